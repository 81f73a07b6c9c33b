//! Which frames and queries are rejected, and which queries merely have no answer.

mod common;

use common::{agreed, frame, query};
use re4_episode::Mode;
use re4_fault::Remedy as _;
use re4_index::{AngleMetric, IndexError, Normalization, Range, RetrievalIndex, retrieve_linear};

const HERE: [f64; 5] = [1.0, 2.0, 3.0, 4.0, 0.5];
const BROKEN: [f64; 3] = [f64::NAN, f64::INFINITY, f64::NEG_INFINITY];

#[test]
fn the_error_names_a_frame_that_is_not_finite() {
    for broken in BROKEN {
        for dimension in 0..5 {
            let mut c = HERE;
            c[dimension] = broken;
            let frames = vec![frame(2, 0, Mode::Transit, HERE), frame(7, 31, Mode::Transit, c)];
            let error = RetrievalIndex::build(frames, AngleMetric::Periodic).err().unwrap();
            // An infinite coordinate makes the range infinite, which invalidates every frame. Only NaN identifies the frame.
            match error {
                IndexError::NotFinite { episode, frame } => {
                    assert!(!broken.is_nan() || (episode, frame) == (7, 31), "{episode}, {frame}");
                }
                other => panic!("{broken} in dimension {dimension}: {other}"),
            }
        }
    }
}

#[test]
fn empty_input_and_duplicate_frames_are_rejected() {
    assert_eq!(
        RetrievalIndex::build(Vec::new(), AngleMetric::Raw).err(),
        Some(IndexError::Empty)
    );
    let twice = vec![
        frame(1, 5, Mode::Transit, HERE),
        frame(0, 5, Mode::Transit, HERE),
        frame(1, 5, Mode::Transfer, [0.0; 5]),
    ];
    let error = RetrievalIndex::build(twice, AngleMetric::Raw).err().unwrap();
    assert_eq!(error, IndexError::Duplicate { episode: 1, frame: 5 });
    assert!(error.sentence().contains("episode 1 contains frame 5 twice"), "{error}");
    let named = error.clone().named(|episode| Some(format!("demo_{}", episode + 3)));
    assert_eq!(
        named.sentence(),
        "cannot build the index: frame 5 of demo_4 occurs twice; give every frame once"
    );
    assert_eq!(error.clone().named(|_| None), error);
    assert_eq!(IndexError::Empty.named(|_| Some(String::new())), IndexError::Empty);
}

#[test]
fn a_range_that_makes_coordinates_overflow_is_rejected() {
    let tiny = Range {
        minimum: 0.0,
        maximum: 1e-200,
    };
    let normalization = Normalization {
        ranges: [tiny; 5],
        angle: AngleMetric::Raw,
    };
    let error = RetrievalIndex::with_normalization(vec![frame(0, 0, Mode::Transit, HERE)], normalization).err();
    assert_eq!(error, Some(IndexError::NotFinite { episode: 0, frame: 0 }));
}

#[test]
fn a_query_that_is_not_finite_is_an_error_of_index_and_scan() {
    let index = RetrievalIndex::build(vec![frame(0, 0, Mode::Transit, HERE)], AngleMetric::Periodic).unwrap();
    for broken in BROKEN.into_iter().chain([1e300, -1e300]) {
        for dimension in 0..4 {
            let mut c = HERE;
            c[dimension] = broken;
            let q = query(Mode::Transit, c);
            assert_eq!(index.retrieve(&q, 0.1), Err(IndexError::QueryNotFinite), "{q:?}");
            let linear = retrieve_linear(index.frames(), index.normalization(), &q, 0.1);
            assert_eq!(linear, Err(IndexError::QueryNotFinite), "{q:?}");
        }
    }
    for broken in BROKEN {
        let q = query(Mode::Transit, [1.0, 2.0, 3.0, 4.0, broken]);
        assert_eq!(index.retrieve(&q, 0.1), Err(IndexError::QueryNotFinite), "{q:?}");
    }
}

#[test]
fn a_query_finds_only_frames_of_its_mode() {
    let transit_only = RetrievalIndex::build(vec![frame(0, 0, Mode::Transit, HERE)], AngleMetric::Raw).unwrap();
    assert_eq!(agreed(&transit_only, &query(Mode::Transfer, HERE), f64::INFINITY), None);
    // The nearest frames have the wrong mode; one of them is in the same episode as the answer and one in another.
    let frames = vec![
        frame(0, 0, Mode::Transfer, HERE),
        frame(1, 0, Mode::Transfer, HERE),
        frame(1, 1, Mode::Transit, [400.0, 400.0, 300.0, 10.0, 3.0]),
    ];
    let index = RetrievalIndex::build(frames, AngleMetric::Periodic).unwrap();
    let answer = agreed(&index, &query(Mode::Transit, HERE), 0.1).unwrap();
    assert_eq!((answer.episode, answer.frame), (1, 1));
    let answer = agreed(&index, &query(Mode::Transfer, HERE), 0.1).unwrap();
    assert_eq!((answer.episode, answer.frame, answer.d_q), (0, 0, 0.0));
}

#[test]
fn a_query_far_outside_the_ranges_has_an_answer() {
    let frames = (0..500)
        .map(|i| {
            frame(
                i / 50,
                i % 50,
                Mode::Transit,
                [f64::from(i), 0.0, f64::from(i * i % 97), f64::from(i % 31), 1.0],
            )
        })
        .collect();
    let index = RetrievalIndex::build(frames, AngleMetric::Periodic).unwrap();
    for far in [1e3, -1e3, 1e9, -1e9, 1e90] {
        for dimension in 0..4 {
            let mut c = HERE;
            c[dimension] = far;
            for epsilon in [0.0, 0.1, f64::INFINITY] {
                assert!(agreed(&index, &query(Mode::Transit, c), epsilon).is_some());
            }
        }
    }
}

#[test]
fn stage_one_selects_within_each_demonstration_not_over_all_frames() {
    // Demonstration 0 contains the frame with the nearest object pose (frame 0) and the frame with the nearest state (frame 1).
    // With epsilon 0.1, frame 1 is not within epsilon of the minimum `d_o`, so stage 1 must not select it.
    let frames = vec![
        frame(0, 0, Mode::Transit, [100.0, 0.0, 0.0, 0.0, 0.0]),
        frame(0, 1, Mode::Transit, [0.0, 0.0, 40.0, 0.0, 0.0]),
        frame(1, 0, Mode::Transit, [100.0, 100.0, 20.0, 0.0, 0.0]),
        frame(2, 0, Mode::Transit, [0.0, 0.0, 100.0, 100.0, 1.0]),
    ];
    let index = RetrievalIndex::build(frames, AngleMetric::Raw).unwrap();
    let here = query(Mode::Transit, [0.0; 5]);
    let strict = agreed(&index, &here, 0.1).unwrap();
    assert_eq!((strict.episode, strict.frame), (0, 0));
    let open = agreed(&index, &here, f64::INFINITY).unwrap();
    assert_eq!(
        (open.episode, open.frame),
        (1, 0),
        "stage 1 selects frame 1 of demonstration 0, whose d_o is 0.4"
    );
}
