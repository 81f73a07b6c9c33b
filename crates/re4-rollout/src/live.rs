//! Policies whose observations come from outside of the harness, such as those of a program that runs its own simulator or robot.

use re4_episode::DemoNames;

use crate::{
    Domain, Estimator, Explained, Explanation, Image, ObservedPose, Phase, Policy, PolicyError, PolicyFactory, Senses,
};

/// The action for one control step, with the explanation of the decision that was made at this step.
#[derive(Debug, Clone, PartialEq)]
pub struct Acted<D: Domain> {
    /// The action to execute, in the frame of the observations.
    pub action: D::Action,
    /// Part of the policy's loop that the action belongs to.
    pub phase: Phase,
    /// The decision, or `None` if the action follows from an earlier one.
    pub decision: Option<Explanation<D>>,
}

/// A policy during one episode, with its type erased.
pub trait Acting<D: Domain>: Send {
    /// Returns the next action. To be called once per control step.
    ///
    /// # Errors
    /// If the policy has no action, or a requested observation is not available.
    fn act(&mut self, senses: &mut dyn Senses<D>) -> Result<Acted<D>, PolicyError>;
}

/// Implements [`Acting`] for a policy.
struct Live<P> {
    policy: P,
    names: DemoNames,
}

impl<D: Domain, P: Policy<D> + Send> Acting<D> for Live<P>
where
    P::Decision: Explained<D>,
{
    fn act(&mut self, senses: &mut dyn Senses<D>) -> Result<Acted<D>, PolicyError> {
        let act = self.policy.act(senses)?;
        Ok(Acted {
            action: act.action,
            phase: act.phase,
            decision: act.decision.map(|decision| decision.explanation(&self.names)),
        })
    }
}

/// Starts a policy for an episode.
pub(crate) fn start<D: Domain, F: PolicyFactory<D>>(
    factory: &F,
    names: &DemoNames,
    seed: u32,
    first: &D::Proprio,
) -> Box<dyn Acting<D>>
where
    F::Policy: Send + 'static,
    <F::Policy as Policy<D>>::Decision: Explained<D>,
{
    Box::new(Live {
        policy: factory.start(seed, first),
        names: names.clone(),
    })
}

/// The observation of one control step, given by the caller. It is in the frame of the demonstrations.
pub struct Given<'a, D: Domain> {
    /// Proprioception.
    pub proprio: D::Proprio,
    /// The object pose, if it is known.
    pub object: Option<D::Pose>,
    /// The image of the estimator's camera, if there is one.
    pub image: Option<&'a Image>,
    /// Estimates the object pose from the image. `None` if the policy observes known poses.
    pub estimator: Option<&'a mut dyn Estimator<D>>,
    /// The estimate of this image, once it was requested.
    observed: Option<ObservedPose<D>>,
}

impl<'a, D: Domain> Given<'a, D> {
    /// An observation with a known object pose.
    pub fn known(proprio: D::Proprio, object: Option<D::Pose>) -> Self {
        Self {
            proprio,
            object,
            image: None,
            estimator: None,
            observed: None,
        }
    }

    /// An observation with an image, from which the estimator computes the object pose when the policy requests it.
    pub fn seen(proprio: D::Proprio, image: Option<&'a Image>, estimator: &'a mut dyn Estimator<D>) -> Self {
        Self {
            proprio,
            object: None,
            image,
            estimator: Some(estimator),
            observed: None,
        }
    }
}

impl<D: Domain> Senses<D> for Given<'_, D> {
    fn proprio(&self) -> D::Proprio {
        self.proprio
    }

    fn observes_object(&self) -> bool {
        self.estimator.is_none()
    }

    fn object(&mut self) -> Result<ObservedPose<D>, PolicyError> {
        let observed = match (self.observed, &mut self.estimator) {
            (Some(observed), _) => observed,
            (None, Some(estimator)) => {
                let image = self
                    .image
                    .ok_or_else(|| PolicyError::unobservable("the observation has no image"))?;
                estimator.estimate(image)?
            }
            (None, None) => self
                .object
                .map(ObservedPose::known)
                .ok_or_else(|| PolicyError::unobservable("the observation has no object pose"))?,
        };
        self.observed = Some(observed);
        Ok(observed)
    }

    /// The image of the observation, whatever the name of the camera.
    fn image(&mut self, _: &str) -> Result<&Image, PolicyError> {
        self.image
            .ok_or_else(|| PolicyError::unobservable("the observation has no image"))
    }
}

#[cfg(test)]
mod tests {
    use re4_geometry::{Point2, Pose2};

    use super::*;
    use crate::Plane;

    /// An estimator that counts its calls.
    struct Counting(u32);

    impl Estimator<Plane> for Counting {
        fn estimate(&mut self, _: &Image) -> Result<ObservedPose<Plane>, PolicyError> {
            self.0 += 1;
            Ok(ObservedPose::known(Pose2::new(f64::from(self.0), 0.0, 0.0)))
        }
    }

    #[test]
    fn an_image_is_estimated_once_and_only_on_request() {
        let image = Image::default();
        let mut estimator = Counting(0);
        let mut given = Given::seen(Point2::new(1.0, 2.0), Some(&image), &mut estimator);
        assert!(!given.observes_object());
        let first = given.object().unwrap();
        assert_eq!(given.object().unwrap(), first);
        assert_eq!(estimator.0, 1);
    }

    #[test]
    fn a_missing_part_of_the_observation_is_an_error() {
        let mut blind = Given::<Plane>::known(Point2::new(1.0, 2.0), None);
        assert!(blind.object().unwrap_err().to_string().contains("no object pose"));
        assert!(blind.image("image").unwrap_err().to_string().contains("no image"));
        let mut estimator = Counting(0);
        let mut dark = Given::seen(Point2::new(1.0, 2.0), None, &mut estimator);
        assert!(dark.object().unwrap_err().to_string().contains("no image"));
    }
}
