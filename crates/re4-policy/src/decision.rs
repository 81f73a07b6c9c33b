//! The decision record of the planar RE4 policy.

use re4_episode::{DemoNames, Mode};
use re4_geometry::{Point2, Pose2};

use crate::replan::PlanKind;

/// The decision record of one retrieval. Positions and poses are in the frame of the observations, in pixels and radians.
#[derive(Debug, Clone, PartialEq)]
pub struct Decision {
    /// Number of control steps taken before the decision.
    pub step: u32,
    /// Mode of the query.
    pub mode: Mode,
    /// End-effector position of the query.
    pub eef: Point2,
    /// Object pose of the query.
    pub object: Pose2,
    /// Number of the retrieved demonstration in the index.
    pub demo: u32,
    /// Retrieved frame, which is the first frame of the chunk.
    pub demo_frame: u32,
    /// Last frame of the chunk, included.
    pub demo_end: u32,
    /// Distance over the full state in normalised coordinates; `None` for the outcome selector.
    pub d_q: Option<f64>,
    /// Distance over the object pose only in normalised coordinates; `None` for the outcome selector.
    pub d_o: Option<f64>,
    /// δ, the motion from the demonstration's object pose to the query's. The identity if Reframe is disabled.
    pub delta: Pose2,
    /// Set-point at which the chunk starts.
    pub set_point: Point2,
    /// How the path to the set-point was found.
    pub plan_kind: PlanKind,
    /// Number of commands of the path.
    pub plan_steps: u32,
    /// Number of nodes searched for the path.
    pub plan_nodes: u32,
    /// The path as a polyline.
    pub plan_path: Vec<Point2>,
    /// Number of commands of the chunk.
    pub replay_steps: u32,
    /// Object pose after the chunk as the demonstration predicts it.
    pub predicted_object: Pose2,
    /// Coverage of the goal at the predicted pose.
    pub predicted_coverage: f64,
    /// Number of chunks or demonstrations compared.
    pub compared: u32,
}

impl Decision {
    /// Returns the same record with its positions and poses in the world frame.
    #[must_use]
    pub fn in_world(&self, world_from_observed: &Pose2) -> Self {
        let point = |p: &Point2| world_from_observed.transform_point(*p);
        let pose = |pose: Pose2| world_from_observed.compose(pose).normalized();
        Self {
            eef: point(&self.eef),
            object: pose(self.object),
            // The demonstration stays where it was recorded.
            delta: world_from_observed.compose(self.delta),
            set_point: point(&self.set_point),
            plan_path: self.plan_path.iter().map(point).collect(),
            predicted_object: pose(self.predicted_object),
            ..self.clone()
        }
    }

    /// Returns the reason for the decision in words. `names` are the names of the demonstrations.
    pub fn reason(&self, names: &DemoNames) -> String {
        let chosen = format!("{} from frame {}", names.of(self.demo), self.demo_frame);
        let why = match (self.d_q, self.d_o) {
            (Some(d_q), Some(d_o)) => format!(
                "nearest object pose (d_o {d_o:.4}) among the nearest states of {} demonstrations (d_q {d_q:.4})",
                self.compared
            ),
            _ => format!(
                "its push to frame {} is predicted to reach a coverage of {:.3}, at the lowest cost of {} chunks compared",
                self.demo_end, self.predicted_coverage, self.compared
            ),
        };
        let path = match self.plan_kind {
            PlanKind::Direct => "the straight path to its start is free",
            PlanKind::Planned => "the path to its start goes around the block",
            PlanKind::Failed => "no free path to its start was found, so the straight path is used",
            PlanKind::Off => "it is replayed from the current position of the pusher",
        };
        format!("{chosen}: {why}; {path}")
    }
}
