//! Effects and choices for a toy policy by retrieval, against brute force.
#![expect(clippy::unwrap_used, reason = "a panic is how a test fails")]

use std::collections::BTreeSet;
use std::convert::Infallible;
use std::sync::Arc;

use re4_influence::{
    Aim, By, Curate, Demo, Episode, Evaluation, Roll, Scenes, Score, Without, curate, episode_rows, evaluate,
    evaluate_without, influence_rows, leave_one_out, pair_rows,
};
use re4_rollout::Traced;

const DEMOS: usize = 12;
const MAX_STEPS: u32 = 100;

/// Position of a demonstration or scene on a line, without a pattern.
fn place(number: usize) -> f64 {
    (number as f64 * 0.618_034).fract()
}

/// Every third demonstration is bad.
fn is_bad(demo: usize) -> bool {
    demo.is_multiple_of(3)
}

/// An episode follows the nearest demonstration three times, from a place that depends on the one before. It fails if it follows a bad
/// one twice.
fn roll_one(Episode { scene, without }: &Episode, calls: &mut usize) -> Traced {
    *calls += 1;
    let mut at = place(scene + 100);
    let mut episode = Traced {
        seed: *scene as u32,
        success: true,
        score: 1.0,
        steps: 0,
        start: [at, 0.0],
        followed: Vec::new(),
        considered: BTreeSet::new(),
    };
    let mut bad = 0;
    for _ in 0..3 {
        let kept = (0..DEMOS).filter(|demo| !without.contains(&(*demo as u32)));
        let nearest = kept
            .min_by(|a, b| (place(*a) - at).abs().total_cmp(&(place(*b) - at).abs()))
            .unwrap();
        episode.followed.push(nearest as u32);
        episode.considered.insert(nearest as u32);
        episode.steps += 10;
        bad += u32::from(is_bad(nearest));
        at = (at + place(nearest) + 0.13).fract();
    }
    if bad >= 2 {
        (episode.success, episode.score, episode.steps) = (false, 0.25, MAX_STEPS);
    }
    episode
}

/// Calls `body` with the toy, and returns the number of episodes that were rolled out.
fn with_toy<R>(body: impl FnOnce(&mut Roll<'_, Infallible>) -> Result<R, Infallible>) -> (R, usize) {
    let mut calls = 0;
    let mut roll = |episodes: &[Episode]| Ok(episodes.iter().map(|one| roll_one(one, &mut calls)).collect());
    let result = body(&mut roll).unwrap();
    (result, calls)
}

fn brute(scenes: usize, without: impl IntoIterator<Item = u32>) -> Evaluation {
    let without: Without = Arc::new(without.into_iter().collect());
    with_toy(|roll| evaluate(roll, scenes, &without)).0
}

#[test]
fn leaving_one_out_is_brute_force_at_the_cost_of_what_depends() {
    let scenes = 60;
    let ((base, changes), calls) = with_toy(|roll| {
        let base = evaluate(roll, scenes, &Arc::default())?;
        let changes = leave_one_out(roll, &base)?;
        Ok((base, changes))
    });
    assert_eq!(calls, scenes + changes.len());
    assert!(changes.len() <= 3 * scenes, "only what was followed");
    let demos: Vec<Demo> = (0..DEMOS)
        .map(|demo| Demo {
            name: format!("demo_{demo}"),
            start: [place(demo), 0.0],
        })
        .collect();
    let episodes = episode_rows(Scenes::Given, &base, &changes);
    let mut pairs = pair_rows(Scenes::Given, &demos, &base, &changes);
    let rows = influence_rows(&demos, &episodes, &pairs);
    // Pairs of parts are in another order.
    pairs.reverse();
    assert_eq!(influence_rows(&demos, &episodes, &pairs), rows);
    let mut flipped = 0;
    for (demo, row) in (0..).zip(&rows) {
        let without = brute(scenes, [demo]);
        for (scene, episode) in without.episodes.iter().enumerate() {
            let change = changes
                .iter()
                .find(|change| (change.demo, change.scene) == (demo, scene));
            assert_eq!(change.map_or(&base.episodes[scene], |change| &change.after), episode);
        }
        assert!((row.success_change - (without.success() - base.success())).abs() < 1e-12);
        let score = |evaluation: &Evaluation| evaluation.mean(|episode| episode.score);
        assert!((row.score_change - (score(&without) - score(&base))).abs() < 1e-12);
        assert!(row.success_low <= row.success_change && row.success_change <= row.success_high);
        assert_eq!(row.successes + row.failures, row.followed);
        flipped += row.repaired + row.broken;
    }
    assert!(flipped > 0, "the toy shows nothing");
}

#[test]
fn more_demonstrations_are_left_out_at_the_cost_of_what_depends() {
    let scenes = 60;
    for more in [vec![0], vec![3, 4], vec![1, 2, 5, 9]] {
        let more: BTreeSet<u32> = more.into_iter().collect();
        let (found, calls) = with_toy(|roll| {
            let base = evaluate(roll, scenes, &Arc::new(BTreeSet::from([7])))?;
            evaluate_without(roll, &base, &more)
        });
        assert_eq!(found, brute(scenes, more.iter().copied().chain([7])));
        assert!(calls < 2 * scenes);
    }
}

fn request<'a>(scores: &'a [Score], findings: &'a Score, by: By, aim: Aim) -> Curate<'a> {
    Curate {
        demos: DEMOS,
        scenes: 60,
        max_steps: MAX_STEPS,
        scores,
        findings,
        by,
        aim,
    }
}

#[test]
fn the_bad_demonstrations_are_dropped() {
    let score = |name: &str, values: &dyn Fn(usize) -> f64| Score {
        name: name.to_owned(),
        values: (0..DEMOS).map(|demo| Some(values(demo))).collect(),
    };
    let scores = [
        score("noise", &place),
        score("quality", &|demo| f64::from(u8::from(!is_bad(demo)))),
    ];
    let findings = score("findings", &|demo| f64::from(u8::from(is_bad(demo))));
    let all = brute(60, []);
    for by in [By::Influence, By::Audit, By::Scores, By::Combined] {
        let request = request(&scores, &findings, by, Aim::Harmful);
        let choice = with_toy(|roll| curate(&request, roll)).0;
        let dropped = (0..DEMOS as u32).filter(|demo| !choice.kept.contains(demo));
        let kept = brute(60, dropped);
        assert!(
            kept.success() > all.success(),
            "{by:?}: {} {}",
            kept.success(),
            all.success()
        );
        let bad = choice.kept.iter().filter(|demo| is_bad(**demo as usize)).count();
        assert!(bad <= 1, "{by:?} keeps {:?}", choice.kept);
        assert_eq!(choice.dropped.len() + choice.kept.len(), DEMOS);
        assert_eq!(choice.ranking().len(), DEMOS);
    }
}

#[test]
fn redundant_demonstrations_change_nothing() {
    let findings = Score {
        name: "findings".to_owned(),
        values: vec![None; DEMOS],
    };
    let request = request(&[], &findings, By::Influence, Aim::Redundant);
    let choice = with_toy(|roll| curate(&request, roll)).0;
    let kept = brute(60, (0..DEMOS as u32).filter(|demo| !choice.kept.contains(demo)));
    assert_eq!(kept.episodes, brute(60, []).episodes);
}
