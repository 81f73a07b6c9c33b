//! The pace of a demonstration: what counts as idle, and how rotations compare with translations.

use nalgebra::Isometry3;

/// Length of the lever that converts a rotation to a distance, in metres per rad: the ratio of the policy's scales for translations
/// and rotations (0.1 m and 1 rad).
pub const LEVER: f64 = 0.1;

/// Fraction of the usual speed below which a step is idle. Studies of reaching use this fraction of the peak speed to determine the
/// start and the end of a movement (Balasubramanian et al. 2012).
pub const IDLE_FRACTION: f64 = 0.05;

/// Distance between two poses: that between their origins, plus the angle between them times [`LEVER`].
pub fn reach(a: &Isometry3<f64>, b: &Isometry3<f64>) -> f64 {
    (b.translation.vector - a.translation.vector).norm() + LEVER * a.rotation.angle_to(&b.rotation)
}

/// The usual fast step: the 95th percentile of the steps above 0, so that one jump of the recorder does not count. 0 if there are
/// none.
pub fn fast_step(steps: impl IntoIterator<Item = f64>) -> f64 {
    let mut moving: Vec<f64> = steps.into_iter().filter(|&step| step > 0.0).collect();
    moving.sort_by(f64::total_cmp);
    let at = (0.95 * moving.len() as f64) as usize;
    moving.get(at).or(moving.last()).copied().unwrap_or(0.0)
}
