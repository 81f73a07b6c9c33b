//! What Push-T's policy searches, out of an `index` artifact.

use anyhow::Result;
use arrow::array::Array as _;
use re4_artifact::Row as _;
use re4_artifact::{Artifact, col_bool, col_f64, col_text, col_u32};
use re4_episode::{Mode, PlanarFrame};
use re4_fault::{OrFault as _, bail, fault};
use re4_geometry::{Point2, Pose2};
use re4_index::{IndexedFrame, Normalization, Range, RetrievalIndex};
use re4_policy::{Chunk, ChunkLibrary, DemoNames, DemoSet, Knowledge, PolicyConfig, Selector};
use tracing::debug;

/// What a policy needs of an `index` artifact, whose demonstrations have these names.
pub(crate) fn open_index(artifact: &Artifact, policy: &PolicyConfig, names: DemoNames) -> Result<Knowledge> {
    let open_chunks = || -> Result<Option<ChunkLibrary>> {
        Ok(match policy.retrieve.selector {
            Selector::Outcome => Some(ChunkLibrary::build(read_chunks(artifact)?)?),
            Selector::TwoStage => None,
        })
    };
    let (states, chunks) = rayon::join(|| open_states(artifact, policy, names), open_chunks);
    let (demos, index) = states?;
    debug!(frames = demos.len(), "index opened");
    Ok(Knowledge {
        demos,
        index,
        chunks: chunks?,
    })
}

fn open_states(artifact: &Artifact, policy: &PolicyConfig, names: DemoNames) -> Result<(DemoSet, RetrievalIndex)> {
    // The normalised coordinates are in the table for other readers; they follow from the states and the scales.
    let table = artifact
        .table(re4_index::IndexRow::<re4_index::PlanarState>::table())?
        .read_columns(&[
            "episode",
            "frame",
            "mode",
            "eef_x",
            "eef_y",
            "object_x",
            "object_y",
            "object_theta",
            "action_x",
            "action_y",
            "retrievable",
        ])?;
    let retrievable = col_bool(&table, "retrievable")?;
    let column = |name| col_f64(&table, name);
    let (eef_x, eef_y) = (column("eef_x")?, column("eef_y")?);
    let (x, y, theta) = (column("object_x")?, column("object_y")?, column("object_theta")?);
    let (action_x, action_y) = (column("action_x")?, column("action_y")?);
    let (episode, frame) = (col_u32(&table, "episode")?, col_u32(&table, "frame")?);
    let modes = col_text(&table, "mode")?;
    let mut indexed = Vec::with_capacity(episode.len());
    let mut demos: Vec<(u32, Vec<(PlanarFrame, Mode)>)> = Vec::new();
    for i in 0..episode.len() {
        let mode = modes[i].and_then(Mode::from_name).or_fault(|| {
            fault!(
                "cannot read {}: table index has an unknown mode in row {i}", artifact.path().display();
                "build it again"
            )
        })?;
        let (eef, object) = (Point2::new(eef_x[i], eef_y[i]), Pose2::new(x[i], y[i], theta[i]));
        // Null in artifacts of older versions, whose frames all may be retrieved.
        if retrievable.is_null(i) || retrievable.value(i) {
            indexed.push(IndexedFrame {
                episode: episode[i],
                frame: frame[i],
                mode,
                eef,
                object,
            });
        }
        let row = PlanarFrame {
            eef,
            object,
            action: Point2::new(action_x[i], action_y[i]),
            contacts: f64::NAN,
        };
        match demos.last_mut().filter(|(number, _)| *number == episode[i]) {
            Some((_, frames)) => frames.push((row, mode)),
            None => demos.push((episode[i], vec![(row, mode)])),
        }
    }
    let normalization = Normalization {
        ranges: read_scales(artifact)?,
        angle: policy.retrieve.angle,
    };
    let index = RetrievalIndex::with_normalization(indexed, normalization)
        .map_err(|error| error.named(|episode| names.get(episode).map(str::to_owned)))?;
    Ok((DemoSet::new(demos).with_names(names), index))
}

fn read_scales(artifact: &Artifact) -> Result<[Range; 5]> {
    let table = artifact.table(re4_index::ScaleRow::table())?.read_all()?;
    let names = col_text(&table, "dimension")?;
    if !names.iter().copied().eq(Normalization::DIMENSIONS.map(Some)) {
        bail!(
            "cannot read {}: table scales names other dimensions than {}",
            artifact.path().display(),
            Normalization::DIMENSIONS.join(", ");
            "build it again"
        );
    }
    let (minimum, maximum) = (col_f64(&table, "minimum")?, col_f64(&table, "maximum")?);
    Ok(std::array::from_fn(|i| Range {
        minimum: minimum[i],
        maximum: maximum[i],
    }))
}

fn read_chunks(artifact: &Artifact) -> Result<Vec<Chunk>> {
    let table = artifact.table(re4_policy::Chunk::table())?.read_all()?;
    let column = |name| col_f64(&table, name);
    let (x, y, theta) = (column("motion_x")?, column("motion_y")?, column("motion_theta")?);
    let (travel, pushed) = (column("travel")?, column("pushed")?);
    let (demo, start, end) = (
        col_u32(&table, "episode")?,
        col_u32(&table, "first_frame")?,
        col_u32(&table, "last_frame")?,
    );
    Ok((0..demo.len())
        .map(|i| Chunk {
            demo: demo[i],
            start: start[i],
            end: end[i],
            motion: Pose2::new(x[i], y[i], theta[i]),
            travel: travel[i],
            pushed: pushed[i],
        })
        .collect())
}
