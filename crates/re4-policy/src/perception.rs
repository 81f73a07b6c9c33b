//! What the policy is told of a scene: its true state, or what a picture of it shows.

use std::sync::Arc;

use re4_geometry::{Point2, Pose2};
use re4_pose::{Estimate, Flag, LogPolarEstimator, Picture, SIDE};
use re4_sim::{Canvas, PushT, PushTObservation};

/// What a policy sees of Push-T. World frame, px and radians.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Observation {
    /// Centre of the pusher.
    pub eef: Point2,
    /// Pose of the block's frame.
    pub object: Pose2,
}

impl From<&PushTObservation> for Observation {
    fn from(state: &PushTObservation) -> Self {
        Self {
            eef: state.agent,
            object: state.block,
        }
    }
}

/// How the policy perceives the object.
#[derive(Clone)]
pub enum Perception {
    /// By its true pose.
    State,
    /// By the pose estimated from the picture; of the state itself it is told the pusher's position alone.
    Pictures(Arc<LogPolarEstimator>),
}

/// What was seen before an action.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sight {
    /// What the policy is told.
    pub observation: Observation,
    /// The estimate behind it, where there is a picture. An estimate that is not [`Flag::Clear`] is not told on: the last
    /// clear one is.
    pub estimate: Option<Estimate>,
}

/// Looks at the scene step by step, through one episode.
pub(crate) struct Eyes {
    perception: Perception,
    /// Drawn on from step to step, where there are pictures.
    canvas: Option<Canvas>,
    picture: Vec<u8>,
    last_clear: Option<Pose2>,
}

impl Eyes {
    pub(crate) fn new(perception: Perception) -> Self {
        Self {
            perception,
            canvas: None,
            picture: Vec::new(),
            last_clear: None,
        }
    }

    /// What is to be seen now. None when no block is seen and none was seen before.
    pub(crate) fn look(&mut self, simulator: &PushT) -> Option<Sight> {
        let state = simulator.observation();
        let Perception::Pictures(estimator) = &self.perception else {
            return Some(Sight {
                observation: Observation::from(&state),
                estimate: None,
            });
        };
        let canvas = self.canvas.get_or_insert_default();
        simulator.render_into(canvas);
        canvas.observation_into(&mut self.picture);
        // The renderer's pictures have the size that the estimator wants.
        let estimate = estimator.estimate(&Picture::new(&self.picture, SIDE, SIDE).ok()?);
        if estimate.flag == Flag::Clear {
            self.last_clear = estimate.pose;
        }
        // A doubtful pose is better than none, and worse than a clear one of a moment ago: the block is slow.
        let object = self.last_clear.or(estimate.pose)?;
        Some(Sight {
            observation: Observation {
                eef: state.agent,
                object,
            },
            estimate: Some(estimate),
        })
    }
}
