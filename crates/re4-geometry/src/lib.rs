//! Planar and spatial rigid motions, angles, and the metrics over them. No input or output.
//!
//! Units are those of the caller's world: pixels for Push-T, metres for robosuite; angles are radians everywhere.

mod angle;
mod planar;
mod polygon;
pub mod spatial;

pub use angle::{periodic_distance, signed_difference, wrap_to_pi, wrap_to_two_pi};
pub use planar::{Point2, Pose2};
pub use polygon::{
    clip_convex, distance_point_to_convex, distance_segment_to_convex, distance_segment_to_segment, polygon_area,
};
