//! The grid, and how far each of its poses is from the demonstrations.

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
    /// `count` values (two or more) over a range widened by `padding`, both of its ends among them.
    fn line(range: Range, padding: f64, count: u32) -> Self {
        let (low, high) = (range.minimum - padding, range.maximum + padding);
        Self {
            first: low,
            step: (high - low) / f64::from(count - 1),
        }
    }

    /// As [`Axis::line`], for angles: where the widened range is a full turn or more, `count` values once round the circle,
    /// none of them twice.
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

/// A place of the grid and the distance of its pose to the nearest frame of a demonstration, normalised. Places are counted
/// with x outermost and theta innermost.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Candidate {
    pub(crate) place: u32,
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
    /// Lays the grid.
    pub(crate) fn new(frames: &[ObjectFrame], config: &ScenesConfig) -> Result<Self, ScenesError> {
        // All frames get the same end effector: Retrieve then decides by the object's pose alone.
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

    /// The pose at a place of the grid.
    pub(crate) fn pose(&self, place: u32) -> Pose2 {
        let [x, y, theta] = self.axes;
        let n = self.count;
        Pose2::new(
            x.value(place / n / n),
            y.value(place / n % n),
            wrap_to_two_pi(theta.value(place % n)),
        )
    }

    /// Distance of a pose to the nearest frame, and that frame: demonstration and number. Of frames that are equally near it
    /// is the first.
    pub(crate) fn nearest(&self, pose: Pose2) -> Result<(f64, u32, u32), ScenesError> {
        let query = Query {
            mode: Mode::Transit,
            eef: Point2::zeros(),
            object: pose,
        };
        // With no tolerance, Retrieve's first stage admits the nearest frame of each demonstration alone.
        let found = self.index.retrieve(&query, 0.0)?.ok_or(IndexError::Empty)?;
        Ok((found.d_o, found.episode, found.frame))
    }

    /// Distance between two poses in normalised coordinates, by which chosen ones are kept apart. Angles are taken the short
    /// way round, however the distance to the demonstrations takes them: 0 and 2π are one pose.
    pub(crate) fn apart(&self, a: Pose2, b: Pose2) -> f64 {
        let [_, _, x, y, theta] = self.index.normalization().ranges.map(Range::span);
        let (dx, dy) = ((a.x - b.x) / x, (a.y - b.y) / y);
        let turn = periodic_distance(a.theta, b.theta, TAU) / theta;
        (dx * dx + dy * dy + turn * turn).sqrt()
    }

    /// Every place of the grid with its distance, in the order of the grid; without those that reach into a wall, if so
    /// asked. `going` is called once a column of angles and says whether to go on.
    pub(crate) fn candidates(&self, going: &(dyn Fn() -> bool + Sync)) -> Result<Vec<Candidate>, ScenesError> {
        let n = self.count;
        let columns = (0..n * n).into_par_iter().map(|column| {
            if !going() {
                return Err(ScenesError::Interrupted);
            }
            let places = (column * n..(column + 1) * n).map(|place| (place, self.pose(place)));
            places
                .filter(|(_, pose)| !self.inside_walls || is_inside(*pose))
                .map(|(place, pose)| self.nearest(pose).map(|(rho, ..)| Candidate { place, rho }))
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
    fn a_line_has_both_of_its_padded_ends() {
        assert_eq!(
            values(Axis::line(range(100.0, 400.0), 20.0, 5), 5),
            [80.0, 165.0, 250.0, 335.0, 420.0]
        );
        // Angles that do not go round are a line as well.
        let arc = values(Axis::circle(range(1.0, 2.0), 0.5, 3), 3);
        assert_eq!(arc, [0.5, 1.5, 2.5]);
    }

    #[test]
    fn a_circle_has_no_angle_twice() {
        let turn = values(Axis::circle(range(0.0, TAU - 0.01), 0.15, 50), 50);
        for (i, a) in turn.iter().enumerate() {
            for b in &turn[..i] {
                assert!(periodic_distance(*a, *b, TAU) > TAU / 50.0 - 1e-12);
            }
        }
        assert_eq!(turn[0], -0.15);
    }

    #[test]
    fn a_block_at_a_wall_is_inside_until_a_corner_is_in_the_wall() {
        // Angle 0: the bar reaches from x - 60 to x + 60, the stem down to y + 120.
        let [low, high] = WALL_FACES;
        assert!(is_inside(Pose2::new(low + 60.0, low, 0.0)));
        assert!(!is_inside(Pose2::new(low + 59.9, low, 0.0)));
        assert!(is_inside(Pose2::new(256.0, high - 120.0, 0.0)));
        assert!(!is_inside(Pose2::new(256.0, high - 119.9, 0.0)));
    }
}
