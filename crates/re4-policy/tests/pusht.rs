//! The presets with the real demonstrations, on twenty scenes that nothing was tuned on. The gates are loose: they are
//! there to catch a step of the loop that no longer works, and the second test shows that they do.
#![expect(clippy::panic, reason = "only tests call these functions, and they may end")]

mod common;

use std::sync::Arc;

use common::{Demos, knowledge, pusht, rollouts, starts};
use re4_index::AngleMetric;
use re4_policy::{Knowledge, PolicyConfig, Selector, Tracking};

const PAPER_GATE: f64 = 0.8;
const RE4_GATE: f64 = 0.95;

/// Mean over the scenes of the maximum score in an episode.
fn score(config: &PolicyConfig, knowledge: &Arc<Knowledge>) -> f64 {
    let seeds: Vec<u32> = (200_000..200_020).collect();
    let episodes =
        rollouts(config, knowledge, &starts(&seeds), 200, &|| true).unwrap_or_else(|error| panic!("{error}"));
    episodes.iter().map(|e| e.maximum(|step| step.score)).sum::<f64>() / seeds.len() as f64
}

/// What the `paper` and the `re4` preset know.
fn known(demos: Demos) -> [Arc<Knowledge>; 2] {
    [
        knowledge(demos.clone(), AngleMetric::Raw),
        knowledge(demos, AngleMetric::Periodic),
    ]
}

#[test]
fn the_presets_reach_their_scores() {
    let Some(demos) = pusht() else { return };
    let [raw, periodic] = known(demos);
    let paper = score(&PolicyConfig::paper(), &raw);
    assert!(paper > PAPER_GATE, "paper: {paper}");
    let re4 = score(&PolicyConfig::re4(), &periodic);
    assert!(re4 > RE4_GATE && re4 > paper, "re4: {re4}, paper: {paper}");
    let re2 = score(&PolicyConfig::re2(), &raw);
    assert!(re2 < paper - 0.1, "re2: {re2}, paper: {paper}");
    println!("paper {paper:.4}, re4 {re4:.4}, re2 {re2:.4}");
}

#[test]
fn a_broken_step_does_not_pass_the_gates() {
    let Some(demos) = pusht() else { return };
    let [raw, periodic] = known(demos);
    let mut reframe = [PolicyConfig::paper(), PolicyConfig::re4()];
    let mut replan = reframe.clone();
    for config in &mut reframe {
        config.reframe.enabled = false;
    }
    for config in &mut replan {
        config.replan.enabled = false;
    }
    for (step, [paper, re4]) in [("reframe", reframe), ("replan", replan)] {
        let papers = score(&paper, &raw);
        let re4s = score(&re4, &periodic);
        println!("without {step}: paper {papers:.4}, re4 {re4s:.4}");
        assert!(papers < PAPER_GATE, "paper without {step}: {papers}");
        assert!(re4s < RE4_GATE, "re4 without {step}: {re4s}");
    }
    // What `re4` adds to `paper` is worth something too.
    let whole = score(&PolicyConfig::re4(), &periodic);
    let mut tracking = PolicyConfig::re4();
    tracking.replay.tracking = Tracking::Actions;
    let mut selector = PolicyConfig::re4();
    selector.retrieve.selector = Selector::TwoStage;
    for (step, config) in [("path tracking", tracking), ("the outcome selector", selector)] {
        let without = score(&config, &periodic);
        println!("re4 without {step}: {without:.4}, with it {whole:.4}");
        assert!(without < whole - 0.01, "re4 without {step}: {without}, with it {whole}");
    }
}
