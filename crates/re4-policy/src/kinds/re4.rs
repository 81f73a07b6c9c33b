//! RE4 and its presets as kinds of policies: settings, decision records and tables.

use std::sync::Arc;

use nalgebra::Isometry3;
use re4_artifact::{Label, SixAxis, Stage, table};
use re4_episode::{DemoNames, Mode};
use re4_geometry::{Point2, Pose2};
use re4_rollout::{ArmState, Explained, Explanation, Named, Opened, Plane, Space};

use super::{Inputs, OpenError, SettingError, Settings};
use crate::artifact::{open_index, open_spatial_index};
use crate::config::PolicyConfig;
use crate::decision::Decision;
use crate::policy::Re4Factory;
use crate::spatial::{SpatialDecision, SpatialPolicyConfig, SpatialRe4Factory};

table! {
    /// One row per decision of RE4 or RE2 for Push-T, in the order of table decisions: the query, the retrieved chunk, how it is
    /// reframed, the plan to its start, and what is replayed.
    #[table("decisions_re4", version = 3, formerly = "decisions")]
    pub struct PlaneRe4Row {
        /// Seed of the scene, or its number in the table scenes.
        pub seed: u32,
        /// Number of the decision in its rollout, from 0.
        pub decision: u32,
        /// Manipulation mode of the query.
        pub mode: Mode,
        /// Retrieval rule: two_stage or outcome.
        pub selector: Label,
        /// Number of demonstrations (two_stage) or chunks (outcome) that were compared.
        pub compared: u32,
        /// Distance over the full object-augmented state in normalised coordinates. Null for the outcome rule.
        pub d_q: Option<f64>,
        /// Distance over the object pose only in normalised coordinates. Null for the outcome rule.
        pub d_o: Option<f64>,
        /// Motion from the demonstration's object pose to the observed one: a rotation about the world origin, then a
        /// translation. Identity (0) if Reframe is off.
        #[frame = "world"]
        pub delta: Pose2,
        /// Goal position of the plan, at which the chunk starts.
        #[frame = "world"]
        pub set_point: Point2,
        /// Result of planning: direct, planned, failed or off.
        pub plan: Label,
        /// Number of control steps of the plan.
        pub plan_steps: u32,
        /// Number of nodes of the searched tree or graph. 0 if there was no search.
        pub plan_nodes: u32,
        /// Polyline of the plan from the pusher to the set-point, as alternating x and y, world frame, px.
        pub plan_path: Vec<f64>,
        /// Number of control steps of the chunk. Fewer are executed if the next decision comes earlier.
        pub replay_steps: u32,
        /// Predicted pose of the block after the chunk, according to the demonstration.
        #[frame = "world"]
        pub predicted_object: Pose2,
        /// Coverage of the goal at the predicted pose.
        pub predicted_coverage: f64,
    }
}

table! {
    /// One row per decision of RE4 or RE2 for a robosuite task, in the order of table decisions: the query, the retrieved chunk,
    /// how it is reframed, the set-point, and what is replayed. The columns from compared to replay_steps are null if the
    /// decision is to return to the home pose.
    #[table("decisions_re4", version = 4, formerly = "spatial_decisions")]
    pub struct SpaceRe4Row {
        /// Seed of the scene.
        pub seed: u32,
        /// Number of the decision in its rollout, from 0.
        pub decision: u32,
        /// Manipulation mode of the query.
        pub mode: Mode,
        /// Distance between the fingers.
        #[unit = "m"]
        pub finger_separation: f64,
        /// Number of demonstrations that were compared.
        pub compared: Option<u32>,
        /// Distance over the full object-augmented state, dimensionless.
        pub d_q: Option<f64>,
        /// Distance over the object pose only, dimensionless.
        pub d_o: Option<f64>,
        /// Distance over the end-effector pose in the object frame, dimensionless.
        pub d_e: Option<f64>,
        /// Motion from the demonstration's object pose to the query's: a rotation about the world origin, then a translation.
        #[frame = "world"]
        pub delta: Option<SixAxis>,
        /// Rotation about the object's symmetry axis that was applied to the query's object; 0 without symmetry.
        #[unit = "rad"]
        #[formerly = "symmetry_turn"]
        pub symmetry_rotation: Option<f64>,
        /// Number of actions of the chunk. Fewer are executed if the next decision comes earlier.
        pub replay_steps: Option<u32>,
        /// Pose to which the grip site moves first: the start of the chunk or the home pose.
        #[frame = "world"]
        pub set_point: Isometry3<f64>,
        /// Whether the arm moves to the set-point first, by a bridge or by returning home. If false, the chunk is replayed from
        /// the current pose.
        pub bridge: bool,
        /// Number of demonstrations that are currently banned in this rollout.
        pub banned: u32,
    }
}

impl Explained<Plane> for Decision {
    type Detail = PlaneRe4Row;

    fn explanation(&self, names: &DemoNames) -> Explanation<Plane> {
        Explanation {
            step: self.step,
            kind: "retrieve",
            proprio: self.eef,
            object: Some(self.object),
            demo: Some((self.demo, self.demo_frame, self.demo_end)),
            reason: self.reason(names),
        }
    }

    fn detail(&self, seed: u32, decision: u32) -> PlaneRe4Row {
        PlaneRe4Row {
            seed,
            decision,
            mode: self.mode,
            selector: Label::from(if self.d_q.is_some() { "two_stage" } else { "outcome" }),
            compared: self.compared,
            d_q: self.d_q,
            d_o: self.d_o,
            delta: self.delta,
            set_point: self.set_point,
            plan: Label::from(self.plan_kind.as_str()),
            plan_steps: self.plan_steps,
            plan_nodes: self.plan_nodes,
            plan_path: self.plan_path.iter().flat_map(|p| [p.x, p.y]).collect(),
            replay_steps: self.replay_steps,
            predicted_object: self.predicted_object,
            predicted_coverage: self.predicted_coverage,
        }
    }

    fn detail_in_world(&self, seed: u32, decision: u32, world_from_observed: &Pose2) -> PlaneRe4Row {
        self.in_world(world_from_observed).detail(seed, decision)
    }
}

impl Explained<Space> for SpatialDecision {
    type Detail = SpaceRe4Row;

    fn explanation(&self, names: &DemoNames) -> Explanation<Space> {
        Explanation {
            step: self.step,
            kind: self.kind.as_str(),
            proprio: ArmState {
                eef: self.eef,
                fingers: self.fingers,
            },
            object: Some(self.object),
            demo: self.choice.map(|c| (c.demo, c.demo_frame, c.demo_end)),
            reason: self.reason(names),
        }
    }

    fn detail(&self, seed: u32, decision: u32) -> SpaceRe4Row {
        let choice = self.choice.as_ref();
        SpaceRe4Row {
            seed,
            decision,
            mode: self.mode,
            finger_separation: (self.fingers[0] - self.fingers[1]).abs(),
            compared: choice.map(|c| c.compared),
            d_q: choice.map(|c| c.d_q),
            d_o: choice.map(|c| c.d_o),
            d_e: choice.map(|c| c.d_e),
            delta: choice.map(|c| SixAxis::from(&c.delta)),
            symmetry_rotation: choice.map(|c| c.symmetry_rotation),
            replay_steps: choice.map(|c| c.replay_steps),
            set_point: self.set_point,
            bridge: self.bridge,
            banned: self.banned,
        }
    }
}

impl Settings<Plane> for PolicyConfig {
    fn check(&self, _: bool) -> Result<(), SettingError> {
        PolicyConfig::check(self)
    }

    fn open(&self, inputs: &Inputs<'_>) -> Result<Box<dyn Opened<Plane>>, OpenError> {
        let knowledge = open_index(inputs.of(Stage::Index)?, &self.retrieve, inputs.names.clone())?;
        Ok(Box::new(Named {
            names: inputs.names.clone(),
            factory: Re4Factory {
                config: self.clone(),
                knowledge: Arc::new(knowledge),
            },
        }))
    }
}

impl Settings<Space> for SpatialPolicyConfig {
    fn check(&self, images: bool) -> Result<(), SettingError> {
        SpatialPolicyConfig::check(self, images)
    }

    fn open(&self, inputs: &Inputs<'_>) -> Result<Box<dyn Opened<Space>>, OpenError> {
        let index = inputs.of(Stage::Index)?;
        let mut knowledge = open_spatial_index(index, &self.retrieve, inputs.symmetry, inputs.names.clone())?;
        if let Some(retime) = &self.replay.retime {
            knowledge = knowledge.with_pace(retime);
        }
        Ok(Box::new(Named {
            names: inputs.names.clone(),
            factory: SpatialRe4Factory {
                config: self.clone(),
                knowledge: Arc::new(knowledge),
            },
        }))
    }
}
