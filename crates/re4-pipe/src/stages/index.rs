//! Index: `episodes` and `modes` to `index`.

use anyhow::{Context as _, Result};
use re4_artifact::{Artifact, Columns, Facts, Recipe, Stage, Writer, col_f64, col_text, col_u32, tables};
use re4_episode::{Mode, PlanarFrame};
use re4_geometry::{Point2, Pose2};
use re4_index::{AngleMetric, IndexedFrame, Normalization, Range, RetrievalIndex};
use re4_policy::{Chunk, ChunkLibrary, DemoSet, Knowledge, PolicyConfig, Selector, collect_chunks};
use serde_json::json;

use super::segment::read_episodes;
use super::{Built, Runner};

/// Raised whenever the same input gives other bytes.
const CODE_VERSION: u32 = 1;

impl Runner {
    /// The `index` artifact.
    pub(crate) fn index(&self, episodes: &Built, modes: &Built) -> Result<Built> {
        let recipe = Recipe::new(Stage::Index, CODE_VERSION)
            .config(&json!({ "longest_chunk": self.pipeline.index.longest_chunk, "pose": self.pipeline.pose }))?
            .input("episodes", episodes.artifact.key())
            .input("modes", modes.artifact.key());
        self.build(&recipe, |writer| {
            let demos = read_demos(&episodes.artifact, &modes.artifact)?;
            let frames = indexed_frames(&demos);
            // The ranges do not depend on how angles are compared; the policy chooses that when it opens the index.
            let normalization = Normalization::over(&frames, AngleMetric::default());
            write_index(&demos, &frames, &normalization, writer)?;
            let chunks = collect_chunks(&demos, self.pipeline.index.longest_chunk as usize);
            write_chunks(&chunks, writer)?;
            let summary = json!({
                "episodes": demos.iter().count(),
                "frames": frames.len(),
                "chunks": chunks.len(),
            });
            Ok(Facts {
                summary,
                warnings: Vec::new(),
            })
        })
    }
}

fn indexed_frames(demos: &DemoSet) -> Vec<IndexedFrame> {
    let mut indexed = Vec::with_capacity(demos.len());
    for (episode, frames) in demos.iter() {
        let modes = demos.modes(episode).unwrap_or_default();
        for (frame, (row, &mode)) in frames.iter().zip(modes).enumerate() {
            indexed.push(IndexedFrame {
                episode,
                frame: frame as u32,
                mode,
                eef: row.eef,
                object: row.object,
            });
        }
    }
    indexed
}

/// Episodes and the mode of each of their frames.
fn read_demos(episodes: &Artifact, modes: &Artifact) -> Result<DemoSet> {
    let table = modes.table(&tables::MODES)?.read_columns(&["mode"])?;
    let mut labels = col_text(&table, "mode")?.into_iter();
    let mut demos = Vec::new();
    for (number, episode) in read_episodes(episodes)?.into_iter().enumerate() {
        let mut frames = Vec::with_capacity(episode.frames.len());
        for frame in episode.frames {
            let mode = labels.next().flatten().and_then(Mode::from_name).with_context(|| {
                format!("cannot read {}: table modes has fewer frames than the episodes, or an unknown mode; build it again", modes.path().display())
            })?;
            frames.push((frame, mode));
        }
        demos.push((number as u32, frames));
    }
    Ok(DemoSet::new(demos))
}

fn write_index(demos: &DemoSet, frames: &[IndexedFrame], normalization: &Normalization, writer: &Writer) -> Result<()> {
    let normalized: Vec<[f64; 5]> = frames.iter().map(|frame| normalization.frame(frame)).collect();
    let actions: Vec<Point2> = demos
        .iter()
        .flat_map(|(_, frames)| frames)
        .map(|frame| frame.action)
        .collect();
    let of = |value: fn(&IndexedFrame) -> f64| frames.iter().map(value).collect::<Vec<f64>>();
    let mut columns = Columns::new(&tables::INDEX)
        .u32("episode", frames.iter().map(|f| f.episode).collect())
        .u32("frame", frames.iter().map(|f| f.frame).collect())
        .text("mode", frames.iter().map(|f| f.mode.as_str()))
        .f64("eef_x", of(|f| f.eef.x))
        .f64("eef_y", of(|f| f.eef.y))
        .f64("object_x", of(|f| f.object.x))
        .f64("object_y", of(|f| f.object.y))
        .f64("object_theta", of(|f| f.object.theta))
        .f64("action_x", actions.iter().map(|a| a.x).collect())
        .f64("action_y", actions.iter().map(|a| a.y).collect());
    for dimension in 0..5 {
        columns = columns.f64(
            &format!("q_{dimension}"),
            normalized.iter().map(|q| q[dimension]).collect(),
        );
    }
    let mut table = writer.table(&tables::INDEX)?;
    table.write_columns(columns)?;
    table.finish()?;
    let mut table = writer.table(&tables::SCALES)?;
    table.write_columns(
        Columns::new(&tables::SCALES)
            .text("dimension", Normalization::DIMENSIONS)
            .f64("minimum", normalization.ranges.iter().map(|r| r.minimum).collect())
            .f64("maximum", normalization.ranges.iter().map(|r| r.maximum).collect()),
    )?;
    table.finish()?;
    Ok(())
}

fn write_chunks(chunks: &[Chunk], writer: &Writer) -> Result<()> {
    let of = |value: fn(&Chunk) -> f64| chunks.iter().map(value).collect::<Vec<f64>>();
    let mut table = writer.table(&tables::CHUNKS)?;
    table.write_columns(
        Columns::new(&tables::CHUNKS)
            .u32("episode", chunks.iter().map(|c| c.demo).collect())
            .u32("first_frame", chunks.iter().map(|c| c.start).collect())
            .u32("last_frame", chunks.iter().map(|c| c.end).collect())
            .f64("motion_x", of(|c| c.motion.x))
            .f64("motion_y", of(|c| c.motion.y))
            .f64("motion_theta", of(|c| c.motion.theta))
            .f64("travel", of(|c| c.travel))
            .f64("pushed", of(|c| c.pushed)),
    )?;
    table.finish()?;
    Ok(())
}

/// What a policy needs of an `index` artifact.
pub(super) fn open_index(artifact: &Artifact, policy: &PolicyConfig) -> Result<Knowledge> {
    let open_chunks = || -> Result<Option<ChunkLibrary>> {
        Ok(match policy.retrieve.selector {
            Selector::Outcome => Some(ChunkLibrary::build(read_chunks(artifact)?)?),
            Selector::TwoStage => None,
        })
    };
    let (states, chunks) = rayon::join(|| open_states(artifact, policy), open_chunks);
    let (demos, index) = states?;
    Ok(Knowledge {
        demos,
        index,
        chunks: chunks?,
    })
}

fn open_states(artifact: &Artifact, policy: &PolicyConfig) -> Result<(DemoSet, RetrievalIndex)> {
    // The normalised coordinates are in the table for other readers; they follow from the states and the scales.
    let table = artifact.table(&tables::INDEX)?.read_columns(&[
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
    ])?;
    let column = |name| col_f64(&table, name);
    let (eef_x, eef_y) = (column("eef_x")?, column("eef_y")?);
    let (x, y, theta) = (column("object_x")?, column("object_y")?, column("object_theta")?);
    let (action_x, action_y) = (column("action_x")?, column("action_y")?);
    let (episode, frame) = (col_u32(&table, "episode")?, col_u32(&table, "frame")?);
    let modes = col_text(&table, "mode")?;
    let mut indexed = Vec::with_capacity(episode.len());
    let mut demos: Vec<(u32, Vec<(PlanarFrame, Mode)>)> = Vec::new();
    for i in 0..episode.len() {
        let mode = modes[i].and_then(Mode::from_name).with_context(|| {
            format!(
                "cannot read {}: table index has an unknown mode in row {i}; build it again",
                artifact.path().display()
            )
        })?;
        let (eef, object) = (Point2::new(eef_x[i], eef_y[i]), Pose2::new(x[i], y[i], theta[i]));
        indexed.push(IndexedFrame {
            episode: episode[i],
            frame: frame[i],
            mode,
            eef,
            object,
        });
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
    let index = RetrievalIndex::with_normalization(indexed, normalization)?;
    Ok((DemoSet::new(demos), index))
}

fn read_scales(artifact: &Artifact) -> Result<[Range; 5]> {
    let table = artifact.table(&tables::SCALES)?.read_all()?;
    let names = col_text(&table, "dimension")?;
    if !names.iter().copied().eq(Normalization::DIMENSIONS.map(Some)) {
        anyhow::bail!(
            "cannot read {}: table scales names other dimensions than {}; build it again",
            artifact.path().display(),
            Normalization::DIMENSIONS.join(", ")
        );
    }
    let (minimum, maximum) = (col_f64(&table, "minimum")?, col_f64(&table, "maximum")?);
    Ok(std::array::from_fn(|i| Range {
        minimum: minimum[i],
        maximum: maximum[i],
    }))
}

fn read_chunks(artifact: &Artifact) -> Result<Vec<Chunk>> {
    let table = artifact.table(&tables::CHUNKS)?.read_all()?;
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
