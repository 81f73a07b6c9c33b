//! End-to-end tests on the human Push-T demonstrations. Skipped if they are not below `RE4_DATA`.

use std::collections::BTreeMap;
use std::path::Path;
use std::process::{Command, Stdio};
use std::time::Duration;

use crate::support::{PROGRAM, folders_in, real_data, repository};
use arrow_array::Array as _;
use re4_artifact::{Artifact, Batches, Row as _, Table, col_binary, col_f64, col_f64_or_null, col_u32};
use re4_ingest::Selection;
use re4_ingest::pusht::PushtReader;
use re4_ingest::{EpisodeRow, FrameRow, ImageRow, PlanarColumns};
use re4_sim::{PushT, ResetOrder, SeedScheme, Simulator as _, scene_from_seed};
use serde_json::Value;
use sha2::{Digest as _, Sha256};
use tempfile::TempDir;

const DATASET: &str = "pusht/pusht_cchi_v7_replay.zarr";

/// The output of `tests/real_data_reference.py`: the words of each line, by the first word.
fn reference() -> BTreeMap<&'static str, Vec<&'static str>> {
    let lines = include_str!("real_data_reference.txt").lines();
    lines
        .map(|line| {
            let mut words = line.split(' ');
            (words.next().unwrap(), words.collect())
        })
        .collect()
}

fn digest(bytes: impl AsRef<[u8]>) -> String {
    hexadecimal(&Sha256::digest(bytes))
}

fn hexadecimal(bytes: &[u8]) -> String {
    bytes
        .iter()
        .fold(String::new(), |text, byte| text + &format!("{byte:02x}"))
}

fn command(data: &Path, artifacts: &Path, arguments: &str) -> Command {
    let mut command = Command::new(PROGRAM);
    command
        .current_dir(repository())
        .env("RE4_DATA", data)
        .args(arguments.split_whitespace())
        .args(["--quiet", "--json", "--artifacts"])
        .arg(artifacts);
    command
}

fn json(data: &Path, artifacts: &Path, arguments: &str) -> Value {
    let output = command(data, artifacts, arguments).output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    serde_json::from_slice(&output.stdout).unwrap()
}

fn open(artifacts: &Path, kind: &str) -> Artifact {
    let folders = folders_in(&artifacts.join(kind));
    assert_eq!(folders.len(), 1, "{folders:?}");
    Artifact::open(&folders[0]).unwrap()
}

/// The reset to seed `i` equals frame 0 of demonstration `i` up to the precision of the recording: the agent is at integer
/// pixels, the block is stored in float32.
#[test]
fn demonstrations_start_from_their_seeds() {
    let Some(data) = real_data() else { return };
    let reader = PushtReader::open(&data.join(DATASET)).unwrap();
    let (episodes, _) = reader.read_episodes(&Selection::All).unwrap();
    assert_eq!(episodes.episode_count(), 206);
    let mut simulator = PushT::new().unwrap();
    let (mut farthest, mut max_rotation) = (0.0_f64, 0.0_f64);
    for (episode, rows) in episodes.frames.iter().enumerate() {
        let [agent_x, agent_y, block_x, block_y, theta] = episodes.state[rows.start];
        let scene = scene_from_seed(SeedScheme::DiffusionPolicy, episode as u32);
        let seen = simulator.reset(&scene, ResetOrder::Legacy).unwrap();
        assert_eq!(
            [seen.agent.x, seen.agent.y],
            [agent_x, agent_y],
            "agent of demonstration {episode}"
        );
        let rotation = (seen.block.theta - theta)
            .sin()
            .abs()
            .max(1.0 - (seen.block.theta - theta).cos());
        farthest = farthest.max((seen.block.x - block_x).hypot(seen.block.y - block_y));
        max_rotation = max_rotation.max(rotation);
        assert!(
            farthest <= 1e-4 && max_rotation <= 1e-6,
            "demonstration {episode}: {farthest} px, {max_rotation} rad"
        );
    }
    println!("206 of 206 start from their seed; block within {farthest:e} px and {max_rotation:e} rad");
}

#[test]
fn ingest_stores_every_value_with_little_memory() {
    let Some(data) = real_data() else { return };
    let folder = TempDir::new().unwrap();
    // The number of threads is fixed, because threads use memory and machines have different numbers of processors.
    let mut child = command(&data, folder.path(), "ingest pipelines/pusht-state.toml --jobs 4")
        .stdout(Stdio::null())
        .spawn()
        .unwrap();
    let mut peak_kib = 0_u64;
    let status = loop {
        if let Some(status) = child.try_wait().unwrap() {
            break status;
        }
        // `VmHWM` is a high-water mark, so the last reading before the end is the peak.
        let text = std::fs::read_to_string(format!("/proc/{}/status", child.id())).unwrap_or_default();
        let mark = text.lines().find_map(|line| line.strip_prefix("VmHWM:"));
        if let Some(kib) = mark.and_then(|words| words.split_whitespace().next()?.parse().ok()) {
            peak_kib = peak_kib.max(kib);
        }
        std::thread::sleep(Duration::from_millis(2));
    };
    assert!(status.success());
    println!("peak memory of ingest with images: {} MiB", peak_kib / 1024);
    assert!(peak_kib > 1024, "the peak was not measured");
    assert!(peak_kib < 1024 * 1024, "{peak_kib} KiB");

    let reference = reference();
    let artifact = open(folder.path(), "episodes");
    assert_eq!(
        artifact.manifest().summary["frames"].to_string(),
        reference["frames"][0]
    );
    let episodes = artifact.table(EpisodeRow::table()).unwrap().read_all().unwrap();
    assert_eq!(episodes.num_rows().to_string(), reference["episodes"][0]);
    let mut end = 0;
    let ends = col_u32(&episodes, "frames").unwrap().iter().flat_map(|frames| {
        end += frames;
        u32::to_le_bytes(end)
    });
    assert_eq!(digest(ends.collect::<Vec<_>>()), reference["episodes"][1]);
    let frames = artifact
        .table(FrameRow::<PlanarColumns>::table())
        .unwrap()
        .read_all()
        .unwrap();
    let mut compared = 0;
    for column in FrameRow::<PlanarColumns>::table()
        .columns
        .iter()
        .filter(|column| !["episode", "frame"].contains(&column.name))
    {
        let values = col_f64_or_null(&frames, column.name).unwrap();
        let bytes: Vec<u8> = values
            .iter()
            .flat_map(|value| {
                let single = value.unwrap() as f32;
                assert_eq!(
                    value.unwrap(),
                    f64::from(single),
                    "{} is not the recorded value",
                    column.name
                );
                single.to_le_bytes()
            })
            .collect();
        let expected = &reference[column.name];
        let sum: f64 = values.iter().flatten().sum();
        let stated: f64 = expected[1].parse().unwrap();
        assert!(
            (sum - stated).abs() < 1e-9 * stated.abs(),
            "{}: sum {sum}, not {stated}",
            column.name
        );
        assert_eq!(digest(bytes), expected[0], "{}", column.name);
        compared += 1;
    }
    assert_eq!(
        compared + 3,
        reference.len(),
        "not all lines of the reference were compared"
    );
    let images = artifact.table(ImageRow::table()).unwrap();
    assert_eq!(images_digest(&images), reference["images"][0]);
}

/// SHA-256 of every 50th image.
fn images_digest(images: &Table) -> String {
    let mut hasher = Sha256::new();
    let mut row = 0;
    let batches: Batches = images.batches().unwrap();
    for batch in batches {
        let batch = batch.unwrap();
        let column = col_binary(&batch, "image").unwrap();
        for i in 0..column.len() {
            if row % 50 == 0 {
                let image = image::load_from_memory(column.value(i)).unwrap().into_rgb8();
                assert_eq!(image.dimensions(), (96, 96));
                hasher.update(image.as_raw());
            }
            row += 1;
        }
    }
    hexadecimal(&hasher.finalize())
}

#[test]
fn open_loop_replay_stays_near_the_recording() {
    let Some(data) = real_data() else { return };
    let folder = TempDir::new().unwrap();
    let command = "replay pipelines/pusht-state.toml --set ingest.images=false";
    let summary = &json(&data, folder.path(), command)["summary"];
    println!("{summary}");
    assert_eq!(summary["episodes"], 206);
    assert_eq!(summary["frames"], 25650);
    let number = |place: &str| summary.pointer(place).unwrap().as_f64().unwrap();
    // The recording is float32, with a resolution of 3e-5 px near 512 px. Larger deviations grow from it in contact.
    assert!(number("/pusher_px/max") < 1e-3);
    assert!(number("/block_px/p50") < 1e-3);
    assert!(number("/block_px/p99") < 0.1);
    assert!(number("/block_px/max") < 5.0);
    assert!((number("/coverage_recorded_mean") - number("/coverage_replayed_mean")).abs() < 0.01);
    let artifact = open(folder.path(), "replays");
    let replays = artifact
        .table(re4_stages::ReplayRow::<re4_stages::PlanarReplay>::table())
        .unwrap()
        .read_all()
        .unwrap();
    let divergence = artifact
        .table(re4_stages::PlanarDivergenceRow::table())
        .unwrap()
        .read_all()
        .unwrap();
    let (episode, block) = (
        col_u32(&divergence, "episode").unwrap(),
        col_f64(&divergence, "block").unwrap(),
    );
    for (number, maximum) in col_f64(&replays, "block_max").unwrap().iter().enumerate() {
        let rows = block.iter().zip(episode).filter(|(_, e)| **e as usize == number);
        assert_eq!(
            rows.map(|(d, _)| *d).fold(0.0, f64::max),
            *maximum,
            "demonstration {number}"
        );
    }
}

#[test]
fn policies_have_the_expected_scores() {
    let Some(data) = real_data() else { return };
    let folder = TempDir::new().unwrap();
    let score = |policy: &str| {
        let arguments = format!("run pipelines/pusht-state.toml --no-images --seeds 200000..200020 --policy {policy}");
        let object = json(&data, folder.path(), &arguments);
        assert_eq!(object["episodes"], 20);
        let score = object["metrics"]["score_scaled_mean"]["value"].as_f64().unwrap();
        println!("{policy}: {score:.4} on 20 seeds from 200000");
        score
    };
    let (re4, paper, re2) = (score("re4"), score("paper"), score("re2"));
    assert!(re4 > 0.95, "re4 scores {re4}");
    assert!(paper > 0.8, "paper scores {paper}");
    assert!(
        re2 < paper,
        "re2 scores {re2}, without Reframe and Replan, and paper {paper}"
    );
}

/// Compares the estimates from all recorded images with the recorded poses. The limits are half of the required accuracy, so that
/// an error of the estimator is noticed before scores suffer.
#[test]
fn poses_from_images_are_near_the_recorded_ones() {
    let Some(data) = real_data() else { return };
    let folder = TempDir::new().unwrap();
    let object = json(&data, folder.path(), "train-pose pipelines/pusht-image.toml");
    let summary = &object["summary"];
    assert_eq!(summary["frames"], 25650);
    assert_eq!(summary["frames_not_clear"], 0);
    let number = |pointer: &str| summary["evaluation"].pointer(pointer).unwrap().as_f64().unwrap();
    assert_eq!(number("/flips"), 0.0);
    for (pointer, limit) in [
        ("/position_px/p50", 0.5),
        ("/position_px/p99", 2.0),
        ("/angle_deg/p50", 0.25),
        ("/angle_deg/p99", 1.5),
    ] {
        let found = number(pointer);
        println!("{pointer}: {found:.3}");
        assert!(found <= limit, "{pointer} is {found}");
    }
    let arguments = "run pipelines/pusht-image.toml --seeds 200000..200020";
    let object = json(&data, folder.path(), arguments);
    let score = object["metrics"]["score_scaled_mean"]["value"].as_f64().unwrap();
    println!("re4 from images: {score:.4} on 20 seeds from 200000");
    assert!(score > 0.95, "re4 scores {score}");
}
