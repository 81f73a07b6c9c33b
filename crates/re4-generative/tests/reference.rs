//! Compares the networks with PyTorch and the samplers with diffusers (`tests/policy_reference.py` of the repository).
#![allow(clippy::unwrap_used, clippy::panic, reason = "a test may stop where it fails")]

use std::collections::BTreeMap;
use std::path::Path;

use burn::tensor::{Tensor, TensorData};
use rand_pcg::Pcg64;
use re4_generative::network::Shape;
use re4_generative::{Generator, NetworkSize, Request, Sampler, weights};
use re4_train::{Backend, tensors};
use serde::Deserialize;

const BATCH: usize = 2;
const CONDITION: usize = 36;
const CHANNELS: usize = 2;

/// The CRC-32 of zlib.
fn crc32(bytes: &[u8]) -> u32 {
    !bytes.iter().fold(!0, |crc, byte| {
        (0..8).fold(crc ^ u32::from(*byte), |crc, _| {
            if crc & 1 == 1 { crc >> 1 ^ 0xEDB8_8320 } else { crc >> 1 }
        })
    })
}

/// The same as `numbers` of the script.
fn numbers(name: &str, count: usize) -> Vec<f32> {
    let start = crc32(name.as_bytes());
    let number = |index: usize| {
        let mut x = (index as u32).wrapping_mul(2_654_435_761).wrapping_add(start);
        for multiplier in [0x7FEB_352D_u32, 0x846C_A68B] {
            x ^= x >> 15;
            x = x.wrapping_mul(multiplier);
        }
        x ^= x >> 16;
        (f64::from(x >> 8) / f64::from(1 << 23) - 1.0) as f32
    };
    (0..count).map(number).collect()
}

/// The same as `tensor` of the script.
fn values(name: &str, shape: &[usize]) -> Vec<f32> {
    let mut values = numbers(name, shape.iter().product());
    for value in &mut values {
        *value = if shape.len() > 1 {
            *value * (3.0 / shape[1..].iter().product::<usize>() as f64).sqrt() as f32
        } else if name.ends_with(".weight") {
            1.0 + 0.25 * *value
        } else {
            0.125 * *value
        };
    }
    values
}

#[derive(Deserialize)]
struct Case {
    network: String,
    length: usize,
    times: Vec<f32>,
    state: BTreeMap<String, Vec<usize>>,
    output: Vec<f32>,
}

#[derive(Deserialize)]
struct Samplers {
    ddpm: Vec<f32>,
    ddim: Vec<f32>,
}

fn cases() -> Vec<Case> {
    serde_json::from_str(include_str!("data/networks.json")).unwrap()
}

impl Case {
    fn shape(&self) -> Shape {
        Shape {
            size: match self.network.as_str() {
                "small" => NetworkSize::Small,
                _ => NetworkSize::Mlp,
            },
            channels: CHANNELS,
            length: self.length,
            condition: CONDITION,
        }
    }

    /// Writes the weights to a file, as PyTorch would. For chunks of one or two actions, the outer taps of the convolutions of
    /// kernel 5 see only padding, and our files leave them out.
    fn write(&self, path: &Path) {
        let stored = self.state.iter().map(|(name, shape)| {
            let all = values(name, shape);
            let taps = 2 * self.length - 1;
            match *shape.as_slice() {
                [outputs, inputs, 5] if taps < 5 => {
                    let kept = all
                        .chunks_exact(5)
                        .flat_map(|kernel| &kernel[2 - taps / 2..=2 + taps / 2]);
                    (name.clone(), (vec![outputs, inputs, taps], kept.copied().collect()))
                }
                _ => (name.clone(), (shape.clone(), all)),
            }
        });
        std::fs::write(path, tensors::to_bytes(&stored.collect()).unwrap()).unwrap();
    }
}

fn largest_difference(own: &[f32], reference: &[f32]) -> f32 {
    assert_eq!(own.len(), reference.len());
    let scale = reference
        .iter()
        .fold(0.0_f32, |largest, value| largest.max(value.abs()));
    own.iter().zip(reference).fold(0.0_f32, |largest, (own, reference)| {
        largest.max((own - reference).abs())
    }) / scale
}

#[test]
fn networks_equal_pytorch() {
    let device = Backend::Flex.device("backend").unwrap();
    let folder = tempfile::tempdir().unwrap();
    for case in cases() {
        let path = folder.path().join("weights.safetensors");
        case.write(&path);
        let network = weights::load(&path, case.shape(), &device).unwrap();
        let data = |name: &str, dims: &[usize]| TensorData::new(numbers(name, dims.iter().product()), dims.to_vec());
        let chunks = Tensor::from_data(data("chunks", &[BATCH, case.length, CHANNELS]), &device);
        let condition = Tensor::from_data(data("condition", &[BATCH, CONDITION]), &device);
        let output = network.forward(chunks, &case.times, condition).into_data();
        let output: Vec<f32> = output.iter::<f32>().collect();
        let difference = largest_difference(&output, &case.output);
        assert!(
            difference < 1e-5,
            "{} of length {}: {difference}",
            case.network,
            case.length
        );
    }
}

#[test]
fn samplers_equal_diffusers() {
    let device = Backend::Flex.device("backend").unwrap();
    let folder = tempfile::tempdir().unwrap();
    let reference: Samplers = serde_json::from_str(include_str!("data/samplers.json")).unwrap();
    let cases = cases();
    let case = cases
        .iter()
        .find(|case| case.network == "small" && case.length == 16)
        .unwrap();
    let path = folder.path().join("weights.safetensors");
    case.write(&path);
    let generator = Generator::new(
        weights::load(&path, case.shape(), &device).unwrap(),
        case.shape(),
        device,
    );
    let condition = numbers("condition", BATCH * CONDITION);
    let requests: Vec<Request> = condition
        .chunks_exact(CONDITION)
        .map(|history| Request {
            history: history.to_vec(),
            last: vec![0.0; CHANNELS],
            rng: Pcg64::new(0, 0),
        })
        .collect();
    for (sampler, expected) in [
        (Sampler::Ddpm, &reference.ddpm),
        (Sampler::Ddim { steps: 10 }, &reference.ddim),
    ] {
        let mut calls = 0..;
        let chunks = generator.generate_with(&requests, sampler, |into, count| {
            let call: u32 = calls.next().unwrap();
            into.extend(numbers(&format!("noise{call}"), count * BATCH));
        });
        let own: Vec<f32> = chunks.unwrap().concat();
        let difference = largest_difference(&own, expected);
        assert!(difference < 1e-5, "{sampler:?}: {difference}");
    }
}
