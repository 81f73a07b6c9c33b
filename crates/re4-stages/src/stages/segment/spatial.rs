//! Segment, for demonstrations with a gripper: `spatial_frames` to `spatial_modes` and `spatial_segments`.

use anyhow::Result;
use nalgebra::Isometry3;
use rayon::prelude::*;
use re4_artifact::{Artifact, Columns, Facts, TableWriter, Writer, tables};
use re4_episode::Mode;
use re4_segment::{Grasp, SegmentedSpatial, SpatialEvidence, SpatialSegment, segment_spatial};
use serde_json::json;

use super::Runner;
use crate::inputs::demos::{SpatialEpisodes, in_portions};

/// Segments every demonstration, some at a time.
pub(super) fn write(runner: &Runner, episodes: &Artifact, writer: &Writer) -> Result<Facts> {
    let config = &runner.pipeline.segment;
    let episodes = SpatialEpisodes::open(episodes)?;
    let bar = runner.notes.progress(episodes.demos() as u64, "segment");
    let mut modes = writer.table(&tables::SPATIAL_MODES)?;
    let mut segments = writer.table(&tables::SPATIAL_SEGMENTS)?;
    let mut counts = Counts::default();
    for portion in in_portions(episodes) {
        runner.interrupt.check("segment")?;
        let segmented = portion?
            .into_par_iter()
            .map(|(number, episode)| Ok((number, segment_spatial(&episode, config)?)))
            .collect::<Result<Vec<_>>>()?;
        for (number, segmented) in &segmented {
            counts.add(segmented);
            write_modes(*number, segmented, &mut modes)?;
            write_segments(*number, &segmented.segments, &mut segments)?;
        }
        bar.inc(segmented.len() as u64);
    }
    bar.finish_and_clear();
    modes.finish()?;
    segments.finish()?;
    Ok(Facts {
        summary: json!({
            "episodes": counts.episodes,
            "segments": counts.segments,
            "transit_frames": counts.transit,
            "transfer_frames": counts.transfer,
            "frames_with_object_moving": counts.moving,
            "frames_with_object_held": counts.held,
        }),
        warnings: Vec::new(),
    })
}

#[derive(Default)]
struct Counts {
    episodes: usize,
    segments: usize,
    transit: usize,
    transfer: usize,
    moving: usize,
    held: usize,
}

impl Counts {
    fn add(&mut self, segmented: &SegmentedSpatial) {
        let transfer = segmented.modes.iter().filter(|mode| **mode == Mode::Transfer).count();
        self.episodes += 1;
        self.segments += segmented.segments.len();
        self.transfer += transfer;
        self.transit += segmented.modes.len() - transfer;
        self.moving += segmented
            .evidence
            .iter()
            .filter(|e| e.object_moving == Some(true))
            .count();
        self.held += segmented.evidence.iter().filter(|e| e.holds).count();
    }
}

fn write_modes(number: u32, segmented: &SegmentedSpatial, table: &mut TableWriter) -> Result<()> {
    let evidence = &segmented.evidence;
    let column = |value: fn(&SpatialEvidence) -> f64| evidence.iter().map(value).collect::<Vec<_>>();
    let optional = |value: fn(&SpatialEvidence) -> Option<f64>| evidence.iter().map(value).collect::<Vec<_>>();
    table.write_columns(
        Columns::new(&tables::SPATIAL_MODES)
            .u32("episode", vec![number; evidence.len()])
            .u32("frame", (0..evidence.len() as u32).collect())
            .text("mode", segmented.modes.iter().map(|mode| mode.as_str()))
            .bool("command_closes", evidence.iter().map(|e| e.command_closes).collect())
            .f64("finger_separation", column(|e| e.finger_separation))
            .f64_or_null("finger_speed", optional(|e| e.finger_speed))
            .f64_or_null("eef_step", optional(|e| e.eef_step))
            .f64_or_null("eef_turn", optional(|e| e.eef_turn))
            .f64_or_null("object_step", optional(|e| e.object_step))
            .f64_or_null("object_turn", optional(|e| e.object_turn))
            .f64_or_null("relative_translation", optional(|e| e.relative_translation))
            .f64_or_null("relative_rotation", optional(|e| e.relative_rotation))
            .f64("eef_object_distance", column(|e| e.eef_object_distance))
            .bool_or_null("object_moving", evidence.iter().map(|e| e.object_moving).collect())
            .bool("holds", evidence.iter().map(|e| e.holds).collect()),
    )?;
    Ok(())
}

fn write_segments(number: u32, segments: &[SpatialSegment], table: &mut TableWriter) -> Result<()> {
    let column = |value: fn(&SpatialSegment) -> f64| segments.iter().map(value).collect::<Vec<_>>();
    let grasp = |value: fn(&Grasp) -> f64| -> Vec<Option<f64>> {
        segments.iter().map(|s| s.grasp.as_ref().map(value)).collect()
    };
    let columns = Columns::new(&tables::SPATIAL_SEGMENTS)
        .u32("episode", vec![number; segments.len()])
        .u32("segment", (0..segments.len() as u32).collect())
        .text("mode", segments.iter().map(|s| s.segment.mode.as_str()))
        .u32(
            "first_frame",
            segments.iter().map(|s| s.segment.frames.start as u32).collect(),
        )
        .u32(
            "end_frame",
            segments.iter().map(|s| s.segment.frames.end as u32).collect(),
        )
        .u32_or_null(
            "settled_frame",
            segments
                .iter()
                .map(|s| s.settled_frame.map(|frame| frame as u32))
                .collect(),
        )
        .f64_or_null("finger_separation", grasp(|g| g.finger_separation))
        .f64_or_null("rigidity_residual", grasp(|g| g.residual))
        .f64_or_null("rigidity_residual_rotation", grasp(|g| g.residual_rotation))
        .f64("object_displacement", column(|s| s.object_displacement))
        .f64("object_rise", column(|s| s.object_rise))
        .f64("object_rotation", column(|s| s.object_rotation))
        .f64("object_path", column(|s| s.object_path));
    let columns = pose_columns(
        columns,
        "anchor",
        &segments.iter().map(|s| s.anchor).collect::<Vec<_>>(),
    );
    let columns = pose_columns(
        columns,
        "grasp",
        &segments
            .iter()
            .map(|s| s.grasp.map(|g| g.transform))
            .collect::<Vec<_>>(),
    );
    table.write_columns(columns)?;
    Ok(())
}

/// The seven columns of a pose that may be absent.
fn pose_columns(columns: Columns, prefix: &str, poses: &[Option<Isometry3<f64>>]) -> Columns {
    ["x", "y", "z", "qx", "qy", "qz", "qw"]
        .iter()
        .enumerate()
        .fold(columns, |columns, (place, part)| {
            let values = poses
                .iter()
                .map(|pose| pose.as_ref().map(|pose| parts(pose)[place]))
                .collect();
            columns.f64_or_null(&format!("{prefix}_{part}"), values)
        })
}

/// Position and quaternion of a pose, as columns have them.
pub(super) fn parts(pose: &Isometry3<f64>) -> [f64; 7] {
    let (t, q) = (pose.translation.vector, pose.rotation.coords);
    [t.x, t.y, t.z, q.x, q.y, q.z, q.w]
}
