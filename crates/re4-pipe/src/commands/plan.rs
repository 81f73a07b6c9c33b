//! `re4-pipe plan`, `merge` and `status`: pipelines whose stages several processes make, on any machines that share a file system.

use std::fmt::Write as _;
use std::path::Path;

use anyhow::{Context as _, Result};
use re4_artifact::Stage;
use re4_fault::ensure;
use re4_stages::{HashedFile, Judge, Notes, Plan, PlannedStage, Runner, Settings, Share, Tasks, address_of, is_suite};
use serde_json::json;

use super::audit::LEAVE_OUT;
use super::{Outcome, suite};
use crate::arguments::{MergeArguments, PlanArguments, RolledArguments, StageArguments, StatusArguments};
use crate::console::Console;

/// `re4-pipe merge`.
pub(crate) fn merge(arguments: &MergeArguments) -> Result<Outcome> {
    let console = Console::new(&arguments.stage.common);
    let stage = Stage::from(arguments.of);
    ensure!(
        arguments.stage.shard.is_none(),
        "--shard does not apply to merge, which publishes the whole artifact"; "remove it"
    );
    ensure!(
        arguments.starts == 0 || stage == Stage::Influence,
        "--starts applies only to merge influence"; "remove it"
    );
    if stage == Stage::Compare {
        return suite::merge(arguments);
    }
    suite::refuse_selected(&arguments.selected, &arguments.stage.pipeline)?;
    let mut overrides = arguments.rolled.overrides();
    if matches!(stage, Stage::Observe | Stage::Audit) {
        overrides.push(LEAVE_OUT.to_owned());
    }
    let runner = arguments.stage.runner_sharing(Share::Merge(stage), &overrides)?;
    let built = if stage == Stage::Influence {
        let starts = arguments.starts;
        runner.influence(Judge { starts })?.built
    } else {
        runner.artifact_of(stage)?
    };
    super::run::answer(console, &runner, &built)
}

/// The hashes of a dataset's files in a plan.
pub(crate) fn sources_of(plan: &Path) -> Result<Vec<HashedFile>> {
    Ok(Plan::read(plan)?.sources)
}

/// `re4-pipe plan`.
pub(crate) fn plan(arguments: &PlanArguments) -> Result<Outcome> {
    if is_suite(&arguments.stage.pipeline) {
        return suite::plan(arguments);
    }
    suite::refuse_selected(&arguments.selected, &arguments.stage.pipeline)?;
    let console = Console::new(&arguments.stage.common);
    let runner = arguments.rolled.runner(&arguments.stage)?;
    let overrides = overrides_of(&arguments.stage, &arguments.rolled);
    let groups = tasks(arguments, &overrides).of_stages(&runner.planned()?)?;
    let plan = Plan {
        format: Plan::FORMAT,
        directory: std::env::current_dir().context("cannot find the current folder")?,
        pipeline: arguments.stage.pipeline.clone(),
        sources: runner.hashed(),
        artifacts: address_of(&arguments.stage.common.artifacts),
        overrides,
        suite: None,
        shards: arguments.shards.get(),
        groups,
    };
    print(console, &plan)
}

/// Prints a plan.
pub(super) fn print(console: Console, plan: &Plan) -> Result<Outcome> {
    console.answer(&serde_json::to_value(plan)?)?;
    console.say(&plan.text())?;
    Ok(Outcome::Done)
}

/// What all tasks have in common.
pub(super) fn tasks<'a>(arguments: &'a PlanArguments, overrides: &'a [String]) -> Tasks<'a> {
    Tasks {
        pipeline: &arguments.stage.pipeline,
        artifacts: &arguments.stage.common.artifacts,
        cpus: arguments.cpus.get(),
        shards: arguments.shards.get(),
        missing: arguments.missing,
        overrides,
    }
}

/// The overrides of the command line, as values of `--set`.
pub(super) fn overrides_of(stage: &StageArguments, rolled: &RolledArguments) -> Vec<String> {
    let mut overrides = stage.set.clone();
    if stage.no_images {
        overrides.push("ingest.images=false".to_owned());
    }
    overrides.extend(rolled.overrides());
    overrides
}

/// `re4-pipe status`.
pub(crate) fn status(arguments: &StatusArguments) -> Result<Outcome> {
    let console = Console::new(&arguments.common);
    let path = &arguments.plan;
    let plan = Plan::read(path)?;
    std::env::set_current_dir(&plan.directory)
        .with_context(|| format!("cannot enter {}, the folder of the plan", plan.directory.display()))?;
    if let Some(selection) = &plan.suite {
        return suite::status(console, &arguments.common, &plan, selection);
    }
    let runner = Runner::new(&Settings {
        pipeline: &plan.pipeline,
        overrides: plan.overrides.clone(),
        artifacts: &plan.artifacts,
        jobs: arguments.common.jobs,
        notes: Notes::new(true),
        share: Share::Whole,
        hashes: &plan.sources,
    })?;
    let planned = runner.planned()?;
    let rows: Vec<_> = planned.iter().map(PlannedStage::to_json).collect();
    let done = planned.iter().all(|stage| stage.done);
    console.answer(&json!({ "done": done, "stages": rows }))?;
    let mut text = "  stage         parts    state".to_owned();
    for (stage, row) in planned.iter().zip(&rows) {
        let parts = match (stage.parts, &stage.missing) {
            (Some(parts), Some(missing)) => format!("{}/{parts}", parts as usize - missing.len()),
            (Some(parts), None) => format!("0/{parts}"),
            _ => "?".to_owned(),
        };
        write!(
            text,
            "\n  {:<12} {parts:>7}  {}",
            stage.stage.as_str(),
            row["state"].as_str().unwrap_or_default()
        )?;
    }
    console.say(&text)?;
    Ok(Outcome::Done)
}
