//! Rigid motions in SE(2) and SE(3), angles, convex polygons, and distances between them. This crate does no input or output.
//!
//! Lengths are in the unit of the caller's world: pixels for Push-T, metres for robosuite. Angles are in radians.

mod angle;
mod planar;
mod polygon;
pub mod spatial;

pub use angle::{periodic_distance, signed_difference, wrap_to_pi, wrap_to_two_pi};
pub use planar::{Point2, Pose2};
pub use polygon::{
    clip_convex, distance_point_to_convex, distance_segment_to_convex, distance_segment_to_segment, polygon_area,
};
