//! Why a policy in space does what it does.

use nalgebra::Isometry3;
use re4_episode::Mode;

use re4_episode::DemoNames;

/// What was decided.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum SpatialDecisionKind {
    /// A chunk was retrieved.
    Retrieve,
    /// The demonstration is followed further, since its next frame is nearly as good as the retrieved one.
    Continue,
    /// The grasp is lost: back to the pose of the episode's beginning, the gripper open.
    GraspLost,
    /// The demonstration ended without success: back to the pose of the episode's beginning, the gripper open.
    DemoEnded,
}

impl SpatialDecisionKind {
    /// The word used in tables.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Retrieve => "retrieve",
            Self::Continue => "continue",
            Self::GraspLost => "grasp_lost",
            Self::DemoEnded => "demo_ended",
        }
    }
}

/// The chunk that a decision chose.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SpatialChoice {
    /// Demonstration, by its number in the index.
    pub demo: u32,
    /// First frame of the chunk.
    pub demo_frame: u32,
    /// Last frame of the chunk; it runs on beyond where the fingers still move.
    pub demo_end: u32,
    /// Distance over the full state, without unit, as are the other two.
    pub d_q: f64,
    /// Distance over the object's pose alone.
    pub d_o: f64,
    /// Distance over the end effector's pose as seen from the object.
    pub d_e: f64,
    /// Demonstrations compared: those with a frame in the mode.
    pub compared: u32,
    /// δ in the world, the identity where Reframe is off.
    pub delta: Isometry3<f64>,
    /// Turn in rad about the object's symmetry axis that was applied to the query's object; 0 for an object without symmetry.
    pub turn: f64,
    /// Actions of the chunk.
    pub replay_steps: u32,
}

/// One record for every decision. World frame, metres, radians.
#[derive(Debug, Clone, PartialEq)]
pub struct SpatialDecision {
    /// Control steps taken before the decision.
    pub step: u32,
    /// What was decided.
    pub kind: SpatialDecisionKind,
    /// Mode of the query.
    pub mode: Mode,
    /// Grip site of the query.
    pub eef: Isometry3<f64>,
    /// Object of the query: the observed pose, or the average of those observed where they are averaged. On the way home, for
    /// which no policy looks, the last one, at rest in the world or in the gripper.
    pub object: Isometry3<f64>,
    /// Finger joints of the query.
    pub fingers: [f64; 2],
    /// The chunk; none on the way home.
    pub choice: Option<SpatialChoice>,
    /// Where the grip site is to go first: the start of the chunk, or home. A start that is measured continuously moves.
    pub set_point: Isometry3<f64>,
    /// Whether a bridge, or the way home, leads there; else the chunk is replayed from where the grip site is.
    pub bridge: bool,
    /// Demonstrations banned by now.
    pub banned: u32,
    /// Demonstrations that were banned since the last decision or by this one.
    pub newly_banned: Vec<u32>,
}

impl SpatialDecision {
    /// The decision in words, in which demonstrations have their names.
    pub fn reason(&self, names: &DemoNames) -> String {
        let mut reason = match (self.kind, &self.choice) {
            (SpatialDecisionKind::GraspLost, _) => format!(
                "the grasp is lost: told to close, the fingers are {:.4} m apart; back to the initial pose with the gripper open",
                (self.fingers[0] - self.fingers[1]).abs()
            ),
            (SpatialDecisionKind::DemoEnded, _) => {
                "the demonstration ended without success; back to the initial pose with the gripper open".to_owned()
            }
            (kind, Some(choice)) => {
                let chosen = format!("{} from frame {}", names.of(choice.demo), choice.demo_frame);
                let why = if kind == SpatialDecisionKind::Continue {
                    format!(
                        "followed further, its next frame being nearly as near (d_q {:.4}, d_o {:.4}) as any",
                        choice.d_q, choice.d_o
                    )
                } else {
                    format!(
                        "nearest object pose (d_o {:.4}) among the nearest states of {} demonstrations (d_q {:.4})",
                        choice.d_o, choice.compared, choice.d_q
                    )
                };
                let way = if self.bridge {
                    "a bridge leads to its start"
                } else {
                    "it is replayed from where the end effector is"
                };
                format!("{chosen}: {why}; {way}")
            }
            (_, None) => "nothing was chosen".to_owned(),
        };
        for (i, demo) in self.newly_banned.iter().enumerate() {
            let before = if i == 0 { "; not followed again: " } else { ", " };
            reason.push_str(before);
            reason.push_str(&names.of(*demo));
        }
        reason
    }
}
