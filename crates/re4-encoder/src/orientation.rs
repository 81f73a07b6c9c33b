//! Gives the estimates of an object without a symmetry by π one orientation each.
//!
//! A two-finger gripper grasps equally well after a rotation by π, and a demonstrator takes the nearer of the two. The anchors
//! therefore determine the object's orientation only up to π, although its images show it. A network that is trained on either
//! alternative takes the demonstrators' choice as far as it can: its estimates jump where the demonstrators change sides, and are
//! wrong near there.
//!
//! After the training, this module chooses the alternative of every demonstration such that demonstrations with similar keypoints
//! have similar rotations: a synchronisation over {0, π}, by the sign of the first eigenvector of the graph of nearest neighbours.
//! Then it trains the head of the rotation again, on the keypoints of the trained network and the chosen alternatives.

use burn::module::Module as _;
use burn::optim::{AdamWConfig, GradientsParams};
use burn::tensor::{Tensor, TensorData};
use nalgebra::{Isometry3, UnitQuaternion, Vector3};
use rand_pcg::Pcg64;
use re4_train::{below, uniform};

use crate::batches::{AS_RECORDED, Sample};
use crate::images::{Crop, load};
use crate::loss::Poses;
use crate::network::{Crops, Encoder, Kernels, estimate};
use crate::predict::corners;
use crate::train::{BACKEND, Task, WeightInitializer, cosine};
use crate::{EncoderError, IMAGE_BYTES};

/// Number of neighbours of a demonstration.
const NEIGHBOURS: usize = 6;

/// Maximum number of frames per demonstration before the grasp, and of those that hold the object.
const FRAMES: usize = 16;

/// Steps of the head's training, images per step, and learning rate of `AdamW`.
const STEPS: u32 = 3000;
const BATCH: usize = 64;
const LEARNING_RATE: f64 = 5e-3;

/// One in this many images of a batch holds the object.
const ONE_HELD_OF: usize = 4;

/// Iterations of the eigenvector.
const ITERATIONS: usize = 20_000;

/// Number of images per forward pass.
const FORWARD: usize = 64;

/// Keypoints of an image, and the demonstration and the pose that they are trained on.
struct Example {
    demo: usize,
    keypoints: Vec<f32>,
    target: Isometry3<f64>,
}

/// Trains the head of the rotation on one alternative per demonstration. Returns the network unchanged if its object has a
/// symmetry by π, or it has no keypoints.
///
/// # Errors
/// If images cannot be read.
pub(crate) fn settle(encoder: Encoder, task: &Task) -> Result<Encoder, EncoderError> {
    let has_symmetry = task.symmetry.of_label() == task.symmetry;
    if !task.config.one_orientation || has_symmetry || encoder.keypoints().is_none() {
        return Ok(encoder);
    }
    // Without gradients: burn keeps the graph of every forward pass that no backward pass follows.
    let frozen = encoder.valid();
    let kernels = Kernels::of(&frozen, task.config.backend)?;
    let network = (&frozen, kernels.as_ref());
    let demos = task.sampler.demos();
    let corners = corners(task.config.crops);
    let (mut before, mut held) = (Vec::new(), Vec::new());
    let mut means = Vec::with_capacity(demos.len());
    for (number, demo) in demos.iter().enumerate() {
        let frames = spread_over(&demo.before);
        let first = before.len();
        for &corner in &corners {
            let examples = keypoints(network, task, (number, demo.first), &frames, corner, |_| demo.anchor)?;
            before.extend(examples);
        }
        means.push(mean(&before[first..first + frames.len()]));
        let frames = spread_over(&demo.held);
        let target = |frame: u32| demo.eef[frame as usize];
        held.extend(keypoints(
            network,
            task,
            (number, demo.first),
            &frames,
            corners[0],
            target,
        )?);
    }
    let anchors: Vec<UnitQuaternion<f64>> = demos.iter().map(|demo| demo.anchor.rotation).collect();
    let rotated = choose(&means, &anchors);
    for example in before.iter_mut().chain(&mut held) {
        if rotated[example.demo] {
            example.target.rotation *= by_pi();
        }
    }
    train_rotation(encoder, task, &before, &held)
}

fn by_pi() -> UnitQuaternion<f64> {
    UnitQuaternion::from_axis_angle(&Vector3::z_axis(), std::f64::consts::PI)
}

/// At most [`FRAMES`] of these frames, evenly spaced.
fn spread_over(frames: &[u32]) -> Vec<u32> {
    let count = frames.len().min(FRAMES);
    (0..count).map(|i| frames[i * frames.len() / count]).collect()
}

/// The keypoints of frames of a demonstration, of which the number and that of its first image are given.
fn keypoints(
    (encoder, kernels): (&Encoder, Option<&Kernels>),
    task: &Task,
    (demo, first): (usize, u64),
    frames: &[u32],
    corner: [u8; 2],
    target: impl Fn(u32) -> Isometry3<f64>,
) -> Result<Vec<Example>, EncoderError> {
    let mut examples = Vec::with_capacity(frames.len());
    for chunk in frames.chunks(FORWARD) {
        let samples: Vec<Sample> = chunk
            .iter()
            .map(|&frame| Sample::plain(first + u64::from(frame), target(frame)))
            .collect();
        let images = load(task.images, &samples)?;
        let images: Vec<&[u8]> = images.chunks_exact(IMAGE_BYTES).collect();
        let crops = vec![
            Crop {
                corner,
                light: AS_RECORDED,
            };
            images.len()
        ];
        let crops = Crops {
            images: &images,
            crops: &crops,
        };
        let found = estimate(encoder, kernels, crops).embedding;
        let numbers: Vec<f32> = found.into_data().iter::<f32>().collect();
        let each = numbers.len() / images.len().max(1);
        for (sample, keypoints) in samples.iter().zip(numbers.chunks_exact(each.max(1))) {
            examples.push(Example {
                demo,
                keypoints: keypoints.to_vec(),
                target: sample.target,
            });
        }
    }
    Ok(examples)
}

/// The mean keypoints.
fn mean(examples: &[Example]) -> Vec<f64> {
    let mut sum = vec![0.0; examples.first().map_or(0, |example| example.keypoints.len())];
    for example in examples {
        for (sum, own) in sum.iter_mut().zip(&example.keypoints) {
            *sum += f64::from(*own);
        }
    }
    sum.iter().map(|sum| sum / examples.len().max(1) as f64).collect()
}

/// For every demonstration, whether its rotation is rotated by π about the approach axis, so that demonstrations with similar
/// keypoints have similar rotations. The first demonstration's is not rotated.
fn choose(keypoints: &[Vec<f64>], rotations: &[UnitQuaternion<f64>]) -> Vec<bool> {
    let count = keypoints.len();
    let distance = |i: usize, j: usize| -> f64 {
        let pairs = keypoints[i].iter().zip(&keypoints[j]);
        pairs.map(|(a, b)| (a - b) * (a - b)).sum()
    };
    // Weight of an edge: 1 if the rotations are equal, -1 if they differ by π, and 0 if they tell nothing.
    let weight = |i: usize, j: usize| -> f64 {
        let [a, b] = [i, j].map(|k| rotations[k].to_rotation_matrix().into_inner());
        f64::midpoint(a.column(0).dot(&b.column(0)), a.column(1).dot(&b.column(1)))
    };
    let mut edges: Vec<Vec<(usize, f64)>> = vec![Vec::new(); count];
    for i in 0..count {
        let mut others: Vec<(f64, usize)> = (0..count).filter(|&j| j != i).map(|j| (distance(i, j), j)).collect();
        others.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        for &(_, j) in others.iter().take(NEIGHBOURS) {
            let own = weight(i, j);
            edges[i].push((j, own));
            edges[j].push((i, own));
        }
    }
    let degrees: Vec<f64> = edges
        .iter()
        .map(|edges| {
            edges
                .iter()
                .map(|(_, weight)| weight.abs())
                .sum::<f64>()
                .max(1e-9)
                .sqrt()
        })
        .collect();
    // The eigenvalues of the normalised weights are between -1 and 1; adding 1 makes the largest the one of the largest magnitude.
    let mut rng = Pcg64::new(0, 0x6f72_6965_6e74_6174_696f_6e00_7369_676e);
    let mut vector: Vec<f64> = (0..count).map(|_| uniform(&mut rng) - 0.5).collect();
    for _ in 0..ITERATIONS {
        let next: Vec<f64> = (0..count)
            .map(|i| {
                let sum: f64 = edges[i]
                    .iter()
                    .map(|&(j, weight)| weight * vector[j] / (degrees[i] * degrees[j]))
                    .sum();
                sum + vector[i]
            })
            .collect();
        let length = next.iter().map(|x| x * x).sum::<f64>().sqrt();
        if length == 0.0 {
            break;
        }
        vector = next.into_iter().map(|x| x / length).collect();
    }
    let sign = vector.first().is_some_and(|first| *first < 0.0);
    vector.iter().map(|x| (*x < 0.0) != sign).collect()
}

/// Trains the head of the rotation from random weights. The rest of the network does not change.
fn train_rotation(
    encoder: Encoder,
    task: &Task,
    before: &[Example],
    held: &[Example],
) -> Result<Encoder, EncoderError> {
    let device = task.config.backend.device(BACKEND)?.autodiff();
    // Two streams, so that weights and batches are independent.
    let stream = |number: u128| Pcg64::new(u128::from(task.config.seed), 0x726f_7461_7469_6f6e + number);
    let mut initializer = WeightInitializer::new(stream(0), encoder.network());
    let mut rng = stream(1);
    let mut encoder = encoder.with_new_rotation(&mut initializer);
    let mut optimizer = AdamWConfig::new()
        .with_weight_decay(task.config.weight_decay as f32)
        .with_epsilon(1e-8)
        .init();
    for step in 0..STEPS {
        let chosen: Vec<&Example> = (0..BATCH)
            .map(|i| {
                let from = if i % ONE_HELD_OF == 0 && !held.is_empty() {
                    held
                } else {
                    before
                };
                &from[below(&mut rng, from.len())]
            })
            .collect();
        let numbers: Vec<f32> = chosen
            .iter()
            .flat_map(|example| example.keypoints.iter().copied())
            .collect();
        let width = numbers.len() / BATCH;
        let inputs = Tensor::<2>::from_data(TensorData::new(numbers, [BATCH, width]), &device);
        let targets: Vec<Isometry3<f64>> = chosen.iter().map(|example| example.target).collect();
        let targets = Poses::from_known(&targets, &device);
        let Some(network) = encoder.keypoints() else { break };
        let loss = network.rotations(&inputs).chordal(&targets, task.symmetry).mean();
        let gradients = GradientsParams::from_grads(loss.backward(), &encoder);
        let rate = cosine(LEARNING_RATE).rate(u64::from(step), u64::from(STEPS));
        encoder = optimizer.step(rate, encoder, gradients);
    }
    Ok(encoder)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::{FRAC_PI_2, PI, TAU};

    use crate::EncoderConfig;
    use crate::batches::Sampler;
    use crate::images::ImageFile;
    use crate::loss::Alternatives;

    /// Objects at all yaws. Keypoints show the yaw; the gripper is within a quarter of a revolution of its home orientation, and
    /// points down.
    #[test]
    fn neighbours_get_the_same_orientation_all_around() {
        let yaws: Vec<f64> = (0..40).map(|i| TAU * f64::from(i * 7 % 40) / 40.0).collect();
        let keypoints: Vec<Vec<f64>> = yaws.iter().map(|yaw| vec![yaw.cos(), yaw.sin(), 0.3]).collect();
        let down = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), PI);
        let gripper = |yaw: f64| UnitQuaternion::from_axis_angle(&Vector3::z_axis(), yaw) * down;
        let grasped = |yaw: f64| {
            let nearer = (yaw + FRAC_PI_2).rem_euclid(PI) - FRAC_PI_2;
            gripper(nearer)
        };
        let rotations: Vec<UnitQuaternion<f64>> = yaws.iter().map(|yaw| grasped(*yaw)).collect();
        let chosen = choose(&keypoints, &rotations);
        assert!(!chosen[0] && chosen.iter().filter(|rotated| **rotated).count() == 20);
        for ((yaw, rotation), rotated) in yaws.iter().zip(&rotations).zip(&chosen) {
            let own = if *rotated { rotation * by_pi() } else { *rotation };
            // The first object is at yaw 0, and its gripper is not rotated.
            assert!(own.angle_to(&gripper(*yaw)) < 1e-6, "yaw {yaw}");
        }
    }

    #[test]
    fn the_head_learns_the_rotation_and_nothing_else_changes() {
        let config = EncoderConfig::default();
        let folder = tempfile::tempdir().unwrap();
        let no_images = std::iter::empty::<Result<Vec<u8>, EncoderError>>();
        let task = Task {
            config: &config,
            sampler: &Sampler::new(Vec::new(), &config, Alternatives::NONE),
            images: &ImageFile::write(folder.path(), no_images).unwrap(),
            held_out: &[],
            weights: None,
            symmetry: Alternatives::NONE,
        };
        let device = config.backend.device(BACKEND).unwrap().autodiff();
        let encoder = Encoder::new(config.network, config.width, &device);
        let encoder = encoder.map(&mut WeightInitializer::new(Pcg64::new(1, 1), config.network));
        let down = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), PI);
        let gripper = |yaw: f64| UnitQuaternion::from_axis_angle(&Vector3::z_axis(), yaw) * down;
        // Every keypoint is on a circle, at an angle of its own.
        let keypoints = |yaw: f64| -> Vec<f32> {
            let angle = |i: usize| yaw + i as f64;
            (0..32)
                .flat_map(|i| [0.2 * angle(i).cos() as f32, 0.2 * angle(i).sin() as f32])
                .collect()
        };
        let examples: Vec<Example> = (0..60)
            .map(|i| TAU * f64::from(i) / 60.0)
            .map(|yaw| Example {
                demo: 0,
                keypoints: keypoints(yaw),
                target: Isometry3::from_parts(Vector3::zeros().into(), gripper(yaw)),
            })
            .collect();
        let trained = train_rotation(encoder.clone(), &task, &examples, &[]).unwrap();
        let raw = |encoder: &Encoder, yaw: f64| {
            let inputs = Tensor::<2>::from_data(TensorData::new(keypoints(yaw), [1, 64]), &device);
            encoder.keypoints().unwrap().head(&inputs)
        };
        for yaw in [0.05, 1.57, 3.1, 3.2, 5.0] {
            let poses = Poses::from_raw(&raw(&trained, yaw), 1.0);
            let target = Isometry3::from_parts(Vector3::zeros().into(), gripper(yaw));
            let (_, angle) = poses.distance(&Poses::from_known(&[target], &device));
            let angle = angle.into_scalar::<f32>();
            assert!(angle < 0.1, "{angle} rad at yaw {yaw}");
            let translation = |encoder: &Encoder| raw(encoder, yaw).narrow(1, 0, 3).into_data();
            assert_eq!(translation(&trained), translation(&encoder));
        }
        let trunk = |encoder: &Encoder| encoder.keypoints().unwrap().trunk_weights().unwrap().kernels;
        assert_eq!(trunk(&trained), trunk(&encoder));
    }

    #[test]
    fn few_demonstrations_are_no_problem() {
        assert!(choose(&[], &[]).is_empty());
        assert_eq!(choose(&[vec![1.0]], &[UnitQuaternion::identity()]), [false]);
        let two = [UnitQuaternion::identity(), by_pi()];
        assert_eq!(choose(&[vec![1.0], vec![1.0]], &two), [false, true]);
    }

    #[test]
    fn frames_are_evenly_spaced() {
        assert_eq!(spread_over(&[3, 4, 5]), [3, 4, 5]);
        let many: Vec<u32> = (0..160).collect();
        assert_eq!(spread_over(&many), (0..16).map(|i| 10 * i).collect::<Vec<u32>>());
        assert!(spread_over(&[]).is_empty());
    }
}
