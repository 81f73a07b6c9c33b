//! The pose encoder, from demonstrations with images to the `poses` artifact. These tests run real trainings on the five recorded
//! demonstrations of Lift. They need the datasets in the folder that `RE4_DATA` names, or in ../shared/data.

use std::fmt::Write as _;
use std::path::Path;

use crate::support::{Answer, Place, artifact_bytes, assert_same_bytes, filters, scripted};
use arrow_array::RecordBatch;
use insta::{assert_snapshot, with_settings};
use re4_artifact::{Artifact, ArtifactSummary, Columns, Recipe, Row as _, Stage, Store, col_f64, col_u32};
use re4_ingest::{FrameRow, SpatialColumns};

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
    let poses = only(&place, "one", Stage::TrainPose);
    re4_artifact::verify(poses.path(), &re4_stages::tables::described).unwrap();
    let files: Vec<&str> = poses.manifest().files.keys().map(String::as_str).collect();
    assert_eq!(files, expected);
    let frames = only(&place, "one", Stage::Ingest)
        .table(FrameRow::<SpatialColumns>::table())
        .unwrap()
        .rows();
    let table = poses
        .table(re4_pose::PoseRow::<re4_pose::SpatialEstimate>::table())
        .unwrap();
    assert_eq!(table.rows(), frames);
    let course = poses.table(re4_pose::TrainingRow::table()).unwrap().read_all().unwrap();
    let losses = col_f64(&course, "loss").unwrap();
    assert_eq!(col_u32(&course, "steps").unwrap(), [12, 24, 36]);
    assert!(losses[2] < fraction * losses[0], "{losses:?}");
    // One demonstration in five is held out and marked.
    assert_eq!(poses.manifest().summary["trained_on"], 4);
    // The checkpoints are removed.
    assert!(!place.path().join("one/checkpoints").exists());
    // A second run skips all stages.
    let again = train(&place, "--artifacts one");
    assert!(again.done().stderr.contains("unchanged, skipped"));
}

/// Moves the recorded object by a metre and rotates it. Everything else is unchanged.
fn disturbed(batch: &RecordBatch) -> RecordBatch {
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

/// Copies an artifact to another store, under the same key, with different recorded object poses.
fn forge(original: &Artifact, store: &Path) {
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
            let batch = batch.unwrap();
            let frames = spec.name == FrameRow::<SpatialColumns>::table().name;
            out.write(if frames { disturbed(&batch) } else { batch }).unwrap();
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
    forge(&only(&place, "true", Stage::Ingest), &place.path().join("false"));
    train(&place, "--artifacts false").done();
    let (real, fake) = (
        only(&place, "true", Stage::TrainPose),
        only(&place, "false", Stage::TrainPose),
    );
    let bytes = |artifact: &Artifact, file: &str| std::fs::read(artifact.path().join(file)).unwrap();
    for file in [
        "encoder.safetensors",
        "poses.parquet",
        "training.parquet",
        "training.svg",
    ] {
        assert!(
            bytes(&real, file) == bytes(&fake, file),
            "{file} depends on recorded object poses"
        );
    }
    // The evaluation reads the recorded poses and differs, so the recorded poses really were changed.
    assert!(bytes(&real, "pose_errors.parquet") != bytes(&fake, "pose_errors.parquet"));
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
    assert!(crate::support::folders_in(&place.path().join("artifacts/poses")).is_empty());
}
