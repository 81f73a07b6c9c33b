//! Distance to the nearest other demonstration.

use std::num::NonZeroUsize;

use kiddo::{ImmutableKdTree, SquaredEuclidean};
use nalgebra::Vector3;
use rayon::prelude::*;

use crate::motion::Motion;

/// Number of positions along a demonstration that are compared.
const KNOTS: usize = 16;

/// Number of parts whose means the tree stores.
const PARTS: usize = 2;

const COARSE: usize = 6 * PARTS;

/// A demonstration's path in a form that does not depend on its pace: positions of end effector and object at equal lengths along
/// the path of both.
#[derive(Debug, Clone, PartialEq)]
pub struct Descriptor([[f32; 6]; KNOTS]);

/// Describes a demonstration. `None` if it has no frames.
pub fn describe(motion: &Motion) -> Option<Descriptor> {
    let pairs = || motion.eef.iter().zip(&motion.object);
    let mut lengths = vec![0.0];
    for ((eef, object), (next_eef, next_object)) in pairs().zip(pairs().skip(1)) {
        let moved = (next_eef - eef).norm() + (next_object - object).norm();
        lengths.push(lengths.last().copied().unwrap_or(0.0) + moved);
    }
    let total = lengths.last().copied().unwrap_or(0.0);
    let mut knots = [[0.0; 6]; KNOTS];
    let mut at = 0;
    for (number, knot) in knots.iter_mut().enumerate() {
        let wanted = total * number as f64 / (KNOTS - 1) as f64;
        while at + 2 < lengths.len() && lengths[at + 1] < wanted {
            at += 1;
        }
        let next = (at + 1).min(motion.eef.len().checked_sub(1)?);
        let part = lengths[next] - lengths[at];
        let fraction = if part > 0.0 {
            ((wanted - lengths[at]) / part).clamp(0.0, 1.0)
        } else {
            0.0
        };
        let between = |points: &[Vector3<f64>]| points[at] + (points[next] - points[at]) * fraction;
        let (eef, object) = (between(&motion.eef), between(&motion.object));
        *knot = [eef.x, eef.y, eef.z, object.x, object.y, object.z].map(|value| value as f32);
    }
    Some(Descriptor(knots))
}

impl Descriptor {
    /// The coordinates of all positions.
    pub(crate) fn coordinates(&self) -> Vec<f32> {
        self.0.as_flattened().to_vec()
    }

    /// The descriptor with these coordinates. `None` if there are more or fewer.
    pub(crate) fn of_coordinates(coordinates: &[f32]) -> Option<Self> {
        let (knots, rest) = coordinates.as_chunks();
        rest.is_empty().then(|| knots.try_into().ok().map(Self)).flatten()
    }

    /// Root mean square distance of the positions of end effector and object.
    fn distance(&self, other: &Self) -> f64 {
        let squares = self.0.iter().flatten().zip(other.0.iter().flatten());
        let sum: f64 = squares.map(|(a, b)| f64::from(a - b).powi(2)).sum();
        (sum / KNOTS as f64).sqrt()
    }

    /// The means of the parts. The root mean square distance of the means is at most that of the positions (Jensen's inequality).
    fn coarse(&self) -> [f64; COARSE] {
        let mut means = [0.0; COARSE];
        let size = KNOTS / PARTS;
        for (number, knot) in self.0.iter().enumerate() {
            for (at, value) in knot.iter().enumerate() {
                means[number / size * 6 + at] += f64::from(*value) / size as f64;
            }
        }
        means
    }
}

/// Descriptors, among which the nearest to one of them is found.
///
/// A tree over the means of both halves of the paths gives lower bounds, so the result is exact.
pub(crate) struct Paths {
    demos: Vec<Descriptor>,
    tree: Option<ImmutableKdTree<f64, COARSE>>,
}

impl Paths {
    pub(crate) fn new(demos: Vec<Descriptor>) -> Self {
        let coarse: Vec<[f64; COARSE]> = demos.iter().map(Descriptor::coarse).collect();
        let tree = ImmutableKdTree::new_from_slice(&coarse).ok();
        Self { demos, tree }
    }

    /// The nearest other one to the descriptor at this place, and its distance. `None` if there is no other.
    pub(crate) fn nearest(&self, own: usize) -> Option<(usize, f64)> {
        let (tree, demo) = (self.tree.as_ref()?, self.demos.get(own)?);
        let coarse = demo.coarse();
        let mut count = 16;
        loop {
            let taken = count.min(self.demos.len());
            let hits = tree
                .query(&coarse)
                .nearest_n::<SquaredEuclidean<f64>>(NonZeroUsize::new(taken)?);
            let hits = hits.execute();
            let others = hits.iter().map(|hit| hit.item as usize).filter(|&other| other != own);
            let best = others
                .map(|other| (other, demo.distance(&self.demos[other])))
                .min_by(|a, b| a.1.total_cmp(&b.1).then(a.0.cmp(&b.0)));
            let farthest = hits.iter().map(|hit| hit.distance).fold(0.0, f64::max);
            // A margin for rounding: means are sums of rounded numbers.
            let bound = (farthest / PARTS as f64).sqrt() * (1.0 - 1e-6) - 1e-9;
            if taken == self.demos.len() || best.is_some_and(|(_, distance)| distance < bound) {
                return best;
            }
            count *= 4;
        }
    }
}

/// For each demonstration, the nearest other one and its distance: the root mean square distance of the positions of end effector
/// and object, at equal lengths along the path. In the unit of the motion. `None` if there is no other demonstration.
pub fn nearest(demos: &[Descriptor]) -> Vec<Option<(usize, f64)>> {
    let paths = Paths::new(demos.to_vec());
    (0..demos.len()).into_par_iter().map(|own| paths.nearest(own)).collect()
}
