//! Inputs that reproduce public bug reports, if available: each is read, or refused with a remedy that works.
#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    reason = "helpers of tests may fail like tests"
)]

mod common;

use common::made::foreign;
use common::read_all;
use re4_ingest::pusht::{PushtConventions, PushtEpisodes, PushtOptions, PushtReader, PushtReading};
use re4_ingest::{Selection, WarningCode};

fn read(case: &str, settings: &str) -> Option<PushtReading> {
    let conventions: PushtConventions = serde_json::from_str(settings).unwrap();
    let options = PushtOptions {
        conventions,
        images: true,
        ..PushtOptions::default()
    };
    let reader = PushtReader::open(&foreign(case)?).unwrap();
    Some(reader.read(&Selection::All, &options).unwrap())
}

fn refusal(case: &str) -> Option<String> {
    let sentence = read_all(&foreign(case)?).expect_err("it should be refused");
    Some(sentence.split_once(".zarr: ").unwrap().1.to_owned())
}

/// Frames with numbers that differ by more than a tolerance.
fn different(one: &PushtEpisodes, other: &PushtEpisodes, tolerance: f64) -> Vec<usize> {
    assert_eq!(one.frames, other.frames);
    let far = |a: &[f64], b: &[f64]| a.iter().zip(b).any(|(a, b)| (a - b).abs() > tolerance);
    (0..one.frame_count())
        .filter(|&frame| far(&one.state[frame], &other.state[frame]) || far(&one.action[frame], &other.action[frame]))
        .collect()
}

#[test]
fn different_storage_reads_as_the_control() {
    let Some(control) = read("z00_control", "{}") else {
        return;
    };
    for case in [
        "z01_zarr3_format3",
        "z02_zarr3_writes_format2",
        "z04_nested_separator",
        "z29_zattrs_nan",
        "z10_state_with_velocity",
    ] {
        let Some(other) = read(case, "{}") else { return };
        assert!(different(&control.episodes, &other.episodes, 0.0).is_empty(), "{case}");
        assert_eq!(control.episodes.contacts, other.episodes.contacts, "{case}");
        assert_eq!(control.episodes.keypoint, other.episodes.keypoint, "{case}");
        let has = |code| other.warnings.iter().any(|warning| warning.code == code);
        assert_eq!(
            has(WarningCode::AbsentChunks),
            case.starts_with("z01") || case.starts_with("z02"),
            "{case}"
        );
        assert_eq!(has(WarningCode::SkippedColumns), case.starts_with("z10"), "{case}");
    }
}

#[test]
fn other_units_and_kinds_are_refused_and_read_with_the_setting() {
    let Some(control) = read("z00_control", "{}") else {
        return;
    };
    let cases = [
        "z06_relative_actions",
        "z08_unit_coordinates",
        "z12_rows_without_end",
        "z23_pictures_unit_floats",
    ];
    let sentences: Vec<String> = cases.iter().filter_map(|case| refusal(case)).collect();
    if sentences.len() < cases.len() {
        return;
    }
    insta::assert_snapshot!(sentences.join("\n"));
    // One of the relative actions is clipped to 99 px in the file.
    for (case, settings, clipped) in [
        ("z06_relative_actions", r#"{"action": "relative"}"#, vec![526]),
        ("z08_unit_coordinates", r#"{"window": [-1, 1]}"#, vec![]),
    ] {
        let read = read(case, settings).unwrap();
        assert_eq!(different(&control.episodes, &read.episodes, 1e-3), clipped, "{case}");
    }
}
