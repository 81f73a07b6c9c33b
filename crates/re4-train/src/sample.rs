//! Random numbers from a seeded generator.
//!
//! burn's own generator is global to the process, so its numbers would depend on other computations of the same process.

use rand_pcg::Pcg64;
use rand_pcg::rand_core::Rng as _;

/// A number of the standard normal distribution (Box-Muller transform).
pub fn normal(rng: &mut Pcg64) -> f64 {
    // 1 - u is in (0, 1], so its logarithm is finite.
    let (log, angle) = ((1.0 - uniform(rng)).ln(), uniform(rng));
    (-2.0 * log).sqrt() * (std::f64::consts::TAU * angle).cos()
}

/// A uniform number in [0, 1).
pub fn uniform(rng: &mut Pcg64) -> f64 {
    (rng.next_u64() >> 11) as f64 / (1_u64 << 53) as f64
}

/// A uniform integer below `bound`, which must be at least 1.
pub fn below(rng: &mut Pcg64, bound: usize) -> usize {
    // The upper half of the product with a 64-bit number: uniform up to a bias of bound / 2^64.
    ((u128::from(rng.next_u64()) * bound as u128) >> 64) as usize
}
