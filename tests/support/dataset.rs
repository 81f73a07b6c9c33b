//! Small Push-T datasets: a scripted pusher moves behind the block and pushes it towards the goal.

use std::fs;
use std::path::Path;

use re4_episode::PlanarFrame;
use re4_geometry::Point2;
use re4_ingest::pusht::{PushtWriter, RecordedEpisode};
use re4_sim::{CENTRE_OF_GRAVITY, GOAL, PushT, ResetOrder, SeedScheme, Simulator as _, Step, scene_from_seed};

/// Side of the images, in pixels. Their content is arbitrary.
pub(crate) const SIDE: usize = 12;

/// Number of frames of an episode.
pub(crate) const LENGTH: usize = 70;

/// Number of images in a chunk.
const PICTURES_IN_CHUNK: usize = 100;

/// Writes a dataset of `episodes` episodes, which start from the scenes of the seeds 1000, 1001 and so on.
pub(crate) fn write(path: &Path, episodes: u32, images: bool) {
    let recorded: Vec<RecordedEpisode> = (0..episodes).map(|number| episode(1000 + number)).collect();
    PushtWriter::write(path, &recorded).unwrap();
    if images {
        write_images(path, episodes as usize * LENGTH);
    }
}

/// As [`write`] without images, with only the first `length` frames of the episodes.
pub(crate) fn write_short(path: &Path, episodes: u32, length: usize) {
    let short = |number| {
        let mut episode = episode(1000 + number);
        episode.frames.truncate(length);
        episode
    };
    let recorded: Vec<RecordedEpisode> = (0..episodes).map(short).collect();
    PushtWriter::write(path, &recorded).unwrap();
}

fn episode(seed: u32) -> RecordedEpisode {
    let mut simulator = PushT::new().unwrap();
    let scene = scene_from_seed(SeedScheme::DiffusionPolicy, seed);
    simulator.reset(&scene, ResetOrder::Legacy).unwrap();
    let mut seen = simulator.outcome();
    let mut pushing = false;
    let frames = (0..LENGTH)
        .map(|_| {
            let action = target(&seen, &mut pushing);
            let frame = PlanarFrame {
                eef: seen.observation.agent,
                object: seen.observation.block,
                action,
                contacts: f64::from(seen.contacts),
            };
            seen = simulator.step(&action).unwrap();
            frame
        })
        .collect();
    RecordedEpisode { frames }
}

/// Moves to a point behind the block as seen from the goal, then pushes through the block, and starts again when it is past it.
fn target(seen: &Step<re4_sim::PushTObservation>, pushing: &mut bool) -> Point2 {
    let agent = seen.observation.agent;
    let centre = seen.observation.block.transform_point(CENTRE_OF_GRAVITY);
    let to_goal = GOAL.transform_point(CENTRE_OF_GRAVITY) - centre;
    let direction = to_goal.try_normalize(1e-9).unwrap_or(Point2::new(1.0, 0.0));
    let behind = centre - direction * 110.0;
    let along = (centre - agent).dot(&direction);
    *pushing = if *pushing {
        along > -20.0
    } else {
        (behind - agent).norm() < 40.0
    };
    let step = if *pushing {
        direction * 18.0
    } else {
        let offset = behind - agent;
        offset * (30.0 / offset.norm()).min(1.0)
    };
    (agent + step).map(|value| value.clamp(20.0, 490.0))
}

/// Adds the array `data/img`, as uncompressed bytes.
fn write_images(path: &Path, frames: usize) {
    let folder = path.join("data/img");
    fs::create_dir(&folder).unwrap();
    let metadata = serde_json::json!({
        "zarr_format": 2, "shape": [frames, SIDE, SIDE, 3], "chunks": [PICTURES_IN_CHUNK, SIDE, SIDE, 3],
        "dtype": "|u1", "compressor": null, "fill_value": 0, "filters": null, "order": "C"
    });
    fs::write(folder.join(".zarray"), metadata.to_string()).unwrap();
    for chunk in 0..frames.div_ceil(PICTURES_IN_CHUNK) {
        let bytes: Vec<u8> = (chunk * PICTURES_IN_CHUNK..(chunk + 1) * PICTURES_IN_CHUNK)
            .flat_map(|frame| image(frame, frames))
            .collect();
        fs::write(folder.join(format!("{chunk}.0.0.0")), bytes).unwrap();
    }
}

/// The image of a frame of the dataset; zeros after its last frame, which fill up the last chunk.
pub(crate) fn image(frame: usize, frames: usize) -> Vec<u8> {
    (0..SIDE * SIDE * 3)
        .map(|i| {
            if frame < frames {
                ((frame * 31 + i * i * 7) % 251) as u8
            } else {
                0
            }
        })
        .collect()
}

/// Replaces an array of a dataset by an uncompressed one with a single chunk.
pub(crate) fn replace(dataset: &Path, array: &str, dtype: &str, shape: &[usize], bytes: &[u8]) {
    let folder = dataset.join(array);
    fs::remove_dir_all(&folder).unwrap();
    fs::create_dir(&folder).unwrap();
    let metadata = serde_json::json!({
        "zarr_format": 2, "shape": shape, "chunks": shape.iter().map(|length| (*length).max(1)).collect::<Vec<_>>(),
        "dtype": dtype, "compressor": null, "fill_value": 0, "filters": null, "order": "C"
    });
    fs::write(folder.join(".zarray"), metadata.to_string()).unwrap();
    if shape.iter().product::<usize>() > 0 {
        fs::write(folder.join(vec!["0"; shape.len()].join(".")), bytes).unwrap();
    }
}

/// Replaces `meta/episode_ends`.
pub(crate) fn replace_ends(dataset: &Path, ends: &[i64]) {
    let bytes: Vec<u8> = ends.iter().flat_map(|end| end.to_le_bytes()).collect();
    replace(dataset, "meta/episode_ends", "<i8", &[ends.len()], &bytes);
}

/// Replaces `data/state` by constant states, except for one value in one frame.
pub(crate) fn replace_state(dataset: &Path, frames: usize, frame: usize, column: usize, value: f32) {
    let mut values = [100.0_f32, 120.0, 300.0, 310.0, 1.0].repeat(frames);
    values[frame * 5 + column] = value;
    let bytes: Vec<u8> = values.iter().flat_map(|value| value.to_le_bytes()).collect();
    replace(dataset, "data/state", "<f4", &[frames, 5], &bytes);
}
