//! A tree over object poses in SE(3) that gives lower bounds of `d_o` in ascending order.

use std::cmp::Ordering;
use std::collections::BinaryHeap;

use nalgebra::{UnitQuaternion, Vector3};
use re4_geometry::spatial::SymmetryGroup;

use crate::spatial::metric::{Measure, State};

/// Maximum number of entries in a leaf.
const LEAF: usize = 4;

/// Number of orientations that are tried as the centre of a ball.
const CENTRES: usize = 8;

/// Relative and absolute amount by which a bound is lowered. Rounding errors in distances and radii are far smaller, so no frame
/// is missed.
const SLACK: f64 = 1e-9;

/// Object poses that are close together: a box around the positions and a ball around the orientations. The radius of the ball is
/// an angle up to the object's symmetry.
#[derive(Debug, Clone)]
struct Region {
    low: Vector3<f64>,
    high: Vector3<f64>,
    centre: UnitQuaternion<f64>,
    radius: f64,
}

impl Region {
    /// Returns a lower bound of `d_o` over the region.
    fn bound(&self, measure: &Measure, q: &State) -> f64 {
        let at = q.object.translation.vector;
        let outside = (self.low - at).sup(&(at - self.high)).sup(&Vector3::zeros());
        let angle = measure.group.angle(&q.object.rotation, &self.centre) - self.radius;
        let bound = outside.norm() / measure.metric.translation_scale + angle.max(0.0) / measure.metric.rotation_scale;
        bound * (1.0 - SLACK) - SLACK
    }
}

/// Frames of one demonstration whose object poses are close together.
#[derive(Debug, Clone)]
struct Entry {
    region: Region,
    demo: u32,
}

#[derive(Debug)]
enum Node {
    Inner {
        region: Region,
        children: [u32; 2],
    },
    Leaf {
        region: Region,
        entries: std::ops::Range<u32>,
    },
}

impl Node {
    fn region(&self) -> &Region {
        match self {
            Self::Inner { region, .. } | Self::Leaf { region, .. } => region,
        }
    }
}

/// The tree. The module documentation of `spatial` describes its entries.
#[derive(Debug)]
pub(crate) struct RegionTree {
    entries: Vec<Entry>,
    nodes: Vec<Node>,
}

/// A node or entry that has yet to be opened.
#[derive(Clone, Copy)]
enum Pending {
    Node(u32),
    Demo(u32),
}

struct Queued {
    bound: f64,
    what: Pending,
}

impl Ord for Queued {
    fn cmp(&self, other: &Self) -> Ordering {
        // The heap yields its maximum, which must be the entry with the smallest bound.
        other.bound.total_cmp(&self.bound)
    }
}

impl PartialOrd for Queued {
    fn partial_cmp(&self, other: &Self) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}

impl PartialEq for Queued {
    fn eq(&self, other: &Self) -> bool {
        self.cmp(other).is_eq()
    }
}

impl Eq for Queued {}

impl RegionTree {
    /// Packs the frames of at least one demonstration; `demos` gives the frames of each demonstration in order.
    pub(crate) fn build<'a>(measure: &Measure, demos: impl Iterator<Item = &'a [State]>) -> Self {
        let mut entries = Vec::new();
        for (demo, frames) in (0..).zip(demos) {
            collect(measure, demo, frames, &mut entries);
        }
        let mut tree = Self {
            entries: Vec::new(),
            nodes: Vec::new(),
        };
        if !entries.is_empty() {
            tree.grow(measure, entries);
        }
        tree
    }

    /// Adds the entries below a new node and returns the number of the node.
    fn grow(&mut self, measure: &Measure, mut entries: Vec<Entry>) -> u32 {
        let region = enclosing(&measure.group, &entries);
        let number = self.nodes.len() as u32;
        if entries.len() <= LEAF {
            let first = self.entries.len() as u32;
            self.entries.append(&mut entries);
            self.nodes.push(Node::Leaf {
                region,
                entries: first..self.entries.len() as u32,
            });
            return number;
        }
        sort_for_split(measure, &region, &mut entries);
        let right = entries.split_off(entries.len() / 2);
        self.nodes.push(Node::Inner {
            region,
            children: [0; 2],
        });
        let grown = [self.grow(measure, entries), self.grow(measure, right)];
        if let Some(Node::Inner { children, .. }) = self.nodes.get_mut(number as usize) {
            *children = grown;
        }
        number
    }

    /// Visits demonstrations in ascending order of lower bounds of `d_o` while `visit` returns true. `visit` receives a bound and
    /// the number of a demonstration; no frame visited later has a `d_o` below the bound. A demonstration can be visited several
    /// times.
    pub(crate) fn visit(&self, measure: &Measure, q: &State, mut visit: impl FnMut(f64, u32) -> bool) {
        let mut queue = BinaryHeap::with_capacity(64);
        let node = |at: u32| Queued {
            bound: self.nodes[at as usize].region().bound(measure, q),
            what: Pending::Node(at),
        };
        if !self.nodes.is_empty() {
            queue.push(node(0));
        }
        while let Some(Queued { bound, what }) = queue.pop() {
            match what {
                Pending::Demo(demo) => {
                    if !visit(bound, demo) {
                        return;
                    }
                }
                Pending::Node(at) => match &self.nodes[at as usize] {
                    Node::Inner { children, .. } => queue.extend(children.map(node)),
                    Node::Leaf { entries, .. } => {
                        let entries = &self.entries[entries.start as usize..entries.end as usize];
                        queue.extend(entries.iter().map(|entry| Queued {
                            bound: entry.region.bound(measure, q),
                            what: Pending::Demo(entry.demo),
                        }));
                    }
                },
            }
        }
    }
}

/// Maximum extent of an entry in units of `d_o`: the diagonal of its box, and the angle to its first frame. Smaller values give
/// tighter bounds but more entries.
const RUN: f64 = 0.02;

/// Splits the frames of a demonstration into runs with close object poses.
fn collect(measure: &Measure, demo: u32, frames: &[State], entries: &mut Vec<Entry>) {
    let mut open: Option<Entry> = None;
    for frame in frames {
        let (at, rotation) = (frame.object.translation.vector, frame.object.rotation);
        if let Some(Entry { region, .. }) = &mut open {
            let (low, high) = (region.low.inf(&at), region.high.sup(&at));
            let angle = measure.group.angle(&rotation, &region.centre);
            if (high - low).norm() <= RUN * measure.metric.translation_scale
                && angle <= RUN * measure.metric.rotation_scale
            {
                (region.low, region.high, region.radius) = (low, high, region.radius.max(angle));
                continue;
            }
        }
        entries.extend(open.replace(Entry {
            region: Region {
                low: at,
                high: at,
                centre: rotation,
                radius: 0.0,
            },
            demo,
        }));
    }
    entries.extend(open);
}

/// Returns a region that encloses the regions of at least one entry. The centre of the ball is the best of up to [`CENTRES`]
/// candidates.
fn enclosing(group: &SymmetryGroup, entries: &[Entry]) -> Region {
    let mut region = entries[0].region.clone();
    for Entry { region: other, .. } in entries {
        (region.low, region.high) = (region.low.inf(&other.low), region.high.sup(&other.high));
    }
    region.radius = f64::INFINITY;
    for candidate in entries.iter().step_by(entries.len().div_ceil(CENTRES)) {
        let centre = candidate.region.centre;
        let reach = |entry: &Entry| group.angle(&centre, &entry.region.centre) + entry.region.radius;
        let radius = entries.iter().map(reach).fold(0.0, f64::max);
        if radius < region.radius {
            (region.centre, region.radius) = (centre, radius);
        }
    }
    region
}

/// Orders entries so that each half is close together. The sort key is the position along the widest side of the box or, if the
/// spread of the orientations is larger, the difference of the angles to two orientations that are far apart.
fn sort_for_split(measure: &Measure, region: &Region, entries: &mut [Entry]) {
    let sides = region.high - region.low;
    let widest = sides.imax();
    let width = sides[widest] / measure.metric.translation_scale;
    let keyed: Vec<f64> = if width >= 2.0 * region.radius / measure.metric.rotation_scale {
        entries
            .iter()
            .map(|e| e.region.low[widest] + e.region.high[widest])
            .collect()
    } else {
        let farthest = |from: &UnitQuaternion<f64>| {
            let angle = |e: &Entry| measure.group.angle(from, &e.region.centre);
            entries
                .iter()
                .map(|e| (angle(e), e.region.centre))
                .fold(
                    (f64::NEG_INFINITY, *from),
                    |best, next| if next.0 > best.0 { next } else { best },
                )
                .1
        };
        let one = farthest(&region.centre);
        let other = farthest(&one);
        let angle = |a: &UnitQuaternion<f64>, e: &Entry| measure.group.angle(a, &e.region.centre);
        entries.iter().map(|e| angle(&one, e) - angle(&other, e)).collect()
    };
    let mut order: Vec<usize> = (0..entries.len()).collect();
    order.sort_by(|&a, &b| keyed[a].total_cmp(&keyed[b]).then(a.cmp(&b)));
    let sorted: Vec<Entry> = order.into_iter().map(|i| entries[i].clone()).collect();
    entries.clone_from_slice(&sorted);
}
