//! Where a policy in space learns of the object's pose.

use nalgebra::Isometry3;
use re4_sim::robosuite::Robosuite;

use crate::PolicyError;
use crate::spatial::{NoiseLevel, SpatialStart};

/// Looks at a simulation and says where the object is, as a camera with a pose estimator behind it does.
///
/// A rollout with an observer tells the policy the pose of the grip site and the joint positions of the fingers at every step,
/// and the object's pose only through the observer, when the policy chooses what to do next: the recorded pose of the object
/// does not reach it otherwise. Its own last gripper command the policy remembers. An observer sees the simulation whole, so
/// that it can draw it; one that stands for a robot's eyes reads nothing else of it.
pub trait Observer {
    /// The object's pose in this state, world frame, metres. Which frame of the object that is, is up to the observer, as long
    /// as demonstrations are indexed with the same one.
    ///
    /// # Errors
    /// [`PolicyError::Look`] when nothing can be seen.
    fn object(&mut self, simulation: &Robosuite) -> Result<Isometry3<f64>, PolicyError>;
}

/// How rollouts learn of the object's pose.
#[derive(Clone, Copy)]
pub enum ObjectSight<'a> {
    /// The simulator's own pose at every control step, with errors made on purpose, which the scene's seed draws.
    Recorded(NoiseLevel),
    /// An observer's, at decisions alone. The function makes the observer of an episode, in the thread that rolls it out.
    Observed(&'a MakeObserver<'a>),
}

/// Makes the observer of an episode.
pub type MakeObserver<'a> = dyn Fn(&SpatialStart) -> Result<Box<dyn Observer>, PolicyError> + Sync + 'a;
