//! A complete training on images that this test renders: a square at the object's position, and a cross for the gripper.
#![allow(clippy::unwrap_used, clippy::panic, reason = "a test may panic")]

use std::cell::Cell;
use std::path::Path;

use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};
use re4_encoder::batches::{Sample, Sampler, TrainingDemo};
use re4_encoder::images::ImageFile;
use re4_encoder::loss::Alternatives;
use re4_encoder::train::{Task, Trained, train};
use re4_encoder::{EncoderConfig, EncoderError, IMAGE_BYTES, Network, Predictor, Preset, SIDE};
use re4_fault::Remedy as _;
use re4_train::Checkpoints;

/// Number of frames before the grasp, and of frames that hold the object.
const BEFORE: usize = 6;
const HELD: usize = 4;

/// A position that depends on the demonstration: a low-discrepancy sequence that fills a rectangle uniformly.
fn position(demo: usize) -> [f64; 2] {
    let centred = |ratio: f64| (demo as f64 * ratio).fract() - 0.5;
    [0.3 * centred(0.754_877_666), 0.3 * centred(0.569_840_291)]
}

fn pose(at: [f64; 2], height: f64) -> Isometry3<f64> {
    Isometry3::from_parts(
        Translation3::new(at[0], at[1], height),
        UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI),
    )
}

fn render(object: [f64; 2], gripper: [f64; 2]) -> Vec<u8> {
    let mut image = vec![60; IMAGE_BYTES];
    let pixel = |at: [f64; 2]| at.map(|x| (SIDE as f64 * (0.5 + x / 0.5)) as i64);
    let mut paint = |column: i64, row: i64, colour: [u8; 3]| {
        let at = (row as usize * SIDE + column as usize) * 3;
        image[at..at + 3].copy_from_slice(&colour);
    };
    let ([x, y], [u, v]) = (pixel(object), pixel(gripper));
    for i in -4..=4 {
        for j in -4..=4 {
            paint(x + i, y + j, [220, 40, 30]);
        }
        paint(u + i, v, [230, 230, 230]);
        paint(u, v + i, [230, 230, 230]);
    }
    image
}

struct Scenes {
    demos: Vec<TrainingDemo>,
    images: ImageFile,
    folder: tempfile::TempDir,
}

/// Demonstrations in which the gripper comes from a corner, grasps the object, and carries it towards the centre.
fn scenes(count: usize) -> Scenes {
    let folder = tempfile::tempdir().unwrap();
    let mut images = Vec::new();
    let demos = (0..count)
        .map(|demo| {
            let at = position(demo);
            let first = images.len() as u64;
            let mut eef = Vec::new();
            for frame in 0..BEFORE + HELD {
                let fraction = (frame.min(BEFORE) as f64) / BEFORE as f64;
                let carried = (frame.saturating_sub(BEFORE)) as f64 * 0.1;
                let object = at.map(|x| x * (1.0 - carried));
                let gripper = if frame < BEFORE {
                    [-0.2 + fraction * (at[0] + 0.2), -0.2 + fraction * (at[1] + 0.2)]
                } else {
                    object
                };
                images.push(render(object, gripper));
                eef.push(pose(gripper, 0.8));
            }
            TrainingDemo {
                first,
                before: (0..BEFORE as u32).collect(),
                held: (BEFORE as u32..(BEFORE + HELD) as u32).collect(),
                anchor: pose(at, 0.8),
                eef,
            }
        })
        .collect();
    let images = ImageFile::write(folder.path(), images.into_iter().map(Ok::<_, EncoderError>)).unwrap();
    Scenes { demos, images, folder }
}

fn config() -> EncoderConfig {
    let paper = EncoderConfig::preset(Preset::Paper);
    EncoderConfig {
        width: 4,
        epochs: 5,
        steps: Some(40),
        batch: 32,
        learning_rate: 2e-3,
        cosine: true,
        losses: re4_encoder::LossConfig {
            translation: 300.0,
            ..paper.losses
        },
        ..paper
    }
}

/// Settings of the preset `re4` for a few seconds.
fn keypoints() -> EncoderConfig {
    EncoderConfig {
        epochs: 5,
        steps: Some(40),
        batch: 32,
        ..EncoderConfig::preset(Preset::Re4)
    }
}

struct Interrupted;

impl From<EncoderError> for Interrupted {
    fn from(error: EncoderError) -> Self {
        panic!("{error}")
    }
}

/// Trains on all demonstrations except every fifth one, which are held out; stops after at most `steps` steps.
fn fit(scenes: &Scenes, config: &EncoderConfig, folder: &Path, steps: u64) -> Option<Trained> {
    let (held_out, training): (Vec<_>, Vec<_>) = (0..scenes.demos.len()).partition(|demo| demo % 5 == 0);
    let held_out: Vec<Sample> = held_out
        .into_iter()
        .flat_map(|demo| {
            let demo = &scenes.demos[demo];
            demo.before
                .iter()
                .map(|&frame| Sample::plain(demo.first + u64::from(frame), demo.anchor))
        })
        .collect();
    let training = training.into_iter().map(|demo| scenes.demos[demo].clone()).collect();
    let sampler = Sampler::new(training, config, Alternatives::NONE);
    let task = Task {
        config,
        sampler: &sampler,
        images: &scenes.images,
        held_out: &held_out,
        weights: None,
        symmetry: Alternatives::NONE,
    };
    let done = Cell::new(0);
    train(&task, &Checkpoints::open(folder, [7; 32]).unwrap(), |_| {
        done.set(done.get() + 1);
        if done.get() < steps { Ok(()) } else { Err(Interrupted) }
    })
    .ok()
}

#[test]
fn the_loss_decreases_and_held_out_positions_are_estimated() {
    // The fraction of the error of the mean pose, which is some 10 cm.
    check_training(&config(), 0.3);
}

#[test]
fn keypoints_estimate_held_out_positions_within_millimetres() {
    check_training(&keypoints(), 0.06);
}

fn check_training(config: &EncoderConfig, fraction: f64) {
    let scenes = scenes(60);
    let folder = tempfile::tempdir().unwrap();
    let trained = fit(&scenes, config, folder.path(), u64::MAX).unwrap();
    let losses: Vec<f64> = trained.epochs.iter().map(|epoch| epoch.losses[0]).collect();
    assert!(losses[4] < 0.25 * losses[0], "{losses:?}");
    let held_out: Vec<f64> = trained.epochs.iter().filter_map(|epoch| epoch.held_out).collect();
    assert!(held_out[4] < 0.5 * held_out[0], "{held_out:?}");

    let predictor = Predictor::new(trained.encoder, config).unwrap();
    let training: Vec<usize> = (0..60).filter(|demo| demo % 5 != 0).collect();
    let mean = training
        .iter()
        .map(|&demo| scenes.demos[demo].anchor.translation.vector)
        .sum::<Vector3<f64>>()
        / training.len() as f64;
    let (mut errors, mut of_mean) = (Vec::new(), Vec::new());
    for demo in scenes.demos.iter().step_by(5) {
        let mut image = vec![0; IMAGE_BYTES];
        scenes.images.read(demo.first + 1, &mut image).unwrap();
        let found = &predictor.predict(&[&image]).unwrap()[0];
        let length = if config.network == Network::Resnet18 {
            256
        } else {
            4 * config.width
        };
        assert_eq!(found.embedding.len(), length);
        errors.push((found.pose.translation.vector - demo.anchor.translation.vector).norm());
        of_mean.push((mean - demo.anchor.translation.vector).norm());
    }
    errors.sort_by(f64::total_cmp);
    of_mean.sort_by(f64::total_cmp);
    let (error, baseline) = (errors[errors.len() / 2], of_mean[of_mean.len() / 2]);
    assert!(
        error < fraction * baseline,
        "the median error is {error:.4} m, that of the mean pose {baseline:.4} m"
    );
}

#[test]
fn an_interrupted_training_resumes_bit_exactly() {
    check_resumption(config());
    check_resumption(keypoints());
}

fn check_resumption(config: EncoderConfig) {
    let scenes = scenes(20);
    let config = EncoderConfig {
        epochs: 3,
        steps: Some(6),
        ..config
    };
    let whole = tempfile::tempdir().unwrap();
    let whole = fit(&scenes, &config, whole.path(), u64::MAX).unwrap();
    assert_eq!(whole.resumed, 0);
    // Interrupted in the middle of the second epoch, and again in the third.
    let folder = tempfile::tempdir().unwrap();
    assert!(fit(&scenes, &config, folder.path(), 9).is_none());
    assert!(fit(&scenes, &config, folder.path(), 8).is_none());
    let resumed = fit(&scenes, &config, folder.path(), u64::MAX).unwrap();
    assert_eq!(resumed.resumed, 2);
    assert_eq!(resumed.epochs, whole.epochs);
    let bytes = |trained: &Trained| re4_encoder::to_bytes(&trained.encoder).unwrap();
    assert!(bytes(&resumed) == bytes(&whole), "weights differ");
    assert_eq!(std::fs::read_dir(scenes.folder.path()).unwrap().count(), 0);
}

#[test]
fn foreign_or_damaged_checkpoints_are_not_used() {
    let scenes = scenes(10);
    let config = EncoderConfig {
        epochs: 2,
        steps: Some(2),
        ..config()
    };
    let folder = tempfile::tempdir().unwrap();
    let whole = fit(&scenes, &config, folder.path(), u64::MAX).unwrap();
    let file = folder.path().join("epoch-00002");
    let bytes = std::fs::read(&file).unwrap();
    // With a flipped bit, or truncated, a checkpoint is ignored.
    for damaged in [
        {
            let mut bytes = bytes.clone();
            *bytes.last_mut().unwrap() ^= 1;
            bytes
        },
        bytes[..bytes.len() / 2].to_vec(),
        Vec::new(),
    ] {
        std::fs::write(&file, damaged).unwrap();
        let again = fit(&scenes, &config, folder.path(), u64::MAX).unwrap();
        assert_eq!(again.resumed, 0);
        assert_eq!(again.epochs, whole.epochs);
    }
    let sampler = Sampler::new(scenes.demos.clone(), &config, Alternatives::NONE);
    let task = Task {
        config: &config,
        sampler: &sampler,
        images: &scenes.images,
        held_out: &[],
        weights: None,
        symmetry: Alternatives::NONE,
    };
    let foreign = Checkpoints::open(folder.path(), [8; 32]).unwrap();
    let Err(error) = train(&task, &foreign, |_| Ok::<_, EncoderError>(())) else {
        panic!("a checkpoint of another training was used")
    };
    assert!(
        error
            .sentence()
            .contains("is of another training run, with other data or settings; remove it")
    );
}

#[test]
fn a_loss_that_is_not_finite_stops_the_training_and_keeps_the_last_checkpoint() {
    let scenes = scenes(10);
    let good = EncoderConfig {
        epochs: 1,
        steps: Some(2),
        ..config()
    };
    let folder = tempfile::tempdir().unwrap();
    fit(&scenes, &good, folder.path(), u64::MAX).unwrap();
    let bad = EncoderConfig {
        epochs: 3,
        learning_rate: 1e30,
        cosine: false,
        ..good
    };
    let sampler = Sampler::new(scenes.demos.clone(), &config(), Alternatives::NONE);
    let task = Task {
        config: &bad,
        sampler: &sampler,
        images: &scenes.images,
        held_out: &[],
        weights: None,
        symmetry: Alternatives::NONE,
    };
    let checkpoints = Checkpoints::open(folder.path(), [7; 32]).unwrap();
    let Err(error) = train(&task, &checkpoints, |_| Ok::<_, EncoderError>(())) else {
        panic!("a training with a loss of 1e30 was not stopped")
    };
    let text = error.sentence();
    assert!(
        text.contains("the loss is not a finite number in step 2 of epoch 2"),
        "{text}"
    );
    assert!(text.contains("the checkpoint of epoch 1 is kept as"), "{text}");
    assert!(folder.path().join("epoch-00001").exists());
}

#[test]
fn batches_depend_on_seed_epoch_and_step_and_pair_near_anchors() {
    let scenes = scenes(40);
    let settings = EncoderConfig {
        radius: 0.05,
        seed: 3,
        batch: 64,
        ..config()
    };
    let sampler = Sampler::new(scenes.demos.clone(), &settings, Alternatives::NONE);
    let batch = sampler.batch(2, 5);
    assert_eq!(batch.samples.len(), 64);
    assert_eq!(batch.samples, sampler.batch(2, 5).samples);
    assert_ne!(batch.samples, sampler.batch(2, 6).samples);
    assert_ne!(batch.samples, sampler.batch(3, 5).samples);
    let demo_of = |sample: &Sample| (sample.image as usize) / (BEFORE + HELD);
    let mut crops = std::collections::BTreeSet::new();
    for step in 0..50 {
        let batch = sampler.batch(0, step);
        for (group, near) in batch.samples.chunks(8).zip(&batch.near) {
            let (first, second) = (demo_of(&group[0]), demo_of(&group[4]));
            let difference =
                scenes.demos[first].anchor.translation.vector - scenes.demos[second].anchor.translation.vector;
            assert_eq!(*near, first != second);
            assert!(difference.norm() < 0.05);
            for (k, sample) in group.iter().enumerate() {
                let demo = &scenes.demos[demo_of(sample)];
                let frame = (sample.image - demo.first) as usize;
                assert_eq!(frame >= BEFORE, k % 4 >= 2);
                let target = if frame < BEFORE { demo.anchor } else { demo.eef[frame] };
                assert_eq!(sample.target, target);
                crops.insert(sample.crop);
            }
        }
    }
    // There are 9 x 9 crops, and each of them is sampled.
    assert_eq!(crops.len(), 81);
    assert!(crops.iter().all(|crop| crop.iter().all(|&at| at <= 8)));
}
