//! Files of `MimicGen`, LIBERO, robosuite 1.5 and `RoboCasa`. `make_relatives.py` makes them from scripted demonstrations of Square and from the
//! sample of Can, so the tables must have the numbers of these demonstrations.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use crate::support::{Answer, Place, repository, results, scripted, scripted_and_simulators, steps};
use arrow_array::{Array as _, Float64Array, RecordBatch};
use nalgebra::{UnitQuaternion, Vector3};
use re4_artifact::{Artifact, Row as _, Stage, col_text, col_u32};
use re4_ingest::{Convention, FrameRow, ImageRow, SpatialColumns};

/// Number of demonstrations in the files.
const DEMOS: usize = 8;

/// A folder with files that the script makes; `None` if Python is missing.
struct Files {
    place: Place,
    python: PathBuf,
}

impl Files {
    fn new() -> Option<Self> {
        let python = std::env::var_os("RE4_PYTHON").map(PathBuf::from);
        if python.is_none() {
            println!(
                "skipped: RE4_PYTHON is not set; run scripts/setup-python.sh and set it to target/python/bin/python"
            );
        }
        Some(Self {
            place: Place::empty(),
            python: python?,
        })
    }

    /// Makes a file and returns its path.
    fn make(&self, kind: &str, source: &Path, more: &str) -> PathBuf {
        let target = self.place.path().join("data/relative.hdf5");
        let output = Command::new(&self.python)
            .arg(repository().join("tests/make_relatives.py"))
            .arg(kind)
            .arg(source)
            .arg(&target)
            .args(["--demos", &DEMOS.to_string()])
            .args(more.split('|').filter(|argument| !argument.is_empty()))
            .output()
            .unwrap();
        let errors = String::from_utf8_lossy(&output.stderr);
        assert!(output.status.success(), "{kind} {more}: {errors}");
        target
    }

    /// Runs a stage on a file, with no other artifacts.
    fn run(&self, stage: &str, task: &str, source: &Path, more: &str) -> Answer {
        let _ = fs::remove_dir_all(self.place.artifacts());
        let text = format!(
            "task = \"{task}\"\n[ingest]\nsource = \"{}\"\n[segment]\n[index]\n[pose]\nsource = \"recorded\"\n",
            source.display()
        );
        self.place.write("relative.toml", text);
        self.place.run(&format!("{stage} relative.toml --json --quiet {more}"))
    }

    fn read(&self, task: &str, source: &Path, more: &str) -> Read {
        let answer = self.run("ingest", task, source, more).done();
        let artifact = self.place.artifact(Stage::Ingest);
        Read {
            frames: frames(&artifact),
            conventions: conventions(&artifact),
            warnings: answer.json()["warnings"].to_string(),
            images: images(&artifact),
        }
    }

    /// Segments, audits and indexes a file.
    fn all_stages(&self, task: &str, source: &Path, more: &str) {
        for stage in ["segment", "audit", "index"] {
            self.run(stage, task, source, more).done();
        }
    }
}

/// What is compared of an artifact.
struct Read {
    frames: Frames,
    conventions: BTreeMap<String, (String, String)>,
    warnings: String,
    /// Episode, frame and first byte of the first row of the images of each camera.
    images: Vec<(String, u32, u32, u8)>,
}

impl Read {
    /// Value and basis of a convention.
    #[track_caller]
    fn convention(&self, name: &str) -> (&str, &str) {
        let (value, basis) = &self.conventions[name];
        (value, basis)
    }
}

/// Numbers of the table `frames` by column, and the episode of each row.
struct Frames {
    episode: Vec<u32>,
    columns: BTreeMap<String, Vec<Option<f64>>>,
}

impl Frames {
    /// Rows of a column in which an episode has its frames `skip` to the last but `cut`.
    fn cut(&self, skip: usize, cut: usize) -> Self {
        let mut kept = Vec::new();
        let mut start = 0;
        for rows in self.episode.chunk_by(|a, b| a == b) {
            kept.extend(start + skip..start + rows.len() - cut);
            start += rows.len();
        }
        Self {
            episode: kept.iter().map(|row| self.episode[*row]).collect(),
            columns: self
                .columns
                .iter()
                .map(|(name, values)| (name.clone(), kept.iter().map(|row| values[*row]).collect()))
                .collect(),
        }
    }

    fn vector(&self, names: [&str; 3], row: usize) -> Vector3<f64> {
        Vector3::from(names.map(|name| self.columns[name][row].unwrap()))
    }

    fn rotation(&self, prefix: &str, row: usize) -> UnitQuaternion<f64> {
        let part = |name: &str| self.columns[&format!("{prefix}_{name}")][row].unwrap();
        UnitQuaternion::new_normalize(nalgebra::Quaternion::new(
            part("qw"),
            part("qx"),
            part("qy"),
            part("qz"),
        ))
    }
}

fn table(artifact: &Artifact) -> RecordBatch {
    artifact
        .table(FrameRow::<SpatialColumns>::table())
        .unwrap()
        .read_all()
        .unwrap()
}

fn frames(artifact: &Artifact) -> Frames {
    let table = table(artifact);
    let mut columns = BTreeMap::new();
    for field in table.schema().fields() {
        let column = table.column_by_name(field.name()).unwrap();
        if let Some(numbers) = column.as_any().downcast_ref::<Float64Array>() {
            columns.insert(field.name().clone(), numbers.iter().collect());
        }
    }
    assert!(columns.len() > 25, "{:?}", columns.keys());
    Frames {
        episode: col_u32(&table, "episode").unwrap().to_vec(),
        columns,
    }
}

fn conventions(artifact: &Artifact) -> BTreeMap<String, (String, String)> {
    let table = artifact.table(Convention::table()).unwrap().read_all().unwrap();
    let texts = |name: &str| {
        let texts = col_text(&table, name).unwrap();
        texts
            .into_iter()
            .map(|text| text.unwrap().to_owned())
            .collect::<Vec<_>>()
    };
    let pairs = texts("value").into_iter().zip(texts("basis"));
    texts("convention").into_iter().zip(pairs).collect()
}

fn images(artifact: &Artifact) -> Vec<(String, u32, u32, u8)> {
    let Ok(table) = artifact.table(ImageRow::table()) else {
        return Vec::new();
    };
    let table = table.read_all().unwrap();
    let bytes = table.column_by_name("image").unwrap();
    let bytes = bytes.as_any().downcast_ref::<arrow_array::BinaryArray>().unwrap();
    let cameras = col_text(&table, "camera").unwrap();
    let places = col_u32(&table, "episode")
        .unwrap()
        .iter()
        .zip(col_u32(&table, "frame").unwrap());
    let rows = cameras.into_iter().zip(places).zip(bytes.iter());
    rows.map(|((camera, (episode, frame)), bytes)| {
        let image = image::load_from_memory(bytes.unwrap()).unwrap().to_rgb8();
        (camera.unwrap().to_owned(), *episode, *frame, image.as_raw()[0])
    })
    .collect()
}

/// Maximum difference of all columns except these; columns of nulls must be null in both.
#[track_caller]
fn difference(ours: &Frames, theirs: &Frames, except: &[&str]) -> f64 {
    assert_eq!(ours.episode, theirs.episode);
    let mut maximum = 0.0_f64;
    for (name, values) in &ours.columns {
        if except.iter().any(|start| name.starts_with(start)) {
            continue;
        }
        for (ours, theirs) in values.iter().zip(&theirs.columns[name]) {
            match (ours, theirs) {
                (Some(ours), Some(theirs)) => maximum = maximum.max((ours - theirs).abs()),
                (ours, theirs) => assert_eq!(ours, theirs, "{name}"),
            }
        }
    }
    maximum
}

/// The file with the first scripted demonstrations of Square, if it exists.
fn square() -> Option<PathBuf> {
    Some(scripted()?.join("square/low_dim.hdf5"))
}

fn first() -> String {
    format!("--set ingest.select.first={DEMOS}")
}

#[test]
fn mimicgen_has_the_numbers_of_its_source() {
    let (Some(files), Some(square)) = (Files::new(), square()) else {
        return;
    };
    let original = files.read("square", &square, &first());
    for environment in ["Square_D0", "Square_D1", "NutAssemblySquare_D2"] {
        let made = files.make("mimicgen", &square, &format!("--set|env={environment}"));
        let read = files.read("square", &made, "");
        assert_eq!(difference(&read.frames, &original.frames, &["reward"]).to_bits(), 0);
        assert_eq!(read.convention("datagen_eef_pose"), ("grip_site", "proven"));
        assert_eq!(read.convention("datagen_object"), ("square_nut", "proven"));
        assert_eq!(
            read.convention("datagen_target_pose"),
            ("goals of the actions", "proven")
        );
        assert!(!read.warnings.contains("does not follow") && !read.warnings.contains("do not follow"));
    }
    files.all_stages("square", &files.make("mimicgen", &square, ""), "");
}

/// The object is named by the task, by a setting, or by the body that has its poses.
#[test]
fn mimicgen_names_the_object() {
    let (Some(files), Some(square)) = (Files::new(), square()) else {
        return;
    };
    let original = files.read("square", &square, &first());
    let same = |made: &Path, more: &str| {
        let read = files.read("robosuite", made, more);
        assert_eq!(read.convention("object").0, "SquareNut_main", "{more}");
        let difference = difference(&read.frames, &original.frames, &["reward"]);
        assert!(difference < 1e-12, "{more}: {difference}");
    };
    let made = files.make("mimicgen", &square, "");
    same(&made, "");
    same(&made, "--set ingest.object=square_nut");
    let threading = files.make(
        "mimicgen",
        &square,
        "--set|env=Threading_D1|--set|name=needle|--set|target=tripod|--set|other=needles",
    );
    same(&threading, "");
    files.all_stages("robosuite", &threading, "");
    let object = files.read("robosuite", &threading, "--set ingest.object=RoundNut");
    assert_eq!(object.convention("object").0, "RoundNut");
}

/// Settings for a file without states, from which the frame of `robot0_eef_quat` is not known.
const FRAMES: &str = "--set ingest.conventions.eef_quaternion=xyzw --set ingest.conventions.eef_orientation=hand_body";

/// Without states, the pose of the object is that in `datagen_info`, and `eef_pose` proves the settings.
#[test]
fn mimicgen_without_states() {
    let Some(files) = Files::new() else { return };
    let sample = repository().join("data/can-sample.hdf5");
    let made = files.make(
        "mimicgen",
        &sample,
        "--set|env=Stack_D0|--set|name=cubeA|--set|target=cubeB",
    );
    let sentence = files.run("ingest", "robosuite", &made, "").refused();
    assert!(sentence.contains("eef_quaternion = \"xyzw\""), "{sentence}");
    let wrong = FRAMES.replace("hand_body", "grip_site");
    let sentence = files.run("ingest", "robosuite", &made, &wrong).refused();
    assert!(sentence.contains("datagen_info/eef_pose is neither"), "{sentence}");
    let read = files.read("robosuite", &made, FRAMES);
    let can = files.read("can", &sample, &first());
    assert_eq!(read.convention("poses").0, "datagen_info");
    assert_eq!(read.convention("object").0, "cubeA");
    assert_eq!(read.convention("datagen_eef_pose"), ("grip_site", "proven"));
    // Matrices have no sign of a quaternion.
    let others = ["reward", "done", "object_q"];
    assert!(difference(&read.frames, &can.frames, &others) < 1e-12);
    for row in (0..can.frames.episode.len()).step_by(7) {
        let [ours, theirs] = [&read, &can].map(|read| read.frames.rotation("object", row));
        assert!(ours.angle_to(&theirs) < 1e-7, "{row}");
    }
    let several = "--set|env=StackThree_D1|--set|name=cubeA|--set|target=cubeC";
    let made = files.make("mimicgen", &sample, several);
    files.all_stages("robosuite", &made, &format!("--set ingest.object=cubeA {FRAMES}"));
}

#[test]
fn several_objects_are_refused_by_name() {
    let (Some(files), Some(square)) = (Files::new(), square()) else {
        return;
    };
    for (environment, words) in [
        ("StackThree_D0", "cubeA, cubeC"),
        ("NutAssembly_D0", "square_nut, round_nut"),
        ("ThreePieceAssembly_D2", "piece_1, piece_2"),
        ("PickPlace_D0", "milk, cereal, bread, can"),
        ("Kitchen_D1", "pot, bread"),
        ("CoffeePreparation_D0", "mug, coffee_pod"),
    ] {
        let made = files.make("mimicgen", &square, &format!("--set|env={environment}"));
        let sentence = files.run("ingest", "robosuite", &made, "").refused();
        assert!(
            sentence.contains(words) && sentence.contains("ingest.object"),
            "{sentence}"
        );
        let read = files.read("robosuite", &made, "--set ingest.object=SquareNut");
        assert!(read.warnings.contains("several objects"), "{}", read.warnings);
    }
    let made = files.make("mimicgen", &square, "--set|env=Square_O1");
    let sentence = files.run("ingest", "square", &made, "").refused();
    assert!(
        sentence.contains("Square_O1") && sentence.contains("robosuite"),
        "{sentence}"
    );
    files.run("ingest", "robosuite", &made, "").done();
}

#[test]
fn a_target_that_moves_is_a_warning() {
    let (Some(files), Some(square)) = (Files::new(), square()) else {
        return;
    };
    let made = files.make("mimicgen", &square, "--set|env=Square_D1|--set|spread=0.02");
    let read = files.read("square", &made, "");
    assert!(
        read.warnings.contains("square_peg") && read.warnings.contains("0.198 m"),
        "{}",
        read.warnings
    );
    assert!(read.warnings.contains("distribution 1"), "{}", read.warnings);
}

#[test]
fn libero_has_the_numbers_of_its_source() {
    let (Some(files), Some(square)) = (Files::new(), square()) else {
        return;
    };
    let original = files.read("square", &square, &first()).frames.cut(5, 1);
    let made = files.make("libero", &square, "");
    let read = files.read("robosuite", &made, "");
    assert_eq!(read.convention("object").0, "black_bowl_1");
    assert_eq!(read.convention("observation_time"), ("after_action", "proven"));
    assert_eq!(read.convention("initial_goal").0, "first_pose");
    // Goals before the first rotation command depend on what the controller held in the missing frames. Poses from states differ
    // from observations by the rounding of the model's text.
    let others = ["reward", "goal", "eef_q", "object_q", "raw_eef"];
    let apart = difference(&read.frames, &original, &others);
    assert!(apart < 2e-6, "{apart}");
    let goals = ["goal_x", "goal_y", "goal_z"];
    let rotations = ["goal_rx", "goal_ry", "goal_rz"];
    for row in 0..original.episode.len() {
        for pose in ["eef", "object"] {
            let angle = read.frames.rotation(pose, row).angle_to(&original.rotation(pose, row));
            assert!(angle < 1e-5, "{pose} {row}: {angle}");
        }
        let apart = (read.frames.vector(goals, row) - original.vector(goals, row)).norm();
        assert!(apart < 1e-5, "{row}: {apart}");
        if original.vector(["delta_rx", "delta_ry", "delta_rz"], row).norm() > 0.0 {
            let [ours, theirs] =
                [&read.frames, &original].map(|frames| UnitQuaternion::from_scaled_axis(frames.vector(rotations, row)));
            assert!(ours.angle_to(&theirs) < 1e-5, "{row}");
        }
    }
    files.all_stages("robosuite", &made, "");
}

#[test]
fn libero_observations_that_are_not_late_are_recognised() {
    let (Some(files), Some(square)) = (Files::new(), square()) else {
        return;
    };
    let made = files.make("libero", &square, "--set|current=1|--set|images=1");
    let read = files.read("robosuite", &made, "");
    assert_eq!(read.convention("observation_time"), ("before_action", "proven"));
    assert_eq!(read.images.len(), 2 * read.frames.episode.len());
}

/// The image of a frame is the one that shows its state.
#[test]
fn libero_images_are_upright_and_belong_to_their_frames() {
    let (Some(files), Some(square)) = (Files::new(), square()) else {
        return;
    };
    for convention in ["opengl", "opencv"] {
        let made = files.make(
            "libero",
            &square,
            &format!("--set|images=1|--set|convention={convention}"),
        );
        let all = files.read("robosuite", &made, "--set ingest.images=false");
        assert!(all.images.is_empty());
        let read = files.read("robosuite", &made, "");
        assert_eq!(difference(&read.frames, &all.frames.cut(1, 0), &[]).to_bits(), 0);
        assert_eq!(read.images.len(), 2 * read.frames.episode.len());
        for (camera, episode, frame, shown) in &read.images {
            assert!(["agentview", "robot0_eye_in_hand"].contains(&camera.as_str()));
            // The number of the state in the file; the frame before it is the one that was left out.
            assert_eq!(u32::from(*shown), (frame + 1) % 251, "{camera} {episode} {frame}");
        }
    }
}

#[test]
fn libero_tasks_of_another_kind_are_refused_by_their_goals() {
    let (Some(files), Some(square)) = (Files::new(), square()) else {
        return;
    };
    for (goal, words) in [
        (
            "(And (On {moved} {place}) (On plate_2 {place}))",
            "several goals: (On black_bowl_1 plate_1) and (On plate_2 plate_1)",
        ),
        ("(And (In {moved} drawer_1) (Close drawer_1))", "(Close drawer_1)"),
        ("(Open drawer_1)", "does not place an object: (Open drawer_1)"),
        ("(And (Turnon stove_1))", "(Turnon stove_1)"),
    ] {
        let made = files.make("libero", &square, &format!("--set|goal={goal}"));
        let sentence = files.run("ingest", "robosuite", &made, "").refused();
        assert!(
            sentence.contains(words) && sentence.contains("ingest.object"),
            "{sentence}"
        );
        let read = files.read("robosuite", &made, "--set ingest.object=black_bowl_1");
        assert!(
            read.warnings.contains("only black_bowl_1 is followed"),
            "{}",
            read.warnings
        );
    }
    let made = files.make("libero", &square, "--set|goal=(And (In {place} {moved}))");
    let sentence = files.run("ingest", "robosuite", &made, "").refused();
    assert!(sentence.contains("ingest.object"), "{sentence}");
    let other = files.make("libero", &square, "--mutate|bddl_cut");
    assert!(
        files
            .run("ingest", "robosuite", &other, "")
            .refused()
            .contains("bddl_file_content")
    );
}

/// Deltas in the frame of a rotated base give the poses, deltas and goals of the source in a world that is rotated.
#[test]
fn deltas_in_the_frame_of_a_rotated_base() {
    let (Some(files), Some(square)) = (Files::new(), square()) else {
        return;
    };
    let original = files.read("square", &square, &first());
    for angle in [1.1, -2.5, 3.1] {
        let made = files.make("composite", &square, &format!("--set|yaw={angle}"));
        let read = files.read("square", &made, "");
        assert_eq!(read.convention("action_frame"), ("base", "proven"), "{angle}");
        rotated(&read.frames, &original.frames, |_| angle);
        // The same world with deltas in its axes.
        let made = files.make(
            "composite",
            &square,
            &format!("--set|yaw={angle}|--set|actions=world|--set|frame=world"),
        );
        let read = files.read(
            "square",
            &made,
            "--set ingest.conventions.allow_actions_beyond_range=true",
        );
        assert!(!read.conventions.contains_key("action_frame"));
        // A declaration that the motion contradicts.
        let made = files.make("composite", &square, &format!("--set|yaw={angle}|--set|actions=world"));
        let sentence = files.run("ingest", "square", &made, "").refused();
        assert!(sentence.contains("action_frame = \"world\""), "{sentence}");
        files.read(
            "square",
            &made,
            "--set ingest.conventions.action_frame=world --set ingest.conventions.allow_actions_beyond_range=true",
        );
    }
    let plain = files.make("composite", &square, "--set|yaw=0");
    let read = files.read("square", &plain, "");
    assert!(!read.conventions.contains_key("action_frame"));
    assert!(difference(&read.frames, &original.frames, &[]) < 1e-15);
    let slight = files.make("composite", &square, "--set|yaw=0.05");
    assert_eq!(
        files.read("square", &slight, "").convention("action_frame"),
        ("base", "declared")
    );
    files.all_stages("square", &files.make("composite", &square, ""), "");
}

/// Compares frames with those of the source in a world that is rotated by an angle that depends on the episode.
fn rotated(ours: &Frames, theirs: &Frames, angle: impl Fn(u32) -> f64) {
    assert_eq!(ours.episode, theirs.episode);
    for row in 0..ours.episode.len() {
        let rotation = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), angle(ours.episode[row]));
        for names in [
            ["eef_x", "eef_y", "eef_z"],
            ["object_x", "object_y", "object_z"],
            ["delta_x", "delta_y", "delta_z"],
            ["delta_rx", "delta_ry", "delta_rz"],
            ["goal_x", "goal_y", "goal_z"],
        ] {
            let apart = (ours.vector(names, row) - rotation * theirs.vector(names, row)).norm();
            assert!(apart < 2e-6, "{names:?} in row {row}: {apart}");
        }
        let goal =
            |frames: &Frames| UnitQuaternion::from_scaled_axis(frames.vector(["goal_rx", "goal_ry", "goal_rz"], row));
        let pairs = [
            (ours.rotation("eef", row), rotation * theirs.rotation("eef", row)),
            (ours.rotation("object", row), rotation * theirs.rotation("object", row)),
            (goal(ours), rotation * goal(theirs)),
        ];
        for (which, (ours, theirs)) in pairs.iter().enumerate() {
            assert!(
                ours.angle_to(theirs) < 1e-5,
                "{which} in row {row}: {}",
                ours.angle_to(theirs)
            );
        }
        assert_eq!(ours.columns["gripper"][row], theirs.columns["gripper"][row]);
    }
}

#[test]
fn robocasa_has_the_numbers_of_its_source() {
    let (Some(files), Some(square)) = (Files::new(), square()) else {
        return;
    };
    let original = files.read("square", &square, &first());
    let made = files.make("robocasa", &square, "");
    let read = files.read("robosuite", &made, "");
    assert_eq!(read.convention("object").0, "obj");
    assert_eq!(read.convention("action_frame"), ("base", "proven"));
    assert_eq!(read.convention("initial_goal").0, "first_pose");
    let first_goals = original.frames.cut(1, 0);
    let ours = read.frames.cut(1, 0);
    for row in 0..ours.episode.len() {
        let rotation = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), 1.1 + 0.9 * f64::from(ours.episode[row]));
        for names in [
            ["eef_x", "eef_y", "eef_z"],
            ["object_x", "object_y", "object_z"],
            ["delta_x", "delta_y", "delta_z"],
            ["goal_x", "goal_y", "goal_z"],
        ] {
            let apart = (ours.vector(names, row) - rotation * first_goals.vector(names, row)).norm();
            assert!(apart < 2e-6, "{names:?} in row {row}: {apart}");
        }
    }
    files.read("robosuite", &made, "--set ingest.filter=train");
    files.all_stages("robosuite", &made, "");
    // A base that moves is no manipulation.
    let made = files.make("robocasa", &square, "--set|driving=1");
    let sentence = files.run("ingest", "robosuite", &made, "").refused();
    assert!(
        sentence.contains("demo_1") && sentence.contains("rows 3 to 8"),
        "{sentence}"
    );
    let kept = files
        .run("ingest", "robosuite", &made, "--set ingest.on_bad=leave_out")
        .done()
        .json();
    assert_eq!(kept["summary"]["left_out"], 1, "{kept}");
}

#[test]
fn two_arms_are_refused_by_name() {
    let (Some(files), Some(square)) = (Files::new(), square()) else {
        return;
    };
    for environment in ["TwoArmCoffee", "TwoArmThreading", "DualCleanup"] {
        let made = files.make("twoarms", &square, &format!("--set|env={environment}"));
        for task in ["square", "robosuite"] {
            let sentence = files.run("ingest", task, &made, "").refused();
            assert!(
                sentence.contains(environment) && sentence.contains("two arms"),
                "{sentence}"
            );
        }
    }
}

/// Kind, mutation, task, and words of the refusal. Every sentence names the place.
const MUTATIONS: [(&str, &str, &str, &[&str]); 20] = [
    (
        "mimicgen",
        "object_nan",
        "square",
        &["data/demo_1/datagen_info/object_poses/square_nut", "NaN in row 7"],
    ),
    (
        "mimicgen",
        "object_sheared",
        "square",
        &[
            "data/demo_1/datagen_info/object_poses/square_nut",
            "row 7",
            "orthonormal",
        ],
    ),
    (
        "mimicgen",
        "object_short",
        "square",
        &["data/demo_1/datagen_info/object_poses/square_nut", "rows"],
    ),
    (
        "mimicgen",
        "object_flat",
        "square",
        &["data/demo_1/datagen_info/object_poses/square_nut", "(N, 4, 4)"],
    ),
    (
        "mimicgen",
        "object_text",
        "square",
        &["data/demo_1/datagen_info/object_poses/square_nut", "text"],
    ),
    (
        "mimicgen",
        "object_missing",
        "square",
        &["demo_1", "datagen_info/object_poses/square_nut is missing"],
    ),
    (
        "mimicgen",
        "object_moved",
        "square",
        &["demo_1", "datagen_info/object_poses/square_nut differs in row"],
    ),
    ("mimicgen", "eef_transposed", "square", &["datagen_info/eef_pose"]),
    (
        "mimicgen",
        "target_shifted",
        "square",
        &["demo_1", "datagen_info/target_pose differs in row"],
    ),
    (
        "mimicgen",
        "gripper_flipped",
        "square",
        &["demo_1", "datagen_info/gripper_action differs in row 0"],
    ),
    ("mimicgen", "group_is_dataset", "square", &["demo_1/datagen_info"]),
    ("mimicgen", "actions_13", "square", &["actions", "(N, 7)"]),
    (
        "mimicgen",
        "object_nan",
        "robosuite",
        &["data/demo_1/datagen_info/object_poses/square_nut", "NaN in row 7"],
    ),
    (
        "libero",
        "late_nan",
        "robosuite",
        &["data/demo_1/obs/ee_pos", "inf in row 4"],
    ),
    ("libero", "late_short", "robosuite", &["data/demo_1/obs/ee_pos", "rows"]),
    (
        "libero",
        "late_elsewhere",
        "robosuite",
        &["demo_1", "obs/ee_pos is 0.6"],
    ),
    (
        "libero",
        "late_early",
        "robosuite",
        &["demo_1", "obs/ee_pos belongs to the state before"],
    ),
    ("libero", "states_short", "robosuite", &["demo_1", "state"]),
    ("composite", "no_states", "square", &["demo_1", "states"]),
    ("robocasa", "actions_13", "robosuite", &["actions", "(N, 7)"]),
];

#[test]
fn damaged_files_are_refused_by_name() {
    let (Some(files), Some(square)) = (Files::new(), square()) else {
        return;
    };
    let mut odds = Vec::new();
    for (kind, mutation, task, words) in MUTATIONS {
        let made = files.make(kind, &square, &format!("--mutate|{mutation}"));
        let answer = files.run("ingest", task, &made, "");
        if answer.code != Some(2) {
            odds.push(format!(
                "{kind} {mutation}: is read: {}{}",
                answer.stdout, answer.stderr
            ));
            continue;
        }
        let sentence = answer.refused();
        if words.iter().any(|word| !sentence.contains(word)) || !sentence.contains("; ") {
            odds.push(format!("{kind} {mutation}: expected {words:?}: {sentence}"));
        }
    }
    // Poses that no column depends on are not used if they contradict the others.
    let made = files.make("mimicgen", &square, "--mutate|eef_elsewhere");
    let read = files.read("square", &made, "");
    assert!(
        read.warnings.contains("datagen_info/eef_pose is neither"),
        "{}",
        read.warnings
    );
    assert!(!read.conventions.contains_key("datagen_eef_pose"));
    // They are needed if the pose of the object is only there.
    let made = files.make(
        "mimicgen",
        &square,
        "--set|env=Stack_D0|--set|name=cubeA|--set|stateless=1|--mutate|eef_elsewhere",
    );
    let sentence = files.run("ingest", "robosuite", &made, FRAMES).refused();
    assert!(sentence.contains("datagen_info/eef_pose is neither"), "{sentence}");
    // Names of objects that are swapped: the tables do not depend on them, and the row names the one that has the object's poses.
    let made = files.make("mimicgen", &square, "--mutate|object_names_swapped");
    assert_eq!(
        files.read("square", &made, "").convention("datagen_object").0,
        "square_peg"
    );
    assert!(odds.is_empty(), "{}", odds.join("\n"));
}

/// Rollouts from `MimicGen`'s file are those from its source.
#[test]
fn rollouts_from_mimicgen_are_those_from_its_source() {
    let (Some(files), Some((scripted, simulators))) = (Files::new(), scripted_and_simulators()) else {
        return;
    };
    let square = scripted.join("square/low_dim.hdf5");
    let made = files.make("mimicgen", &square, "");
    let outcome = |source: &Path, more: &str| {
        let _ = fs::remove_dir_all(files.place.artifacts());
        let text = format!(
            "task = \"square\"\nvariant = \"state\"\n[ingest]\nsource = \"{}\"\n[segment]\n[pose]\nsource = \"recorded\"\n[index]\n[policy]\nkind = \"re4\"\n[rollout]\nseeds = \"201000..201003\"\nmax_steps = 300\nfidelity = \"fast\"\n",
            source.display()
        );
        files.place.write("rollout.toml", text);
        let output = files
            .place
            .command()
            .env("RE4_SIMULATORS", &simulators)
            .args(format!("rollout rollout.toml --quiet {more}").split_whitespace())
            .output()
            .unwrap();
        Answer::new(&output, files.place.path()).done();
        let rollouts = files.place.artifact(Stage::Rollout);
        [results(&rollouts), steps(&rollouts)]
    };
    assert_eq!(outcome(&made, ""), outcome(&square, &first()));
}
