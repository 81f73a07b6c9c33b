//! Rollouts and replays of robosuite tasks.

use std::fmt::Write as _;
use std::time::Instant;

use anyhow::Result;
use re4_artifact::Row as _;
use re4_fault::ensure;
use re4_rollout::{SpaceResultRow, SpaceStepRow};
use serde_json::{Value, json};

use super::super::Outcome;
use super::Page;
use crate::arguments::{ReplayArguments, RolloutArguments};
use crate::console::Console;
use re4_stages::{Built, Runner};

/// Runs every stage up to the rollouts.
pub(super) fn roll_out(runner: &Runner, arguments: &RolloutArguments) -> Result<Outcome> {
    let console = Console::new(&arguments.stage.common);
    let start = Instant::now();
    ensure!(arguments.record.is_none(), "--record writes the dataset format of Push-T"; "remove it for robosuite tasks");
    let page = Page::at(runner, arguments)?;
    let (built, _) = runner.roll_out()?;
    if let Some(page) = &page {
        page.write(console, arguments, &built)?;
    }
    let summary = &built.artifact.manifest().summary;
    let (section, kind) = (runner.pipeline.rollout()?, runner.pipeline.policy()?.kind());
    let rollouts = built.artifact.table(SpaceResultRow::table())?.rows();
    let rate = &summary["metrics"]["success_rate"];
    let mut answer = json!({
        "task": runner.pipeline.task,
        "variant": runner.pipeline.variant,
        "policy": kind,
        "episodes": rollouts,
        "max_steps": section.max_steps,
        "metrics": { "success_rate": ordered(rate) },
        "median_steps_of_successes": summary["medians"]["steps_of_successes"],
        "losses": summary["losses"],
        "artifact": built.artifact.path(),
        "warnings": runner.warnings(),
        "wall_s": start.elapsed().as_secs_f64(),
    });
    let images = summary["images"].as_u64();
    if let Some(images) = images {
        answer["images"] = json!(images);
    }
    console.answer(&answer)?;
    let [value, low, high] = ["value", "low", "high"].map(|key| rate[key].as_f64().unwrap_or(f64::NAN));
    let mut text = format!(
        "policy {kind}, {rollouts} rollouts of at most {} steps; mean, 95 % interval\n  success rate  {value:.3}   [{low:.3}, {high:.3}]",
        section.max_steps
    );
    let losses = &summary["losses"];
    match summary["medians"]["steps_of_successes"].as_f64() {
        Some(median) => write!(
            text,
            "\n  median {median} steps of the successful rollouts; {losses} lost grasps"
        )?,
        None => write!(text, "\n  no rollout succeeds; {losses} lost grasps")?,
    }
    if let Some(images) = images {
        let steps = built.artifact.table(SpaceStepRow::table())?.rows();
        write!(text, "\n  poses estimated from {images} images in {steps} steps")?;
    }
    console.say(&text)?;
    Ok(Outcome::Done)
}

fn ordered(rate: &Value) -> Value {
    json!({ "value": rate["value"], "low": rate["low"], "high": rate["high"] })
}

/// `re4-pipe replay` for robosuite tasks.
pub(super) fn replay(runner: &Runner, arguments: &ReplayArguments) -> Result<Outcome> {
    let console = Console::new(&arguments.stage.common);
    ensure!(
        arguments.plot.is_none(),
        "--plot applies only to Push-T";
        "for robosuite tasks, the distances are in the table divergence of the artifact"
    );
    runner.require_simulator("replay")?;
    let built = runner.replay_spatial(&runner.ingest()?)?;
    console.answer(&built.to_json())?;
    console.say(&description(&built)?)?;
    let summary = &built.artifact.manifest().summary;
    let rate = |kind: &str| summary[kind]["success_rate"]["value"].as_f64().unwrap_or(0.0);
    let short = arguments
        .minimum
        .is_some_and(|minimum| rate("delta") < minimum || rate("absolute") < minimum);
    Ok(if short { Outcome::GateFailed } else { Outcome::Done })
}

fn description(built: &Built) -> Result<String> {
    let manifest = built.artifact.manifest();
    let summary = &manifest.summary;
    let mut text = format!("{} artifact in {}", manifest.artifact, built.artifact.path().display());
    let recorded = summary["recorded_actions"].as_str().unwrap_or_default();
    for kind in ["delta", "absolute"] {
        let of = &summary[kind];
        let origin = if kind == recorded { "recorded" } else { "converted" };
        let millimetres = |part: &str| 1e3 * of["object_max_m"][part].as_f64().unwrap_or(f64::NAN);
        write!(
            text,
            "\n  {kind:<8} {origin:<9}  {} of {} succeed; maximum object error per replay: median {:.3} mm, 99 % {:.3} mm, maximum {:.3} mm",
            of["successes"],
            of["replays"],
            millimetres("p50"),
            millimetres("p99"),
            millimetres("max"),
        )?;
        let failed: Vec<String> = of["failed_demonstrations"]
            .as_array()
            .into_iter()
            .flatten()
            // Artifacts of older versions contain numbers instead of names.
            .map(|demo| {
                demo.as_str()
                    .map_or_else(|| format!("demonstration {demo}"), str::to_owned)
            })
            .collect();
        if !failed.is_empty() {
            write!(text, "\n    failed: {}", failed.join(", "))?;
        }
    }
    Ok(text)
}
