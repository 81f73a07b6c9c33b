//! What is known of robosuite and robomimic demonstrations, so that a file's conventions can be proven from its numbers
//! instead of believed from its version.
//!
//! * [`kinematics`]: poses of bodies and sites from a demo's `model_file` and its flattened states, without a simulator.
//! * [`env_args`]: the attributes that say how a file was recorded.
//! * [`physics`]: a model without what is only drawn.
//! * [`actions`]: delta actions of the operational-space controller to absolute ones and back.
//! * [`conventions`]: the layout of the object vector, frames, quaternion order, kind of action and gripper sign, each with
//!   the evidence for it.
//! * [`models`]: a demo's `model_file` with the paths of its meshes and textures as they are on this machine.
//!
//! Metres, radians, seconds. World frame: robosuite's, z up. Rotations are active: `pose * point` takes coordinates in a frame
//! to world coordinates.

pub mod actions;
pub mod conventions;
pub mod env_args;
pub mod kinematics;
pub mod models;
pub mod physics;

use nalgebra::UnitQuaternion;

/// The rotation that takes coordinates in the grip site's frame to the hand body's: -90 degrees about z, so that
/// `R_site = R_hand * hand_to_site()`.
///
/// It is the `quat` of the body `right_gripper` in the Panda's models of robosuite 1.0 to 1.5. Observations hold the hand's
/// orientation (`robot0_eef_quat`), the controller's goals are the site's.
#[must_use]
pub fn hand_to_site() -> UnitQuaternion<f64> {
    UnitQuaternion::from_axis_angle(&nalgebra::Vector3::z_axis(), -std::f64::consts::FRAC_PI_2)
}
