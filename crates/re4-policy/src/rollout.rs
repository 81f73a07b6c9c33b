//! Rollouts: a policy against the simulator, scene after scene.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use rayon::prelude::*;
use re4_geometry::Point2;
use re4_sim::{
    PushT, PushTObservation, ResetOrder, Scene, SeedScheme, SimError, Simulator as _, Step, scene_from_seed,
};
use thiserror::Error;

use crate::config::PolicyConfig;
use crate::perception::{Eyes, Perception, Sight};
use crate::policy::{Decision, Knowledge, Phase, Re4};
use crate::{Policy, PolicyError};

/// Where a rollout starts. Scores over different sets of starts must not be compared.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Start {
    /// Names the scene: its seed, or its number in a list of scenes. It seeds the policy's random numbers too.
    pub number: u32,
    /// State to ask for.
    pub scene: Scene,
    /// In which order the reset sets position and angle.
    pub order: ResetOrder,
}

impl Start {
    /// The start that a seed stands for.
    pub fn from_seed(scheme: SeedScheme, order: ResetOrder, seed: u32) -> Self {
        Self {
            number: seed,
            scene: scene_from_seed(scheme, seed),
            order,
        }
    }
}

/// One control step of a rollout.
#[derive(Debug, Clone, PartialEq)]
pub struct StepRecord {
    /// What the policy saw before the step.
    pub sight: Sight,
    /// Target sent.
    pub action: Point2,
    /// Part of the loop.
    pub phase: Phase,
    /// Decision that the action follows from (position in [`EpisodeRollout::decisions`]).
    pub decision: u32,
    /// What came of it.
    pub after: Step<PushTObservation>,
}

/// A rollout from one scene.
#[derive(Debug, Clone, PartialEq)]
pub struct EpisodeRollout {
    /// What was asked for.
    pub start: Start,
    /// State and coverage after the reset.
    pub first: Step<PushTObservation>,
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
    #[error("rollout of scene {scene} failed at step {step}: {source}")]
    Simulator {
        /// Number of the scene.
        scene: u32,
        /// Steps taken.
        step: usize,
        /// What it refused.
        source: SimError,
    },
    /// The policy had no action.
    #[error("rollout of scene {scene} failed at step {step}: {source}")]
    Policy {
        /// Number of the scene.
        scene: u32,
        /// Steps taken.
        step: usize,
        /// Why.
        source: PolicyError,
    },
    /// No block in the first picture.
    #[error(
        "rollout of scene {scene} failed at step {step}: no block is seen in the picture and none was seen before; start from a scene that shows it"
    )]
    Blind {
        /// Number of the scene.
        scene: u32,
        /// Steps taken.
        step: usize,
    },
    /// The caller asked to stop.
    #[error("the rollout was interrupted; nothing was written, run it again")]
    Interrupted,
}

/// Rolls a policy out from one scene, until success or the step budget.
///
/// # Errors
/// When the simulator refuses the scene or an action, the policy has no action, or no block is seen.
pub fn rollout(
    simulator: &mut PushT,
    policy: &mut dyn Policy,
    perception: &Perception,
    start: Start,
    max_steps: u32,
) -> Result<EpisodeRollout, RolloutError> {
    let scene = start.number;
    let refused = |step| move |source| RolloutError::Simulator { scene, step, source };
    simulator.reset(&start.scene, start.order).map_err(refused(0))?;
    let first = simulator.outcome();
    let mut eyes = Eyes::new(perception.clone());
    let mut steps: Vec<StepRecord> = Vec::new();
    let mut decisions = Vec::new();
    for step in 0..max_steps as usize {
        let sight = eyes.look(simulator).ok_or(RolloutError::Blind { scene, step })?;
        let act = policy
            .act(&sight.observation)
            .map_err(|source| RolloutError::Policy { scene, step, source })?;
        decisions.extend(act.decision);
        let after = simulator.step(&act.target).map_err(refused(step))?;
        steps.push(StepRecord {
            sight,
            action: act.target,
            phase: act.phase,
            decision: (decisions.len() as u32).saturating_sub(1),
            after,
        });
        if after.success {
            break;
        }
    }
    Ok(EpisodeRollout {
        start,
        first,
        steps,
        decisions,
    })
}

/// Rolls a policy out from many scenes, in parallel on the current thread pool; results come in the order of `starts` and
/// do not depend on the number of threads.
///
/// `progress` is called after every episode and says whether to go on.
///
/// # Errors
/// The first error in the order of `starts`.
pub fn rollouts(
    config: &PolicyConfig,
    knowledge: &Arc<Knowledge>,
    perception: &Perception,
    starts: &[Start],
    max_steps: u32,
    progress: &(dyn Fn() -> bool + Sync),
) -> Result<Vec<EpisodeRollout>, RolloutError> {
    let stopped = AtomicBool::new(false);
    starts
        .par_iter()
        .map(|&start| {
            if stopped.load(Ordering::Relaxed) {
                return Err(RolloutError::Interrupted);
            }
            let mut simulator = PushT::new().map_err(|source| RolloutError::Simulator {
                scene: start.number,
                step: 0,
                source,
            })?;
            let mut policy = Re4::new(config.clone(), Arc::clone(knowledge), u64::from(start.number));
            let episode = rollout(&mut simulator, &mut policy, perception, start, max_steps)?;
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
