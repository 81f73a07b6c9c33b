//! The pose encoder, from demonstrations with images to the artifacts `encoder` and `poses`. These tests run real trainings on the five recorded
//! demonstrations of Lift. They need the datasets in the folder that `RE4_DATA` names, or in ../shared/data.

use std::fmt::Write as _;
use std::io::Cursor;
use std::path::Path;
use std::sync::Arc;

use crate::support::{Answer, Place, artifact_bytes, assert_same_bytes, filters, scripted};
use arrow_array::{BinaryArray, RecordBatch};
use image::RgbImage;
use insta::{assert_snapshot, with_settings};
use re4_artifact::{Artifact, ArtifactSummary, Columns, Recipe, Row as _, Stage, Store, col_binary, col_f64, col_u32};
use re4_ingest::{FrameRow, ImageRow, SpatialColumns};

/// Settings of short trainings, by preset.
const PAPER: &str = r#"
preset = "paper"
width = 4
learning_rate = 2e-3
losses = { translation = 300.0 }
"#;
const RE4: &str = r#"
preset = "re4"
"#;

fn pipeline(source: &Path, settings: &str) -> String {
    format!(
        "task = \"lift\"\nvariant = \"image\"\n[ingest]\nsource = \"{}\"\ncameras = [\"agentview\"]\n[segment]\n\
         [pose]\nsource = \"encoder\"\n[pose.encoder]\nepochs = 3\nsteps = 12\nbatch = 32\nheld_out = 0.2\n{settings}",
        source.display()
    )
}

fn only(place: &Place, artifacts: &str, stage: Stage) -> Artifact {
    let mut folders = crate::support::folders_in(&place.path().join(artifacts).join(stage.artifact()));
    assert_eq!(folders.len(), 1);
    Artifact::open(&folders.remove(0)).unwrap()
}

fn train(place: &Place, arguments: &str) -> Answer {
    place.run(&format!("train-pose lift.toml {arguments}"))
}

/// A folder with a pipeline file on Lift's five demonstrations with images.
fn lift(settings: &str) -> Option<Place> {
    let data = scripted()?;
    let place = Place::empty();
    place.write("lift.toml", pipeline(&data.join("lift/image_5.hdf5"), settings));
    Some(place)
}

#[test]
fn training_gives_a_consistent_artifact_for_any_number_of_threads() {
    check_artifact(PAPER, &["encoder.safetensors", "model_card.md", "training.svg"], 0.7);
}

#[test]
fn keypoints_give_a_consistent_artifact_for_any_number_of_threads() {
    check_artifact(
        RE4,
        &[
            "confidence.json",
            "encoder.safetensors",
            "model_card.md",
            "training.svg",
        ],
        0.85,
    );
}

/// `fraction` is that of the first epoch's loss that remains after the third.
fn check_artifact(settings: &str, expected: &[&str], fraction: f64) {
    let Some(place) = lift(settings) else { return };
    train(&place, "--jobs 1 --artifacts one").done();
    train(&place, "--jobs 2 --artifacts two").done();
    assert_same_bytes(
        &artifact_bytes(&place.path().join("one")),
        &artifact_bytes(&place.path().join("two")),
    );
    let (encoder, poses) = (
        only(&place, "one", Stage::TrainEncoder),
        only(&place, "one", Stage::TrainPose),
    );
    for artifact in [&encoder, &poses] {
        re4_artifact::verify(artifact.path(), &re4_stages::tables::described).unwrap();
    }
    let files: Vec<&str> = encoder.manifest().files.keys().map(String::as_str).collect();
    assert_eq!(files, expected);
    assert!(poses.manifest().files.is_empty());
    assert_eq!(poses.manifest().inputs["encoder"], *encoder.key());
    let frames = only(&place, "one", Stage::Ingest)
        .table(FrameRow::<SpatialColumns>::table())
        .unwrap()
        .rows();
    let table = poses
        .table(re4_pose::PoseRow::<re4_pose::SpatialEstimate>::table())
        .unwrap();
    assert_eq!(table.rows(), frames);
    let course = encoder
        .table(re4_pose::TrainingRow::table())
        .unwrap()
        .read_all()
        .unwrap();
    let losses = col_f64(&course, "loss").unwrap();
    assert_eq!(col_u32(&course, "steps").unwrap(), [12, 24, 36]);
    assert!(losses[2] < fraction * losses[0], "{losses:?}");
    // One demonstration in five is held out and marked.
    for artifact in [&encoder, &poses] {
        assert_eq!(artifact.manifest().summary["trained_on"], 4);
    }
    // The checkpoints are removed.
    assert!(!place.path().join("one/checkpoints").exists());
    // A second run skips all stages.
    let again = train(&place, "--artifacts one");
    assert!(again.done().stderr.contains("unchanged, skipped"));
}

/// Moves the recorded object by a metre and rotates it. Everything else is unchanged.
fn disturbed(table: &str, batch: RecordBatch) -> RecordBatch {
    if table != FrameRow::<SpatialColumns>::table().name {
        return batch;
    }
    let batch = &batch;
    let mut columns = Columns::new(FrameRow::<SpatialColumns>::table());
    for spec in FrameRow::<SpatialColumns>::table().columns {
        let array = batch.column_by_name(spec.name).unwrap();
        columns = match spec.name {
            "object_x" | "object_y" | "object_z" => {
                let values = col_f64(batch, spec.name).unwrap();
                columns.f64(spec.name, values.iter().map(|x| 1.0 - 3.0 * x).collect())
            }
            "object_qx" => columns.f64(spec.name, vec![0.6; batch.num_rows()]),
            "object_qy" => columns.f64(spec.name, vec![0.8; batch.num_rows()]),
            "object_qz" | "object_qw" => columns.f64(spec.name, vec![0.0; batch.num_rows()]),
            name => columns.array(name, array.clone()),
        };
    }
    columns.finish().unwrap()
}

/// Copies an artifact to another store, under the same key, with other rows: `edit` returns the rows of a table, given its name.
fn forge(original: &Artifact, store: &Path, edit: impl Fn(&str, RecordBatch) -> RecordBatch) {
    let manifest = original.manifest();
    let recipe = Recipe::new(Stage::Ingest, manifest.code_version)
        .config(&manifest.config)
        .unwrap()
        .source(manifest.source_blake3.unwrap().as_bytes(), manifest.source.clone());
    assert_eq!(recipe.key(), manifest.key);
    let writer = Store::open(store).unwrap().begin(&recipe).unwrap();
    for (name, summary) in &manifest.tables {
        let spec = re4_stages::tables::described(original, name).unwrap();
        let mut out = writer.table_in_groups(spec, summary.row_group_rows as usize).unwrap();
        for batch in original.table(spec).unwrap().batches().unwrap() {
            out.write(edit(spec.name, batch.unwrap())).unwrap();
        }
        out.finish().unwrap();
    }
    writer
        .publish(ArtifactSummary {
            summary: manifest.summary.clone(),
            warnings: manifest.warnings.clone(),
        })
        .unwrap();
}

#[test]
fn training_and_estimates_do_not_depend_on_recorded_object_poses() {
    check_independence(PAPER);
    check_independence(RE4);
}

fn check_independence(settings: &str) {
    let Some(place) = lift(settings) else { return };
    train(&place, "--artifacts true").done();
    forge(
        &only(&place, "true", Stage::Ingest),
        &place.path().join("false"),
        disturbed,
    );
    train(&place, "--artifacts false").done();
    let same = |stage: Stage, file: &str| {
        let [real, fake] = ["true", "false"].map(|artifacts| only(&place, artifacts, stage));
        let bytes = |artifact: &Artifact| std::fs::read(artifact.path().join(file)).unwrap();
        bytes(&real) == bytes(&fake)
    };
    for (stage, file) in [
        (Stage::TrainEncoder, "encoder.safetensors"),
        (Stage::TrainEncoder, "training.parquet"),
        (Stage::TrainEncoder, "training.svg"),
        (Stage::TrainPose, "poses.parquet"),
    ] {
        assert!(same(stage, file), "{file} depends on recorded object poses");
    }
    // The evaluation reads the recorded poses and differs, so the recorded poses really were changed.
    assert!(!same(Stage::TrainPose, "pose_errors.parquet"));
}

/// The rows of table `images` with other images. `edit` changes the image of a demonstration.
fn with_images(table: &str, batch: RecordBatch, edit: impl Fn(u32, &mut RgbImage)) -> RecordBatch {
    if table != ImageRow::table().name {
        return batch;
    }
    let (episodes, images) = (
        col_u32(&batch, "episode").unwrap(),
        col_binary(&batch, "image").unwrap(),
    );
    let edited = episodes.iter().enumerate().map(|(row, &episode)| {
        let mut image = image::load_from_memory(images.value(row)).unwrap().into_rgb8();
        edit(episode, &mut image);
        let mut file = Cursor::new(Vec::new());
        image.write_to(&mut file, image::ImageFormat::Png).unwrap();
        file.into_inner()
    });
    let files: Vec<Vec<u8>> = edited.collect();
    let mut columns = Columns::new(ImageRow::table());
    for spec in ImageRow::table().columns {
        columns = match spec.name {
            "image" => columns.array("image", Arc::new(files.iter().map(Some).collect::<BinaryArray>())),
            name => columns.array(name, batch.column_by_name(name).unwrap().clone()),
        };
    }
    columns.finish().unwrap()
}

/// Code of every warning of the training and of the estimates, with the demonstration that it names.
fn warnings(place: &Place, artifacts: &str) -> Vec<(String, Option<String>)> {
    let text = |warning: &serde_json::Value, name: &str| warning[name].as_str().map(str::to_owned);
    let of = |stage| only(place, artifacts, stage).manifest().warnings.clone();
    let all = [Stage::TrainEncoder, Stage::TrainPose].into_iter().flat_map(of);
    all.map(|warning| (text(&warning, "code").unwrap(), text(&warning, "demo_name")))
        .collect()
}

#[test]
fn images_and_grasps_that_cannot_be_learned_from_are_reported() {
    let Some(place) = lift(RE4) else { return };
    train(&place, "--artifacts plain").done();
    let known = warnings(&place, "plain");
    // Four demonstrations are too few to learn from.
    assert_eq!(known, [("no_better_than_mean".to_owned(), None)]);
    let plain = only(&place, "plain", Stage::Ingest);
    let named = |code: &str, demo: &str| (code.to_owned(), Some(demo.to_owned()));

    // A camera that did not work in one demonstration.
    let black = |demos: std::ops::Range<u32>| {
        move |table: &str, batch| {
            with_images(table, batch, |demo, image| {
                if demos.contains(&demo) {
                    image.fill(0);
                }
            })
        }
    };
    forge(&plain, &place.path().join("black"), black(3..4));
    train(&place, "--artifacts black").done();
    assert!(warnings(&place, "black").contains(&named("blank_images", "demo_3")));
    forge(&plain, &place.path().join("night"), black(0..5));
    let refused = train(&place, "--artifacts night").refused();
    assert!(
        refused.contains("have a single color; record or render the images again"),
        "{refused}"
    );

    // The gripper never closes in one demonstration, or in all.
    let open = |demos: std::ops::Range<u32>| {
        move |table: &str, batch: RecordBatch| {
            if table != FrameRow::<SpatialColumns>::table().name {
                return batch;
            }
            let episodes = col_u32(&batch, "episode").unwrap();
            let gripper = col_f64(&batch, "gripper").unwrap();
            let gripper = episodes
                .iter()
                .zip(gripper)
                .map(|(demo, own)| if demos.contains(demo) { -1.0 } else { *own });
            let gripper: Vec<f64> = gripper.collect();
            let mut columns = Columns::new(FrameRow::<SpatialColumns>::table());
            for spec in FrameRow::<SpatialColumns>::table().columns {
                columns = match spec.name {
                    "gripper" => columns.f64("gripper", gripper.clone()),
                    name => columns.array(name, batch.column_by_name(name).unwrap().clone()),
                };
            }
            columns.finish().unwrap()
        }
    };
    forge(&plain, &place.path().join("open"), open(1..2));
    train(&place, "--artifacts open").done();
    assert!(warnings(&place, "open").contains(&named("no_grasp", "demo_1")));
    forge(&plain, &place.path().join("never"), open(0..5));
    let refused = train(&place, "--artifacts never").refused();
    assert!(
        refused.contains("no training demonstration has a transfer frame after a transit frame"),
        "{refused}"
    );
}

#[test]
fn the_page_of_a_training_shows_errors_and_images() {
    let Some(place) = lift(RE4) else { return };
    train(&place, "--artifacts artifacts").done();
    let poses = only(&place, "artifacts", Stage::TrainPose);
    let folder = poses.path().strip_prefix(place.path()).unwrap().display().to_string();
    place.run(&format!("report {folder} --output training.html")).done();
    let page = std::fs::read_to_string(place.path().join("training.html")).unwrap();
    for expected in [
        "<h1>Lift</h1>",
        "36 steps",
        "4 demonstrations",
        "1 demonstration was held out",
        "L_abs, held out",
        "demo_0, frame ",
        "data:image/png;base64,",
        "class=\"estimated x\"",
        "class=\"anchored\"",
    ] {
        assert!(page.contains(expected), "{expected}");
    }
    // One image before the grasp and one that holds the object, of the only held-out demonstration.
    assert_eq!(page.matches("<figure").count(), 2);
    place.run(&format!("report {folder} --output again.html")).done();
    assert!(page == std::fs::read_to_string(place.path().join("again.html")).unwrap());

    let refused = place
        .run(&format!("report {folder} --images 2 --output no.html"))
        .refused();
    assert!(refused.contains("it has a poses artifact, not rollouts"), "{refused}");
    let [kept, away] = ["artifacts/encoder", "away"].map(|folder| place.path().join(folder));
    std::fs::rename(&kept, &away).unwrap();
    let refused = place.run(&format!("report {folder} --output no.html")).refused();
    assert!(
        refused.contains("its encoder artifact is neither beside it nor in artifacts"),
        "{refused}"
    );
    std::fs::rename(&away, &kept).unwrap();
    // Without the episodes there are no images, which is said.
    std::fs::rename(place.path().join("artifacts/episodes"), place.path().join("elsewhere")).unwrap();
    let answer = place.run(&format!("report {folder} --output bare.html"));
    assert!(answer.done().stderr.contains("the page shows no images"));
    let bare = std::fs::read_to_string(place.path().join("bare.html")).unwrap();
    assert!(!bare.contains("data:image/png") && bare.contains("Errors by phase"));
}

#[test]
fn unusable_settings_and_data() {
    let Some(place) = lift(PAPER) else { return };
    let data = scripted().unwrap();
    place.write("re4.toml", pipeline(&data.join("lift/image_5.hdf5"), RE4));
    place.write(
        "states.toml",
        pipeline(&data.join("lift/low_dim.hdf5"), PAPER)
            .replace("cameras = [\"agentview\"]\n", "select = { first = 2 }\n"),
    );
    place.write("weights.bin", "not weights");
    let mut errors = String::new();
    for arguments in [
        "states.toml",
        "lift.toml --set pose.encoder.camera=frontview",
        "lift.toml --set pose.encoder.weights=nowhere.pth",
        "lift.toml --set pose.encoder.weights=weights.bin",
        "lift.toml --set pose.encoder.backend=torch",
        "lift.toml --set pose.encoder.learning_rate=1e30",
        "lift.toml --set pose.encoder.batch=12",
        "lift.toml --set pose.encoder.epochs=0",
        "lift.toml --set pose.encoder.width=0",
        "lift.toml --set pose.encoder.held_out=1.0",
        "lift.toml --set pose.encoder.losses.absolute=-1.0",
        "lift.toml --set pose.encoder.losses.rotation=-1.0",
        "lift.toml --set pose.encoder.held_images=3",
        "lift.toml --set pose.encoder.crops=6",
        "re4.toml --set pose.encoder.preset=best",
        "re4.toml --set pose.encoder.width=20",
        "re4.toml --set pose.encoder.weights=weights.bin",
        "lift.toml --set variant=state",
        "lift.toml --set pose.source=recorded",
        "lift.toml --set pose.source=log_polar",
        "lift.toml --set segment.rule=rigid_motion",
    ] {
        if cfg!(feature = "torch") && arguments.contains("torch") {
            continue;
        }
        let answer = place.run(&format!("train-pose {arguments} --artifacts artifacts"));
        writeln!(errors, "$ train-pose {arguments}\n{}", answer.refused()).unwrap();
    }
    with_settings!({ filters => filters() }, { assert_snapshot!(errors) });
    // No artifact is left, also by the training that diverged in its first epoch.
    for kind in ["encoder", "poses"] {
        assert!(crate::support::folders_in(&place.path().join("artifacts").join(kind)).is_empty());
    }
}
