//! The stage `index`: makes `index` from `episodes`, `modes` and, if poses are estimated, `poses`.

mod estimated;
mod spatial;

use std::collections::{BTreeMap, BTreeSet};
use std::ops::Range;
use std::path::PathBuf;

use anyhow::Result;
use re4_artifact::{Artifact, ArtifactSummary, Recipe, Row as _, Stage, Table, Writer, columns};
use re4_episode::{Mode, PlanarFrame};
use re4_fault::{OrFault as _, ensure, fault};
use re4_geometry::Pose2;
use re4_index::{AngleMetric, IndexRow, IndexedFrame, Normalization, PlanarState, ScaleRow};
use re4_ingest::EpisodeRow;
use re4_policy::{DemoSet, collect_chunks};
use re4_pose::{Estimate, Flag, PoseRow, between_clear};
use re4_segment::{Evidence, ModeRow};
use serde_json::{Value, json};

use crate::inputs::episodes::PlanarEpisodes;
use crate::parts::{DEMOS_IN_PART, Lazy, parts_of, sum_of_summaries};
use crate::runner::{Built, Runner};

/// Increase it whenever the same input gives different bytes.
const CODE_VERSION: u32 = 4;

/// The same for an index in several parts.
const VERSION_IN_PARTS: u32 = 5;

impl Runner {
    /// Makes the `index` artifact of Push-T, or returns the existing one. Object poses come from `poses` if it is given,
    /// otherwise from `episodes`.
    ///
    /// It is cut into parts of demonstrations although `episodes` and `modes` have one part each, because a zarr store is read as a whole.
    /// The ranges of the normalised coordinates are those of all frames, so the states of all demonstrations are read once, and those
    /// of a part again.
    ///
    /// # Errors
    /// If an input cannot be read, a setting does not fit the input, or the run is interrupted.
    pub fn index(&self, episodes: &Built, modes: &Built, poses: Option<&Built>) -> Result<Built> {
        let longest_chunk = self.pipeline.index()?.longest_chunk;
        let count = episodes.artifact.table(EpisodeRow::table())?.rows();
        let parts = parts_of(count as usize, DEMOS_IN_PART);
        let version = if parts == 1 { CODE_VERSION } else { VERSION_IN_PARTS };
        let mut recipe = Recipe::new(Stage::Index, version)
            .config(&json!({
                "longest_chunk": longest_chunk,
                "pose": { "source": self.pipeline.pose()?.source },
            }))?
            .input("episodes", episodes.artifact.key())
            .input("modes", modes.artifact.key());
        if let Some(poses) = poses {
            recipe = recipe.input("poses", poses.artifact.key());
        }
        let inputs = Lazy::new();
        let inputs =
            || inputs.get(|| Inputs::open(&episodes.artifact, &modes.artifact, poses.map(|poses| &poses.artifact)));
        let known = Lazy::new();
        let normalization = || known.get(|| self.normalization(inputs()?, parts));
        let make = |writer: &Writer, part: u32| {
            let normalization = normalization()?;
            let indexed = inputs()?.part(part)?;
            let modes = inputs()?.modes(part)?;
            anyhow::Ok(ArtifactSummary {
                summary: write_index(&indexed, modes, longest_chunk as usize, normalization, writer)?,
                warnings: Vec::new(),
            })
        };
        if parts == 1 {
            return self.build(&recipe, |writer| {
                let summary = make(writer, 0)?;
                write_scales(normalization()?, writer)?;
                Ok(summary)
            });
        }
        self.build_parts(&recipe, parts, make, |parts, writer| {
            write_scales(normalization()?, writer)?;
            Ok(ArtifactSummary {
                summary: Value::Object(sum_of_summaries(parts)),
                warnings: Vec::new(),
            })
        })
    }

    /// The ranges over all frames of all parts. They do not depend on how angles are compared; the policy chooses that when it opens
    /// the index.
    fn normalization(&self, inputs: &Inputs, parts: u32) -> Result<Normalization> {
        let mut of_parts = Vec::new();
        for part in 0..parts {
            self.interrupt.check("index")?;
            let indexed = inputs.part(part)?;
            if !indexed.demos.is_empty() {
                of_parts.push(Normalization::over(&indexed.frames(), AngleMetric::default()));
            }
        }
        Normalization::merged(of_parts).or_fault(|| {
            fault!(
                "cannot index {}: no frame has a clear pose", inputs.path.display();
                "inspect the table poses with re4-pipe inspect"
            )
        })
    }
}

/// Frames without a clear estimated pose, as (episode, frame).
type Blanks = BTreeSet<(u32, u32)>;

columns! {
    /// The columns of table `modes` that are read.
    pub struct ModeOf {
        /// Demonstration.
        pub episode: u32,
        /// Frame.
        pub frame: u32,
        /// Mode of the frame.
        pub mode: Mode,
    }
}

/// The tables that the index is made from. They have one row per frame, in the same order.
struct Inputs {
    recorded: PlanarEpisodes,
    modes: Table,
    poses: Option<Table>,
    /// Path of the demonstrations, for messages.
    path: PathBuf,
}

/// The demonstrations of a part, without those that have no clear pose.
struct Indexed {
    demos: Vec<(u32, Vec<PlanarFrame>)>,
    blanks: Blanks,
}

impl Inputs {
    fn open(episodes: &Artifact, modes: &Artifact, poses: Option<&Artifact>) -> Result<Self> {
        let recorded = PlanarEpisodes::open(episodes)?;
        let rows = recorded.rows(0..recorded.count()).end;
        let table = modes.table(ModeRow::<Evidence>::table())?;
        ensure!(
            table.rows() == rows,
            "cannot read {}: table modes has {} frames, and the episodes have {rows}", modes.path().display(), table.rows();
            "delete the artifact and run again"
        );
        let poses = poses
            .map(|poses| poses.table(PoseRow::<Estimate>::table()))
            .transpose()?;
        if let Some(poses) = &poses {
            ensure!(
                poses.rows() == rows,
                "cannot index {}: it has {rows} frames, and the poses artifact has {}", episodes.path().display(), poses.rows();
                "delete the poses artifact and run again"
            );
        }
        Ok(Self {
            recorded,
            modes: table,
            poses,
            path: episodes.path().to_path_buf(),
        })
    }

    /// The demonstrations of a part.
    fn demos(&self, part: u32) -> Range<usize> {
        let start = part as usize * DEMOS_IN_PART;
        start..self.recorded.count().min(start + DEMOS_IN_PART)
    }

    /// Reads the demonstrations of a part. Estimated poses replace the recorded ones if there are any; frames without a clear estimate
    /// get an interpolated pose and are returned as blanks. Demonstrations without any clear estimate are dropped.
    fn part(&self, part: u32) -> Result<Indexed> {
        let demos = self.demos(part);
        let numbers = (0..).skip(demos.start);
        let Some(poses) = &self.poses else {
            let recorded = self.recorded.read_known(demos)?.into_iter();
            return Ok(Indexed {
                demos: numbers.zip(recorded.map(|episode| episode.frames)).collect(),
                blanks: Blanks::new(),
            });
        };
        let mut estimates = poses
            .read_range::<PoseRow<Estimate>>(self.recorded.rows(demos.clone()))?
            .into_iter();
        let mut indexed = Indexed {
            demos: Vec::new(),
            blanks: Blanks::new(),
        };
        for (number, episode) in numbers.zip(self.recorded.read(demos)?) {
            let mut frames = episode.frames;
            let own: Vec<_> = estimates.by_ref().take(frames.len()).collect();
            self.in_order(
                &poses.summary().file,
                number,
                own.iter().map(|row| (row.episode, row.frame)),
            )?;
            let clear = |row: PoseRow<Estimate>| row.estimate.pose.filter(|_| row.estimate.flag == Flag::Clear);
            let known: Vec<Option<Pose2>> = own.into_iter().map(clear).collect();
            let Some(filled) = between_clear(&known) else {
                continue;
            };
            let blank = (0..).zip(&known).filter(|(_, pose)| pose.is_none());
            indexed.blanks.extend(blank.map(|(frame, _)| (number, frame)));
            for (frame, pose) in frames.iter_mut().zip(filled) {
                frame.object = pose;
            }
            indexed.demos.push((number, frames));
        }
        Ok(indexed)
    }

    /// The modes of the frames of a part, by demonstration.
    fn modes(&self, part: u32) -> Result<BTreeMap<u32, Vec<Mode>>> {
        let rows = self.modes.read_range::<ModeOf>(self.recorded.rows(self.demos(part)))?;
        let mut modes: BTreeMap<u32, Vec<Mode>> = BTreeMap::new();
        for of in rows.chunk_by(|a, b| a.episode == b.episode) {
            let number = of[0].episode;
            self.in_order(
                &self.modes.summary().file,
                number,
                of.iter().map(|row| (row.episode, row.frame)),
            )?;
            modes.insert(number, of.iter().map(|row| row.mode).collect());
        }
        Ok(modes)
    }

    /// Returns an error if these rows of a table are not the frames of a demonstration in order.
    fn in_order(&self, table: &str, demo: u32, rows: impl Iterator<Item = (u32, u32)>) -> Result<()> {
        for (expected, found) in (0..).map(|frame| (demo, frame)).zip(rows) {
            ensure!(
                expected == found,
                "cannot index {}: {table} has episode {}, frame {} in the place of episode {}, frame {}",
                self.path.display(), found.0, found.1, expected.0, expected.1;
                "delete the artifact of that table and run again"
            );
        }
        Ok(())
    }
}

impl Indexed {
    /// The frames without their modes, which no range depends on.
    fn frames(&self) -> Vec<IndexedFrame> {
        let frames_of = |(episode, frames): &(u32, Vec<PlanarFrame>)| {
            let episode = *episode;
            let frames = (0..).zip(frames.iter());
            let frame = |(frame, row): (u32, &PlanarFrame)| indexed_frame(episode, frame, Mode::Transit, row);
            frames.map(frame).collect::<Vec<_>>()
        };
        self.demos.iter().flat_map(frames_of).collect()
    }
}

fn indexed_frame(episode: u32, frame: u32, mode: Mode, row: &PlanarFrame) -> IndexedFrame {
    IndexedFrame {
        episode,
        frame,
        mode,
        eef: row.eef,
        object: row.object,
    }
}

/// Writes the frames and chunks of a part. Returns its summary.
fn write_index(
    indexed: &Indexed,
    mut modes: BTreeMap<u32, Vec<Mode>>,
    longest_chunk: usize,
    normalization: &Normalization,
    writer: &Writer,
) -> Result<Value> {
    let mut table = writer.rows()?;
    for (number, frames) in &indexed.demos {
        let modes = modes.remove(number).unwrap_or_default();
        ensure!(
            modes.len() == frames.len(),
            "cannot index episode {number}: it has {} frames, and table modes has {} of it", frames.len(), modes.len();
            "delete the modes artifact and run again"
        );
        for (frame, (row, mode)) in (0..).zip(frames.iter().zip(modes)) {
            table.push(&IndexRow {
                episode: *number,
                frame,
                mode,
                state: PlanarState {
                    eef: row.eef,
                    object: row.object,
                    action: row.action,
                    q: normalization.frame(&indexed_frame(*number, frame, mode, row)),
                },
                retrievable: Some(!indexed.blanks.contains(&(*number, frame))),
            })?;
        }
    }
    let frames = table.rows();
    table.finish()?;
    // The outcome of a chunk is measured with the poses of its frames, so chunks with an interpolated pose are dropped.
    let mut chunks = collect_chunks(&DemoSet::new(indexed.demos.iter().cloned()), longest_chunk);
    chunks.retain(|chunk| {
        let mut within = indexed
            .blanks
            .range((chunk.demo, chunk.start)..=(chunk.demo, chunk.end));
        within.next().is_none()
    });
    writer.write_rows(chunks.iter().copied())?;
    Ok(json!({
        "episodes": indexed.demos.len(),
        "frames": frames - indexed.blanks.len() as u64,
        "chunks": chunks.len(),
    }))
}

fn write_scales(normalization: &Normalization, writer: &Writer) -> Result<()> {
    let scales = Normalization::DIMENSIONS.into_iter().zip(normalization.ranges);
    writer.write_rows(scales.map(|(dimension, range)| ScaleRow {
        dimension: dimension.to_owned(),
        minimum: range.minimum,
        maximum: range.maximum,
    }))?;
    Ok(())
}
