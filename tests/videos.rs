//! Videos of Push-T rollouts show the states in the artifact, rendered by the simulator's renderer.

use std::fs;

use crate::support::{Place, filters};
use gif::{ColorOutput, DecodeOptions};
use insta::{assert_snapshot, with_settings};
use re4_artifact::Row as _;
use re4_artifact::{Artifact, Stage, col_f64, col_u32};
use re4_geometry::{Point2, Pose2};
use re4_sim::{Canvas, render_state};

/// Colours of plans and replayed chunks in images.
const LINES: [[u8; 3]; 2] = [[214, 126, 20], [40, 80, 200]];

/// A folder with rollouts of the seeds 500 to 505, and the path of their artifact.
fn rollouts() -> (Place, String) {
    let place = Place::new();
    place.run("run small.toml --no-images").done();
    let key = place.artifact(Stage::Rollout).key().short();
    (place, format!("artifacts/rollouts/{key}"))
}

struct Video {
    width: usize,
    height: usize,
    /// Frames as a viewer shows them: colours, row by row.
    frames: Vec<Vec<[u8; 3]>>,
    /// Delays of the frames, in hundredths of a second.
    delays: Vec<u16>,
}

fn video(place: &Place, name: &str) -> Video {
    let file = fs::File::open(place.path().join(name)).unwrap();
    let mut options = DecodeOptions::new();
    options.set_color_output(ColorOutput::RGBA);
    let mut decoder = options.read_info(file).unwrap();
    let (width, height) = (usize::from(decoder.width()), usize::from(decoder.height()));
    let mut screen = vec![[0; 3]; width * height];
    let (mut frames, mut delays) = (Vec::new(), Vec::new());
    while let Some(frame) = decoder.read_next_frame().unwrap() {
        let (left, top) = (usize::from(frame.left), usize::from(frame.top));
        for (i, pixel) in frame.buffer.chunks(4).enumerate().filter(|(_, pixel)| pixel[3] > 0) {
            let (row, column) = (i / usize::from(frame.width), i % usize::from(frame.width));
            screen[(top + row) * width + left + column] = [pixel[0], pixel[1], pixel[2]];
        }
        frames.push(screen.clone());
        delays.push(frame.delay);
    }
    Video {
        width,
        height,
        frames,
        delays,
    }
}

/// Renders the states of a rollout before each step and after the last.
fn images(artifact: &Artifact, seed: u32) -> Vec<Canvas> {
    let results = crate::support::results(artifact);
    let steps = crate::support::steps(artifact);
    let row = |table, seed| col_u32(table, "seed").unwrap().iter().position(|s| *s == seed).unwrap();
    let state = |table, at: usize, names: [&str; 5]| {
        let [x, y, u, v, theta] = names.map(|name| col_f64(table, name).unwrap()[at]);
        render_state(Point2::new(x, y), Pose2::new(u, v, theta))
    };
    let at = row(&results, seed);
    let first = state(&results, at, ["eef_x", "eef_y", "object_x", "object_y", "object_theta"]);
    let start = row(&steps, seed);
    let count = col_u32(&results, "steps").unwrap()[at] as usize;
    let names = ["eef_x", "eef_y", "object_x", "object_y", "object_theta"];
    let others = (start..start + count).map(|at| state(&steps, at, names));
    std::iter::once(first).chain(others).collect()
}

#[test]
fn a_video_shows_every_state_of_the_rollout() {
    let (place, path) = rollouts();
    let answer = place.run(&format!("video {path} --seed 502 out.gif --size 512")).done();
    let video = video(&place, "out.gif");
    let images = images(&place.artifact(Stage::Rollout), 502);
    assert!(images.len() > 5);
    assert_eq!((video.width, video.height), (512, 512 + 56));
    assert_eq!(video.frames.len(), images.len());
    assert!(
        video.delays[..images.len() - 1].iter().all(|delay| *delay == 10),
        "the frame rate is not 10 per second"
    );
    for (i, (frame, image)) in video.frames.iter().zip(&images).enumerate() {
        let expected = image.bytes().as_chunks::<3>().0;
        let other: Vec<[u8; 3]> = frame
            .iter()
            .zip(expected)
            .filter(|(a, b)| a != b)
            .map(|(a, _)| *a)
            .collect();
        assert!(
            other.iter().all(|colour| LINES.contains(colour)),
            "frame {i} differs from the state"
        );
        assert!(
            !other.is_empty() && other.len() < 512 * 512 / 20,
            "frame {i}: lines of {} pixels",
            other.len()
        );
    }
    assert!(
        answer.stdout.starts_with("video written to out.gif: 512 x 568 px, "),
        "{}",
        answer.stdout
    );
}

#[test]
fn the_chunk_is_the_demonstration_moved_to_the_block() {
    let (place, path) = rollouts();
    place.run(&format!("video {path} --seed 503 out.gif --size 512")).done();
    let video = video(&place, "out.gif");
    let decisions = crate::support::decisions(&place.artifact(Stage::Rollout));
    let index = place
        .artifact(Stage::Index)
        .table(re4_index::IndexRow::<re4_index::PlanarState>::table())
        .unwrap()
        .read_all()
        .unwrap();
    let number = |table, name, at: usize| col_u32(table, name).unwrap()[at];
    let value = |table, name, at: usize| col_f64(table, name).unwrap()[at];
    let mut checked = 0;
    for at in (0..decisions.num_rows()).filter(|at| number(&decisions, "seed", *at) == 503) {
        let demo = number(&decisions, "demo", at);
        let [dx, dy, theta] = ["delta_x", "delta_y", "delta_theta"].map(|name| value(&decisions, name, at));
        let frame = &video.frames[number(&decisions, "step", at) as usize];
        for row in (0..index.num_rows()).filter(|row| {
            let chunk = number(&decisions, "demo_frame", at)..=number(&decisions, "demo_end", at);
            number(&index, "episode", *row) == demo && chunk.contains(&number(&index, "frame", *row))
        }) {
            let (x, y) = (value(&index, "eef_x", row), value(&index, "eef_y", row));
            let (x, y) = (
                theta.cos() * x - theta.sin() * y + dx,
                theta.sin() * x + theta.cos() * y + dy,
            );
            assert_eq!(
                frame[y.round() as usize * 512 + x.round() as usize],
                LINES[1],
                "decision {at}, {x}, {y}"
            );
            checked += 1;
        }
    }
    assert!(checked > 10, "{checked}");
}

#[test]
fn videos_are_small_and_the_same_in_every_run() {
    let (place, path) = rollouts();
    let bytes = |name: &str| fs::read(place.path().join(name)).unwrap();
    place.write("b.gif", "a file to be replaced");
    place.run(&format!("video {path} --seed 502 a.gif")).done();
    let answer = place
        .run(&format!("video {path} --seeds 502 b.gif --jobs 1 --json"))
        .done()
        .json();
    assert!(bytes("a.gif") == bytes("b.gif"));
    let video = video(&place, "a.gif");
    assert!(
        bytes("a.gif").len() < 2_000 * video.frames.len(),
        "{} bytes",
        bytes("a.gif").len()
    );
    let seconds: f64 = video.delays.iter().map(|delay| f64::from(*delay) / 100.0).sum();
    assert!((answer["seconds"].as_f64().unwrap() - seconds).abs() < 1e-9);
    for (key, expected) in [
        ("width", video.width),
        ("height", video.height),
        ("frames", video.frames.len()),
        ("bytes", bytes("b.gif").len()),
    ] {
        assert_eq!(answer[key].as_u64(), Some(expected as u64), "{key}");
    }
    assert_eq!(answer["chunks"], true);
    assert!(place.temporaries().is_empty());
}

#[test]
fn several_rollouts_share_a_video_at_another_speed() {
    let (place, path) = rollouts();
    place
        .run(&format!(
            "video {path} --seeds 501..504,500 out.gif --size 100 --speed 4"
        ))
        .done();
    let video = video(&place, "out.gif");
    assert_eq!((video.width, video.height), (200, 2 * 104));
    let artifact = place.artifact(Stage::Rollout);
    let longest = [501, 502, 503, 500]
        .map(|seed| images(&artifact, seed).len())
        .into_iter()
        .max()
        .unwrap();
    assert_eq!(video.frames.len(), longest);
    let total: u32 = video.delays[..longest - 1].iter().map(|delay| u32::from(*delay)).sum();
    assert_eq!(total, ((longest - 1) as f64 * 2.5).round() as u32);
}

#[test]
fn without_the_index_a_video_has_no_chunks_and_warns() {
    let (place, path) = rollouts();
    fs::rename(place.artifacts().join("index"), place.path().join("elsewhere")).unwrap();
    let answer = place.run(&format!("video {path} --seed 502 out.gif --size 512")).done();
    assert!(answer.stderr.contains("the video shows no chunks"), "{}", answer.stderr);
    let video = video(&place, "out.gif");
    let scene = |frame: &Vec<[u8; 3]>| frame[..512 * 512].to_vec();
    assert!(video.frames.iter().all(|frame| !scene(frame).contains(&LINES[1])));
    assert!(video.frames.iter().any(|frame| scene(frame).contains(&LINES[0])));
}

#[test]
fn videos_that_cannot_be_made() {
    let (place, path) = rollouts();
    let index = place.artifact(Stage::Index).key().short();
    place.write("kept.gif", "kept");
    fs::create_dir(place.path().join("folder.gif")).unwrap();
    let damaged = place.artifacts().join("rollouts/damaged");
    let mut sentences = Vec::new();
    for arguments in [
        format!("{path} --seed 9 kept.gif"),
        format!("{path} --seeds 503..507 kept.gif"),
        format!("{path} --seed 502 out.mp4"),
        format!("{path} --seed 502 out"),
        format!("{path} --seed 502 no/folder/out.gif"),
        format!("{path} --seed 502 folder.gif"),
        format!("{path} --seed 502 kept.gif --size 63"),
        format!("{path} --seed 502 kept.gif --size 513"),
        format!("{path} --seed 502 kept.gif --speed 0"),
        format!("{path} --seed 502 kept.gif --speed nan"),
        format!("artifacts/index/{index} --seed 502 kept.gif"),
        "artifacts/rollouts/absent --seed 502 kept.gif".to_owned(),
    ] {
        let sentence = place.run(&format!("video {arguments}")).refused_at_once();
        sentences.push(format!("video {arguments}\n  {sentence}"));
    }
    fs::rename(place.path().join(&path), &damaged).unwrap();
    let table = damaged.join("steps.parquet");
    let mut bytes = fs::read(&table).unwrap();
    bytes[100] ^= 1;
    fs::write(table, bytes).unwrap();
    let sentence = place
        .run("video artifacts/rollouts/damaged --seed 502 kept.gif")
        .refused_at_once();
    sentences.push(format!("a damaged table\n  {sentence}"));
    with_settings!({filters => filters()}, { assert_snapshot!(sentences.join("\n")) });
    assert_eq!(fs::read(place.path().join("kept.gif")).unwrap(), b"kept");
    assert!(place.temporaries().is_empty());
}
