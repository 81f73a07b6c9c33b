//! RE4 and its presets as kinds of policies.

use std::sync::Arc;

use nalgebra::Isometry3;
use re4_artifact::{Label, SixAxis, Stage, table};
use re4_episode::{DemoNames, Mode};
use re4_geometry::{Point2, Pose2};
use re4_rollout::{ArmState, Explained, Explanation, Named, Opened, Plane, Space};

use super::{Inputs, OpenError, SettingError, Settings};
use crate::artifact::{open_index, open_spatial_index};
use crate::config::PolicyConfig;
use crate::policy::{Decision, Re4Factory};
use crate::spatial::{SpatialDecision, SpatialPolicyConfig, SpatialRe4Factory};

table! {
    /// One row a decision of RE4 or RE2 of Push-T, in the order of table decisions: what it saw, what it retrieved, how it moved
    /// it, what it planned and what it replays.
    #[table("decisions_re4", version = 4, formerly = "decisions")]
    pub struct PlaneRe4Row {
        /// Seed of the scene, or its number in the table scenes.
        pub seed: u32,
        /// Number of the decision in its rollout, from 0.
        pub decision: u32,
        /// Manipulation mode of the query.
        pub mode: Mode,
        /// Rule that chose: two_stage or outcome.
        pub selector: Label,
        /// How many demonstrations (two_stage) or chunks (outcome) were compared.
        pub compared: u32,
        /// Distance of the object-augmented states in normalised coordinates; null for the outcome rule.
        pub d_q: Option<f64>,
        /// Distance of the object poses alone in normalised coordinates; null for the outcome rule.
        pub d_o: Option<f64>,
        /// Motion that carries the demonstration's object onto the observed one: a rotation about the world's origin, then a
        /// translation; 0 with Reframe off.
        #[frame = "world"]
        pub delta: Pose2,
        /// Position that the plan leads the pusher to.
        #[frame = "world"]
        pub set_point: Point2,
        /// How it was planned to get there: direct, planned, failed or off.
        pub plan: Label,
        /// Control steps of the plan.
        pub plan_steps: u32,
        /// Nodes of the tree or graph that was searched; 0 where none was.
        pub plan_nodes: u32,
        /// Polyline of the plan, from the pusher to the set-point: x and y by turns, world frame, px.
        pub plan_path: Vec<f64>,
        /// Control steps of the chunk; fewer are executed when the next decision comes earlier.
        pub replay_steps: u32,
        /// Pose that the demonstration says the block will have after the chunk.
        #[frame = "world"]
        pub predicted_object: Pose2,
        /// Coverage of the goal at that predicted pose.
        pub predicted_coverage: f64,
    }
}

table! {
    /// One row a decision of RE4 or RE2 of a robosuite task, in the order of table decisions: what it saw, what it retrieved, how
    /// it moved it, where it goes first and what it replays. Columns from compared to replay_steps are null on the way home.
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
        /// Demonstrations compared.
        pub compared: Option<u32>,
        /// Distance over the full object-augmented state, without unit.
        pub d_q: Option<f64>,
        /// Distance over the object's pose alone.
        pub d_o: Option<f64>,
        /// Distance over the end effector's pose as seen from the object.
        pub d_e: Option<f64>,
        /// Motion that carries the demonstration's object onto the query's: a rotation about the world's origin, then a
        /// translation.
        #[frame = "world"]
        pub delta: Option<SixAxis>,
        /// Rotation about the object's symmetry axis that was applied to the query's object; 0 without symmetry.
        #[unit = "rad"]
        #[formerly = "symmetry_turn"]
        pub symmetry_rotation: Option<f64>,
        /// Actions of the chunk; fewer are executed when the next decision comes earlier.
        pub replay_steps: Option<u32>,
        /// Where the grip site goes first.
        #[frame = "world"]
        pub set_point: Isometry3<f64>,
        /// Whether a bridge, or the way home, leads there; else the chunk is replayed from where the grip site is.
        pub bridge: bool,
        /// Demonstrations that are not followed again by now.
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
            symmetry_rotation: choice.map(|c| c.turn),
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
        let knowledge = open_spatial_index(index, &self.retrieve, inputs.symmetry, inputs.names.clone())?;
        Ok(Box::new(Named {
            names: inputs.names.clone(),
            factory: SpatialRe4Factory {
                config: self.clone(),
                knowledge: Arc::new(knowledge),
            },
        }))
    }
}
