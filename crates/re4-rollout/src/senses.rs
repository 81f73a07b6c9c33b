//! Observations that a policy can request at a control step.

use crate::{Domain, Env, Image, PolicyError};

/// The observations of the current control step, each computed when the policy requests it.
///
/// Repeated requests within a control step return the same answer and cost nothing. The harness records what the policy
/// requested. This interface is the only access that a policy has to the simulation; in particular, with poses from images there
/// is no access to the true object pose.
pub trait Senses<D: Domain> {
    /// Returns the proprioception, which is always available: the position of the pusher, or the pose of the grip site and the
    /// joint positions of the fingers.
    fn proprio(&self) -> D::Proprio;

    /// Returns whether the object pose is available without rendering an image. If not, every observation of the object pose
    /// renders an image and runs an estimator, so a policy may request the pose less often.
    fn observes_object(&self) -> bool;

    /// Returns the observed object pose in the world frame: the true pose, the true pose with simulated errors, or the estimate
    /// from an image, depending on the pipeline. The estimate states whether it is doubtful.
    ///
    /// The source of the poses defines which body frame of the object the pose refers to. Demonstrations are indexed with poses
    /// from the same source.
    ///
    /// # Errors
    /// If the object cannot be observed, for example because the image cannot be rendered.
    fn object(&mut self) -> Result<ObservedPose<D>, PolicyError>;

    /// Returns the image of a camera in the current state.
    ///
    /// # Errors
    /// If the camera does not exist or the image cannot be rendered.
    fn image(&mut self, camera: &str) -> Result<&Image, PolicyError>;
}

/// An observation of the object pose.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ObservedPose<D: Domain> {
    /// The pose in the world frame.
    pub pose: D::Pose,
    /// Confidence of the estimator from 0 to 1. `None` if the pose does not come from an estimator, or if the estimator reports
    /// no confidence.
    pub confidence: Option<f64>,
    /// Flag that the estimator assigned to the image, such as `occluded`. `None` if the pose does not come from an estimator, or
    /// if the estimator has no flags.
    pub flag: Option<&'static str>,
}

/// The flag of an estimate that is not doubtful.
pub const CLEAR: &str = "clear";

impl<D: Domain> ObservedPose<D> {
    /// A pose that does not come from an estimator.
    pub fn known(pose: D::Pose) -> Self {
        Self {
            pose,
            confidence: None,
            flag: None,
        }
    }

    /// Whether the estimator flagged the image.
    pub fn is_doubtful(&self) -> bool {
        self.flag.is_some_and(|flag| flag != CLEAR)
    }
}

/// Estimates the object pose from images and has no other input.
///
/// One estimator is used for one episode, so it may keep state between images.
pub trait Estimator<D: Domain> {
    /// Estimates the object pose in an image.
    ///
    /// # Errors
    /// If the image is invalid or the object cannot be located.
    fn estimate(&mut self, image: &Image) -> Result<ObservedPose<D>, PolicyError>;
}

/// Adds a simulated error to a pose. Every call samples a new error.
pub type Errors<D> = Box<dyn FnMut(&<D as Domain>::Pose) -> <D as Domain>::Pose>;

/// The source of the object pose in one episode.
pub enum Source<D: Domain> {
    /// The true pose from the simulator.
    Recorded,
    /// The true pose from the simulator with simulated errors.
    Noisy(Errors<D>),
    /// The estimate from the images of a camera. The policy then has no access to the true pose.
    Image {
        /// Name of the camera.
        camera: String,
        /// The estimator that receives its images.
        estimator: Box<dyn Estimator<D>>,
    },
}

/// The observations that a policy requested at one control step.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Asked<D: Domain> {
    /// The observed object pose, or `None` if the policy did not request it.
    pub object: Option<ObservedPose<D>>,
    /// Number of images rendered for the policy or for the estimator.
    pub images: u32,
}

/// Implements [`Senses`] for an environment and records the requests.
pub(crate) struct Sensing<'a, D: Domain> {
    pub(crate) env: &'a mut dyn Env<D>,
    source: Source<D>,
    /// The images by camera name, with a flag that is true if the image shows the current state. The buffers are reused from step
    /// to step.
    images: Vec<(String, Image, bool)>,
    asked: Asked<D>,
}

impl<'a, D: Domain> Sensing<'a, D> {
    pub(crate) fn new(env: &'a mut dyn Env<D>, source: Source<D>) -> Self {
        Self {
            env,
            source,
            images: Vec::new(),
            asked: Asked {
                object: None,
                images: 0,
            },
        }
    }

    /// Returns the requests since the last call and invalidates the images, so that later requests observe the next state.
    pub(crate) fn finish(&mut self) -> Asked<D> {
        for (_, _, fresh) in &mut self.images {
            *fresh = false;
        }
        let none = Asked {
            object: None,
            images: 0,
        };
        std::mem::replace(&mut self.asked, none)
    }
}

/// Returns the image of a camera, which is rendered if it has not been rendered since the last step.
fn current_image<'i, D: Domain>(
    images: &'i mut Vec<(String, Image, bool)>,
    camera: &str,
    env: &mut dyn Env<D>,
    count: &mut u32,
) -> Result<&'i Image, PolicyError> {
    let at = images.iter().position(|(name, ..)| name == camera).unwrap_or_else(|| {
        images.push((camera.to_owned(), Image::default(), false));
        images.len() - 1
    });
    let (_, image, fresh) = &mut images[at];
    if !*fresh {
        env.render(camera, image)?;
        *count += 1;
        *fresh = true;
    }
    Ok(image)
}

impl<D: Domain> Senses<D> for Sensing<'_, D> {
    fn proprio(&self) -> D::Proprio {
        self.env.proprio()
    }

    fn observes_object(&self) -> bool {
        !matches!(self.source, Source::Image { .. })
    }

    fn object(&mut self) -> Result<ObservedPose<D>, PolicyError> {
        if let Some(observed) = self.asked.object {
            return Ok(observed);
        }
        let observed = match &mut self.source {
            Source::Recorded => ObservedPose::known(self.env.object()),
            Source::Noisy(perturb) => ObservedPose::known(perturb(&self.env.object())),
            Source::Image { camera, estimator } => {
                let image = current_image(&mut self.images, camera, self.env, &mut self.asked.images)?;
                estimator.estimate(image)?
            }
        };
        self.asked.object = Some(observed);
        Ok(observed)
    }

    fn image(&mut self, camera: &str) -> Result<&Image, PolicyError> {
        current_image(&mut self.images, camera, self.env, &mut self.asked.images)
    }
}
