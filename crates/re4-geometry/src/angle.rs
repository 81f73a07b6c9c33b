//! Angles on the circle, in radians.

use std::f64::consts::{PI, TAU};

/// Wraps an angle into `[0, 2π)`, the range in which Push-T stores block angles.
pub fn wrap_to_two_pi(angle: f64) -> f64 {
    let wrapped = angle.rem_euclid(TAU);
    // `rem_euclid` of a tiny negative number rounds up to exactly 2π.
    if wrapped >= TAU { 0.0 } else { wrapped }
}

/// Wraps an angle into `[-π, π)`.
pub fn wrap_to_pi(angle: f64) -> f64 {
    wrap_to_two_pi(angle + PI) - PI
}

/// Returns the signed angle in `[-π, π)` of the shortest rotation from `from` to `to`.
pub fn signed_difference(from: f64, to: f64) -> f64 {
    wrap_to_pi(to - from)
}

/// Distance between two values on a circle of circumference `period`; at most half the circumference.
pub fn periodic_distance(a: f64, b: f64, period: f64) -> f64 {
    let d = (a - b).rem_euclid(period);
    d.min(period - d)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn wrapping_keeps_the_direction(a in -1e3..1e3f64) {
            for w in [wrap_to_two_pi(a), wrap_to_pi(a)] {
                prop_assert!((w.sin() - a.sin()).abs() < 1e-9);
                prop_assert!((w.cos() - a.cos()).abs() < 1e-9);
            }
            prop_assert!((0.0..TAU).contains(&wrap_to_two_pi(a)));
            prop_assert!((-PI..PI).contains(&wrap_to_pi(a)));
        }

        #[test]
        fn periodic_distance_is_a_metric_on_the_circle(a in -50.0..50.0f64, b in -50.0..50.0f64, c in -50.0..50.0f64) {
            let d = |x, y| periodic_distance(x, y, TAU);
            prop_assert!((d(a, b) - d(b, a)).abs() < 1e-9);
            prop_assert!(d(a, c) <= d(a, b) + d(b, c) + 1e-9);
            prop_assert!((d(a, b) - signed_difference(a, b).abs()).abs() < 1e-9);
        }
    }

    #[test]
    fn angles_on_both_sides_of_zero_are_close() {
        assert!(periodic_distance(0.01, TAU - 0.01, TAU) < 0.0201);
        assert_eq!(wrap_to_two_pi(-1e-300), 0.0);
    }
}
