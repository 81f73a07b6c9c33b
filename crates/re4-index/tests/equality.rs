//! Compares the planar index with the linear scan, and the linear scan with an independent implementation of the definition.

mod common;

use std::collections::BTreeSet;
use std::f64::consts::{PI, TAU};

use common::{Random, agreed, bits, coordinates, frame, query};
use proptest::prelude::*;
use re4_episode::Mode;
use re4_index::{AngleMetric, IndexedFrame, Query, RetrievalIndex, retrieve_linear};

const METRICS: [AngleMetric; 2] = [AngleMetric::Periodic, AngleMetric::Raw];
const EPSILONS: [f64; 5] = [0.0, 0.03, 0.1, 0.5, f64::INFINITY];

#[derive(Clone, Copy)]
enum Shape {
    /// A few integer values, which give many duplicates and ties.
    Grid,
    /// Uniform random states.
    Scattered,
    /// Small steps from frame to frame; the angle crosses the discontinuity at 0 and 2π.
    Walk,
    /// Copies of a few episodes, so that every frame has an equal frame in another episode.
    Copies,
}

/// Generates random demonstrations of 1 to `longest` frames. Every episode has frames of both modes unless `one_mode` is set.
fn demonstrations(
    random: &mut Random,
    shape: Shape,
    episodes: usize,
    longest: usize,
    one_mode: bool,
) -> Vec<IndexedFrame> {
    let mut made: Vec<Vec<(Mode, [f64; 5])>> = Vec::new();
    for _ in 0..episodes {
        if matches!(shape, Shape::Copies) && made.len() >= 3 {
            made.push(made[random.below(3)].clone());
            continue;
        }
        let mut c = std::array::from_fn(|i| random.range(0.0, if i == 4 { TAU } else { 512.0 }));
        let frames = (0..=random.below(longest)).map(|_| {
            match shape {
                Shape::Grid | Shape::Copies => c = std::array::from_fn(|_| random.below(5) as f64),
                Shape::Scattered => {
                    c = std::array::from_fn(|i| random.range(-1.0, 1.0) * if i == 4 { 20.0 } else { 512.0 });
                }
                Shape::Walk => {
                    for (i, v) in c.iter_mut().enumerate() {
                        *v += random.range(-1.0, 1.0) * if i == 4 { 0.2 } else { 8.0 };
                    }
                }
            }
            let mode = if one_mode {
                Mode::Transfer
            } else {
                random.pick(&Mode::ALL)
            };
            (mode, c)
        });
        made.push(frames.collect());
    }
    // The episode numbers have gaps because they identify demonstrations and are not positions.
    (0..)
        .step_by(3)
        .zip(made)
        .flat_map(|(episode, frames)| (0..).zip(frames).map(move |(i, (mode, c))| frame(episode, i, mode, c)))
        .collect()
}

/// A query that equals a frame, is near it, has an alias of its angle, is anywhere in the range, or is far outside the range.
fn any_query(random: &mut Random, frames: &[IndexedFrame]) -> Query {
    let mut c = coordinates(&random.pick(frames));
    match random.below(6) {
        0 => {}
        1 => c = c.map(|v| v + random.range(-0.5, 0.5)),
        2 => c[4] += TAU * random.pick(&[-3.0, -2.0, -1.0, 1.0, 2.0]),
        3 => c = std::array::from_fn(|i| random.range(0.0, if i == 4 { TAU } else { 512.0 })),
        4 => c = c.map(|v| v.round() + random.below(3) as f64 - 1.0),
        _ => c = c.map(|v| v + random.range(-1.0, 1.0) * random.pick(&[1e4, 1e9, 1e40])),
    }
    query(random.pick(&Mode::ALL), c)
}

#[test]
fn index_and_linear_scan_agree_on_a_hundred_thousand_queries() {
    let mut random = Random::new(1);
    let (mut answered, mut unanswered) = (0, 0);
    let shapes = [Shape::Grid, Shape::Scattered, Shape::Walk, Shape::Copies];
    for set in 0..1400 {
        let one_mode = set % 10 == 0;
        let (episodes, longest) = random.pick(&[(1, 1), (1, 40), (40, 1), (9, 9), (12, 30), (30, 8)]);
        let frames = demonstrations(&mut random, shapes[set % 4], episodes, longest, one_mode);
        let index = RetrievalIndex::build(frames.clone(), METRICS[set / 4 % 2]).unwrap();
        for _ in 0..90 {
            let query = any_query(&mut random, &frames);
            let answer = agreed(&index, &query, random.pick(&EPSILONS));
            let admissible = frames.iter().any(|f| f.mode == query.mode);
            assert_eq!(
                answer.is_some(),
                admissible,
                "an answer exists if a frame has the mode: {query:?}"
            );
            *if admissible { &mut answered } else { &mut unanswered } += 1;
        }
    }
    assert!(answered >= 100_000 && unanswered >= 1000, "{answered}, {unanswered}");
}

#[test]
fn leaving_out_demonstrations_at_the_query_is_an_index_without_them_with_the_same_scales() {
    let mut random = Random::new(3);
    let shapes = [Shape::Grid, Shape::Scattered, Shape::Walk, Shape::Copies];
    let mut changed = 0;
    for set in 0..400 {
        let frames = demonstrations(&mut random, shapes[set % 4], 12, 12, set % 10 == 0);
        let index = RetrievalIndex::build(frames.clone(), METRICS[set / 4 % 2]).unwrap();
        for _ in 0..40 {
            let query = any_query(&mut random, &frames);
            let epsilon = random.pick(&EPSILONS);
            let all = index.retrieve(&query, epsilon).unwrap();
            let count = random.below(4);
            let without: BTreeSet<u32> = (0..count).map(|_| random.pick(&frames).episode).collect();
            let others: Vec<IndexedFrame> = index
                .frames()
                .iter()
                .copied()
                .filter(|frame| !without.contains(&frame.episode))
                .collect();
            let expected = retrieve_linear(&others, index.normalization(), &query, epsilon).unwrap();
            let found = index.retrieve_without(&query, epsilon, &without).unwrap();
            assert_eq!(bits(found), bits(expected), "{query:?} without {without:?}");
            // The lemma on which the influence rests: only the demonstration of the answer matters.
            if all.is_none_or(|answer| !without.contains(&answer.episode)) {
                assert_eq!(bits(found), bits(all), "{query:?} without {without:?}");
            } else {
                changed += 1;
            }
        }
    }
    assert!(changed > 1000, "{changed}");
}

#[test]
fn index_and_linear_scan_agree_on_large_sets() {
    // The sets have more than FAN³ frames in one mode, so that the tree has several levels, and are large enough to be arranged
    // in parallel.
    let mut random = Random::new(2);
    for (shape, episodes, longest) in [
        (Shape::Walk, 700, 120),
        (Shape::Grid, 60, 60),
        (Shape::Copies, 200, 60),
        (Shape::Scattered, 2000, 4),
    ] {
        let frames = demonstrations(&mut random, shape, episodes, longest, true);
        for metric in METRICS {
            let index = RetrievalIndex::build(frames.clone(), metric).unwrap();
            for _ in 0..60 {
                let query = Query {
                    mode: Mode::Transfer,
                    ..any_query(&mut random, &frames)
                };
                agreed(&index, &query, random.pick(&EPSILONS));
            }
        }
    }
}

/// Implements Retrieve as the paper defines it, from raw coordinates and without code of the crate: distances are square roots
/// and lists are sorted. The sums are `(x² + y²) + θ²` and `(eef x² + eef y²) + d_o²`, which determines the last bit on random
/// data.
fn by_definition(
    frames: &[IndexedFrame],
    metric: AngleMetric,
    query: &Query,
    epsilon: f64,
) -> Option<(u32, u32, f64, f64)> {
    let wrapped = |angle: f64| ((angle % TAU) + TAU) % TAU;
    let columns = |c: [f64; 5]| [c[0], c[1], c[2], c[3], wrapped(c[4])];
    let all: Vec<[f64; 5]> = frames.iter().map(|f| columns(coordinates(f))).collect();
    let sorted = |i: usize| {
        let mut values: Vec<f64> = all.iter().map(|c| c[i]).collect();
        values.sort_by(f64::total_cmp);
        values
    };
    let low: Vec<f64> = (0..5).map(|i| sorted(i)[0]).collect();
    let span: Vec<f64> = (0..5)
        .map(|i| sorted(i)[all.len() - 1] - low[i])
        .map(|span| if span == 0.0 { 1.0 } else { span })
        .collect();
    let scaled = |c: [f64; 5]| -> Vec<f64> { (0..5).map(|i| (c[i] - low[i]) / span[i]).collect() };
    let q = scaled(columns([
        query.eef.x,
        query.eef.y,
        query.object.x,
        query.object.y,
        query.object.theta,
    ]));
    let distances = |c: [f64; 5]| {
        let f = scaled(c);
        let mut angle = (q[4] - f[4]).abs();
        if metric == AngleMetric::Periodic && TAU / span[4] - angle < angle {
            angle = TAU / span[4] - angle;
        }
        let squared = |i: usize| (q[i] - f[i]).powi(2);
        let object = squared(2) + squared(3) + angle.powi(2);
        ((squared(0) + squared(1) + object).sqrt(), object.sqrt())
    };
    let mut episodes: Vec<u32> = frames.iter().map(|f| f.episode).collect();
    episodes.sort_unstable();
    episodes.dedup();
    let mut winners: Vec<(u32, u32, f64, f64)> = Vec::new();
    for episode in episodes {
        let mut candidates: Vec<(u32, f64, f64)> = frames
            .iter()
            .zip(&all)
            .filter(|(f, _)| f.episode == episode && f.mode == query.mode)
            .map(|(f, &c)| (f.frame, distances(c).0, distances(c).1))
            .collect();
        candidates.sort_by(|a, b| a.2.total_cmp(&b.2));
        let Some(&(_, _, minimum)) = candidates.first() else {
            continue;
        };
        candidates.retain(|c| c.2 <= minimum + epsilon);
        candidates.sort_by(|a, b| a.1.total_cmp(&b.1).then(a.0.cmp(&b.0)));
        let (number, d_q, d_o) = candidates[0];
        winners.push((episode, number, d_q, d_o));
    }
    winners.sort_by(|a, b| a.3.total_cmp(&b.3).then(a.0.cmp(&b.0)));
    winners.first().copied()
}

#[test]
fn the_linear_scan_matches_the_definition() {
    let mut random = Random::new(3);
    for set in 0..400 {
        let frames = match set % 4 {
            // The corners make every span 4, so that distances on the grid are exact.
            0 => {
                let mut frames = demonstrations(&mut random, Shape::Grid, 8, 12, false);
                frames.push(frame(900, 0, Mode::Transit, [0.0; 5]));
                frames.push(frame(900, 1, Mode::Transfer, [4.0; 5]));
                frames
            }
            1 => demonstrations(&mut random, Shape::Scattered, 8, 12, false),
            2 => demonstrations(&mut random, Shape::Walk, 6, 20, true),
            _ => demonstrations(&mut random, Shape::Copies, 10, 8, false),
        };
        let metric = METRICS[set / 4 % 2];
        let index = RetrievalIndex::build(frames.clone(), metric).unwrap();
        for _ in 0..25 {
            let query = any_query(&mut random, &frames);
            if query.eef.norm() > 1e5 || query.object.translation().norm() > 1e5 || query.object.theta.abs() > 1e5 {
                // For such large values the two orders of operations lose different digits.
                continue;
            }
            let epsilon = random.pick(&[0.0, 0.03, 0.25, f64::INFINITY]);
            let linear = retrieve_linear(index.frames(), index.normalization(), &query, epsilon).unwrap();
            let definition = by_definition(&frames, metric, &query, epsilon);
            let named = linear.map(|a| (a.episode, a.frame));
            assert_eq!(
                named,
                definition.map(|d| (d.0, d.1)),
                "{query:?}, epsilon {epsilon}, {metric:?}"
            );
            if let (Some(a), Some((_, _, d_q, d_o))) = (linear, definition) {
                assert!(
                    (a.d_q - d_q).abs() < 1e-12 && (a.d_o - d_o).abs() < 1e-12,
                    "{query:?}: {a:?}"
                );
            }
        }
    }
}

#[test]
fn the_order_of_the_frames_does_not_matter() {
    let mut random = Random::new(4);
    for shape in [Shape::Grid, Shape::Copies, Shape::Walk] {
        let frames = demonstrations(&mut random, shape, 25, 40, false);
        let mut shuffled = frames.clone();
        random.shuffle(&mut shuffled);
        assert_ne!(frames, shuffled);
        for metric in METRICS {
            let one = RetrievalIndex::build(frames.clone(), metric).unwrap();
            let other = RetrievalIndex::build(shuffled.clone(), metric).unwrap();
            assert_eq!(one.frames(), other.frames());
            for _ in 0..300 {
                let query = any_query(&mut random, &frames);
                let epsilon = random.pick(&EPSILONS);
                let answers = [&one, &other].map(|index| bits(index.retrieve(&query, epsilon).unwrap()));
                assert_eq!(answers[0], answers[1], "{query:?}, epsilon {epsilon}");
            }
        }
    }
}

#[test]
fn an_angle_and_its_aliases_find_the_same_frame() {
    let at = |theta| [0.0, 0.0, 0.0, 0.0, theta];
    let angles = [
        0.0,
        0.1,
        PI,
        TAU - 0.1,
        TAU - 1e-9,
        TAU,
        -0.3,
        TAU + 0.5,
        -4.0 * TAU + 1.0,
    ];
    let frames: Vec<IndexedFrame> = (0..)
        .zip(angles)
        .map(|(i, theta)| frame(i, 0, Mode::Transit, at(theta)))
        .collect();
    let periodic = RetrievalIndex::build(frames.clone(), AngleMetric::Periodic).unwrap();
    let raw = RetrievalIndex::build(frames, AngleMetric::Raw).unwrap();
    for step in 0..4000 {
        let theta = -3.0 * TAU + 6.0 * TAU * f64::from(step) / 4000.0;
        for index in [&periodic, &raw] {
            let here = query(Mode::Transit, at(theta));
            let answer = agreed(index, &here, 0.1).unwrap();
            for revolutions in [-2.0, 1.0] {
                let alias = query(Mode::Transit, at(theta + TAU * revolutions));
                let other = agreed(index, &alias, 0.1).unwrap();
                assert!(
                    (answer.d_o - other.d_o).abs() < 1e-9,
                    "{theta}: {answer:?} and {other:?}"
                );
            }
        }
    }
    let just_below = query(Mode::Transit, at(TAU - 1e-12));
    assert_eq!(
        periodic.retrieve(&just_below, 0.1).unwrap().unwrap().episode,
        0,
        "0 and 2π are the same periodic angle"
    );
    assert_eq!(
        raw.retrieve(&just_below, 0.1).unwrap().unwrap().episode,
        4,
        "raw angles are discontinuous at 2π"
    );
    let below_zero = query(Mode::Transit, at(-0.29));
    assert_eq!(periodic.retrieve(&below_zero, 0.1).unwrap().unwrap().episode, 6);
}

/// Few values per coordinate, so that shrinking ends at a readable case.
fn small_frames() -> impl Strategy<Value = Vec<IndexedFrame>> {
    let coordinate = || prop_oneof![(0..3i32).prop_map(f64::from), -700.0..700.0f64];
    let one = (
        0..4u32,
        any::<bool>(),
        [coordinate(), coordinate(), coordinate(), coordinate(), coordinate()],
    );
    prop::collection::vec(one, 1..40).prop_map(|list| {
        (0..)
            .zip(list)
            .map(|(number, (episode, grasped, c))| frame(episode, number, Mode::ALL[usize::from(grasped)], c))
            .collect()
    })
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(3000))]

    #[test]
    fn index_and_linear_scan_agree_on_small_sets(
        frames in small_frames(),
        raw in any::<bool>(),
        grasped in any::<bool>(),
        c in [-3.0..6.0f64, -3.0..6.0f64, -3.0..6.0f64, -800.0..800.0f64, -20.0..20.0f64],
        whole in any::<bool>(),
        epsilon in prop_oneof![Just(0.0), Just(f64::INFINITY), 0.0..1.0f64],
    ) {
        let index = RetrievalIndex::build(frames.clone(), METRICS[usize::from(raw)]).unwrap();
        let c = if whole { c.map(f64::round) } else { c };
        let query = query(Mode::ALL[usize::from(grasped)], c);
        let fast = index.retrieve(&query, epsilon).unwrap();
        let slow = retrieve_linear(index.frames(), index.normalization(), &query, epsilon).unwrap();
        prop_assert_eq!(bits(fast), bits(slow));
    }
}
