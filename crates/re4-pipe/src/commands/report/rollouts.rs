//! A `rollouts` artifact as the page takes it.

use std::ops::Range;

use anyhow::{Result, ensure};
use arrow::array::RecordBatch;
use re4_artifact::{Artifact, col_bool, col_f64, col_f64_list, col_f64_or_null, col_text, col_u32};
use re4_policy::kinds::{Kinds, PlanePolicy};
use re4_report::html::{DecisionTrace, Metrics, Rollout, Rollouts, Starts, StepTrace, Taken};
use re4_stats::Interval;
use serde::de::DeserializeOwned;
use serde_json::Value;

use super::super::{names_of_decisions, rollout_tables};

/// Reads manifest and tables.
pub(super) fn read(artifact: &Artifact) -> Result<Rollouts> {
    let manifest = artifact.manifest();
    let config = &manifest.config;
    let protocol = &manifest.summary["protocol"];
    let metric =
        |name: &str| -> Result<Interval> { stated(artifact, "summary.metrics", &manifest.summary["metrics"], name) };
    let (demonstrations_taken, demonstrations) = demonstrations(protocol);
    let (preset, altered) = policy::<PlanePolicy>(artifact)?;
    let (starts, scenes) = starts(config);
    Ok(Rollouts {
        key: artifact.key().to_string(),
        index_key: super::index_key(artifact)?.to_string(),
        altered,
        preset,
        variant: stated(artifact, "config", config, "variant")?,
        demonstrations,
        demonstrations_taken,
        dataset_demonstrations: protocol["dataset"]["episodes"].as_u64(),
        starts,
        scenes,
        max_steps: stated(artifact, "config", config, "max_steps")?,
        metrics: Metrics {
            score_scaled_mean: metric("score_scaled_mean")?,
            coverage_raw_mean: metric("coverage_raw_mean")?,
            iou_mean: metric("iou_mean")?,
            success_rate: metric("success_rate")?,
        },
        protocol: protocol.clone(),
        settings: config["policy"].clone(),
        rollouts: rollouts(artifact)?,
    })
}

/// The kind of the policy, and whether settings of it were changed.
pub(super) fn policy<K: Kinds>(artifact: &Artifact) -> Result<(String, bool)> {
    let config = &artifact.manifest().config;
    let mut settings = config["policy"].clone();
    // Older versions state it beside the settings.
    let kind: String = match settings.as_object_mut().and_then(|settings| settings.remove("kind")) {
        Some(Value::String(kind)) => kind,
        _ => stated(artifact, "config", config, "preset")?,
    };
    let mut defaults = serde_json::to_value(K::defaults(&kind))?;
    if let Some(defaults) = defaults.as_object_mut() {
        defaults.remove("kind");
    }
    Ok((kind, defaults != settings))
}

/// What the manifest states under this name.
pub(in crate::commands) fn stated<T: DeserializeOwned>(
    artifact: &Artifact,
    place: &str,
    values: &Value,
    name: &str,
) -> Result<T> {
    serde_json::from_value(values[name].clone()).map_err(|_| {
        anyhow::anyhow!(
            "cannot report on {}: its manifest states no usable {place}.{name}; run the rollout again",
            artifact.path().display()
        )
    })
}

/// Which demonstrations were taken, and how many these are.
fn demonstrations(protocol: &Value) -> (Taken, Option<u64>) {
    let select = &protocol["demonstrations"]["select"];
    let in_dataset = protocol["dataset"]["episodes"].as_u64();
    let length = |range: &str| -> Option<u64> {
        let (start, end) = range.split_once("..")?;
        end.trim().parse::<u64>().ok()?.checked_sub(start.trim().parse().ok()?)
    };
    if select == "all" {
        (Taken::All, in_dataset)
    } else if let Some(count) = select["first"].as_u64() {
        (Taken::First(count), Some(count))
    } else {
        let listed = select["episodes"].as_array().map(|list| list.len() as u64);
        let count = select["last"].as_u64().or(listed);
        (
            Taken::Other,
            count.or_else(|| select["range"].as_str().and_then(length)),
        )
    }
}

/// What the rollouts start from, and that in words.
fn starts(config: &Value) -> (Starts, String) {
    match (&config["scenes"], &config["seeds"]) {
        (Value::Null, Value::String(seeds)) => (Starts::Seeds, format!("seeds {}", inclusive(seeds))),
        (Value::Null, seeds) => (Starts::Seeds, format!("seeds {seeds}")),
        (scenes, _) => {
            let kind = scenes["kind"].as_str().unwrap_or("chosen").replace('_', " ");
            (Starts::Scenes, format!("scenes: {kind}"))
        }
    }
}

/// Half-open ranges as readers of a page expect them: `500..600` is 500–599.
pub(super) fn inclusive(seeds: &str) -> String {
    let part = |part: &str| {
        let (start, end) = part.split_once("..")?;
        let last = end.trim().parse::<u64>().ok()?.checked_sub(1)?;
        Some(format!("{}–{last}", start.trim()))
    };
    let parts = seeds.split(',').map(str::trim);
    parts
        .map(|text| part(text).unwrap_or_else(|| text.to_owned()))
        .collect::<Vec<_>>()
        .join(", ")
}

fn rollouts(artifact: &Artifact) -> Result<Vec<Rollout>> {
    let results = rollout_tables::results(artifact)?;
    let number = |name| col_f64(&results, name);
    let start = [
        number("eef_x")?,
        number("eef_y")?,
        number("object_x")?,
        number("object_y")?,
        number("object_theta")?,
    ];
    let (score, coverage, iou) = (number("score_max")?, number("coverage_max")?, number("iou_max")?);
    let coverage_final = number("coverage_final")?;
    let success = col_bool(&results, "success")?;
    let seeds = col_u32(&results, "seed")?;
    let steps = Steps::read(artifact, seeds, col_u32(&results, "steps")?)?;
    let decisions = Decisions::read(artifact, seeds, col_u32(&results, "decisions")?)?;
    (0..seeds.len())
        .map(|i| {
            Ok(Rollout {
                seed: seeds[i],
                score: score[i],
                coverage: coverage[i],
                iou: iou[i],
                coverage_final: coverage_final[i],
                success: success.value(i),
                shown: true,
                start: start.map(|column| column[i]),
                steps: steps.of(i)?,
                decisions: decisions.of(i)?,
            })
        })
        .collect()
}

/// Rows of each rollout in a table that lists them in the order of the results.
pub(super) fn rows(
    artifact: &Artifact,
    table: &str,
    column: &[u32],
    seeds: &[u32],
    counts: &[u32],
) -> Result<Vec<Range<usize>>> {
    let mut at = 0;
    let mut ranges = Vec::with_capacity(seeds.len());
    for (&seed, &count) in seeds.iter().zip(counts) {
        let range = at..at + count as usize;
        ensure!(
            column
                .get(range.clone())
                .is_some_and(|found| found.iter().all(|s| *s == seed)),
            "cannot report on {}: table {table} does not hold the rows of seed {seed} that table results counts; run the rollout again",
            artifact.path().display()
        );
        at = range.end;
        ranges.push(range);
    }
    Ok(ranges)
}

struct Steps {
    rows: RecordBatch,
    ranges: Vec<Range<usize>>,
}

impl Steps {
    fn read(artifact: &Artifact, seeds: &[u32], counts: &[u32]) -> Result<Self> {
        let rows = rollout_tables::steps(artifact)?;
        let ranges = self::rows(artifact, "steps", col_u32(&rows, "seed")?, seeds, counts)?;
        Ok(Self { rows, ranges })
    }

    fn of(&self, rollout: usize) -> Result<Vec<StepTrace>> {
        let range = self.ranges[rollout].clone();
        let rows = self.rows.slice(range.start, range.len());
        let number = |name| col_f64(&rows, name);
        let (action_x, action_y) = (number("action_x")?, number("action_y")?);
        let (eef_x, eef_y) = (number("eef_x")?, number("eef_y")?);
        let object = [number("object_x")?, number("object_y")?, number("object_theta")?];
        let (coverage, score) = (number("coverage")?, number("score")?);
        let decision = col_u32(&rows, "decision")?;
        let phase = col_text(&rows, "phase")?;
        let observed = [
            optional(&rows, "seen_x")?,
            optional(&rows, "seen_y")?,
            optional(&rows, "seen_theta")?,
        ];
        let confidence = optional(&rows, "pose_confidence")?;
        let flag = match rows.column_by_name("pose_flag") {
            Some(_) => col_text(&rows, "pose_flag")?,
            None => vec![None; rows.num_rows()],
        };
        Ok((0..range.len())
            .map(|i| StepTrace {
                action: [action_x[i], action_y[i]],
                eef: [eef_x[i], eef_y[i]],
                object: object.map(|column| column[i]),
                coverage: coverage[i],
                score: score[i],
                decision: decision[i],
                replay: phase[i] == Some("replay"),
                // A recorded pose is not shown once more.
                observed: flag[i].and_then(|_| whole([observed[0][i], observed[1][i], observed[2][i]])),
                confidence: confidence[i],
                flag: flag[i].map(str::to_owned),
            })
            .collect())
    }
}

/// A column that only some versions of the table have; null where it is not there.
fn optional(rows: &RecordBatch, name: &str) -> Result<Vec<Option<f64>>> {
    match rows.column_by_name(name) {
        Some(_) => Ok(col_f64_or_null(rows, name)?),
        None => Ok(vec![None; rows.num_rows()]),
    }
}

/// A pose of which no part is missing.
fn whole(pose: [Option<f64>; 3]) -> Option<[f64; 3]> {
    let [x, y, theta] = pose;
    Some([x?, y?, theta?])
}

struct Decisions {
    rows: RecordBatch,
    ranges: Vec<Range<usize>>,
}

impl Decisions {
    fn read(artifact: &Artifact, seeds: &[u32], counts: &[u32]) -> Result<Self> {
        let rows = rollout_tables::decisions(artifact)?;
        let ranges = self::rows(artifact, "decisions", col_u32(&rows, "seed")?, seeds, counts)?;
        Ok(Self { rows, ranges })
    }

    fn of(&self, rollout: usize) -> Result<Vec<DecisionTrace>> {
        let range = self.ranges[rollout].clone();
        let rows = self.rows.slice(range.start, range.len());
        let count = |name| col_u32(&rows, name);
        let words = |name| -> Result<Vec<String>> {
            let column = col_text(&rows, name)?;
            Ok(column
                .into_iter()
                .map(|text| text.unwrap_or_default().to_owned())
                .collect())
        };
        let pose = |name: &str| -> Result<[&[f64]; 3]> {
            let part = |axis: &str| col_f64(&rows, &format!("{name}_{axis}"));
            Ok([part("x")?, part("y")?, part("theta")?])
        };
        let (step, demo, frame, end) = (count("step")?, count("demo")?, count("demo_frame")?, count("demo_end")?);
        let names = names_of_decisions(&rows)?;
        let (compared, replay_steps) = (count("compared")?, count("replay_steps")?);
        let (plan_steps, plan_nodes) = (count("plan_steps")?, count("plan_nodes")?);
        let (object, delta, predicted) = (pose("query_object")?, pose("delta")?, pose("predicted_object")?);
        let (set_x, set_y) = (col_f64(&rows, "set_point_x")?, col_f64(&rows, "set_point_y")?);
        let (d_q, d_o) = (col_f64_or_null(&rows, "d_q")?, col_f64_or_null(&rows, "d_o")?);
        let predicted_coverage = col_f64(&rows, "predicted_coverage")?;
        let (selector, plan, reason) = (words("selector")?, words("plan")?, words("reason")?);
        let mode = col_text(&rows, "mode")?;
        let paths = col_f64_list(&rows, "plan_path")?;
        Ok((0..range.len())
            .map(|i| DecisionTrace {
                step: step[i],
                selector: selector[i].clone(),
                transfer: mode[i] == Some("transfer"),
                object: object.map(|column| column[i]),
                demo: demo[i],
                demo_name: names[i].clone(),
                demo_frame: frame[i],
                demo_end: end[i],
                compared: compared[i],
                d_q: d_q[i],
                d_o: d_o[i],
                delta: delta.map(|column| column[i]),
                set_point: [set_x[i], set_y[i]],
                plan: plan[i].clone(),
                plan_steps: plan_steps[i],
                plan_nodes: plan_nodes[i],
                plan_path: paths[i].clone(),
                replay_steps: replay_steps[i],
                predicted: predicted.map(|column| column[i]),
                predicted_coverage: predicted_coverage[i],
                reason: reason[i].clone(),
            })
            .collect())
    }
}
