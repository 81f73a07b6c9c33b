//! Copies among demonstrations: identical ones by hash, nearly identical ones by the distance between their paths.
//!
//! The path of a demonstration is resampled to a fixed number of points at equal fractions of its duration, so that copies at
//! another speed have the same points. The mean of a coordinate over all points differs by no more than the root mean square
//! difference of that coordinate, so copies are in the same cell of a grid over such means, or in neighbouring cells. Only
//! those are compared, and the cost per demonstration does not grow with their number.

use std::collections::HashMap;

use nalgebra::Vector3;

use crate::checks::{SAMPLE, find};
use crate::common::Sink;
use crate::finding::Finding;
use crate::observed::CopyRow;
use crate::thresholds::{Observation, Thresholds};
use re4_task::Domain;

/// Number of points of a resampled path.
const POINTS: usize = 24;

/// Coordinates per point: three of the end effector and three of the object.
const COORDINATES: usize = 6;

/// Coordinates whose means form the cells of the grid: x and y of end effector and object.
const GRID: [usize; 4] = [0, 1, 3, 4];

/// A path of end effector and object, resampled in time.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Path(Vec<f32>);

impl Path {
    /// Resamples positions of end effector and object.
    pub(crate) fn new(positions: impl ExactSizeIterator<Item = (Vector3<f64>, Vector3<f64>)>) -> Self {
        let positions: Vec<_> = positions.collect();
        let Some(last) = positions.len().checked_sub(1) else {
            return Self::default();
        };
        let sample = |point: usize| {
            let at = last as f64 * point as f64 / (POINTS - 1) as f64;
            let before = (at.floor() as usize).min(last);
            let (low, high) = (positions[before], positions[(before + 1).min(last)]);
            let part = at - before as f64;
            let mix = |a: Vector3<f64>, b: Vector3<f64>| (a + part * (b - a)).map(|value| value as f32);
            let (eef, object) = (mix(low.0, high.0), mix(low.1, high.1));
            [eef.x, eef.y, eef.z, object.x, object.y, object.z]
        };
        Self((0..POINTS).flat_map(sample).collect())
    }

    /// The coordinates of all points.
    pub(crate) fn coordinates(&self) -> &[f32] {
        &self.0
    }

    /// The path with these coordinates.
    pub(crate) fn of_coordinates(coordinates: Vec<f32>) -> Self {
        Self(coordinates)
    }

    /// The root mean square distance between the points of two paths, or `None` if it is at least `limit`.
    fn distance(&self, other: &Self, limit: f64) -> Option<f64> {
        let most = limit * limit * (2 * POINTS) as f64;
        let mut sum = 0.0;
        for (own, other) in self.0.chunks_exact(COORDINATES).zip(other.0.chunks_exact(COORDINATES)) {
            let squares = own.iter().zip(other).map(|(a, b)| f64::from(a - b).powi(2));
            sum += squares.sum::<f64>();
            if sum >= most {
                return None;
            }
        }
        Some((sum / (2 * POINTS) as f64).sqrt())
    }

    fn means(&self) -> [f64; COORDINATES] {
        std::array::from_fn(|coordinate| self.mean(coordinate))
    }

    fn mean(&self, coordinate: usize) -> f64 {
        let values = self.0.iter().skip(coordinate).step_by(COORDINATES);
        values.map(|value| f64::from(*value)).sum::<f64>() / POINTS as f64
    }
}

/// Distances of a sample of demonstrations to their nearest other one that is not identical.
#[derive(Debug)]
pub struct Neighbours {
    /// Every how many-th demonstration is in the sample.
    step: usize,
    seen: usize,
    sample: Vec<Sampled>,
}

/// A demonstration of the sample.
#[derive(Debug)]
struct Sampled {
    episode: u32,
    path: Path,
    means: [f64; COORDINATES],
    /// Distance to the nearest other one so far.
    nearest: f64,
}

impl Neighbours {
    /// An empty sample of so many demonstrations.
    pub fn new(count: usize) -> Self {
        Self {
            step: count.div_ceil(SAMPLE).max(1),
            seen: 0,
            sample: Vec::new(),
        }
    }

    /// Takes the next demonstration into the sample if it is its place in the order that says so.
    pub fn sample(&mut self, own: &Observation) {
        if self.seen.is_multiple_of(self.step) {
            self.sample.push(Sampled {
                episode: own.episode,
                path: own.path.clone(),
                means: own.path.means(),
                nearest: f64::INFINITY,
            });
        }
        self.seen += 1;
    }

    /// Compares all of the sample with a demonstration.
    pub fn compare(&mut self, other: &Observation) {
        let means = other.path.means();
        for own in self.sample.iter_mut().filter(|own| own.episode != other.episode) {
            // The mean of squares is at least the square of the mean. The margin is for rounding.
            let apart = own.means.iter().zip(means).map(|(a, b)| (a - b).powi(2));
            let bound = (apart.sum::<f64>() / 2.0).sqrt() * (1.0 - 1e-6) - 1e-9;
            if bound < own.nearest
                && let Some(distance) = own.path.distance(&other.path, own.nearest)
                && distance > 0.0
            {
                own.nearest = distance;
            }
        }
    }

    /// The distances.
    pub(crate) fn distances(self) -> Vec<f64> {
        let distances = self.sample.into_iter().map(|own| own.nearest);
        distances.filter(|distance| distance.is_finite()).collect()
    }
}

/// Reports demonstrations that are identical to an earlier one, nearly the same as an earlier one, or have the same actions as an
/// earlier one.
pub fn audit_copies(observations: &[Observation], thresholds: &Thresholds) -> Vec<Finding> {
    let mut copies = Copies::new(thresholds);
    let found = |own: &Observation| {
        let copy = copies.add(own)?;
        copy.finding(&own.demo, own.frames, thresholds)
    };
    observations.iter().filter_map(found).collect()
}

/// Demonstrations that are added one at a time and compared with the earlier ones. About 900 bytes are kept of each.
pub struct Copies {
    recordings: HashMap<[u8; 32], usize>,
    actions: HashMap<[u8; 32], usize>,
    grid: Grid,
    /// Number, name and number of frames of all demonstrations.
    earlier: Vec<(u32, Box<str>, u32)>,
}

impl Copies {
    /// No demonstrations.
    pub fn new(thresholds: &Thresholds) -> Self {
        Self {
            recordings: HashMap::new(),
            actions: HashMap::new(),
            grid: Grid::new(thresholds.over("near_duplicate")),
            earlier: Vec::new(),
        }
    }

    /// Compares a demonstration with the earlier ones.
    pub fn add(&mut self, own: &Observation) -> Option<CopyRow> {
        let place = self.earlier.len();
        let found = if let Some(&other) = self.recordings.get(&own.recording) {
            Some(("duplicate", other, None))
        } else if let Some((other, distance)) = self.grid.nearest(&own.path) {
            Some(("near_duplicate", other, Some(distance)))
        } else {
            self.actions
                .get(&own.actions)
                .map(|&other| ("same_actions", other, None))
        };
        self.recordings.entry(own.recording).or_insert(place);
        self.actions.entry(own.actions).or_insert(place);
        // Of many copies of one demonstration, only the first is compared with later ones.
        if found.is_none_or(|(code, ..)| code == "same_actions") {
            self.grid.insert(place, &own.path);
        }
        self.earlier.push((own.episode, own.demo.as_str().into(), own.frames));
        let (code, other, distance) = found?;
        let (other, other_demo, other_frames) = self.earlier.get(other)?;
        Some(CopyRow {
            episode: own.episode,
            code: code.into(),
            distance,
            other: *other,
            other_demo: other_demo.to_string(),
            other_frames: *other_frames,
        })
    }
}

impl CopyRow {
    /// The finding about the copy; `demo` and `frames` are its name and its number of frames. `None` if the row names no check of this
    /// build.
    pub fn finding(&self, demo: &str, frames: u32, thresholds: &Thresholds) -> Option<Finding> {
        let code = find(&self.code)?.code;
        let other = &self.other_demo;
        let message = match self.distance {
            Some(distance) => format!(
                "nearly identical to {other}: over {frames} and {} frames, the paths are {} apart",
                self.other_frames,
                match thresholds.domain() {
                    Domain::Plane => format!("{distance:.2} px"),
                    Domain::Arm if !thresholds.made("discontinuity_eef") =>
                        format!("{:.2} % of the range of a joint", 1e2 * distance),
                    Domain::Space | Domain::Arm => format!("{:.2} mm", 1e3 * distance),
                }
            ),
            None if code == "duplicate" => format!("identical to {other}, bit for bit"),
            None => format!("the same actions as {other}, but other states"),
        };
        let mut sink = Sink::new(self.episode, demo, thresholds);
        sink.add(code, 0..frames as usize, self.distance, message);
        sink.link(self.other, other);
        sink.findings.pop()
    }
}

/// Paths by the cell of their means.
struct Grid {
    limit: f64,
    cells: HashMap<[i64; 4], Vec<(usize, Path)>>,
}

impl Grid {
    fn new(limit: f64) -> Self {
        Self {
            limit,
            cells: HashMap::new(),
        }
    }

    fn cell(&self, path: &Path) -> [i64; 4] {
        // The limit is a mean over the points of end effector and object, so one of the two may differ by the root of 2 more.
        let side = self.limit * std::f64::consts::SQRT_2;
        GRID.map(|coordinate| (path.mean(coordinate) / side).floor() as i64)
    }

    fn insert(&mut self, place: usize, path: &Path) {
        if self.limit.is_finite() && self.limit > 0.0 {
            self.cells
                .entry(self.cell(path))
                .or_default()
                .push((place, path.clone()));
        }
    }

    /// The nearest inserted demonstration closer than the limit; the earliest of equally near ones.
    fn nearest(&self, own: &Path) -> Option<(usize, f64)> {
        if !(self.limit.is_finite() && self.limit > 0.0) {
            return None;
        }
        let center = self.cell(own);
        let mut best: Option<(usize, f64)> = None;
        for neighbour in 0..81 {
            let cell = std::array::from_fn(|axis| center[axis] + (neighbour / 3_i64.pow(axis as u32)) % 3 - 1);
            for (place, other) in self.cells.get(&cell).into_iter().flatten() {
                let limit = best.map_or(self.limit, |(_, distance)| distance.next_up());
                if let Some(distance) = own.distance(other, limit)
                    && best.is_none_or(|(earlier, nearest)| (distance, *place) < (nearest, earlier))
                {
                    best = Some((*place, distance));
                }
            }
        }
        best
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn observation(episode: u32, offset: f64) -> Observation {
        // A scene of its own for every tenth of the offset, and a path along it.
        let path = (0..40 + episode as usize).map(|t| {
            let along = t as f64 / (39 + episode as usize) as f64;
            let eef = Vector3::new(offset, 0.3 * along, 0.9 - 0.1 * along);
            (eef, Vector3::new(0.1 + offset, 0.3 * along * along, 0.8))
        });
        let mut hash = [0; 32];
        hash[..4].copy_from_slice(&episode.to_le_bytes());
        Observation {
            episode,
            demo: format!("demo_{episode}"),
            frames: 40 + episode,
            values: Vec::new(),
            last_object: Vector3::zeros(),
            rewarded: None,
            recording: hash,
            actions: hash,
            response: None,
            path: Path::new(path.collect::<Vec<_>>().into_iter()),
        }
    }

    #[test]
    fn copies_at_another_speed_are_found_and_others_are_not() {
        // The fifth one is as the second, 0.4 mm beside it and with more frames.
        let offsets = [0.0, 0.031, 0.058, 0.1, 0.0314, 0.13, 0.17, 0.2, 0.24];
        let all: Vec<Observation> = (0..).zip(offsets).map(|(n, x)| observation(n, x)).collect();
        let thresholds = Thresholds::derive(&all, &crate::AuditConfig::default(), false, 0.01);
        let found: Vec<_> = audit_copies(&all, &thresholds)
            .into_iter()
            .map(|finding| (finding.code, finding.episode, finding.other))
            .collect();
        assert_eq!(found, [("near_duplicate", 4, Some(1))]);
    }

    #[test]
    fn the_grid_finds_what_a_comparison_of_all_pairs_finds() {
        // Offsets of a low-discrepancy sequence: pairs at all distances.
        let all: Vec<Observation> = (0..200_u32)
            .map(|n| observation(n, (f64::from(n) * 0.618_033_988_749) % 1.0 * 0.2))
            .collect();
        for limit in [1e-4, 4e-4, 2e-3] {
            let mut grid = Grid::new(limit);
            for (place, own) in all.iter().enumerate() {
                let expected = (0..place)
                    .filter_map(|other| Some((other, own.path.distance(&all[other].path, limit)?)))
                    .min_by(|a, b| a.1.total_cmp(&b.1));
                assert_eq!(grid.nearest(&own.path), expected, "{limit} {place}");
                grid.insert(place, &own.path);
            }
        }
    }
}
