//! The behaviour of the loop when the block does not move as the demonstration predicts.
#![allow(clippy::unwrap_used, reason = "a panic is how a test fails")]

mod common;
mod shown;

use std::collections::BTreeSet;

use common::{Random, knowledge, scripted};
use re4_geometry::{Point2, Pose2};
use re4_index::AngleMetric;
use re4_policy::{Decision, PolicyConfig, Re4};
use re4_rollout::{Act, Phase, Plane, Policy as _};
use shown::Shown;

fn act(policy: &mut Re4, agent: Point2, block: Pose2) -> Act<Plane, Decision> {
    let mut shown = Shown {
        proprio: agent,
        observes_object: true,
        flag: None,
        object: &mut || Ok(block),
    };
    policy.act(&mut shown).unwrap()
}

#[test]
fn a_push_that_moved_nothing_is_not_repeated() {
    let knowledge = knowledge(scripted(10), AngleMetric::Periodic);
    let block = Pose2::new(200.0, 280.0, 2.0);
    let mut policy = Re4::new(PolicyConfig::re4(), knowledge, 1);
    let mut agent = Point2::new(60.0, 60.0);
    let mut tried = BTreeSet::new();
    for _ in 0..400 {
        // The pusher reaches every target, and the block does not move.
        let act = self::act(&mut policy, agent, block);
        agent = act.action;
        if let Some(decision) = act.decision {
            let chunk = (decision.demo, decision.demo_frame);
            assert!(tried.insert(chunk), "{chunk:?} was selected before: {decision:?}");
        }
        if tried.len() == 6 {
            return;
        }
    }
    panic!("only {} chunks were selected", tried.len());
}

#[test]
fn a_chunk_is_abandoned_only_if_the_block_diverges() {
    let knowledge = knowledge(scripted(10), AngleMetric::Periodic);
    let mut random = Random::new(3);
    let mut abandoned = 0;
    for _ in 0..30 {
        let block = random.block();
        let jump = Pose2::new(block.x + 120.0, block.y - 90.0, block.theta + 1.0);
        for (divergence, moved) in [(Some(8.0), true), (Some(8.0), false), (None, true)] {
            let mut config = PolicyConfig::re4();
            config.replay.divergence = divergence;
            let mut policy = Re4::new(config, knowledge.clone(), 1);
            let mut agent = Point2::new(60.0, 60.0);
            let mut replayed = 0;
            let mut length = 0;
            while replayed < 2 {
                let act = self::act(&mut policy, agent, block);
                agent = act.action;
                length = act.decision.map_or(length, |decision| decision.replay_steps);
                replayed = if act.phase == Phase::Replay { replayed + 1 } else { 0 };
            }
            if length < 4 {
                continue;
            }
            let next = act(&mut policy, agent, if moved { jump } else { block });
            let expected = divergence.is_some() && moved;
            assert_eq!(
                next.decision.is_some(),
                expected,
                "{divergence:?}, {moved}, chunk of {length}"
            );
            abandoned += u32::from(expected);
        }
    }
    assert!(abandoned > 5, "{abandoned}");
}
