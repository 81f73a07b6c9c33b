//! GPI, geometry-aware policy imitation: a policy from a velocity field over the frames of the demonstrations, without training.
//!
//! At every step (horizon 1) it finds the `neighbors` nearest frames that it has not used yet, and combines their recorded
//! motions with an attraction towards their recorded positions, weighted by inverse distances. With a longer horizon, it takes
//! the nearest frame and follows its demonstration for `horizon` frames. Queries have noise that decays during the episode.
//!
//! Source: the method's public code and paper; the port to the robosuite tasks follows the description in the RE4 paper.
//! `docs/policies/gpi.md` lists what differs.

use std::collections::{BTreeSet, VecDeque};
use std::sync::Arc;

use re4_artifact::table;
use re4_episode::DemoNames;
use re4_rollout::{
    Act, Domain, Explained, Explanation, Named, Opened, Phase, Plane, Policy, PolicyError, PolicyFactory, Senses,
    Space, Trace,
};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::{Inputs, OpenError, SettingError, Settings};
use crate::LookupError;
use crate::lookup::{
    ActionFrame, Field, Lookup, Memory, QueryNoise, QueryNoiseConfig, SpaceWeights, UsedFrames, inverse_weights,
    nearest,
};

/// Settings of GPI in both domains.
#[derive(Debug, Clone, PartialEq)]
struct Gpi {
    horizon: u32,
    neighbors: u32,
    noise: QueryNoiseConfig,
    actions: ActionFrame,
    progression: f64,
    attraction: f64,
    attraction_first: Option<f64>,
    smoothing: f64,
    memory: Option<u32>,
}

/// Settings of GPI for Push-T. The defaults are those of the authors' run with states.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct PlaneGpi {
    /// Number of actions of a plan (authors: 8, and 1 to 16 in their batch evaluation; RE4 paper: 1 from states, 4 from images).
    /// 1: a new query at every step, which combines several frames.
    pub horizon: u32,
    /// Number of frames that are combined if the horizon is 1 (authors and RE4 paper: 3).
    pub neighbors: u32,
    /// Noise of queries. It affects only the search.
    pub noise: QueryNoiseConfig,
    /// The frame of actions: `object` is the authors' default for states, `world` for images.
    pub actions: ActionFrame,
    /// Weight of the recorded motion in the velocity field (authors: 1).
    pub progression: f64,
    /// Weight of the attraction towards the recorded position (authors: 1). If both weights are 1, the velocity field leads
    /// exactly to the recorded action.
    pub attraction: f64,
    /// Weight of the attraction at the first action of a plan; it rises linearly to `attraction` at the last one (authors' batch
    /// evaluation: 0.5). Default: `attraction`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub attraction_first: Option<f64>,
    /// Weight of the previous action in the executed one (authors: 0; 0 to 0.4 in their batch evaluation).
    pub smoothing: f64,
    /// Number of used frames that are not used again. Default: all frames that were used in the episode (authors, states).
    #[serde(skip_serializing_if = "Option::is_none")]
    pub memory: Option<u32>,
}

impl Default for PlaneGpi {
    fn default() -> Self {
        Self {
            horizon: 8,
            neighbors: 3,
            noise: QueryNoiseConfig::default(),
            actions: ActionFrame::Object,
            progression: 1.0,
            attraction: 1.0,
            attraction_first: None,
            smoothing: 0.0,
            memory: None,
        }
    }
}

/// Settings of GPI for the robosuite tasks. The defaults follow the RE4 paper's port (3 neighbours, noise 0.01, horizon 1 from
/// states, 25 used frames); the weights of distances, which it does not state, are 1.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct SpaceGpi {
    /// Number of actions of a plan (RE4 paper: 1 from states, 4 from images).
    pub horizon: u32,
    /// Number of frames whose positions are combined if the horizon is 1 (RE4 paper: 3). Rotation and gripper command are those
    /// of the nearest frame.
    pub neighbors: u32,
    /// Noise of queries. It affects only the search.
    pub noise: QueryNoiseConfig,
    /// Weights of distances.
    pub weights: SpaceWeights,
    /// The frame of actions. `world`: recorded goals are used as they are.
    pub actions: ActionFrame,
    /// Weight of the recorded motion in the velocity field (authors: 1).
    pub progression: f64,
    /// Weight of the attraction towards the recorded position (authors: 1). With 0, the policy executes recorded displacements
    /// of the end effector.
    pub attraction: f64,
    /// Weight of the attraction at the first action of a plan; it rises linearly to `attraction` at the last one. Default:
    /// `attraction`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub attraction_first: Option<f64>,
    /// Weight of the previous action in the executed one.
    pub smoothing: f64,
    /// Number of used frames that are not used again (RE4 paper: 25). 0 for none.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub memory: Option<u32>,
}

impl Default for SpaceGpi {
    fn default() -> Self {
        Self {
            horizon: 1,
            neighbors: 3,
            noise: QueryNoiseConfig::default(),
            weights: SpaceWeights::default(),
            actions: ActionFrame::World,
            progression: 1.0,
            attraction: 1.0,
            attraction_first: None,
            smoothing: 0.0,
            memory: Some(25),
        }
    }
}

table! {
    /// One row per decision of GPI, in the order of table decisions.
    #[table("decisions_gpi", version = 1)]
    pub struct GpiRow {
        /// Seed of the scene, or its number in the table scenes.
        pub seed: u32,
        /// Number of the decision in its rollout, from 0.
        pub decision: u32,
        /// Standard deviation of the noise of the query, in normalised coordinates; 0 without noise.
        pub sigma: f64,
        /// Distance between the query and the nearest frame, dimensionless.
        pub distance: f64,
        /// The frames that are combined, the nearest first: demonstration, frame and weight of each, one after the other. The
        /// sum of the weights is 1.
        pub neighbors: Vec<f64>,
        /// Number of frames that are excluded because they were used.
        pub used: u32,
    }
}

/// Frames with their weights, the nearest first.
type Weighted = Vec<(f64, usize)>;

/// The decision record of a query.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct GpiDecision<D: Domain> {
    step: u32,
    proprio: D::Proprio,
    object: D::Pose,
    sigma: f64,
    distance: f64,
    /// Demonstration, frame and weight, the nearest first.
    neighbors: Vec<(u32, u32, f64)>,
    /// Last frame whose action is executed.
    end: u32,
    used: u32,
}

impl<D: Domain> Explained<D> for GpiDecision<D> {
    type Detail = GpiRow;

    fn explanation(&self, names: &DemoNames) -> Explanation<D> {
        let first = self.neighbors.first();
        let (demo, frame) = first.map_or((0, 0), |(demo, frame, _)| (*demo, *frame));
        let others = self.neighbors.len().saturating_sub(1);
        let how = match others {
            0 => String::new(),
            _ => format!(", combined with {others} more"),
        };
        Explanation {
            step: self.step,
            kind: "flow",
            proprio: self.proprio,
            object: Some(self.object),
            demo: Some((demo, frame, self.end)),
            reason: format!(
                "{} from frame {frame}: the nearest unused frame (distance {:.4}){how}",
                names.of(demo),
                self.distance
            ),
        }
    }

    fn detail(&self, seed: u32, decision: u32) -> GpiRow {
        GpiRow {
            seed,
            decision,
            sigma: self.sigma,
            distance: self.distance,
            neighbors: self
                .neighbors
                .iter()
                .flat_map(|(demo, frame, weight)| [f64::from(*demo), f64::from(*frame), *weight])
                .collect(),
            used: self.used,
        }
    }
}

struct GpiFactory<D: Lookup> {
    memory: Arc<Memory<D>>,
    config: Arc<Gpi>,
}

struct GpiPolicy<D: Lookup> {
    memory: Arc<Memory<D>>,
    config: Arc<Gpi>,
    noise: QueryNoise,
    used: UsedFrames,
    /// Positions of the frames of the plan that have yet to be executed. Empty if the horizon is 1.
    plan: VecDeque<usize>,
    /// Number of frames of the plan when it was made.
    planned: usize,
    previous: Option<D::Action>,
    trace: Trace,
    step: u32,
}

impl<D: Lookup> PolicyFactory<D> for GpiFactory<D> {
    type Policy = GpiPolicy<D>;

    fn start(&self, seed: u32, _: &D::Proprio) -> GpiPolicy<D> {
        GpiPolicy {
            noise: QueryNoise::new(seed, self.config.noise),
            used: UsedFrames::new(self.memory.entries.len(), self.config.memory),
            memory: Arc::clone(&self.memory),
            config: Arc::clone(&self.config),
            plan: VecDeque::new(),
            planned: 0,
            previous: None,
            trace: Trace::default(),
            step: 0,
        }
    }

    fn start_without(&self, seed: u32, first: &D::Proprio, without: &Arc<BTreeSet<u32>>) -> Option<GpiPolicy<D>> {
        Some(GpiPolicy {
            trace: Trace::without(without),
            ..self.start(seed, first)
        })
    }
}

impl<D: Lookup> GpiPolicy<D> {
    /// Searches the nearest unused frames. If every frame was used, all are forgotten.
    fn search(&mut self, state: &D::State, count: usize) -> Vec<(f64, usize)> {
        loop {
            let (memory, used, without) = (&self.memory, &self.used, self.trace.left_out());
            let distances = memory.entries.iter().enumerate().map(|(at, entry)| {
                let admitted = entry.retrievable && !used.contains(at) && !without.contains(&entry.demo);
                admitted.then(|| D::squared(&memory.scales, &entry.state, state))
            });
            let found = nearest(distances, count);
            if !found.is_empty() || self.used.len() == 0 {
                return found.into_iter().map(|(squared, at)| (squared.sqrt(), at)).collect();
            }
            self.used.clear();
        }
    }

    /// Makes a new query. Returns the decision and the frames that are combined with their weights, the nearest first.
    fn decide(&mut self, proprio: D::Proprio, object: D::Pose) -> Result<(GpiDecision<D>, Weighted), LookupError> {
        let mut state = self.memory.query(&proprio, &object)?;
        let sigma = self.noise.next_sigma();
        if let Some(sigma) = sigma {
            D::perturb(&mut state, &mut || sigma * self.noise.normal());
        }
        let reactive = self.config.horizon == 1;
        let used = self.used.len() as u32;
        let found = self.search(&state, if reactive { self.config.neighbors as usize } else { 1 });
        let (distance, at) = *found.first().ok_or(LookupError::NothingToDo)?;
        // The nearest unused frames are the same without any frame that is not among them. Used frames were among them before.
        let memory = &self.memory;
        self.trace
            .consider(found.iter().map(|(_, at)| memory.entries[*at].demo));
        let weights = inverse_weights(found.iter().map(|(distance, _)| *distance));
        let parts: Vec<(f64, usize)> = weights.into_iter().zip(found.iter().map(|(_, at)| *at)).collect();
        if !reactive {
            let run = self.memory.run(at, self.config.horizon as usize);
            self.plan = (at..at + run).collect();
            self.planned = run;
        }
        let entries = &self.memory.entries;
        let last = self.plan.back().copied().unwrap_or(at);
        let decision = GpiDecision {
            step: self.step,
            proprio,
            object,
            sigma: sigma.unwrap_or(0.0),
            distance,
            neighbors: parts
                .iter()
                .map(|(weight, at)| (entries[*at].demo, entries[*at].frame, *weight))
                .collect(),
            end: entries[last].frame,
            used,
        };
        Ok((decision, parts))
    }

    /// Weight of the attraction for the frame of the plan that is executed next, of which `left` frames remain.
    fn attraction(&self, left: usize) -> f64 {
        let Gpi {
            attraction: last,
            attraction_first: first,
            ..
        } = *self.config;
        match first {
            Some(first) if self.planned > 1 => {
                let part = (self.planned - left) as f64 / (self.planned - 1) as f64;
                first + (last - first) * part
            }
            _ => last,
        }
    }
}

impl<D: Lookup> Policy<D> for GpiPolicy<D> {
    type Decision = GpiDecision<D>;

    fn act(&mut self, senses: &mut dyn Senses<D>) -> Result<Act<D, GpiDecision<D>>, PolicyError> {
        let proprio = senses.proprio();
        // In a plan with world actions, the object pose has no effect, so that no image is needed.
        let observes = self.plan.is_empty() || self.config.actions == ActionFrame::Object;
        let object = if observes { Some(senses.object()?.pose) } else { None };
        let (decision, mut parts) = match object {
            Some(object) if self.plan.is_empty() => {
                let (decision, parts) = self.decide(proprio, object)?;
                (Some(decision), parts)
            }
            _ => (None, Vec::new()),
        };
        let left = self.plan.len();
        if let Some(at) = self.plan.pop_front() {
            parts = vec![(1.0, at)];
        }
        let field = Field {
            frame: self.config.actions,
            progression: self.config.progression,
            attraction: self.attraction(left),
        };
        let entries = &self.memory.entries;
        let neighbors: Vec<_> = parts.iter().map(|(weight, at)| (*weight, &entries[*at])).collect();
        let (_, first) = neighbors.first().ok_or(LookupError::NothingToDo)?;
        let pose = object.unwrap_or(first.object);
        let mut action = D::flow(&neighbors, &proprio, &pose, &field);
        if let Some((_, at)) = parts.first() {
            self.used.insert(*at);
        }
        if let Some(previous) = &self.previous {
            D::smooth(&mut action, previous, self.config.smoothing);
        }
        self.previous = Some(action);
        self.step += 1;
        Ok(Act {
            action,
            phase: Phase::Replay,
            object,
            decision,
        })
    }

    fn considered(&self) -> Option<&BTreeSet<u32>> {
        self.trace.considered()
    }
}

impl Gpi {
    fn check(&self) -> Result<(), SettingError> {
        SettingError::unless(self.horizon >= 1, "horizon", self.horizon, "give 1 or more")?;
        SettingError::unless(self.neighbors >= 1, "neighbors", self.neighbors, "give 1 or more")?;
        self.noise.check()?;
        let first = self.attraction_first.unwrap_or(0.0);
        for (setting, value) in [
            ("progression", self.progression),
            ("attraction", self.attraction),
            ("attraction_first", first),
            ("smoothing", self.smoothing),
        ] {
            let valid = (0.0..=100.0).contains(&value);
            SettingError::unless(valid, setting, value, "give a number from 0 to 100")?;
        }
        Ok(())
    }

    fn open<D: Lookup>(self, inputs: &Inputs<'_>, weights: &D::Weights) -> Result<Box<dyn Opened<D>>, OpenError> {
        Ok(Box::new(Named {
            factory: GpiFactory {
                memory: Arc::new(Memory::<D>::open(inputs, weights)?),
                config: Arc::new(self),
            },
            names: inputs.names.clone(),
        }))
    }
}

impl PlaneGpi {
    fn common(&self) -> Gpi {
        Gpi {
            horizon: self.horizon,
            neighbors: self.neighbors,
            noise: self.noise,
            actions: self.actions,
            progression: self.progression,
            attraction: self.attraction,
            attraction_first: self.attraction_first,
            smoothing: self.smoothing,
            memory: self.memory,
        }
    }
}

impl SpaceGpi {
    fn common(&self) -> Gpi {
        Gpi {
            horizon: self.horizon,
            neighbors: self.neighbors,
            noise: self.noise,
            actions: self.actions,
            progression: self.progression,
            attraction: self.attraction,
            attraction_first: self.attraction_first,
            smoothing: self.smoothing,
            memory: self.memory,
        }
    }
}

impl Settings<Plane> for PlaneGpi {
    fn check(&self, _: bool) -> Result<(), SettingError> {
        self.common().check()
    }

    fn open(&self, inputs: &Inputs<'_>) -> Result<Box<dyn Opened<Plane>>, OpenError> {
        self.common().open(inputs, &())
    }
}

impl Settings<Space> for SpaceGpi {
    fn check(&self, _: bool) -> Result<(), SettingError> {
        self.common().check()?;
        self.weights.check()
    }

    fn open(&self, inputs: &Inputs<'_>) -> Result<Box<dyn Opened<Space>>, OpenError> {
        self.common().open(inputs, &self.weights)
    }
}
