//! Rollouts that record which demonstrations decided them, and rollouts without some of the demonstrations.
//!
//! A policy by retrieval reads its demonstrations only when it decides. If a decision is the same without a demonstration, so are
//! the actions that follow from it, the next observation, and the next decision. An episode whose decisions are all the same
//! without a demonstration is therefore the same without it, step by step, and need not be rolled out again.
//!
//! A policy reports the demonstrations for which this is not certain: [`Trace::consider`]. Everything else that it derives from all
//! demonstrations, such as the ranges that normalise states, stays as it is with all of them.

use std::collections::BTreeSet;
use std::sync::Arc;

use re4_episode::DemoNames;

use crate::rollout::in_parallel;
use crate::{
    Explained, Harness, Policy, PolicyFactory, Recorded, Rollout, RolloutError, Start, rollout::timed_rollout,
};

/// The demonstrations that a policy does without during an episode, and those that its decisions have depended on so far.
#[derive(Debug, Clone, Default)]
pub struct Trace {
    without: Arc<BTreeSet<u32>>,
    considered: Option<BTreeSet<u32>>,
}

impl Trace {
    /// A trace of an episode without these demonstrations.
    #[must_use]
    pub fn without(without: &Arc<BTreeSet<u32>>) -> Self {
        Self {
            without: Arc::clone(without),
            considered: Some(BTreeSet::new()),
        }
    }

    /// The demonstrations that the policy does without. Empty in an ordinary rollout.
    pub fn left_out(&self) -> &BTreeSet<u32> {
        &self.without
    }

    /// Whether the policy has to report what its decisions depend on.
    pub fn is_on(&self) -> bool {
        self.considered.is_some()
    }

    /// Reports demonstrations without which a decision might have been another one.
    pub fn consider(&mut self, demos: impl IntoIterator<Item = u32>) {
        if let Some(considered) = &mut self.considered {
            considered.extend(demos);
        }
    }

    /// The demonstrations that were reported so far.
    pub fn considered(&self) -> Option<&BTreeSet<u32>> {
        self.considered.as_ref()
    }
}

/// An episode that is rolled out without some demonstrations.
#[derive(Debug, Clone, PartialEq)]
pub struct Job<D: crate::Domain> {
    /// The start.
    pub start: Start<D>,
    /// Demonstrations that the policy does without.
    pub without: Arc<BTreeSet<u32>>,
}

/// The result of an episode, and the demonstrations that it depends on.
#[derive(Debug, Clone, PartialEq)]
pub struct Traced {
    /// Seed of the scene.
    pub seed: u32,
    /// Whether the task succeeded.
    pub success: bool,
    /// The score of the task, from 0 to 1.
    pub score: f64,
    /// Number of control steps.
    pub steps: u32,
    /// Position of the object after the reset, world frame: x and y, in px for Push-T and in m for robosuite tasks.
    pub start: [f64; 2],
    /// The demonstrations that the policy followed, one per decision that follows one, in order.
    pub followed: Vec<u32>,
    /// The demonstrations without which a decision might have been another one. Without any other demonstration, the episode is the
    /// same. Contains all that the policy followed.
    pub considered: BTreeSet<u32>,
}

impl Traced {
    fn of<D: Recorded, X: Explained<D>>(rollout: &Rollout<D, X>, mut considered: BTreeSet<u32>) -> Self {
        let names = DemoNames::default();
        let decisions = rollout.decisions.iter();
        let followed: Vec<u32> = decisions
            .filter_map(|decision| decision.explanation(&names).demo)
            .map(|(demo, ..)| demo)
            .collect();
        considered.extend(&followed);
        Self {
            seed: rollout.start.seed,
            success: rollout.success(),
            score: D::score(rollout),
            steps: rollout.steps.len() as u32,
            start: D::start(&rollout.first),
            followed,
            considered,
        }
    }
}

/// Rolls out episodes, each without its own set of demonstrations. The results are in the order of `jobs` and do not depend on the
/// number of threads. Returns `None` if the policy cannot do without single demonstrations.
pub(crate) fn traced<D: Recorded, F: PolicyFactory<D>>(
    factory: &F,
    harness: &Harness<'_, '_, D>,
    jobs: &[Job<D>],
) -> Result<Option<Vec<Traced>>, RolloutError>
where
    <F::Policy as Policy<D>>::Decision: Explained<D>,
{
    let one = |job: &Job<D>| {
        let begin = |seed, first: &D::Proprio| factory.start_without(seed, first, &job.without);
        timed_rollout(&begin, harness, &job.start)
            .map(|found| found.and_then(|(rollout, policy)| Some(Traced::of(&rollout, policy.considered()?.clone()))))
    };
    let results = in_parallel(jobs, factory.concurrent(), one)?;
    Ok(results.into_iter().collect())
}
