//! A packed tree of boxes over object poses that gives lower bounds of `d_o`.

use crate::metric::{box_squared, object_squared};

/// Number of children of a group and of frames in a leaf.
pub(crate) const FAN: usize = 8;

/// Number of poses up to which a subtree is arranged on the current thread.
const PARALLEL: usize = 1 << 14;

/// Normalised object pose of a frame, with the number of its demonstration.
#[derive(Clone, Copy)]
pub(crate) struct Pose {
    pub(crate) at: [f64; 3],
    pub(crate) demo: u32,
}

/// Frames that are close together. The coordinates are stored in columns so that the compiler can vectorise the distances.
struct Leaf {
    at: [[f64; FAN]; 3],
    demos: [u32; FAN],
}

/// The boxes of sibling nodes, also in columns. Unused places contain empty boxes, whose bound is infinite.
struct Group {
    low: [[f64; FAN]; 3],
    high: [[f64; FAN]; 3],
}

/// The groups, level by level: box `c` of group `g` bounds group `FAN * g + c` of the level below or, on the lowest level, the
/// leaf with that number. The last level has one group, the root.
pub(crate) struct PoseTree {
    leaves: Vec<Leaf>,
    levels: Vec<Vec<Group>>,
}

/// A group or, on level 0, a leaf that has yet to be visited.
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
        // A leaf that is not full repeats its last frame, so a visitor can see a frame more than once.
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

    /// Visits all leaves that can contain a frame whose squared `d_o` is at most `reach`, nearer siblings first. `visit` receives
    /// the squared distances of a leaf's frames and the numbers of their demonstrations, and may lower `reach`.
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
                    // Insertion sort that leaves the nearest sibling on top of the stack.
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

/// Orders poses so that every run of `FAN`, `FAN`², ... poses is close together. The poses are split at the median of the widest
/// dimension, shifted to a multiple of the run length so that the tree stays packed.
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
