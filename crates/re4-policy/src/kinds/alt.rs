//! ALT, an action lookup table: recorded action sequences, keyed by a latent code of the state, with a monitor that reports
//! states unlike those of the demonstrations.
//!
//! The latent space is spanned by the principal components of the normalised state. It is divided into cells; every cell that
//! contains frames has one entry. A query takes the entry of its own cell, or the nearest entry if its cell is empty, and
//! replays the entry's actions. `docs/policies/alt.md` lists what differs from the published method.

use std::collections::btree_map::Entry;
use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::sync::Arc;

use rayon::prelude::*;
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
use crate::lookup::{ActionFrame, History, Latent, Lookup, Memory, SpaceWeights, nearest, squared};

/// Maximum number of frames from which the monitor computes its reference distances.
const REFERENCES: usize = 2000;

/// Settings of ALT in both domains.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Alt {
    horizon: u32,
    components: u32,
    cell: f64,
    history: u32,
    actions: ActionFrame,
    alarm: f64,
}

/// Settings of ALT for Push-T.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct PlaneAlt {
    /// Number of actions executed before the next lookup.
    pub horizon: u32,
    /// Number of principal components of the latent space. More than there are coordinates: all.
    pub components: u32,
    /// Size of a cell along each component, in normalised coordinates, whose range is 2. 0: every frame is an entry.
    pub cell: f64,
    /// Number of successive states in the latent code: 1 for the present state only.
    pub history: u32,
    /// The frame of actions. `world`: recorded targets are used as they are.
    pub actions: ActionFrame,
    /// A query is out of distribution if its distance exceeds this quantile of the distances of recorded frames to the entries
    /// of other demonstrations.
    pub alarm: f64,
}

impl Default for PlaneAlt {
    fn default() -> Self {
        Self {
            horizon: 12,
            components: 6,
            cell: 0.02,
            history: 1,
            actions: ActionFrame::Object,
            alarm: 0.99,
        }
    }
}

/// Settings of ALT for the robosuite tasks.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct SpaceAlt {
    /// Number of actions executed before the next lookup.
    pub horizon: u32,
    /// Number of principal components of the latent space. More than there are coordinates: all.
    pub components: u32,
    /// Size of a cell along each component, in normalised coordinates, whose range is 2. 0: every frame is an entry.
    pub cell: f64,
    /// Number of successive states in the latent code: 1 for the present state only.
    pub history: u32,
    /// The frame of goal poses. `world`: recorded goals are used as they are.
    pub actions: ActionFrame,
    /// A query is out of distribution if its distance exceeds this quantile of the distances of recorded frames to the entries
    /// of other demonstrations.
    pub alarm: f64,
    /// Weights of distances.
    pub weights: SpaceWeights,
}

impl Default for SpaceAlt {
    fn default() -> Self {
        Self {
            horizon: 8,
            components: 16,
            cell: 0.02,
            history: 1,
            actions: ActionFrame::World,
            alarm: 0.99,
            weights: SpaceWeights::default(),
        }
    }
}

table! {
    /// One row per decision of ALT, in the order of table decisions.
    #[table("decisions_alt", version = 1)]
    pub struct AltRow {
        /// Seed of the scene, or its number in the table scenes.
        pub seed: u32,
        /// Number of the decision in its rollout, from 0.
        pub decision: u32,
        /// Whether the cell of the query has an entry. If not, the nearest entry was used.
        pub hit: bool,
        /// Distance to the nearest entry in the latent space, dimensionless.
        pub distance: f64,
        /// Fraction of the reference distances that are smaller: distances of recorded frames to the nearest entry of another
        /// demonstration. Null with one demonstration.
        pub quantile: Option<f64>,
        /// Whether the query is out of distribution: its distance exceeds the quantile policy.alarm of the reference distances.
        pub out_of_distribution: bool,
        /// Number of entries of the table.
        pub entries: u32,
    }
}

/// The decision record of a lookup.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct AltDecision<D: Domain> {
    step: u32,
    proprio: D::Proprio,
    object: D::Pose,
    demo: u32,
    frame: u32,
    end: u32,
    found: Found,
    entries: u32,
}

/// The result of a lookup.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Found {
    /// Position of the frame.
    at: usize,
    hit: bool,
    distance: f64,
    quantile: Option<f64>,
    outside: bool,
}

impl<D: Domain> Explained<D> for AltDecision<D> {
    type Detail = AltRow;

    fn explanation(&self, names: &DemoNames) -> Explanation<D> {
        let how = if self.found.hit {
            "the entry of the state's cell"
        } else {
            "the nearest entry"
        };
        let outside = match (self.found.outside, self.found.quantile) {
            (true, Some(quantile)) => format!(
                "; the state is out of distribution: farther than {:.1} % of recorded frames",
                100.0 * quantile
            ),
            _ => String::new(),
        };
        Explanation {
            step: self.step,
            kind: "lookup",
            proprio: self.proprio,
            object: Some(self.object),
            demo: Some((self.demo, self.frame, self.end)),
            reason: format!(
                "{} from frame {}: {how} of {} (distance {:.4}){outside}",
                names.of(self.demo),
                self.frame,
                self.entries,
                self.found.distance
            ),
        }
    }

    fn detail(&self, seed: u32, decision: u32) -> AltRow {
        AltRow {
            seed,
            decision,
            hit: self.found.hit,
            distance: self.found.distance,
            quantile: self.found.quantile,
            out_of_distribution: self.found.outside,
            entries: self.entries,
        }
    }
}

/// The table with its monitor.
struct Lut<D: Lookup> {
    memory: Memory<D>,
    latent: Latent,
    /// The latent code of each entry, and the position of its frame.
    codes: Vec<(Vec<f64>, usize)>,
    /// The later frames of the cell of each entry, one per further demonstration: they are entries without the demonstrations before
    /// them.
    substitutes: Vec<Vec<(Vec<f64>, usize)>>,
    cells: BTreeMap<Vec<i64>, usize>,
    /// Reference distances in ascending order.
    references: Vec<f64>,
    config: Alt,
}

fn cell_of(code: &[f64], size: f64) -> Vec<i64> {
    code.iter().map(|value| (value / size).floor() as i64).collect()
}

impl<D: Lookup> Lut<D> {
    fn build(memory: Memory<D>, config: Alt) -> Self {
        let admitted: Vec<usize> = (0..memory.entries.len())
            .filter(|at| memory.entries[*at].retrievable)
            .collect();
        let features: Vec<Vec<f64>> = admitted
            .iter()
            .map(|at| History::<D>::features_of(&memory, *at, config.history))
            .collect();
        let latent = Latent::fit(&features, config.components as usize, 0.0);
        let all: Vec<(Vec<f64>, usize)> = features.iter().map(|row| latent.of(row)).zip(admitted).collect();
        let mut cells = BTreeMap::new();
        let mut substitutes: Vec<Vec<(Vec<f64>, usize)>> = Vec::new();
        let codes = if config.cell > 0.0 {
            let mut codes = Vec::new();
            for (code, at) in &all {
                match cells.entry(cell_of(code, config.cell)) {
                    Entry::Vacant(cell) => {
                        cell.insert(codes.len());
                        codes.push((code.clone(), *at));
                        substitutes.push(Vec::new());
                    }
                    Entry::Occupied(cell) => {
                        let (_, first) = codes[*cell.get()];
                        let later = &mut substitutes[*cell.get()];
                        // Frames are sorted by demonstration.
                        let last = later.last().map_or(first, |(_, last)| *last);
                        if memory.entries[last].demo != memory.entries[*at].demo {
                            later.push((code.clone(), *at));
                        }
                    }
                }
            }
            codes
        } else {
            substitutes.resize(all.len(), Vec::new());
            all.clone()
        };
        let mut lut = Self {
            memory,
            latent,
            codes,
            substitutes,
            cells,
            references: Vec::new(),
            config,
        };
        lut.references = lut.reference_distances(&all);
        lut
    }

    /// Distances of recorded frames, evenly spaced over all demonstrations, to the nearest entry of another demonstration, in
    /// ascending order.
    fn reference_distances(&self, all: &[(Vec<f64>, usize)]) -> Vec<f64> {
        let step = all.len().div_ceil(REFERENCES).max(1);
        let demo = |at: usize| self.memory.entries[at].demo;
        let sample: Vec<&(Vec<f64>, usize)> = all.iter().step_by(step).collect();
        let mut distances: Vec<f64> = sample
            .into_par_iter()
            .filter_map(|(code, at)| {
                let others = self.codes.iter().map(|(other, place)| {
                    let other_demo = demo(*place) != demo(*at);
                    other_demo.then(|| squared(code, other))
                });
                nearest(others, 1).first().map(|(squared, _)| squared.sqrt())
            })
            .collect();
        distances.sort_by(f64::total_cmp);
        distances
    }

    /// The entry of a cell without some demonstrations: its code and the position of its frame. `None` if only they have frames there.
    fn entry(&self, cell: usize, without: &BTreeSet<u32>) -> Option<&(Vec<f64>, usize)> {
        let mut frames = std::iter::once(&self.codes[cell]).chain(&self.substitutes[cell]);
        frames.find(|(_, at)| !without.contains(&self.memory.entries[*at].demo))
    }

    /// The demonstrations without which [`Self::find`] would have found another frame than this one. Without the demonstration of
    /// an entry, the cell has another entry, which may be nearer to the code.
    fn considered(&self, code: &[f64], found: &Found, without: &BTreeSet<u32>) -> BTreeSet<u32> {
        let demo = |at: usize| self.memory.entries[at].demo;
        let mut demos = BTreeSet::from([demo(found.at)]);
        if found.hit {
            return demos;
        }
        for cell in 0..self.codes.len() {
            let Some((_, at)) = self.entry(cell, without) else {
                continue;
            };
            let mut without = without.clone();
            without.insert(demo(*at));
            let nearer = self
                .entry(cell, &without)
                .is_some_and(|(other, _)| squared(code, other).sqrt() <= found.distance);
            if nearer {
                demos.insert(demo(*at));
            }
        }
        demos
    }

    fn find(&self, code: &[f64], without: &BTreeSet<u32>) -> Option<Found> {
        let distances = (0..self.codes.len()).map(|cell| {
            let (other, _) = self.entry(cell, without)?;
            Some(squared(code, other))
        });
        let (squared, nearest) = *nearest(distances, 1).first()?;
        let distance = squared.sqrt();
        let own = match self.config.cell {
            0.0 => None,
            size => self.cells.get(&cell_of(code, size)).copied(),
        };
        let own = own.filter(|cell| self.entry(*cell, without).is_some());
        let (_, at) = self.entry(own.unwrap_or(nearest), without)?;
        let count = self.references.len();
        let below = self.references.partition_point(|reference| *reference < distance);
        let quantile = (count > 0).then(|| below as f64 / count as f64);
        Some(Found {
            at: *at,
            hit: own.is_some(),
            distance,
            quantile,
            outside: quantile.is_some_and(|quantile| quantile > self.config.alarm),
        })
    }
}

struct AltFactory<D: Lookup> {
    lut: Arc<Lut<D>>,
}

struct AltPolicy<D: Lookup> {
    lut: Arc<Lut<D>>,
    history: History<D>,
    /// Positions of the frames whose actions have yet to be executed.
    plan: VecDeque<usize>,
    trace: Trace,
    step: u32,
}

impl<D: Lookup> PolicyFactory<D> for AltFactory<D> {
    type Policy = AltPolicy<D>;

    fn start(&self, _: u32, _: &D::Proprio) -> AltPolicy<D> {
        AltPolicy {
            lut: Arc::clone(&self.lut),
            history: History::new(self.lut.config.history),
            plan: VecDeque::new(),
            trace: Trace::default(),
            step: 0,
        }
    }

    fn start_without(&self, seed: u32, first: &D::Proprio, without: &Arc<BTreeSet<u32>>) -> Option<AltPolicy<D>> {
        Some(AltPolicy {
            trace: Trace::without(without),
            ..self.start(seed, first)
        })
    }
}

impl<D: Lookup> AltPolicy<D> {
    fn decide(&mut self, proprio: D::Proprio, object: D::Pose) -> Result<AltDecision<D>, LookupError> {
        let lut = &self.lut;
        let code = lut.latent.of(&self.history.features(&lut.memory));
        let without = self.trace.left_out();
        let found = lut.find(&code, without).ok_or(LookupError::NothingToDo)?;
        if self.trace.is_on() {
            let considered = lut.considered(&code, &found, without);
            self.trace.consider(considered);
        }
        let run = lut.memory.run(found.at, lut.config.horizon as usize);
        self.plan = (found.at..found.at + run).collect();
        let first = &lut.memory.entries[found.at];
        Ok(AltDecision {
            step: self.step,
            proprio,
            object,
            demo: first.demo,
            frame: first.frame,
            end: first.frame + (run as u32).saturating_sub(1),
            found,
            entries: lut.codes.len() as u32,
        })
    }
}

impl<D: Lookup> Policy<D> for AltPolicy<D> {
    type Decision = AltDecision<D>;

    fn act(&mut self, senses: &mut dyn Senses<D>) -> Result<Act<D, AltDecision<D>>, PolicyError> {
        // An image is only needed at lookups, unless the latent code contains earlier states or actions follow the object.
        let config = self.lut.config;
        let observes = self.plan.is_empty() || config.history > 1 || config.actions == ActionFrame::Object;
        let proprio = senses.proprio();
        let mut object = None;
        if observes {
            let pose = senses.object()?.pose;
            self.history.push(self.lut.memory.query(&proprio, &pose)?);
            object = Some(pose);
        }
        let decision = match object {
            Some(pose) if self.plan.is_empty() => Some(self.decide(proprio, pose)?),
            _ => None,
        };
        let at = self.plan.pop_front().ok_or(LookupError::NothingToDo)?;
        let entry = &self.lut.memory.entries[at];
        let pose = object.unwrap_or(entry.object);
        self.step += 1;
        Ok(Act {
            action: D::mean(&[(1.0, entry)], &pose, config.actions),
            phase: Phase::Replay,
            decision,
            object,
        })
    }

    fn considered(&self) -> Option<&BTreeSet<u32>> {
        self.trace.considered()
    }
}

impl Alt {
    fn check(&self) -> Result<(), SettingError> {
        SettingError::unless(self.horizon >= 1, "horizon", self.horizon, "give 1 or more")?;
        SettingError::unless(self.components >= 1, "components", self.components, "give 1 or more")?;
        let valid = self.cell == 0.0 || (1e-6..=1e6).contains(&self.cell);
        SettingError::unless(valid, "cell", self.cell, "give 0, or a number from 0.000001 to 1000000")?;
        let valid = (1..=100).contains(&self.history);
        SettingError::unless(valid, "history", self.history, "give a number from 1 to 100")?;
        let valid = (0.0..=1.0).contains(&self.alarm);
        SettingError::unless(valid, "alarm", self.alarm, "give a number from 0 to 1")
    }

    fn open<D: Lookup>(self, inputs: &Inputs<'_>, weights: &D::Weights) -> Result<Box<dyn Opened<D>>, OpenError> {
        let lut = Lut::<D>::build(Memory::open(inputs, weights)?, self);
        Ok(Box::new(Named {
            factory: AltFactory { lut: Arc::new(lut) },
            names: inputs.names.clone(),
        }))
    }
}

impl PlaneAlt {
    fn common(&self) -> Alt {
        Alt {
            horizon: self.horizon,
            components: self.components,
            cell: self.cell,
            history: self.history,
            actions: self.actions,
            alarm: self.alarm,
        }
    }
}

impl SpaceAlt {
    fn common(&self) -> Alt {
        Alt {
            horizon: self.horizon,
            components: self.components,
            cell: self.cell,
            history: self.history,
            actions: self.actions,
            alarm: self.alarm,
        }
    }
}

impl Settings<Plane> for PlaneAlt {
    fn check(&self, _: bool) -> Result<(), SettingError> {
        self.common().check()
    }

    fn open(&self, inputs: &Inputs<'_>) -> Result<Box<dyn Opened<Plane>>, OpenError> {
        self.common().open(inputs, &())
    }
}

impl Settings<Space> for SpaceAlt {
    fn check(&self, _: bool) -> Result<(), SettingError> {
        self.common().check()?;
        self.weights.check()
    }

    fn open(&self, inputs: &Inputs<'_>) -> Result<Box<dyn Opened<Space>>, OpenError> {
        self.common().open(inputs, &self.weights)
    }
}
