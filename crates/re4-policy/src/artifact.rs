//! What policies know, out of an `index` artifact.

use std::collections::BTreeSet;

use nalgebra::Isometry3;
use re4_artifact::{Artifact, SixAxis, columns, tables};
use re4_episode::{DemoNames, Mode, PlanarFrame};
use re4_geometry::spatial::Symmetry;
use re4_geometry::{Point2, Pose2};
use re4_index::{IndexedFrame, Normalization, Range, RetrievalIndex};

use crate::DemoSet;
use crate::config::{RetrieveConfig, Selector};
use crate::kinds::OpenError;
use crate::outcome::{Chunk, ChunkLibrary};
use crate::policy::Knowledge;
use crate::spatial::{SpatialDemoFrame, SpatialDemoSet, SpatialKnowledge, SpatialRetrieveConfig};

columns! {
    /// A frame of Push-T as it is searched and replayed.
    pub struct PlaneFrame {
        /// Demonstration.
        pub episode: u32,
        /// Frame.
        pub frame: u32,
        /// Mode.
        pub mode: Mode,
        /// Pusher's centre.
        pub eef: Point2,
        /// Pose of the block.
        pub object: Pose2,
        /// Target sent.
        pub action: Point2,
        /// Whether it may be retrieved; null in artifacts of older versions, whose frames all may.
        pub retrievable: Option<bool>,
    }
}

columns! {
    /// A frame of a robosuite task as it is searched and replayed.
    pub struct SpaceFrame {
        /// Demonstration.
        pub episode: u32,
        /// Frame.
        pub frame: u32,
        /// Mode.
        pub mode: Mode,
        /// Grip site.
        pub eef: Isometry3<f64>,
        /// Pose of the object.
        pub object: Isometry3<f64>,
        /// Goal of the grip site.
        pub goal: SixAxis,
        /// Gripper command.
        pub gripper: f64,
        /// Whether it may be retrieved.
        pub retrievable: bool,
    }
}

columns! {
    /// A chunk.
    pub struct ChunkColumns {
        /// Demonstration.
        pub episode: u32,
        /// First frame.
        pub first_frame: u32,
        /// Last frame.
        pub last_frame: u32,
        /// Motion of the block.
        pub motion: Pose2,
        /// Length of the pusher's path.
        pub travel: f64,
        /// Length of the block's path.
        pub pushed: f64,
    }
}

columns! {
    /// The range of a dimension.
    pub struct Scale {
        /// Its name.
        pub dimension: String,
        /// Least value.
        pub minimum: f64,
        /// Greatest value.
        pub maximum: f64,
    }
}

/// The frames of an `index` artifact of Push-T.
///
/// # Errors
/// When it cannot be read.
pub fn plane_frames(index: &Artifact) -> Result<Vec<PlaneFrame>, OpenError> {
    Ok(index.table(&tables::INDEX)?.read()?)
}

/// The frames of an `index` artifact of a robosuite task.
///
/// # Errors
/// When it cannot be read.
pub fn space_frames(index: &Artifact) -> Result<Vec<SpaceFrame>, OpenError> {
    Ok(index.table(&tables::SPATIAL_INDEX)?.read()?)
}

/// What RE4 knows of Push-T, from demonstrations of these names.
pub(crate) fn open_index(
    artifact: &Artifact,
    retrieve: &RetrieveConfig,
    names: DemoNames,
) -> Result<Knowledge, OpenError> {
    let open_chunks = || -> Result<Option<ChunkLibrary>, OpenError> {
        Ok(match retrieve.selector {
            Selector::Outcome => Some(ChunkLibrary::build(read_chunks(artifact)?)?),
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
) -> Result<(DemoSet, RetrievalIndex), OpenError> {
    let rows = plane_frames(artifact)?;
    let mut indexed = Vec::with_capacity(rows.len());
    let mut demos: Vec<(u32, Vec<(PlanarFrame, Mode)>)> = Vec::new();
    for row in rows {
        if row.retrievable.unwrap_or(true) {
            indexed.push(IndexedFrame {
                episode: row.episode,
                frame: row.frame,
                mode: row.mode,
                eef: row.eef,
                object: row.object,
            });
        }
        let frame = PlanarFrame {
            eef: row.eef,
            object: row.object,
            action: row.action,
            contacts: f64::NAN,
        };
        match demos.last_mut().filter(|(number, _)| *number == row.episode) {
            Some((_, frames)) => frames.push((frame, row.mode)),
            None => demos.push((row.episode, vec![(frame, row.mode)])),
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

/// The ranges that states of Push-T are normalised by.
///
/// # Errors
/// When they cannot be read, or are of other dimensions.
pub fn read_scales(artifact: &Artifact) -> Result<[Range; 5], OpenError> {
    let rows: Vec<Scale> = artifact.table(&tables::SCALES)?.read()?;
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

fn read_chunks(artifact: &Artifact) -> Result<Vec<Chunk>, OpenError> {
    let rows: Vec<ChunkColumns> = artifact.table(&tables::CHUNKS)?.read()?;
    let chunk = |row: ChunkColumns| Chunk {
        demo: row.episode,
        start: row.first_frame,
        end: row.last_frame,
        motion: row.motion,
        travel: row.travel,
        pushed: row.pushed,
    };
    Ok(rows.into_iter().map(chunk).collect())
}

/// What RE4 knows of a robosuite task, from demonstrations of these names.
pub(crate) fn open_spatial_index(
    artifact: &Artifact,
    retrieve: &SpatialRetrieveConfig,
    symmetry: Symmetry,
    names: DemoNames,
) -> Result<SpatialKnowledge, OpenError> {
    let mut demos: Vec<(u32, Vec<SpatialDemoFrame>)> = Vec::new();
    let mut excluded = BTreeSet::new();
    for row in space_frames(artifact)? {
        if !row.retrievable {
            excluded.insert((row.episode, row.frame));
        }
        let frame = SpatialDemoFrame {
            eef: row.eef,
            object: row.object,
            goal: row.goal.into(),
            gripper: row.gripper,
            mode: row.mode,
        };
        match demos.last_mut().filter(|(number, _)| *number == row.episode) {
            Some((_, frames)) => frames.push(frame),
            None => demos.push((row.episode, vec![frame])),
        }
    }
    Ok(SpatialKnowledge::new(
        SpatialDemoSet::new(demos).with_names(names),
        retrieve,
        symmetry,
        |demo, frame| excluded.contains(&(demo, frame)),
    )?)
}
