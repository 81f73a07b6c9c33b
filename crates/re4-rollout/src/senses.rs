//! What a policy can ask for at a control step.

use crate::{Domain, Env, Image, PolicyError};

/// What a policy can ask for at a control step, each when it asks. The same question gets the same answer until the next step.
pub trait Senses<D: Domain> {
    /// What it feels of its own body.
    fn proprio(&self) -> D::Proprio;

    /// Whether the object's pose is at hand at every step; else each answer takes an image, and a policy may ask less often.
    fn observes_object(&self) -> bool;

    /// Where the object is, as far as that is known. Which frame of the object that is, is up to who tells it, as long as
    /// demonstrations are indexed with the same one.
    ///
    /// # Errors
    /// When it cannot be seen.
    fn object(&mut self) -> Result<D::Pose, PolicyError>;

    /// What a camera shows.
    ///
    /// # Errors
    /// When there is no such camera, or it cannot be rendered.
    fn image(&mut self, camera: &str) -> Result<&Image, PolicyError>;
}

/// An answer to where the object is.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ObservedPose<D: Domain> {
    /// The pose, world frame.
    pub pose: D::Pose,
    /// How sure the estimator is, from 0 to 1, where it says so.
    pub confidence: Option<f64>,
    /// What the estimator remarks of the image, where it does.
    pub flag: Option<&'static str>,
}

/// Says where the object is in images, and sees nothing else.
pub trait Estimator<D: Domain> {
    /// The object's pose in an image.
    ///
    /// # Errors
    /// When it cannot be seen.
    fn estimate(&mut self, image: &Image) -> Result<ObservedPose<D>, PolicyError>;
}

/// Puts an error on a pose, at every call anew.
pub type Errors<D> = Box<dyn FnMut(&<D as Domain>::Pose) -> <D as Domain>::Pose>;

/// Where the object's pose comes from in one episode.
pub enum Source<D: Domain> {
    /// The simulator.
    Recorded,
    /// The simulator, with errors made on purpose.
    Noisy(Errors<D>),
    /// What an estimator says of the images of a camera. Nothing else leads from the true pose to the policy.
    Image {
        /// Name of the camera.
        camera: String,
        /// Who looks at its images.
        estimator: Box<dyn Estimator<D>>,
    },
}

/// What a policy asked for at a control step.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Asked<D: Domain> {
    /// What it was told of the object's pose; none where it did not ask.
    pub object: Option<ObservedPose<D>>,
    /// Images rendered for it or for the estimator.
    pub images: u32,
}

/// The senses in an environment, which keep count.
pub(crate) struct Sensing<'a, D: Domain> {
    pub(crate) env: &'a mut dyn Env<D>,
    source: Source<D>,
    /// Images by camera, and whether they show the present state.
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

    /// What was asked since the last call; the next questions are about the state to come.
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

/// The image of a camera, rendered unless it was since the last step.
fn shot<'i, D: Domain>(
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

    fn object(&mut self) -> Result<D::Pose, PolicyError> {
        if let Some(told) = &self.asked.object {
            return Ok(told.pose);
        }
        let recorded = |pose| ObservedPose {
            pose,
            confidence: None,
            flag: None,
        };
        let told = match &mut self.source {
            Source::Recorded => recorded(self.env.object()),
            Source::Noisy(perturb) => recorded(perturb(&self.env.object())),
            Source::Image { camera, estimator } => {
                let image = shot(&mut self.images, camera, self.env, &mut self.asked.images)?;
                estimator.estimate(image)?
            }
        };
        self.asked.object = Some(told);
        Ok(told.pose)
    }

    fn image(&mut self, camera: &str) -> Result<&Image, PolicyError> {
        shot(&mut self.images, camera, self.env, &mut self.asked.images)
    }
}
