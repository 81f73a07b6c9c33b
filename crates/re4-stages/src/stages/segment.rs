//! The stage `segment`: makes `modes` from `episodes`.

use anyhow::Result;
use rayon::prelude::*;
use re4_artifact::{Artifact, ArtifactSummary, Cell, Recipe, Stage, Writer};
use re4_episode::Mode;
use re4_segment::{
    ArmEvidence, Evidence, ModeRow, SegmentError, SegmentRow, Segmented, SpatialEvidence, segment_arm, segment_planar,
    segment_spatial,
};
use re4_task::Domain;
use serde_json::{Map, Value, json};

use crate::inputs::arm::{self, ArmEpisodes};

use crate::inputs::demos::{SpatialEpisodes, in_batches};
use crate::inputs::episodes::read_frames;
use crate::parts::{Lazy, sum_of_summaries};
use crate::runner::{Built, Runner};

/// Increase it whenever the same input gives different bytes.
const CODE_VERSION: u32 = 5;

impl Runner {
    /// Makes the `modes` artifact, or returns the existing one.
    ///
    /// # Errors
    /// If an input cannot be read, a setting does not fit the input, or the run is interrupted.
    pub fn segment(&self, episodes: &Built) -> Result<Built> {
        let config = &self.pipeline.segment;
        let recipe = Recipe::new(Stage::Segment, CODE_VERSION)
            .config(config)?
            .input("episodes", episodes.artifact.key());
        // The gripper of an arm is proven from all demonstrations, once.
        let proven = Lazy::new();
        let gripper = || proven.get(|| arm::gripper(&episodes.artifact, config));
        let make = |episodes: &Artifact, writer: &Writer| match self.pipeline.task.domain() {
            Domain::Plane => {
                let demos = read_frames(episodes)?;
                let segment = |demo: &_| segment_planar(demo, config);
                self.write_modes(demos.len(), (0..).zip(demos).map(Ok), segment, PLANE, writer)
            }
            Domain::Arm => {
                let gripper = gripper()?;
                let demos = ArmEpisodes::open(episodes)?;
                let segment = |demo: &_| segment_arm(demo, config.rule, gripper.as_ref());
                self.write_modes(demos.demos(), demos, segment, ARM, writer)
            }
            Domain::Space => {
                let demos = SpatialEpisodes::open(episodes)?;
                let segment = |demo: &_| segment_spatial(demo, config);
                self.write_modes(demos.demos(), demos, segment, SPACE, writer)
            }
        };
        let complete = |mut summary: ArtifactSummary| {
            if self.pipeline.task.domain() == Domain::Arm {
                summary.summary["gripper"] = json!(gripper()?);
            }
            anyhow::Ok(summary)
        };
        let parts = episodes.artifact.parts();
        if parts == 1 {
            return self.build(&recipe, |writer| complete(make(&episodes.artifact, writer)?));
        }
        self.build_parts(
            &recipe,
            parts,
            |writer, part| make(&episodes.artifact.part(part)?, writer),
            |parts, _| {
                complete(ArtifactSummary {
                    summary: Value::Object(sum_of_summaries(parts)),
                    warnings: Vec::new(),
                })
            },
        )
    }

    /// Segments all demonstrations in batches, and counts the frames whose evidence satisfies the predicates in `counted`.
    fn write_modes<D: Sync + Send, E: Cell + Clone + Send, S: Cell + Clone + Send>(
        &self,
        count: usize,
        demos: impl Iterator<Item = Result<(u32, D)>>,
        segment: impl Fn(&D) -> Result<Segmented<E, S>, SegmentError> + Sync,
        counted: Counted<E>,
        writer: &Writer,
    ) -> Result<ArtifactSummary> {
        let bar = self.notes.progress(count as u64, "segment");
        let mut modes = writer.rows::<ModeRow<E>>()?;
        let mut segments = writer.rows::<SegmentRow<S>>()?;
        let mut summary = Summary::new(counted);
        for batch in in_batches(demos) {
            self.interrupt.check("segment")?;
            let segmented = batch?
                .into_par_iter()
                .map(|(number, demo)| Ok((number, segment(&demo)?)))
                .collect::<Result<Vec<_>>>()?;
            for (number, segmented) in &segmented {
                let (frames, runs) = segmented.rows(*number);
                for row in frames {
                    summary.add(&row);
                    modes.push(&row)?;
                }
                segments.extend(runs)?;
            }
            bar.inc(segmented.len() as u64);
        }
        bar.finish_and_clear();
        let summary = summary.into_json(segments.rows());
        modes.finish()?;
        segments.finish()?;
        Ok(ArtifactSummary {
            summary,
            warnings: Vec::new(),
        })
    }
}

/// Names and predicates of the counts of frames in the summary.
type Counted<E> = &'static [(&'static str, fn(&E) -> bool)];

const PLANE: Counted<Evidence> = &[
    ("frames_in_contact", |e| e.contact == Some(true)),
    ("frames_with_object_moving", |e| e.object_moving == Some(true)),
];

const ARM: Counted<ArmEvidence> = &[("frames_with_object_held", |e| e.holds)];

const SPACE: Counted<SpatialEvidence> = &[
    ("frames_with_object_moving", |e| e.object_moving == Some(true)),
    ("frames_with_object_held", |e| e.holds),
];

/// Accumulates the summary of a `modes` artifact.
struct Summary<E: 'static> {
    counted: Counted<E>,
    counts: Vec<u64>,
    demos: u64,
    last: Option<u32>,
    frames: u64,
    transfer: u64,
}

impl<E> Summary<E> {
    fn new(counted: Counted<E>) -> Self {
        Self {
            counted,
            counts: vec![0; counted.len()],
            demos: 0,
            last: None,
            frames: 0,
            transfer: 0,
        }
    }

    /// Adds a row of table `modes`. Rows have to be sorted by episode, because a change of episode counts as a new one.
    fn add(&mut self, row: &ModeRow<E>) {
        self.demos += u64::from(self.last.replace(row.episode) != Some(row.episode));
        self.frames += 1;
        self.transfer += u64::from(row.mode == Mode::Transfer);
        for (count, (_, holds)) in self.counts.iter_mut().zip(self.counted) {
            *count += u64::from(holds(&row.evidence));
        }
    }

    /// The summary; `segments` is the number of rows of table `segments`.
    fn into_json(self, segments: u64) -> Value {
        let mut summary = Map::new();
        let counts = self.counted.iter().map(|(name, _)| *name).zip(self.counts);
        let all = [
            ("episodes", self.demos),
            ("segments", segments),
            ("transit_frames", self.frames - self.transfer),
            ("transfer_frames", self.transfer),
        ];
        summary.extend(
            all.into_iter()
                .chain(counts)
                .map(|(name, count)| (name.to_owned(), json!(count))),
        );
        Value::Object(summary)
    }
}
