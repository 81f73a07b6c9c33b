//! Lookup of the robot and the objects in models of different robosuite versions.
//!
//! | robosuite | grip site | hand body | finger joints | cube |
//! |---|---|---|---|---|
//! | 1.0.1 | `gripper0_grip_site` | `robot0_right_hand` | `gripper0_finger_joint1`, `2` | `cube` |
//! | 1.4.1 | `gripper0_grip_site` | `robot0_right_hand` | `gripper0_finger_joint1`, `2` | `cube_main` |
//! | 1.5.1 | `gripper0_right_grip_site` | `robot0_right_hand` | `gripper0_right_finger_joint1`, `2` | `cube_main` |

use nalgebra::Isometry3;

use super::{BodyId, JointKind, KinematicsError, Model, SiteId};

/// The parts of a robot's end effector in a model.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Robot {
    /// The grip site. Its position is `robot0_eef_pos`, and the controller controls its pose.
    pub grip_site: SiteId,
    /// The hand body. Its orientation is `robot0_eef_quat`.
    pub hand: BodyId,
    /// Indices in `qpos` of the two finger joints, in the order of `robot0_gripper_qpos`. `None` unless the gripper has exactly
    /// two sliding fingers.
    pub fingers: Option<[usize; 2]>,
}

impl Robot {
    /// The finger positions `robot0_gripper_qpos`, in metres. Returns `None` unless the gripper has exactly two sliding fingers.
    #[must_use]
    pub fn gripper_qpos(&self, qpos: &[f64]) -> Option<[f64; 2]> {
        let [first, second] = self.fingers?;
        Some([*qpos.get(first)?, *qpos.get(second)?])
    }
}

/// The index of the first name in `exact` that is among `names`, else of the only name that ends with `suffix`.
fn find<'a>(
    what: &str,
    names: impl Iterator<Item = &'a str> + Clone,
    exact: &[String],
    suffix: &str,
) -> Result<usize, KinematicsError> {
    for name in exact {
        if let Some(index) = names.clone().position(|candidate| candidate == name) {
            return Ok(index);
        }
    }
    let ending: Vec<usize> = names
        .clone()
        .enumerate()
        .filter(|(_, name)| name.ends_with(suffix))
        .map(|(index, _)| index)
        .collect();
    if let [index] = ending[..] {
        return Ok(index);
    }
    Err(KinematicsError::Missing {
        what: what.to_owned(),
        sought: format!("{} and for the only name that ends with {suffix}", exact.join(", ")),
        present: listed(names),
    })
}

/// Formats at most twelve names for an error message.
pub(super) fn listed<'a>(names: impl Iterator<Item = &'a str>) -> String {
    let names: Vec<&str> = names.filter(|name| !name.is_empty()).collect();
    match names.len() {
        0 => "no names".to_owned(),
        1..=12 => names.join(", "),
        more => format!("{} and {} more", names[..12].join(", "), more - 12),
    }
}

impl Model {
    /// Finds the robot with this number (0 if there is only one).
    ///
    /// # Errors
    /// If the grip site or the hand body has no known name, or several names match.
    pub fn robot(&self, number: usize) -> Result<Robot, KinematicsError> {
        let sites = self.sites.iter().map(|site| site.name.as_str());
        let bodies = self.bodies.iter().map(|body| body.name.as_str());
        let grip_site = find(
            &format!("grip site of robot {number}"),
            sites,
            &[
                format!("gripper{number}_grip_site"),
                format!("gripper{number}_right_grip_site"),
            ],
            "grip_site",
        )?;
        let hand = find(
            &format!("hand body of robot {number}"),
            bodies,
            &[format!("robot{number}_right_hand")],
            "right_hand",
        )?;
        // Names of finger joints differ between versions, so that they are found as the joints of the hand body's descendants.
        let below = |mut body: usize| {
            while body > hand {
                body = self.bodies[body].parent;
            }
            body == hand
        };
        let bodies = self.bodies.iter().enumerate();
        let joints: Vec<_> = bodies
            .filter(|(index, _)| *index != hand && below(*index))
            .flat_map(|(_, body)| &body.joints)
            .collect();
        let fingers = match joints[..] {
            [first, second] if first.kind == JointKind::Slide && second.kind == JointKind::Slide => {
                Some([first.address, second.address])
            }
            _ => None,
        };
        Ok(Robot {
            grip_site: SiteId(grip_site),
            hand: BodyId(hand),
            fingers,
        })
    }

    /// World pose of robot 0's base, the body `robot0_base`. Returns `None` if the model has no such body or the body can move.
    #[must_use]
    pub fn base(&self) -> Option<Isometry3<f64>> {
        let mut body = self.bodies.iter().position(|body| body.name == "robot0_base")?;
        let mut pose = Isometry3::identity();
        loop {
            let own = &self.bodies[body];
            if !own.joints.is_empty() {
                return None;
            }
            pose = own.pose * pose;
            if body == 0 {
                return Some(pose);
            }
            body = own.parent;
        }
    }

    /// Finds the free body of an object by its name in observations: `cube`, `Can`, `SquareNut`.
    ///
    /// # Errors
    /// If no free body has this name, with or without robosuite's suffixes `_main` and `0`.
    pub fn object(&self, name: &str) -> Result<BodyId, KinematicsError> {
        for ending in ["_main", "", "0"] {
            let wanted = format!("{name}{ending}");
            if let Some((body, _)) = self.free_bodies().find(|(_, body)| *body == wanted) {
                return Ok(body);
            }
        }
        Err(KinematicsError::Missing {
            what: format!("free body of the object {name}"),
            sought: format!("{name}_main, {name} and {name}0"),
            present: listed(self.free_bodies().map(|(_, name)| name)),
        })
    }
}
