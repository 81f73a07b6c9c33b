//! Copies among demonstrations: identical ones by hash, nearly identical ones by the distance between their paths.
//!
//! The path of a demonstration is resampled to a fixed number of points at equal fractions of its duration, so that copies at
//! another speed have the same points. The mean of a coordinate over all points differs by no more than the root mean square
//! difference of that coordinate, so copies are in the same cell of a grid over such means, or in neighbouring cells. Only
//! those are compared, and the cost per demonstration does not grow with their number.

use std::collections::HashMap;

use nalgebra::Vector3;

use crate::checks::SAMPLE;
use crate::common::Sink;
use crate::finding::Finding;
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

    fn mean(&self, coordinate: usize) -> f64 {
        let values = self.0.iter().skip(coordinate).step_by(COORDINATES);
        values.map(|value| f64::from(*value)).sum::<f64>() / POINTS as f64
    }
}

/// Distances of a sample of demonstrations to their nearest other one that is not identical.
pub(crate) fn nearest_distances(observations: &[Observation]) -> Vec<f64> {
    let step = observations.len().div_ceil(SAMPLE).max(1);
    observations
        .iter()
        .step_by(step)
        .filter_map(|own| {
            let mut nearest = f64::INFINITY;
            for other in observations.iter().filter(|other| other.episode != own.episode) {
                if let Some(distance) = own.path.distance(&other.path, nearest)
                    && distance > 0.0
                {
                    nearest = distance;
                }
            }
            nearest.is_finite().then_some(nearest)
        })
        .collect()
}

/// Reports demonstrations that are identical to an earlier one, nearly the same as an earlier one, or have the same actions as an
/// earlier one.
pub fn audit_copies(observations: &[Observation], thresholds: &Thresholds) -> Vec<Finding> {
    let mut findings = Vec::new();
    let mut recordings: HashMap<[u8; 32], usize> = HashMap::new();
    let mut actions: HashMap<[u8; 32], usize> = HashMap::new();
    let mut grid = Grid::new(thresholds.over("near_duplicate"));
    for (place, observation) in observations.iter().enumerate() {
        let all = 0..observation.frames as usize;
        let mut sink = Sink::new(observation.episode, &observation.demo, thresholds);
        let identical = recordings
            .get(&observation.recording)
            .map(|&other| &observations[other]);
        let same = actions.get(&observation.actions).map(|&other| &observations[other]);
        let near = || grid.nearest(observation, observations);
        if let Some(same) = identical {
            let message = format!("identical to {}, bit for bit", same.demo);
            sink.add("duplicate", all, None, message);
            sink.link(same);
        } else if let Some((other, distance)) = near() {
            let other = &observations[other];
            let message = format!(
                "nearly identical to {}: over {} and {} frames, the paths are {} apart",
                other.demo,
                observation.frames,
                other.frames,
                match thresholds.domain() {
                    Domain::Plane => format!("{distance:.2} px"),
                    Domain::Arm if !thresholds.made("discontinuity_eef") =>
                        format!("{:.2} % of the range of a joint", 1e2 * distance),
                    Domain::Space | Domain::Arm => format!("{:.2} mm", 1e3 * distance),
                }
            );
            sink.add("near_duplicate", all, Some(distance), message);
            sink.link(other);
        } else if let Some(same) = same {
            let message = format!("the same actions as {}, but other states", same.demo);
            sink.add("same_actions", all, None, message);
            sink.link(same);
        }
        recordings.entry(observation.recording).or_insert(place);
        actions.entry(observation.actions).or_insert(place);
        // Of many copies of one demonstration, only the first is compared with later ones.
        if sink.findings.iter().all(|finding| finding.code == "same_actions") {
            grid.insert(place, observation);
        }
        findings.append(&mut sink.findings);
    }
    findings
}

/// Paths by the cell of their means.
struct Grid {
    limit: f64,
    cells: HashMap<[i64; 4], Vec<usize>>,
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

    fn insert(&mut self, place: usize, observation: &Observation) {
        if self.limit.is_finite() && self.limit > 0.0 {
            let cell = self.cell(&observation.path);
            self.cells.entry(cell).or_default().push(place);
        }
    }

    /// The nearest inserted demonstration closer than the limit; the earliest of equally near ones.
    fn nearest(&self, own: &Observation, all: &[Observation]) -> Option<(usize, f64)> {
        if !(self.limit.is_finite() && self.limit > 0.0) {
            return None;
        }
        let center = self.cell(&own.path);
        let mut best: Option<(usize, f64)> = None;
        for neighbour in 0..81 {
            let cell = std::array::from_fn(|axis| center[axis] + (neighbour / 3_i64.pow(axis as u32)) % 3 - 1);
            for &place in self.cells.get(&cell).map_or(&[] as &[usize], Vec::as_slice) {
                let Some(other) = all.get(place) else { continue };
                let limit = best.map_or(self.limit, |(_, distance)| distance.next_up());
                if let Some(distance) = own.path.distance(&other.path, limit)
                    && best.is_none_or(|(earlier, nearest)| (distance, place) < (nearest, earlier))
                {
                    best = Some((place, distance));
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
                assert_eq!(grid.nearest(own, &all), expected, "{limit} {place}");
                grid.insert(place, own);
            }
        }
    }
}
