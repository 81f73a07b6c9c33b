//! The reward as a check of the block's poses: LeRobot's Push-T datasets have the coverage of the goal in the next frame, divided by
//! the coverage of a success and at most 1.

use re4_geometry::Pose2;
use re4_sim::{GOAL, SUCCESS_COVERAGE, coverage};

/// Maximum difference between a reward and that of the pose. Where the whole outline of the block (480 px) moves across that of the
/// goal, a displacement of one pixel changes the coverage by 480 / 6300, and the reward by 0.08.
pub(super) const MAX_DIFFERENCE: f64 = 0.08;

/// Which frame a reward belongs to.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Of {
    /// The next one, as the name `next.reward` says.
    Next,
    /// The same one.
    Same,
}

impl Of {
    /// Its name in the table of conventions.
    pub(super) fn name(self) -> &'static str {
        match self {
            Self::Next => "coverage_next_frame",
            Self::Same => "coverage_same_frame",
        }
    }
}

/// Largest differences between the rewards of an episode and those of its poses, if they belong to the next or to the same frame. The
/// last frame has no next one and is left out. NaN for a reward that is not a number.
pub(super) fn differences(poses: &[Pose2], rewards: &[f64]) -> [f64; 2] {
    let expected: Vec<f64> = poses
        .iter()
        .map(|pose| (coverage(*pose, GOAL) / SUCCESS_COVERAGE).min(1.0))
        .collect();
    let rewards = rewards.get(..poses.len().saturating_sub(1)).unwrap_or_default();
    [1, 0].map(|later| {
        let differences = rewards
            .iter()
            .zip(expected.iter().skip(later))
            .map(|(a, b)| (a - b).abs());
        differences.fold(
            0.0,
            |worst: f64, next| {
                if next > worst || next.is_nan() { next } else { worst }
            },
        )
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rewards_belong_to_the_next_frame() {
        let poses: Vec<Pose2> = (0..30)
            .map(|i| Pose2::new(256.0 + 4.0 * f64::from(i), 256.0, GOAL.theta))
            .collect();
        let of = |pose: &Pose2| (coverage(*pose, GOAL) / 0.95).min(1.0);
        let mut rewards: Vec<f64> = poses.iter().skip(1).map(of).collect();
        rewards.push(rewards[28]);
        let [next, same] = differences(&poses, &rewards);
        assert_eq!(next, 0.0);
        assert!(same > MAX_DIFFERENCE, "{same}");
        rewards[3] = f64::NAN;
        assert!(differences(&poses, &rewards)[0].is_nan());
        assert_eq!(differences(&[], &[]), [0.0, 0.0]);
    }

    #[test]
    fn a_pixel_changes_a_reward_by_less_than_the_limit() {
        for angle in 0..8 {
            let theta = GOAL.theta + f64::from(angle);
            let direction = f64::from(angle) * 0.7;
            for at in 0..60 {
                let of = |step: f64| {
                    let at = f64::from(at) + step;
                    (coverage(
                        Pose2::new(256.0 + at * direction.cos(), 256.0 + at * direction.sin(), theta),
                        GOAL,
                    ) / 0.95)
                        .min(1.0)
                };
                assert!((of(1.0) - of(0.0)).abs() < MAX_DIFFERENCE);
            }
        }
    }
}
