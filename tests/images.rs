//! End-to-end tests of Push-T's image variant: poses are estimated from images, indexed and observed by the policy; and images
//! from which no pose can be estimated.

use std::f64::consts::TAU;
use std::fs;

use crate::support::dataset::{self, LENGTH, replace};
use crate::support::{Place, assert_same_bytes, filters};
use insta::{assert_snapshot, with_settings};
use re4_artifact::Row as _;
use re4_artifact::{Artifact, Stage, col_bool, col_f64, col_f64_or_null, col_text, col_u32};
use re4_geometry::{Point2, Pose2, periodic_distance};
use re4_ingest::Selection;
use re4_ingest::pusht::PushtReader;
use re4_sim::{Canvas, OBSERVATION_SIDE};

const EPISODES: u32 = 6;
const FRAMES: usize = EPISODES as usize * LENGTH;

/// A state of the dataset: pusher x and y, block x, y and theta.
type State = [f64; 5];

fn states(place: &Place) -> Vec<State> {
    let (episodes, _) = PushtReader::open(&place.dataset())
        .unwrap()
        .read_episodes(&Selection::All)
        .unwrap();
    episodes.state
}

fn render_state(state: &State) -> Vec<u8> {
    let mut canvas = Canvas::new();
    canvas.render_state(
        Point2::new(state[0], state[1]),
        Pose2::new(state[2], state[3], state[4]),
    );
    canvas.observation()
}

/// Replaces the images of a folder's dataset.
fn set_images(place: &Place, side: usize, images: &[Vec<u8>]) {
    let _ = fs::create_dir(place.dataset().join("data/img"));
    replace(
        &place.dataset(),
        "data/img",
        "|u1",
        &[images.len(), side, side, 3],
        &images.concat(),
    );
}

/// A folder with a dataset without images, and `image.toml` on it.
fn states_only() -> Place {
    let place = Place::empty();
    dataset::write(&place.dataset(), EPISODES, false);
    write_pipeline(&place, "");
    place
}

/// As [`states_only`], with images of the states.
fn with_images() -> Place {
    let place = states_only();
    let images: Vec<Vec<u8>> = states(&place).iter().map(render_state).collect();
    set_images(&place, OBSERVATION_SIDE, &images);
    place
}

fn write_pipeline(place: &Place, ingest: &str) {
    let small = fs::read_to_string(place.path().join("small.toml")).unwrap();
    let image = small
        .replace("variant = \"state\"", "variant = \"image\"")
        .replace("source = \"recorded\"", "source = \"log_polar\"")
        .replace(
            "source = \"small.zarr\"\n",
            &format!("source = \"small.zarr\"\n{ingest}\n"),
        );
    place.write("image.toml", image);
}

fn table_bytes(artifact: &Artifact, table: &str) -> Vec<u8> {
    fs::read(artifact.path().join(format!("{table}.parquet"))).unwrap()
}

/// Estimated poses, the index and the policy do not depend on recorded poses: with different recorded poses and the same images
/// they are the same, byte for byte.
#[test]
fn poses_depend_only_on_the_images() {
    let (honest, doctored) = (with_images(), with_images());
    let shifted: Vec<u8> = states(&doctored)
        .iter()
        .enumerate()
        .flat_map(|(i, s)| [s[0], s[1], 100.0 + (i % 300) as f64, 250.0, (i % 6) as f64])
        .flat_map(|value| (value as f32).to_le_bytes())
        .collect();
    replace(&doctored.dataset(), "data/state", "<f4", &[FRAMES, 5], &shifted);
    for place in [&honest, &doctored] {
        place.run("run image.toml").done();
    }
    let artifacts = |stage| [honest.artifact(stage), doctored.artifact(stage)];
    let [one, other] = artifacts(Stage::Ingest);
    assert!(
        table_bytes(&one, "frames") != table_bytes(&other, "frames"),
        "the recorded poses were not changed"
    );
    for (stage, table) in [
        (Stage::TrainPose, "poses"),
        (Stage::TrainPose, "anchor"),
        (Stage::Index, "index"),
        (Stage::Index, "scales"),
        (Stage::Index, "chunks"),
        (Stage::Rollout, "results"),
        (Stage::Rollout, "steps"),
        (Stage::Rollout, "decisions"),
    ] {
        let [one, other] = artifacts(stage);
        assert!(
            table_bytes(&one, table) == table_bytes(&other, table),
            "{table} differs"
        );
    }
}

#[test]
fn a_run_from_images_is_deterministic() {
    let (one, two) = (with_images(), with_images());
    one.run("run image.toml --jobs 1").done();
    two.run("run image.toml --jobs 2").done();
    assert_same_bytes(&one.bytes(), &two.bytes());
    let again = one.run("run image.toml").done();
    assert_eq!(
        again.stderr.matches("unchanged, skipped").count(),
        5,
        "{}",
        again.stderr
    );
}

#[test]
fn the_policy_observes_the_pose_in_the_image() {
    let place = with_images();
    place.run("run image.toml").done();
    let rollouts = place.artifact(Stage::Rollout);
    let steps = crate::support::steps(&rollouts);
    let of = |name| col_f64(&steps, name).unwrap();
    let observed = |name| col_f64_or_null(&steps, name).unwrap();
    let (seed, step) = (col_u32(&steps, "seed").unwrap(), col_u32(&steps, "step").unwrap());
    let (x, y, theta) = (of("object_x"), of("object_y"), of("object_theta"));
    let (seen_x, seen_y) = (observed("seen_x"), observed("seen_y"));
    let (seen_theta, confidence) = (observed("seen_theta"), observed("pose_confidence"));
    let mut exact = 0;
    for row in 1..seed.len() {
        if step[row] == 0 {
            continue;
        }
        // The state before an action is the state after the previous action.
        let off = (seen_x[row].unwrap() - x[row - 1]).hypot(seen_y[row].unwrap() - y[row - 1]);
        let rotation = periodic_distance(seen_theta[row].unwrap(), theta[row - 1], TAU);
        assert!(off < 3.0 && rotation < 0.04, "row {row}: {off} px, {rotation} rad");
        assert!((0.7..=1.0).contains(&confidence[row].unwrap()));
        exact += u32::from(off < 1e-6);
    }
    assert_eq!(exact, 0, "an exact pose would be a recorded one, not an estimate");
    let flags = col_text(&steps, "pose_flag").unwrap();
    assert!(flags.iter().all(|flag| *flag == Some("clear")));
    let decisions = crate::support::decisions(&rollouts);
    let (at, query) = (
        (
            col_u32(&decisions, "seed").unwrap(),
            col_u32(&decisions, "step").unwrap(),
        ),
        col_f64(&decisions, "query_object_x").unwrap(),
    );
    for (i, &query) in query.iter().enumerate() {
        let row = (0..seed.len())
            .find(|&row| (seed[row], step[row]) == (at.0[i], at.1[i]))
            .unwrap();
        assert_eq!(Some(query), seen_x[row]);
    }
    // In the state variant, these columns are null.
    place.run("run small.toml --artifacts states").done();
    let folder = &crate::support::folders_in(&place.path().join("states/rollouts"))[0];
    let steps = crate::support::steps(&Artifact::open(folder).unwrap());
    assert!(
        col_f64_or_null(&steps, "pose_confidence")
            .unwrap()
            .iter()
            .all(Option::is_none)
    );
}

#[test]
fn rendered_images_give_the_same_poses_as_recorded_ones() {
    let (recorded, rendered) = (with_images(), states_only());
    write_pipeline(&rendered, "render = [\"image\"]");
    for place in [&recorded, &rendered] {
        place.run("train-pose image.toml").done();
    }
    let bytes = |place: &Place| table_bytes(&place.artifact(Stage::TrainPose), "poses");
    assert!(bytes(&recorded) == bytes(&rendered));
    let warned = |place: &Place| place.artifact(Stage::Ingest).manifest().warnings.clone();
    assert_eq!(warned(&recorded), warned(&rendered));
    write_pipeline(&recorded, "render = [\"image\"]");
    let refusal = recorded.run("ingest image.toml").refused_at_once();
    assert!(
        refusal.contains("it has recorded images; remove ingest.render"),
        "{refusal}"
    );
}

#[test]
fn frames_without_a_clear_pose_are_counted_and_not_retrieved() {
    let place = with_images();
    let all = states(&place);
    let away = |state: &State| [state[0], state[1], -900.0, -900.0, 0.0];
    let mut images: Vec<Vec<u8>> = all.iter().map(render_state).collect();
    // One push moves the block out of the image, so some frames are not clear in the unchanged images.
    place.run("train-pose image.toml --artifacts before").done();
    let folder = &crate::support::folders_in(&place.path().join("before/poses"))[0];
    let poses = Artifact::open(folder)
        .unwrap()
        .table(re4_pose::PoseRow::<re4_pose::Estimate>::table())
        .unwrap()
        .read_all()
        .unwrap();
    let flags = col_text(&poses, "flag").unwrap();
    let doubtful: Vec<usize> = (0..FRAMES).filter(|&row| flags[row] != Some("clear")).collect();
    let count = |flag: &str| flags.iter().filter(|other| **other == Some(flag)).count();
    // Three frames show no block; one shows two.
    let (hidden, two) = ([LENGTH + 10, LENGTH + 11, 3 * LENGTH], 4 * LENGTH + 30);
    let mut wanted = [&hidden[..], &[two], &doubtful].concat();
    wanted.sort_unstable();
    assert!(
        doubtful
            .iter()
            .all(|row| wanted.iter().filter(|other| *other == row).count() == 1)
    );
    for frame in hidden {
        images[frame] = render_state(&away(&all[frame]));
    }
    let (second, empty) = (
        render_state(&[25.0, 25.0, 90.0, 300.0, 1.0]),
        render_state(&[25.0, 25.0, -900.0, -900.0, 0.0]),
    );
    for (i, byte) in second.iter().enumerate().filter(|(i, byte)| **byte != empty[*i]) {
        images[two][i] = *byte;
    }
    set_images(&place, OBSERVATION_SIDE, &images);
    let answer = place.run("index image.toml --json").done();
    let counted = format!("{} frames not clear, 1 warning", wanted.len());
    assert!(answer.stderr.contains(&counted), "{}", answer.stderr);
    let poses = place.artifact(Stage::TrainPose);
    let summary = &poses.manifest().summary;
    let flagged = |flag: &str| summary["flags"][flag].as_u64().unwrap() as usize;
    assert_eq!(flagged("no_block"), count("no_block") + 3);
    assert_eq!(flagged("second_block"), count("second_block") + 1);
    assert_eq!(flagged("occluded"), count("occluded"));
    let message = poses.manifest().warnings[0]["message"].as_str().unwrap().to_owned();
    let start = format!("the estimated pose is not clear in {} of 420 frames (", wanted.len());
    assert!(message.starts_with(&start), "{message}");
    assert!(
        message.ends_with("first in episode 1, frame 10; these frames are not retrieved"),
        "{message}"
    );
    let index = place
        .artifact(Stage::Index)
        .table(re4_index::IndexRow::<re4_index::PlanarState>::table())
        .unwrap()
        .read_all()
        .unwrap();
    let retrievable = col_bool(&index, "retrievable").unwrap();
    let left_out: Vec<usize> = (0..FRAMES).filter(|&row| !retrievable.value(row)).collect();
    assert_eq!(left_out, wanted);
    let x = col_f64(&index, "object_x").unwrap();
    let between = |row: usize, fraction: f64| x[LENGTH + 9] + fraction * (x[LENGTH + 12] - x[LENGTH + 9]) - x[row];
    assert!(between(LENGTH + 10, 1.0 / 3.0).abs() < 1e-9 && between(LENGTH + 11, 2.0 / 3.0).abs() < 1e-9);
    assert_eq!(x[3 * LENGTH], x[3 * LENGTH + 1]);
    let chunks = place
        .artifact(Stage::Index)
        .table(re4_policy::Chunk::table())
        .unwrap()
        .read_all()
        .unwrap();
    let column = |name| col_u32(&chunks, name).unwrap();
    let (episode, first, last) = (column("episode"), column("first_frame"), column("last_frame"));
    let over = |demo: u32, frame: u32| {
        (0..episode.len())
            .filter(move |&i| episode[i] == demo && (first[i]..=last[i]).contains(&frame))
            .count()
    };
    assert_eq!((over(1, 10), over(1, 11), over(3, 0), over(4, 30)), (0, 0, 0, 0));
    let rolled = place.run("run image.toml --quiet").done();
    assert!(rolled.stdout.contains("6 rollouts"), "{}", rolled.stdout);
}

#[test]
fn images_without_usable_poses() {
    let mut refusals = String::new();
    let mut refuse = |name: &str, place: &Place, arguments: &str| {
        let refusal = place
            .run(&format!("train-pose image.toml --quiet {arguments}"))
            .refused();
        assert!(place.temporaries().is_empty(), "{:?}", place.temporaries());
        assert!(crate::support::folders_in(&place.artifacts().join("poses")).is_empty());
        refusals.extend([name, "\n  ", &refusal, "\n"]);
    };
    refuse("no images", &states_only(), "");
    let place = Place::new();
    write_pipeline(&place, "");
    refuse("12 x 12 images", &place, "");
    let place = with_images();
    let good: Vec<Vec<u8>> = states(&place).iter().map(render_state).collect();
    let changed = |change: fn(&mut [u8; 3])| -> Vec<Vec<u8>> {
        let mut images = good.clone();
        for pixel in images.iter_mut().flat_map(|image| image.as_chunks_mut::<3>().0) {
            change(pixel);
        }
        images
    };
    set_images(&place, OBSERVATION_SIDE, &changed(|pixel| pixel.swap(0, 2)));
    refuse("BGR", &place, "");
    set_images(
        &place,
        OBSERVATION_SIDE,
        &changed(|pixel| *pixel = pixel.map(|value| value / 255)),
    );
    refuse("values from 0 to 1", &place, "");
    set_images(&place, OBSERVATION_SIDE, &changed(|pixel| *pixel = [255; 3]));
    refuse("blank", &place, "");
    set_images(&place, OBSERVATION_SIDE, &good);
    refuse("goal outside", &place, "--set pose.goal=[500,256,0.8]");
    refuse("goal elsewhere", &place, "--set pose.goal=[276,256,0.8]");
    refuse("goal of no number", &place, "--set pose.goal=[nan,256,0.8]");
    let empty = render_state(&[25.0, 25.0, -900.0, -900.0, 0.0]);
    set_images(&place, OBSERVATION_SIDE, &vec![empty; FRAMES]);
    with_settings!({ filters => filters() }, { assert_snapshot!(refusals) });
    // If no frame shows a block, the poses artifact is made, but there is nothing to index.
    place.run("train-pose image.toml").done();
    let refusal = place.run("index image.toml --quiet").refused();
    assert!(refusal.contains("no frame has a clear pose"), "{refusal}");
}

#[test]
fn settings_that_contradict_each_other() {
    let place = states_only();
    let refusals: Vec<String> = [
        "small.toml --set variant=image",
        "small.toml --set pose.source=log_polar",
        "image.toml --no-images",
        "image.toml --set segment.rule=rigid_motion",
        "image.toml --set ingest.render=[\"image\",\"image\"]",
        "image.toml --set ingest.render=[\"agentview\"]",
    ]
    .iter()
    .map(|arguments| place.run(&format!("run {arguments}")).refused_at_once())
    .collect();
    assert_snapshot!(refusals.join("\n"));
}
