//! Rollouts in space: a policy against robosuite's tasks, seed after seed.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};

use nalgebra::Isometry3;
use rayon::prelude::*;
use re4_sim::robosuite::{
    ArmAction, FirstTorques, Robosuite, RobosuiteAction, RobosuiteModel, RobosuiteObservation, RobosuiteScene,
    RobosuiteStep,
};
use re4_sim::{SimError, Simulator as _};

use crate::spatial::{
    ObjectSight, Observer, PoseNoise, SpatialAct, SpatialAction, SpatialBody, SpatialDecision, SpatialKnowledge,
    SpatialObservation, SpatialPhase, SpatialPolicy, SpatialPolicyConfig, SpatialRe4,
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
    /// What the policy saw before the step. Where it looked at the object, the pose that it was told; at steps at which it did
    /// not look, the one that it went by.
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
    /// How often an observer was asked where the object is; 0 without one.
    pub looks: u32,
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

/// Tells a policy of the object in one episode.
enum Eyes {
    Recorded(Option<PoseNoise>),
    Observed(Box<dyn Observer>),
}

impl Eyes {
    fn open(sight: ObjectSight<'_>, start: &SpatialStart) -> Result<Self, PolicyError> {
        match sight {
            ObjectSight::Recorded(noise) => {
                let errors = || PoseNoise::new(u64::from(start.seed), noise.translation, noise.rotation);
                Ok(Self::Recorded((noise != NoiseLevel::default()).then(errors)))
            }
            ObjectSight::Observed(make) => Ok(Self::Observed(make(start)?)),
        }
    }

    /// Lets the policy act, and says what it saw and whether it looked.
    fn act(
        &mut self,
        policy: &mut impl SpatialPolicy,
        simulator: &Robosuite,
        now: &RobosuiteObservation,
    ) -> Result<(SpatialObservation, SpatialAct, bool), PolicyError> {
        match self {
            Self::Recorded(errors) => {
                let mut seen = observe(now);
                if let Some(errors) = errors {
                    seen.object = errors.perturb(&seen.object);
                }
                let act = policy.act(&seen)?;
                Ok((seen, act, false))
            }
            Self::Observed(observer) => {
                // From here on, nothing leads from the object's recorded pose to the policy but the observer.
                let body = SpatialBody {
                    eef: now.grip_site,
                    fingers: now.fingers,
                };
                let mut told = None;
                let act = policy.act_looking(&body, &mut || {
                    let object = observer.object(simulator)?;
                    told = Some(object);
                    Ok(object)
                })?;
                let seen = SpatialObservation {
                    eef: body.eef,
                    object: told.unwrap_or(act.object),
                    fingers: body.fingers,
                };
                Ok((seen, act, told.is_some()))
            }
        }
    }
}

/// Rolls a policy out from one seed, until success or the step budget. The policy is made when the pose of the grip site after
/// the reset is known.
///
/// # Errors
/// When the simulator refuses, or the policy has no action.
pub fn spatial_rollout<P: SpatialPolicy>(
    start: &SpatialStart,
    sight: ObjectSight<'_>,
    max_steps: u32,
    policy: impl FnOnce(&Isometry3<f64>) -> P,
) -> Result<SpatialRollout, RolloutError> {
    let scene = start.seed;
    let refused = |step: usize| move |source: SimError| RolloutError::Simulator { scene, step, source };
    let mut simulator = Robosuite::new(&start.model).map_err(refused(0))?;
    let first = simulator
        .reset(&start.scene, FirstTorques::AsRobosuite)
        .map_err(refused(0))?;
    let first_state = simulator.state();
    let refuses = |step: usize| move |source: PolicyError| RolloutError::Policy { scene, step, source };
    let mut eyes = Eyes::open(sight, start).map_err(refuses(0))?;
    let mut policy = policy(&first.grip_site);
    let mut now = first;
    let mut steps: Vec<SpatialStepRecord> = Vec::new();
    let mut decisions = Vec::new();
    let mut looks = 0;
    for step in 0..max_steps as usize {
        let (seen, act, looked) = eyes.act(&mut policy, &simulator, &now).map_err(refuses(step))?;
        looks += u32::from(looked);
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
        looks,
    })
}

/// Rolls RE4 out from many seeds, in parallel: on the current thread pool, or, with observers, in as many threads of their own.
/// Results come in the order of `seeds` and do not depend on the number of threads. `start` makes the scene of a seed; `progress` is called after every episode and says
/// whether to go on.
///
/// # Errors
/// The first error in the order of `seeds`.
pub fn spatial_rollouts(
    config: &SpatialPolicyConfig,
    knowledge: &Arc<SpatialKnowledge>,
    seeds: &[u32],
    sight: ObjectSight<'_>,
    max_steps: u32,
    start: &(dyn Fn(u32) -> Result<SpatialStart, SimError> + Sync),
    progress: &(dyn Fn() -> bool + Sync),
) -> Result<Vec<SpatialRollout>, RolloutError> {
    let stopped = AtomicBool::new(false);
    let one = |seed: u32| {
        if stopped.load(Ordering::Relaxed) {
            return Err(RolloutError::Interrupted);
        }
        let start = start(seed).map_err(|source| RolloutError::Simulator {
            scene: seed,
            step: 0,
            source,
        })?;
        let episode = spatial_rollout(&start, sight, max_steps, |home| {
            SpatialRe4::new(config.clone(), Arc::clone(knowledge), *home)
        })?;
        if progress() {
            Ok(episode)
        } else {
            stopped.store(true, Ordering::Relaxed);
            Err(RolloutError::Interrupted)
        }
    };
    let rollouts: Vec<Result<SpatialRollout, RolloutError>> = match sight {
        ObjectSight::Recorded(_) => seeds.par_iter().with_max_len(1).map(|&seed| one(seed)).collect(),
        ObjectSight::Observed(_) => in_own_threads(seeds, &one),
    };
    rollouts.into_iter().collect()
}

/// The results for all seeds, in their order, from as many threads as the current thread pool has, but not from the pool itself:
/// an estimator that all observers share may wait for work of its own that it gave to the pool, and a thread of the pool that
/// waits takes up another episode, which would ask the same estimator.
fn in_own_threads<T: Send>(seeds: &[u32], one: &(impl Fn(u32) -> T + Sync)) -> Vec<T> {
    let next = AtomicUsize::new(0);
    let work = || {
        let mut done = Vec::new();
        loop {
            let at = next.fetch_add(1, Ordering::Relaxed);
            let Some(&seed) = seeds.get(at) else { break done };
            done.push((at, one(seed)));
        }
    };
    let mut done: Vec<(usize, T)> = std::thread::scope(|scope| {
        let threads = rayon::current_num_threads().min(seeds.len());
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
