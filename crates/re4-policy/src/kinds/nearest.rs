//! The nearest-neighbour baseline: it replays the recorded actions of the frame with the nearest state.
//!
//! It does not retrieve by outcome, does not transform actions to the observed object pose and does not plan, so it shows what a
//! policy achieves without any of these. It is also the smallest complete policy, and its module is a template for new ones:
//!
//! * [`PlaneNearest`] and [`SpaceNearest`] are the settings in the two domains. Their [`Settings`] implementations check the
//!   settings and open the index artifact.
//! * [`NearestRow`] is the policy-specific table; `NearestDecision` is the decision record that fills it.
//! * `NearestFactory` shares the demonstrations between episodes and starts a `Nearest`, the policy, for each of them.

use std::collections::{BTreeSet, VecDeque};
use std::sync::Arc;

use re4_artifact::{Stage, table};
use re4_episode::{DemoNames, Mode};
use re4_geometry::Point2;
use re4_index::{AngleMetric, IndexError, IndexRow, Normalization, PlanarState, Query, SpatialQuery, Stage2};
use re4_rollout::{
    Act, ArmAction, Domain, Explained, Explanation, Named, Opened, Phase, Plane, Policy, PolicyError, PolicyFactory,
    Recorded, Senses, Space, Trace,
};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::{Inputs, OpenError, SettingError, Settings};
use crate::LookupError;
use crate::artifact::{open_spatial_index, read_scales};
use crate::spatial::{SpatialKnowledge, SpatialPolicyConfig, SpatialRetrieveConfig};

/// Settings of the nearest-neighbour policy for Push-T. States are compared by the Euclidean distance of their min-max-normalised
/// coordinates, with periodic angles.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct PlaneNearest {
    /// Number of actions executed before the next lookup.
    pub horizon: u32,
}

impl Default for PlaneNearest {
    fn default() -> Self {
        Self { horizon: 1 }
    }
}

/// Settings of the nearest-neighbour policy for the robosuite tasks. Only frames of the mode given by the last gripper command
/// are compared. The distance is over the object pose and the end-effector pose in the object frame.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct SpaceNearest {
    /// Number of actions executed before the next lookup.
    pub horizon: u32,
    /// Translation that contributes a distance of 1, in metres.
    pub translation_scale: f64,
    /// Rotation that contributes a distance of 1, in rad.
    pub rotation_scale: f64,
}

impl Default for SpaceNearest {
    fn default() -> Self {
        Self {
            horizon: 1,
            translation_scale: 0.1,
            rotation_scale: 1.0,
        }
    }
}

table! {
    /// One row per decision of the nearest-neighbour policy, in the order of table decisions.
    #[table("decisions_nearest", version = 1)]
    pub struct NearestRow {
        /// Seed of the scene, or its number in the table scenes.
        pub seed: u32,
        /// Number of the decision in its rollout, from 0.
        pub decision: u32,
        /// Distance between the states, dimensionless.
        pub distance: f64,
        /// Number of frames that were compared.
        pub compared: u32,
    }
}

/// The decision record of one lookup.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct NearestDecision<D: Domain> {
    step: u32,
    proprio: D::Proprio,
    object: D::Pose,
    found: Found,
}

/// The result of a lookup.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Found {
    demo: u32,
    frame: u32,
    /// Last frame whose action is executed.
    end: u32,
    distance: f64,
    compared: u32,
}

impl<D: Domain> Explained<D> for NearestDecision<D> {
    type Detail = NearestRow;

    fn explanation(&self, names: &DemoNames) -> Explanation<D> {
        let Found {
            demo,
            frame,
            end,
            distance,
            compared,
        } = self.found;
        Explanation {
            step: self.step,
            kind: "nearest",
            proprio: self.proprio,
            object: Some(self.object),
            demo: Some((demo, frame, end)),
            reason: format!(
                "{} from frame {frame}: the nearest of {compared} states (distance {distance:.4})",
                names.of(demo)
            ),
        }
    }

    fn detail(&self, seed: u32, decision: u32) -> NearestRow {
        NearestRow {
            seed,
            decision,
            distance: self.found.distance,
            compared: self.found.compared,
        }
    }
}

/// The states and actions of the demonstrations in one domain.
trait States<D: Domain>: Send + Sync {
    /// Finds the nearest frame among the demonstrations that are not in `without`. `closed` is true if the last command closed the
    /// gripper. Returns the frame and up to `horizon` actions, starting with the action of the frame.
    fn nearest(
        &self,
        proprio: &D::Proprio,
        object: &D::Pose,
        closed: bool,
        horizon: usize,
        without: &BTreeSet<u32>,
    ) -> Result<(Found, Vec<D::Action>), LookupError>;

    /// Returns whether an action closes the gripper.
    fn closes(action: &D::Action) -> bool;
}

struct NearestFactory<S> {
    states: Arc<S>,
    horizon: usize,
}

struct Nearest<D: Domain, S> {
    states: Arc<S>,
    horizon: usize,
    /// Actions that have yet to be executed.
    chunk: VecDeque<D::Action>,
    closed: bool,
    trace: Trace,
    step: u32,
}

impl<D: Domain, S: States<D>> PolicyFactory<D> for NearestFactory<S> {
    type Policy = Nearest<D, S>;

    fn start(&self, _: u32, _: &D::Proprio) -> Nearest<D, S> {
        Nearest {
            states: Arc::clone(&self.states),
            horizon: self.horizon,
            chunk: VecDeque::new(),
            closed: false,
            trace: Trace::default(),
            step: 0,
        }
    }

    fn start_without(&self, seed: u32, first: &D::Proprio, without: &Arc<BTreeSet<u32>>) -> Option<Nearest<D, S>> {
        Some(Nearest {
            trace: Trace::without(without),
            ..self.start(seed, first)
        })
    }
}

impl<D: Domain, S: States<D>> Policy<D> for Nearest<D, S> {
    type Decision = NearestDecision<D>;

    fn act(&mut self, senses: &mut dyn Senses<D>) -> Result<Act<D, NearestDecision<D>>, PolicyError> {
        let mut decision = None;
        if self.chunk.is_empty() {
            let (proprio, object) = (senses.proprio(), senses.object()?.pose);
            let without = self.trace.left_out();
            let (found, actions) = self
                .states
                .nearest(&proprio, &object, self.closed, self.horizon, without)?;
            // A minimum is the same without any frame that does not attain it.
            self.trace.consider([found.demo]);
            self.chunk.extend(actions);
            decision = Some(NearestDecision {
                step: self.step,
                proprio,
                object,
                found,
            });
        }
        let action = self.chunk.pop_front().ok_or(LookupError::NothingToDo)?;
        self.closed = S::closes(&action);
        self.step += 1;
        Ok(Act {
            action,
            phase: Phase::Replay,
            object: decision.as_ref().map(|decision| decision.object),
            decision,
        })
    }

    fn considered(&self) -> Option<&BTreeSet<u32>> {
        self.trace.considered()
    }
}

struct PlaneStates {
    frames: Vec<IndexRow<PlanarState>>,
    normalization: Normalization,
}

impl States<Plane> for PlaneStates {
    fn nearest(
        &self,
        eef: &Point2,
        object: &re4_geometry::Pose2,
        _: bool,
        horizon: usize,
        without: &BTreeSet<u32>,
    ) -> Result<(Found, Vec<Point2>), LookupError> {
        // The pusher does not grasp, so every frame of Push-T is in transit.
        let mode = Mode::Transit;
        let (eef, object) = (*eef, *object);
        let q = self.normalization.query(&Query { mode, eef, object });
        if q.iter().any(|number| !number.is_finite()) {
            return Err(IndexError::QueryNotFinite.into());
        }
        let period = self.normalization.period();
        let squared = |frame: &IndexRow<PlanarState>| {
            let [x, y, object_x, object_y, angle] = std::array::from_fn(|i| (frame.state.q[i] - q[i]).abs());
            let angle = angle.min((period - angle).abs());
            x * x + y * y + object_x * object_x + object_y * object_y + angle * angle
        };
        let admitted = self.frames.iter().enumerate();
        let admitted =
            admitted.filter(|(_, frame)| frame.retrievable != Some(false) && !without.contains(&frame.episode));
        let (mut best, mut compared) = (None, 0);
        for (at, frame) in admitted {
            let distance = squared(frame);
            compared += 1;
            if best.is_none_or(|(minimum, _)| distance < minimum) {
                best = Some((distance, at));
            }
        }
        let (distance, at) = best.ok_or(LookupError::NoFrameOfMode { mode })?;
        let first = &self.frames[at];
        let chunk = self.frames[at..].iter().take(horizon);
        let actions: Vec<Point2> = chunk
            .take_while(|frame| frame.episode == first.episode)
            .map(|frame| frame.state.action)
            .collect();
        let found = Found {
            demo: first.episode,
            frame: first.frame,
            end: first.frame + actions.len() as u32 - 1,
            distance: distance.sqrt(),
            compared,
        };
        Ok((found, actions))
    }

    fn closes(_: &Point2) -> bool {
        false
    }
}

impl States<Space> for SpatialKnowledge {
    fn nearest(
        &self,
        arm: &re4_rollout::ArmState,
        object: &nalgebra::Isometry3<f64>,
        closed: bool,
        horizon: usize,
        without: &BTreeSet<u32>,
    ) -> Result<(Found, Vec<ArmAction>), LookupError> {
        let mode = if closed { Mode::Transfer } else { Mode::Transit };
        let (eef, object) = (arm.eef, *object);
        let query = SpatialQuery { mode, eef, object };
        // If both stages use `d_q`, the two-stage lookup returns the nearest state over all demonstrations.
        let found = self
            .index()
            .retrieve_without(&query, Stage2::State, &BTreeSet::new(), without)?;
        let found = found.ok_or(LookupError::NoFrameOfMode { mode })?;
        let frames = self.demos().demo(found.episode).unwrap_or_default();
        let chunk = frames.iter().skip(found.frame as usize).take(horizon);
        let actions: Vec<ArmAction> = chunk
            .map(|frame| ArmAction {
                goal: frame.goal,
                gripper: frame.gripper,
            })
            .collect();
        let found = Found {
            demo: found.episode,
            frame: found.frame,
            end: found.frame + (actions.len() as u32).saturating_sub(1),
            distance: found.distances.d_q,
            compared: self.index().frames().iter().filter(|frame| frame.mode == mode).count() as u32,
        };
        Ok((found, actions))
    }

    fn closes(action: &ArmAction) -> bool {
        action.gripper > 0.0
    }
}

fn opened<D: Recorded, S: States<D> + 'static>(states: S, horizon: u32, names: DemoNames) -> Box<dyn Opened<D>> {
    let (states, horizon) = (Arc::new(states), horizon as usize);
    Box::new(Named {
        factory: NearestFactory { states, horizon },
        names,
    })
}

impl Settings<Plane> for PlaneNearest {
    fn check(&self, _: bool) -> Result<(), SettingError> {
        SettingError::unless(self.horizon >= 1, "horizon", self.horizon, "give 1 or more")
    }

    fn open(&self, inputs: &Inputs<'_>) -> Result<Box<dyn Opened<Plane>>, OpenError> {
        let index = inputs.of(Stage::Index)?;
        let states = PlaneStates {
            frames: index.read()?,
            normalization: Normalization {
                ranges: read_scales(index)?,
                angle: AngleMetric::Periodic,
            },
        };
        Ok(opened(states, self.horizon, inputs.names.clone()))
    }
}

impl Settings<Space> for SpaceNearest {
    fn check(&self, _: bool) -> Result<(), SettingError> {
        SettingError::unless(self.horizon >= 1, "horizon", self.horizon, "give 1 or more")?;
        for (setting, scale) in [
            ("translation_scale", self.translation_scale),
            ("rotation_scale", self.rotation_scale),
        ] {
            let valid = scale.is_finite() && scale > 0.0;
            SettingError::unless(valid, setting, scale, "give a finite number above 0")?;
        }
        Ok(())
    }

    fn open(&self, inputs: &Inputs<'_>) -> Result<Box<dyn Opened<Space>>, OpenError> {
        let retrieve = SpatialRetrieveConfig {
            translation_scale: self.translation_scale,
            rotation_scale: self.rotation_scale,
            ..SpatialPolicyConfig::paper().retrieve
        };
        let names = inputs.names.clone();
        let states = open_spatial_index(inputs.of(Stage::Index)?, &retrieve, inputs.symmetry, names.clone())?;
        Ok(opened(states, self.horizon, names))
    }
}
