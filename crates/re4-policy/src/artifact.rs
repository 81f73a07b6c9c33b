//! Loads the data of policies from an `index` artifact.

use std::collections::{BTreeMap, BTreeSet};

use re4_artifact::Artifact;
use re4_episode::{DemoNames, PlanarFrame};
use re4_geometry::spatial::Symmetry;
use re4_index::{IndexRow, IndexedFrame, Normalization, PlanarState, Range, RetrievalIndex, ScaleRow, SpatialState};

use crate::DemoSet;
use crate::config::{RetrieveConfig, Selector};
use crate::kinds::OpenError;
use crate::outcome::ChunkLibrary;
use crate::policy::Knowledge;
use crate::spatial::{SpatialDemoFrame, SpatialDemoSet, SpatialKnowledge, SpatialRetrieveConfig};

/// Loads the data of RE4 for Push-T. `names` are the names of the demonstrations.
pub(crate) fn open_index(
    artifact: &Artifact,
    retrieve: &RetrieveConfig,
    names: DemoNames,
) -> Result<Knowledge, OpenError> {
    let open_chunks = || -> Result<Option<ChunkLibrary>, OpenError> {
        Ok(match retrieve.selector {
            Selector::Outcome => Some(ChunkLibrary::build(artifact.read()?)?),
            Selector::TwoStage => None,
        })
    };
    let (states, chunks) = rayon::join(|| open_states(artifact, retrieve, names), open_chunks);
    let (demos, index) = states?;
    Ok(Knowledge {
        demos,
        index,
        chunks: chunks?,
    })
}

fn open_states(
    artifact: &Artifact,
    retrieve: &RetrieveConfig,
    names: DemoNames,
) -> Result<(DemoSet<PlanarFrame>, RetrievalIndex), OpenError> {
    let rows: Vec<IndexRow<PlanarState>> = artifact.read()?;
    let mut indexed = Vec::with_capacity(rows.len());
    let mut demos: Vec<(u32, Vec<PlanarFrame>)> = Vec::new();
    for row in rows {
        let PlanarState {
            eef, object, action, ..
        } = row.state;
        if row.retrievable.unwrap_or(true) {
            indexed.push(IndexedFrame {
                episode: row.episode,
                frame: row.frame,
                mode: row.mode,
                eef,
                object,
            });
        }
        let frame = PlanarFrame {
            eef,
            object,
            action,
            // Not stored in the index, because no policy uses it.
            contacts: f64::NAN,
        };
        match demos.last_mut().filter(|(number, _)| *number == row.episode) {
            Some((_, frames)) => frames.push(frame),
            None => demos.push((row.episode, vec![frame])),
        }
    }
    let normalization = Normalization {
        ranges: read_scales(artifact)?,
        angle: retrieve.angle,
    };
    let index = RetrievalIndex::with_normalization(indexed, normalization)
        .map_err(|error| error.named(|episode| names.get(episode).map(str::to_owned)))?;
    Ok((DemoSet::new(demos).with_names(names), index))
}

/// Reads the ranges that normalise the states of Push-T.
///
/// # Errors
/// If the table cannot be read or lists unexpected dimensions.
pub fn read_scales(artifact: &Artifact) -> Result<[Range; 5], OpenError> {
    let rows: Vec<ScaleRow> = artifact.read()?;
    let named = rows
        .iter()
        .map(|row| row.dimension.as_str())
        .eq(Normalization::DIMENSIONS);
    if !named {
        return Err(OpenError::Scales {
            folder: artifact.path().to_owned(),
        });
    }
    Ok(std::array::from_fn(|i| Range {
        minimum: rows[i].minimum,
        maximum: rows[i].maximum,
    }))
}

/// Loads the data of RE4 for a robosuite task. `names` are the names of the demonstrations.
pub(crate) fn open_spatial_index(
    artifact: &Artifact,
    retrieve: &SpatialRetrieveConfig,
    symmetry: Symmetry,
    names: DemoNames,
) -> Result<SpatialKnowledge, OpenError> {
    let mut demos: Vec<(u32, Vec<SpatialDemoFrame>)> = Vec::new();
    let mut recorded: BTreeMap<u32, Vec<u32>> = BTreeMap::new();
    let mut excluded = BTreeSet::new();
    for row in artifact.read::<IndexRow<SpatialState>>()? {
        let numbers = recorded.entry(row.episode).or_default();
        if row.retrievable == Some(false) {
            excluded.insert((row.episode, numbers.len() as u32));
        }
        numbers.push(row.frame);
        let frame = SpatialDemoFrame {
            eef: row.state.eef,
            object: row.state.object,
            goal: row.state.goal.into(),
            gripper: row.state.gripper,
            mode: row.mode,
        };
        match demos.last_mut().filter(|(number, _)| *number == row.episode) {
            Some((_, frames)) => frames.push(frame),
            None => demos.push((row.episode, vec![frame])),
        }
    }
    let knowledge = SpatialKnowledge::new(
        SpatialDemoSet::new(demos).with_names(names),
        retrieve,
        symmetry,
        |demo, frame| excluded.contains(&(demo, frame)),
    )?;
    Ok(knowledge.with_recorded_frames(recorded))
}
