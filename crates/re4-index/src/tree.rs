//! A packed tree of boxes over object poses, which yields lower bounds of `d_o`.

use crate::metric::{box_squared, object_squared};

/// Children of a group and frames of a leaf.
pub(crate) const FAN: usize = 8;

/// Poses below which a part of the tree is arranged on the thread at hand.
const PARALLEL: usize = 1 << 14;

/// Normalised object pose of a frame, and the demonstration that it belongs to.
#[derive(Clone, Copy)]
pub(crate) struct Pose {
    pub(crate) at: [f64; 3],
    pub(crate) demo: u32,
}

/// Frames that are close together, in columns, so that the compiler computes their distances with vector instructions.
struct Leaf {
    at: [[f64; FAN]; 3],
    demos: [u32; FAN],
}

/// The boxes of siblings, in columns as well. Boxes beyond the last sibling hold nothing and are infinitely far.
struct Group {
    low: [[f64; FAN]; 3],
    high: [[f64; FAN]; 3],
}

/// Groups in levels: box `c` of group `g` bounds group `8 g + c` of the level below; on the lowest level it bounds that
/// leaf. The last level is one group, the root.
pub(crate) struct PoseTree {
    leaves: Vec<Leaf>,
    levels: Vec<Vec<Group>>,
}

/// A group or, on level 0, a leaf that is still to be visited.
#[derive(Clone, Copy)]
struct Pending {
    bound: f64,
    level: u32,
    at: u32,
}

impl PoseTree {
    /// Packs the poses of at least one frame.
    pub(crate) fn build(mut poses: Vec<Pose>) -> Self {
        arrange(&mut poses);
        // A leaf that is not full repeats its last frame: a frame may be met twice.
        let leaves: Vec<Leaf> = poses
            .chunks(FAN)
            .map(|some| {
                let frame = |c: usize| some[c.min(some.len() - 1)];
                Leaf {
                    at: std::array::from_fn(|i| std::array::from_fn(|c| frame(c).at[i])),
                    demos: std::array::from_fn(|c| frame(c).demo),
                }
            })
            .collect();
        let mut boxes: Vec<[[f64; 3]; 2]> = leaves.iter().map(|leaf| extent(&leaf.at, &leaf.at)).collect();
        let mut levels = Vec::new();
        loop {
            let groups: Vec<Group> = boxes
                .chunks(FAN)
                .map(|siblings| {
                    let side = |side: usize, empty: f64| {
                        std::array::from_fn(|i| std::array::from_fn(|c| siblings.get(c).map_or(empty, |b| b[side][i])))
                    };
                    Group {
                        low: side(0, f64::INFINITY),
                        high: side(1, f64::NEG_INFINITY),
                    }
                })
                .collect();
            boxes = groups.iter().map(|group| extent(&group.low, &group.high)).collect();
            levels.push(groups);
            if boxes.len() <= 1 {
                return Self { leaves, levels };
            }
        }
    }

    /// Visits all leaves that may hold a frame whose squared `d_o` is at most `reach`, the nearer ones first. `visit` gets
    /// the squared distances of a leaf's frames and their demonstrations, and may lower `reach`.
    pub(crate) fn visit(
        &self,
        q: &[f64; 5],
        period: f64,
        mut reach: f64,
        mut visit: impl FnMut(&[f64; FAN], &[u32; FAN], &mut f64),
    ) {
        let mut stack = Vec::with_capacity(FAN * (self.levels.len() + 1));
        stack.push(Pending {
            bound: 0.0,
            level: self.levels.len() as u32,
            at: 0,
        });
        while let Some(Pending { bound, level, at }) = stack.pop() {
            if bound > reach {
                continue;
            }
            if level == 0 {
                let Leaf {
                    at: [x, y, theta],
                    demos,
                } = &self.leaves[at as usize];
                let mut distances = [0.0; FAN];
                for (c, distance) in distances.iter_mut().enumerate() {
                    *distance = object_squared(q, x[c], y[c], theta[c], period);
                }
                visit(&distances, demos, &mut reach);
                continue;
            }
            let Group { low, high } = &self.levels[level as usize - 1][at as usize];
            let mut bounds = [0.0; FAN];
            for (c, bound) in bounds.iter_mut().enumerate() {
                *bound = box_squared(
                    q,
                    [low[0][c], low[1][c], low[2][c]],
                    [high[0][c], high[1][c], high[2][c]],
                    period,
                );
            }
            let first = stack.len();
            for (c, bound) in bounds.into_iter().enumerate() {
                if bound <= reach && bound < f64::INFINITY {
                    // Insertion sort, the nearest sibling on top.
                    let mut place = stack.len();
                    stack.push(Pending {
                        bound,
                        level: level - 1,
                        at: at * FAN as u32 + c as u32,
                    });
                    while place > first && stack[place - 1].bound < bound {
                        stack.swap(place - 1, place);
                        place -= 1;
                    }
                }
            }
        }
    }
}

/// Minimum and maximum coordinates over columns.
fn extent(low: &[[f64; FAN]; 3], high: &[[f64; FAN]; 3]) -> [[f64; 3]; 2] {
    [
        low.map(|column| column.into_iter().fold(f64::INFINITY, f64::min)),
        high.map(|column| column.into_iter().fold(f64::NEG_INFINITY, f64::max)),
    ]
}

/// Orders poses so that every run of `FAN`, `FAN`², ... of them is close together: parts are split off at the median of
/// the widest dimension, moved to where such a run ends.
fn arrange(poses: &mut [Pose]) {
    if poses.len() <= FAN {
        return;
    }
    let width = |i: usize| {
        let (low, high) = poses
            .iter()
            .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), pose| {
                (low.min(pose.at[i]), high.max(pose.at[i]))
            });
        high - low
    };
    let widths = [0, 1, 2].map(width);
    let widest = (1..3).fold(0, |best, i| if widths[i] > widths[best] { i } else { best });
    let mut run = FAN;
    while run * FAN < poses.len() {
        run *= FAN;
    }
    let middle = (poses.len() / 2).next_multiple_of(run);
    poses.select_nth_unstable_by(middle, |a, b| a.at[widest].total_cmp(&b.at[widest]));
    let (left, right) = poses.split_at_mut(middle);
    if left.len() > PARALLEL {
        rayon::join(|| arrange(left), || arrange(right));
    } else {
        arrange(left);
        arrange(right);
    }
}
