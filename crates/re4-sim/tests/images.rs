//! Images equal those of gym-pusht 0.1.8 byte for byte: whole episodes are replayed, and every stored frame is compared at both
//! sizes.

#![expect(clippy::unwrap_used, reason = "helpers of a test may panic")]
#![expect(clippy::panic, reason = "helpers of a test may panic")]

use std::fmt::Write as _;
use std::path::{Path, PathBuf};

use re4_geometry::{Point2, Pose2};
use re4_sim::{Canvas, OBSERVATION_SIDE, PushT, ResetOrder, Scene, Simulator, render_state};
use serde::Deserialize;
use sha2::{Digest, Sha256};

#[derive(Deserialize)]
struct Reference {
    versions: serde_json::Map<String, serde_json::Value>,
    episodes: Vec<Episode>,
}

#[derive(Deserialize)]
struct Episode {
    scene: [f64; 5],
    actions: Vec<[f64; 2]>,
    frames: Vec<Frame>,
}

#[derive(Deserialize)]
struct Frame {
    step: usize,
    marked: bool,
    canvas: String,
    observation: String,
    image: Option<String>,
}

fn data() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data")
}

fn reference() -> Reference {
    let text = std::fs::read_to_string(data().join("reference_images.json")).unwrap();
    serde_json::from_str(&text).unwrap()
}

/// The first 16 bytes of the SHA-256, in hexadecimal digits.
fn hash_of(bytes: &[u8]) -> String {
    Sha256::digest(bytes)[..16]
        .iter()
        .fold(String::new(), |mut text, byte| {
            write!(text, "{byte:02x}").unwrap();
            text
        })
}

/// Replays an episode and calls `check` for each stored frame when the simulator is in its state.
fn replay(episode: &Episode, mut check: impl FnMut(&PushT, &Frame)) {
    let [agent_x, agent_y, x, y, theta] = episode.scene;
    let scene = Scene {
        agent: Point2::new(agent_x, agent_y),
        block: Pose2::new(x, y, theta),
    };
    let mut simulator = PushT::new().unwrap();
    simulator.reset(&scene, ResetOrder::Legacy).unwrap();
    let mut frames = episode.frames.iter().peekable();
    for step in 0..=episode.actions.len() {
        if step > 0 {
            let [target_x, target_y] = episode.actions[step - 1];
            simulator.step(&Point2::new(target_x, target_y)).unwrap();
        }
        if let Some(frame) = frames.next_if(|frame| frame.step == step) {
            check(&simulator, frame);
        }
    }
    assert!(frames.next().is_none(), "a frame is after the episode's end");
}

#[test]
fn every_frame_has_the_bytes_of_gym_pusht() {
    let reference = reference();
    assert_eq!(reference.versions["gym-pusht"], "0.1.8");
    let (mut canvas, mut observation) = (Canvas::new(), Vec::new());
    let (mut frames, mut marked, mut images) = (0, 0, 0);
    let mut wrong = Vec::new();
    for (number, episode) in reference.episodes.iter().enumerate() {
        replay(episode, |simulator, frame| {
            simulator.render_into(&mut canvas);
            canvas.observation_into(&mut observation);
            // The full images are compared first, because they show where a difference is.
            if let Some(name) = &frame.image {
                compare(name, &observation);
                images += 1;
            }
            if hash_of(canvas.bytes()) != frame.canvas || hash_of(&observation) != frame.observation {
                wrong.push((number, frame.step));
            }
            let observed = simulator.observation();
            let unmarked = render_state(observed.agent, observed.block);
            assert_eq!(
                unmarked != canvas,
                frame.marked,
                "marks of episode {number}, step {}",
                frame.step
            );
            frames += 1;
            marked += usize::from(frame.marked);
        });
    }
    assert!(
        wrong.is_empty(),
        "{} of {frames} frames differ (episode, step): {wrong:?}",
        wrong.len()
    );
    // The comparison is meaningful only with many frames, most of them with contact marks.
    assert!(
        frames >= 200 && 2 * marked >= frames && images >= 5,
        "{frames} {marked} {images}"
    );
}

/// Panics with the first pixel at which an observation differs from the stored image.
fn compare(name: &str, observation: &[u8]) {
    let expected = image::open(data().join("images").join(name)).unwrap().to_rgb8();
    let pairs = expected.chunks_exact(3).zip(observation.chunks_exact(3));
    if let Some((at, (expected, found))) = pairs.enumerate().find(|(_, (expected, found))| expected != found) {
        let (row, column) = (at / OBSERVATION_SIDE, at % OBSERVATION_SIDE);
        panic!("{name}, row {row}, column {column}: {found:?}, not {expected:?}");
    }
    assert_eq!(expected.len(), observation.len());
}

#[test]
fn a_reused_canvas_gives_the_same_image_as_a_new_one() {
    let reference = reference();
    let mut used = Canvas::new();
    for episode in &reference.episodes[..4] {
        replay(episode, |simulator, _| {
            simulator.render_into(&mut used);
            assert_eq!(used, simulator.render());
            assert_eq!(used.bytes().len(), Canvas::SIDE * Canvas::SIDE * 3);
            assert_eq!(used.observation().len(), OBSERVATION_SIDE * OBSERVATION_SIDE * 3);
        });
    }
}

#[test]
fn shapes_far_away_or_not_finite_are_not_rendered() {
    let away = render_state(Point2::new(-500.0, 900.0), Pose2::new(5000.0, -5000.0, 1.0));
    // Only goal and walls are visible.
    assert!(away.bytes().chunks_exact(3).all(|pixel| {
        [[255, 255, 255], [144, 238, 144], [211, 211, 211]].contains(&[pixel[0], pixel[1], pixel[2]])
    }));
    for odd in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY, f64::MAX, f64::MIN] {
        for place in 0..3 {
            let coordinate = |i| if i == place { odd } else { 200.0 };
            let block = Pose2::new(coordinate(0), coordinate(1), coordinate(2));
            let image = render_state(Point2::new(coordinate(0), coordinate(1)), block);
            if odd.is_nan() || (odd.is_infinite() && place == 2) {
                let agent_only = render_state(Point2::new(coordinate(0), coordinate(1)), Pose2::new(9e9, 9e9, 0.0));
                assert!(image == agent_only, "{odd} in place {place}");
            }
        }
    }
    // Partly outside: no panic on any side, and a part of the block is visible.
    for (x, y) in [
        (-20.0, 250.0),
        (530.0, 250.0),
        (250.0, -20.0),
        (250.0, 530.0),
        (0.0, 0.0),
        (511.0, 511.0),
    ] {
        let visible = (0..16).filter(|&i| {
            let block = Pose2::new(x, y, f64::from(i) * 0.4);
            render_state(Point2::new(x, y), block) != away
        });
        assert!(visible.count() > 0, "nothing is visible at {x}, {y}");
    }
}
