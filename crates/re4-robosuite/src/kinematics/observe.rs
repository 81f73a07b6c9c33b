//! What robosuite's observations hold of a state, computed from the model.

use nalgebra::Isometry3;

use super::{KinematicsError, Model};

/// World poses that observations are made of.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Observed {
    /// Seconds since the simulation's reset.
    pub time: f64,
    /// The grip site: its position is `robot0_eef_pos`.
    pub site: Isometry3<f64>,
    /// The hand body: its orientation is `robot0_eef_quat`.
    pub hand: Isometry3<f64>,
    /// The finger joints, `robot0_gripper_qpos`; none for hands with other than two sliding fingers.
    pub gripper_qpos: Option<[f64; 2]>,
    /// The object's body, where one was asked for.
    pub object: Option<Isometry3<f64>>,
}

impl Model {
    /// What robot 0 and an object are in each of these flattened states.
    ///
    /// `object` is its name in observations: `cube`, `Can`, `SquareNut`.
    ///
    /// # Errors
    /// When the robot or the object is not in the model, or a state is not one of this model.
    pub fn observe<'a>(
        &self,
        states: impl Iterator<Item = &'a [f64]>,
        object: Option<&str>,
    ) -> Result<Vec<Observed>, KinematicsError> {
        let robot = self.robot(0)?;
        let object = object.map(|name| self.object(name)).transpose()?;
        states
            .map(|state| {
                let state = self.split(state)?;
                let poses = self.forward(state.qpos)?;
                Ok(Observed {
                    time: state.time,
                    site: *poses.site(robot.grip_site),
                    hand: *poses.body(robot.hand),
                    gripper_qpos: robot.gripper_qpos(state.qpos),
                    object: object.map(|body| *poses.body(body)),
                })
            })
            .collect()
    }
}
