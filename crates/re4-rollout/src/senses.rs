//! Observations that a policy can request at a control step.

use std::collections::VecDeque;

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

    /// Returns the motion from the world frame to the frame of the observations and actions, or `None` if that is the world
    /// frame. If the goal of the episode is not that of the demonstrations, proprioception, object pose and images are those that
    /// an observer at the demonstrations' place relative to the goal would have, and actions are in the same frame. A policy
    /// needs the motion only if it uses something that does not move with the goal, such as the walls of Push-T.
    fn observed_from_world(&self) -> Option<D::Motion> {
        None
    }

    /// Returns the age of the observations in control steps. In the first steps of an episode, the observations are those after the
    /// reset, which are less old.
    fn latency(&self) -> u32 {
        0
    }

    /// Returns the observed object pose: the true pose, the true pose with simulated errors, or the estimate
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
    /// The pose, in the frame of the observations ([`Senses::observed_from_world`]).
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
    /// The observed object pose in the world frame, or `None` if the policy did not request it.
    pub object: Option<ObservedPose<D>>,
    /// Number of images rendered for the policy or for the estimator.
    pub images: u32,
}

/// What is observed of a state: enough to answer every request of a policy.
struct Moment<D: Domain> {
    proprio: D::Proprio,
    object: D::Pose,
    view: D::View,
}

/// An image of a camera. The buffer is reused from step to step.
struct Shot {
    camera: String,
    /// Whether the camera is moved to the frame of the observations.
    moved: bool,
    image: Image,
    /// Whether the image shows the observed state.
    fresh: bool,
}

/// Implements [`Senses`] for an environment and records the requests.
pub(crate) struct Sensing<'a, D: Domain> {
    pub(crate) env: &'a mut dyn Env<D>,
    source: Source<D>,
    observed_from_world: Option<D::Motion>,
    latency: usize,
    /// The last states, the oldest first, which is the one that is observed. Empty without latency: then the current state is
    /// observed.
    moments: VecDeque<Moment<D>>,
    shots: Vec<Shot>,
    asked: Asked<D>,
}

impl<'a, D: Domain> Sensing<'a, D> {
    /// Observations are `latency` control steps old.
    pub(crate) fn new(
        env: &'a mut dyn Env<D>,
        source: Source<D>,
        observed_from_world: Option<D::Motion>,
        latency: u32,
    ) -> Self {
        Self {
            env,
            source,
            observed_from_world,
            latency: latency as usize,
            moments: VecDeque::new(),
            shots: Vec::new(),
            asked: Asked {
                object: None,
                images: 0,
            },
        }
    }

    /// Called before every control step.
    pub(crate) fn begin(&mut self) {
        if self.latency == 0 {
            return;
        }
        self.moments.push_back(Moment {
            proprio: self.env.proprio(),
            object: self.env.object(),
            view: self.env.view(),
        });
        // In the first steps of an episode, the state after the reset is the oldest one.
        if self.moments.len() > self.latency + 1 {
            self.moments.pop_front();
        }
    }

    /// Returns the requests since the last call and invalidates the images, so that later requests observe the next state.
    pub(crate) fn finish(&mut self) -> Asked<D> {
        for shot in &mut self.shots {
            shot.fresh = false;
        }
        let none = Asked {
            object: None,
            images: 0,
        };
        std::mem::replace(&mut self.asked, none)
    }

    /// Takes the image of a camera unless it shows the observed state already, and returns its index. `moved`: in the frame of the
    /// observations.
    fn shoot(&mut self, camera: &str, moved: bool) -> Result<usize, PolicyError> {
        let moved = moved && self.observed_from_world.is_some();
        let known = |shot: &Shot| shot.camera == camera && shot.moved == moved;
        let at = self.shots.iter().position(known).unwrap_or_else(|| {
            self.shots.push(Shot {
                camera: camera.to_owned(),
                moved,
                image: Image::default(),
                fresh: false,
            });
            self.shots.len() - 1
        });
        let shot = &mut self.shots[at];
        if !shot.fresh {
            let motion = self.observed_from_world.as_ref().filter(|_| moved);
            if let Some(moment) = self.moments.front() {
                self.env.render(&moment.view, motion, camera, &mut shot.image)?;
            } else {
                let view = self.env.view();
                self.env.render(&view, motion, camera, &mut shot.image)?;
            }
            self.asked.images += 1;
            shot.fresh = true;
        }
        Ok(at)
    }

    /// Returns the observed object pose in the world frame.
    fn observe(&mut self) -> Result<ObservedPose<D>, PolicyError> {
        let camera = match &self.source {
            Source::Image { camera, .. } => Some(camera.clone()),
            _ => None,
        };
        // The estimator is calibrated for the camera of the demonstrations, which does not move.
        let shot = camera.map(|camera| self.shoot(&camera, false)).transpose()?;
        let object = self
            .moments
            .front()
            .map_or_else(|| self.env.object(), |moment| moment.object);
        match (&mut self.source, shot) {
            (Source::Image { estimator, .. }, Some(at)) => estimator.estimate(&self.shots[at].image),
            (Source::Noisy(perturb), _) => Ok(ObservedPose::known(perturb(&object))),
            _ => Ok(ObservedPose::known(object)),
        }
    }
}

impl<D: Domain> Senses<D> for Sensing<'_, D> {
    fn proprio(&self) -> D::Proprio {
        let proprio = self
            .moments
            .front()
            .map_or_else(|| self.env.proprio(), |moment| moment.proprio);
        match &self.observed_from_world {
            Some(motion) => D::proprio_in(motion, &proprio),
            None => proprio,
        }
    }

    fn observes_object(&self) -> bool {
        !matches!(self.source, Source::Image { .. })
    }

    fn observed_from_world(&self) -> Option<D::Motion> {
        self.observed_from_world
    }

    fn latency(&self) -> u32 {
        self.latency as u32
    }

    fn object(&mut self) -> Result<ObservedPose<D>, PolicyError> {
        let observed = match self.asked.object {
            Some(observed) => observed,
            None => self.observe()?,
        };
        self.asked.object = Some(observed);
        Ok(match &self.observed_from_world {
            Some(motion) => ObservedPose {
                pose: D::pose_in(motion, &observed.pose),
                ..observed
            },
            None => observed,
        })
    }

    fn image(&mut self, camera: &str) -> Result<&Image, PolicyError> {
        let at = self.shoot(camera, true)?;
        Ok(&self.shots[at].image)
    }
}
