//! Push-T's zarr store.

use anyhow::Result;
use re4_episode::PlanarFrame;
use re4_fault::{ensure, fault};
use re4_ingest::pusht::{PushtWriter, RecordedEpisode};

use crate::inputs::Inputs;
use crate::{Exported, Format, Hooks, Request, plane};

/// Writes the store.
pub(crate) fn write(inputs: &Inputs, request: &Request<'_>, hooks: Hooks<'_>) -> Result<Exported> {
    inputs.require(Format::PushtZarr, true)?;
    let mut episodes = Vec::new();
    plane::read(inputs, |take| {
        ensure!(!(hooks.stop)(), "the export was stopped"; "run again");
        let frames = take.frames.iter().map(|frame| {
            let object = frame.object.ok_or_else(|| {
                fault!(
                    "the format {} needs the block's pose, which {} does not have", Format::PushtZarr.name(), take.name;
                    "use --format lerobot"
                )
            })?;
            Ok(PlanarFrame {
                eef: frame.eef,
                object,
                action: frame.action,
                contacts: frame.contacts.unwrap_or(f64::NAN),
            })
        });
        let frames = frames.collect::<Result<_>>()?;
        episodes.push(RecordedEpisode { frames });
        Ok(())
    })?;
    (hooks.progress)(0, episodes.len());
    PushtWriter::write(request.out, &episodes)?;
    (hooks.progress)(episodes.len(), episodes.len());
    let names = [
        "data/action",
        "data/state",
        "data/keypoint",
        "data/n_contacts",
        "meta/episode_ends",
    ];
    Ok(Exported {
        episodes: episodes.len(),
        frames: episodes.iter().map(|episode| episode.frames.len()).sum(),
        bytes: super::size(request.out)?,
        features: names.map(str::to_owned).to_vec(),
        notes: vec!["the store has no images".to_owned()],
    })
}
