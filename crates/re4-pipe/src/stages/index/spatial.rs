//! The index of robosuite's tasks.

use std::collections::BTreeMap;

use anyhow::{Context as _, Result, bail};
use arrow::array::RecordBatch;
use nalgebra::{Isometry3, Quaternion, Translation3, UnitQuaternion, Vector3};
use re4_artifact::{Artifact, Columns, Facts, Recipe, Stage, col_bool, col_f64, col_text, col_u32, tables};
use re4_audit::SpatialDemo;
use re4_episode::Mode;
use re4_geometry::spatial::Symmetry;
use re4_policy::DemoNames;
use re4_policy::spatial::{SpatialDemoFrame, SpatialDemoSet, SpatialKnowledge, SpatialRetrieveConfig};
use re4_robosuite::hand_to_site;
use serde_json::json;

use super::super::demos::SegmentedEpisodes;
use super::super::{Built, Runner};
use super::estimated::EstimatedPoses;
use crate::pipeline::Estimates;
use crate::poses::{PARTS, pose_columns};

/// Raised whenever the same input gives other bytes.
const CODE_VERSION: u32 = 1;

impl Runner {
    /// The `index` artifact of a robosuite task, over the poses of the `poses` artifact where there is one, over the recorded
    /// ones otherwise. With a `poses` artifact, the recorded object pose is read for nothing: what `index.leave_out` names is
    /// then found by the fingers alone.
    pub(crate) fn index_spatial(&self, episodes: &Built, modes: &Built, poses: Option<&Built>) -> Result<Built> {
        let leave_out = &self.pipeline.index()?.leave_out;
        let audit = if leave_out.is_empty() || poses.is_some() {
            None
        } else {
            Some(self.audit(episodes, modes)?)
        };
        let mut config = json!({
            "task": self.pipeline.task,
            "leave_out": leave_out,
            "pose": { "source": self.pipeline.pose()?.source },
        });
        if poses.is_some() && !leave_out.is_empty() {
            config["by_fingers"] = self.audit_config();
        }
        let estimates = self.pipeline.index()?.estimates;
        if poses.is_some() && estimates != Estimates::default() {
            config["estimates"] = json!(estimates);
        }
        let mut recipe = Recipe::new(Stage::Index, CODE_VERSION)
            .config(&config)?
            .input("episodes", episodes.artifact.key())
            .input("modes", modes.artifact.key());
        if let Some(audit) = &audit {
            recipe = recipe.input("audit", audit.artifact.key());
        }
        if let Some(poses) = poses {
            recipe = recipe.input("poses", poses.artifact.key());
        }
        self.build(&recipe, |writer| {
            let ends = match (&audit, poses) {
                (Some(audit), _) => left_out(&audit.artifact, leave_out)?,
                (None, Some(_)) if !leave_out.is_empty() => {
                    self.left_out_by_fingers(&episodes.artifact, &modes.artifact, leave_out)?
                }
                _ => BTreeMap::new(),
            };
            let estimated = poses.map(|poses| EstimatedPoses::open(&poses.artifact)).transpose()?;
            let to_site = orientation_to_site(&episodes.artifact)?;
            let (mut demos, mut frames, mut retrievable) = (0_u64, 0_u64, 0_u64);
            let mut table = writer.table(&tables::SPATIAL_INDEX)?;
            for demo in SegmentedEpisodes::open(&episodes.artifact, &modes.artifact)? {
                self.interrupt.check("index")?;
                let mut demo = demo?;
                if let Some(estimated) = &estimated {
                    estimated.put_into(&mut demo, estimates)?;
                }
                let end = ends.get(&demo.number).copied().unwrap_or(0) as usize;
                let count = demo.episode.frames.len();
                demos += 1;
                frames += count as u64;
                retrievable += count.saturating_sub(end) as u64;
                table.write_columns(columns(&demo, &to_site, end))?;
            }
            table.finish()?;
            if let Some(estimated) = &estimated {
                estimated.check_count(demos)?;
            }
            if retrievable == 0 {
                bail!(
                    "cannot index {}: every frame is left out by index.leave_out; name fewer checks",
                    episodes.artifact.path().display()
                );
            }
            Ok(Facts {
                summary: json!({ "episodes": demos, "frames": frames, "retrievable_frames": retrievable }),
                warnings: Vec::new(),
            })
        })
    }
}

/// The end of the last finding of one of these checks, by demonstration.
fn left_out(audit: &Artifact, checks: &[String]) -> Result<BTreeMap<u32, u32>> {
    let known = audit.table(&tables::CHECKS)?.read_columns(&["code"])?;
    check_names(checks, col_text(&known, "code")?.into_iter().flatten())?;
    let findings = audit
        .table(&tables::FINDINGS)?
        .read_columns(&["episode", "code", "end_frame"])?;
    let (episodes, ends) = (col_u32(&findings, "episode")?, col_u32(&findings, "end_frame")?);
    let mut last = BTreeMap::new();
    for ((episode, end), code) in episodes.iter().zip(ends).zip(col_text(&findings, "code")?) {
        if checks.iter().any(|check| Some(check.as_str()) == code) {
            let entry = last.entry(*episode).or_insert(0);
            *entry = (*end).max(*entry);
        }
    }
    Ok(last)
}

/// Refuses names that no check has.
pub(super) fn check_names<'a>(checks: &[String], known: impl Iterator<Item = &'a str>) -> Result<()> {
    let known: Vec<&str> = known.collect();
    match checks.iter().find(|check| !known.contains(&check.as_str())) {
        Some(check) => bail!(
            "index.leave_out names the check {check:?}, which the audit does not have; its checks are {}",
            known.join(", ")
        ),
        None => Ok(()),
    }
}

/// The rotation from the end effector's recorded frame to that of the grip site.
pub(in super::super) fn orientation_to_site(episodes: &Artifact) -> Result<UnitQuaternion<f64>> {
    let rows = episodes
        .table(&tables::CONVENTIONS)?
        .read_columns(&["convention", "value"])?;
    let (names, values) = (col_text(&rows, "convention")?, col_text(&rows, "value")?);
    let row = names.iter().position(|name| *name == Some("eef_orientation"));
    match row.and_then(|row| values[row]) {
        Some("hand_body") => Ok(hand_to_site()),
        Some("grip_site") => Ok(UnitQuaternion::identity()),
        _ => bail!(
            "cannot tell whose orientation the end effector's is: table conventions of {} does not say it; ingest the dataset anew",
            episodes.path().display()
        ),
    }
}

fn columns(demo: &SpatialDemo, to_site: &UnitQuaternion<f64>, end: usize) -> Columns {
    let frames = &demo.episode.frames;
    let eef: Vec<Isometry3<f64>> = frames.iter().map(|frame| frame.eef * to_site).collect();
    let object: Vec<Isometry3<f64>> = frames.iter().map(|frame| frame.object).collect();
    let mut columns = Columns::new(&tables::SPATIAL_INDEX)
        .u32("episode", vec![demo.number; frames.len()])
        .u32("frame", (0..frames.len() as u32).collect())
        .text("mode", demo.segmented.modes.iter().map(|mode| mode.as_str()));
    columns = pose_columns(columns, "eef", &eef);
    columns = pose_columns(columns, "object", &object);
    for (part, name) in ["x", "y", "z", "rx", "ry", "rz"].into_iter().enumerate() {
        columns = columns.f64(
            &format!("goal_{name}"),
            frames.iter().map(|frame| frame.goal[part]).collect(),
        );
    }
    let commands = frames.iter().map(|frame| {
        let size = frame.gripper.abs();
        if frame.closes { size } else { -size }
    });
    columns
        .f64("gripper", commands.collect())
        .bool("retrievable", (0..frames.len()).map(|frame| frame >= end).collect())
}

/// Poses of seven columns each, whose names begin with `prefix`.
pub(super) fn read_poses(table: &RecordBatch, prefix: &str) -> Result<Vec<Isometry3<f64>>> {
    let parts = PARTS
        .iter()
        .map(|part| col_f64(table, &format!("{prefix}_{part}")))
        .collect::<Result<Vec<_>, _>>()?;
    Ok((0..table.num_rows())
        .map(|i| {
            let part = |k: usize| parts[k][i];
            Isometry3::from_parts(
                Translation3::new(part(0), part(1), part(2)),
                UnitQuaternion::new_unchecked(Quaternion::new(part(6), part(3), part(4), part(5))),
            )
        })
        .collect())
}

/// What a policy needs of an `index` artifact, whose demonstrations have these names.
pub(in super::super) fn open_spatial_index(
    artifact: &Artifact,
    retrieve: &SpatialRetrieveConfig,
    symmetry: Symmetry,
    names: DemoNames,
) -> Result<SpatialKnowledge> {
    let table = artifact.table(&tables::SPATIAL_INDEX)?.read_all()?;
    let column = |name: &str| col_f64(&table, name);
    let (eef, object) = (read_poses(&table, "eef")?, read_poses(&table, "object")?);
    let goals = ["x", "y", "z", "rx", "ry", "rz"]
        .iter()
        .map(|part| column(&format!("goal_{part}")))
        .collect::<Result<Vec<_>, _>>()?;
    let gripper = column("gripper")?;
    let (episode, frame) = (col_u32(&table, "episode")?, col_u32(&table, "frame")?);
    let retrievable = col_bool(&table, "retrievable")?;
    let modes = col_text(&table, "mode")?;
    let mut demos: Vec<(u32, Vec<SpatialDemoFrame>)> = Vec::new();
    let mut excluded = std::collections::BTreeSet::new();
    for i in 0..episode.len() {
        let mode = modes[i].and_then(Mode::from_name).with_context(|| {
            format!(
                "cannot read {}: table spatial_index has an unknown mode in row {i}; build it again",
                artifact.path().display()
            )
        })?;
        if !retrievable.value(i) {
            excluded.insert((episode[i], frame[i]));
        }
        let row = SpatialDemoFrame {
            eef: eef[i],
            object: object[i],
            goal: Isometry3::from_parts(
                Translation3::new(goals[0][i], goals[1][i], goals[2][i]),
                UnitQuaternion::from_scaled_axis(Vector3::new(goals[3][i], goals[4][i], goals[5][i])),
            ),
            gripper: gripper[i],
            mode,
        };
        match demos.last_mut().filter(|(number, _)| *number == episode[i]) {
            Some((_, frames)) => frames.push(row),
            None => demos.push((episode[i], vec![row])),
        }
    }
    Ok(SpatialKnowledge::new(
        SpatialDemoSet::new(demos).with_names(names),
        retrieve,
        symmetry,
        |demo, frame| excluded.contains(&(demo, frame)),
    )?)
}
