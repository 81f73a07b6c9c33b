//! What the page of an audit shows of demonstrations of an arm without an object.

use anyhow::Result;
use re4_artifact::Artifact;
use re4_artifact::episodes::{ArmColumns, FrameRow, SignalRole, SignalRow, SignalVector};
use re4_segment::{ArmEvidence, ArmSegment, ModeRow, SegmentRow};

use super::audit::{measure, segment};
use crate::html::audit::{Flag, Panel, Segment, Series};

/// Maximum number of curves in a plot; more elements of a role get further plots.
const CURVES: usize = 3;

/// The segments. The page's columns of the fingers and of the object's displacement have the opening, as a fraction, and the length of
/// the end effector's path.
pub(super) fn segments(modes: &Artifact) -> Result<Vec<Segment>> {
    let rows: Vec<SegmentRow<ArmSegment>> = modes.read()?;
    let segments = rows.into_iter().map(|row| Segment {
        finger_separation: row.summary.opening,
        object_displacement: row.summary.eef_path.unwrap_or(f64::NAN),
        ..segment(row.episode, row.segment, &row.summary.segment)
    });
    Ok(segments.collect())
}

/// The evidence by frame: flags and plots. Plots of what the dataset does not have are left out.
pub(super) fn evidence(modes: &Artifact, episodes: &Artifact) -> Result<(Vec<Flag>, Vec<Panel>)> {
    let modes: Vec<ModeRow<ArmEvidence>> = modes.read()?;
    let frames: Vec<FrameRow<ArmColumns>> = episodes.read()?;
    let signals: Vec<SignalRow> = if episodes.has::<SignalRow>() {
        episodes.read()?
    } else {
        Vec::new()
    };
    let closes = Flag {
        label: "commanded".to_owned(),
        values: modes.iter().map(|row| row.evidence.command_closes).collect(),
    };
    let holds = Flag {
        label: "holds".to_owned(),
        values: modes.iter().map(|row| Some(row.evidence.holds)).collect(),
    };
    let of_modes = |of: fn(&ArmEvidence) -> Option<f64>| series("", modes.iter().map(|row| of(&row.evidence)));
    let of_frames = |label: &str, of: &dyn Fn(&ArmColumns) -> Option<f64>| {
        series(label, frames.iter().map(|row| of(&row.recorded)))
    };
    let panel = |title: &str, unit: &str, factor: f64, series: Vec<Series>| Panel {
        title: title.to_owned(),
        measure: measure(unit, factor),
        series,
    };
    let height = of_frames("", &|frame| frame.eef.map(|eef| eef.z));
    let mut panels = vec![
        panel("Gripper opening", "% of its travel", 1e2, vec![of_modes(|e| e.opening)]),
        panel("Gripper command", "", 1.0, vec![of_frames("", &|frame| frame.gripper)]),
        panel("Height of the end effector", "mm", 1e3, vec![height]),
        panel(
            "Speed of the end effector",
            "mm/frame",
            1e3,
            vec![of_modes(|e| e.eef_step)],
        ),
    ];
    let vectors = [
        (SignalVector::Action, SignalRole::EefPosition, "Action, translation"),
        (SignalVector::Action, SignalRole::EefOrientation, "Action, rotation"),
        (SignalVector::Action, SignalRole::Joint, "Action, joints"),
        (SignalVector::Action, SignalRole::Other, "Action, others"),
        (SignalVector::State, SignalRole::Joint, "Joints"),
    ];
    for (vector, role, title) in vectors {
        let own: Vec<&SignalRow> = signals
            .iter()
            .filter(|row| row.vector == vector && row.role == role)
            .collect();
        for group in own.chunks(CURVES) {
            let common = common(&group.iter().map(|row| row.name.as_str()).collect::<Vec<_>>());
            let curves = group.iter().map(|row| {
                let index = row.index as usize;
                of_frames(row.name.get(common..).unwrap_or(&row.name), &|frame| match vector {
                    SignalVector::State => frame.state.get(index).copied(),
                    SignalVector::Action => frame.action.get(index).copied(),
                })
            });
            panels.push(panel(title, "", 1.0, curves.collect()));
        }
    }
    panels.push(panel("Reward", "", 1.0, vec![of_frames("", &|frame| frame.reward)]));
    // The first plot is kept, because the number of its values is the number of frames.
    let empty = |panel: &Panel| {
        panel
            .series
            .iter()
            .all(|series| series.values.iter().all(|value| value.is_nan()))
    };
    let mut place = 0;
    panels.retain(|panel| {
        place += 1;
        place == 1 || !empty(panel)
    });
    Ok((vec![closes, holds], panels))
}

/// Length of the beginning that names have in common, up to its last separator, if it is long: the plot has little room for names.
fn common(names: &[&str]) -> usize {
    let Some(first) = names.first().filter(|_| names.iter().any(|name| name.len() > SHORT)) else {
        return 0;
    };
    let same = |end: usize| names.iter().all(|name| name.get(..end) == first.get(..end));
    let separators = first
        .char_indices()
        .filter(|(_, letter)| matches!(letter, '_' | '.' | '/'));
    let ends = separators.map(|(at, letter)| at + letter.len_utf8());
    ends.rev().find(|end| *end < first.len() && same(*end)).unwrap_or(0)
}

/// Names up to this length are shown whole.
const SHORT: usize = 10;

fn series(label: &str, values: impl Iterator<Item = Option<f64>>) -> Series {
    Series {
        label: label.to_owned(),
        values: values.map(|value| value.unwrap_or(f64::NAN)).collect(),
    }
}
