//! VINN, locally weighted neighbours: the weighted mean of the actions of the nearest frames.
//!
//! VINN learns an embedding of images without labels and averages the actions of the nearest frames in it. Here the embedding is
//! the normalised state (the recorded or the estimated object pose, and the end effector), or the last states.
//! `docs/policies/vinn.md` lists what differs.

use std::collections::BTreeSet;
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
use crate::lookup::{ActionFrame, History, Lookup, Memory, SpaceWeights, nearest, softmax_weights};

/// Settings of VINN in both domains.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Vinn {
    neighbors: u32,
    temperature: f64,
    history: u32,
    actions: ActionFrame,
}

/// Settings of VINN for Push-T.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct PlaneVinn {
    /// Number of frames whose actions are averaged.
    pub neighbors: u32,
    /// The weight of a frame is proportional to `exp(-distance / temperature)`. The authors have no temperature, which is 1.
    pub temperature: f64,
    /// Number of successive states that are compared: 1 for the present state only.
    pub history: u32,
    /// The frame in which actions are averaged. The authors' robots act relative to the end effector; here `world` averages the
    /// recorded targets.
    pub actions: ActionFrame,
}

impl Default for PlaneVinn {
    fn default() -> Self {
        Self {
            neighbors: 3,
            temperature: 0.03,
            history: 8,
            actions: ActionFrame::Object,
        }
    }
}

/// Settings of VINN for the robosuite tasks.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct SpaceVinn {
    /// Number of frames whose actions are averaged.
    pub neighbors: u32,
    /// The weight of a frame is proportional to `exp(-distance / temperature)`. The authors have no temperature, which is 1.
    pub temperature: f64,
    /// Number of successive states that are compared: 1 for the present state only.
    pub history: u32,
    /// The frame in which goal poses are averaged.
    pub actions: ActionFrame,
    /// Weights of distances.
    pub weights: SpaceWeights,
}

impl Default for SpaceVinn {
    fn default() -> Self {
        Self {
            neighbors: 3,
            temperature: 0.03,
            history: 8,
            actions: ActionFrame::World,
            weights: SpaceWeights::default(),
        }
    }
}

table! {
    /// One row per decision of VINN, in the order of table decisions.
    #[table("decisions_vinn", version = 1)]
    pub struct VinnRow {
        /// Seed of the scene, or its number in the table scenes.
        pub seed: u32,
        /// Number of the decision in its rollout, from 0.
        pub decision: u32,
        /// Distance to the nearest frame, dimensionless.
        pub distance: f64,
        /// Distance to the farthest frame that is averaged, dimensionless.
        pub farthest: f64,
        /// The frames that are averaged, the nearest first: demonstration, frame and weight of each, one after the other. The
        /// sum of the weights is 1.
        pub neighbors: Vec<f64>,
    }
}

/// The decision record of a step.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct VinnDecision<D: Domain> {
    step: u32,
    proprio: D::Proprio,
    object: D::Pose,
    distance: f64,
    farthest: f64,
    /// Demonstration, frame and weight, the nearest first.
    neighbors: Vec<(u32, u32, f64)>,
}

impl<D: Domain> Explained<D> for VinnDecision<D> {
    type Detail = VinnRow;

    fn explanation(&self, names: &DemoNames) -> Explanation<D> {
        let (demo, frame, weight) = self.neighbors.first().copied().unwrap_or_default();
        Explanation {
            step: self.step,
            kind: "average",
            proprio: self.proprio,
            object: Some(self.object),
            demo: Some((demo, frame, frame)),
            reason: format!(
                "the mean action of {} frames; the nearest is frame {frame} of {} (distance {:.4}, weight {weight:.2})",
                self.neighbors.len(),
                names.of(demo),
                self.distance
            ),
        }
    }

    fn detail(&self, seed: u32, decision: u32) -> VinnRow {
        let numbers = self.neighbors.iter();
        VinnRow {
            seed,
            decision,
            distance: self.distance,
            farthest: self.farthest,
            neighbors: numbers
                .flat_map(|(demo, frame, weight)| [f64::from(*demo), f64::from(*frame), *weight])
                .collect(),
        }
    }
}

struct VinnFactory<D: Lookup> {
    memory: Arc<Memory<D>>,
    config: Vinn,
}

struct VinnPolicy<D: Lookup> {
    memory: Arc<Memory<D>>,
    config: Vinn,
    history: History<D>,
    trace: Trace,
    step: u32,
}

impl<D: Lookup> PolicyFactory<D> for VinnFactory<D> {
    type Policy = VinnPolicy<D>;

    fn start(&self, _: u32, _: &D::Proprio) -> VinnPolicy<D> {
        VinnPolicy {
            memory: Arc::clone(&self.memory),
            config: self.config,
            history: History::new(self.config.history),
            trace: Trace::default(),
            step: 0,
        }
    }

    fn start_without(&self, seed: u32, first: &D::Proprio, without: &Arc<BTreeSet<u32>>) -> Option<VinnPolicy<D>> {
        Some(VinnPolicy {
            trace: Trace::without(without),
            ..self.start(seed, first)
        })
    }
}

impl<D: Lookup> Policy<D> for VinnPolicy<D> {
    type Decision = VinnDecision<D>;

    fn act(&mut self, senses: &mut dyn Senses<D>) -> Result<Act<D, VinnDecision<D>>, PolicyError> {
        let (proprio, object) = (senses.proprio(), senses.object()?.pose);
        self.history.push(self.memory.query(&proprio, &object)?);
        let memory = &self.memory;
        let without = self.trace.left_out();
        let distances = memory.entries.iter().enumerate().map(|(at, entry)| {
            let admitted = entry.retrievable && !without.contains(&entry.demo);
            admitted.then(|| self.history.squared(memory, at))
        });
        let found: Vec<(f64, usize)> = nearest(distances, self.config.neighbors as usize)
            .into_iter()
            .map(|(squared, at)| (squared.sqrt(), at))
            .collect();
        let (Some((distance, _)), Some((farthest, _))) = (found.first(), found.last()) else {
            return Err(LookupError::NothingToDo.into());
        };
        let distances: Vec<f64> = found.iter().map(|(distance, _)| *distance).collect();
        let weights = softmax_weights(&distances, self.config.temperature);
        let neighbors: Vec<_> = weights
            .iter()
            .zip(&found)
            .map(|(weight, (_, at))| (*weight, &memory.entries[*at]))
            .collect();
        let decision = VinnDecision {
            step: self.step,
            proprio,
            object,
            distance: *distance,
            farthest: *farthest,
            neighbors: neighbors
                .iter()
                .map(|(weight, entry)| (entry.demo, entry.frame, *weight))
                .collect(),
        };
        let action = D::mean(&neighbors, &object, self.config.actions);
        // The nearest frames are the same without any frame that is not among them.
        self.trace.consider(decision.neighbors.iter().map(|(demo, ..)| *demo));
        self.step += 1;
        Ok(Act {
            action,
            phase: Phase::Replay,
            decision: Some(decision),
            object: Some(object),
        })
    }

    fn considered(&self) -> Option<&BTreeSet<u32>> {
        self.trace.considered()
    }
}

impl Vinn {
    fn check(&self) -> Result<(), SettingError> {
        SettingError::unless(self.neighbors >= 1, "neighbors", self.neighbors, "give 1 or more")?;
        let valid = self.temperature.is_finite() && self.temperature > 0.0;
        SettingError::unless(valid, "temperature", self.temperature, "give a finite number above 0")?;
        let valid = (1..=100).contains(&self.history);
        SettingError::unless(valid, "history", self.history, "give a number from 1 to 100")
    }

    fn open<D: Lookup>(self, inputs: &Inputs<'_>, weights: &D::Weights) -> Result<Box<dyn Opened<D>>, OpenError> {
        Ok(Box::new(Named {
            factory: VinnFactory {
                memory: Arc::new(Memory::<D>::open(inputs, weights)?),
                config: self,
            },
            names: inputs.names.clone(),
        }))
    }
}

impl PlaneVinn {
    fn common(&self) -> Vinn {
        Vinn {
            neighbors: self.neighbors,
            temperature: self.temperature,
            history: self.history,
            actions: self.actions,
        }
    }
}

impl SpaceVinn {
    fn common(&self) -> Vinn {
        Vinn {
            neighbors: self.neighbors,
            temperature: self.temperature,
            history: self.history,
            actions: self.actions,
        }
    }
}

impl Settings<Plane> for PlaneVinn {
    fn check(&self, _: bool) -> Result<(), SettingError> {
        self.common().check()
    }

    fn open(&self, inputs: &Inputs<'_>) -> Result<Box<dyn Opened<Plane>>, OpenError> {
        self.common().open(inputs, &())
    }
}

impl Settings<Space> for SpaceVinn {
    fn check(&self, _: bool) -> Result<(), SettingError> {
        self.common().check()?;
        self.weights.check()
    }

    fn open(&self, inputs: &Inputs<'_>) -> Result<Box<dyn Opened<Space>>, OpenError> {
        self.common().open(inputs, &self.weights)
    }
}
