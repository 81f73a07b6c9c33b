//! Checks of values in Push-T recordings, and warnings about them.

use std::f64::consts::{PI, TAU};
use std::ops::Range;

use super::episodes::PushtEpisodes;
use crate::error::Fault;
use crate::tables::KEYPOINTS;
use crate::warning::{Warning, WarningCode};

/// Smallest accepted coordinate in pixels. The window is 0 to 512. Agent, block and target cannot leave it by more than
/// the size of the block, so values outside this range are in another unit or from another dataset.
pub const POSITION_LOW: f64 = -100.0;
/// Largest accepted coordinate in pixels.
pub const POSITION_HIGH: f64 = 700.0;
/// Tolerance of the range 0 to 2π of angles: 2π rounded to f32 is already 1.7e-7 too large.
pub const ANGLE_TOLERANCE: f64 = 1e-5;
/// Side of the window in pixels.
pub const WINDOW: f64 = 512.0;
/// Episodes with fewer frames cause a warning.
pub const SHORT_EPISODE: usize = 10;

const STATE_COLUMNS: [&str; 5] = ["agent_x", "agent_y", "block_x", "block_y", "block_theta"];
const ACTION_COLUMNS: [&str; 2] = ["action_x", "action_y"];
const THETA: usize = 4;

/// Converts exclusive cumulative ends to the frames of episodes. `None` is a number that is not an integer.
pub(super) fn episode_ranges(ends: &[Option<i128>], frames: u64) -> Result<Vec<Range<usize>>, Fault> {
    let mut previous = 0;
    let mut ranges = Vec::with_capacity(ends.len());
    for (index, &value) in ends.iter().enumerate() {
        let value = value.ok_or(Fault::FractionalEnd { index })?;
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

/// The place of a frame in the dataset.
struct Place {
    frame: u64,
    episode: u32,
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

fn check_row(
    array: &str,
    place: &Place,
    row: &[f64],
    bounds: impl Fn(usize) -> Bounds,
    name: impl Fn(usize) -> String,
) -> Result<(), Fault> {
    for (number, &value) in row.iter().enumerate() {
        let Place { frame, episode } = *place;
        let Bounds { low, high, unit } = bounds(number);
        let name = || name(number);
        if !value.is_finite() {
            return Err(Fault::NotFinite {
                array: array.to_owned(),
                frame,
                episode,
                column: number,
                name: name(),
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
                name: name(),
                value,
                low,
                high,
                unit,
            });
        }
    }
    Ok(())
}

/// Refuses values that no recording can have.
pub(super) fn values(episodes: &PushtEpisodes) -> Result<(), Fault> {
    faults(episodes)
        .into_iter()
        .next()
        .map_or(Ok(()), |(_, fault)| Err(fault))
}

/// The first invalid value of every episode in each array, array by array, with the index of the episode.
pub(super) fn faults(episodes: &PushtEpisodes) -> Vec<(usize, Fault)> {
    let mut faults = states_and_actions(episodes, state_bounds, PIXELS);
    first_of_each(
        &mut faults,
        episodes,
        episodes.contacts.as_deref().unwrap_or_default(),
        |place, &value| {
            if value.is_finite() && value >= 0.0 && value.fract() == 0.0 {
                return Ok(());
            }
            Err(Fault::NotACount {
                frame: place.frame,
                episode: place.episode,
                value,
            })
        },
    );
    first_of_each(
        &mut faults,
        episodes,
        episodes.keypoint.as_deref().unwrap_or_default(),
        |place, points| {
            let row: [f64; 2 * KEYPOINTS] = std::array::from_fn(|i| points[i / 2][i % 2]);
            check_row(
                "array data/keypoint",
                place,
                &row,
                |_| PIXELS,
                |column| format!("{} of point {}", if column % 2 == 0 { "x" } else { "y" }, column / 2),
            )
        },
    );
    faults
}

/// The first state or action of every episode that is not finite, with the index of the episode.
pub(super) fn not_finite(episodes: &PushtEpisodes) -> Vec<(usize, Fault)> {
    let any = Bounds {
        low: f64::MIN,
        high: f64::MAX,
        unit: "",
    };
    states_and_actions(episodes, |_| any, any)
}

/// The first state and action of every episode outside the given bounds; those of states depend on the column.
fn states_and_actions(
    episodes: &PushtEpisodes,
    state: impl Fn(usize) -> Bounds,
    action: Bounds,
) -> Vec<(usize, Fault)> {
    let mut faults = Vec::new();
    let (states, actions) = (episodes.recorded.states(), episodes.recorded.actions());
    first_of_each(&mut faults, episodes, &episodes.state, |place, row| {
        let name = |column: usize| STATE_COLUMNS[column].to_owned();
        check_row(&states, place, row, &state, name)
    });
    first_of_each(&mut faults, episodes, &episodes.action, |place, row| {
        let name = |column: usize| ACTION_COLUMNS[column].to_owned();
        check_row(&actions, place, row, |_| action, name)
    });
    faults
}

fn state_bounds(column: usize) -> Bounds {
    if column == THETA { RADIANS } else { PIXELS }
}

/// Appends the first fault of each episode in a column of rows; the column is empty if the array does not exist.
fn first_of_each<T>(
    faults: &mut Vec<(usize, Fault)>,
    episodes: &PushtEpisodes,
    column: &[T],
    check: impl Fn(&Place, &T) -> Result<(), Fault>,
) {
    if column.is_empty() {
        return;
    }
    let episodes = episodes.sources.iter().zip(&episodes.rows).zip(&episodes.frames);
    faults.extend(episodes.enumerate().filter_map(|(number, ((&episode, rows), frames))| {
        let places = rows.clone().map(|frame| Place {
            frame: frame as u64,
            episode,
        });
        let first = places
            .zip(&column[frames.clone()])
            .find_map(|(place, row)| check(&place, row).err());
        first.map(|fault| (number, fault))
    }));
}

/// Collects warnings, one per kind, in the order of [`WarningCode`].
pub(super) fn warnings(episodes: &PushtEpisodes, notes: &Notes) -> Vec<Warning> {
    let steps = |unusual: &dyn Fn(usize) -> bool| in_episodes(episodes, |start, frame| frame > start && unusual(frame));
    let seam = steps(&|frame| (episodes.state[frame][THETA] - episodes.state[frame - 1][THETA]).abs() > PI);
    let outside = in_episodes(episodes, |_, frame| {
        episodes.action[frame]
            .iter()
            .any(|coordinate| !(0.0..=WINDOW).contains(coordinate))
    });
    // Without the block, an agent that waits repeats its state.
    let repeated = steps(&|frame| episodes.recorded.block && episodes.state[frame] == episodes.state[frame - 1]);
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
                episode: at.map(|at| at.0),
                frame: at.map(|at| at.1),
                ..Warning::new(code, message, count)
            });
        }
    };
    let count = seam.len();
    found(
        WarningCode::AngleSeam,
        seam.first(),
        count,
        format!(
            "the block angle wraps between 0 and 2π {count} times inside episodes; compute differences of angles modulo 2π"
        ),
    );
    let count = outside.len();
    found(
        WarningCode::ActionOutsideWindow,
        outside.first(),
        count,
        format!("{count} actions are outside the window (0 to {WINDOW} pixels)"),
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
    let absent = |present: bool| usize::from(!present && episodes.recorded.is_zarr());
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
        absent(notes.has_images),
        "the dataset has no data/img".to_owned(),
    );
    warnings.extend(noted(notes));
    warnings
}

/// Warnings from observations made while reading.
fn noted(notes: &Notes) -> Vec<Warning> {
    let mut warnings = Vec::new();
    let mut found = |code, count: usize, message: String| {
        if count > 0 {
            warnings.push(Warning::new(code, message, count));
        }
    };
    found(
        WarningCode::AngleWrapped,
        notes.wrapped,
        format!(
            "{} block angles were outside 0 to 2π and were wrapped to that range",
            notes.wrapped
        ),
    );
    found(
        WarningCode::AbsentChunks,
        notes.absent_chunks as usize,
        format!(
            "{} chunks are not stored and were read as the fill value, as the zarr specification requires; newer writers omit such chunks, but an incomplete copy looks the same",
            notes.absent_chunks
        ),
    );
    found(
        WarningCode::SkippedColumns,
        2 * usize::from(notes.velocity),
        "data/state has the agent's velocity in two additional columns, which are not ingested".to_owned(),
    );
    let weak = notes.explained.filter(|explained| *explained < super::follow::USUAL);
    found(
        WarningCode::Convention,
        usize::from(weak.is_some()),
        format!(
            "the targets explain {:.0} % of the change in the agent's steps, but 99.6 % in the original dataset: the controller or the rate differs, or the data is noisy",
            100.0 * weak.unwrap_or_default()
        ),
    );
    warnings
}

/// Observations made while reading.
#[derive(Debug, Clone, Default)]
pub(super) struct Notes {
    /// Whether the array of images exists.
    pub(super) has_images: bool,
    /// Number of block angles that were wrapped to 0 to 2π.
    pub(super) wrapped: usize,
    /// Number of chunks that are not stored and were read as fill values.
    pub(super) absent_chunks: u64,
    /// Whether states include the agent's velocity.
    pub(super) velocity: bool,
    /// Fraction of the change in the agent's steps that the targets explain; `None` if there is too little motion.
    pub(super) explained: Option<f64>,
}

/// Episode, and frame within it, of every frame for which `unusual(first frame of its episode, frame)` returns true.
fn in_episodes(episodes: &PushtEpisodes, unusual: impl Fn(usize, usize) -> bool) -> Vec<(u32, u64)> {
    episodes
        .sources
        .iter()
        .zip(&episodes.frames)
        .flat_map(|(&source, frames)| {
            let start = frames.start;
            frames
                .clone()
                .filter(|&frame| unusual(start, frame))
                .map(move |frame| (source, (frame - start) as u64))
                .collect::<Vec<_>>()
        })
        .collect()
}

/// Minimum number of steps with motion for deciding whether two columns are a velocity.
const MIN_STEPS: usize = 20;

/// Minimum cosine similarity between steps and velocities. It exceeds 0.95 for the simulator's velocities and for differences of
/// positions.
const MIN_SIMILARITY: f64 = 0.8;

/// Accepts the last two of seven columns if they are proportional to the agent's steps, as its velocity is in any unit.
pub(super) fn velocity(states: &[[f64; 7]], frames: &[Range<usize>]) -> Result<(), Fault> {
    let columns = |why: String| Fault::StateColumns { why };
    let (mut steps, mut velocities, mut products, mut moving) = (0.0, 0.0, 0.0, 0);
    // The ends of episodes are excluded: velocities computed by differences over the whole array are wrong there.
    for frame in frames
        .iter()
        .flat_map(|frames| frames.start + 1..frames.end.saturating_sub(1))
    {
        let [before, here, after] = [frame - 1, frame, frame + 1].map(|frame| states[frame]);
        for (position, velocity) in [(0, 5), (1, 6)] {
            let (step, velocity) = (after[position] - before[position], here[velocity]);
            if step.is_finite() && velocity.is_finite() {
                steps += step * step;
                velocities += velocity * velocity;
                products += step * velocity;
                moving += usize::from(step != 0.0);
            }
        }
    }
    if moving < MIN_STEPS {
        return Err(columns(format!(
            "the agent moves in only {moving} steps, too few to decide"
        )));
    }
    let similarity = products / (steps * velocities).sqrt();
    if similarity >= MIN_SIMILARITY {
        return Ok(());
    }
    let similarity = if similarity.is_finite() { similarity } else { 0.0 };
    Err(columns(format!(
        "their cosine similarity to the agent's steps is {similarity:.2}, and that of a velocity is near 1"
    )))
}
