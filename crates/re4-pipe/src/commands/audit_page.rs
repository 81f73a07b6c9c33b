//! The HTML page of an audit: what its tables and those of its inputs hold, put into the page's own terms.

use anyhow::{Context as _, Result, ensure};
use arrow::record_batch::RecordBatch;
use re4_artifact::{
    Artifact, Row as _, TableSpec, col_bool, col_f64, col_f64_or_null, col_text, col_u32, col_u32_or_null, columns,
};
use re4_audit::{AuditedEpisodeRow, CheckRow, FindingRow, GraspRow};
use re4_geometry::{Point2, Pose2};
use re4_ingest::{FrameRow, PlanarColumns, SpatialColumns};
use re4_report::html::audit::{
    Audit, Check, Contacts, Convention, Demo, Finding, Flag, Grasp, Measure, Panel, Segment, Series, Severity, page,
};
use re4_segment::{Evidence, ModeRow, SegmentFacts, SegmentRow, SpatialEvidence, SpatialSegment};

use crate::arguments::StageArguments;
use crate::console::Console;
use crate::output::Output;
use re4_stages::Task;
use re4_stages::{Built, Runner};

/// A page beyond this many bytes takes a while to open, which is said.
const LARGE_PAGE: usize = 12_000_000;

/// The artifacts that a page is made of.
pub(crate) struct Sources<'a> {
    /// Task of the pipeline.
    pub(crate) task: Task,
    /// The dataset as the pipeline names it.
    pub(crate) dataset: String,
    /// The command that makes the page, without the page's own place.
    pub(crate) command: String,
    /// Demonstrations.
    pub(crate) episodes: &'a Artifact,
    /// Their modes.
    pub(crate) modes: &'a Artifact,
    /// What was found.
    pub(crate) audit: &'a Artifact,
}

impl<'a> Sources<'a> {
    /// Of a pipeline's `episodes`, `modes` and `audit`.
    pub(crate) fn of(runner: &Runner, arguments: &StageArguments, [episodes, modes, audit]: [&'a Built; 3]) -> Self {
        let ingest = &runner.pipeline.ingest;
        let source = ingest.source.display();
        let settings: String = arguments
            .set
            .iter()
            .map(|setting| [" --set ", setting].concat())
            .collect();
        let command = format!("re4-pipe audit {}{settings}", arguments.pipeline.display());
        Self {
            task: runner.pipeline.task,
            dataset: match &ingest.filter {
                Some(filter) => format!("{source}, filter {filter}"),
                None => source.to_string(),
            },
            command,
            episodes: &episodes.artifact,
            modes: &modes.artifact,
            audit: &audit.artifact,
        }
    }
}

/// Writes the page, whole or not at all.
pub(crate) fn write(sources: &Sources<'_>, output: &Output, console: Console) -> Result<()> {
    let text = page(&read(sources)?);
    output.write(&text)?;
    let size = text.len() as f64 / 1e6;
    console.note(&format!("{:>10}  {}  {size:.1} MB", "page", output.named().display()));
    if text.len() > LARGE_PAGE {
        console.note(&format!(
            "warning: the page is {size:.0} MB large and may open slowly; ingest.filter or ingest.select limits the demonstrations"
        ));
    }
    Ok(())
}

fn read(sources: &Sources<'_>) -> Result<Audit> {
    let planar = sources.task.is_planar();
    let demos = demos(sources.audit)?;
    let places = Places {
        numbers: demos.iter().map(|demo| demo.number).collect(),
    };
    let segments = segments(sources.modes, planar, &places)?;
    let frames: u64 = demos.iter().map(|demo| u64::from(demo.frames)).sum();
    let (flags, panels) = if planar {
        planar_evidence(sources.modes)?
    } else {
        spatial_evidence(sources.modes, sources.episodes)?
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
    Ok(Audit {
        tool_version: env!("CARGO_PKG_VERSION").to_owned(),
        dataset: sources.dataset.clone(),
        task: sources.task.environment().to_owned(),
        command: sources.command.clone(),
        artifacts: [sources.audit, sources.modes, sources.episodes]
            .map(|artifact| (artifact.manifest().artifact.clone(), artifact.key().to_string()))
            .to_vec(),
        frame_seconds: 1.0 / sources.task.control_rate() as f64,
        length: if planar {
            measure("px", 1.0)
        } else {
            measure("mm", 1000.0)
        },
        checks: checks(sources.audit)?,
        findings: findings(sources.audit, &places)?,
        grasps: if planar {
            contact_begins(sources.episodes, sources.modes, &segments, &places)?
        } else {
            grasps(sources.audit, &places)?
        },
        outline: planar.then(super::report::block_outline),
        contacts: contacts(sources.audit),
        conventions: if sources.episodes.has::<re4_ingest::Convention>() {
            conventions(sources.episodes)?
        } else {
            Vec::new()
        },
        demos,
        segments,
        flags,
        panels,
    })
}

fn measure(unit: &str, factor: f64) -> Measure {
    Measure {
        unit: unit.to_owned(),
        factor,
    }
}

/// Where demonstrations stand on the page, by their number.
struct Places {
    numbers: Vec<u32>,
}

impl Places {
    fn of(&self, artifact: &Artifact, table: &TableSpec, episode: u32) -> Result<usize> {
        self.numbers.binary_search(&episode).ok().with_context(|| {
            format!(
                "cannot make a page of {}: table {} names episode {episode}, which table {} lacks; run the audit again",
                artifact.path().display(),
                table.name,
                AuditedEpisodeRow::table().name
            )
        })
    }
}

fn texts(batch: &RecordBatch, name: &str) -> Result<Vec<String>> {
    let column = col_text(batch, name)?;
    Ok(column
        .into_iter()
        .map(|text| text.unwrap_or_default().to_owned())
        .collect())
}

fn severity(word: &str, artifact: &Artifact) -> Result<Severity> {
    Severity::from_name(word).with_context(|| {
        format!(
            "cannot make a page of {}: it names a severity {word:?}; there are error, warning and note",
            artifact.path().display()
        )
    })
}

fn demos(audit: &Artifact) -> Result<Vec<Demo>> {
    let rows = audit.table(AuditedEpisodeRow::table())?.read_all()?;
    let names = texts(&rows, "demo")?;
    let count = |name| col_u32(&rows, name);
    let (number, frames) = (count("episode")?, count("frames")?);
    let (transit, transfer) = (count("transit_frames")?, count("transfer_frames")?);
    let (segments, transfers) = (count("segments")?, count("transfers")?);
    let (errors, warnings, notes) = (count("errors")?, count("warnings")?, count("notes")?);
    let grasp = col_u32_or_null(&rows, "grasp_frame")?;
    let displacement = col_f64(&rows, "object_displacement")?;
    Ok(names
        .into_iter()
        .enumerate()
        .map(|(i, name)| Demo {
            number: number[i],
            name,
            frames: frames[i],
            transit_frames: transit[i],
            transfer_frames: transfer[i],
            segments: segments[i],
            transfers: transfers[i],
            grasp_frame: grasp[i],
            object_displacement: displacement[i],
            errors: errors[i],
            warnings: warnings[i],
            notes: notes[i],
        })
        .collect())
}

fn checks(audit: &Artifact) -> Result<Vec<Check>> {
    let rows = audit.table(CheckRow::table())?.read_all()?;
    let (code, word) = (texts(&rows, "code")?, texts(&rows, "severity")?);
    let (meaning, measure) = (texts(&rows, "meaning")?, texts(&rows, "measure")?);
    let (unit, origin, derivation) = (
        texts(&rows, "unit")?,
        texts(&rows, "origin")?,
        texts(&rows, "derivation")?,
    );
    let threshold = col_f64_or_null(&rows, "threshold")?;
    let (found, episodes) = (col_u32(&rows, "findings")?, col_u32(&rows, "episodes")?);
    (0..rows.num_rows())
        .map(|i| {
            Ok(Check {
                code: code[i].clone(),
                severity: severity(&word[i], audit)?,
                meaning: meaning[i].clone(),
                measure: measure[i].clone(),
                threshold: threshold[i],
                unit: unit[i].clone(),
                origin: origin[i].clone(),
                derivation: derivation[i].clone(),
                findings: found[i],
                episodes: episodes[i],
            })
        })
        .collect()
}

fn findings(audit: &Artifact, places: &Places) -> Result<Vec<Finding>> {
    let rows = audit.table(FindingRow::table())?.read_all()?;
    let (word, code) = (texts(&rows, "severity")?, texts(&rows, "code")?);
    let (unit, message) = (texts(&rows, "unit")?, texts(&rows, "message")?);
    let (value, threshold) = (col_f64_or_null(&rows, "value")?, col_f64_or_null(&rows, "threshold")?);
    let (first, end) = (col_u32(&rows, "first_frame")?, col_u32(&rows, "end_frame")?);
    col_u32(&rows, "episode")?
        .iter()
        .enumerate()
        .map(|(i, &episode)| {
            Ok(Finding {
                severity: severity(&word[i], audit)?,
                code: code[i].clone(),
                demo: places.of(audit, FindingRow::table(), episode)?,
                first_frame: first[i],
                end_frame: end[i],
                value: value[i],
                threshold: threshold[i],
                unit: unit[i].clone(),
                message: message[i].clone(),
            })
        })
        .collect()
}

fn segments(modes: &Artifact, planar: bool, places: &Places) -> Result<Vec<Segment>> {
    let spec = if planar {
        SegmentRow::<SegmentFacts>::table()
    } else {
        SegmentRow::<SpatialSegment>::table()
    };
    let rows = modes.table(spec)?.read_all()?;
    let mode = texts(&rows, "mode")?;
    let (number, first, end) = (
        col_u32(&rows, "segment")?,
        col_u32(&rows, "first_frame")?,
        col_u32(&rows, "end_frame")?,
    );
    let residual = col_f64_or_null(&rows, "rigidity_residual")?;
    let displacement = col_f64(&rows, "object_displacement")?;
    let spatial = |name| {
        if planar {
            Ok(vec![None; rows.num_rows()])
        } else {
            col_f64_or_null(&rows, name)
        }
    };
    let (separation, turned) = (spatial("finger_separation")?, spatial("rigidity_residual_rotation")?);
    let rise = spatial("object_rise")?;
    let settled = if planar {
        vec![None; rows.num_rows()]
    } else {
        col_u32_or_null(&rows, "settled_frame")?
    };
    col_u32(&rows, "episode")?
        .iter()
        .enumerate()
        .map(|(i, &episode)| {
            Ok(Segment {
                demo: places.of(modes, spec, episode)?,
                number: number[i],
                transfer: mode[i] == "transfer",
                first_frame: first[i],
                end_frame: end[i],
                settled_frame: settled[i],
                finger_separation: separation[i],
                residual: residual[i],
                residual_rotation: turned[i],
                object_displacement: displacement[i],
                object_rise: rise[i],
            })
        })
        .collect()
}

fn grasps(audit: &Artifact, places: &Places) -> Result<Vec<Grasp>> {
    let rows = audit.table(GraspRow::table())?.read_all()?;
    let outcome = texts(&rows, "outcome")?;
    let (segment, first, end) = (
        col_u32(&rows, "segment")?,
        col_u32(&rows, "first_frame")?,
        col_u32(&rows, "end_frame")?,
    );
    let (x, y, z) = (
        col_f64(&rows, "grasp_x")?,
        col_f64(&rows, "grasp_y")?,
        col_f64(&rows, "grasp_z")?,
    );
    col_u32(&rows, "episode")?
        .iter()
        .enumerate()
        .map(|(i, &episode)| {
            Ok(Grasp {
                demo: places.of(audit, GraspRow::table(), episode)?,
                segment: segment[i],
                first_frame: first[i],
                end_frame: end[i],
                outcome: outcome[i].clone(),
                position: [x[i], y[i], z[i]],
            })
        })
        .collect()
}

columns! {
    /// Where pusher and block are.
    pub struct EefAndObject {
        /// Position of the pusher.
        pub eef: Point2,
        /// Pose of the block.
        pub object: Option<Pose2>,
    }
}

/// Where the pusher is in the block's frame as contact begins.
fn contact_begins(episodes: &Artifact, modes: &Artifact, segments: &[Segment], places: &Places) -> Result<Vec<Grasp>> {
    let rows = episodes
        .table(FrameRow::<PlanarColumns>::table())?
        .read::<EefAndObject>()?;
    let listed = modes
        .table(ModeRow::<Evidence>::table())?
        .read_columns(&["episode", "frame", "contact"])?;
    let (episode, frame) = (col_u32(&listed, "episode")?, col_u32(&listed, "frame")?);
    let contact: Vec<Option<bool>> = col_bool(&listed, "contact")?.iter().collect();
    let touching = |row: usize| contact[row] == Some(true);
    let mut begins = Vec::new();
    for row in 1..listed.num_rows().min(rows.len()) {
        if frame[row] == 0 || contact[row - 1] != Some(false) || !touching(row) {
            continue;
        }
        let length = (row..listed.num_rows())
            .take_while(|&later| episode[later] == episode[row] && touching(later))
            .count() as u32;
        let demo = places.of(modes, ModeRow::<Evidence>::table(), episode[row])?;
        let Some(object) = rows[row].object else { continue };
        let seen = object.inverse_transform_point(rows[row].eef);
        begins.push(Grasp {
            demo,
            segment: segment_at(segments, demo, frame[row]),
            first_frame: frame[row],
            end_frame: frame[row] + length,
            outcome: String::new(),
            position: [seen.x, seen.y, 0.0],
        });
    }
    Ok(begins)
}

/// Number of the segment that holds a frame.
fn segment_at(segments: &[Segment], demo: usize, frame: u32) -> u32 {
    let of_demo = segments.iter().filter(|segment| segment.demo == demo);
    of_demo
        .filter(|segment| segment.first_frame <= frame)
        .map(|segment| segment.number)
        .max()
        .unwrap_or(0)
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

fn conventions(episodes: &Artifact) -> Result<Vec<Convention>> {
    let rows = episodes.read::<re4_ingest::Convention>()?.into_iter();
    Ok(rows
        .map(|row| Convention {
            name: row.convention.to_string(),
            value: row.value.to_string(),
            basis: row.basis.to_string(),
            evidence: row.evidence,
            residual: row.residual,
            runner_up: row.runner_up,
            threshold: row.threshold,
            unit: row.unit.to_string(),
            frames: row.frames as u32,
        })
        .collect())
}

fn flag(rows: &RecordBatch, name: &str, label: &str) -> Result<Flag> {
    Ok(Flag {
        label: label.to_owned(),
        values: col_bool(rows, name)?.iter().collect(),
    })
}

fn series(rows: &RecordBatch, name: &str, label: &str) -> Result<Series> {
    Ok(Series {
        label: label.to_owned(),
        values: col_f64_or_null(rows, name)?
            .into_iter()
            .map(|value| value.unwrap_or(f64::NAN))
            .collect(),
    })
}

fn panel(title: &str, measure: Measure, series: Vec<Series>) -> Panel {
    Panel {
        title: title.to_owned(),
        measure,
        series,
    }
}

fn degrees() -> f64 {
    1.0_f64.to_degrees()
}

fn spatial_evidence(modes: &Artifact, episodes: &Artifact) -> Result<(Vec<Flag>, Vec<Panel>)> {
    let rows = modes.table(ModeRow::<SpatialEvidence>::table())?.read_all()?;
    let recorded = episodes
        .table(FrameRow::<SpatialColumns>::table())?
        .read_columns(&["eef_z", "object_z"])?;
    let flags = vec![
        flag(&rows, "command_closes", "gripper closes")?,
        flag(&rows, "holds", "evidence holds")?,
        flag(&rows, "object_moving", "object moves")?,
    ];
    let one = |name, label| series(&rows, name, label);
    let panels = vec![
        panel("Fingers apart", measure("mm", 1e3), vec![one("finger_separation", "")?]),
        panel(
            "Height",
            measure("mm", 1e3),
            vec![
                series(&recorded, "eef_z", "end effector")?,
                series(&recorded, "object_z", "object")?,
            ],
        ),
        panel(
            "Speed",
            measure("mm/frame", 1e3),
            vec![one("eef_step", "end effector")?, one("object_step", "object")?],
        ),
        panel(
            "Relative translation",
            measure("mm/frame", 1e3),
            vec![one("relative_translation", "")?],
        ),
        panel(
            "Relative rotation",
            measure("°/frame", degrees()),
            vec![one("relative_rotation", "")?],
        ),
        panel(
            "Grip to object",
            measure("mm", 1e3),
            vec![one("eef_object_distance", "")?],
        ),
    ];
    Ok((flags, panels))
}

fn planar_evidence(modes: &Artifact) -> Result<(Vec<Flag>, Vec<Panel>)> {
    let rows = modes.table(ModeRow::<Evidence>::table())?.read_all()?;
    let flags = vec![
        flag(&rows, "contact", "in contact")?,
        flag(&rows, "object_moving", "object moves")?,
    ];
    let one = |name, label| series(&rows, name, label);
    let panels = vec![
        panel("Contact points", measure("", 1.0), vec![one("contacts", "")?]),
        panel(
            "Speed",
            measure("px/frame", 1.0),
            vec![one("eef_step", "pusher")?, one("object_step", "block")?],
        ),
        panel(
            "Block turns",
            measure("°/frame", degrees()),
            vec![one("object_turn", "")?],
        ),
        panel(
            "Relative translation",
            measure("px/frame", 1.0),
            vec![one("relative_translation", "")?],
        ),
        panel(
            "Pusher to block",
            measure("px", 1.0),
            vec![one("eef_object_distance", "")?],
        ),
    ];
    Ok((flags, panels))
}
