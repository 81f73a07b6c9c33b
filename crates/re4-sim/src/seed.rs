//! Scenes from seeds, bit-identical to those that numpy's generators give.
//!
//! Push-T programs use two generators: `diffusion_policy` samples from numpy's legacy `RandomState` (MT19937), gym-pusht
//! from `Generator(PCG64(SeedSequence(seed)))`. The algorithms are public: Matsumoto and Nishimura 1998 (MT19937),
//! Marsaglia's polar method for normal numbers, O'Neill 2014 (PCG XSL RR 128/64) and her `seed_seq` replacement that numpy's
//! `SeedSequence` follows, Lemire 2019 for bounded integers.

use std::f64::consts::PI;

use rand_pcg::Pcg64;
use rand_pcg::rand_core::Rng;
use re4_geometry::{Point2, Pose2};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::Scene;
use crate::random_state::RandomState;

/// The program whose seeding is reproduced.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum SeedScheme {
    /// `diffusion_policy`: numpy `RandomState(seed)`. Demonstration `i` of the Push-T dataset starts from seed `i`
    /// (0 to 205); the benchmark's test scenes are the seeds from 100000.
    DiffusionPolicy,
    /// gym-pusht: numpy `Generator(PCG64(SeedSequence(seed)))`, as gymnasium seeds its environments.
    GymPusht,
}

/// The scene that a program requests for `seed`: agent in `[50, 450)`², block in `[100, 400)`², all whole pixels.
///
/// The block's angle is uniform in `[-π, π)` for gym-pusht and normal, `N(-π, (2π)²)`, for `diffusion_policy`. This is the
/// *requested* scene: the block arrives at another position under [`ResetOrder::Legacy`](crate::ResetOrder::Legacy).
pub fn scene_from_seed(scheme: SeedScheme, seed: u32) -> Scene {
    match scheme {
        SeedScheme::DiffusionPolicy => {
            let mut generator = RandomState::new(seed);
            let (agent, block) = positions(|low, high| generator.integer(low, high));
            let theta = generator.standard_normal() * 2.0 * PI - PI;
            scene(agent, block, theta)
        }
        SeedScheme::GymPusht => {
            let mut generator = Generator::new(seed);
            let (agent, block) = positions(|low, high| generator.integer(low, high));
            // numpy's `uniform(low, high)` is `low + (high - low) * u`.
            let theta = -PI + (PI - -PI) * generator.unit();
            scene(agent, block, theta)
        }
    }
}

fn positions(mut integer: impl FnMut(u32, u32) -> u32) -> (Point2, Point2) {
    let mut point = |low, high| {
        let x = f64::from(integer(low, high));
        Point2::new(x, f64::from(integer(low, high)))
    };
    (point(50, 450), point(100, 400))
}

fn scene(agent: Point2, block: Point2, theta: f64) -> Scene {
    Scene {
        agent,
        block: Pose2::new(block.x, block.y, theta),
    }
}

/// The part of numpy's `Generator(PCG64(SeedSequence(seed)))` that scenes need.
struct Generator {
    bits: Pcg64,
    /// The upper half of a 64-bit word, kept for the next 32-bit word as numpy keeps it.
    kept_half: Option<u32>,
}

impl Generator {
    fn new(seed: u32) -> Self {
        let words = seed_sequence(seed);
        let wide = |high: u64, low: u64| (u128::from(high) << 64) | u128::from(low);
        Self {
            bits: Pcg64::new(wide(words[0], words[1]), wide(words[2], words[3])),
            kept_half: None,
        }
    }

    fn next_u32(&mut self) -> u32 {
        if let Some(half) = self.kept_half.take() {
            return half;
        }
        let word = self.bits.next_u64();
        self.kept_half = Some((word >> 32) as u32);
        word as u32
    }

    /// `integers(low, high)`: Lemire's multiplication, with rejection of the few products that would bias the result.
    fn integer(&mut self, low: u32, high: u32) -> u32 {
        let count = high - low;
        let threshold = count.wrapping_neg() % count;
        loop {
            let product = u64::from(self.next_u32()) * u64::from(count);
            if product as u32 >= threshold {
                return low + (product >> 32) as u32;
            }
        }
    }

    /// A number in `[0, 1)` with 53 random bits. It does not use a kept half word, as in numpy.
    fn unit(&mut self) -> f64 {
        (self.bits.next_u64() >> 11) as f64 / 9_007_199_254_740_992.0
    }
}

/// numpy's `SeedSequence(seed).generate_state(4, uint64)`. The constants are those of numpy's `bit_generator.pyx`: `INIT_A`,
/// `MULT_A`, `MIX_MULT_L`, `MIX_MULT_R`, `INIT_B` and `MULT_B`, in this order.
fn seed_sequence(seed: u32) -> [u64; 4] {
    let mut constant = 0x43b0_d7e5_u32;
    let mut hash = |value: u32| {
        let value = value ^ constant;
        constant = constant.wrapping_mul(0x931e_8875);
        let value = value.wrapping_mul(constant);
        value ^ (value >> 16)
    };
    let mut pool = [seed, 0, 0, 0].map(&mut hash);
    for source in 0..4 {
        for target in (0..4).filter(|&target| target != source) {
            let mixed = 0xca01_f9dd_u32
                .wrapping_mul(pool[target])
                .wrapping_sub(0x4973_f715_u32.wrapping_mul(hash(pool[source])));
            pool[target] = mixed ^ (mixed >> 16);
        }
    }
    let mut constant = 0x8b51_f9dd_u32;
    let mut words = pool.into_iter().cycle().map(|value| {
        let value = value ^ constant;
        constant = constant.wrapping_mul(0x58f3_8ded);
        let value = value.wrapping_mul(constant);
        u64::from(value ^ (value >> 16))
    });
    std::array::from_fn(|_| {
        let low = words.next().unwrap_or(0);
        let high = words.next().unwrap_or(0);
        (high << 32) | low
    })
}
