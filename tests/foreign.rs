//! Files with peculiarities of public datasets, converters and writers. Each is read as its author meant it, or refused with one
//! sentence that names the peculiarity and the remedy. The files in the folder `foreign` of the datasets were made after public
//! reports; `make_foreign.py` makes the others.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use crate::support::{Answer, Place, repository, scripted_and_simulators};
use re4_artifact::{Artifact, Row as _, Stage, col_f64, col_text};
use re4_ingest::{DemoRow, FrameRow, SpatialColumns};

/// The expected result of `ingest`.
#[derive(Debug, Clone, Copy)]
enum Expected {
    /// The file is read, and its warnings contain these texts.
    Read(&'static [&'static str]),
    /// The file is refused, and the message contains these texts.
    Refused(&'static [&'static str]),
}

use Expected::{Read, Refused};

/// Case, task, additional arguments, and the expected result.
const CASES: &[(&str, &str, &str, Expected)] = &[
    ("h00_control_can", "can", "", Read(&[])),
    ("h00_control_lift", "lift", "", Read(&[])),
    ("z00_control", "pusht", "", Read(&[])),
    // Cases that once gave wrong results silently.
    (
        "h03_demo1_no_underscore",
        "lift",
        "--set ingest.select.first=3",
        Read(&[]),
    ),
    (
        "h05_lost_demos_masks",
        "lift",
        "--set ingest.select.episodes=[3]",
        Read(&[]),
    ),
    (
        "h05_lost_demos_masks",
        "lift",
        "--set ingest.select.episodes=[2]",
        Refused(&["demo_2", "demo_3"]),
    ),
    ("h24_absolute_in_base_frame", "lift", "", Refused(&["base"])),
    (
        "h24_absolute_in_base_frame",
        "lift",
        "--set ingest.conventions.action_kind=absolute",
        Refused(&["base"]),
    ),
    ("h26_deltas_in_metres", "can", "", Refused(&["action_scale", "0.05"])),
    (
        "h28_gripper_zero_one",
        "lift",
        "",
        Refused(&["gripper_range", "zero_one"]),
    ),
    (
        "h76_live_observations",
        "lift",
        "--set ingest.conventions.allow_actions_beyond_range=true",
        Read(&[]),
    ),
    ("z06_relative_actions", "pusht", "", Refused(&["relative"])),
    ("z08_unit_coordinates", "pusht", "", Refused(&["unit"])),
    // Cases that once were refused without need.
    ("h01_mimicgen_square_d0", "square", "", Read(&[])),
    ("h02a_obs_object_only", "lift", "", Read(&["robot0_eef_pos", "states"])),
    ("h06_lost_demos_stale_total", "lift", "", Read(&["total"])),
    ("h11_env_args_infinity", "lift", "", Read(&[])),
    ("h19_libero_layout", "lift", "", Refused(&["Libero", "robosuite"])),
    (
        "h19_libero_layout",
        "robosuite",
        "--set ingest.object=cube",
        Read(&["robot0_eef_pos", "states"]),
    ),
    (
        "h37_extra_members_of_data",
        "lift",
        "",
        Read(&["/data/language", "/data/stats"]),
    ),
    ("h45_model_windows_path", "lift", "", Read(&[])),
    ("z01_zarr3_format3", "pusht", "", Read(&[])),
    ("z02_zarr3_writes_format2", "pusht", "", Read(&[])),
    ("z10_state_with_velocity", "pusht", "", Read(&[])),
    // Cases that once had unclear messages.
    ("h20_isaaclab_layout", "lift", "", Refused(&["Isaac"])),
    ("h20_isaaclab_layout", "robosuite", "", Refused(&["Isaac"])),
    ("h34_counts_as_arrays", "lift", "", Read(&[])),
    ("h59_writer_killed_latest", "lift", "", Refused(&["h5clear -s"])),
    ("h61_gz", "lift", "", Refused(&["gunzip"])),
    (
        "h64_preallocated_rows_counted",
        "lift",
        "",
        Refused(&["demo_2", "53", "79", "zero"]),
    ),
    (
        "h71_first_demo_without_obs",
        "lift",
        "",
        Read(&["demo_1, demo_2", "demo_0 has no group obs"]),
    ),
    // Cases that always were handled correctly.
    ("h07_attrs_fixed_bytes", "lift", "", Read(&[])),
    ("h14_jammed", "lift", "", Read(&[])),
    (
        "h16_lzf",
        "lift",
        "",
        Refused(&["rewrite it with gzip or without compression"]),
    ),
    ("h21_two_arms", "lift", "", Refused(&["2 robots"])),
    ("h22_joint_actions_8", "lift", "", Refused(&["(N, 7)"])),
    ("h23_joint_deltas_7_declared_osc", "lift", "", Refused(&["action_kind"])),
    (
        "h31_gripper_flipped",
        "lift",
        "",
        Refused(&["gripper_sign = \"positive_opens\""]),
    ),
    (
        "h31_gripper_flipped",
        "lift",
        "--set ingest.conventions.gripper_sign=positive_opens",
        Read(&[]),
    ),
    ("h40_one_state_more", "lift", "", Refused(&["states has 56"])),
    ("h57_action_dict", "lift", "", Read(&[])),
    ("z04_nested_separator", "pusht", "", Read(&[])),
    ("z12_rows_without_end", "pusht", "", Refused(&["episode_ends"])),
    ("z23_pictures_unit_floats", "pusht", "", Refused(&["0..1"])),
    ("z29_zattrs_nan", "pusht", "", Read(&[])),
];

/// The folder of the cases, if it exists; otherwise prints that the test is skipped.
fn foreign() -> Option<PathBuf> {
    let beside = || repository().join("../shared/data");
    let path = std::env::var_os("RE4_DATA")
        .map_or_else(beside, PathBuf::from)
        .join("foreign");
    if !path.is_dir() {
        println!(
            "skipped: no {}; set RE4_DATA to the folder of the datasets",
            path.display()
        );
    }
    path.is_dir().then_some(path)
}

/// The file or store of a case.
fn source(folder: &Path, case: &str) -> PathBuf {
    let mut entries = fs::read_dir(folder.join(case)).unwrap();
    entries.next().unwrap().unwrap().path()
}

fn ingest(place: &Place, task: &str, source: &Path, more: &str) -> Answer {
    let pipeline = format!(
        "task = \"{task}\"\n[ingest]\nsource = \"{}\"\n[segment]\n",
        source.display()
    );
    place.write("foreign.toml", pipeline);
    let _ = fs::remove_dir_all(place.artifacts());
    place.run(&format!("ingest foreign.toml --json --quiet {more}"))
}

/// Describes how the result of a case differs from the expected one; `None` if it does not.
fn odd(answer: Answer, expected: Expected) -> Option<String> {
    let (code, words, message) = match expected {
        Refused(words) => {
            let message = if answer.code == Some(2) {
                answer.refused()
            } else {
                format!("it is read: {}{}", answer.stdout, answer.stderr)
            };
            let code = message.starts_with("error: ");
            (code, words, message)
        }
        Read(words) => {
            let read = answer.code == Some(0);
            let message = if read {
                answer.json()["warnings"].to_string()
            } else {
                answer.stderr
            };
            (read, words, message)
        }
    };
    let missing: Vec<&&str> = words.iter().filter(|word| !message.contains(**word)).collect();
    (!code || !missing.is_empty()).then(|| format!("expected {expected:?}, lacks {missing:?}: {message}"))
}

#[test]
fn cases_have_the_expected_results() {
    let Some(folder) = foreign() else { return };
    let place = Place::empty();
    let mut odds = Vec::new();
    for (case, task, more, expected) in CASES {
        let answer = ingest(&place, task, &source(&folder, case), more);
        odds.extend(odd(answer, *expected).map(|what| format!("{case} {more}\n  {what}")));
        assert!(place.temporaries().is_empty(), "{case}: {:?}", place.temporaries());
    }
    assert!(odds.is_empty(), "{}", odds.join("\n"));
}

fn names(artifact: &Artifact) -> Vec<String> {
    let table = artifact.table(DemoRow::table()).unwrap().read_all().unwrap();
    let names = col_text(&table, "demo").unwrap();
    names.into_iter().map(|name| name.unwrap().to_owned()).collect()
}

/// Goals, deltas and gripper commands of all frames.
fn actions(artifact: &Artifact) -> Vec<Vec<f64>> {
    let table = artifact
        .table(FrameRow::<SpatialColumns>::table())
        .unwrap()
        .read_all()
        .unwrap();
    let columns = [
        "goal_x", "goal_y", "goal_z", "goal_rx", "goal_ry", "goal_rz", "delta_x", "delta_rz", "gripper",
    ];
    columns.map(|column| col_f64(&table, column).unwrap().to_vec()).into()
}

/// Maximum absolute difference.
fn max_difference(ours: &[Vec<f64>], theirs: &[Vec<f64>]) -> f64 {
    assert_eq!(ours.len(), theirs.len());
    let mut maximum = 0.0_f64;
    for (ours, theirs) in ours.iter().zip(theirs) {
        assert_eq!(ours.len(), theirs.len());
        maximum = ours
            .iter()
            .zip(theirs)
            .map(|(a, b)| (a - b).abs())
            .fold(maximum, f64::max);
    }
    maximum
}

#[test]
fn the_selected_demonstrations_are_ingested() {
    let Some(folder) = foreign() else { return };
    let place = Place::empty();
    let names = |case: &str, more: &str| {
        ingest(&place, "lift", &source(&folder, case), more).done();
        names(&place.artifact(Stage::Ingest))
    };
    assert_eq!(
        names("h03_demo1_no_underscore", "--set ingest.select.first=3"),
        ["demo1", "demo2", "demo3"]
    );
    assert_eq!(
        names("h05_lost_demos_masks", "--set ingest.select.episodes=[3]"),
        ["demo_3"]
    );
    assert_eq!(
        names("h05_lost_demos_masks", "--set ingest.select.episodes=[\"demo_6\",0]"),
        ["demo_0", "demo_6"]
    );
}

/// With the setting that the error message names, an unusual file gives the same actions as the usual one.
#[test]
fn the_remedy_in_the_message_works() {
    let Some(folder) = foreign() else { return };
    let place = Place::empty();
    let actions_of = |task: &str, case: &str, more: &str| {
        ingest(&place, task, &source(&folder, case), more).done();
        actions(&place.artifact(Stage::Ingest))
    };
    let metres = actions_of(
        "can",
        "h26_deltas_in_metres",
        "--set ingest.conventions.action_scale=metres",
    );
    assert!(max_difference(&metres, &actions_of("can", "h00_control_can", "")) < 1e-9);
    let gripper = actions_of(
        "lift",
        "h28_gripper_zero_one",
        "--set ingest.conventions.gripper_range=zero_one",
    );
    assert!(max_difference(&gripper, &actions_of("lift", "h00_control_lift", "")) < 1e-9);
}

/// The converted actions of unusual files still succeed in the simulator in which they were recorded.
#[test]
fn replays_of_unusual_files_succeed() {
    let (Some(folder), Some((_, simulators))) = (foreign(), scripted_and_simulators()) else {
        return;
    };
    let place = Place::empty();
    for (case, task, more, demos) in [
        ("h45_model_windows_path", "lift", "", 3),
        (
            "h28_gripper_zero_one",
            "lift",
            "--set ingest.conventions.gripper_range=zero_one",
            4,
        ),
        (
            "h26_deltas_in_metres",
            "can",
            "--set ingest.conventions.action_scale=metres",
            4,
        ),
    ] {
        let source = source(&folder, case);
        let pipeline = format!(
            "task = \"{task}\"\n[ingest]\nsource = \"{}\"\n[segment]\n",
            source.display()
        );
        place.write("foreign.toml", pipeline);
        let output = place
            .command()
            .env("RE4_SIMULATORS", &simulators)
            .args(format!("replay foreign.toml --quiet {more}").split_whitespace())
            .output()
            .unwrap();
        let answer = Answer::new(&output, place.path()).done();
        let all = format!("{demos} of {demos} succeed");
        assert_eq!(answer.stdout.matches(&all).count(), 2, "{case}: {}", answer.stdout);
    }
}

/// A demonstration that cannot be used does not prevent the audit of the others.
#[test]
fn an_audit_leaves_out_and_reports_unusable_demonstrations() {
    let Some(folder) = foreign() else { return };
    let place = Place::empty();
    let case = "h64_preallocated_rows_counted";
    let source = source(&folder, case);
    ingest(&place, "lift", &source, "").refused();
    let answer = place.run("audit foreign.toml --json --quiet").done().json();
    assert_eq!(answer["summary"]["by_code"]["left_out"], 1, "{answer}");
    assert!(answer.to_string().contains("demo_2"), "{answer}");
    assert_eq!(place.run("audit foreign.toml --fail-on error").code, Some(1));
    // The artifact without that demonstration is not used by an ingest of the whole dataset.
    assert!(place.run("ingest foreign.toml").refused().contains("demo_2"));
    let kept = place
        .run("ingest foreign.toml --json --quiet --set ingest.on_bad=leave_out")
        .done()
        .json();
    assert_eq!(kept["summary"]["left_out"], 1, "{kept}");
    assert_eq!(names(&place.artifact(Stage::Ingest)), ["demo_0", "demo_1"]);
}

/// The cases of `make_foreign.py`.
const MADE: &[(&str, Expected)] = &[
    ("control", Read(&[])),
    ("counts_as_arrays", Read(&[])),
    ("deltas_in_metres", Refused(&["action_scale"])),
    ("gripper_zero_one", Refused(&["gripper_range", "zero_one"])),
    ("json_as_python_writes_it", Read(&[])),
    (
        "members_that_are_no_demonstrations",
        Read(&["/data/language", "/data/stats"]),
    ),
    ("names_without_underscore", Read(&[])),
    ("numbers_with_gaps", Read(&[])),
    ("one_bad_demonstration", Refused(&["2 of 4", "demo_1", "demo_3"])),
    ("rows_that_were_never_written", Refused(&["demo_2", "zero"])),
    ("stale_total", Read(&["total"])),
];

#[test]
fn generated_cases_have_the_expected_results() {
    let Some(python) = std::env::var_os("RE4_PYTHON") else {
        println!("skipped: RE4_PYTHON is not set; run scripts/setup-python.sh and set it to target/python/bin/python");
        return;
    };
    let place = Place::empty();
    let folder = place.path().join("data/made");
    fs::create_dir(&folder).unwrap();
    let made = Command::new(python)
        .arg(repository().join("tests/make_foreign.py"))
        .args([&repository().join("data/can-sample.hdf5"), &folder])
        .status()
        .unwrap();
    assert!(made.success());
    assert_eq!(fs::read_dir(&folder).unwrap().count(), MADE.len());
    let mut odds = Vec::new();
    let mut control = Vec::new();
    for (case, expected) in MADE {
        let answer = ingest(&place, "can", &folder.join(format!("{case}.hdf5")), "");
        let read = answer.code == Some(0);
        odds.extend(odd(answer, *expected).map(|what| format!("{case}\n  {what}")));
        if read && matches!(expected, Read(_)) {
            let actions = actions(&place.artifact(Stage::Ingest));
            if *case == "control" {
                control = actions;
            } else {
                assert!(max_difference(&actions, &control) == 0.0, "{case}");
            }
        }
    }
    assert!(odds.is_empty(), "{}", odds.join("\n"));
    ingest(&place, "can", &folder.join("names_without_underscore.hdf5"), "").done();
    assert_eq!(
        names(&place.artifact(Stage::Ingest)),
        ["demo1", "demo2", "demo10", "demo11"]
    );
    ingest(
        &place,
        "can",
        &folder.join("numbers_with_gaps.hdf5"),
        "--set ingest.select.episodes=[4]",
    )
    .done();
    assert_eq!(names(&place.artifact(Stage::Ingest)), ["demo_4"]);
}
