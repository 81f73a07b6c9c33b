//! Forward kinematics of `MuJoCo` models, as far as robosuite's `model_file` needs it.
//!
//! A flattened state is `[time, qpos, qvel]`; `qpos` holds joints in the depth-first order of bodies. Source: `MuJoCo`'s
//! documentation, chapters "XML Reference" and "Computation" (kinematics).

mod names;
mod observe;
mod parse;

use nalgebra::{Isometry3, Quaternion, Translation3, Unit, UnitQuaternion, Vector3};
use thiserror::Error;

pub use names::Robot;
pub use observe::{Observed, PANDA_RESET};

/// What a joint adds to the pose of its body.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum JointKind {
    /// Position and quaternion (w first): 7 numbers of `qpos`, 6 of `qvel`.
    Free,
    /// Quaternion (w first): 4 numbers of `qpos`, 3 of `qvel`.
    Ball,
    /// Metres along the axis.
    Slide,
    /// Radians about the axis.
    Hinge,
}

impl JointKind {
    /// Numbers of the joint in `qpos`.
    #[must_use]
    pub fn positions(self) -> usize {
        match self {
            Self::Free => 7,
            Self::Ball => 4,
            Self::Slide | Self::Hinge => 1,
        }
    }

    /// Numbers of the joint in `qvel`.
    #[must_use]
    pub fn velocities(self) -> usize {
        match self {
            Self::Free => 6,
            Self::Ball => 3,
            Self::Slide | Self::Hinge => 1,
        }
    }
}

/// A joint of a body.
#[derive(Debug, Clone, PartialEq)]
pub struct Joint {
    /// Name in the model, empty where it has none.
    pub name: String,
    /// Its kind.
    pub kind: JointKind,
    /// Index of its first number in `qpos`.
    pub address: usize,
    position: Vector3<f64>,
    axis: Unit<Vector3<f64>>,
    reference: f64,
}

/// A body: the pose in its parent with all joints at their reference, and its joints.
#[derive(Debug, Clone, PartialEq)]
struct Body {
    name: String,
    parent: usize,
    pose: Isometry3<f64>,
    joints: Vec<Joint>,
}

#[derive(Debug, Clone, PartialEq)]
struct Site {
    name: String,
    body: usize,
    pose: Isometry3<f64>,
}

/// A body of a [`Model`].
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub struct BodyId(usize);

/// A site of a [`Model`].
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub struct SiteId(usize);

/// Why a model or a state cannot be used. The caller says in which file and demo it is.
#[derive(Debug, Clone, PartialEq, Error)]
pub enum KinematicsError {
    /// The text is not XML.
    #[error("the model is not readable as XML: {0}")]
    Xml(String),
    /// The XML is not a model that poses can be computed from.
    #[error("the model cannot be used: {0}")]
    Model(String),
    /// A part of the robot or an object is not in the model under any known name.
    #[error("the model has no {what}: looked for {sought}; it has {present}")]
    Missing {
        /// What was sought, in words.
        what: String,
        /// The names looked for.
        sought: String,
        /// What there is of that kind.
        present: String,
    },
    /// A state or `qpos` of another width than the model's.
    #[error("a {what} has {got} numbers, but the model needs {need}: state and model do not belong together")]
    Width {
        /// "state" or "qpos".
        what: &'static str,
        /// Its width.
        got: usize,
        /// The model's width.
        need: usize,
    },
    /// A number that is NaN or infinite.
    #[error("qpos[{index}] is {value}, not a finite number")]
    NotFinite {
        /// Index in `qpos`.
        index: usize,
        /// The number.
        value: f64,
    },
}

/// A kinematic tree with sites.
#[derive(Debug, Clone, PartialEq)]
pub struct Model {
    // Parents come before their children; the first body is the world.
    bodies: Vec<Body>,
    sites: Vec<Site>,
    positions: usize,
    velocities: usize,
}

/// World poses of all bodies and sites of a model.
#[derive(Debug, Clone, PartialEq)]
pub struct Poses {
    bodies: Vec<Isometry3<f64>>,
    sites: Vec<Isometry3<f64>>,
}

impl Poses {
    /// World pose of a body of the model that made these poses.
    #[must_use]
    pub fn body(&self, body: BodyId) -> &Isometry3<f64> {
        &self.bodies[body.0]
    }

    /// World pose of a site of the model that made these poses.
    #[must_use]
    pub fn site(&self, site: SiteId) -> &Isometry3<f64> {
        &self.sites[site.0]
    }
}

/// The parts of a flattened `MuJoCo` state.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct State<'a> {
    /// Seconds.
    pub time: f64,
    /// Joint positions.
    pub qpos: &'a [f64],
    /// Joint velocities.
    pub qvel: &'a [f64],
}

impl Model {
    /// Reads a merged MJCF model.
    ///
    /// Frames, includes, replicas and attachments are refused: models that `MuJoCo` or robosuite saved have none.
    ///
    /// # Errors
    /// A sentence that names the element, where the text is no XML, no MJCF, or needs what is not known here.
    pub fn parse(mjcf_xml: &str) -> Result<Self, KinematicsError> {
        parse::parse(mjcf_xml)
    }

    /// Length of `qpos`.
    #[must_use]
    pub fn positions(&self) -> usize {
        self.positions
    }

    /// Length of `qvel`.
    #[must_use]
    pub fn velocities(&self) -> usize {
        self.velocities
    }

    /// Length of a flattened state `[time, qpos, qvel]`.
    #[must_use]
    pub fn state_width(&self) -> usize {
        1 + self.positions + self.velocities
    }

    /// Joints in the order of `qpos`.
    pub fn joints(&self) -> impl Iterator<Item = &Joint> {
        self.bodies.iter().flat_map(|body| &body.joints)
    }

    /// Bodies with a free joint, in the order of `qpos`, with their names.
    pub fn free_bodies(&self) -> impl Iterator<Item = (BodyId, &str)> {
        let free = |body: &Body| body.joints.iter().any(|joint| joint.kind == JointKind::Free);
        let bodies = self.bodies.iter().enumerate();
        bodies
            .filter(move |(_, body)| free(body))
            .map(|(index, body)| (BodyId(index), body.name.as_str()))
    }

    /// Name of a body.
    #[must_use]
    pub fn body_name(&self, body: BodyId) -> &str {
        &self.bodies[body.0].name
    }

    /// Name of a site.
    #[must_use]
    pub fn site_name(&self, site: SiteId) -> &str {
        &self.sites[site.0].name
    }

    /// Splits a flattened state.
    ///
    /// # Errors
    /// When it has another width than the model's.
    pub fn split<'a>(&self, state: &'a [f64]) -> Result<State<'a>, KinematicsError> {
        if state.len() != self.state_width() {
            return Err(KinematicsError::Width {
                what: "state",
                got: state.len(),
                need: self.state_width(),
            });
        }
        let (qpos, qvel) = state[1..].split_at(self.positions);
        Ok(State {
            time: state[0],
            qpos,
            qvel,
        })
    }

    /// World poses of all bodies and sites.
    ///
    /// Quaternions in `qpos` are normalised first, as `MuJoCo` does.
    ///
    /// # Errors
    /// When `qpos` has another length than the model's or holds a number that is not finite.
    pub fn forward(&self, qpos: &[f64]) -> Result<Poses, KinematicsError> {
        let mut bodies = vec![Isometry3::identity(); self.bodies.len()];
        self.place(qpos, 0..self.bodies.len(), &mut bodies)?;
        let sites = self.sites.iter().map(|site| bodies[site.body] * site.pose).collect();
        Ok(Poses { bodies, sites })
    }

    /// World poses of some bodies, ancestors before their descendants and none left out.
    fn place(
        &self,
        qpos: &[f64],
        indices: impl Iterator<Item = usize>,
        poses: &mut [Isometry3<f64>],
    ) -> Result<(), KinematicsError> {
        if qpos.len() != self.positions {
            return Err(KinematicsError::Width {
                what: "qpos",
                got: qpos.len(),
                need: self.positions,
            });
        }
        if let Some(index) = qpos.iter().position(|value| !value.is_finite()) {
            return Err(KinematicsError::NotFinite {
                index,
                value: qpos[index],
            });
        }
        for index in indices {
            let body = &self.bodies[index];
            let drawn = if index == 0 {
                body.pose
            } else {
                poses[body.parent] * body.pose
            };
            poses[index] = body.joints.iter().fold(drawn, |pose, joint| {
                joint.apply(pose, &qpos[joint.address..joint.address + joint.kind.positions()])
            });
        }
        Ok(())
    }

    /// Bodies and all their ancestors, in the order of [`Model::place`].
    fn with_ancestors(&self, bodies: impl Iterator<Item = usize>) -> Vec<usize> {
        let mut needed = vec![false; self.bodies.len()];
        for mut index in bodies {
            while !needed[index] {
                needed[index] = true;
                index = self.bodies[index].parent;
            }
        }
        (0..needed.len()).filter(|index| needed[*index]).collect()
    }
}

/// A quaternion with w first; the identity where all numbers are zero, as in `MuJoCo`.
fn rotation_wxyz(q: &[f64]) -> UnitQuaternion<f64> {
    UnitQuaternion::try_new(Quaternion::new(q[0], q[1], q[2], q[3]), 1e-15).unwrap_or_default()
}

impl Joint {
    /// The pose of the body after this joint.
    fn apply(&self, pose: Isometry3<f64>, q: &[f64]) -> Isometry3<f64> {
        // Rotations leave the joint's anchor where it is.
        let about_anchor = |rotation: UnitQuaternion<f64>| {
            let turned = pose.rotation * rotation;
            let anchor = pose.rotation * self.position + pose.translation.vector;
            Isometry3::from_parts(Translation3::from(anchor - turned * self.position), turned)
        };
        match self.kind {
            // A free body hangs on the world: its pose is the joint's.
            JointKind::Free => Isometry3::from_parts(Translation3::new(q[0], q[1], q[2]), rotation_wxyz(&q[3..])),
            JointKind::Ball => about_anchor(rotation_wxyz(q)),
            JointKind::Hinge => about_anchor(UnitQuaternion::from_axis_angle(&self.axis, q[0] - self.reference)),
            JointKind::Slide => {
                let shift = pose.rotation * (self.axis.into_inner() * (q[0] - self.reference));
                Isometry3::from_parts(Translation3::from(pose.translation.vector + shift), pose.rotation)
            }
        }
    }
}
