//! Compares an index in parts with one index and with the linear scan.
#![allow(
    clippy::unwrap_used,
    clippy::print_stdout,
    reason = "a panic is how a test fails, and the documentation quotes the printed figures"
)]

mod common;

use std::collections::BTreeSet;

use common::{Random, bits, coordinates, frame, query};
use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};
use proptest::prelude::*;
use re4_episode::Mode;
use re4_index::{
    AngleMetric, Candidate, IndexError, IndexedFrame, IndexedSpatialFrame, Normalization, Partitioned, Query, Range,
    RetrievalIndex, SpatialIndex, SpatialMetric, SpatialQuery, Stage2, retrieve_linear, retrieve_spatial_linear,
};

type Parts = Partitioned<RetrievalIndex>;

const METRICS: [AngleMetric; 2] = [AngleMetric::Periodic, AngleMetric::Raw];

/// Demonstrations whose states are whole numbers. Most are copies of earlier ones, so nearly every query has ties.
fn demonstrations(random: &mut Random, count: usize) -> Vec<IndexedFrame> {
    let mut made: Vec<Vec<(Mode, [f64; 5])>> = Vec::new();
    for _ in 0..count {
        let copied = (!made.is_empty() && random.below(3) > 0).then(|| made[random.below(made.len())].clone());
        made.push(copied.unwrap_or_else(|| {
            let length = 1 + random.below(12);
            let mut state = || (random.pick(&Mode::ALL), std::array::from_fn(|_| random.below(7) as f64));
            (0..length).map(|_| state()).collect()
        }));
    }
    (0..)
        .step_by(3)
        .zip(made)
        .flat_map(|(episode, frames)| (0..).zip(frames).map(move |(i, (mode, c))| frame(episode, i, mode, c)))
        .collect()
}

fn any_query(random: &mut Random, frames: &[IndexedFrame]) -> Query {
    let c = coordinates(&random.pick(frames));
    let c = match random.below(3) {
        0 => c,
        1 => c.map(|v| v + 0.5 * random.below(3) as f64),
        _ => c.map(|v| v + random.range(-0.5, 0.5)),
    };
    query(random.pick(&Mode::ALL), c)
}

/// Distributes demonstrations at random.
fn scattered(random: &mut Random, frames: &[IndexedFrame], count: usize) -> Vec<Vec<IndexedFrame>> {
    let mut sets = vec![Vec::new(); count];
    for demo in frames.chunk_by(|a, b| a.episode == b.episode) {
        sets[random.below(count)].extend_from_slice(demo);
    }
    sets
}

#[test]
fn eight_parts_answer_ten_thousand_queries_as_one_index_does() {
    let mut random = Random::new(1);
    let (mut queries, mut ties, mut different, mut with_own_ranges) = (0, 0, 0, 0);
    for set in 0..20 {
        let frames = demonstrations(&mut random, 60);
        let angle = METRICS[set % 2];
        let one = RetrievalIndex::build(frames.clone(), angle).unwrap();
        let parts = Parts::build(frames.clone(), angle, 8).unwrap();
        assert_eq!(parts.parts().len(), 8);
        let sets = parts.parts().iter().map(|part| part.frames().to_vec());
        let own: Vec<RetrievalIndex> = sets.map(|set| RetrievalIndex::build(set, angle).unwrap()).collect();
        for _ in 0..500 {
            let query = any_query(&mut random, &frames);
            let epsilon = random.pick(&[0.0, 0.1, f64::INFINITY]);
            let expected = one.retrieve(&query, epsilon).unwrap();
            let scanned = retrieve_linear(one.frames(), one.normalization(), &query, epsilon).unwrap();
            assert_eq!(bits(expected), bits(scanned));
            different += u32::from(bits(parts.retrieve(&query, epsilon).unwrap()) != bits(expected));
            let none = BTreeSet::new();
            let answers = own
                .iter()
                .filter_map(|part| part.candidate(&query, epsilon, &none).unwrap());
            let answer = Candidate::least(answers).map(|least| least.retrieved);
            let place = |found: re4_index::Retrieved| (found.episode, found.frame);
            with_own_ranges += u32::from(answer.map(place) != expected.map(place));
            let next = expected.map(|found| BTreeSet::from([found.episode]));
            let next = next.and_then(|without| one.retrieve_without(&query, epsilon, &without).unwrap());
            ties += u32::from(next.is_some() && next.map(|n| n.d_o.to_bits()) == expected.map(|e| e.d_o.to_bits()));
            queries += 1;
        }
    }
    println!(
        "{queries} queries, {ties} with a tie: 8 parts differ from one index in {different}; with their own ranges in {with_own_ranges}"
    );
    assert_eq!(different, 0);
    assert!(queries == 10_000 && ties > 5000, "{queries}, {ties}");
    assert!(
        with_own_ranges > 500,
        "parts with their own ranges must be noticed: {with_own_ranges}"
    );
}

/// 1 and the next larger number have the same root. One index prefers the demonstration with the smaller square.
#[test]
fn squares_are_compared_and_not_roots() {
    let at = |x, y| [0.0, 0.0, x, y, 0.0];
    let ranges = [Range {
        minimum: 0.0,
        maximum: 1.0,
    }; 5];
    let normalization = Normalization {
        ranges,
        angle: AngleMetric::Raw,
    };
    let far = frame(0, 0, Mode::Transit, at(1.0, 1.5e-8));
    let near = frame(1, 0, Mode::Transit, at(1.0, 0.0));
    let query = query(Mode::Transit, at(0.0, 0.0));
    let parts = Parts::with_normalization(vec![vec![far], vec![near]], normalization).unwrap();
    let roots: Vec<f64> = parts
        .parts()
        .iter()
        .map(|part| part.retrieve(&query, 0.0).unwrap().unwrap().d_o)
        .collect();
    assert_eq!(roots, [1.0, 1.0]);
    let one = RetrievalIndex::with_normalization(vec![far, near], normalization).unwrap();
    assert_eq!(one.retrieve(&query, 0.0).unwrap().unwrap().episode, 1);
    assert_eq!(parts.retrieve(&query, 0.0).unwrap().unwrap().episode, 1);
}

#[test]
fn invalid_parts_are_refused() {
    let one = |episode| vec![frame(episode, 0, Mode::Transit, [1.0; 5])];
    let normalization = Normalization::over(&one(0), AngleMetric::Raw);
    let build = |sets| Parts::with_normalization(sets, normalization).map(|parts| parts.parts().len());
    assert_eq!(build(vec![one(0), Vec::new(), one(1)]).unwrap(), 2);
    assert_eq!(build(vec![Vec::new()]).unwrap_err(), IndexError::Empty);
    assert_eq!(
        build(vec![one(7), one(8), one(7)]).unwrap_err(),
        IndexError::Duplicate { episode: 7, frame: 0 }
    );
    assert_eq!(
        Parts::build(Vec::new(), AngleMetric::Raw, 3).err(),
        Some(IndexError::Empty)
    );
}

/// Zeros with both signs and NaN, which `f64::min` handles in another way.
fn number() -> impl Strategy<Value = f64> {
    prop_oneof![4 => (0..4_i32).prop_map(f64::from), 2 => Just(-0.0), 1 => Just(f64::NAN), 1 => Just(-f64::NAN), 1 => -9.0..9.0_f64]
}

fn range_bits(normalization: &Normalization) -> Vec<(u64, u64)> {
    let ranges = normalization.ranges.iter();
    ranges
        .map(|range| (range.minimum.to_bits(), range.maximum.to_bits()))
        .collect()
}

fn spatial_frames(random: &mut Random) -> Vec<IndexedSpatialFrame> {
    let pose = |random: &mut Random| {
        let at = Translation3::new(random.below(3) as f64, random.below(2) as f64, 0.0);
        let turn = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), random.below(4) as f64 * 0.5);
        Isometry3::from_parts(at, turn)
    };
    let mut frames = Vec::new();
    for episode in 0..2 + random.below(20) as u32 {
        for number in 0..=random.below(6) as u32 {
            frames.push(IndexedSpatialFrame {
                episode: 2 * episode,
                frame: number,
                mode: random.pick(&Mode::ALL),
                eef: pose(random),
                object: pose(random),
            });
        }
    }
    frames
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(300))]

    #[test]
    fn any_distribution_answers_as_one_index_does(seed in any::<u64>(), count in 1..12_usize, raw in any::<bool>()) {
        let mut random = Random::new(seed);
        let demos = 1 + random.below(30);
        let frames = demonstrations(&mut random, demos);
        let angle = METRICS[usize::from(raw)];
        let one = RetrievalIndex::build(frames.clone(), angle).unwrap();
        let sets = scattered(&mut random, &frames, count);
        let merged = Normalization::merged(sets.iter().map(|set| Normalization::over(set, angle))).unwrap();
        prop_assert_eq!(range_bits(&merged), range_bits(one.normalization()));
        let parts = Parts::with_normalization(sets, merged).unwrap();
        for _ in 0..20 {
            let query = any_query(&mut random, &frames);
            let epsilon = random.pick(&[0.0, 0.1, f64::INFINITY]);
            let without: BTreeSet<u32> = (0..random.below(4)).map(|_| random.pick(&frames).episode).collect();
            let expected = one.retrieve_without(&query, epsilon, &without).unwrap();
            prop_assert_eq!(bits(parts.retrieve_without(&query, epsilon, &without).unwrap()), bits(expected));
        }
    }

    #[test]
    fn ranges_of_parts_are_merged_bit_for_bit(
        numbers in prop::collection::vec([number(), number(), number(), number(), number()], 0..20),
        cuts in prop::collection::vec(0..20_usize, 0..4),
        backwards in any::<bool>(),
    ) {
        let frames: Vec<IndexedFrame> = (0..).zip(numbers).map(|(i, c)| frame(i, 0, Mode::Transit, c)).collect();
        let mut bounds: Vec<usize> = cuts.into_iter().map(|cut| cut.min(frames.len())).collect();
        bounds.extend([0, frames.len()]);
        bounds.sort_unstable();
        let parts = bounds.windows(2).map(|pair| Normalization::over(&frames[pair[0]..pair[1]], AngleMetric::Raw));
        let mut parts: Vec<Normalization> = parts.collect();
        if backwards {
            parts.reverse();
        }
        let whole = Normalization::over(&frames, AngleMetric::Raw);
        prop_assert_eq!(range_bits(&Normalization::merged(parts).unwrap()), range_bits(&whole));
    }

    #[test]
    fn parts_in_space_answer_as_one_index_does(seed in any::<u64>(), count in 1..9_usize) {
        let mut random = Random::new(seed);
        let frames = spatial_frames(&mut random);
        let metric = SpatialMetric::default();
        let one = SpatialIndex::build(frames.clone(), metric).unwrap();
        let parts = Partitioned::<SpatialIndex>::build(frames.clone(), metric, count).unwrap();
        for mode in Mode::ALL {
            prop_assert_eq!(parts.demos(mode), one.demos(mode));
        }
        for _ in 0..20 {
            let near = random.pick(&frames);
            let query = SpatialQuery { mode: random.pick(&Mode::ALL), eef: near.eef, object: random.pick(&frames).object };
            let stage2 = random.pick(&[Stage2::Object, Stage2::State]);
            let numbers = |random: &mut Random| -> BTreeSet<u32> {
                let most = random.pick(&[0, 3, 60]);
                (0..most).map(|_| random.pick(&frames).episode).collect()
            };
            let (banned, without) = (numbers(&mut random), numbers(&mut random));
            let expected = one.retrieve_without(&query, stage2, &banned, &without).unwrap();
            let found = parts.retrieve_without(&query, stage2, &banned, &without).unwrap();
            prop_assert_eq!(found, expected);
            let scanned = retrieve_spatial_linear(&frames, &metric, &query, stage2, &banned).unwrap();
            prop_assert_eq!(parts.retrieve(&query, stage2, &banned).unwrap(), scanned);
        }
    }
}
