//! What a Push-T recording can hold, and what is odd in one.

use std::f64::consts::{PI, TAU};
use std::ops::Range;

use super::episodes::{KEYPOINTS, PushtEpisodes};
use crate::error::Fault;
use crate::warning::{Warning, WarningCode};

/// Smallest accepted coordinate in pixels. The window is 0 to 512; agent, block and target cannot leave it by more than
/// the block's size, so what lies beyond is another unit or another dataset.
pub const POSITION_LOW: f64 = -100.0;
/// Largest accepted coordinate in pixels.
pub const POSITION_HIGH: f64 = 700.0;
/// How far an angle may lie outside of 0 to 2π: 2π rounded to f32 is already 1.7e-7 too large.
pub const ANGLE_TOLERANCE: f64 = 1e-5;
/// Side of the window in pixels.
pub const WINDOW: f64 = 512.0;
/// Episodes with fewer frames get a warning.
pub const SHORT_EPISODE: usize = 10;

const STATE_COLUMNS: [&str; 5] = ["agent_x", "agent_y", "block_x", "block_y", "block_theta"];
const ACTION_COLUMNS: [&str; 2] = ["action_x", "action_y"];
const THETA: usize = 4;

/// Turns exclusive cumulative ends into frames of episodes.
pub(super) fn episode_ranges(ends: &[i128], frames: u64) -> Result<Vec<Range<usize>>, Fault> {
    let mut previous = 0;
    let mut ranges = Vec::with_capacity(ends.len());
    for (index, &value) in ends.iter().enumerate() {
        if value < 0 {
            return Err(Fault::NegativeEnd { index, value });
        }
        if value <= previous {
            return Err(Fault::EndsNotIncreasing { index, value, previous });
        }
        ranges.push(previous as usize..value as usize);
        previous = value;
    }
    match ends.len().checked_sub(1) {
        None => Err(Fault::NoEpisodes),
        Some(index) if previous != i128::from(frames) => Err(Fault::EndsDoNotMatch {
            index,
            last: previous,
            frames,
        }),
        Some(_) => Ok(ranges),
    }
}

/// Where a frame of the columns lies in the dataset.
struct Place {
    frame: u64,
    episode: u32,
}

/// Every frame of the columns with its place, in order.
fn places(episodes: &PushtEpisodes) -> impl Iterator<Item = Place> {
    episodes
        .sources
        .iter()
        .zip(&episodes.rows)
        .flat_map(|(&episode, rows)| {
            rows.clone().map(move |frame| Place {
                frame: frame as u64,
                episode,
            })
        })
}

/// Accepted values of a column.
#[derive(Clone, Copy)]
struct Bounds {
    low: f64,
    high: f64,
    unit: &'static str,
}

const PIXELS: Bounds = Bounds {
    low: POSITION_LOW,
    high: POSITION_HIGH,
    unit: "pixels",
};
const RADIANS: Bounds = Bounds {
    low: 0.0,
    high: TAU,
    unit: "radians",
};

fn check_row(array: &str, place: &Place, row: &[f64], column: impl Fn(usize) -> (String, Bounds)) -> Result<(), Fault> {
    for (number, &value) in row.iter().enumerate() {
        let Place { frame, episode } = *place;
        let (name, Bounds { low, high, unit }) = column(number);
        if !value.is_finite() {
            return Err(Fault::NotFinite {
                array: array.to_owned(),
                frame,
                episode,
                column: number,
                name,
                value,
            });
        }
        let slack = if unit == RADIANS.unit { ANGLE_TOLERANCE } else { 0.0 };
        if !(low - slack..=high + slack).contains(&value) {
            return Err(Fault::OutOfRange {
                array: array.to_owned(),
                frame,
                episode,
                column: number,
                name,
                value,
                low,
                high,
                unit,
            });
        }
    }
    Ok(())
}

/// Refuses values no recording can have.
pub(super) fn values(episodes: &PushtEpisodes) -> Result<(), Fault> {
    for (place, row) in places(episodes).zip(&episodes.state) {
        check_row("data/state", &place, row, |column| {
            (
                STATE_COLUMNS[column].to_owned(),
                if column == THETA { RADIANS } else { PIXELS },
            )
        })?;
    }
    for (place, row) in places(episodes).zip(&episodes.action) {
        check_row("data/action", &place, row, |column| {
            (ACTION_COLUMNS[column].to_owned(), PIXELS)
        })?;
    }
    for (place, &value) in places(episodes).zip(episodes.contacts.iter().flatten()) {
        if !value.is_finite() || value < 0.0 || value.fract() != 0.0 {
            return Err(Fault::NotACount {
                frame: place.frame,
                episode: place.episode,
                value,
            });
        }
    }
    for (place, points) in places(episodes).zip(episodes.keypoint.iter().flatten()) {
        let row: [f64; 2 * KEYPOINTS] = std::array::from_fn(|i| points[i / 2][i % 2]);
        check_row("data/keypoint", &place, &row, |column| {
            (
                format!("{} of point {}", if column % 2 == 0 { "x" } else { "y" }, column / 2),
                PIXELS,
            )
        })?;
    }
    Ok(())
}

/// Collects what is odd, one warning a kind, in the order of [`WarningCode`].
pub(super) fn warnings(episodes: &PushtEpisodes, has_images: bool) -> Vec<Warning> {
    let steps = |odd: &dyn Fn(usize) -> bool| in_episodes(episodes, |start, frame| frame > start && odd(frame));
    let seam = steps(&|frame| (episodes.state[frame][THETA] - episodes.state[frame - 1][THETA]).abs() > PI);
    let outside = in_episodes(episodes, |_, frame| {
        episodes.action[frame]
            .iter()
            .any(|coordinate| !(0.0..=WINDOW).contains(coordinate))
    });
    let repeated = steps(&|frame| episodes.state[frame] == episodes.state[frame - 1]);
    let short: Vec<u32> = episodes
        .sources
        .iter()
        .zip(&episodes.rows)
        .filter(|(_, rows)| rows.len() < SHORT_EPISODE)
        .map(|(&source, _)| source)
        .collect();

    let mut warnings = Vec::new();
    let mut found = |code, at: Option<&(u32, u64)>, count: usize, message: String| {
        if count > 0 {
            warnings.push(Warning {
                code,
                message,
                episode: at.map(|at| at.0),
                frame: at.map(|at| at.1),
                count: count as u64,
            });
        }
    };
    let count = seam.len();
    found(
        WarningCode::AngleSeam,
        seam.first(),
        count,
        format!(
            "the block angle crosses the seam between 0 and 2π {count} times inside episodes; compare angles on the circle"
        ),
    );
    let count = outside.len();
    found(
        WarningCode::ActionOutsideWindow,
        outside.first(),
        count,
        format!("{count} actions lie outside of the window (0 to {WINDOW} pixels)"),
    );
    let count = short.len();
    found(
        WarningCode::ShortEpisode,
        short.first().map(|&episode| (episode, 0)).as_ref(),
        count,
        format!("{count} episodes have fewer than {SHORT_EPISODE} frames"),
    );
    let count = repeated.len();
    found(
        WarningCode::RepeatedState,
        repeated.first(),
        count,
        format!("{count} frames repeat the state of the frame before them"),
    );
    let absent = |present: bool| usize::from(!present);
    found(
        WarningCode::NoContacts,
        None,
        absent(episodes.contacts.is_some()),
        "the dataset has no data/n_contacts: contacts are unknown".to_owned(),
    );
    found(
        WarningCode::NoKeypoints,
        None,
        absent(episodes.keypoint.is_some()),
        "the dataset has no data/keypoint".to_owned(),
    );
    found(
        WarningCode::NoImages,
        None,
        absent(has_images),
        "the dataset has no data/img".to_owned(),
    );
    warnings
}

/// Episode and frame within it of every frame for which `odd(first frame of its episode, frame)` holds.
fn in_episodes(episodes: &PushtEpisodes, odd: impl Fn(usize, usize) -> bool) -> Vec<(u32, u64)> {
    episodes
        .sources
        .iter()
        .zip(&episodes.frames)
        .flat_map(|(&source, frames)| {
            let start = frames.start;
            frames
                .clone()
                .filter(|&frame| odd(start, frame))
                .map(move |frame| (source, (frame - start) as u64))
                .collect::<Vec<_>>()
        })
        .collect()
}
