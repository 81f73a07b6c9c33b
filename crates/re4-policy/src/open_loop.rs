//! Open-loop replay of demonstrations: executes the recorded actions from the recorded first state without feedback.

use re4_artifact::columns;
use re4_episode::PlanarFrame;
use re4_geometry::periodic_distance;
use re4_sim::{GOAL, PushT, ResetOrder, Scene, SimError, Simulator as _, coverage};

use crate::outcome::Body;

columns! {
    /// Deviation of a replay from its recording at one frame.
    #[domain = "plane"]
    #[derive(Copy)]
    pub struct Divergence {
        /// Distance between the replayed and the recorded pusher.
        #[unit = "px"]
        pub pusher: f64,
        /// Distance between the replayed and the recorded origin of the block frame.
        #[unit = "px"]
        pub block_position: f64,
        /// Shortest angular distance between the replayed and the recorded angle of the block, at least 0.
        #[unit = "rad"]
        pub block_angle: f64,
        /// Root mean square displacement of the points of the block.
        #[unit = "px"]
        pub block: f64,
    }
}

/// An open-loop replay of one demonstration.
#[derive(Debug, Clone, PartialEq)]
pub struct OpenLoop {
    /// Divergence at every recorded frame, including the first.
    pub divergence: Vec<Divergence>,
    /// Recorded coverage at the last recorded frame.
    pub coverage_recorded: f64,
    /// Coverage of the replay at the same frame.
    pub coverage_replayed: f64,
    /// Coverage of the replay after the last action. The recording has no frame after its last action.
    pub coverage_after: f64,
}

/// Replays a demonstration from its first state. Returns `None` for a demonstration without frames.
///
/// # Errors
/// If the simulator rejects the first state or an action.
pub fn replay_open_loop(simulator: &mut PushT, frames: &[PlanarFrame]) -> Result<Option<OpenLoop>, SimError> {
    let (Some(first), Some(last)) = (frames.first(), frames.last()) else {
        return Ok(None);
    };
    let body = Body::tee();
    simulator.reset(&Scene::from_observed(first.eef, first.object), ResetOrder::Legacy)?;
    let mut now = simulator.outcome();
    let mut divergence = Vec::with_capacity(frames.len());
    let mut coverage_replayed = now.coverage;
    for frame in frames {
        let block = now.observation.block;
        divergence.push(Divergence {
            pusher: (now.observation.agent - frame.eef).norm(),
            block_position: (block.translation() - frame.object.translation()).norm(),
            block_angle: periodic_distance(block.theta, frame.object.theta, std::f64::consts::TAU),
            block: body.distance(block, frame.object),
        });
        coverage_replayed = now.coverage;
        now = simulator.step(&frame.action)?;
    }
    Ok(Some(OpenLoop {
        divergence,
        coverage_recorded: coverage(last.object, GOAL),
        coverage_replayed,
        coverage_after: now.coverage,
    }))
}
