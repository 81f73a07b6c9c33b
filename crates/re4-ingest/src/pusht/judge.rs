//! Checks the numbers of a dataset, whatever its format, and converts them to the conventions of the original dataset.

use super::episodes::PushtEpisodes;
use super::follow;
use super::reader::{PushtOptions, PushtReading};
use super::settle::{lost_episodes, of_episodes, settle};
use super::validate::{self, Notes};
use crate::error::Fault;
use crate::left_out::OnBad;
use crate::zarr::Lost;

/// Judges the numbers as they are in the dataset. `lost` are rows that could not be read, `bad` faults of episodes, by their
/// indices, that the reader has found.
pub(super) fn judged(
    mut episodes: PushtEpisodes,
    mut notes: Notes,
    lost: Vec<Lost>,
    mut bad: Vec<(usize, Fault)>,
    options: &PushtOptions<'_>,
) -> Result<PushtReading, Fault> {
    bad.extend(validate::not_finite(&episodes));
    let mut unread = lost_episodes(&episodes, &lost);
    for (number, frames) in episodes.frames.iter().enumerate() {
        unread[number] |= frames.is_empty();
    }
    let is_good = |bad: &[(usize, Fault)]| {
        let mut good: Vec<bool> = unread.iter().map(|lost| !lost).collect();
        for (number, _) in bad {
            good[*number] = false;
        }
        good
    };

    let raw_actions = episodes.action.clone();
    let judgement = options.conventions.judge(&episodes, &is_good(&bad));
    let mut faults = judgement.faults;
    // Actions are checked against the positions in their most likely unit, so that faults of both are reported at once.
    let conventions = if faults.is_empty() {
        options.conventions
    } else {
        judgement.likely
    };
    notes.wrapped = conventions.convert(&mut episodes);
    bad.extend(judgement.small.into_iter().map(|number| {
        (
            number,
            Fault::Contradicts {
                episode: episodes.sources[number],
                what: format!(
                    "all positions of the block in {} are within 40 px of the window's corner, where the block cannot be",
                    episodes.recorded.states()
                ),
            },
        )
    }));
    let following = follow::judge(&conventions, &episodes, &raw_actions, &is_good(&bad));
    faults.extend(following.fault);
    notes.explained = following.explained;
    bad.extend(following.outliers.into_iter().map(|(number, fraction)| {
        (
            number,
            Fault::Contradicts {
                episode: episodes.sources[number],
                what: format!(
                    "{} explains {:.0} % of the change in the agent's steps",
                    episodes.recorded.actions(),
                    100.0 * fraction
                ),
            },
        )
    }));
    if !faults.is_empty() {
        if options.on_bad == OnBad::Refuse {
            faults.extend(lost.into_iter().map(|lost| lost.fault));
            bad.retain(|(_, fault)| matches!(fault, Fault::NotFinite { .. } | Fault::Lerobot(_)));
            faults.extend(of_episodes(bad, episodes.episode_count(), false));
        }
        return Err(Fault::of_all(faults).unwrap_or(Fault::NoEpisodes));
    }
    let no_numbers: Vec<usize> = bad
        .iter()
        .filter_map(|(number, fault)| matches!(fault, Fault::NotFinite { .. }).then_some(*number))
        .collect();
    // Rows that cannot be read are filled with zeros, so faults found in them would be meaningless.
    bad.extend(validate::faults(&episodes).into_iter().filter(|(number, fault)| {
        !(unread[*number] || no_numbers.contains(number) && matches!(fault, Fault::NotFinite { .. }))
    }));
    let read = lost_episodes(&episodes, &lost);
    bad.retain(|(number, _)| !read[*number]);
    bad.sort_by_key(|(number, _)| *number);
    settle(episodes, &notes, lost, bad, options)
}
