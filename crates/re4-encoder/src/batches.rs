//! Which images a step of the optimiser sees.
//!
//! A batch has groups of two demonstrations. The first demonstration of a group is drawn among all that are trained on; the
//! second among those whose anchor is nearer than the radius and turned by less than [`SAME_TURN`], and is the first one again
//! where there is none. Of each, two frames before the grasp and two that hold the object are drawn, independently and with
//! equal chances, and every image has its own crop. Every draw depends on seed, epoch and step alone, so a training that
//! goes on after a checkpoint draws the same.

use nalgebra::{Isometry3, Vector3};
use rand_pcg::Pcg64;
use rand_pcg::rand_core::Rng as _;

use crate::loss::{BEFORE, GROUP, HELD};
use crate::{CROP, SIDE};

/// Anchors that are turned by more than this against each other, in rad, are not one place: the gripper holds another way.
const SAME_TURN: f64 = 0.3;

/// What training knows of a demonstration. There is no recorded object pose in it.
#[derive(Debug, Clone)]
pub struct TrainingDemo {
    /// Number of its first image in the file of images.
    pub first: u64,
    /// Frames before the grasp, whose images show the object at the anchor.
    pub before: Vec<u32>,
    /// Frames that hold the object.
    pub held: Vec<u32>,
    /// End effector's pose at the grasp.
    pub anchor: Isometry3<f64>,
    /// End effector's pose in every frame.
    pub eef: Vec<Isometry3<f64>>,
}

/// An image of a batch.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sample {
    /// Number of the image.
    pub image: u64,
    /// First row and column of the crop.
    pub crop: [u8; 2],
    /// What the estimate should be.
    pub target: Isometry3<f64>,
}

/// The images of a step.
#[derive(Debug, Clone)]
pub struct Batch {
    /// In groups of [`GROUP`].
    pub samples: Vec<Sample>,
    /// For each group, whether its two anchors belong to one place.
    pub near: Vec<bool>,
}

/// Draws batches.
#[derive(Debug)]
pub struct Sampler {
    demos: Vec<TrainingDemo>,
    near: Vec<Vec<usize>>,
    seed: u64,
    groups: usize,
}

/// A whole number below `bound`, which is at least 1.
fn below(rng: &mut Pcg64, bound: usize) -> usize {
    // Of 64 bits times the bound, the upper half: even up to bound / 2^64.
    ((u128::from(rng.next_u64()) * bound as u128) >> 64) as usize
}

impl Sampler {
    /// Every demonstration needs frames of both kinds.
    pub fn new(demos: Vec<TrainingDemo>, radius: f64, seed: u64, batch: usize) -> Self {
        let same = |a: &Isometry3<f64>, b: &Isometry3<f64>| {
            let way: Vector3<f64> = a.translation.vector - b.translation.vector;
            way.norm() < radius && a.rotation.angle_to(&b.rotation) < SAME_TURN
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
            seed,
            groups: batch / GROUP,
        }
    }

    /// The batch of a step, both counted from 0.
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
                let mut draw = |frames: &[u32], target: &dyn Fn(usize) -> Isometry3<f64>| {
                    let frame = frames[below(&mut rng, frames.len())];
                    let free = SIDE - CROP + 1;
                    let crop = [below(&mut rng, free) as u8, below(&mut rng, free) as u8];
                    samples.push(Sample {
                        image: demo.first + u64::from(frame),
                        crop,
                        target: target(frame as usize),
                    });
                };
                for _ in 0..BEFORE {
                    draw(&demo.before, &|_| demo.anchor);
                }
                for _ in 0..HELD {
                    draw(&demo.held, &|frame| demo.eef[frame]);
                }
            }
        }
        Batch { samples, near }
    }

    /// The anchors: where estimates start from.
    pub fn anchors(&self) -> Vec<Isometry3<f64>> {
        self.demos.iter().map(|demo| demo.anchor).collect()
    }

    /// Fraction of demonstrations that have another one near.
    pub fn with_neighbours(&self) -> f64 {
        self.near.iter().filter(|others| !others.is_empty()).count() as f64 / self.demos.len().max(1) as f64
    }

    /// How many images there are to draw from.
    pub fn images(&self) -> usize {
        self.demos.iter().map(|demo| demo.before.len() + demo.held.len()).sum()
    }
}
