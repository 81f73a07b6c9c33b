//! Rollouts: a policy against the simulator, seed after seed.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use rayon::prelude::*;
use re4_geometry::Point2;
use re4_sim::{
    PushT, PushTObservation, ResetOrder, Scene, SeedScheme, SimError, Simulator as _, Step, scene_from_seed,
};
use thiserror::Error;

use crate::config::PolicyConfig;
use crate::policy::{Decision, Knowledge, Phase, Re4};
use crate::{Policy, PolicyError};

/// How episodes start and end. Scores of different protocols must not be compared.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Protocol {
    /// Whose seeds: which generator turns a seed into a scene.
    pub scheme: SeedScheme,
    /// In which order a reset sets position and angle.
    pub order: ResetOrder,
    /// Control steps an episode lasts at most.
    pub max_steps: u32,
}

/// One control step of a rollout.
#[derive(Debug, Clone, PartialEq)]
pub struct StepRecord {
    /// What the policy saw before the step.
    pub before: PushTObservation,
    /// Target sent.
    pub action: Point2,
    /// Part of the loop.
    pub phase: Phase,
    /// Decision that the action follows from (position in [`EpisodeRollout::decisions`]).
    pub decision: u32,
    /// What came of it.
    pub after: Step<PushTObservation>,
}

/// A rollout from one seed.
#[derive(Debug, Clone, PartialEq)]
pub struct EpisodeRollout {
    /// Seed.
    pub seed: u32,
    /// Scene that the seed asks for.
    pub scene: Scene,
    /// State and coverage after the reset.
    pub start: Step<PushTObservation>,
    /// Control steps.
    pub steps: Vec<StepRecord>,
    /// Decisions.
    pub decisions: Vec<Decision>,
}

impl EpisodeRollout {
    /// Whether a step reached the success coverage, which ends the episode.
    pub fn success(&self) -> bool {
        self.steps.iter().any(|s| s.after.success)
    }

    /// Greatest value of a measure over the steps of the episode; 0 for an episode without steps.
    pub fn maximum(&self, measure: impl Fn(&Step<PushTObservation>) -> f64) -> f64 {
        self.steps.iter().map(|s| measure(&s.after)).fold(0.0, f64::max)
    }
}

/// Why a rollout could not be carried out.
#[derive(Debug, Error)]
pub enum RolloutError {
    /// The simulator refused.
    #[error("rollout of seed {seed} failed at step {step}: {source}")]
    Simulator {
        /// Seed.
        seed: u32,
        /// Steps taken.
        step: usize,
        /// What it refused.
        source: SimError,
    },
    /// The policy had no action.
    #[error("rollout of seed {seed} failed at step {step}: {source}")]
    Policy {
        /// Seed.
        seed: u32,
        /// Steps taken.
        step: usize,
        /// Why.
        source: PolicyError,
    },
    /// The caller asked to stop.
    #[error("the rollout was interrupted; nothing was written, run it again")]
    Interrupted,
}

/// Rolls a policy out from one seed, until success or the step budget.
///
/// # Errors
/// When the simulator refuses the scene or an action, or the policy has no action.
pub fn rollout(
    simulator: &mut PushT,
    policy: &mut dyn Policy,
    seed: u32,
    protocol: Protocol,
) -> Result<EpisodeRollout, RolloutError> {
    let scene = scene_from_seed(protocol.scheme, seed);
    let refused = |step| move |source| RolloutError::Simulator { seed, step, source };
    simulator.reset(&scene, protocol.order).map_err(refused(0))?;
    let start = simulator.outcome();
    let mut observation = start.observation;
    let mut steps: Vec<StepRecord> = Vec::new();
    let mut decisions = Vec::new();
    for step in 0..protocol.max_steps as usize {
        let act = policy
            .act(&observation)
            .map_err(|source| RolloutError::Policy { seed, step, source })?;
        decisions.extend(act.decision);
        let after = simulator.step(&act.target).map_err(refused(step))?;
        steps.push(StepRecord {
            before: observation,
            action: act.target,
            phase: act.phase,
            decision: (decisions.len() as u32).saturating_sub(1),
            after,
        });
        observation = after.observation;
        if after.success {
            break;
        }
    }
    Ok(EpisodeRollout {
        seed,
        scene,
        start,
        steps,
        decisions,
    })
}

/// Rolls a policy out from many seeds, in parallel on the current thread pool; results come in the order of `seeds` and
/// do not depend on the number of threads.
///
/// `progress` is called after every episode and says whether to go on.
///
/// # Errors
/// The first error in the order of `seeds`.
pub fn rollouts(
    config: &PolicyConfig,
    knowledge: &Arc<Knowledge>,
    seeds: &[u32],
    protocol: Protocol,
    progress: &(dyn Fn() -> bool + Sync),
) -> Result<Vec<EpisodeRollout>, RolloutError> {
    let stopped = AtomicBool::new(false);
    seeds
        .par_iter()
        .map(|&seed| {
            if stopped.load(Ordering::Relaxed) {
                return Err(RolloutError::Interrupted);
            }
            let mut simulator = PushT::new().map_err(|source| RolloutError::Simulator { seed, step: 0, source })?;
            let mut policy = Re4::new(config.clone(), Arc::clone(knowledge), u64::from(seed));
            let episode = rollout(&mut simulator, &mut policy, seed, protocol)?;
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
