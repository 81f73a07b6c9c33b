//! The rows of the table: novelty, ranks, quality and missing values.

use nalgebra::Vector3;
use proptest::prelude::*;
use re4_episode::{Mode, Segment};
use re4_scores::{KINDS, Motion, Sketch, correlation, describe, nearest, ranks, score};

fn motion(points: &[[f64; 3]]) -> Motion {
    let eef: Vec<Vector3<f64>> = points.iter().map(|point| Vector3::from(*point)).collect();
    Motion {
        steps: eef.windows(2).map(|pair| (pair[1] - pair[0]).norm()).collect(),
        object: vec![Vector3::zeros(); eef.len()],
        fingers: Vec::new(),
        states: eef.iter().map(|at| [at.x, at.y, at.z, 0.0, 0.0, 0.0, 0.0]).collect(),
        actions: vec![[0.1; 7]; eef.len()],
        segments: vec![Segment {
            mode: Mode::Transit,
            frames: 0..eef.len(),
        }],
        eef,
        period: 0.1,
    }
}

/// A line from the origin at this angle, with this many frames.
fn line(angle: f64, frames: usize) -> Motion {
    let (sin, cos) = f64::sin_cos(angle);
    let at = |frame: usize| frame as f64 / (frames - 1) as f64;
    motion(
        &(0..frames)
            .map(|frame| [cos * at(frame), sin * at(frame), 0.0])
            .collect::<Vec<_>>(),
    )
}

#[test]
fn novelty_does_not_depend_on_the_pace() {
    let demos: Vec<_> = [line(0.0, 30), line(0.0, 90), line(1.0, 30)]
        .iter()
        .map(|m| describe(m).unwrap())
        .collect();
    let found = nearest(&demos);
    let (twin, apart) = found[0].unwrap();
    assert_eq!(twin, 1);
    assert!(apart < 1e-6, "{apart}");
    // Points at distance s on two lines at an angle of 1 rad are 2 s sin(1/2) apart; the mean of s^2 over 16 knots is 31 / 90.
    let (_, apart) = found[2].unwrap();
    let known = 2.0 * 0.5_f64.sin() * (31.0_f64 / 90.0).sqrt();
    assert!((apart - known).abs() < 1e-6, "{apart}, known {known}");
    assert_eq!(nearest(&demos[..1]), vec![None]);
    assert!(nearest(&[]).is_empty());
}

#[test]
fn equal_values_share_ranks_and_missing_values_have_none() {
    let values = [Some(3.0), None, Some(1.0), Some(3.0), Some(2.0)];
    assert_eq!(ranks(&values, true), [Some(1.5), None, Some(4.0), Some(1.5), Some(3.0)]);
    assert_eq!(
        ranks(&values, false),
        [Some(3.5), None, Some(1.0), Some(3.5), Some(2.0)]
    );
}

#[test]
fn the_correlation_is_spearmans() {
    let column = |values: [f64; 5]| values.map(Some).to_vec();
    let ordered = column([1.0, 2.0, 3.0, 4.0, 5.0]);
    assert_eq!(
        correlation(&ordered, &column([10.0, 20.0, 30.0, 40.0, 500.0])),
        Some(1.0)
    );
    assert_eq!(correlation(&ordered, &column([5.0, 4.0, 3.0, 2.0, 1.0])), Some(-1.0));
    // 1 - 6 * (1 + 1 + 0 + 1 + 1) / (5 * 24)
    let swapped = correlation(&ordered, &column([2.0, 1.0, 3.0, 5.0, 4.0])).unwrap();
    assert!((swapped - 0.8).abs() < 1e-12);
    assert_eq!(correlation(&ordered, &column([1.0; 5])), None);
    assert_eq!(correlation(&ordered[..0], &ordered[..0]), None);
}

#[test]
fn the_better_demonstration_ranks_first_in_everything_that_differs() {
    let waiting: Vec<[f64; 3]> = (0..120)
        .map(|at| [f64::from(at.min(29)) / 29.0, if at % 2 == 0 { 0.0 } else { 0.01 }, 0.0])
        .collect();
    let sketches = [Sketch::of(4, &line(0.0, 30)), Sketch::of(9, &motion(&waiting))];
    let rows = score(&sketches);
    assert_eq!(rows.iter().map(|row| row.episode).collect::<Vec<_>>(), [4, 9]);
    let ranked = |column: &str| {
        let kind = KINDS.iter().find(|kind| kind.column == column).unwrap();
        rows.iter().map(|row| (kind.rank)(&row.rank)).collect::<Vec<_>>()
    };
    for column in [
        "duration",
        "path_efficiency",
        "log_dimensionless_jerk",
        "envelope_distance",
    ] {
        assert_eq!(ranked(column), [Some(1.0), Some(2.0)], "{column}");
    }
    assert_eq!(ranked("regrasps"), [None, None]);
    assert_eq!(ranked("novelty"), [Some(1.5), Some(1.5)]);
    assert_eq!((rows[0].nearest, rows[1].nearest), (Some(9), Some(4)));
    assert!(rows[0].quality > rows[1].quality);
}

#[test]
fn a_demonstration_of_one_frame_has_no_scores_but_its_duration() {
    let rows = score(&[Sketch::of(0, &motion(&[[0.0; 3]])), Sketch::of(1, &line(0.0, 9))]);
    let known = KINDS.iter().filter(|kind| (kind.value)(&rows[0].scores).is_some());
    assert_eq!(
        known.map(|kind| kind.column).collect::<Vec<_>>(),
        ["duration", "novelty"]
    );
    assert!(score(&[]).is_empty());
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]

    /// The search by tree finds what the comparison of all pairs finds.
    #[test]
    fn the_nearest_demonstration_is_found_exactly(angles in proptest::collection::vec((0.0..3.0_f64, 8..40_usize), 2..60)) {
        let demos: Vec<_> = angles.iter().map(|(angle, frames)| describe(&line(*angle, *frames)).unwrap()).collect();
        let found = nearest(&demos);
        for (own, found) in found.iter().enumerate() {
            let others: Vec<_> = (0..demos.len()).filter(|&other| other != own).collect();
            let of = |other: usize| nearest(&[demos[own].clone(), demos[other].clone()])[0].unwrap().1;
            let best = others.iter().map(|&other| of(other)).fold(f64::INFINITY, f64::min);
            prop_assert_eq!(found.unwrap().1, best);
        }
    }
}
