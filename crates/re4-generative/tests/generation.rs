//! A chunk depends only on its own request, and training resumes with equal bytes.
#![allow(clippy::unwrap_used, clippy::panic, reason = "a test may stop where it fails")]

use rand_pcg::Pcg64;
use re4_generative::config::FlowConfig;
use re4_generative::network::Network;
use re4_generative::train::{Task, train};
use re4_generative::{
    Demo, GenerativeConfig, GenerativeError, Generator, Kind, Method, NetworkSize, Normalizer, Request, Sampler,
    Windows, weights,
};
use re4_train::{Backend, Checkpoints};

const OBSERVATION: usize = 5;
const CHANNELS: usize = 2;

fn config(network: NetworkSize) -> GenerativeConfig {
    GenerativeConfig {
        network,
        horizon: 8,
        steps: 100,
        batch: 32,
        warm_up: 10,
        learning_rate: 1e-3,
        ..GenerativeConfig::diffusion()
    }
}

const FLOW: Method = Method::Flow(FlowConfig {
    deviation: 0.1,
    stabilization: 0.0,
    stochastic: true,
});

#[test]
fn a_chunk_does_not_depend_on_the_others_of_its_batch() {
    let device = Backend::Flex.device("backend").unwrap();
    let flow = Sampler::Flow {
        steps: 2,
        actions: 4,
        horizon: 8,
    };
    for size in [NetworkSize::Mlp, NetworkSize::Small] {
        for (method, samplers) in [
            (Method::Diffusion, vec![Sampler::Ddim { steps: 10 }, Sampler::Ddpm]),
            (FLOW, vec![flow]),
        ] {
            let shape = method.shape(&config(size), CHANNELS, OBSERVATION);
            let generator = Generator::new(Network::sampled(shape, 3, &device), shape, device.clone());
            let requests: Vec<Request> = (0_u8..13)
                .map(|number| Request {
                    history: (0..shape.condition)
                        .map(|at| (f32::from(number) + at as f32 * 0.37).sin())
                        .collect(),
                    last: vec![f32::from(number) * 0.1 - 0.6; CHANNELS],
                    rng: Pcg64::new(7, u128::from(number)),
                })
                .collect();
            for sampler in samplers {
                let together = generator.generate(&requests, sampler).unwrap();
                let alone: Vec<Vec<f32>> = requests
                    .chunks(1)
                    .flat_map(|request| generator.generate(request, sampler).unwrap())
                    .collect();
                assert_eq!(together, alone, "{size:?} {sampler:?}");
                assert_ne!(together[0], together[1]);
            }
        }
    }
}

/// Demonstrations on a circle: the action is the next position.
fn circle() -> Vec<Demo> {
    (0..4)
        .map(|number| {
            let at = |frame: usize| {
                let angle = 0.15 * frame as f64 + f64::from(number);
                [angle.cos(), angle.sin()]
            };
            Demo {
                number,
                observations: (0..60)
                    .map(|frame| {
                        let [x, y] = at(frame);
                        vec![x, y, 0.0, 0.0, 0.0]
                    })
                    .collect(),
                actions: (0..60).map(|frame| at(frame + 1).to_vec()).collect(),
                rest: at(0).to_vec(),
            }
        })
        .collect()
}

enum Stop {
    Wanted,
    Error(GenerativeError),
}

impl From<GenerativeError> for Stop {
    fn from(error: GenerativeError) -> Self {
        Self::Error(error)
    }
}

/// Trains on the circle. Stops after some steps if asked to. Returns the bytes of the weights, the losses and the normalisation.
fn fit(
    method: Method,
    config: &GenerativeConfig,
    folder: &std::path::Path,
    stop: Option<u64>,
) -> Option<(Vec<u8>, Vec<f64>, Normalizer, Network)> {
    let demos = circle();
    let normalizer = |kinds: &[Kind], rows: fn(&Demo) -> &Vec<Vec<f64>>| {
        Normalizer::fit(kinds, demos.iter().flat_map(rows).map(Vec::as_slice))
    };
    let observations = normalizer(&[Kind::Range; OBSERVATION], |demo| &demo.observations);
    let actions = normalizer(&[Kind::Range; CHANNELS], |demo| &demo.actions);
    let windows = Windows::new(&demos, config, &observations, &actions).unwrap();
    let task = Task {
        config,
        method,
        windows: &windows,
        held_out: None,
        shape: method.shape(config, CHANNELS, OBSERVATION),
    };
    let checkpoints = Checkpoints::open(folder, [1; 32]).unwrap();
    let trained = train(&task, &checkpoints, |progress| {
        if stop == Some(progress.steps) {
            return Err(Stop::Wanted);
        }
        Ok(())
    });
    match trained {
        Ok(trained) => {
            let losses = trained.fitted.epochs.iter().map(|epoch| epoch.losses[0]).collect();
            Some((
                weights::to_bytes(&trained.network).unwrap(),
                losses,
                actions,
                trained.network,
            ))
        }
        Err(Stop::Wanted) => None,
        Err(Stop::Error(error)) => panic!("{error}"),
    }
}

#[test]
fn an_interrupted_training_ends_with_equal_bytes() {
    for (size, method) in [(NetworkSize::Mlp, Method::Diffusion), (NetworkSize::Mlp, FLOW)] {
        let folder = tempfile::tempdir().unwrap();
        let config = GenerativeConfig {
            steps: 300,
            batch: 16,
            ..config(size)
        };
        let whole = fit(method, &config, &folder.path().join("whole"), None).unwrap();
        let parts = folder.path().join("parts");
        assert!(fit(method, &config, &parts, Some(130)).is_none());
        assert!(fit(method, &config, &parts, Some(201)).is_none());
        let resumed = fit(method, &config, &parts, None).unwrap();
        assert_eq!(whole.0, resumed.0, "{size:?}");
        assert_eq!(whole.1, resumed.1);
        assert_eq!(whole.1.len(), 3);
        assert!(whole.1[2] < whole.1[0]);
    }
}

/// After a short training, both methods follow the circle.
#[test]
fn trained_policies_follow_the_demonstrations() {
    let device = Backend::Flex.device("backend").unwrap();
    let longer = GenerativeConfig {
        steps: 1000,
        average: 0.6,
        ..config(NetworkSize::Mlp)
    };
    let deterministic = Method::Flow(FlowConfig::default());
    let flow = Sampler::Flow {
        steps: 4,
        actions: 4,
        horizon: 8,
    };
    for (method, samplers, skipped) in [
        (Method::Diffusion, vec![Sampler::Ddim { steps: 10 }, Sampler::Ddpm], 1),
        (deterministic, vec![flow], 0),
    ] {
        let folder = tempfile::tempdir().unwrap();
        let (_, _, actions, network) = fit(method, &longer, folder.path(), None).unwrap();
        let shape = method.shape(&longer, CHANNELS, OBSERVATION);
        let generator = Generator::new(network, shape, device.clone());
        let demo = &circle()[1];
        for sampler in samplers {
            for frame in [10, 25, 40] {
                let history = [frame - 1, frame]
                    .into_iter()
                    .flat_map(|frame| demo.observations[frame].clone());
                let request = Request {
                    // The range of both coordinates is about [-1, 1], and the other dimensions are constant.
                    history: history.map(|value| value as f32).collect(),
                    last: actions.forward(&demo.actions[frame - 1]).collect(),
                    rng: Pcg64::new(1, frame as u128),
                };
                let chunk = &generator.generate(&[request], sampler).unwrap()[0][skipped * CHANNELS..];
                for step in 0..4 {
                    let own: Vec<f64> = actions
                        .inverse(&chunk[step * CHANNELS..(step + 1) * CHANNELS])
                        .collect();
                    let expected = &demo.actions[frame + step];
                    let error = (own[0] - expected[0]).hypot(own[1] - expected[1]);
                    assert!(
                        error < 0.15,
                        "{sampler:?} frame {frame} step {step}: {own:?} {expected:?}"
                    );
                }
            }
        }
    }
}

#[test]
fn weights_survive_a_file_and_wrong_files_are_refused() {
    let device = Backend::Flex.device("backend").unwrap();
    let folder = tempfile::tempdir().unwrap();
    for size in [NetworkSize::Mlp, NetworkSize::Small] {
        let shape = Method::Diffusion.shape(&config(size), CHANNELS, OBSERVATION);
        let network = Network::sampled(shape, 1, &device);
        let bytes = weights::to_bytes(&network).unwrap();
        let path = folder.path().join(format!("{size:?}.safetensors"));
        std::fs::write(&path, &bytes).unwrap();
        let again = weights::load(&path, shape, &device).unwrap();
        assert_eq!(weights::to_bytes(&again).unwrap(), bytes);
        // Another network.
        let other = Method::Diffusion.shape(&config(size), CHANNELS + 1, OBSERVATION);
        let error = weights::load(&path, other, &device).unwrap_err().to_string();
        assert!(error.contains("has the shape"), "{error}");
        // A truncated file, and one with a value that is not finite.
        std::fs::write(&path, &bytes[..bytes.len() - 3]).unwrap();
        let error = weights::load(&path, shape, &device).unwrap_err().to_string();
        assert!(error.contains("truncated"), "{error}");
        let mut broken = bytes.clone();
        let end = broken.len() - 4;
        broken[end..].copy_from_slice(&f32::NAN.to_le_bytes());
        std::fs::write(&path, &broken).unwrap();
        let error = weights::load(&path, shape, &device).unwrap_err().to_string();
        assert!(error.contains("NaN"), "{error}");
    }
}

#[test]
fn a_learning_rate_that_diverges_is_one_sentence() {
    let folder = tempfile::tempdir().unwrap();
    let wild = GenerativeConfig {
        learning_rate: 1e30,
        ..config(NetworkSize::Mlp)
    };
    let demos = circle();
    let kinds = [Kind::Range; OBSERVATION];
    let observations = Normalizer::fit(
        &kinds,
        demos.iter().flat_map(|demo| &demo.observations).map(Vec::as_slice),
    );
    let actions = Normalizer::fit(
        &kinds[..CHANNELS],
        demos.iter().flat_map(|demo| &demo.actions).map(Vec::as_slice),
    );
    let windows = Windows::new(&demos, &wild, &observations, &actions).unwrap();
    let task = Task {
        config: &wild,
        method: Method::Diffusion,
        windows: &windows,
        held_out: None,
        shape: Method::Diffusion.shape(&wild, CHANNELS, OBSERVATION),
    };
    let checkpoints = Checkpoints::open(folder.path(), [1; 32]).unwrap();
    let error = train::<GenerativeError>(&task, &checkpoints, |_| Ok(()))
        .err()
        .unwrap()
        .to_string();
    assert!(error.contains("the loss is not a finite number in step"), "{error}");
}
