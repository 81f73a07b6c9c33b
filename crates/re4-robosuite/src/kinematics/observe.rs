//! Computes the poses in robosuite's observations from a state and its model.

use std::f64::consts::PI;

use nalgebra::Isometry3;

use super::names::listed;
use super::{KinematicsError, Model};

/// The quantities in a state that observations consist of. Poses are in the world frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Observed {
    /// Seconds since the simulation's reset.
    pub time: f64,
    /// Pose of the grip site. Its position is `robot0_eef_pos`.
    pub site: Isometry3<f64>,
    /// Pose of the hand body. Its orientation is `robot0_eef_quat`.
    pub hand: Isometry3<f64>,
    /// Positions of the finger joints, `robot0_gripper_qpos`, in metres. `None` unless the gripper has exactly two sliding
    /// fingers.
    pub gripper_qpos: Option<[f64; 2]>,
    /// Pose of the object's body, if an object was requested.
    pub object: Option<Isometry3<f64>>,
}

/// The arm joint angles (radians) to which robosuite resets a Panda, without noise. Source: robosuite 1.4.1 and 1.5.1,
/// `models/robots/manipulators/panda_robot.py` (`init_qpos`).
pub const PANDA_RESET: [f64; 7] = [0.0, PI / 16.0, 0.0, -5.0 * PI / 6.0, 0.0, PI - 0.2, PI / 4.0];

impl Model {
    /// World pose of the grip site with robot 0's arm joints at these angles (radians), e.g. [`PANDA_RESET`].
    ///
    /// After a recorded state is loaded into a simulation that was just reset, the controller holds the pose for [`PANDA_RESET`]
    /// until the end of the first step.
    ///
    /// # Errors
    /// If the model lacks the robot or its arm joints `robot0_joint1` to `robot0_joint7`.
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

    /// World pose, in each of these flattened states, of the frame in which a controller of robosuite 1.5 reads commands with
    /// `input_ref_frame = "base"`: the site `robot0_right_center`, or the body `robot0_base` in models without that site. Returns
    /// `None` if the model has neither.
    ///
    /// # Errors
    /// If a state does not belong to this model.
    pub fn command_frames<'a>(
        &self,
        states: impl Iterator<Item = &'a [f64]>,
    ) -> Result<Option<Vec<Isometry3<f64>>>, KinematicsError> {
        let site = self.sites.iter().find(|site| site.name == "robot0_right_center");
        let body = || self.bodies.iter().position(|body| body.name == "robot0_base");
        let Some((body, offset)) = site
            .map(|site| (site.body, site.pose))
            .or_else(|| Some((body()?, Isometry3::identity())))
        else {
            return Ok(None);
        };
        let needed = self.with_ancestors(std::iter::once(body));
        let mut poses = vec![Isometry3::identity(); self.bodies.len()];
        states
            .map(|state| {
                let state = self.split(state)?;
                self.place(state.qpos, needed.iter().copied(), &mut poses)?;
                Ok(poses[body] * offset)
            })
            .collect::<Result<Vec<_>, _>>()
            .map(Some)
    }

    /// Whether robot 0 stands on joints, as a mobile base does.
    #[must_use]
    pub fn moves_its_base(&self) -> bool {
        let base = self.bodies.iter().position(|body| body.name == "robot0_base");
        let ancestors = self.with_ancestors(base.into_iter());
        ancestors.into_iter().any(|body| !self.bodies[body].joints.is_empty())
    }

    /// World poses of the body of an object or fixture in each of these flattened states. `name` is the name of the body, with or
    /// without robosuite's suffixes. Returns `None` if there is no such body.
    ///
    /// # Errors
    /// If a state does not belong to this model.
    pub fn body_poses<'a>(
        &self,
        name: &str,
        states: impl Iterator<Item = &'a [f64]>,
    ) -> Result<Option<Vec<Isometry3<f64>>>, KinematicsError> {
        let named = |ending: &str| {
            let wanted = format!("{name}{ending}");
            self.bodies.iter().position(|body| body.name == wanted)
        };
        let Some(body) = ["_main", "", "_root", "0"].into_iter().find_map(named) else {
            return Ok(None);
        };
        let needed = self.with_ancestors(std::iter::once(body));
        let mut poses = vec![Isometry3::identity(); self.bodies.len()];
        states
            .map(|state| {
                let state = self.split(state)?;
                self.place(state.qpos, needed.iter().copied(), &mut poses)?;
                Ok(poses[body])
            })
            .collect::<Result<Vec<_>, _>>()
            .map(Some)
    }

    /// Computes the poses of robot 0 and an object in each of these flattened states.
    ///
    /// `object` is the object's name in observations: `cube`, `Can`, `SquareNut`.
    ///
    /// # Errors
    /// If the model lacks the robot or the object, or a state does not belong to this model.
    pub fn observe<'a>(
        &self,
        states: impl Iterator<Item = &'a [f64]>,
        object: Option<&str>,
    ) -> Result<Vec<Observed>, KinematicsError> {
        let robot = self.robot(0)?;
        let object = object.map(|name| self.object(name)).transpose()?;
        // Computing only these bodies and their ancestors is faster: most bodies of a scene are neither.
        let site = &self.sites[robot.grip_site.0];
        let requested = [robot.hand.0, site.body].into_iter().chain(object.map(|body| body.0));
        let needed = self.with_ancestors(requested);
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
