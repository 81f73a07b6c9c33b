//! Every step of the loop can be disabled or exchanged separately, rollouts do not depend on the number of threads, and
//! demonstrations that cannot be followed are rejected.
#![expect(clippy::panic, clippy::unwrap_used, reason = "a panic is how a test fails")]

mod common;
mod shown;

use std::sync::Arc;

use common::{knowledge, rollouts, scripted, starts};
use re4_episode::{Mode, PlanarFrame};
use re4_geometry::{Point2, Pose2};
use re4_index::{AngleMetric, IndexedFrame, RetrievalIndex};
use re4_policy::{
    Decision, DemoNames, DemoSet, Knowledge, LookupError, PlanKind, Planner, PolicyConfig, Re4, Selector, Tracking,
};
use re4_rollout::{Phase, Plane, Policy as _, PolicyError, Rollout, RolloutError};
use shown::Shown;

const SEEDS: [u32; 4] = [810_000, 810_001, 810_002, 810_003];

fn rolled(config: &PolicyConfig, knowledge: &Arc<Knowledge>) -> Vec<Rollout<Plane, Decision>> {
    rollouts(config, knowledge, &starts(&SEEDS), 60, &|| true).unwrap_or_else(|error| panic!("{config:?}: {error}"))
}

fn actions(episodes: &[Rollout<Plane, Decision>]) -> Vec<Point2> {
    episodes.iter().flat_map(|e| e.steps.iter().map(|s| s.action)).collect()
}

fn base(name: &str) -> PolicyConfig {
    match name {
        "re4" => PolicyConfig::re4(),
        "paper" => PolicyConfig::paper(),
        _ => PolicyConfig::re2(),
    }
}

type Switch = (&'static str, fn(&mut PolicyConfig));

const SWITCHES: [Switch; 6] = [
    ("reframe", |c| c.reframe.enabled = !c.reframe.enabled),
    ("replan", |c| c.replan.enabled = !c.replan.enabled),
    ("planner", |c| {
        c.replan.planner = match c.replan.planner {
            Planner::Rrt => Planner::Visibility,
            Planner::Visibility => Planner::Rrt,
        }
    }),
    ("selector", |c| {
        c.retrieve.selector = match c.retrieve.selector {
            Selector::TwoStage => Selector::Outcome,
            Selector::Outcome => Selector::TwoStage,
        }
    }),
    ("tracking", |c| {
        c.replay.tracking = match c.replay.tracking {
            Tracking::Actions => Tracking::Path,
            Tracking::Path => Tracking::Actions,
        }
    }),
    ("horizon", |c| c.replay.horizon = 7),
];

#[test]
fn every_switch_changes_the_actions() {
    let knowledge = knowledge(scripted(10), AngleMetric::Raw);
    for name in ["paper", "re4"] {
        let base = base(name);
        let before = rolled(&base, &knowledge);
        for (switch, toggle) in SWITCHES {
            let mut config = base.clone();
            toggle(&mut config);
            let after = rolled(&config, &knowledge);
            assert_ne!(actions(&before), actions(&after), "{name}: {switch} has no effect");
        }
    }
}

#[test]
fn every_combination_of_switches_gives_different_actions() {
    let knowledge = knowledge(scripted(10), AngleMetric::Raw);
    let mut seen: Vec<(Vec<&str>, Vec<Point2>)> = Vec::new();
    for chosen in 0..1 << 5 {
        let mut config = base("paper");
        let mut names = Vec::new();
        for (i, (name, toggle)) in SWITCHES[..5].iter().enumerate() {
            if chosen >> i & 1 == 1 {
                toggle(&mut config);
                names.push(*name);
            }
        }
        let episodes = rolled(&config, &knowledge);
        for episode in &episodes {
            assert!(episode.steps.len() == 60 || episode.success());
            assert!(!episode.decisions.is_empty());
        }
        let done = actions(&episodes);
        // The planner has no effect if Replan is disabled.
        if !(names.contains(&"replan") && names.contains(&"planner")) {
            for (others, other) in &seen {
                assert_ne!(&done, other, "{names:?} gives the same actions as {others:?}");
            }
            seen.push((names, done));
        }
    }
    assert_eq!(seen.len(), 24);
}

#[test]
fn disabled_steps_have_no_effect() {
    let knowledge = knowledge(scripted(10), AngleMetric::Raw);
    for name in ["paper", "re4", "re2"] {
        let mut config = base(name);
        config.reframe.enabled = false;
        config.replan.enabled = false;
        for episode in rolled(&config, &knowledge) {
            for decision in &episode.decisions {
                assert_eq!((decision.plan_kind, decision.plan_steps), (PlanKind::Off, 0));
                assert_eq!(decision.delta, Pose2::IDENTITY);
                let frame = knowledge.demos.demo(decision.demo).unwrap()[decision.demo_frame as usize];
                assert_eq!(
                    decision.set_point, frame.eef,
                    "the demonstration is replayed where it was recorded"
                );
            }
            assert!(episode.steps.iter().all(|s| s.phase == Phase::Replay));
        }
    }
}

#[test]
fn without_reframe_and_replan_the_recorded_actions_are_sent() {
    let knowledge = knowledge(scripted(10), AngleMetric::Raw);
    for episode in rolled(&base("re2"), &knowledge) {
        let mut sent = episode.steps.iter().map(|s| s.action);
        for decision in &episode.decisions {
            let frames = &knowledge.demos.demo(decision.demo).unwrap()[decision.demo_frame as usize..];
            for (frame, action) in frames.iter().zip(sent.by_ref().take(decision.replay_steps as usize)) {
                assert_eq!(frame.action, action);
            }
        }
        assert!(sent.next().is_none());
    }
}

#[test]
fn decisions_and_steps_fit_together() {
    let knowledge = knowledge(scripted(10), AngleMetric::Raw);
    for name in ["paper", "re4", "re2"] {
        let config = base(name);
        for episode in rolled(&config, &knowledge) {
            let eef_before = |i: usize| {
                let before = i.checked_sub(1).map_or(&episode.first, |i| &episode.steps[i].after);
                before.observation.agent
            };
            for (i, step) in episode.steps.iter().enumerate() {
                let decision = &episode.decisions[step.decision as usize];
                assert!(decision.step as usize <= i);
                let since = i - decision.step as usize;
                let planned = since < decision.plan_steps as usize;
                assert_eq!(
                    step.phase,
                    if planned { Phase::Plan } else { Phase::Replay },
                    "{name}, step {i}"
                );
                if since == 0 {
                    assert_eq!(
                        (decision.eef, decision.object),
                        (eef_before(i), step.asked.object.unwrap().pose)
                    );
                }
                if i > 0 {
                    let observed = step.asked.object.unwrap();
                    assert_eq!(observed.pose, episode.steps[i - 1].after.observation.block);
                    assert_eq!(
                        (step.seen, observed.confidence, step.asked.images),
                        (Some(observed.pose), None, 0)
                    );
                }
            }
        }
    }
}

#[test]
fn one_thread_and_two_give_the_same_rollouts() {
    let knowledge = knowledge(scripted(10), AngleMetric::Raw);
    let seeds: Vec<u32> = (820_000..820_012).collect();
    for name in ["paper", "re4", "re2"] {
        let config = base(name);
        let run = |threads: usize| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| rollouts(&config, &knowledge, &starts(&seeds), 50, &|| true))
                .unwrap()
        };
        let one = run(1);
        assert_eq!(one.iter().map(|e| e.start.seed).collect::<Vec<_>>(), seeds);
        assert_eq!(one, run(2), "{name}");
        // They do not depend on the other seeds either.
        let single = rollouts(&config, &knowledge, &starts(&seeds[5..6]), 50, &|| true).unwrap();
        assert_eq!(one[5..6], single[..]);
    }
}

#[test]
fn a_caller_can_stop_the_rollouts() {
    let knowledge = knowledge(scripted(10), AngleMetric::Raw);
    let stopped = rollouts(&base("paper"), &knowledge, &starts(&SEEDS), 5, &|| false);
    assert!(matches!(stopped, Err(RolloutError::Interrupted)));
}

/// Demonstrations in which the pusher moves past the block and the block rests.
fn without_a_push(mode: Mode) -> (DemoSet<PlanarFrame>, RetrievalIndex) {
    let frames: Vec<PlanarFrame> = (0..30)
        .map(|i| PlanarFrame {
            eef: Point2::new(30.0 + 5.0 * f64::from(i), 40.0),
            object: Pose2::new(300.0, 300.0, 1.0),
            action: Point2::new(35.0 + 5.0 * f64::from(i), 40.0),
            contacts: 0.0,
        })
        .collect();
    let indexed = (0..).zip(&frames).map(|(number, frame)| IndexedFrame {
        episode: 4,
        frame: number,
        mode,
        eef: frame.eef,
        object: frame.object,
    });
    let index = RetrievalIndex::build(indexed.collect(), AngleMetric::Raw).unwrap();
    let demos = DemoSet::new([(4, frames)]);
    (demos, index)
}

#[test]
fn demonstrations_that_cannot_be_followed_are_rejected() {
    let refusal = |name: &str, mode: Mode, demos: Option<DemoSet<PlanarFrame>>| {
        let (own, index) = without_a_push(mode);
        let knowledge = Arc::new(Knowledge {
            demos: demos.unwrap_or(own),
            index,
            chunks: None,
        });
        let mut seen = Shown::<Plane> {
            proprio: Point2::new(100.0, 100.0),
            observes_object: true,
            flag: None,
            object: &mut || Ok(Pose2::new(250.0, 250.0, 0.5)),
        };
        match Re4::new(base(name), knowledge, 1).act(&mut seen) {
            Ok(_) => None,
            Err(PolicyError::Own(error)) => Some(error.downcast::<LookupError>().unwrap()),
            Err(error) => panic!("{error}"),
        }
    };
    let error = refusal("re4", Mode::Transit, None).unwrap();
    assert!(matches!(*error, LookupError::NoChunks), "{error}");
    assert!(
        error.to_string().contains("no demonstration contains a push"),
        "{error}"
    );
    let error = refusal("paper", Mode::Transfer, None).unwrap();
    assert!(
        matches!(*error, LookupError::NoFrameOfMode { mode: Mode::Transit }),
        "{error}"
    );
    let names = (0..5).map(|number| format!("episode {}", 10 * number)).collect();
    let nothing = DemoSet::default().with_names(DemoNames::new(names));
    let error = refusal("paper", Mode::Transit, Some(nothing)).unwrap();
    assert!(
        matches!(&*error, LookupError::UnknownDemo { demo, .. } if demo == "episode 40"),
        "{error}"
    );
    // The two-stage selector needs no push.
    assert!(refusal("paper", Mode::Transit, None).is_none());
}
