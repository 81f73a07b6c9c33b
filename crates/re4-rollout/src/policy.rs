//! What answers actions.

use re4_fault::Remedy;
use std::error::Error;
use std::fmt::Debug;

use thiserror::Error;

use crate::{Domain, Senses};

/// Which part of a policy's loop an action belongs to.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Phase {
    /// On the planned way to the start of a chunk, in the plane.
    Plan,
    /// On the way to the start of a chunk, in space.
    Bridge,
    /// Executing a chunk.
    Replay,
    /// On the way to the pose of the episode's beginning, the gripper open.
    Home,
}

impl Phase {
    /// The word used in tables.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Plan => "plan",
            Self::Bridge => "bridge",
            Self::Replay => "replay",
            Self::Home => "home",
        }
    }
}

/// One action, and why it was taken.
#[derive(Debug, Clone, PartialEq)]
pub struct Act<D: Domain, X> {
    /// What to send.
    pub action: D::Action,
    /// Part of the loop that the action belongs to.
    pub phase: Phase,
    /// The decision that the action starts, if it starts one.
    pub decision: Option<X>,
    /// Where the policy takes the object to be at this step, world frame, where it goes by a pose: the one that it was told, the
    /// average of those, or, where it did not ask, the last of them at rest in the world or in the gripper.
    pub object: Option<D::Pose>,
}

/// A policy in the middle of an episode: it is asked at every control step, and keeps what it needs of earlier steps and what
/// it has planned for later ones.
pub trait Policy<D: Domain> {
    /// Why it does what it does: one record a decision.
    type Decision: Debug + Clone + PartialEq + Send;

    /// The next action.
    ///
    /// # Errors
    /// When the policy has no action, or what it asks for cannot be sensed.
    fn act(&mut self, senses: &mut dyn Senses<D>) -> Result<Act<D, Self::Decision>, PolicyError>;
}

/// Starts a policy for every episode. What it knows is opened before and shared.
pub trait PolicyFactory<D: Domain>: Sync {
    /// What it starts.
    type Policy: Policy<D>;

    /// A policy at the beginning of an episode. The seed of the scene drives the policy's random numbers; `first` is what is
    /// felt after the reset.
    fn start(&self, seed: u32, first: &D::Proprio) -> Self::Policy;
}

/// Why a policy cannot act.
#[derive(Debug, Error, Remedy)]
pub enum PolicyError {
    /// No block in the first image.
    #[error("no block is seen in the image and none was seen before")]
    #[remedy("start from a scene that shows it")]
    Blind,
    /// Nobody tells where the object is.
    #[error("cannot retrieve: the object's pose is not known, since {source}")]
    Look {
        /// Why, in words that go on from there.
        source: Box<dyn Error + Send + Sync>,
    },
    /// Reasons of the policy's own.
    #[error("{0}")]
    Own(#[from] Box<dyn Error + Send + Sync>),
}

impl PolicyError {
    /// What cannot be seen, by the error that says why.
    pub fn look(error: impl Into<Box<dyn Error + Send + Sync>>) -> Self {
        Self::Look { source: error.into() }
    }

    pub(crate) fn no_camera(camera: &str) -> Self {
        Self::look(format!("the scene has no camera {camera:?}"))
    }
}
