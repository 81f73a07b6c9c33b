//! Tables of the audit of a segmentation: planar and spatial demonstrations alike. Units are those of the row.

use super::{EPISODE, NAME_IN_SOURCE, category, id, number};
use crate::spec::ColumnKind::{F64, Text, U32};
use crate::spec::{ColumnSpec, TableSpec};

/// Findings.
pub const FINDINGS: TableSpec = TableSpec {
    name: "findings",
    version: 2,
    domain: "",
    formerly: "",
    description: "One row a finding: what looks wrong, where, by which measure against which threshold. Sorted by episode, first frame and code.",
    columns: &[
        id("finding", "Number of the finding in this artifact, from 0."),
        category(
            "severity",
            "error: the segmentation or the data is wrong here; warning: probably not what the demonstrator wanted, or a trap for a learner; note: worth knowing.",
        ),
        category("code", "Kind of the finding; its meaning stands in table checks."),
        EPISODE,
        id("first_frame", "First frame that it concerns."),
        id("end_frame", "Frame after the last one that it concerns."),
        ColumnSpec::new(
            "value",
            F64,
            "What was measured; null where there is nothing to measure.",
        )
        .nullable(),
        ColumnSpec::new("threshold", F64, "What it was compared with; null likewise.").nullable(),
        category("unit", "Unit of value and threshold; empty for none."),
        ColumnSpec::new("message", Text, "The finding in one sentence."),
        NAME_IN_SOURCE,
    ],
};

/// The checks of an audit.
pub const CHECKS: TableSpec = TableSpec {
    name: "checks",
    version: 1,
    domain: "",
    formerly: "",
    description: "One row a check that was made, whether or not it found something, with its threshold and where that comes from. Sorted by code.",
    columns: &[
        category("code", "Kind of finding that it makes."),
        category("severity", "Severity of its findings."),
        ColumnSpec::new("meaning", Text, "What such a finding means, and what to do about it."),
        ColumnSpec::new("measure", Text, "What is measured."),
        ColumnSpec::new("threshold", F64, "What it is compared with; null where there is none.").nullable(),
        category("unit", "Unit of the threshold; empty for none."),
        category(
            "origin",
            "Where the threshold comes from: data, derived from this dataset; setting, from the pipeline file; default, built in.",
        ),
        ColumnSpec::new("derivation", Text, "How it was derived, in words."),
        id("findings", "How many findings it made."),
        id("episodes", "In how many demonstrations."),
    ],
};

/// Demonstrations as the audit sees them.
pub const AUDITED_EPISODES: TableSpec = TableSpec {
    name: "audited_episodes",
    version: 1,
    domain: "",
    formerly: "",
    description: "One row a demonstration: its length, its modes and how much was found in it. Sorted by episode.",
    columns: &[
        EPISODE,
        ColumnSpec::new("demo", Text, "Name of the demonstration in its source."),
        id("frames", "Frames."),
        id("transit_frames", "Frames in transit."),
        id("transfer_frames", "Frames in transfer."),
        id("segments", "Segments."),
        id("transfers", "Transfer segments."),
        ColumnSpec::new("grasp_frame", U32, "First transfer frame; null where there is none.").nullable(),
        number(
            "object_displacement",
            "Distance of the object's origin at the end from where it was at the start; px or m, as the task's tables.",
        ),
        id("errors", "Findings of severity error."),
        id("warnings", "Findings of severity warning."),
        id("notes", "Findings of severity note."),
    ],
};

/// Grasps of demonstrations with a gripper.
pub const GRASPS: TableSpec = TableSpec {
    name: "grasps",
    version: 1,
    domain: "",
    formerly: "",
    description: "One row a transfer segment of a demonstration with a gripper: where the object was grasped and how it went. Sorted by episode and segment.",
    columns: &[
        EPISODE,
        id("segment", "Number of the segment in its episode, from 0."),
        id("first_frame", "First frame of the segment."),
        id("end_frame", "Frame after the last one of the segment."),
        category("outcome", "held: the object stays fixed to the end effector; missed: the fingers closed on nothing; lost: it was held, and slipped out before the command to open; brief: too short to tell."),
        number("grasp_x", "End effector in the object's frame at the settled frame, x.").unit("m").frame("object"),
        number("grasp_y", "End effector in the object's frame at the settled frame, y.").unit("m").frame("object"),
        number("grasp_z", "End effector in the object's frame at the settled frame, z.").unit("m").frame("object"),
        number("grasp_qx", "Its orientation, quaternion part x.").frame("object"),
        number("grasp_qy", "Its orientation, quaternion part y.").frame("object"),
        number("grasp_qz", "Its orientation, quaternion part z.").frame("object"),
        number("grasp_qw", "Its orientation, quaternion part w.").frame("object"),
        number("finger_separation", "Distance between the fingers at the settled frame.").unit("m"),
        number("rigidity_residual", "Largest distance of the end effector in the object's frame from the grasp transform, over the part of the segment that is held.").unit("m"),
        number("object_rise", "Greatest height of the object over where it was at the start of the segment.").unit("m"),
    ],
};
