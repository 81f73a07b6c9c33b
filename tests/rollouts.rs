//! The `rollouts` artifact: steps, decisions and results are consistent, and the simulator reproduces them.

use std::ops::Range;

use crate::support::{Place, folders_in};
use re4_artifact::{Artifact, col_bool, col_f64, col_text, col_u32};
use re4_geometry::{Point2, Pose2};
use re4_sim::{GOAL, PushT, ResetOrder, SeedScheme, Simulator as _, coverage, scene_from_seed};

/// The tables of a `rollouts` artifact by column.
struct Rollouts {
    results: arrow_array::RecordBatch,
    steps: arrow_array::RecordBatch,
    decisions: arrow_array::RecordBatch,
}

impl Rollouts {
    fn of(preset: &str) -> Self {
        let place = Place::new();
        place
            .run(&format!(
                "run small.toml --no-images --policy {preset} --seeds 500..510"
            ))
            .done();
        let folder = folders_in(&place.artifacts().join("rollouts")).remove(0);
        let artifact = Artifact::open(&folder).unwrap();
        Self {
            results: crate::support::results(&artifact),
            steps: crate::support::steps(&artifact),
            decisions: crate::support::decisions(&artifact),
        }
    }

    fn result(&self, column: &str, rollout: usize) -> f64 {
        col_f64(&self.results, column).unwrap()[rollout]
    }

    fn step(&self, column: &str) -> &[f64] {
        col_f64(&self.steps, column).unwrap()
    }

    fn decision(&self, column: &str) -> &[f64] {
        col_f64(&self.decisions, column).unwrap()
    }

    /// Seed, rows of steps and rows of decisions of every rollout, in the order of the results.
    fn rows(&self) -> Vec<(u32, Range<usize>, Range<usize>)> {
        let seeds = col_u32(&self.results, "seed").unwrap();
        let (mut step, mut decision) = (0, 0);
        let count = |column| col_u32(&self.results, column).unwrap();
        (0..seeds.len())
            .map(|i| {
                let steps = step..step + count("steps")[i] as usize;
                let decisions = decision..decision + count("decisions")[i] as usize;
                (step, decision) = (steps.end, decisions.end);
                (seeds[i], steps, decisions)
            })
            .collect()
    }
}

fn check(preset: &str) {
    let rollouts = Rollouts::of(preset);
    let rows = rollouts.rows();
    assert_eq!(
        rows.iter().map(|(seed, ..)| *seed).collect::<Vec<_>>(),
        (500..510).collect::<Vec<_>>()
    );
    let (_, last_steps, last_decisions) = rows.last().unwrap();
    assert_eq!(
        last_steps.end,
        rollouts.steps.num_rows(),
        "not all steps belong to a rollout"
    );
    assert_eq!(
        last_decisions.end,
        rollouts.decisions.num_rows(),
        "not all decisions belong to a rollout"
    );
    for (rollout, (seed, steps, decisions)) in rows.into_iter().enumerate() {
        let at = format!("{preset}, seed {seed}");
        results_follow_from_steps(&rollouts, rollout, steps.clone(), &at);
        every_action_has_its_decision(&rollouts, seed, steps.clone(), decisions.clone(), &at);
        decisions_have_the_state_of_their_step(&rollouts, rollout, steps.clone(), decisions, &at);
        the_simulator_reproduces_the_states(&rollouts, rollout, seed, steps, &at);
    }
}

fn results_follow_from_steps(rollouts: &Rollouts, rollout: usize, steps: Range<usize>, at: &str) {
    let (cover, iou, score) = (rollouts.step("coverage"), rollouts.step("iou"), rollouts.step("score"));
    let maximum = |values: &[f64]| values[steps.clone()].iter().copied().fold(0.0, f64::max);
    assert_eq!(rollouts.result("coverage_max", rollout), maximum(cover), "{at}");
    assert_eq!(rollouts.result("iou_max", rollout), maximum(iou), "{at}");
    assert_eq!(rollouts.result("score_max", rollout), maximum(score), "{at}");
    assert_eq!(rollouts.result("coverage_final", rollout), cover[steps.end - 1], "{at}");
    let success = col_bool(&rollouts.results, "success").unwrap().value(rollout);
    assert_eq!(success, maximum(cover) > 0.95, "{at}");
    assert!(steps.len() <= 60, "{at}");
    assert!(
        success || steps.len() == 60,
        "{at}: the rollout ended early without success"
    );
    for step in steps.clone() {
        assert_eq!(score[step], (cover[step] / 0.95).min(1.0), "{at}");
        assert!((0.0..=1.0).contains(&iou[step]) && iou[step] <= cover[step], "{at}");
        assert_eq!(
            cover[step] > 0.95,
            success && step + 1 == steps.end,
            "{at}: the rollout continued after success"
        );
    }
    let number = col_u32(&rollouts.steps, "step").unwrap();
    assert_eq!(
        number[steps.clone()],
        (0..steps.len() as u32).collect::<Vec<_>>(),
        "{at}"
    );
}

fn every_action_has_its_decision(
    rollouts: &Rollouts,
    seed: u32,
    steps: Range<usize>,
    decisions: Range<usize>,
    at: &str,
) {
    let of_decision = |name| &col_u32(&rollouts.decisions, name).unwrap()[decisions.clone()];
    assert!(of_decision("seed").iter().all(|found| *found == seed), "{at}");
    assert!(
        col_u32(&rollouts.steps, "seed").unwrap()[steps.clone()]
            .iter()
            .all(|found| *found == seed),
        "{at}"
    );
    let numbers: Vec<u32> = (0..decisions.len() as u32).collect();
    assert_eq!(of_decision("decision"), numbers, "{at}");
    let belongs = &col_u32(&rollouts.steps, "decision").unwrap()[steps.clone()];
    let phases = &col_text(&rollouts.steps, "phase").unwrap()[steps.clone()];
    assert!(belongs.is_sorted(), "{at}");
    for number in numbers {
        let first = belongs.partition_point(|d| *d < number);
        let executed = first..belongs.partition_point(|d| *d <= number);
        let index = number as usize;
        assert!(!executed.is_empty(), "{at}: decision {number} has no action");
        assert_eq!(of_decision("step")[index] as usize, first, "{at}, decision {number}");
        let planned = executed.clone().take_while(|i| phases[*i] == Some("plan")).count();
        let replayed = executed.len() - planned;
        assert!(
            phases[executed.start + planned..executed.end]
                .iter()
                .all(|phase| *phase == Some("replay")),
            "{at}, decision {number}: a plan step follows a replay step"
        );
        let (plan, replay) = (
            of_decision("plan_steps")[index] as usize,
            of_decision("replay_steps")[index] as usize,
        );
        assert!(
            planned <= plan && replayed <= replay,
            "{at}, decision {number}: {executed:?} of {plan} + {replay}"
        );
        assert!(
            replayed == 0 || planned == plan,
            "{at}, decision {number}: the replay began before the end of the plan"
        );
    }
    assert_eq!(
        belongs.last().map(|last| *last as usize + 1),
        Some(decisions.len()),
        "{at}"
    );
    let reasons = col_text(&rollouts.decisions, "reason").unwrap();
    assert!(
        reasons[decisions]
            .iter()
            .all(|reason| reason.is_some_and(|text| !text.is_empty())),
        "{at}"
    );
}

fn decisions_have_the_state_of_their_step(
    rollouts: &Rollouts,
    rollout: usize,
    steps: Range<usize>,
    decisions: Range<usize>,
    at: &str,
) {
    let step_of = col_u32(&rollouts.decisions, "step").unwrap();
    let demo_frame = col_u32(&rollouts.decisions, "demo_frame").unwrap();
    let demo_end = col_u32(&rollouts.decisions, "demo_end").unwrap();
    for decision in decisions {
        let step = step_of[decision] as usize;
        for (seen, in_results, in_steps) in [
            ("query_eef_x", "eef_x", "eef_x"),
            ("query_eef_y", "eef_y", "eef_y"),
            ("query_object_x", "object_x", "object_x"),
            ("query_object_y", "object_y", "object_y"),
            ("query_object_theta", "object_theta", "object_theta"),
        ] {
            let state = match step {
                0 => rollouts.result(in_results, rollout),
                _ => rollouts.step(in_steps)[steps.start + step - 1],
            };
            assert_eq!(
                rollouts.decision(seen)[decision],
                state,
                "{at}, decision {decision}: {seen}"
            );
        }
        assert!(demo_frame[decision] <= demo_end[decision], "{at}, decision {decision}");
        let pose = |name: &str| rollouts.decision(&format!("predicted_object_{name}"))[decision];
        let predicted = coverage(Pose2::new(pose("x"), pose("y"), pose("theta")), GOAL);
        assert!(
            (rollouts.decision("predicted_coverage")[decision] - predicted).abs() < 1e-12,
            "{at}, decision {decision}"
        );
    }
}

/// In a new simulator, the recorded actions give the recorded states bit for bit.
fn the_simulator_reproduces_the_states(rollouts: &Rollouts, rollout: usize, seed: u32, steps: Range<usize>, at: &str) {
    let mut simulator = PushT::new().unwrap();
    let scene = scene_from_seed(SeedScheme::DiffusionPolicy, seed);
    let start = simulator.reset(&scene, ResetOrder::Legacy).unwrap();
    let recorded = ["eef_x", "eef_y", "object_x", "object_y", "object_theta"].map(|n| rollouts.result(n, rollout));
    let reached = [
        start.agent.x,
        start.agent.y,
        start.block.x,
        start.block.y,
        start.block.theta,
    ];
    assert_eq!(recorded, reached, "{at}");
    for step in steps {
        let action = Point2::new(rollouts.step("action_x")[step], rollouts.step("action_y")[step]);
        let after = simulator.step(&action).unwrap();
        let names = [
            "eef_x",
            "eef_y",
            "object_x",
            "object_y",
            "object_theta",
            "coverage",
            "iou",
            "contacts",
        ];
        let recorded = names.map(|name| rollouts.step(name)[step]);
        let seen = after.observation;
        let reached = [
            seen.agent.x,
            seen.agent.y,
            seen.block.x,
            seen.block.y,
            seen.block.theta,
            after.coverage,
            after.iou,
            f64::from(after.contacts),
        ];
        assert_eq!(recorded, reached, "{at}, row {step}");
    }
}

#[test]
fn tables_of_the_re4_preset_are_consistent() {
    check("re4");
}

#[test]
fn tables_of_the_paper_preset_are_consistent() {
    check("paper");
}

#[test]
fn tables_of_the_re2_preset_are_consistent() {
    check("re2");
}
