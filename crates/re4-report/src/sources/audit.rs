//! The HTML page of an audit: reads the tables of the audit and of its inputs, and converts them to the content of the page.

use std::collections::BTreeMap;

use anyhow::{Result, ensure};
use re4_artifact::episodes::{Convention, FrameRow, ImageRow, PlanarColumns, SpatialColumns};
use re4_artifact::{Artifact, Row as _, TableSpec, col_bool, col_f64_or_null, columns};
use re4_audit::{AuditedEpisodeRow, FindingRow, GraspRow};
use re4_episode::Mode;
use re4_geometry::{Point2, Pose2};
use re4_scores::ScoreRow;
use re4_segment::{Evidence, ModeRow, SegmentRow, SegmentSummary, SpatialEvidence, SpatialSegment};
use re4_task::{Domain, Task};

use crate::html::audit::{Audit, Contacts, Flag, Grasp, Measure, Panel, Segment, Series, Shot, page};
use crate::html::rollouts::plane::block_outline;

/// The artifacts that a page is made from, and the texts about them.
#[derive(Debug)]
pub struct AuditSources<'a> {
    /// Task of the pipeline.
    pub task: Task,
    /// Name of the dataset in the pipeline.
    pub dataset: String,
    /// The command that makes the page, without the path of the page.
    pub command: String,
    /// The `episodes` artifact with the demonstrations.
    pub episodes: &'a Artifact,
    /// The `modes` artifact.
    pub modes: &'a Artifact,
    /// The `audit` artifact.
    pub audit: &'a Artifact,
}

/// Makes the page.
///
/// # Errors
/// If tables cannot be read, or do not describe the same demonstrations.
pub fn audit_page(sources: &AuditSources<'_>) -> Result<String> {
    let domain = sources.task.domain();
    let planar = domain == Domain::Plane;
    let demos: Vec<AuditedEpisodeRow> = sources.audit.read()?;
    let known = KnownEpisodes(demos.iter().map(|demo| demo.episode).collect());
    let segments = match domain {
        Domain::Arm => super::arm::segments(sources.modes)?,
        Domain::Plane | Domain::Space => segments(sources.modes, planar)?,
    };
    known.require(
        sources.modes,
        SegmentRow::<SegmentSummary>::NAME,
        segments.iter().map(|segment| segment.episode),
    )?;
    let findings: Vec<FindingRow> = sources.audit.read()?;
    known.require(
        sources.audit,
        FindingRow::NAME,
        findings.iter().map(|finding| finding.episode),
    )?;
    let grasps = match domain {
        Domain::Plane => contact_onsets(sources.episodes, sources.modes, &segments)?,
        Domain::Space => grasps(sources.audit)?,
        Domain::Arm => Vec::new(),
    };
    known.require(sources.audit, GraspRow::NAME, grasps.iter().map(|grasp| grasp.episode))?;
    let frames: u64 = demos.iter().map(|demo| demo.frames as u64).sum();
    let (flags, panels) = match domain {
        Domain::Plane => PLANAR.read(
            sources.modes,
            sources.episodes,
            [ModeRow::<Evidence>::table(), FrameRow::<PlanarColumns>::table()],
        )?,
        Domain::Space => SPATIAL.read(
            sources.modes,
            sources.episodes,
            [ModeRow::<SpatialEvidence>::table(), FrameRow::<SpatialColumns>::table()],
        )?,
        Domain::Arm => super::arm::evidence(sources.modes, sources.episodes)?,
    };
    let seconds = sources.audit.manifest().summary["arm"]["frame_seconds"].as_f64();
    let rows = panels
        .first()
        .and_then(|panel| panel.series.first())
        .map_or(0, |series| series.values.len());
    ensure!(
        rows as u64 == frames,
        "cannot make a page of {}: it has {frames} frames, but {} has modes for {rows}; run the audit again",
        sources.audit.path().display(),
        sources.modes.path().display()
    );
    let shots = shots(sources.episodes, &findings)?;
    Ok(page(&Audit {
        tool_version: env!("CARGO_PKG_VERSION").to_owned(),
        dataset: sources.dataset.clone(),
        task: sources.task.environment().to_owned(),
        command: sources.command.clone(),
        artifacts: [sources.audit, sources.modes, sources.episodes]
            .map(|artifact| (artifact.manifest().artifact.clone(), artifact.key().to_string()))
            .to_vec(),
        frame_seconds: seconds.unwrap_or(1.0 / sources.task.control_rate() as f64),
        length: if planar {
            measure("px", 1.0)
        } else {
            measure("mm", 1000.0)
        },
        checks: sources.audit.read()?,
        findings,
        grasps,
        object: domain != Domain::Arm,
        outline: planar.then(block_outline),
        contacts: contacts(sources.audit),
        conventions: if sources.episodes.has::<Convention>() {
            sources.episodes.read()?
        } else {
            Vec::new()
        },
        scores: if sources.audit.has::<ScoreRow>() {
            sources.audit.read()?
        } else {
            Vec::new()
        },
        shots,
        demos,
        segments,
        flags,
        panels,
    }))
}

/// Maximum number of camera images on a page; with 84 x 84 pixels, they have about 10 kB each.
const SHOTS: usize = 160;

/// The images in the middle of the findings, of the first camera of the dataset. If there are too many, those of the most severe
/// findings are shown.
fn shots(episodes: &Artifact, findings: &[FindingRow]) -> Result<Vec<Shot>> {
    if !episodes.has::<ImageRow>() {
        return Ok(Vec::new());
    }
    let mut order: Vec<usize> = (0..findings.len())
        .filter(|&at| !findings[at].frames.is_empty())
        .collect();
    order.sort_by_key(|&at| std::cmp::Reverse(findings[at].severity));
    order.truncate(SHOTS);
    let mut wanted: BTreeMap<(u32, u32), Vec<usize>> = BTreeMap::new();
    for at in order {
        let FindingRow { episode, frames, .. } = &findings[at];
        wanted
            .entry((*episode, frames.start.midpoint(frames.end - 1)))
            .or_default()
            .push(at);
    }
    let (mut camera, mut shots) = (None, Vec::new());
    for row in episodes.table(ImageRow::table())?.stream::<ImageRow>()? {
        let row = row?;
        if camera.get_or_insert_with(|| row.camera.clone()) != &row.camera {
            continue;
        }
        for &finding in wanted.get(&(row.episode, row.frame)).into_iter().flatten() {
            shots.push(Shot {
                finding,
                frame: row.frame,
                png: row.image.clone(),
            });
        }
    }
    shots.sort_by_key(|shot| shot.finding);
    Ok(shots)
}

pub(super) fn measure(unit: &str, factor: f64) -> Measure {
    Measure {
        unit: unit.to_owned(),
        factor,
    }
}

/// Numbers of the demonstrations on the page, in increasing order.
struct KnownEpisodes(Vec<u32>);

impl KnownEpisodes {
    /// Returns an error if a table names any other demonstration.
    fn require(&self, artifact: &Artifact, table: &str, mut episodes: impl Iterator<Item = u32>) -> Result<()> {
        let foreign = episodes.find(|episode| self.0.binary_search(episode).is_err());
        ensure!(
            foreign.is_none(),
            "cannot make a page of {}: table {table} names episode {}, which is missing in table {}; run the audit again",
            artifact.path().display(),
            foreign.unwrap_or_default(),
            AuditedEpisodeRow::NAME
        );
        Ok(())
    }
}

fn segments(modes: &Artifact, planar: bool) -> Result<Vec<Segment>> {
    if planar {
        let rows: Vec<SegmentRow<SegmentSummary>> = modes.read()?;
        let segments = rows.into_iter().map(|row| Segment {
            residual: row.summary.rigidity_residual,
            object_displacement: row.summary.object_displacement.unwrap_or(f64::NAN),
            ..segment(row.episode, row.segment, &row.summary.segment)
        });
        return Ok(segments.collect());
    }
    let rows: Vec<SegmentRow<SpatialSegment>> = modes.read()?;
    let segments = rows.into_iter().map(|row| Segment {
        settled_frame: row.summary.settled_frame.map(|frame| frame as u32),
        finger_separation: row.summary.grasp.map(|grasp| grasp.finger_separation),
        residual: row.summary.grasp.map(|grasp| grasp.residual),
        residual_rotation: row.summary.grasp.map(|grasp| grasp.residual_rotation),
        object_displacement: row.summary.object_displacement,
        object_rise: Some(row.summary.object_rise),
        ..segment(row.episode, row.segment, &row.summary.segment)
    });
    Ok(segments.collect())
}

/// The part of a segment that is the same for planar and spatial demonstrations.
pub(super) fn segment(episode: u32, number: u32, segment: &re4_episode::Segment) -> Segment {
    Segment {
        episode,
        number,
        transfer: segment.mode == Mode::Transfer,
        first_frame: segment.frames.start as u32,
        end_frame: segment.frames.end as u32,
        ..Segment::default()
    }
}

fn grasps(audit: &Artifact) -> Result<Vec<Grasp>> {
    let rows: Vec<GraspRow> = audit.read()?;
    let grasps = rows.into_iter().map(|row| Grasp {
        episode: row.episode,
        segment: row.segment as u32,
        first_frame: row.frames.start as u32,
        end_frame: row.frames.end as u32,
        outcome: row.outcome.to_string(),
        position: row.grasp.translation.vector.into(),
    });
    Ok(grasps.collect())
}

columns! {
    /// Pusher and block at a frame.
    pub struct PusherAndBlock {
        /// Position of the pusher.
        pub eef: Point2,
        /// Pose of the block.
        pub object: Option<Pose2>,
    }
}

/// Returns the positions of the pusher in the block's frame at the frames where contact begins.
fn contact_onsets(episodes: &Artifact, modes: &Artifact, segments: &[Segment]) -> Result<Vec<Grasp>> {
    let frames: Vec<PusherAndBlock> = episodes.table(FrameRow::<PlanarColumns>::table())?.read()?;
    let modes: Vec<ModeRow<Evidence>> = modes.read()?;
    let touching = |row: &ModeRow<Evidence>| row.evidence.contact == Some(true);
    let mut onsets = Vec::new();
    for row in 1..modes.len().min(frames.len()) {
        let ModeRow { episode, frame, .. } = modes[row];
        if frame == 0 || modes[row - 1].evidence.contact != Some(false) || !touching(&modes[row]) {
            continue;
        }
        let lasting = modes[row..]
            .iter()
            .take_while(|later| later.episode == episode && touching(later));
        let of_demo = segments
            .iter()
            .filter(|segment| segment.episode == episode && segment.first_frame <= frame);
        let Some(block) = frames[row].object else { continue };
        let position = block.inverse_transform_point(frames[row].eef);
        onsets.push(Grasp {
            episode,
            segment: of_demo.map(|segment| segment.number).max().unwrap_or(0),
            first_frame: frame,
            end_frame: frame + lasting.count() as u32,
            outcome: String::new(),
            position: [position.x, position.y, 0.0],
        });
    }
    Ok(onsets)
}

/// Reads the numbers of steps by contact and motion from the audit's summary; `None` if contacts were not recorded.
fn contacts(audit: &Artifact) -> Option<Contacts> {
    let stated = audit.manifest().summary.get("contacts")?;
    let count = |name: &str| stated.get(name)?.as_u64();
    Some(Contacts {
        both: count("contact_and_motion")?,
        contact_alone: count("contact_alone")?,
        motion_alone: count("motion_alone")?,
        neither: count("neither")?,
        jaccard: stated.get("jaccard")?.as_f64(),
    })
}

/// The evidence by frame that the page shows.
struct Shown {
    /// Column of the table of modes, and its name on the page.
    flags: &'static [(&'static str, &'static str)],
    /// Title, unit, factor from the artifact's unit to that unit, and curves of each plot.
    panels: &'static [(&'static str, &'static str, f64, &'static [Curve])],
}

/// A curve: whether its column is in the table of recorded frames (otherwise, in the table of modes), the column, and its name on
/// the page.
type Curve = (bool, &'static str, &'static str);

const DEGREES: f64 = 180.0 / std::f64::consts::PI;

const SPATIAL: Shown = Shown {
    flags: &[
        ("command_closes", "commanded"),
        ("holds", "object held"),
        ("object_moving", "object moves"),
    ],
    panels: &[
        ("Finger separation", "mm", 1e3, &[(false, "finger_separation", "")]),
        (
            "Height",
            "mm",
            1e3,
            &[(true, "eef_z", "end effector"), (true, "object_z", "object")],
        ),
        (
            "Speed",
            "mm/frame",
            1e3,
            &[(false, "eef_step", "end effector"), (false, "object_step", "object")],
        ),
        (
            "Relative translation",
            "mm/frame",
            1e3,
            &[(false, "relative_translation", "")],
        ),
        (
            "Relative rotation",
            "°/frame",
            DEGREES,
            &[(false, "relative_rotation", "")],
        ),
        ("Grip site to object", "mm", 1e3, &[(false, "eef_object_distance", "")]),
        (
            "Action, translation",
            "of the limit",
            1.0,
            &[(true, "delta_x", "x"), (true, "delta_y", "y"), (true, "delta_z", "z")],
        ),
        (
            "Action, rotation",
            "of the limit",
            1.0,
            &[
                (true, "delta_rx", "x"),
                (true, "delta_ry", "y"),
                (true, "delta_rz", "z"),
            ],
        ),
        ("Action, gripper", "", 1.0, &[(true, "gripper", "")]),
        ("Reward", "", 1.0, &[(true, "reward", "")]),
    ],
};

const PLANAR: Shown = Shown {
    flags: &[("contact", "in contact"), ("object_moving", "object moves")],
    panels: &[
        ("Contact points", "", 1.0, &[(false, "contacts", "")]),
        (
            "Speed",
            "px/frame",
            1.0,
            &[(false, "eef_step", "pusher"), (false, "object_step", "block")],
        ),
        ("Block rotation", "°/frame", DEGREES, &[(false, "object_rotation", "")]),
        (
            "Relative translation",
            "px/frame",
            1.0,
            &[(false, "relative_translation", "")],
        ),
        ("Pusher to block", "px", 1.0, &[(false, "eef_object_distance", "")]),
        (
            "Action (target)",
            "px",
            1.0,
            &[(true, "action_x", "x"), (true, "action_y", "y")],
        ),
    ],
};

impl Shown {
    fn read(
        &self,
        modes: &Artifact,
        frames: &Artifact,
        [of_modes, of_frames]: [&'static TableSpec; 2],
    ) -> Result<(Vec<Flag>, Vec<Panel>)> {
        let modes = modes.table(of_modes)?.read_all()?;
        let frames = frames.table(of_frames)?;
        let flags = self.flags.iter().map(|(name, label)| {
            Ok(Flag {
                label: (*label).to_owned(),
                values: col_bool(&modes, name)?.iter().collect(),
            })
        });
        let series = |(recorded, name, label): &Curve| {
            let values = if *recorded {
                col_f64_or_null(&frames.read_columns(&[name])?, name)?
            } else {
                col_f64_or_null(&modes, name)?
            };
            Ok(Series {
                label: (*label).to_owned(),
                values: values.into_iter().map(|value| value.unwrap_or(f64::NAN)).collect(),
            })
        };
        let panels = self.panels.iter().map(|(title, unit, factor, curves)| {
            Ok(Panel {
                title: (*title).to_owned(),
                measure: measure(unit, *factor),
                series: curves.iter().map(series).collect::<Result<_>>()?,
            })
        });
        Ok((flags.collect::<Result<_>>()?, panels.collect::<Result<_>>()?))
    }
}
