//! `rollouts` artifacts of robosuite's tasks as the page takes them.

use std::collections::{BTreeMap, BTreeSet};
use std::ops::Range;

use anyhow::{Context as _, Result, ensure};
use arrow::array::RecordBatch;
use re4_artifact::Row as _;
use re4_artifact::{Artifact, col_bool, col_f64, col_f64_or_null, col_text, col_u32, col_u32_or_null};
use re4_policy::kinds::SpacePolicy;
use re4_report::html::spatial::{
    Pose, SpatialChosen, SpatialDecision, SpatialDemonstration, SpatialPhase, SpatialRollouts, SpatialStep,
    SpatialTrace, SpatialWorld,
};
use re4_sim::robosuite::RobosuiteTask;
use re4_stats::Interval;

use super::super::{names_of_decisions, rollout_tables};
use super::rollouts::{inclusive, policy, rows, stated};

/// Names of the columns of a pose, after its prefix.
const POSE: [&str; 7] = ["x", "y", "z", "qx", "qy", "qz", "qw"];
const AXES: [&str; 3] = ["x", "y", "z"];

/// Reads manifest and tables.
pub(super) fn read(artifact: &Artifact, index: Option<&Artifact>) -> Result<SpatialRollouts> {
    let manifest = artifact.manifest();
    let (config, summary) = (&manifest.config, &manifest.summary);
    let protocol = &summary["protocol"];
    let (preset, altered) = policy::<SpacePolicy>(artifact)?;
    let task: RobosuiteTask = stated(artifact, "config", config, "task")?;
    let seeds: String = stated(artifact, "config", config, "seeds")?;
    let success_rate: Interval = stated(artifact, "summary.metrics", &summary["metrics"], "success_rate")?;
    Ok(SpatialRollouts {
        key: artifact.key().to_string(),
        index_key: super::index_key(artifact)?.to_string(),
        world: SpatialWorld {
            task: task.title.to_owned(),
            fixtures: task.fixtures.to_vec(),
            object: task.shape.to_vec(),
        },
        altered,
        preset,
        variant: stated(artifact, "config", config, "variant")?,
        seeds: inclusive(&seeds),
        max_steps: stated(artifact, "config", config, "max_steps")?,
        success_rate,
        successes: stated(artifact, "summary", summary, "successes")?,
        median_steps: summary["medians"]["steps_of_successes"].as_f64(),
        losses: stated(artifact, "summary", summary, "losses")?,
        demonstrations: demonstrations(&protocol["demonstrations"]["select"], index),
        dataset: dataset(protocol),
        simulator: simulator(protocol),
        protocol: protocol.clone(),
        settings: config["policy"].clone(),
        rollouts: traces(artifact)?,
    })
}

/// Which demonstrations were used.
fn demonstrations(select: &serde_json::Value, index: Option<&Artifact>) -> String {
    let count = index.and_then(|index| index.manifest().summary["episodes"].as_u64());
    match (select, count) {
        (select, Some(count)) if select == "all" => format!("all {count} demonstrations"),
        (select, None) if select == "all" => "all demonstrations of the file".to_owned(),
        (_, Some(count)) => format!("{count} chosen demonstrations"),
        (_, None) => "chosen demonstrations".to_owned(),
    }
}

fn dataset(protocol: &serde_json::Value) -> String {
    let dataset = &protocol["dataset"];
    let word = |name: &str| dataset[name].as_str().unwrap_or("unknown").to_owned();
    let digest = protocol["dataset_blake3"].as_str().and_then(|digest| digest.get(..8));
    format!(
        "{} of {} (BLAKE3 {}), recorded with robosuite {}",
        word("file"),
        word("environment"),
        digest.unwrap_or("unknown"),
        word("robosuite_version")
    )
}

fn simulator(protocol: &serde_json::Value) -> String {
    let mut words = format!(
        "{}, behaves as robosuite {}",
        protocol["physics"].as_str().unwrap_or("unknown physics"),
        protocol["robosuite"].as_str().unwrap_or("unknown")
    );
    if protocol["fidelity"] == "fast" {
        words += ", fast";
    }
    words
}

/// Columns of a table by prefix and suffix.
fn columns<'a, const N: usize>(rows: &'a RecordBatch, prefix: &str, suffixes: [&str; N]) -> Result<[&'a [f64]; N]> {
    let mut found = [&[][..]; N];
    for (column, suffix) in found.iter_mut().zip(suffixes) {
        *column = col_f64(rows, &format!("{prefix}_{suffix}"))?;
    }
    Ok(found)
}

fn traces(artifact: &Artifact) -> Result<Vec<SpatialTrace>> {
    let results = rollout_tables::results(artifact)?;
    let seeds = col_u32(&results, "seed")?;
    let success = col_bool(&results, "success")?;
    let count = |name| col_u32(&results, name);
    let eef = columns(&results, "eef", AXES)?;
    let object = columns(&results, "object", POSE)?;
    let step_rows = rollout_tables::steps(artifact)?;
    let decision_rows = rollout_tables::decisions(artifact)?;
    let place = |table: &str, batch: &RecordBatch, counts: &[u32]| -> Result<Vec<Range<usize>>> {
        rows(artifact, table, col_u32(batch, "seed")?, seeds, counts)
    };
    let of_steps = place("steps", &step_rows, count("steps")?)?;
    let of_decisions = place("decisions", &decision_rows, count("decisions")?)?;
    (0..seeds.len())
        .map(|i| {
            let decisions = slice(&decision_rows, &of_decisions[i]);
            // The orientation at the start is in no table of its own.
            let turned: Pose = match columns(&decisions, "query_eef", POSE)? {
                first if decisions.num_rows() > 0 => first.map(|column| column[0]),
                _ => [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0],
            };
            let [x, y, z] = eef.map(|column| column[i]);
            let kinds = col_text(&decisions, "kind")?;
            let followed: BTreeSet<u32> = col_u32_or_null(&decisions, "demo")?.into_iter().flatten().collect();
            Ok(SpatialTrace {
                seed: seeds[i],
                success: success.value(i),
                losses: kinds.iter().filter(|kind| **kind == Some("grasp_lost")).count() as u32,
                banned: col_u32(&decisions, "banned")?.last().copied().unwrap_or(0),
                demos: followed.len() as u32,
                shown: true,
                eef: [x, y, z, turned[3], turned[4], turned[5], turned[6]],
                object: object.map(|column| column[i]),
                steps: read_steps(artifact, &slice(&step_rows, &of_steps[i]))?,
                decisions: read_decisions(&decisions)?,
            })
        })
        .collect()
}

fn slice(rows: &RecordBatch, range: &Range<usize>) -> RecordBatch {
    rows.slice(range.start, range.len())
}

fn read_steps(artifact: &Artifact, rows: &RecordBatch) -> Result<Vec<SpatialStep>> {
    let goal = columns(rows, "action", AXES)?;
    let (eef, object, seen) = (
        columns(rows, "eef", POSE)?,
        columns(rows, "object", POSE)?,
        columns(rows, "seen", POSE)?,
    );
    let fingers = columns(rows, "finger", ["0", "1"])?;
    let gripper = col_f64(rows, "gripper")?;
    let decision = col_u32(rows, "decision")?;
    let phase = col_text(rows, "phase")?;
    (0..rows.num_rows())
        .map(|i| {
            let word = phase[i].unwrap_or_default();
            Ok(SpatialStep {
                goal: goal.map(|column| column[i]),
                gripper: gripper[i],
                eef: eef.map(|column| column[i]),
                object: object.map(|column| column[i]),
                fingers: (fingers[0][i] - fingers[1][i]).abs(),
                decision: decision[i],
                phase: SpatialPhase::from_name(word).with_context(|| {
                    format!(
                        "cannot report on {}: table steps has the phase {word}, which this version does not know; run the rollout again",
                        artifact.path().display()
                    )
                })?,
                seen: seen.map(|column| column[i]),
            })
        })
        .collect()
}

fn read_decisions(rows: &RecordBatch) -> Result<Vec<SpatialDecision>> {
    let whole = |name| col_u32_or_null(rows, name);
    let real = |name| col_f64_or_null(rows, name);
    let (demo, first, last) = (whole("demo")?, whole("demo_frame")?, whole("demo_end")?);
    let names = names_of_decisions(rows)?;
    let (compared, replay_steps) = (whole("compared")?, whole("replay_steps")?);
    let (d_q, d_o, d_e, turn) = (real("d_q")?, real("d_o")?, real("d_e")?, real("symmetry_turn")?);
    let mut delta = Vec::with_capacity(6);
    for part in ["x", "y", "z", "rx", "ry", "rz"] {
        delta.push(col_f64_or_null(rows, &format!("delta_{part}"))?);
    }
    let choice = |i: usize| -> Option<SpatialChosen> {
        let mut motion = [0.0; 6];
        for (part, column) in motion.iter_mut().zip(&delta) {
            *part = column[i]?;
        }
        Some(SpatialChosen {
            demo: demo[i]?,
            demo_name: names[i].clone(),
            demo_frame: first[i]?,
            demo_end: last[i]?,
            compared: compared[i]?,
            d_q: d_q[i]?,
            d_o: d_o[i]?,
            d_e: d_e[i]?,
            delta: motion,
            turn: turn[i]?,
            replay_steps: replay_steps[i]?,
        })
    };
    let (object, set_point) = (columns(rows, "query_object", POSE)?, columns(rows, "set_point", POSE)?);
    let fingers = col_f64(rows, "finger_separation")?;
    let (step, banned, bridge) = (
        col_u32(rows, "step")?,
        col_u32(rows, "banned")?,
        col_bool(rows, "bridge")?,
    );
    let (kind, mode, reason) = (
        col_text(rows, "kind")?,
        col_text(rows, "mode")?,
        col_text(rows, "reason")?,
    );
    Ok((0..rows.num_rows())
        .map(|i| SpatialDecision {
            step: step[i],
            kind: kind[i].unwrap_or_default().to_owned(),
            transfer: mode[i] == Some("transfer"),
            object: object.map(|column| column[i]),
            fingers: fingers[i],
            choice: choice(i),
            set_point: set_point.map(|column| column[i]),
            bridge: bridge.value(i),
            banned: banned[i],
            reason: reason[i].unwrap_or_default().to_owned(),
            picture: None,
        })
        .collect())
}

/// The frames of the demonstrations that are referred to.
pub(super) fn read_demonstrations(
    index: &Artifact,
    needed: &BTreeSet<u32>,
) -> Result<BTreeMap<u32, SpatialDemonstration>> {
    let eef_names = AXES.map(|axis| format!("eef_{axis}"));
    let object_names = POSE.map(|part| format!("object_{part}"));
    let names: Vec<&str> = ["episode"]
        .into_iter()
        .chain(eef_names.iter().chain(&object_names).map(String::as_str))
        .collect();
    let rows = index
        .table(re4_index::IndexRow::<re4_index::SpatialState>::table())?
        .read_columns(&names)?;
    let (eef, object) = (columns(&rows, "eef", AXES)?, columns(&rows, "object", POSE)?);
    let mut demonstrations: BTreeMap<u32, SpatialDemonstration> = BTreeMap::new();
    for (row, episode) in col_u32(&rows, "episode")?.iter().enumerate() {
        if needed.contains(episode) {
            let frame = (eef.map(|column| column[row]), object.map(|column| column[row]));
            demonstrations.entry(*episode).or_default().push(frame);
        }
    }
    Ok(demonstrations)
}

/// Whether these are rollouts of a robosuite task.
///
/// # Errors
/// When some are and others are not.
pub(super) fn all_spatial(artifacts: &[Artifact]) -> Result<bool> {
    let spatial = |artifact: &&Artifact| rollout_tables::in_space(artifact);
    let count = artifacts.iter().filter(spatial).count();
    ensure!(
        count == 0 || count == artifacts.len(),
        "cannot report on Push-T's rollouts and robosuite's in one page: {} holds Push-T's, {} robosuite's; make a page of each",
        named(artifacts.iter().find(|artifact| !spatial(artifact))),
        named(artifacts.iter().find(spatial))
    );
    Ok(count > 0)
}

fn named(artifact: Option<&Artifact>) -> String {
    artifact.map_or_else(String::new, |artifact| artifact.path().display().to_string())
}
