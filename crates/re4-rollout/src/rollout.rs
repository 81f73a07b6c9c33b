//! Rollouts: a policy against a simulation, start after start.

use re4_fault::Remedy;
use std::sync::atomic::{AtomicUsize, Ordering};

use re4_sim::{PushTObservation, ResetOrder, SeedScheme, SimError, Step, scene_from_seed};
use thiserror::Error;

use crate::senses::Sensing;
use crate::{Asked, Domain, Env, Phase, Plane, PlaneScene, Policy, PolicyError, PolicyFactory, Senses as _, Source};

/// Where a rollout starts. Scores over different sets of starts must not be compared.
#[derive(Debug, Clone, PartialEq)]
pub struct Start<D: Domain> {
    /// Names the scene: its seed, or its number in a list of scenes. It seeds the policy's random numbers too.
    pub seed: u32,
    /// The scene.
    pub scene: D::Scene,
}

impl Start<Plane> {
    /// The start that a seed stands for.
    pub fn from_seed(scheme: SeedScheme, order: ResetOrder, seed: u32) -> Self {
        Self {
            seed,
            scene: PlaneScene {
                state: scene_from_seed(scheme, seed),
                order,
            },
        }
    }
}

/// One control step of a rollout.
#[derive(Debug, Clone, PartialEq)]
pub struct StepRecord<D: Domain> {
    /// What the policy asked for before the step.
    pub asked: Asked<D>,
    /// Where the policy took the object to be: what it was told, or else what it went by, where it went by a pose at all.
    pub seen: Option<D::Pose>,
    /// What it commanded.
    pub action: D::Action,
    /// Part of the loop.
    pub phase: Phase,
    /// Decision that the action follows from (position in [`Rollout::decisions`]).
    pub decision: u32,
    /// What came of it.
    pub after: D::Outcome,
}

/// A rollout from one start.
#[derive(Debug, Clone, PartialEq)]
pub struct Rollout<D: Domain, X> {
    /// Where it started.
    pub start: Start<D>,
    /// State after the reset.
    pub first: D::First,
    /// Control steps, to the first success at most.
    pub steps: Vec<StepRecord<D>>,
    /// Decisions.
    pub decisions: Vec<X>,
}

impl<D: Domain, X> Rollout<D, X> {
    /// Whether the task was done at some step, which ends the episode.
    pub fn success(&self) -> bool {
        self.steps.last().is_some_and(|step| D::success(&step.after))
    }

    /// Images rendered.
    pub fn images(&self) -> u32 {
        self.steps.iter().map(|step| step.asked.images).sum()
    }
}

impl<X> Rollout<Plane, X> {
    /// Maximum value of a measure over the steps of the episode; 0 for an episode without steps.
    pub fn maximum(&self, measure: impl Fn(&Step<PushTObservation>) -> f64) -> f64 {
        self.steps.iter().map(|s| measure(&s.after)).fold(0.0, f64::max)
    }
}

/// Why a rollout could not be carried out.
#[derive(Debug, Error, Remedy)]
pub enum RolloutError {
    /// The simulator refused.
    #[error("rollout of scene {scene} failed at step {step}: {source}")]
    #[remedy(source.remedy())]
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
    #[remedy(source.remedy())]
    Policy {
        /// Number of the scene.
        scene: u32,
        /// Steps taken.
        step: usize,
        /// Why.
        source: PolicyError,
    },
    /// The caller asked to stop.
    #[error("the rollout was interrupted")]
    #[remedy("nothing was written, run it again")]
    Interrupted,
}

/// Rolls a policy out from one start, until success or the step budget. The policy is started when it is known what is felt
/// after the reset.
///
/// # Errors
/// When the simulator refuses the scene or an action, or the policy has no action.
pub fn rollout<D: Domain, F: PolicyFactory<D> + ?Sized>(
    factory: &F,
    env: &mut dyn Env<D>,
    source: Source<D>,
    start: Start<D>,
    max_steps: u32,
) -> Result<RolloutOf<D, F>, RolloutError> {
    let scene = start.seed;
    let refused = |step| move |source| RolloutError::Simulator { scene, step, source };
    let first = env.reset(&start.scene).map_err(refused(0))?;
    let mut senses = Sensing::new(env, source);
    let mut policy = factory.start(scene, &senses.proprio());
    let mut steps: Vec<StepRecord<D>> = Vec::new();
    let mut decisions = Vec::new();
    for step in 0..max_steps as usize {
        let act = policy
            .act(&mut senses)
            .map_err(|source| RolloutError::Policy { scene, step, source })?;
        decisions.extend(act.decision);
        let after = senses.env.step(&act.action).map_err(refused(step))?;
        let asked = senses.finish();
        steps.push(StepRecord {
            seen: asked.object.map(|told| told.pose).or(act.object),
            asked,
            action: act.action,
            phase: act.phase,
            decision: (decisions.len() as u32).saturating_sub(1),
            after,
        });
        if D::success(&after) {
            break;
        }
    }
    Ok(Rollout {
        start,
        first,
        steps,
        decisions,
    })
}

/// A rollout of the policies that a factory starts.
type RolloutOf<D, F> = Rollout<D, <<F as PolicyFactory<D>>::Policy as Policy<D>>::Decision>;

/// Makes the simulation of a start.
pub type MakeEnv<'a, 'e, D> = dyn Fn(&Start<D>) -> Result<Box<dyn Env<D> + 'e>, SimError> + Sync + 'a;

/// Says where the object's pose comes from in the episode of a seed.
pub type MakeSource<'a, D> = dyn Fn(u32) -> Source<D> + Sync + 'a;

/// What policies are rolled out in.
pub struct Harness<'a, 'e, D: Domain> {
    /// Makes the simulation of a start, in the thread that rolls it out.
    pub env: &'a MakeEnv<'a, 'e, D>,
    /// Where the object's pose comes from in the episode of a seed.
    pub source: &'a MakeSource<'a, D>,
    /// Control steps an episode lasts at most.
    pub max_steps: u32,
    /// Called after every episode; says whether to go on.
    pub progress: &'a (dyn Fn() -> bool + Sync),
}

/// Rolls a policy out from many starts, in as many threads as the current thread pool has. Results come in the order of
/// `starts` and do not depend on the number of threads.
///
/// The threads are not the pool's own: an estimator or a network that all episodes share may wait for work of its own that it
/// gave to the pool, and a thread of the pool that waits takes up another episode, which would ask the same estimator.
///
/// # Errors
/// The first error in the order of `starts`.
pub fn rollouts<D: Domain, F: PolicyFactory<D> + ?Sized>(
    factory: &F,
    harness: &Harness<'_, '_, D>,
    starts: &[Start<D>],
) -> Result<Vec<RolloutOf<D, F>>, RolloutError> {
    let one = |start: &Start<D>| {
        let refused = |source| RolloutError::Simulator {
            scene: start.seed,
            step: 0,
            source,
        };
        let mut env = (harness.env)(start).map_err(refused)?;
        let source = (harness.source)(start.seed);
        let episode = rollout(factory, env.as_mut(), source, start.clone(), harness.max_steps)?;
        if (harness.progress)() {
            Ok(episode)
        } else {
            Err(RolloutError::Interrupted)
        }
    };
    // Starts before the first that failed are finished, those after it are not begun.
    let (next, end) = (AtomicUsize::new(0), AtomicUsize::new(starts.len()));
    let work = || {
        let mut done = Vec::new();
        loop {
            let at = next.fetch_add(1, Ordering::Relaxed);
            if at >= end.load(Ordering::Relaxed) {
                break done;
            }
            let result = one(&starts[at]);
            if result.is_err() {
                end.fetch_min(at, Ordering::Relaxed);
            }
            done.push((at, result));
        }
    };
    let mut done: Vec<_> = std::thread::scope(|scope| {
        let threads = rayon::current_num_threads().min(starts.len());
        let workers: Vec<_> = (0..threads).map(|_| scope.spawn(work)).collect();
        let joined = workers.into_iter().map(|worker| match worker.join() {
            Ok(done) => done,
            Err(panic) => std::panic::resume_unwind(panic),
        });
        joined.flatten().collect()
    });
    done.sort_by_key(|(at, _)| *at);
    done.into_iter().map(|(_, result)| result).collect()
}
