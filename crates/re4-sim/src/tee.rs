//! The T-shaped block: its two rectangles, its goal pose, and its coverage of the goal.
//!
//! The constants are those of gym-pusht 0.1.8 (`envs/pusht.py`), which `diffusion_policy`'s `env/pusht/pusht_env.py` uses too.

use crate::chipmunk::WALL_FACES;
use re4_geometry::{Point2, Pose2, clip_convex, distance_point_to_convex, polygon_area};

/// The goal pose of the block, in pixels and radians.
pub const GOAL: Pose2 = Pose2::new(256.0, 256.0, std::f64::consts::FRAC_PI_4);

/// An episode succeeds when the coverage is strictly greater than this.
pub const SUCCESS_COVERAGE: f64 = 0.95;

/// Radius of the round agent, in pixels.
pub const AGENT_RADIUS: f64 = 15.0;

/// The block's centre of gravity in its own frame, in pixels: the mean of the rectangles' centroids without area weights, as
/// in gym-pusht.
pub const CENTRE_OF_GRAVITY: Point2 = Point2::new(0.0, 45.0);

/// Area of the block, in square pixels: a bar of 120 x 30 and a stem of 30 x 90.
pub const TEE_AREA: f64 = 6300.0;

/// The bar and the stem, each as its four corners in the block's frame, in pixels.
///
/// The corners are in the order of gym-pusht's keypoints.
pub const fn tee_rectangles() -> [[Point2; 4]; 2] {
    [
        [
            Point2::new(-60.0, 0.0),
            Point2::new(60.0, 0.0),
            Point2::new(60.0, 30.0),
            Point2::new(-60.0, 30.0),
        ],
        [
            Point2::new(-15.0, 30.0),
            Point2::new(15.0, 30.0),
            Point2::new(15.0, 120.0),
            Point2::new(-15.0, 120.0),
        ],
    ]
}

/// The rectangles of a block at `pose`, in the world, in pixels.
pub fn tee_vertices(pose: Pose2) -> [[Point2; 4]; 2] {
    let (sine, cosine) = pose.theta.sin_cos();
    tee_rectangles().map(|rectangle| {
        rectangle.map(|p| Point2::new(pose.x + cosine * p.x - sine * p.y, pose.y + sine * p.x + cosine * p.y))
    })
}

/// The distance by which a corner of the block reaches into a wall or past it, in pixels; 0 for a block between the walls.
pub fn depth_in_walls(block: Pose2) -> f64 {
    let [low, high] = WALL_FACES;
    let depths = |p: &Point2| [low - p.x, p.x - high, low - p.y, p.y - high];
    tee_vertices(block)
        .iter()
        .flatten()
        .flat_map(depths)
        .fold(0.0, f64::max)
}

/// The distance from a point to a block, in pixels; 0 inside the block.
pub fn clearance_of_block(block: Pose2, point: Point2) -> f64 {
    tee_vertices(block)
        .iter()
        .map(|rectangle| distance_point_to_convex(point, rectangle))
        .fold(f64::INFINITY, f64::min)
}

/// Fraction of the goal's area that the block covers, in `[0, 1]`.
pub fn coverage(block: Pose2, goal: Pose2) -> f64 {
    coverage_of_area(overlap_area(&tee_vertices(block), &tee_vertices(goal)))
}

/// Intersection over union of the block and the goal, in `[0, 1]`.
pub fn iou(block: Pose2, goal: Pose2) -> f64 {
    iou_of_area(overlap_area(&tee_vertices(block), &tee_vertices(goal)))
}

/// Coverage for an area of overlap in square pixels. The minimum removes the rounding error of a block that is exactly on the
/// goal.
pub(crate) fn coverage_of_area(overlap: f64) -> f64 {
    (overlap / TEE_AREA).min(1.0)
}

/// Intersection over union for an area of overlap in square pixels, limited to 1 for the same reason.
pub(crate) fn iou_of_area(overlap: f64) -> f64 {
    (overlap / (2.0 * TEE_AREA - overlap)).min(1.0)
}

/// Area of the intersection of two T shapes, in square pixels. The two rectangles of a T do not overlap, so the four
/// intersections add up.
pub(crate) fn overlap_area(a: &[[Point2; 4]; 2], b: &[[Point2; 4]; 2]) -> f64 {
    a.iter()
        .flat_map(|p| b.iter().map(move |q| (p, q)))
        .filter(|(p, q)| boxes_meet(p, q))
        .map(|(p, q)| polygon_area(&clip_convex(p, q)))
        // `sum` starts from -0, so a block off the goal would have the coverage -0.
        .fold(0.0, |sum, area| sum + area)
}

/// Whether the axis-aligned bounding boxes of two rectangles overlap: avoids most of the clipping while the block is far away.
fn boxes_meet(p: &[Point2; 4], q: &[Point2; 4]) -> bool {
    (0..2).all(|axis| {
        let range = |r: &[Point2; 4]| {
            r.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), v| {
                (low.min(v[axis]), high.max(v[axis]))
            })
        };
        let ((p_low, p_high), (q_low, q_high)) = (range(p), range(q));
        p_low <= q_high && q_low <= p_high
    })
}
