//! Models, observations and actions of robosuite and robomimic demonstrations.
//!
//! The crate proves the conventions of a file from its numbers, instead of deriving them from the declared version of robosuite.
//!
//! * [`kinematics`]: computes poses of bodies and sites from the attribute `model_file` and the flattened states of a
//!   demonstration, without a simulator.
//! * [`env_args`]: parses the attributes that describe how a file was recorded.
//! * [`physics`]: removes the parts of a model that physics does not depend on.
//! * [`actions`]: converts delta actions of the operational-space controller to absolute actions and back.
//! * [`conventions`]: detects the layout of the object vector, frames, quaternion orders, the kind of action and the gripper
//!   sign, each with the evidence for it.
//! * [`cameras`]: projects points to the images of a model's fixed cameras.
//! * [`models`]: rewrites the paths of meshes and textures in a `model_file` to the paths on this machine.
//!
//! Units are metres, radians and seconds. The world frame is robosuite's, with z up. Rotations are active: `pose * point`
//! converts the coordinates of a point in the frame `pose` to world coordinates.

pub mod actions;
pub mod cameras;
pub mod conventions;
pub mod env_args;
pub mod kinematics;
pub mod models;
pub mod physics;

use nalgebra::UnitQuaternion;

/// The orientation of the grip site in the frame of the hand body: -90 degrees about z, so that
/// `R_site = R_hand * hand_from_site()`. It converts coordinates in the grip site's frame to the hand body's frame.
///
/// It is the `quat` of the body `right_gripper` in the Panda models of robosuite 1.0 to 1.5. Observations contain the
/// orientation of the hand body (`robot0_eef_quat`), while the goals of the controller are orientations of the grip site.
#[must_use]
pub fn hand_from_site() -> UnitQuaternion<f64> {
    UnitQuaternion::from_axis_angle(&nalgebra::Vector3::z_axis(), -std::f64::consts::FRAC_PI_2)
}
