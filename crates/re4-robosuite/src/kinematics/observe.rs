//! What robosuite's observations hold of a state, computed from the model.

use std::f64::consts::PI;

use nalgebra::Isometry3;

use super::names::listed;
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

/// The arm joints (radians) at which robosuite resets a Panda, before noise. Source: robosuite 1.4.1 and 1.5.1,
/// `models/robots/manipulators/panda_robot.py` (`init_qpos`).
pub const PANDA_RESET: [f64; 7] = [0.0, PI / 16.0, 0.0, -5.0 * PI / 6.0, 0.0, PI - 0.2, PI / 4.0];

impl Model {
    /// The grip site's pose with robot 0's arm joints at these angles, e.g. [`PANDA_RESET`].
    ///
    /// A simulator that was reset to a recorded state holds this pose in its controller until the first step is done.
    ///
    /// # Errors
    /// When the robot or its arm joints `robot0_joint1` to `robot0_joint7` are not in the model.
    pub fn site_at(&self, arm: &[f64; 7]) -> Result<Isometry3<f64>, KinematicsError> {
        let robot = self.robot(0)?;
        let mut qpos = vec![0.0; self.positions()];
        for (number, angle) in (1..).zip(arm) {
            let name = format!("robot0_joint{number}");
            let Some(joint) = self.joints().find(|joint| joint.name == name) else {
                return Err(KinematicsError::Missing {
                    what: format!("arm joint {number}"),
                    sought: name,
                    present: listed(self.joints().map(|joint| joint.name.as_str())),
                });
            };
            qpos[joint.address] = *angle;
        }
        Ok(*self.forward(&qpos)?.site(robot.grip_site))
    }

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
        // Most bodies of a scene are neither.
        let site = &self.sites[robot.grip_site.0];
        let asked = [robot.hand.0, site.body].into_iter().chain(object.map(|body| body.0));
        let needed = self.with_ancestors(asked);
        let mut poses = vec![Isometry3::identity(); self.bodies.len()];
        states
            .map(|state| {
                let state = self.split(state)?;
                self.place(state.qpos, needed.iter().copied(), &mut poses)?;
                Ok(Observed {
                    time: state.time,
                    site: poses[site.body] * site.pose,
                    hand: poses[robot.hand.0],
                    gripper_qpos: robot.gripper_qpos(state.qpos),
                    object: object.map(|body| poses[body.0]),
                })
            })
            .collect()
    }
}
