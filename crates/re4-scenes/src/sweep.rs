//! The grid of poses and their distances to the demonstrations.

use std::f64::consts::TAU;

use rayon::prelude::*;
use re4_episode::Mode;
use re4_geometry::{Point2, Pose2, periodic_distance, wrap_to_two_pi};
use re4_index::{IndexError, IndexedFrame, Query, Range, RetrievalIndex};
use re4_sim::depth_in_walls;

use crate::{ObjectFrame, ScenesConfig, ScenesError};

/// Evenly spaced values of one dimension of the grid.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Axis {
    first: f64,
    step: f64,
}

impl Axis {
    /// `count` values (two or more) over a range widened by `padding`, including both ends.
    fn line(range: Range, padding: f64, count: u32) -> Self {
        let (low, high) = (range.minimum - padding, range.maximum + padding);
        Self {
            first: low,
            step: (high - low) / f64::from(count - 1),
        }
    }

    /// Like [`Axis::line`], for angles: if the widened range covers the full circle, `count` values over one circle without
    /// duplicates.
    fn circle(range: Range, padding: f64, count: u32) -> Self {
        let line = Self::line(range, padding, count);
        if range.maximum - range.minimum + 2.0 * padding < TAU {
            return line;
        }
        Self {
            step: TAU / f64::from(count),
            ..line
        }
    }

    fn value(self, i: u32) -> f64 {
        self.first + self.step * f64::from(i)
    }
}

/// A grid point, with the normalised distance of its pose to the nearest frame of a demonstration. Grid points are numbered
/// with x outermost and theta innermost.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Candidate {
    pub(crate) index: u32,
    pub(crate) rho: f64,
}

/// The grid over the poses of the demonstrations.
pub(crate) struct Sweep {
    index: RetrievalIndex,
    axes: [Axis; 3],
    count: u32,
    inside_walls: bool,
}

impl Sweep {
    /// Builds the grid and the index of the frames.
    pub(crate) fn new(frames: &[ObjectFrame], config: &ScenesConfig) -> Result<Self, ScenesError> {
        // All frames get the same end effector, so Retrieve compares only the object's poses.
        let indexed = frames.iter().map(|frame| IndexedFrame {
            episode: frame.episode,
            frame: frame.frame,
            mode: Mode::Transit,
            eef: Point2::zeros(),
            object: frame.object,
        });
        let index = RetrievalIndex::build(indexed.collect(), config.angle)?;
        let [_, _, x, y, theta] = index.normalization().ranges;
        let axes = [
            Axis::line(x, config.padding_position, config.grid),
            Axis::line(y, config.padding_position, config.grid),
            Axis::circle(theta, config.padding_angle, config.grid),
        ];
        Ok(Self {
            index,
            axes,
            count: config.grid,
            inside_walls: config.inside_walls,
        })
    }

    /// The pose of a grid point.
    pub(crate) fn pose(&self, index: u32) -> Pose2 {
        let [x, y, theta] = self.axes;
        let n = self.count;
        Pose2::new(
            x.value(index / n / n),
            y.value(index / n % n),
            wrap_to_two_pi(theta.value(index % n)),
        )
    }

    /// Distance of a pose to the nearest frame, and that frame: demonstration and frame number. Of equally near frames, the
    /// first one is returned.
    pub(crate) fn nearest(&self, pose: Pose2) -> Result<(f64, u32, u32), ScenesError> {
        let query = Query {
            mode: Mode::Transit,
            eef: Point2::zeros(),
            object: pose,
        };
        // With zero tolerance, Retrieve's first stage admits only the nearest frame of each demonstration.
        let found = self.index.retrieve(&query, 0.0)?.ok_or(IndexError::Empty)?;
        Ok((found.d_o, found.episode, found.frame))
    }

    /// Distance between two poses in normalised coordinates, for the separation of chosen poses. It uses the shortest angular
    /// difference, whatever the metric of the distance to the demonstrations, because 0 and 2π are the same pose.
    pub(crate) fn distance(&self, a: Pose2, b: Pose2) -> f64 {
        let [_, _, x, y, theta] = self.index.normalization().ranges.map(Range::span);
        let (dx, dy) = ((a.x - b.x) / x, (a.y - b.y) / y);
        let rotation = periodic_distance(a.theta, b.theta, TAU) / theta;
        (dx * dx + dy * dy + rotation * rotation).sqrt()
    }

    /// All grid points with their distances, in grid order; without those that reach into a wall if `inside_walls` is set.
    /// `keep_going` is called once per column of angles; the sweep stops when it returns `false`.
    pub(crate) fn candidates(&self, keep_going: &(dyn Fn() -> bool + Sync)) -> Result<Vec<Candidate>, ScenesError> {
        let n = self.count;
        let columns = (0..n * n).into_par_iter().map(|column| {
            if !keep_going() {
                return Err(ScenesError::Interrupted);
            }
            let poses = (column * n..(column + 1) * n).map(|index| (index, self.pose(index)));
            poses
                .filter(|(_, pose)| !self.inside_walls || is_inside(*pose))
                .map(|(index, pose)| self.nearest(pose).map(|(rho, ..)| Candidate { index, rho }))
                .collect::<Result<Vec<_>, _>>()
        });
        let columns = columns.collect::<Result<Vec<_>, _>>()?;
        Ok(columns.into_iter().flatten().collect())
    }
}

/// Whether no corner of the block reaches into a wall.
fn is_inside(pose: Pose2) -> bool {
    depth_in_walls(pose) == 0.0
}

#[cfg(test)]
mod tests {
    use super::*;
    use re4_sim::WALL_FACES;

    const fn range(minimum: f64, maximum: f64) -> Range {
        Range { minimum, maximum }
    }

    fn values(axis: Axis, count: u32) -> Vec<f64> {
        (0..count).map(|i| axis.value(i)).collect()
    }

    #[test]
    fn a_line_includes_both_padded_ends() {
        assert_eq!(
            values(Axis::line(range(100.0, 400.0), 20.0, 5), 5),
            [80.0, 165.0, 250.0, 335.0, 420.0]
        );
        // An angular range of less than the full circle is a line too.
        let arc = values(Axis::circle(range(1.0, 2.0), 0.5, 3), 3);
        assert_eq!(arc, [0.5, 1.5, 2.5]);
    }

    #[test]
    fn a_circle_has_no_duplicate_angles() {
        let circle = values(Axis::circle(range(0.0, TAU - 0.01), 0.15, 50), 50);
        for (i, a) in circle.iter().enumerate() {
            for b in &circle[..i] {
                assert!(periodic_distance(*a, *b, TAU) > TAU / 50.0 - 1e-12);
            }
        }
        assert_eq!(circle[0], -0.15);
    }

    #[test]
    fn a_block_is_inside_until_a_corner_reaches_into_a_wall() {
        // At angle 0 the bar extends from x - 60 to x + 60, and the stem down to y + 120.
        let [low, high] = WALL_FACES;
        assert!(is_inside(Pose2::new(low + 60.0, low, 0.0)));
        assert!(!is_inside(Pose2::new(low + 59.9, low, 0.0)));
        assert!(is_inside(Pose2::new(256.0, high - 120.0, 0.0)));
        assert!(!is_inside(Pose2::new(256.0, high - 119.9, 0.0)));
    }
}
