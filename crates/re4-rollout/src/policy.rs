//! The policy interface: observations in, one action per control step out.

use re4_fault::Remedy;
use std::collections::BTreeSet;
use std::error::Error;
use std::fmt::Debug;
use std::sync::Arc;

use thiserror::Error;

use crate::{Domain, Senses};

/// The part of the policy's loop that an action belongs to.
///
/// The phases are those of RE4. A policy that has no planning phase uses [`Phase::Replay`] for every action.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Phase {
    /// Following a planned path to the start of a chunk (planar tasks).
    Plan,
    /// Moving to the start of a chunk under closed-loop control (tasks in SE(3)).
    Bridge,
    /// Executing a chunk.
    Replay,
    /// Returning to the initial pose of the episode with the gripper open.
    Home,
}

impl Phase {
    /// Returns the name of the phase in tables.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Plan => "plan",
            Self::Bridge => "bridge",
            Self::Replay => "replay",
            Self::Home => "home",
        }
    }
}

/// The action for one control step, and the reason for it.
///
/// `X` is the type of the policy's decision record, [`Policy::Decision`].
#[derive(Debug, Clone, PartialEq)]
pub struct Act<D: Domain, X> {
    /// The action to execute.
    pub action: D::Action,
    /// Part of the policy's loop that the action belongs to.
    pub phase: Phase,
    /// The decision record, if the policy made a decision at this step. Later actions with `None` are attributed to the same
    /// decision, so the first action of an episode should carry a decision.
    pub decision: Option<X>,
    /// The object pose in the world frame on which the policy bases this step, or `None` if it uses no pose. The pose is the
    /// observed pose, a filtered pose or, if the policy did not request an observation at this step, the last pose, assumed fixed
    /// in the world or in the gripper. It is only recorded (column `seen` of table `steps`).
    pub object: Option<D::Pose>,
}

/// A policy during one episode.
///
/// The harness creates a policy with [`PolicyFactory::start`], calls [`Policy::act`] once per control step, and drops the policy
/// at the end of the episode. A policy therefore stores everything that it needs from earlier steps and the actions that it has
/// planned for later steps.
pub trait Policy<D: Domain> {
    /// The decision record, which explains a choice of the policy. To write rollouts to tables, it must implement
    /// [`Explained`](crate::Explained).
    type Decision: Debug + Clone + PartialEq + Send;

    /// Returns the next action.
    ///
    /// The policy reads its observations from `senses`. It need not request the object pose or an image at every step.
    ///
    /// # Errors
    /// If the policy has no action, or a requested observation is not available.
    fn act(&mut self, senses: &mut dyn Senses<D>) -> Result<Act<D, Self::Decision>, PolicyError>;

    /// The demonstrations without which a decision of the episode so far might have been another one; `None` if the policy does not
    /// know them. See [`Trace`](crate::Trace).
    fn considered(&self) -> Option<&BTreeSet<u32>> {
        None
    }
}

/// Starts a policy for every episode.
///
/// A factory owns or shares the read-only data of its policies, such as demonstrations and indices. This data is loaded once
/// before the first episode. Several threads call the same factory.
pub trait PolicyFactory<D: Domain>: Sync {
    /// The type of policy that the factory starts.
    type Policy: Policy<D>;

    /// Number of rollouts to run at the same time if more than one thread is used, or `None` for one per thread. A policy that
    /// computes the actions of several rollouts together returns more than the number of threads.
    fn concurrent(&self) -> Option<usize> {
        None
    }

    /// Creates the policy for an episode. `first` is the proprioception after the reset. `seed` identifies the scene; a policy
    /// that uses random numbers must derive them from `seed` so that rollouts are reproducible.
    fn start(&self, seed: u32, first: &D::Proprio) -> Self::Policy;

    /// Creates the policy for an episode without some demonstrations. The policy reports what its decisions depend on, see
    /// [`Policy::considered`]. Everything that is derived from all demonstrations, such as the ranges that normalise states, stays
    /// as it is with all of them. `None` if that is not possible, for instance because a network was trained on them.
    fn start_without(&self, _seed: u32, _first: &D::Proprio, _without: &Arc<BTreeSet<u32>>) -> Option<Self::Policy> {
        None
    }
}

/// An error that prevents a policy from acting.
#[derive(Debug, Error, Remedy)]
pub enum PolicyError {
    /// The estimator found no block in the current image or in any earlier image.
    #[error("neither the current image nor an earlier image shows the block")]
    #[remedy("start from a scene in which the block is visible")]
    BlockNeverVisible,
    /// An observation that the policy requested is not available.
    #[error("cannot observe the scene: {source}")]
    Unobservable {
        /// The reason, as a clause without a capital letter or a full stop.
        source: Box<dyn Error + Send + Sync>,
    },
    /// An error of the policy's own type.
    #[error("{0}")]
    Own(#[from] Box<dyn Error + Send + Sync>),
}

impl PolicyError {
    /// Creates a [`PolicyError::Unobservable`] from the reason why an observation is not available.
    pub fn unobservable(error: impl Into<Box<dyn Error + Send + Sync>>) -> Self {
        Self::Unobservable { source: error.into() }
    }

    pub(crate) fn no_camera(camera: &str) -> Self {
        Self::unobservable(format!("the scene has no camera {camera:?}"))
    }
}
