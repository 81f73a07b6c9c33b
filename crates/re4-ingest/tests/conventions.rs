//! Files in other conventions, read with the setting that their refusal suggests, give the columns of the original file.
#![allow(clippy::unwrap_used, clippy::print_stdout, reason = "a test may stop where it fails")]

use std::path::{Path, PathBuf};

use re4_ingest::robomimic::{Access, DemoChoice, Interpreter, Layout, Reading, RobomimicReader, Sources};
use re4_ingest::{IngestError, LeftOut, SpatialColumns, refusal};
use re4_robosuite::conventions::{ActionFrame, ActionScale, GripperRange, InitialGoal, RobosuiteTask, Settings};

/// A file in the folder of the datasets, if it is available.
fn dataset(name: &str) -> Option<PathBuf> {
    let beside = || Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared/data");
    let path = std::env::var_os("RE4_DATA")
        .map_or_else(beside, PathBuf::from)
        .join(name);
    if !path.exists() {
        println!(
            "skipped: no {}; set RE4_DATA to the folder of the datasets",
            path.display()
        );
    }
    path.exists().then_some(path)
}

fn foreign(name: &str) -> Option<PathBuf> {
    dataset(&format!("foreign/{name}/{name}.hdf5"))
}

fn reading(task: &str, conventions: Settings) -> Reading {
    Reading {
        task: RobosuiteTask::named(task),
        object: None,
        env_args: None,
        conventions,
    }
}

fn open(path: &Path) -> Result<RobomimicReader, IngestError> {
    RobomimicReader::open(&Sources::open(path)?, &DemoChoice::default(), Access::Library, None)
}

type Columns = Vec<(String, Vec<SpatialColumns>)>;

/// The interpreter and the columns of all demonstrations, or the message of the refusal.
fn ingest(path: &Path, reading: &Reading) -> Result<(Interpreter, Columns), String> {
    let reader = open(path).map_err(|error| error.to_string())?;
    let (interpreter, left_out) = Interpreter::learn(&reader, reading).map_err(|error| error.to_string())?;
    if !left_out.is_empty() {
        return Err(refusal(&left_out, reader.demos().len()));
    }
    let mut all = Vec::new();
    reader
        .for_each(
            0..reader.demos().len(),
            |_, demo: Result<_, LeftOut>| {
                let mut demo = demo.unwrap();
                let columns = interpreter.interpret(&reader, &mut demo, None)?;
                Ok::<_, IngestError>((demo.name, columns.frames))
            },
            |_, row| {
                all.push(row);
                Ok(())
            },
        )
        .map_err(|error| error.to_string())?;
    Ok((interpreter, all))
}

/// Maximum differences of deltas, goals and gripper commands.
fn differences(a: &Columns, b: &Columns) -> [f64; 3] {
    assert_eq!(a.len(), b.len());
    let mut largest = [0.0_f64; 3];
    for ((_, a), (_, b)) in a.iter().zip(b) {
        assert!(!a.is_empty() && !b.is_empty());
        for (a, b) in a.iter().zip(b) {
            for axis in 0..6 {
                largest[0] = largest[0].max((a.delta.0[axis] - b.delta.0[axis]).abs());
                largest[1] = largest[1].max((a.goal.0[axis] - b.goal.0[axis]).abs());
            }
            largest[2] = largest[2].max((a.gripper - b.gripper).abs());
        }
    }
    largest
}

fn basis(interpreter: &Interpreter, name: &str) -> (String, String) {
    let row = interpreter
        .conventions()
        .iter()
        .find(|row| row.convention == *name)
        .unwrap();
    (row.value.to_string(), row.basis.to_string())
}

#[test]
fn deltas_in_metres_are_converted_by_the_setting() {
    let (Some(metres), Some(control)) = (foreign("h26_deltas_in_metres"), foreign("h00_control_can")) else {
        return;
    };
    let refused = ingest(&metres, &reading("can", Settings::default())).err().unwrap();
    println!("{refused}");
    assert!(refused.contains("set action_scale = \"metres\""), "{refused}");
    let settings = Settings {
        action_scale: Some(ActionScale::Metres),
        ..Settings::default()
    };
    let (interpreter, columns) = ingest(&metres, &reading("can", settings)).unwrap();
    assert_eq!(
        basis(&interpreter, "action_scale"),
        ("metres".to_owned(), "proven".to_owned())
    );
    let (interpreter, expected) = ingest(&control, &reading("can", Settings::default())).unwrap();
    assert_eq!(
        basis(&interpreter, "action_scale"),
        ("controller".to_owned(), "proven".to_owned())
    );
    let largest = differences(&columns, &expected);
    assert!(largest.iter().all(|difference| *difference < 1e-9), "{largest:?}");
    let refused = ingest(&control, &reading("can", settings)).err().unwrap();
    println!("{refused}");
    assert!(refused.contains("action_scale = \"controller\" fits"), "{refused}");
}

#[test]
fn gripper_commands_from_0_to_1_are_converted_by_the_setting() {
    let (Some(zero_one), Some(control)) = (foreign("h28_gripper_zero_one"), foreign("h00_control_lift")) else {
        return;
    };
    let refused = ingest(&zero_one, &reading("lift", Settings::default())).err().unwrap();
    println!("{refused}");
    assert!(refused.contains("set gripper_range = \"zero_one\""), "{refused}");
    let settings = Settings {
        gripper_range: Some(GripperRange::ZeroOne),
        ..Settings::default()
    };
    let (interpreter, columns) = ingest(&zero_one, &reading("lift", settings)).unwrap();
    assert_eq!(
        basis(&interpreter, "gripper_range"),
        ("zero_one".to_owned(), "proven".to_owned())
    );
    let (_, expected) = ingest(&control, &reading("lift", Settings::default())).unwrap();
    assert_eq!(differences(&columns, &expected), [0.0; 3]);
}

#[test]
fn goals_in_the_base_frame_are_converted_by_the_setting() {
    let (Some(in_base), Some(control)) = (foreign("h24_absolute_in_base_frame"), foreign("h00_control_lift")) else {
        return;
    };
    let settings = Settings {
        action_frame: Some(ActionFrame::Base),
        ..Settings::default()
    };
    let (interpreter, columns) = ingest(&in_base, &reading("lift", settings)).unwrap();
    assert_eq!(
        basis(&interpreter, "action_frame"),
        ("base".to_owned(), "proven".to_owned())
    );
    let (_, expected) = ingest(&control, &reading("lift", Settings::default())).unwrap();
    let [deltas, goals, gripper] = differences(&columns, &expected);
    println!("{deltas:.2e} {goals:.2e}");
    assert!(goals < 1e-6 && gripper == 0.0, "{goals:.2e}");
}

/// Reading from observations gives the same goals as reading from the states they were computed from.
#[test]
fn the_raw_and_the_observed_layout_give_the_same_goals() {
    let (Some(live), Some(raw)) = (
        foreign("h76_live_observations"),
        dataset("robosuite/robosuite-1.4.1-demos/lift/demo.hdf5"),
    ) else {
        return;
    };
    let settings = Settings {
        allow_actions_beyond_range: true,
        ..Settings::default()
    };
    let (of_live, observed) = ingest(&live, &reading("lift", settings)).unwrap();
    let (of_raw, states) = ingest(&raw, &reading("lift", settings)).unwrap();
    for interpreter in [&of_live, &of_raw] {
        assert_eq!(
            basis(interpreter, "initial_goal"),
            ("reset_pose".to_owned(), "proven".to_owned())
        );
    }
    let largest = differences(&observed, &states);
    println!("{largest:?}");
    assert!(largest.iter().all(|difference| *difference < 1e-6), "{largest:?}");
    let first = Settings {
        initial_goal: Some(InitialGoal::FirstPose),
        ..settings
    };
    let refused = ingest(&raw, &reading("lift", first)).err().unwrap();
    assert!(
        refused.contains("initial_goal = \"first_pose\" is contradicted"),
        "{refused}"
    );
}

#[test]
fn unrecorded_rows_are_reported_or_left_out() {
    let Some(cut_off) = foreign("h64_preallocated_rows_counted") else {
        return;
    };
    let refused = ingest(&cut_off, &reading("lift", Settings::default())).err().unwrap();
    println!("{refused}");
    assert!(
        refused.contains("demo_2: rows 53 to 79 contain only zeros"),
        "{refused}"
    );
    let reader = open(&cut_off).unwrap();
    let reading = reading("lift", Settings::default());
    let (_, left_out) = Interpreter::learn(&reader, &reading).unwrap();
    let names: Vec<&str> = left_out.iter().map(|left| left.demo.as_str()).collect();
    assert_eq!(names, ["demo_2"]);
    assert!(left_out[0].why.contains("rows 53 to 79"), "{}", left_out[0].why);
}

#[test]
fn environment_names_are_matched_to_tasks() {
    let (Some(square), Some(isaac), Some(infinity)) = (
        foreign("h01_mimicgen_square_d0"),
        foreign("h20_isaaclab_layout"),
        foreign("h11_env_args_infinity"),
    ) else {
        return;
    };
    let (interpreter, columns) = ingest(&square, &reading("square", Settings::default())).unwrap();
    assert!(!columns.is_empty());
    assert_eq!(interpreter.env().env_name, "Square_D0");
    // The file's poses in datagen_info are made up; they are not used.
    let warnings = interpreter.warnings();
    assert_eq!(warnings.len(), 3, "{warnings:?}");
    assert!(
        warnings.iter().all(|warning| warning.contains("datagen_info/")),
        "{warnings:?}"
    );
    let refused = ingest(&square, &reading("can", Settings::default())).err().unwrap();
    assert!(refused.contains("the pipeline's task needs PickPlaceCan"), "{refused}");
    for task in ["lift", "robosuite"] {
        let refused = ingest(&isaac, &reading(task, Settings::default())).err().unwrap();
        println!("{refused}");
        assert!(
            refused.contains("it is not a robosuite dataset") && refused.contains("Isaac Lab"),
            "{refused}"
        );
    }
    ingest(&infinity, &reading("lift", Settings::default())).unwrap();
    let reader = open(&square).unwrap();
    assert_eq!(reader.layout(), Layout::Observed);
}
