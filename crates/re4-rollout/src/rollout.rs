//! Rollouts of a policy in a simulation, from one start after another.

use re4_fault::Remedy;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Instant;

use re4_sim::{GOAL, PushTObservation, ResetOrder, SeedScheme, SimError, Step, scene_from_seed};
use thiserror::Error;

use crate::conditions::Disturber;
use crate::senses::Sensing;
use crate::{
    ActTimes, AppliedDisturbance, Asked, Conditions, Domain, Env, Phase, Plane, PlaneScene, Policy, PolicyError,
    PolicyFactory, Senses as _, Source,
};

/// The start of a rollout. Scores over different sets of starts are not comparable.
#[derive(Debug, Clone, PartialEq)]
pub struct Start<D: Domain> {
    /// Identifies the scene: its seed, or its number in a list of scenes. It also seeds the policy's random numbers.
    pub seed: u32,
    /// The scene.
    pub scene: D::Scene,
}

impl Start<Plane> {
    /// Creates the start of a seed, with the goal of the task.
    pub fn from_seed(scheme: SeedScheme, order: ResetOrder, seed: u32) -> Self {
        Self {
            seed,
            scene: PlaneScene {
                state: scene_from_seed(scheme, seed),
                order,
                goal: GOAL,
            },
        }
    }
}

/// One control step of a rollout. Poses and actions are in the world frame.
#[derive(Debug, Clone, PartialEq)]
pub struct StepRecord<D: Domain> {
    /// The observations that the policy requested before the step.
    pub asked: Asked<D>,
    /// The object pose on which the policy based the step: the observed pose if it requested one, otherwise the pose that the
    /// policy reported. `None` if it used no pose.
    pub seen: Option<D::Pose>,
    /// The executed action.
    pub action: D::Action,
    /// Part of the policy's loop that the action belongs to.
    pub phase: Phase,
    /// Index in [`Rollout::decisions`] of the decision that the action follows from.
    pub decision: u32,
    /// The result of the step.
    pub after: D::Outcome,
}

/// A rollout from one start.
#[derive(Debug, Clone, PartialEq)]
pub struct Rollout<D: Domain, X> {
    /// The start.
    pub start: Start<D>,
    /// State after the reset.
    pub first: D::First,
    /// Control steps. A rollout ends at the first success.
    pub steps: Vec<StepRecord<D>>,
    /// Decision records in order, in the frame of the policy's observations.
    pub decisions: Vec<X>,
    /// The disturbance, if there was one.
    pub disturbance: Option<AppliedDisturbance>,
}

impl<D: Domain, X> Rollout<D, X> {
    /// Returns whether the task succeeded. Success ends the rollout, so only the last step is examined.
    pub fn success(&self) -> bool {
        self.steps.last().is_some_and(|step| D::success(&step.after))
    }

    /// Returns the motion from the frame of the policy's observations to the world frame, or `None` if they are the same.
    pub fn world_from_observed(&self) -> Option<D::Motion> {
        D::observed_from_world(&self.start.scene).map(|motion| D::inverse(&motion))
    }

    /// Returns the number of rendered images.
    pub fn images(&self) -> u32 {
        self.steps.iter().map(|step| step.asked.images).sum()
    }
}

impl<X> Rollout<Plane, X> {
    /// Returns the maximum of a measure over the steps of the episode, or 0 for an episode without steps.
    pub fn maximum(&self, measure: impl Fn(&Step<PushTObservation>) -> f64) -> f64 {
        self.steps.iter().map(|s| measure(&s.after)).fold(0.0, f64::max)
    }
}

/// An error that ends a rollout.
#[derive(Debug, Error, Remedy)]
pub enum RolloutError {
    /// The simulator rejected the scene or an action.
    #[error("rollout of scene {scene} failed at step {step}: {source}")]
    #[remedy(source.remedy())]
    Simulator {
        /// Seed or number of the scene.
        scene: u32,
        /// Number of control steps taken before the error.
        step: usize,
        /// The simulator's error.
        source: SimError,
    },
    /// The policy failed to return an action.
    #[error("rollout of scene {scene} failed at step {step}: {source}")]
    #[remedy(source.remedy())]
    Policy {
        /// Seed or number of the scene.
        scene: u32,
        /// Number of control steps taken before the error.
        step: usize,
        /// The policy's error.
        source: PolicyError,
    },
    /// The progress callback asked to stop.
    #[error("the rollout was interrupted")]
    #[remedy("no unfinished artifact remains, so run the same command again to continue")]
    Interrupted,
}

/// Rolls out a policy from one start until success or until `max_steps` control steps are executed. The policy is started after
/// the reset, so its factory receives the first proprioception, in the frame of the policy's observations.
///
/// # Errors
/// If the simulator rejects the scene or an action, or the policy fails to return an action.
pub fn rollout<D: Domain, F: PolicyFactory<D> + ?Sized>(
    factory: &F,
    env: &mut dyn Env<D>,
    source: Source<D>,
    start: Start<D>,
    max_steps: u32,
    conditions: &Conditions,
) -> Result<RolloutOf<D, F>, RolloutError> {
    let run = Run {
        max_steps,
        conditions,
        times: &ActTimes::default(),
    };
    let begin = |seed, first: &D::Proprio| Some(factory.start(seed, first));
    let done = run.episode(&begin, env, source, start)?;
    // A factory always starts its policy.
    done.map(|(rollout, _)| rollout).ok_or(RolloutError::Interrupted)
}

/// Rolls out an episode in the environment that a harness makes for it. Returns `None` if `begin` starts no policy, otherwise the
/// rollout and the policy after it.
#[expect(clippy::type_complexity, reason = "a rollout with its policy")]
pub(crate) fn timed_rollout<D: Domain, P: Policy<D>>(
    begin: &dyn Fn(u32, &D::Proprio) -> Option<P>,
    harness: &Harness<'_, '_, D>,
    start: &Start<D>,
) -> Result<Option<(Rollout<D, P::Decision>, P)>, RolloutError> {
    let refused = |source| RolloutError::Simulator {
        scene: start.seed,
        step: 0,
        source,
    };
    let mut env = (harness.env)(start).map_err(refused)?;
    let run = Run {
        max_steps: harness.max_steps,
        conditions: &harness.conditions,
        times: harness.times,
    };
    let episode = run.episode(begin, env.as_mut(), (harness.source)(start.seed), start.clone())?;
    if (harness.progress)() {
        Ok(episode)
    } else {
        Err(RolloutError::Interrupted)
    }
}

/// What all episodes of a run share.
struct Run<'a> {
    max_steps: u32,
    conditions: &'a Conditions,
    times: &'a ActTimes,
}

impl Run<'_> {
    /// Rolls out one episode, and adds the wall time of every call of the policy to the times at its end.
    #[expect(clippy::type_complexity, reason = "a rollout with its policy")]
    fn episode<D: Domain, P: Policy<D>>(
        &self,
        begin: &dyn Fn(u32, &D::Proprio) -> Option<P>,
        env: &mut dyn Env<D>,
        source: Source<D>,
        start: Start<D>,
    ) -> Result<Option<(Rollout<D, P::Decision>, P)>, RolloutError> {
        let Self {
            max_steps,
            conditions,
            times,
        } = *self;
        let mut calls = Vec::new();
        let scene = start.seed;
        let refused = |step| move |source| RolloutError::Simulator { scene, step, source };
        let first = env.reset(&start.scene).map_err(refused(0))?;
        let observed_from_world = D::observed_from_world(&start.scene);
        let world_from_observed = observed_from_world.as_ref().map(D::inverse);
        let mut senses = Sensing::new(env, source, observed_from_world, conditions.latency);
        let mut disturber = conditions
            .disturbance
            .map(|disturbance| Disturber::new(disturbance, scene));
        let Some(mut policy) = begin(scene, &senses.proprio()) else {
            return Ok(None);
        };
        let mut steps: Vec<StepRecord<D>> = Vec::new();
        let mut decisions = Vec::new();
        for step in 0..max_steps as usize {
            if let Some(disturber) = &mut disturber {
                disturber.before_step(step as u32, senses.env).map_err(refused(step))?;
            }
            senses.begin();
            let before = Instant::now();
            let act = policy
                .act(&mut senses)
                .map_err(|source| RolloutError::Policy { scene, step, source })?;
            calls.push((before.elapsed(), act.decision.is_some()));
            decisions.extend(act.decision);
            let (action, object) = match &world_from_observed {
                Some(motion) => (
                    D::action_in_world(motion, &act.action),
                    act.object.map(|pose| D::pose_in(motion, &pose)),
                ),
                None => (act.action, act.object),
            };
            let after = senses.env.step(&action).map_err(refused(step))?;
            let asked = senses.finish();
            steps.push(StepRecord {
                seen: asked.object.map(|observed| observed.pose).or(object),
                asked,
                action,
                phase: act.phase,
                // The last decision so far. Steps before the first decision count to decision 0.
                decision: (decisions.len() as u32).saturating_sub(1),
                after,
            });
            if D::success(&after) {
                break;
            }
        }
        times.add(&calls);
        let rollout = Rollout {
            start,
            first,
            steps,
            decisions,
            disturbance: disturber.and_then(|disturber| disturber.applied()),
        };
        Ok(Some((rollout, policy)))
    }
}

/// A rollout with the decision type of a factory's policies.
type RolloutOf<D, F> = Rollout<D, <<F as PolicyFactory<D>>::Policy as Policy<D>>::Decision>;

/// Creates the simulation for a start.
pub type MakeEnv<'a, 'e, D> = dyn Fn(&Start<D>) -> Result<Box<dyn Env<D> + 'e>, SimError> + Sync + 'a;

/// Returns the source of the object pose for the episode of a seed.
pub type MakeSource<'a, D> = dyn Fn(u32) -> Source<D> + Sync + 'a;

/// Everything that rollouts need apart from the policy and the starts.
pub struct Harness<'a, 'e, D: Domain> {
    /// Creates the simulation for a start, in the thread that runs the rollout.
    pub env: &'a MakeEnv<'a, 'e, D>,
    /// Returns the source of the object pose for the episode of a seed.
    pub source: &'a MakeSource<'a, D>,
    /// Maximum number of control steps of an episode.
    pub max_steps: u32,
    /// Conditions of all episodes.
    pub conditions: Conditions,
    /// Called after every episode. Returns false to stop the rollouts.
    pub progress: &'a (dyn Fn() -> bool + Sync),
    /// Receives the wall time of every call of the policy. Times are no part of the rollouts, which are the same in every run.
    pub times: &'a ActTimes,
}

/// Rolls out a policy from many starts on as many threads as the current rayon thread pool has, or as
/// the factory asks for. The results are in the order of
/// `starts` and do not depend on the number of threads.
///
/// The rollouts run on separate threads instead of pool threads. A pool thread that waits for work of a shared estimator or
/// network would run another episode in the meantime, and that episode would call the same estimator.
///
/// # Errors
/// The first error in the order of `starts`.
pub fn rollouts<D: Domain, F: PolicyFactory<D> + ?Sized>(
    factory: &F,
    harness: &Harness<'_, '_, D>,
    starts: &[Start<D>],
) -> Result<Vec<RolloutOf<D, F>>, RolloutError> {
    let begin = |seed, first: &D::Proprio| Some(factory.start(seed, first));
    // A factory always starts its policy.
    let one = |start: &Start<D>| Ok(timed_rollout(&begin, harness, start)?.map(|(rollout, _)| rollout));
    let done = in_parallel(starts, factory.concurrent(), one)?;
    Ok(done.into_iter().flatten().collect())
}

/// Does `one` for every job on as many threads as the current rayon thread pool has, or as `concurrent` asks for. The results are in
/// the order of the jobs. Returns the first error in their order.
pub(crate) fn in_parallel<J: Sync, R: Send>(
    jobs: &[J],
    concurrent: Option<usize>,
    one: impl Fn(&J) -> Result<R, RolloutError> + Sync,
) -> Result<Vec<R>, RolloutError> {
    // After an error, no later job is begun, but all earlier ones are completed, so the reported error does not depend on timing.
    let (next, end) = (AtomicUsize::new(0), AtomicUsize::new(jobs.len()));
    let work = || {
        let mut done = Vec::new();
        loop {
            let at = next.fetch_add(1, Ordering::Relaxed);
            if at >= end.load(Ordering::Relaxed) {
                break done;
            }
            let result = one(&jobs[at]);
            if result.is_err() {
                end.fetch_min(at, Ordering::Relaxed);
            }
            done.push((at, result));
        }
    };
    let mut done: Vec<_> = std::thread::scope(|scope| {
        let threads = match (rayon::current_num_threads(), concurrent) {
            // With one thread, rollouts run one after another, so that the time of an action is that of one rollout.
            (1, _) => 1,
            (threads, concurrent) => concurrent.map_or(threads, |rollouts| rollouts.max(threads)),
        };
        let threads = threads.min(jobs.len());
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
