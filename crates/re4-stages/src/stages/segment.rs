//! Segment: `episodes` to `modes`.

mod spatial;

use anyhow::Result;
use re4_artifact::{Columns, Facts, Recipe, Stage, Writer, tables};
use re4_episode::Mode;
use re4_segment::{Evidence, SegmentFacts, SegmentedEpisode, segment_planar};
use serde_json::json;

use crate::inputs::episodes::read_episodes;
use crate::runner::{Built, Runner};

/// Raised whenever the same input gives other bytes.
const CODE_VERSION: u32 = 1;

impl Runner {
    /// The `modes` artifact.
    ///
    /// # Errors
    /// When an input, or a setting of the pipeline, does not allow it; or at Ctrl-C.
    pub fn segment(&self, episodes: &Built) -> Result<Built> {
        let recipe = Recipe::new(Stage::Segment, CODE_VERSION)
            .config(&self.pipeline.segment)?
            .input("episodes", episodes.artifact.key());
        if !self.pipeline.task.is_planar() {
            return self.build(&recipe, |writer| spatial::write(self, &episodes.artifact, writer));
        }
        self.build(&recipe, |writer| {
            let episodes = read_episodes(&episodes.artifact)?;
            let segmented = episodes
                .iter()
                .map(|episode| segment_planar(episode, &self.pipeline.segment))
                .collect::<Result<Vec<_>, _>>()?;
            write_modes(&segmented, writer)?;
            write_segments(&segmented, writer)?;
            let frames_of = |mode| segmented.iter().flat_map(|e| &e.modes).filter(|m| **m == mode).count();
            Ok(Facts {
                summary: json!({
                    "episodes": segmented.len(),
                    "segments": segmented.iter().map(|e| e.segments.len()).sum::<usize>(),
                    "transit_frames": frames_of(Mode::Transit),
                    "transfer_frames": frames_of(Mode::Transfer),
                    "frames_in_contact": segmented.iter().flat_map(|e| &e.evidence).filter(|e| e.contact == Some(true)).count(),
                    "frames_with_object_moving": segmented.iter().flat_map(|e| &e.evidence).filter(|e| e.object_moving == Some(true)).count(),
                }),
                warnings: Vec::new(),
            })
        })
    }
}

fn write_modes(episodes: &[SegmentedEpisode], writer: &Writer) -> Result<()> {
    let evidence = || episodes.iter().flat_map(|episode| &episode.evidence);
    let optional = |value: fn(&Evidence) -> Option<f64>| evidence().map(value).collect::<Vec<_>>();
    let mut table = writer.table(&tables::MODES)?;
    table.write_columns(
        Columns::new(&tables::MODES)
            .u32(
                "episode",
                numbered(episodes, |episode| episode.modes.len())
                    .map(|(number, _)| number)
                    .collect(),
            )
            .u32(
                "frame",
                numbered(episodes, |episode| episode.modes.len())
                    .map(|(_, frame)| frame)
                    .collect(),
            )
            .text(
                "mode",
                episodes
                    .iter()
                    .flat_map(|episode| &episode.modes)
                    .map(|mode| mode.as_str()),
            )
            .f64_or_null("contacts", optional(|e| e.contacts))
            .bool_or_null("contact", evidence().map(|e| e.contact).collect())
            .f64_or_null("eef_step", optional(|e| e.eef_step))
            .f64_or_null("object_step", optional(|e| e.object_step))
            .f64_or_null("object_turn", optional(|e| e.object_turn))
            .f64_or_null("relative_translation", optional(|e| e.relative_translation))
            .f64_or_null("relative_rotation", optional(|e| e.relative_rotation))
            .f64(
                "eef_object_distance",
                evidence().map(|e| e.eef_object_distance).collect(),
            )
            .bool_or_null("object_moving", evidence().map(|e| e.object_moving).collect()),
    )?;
    table.finish()?;
    Ok(())
}

fn write_segments(episodes: &[SegmentedEpisode], writer: &Writer) -> Result<()> {
    let segments = || episodes.iter().flat_map(|episode| &episode.segments);
    let optional = |value: fn(&SegmentFacts) -> Option<f64>| segments().map(value).collect::<Vec<_>>();
    let mut table = writer.table(&tables::SEGMENTS)?;
    table.write_columns(
        Columns::new(&tables::SEGMENTS)
            .u32(
                "episode",
                numbered(episodes, |episode| episode.segments.len())
                    .map(|(number, _)| number)
                    .collect(),
            )
            .u32(
                "segment",
                numbered(episodes, |episode| episode.segments.len())
                    .map(|(_, segment)| segment)
                    .collect(),
            )
            .text("mode", segments().map(|s| s.segment.mode.as_str()))
            .u32(
                "first_frame",
                segments().map(|s| s.segment.frames.start as u32).collect(),
            )
            .u32("end_frame", segments().map(|s| s.segment.frames.end as u32).collect())
            .f64_or_null("anchor_x", optional(|s| s.anchor.map(|p| p.x)))
            .f64_or_null("anchor_y", optional(|s| s.anchor.map(|p| p.y)))
            .f64_or_null("grasp_x", optional(|s| s.grasp.map(|p| p.x)))
            .f64_or_null("grasp_y", optional(|s| s.grasp.map(|p| p.y)))
            .f64_or_null("rigidity_residual", optional(|s| s.rigidity_residual))
            .f64(
                "object_displacement",
                segments().map(|s| s.object_displacement).collect(),
            )
            .f64("object_rotation", segments().map(|s| s.object_rotation).collect()),
    )?;
    table.finish()?;
    Ok(())
}

/// Number of the episode and number inside it, for every row of a table with `rows` rows an episode.
fn numbered(episodes: &[SegmentedEpisode], rows: fn(&SegmentedEpisode) -> usize) -> impl Iterator<Item = (u32, u32)> {
    episodes
        .iter()
        .enumerate()
        .flat_map(move |(number, episode)| (0..rows(episode) as u32).map(move |row| (number as u32, row)))
}
