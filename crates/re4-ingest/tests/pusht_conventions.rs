//! Other units and kinds of actions are refused by name, and read with the settings that declare them.
#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    reason = "helpers of tests may fail like tests"
)]

mod common;

use common::Copy;
use common::made::{Made, made};
use re4_ingest::pusht::{PushtConventions, PushtOptions, PushtReader, PushtReading};
use re4_ingest::{Selection, WarningCode};

fn read(copy: &Copy, settings: &str) -> Result<PushtReading, String> {
    let conventions: PushtConventions = serde_json::from_str(settings).unwrap();
    conventions.check().unwrap();
    let options = PushtOptions {
        conventions,
        ..PushtOptions::default()
    };
    PushtReader::open(&copy.path())
        .unwrap()
        .read(&Selection::All, &options)
        .map_err(|error| error.fault.to_string())
}

fn refusal(made: &Made, settings: &str) -> String {
    read(&made.store(), settings).expect_err("it should be refused")
}

/// Reads a dataset with settings. The numbers must equal those of `original` in pixels, radians and absolute targets.
fn check(made: &Made, settings: &str, original: &Made, tolerance: f64) -> PushtReading {
    let reading = read(&made.store(), settings).unwrap();
    let far = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
    for (frame, state) in reading.episodes.state.iter().enumerate() {
        let off = far(state, &original.state[frame]).max(far(&reading.episodes.action[frame], &original.action[frame]));
        assert!(off < tolerance, "{settings}: frame {frame} is off by {off}");
    }
    assert!(reading.explained.unwrap() > 0.9, "{settings}: {:?}", reading.explained);
    reading
}

fn scaled(low: f64, high: f64) -> impl Fn(usize, f64) -> f64 {
    move |column, value| match column {
        4 => value,
        _ => low + value / 512.0 * (high - low),
    }
}

const WORLD: (usize, usize) = (6, 90);

fn world() -> Made {
    made(WORLD.0, WORLD.1)
}

#[test]
fn data_in_the_original_conventions_is_unchanged() {
    let reading = check(&world(), "{}", &world(), 1e-4);
    assert!(reading.explained.unwrap() > 0.97, "{:?}", reading.explained);
    assert!(
        reading
            .warnings
            .iter()
            .all(|warning| warning.code != WarningCode::Convention)
    );
    // Fewer episodes are accepted, too, down to one.
    for episodes in 1..4 {
        check(&made(episodes, 120), "{}", &made(episodes, 120), 1e-4);
    }
}

#[test]
fn positions_in_other_units() {
    let cases = [
        ("[-1, 1]", -1.0, 1.0),
        ("[0, 1]", 0.0, 1.0),
        ("[0, 96]", 0.0, 96.0),
        ("[-256, 256]", -256.0, 256.0),
        ("[0, 1024]", 0.0, 1024.0),
        ("[0, 256]", 0.0, 256.0),
        ("[0, 0.3]", 0.0, 0.3),
        ("[-2.5, 2.5]", -2.5, 2.5),
    ];
    let mut sentences = Vec::new();
    for (window, low, high) in cases {
        let other = world().map(scaled(low, high));
        sentences.push(refusal(&other, "{}"));
        check(&other, &format!("{{\"window\": {window}}}"), &world(), 1e-2);
    }
    // Settings that contradict the data.
    for (low, high, settings) in [
        (0.0, 512.0, r#"{"window": [-1, 1]}"#),
        (0.0, 512.0, r#"{"window": [0, 96]}"#),
        (-1.0, 1.0, r#"{"window": [0, 1]}"#),
        (0.0, 1.0, r#"{"window": [-1, 1]}"#),
        (0.0, 96.0, r#"{"window": [0, 1]}"#),
        (0.0, 0.3, r#"{"window": [0, 1]}"#),
    ] {
        sentences.push(refusal(&world().map(scaled(low, high)), settings));
    }
    insta::assert_snapshot!(sentences.join("\n"));
}

#[test]
fn angles_in_other_units() {
    let degrees = || world().map(|column, value| if column == 4 { value.to_degrees() } else { value });
    let signed = || {
        world().map(|column, value| match column {
            4 if value > std::f64::consts::PI => value - std::f64::consts::TAU,
            _ => value,
        })
    };
    let full_rotations = || {
        world().map(|column, value| {
            if column == 4 {
                value - 2.0 * std::f64::consts::TAU
            } else {
                value
            }
        })
    };
    let normalised = world().map(|column, value| match column {
        4 => value / std::f64::consts::PI - 1.0,
        _ => scaled(-1.0, 1.0)(column, value),
    });
    let sentences = [
        refusal(&degrees(), "{}"),
        refusal(&world(), r#"{"angle": "degrees"}"#),
        refusal(&normalised, r#"{"window": [-1, 1]}"#),
        // Both at once.
        refusal(&degrees().map(scaled(-1.0, 1.0)), "{}"),
    ];
    insta::assert_snapshot!(sentences.join("\n"));
    check(&degrees(), r#"{"angle": "degrees"}"#, &world(), 1e-3);
    // Angles that differ by full rotations are wrapped; the unit is not in question.
    for (other, count) in [(signed(), 1..540), (full_rotations(), 540..541)] {
        let reading = check(&other, "{}", &world(), 1e-3);
        let wrapped = reading
            .warnings
            .iter()
            .find(|warning| warning.code == WarningCode::AngleWrapped);
        assert!(count.contains(&wrapped.unwrap().count));
    }
}

#[test]
fn actions_of_other_kinds() {
    let relative = |scale: f64| world().map_actions(move |_, agent, action| (action - agent) / scale);
    let other = |low: f64, high: f64| world().map_actions(move |_, _, action| low + action / 512.0 * (high - low));
    let by_axis = world().map_actions(|axis, _, action| {
        let [low, high] = [[12.0, 511.0], [90.0, 430.0]][axis];
        2.0 * (action - low) / (high - low) - 1.0
    });
    let mirrored = world().map_actions(|axis, _, action| if axis == 1 { 512.0 - action } else { action });
    let mut displacements = world();
    for episode in 0..WORLD.0 {
        let frames = displacements.frames(episode);
        for frame in frames.clone() {
            let next = (frame + 1).min(frames.end - 1);
            displacements.action[frame] =
                [0, 1].map(|axis| displacements.state[next][axis] - displacements.state[frame][axis]);
        }
    }
    let shifted = |by: isize| {
        let (original, mut moved) = (world(), world());
        for episode in 0..WORLD.0 {
            let frames = original.frames(episode);
            for frame in frames.clone() {
                let from = (frame as isize + by).clamp(frames.start as isize, frames.end as isize - 1);
                moved.action[frame] = original.action[from as usize];
            }
        }
        moved
    };
    let shuffled = {
        let mut other = world();
        let actions = other.action.clone();
        for (number, action) in other.action.iter_mut().enumerate() {
            *action = actions[number * 197 % actions.len()];
        }
        other
    };
    let sentences = [
        refusal(&relative(1.0), "{}"),
        refusal(&relative(100.0), "{}"),
        refusal(&relative(256.0), "{}"),
        refusal(&other(-1.0, 1.0), "{}"),
        refusal(&other(0.0, 96.0), "{}"),
        refusal(&other(-4.0, 3.0), "{}"),
        refusal(&other(12.0, 512.0 - 30.0), "{}"),
        refusal(&by_axis, "{}"),
        refusal(&by_axis, r#"{"action_window": [-1, 1]}"#),
        refusal(&mirrored, "{}"),
        refusal(&displacements, "{}"),
        refusal(&displacements, r#"{"action": "relative"}"#),
        refusal(&shifted(1), "{}"),
        refusal(&shifted(-1), "{}"),
        refusal(&shuffled, "{}"),
        // Settings that contradict the data.
        refusal(&world(), r#"{"action": "relative"}"#),
        refusal(&world(), r#"{"action_window": [-1, 1]}"#),
        refusal(&relative(100.0), r#"{"action": "relative"}"#),
        refusal(&relative(1.0), r#"{"action": "relative", "action_scale": 100}"#),
        refusal(&relative(1.0), r#"{"action_window": [-100, 100]}"#),
        // With the positions in another unit as well.
        refusal(
            &world()
                .map_actions(|_, agent, action| action - agent)
                .map(|column, value| match column {
                    5 | 6 => value / 256.0,
                    _ => scaled(-1.0, 1.0)(column, value),
                }),
            "{}",
        ),
    ];
    insta::assert_snapshot!(sentences.join("\n"));
    check(&relative(1.0), r#"{"action": "relative"}"#, &world(), 1e-3);
    check(
        &relative(100.0),
        r#"{"action": "relative", "action_scale": 100}"#,
        &world(),
        1e-2,
    );
    check(&other(-1.0, 1.0), r#"{"action_window": [-1, 1]}"#, &world(), 1e-3);
    check(&other(-4.0, 3.0), r#"{"action_window": [-4, 3]}"#, &world(), 1e-3);
}

/// A relative action of zeros means to stay, so a chunk of them may be omitted. An absolute action of zeros is the corner.
#[test]
fn a_chunk_of_relative_actions_may_be_omitted() {
    let mut relative = world().map_actions(|_, agent, action| action - agent);
    relative.action[200..210].fill([0.0; 2]);
    let frames = relative.state.len();
    let chunked = || {
        let copy = relative
            .store()
            .metadata("data/action", &[("chunks", serde_json::json!([10, 2]))]);
        relative
            .action
            .chunks(10)
            .enumerate()
            .fold(copy, |copy, (number, rows)| {
                let bytes: Vec<u8> = rows
                    .as_flattened()
                    .iter()
                    .flat_map(|&value| (value as f32).to_le_bytes())
                    .collect();
                copy.write(&format!("data/action/{number}.0"), bytes)
            })
    };
    let settings = r#"{"action": "relative"}"#;
    let whole = read(&chunked(), settings).unwrap();
    assert_eq!(whole.episodes.frame_count(), frames);
    let copy = chunked().remove("data/action/20.0");
    assert_eq!(read(&copy, settings).unwrap().episodes, whole.episodes);
    let sentence = read(&copy, "{}").unwrap_err();
    assert!(
        sentence.starts_with("2 problems were found: (1) data/action explains"),
        "{sentence}"
    );
    assert!(
        sentence.contains("(2) chunk 20.0 of array data/action is missing"),
        "{sentence}"
    );
}

/// Recordings with too little motion to judge are read unchanged.
#[test]
fn short_and_idle_recordings_are_not_judged() {
    for (episodes, frames) in [(1, 10), (1, 40), (3, 15)] {
        let relative = made(episodes, frames).map_actions(|_, agent, action| 0.2 * (action - agent));
        let reading = read(&relative.store(), "{}").unwrap();
        assert_eq!(reading.explained, None, "{episodes} of {frames}");
    }
    let mut idle = world();
    let first = idle.state[0];
    idle.state.fill(first);
    assert_eq!(read(&idle.store(), "{}").unwrap().explained, None);
}

#[test]
fn an_inconsistent_episode_is_reported() {
    let mut relative = world();
    for frame in relative.frames(2) {
        for axis in 0..2 {
            relative.action[frame][axis] -= relative.state[frame][axis];
        }
    }
    let mut unit = world();
    for frame in unit.frames(4) {
        for axis in 0..4 {
            unit.state[frame][axis] /= 512.0;
        }
    }
    insta::assert_snapshot!([refusal(&relative, "{}"), refusal(&unit, "{}")].join("\n"));
}

#[test]
fn weakly_followed_targets_cause_a_warning() {
    let mut noisy = world();
    for (number, action) in noisy.action.iter_mut().enumerate() {
        action[number % 2] += 45.0 * ((number * 37 % 11) as f64 - 5.0) / 5.0;
    }
    let reading = read(&noisy.store(), "{}").unwrap();
    let explained = reading.explained.unwrap();
    assert!((0.5..0.9).contains(&explained), "{explained}");
    let warning = reading
        .warnings
        .iter()
        .find(|warning| warning.code == WarningCode::Convention)
        .unwrap();
    assert!(
        warning.message.contains(&format!("explain {:.0} %", 100.0 * explained)),
        "{}",
        warning.message
    );
}

#[test]
fn seven_columns_are_read_if_the_last_two_are_the_velocity() {
    let world = world();
    let frames = world.state.len();
    let wide = |last: &dyn Fn(usize) -> [f64; 2]| {
        let values: Vec<f64> = (0..frames)
            .flat_map(|frame| world.state[frame].into_iter().chain(last(frame)))
            .collect();
        world.store().floats("data/state", &[frames, 7], &values)
    };
    let step = |frame: usize, axis: usize| world.state[(frame + 1).min(frames - 1)][axis] - world.state[frame][axis];
    let velocity = wide(&|frame| [10.0 * step(frame, 0), 10.0 * step(frame, 1)]);
    let reading = read(&velocity, "{}").unwrap();
    assert_eq!(reading.episodes, read(&world.store(), "{}").unwrap().episodes);
    assert!(
        reading
            .warnings
            .iter()
            .any(|warning| warning.code == WarningCode::SkippedColumns)
    );
    let sentences = [
        wide(&|_| [0.0, 0.0]),
        wide(&|frame| [10.0 * step(frame, 1), -10.0 * step(frame, 0)]),
        wide(&|frame| [world.state[frame][2], world.state[frame][3]]),
    ]
    .map(|copy| read(&copy, "{}").unwrap_err());
    insta::assert_snapshot!(sentences.join("\n"));
}
