//! Sampling of training batches.
//!
//! A batch consists of groups of two demonstrations. The first demonstration of a group is sampled from the training set. The
//! second is sampled from the demonstrations whose anchor differs from the first one's by less than the radius and less than
//! [`SAME_ROTATION`]; if there are none, it is the first one again. From each demonstration, two frames before the grasp and two
//! that hold the object are sampled uniformly and independently, and every image has its own random crop. All samples depend only
//! on seed, epoch and step, so a training that resumes from a checkpoint uses the same batches.

use nalgebra::{Isometry3, UnitQuaternion, Vector3};
use rand_pcg::Pcg64;
use re4_train::{below, normal};

use crate::config::EncoderConfig;
use crate::images::MIDDLE;
use crate::loss::{Alternatives, GROUP, PER_DEMO};
use crate::{CROP, SIDE};

/// Maximum angle between two anchors that L_cross treats as the same pose, in rad; beyond it, the gripper holds the object
/// differently.
const SAME_ROTATION: f64 = 0.3;

/// The training data of a demonstration. It has no recorded object pose.
#[derive(Debug, Clone)]
pub struct TrainingDemo {
    /// Number of its first image in the image file.
    pub first: u64,
    /// Frames before the grasp, in which the object is at the anchor.
    pub before: Vec<u32>,
    /// Frames in which the gripper holds the object.
    pub held: Vec<u32>,
    /// End effector's pose at the grasp.
    pub anchor: Isometry3<f64>,
    /// End effector's pose in every frame.
    pub eef: Vec<Isometry3<f64>>,
}

/// An image of a batch, with its target.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sample {
    /// Number of the image.
    pub image: u64,
    /// First row and column of the crop.
    pub crop: [u8; 2],
    /// Factor of the pixels' values, and what is added to them as a fraction of the largest value.
    pub light: [f32; 2],
    /// Target of the estimate.
    pub target: Isometry3<f64>,
}

impl Sample {
    /// A sample with the centre crop and unchanged brightness.
    pub fn plain(image: u64, target: Isometry3<f64>) -> Self {
        Self {
            image,
            crop: MIDDLE,
            light: AS_RECORDED,
            target,
        }
    }
}

/// Unchanged brightness.
pub(crate) const AS_RECORDED: [f32; 2] = [1.0, 0.0];

/// The images of an optimiser step.
#[derive(Debug, Clone)]
pub struct Batch {
    /// The images, in groups of [`GROUP`].
    pub samples: Vec<Sample>,
    /// For each group, whether its anchors are those of two demonstrations that L_cross treats as the same pose.
    pub near: Vec<bool>,
}

/// Samples batches.
#[derive(Debug)]
pub struct Sampler {
    demos: Vec<TrainingDemo>,
    near: Vec<Vec<usize>>,
    seed: u64,
    groups: usize,
    held: usize,
    brightness: f64,
}

/// The angle between the rotations of two anchors, up to the alternatives.
fn angle(a: &Isometry3<f64>, b: &Isometry3<f64>, symmetry: Alternatives) -> f64 {
    match symmetry {
        Alternatives::Axis => (a.rotation * Vector3::z()).angle(&(b.rotation * Vector3::z())),
        Alternatives::Fold(_) => {
            let of = |by| {
                a.rotation
                    .angle_to(&(b.rotation * UnitQuaternion::from_axis_angle(&Vector3::z_axis(), by)))
            };
            symmetry.angles().map(of).fold(f64::INFINITY, f64::min)
        }
    }
}

impl Sampler {
    /// A sampler for demonstrations that each have frames before the grasp and frames that hold the object.
    /// `symmetry` is that of the object, for the distance of two anchors.
    pub fn new(demos: Vec<TrainingDemo>, config: &EncoderConfig, symmetry: Alternatives) -> Self {
        let radius = config.radius;
        let same = |a: &Isometry3<f64>, b: &Isometry3<f64>| {
            let difference: Vector3<f64> = a.translation.vector - b.translation.vector;
            difference.norm() < radius && angle(a, b, symmetry) < SAME_ROTATION
        };
        let near = (0..demos.len())
            .map(|i| {
                (0..demos.len())
                    .filter(|&j| j != i && same(&demos[i].anchor, &demos[j].anchor))
                    .collect()
            })
            .collect();
        Self {
            demos,
            near,
            seed: config.seed,
            groups: config.batch / GROUP,
            held: config.held_images,
            brightness: config.brightness,
        }
    }

    /// The batch of a step; epoch and step are counted from 0.
    pub fn batch(&self, epoch: u32, step: u32) -> Batch {
        let mut rng = Pcg64::new(
            u128::from(self.seed) << 64 | u128::from(epoch) << 32 | u128::from(step),
            0x0a02_bdbf_7bb3_c0a7_ac28_fa16_a64a_bf96,
        );
        let mut samples = Vec::with_capacity(self.groups * GROUP);
        let mut near = Vec::with_capacity(self.groups);
        for _ in 0..self.groups {
            let first = below(&mut rng, self.demos.len());
            let others = &self.near[first];
            near.push(!others.is_empty());
            let second = match others.len() {
                0 => first,
                n => others[below(&mut rng, n)],
            };
            for demo in [&self.demos[first], &self.demos[second]] {
                let mut sample = |frames: &[u32], target: &dyn Fn(usize) -> Isometry3<f64>| {
                    let frame = frames[below(&mut rng, frames.len())];
                    let offsets = SIDE - CROP + 1;
                    let crop = [below(&mut rng, offsets) as u8, below(&mut rng, offsets) as u8];
                    let light = if self.brightness > 0.0 {
                        let change = |rng: &mut Pcg64| (self.brightness * normal(rng)) as f32;
                        [1.0 + change(&mut rng), change(&mut rng)]
                    } else {
                        AS_RECORDED
                    };
                    samples.push(Sample {
                        image: demo.first + u64::from(frame),
                        crop,
                        light,
                        target: target(frame as usize),
                    });
                };
                for _ in 0..PER_DEMO - self.held {
                    sample(&demo.before, &|_| demo.anchor);
                }
                for _ in 0..self.held {
                    sample(&demo.held, &|frame| demo.eef[frame]);
                }
            }
        }
        Batch { samples, near }
    }

    /// The demonstrations.
    pub(crate) fn demos(&self) -> &[TrainingDemo] {
        &self.demos
    }

    /// The anchors of the demonstrations, around which the initial estimates are distributed.
    pub fn anchors(&self) -> Vec<Isometry3<f64>> {
        self.demos.iter().map(|demo| demo.anchor).collect()
    }

    /// Fraction of the demonstrations that have another one with a nearby anchor.
    pub fn with_neighbours(&self) -> f64 {
        self.near.iter().filter(|others| !others.is_empty()).count() as f64 / self.demos.len().max(1) as f64
    }

    /// Number of images in the training set.
    pub fn images(&self) -> usize {
        self.demos.iter().map(|demo| demo.before.len() + demo.held.len()).sum()
    }
}
