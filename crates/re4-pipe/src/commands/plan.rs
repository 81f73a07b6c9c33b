//! `re4-pipe plan`, `merge` and `status`: pipelines whose stages several processes make, on any machines that share a file system.

use std::fmt::Write as _;
use std::path::Path;

use anyhow::{Context as _, Result};
use re4_artifact::{Shard, Stage};
use re4_fault::{OrFault as _, ensure, fault};
use re4_stages::{
    Group, HashedFile, Judge, Notes, Plan, PlannedStage, Runner, Settings, Share, address_of, is_suite, memory_mb,
};
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
    let shards = arguments.shards.get();
    let mut groups: Vec<Group> = Vec::new();
    let mut previous: Option<String> = None;
    for planned in runner.planned()? {
        let writer = GroupWriter {
            arguments,
            overrides: &runner_overrides(arguments),
            planned: &planned,
        };
        if arguments.missing && planned.done {
            continue;
        }
        let parts = planned.parts.unwrap_or(1);
        let count = parts.min(shards);
        let id = planned.stage.to_string();
        let after: Vec<String> = previous.iter().cloned().collect();
        if parts == 1 {
            groups.push(writer.group(&id, 1, after, writer.command(&[&id], false)?));
            previous = Some(id);
            continue;
        }
        let mut tasks = writer.group(&id, count, after, writer.command(&[&id], true)?);
        let mut before = Some(id.clone());
        if let (true, Some(missing)) = (arguments.missing, &planned.missing) {
            let indices = indices_of(count, parts, missing);
            if indices.is_empty() {
                before.clone_from(&previous);
            } else {
                tasks.indices = (indices.len() < count as usize).then_some(indices);
                groups.push(tasks);
            }
        } else {
            groups.push(tasks);
        }
        let merge = format!("{id}.merge");
        groups.push(writer.group(
            &merge,
            1,
            before.into_iter().collect(),
            writer.command(&["merge", &id], false)?,
        ));
        previous = Some(merge);
    }
    let plan = Plan {
        format: Plan::FORMAT,
        directory: std::env::current_dir().context("cannot find the current folder")?,
        pipeline: arguments.stage.pipeline.clone(),
        sources: runner.hashed(),
        artifacts: address_of(&arguments.stage.common.artifacts),
        overrides: runner_overrides(arguments),
        suite: None,
        shards,
        groups,
    };
    print(console, &plan)
}

/// Prints a plan.
pub(super) fn print(console: Console, plan: &Plan) -> Result<Outcome> {
    console.answer(&serde_json::to_value(plan)?)?;
    console.say(&text(plan)?)?;
    Ok(Outcome::Done)
}

/// The tasks of `count` that make one of the missing parts.
pub(super) fn indices_of(count: u32, parts: u32, missing: &[u32]) -> Vec<u32> {
    let makes = |index: &u32| {
        let shard: Option<Shard> = format!("{index}/{count}").parse().ok();
        let own = shard.map(|shard| shard.parts(parts));
        own.is_some_and(|own| missing.iter().any(|part| own.contains(part)))
    };
    (0..count).filter(makes).collect()
}

/// The overrides of the command line, as values of `--set`.
fn runner_overrides(arguments: &PlanArguments) -> Vec<String> {
    overrides_of(&arguments.stage, &arguments.rolled)
}

/// The same, of any command.
pub(super) fn overrides_of(stage: &StageArguments, rolled: &RolledArguments) -> Vec<String> {
    let mut overrides = stage.set.clone();
    if stage.no_images {
        overrides.push("ingest.images=false".to_owned());
    }
    overrides.extend(rolled.overrides());
    overrides
}

/// What the groups of a stage have in common.
pub(super) struct GroupWriter<'a> {
    pub(super) arguments: &'a PlanArguments,
    pub(super) overrides: &'a [String],
    pub(super) planned: &'a PlannedStage,
}

impl GroupWriter<'_> {
    pub(super) fn group(&self, id: &str, count: u32, after: Vec<String>, command: Vec<String>) -> Group {
        Group {
            id: id.to_owned(),
            stage: self.planned.stage.to_string(),
            count,
            indices: None,
            after,
            cpus: self.arguments.cpus.get(),
            memory_mb: memory_mb(self.planned.stage),
            gpus: 0,
            outputs: self.planned.artifact.iter().map(|path| address_of(path)).collect(),
            command,
        }
    }

    /// The command that begins with these words of the command line.
    pub(super) fn command(&self, words: &[&str], sharded: bool) -> Result<Vec<String>> {
        let StageArguments { pipeline, common, .. } = &self.arguments.stage;
        let program = std::env::current_exe().context("cannot find the program's own file")?;
        let path = |path: &Path| -> Result<String> {
            let text = path.to_str().map(str::to_owned);
            text.or_fault(|| fault!("cannot plan with {}: its name is not UTF-8", path.display(); "rename it"))
        };
        let mut command = vec![path(&program)?];
        command.extend(words.iter().map(|&word| word.to_owned()));
        command.push(path(pipeline)?);
        command.extend(["--artifacts".to_owned(), path(&address_of(&common.artifacts))?]);
        command.extend([
            "--jobs".to_owned(),
            self.arguments.cpus.to_string(),
            "--quiet".to_owned(),
        ]);
        for set in self.overrides {
            command.extend(["--set".to_owned(), set.clone()]);
        }
        if sharded {
            command.extend(["--shard".to_owned(), "{index}/{count}".to_owned()]);
        }
        Ok(command)
    }
}

/// The plan as text for a person.
fn text(plan: &Plan) -> Result<String> {
    let mut text = "  group              tasks  after              memory".to_owned();
    for group in &plan.groups {
        let tasks = match &group.indices {
            Some(indices) => format!("{} of {}", indices.len(), group.count),
            None => group.count.to_string(),
        };
        let after = group.after.join(", ");
        write!(
            text,
            "\n  {:<17} {tasks:>6}  {after:<17} {:>4} MiB",
            group.id, group.memory_mb
        )?;
    }
    if plan.groups.is_empty() {
        return Ok("nothing is missing".to_owned());
    }
    text += "\nadd --json to get the commands; scripts/engines has programs that run them";
    Ok(text)
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
    let rows: Vec<_> = planned.iter().map(row).collect();
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

/// What is known of a stage.
fn row(stage: &PlannedStage) -> serde_json::Value {
    let state = match (&stage.missing, stage.done) {
        (_, true) => "done".to_owned(),
        (None, _) => "waiting for earlier stages".to_owned(),
        (Some(missing), _) if missing.is_empty() => "all parts made, not merged".to_owned(),
        (Some(missing), _) => format!("{} parts missing", missing.len()),
    };
    json!({
        "stage": stage.stage.as_str(),
        "artifact": stage.artifact,
        "parts": stage.parts,
        "missing": stage.missing,
        "state": state,
    })
}
