//! Decision records of the policy in SE(3).

use nalgebra::Isometry3;
use re4_episode::Mode;

use re4_episode::DemoNames;

/// The kind of decision.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum SpatialDecisionKind {
    /// A chunk was retrieved.
    Retrieve,
    /// The policy continues with the current demonstration, because its next frame is nearly as close as the retrieved one.
    Continue,
    /// The grasp is lost. The arm returns to the initial pose of the episode with the gripper open.
    GraspLost,
    /// The demonstration ended without success. The arm returns to the initial pose of the episode with the gripper open.
    DemoEnded,
}

impl SpatialDecisionKind {
    /// Returns the name of the kind in tables.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Retrieve => "retrieve",
            Self::Continue => "continue",
            Self::GraspLost => "grasp_lost",
            Self::DemoEnded => "demo_ended",
        }
    }
}

/// The chunk that a decision selected.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SpatialChoice {
    /// Number of the demonstration in the index.
    pub demo: u32,
    /// First frame of the chunk.
    pub demo_frame: u32,
    /// Last frame of the chunk, included. The replay continues past it while the fingers still move.
    pub demo_end: u32,
    /// Distance over the full state, dimensionless.
    pub d_q: f64,
    /// Distance over the object pose only, dimensionless.
    pub d_o: f64,
    /// Distance over the end-effector pose in the object frame, dimensionless.
    pub d_e: f64,
    /// Number of demonstrations compared, which are those that have a frame of the query's mode.
    pub compared: u32,
    /// δ, the motion in the world frame from the demonstration's object pose to the query's. The identity if Reframe is disabled.
    pub delta: Isometry3<f64>,
    /// Rotation about the object's symmetry axis that was applied to the query's object, in rad; 0 for an object without
    /// symmetry.
    pub symmetry_rotation: f64,
    /// Number of actions of the chunk.
    pub replay_steps: u32,
}

/// The decision record. Poses are in the world frame, in metres and radians.
#[derive(Debug, Clone, PartialEq)]
pub struct SpatialDecision {
    /// Number of control steps taken before the decision.
    pub step: u32,
    /// The kind of decision.
    pub kind: SpatialDecisionKind,
    /// Mode of the query.
    pub mode: Mode,
    /// Pose of the grip site.
    pub eef: Isometry3<f64>,
    /// Object pose of the query: the observed pose, or the average of the observed poses if they are averaged. A decision to
    /// return home does not request an observation; its object pose is the last one, assumed fixed in the world or in the
    /// gripper.
    pub object: Isometry3<f64>,
    /// Joint positions of the fingers in metres.
    pub fingers: [f64; 2],
    /// The selected chunk, or `None` if the arm returns home.
    pub choice: Option<SpatialChoice>,
    /// Pose to which the grip site moves first: the start of the chunk or the home pose. With continuous measurement, the start
    /// of the chunk moves afterwards.
    pub set_point: Isometry3<f64>,
    /// Whether the arm moves to the set-point first, by a bridge or by returning home. If false, the chunk is replayed from the
    /// current pose.
    pub bridge: bool,
    /// Number of demonstrations that are currently banned.
    pub banned: u32,
    /// Demonstrations that were banned since the last decision or by this decision.
    pub newly_banned: Vec<u32>,
}

impl SpatialDecision {
    /// Returns the reason for the decision in words. `names` are the names of the demonstrations.
    pub fn reason(&self, names: &DemoNames) -> String {
        let mut reason = match (self.kind, &self.choice) {
            (SpatialDecisionKind::GraspLost, _) => format!(
                "the grasp is lost: the gripper was commanded to close, and the fingers are only {:.4} m apart; \
                 the arm returns to the initial pose with the gripper open",
                (self.fingers[0] - self.fingers[1]).abs()
            ),
            (SpatialDecisionKind::DemoEnded, _) => {
                "the demonstration ended without success; the arm returns to the initial pose with the gripper open"
                    .to_owned()
            }
            (kind, Some(choice)) => {
                let chosen = format!("{} from frame {}", names.of(choice.demo), choice.demo_frame);
                let why = if kind == SpatialDecisionKind::Continue {
                    format!(
                        "continued, because its next frame (d_q {:.4}, d_o {:.4}) is nearly as close as the retrieved frame",
                        choice.d_q, choice.d_o
                    )
                } else {
                    format!(
                        "nearest object pose (d_o {:.4}) among the nearest states of {} demonstrations (d_q {:.4})",
                        choice.d_o, choice.compared, choice.d_q
                    )
                };
                let path = if self.bridge {
                    "a bridge moves the end effector to its start"
                } else {
                    "it is replayed from the current pose of the end effector"
                };
                format!("{chosen}: {why}; {path}")
            }
            (_, None) => "no chunk was selected".to_owned(),
        };
        for (i, demo) in self.newly_banned.iter().enumerate() {
            let separator = if i == 0 { "; banned: " } else { ", " };
            reason.push_str(separator);
            reason.push_str(&names.of(*demo));
        }
        reason
    }
}
