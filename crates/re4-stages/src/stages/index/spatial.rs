//! The stage `index` for robosuite tasks.

use std::collections::BTreeMap;

use anyhow::Result;
use re4_artifact::{Artifact, ArtifactSummary, Recipe, SixAxis, Stage, Writer};
use re4_audit::{CheckRow, FindingRow, SpatialDemo};
use re4_fault::bail;
use re4_index::trim::kept;
use re4_index::{IndexRow, SpatialState};
use serde_json::{Value, json};

use super::estimated::{EstimatedPoses, check_count};
use crate::inputs::demos::SegmentedEpisodes;
use crate::parts::{Lazy, sum_of_summaries};
use crate::pipeline::Estimates;
use crate::runner::{Built, Runner};

/// Increase it whenever the same input gives different bytes.
const CODE_VERSION: u32 = 3;

impl Runner {
    /// Makes the `index` artifact of a robosuite task, or returns the existing one. Object poses come from `poses` if it is
    /// given, otherwise from `episodes`. With `poses`, recorded object poses are not read at all: the checks of `index.leave_out`
    /// are then evaluated from the fingers only.
    ///
    /// # Errors
    /// If an input cannot be read, a setting does not fit the input, or the run is interrupted.
    pub fn index_spatial(&self, episodes: &Built, modes: &Built, poses: Option<&Built>) -> Result<Built> {
        let leave_out = &self.pipeline.index()?.leave_out;
        let audit = if leave_out.is_empty() || poses.is_some() {
            None
        } else {
            Some(self.audit(episodes, modes)?)
        };
        let recipe = self.spatial_recipe([episodes, modes], audit.as_ref(), poses)?;
        let estimates = self.pipeline.index()?.estimates;
        let trim = &self.pipeline.index()?.trim;
        // Which frames are left out depends on all demonstrations.
        let known = Lazy::new();
        let ends = || {
            known.get(|| match (&audit, poses) {
                (Some(audit), _) => left_out(&audit.artifact, leave_out),
                (None, Some(_)) if !leave_out.is_empty() => {
                    self.left_out_by_fingers(&episodes.artifact, &modes.artifact, leave_out)
                }
                _ => Ok(BTreeMap::new()),
            })
        };
        let estimated = |part: u32| {
            let Some(poses) = poses else { return Ok(None) };
            // The poses of an encoder have the parts of the demonstrations.
            EstimatedPoses::open(&poses.artifact.part(part)?).map(Some)
        };
        let make = |part: u32, episodes: &Artifact, modes: &Artifact, writer: &Writer| {
            let (ends, estimated) = (ends()?, estimated(part)?);
            let (mut demos, mut frames, mut retrievable, mut cut) = (0_u64, 0_u64, 0_u64, 0_u64);
            let mut table = writer.rows()?;
            for demo in SegmentedEpisodes::open(episodes, modes)? {
                self.interrupt.check("index")?;
                let mut demo = demo?;
                if let Some(estimated) = &estimated {
                    estimated.put_into(&mut demo, estimates)?;
                }
                let end = ends.get(&demo.number).copied().unwrap_or(0) as usize;
                let kept = kept(&demo.episode.frames, trim);
                let count = kept.iter().filter(|kept| **kept).count();
                demos += 1;
                frames += count as u64;
                cut += (kept.len() - count) as u64;
                retrievable += kept.iter().skip(end).filter(|kept| **kept).count() as u64;
                table.extend(rows(&demo, end).zip(kept).filter_map(|(row, kept)| kept.then_some(row)))?;
            }
            table.finish()?;
            let mut summary = json!({ "episodes": demos, "frames": frames, "retrievable_frames": retrievable });
            if !trim.is_empty() {
                summary["trimmed_frames"] = json!(cut);
            }
            anyhow::Ok(ArtifactSummary {
                summary,
                warnings: Vec::new(),
            })
        };
        let checked = |summary: ArtifactSummary| {
            let count = |name: &str| summary.summary[name].as_u64().unwrap_or_default();
            if let Some(poses) = poses {
                check_count(&poses.artifact, count("episodes"))?;
            }
            if count("retrievable_frames") == 0 {
                bail!(
                    "cannot index {}: index.leave_out leaves out every frame", episodes.artifact.path().display();
                    "name fewer checks in index.leave_out"
                );
            }
            anyhow::Ok(summary)
        };
        let parts = episodes.artifact.parts();
        if parts == 1 {
            return self.build(&recipe, |writer| {
                checked(make(0, &episodes.artifact, &modes.artifact, writer)?)
            });
        }
        self.build_parts(
            &recipe,
            parts,
            |writer, part| {
                let (episodes, modes) = (episodes.artifact.part(part)?, modes.artifact.part(part)?);
                make(part, &episodes, &modes, writer)
            },
            |parts, _| {
                checked(ArtifactSummary {
                    summary: Value::Object(sum_of_summaries(parts)),
                    warnings: Vec::new(),
                })
            },
        )
    }

    /// The recipe of the index.
    fn spatial_recipe(
        &self,
        [episodes, modes]: [&Built; 2],
        audit: Option<&Built>,
        poses: Option<&Built>,
    ) -> Result<Recipe> {
        let leave_out = &self.pipeline.index()?.leave_out;
        // Keys that are added only below leave the key of an index unchanged for pipelines that do not use these settings.
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
        let trim = &self.pipeline.index()?.trim;
        if !trim.is_empty() {
            config["trim"] = json!(trim);
        }
        let mut recipe = Recipe::new(Stage::Index, CODE_VERSION)
            .config(&config)?
            .input("episodes", episodes.artifact.key())
            .input("modes", modes.artifact.key());
        if let Some(audit) = audit {
            recipe = recipe.input("audit", audit.artifact.key());
        }
        if let Some(poses) = poses {
            recipe = recipe.input("poses", poses.artifact.key());
        }
        Ok(recipe)
    }
}

/// The end frame of the last finding of these checks, by demonstration, from an `audit` artifact.
fn left_out(audit: &Artifact, checks: &[String]) -> Result<BTreeMap<u32, u32>> {
    let known: Vec<CheckRow> = audit.read()?;
    check_names(checks, known.iter().map(|check| &*check.code))?;
    let findings: Vec<FindingRow> = audit.read()?;
    Ok(last_ends(
        checks,
        findings
            .iter()
            .map(|finding| (&*finding.code, finding.episode, finding.frames.end)),
    ))
}

/// The end frame of the last finding of these checks, by demonstration. Findings are given as (code, demonstration, end frame).
pub(super) fn last_ends<'a>(
    checks: &[String],
    findings: impl Iterator<Item = (&'a str, u32, u32)>,
) -> BTreeMap<u32, u32> {
    let mut last = BTreeMap::new();
    for (_, episode, end) in findings.filter(|(code, ..)| checks.iter().any(|check| check == code)) {
        let entry = last.entry(episode).or_insert(0);
        *entry = end.max(*entry);
    }
    last
}

/// Returns an error for a name that no check has.
pub(super) fn check_names<'a>(checks: &[String], known: impl Iterator<Item = &'a str>) -> Result<()> {
    let known: Vec<&str> = known.collect();
    match checks.iter().find(|check| !known.contains(&check.as_str())) {
        Some(check) => bail!(
            "index.leave_out names an unknown check {check:?}";
            "the checks of the audit are {}", known.join(", ")
        ),
        None => Ok(()),
    }
}

/// The rows of a demonstration; frames before `end` are marked as not retrievable.
fn rows(demo: &SpatialDemo, end: usize) -> impl Iterator<Item = IndexRow<SpatialState>> {
    let frames = demo.episode.frames.iter().zip(&demo.segmented.modes);
    frames.enumerate().map(move |(number, (frame, &mode))| IndexRow {
        episode: demo.number,
        frame: number as u32,
        mode,
        state: SpatialState {
            eef: frame.eef,
            object: frame.object,
            goal: SixAxis(frame.goal),
            gripper: frame.gripper,
        },
        retrievable: Some(number >= end),
    })
}
