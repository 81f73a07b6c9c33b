//! GPI as its authors tuned it for Lift, Can and Square: phases, gated distances, votes, progress, and actions that are adapted
//! to the observed object. It is a reference for what hand tuning adds to the method, not the method itself.
//!
//! Source: the method's public reproduction for robomimic's tasks. `docs/policies/gpi.md` lists what differs.

mod choose;
mod frames;
mod library;
mod motion;
mod phases;
#[cfg(test)]
mod tests;
mod tuning;

use std::collections::VecDeque;
use std::sync::Arc;

use nalgebra::Isometry3;
use re4_artifact::{Label, table};
use re4_episode::DemoNames;
use re4_rollout::{
    Act, ArmState, Explained, Explanation, Named, Opened, Phase, Policy, PolicyError, PolicyFactory, Senses, Space,
};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::{Inputs, OpenError, SettingError, Settings};
use crate::LookupError;
use crate::lookup::UsedFrames;
use choose::How;
use library::{Library, Switches};
use phases::{Live, Stage};
use tuning::{CAN, LIFT, SQUARE, Tuning};

/// The tasks for which the authors tuned the method.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum TunedFor {
    /// robosuite's `Lift`.
    Lift,
    /// robosuite's `PickPlaceCan`.
    Can,
    /// robosuite's `NutAssemblySquare`.
    Square,
}

impl TunedFor {
    fn tuning(self) -> Tuning {
        match self {
            Self::Lift => LIFT,
            Self::Can => CAN,
            Self::Square => SQUARE,
        }
    }
}

/// Settings of the tuned GPI. All other constants are the authors' for the task.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
#[expect(
    clippy::struct_excessive_bools,
    reason = "independent parts of the method that can be disabled"
)]
pub struct SpaceGpiTuned {
    /// The task whose constants are used. Default: the task of the pipeline.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub tuning: Option<TunedFor>,
    /// Number of actions of a plan. Default: the authors' (Lift 1, Can 3, Square 8).
    #[serde(skip_serializing_if = "Option::is_none")]
    pub horizon: Option<u32>,
    /// Number of principal components in which states are compared. Default: the authors' (Lift 5, Can 16, Square 26).
    #[serde(skip_serializing_if = "Option::is_none")]
    pub components: Option<u32>,
    /// Number of frames ahead at which the correction of actions (`flow`) looks. Default: the authors' (Can 8, Square 5).
    #[serde(skip_serializing_if = "Option::is_none")]
    pub flow_ahead: Option<u32>,
    /// Gain of the correction of positions. Default: the authors' (Can 0.5, Square 0.496402).
    #[serde(skip_serializing_if = "Option::is_none")]
    pub flow_gain: Option<f64>,
    /// Number of used frames that are not used again.
    pub memory: u32,
    /// Whether only frames of the present phase and the next one are compared.
    pub gate: bool,
    /// Whether neighbouring frames of a demonstration support each other in the choice of a frame.
    pub vote: bool,
    /// Whether frames are re-ranked by the progress of their demonstrations, from the phase transport on.
    pub rerank: bool,
    /// Whether actions are corrected towards the later poses of the demonstrations (Can: of the end effector; Square: of the nut).
    pub flow: bool,
    /// Can: the position to which goals before the lift are relative. The authors use `end_effector` for Can; for Square, goals
    /// before the lift are always relative to the object.
    pub reach: Reach,
}

/// The position to which recorded goals are relative.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Reach {
    /// Recorded displacements of the end effector (authors).
    EndEffector,
    /// Recorded offsets from the object, without rotation.
    Object,
}

impl Default for SpaceGpiTuned {
    fn default() -> Self {
        Self {
            tuning: None,
            horizon: None,
            components: None,
            flow_ahead: None,
            flow_gain: None,
            memory: 25,
            gate: true,
            vote: true,
            rerank: true,
            flow: true,
            reach: Reach::EndEffector,
        }
    }
}

table! {
    /// One row per decision of the tuned GPI, in the order of table decisions.
    #[table("decisions_gpi_tuned", version = 1)]
    pub struct GpiTunedRow {
        /// Seed of the scene.
        pub seed: u32,
        /// Number of the decision in its rollout, from 0.
        pub decision: u32,
        /// Phase: pick, lift, transport, pre_insert or insert.
        pub phase: Label,
        /// How the frame was chosen: nearest, vote or rerank.
        pub choice: Label,
        /// Distance of the frame, dimensionless: squared, and adjusted by the rules of the phase.
        pub distance: f64,
        /// Number of frames that were compared.
        pub compared: u32,
        /// Whether the gripper has just grasped the object.
        pub grasped: bool,
    }
}

/// The decision record of a plan.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct TunedDecision {
    step: u32,
    arm: ArmState,
    object: Isometry3<f64>,
    demo: u32,
    frame: u32,
    end: u32,
    stage: Stage,
    how: How,
    distance: f64,
    compared: u32,
    grasped: bool,
}

impl Explained<Space> for TunedDecision {
    type Detail = GpiTunedRow;

    fn explanation(&self, names: &DemoNames) -> Explanation<Space> {
        let how = match self.how {
            How::Nearest => "the nearest frame",
            How::Vote => "the frame with the most support by its neighbours",
            How::Rerank => "the near frame whose demonstration progresses most",
        };
        Explanation {
            step: self.step,
            kind: "flow",
            proprio: self.arm,
            object: Some(self.object),
            demo: Some((self.demo, self.frame, self.end)),
            reason: format!(
                "{} from frame {}: {how} of {} in phase {} (distance {:.4})",
                names.of(self.demo),
                self.frame,
                self.compared,
                self.stage.as_str(),
                self.distance
            ),
        }
    }

    fn detail(&self, seed: u32, decision: u32) -> GpiTunedRow {
        GpiTunedRow {
            seed,
            decision,
            phase: self.stage.as_str().into(),
            choice: self.how.as_str().into(),
            distance: self.distance,
            compared: self.compared,
            grasped: self.grasped,
        }
    }
}

struct TunedFactory {
    library: Arc<Library>,
    memory: u32,
}

struct TunedPolicy {
    library: Arc<Library>,
    live: Live,
    used: UsedFrames,
    plan: VecDeque<usize>,
    followed: Option<usize>,
    step: u32,
}

impl PolicyFactory<Space> for TunedFactory {
    type Policy = TunedPolicy;

    fn start(&self, _: u32, _: &ArmState) -> TunedPolicy {
        TunedPolicy {
            used: UsedFrames::new(self.library.frames.len(), Some(self.memory)),
            library: Arc::clone(&self.library),
            live: Live::new(),
            plan: VecDeque::new(),
            followed: None,
            step: 0,
        }
    }
}

impl TunedPolicy {
    fn decide(
        &mut self,
        arm: ArmState,
        object: Isometry3<f64>,
        distances: &[Option<f64>],
    ) -> Result<TunedDecision, LookupError> {
        let library = &self.library;
        let (distance, at, how) = library
            .choose(distances, self.live.stage)
            .ok_or(LookupError::NothingToDo)?;
        let end = library.end_of(at).min(at + library.tuning.horizon as usize - 1);
        self.plan = (at..=end).collect();
        let first = &library.frames[at];
        Ok(TunedDecision {
            step: self.step,
            arm,
            object,
            demo: first.demo,
            frame: first.frame,
            end: library.frames[end].frame,
            stage: self.live.stage,
            how,
            distance,
            compared: distances.iter().flatten().count() as u32,
            grasped: self.live.grasped,
        })
    }
}

impl Policy<Space> for TunedPolicy {
    type Decision = TunedDecision;

    fn act(&mut self, senses: &mut dyn Senses<Space>) -> Result<Act<Space, TunedDecision>, PolicyError> {
        let (arm, object) = (senses.proprio(), senses.object()?.pose);
        let library = Arc::clone(&self.library);
        self.live.observe(&library.phases, &arm, &object);
        let code = library.space.code(&arm, &object);
        let used = |at: usize| self.used.contains(at);
        let distances = library.distances(&code, &self.live, arm.fingers[0], self.followed, &used);
        let decision = if self.plan.is_empty() {
            Some(self.decide(arm, object, &distances)?)
        } else {
            None
        };
        let at = self.plan.pop_front().ok_or(LookupError::NothingToDo)?;
        self.used.insert(at);
        self.followed = Some(at);
        self.step += 1;
        Ok(Act {
            action: library.action(at, self.live.stage, &arm, &object, &distances),
            phase: Phase::Replay,
            decision,
            object: Some(object),
        })
    }
}

impl Settings<Space> for SpaceGpiTuned {
    fn check(&self, _: bool) -> Result<(), SettingError> {
        let horizon = self.horizon.unwrap_or(1);
        SettingError::unless(horizon >= 1, "horizon", horizon, "give 1 or more")?;
        let components = self.components.unwrap_or(1);
        SettingError::unless(components >= 1, "components", components, "give 1 or more")?;
        let gain = self.flow_gain.unwrap_or(0.0);
        SettingError::unless(
            (0.0..=10.0).contains(&gain),
            "flow_gain",
            gain,
            "give a number from 0 to 10",
        )
    }

    fn open(&self, inputs: &Inputs<'_>) -> Result<Box<dyn Opened<Space>>, OpenError> {
        let of_task = || {
            let name = inputs.task?.name;
            [LIFT, CAN, SQUARE].into_iter().find(|tuning| tuning.name == name)
        };
        let tuning = self.tuning.map(TunedFor::tuning).or_else(of_task);
        let mut tuning = tuning.ok_or(OpenError::NoTuning)?;
        tuning.horizon = self.horizon.unwrap_or(tuning.horizon);
        tuning.components = self.components.map_or(tuning.components, |count| count as usize);
        tuning.flow_ahead = self.flow_ahead.map_or(tuning.flow_ahead, |frames| frames as usize);
        tuning.flow_gain = self.flow_gain.unwrap_or(tuning.flow_gain);
        let switches = Switches {
            gate: self.gate,
            vote: self.vote,
            rerank: self.rerank,
            flow: self.flow,
            reach: self.reach == Reach::Object,
        };
        Ok(Box::new(Named {
            factory: TunedFactory {
                library: Arc::new(Library::open(inputs, tuning, switches)?),
                memory: self.memory,
            },
            names: inputs.names.clone(),
        }))
    }
}
