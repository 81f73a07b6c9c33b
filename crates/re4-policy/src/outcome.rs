//! Retrieve by outcome: which recorded push would bring the object here closest to its goal?
//!
//! Pushing is quasi-static and does not depend on where in the plane it happens: a chunk that moved the demonstration's
//! object by `T = o_j⁻¹ o_e` (in the object's own frame) moves ours, reframed, from `o_q` to `o_q T`. The chunk that is
//! wanted is the one whose `T` is nearest to `o_q⁻¹ o_goal`. The demonstrations thus serve as a forward model; nothing
//! but their recorded poses and the task's goal pose enters.
//!
//! The distance between two poses of the object is the root mean square displacement of its points,
//! `D² = |Δc|² + 2 r² (1 - cos Δθ)` with `c` the centroid and `r` the radius of gyration about it, in pixels. It is
//! Euclidean in `(c_x, c_y, r cos θ, r sin θ)`, so a KD-tree over these four numbers answers it exactly.

use std::num::NonZeroUsize;

use kiddo::{ImmutableKdTree, SquaredEuclidean};
use re4_artifact::table;
use re4_geometry::{Point2, Pose2, polygon_area};
use re4_sim::tee_rectangles;

use crate::LookupError;
use re4_episode::PlanarFrame;

use crate::demos::DemoSet;
use crate::replan::Obstacle;

/// The object may start a chunk once the pusher is at least this far (pixels, from its centre) from the block.
const FREE_DISTANCE: f64 = 16.0;

/// Object motion between frames, in pixels root mean square, below which it counts as resting.
const RESTING: f64 = 0.05;

/// Centroid and radius of gyration of the object, which define the distance between its poses.
#[derive(Debug, Clone, Copy)]
pub struct Body {
    centroid: Point2,
    gyration: f64,
}

impl Body {
    /// The Push-T block, from its two rectangles.
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

    /// Root mean square displacement of the body's points between two poses, in pixels.
    pub fn distance(&self, a: Pose2, b: Pose2) -> f64 {
        let (a, b) = (self.embed(a), self.embed(b));
        a.iter().zip(&b).map(|(x, y)| (x - y) * (x - y)).sum::<f64>().sqrt()
    }
}

table! {
    /// One row a chunk: a part of a demonstration that starts with the pusher clear of the block and ends anywhere after the block
    /// began to move. Sorted by episode, first and last frame.
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
        /// The block's motion o_j^-1 o_e: its pose at the last frame in its own frame at the first.
        #[frame = "object"]
        pub motion: Pose2,
        /// Length of the pusher's path.
        #[unit = "px"]
        pub travel: f64,
        /// Length of the block's path: root mean square displacement of its points, summed over the frames.
        #[unit = "px"]
        pub pushed: f64,
    }
}

/// All chunks of a set of demonstrations, searchable by outcome.
pub struct ChunkLibrary {
    body: Body,
    chunks: Vec<Chunk>,
    tree: ImmutableKdTree<f64, 4>,
}

/// Collects the chunks of up to `longest` frames from a set of demonstrations, in the order of demonstration, first and
/// last frame.
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
            // A useful start is the last free frame before contact: the plan brings the pusher there.
            let leads_to_contact = free[start] && (!free[start + 1] || moved[start] >= RESTING);
            // The contact must push: the object moves before the pusher is free again.
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
    /// Makes chunks searchable.
    ///
    /// # Errors
    /// When there are none, or the tree cannot be built.
    pub fn build(chunks: Vec<Chunk>) -> Result<Self, LookupError> {
        if chunks.is_empty() {
            return Err(LookupError::NoChunks);
        }
        let body = Body::tee();
        let points: Vec<[f64; 4]> = chunks.iter().map(|c| body.embed(c.motion)).collect();
        let tree = ImmutableKdTree::new_from_slice(&points).map_err(|error| LookupError::Chunks {
            reason: error.to_string(),
        })?;
        Ok(Self { body, chunks, tree })
    }

    /// The body whose poses are compared.
    pub fn body(&self) -> Body {
        self.body
    }

    /// How many chunks there are; at least one.
    #[expect(clippy::len_without_is_empty, reason = "there is no library without chunks")]
    pub fn len(&self) -> usize {
        self.chunks.len()
    }

    /// The `count` chunks whose outcome is nearest to `wanted`, a motion in the object's own frame; nearest first, each
    /// with its remaining misalignment in pixels.
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
        found.sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        found
            .into_iter()
            .map(|(d, i)| (d.sqrt(), self.chunks[i as usize]))
            .collect()
    }
}
