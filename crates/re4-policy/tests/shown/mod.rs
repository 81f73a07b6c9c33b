//! Observations that a test gives a policy at one step.
#![allow(dead_code, reason = "each test file uses only some of these items")]

use re4_rollout::{Domain, Image, ObservedPose, PolicyError, Senses};

pub(crate) struct Shown<'a, D: Domain> {
    pub(crate) proprio: D::Proprio,
    /// Whether the pose is available at every step without rendering.
    pub(crate) observes_object: bool,
    pub(crate) object: &'a mut dyn FnMut() -> Result<D::Pose, PolicyError>,
    /// The flag of the estimate.
    pub(crate) flag: Option<&'static str>,
}

impl<D: Domain> Senses<D> for Shown<'_, D> {
    fn proprio(&self) -> D::Proprio {
        self.proprio
    }

    fn observes_object(&self) -> bool {
        self.observes_object
    }

    fn object(&mut self) -> Result<ObservedPose<D>, PolicyError> {
        let pose = (self.object)()?;
        Ok(ObservedPose {
            flag: self.flag,
            ..ObservedPose::known(pose)
        })
    }

    fn image(&mut self, camera: &str) -> Result<&Image, PolicyError> {
        Err(PolicyError::unobservable(format!("there is no camera {camera}")))
    }
}
