//! Replay at the robot's pace in a kinematic world: it is faster, and grasps and placements are as good as at the recorded pace.
#![allow(clippy::unwrap_used, reason = "a panic is how a test fails")]

mod shown;
mod toy;

use std::sync::Arc;

use re4_geometry::spatial::Symmetry;
use re4_policy::spatial::{RetimeConfig, SpatialDecisionKind, SpatialDemoSet, SpatialKnowledge, SpatialPolicyConfig};
use toy::{Random, block, demonstrate_with_lead, episode};

/// What 30 random placements give.
#[derive(Debug)]
struct Outcome {
    successes: usize,
    lost: usize,
    /// Median number of steps.
    steps: usize,
    /// Largest distance from the grip site to the centre of the block in the grasp, in metres.
    off: f64,
}

fn run(lead: f64, retime: Option<RetimeConfig>) -> Outcome {
    let mut config = SpatialPolicyConfig::re4();
    config.replay.retime = retime;
    let mut random = Random::new(1);
    let mut placement = move || {
        block(
            random.range(-0.15, 0.05),
            random.range(-0.2, 0.0),
            random.range(-0.6, 0.6),
        )
    };
    let demos = SpatialDemoSet::new((0..8).map(|number| (number, demonstrate_with_lead(placement(), 0, lead))));
    let mut knowledge = SpatialKnowledge::new(demos, &config.retrieve, Symmetry::None, |_, _| false).unwrap();
    if let Some(retime) = &config.replay.retime {
        knowledge = knowledge.with_pace(retime);
    }
    let knowledge = Arc::new(knowledge);
    let mut random = Random::new(2);
    let mut outcome = Outcome {
        successes: 0,
        lost: 0,
        steps: 0,
        off: 0.0,
    };
    let mut steps = Vec::new();
    for _ in 0..30 {
        let placed = block(
            random.range(-0.15, 0.05),
            random.range(-0.2, 0.0),
            random.range(-0.6, 0.6),
        );
        let mut off = 0.0_f64;
        let run = episode(&config, &knowledge, placed, None, |_, world| {
            off = off.max(world.held.map_or(0.0, |held| held.translation.vector.norm()));
        });
        outcome.successes += usize::from(run.success);
        let lost = run
            .decisions()
            .into_iter()
            .filter(|d| d.kind == SpatialDecisionKind::GraspLost);
        outcome.lost += lost.count();
        outcome.off = outcome.off.max(off);
        steps.push(run.acts.len());
    }
    steps.sort_unstable();
    outcome.steps = steps[15];
    outcome
}

#[test]
fn slow_demonstrations_are_replayed_fast_and_nothing_is_lost() {
    let recorded = run(0.012, None);
    let retimed = run(0.012, Some(RetimeConfig::default()));
    assert_eq!((retimed.successes, retimed.lost), (30, 0), "{retimed:?}");
    assert_eq!(recorded.lost, 0, "{recorded:?}");
    assert!(2 * retimed.steps < recorded.steps, "{retimed:?}, {recorded:?}");
    assert!(retimed.off <= recorded.off + 0.002, "{retimed:?}, {recorded:?}");
}

#[test]
fn demonstrations_at_the_robots_pace_are_not_worse() {
    let recorded = run(0.04, None);
    let retimed = run(0.04, Some(RetimeConfig::default()));
    assert_eq!((recorded.successes, recorded.lost), (30, 0), "{recorded:?}");
    assert_eq!((retimed.successes, retimed.lost), (30, 0), "{retimed:?}");
    assert!(retimed.steps <= recorded.steps + 10, "{retimed:?}, {recorded:?}");
}

#[test]
fn with_a_margin_larger_than_the_workspace_everything_is_replayed_as_recorded() {
    let [recorded, retimed] = [None, Some(RetimeConfig { margin: 10.0 })].map(|retime| run(0.04, retime));
    assert_eq!(format!("{recorded:?}"), format!("{retimed:?}"));
}
