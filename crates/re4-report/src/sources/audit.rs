//! The HTML page of an audit: what its tables and those of its inputs hold, put into the page's own terms.

use anyhow::{Result, ensure};
use nalgebra::Vector3;
use re4_artifact::{Artifact, Label, TableSpec, col_bool, col_f64_or_null, columns, tables};
use re4_episode::Mode;
use re4_geometry::{Point2, Pose2};

use crate::html::audit::{Audit, Contacts, Demo, Finding, Flag, Grasp, Measure, Panel, Segment, Series, page};
use crate::html::rollouts::plane::block_outline;

/// The artifacts that a page is made of, and what it says of them.
#[derive(Debug)]
pub struct AuditSources<'a> {
    /// Name of the task on the page.
    pub task: &'static str,
    /// Whether it is in the plane.
    pub planar: bool,
    /// The dataset as the pipeline names it.
    pub dataset: String,
    /// The command that makes the page, without the page's own place.
    pub command: String,
    /// Demonstrations.
    pub episodes: &'a Artifact,
    /// Their modes.
    pub modes: &'a Artifact,
    /// What was found.
    pub audit: &'a Artifact,
}

/// Makes the page.
///
/// # Errors
/// When tables cannot be read, or are not of the same demonstrations.
pub fn audit_page(sources: &AuditSources<'_>) -> Result<String> {
    let planar = sources.planar;
    let demos: Vec<Demo> = sources.audit.table(&tables::AUDITED_EPISODES)?.read()?;
    let places = Places(demos.iter().map(|demo| demo.number).collect());
    let segments = segments(sources.modes, planar)?;
    places.hold(
        sources.modes,
        "segments",
        segments.iter().map(|segment| segment.episode),
    )?;
    let findings: Vec<Finding> = sources.audit.table(&tables::FINDINGS)?.read()?;
    places.hold(
        sources.audit,
        tables::FINDINGS.name,
        findings.iter().map(|finding| finding.episode),
    )?;
    let grasps = if planar {
        contact_begins(sources.episodes, sources.modes, &segments)?
    } else {
        grasps(sources.audit)?
    };
    places.hold(
        sources.audit,
        tables::GRASPS.name,
        grasps.iter().map(|grasp| grasp.episode),
    )?;
    let frames: u64 = demos.iter().map(|demo| u64::from(demo.frames)).sum();
    let (flags, panels) = if planar {
        PLANAR.read(sources.modes, sources.episodes, [&tables::MODES, &tables::FRAMES])?
    } else {
        SPATIAL.read(
            sources.modes,
            sources.episodes,
            [&tables::SPATIAL_MODES, &tables::SPATIAL_FRAMES],
        )?
    };
    let rows = panels
        .first()
        .and_then(|panel| panel.series.first())
        .map_or(0, |series| series.values.len());
    ensure!(
        rows as u64 == frames,
        "cannot make a page of {}: it counts {frames} frames, and the modes in {} are those of {rows}; run the audit again",
        sources.audit.path().display(),
        sources.modes.path().display()
    );
    Ok(page(&Audit {
        tool_version: env!("CARGO_PKG_VERSION").to_owned(),
        dataset: sources.dataset.clone(),
        task: sources.task.to_owned(),
        command: sources.command.clone(),
        artifacts: [sources.audit, sources.modes, sources.episodes]
            .map(|artifact| (artifact.manifest().artifact.clone(), artifact.key().to_string()))
            .to_vec(),
        frame_seconds: if planar { 0.1 } else { 0.05 },
        length: if planar {
            measure("px", 1.0)
        } else {
            measure("mm", 1000.0)
        },
        checks: sources.audit.table(&tables::CHECKS)?.read()?,
        findings,
        grasps,
        outline: planar.then(block_outline),
        contacts: contacts(sources.audit),
        conventions: if sources.episodes.has_table(&tables::CONVENTIONS) {
            sources.episodes.table(&tables::CONVENTIONS)?.read()?
        } else {
            Vec::new()
        },
        demos,
        segments,
        flags,
        panels,
    }))
}

fn measure(unit: &str, factor: f64) -> Measure {
    Measure {
        unit: unit.to_owned(),
        factor,
    }
}

/// Numbers of the demonstrations on the page, ascending.
struct Places(Vec<u32>);

impl Places {
    /// Refuses a table that names others.
    fn hold(&self, artifact: &Artifact, table: &str, mut episodes: impl Iterator<Item = u32>) -> Result<()> {
        let foreign = episodes.find(|episode| self.0.binary_search(episode).is_err());
        ensure!(
            foreign.is_none(),
            "cannot make a page of {}: table {table} names episode {}, which table {} lacks; run the audit again",
            artifact.path().display(),
            foreign.unwrap_or_default(),
            tables::AUDITED_EPISODES.name
        );
        Ok(())
    }
}

columns! {
    /// A segment, in the plane or in space.
    pub struct AnySegment {
        /// Demonstration.
        pub episode: u32,
        /// Number in it.
        pub segment: u32,
        /// Mode.
        pub mode: Mode,
        /// First frame.
        pub first_frame: u32,
        /// Frame after the last one.
        pub end_frame: u32,
        /// Largest distance of the end effector in the object's frame from the grasp.
        pub rigidity_residual: Option<f64>,
        /// Distance that the object moves.
        pub object_displacement: f64,
    }
}

columns! {
    /// What a segment in space has besides.
    pub struct Held {
        /// First frame at which the fingers have stopped closing.
        pub settled_frame: Option<u32>,
        /// Distance between the fingers there.
        pub finger_separation: Option<f64>,
        /// Largest angle from the grasp.
        pub rigidity_residual_rotation: Option<f64>,
        /// Height that the object rises.
        pub object_rise: f64,
    }
}

fn segments(modes: &Artifact, planar: bool) -> Result<Vec<Segment>> {
    let table = modes.table(if planar {
        &tables::SEGMENTS
    } else {
        &tables::SPATIAL_SEGMENTS
    })?;
    let rows: Vec<AnySegment> = table.read()?;
    let held: Vec<Option<Held>> = if planar {
        vec![None; rows.len()]
    } else {
        table.read()?.into_iter().map(Some).collect()
    };
    let segments = rows.into_iter().zip(held).map(|(row, held)| Segment {
        episode: row.episode,
        number: row.segment,
        transfer: row.mode == Mode::Transfer,
        first_frame: row.first_frame,
        end_frame: row.end_frame,
        settled_frame: held.as_ref().and_then(|held| held.settled_frame),
        finger_separation: held.as_ref().and_then(|held| held.finger_separation),
        residual: row.rigidity_residual,
        residual_rotation: held.as_ref().and_then(|held| held.rigidity_residual_rotation),
        object_displacement: row.object_displacement,
        object_rise: held.map(|held| held.object_rise),
    });
    Ok(segments.collect())
}

columns! {
    /// A grasp in space.
    pub struct SpatialGrasp {
        /// Demonstration.
        pub episode: u32,
        /// Number of its segment.
        pub segment: u32,
        /// First frame of the segment.
        pub first_frame: u32,
        /// Frame after the last one of the segment.
        pub end_frame: u32,
        /// How it went.
        pub outcome: Label,
        /// The end effector in the object's frame.
        pub grasp: Vector3<f64>,
    }
}

fn grasps(audit: &Artifact) -> Result<Vec<Grasp>> {
    let rows: Vec<SpatialGrasp> = audit.table(&tables::GRASPS)?.read()?;
    let grasps = rows.into_iter().map(|row| Grasp {
        episode: row.episode,
        segment: row.segment,
        first_frame: row.first_frame,
        end_frame: row.end_frame,
        outcome: row.outcome.to_string(),
        position: row.grasp.into(),
    });
    Ok(grasps.collect())
}

columns! {
    /// Pusher and block at a frame.
    pub struct Seen {
        /// Pusher.
        pub eef: Point2,
        /// Block.
        pub object: Pose2,
    }
}

columns! {
    /// Whether a frame has contact.
    pub struct Touch {
        /// Demonstration.
        pub episode: u32,
        /// Frame.
        pub frame: u32,
        /// Whether contact was counted; nothing where it is not recorded.
        pub contact: Option<bool>,
    }
}

/// Where the pusher is in the block's frame as contact begins.
fn contact_begins(episodes: &Artifact, modes: &Artifact, segments: &[Segment]) -> Result<Vec<Grasp>> {
    let seen: Vec<Seen> = episodes.table(&tables::FRAMES)?.read()?;
    let touches: Vec<Touch> = modes.table(&tables::MODES)?.read()?;
    let touching = |touch: &Touch| touch.contact == Some(true);
    let mut begins = Vec::new();
    for row in 1..touches.len().min(seen.len()) {
        let Touch { episode, frame, .. } = touches[row];
        if frame == 0 || touches[row - 1].contact != Some(false) || !touching(&touches[row]) {
            continue;
        }
        let lasting = touches[row..]
            .iter()
            .take_while(|later| later.episode == episode && touching(later));
        let of_demo = segments
            .iter()
            .filter(|segment| segment.episode == episode && segment.first_frame <= frame);
        let position = seen[row].object.inverse_transform_point(seen[row].eef);
        begins.push(Grasp {
            episode,
            segment: of_demo.map(|segment| segment.number).max().unwrap_or(0),
            first_frame: frame,
            end_frame: frame + lasting.count() as u32,
            outcome: String::new(),
            position: [position.x, position.y, 0.0],
        });
    }
    Ok(begins)
}

/// What the audit's summary says of contact and motion; nothing where contacts are not recorded.
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

/// Evidence by frame: names of columns, with what they are called on the page.
struct Evidence {
    flags: &'static [(&'static str, &'static str)],
    panels: &'static [(&'static str, &'static str, f64, &'static [Curve])],
}

/// A curve: whether it is of the recorded frames and not of the modes, its column, its name on the page.
type Curve = (bool, &'static str, &'static str);

const DEGREES: f64 = 180.0 / std::f64::consts::PI;

const SPATIAL: Evidence = Evidence {
    flags: &[
        ("command_closes", "gripper closes"),
        ("holds", "evidence holds"),
        ("object_moving", "object moves"),
    ],
    panels: &[
        ("Fingers apart", "mm", 1e3, &[(false, "finger_separation", "")]),
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
        ("Grip to object", "mm", 1e3, &[(false, "eef_object_distance", "")]),
    ],
};

const PLANAR: Evidence = Evidence {
    flags: &[("contact", "in contact"), ("object_moving", "object moves")],
    panels: &[
        ("Contact points", "", 1.0, &[(false, "contacts", "")]),
        (
            "Speed",
            "px/frame",
            1.0,
            &[(false, "eef_step", "pusher"), (false, "object_step", "block")],
        ),
        ("Block turns", "°/frame", DEGREES, &[(false, "object_turn", "")]),
        (
            "Relative translation",
            "px/frame",
            1.0,
            &[(false, "relative_translation", "")],
        ),
        ("Pusher to block", "px", 1.0, &[(false, "eef_object_distance", "")]),
    ],
};

impl Evidence {
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
