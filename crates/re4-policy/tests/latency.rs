//! The planar policy with old observations, and with a goal and walls that are elsewhere.
#![expect(clippy::panic, reason = "a panic is how a test fails")]

mod common;

use std::sync::Arc;

use common::{knowledge, pusht, starts};
use re4_index::AngleMetric;
use re4_policy::{Knowledge, PolicyConfig, Re4Factory};
use re4_rollout::{ActTimes, Conditions, Harness, Plane, PushTEnv, Source, Start};
use re4_sim::random_goal;

/// Returns the fraction of the rollouts that succeed within 300 steps.
fn successes(knowledge: &Arc<Knowledge>, starts: &[Start<Plane>], latency: u32) -> f64 {
    let factory = Re4Factory {
        config: PolicyConfig::re4(),
        knowledge: Arc::clone(knowledge),
    };
    let harness: Harness<'_, '_, Plane> = Harness {
        env: &|_| Ok(Box::new(PushTEnv::new()?)),
        source: &|_| Source::Recorded,
        conditions: Conditions {
            latency,
            disturbance: None,
        },
        max_steps: 300,
        progress: &|| true,
        times: &ActTimes::default(),
    };
    let rolled = re4_rollout::rollouts(&factory, &harness, starts).unwrap_or_else(|error| panic!("{error}"));
    rolled.iter().filter(|rollout| rollout.success()).count() as f64 / starts.len() as f64
}

#[test]
fn old_observations_and_other_goals_are_not_in_the_way_of_success() {
    let Some(demos) = pusht() else { return };
    let knowledge = knowledge(demos, AngleMetric::Periodic);
    let seeds: Vec<u32> = (200_000..200_020).collect();
    let mut starts = starts(&seeds);
    for latency in [1, 2] {
        let rate = successes(&knowledge, &starts, latency);
        assert!(rate >= 0.9, "latency {latency}: {rate}");
    }
    for start in &mut starts {
        start.scene.goal = random_goal(start.seed, start.scene.state.arrival(start.scene.order));
    }
    let rate = successes(&knowledge, &starts, 0);
    assert!(rate >= 0.9, "random goals: {rate}");
    assert!(starts.iter().any(|start| start.scene.goal.x < 150.0));
}
