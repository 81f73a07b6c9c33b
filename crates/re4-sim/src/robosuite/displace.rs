//! Moves the object of a scene on its support, as a disturbance of a rollout.

use nalgebra::{Isometry3, Quaternion, Translation3, UnitQuaternion, Vector3};
use re4_geometry::Pose2;

use super::{Robosuite, UNSTABLE_LIMIT};
use crate::SimError;

/// Minimum distance of the grip site from the object's origin, in metres, before and after the displacement. The object is not
/// held, and the fingers do not touch it.
const CLEAR_OF_GRIPPER: f64 = 0.1;

/// Maximum speed of an object at rest, in m/s along each axis.
const AT_REST: f64 = 0.05;

/// Width of the margin around the region of the initial placement in which the object may be afterwards, in metres. The object
/// stays clear of the walls of the bins and of the pegs.
const MARGIN: f64 = 0.04;

impl Robosuite {
    /// Translates the object along the table and rotates it about the vertical axis through its origin: metres and radians, world
    /// frame. It is at rest afterwards. Returns false and changes nothing if the object moves, the gripper is within 10 cm of its
    /// old or new place, or the new place is more than 4 cm outside of the region in which the task places the object at a reset.
    ///
    /// # Errors
    /// If the displacement is not finite.
    pub fn displace_object(&mut self, motion: Pose2) -> Result<bool, SimError> {
        let task = self.model.task;
        let numbers = [motion.x, motion.y, motion.theta];
        if let Some(index) = numbers.iter().position(|n| n.is_nan() || n.abs() >= UNSTABLE_LIMIT) {
            return Err(SimError::NotFinite {
                operation: "displace",
                task: task.environment,
                what: "displacement",
                index,
                value: numbers[index],
            });
        }
        let (at, freedom) = self.model.robot.object_joint;
        let [x, y, z, w, i, j, k] = std::array::from_fn(|n| self.data.qpos()[at + n]);
        let now = Isometry3::from_parts(
            Translation3::new(x, y, z),
            UnitQuaternion::new_normalize(Quaternion::new(w, i, j, k)),
        );
        let moved = now.translation.vector + Vector3::new(motion.x, motion.y, 0.0);
        let gripper = self.model.robot.site_position(&self.data);
        let clear = |object: &Vector3<f64>| (gripper - object).norm() >= CLEAR_OF_GRIPPER;
        let resting = self.data.qvel()[freedom..freedom + 3]
            .iter()
            .all(|v| v.abs() <= AT_REST);
        let rule = task.placement.iter().find(|rule| rule.object == task.object);
        let inside = rule.is_none_or(|rule| {
            let within = |value: f64, [low, high]: [f64; 2]| (low - MARGIN..=high + MARGIN).contains(&value);
            within(moved.x - rule.reference[0], rule.x) && within(moved.y - rule.reference[1], rule.y)
        });
        if !(resting && inside && clear(&now.translation.vector) && clear(&moved)) {
            return Ok(false);
        }
        let rotation = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), motion.theta) * now.rotation;
        let [i, j, k, w] = rotation.coords.into();
        self.data.qpos_mut()[at..at + 7].copy_from_slice(&[moved.x, moved.y, moved.z, w, i, j, k]);
        self.data.qvel_mut()[freedom..freedom + 6].fill(0.0);
        self.data.forward();
        Ok(true)
    }
}
