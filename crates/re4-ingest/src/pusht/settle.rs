//! Decides about episodes that cannot be used: the dataset is refused, or they are left out.

use std::ops::Range;

use super::episodes::PushtEpisodes;
use super::reader::{PushtOptions, PushtReading};
use super::validate::{self, Notes};
use crate::error::Fault;
use crate::left_out::OnBad;
use crate::tables::LeftOut;
use crate::zarr::Lost;

/// Refuses the dataset because of faults, or leaves out the affected episodes, depending on the options.
pub(super) fn settle(
    episodes: PushtEpisodes,
    notes: &Notes,
    lost: Vec<Lost>,
    bad: Vec<(usize, Fault)>,
    options: &PushtOptions<'_>,
) -> Result<PushtReading, Fault> {
    let count = episodes.episode_count();
    let spread = |lost: &Lost| {
        let overlaps = |rows: &Range<usize>| {
            lost.rows
                .iter()
                .any(|lost| lost.start < rows.end as u64 && (rows.start as u64) < lost.end)
        };
        (0..count)
            .filter(|number| overlaps(&episodes.rows[*number]))
            .collect::<Vec<_>>()
    };
    let mut why: Vec<Option<String>> = vec![None; count];
    for lost in &lost {
        for number in spread(lost) {
            why[number].get_or_insert_with(|| lost.fault.to_string());
        }
    }
    for (number, fault) in &bad {
        why[*number].get_or_insert_with(|| fault.to_string());
    }
    let left = why.iter().filter(|why| why.is_none()).count();
    if left == count {
        let warnings = validate::warnings(&episodes, notes);
        return Ok(PushtReading {
            episodes,
            warnings,
            left_out: Vec::new(),
            explained: notes.explained,
        });
    }
    if options.on_bad == OnBad::LeaveOut && left > 0 {
        let (good, left_out) = without(&episodes, why);
        let warnings = validate::warnings(&good, notes);
        return Ok(PushtReading {
            episodes: good,
            warnings,
            left_out,
            explained: notes.explained,
        });
    }
    let mut faults: Vec<Fault> = lost.into_iter().map(|lost| lost.fault).collect();
    faults.extend(of_episodes(bad, count, left == 0));
    Err(Fault::of_all(faults).unwrap_or(Fault::NoEpisodes))
}

/// Combines faults of single episodes, given with their indices in ascending order; `None` if there are none.
pub(super) fn of_episodes(mut bad: Vec<(usize, Fault)>, episodes: usize, all: bool) -> Option<Fault> {
    if bad.len() < 2 {
        return bad.pop().map(|(_, fault)| fault);
    }
    let mut numbers: Vec<usize> = bad.iter().map(|(number, _)| *number).collect();
    numbers.dedup();
    let faults: Vec<Fault> = bad.into_iter().map(|(_, fault)| fault).collect();
    Some(Fault::of_episodes(&faults, numbers.len(), episodes, all))
}

/// Whether no row of the given runs can be read.
pub(super) fn covers(lost: &Lost, runs: &[Range<u64>]) -> bool {
    runs.iter().all(|run| {
        let next = lost.rows.partition_point(|rows| rows.end <= run.start);
        lost.rows
            .get(next)
            .is_some_and(|rows| rows.start <= run.start && run.end <= rows.end)
    })
}

/// Marks the episodes with rows that cannot be read.
pub(super) fn lost_episodes(episodes: &PushtEpisodes, lost: &[Lost]) -> Vec<bool> {
    let rows: Vec<&Range<u64>> = lost.iter().flat_map(|lost| &lost.rows).collect();
    episodes
        .rows
        .iter()
        .map(|here| {
            rows.iter()
                .any(|rows| rows.start < here.end as u64 && (here.start as u64) < rows.end)
        })
        .collect()
}

/// Separates the episodes into those without and those with a reason to leave them out.
fn without(episodes: &PushtEpisodes, why: Vec<Option<String>>) -> (PushtEpisodes, Vec<LeftOut>) {
    let mut good = PushtEpisodes {
        contacts: episodes.contacts.as_ref().map(|_| Vec::new()),
        keypoint: episodes.keypoint.as_ref().map(|_| Vec::new()),
        recorded: episodes.recorded.clone(),
        ..PushtEpisodes::default()
    };
    let mut left_out = Vec::new();
    for (number, why) in why.into_iter().enumerate() {
        if let Some(why) = why {
            left_out.push(LeftOut {
                demo: re4_episode::episode_name(episodes.sources[number]),
                why,
            });
            continue;
        }
        let frames = episodes.frames[number].clone();
        let start = good.state.len();
        good.sources.push(episodes.sources[number]);
        good.rows.push(episodes.rows[number].clone());
        good.frames.push(start..start + frames.len());
        good.state.extend_from_slice(&episodes.state[frames.clone()]);
        good.action.extend_from_slice(&episodes.action[frames.clone()]);
        if let (Some(good), Some(contacts)) = (&mut good.contacts, &episodes.contacts) {
            good.extend_from_slice(&contacts[frames.clone()]);
        }
        if let (Some(good), Some(keypoint)) = (&mut good.keypoint, &episodes.keypoint) {
            good.extend_from_slice(&keypoint[frames]);
        }
    }
    (good, left_out)
}
