//! Forward kinematics of `MuJoCo` models, for the features that robosuite's `model_file` uses.
//!
//! A flattened state is `[time, qpos, qvel]`. `qpos` contains the joints in the depth-first order of their bodies. Source:
//! `MuJoCo`'s documentation, chapters "XML Reference" and "Computation" (kinematics).

mod names;
mod observe;
mod parse;

use nalgebra::{Isometry3, Quaternion, Translation3, Unit, UnitQuaternion, Vector3};
use thiserror::Error;

pub use names::Robot;
pub use observe::{Observed, PANDA_RESET};

/// The motion that a joint allows.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum JointKind {
    /// Any motion. `qpos` has 7 numbers: position (metres) and quaternion (w first). `qvel` has 6.
    Free,
    /// Any rotation. `qpos` has 4 numbers: a quaternion (w first). `qvel` has 3.
    Ball,
    /// A translation along an axis, in metres.
    Slide,
    /// A rotation about an axis, in radians.
    Hinge,
}

impl JointKind {
    /// How many numbers of `qpos` belong to the joint.
    #[must_use]
    pub fn positions(self) -> usize {
        match self {
            Self::Free => 7,
            Self::Ball => 4,
            Self::Slide | Self::Hinge => 1,
        }
    }

    /// How many numbers of `qvel` belong to the joint.
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
    /// Name in the model. Empty for an unnamed joint.
    pub name: String,
    /// Its kind.
    pub kind: JointKind,
    /// Index of its first number in `qpos`.
    pub address: usize,
    position: Vector3<f64>,
    axis: Unit<Vector3<f64>>,
    reference: f64,
}

/// A body with its joints. `pose` is its pose in the parent's frame when all joints are at their references.
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

/// Reasons why a model or a state cannot be used. The caller adds the names of the file and the demonstration.
#[derive(Debug, Clone, PartialEq, Error)]
pub enum KinematicsError {
    /// The text is not XML.
    #[error("the model is not valid XML: {0}")]
    Xml(String),
    /// Poses cannot be computed from the model.
    #[error("the model cannot be used: {0}")]
    Model(String),
    /// The model has no part of the robot or object with a known name.
    // Without "; ", which separates a remedy in messages about datasets.
    #[error("the model has no {what}: looked for {sought}, but found {present}")]
    Missing {
        /// Description of the missing part.
        what: String,
        /// The names that were looked for.
        sought: String,
        /// The names of this kind that the model has.
        present: String,
    },
    /// A state or `qpos` has another length than the model needs.
    #[error("a {what} has {got} numbers, but the model needs {need}: state and model do not belong together")]
    Width {
        /// "state" or "qpos".
        what: &'static str,
        /// Its length.
        got: usize,
        /// The length that the model needs.
        need: usize,
    },
    /// A number is NaN or infinite.
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
    /// World pose of a body. The body must be from the model that computed these poses.
    #[must_use]
    pub fn body(&self, body: BodyId) -> &Isometry3<f64> {
        &self.bodies[body.0]
    }

    /// World pose of a site. The site must be from the model that computed these poses.
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
    /// Parses a merged MJCF model.
    ///
    /// Frames, includes, replicas and attachments are refused. Models that `MuJoCo` or robosuite saved do not contain them.
    ///
    /// # Errors
    /// If the text is not XML, not MJCF, or uses an unsupported feature. The error names the element.
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
    /// If its length differs from [`Model::state_width`].
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
    /// Quaternions in `qpos` are normalised first, as in `MuJoCo`.
    ///
    /// # Errors
    /// If the length of `qpos` differs from [`Model::positions`], or one of its numbers is not finite.
    pub fn forward(&self, qpos: &[f64]) -> Result<Poses, KinematicsError> {
        let mut bodies = vec![Isometry3::identity(); self.bodies.len()];
        self.place(qpos, 0..self.bodies.len(), &mut bodies)?;
        let sites = self.sites.iter().map(|site| bodies[site.body] * site.pose).collect();
        Ok(Poses { bodies, sites })
    }

    /// Computes the world poses of the bodies with these indices. The indices must be in ascending order and include all
    /// ancestors.
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
            let at_reference = if index == 0 {
                body.pose
            } else {
                poses[body.parent] * body.pose
            };
            poses[index] = body.joints.iter().fold(at_reference, |pose, joint| {
                joint.apply(pose, &qpos[joint.address..joint.address + joint.kind.positions()])
            });
        }
        Ok(())
    }

    /// The indices of bodies and all their ancestors, in ascending order.
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

/// Converts a quaternion (w first) to a rotation. As in `MuJoCo`, zeros give the identity.
fn rotation_wxyz(q: &[f64]) -> UnitQuaternion<f64> {
    UnitQuaternion::try_new(Quaternion::new(q[0], q[1], q[2], q[3]), 1e-15).unwrap_or_default()
}

impl Joint {
    /// Applies the joint's motion to the pose of its body. `q` contains the joint's numbers in `qpos`.
    fn apply(&self, pose: Isometry3<f64>, q: &[f64]) -> Isometry3<f64> {
        // A rotation does not move the anchor of the joint.
        let about_anchor = |rotation: UnitQuaternion<f64>| {
            let rotated = pose.rotation * rotation;
            let anchor = pose.rotation * self.position + pose.translation.vector;
            Isometry3::from_parts(Translation3::from(anchor - rotated * self.position), rotated)
        };
        match self.kind {
            // The parent of a free body is the world, so the joint gives its world pose.
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
