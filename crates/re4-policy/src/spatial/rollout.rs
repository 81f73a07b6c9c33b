//! Rollouts in space: a policy against robosuite's tasks, seed after seed.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use rayon::prelude::*;
use re4_sim::robosuite::{
    ArmAction, FirstTorques, Robosuite, RobosuiteAction, RobosuiteModel, RobosuiteObservation, RobosuiteScene,
    RobosuiteStep,
};
use re4_sim::{SimError, Simulator as _};

use crate::spatial::{
    PoseNoise, SpatialAction, SpatialDecision, SpatialKnowledge, SpatialObservation, SpatialPhase, SpatialPolicy,
    SpatialPolicyConfig, SpatialRe4,
};
use crate::{PolicyError, RolloutError};

/// Where a rollout in space starts.
#[derive(Clone)]
pub struct SpatialStart {
    /// Seed of the scene; it seeds the errors of observed poses, too.
    pub seed: u32,
    /// The model, which may differ from seed to seed.
    pub model: RobosuiteModel,
    /// Coordinates at rest.
    pub scene: RobosuiteScene,
}

/// Errors that observed object poses are given on purpose.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct NoiseLevel {
    /// Standard deviation along each axis, in metres.
    pub translation: f64,
    /// Standard deviation of each component of a rotation vector, in rad.
    pub rotation: f64,
}

/// One control step of a rollout.
#[derive(Debug, Clone, PartialEq)]
pub struct SpatialStepRecord {
    /// What the policy saw before the step.
    pub seen: SpatialObservation,
    /// What it commanded.
    pub action: SpatialAction,
    /// Part of the loop.
    pub phase: SpatialPhase,
    /// Decision that the action follows from (position in [`SpatialRollout::decisions`]).
    pub decision: u32,
    /// What came of it.
    pub after: RobosuiteStep,
}

/// A rollout from one seed.
#[derive(Debug, Clone, PartialEq)]
pub struct SpatialRollout {
    /// Seed of the scene.
    pub seed: u32,
    /// State after the reset.
    pub first: RobosuiteObservation,
    /// Time, coordinates and velocities after the reset.
    pub first_state: Vec<f64>,
    /// Control steps, to the first success at most.
    pub steps: Vec<SpatialStepRecord>,
    /// Decisions.
    pub decisions: Vec<SpatialDecision>,
}

impl SpatialRollout {
    /// Whether the task was done at some step, which ends the episode.
    pub fn success(&self) -> bool {
        self.steps.last().is_some_and(|step| step.after.success)
    }
}

/// What a policy sees of a robosuite task: the grip site, the object, the fingers.
pub fn observe(observation: &RobosuiteObservation) -> SpatialObservation {
    SpatialObservation {
        eef: observation.grip_site,
        object: observation.object,
        fingers: observation.fingers,
    }
}

/// An action as robosuite's controller takes it: the absolute goal of the grip site.
pub fn to_robosuite(action: &SpatialAction) -> RobosuiteAction {
    let (t, r) = (action.goal.translation.vector, action.goal.rotation.scaled_axis());
    RobosuiteAction {
        arm: ArmAction::Absolute([t.x, t.y, t.z, r.x, r.y, r.z]),
        gripper: action.gripper,
    }
}

/// Rolls a policy out from one seed, until success or the step budget. The policy is made when the scene is known.
///
/// # Errors
/// When the simulator refuses, or the policy has no action.
pub fn spatial_rollout<P: SpatialPolicy>(
    start: &SpatialStart,
    noise: NoiseLevel,
    max_steps: u32,
    policy: impl FnOnce(&SpatialObservation) -> P,
) -> Result<SpatialRollout, RolloutError> {
    let scene = start.seed;
    let refused = |step: usize| move |source: SimError| RolloutError::Simulator { scene, step, source };
    let mut simulator = Robosuite::new(&start.model).map_err(refused(0))?;
    let first = simulator
        .reset(&start.scene, FirstTorques::AsRobosuite)
        .map_err(refused(0))?;
    let first_state = simulator.state();
    let mut errors = PoseNoise::new(u64::from(scene), noise.translation, noise.rotation);
    let mut policy = policy(&observe(&first));
    let mut now = first;
    let mut steps: Vec<SpatialStepRecord> = Vec::new();
    let mut decisions = Vec::new();
    for step in 0..max_steps as usize {
        let mut seen = observe(&now);
        if noise != NoiseLevel::default() {
            seen.object = errors.perturb(&seen.object);
        }
        let act = policy
            .act(&seen)
            .map_err(|source: PolicyError| RolloutError::Policy { scene, step, source })?;
        decisions.extend(act.decision);
        let after = simulator.step(&to_robosuite(&act.action)).map_err(refused(step))?;
        steps.push(SpatialStepRecord {
            seen,
            action: act.action,
            phase: act.phase,
            decision: (decisions.len() as u32).saturating_sub(1),
            after,
        });
        if after.success {
            break;
        }
        now = after.observation;
    }
    Ok(SpatialRollout {
        seed: scene,
        first,
        first_state,
        steps,
        decisions,
    })
}

/// Rolls RE4 out from many seeds, in parallel on the current thread pool; results come in the order of `seeds` and do not
/// depend on the number of threads. `start` makes the scene of a seed; `progress` is called after every episode and says
/// whether to go on.
///
/// # Errors
/// The first error in the order of `seeds`.
pub fn spatial_rollouts(
    config: &SpatialPolicyConfig,
    knowledge: &Arc<SpatialKnowledge>,
    seeds: &[u32],
    noise: NoiseLevel,
    max_steps: u32,
    start: &(dyn Fn(u32) -> Result<SpatialStart, SimError> + Sync),
    progress: &(dyn Fn() -> bool + Sync),
) -> Result<Vec<SpatialRollout>, RolloutError> {
    let stopped = AtomicBool::new(false);
    seeds
        .par_iter()
        .with_max_len(1)
        .map(|&seed| {
            if stopped.load(Ordering::Relaxed) {
                return Err(RolloutError::Interrupted);
            }
            let start = start(seed).map_err(|source| RolloutError::Simulator {
                scene: seed,
                step: 0,
                source,
            })?;
            let episode = spatial_rollout(&start, noise, max_steps, |seen| {
                SpatialRe4::new(config.clone(), Arc::clone(knowledge), seen.eef)
            })?;
            if progress() {
                Ok(episode)
            } else {
                stopped.store(true, Ordering::Relaxed);
                Err(RolloutError::Interrupted)
            }
        })
        .collect::<Vec<_>>()
        .into_iter()
        .collect()
}
