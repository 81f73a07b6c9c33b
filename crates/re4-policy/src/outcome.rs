//! Retrieve by outcome: finds the recorded push that would bring the object closest to its goal.
//!
//! Pushing is quasi-static and does not depend on where in the plane it happens. A chunk that moved the object of a demonstration
//! by `T = o_j⁻¹ o_e` (in the object frame) therefore moves the observed object from `o_q` to `o_q T` after Reframe. The best
//! chunk is the one whose `T` is nearest to `o_q⁻¹ o_goal`. The demonstrations thus act as a forward model of pushing; the method
//! uses only their recorded poses and the goal pose of the task.
//!
//! The distance between two object poses is the root mean square displacement of the object's points,
//! `D² = |Δc|² + 2 r² (1 - cos Δθ)`, in pixels, where `c` is the centroid and `r` is the radius of gyration about it. This
//! distance is Euclidean in `(c_x, c_y, r cos θ, r sin θ)`, so a KD-tree over these four numbers finds nearest neighbours
//! exactly.

use std::collections::{BTreeMap, BTreeSet};
use std::num::NonZeroUsize;

use kiddo::{ImmutableKdTree, SquaredEuclidean};
use re4_artifact::table;
use re4_geometry::{Point2, Pose2, polygon_area};
use re4_sim::tee_rectangles;

use crate::LookupError;
use re4_episode::PlanarFrame;

use crate::demos::DemoSet;
use crate::replan::Obstacle;

/// Minimum distance in pixels from the pusher's centre to the block at the start of a chunk: 1 px more than the pusher's radius.
const FREE_DISTANCE: f64 = 16.0;

/// Root mean square displacement between two frames, in pixels, below which the object counts as resting.
const RESTING: f64 = 0.05;

/// Centroid and radius of gyration of the object, which define the distance between its poses. Pixels.
#[derive(Debug, Clone, Copy)]
pub struct Body {
    centroid: Point2,
    gyration: f64,
}

impl Body {
    /// Creates the body of the Push-T block from its two rectangles.
    pub fn tee() -> Self {
        let parts = tee_rectangles();
        let mut area = 0.0;
        let mut centroid = Point2::zeros();
        for part in &parts {
            let a = polygon_area(part);
            centroid += part.iter().sum::<Point2>() / 4.0 * a;
            area += a;
        }
        centroid /= area;
        let mut second = 0.0;
        for part in &parts {
            let (w, h) = ((part[1] - part[0]).norm(), (part[2] - part[1]).norm());
            let own = w * h * (w * w + h * h) / 12.0;
            second += own + w * h * (part.iter().sum::<Point2>() / 4.0 - centroid).norm_squared();
        }
        Self {
            centroid,
            gyration: (second / area).sqrt(),
        }
    }

    fn embed(&self, pose: Pose2) -> [f64; 4] {
        let c = pose.transform_point(self.centroid);
        let (s, k) = pose.theta.sin_cos();
        [c.x, c.y, self.gyration * k, self.gyration * s]
    }

    /// Returns the root mean square displacement of the body's points between two poses, in pixels.
    pub fn distance(&self, a: Pose2, b: Pose2) -> f64 {
        let (a, b) = (self.embed(a), self.embed(b));
        a.iter().zip(&b).map(|(x, y)| (x - y) * (x - y)).sum::<f64>().sqrt()
    }
}

table! {
    /// One row per chunk: a part of a demonstration that starts with the pusher clear of the block and ends at a frame at which
    /// the block moves. A start has one chunk for every such end. Sorted by episode, first and last frame.
    #[table("chunks", version = 1)]
    #[derive(Copy)]
    pub struct Chunk {
        /// Number of the demonstration in this artifact, from 0.
        #[prefix = "episode"]
        pub demo: u32,
        /// First frame of the chunk.
        #[prefix = "first_frame"]
        pub start: u32,
        /// Last frame of the chunk, included.
        #[prefix = "last_frame"]
        pub end: u32,
        /// Motion of the block, o_j^-1 o_e: its pose at the last frame in the block frame at the first.
        #[frame = "object"]
        pub motion: Pose2,
        /// Length of the pusher's path.
        #[unit = "px"]
        pub travel: f64,
        /// Length of the block's path: the root mean square displacement of its points, summed over the frames.
        #[unit = "px"]
        pub pushed: f64,
    }
}

/// All chunks of a set of demonstrations with a search tree over their outcomes.
pub struct ChunkLibrary {
    body: Body,
    chunks: Vec<Chunk>,
    /// Number of chunks of every demonstration that has chunks.
    counts: BTreeMap<u32, usize>,
    tree: ImmutableKdTree<f64, 4>,
}

/// Collects the chunks of up to `longest` frames from a set of demonstrations, sorted by demonstration, first and last frame.
pub fn collect_chunks(demos: &DemoSet<PlanarFrame>, longest: usize) -> Vec<Chunk> {
    let body = Body::tee();
    let mut chunks = Vec::new();
    for (demo, frames) in demos.iter() {
        let moved: Vec<f64> = frames
            .windows(2)
            .map(|w| body.distance(w[0].object, w[1].object))
            .collect();
        let free: Vec<bool> = frames
            .iter()
            .map(|f| Obstacle::at(f.object).distance(f.eef) >= FREE_DISTANCE)
            .collect();
        for start in 0..moved.len() {
            // A chunk starts at the last free frame before contact, because Replan moves the pusher there without contact.
            let leads_to_contact = free[start] && (!free[start + 1] || moved[start] >= RESTING);
            // The contact must move the object before the pusher is free again.
            let pushes = (start..moved.len())
                .take_while(|&t| t == start || !free[t] || moved[t] >= RESTING)
                .any(|t| moved[t] >= RESTING);
            if !(leads_to_contact && pushes) {
                continue;
            }
            let (mut travel, mut pushed) = (0.0, 0.0);
            for end in start + 1..frames.len().min(start + 1 + longest) {
                travel += (frames[end].eef - frames[end - 1].eef).norm();
                pushed += moved[end - 1];
                if moved[end - 1] >= RESTING {
                    let motion = frames[start].object.inverse().compose(frames[end].object);
                    chunks.push(Chunk {
                        demo,
                        start: start as u32,
                        end: end as u32,
                        motion,
                        travel,
                        pushed,
                    });
                }
            }
        }
    }
    chunks
}

impl ChunkLibrary {
    /// Builds the search tree.
    ///
    /// # Errors
    /// If there are no chunks, or the tree cannot be built.
    pub fn build(chunks: Vec<Chunk>) -> Result<Self, LookupError> {
        if chunks.is_empty() {
            return Err(LookupError::NoChunks);
        }
        let body = Body::tee();
        let points: Vec<[f64; 4]> = chunks.iter().map(|c| body.embed(c.motion)).collect();
        let tree = ImmutableKdTree::new_from_slice(&points).map_err(|error| LookupError::Chunks {
            reason: error.to_string(),
        })?;
        let mut counts = BTreeMap::new();
        for chunk in &chunks {
            *counts.entry(chunk.demo).or_insert(0) += 1;
        }
        Ok(Self {
            body,
            chunks,
            counts,
            tree,
        })
    }

    /// Returns the body that defines the distance between poses.
    pub fn body(&self) -> Body {
        self.body
    }

    /// Returns the number of chunks, which is at least one.
    #[expect(clippy::len_without_is_empty, reason = "a library has at least one chunk")]
    pub fn len(&self) -> usize {
        self.chunks.len()
    }

    /// Returns the `count` chunks whose outcomes are nearest to `wanted`, a motion in the object frame, nearest first. Each chunk
    /// comes with its remaining misalignment in pixels.
    pub fn nearest(&self, wanted: Pose2, count: NonZeroUsize) -> Vec<(f64, Chunk)> {
        let query = self.body.embed(wanted);
        let mut found: Vec<(f64, u32)> = self
            .tree
            .query(&query)
            .nearest_n::<SquaredEuclidean<f64>>(count)
            .execute()
            .iter()
            .map(|hit| (hit.distance, hit.item))
            .collect();
        // Equal distances are ordered by chunk so that the result is deterministic.
        found.sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        found
            .into_iter()
            .map(|(d, i)| (d.sqrt(), self.chunks[i as usize]))
            .collect()
    }

    /// Returns the number of chunks of the demonstrations that are not in `without`.
    pub fn len_without(&self, without: &BTreeSet<u32>) -> usize {
        let left_out = without.iter().filter_map(|demo| self.counts.get(demo));
        self.len() - left_out.sum::<usize>()
    }

    /// As [`Self::nearest`], as if the library had no chunks of the demonstrations in `without`.
    pub fn nearest_without(&self, wanted: Pose2, count: NonZeroUsize, without: &BTreeSet<u32>) -> Vec<(f64, Chunk)> {
        let left = count.get().min(self.len_without(without));
        let mut asked = count;
        loop {
            let mut found = self.nearest(wanted, asked);
            found.retain(|(_, chunk)| !without.contains(&chunk.demo));
            if found.len() >= left {
                found.truncate(left);
                return found;
            }
            asked = asked.saturating_add(asked.get());
        }
    }
}
