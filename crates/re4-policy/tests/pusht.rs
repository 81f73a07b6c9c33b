//! The presets with the real demonstrations on twenty scenes that were not used for tuning. The thresholds are loose: they detect
//! a step of the loop that no longer works, which the second test verifies.
#![expect(clippy::panic, reason = "a panic is how a test fails")]

mod common;

use std::sync::Arc;

use common::{Demos, knowledge, pusht, rollouts, starts};
use re4_index::AngleMetric;
use re4_policy::{Knowledge, PolicyConfig, Selector, Tracking};

const PAPER_THRESHOLD: f64 = 0.8;
const RE4_THRESHOLD: f64 = 0.95;

/// Returns the mean over the scenes of the maximum score in an episode.
fn score(config: &PolicyConfig, knowledge: &Arc<Knowledge>) -> f64 {
    let seeds: Vec<u32> = (200_000..200_020).collect();
    let episodes =
        rollouts(config, knowledge, &starts(&seeds), 200, &|| true).unwrap_or_else(|error| panic!("{error}"));
    episodes.iter().map(|e| e.maximum(|step| step.score)).sum::<f64>() / seeds.len() as f64
}

/// Returns the data of the `paper` and of the `re4` preset.
fn knowledge_of_presets(demos: Demos) -> [Arc<Knowledge>; 2] {
    [
        knowledge(demos.clone(), AngleMetric::Raw),
        knowledge(demos, AngleMetric::Periodic),
    ]
}

#[test]
fn the_presets_reach_their_scores() {
    let Some(demos) = pusht() else { return };
    let [raw, periodic] = knowledge_of_presets(demos);
    let paper = score(&PolicyConfig::paper(), &raw);
    assert!(paper > PAPER_THRESHOLD, "paper: {paper}");
    let re4 = score(&PolicyConfig::re4(), &periodic);
    assert!(re4 > RE4_THRESHOLD && re4 > paper, "re4: {re4}, paper: {paper}");
    let re2 = score(&PolicyConfig::re2(), &raw);
    assert!(re2 < paper - 0.1, "re2: {re2}, paper: {paper}");
    println!("paper {paper:.4}, re4 {re4:.4}, re2 {re2:.4}");
}

#[test]
fn without_a_step_the_scores_miss_the_thresholds() {
    let Some(demos) = pusht() else { return };
    let [raw, periodic] = knowledge_of_presets(demos);
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
        assert!(papers < PAPER_THRESHOLD, "paper without {step}: {papers}");
        assert!(re4s < RE4_THRESHOLD, "re4 without {step}: {re4s}");
    }
    // Each addition of `re4` to `paper` improves the score, too.
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
