//! `re4-pipe plan`, `merge` and `status` of suites, whose cells several processes run.

use std::fmt::Write as _;
use std::path::Path;
use std::time::Instant;

use anyhow::{Context as _, Result};
use re4_artifact::Stage;
use re4_fault::ensure;
use re4_stages::{
    Group, HashedFile, Notes, Plan, PlannedStage, PlannedSuite, Selection, Session, address_of, memory_mb,
    merge_comparison, planned_suite, read_suite,
};
use serde_json::json;

use super::plan::{GroupWriter, indices_of, overrides_of, print, sources_of};
use super::{Outcome, compare};
use crate::arguments::{Common, MergeArguments, PlanArguments, RolledArguments, SelectedArguments, StageArguments};
use crate::console::Console;

/// Id of the group that makes what several parts read.
const INPUTS: &str = "compare.inputs";

/// The session of a command about a suite.
pub(super) fn session(common: &Common, hashes: &[HashedFile]) -> Result<Session> {
    let session = Session::open(&common.artifacts, common.jobs, Notes::new(common.quiet))?;
    Ok(session.of_many_pipelines().trusting(hashes))
}

/// The cells that the arguments of `plan` and `merge` select.
fn selection(selected: &SelectedArguments, stage: &StageArguments, rolled: &RolledArguments) -> Result<Selection> {
    let seeds = rolled.seeds.as_deref().map(str::parse).transpose()?;
    let others = RolledArguments {
        seeds: None,
        ..rolled.clone()
    };
    Ok(selected.selection(seeds, overrides_of(stage, &others)))
}

/// `re4-pipe merge compare`.
pub(super) fn merge(arguments: &MergeArguments) -> Result<Outcome> {
    let start = Instant::now();
    let MergeArguments {
        stage,
        rolled,
        selected,
        ..
    } = arguments;
    let file = &stage.pipeline;
    let selection = selection(selected, stage, rolled)?;
    let (suite, cells) = read_suite(file, &selection)?;
    let page = compare::Page::at(None, file, &cells)?;
    let hashes = stage.plan.as_deref().map(sources_of).transpose()?.unwrap_or_default();
    let session = session(&stage.common, &hashes)?;
    let compared = merge_comparison(&session, file, &suite, &cells)?;
    page.finish(&stage.common, file, &suite, &compared, start)
}

/// `re4-pipe plan` of a suite.
pub(super) fn plan(arguments: &PlanArguments) -> Result<Outcome> {
    let PlanArguments { stage, .. } = arguments;
    ensure!(
        stage.shard.is_none(),
        "--shard does not apply to plan, which lists all shards"; "give --shards instead"
    );
    let selection = selection(&arguments.selected, stage, &arguments.rolled)?;
    let (suite, cells) = read_suite(&stage.pipeline, &selection)?;
    let hashes = stage.plan.as_deref().map(sources_of).transpose()?.unwrap_or_default();
    let session = session(&stage.common, &hashes)?;
    let planned = planned_suite(&session, &suite, &cells)?;
    let groups = groups(arguments, &selection, &planned)?;
    let plan = Plan {
        format: Plan::FORMAT,
        directory: std::env::current_dir().context("cannot find the current folder")?,
        pipeline: stage.pipeline.clone(),
        sources: session.hashed(),
        artifacts: address_of(&stage.common.artifacts),
        overrides: selection.set.clone(),
        suite: Some(selection),
        shards: arguments.shards.get(),
        groups,
    };
    print(Console::new(&stage.common), &plan)
}

/// The groups of a suite: what several parts read, the rollouts, and the comparison.
fn groups(arguments: &PlanArguments, selection: &Selection, planned: &PlannedSuite) -> Result<Vec<Group>> {
    let mut groups: Vec<Group> = Vec::new();
    if arguments.missing && planned.done {
        return Ok(groups);
    }
    let parts = planned.parts();
    let count = parts.min(arguments.shards.get());
    let of_stage = PlannedStage {
        stage: Stage::Compare,
        parts: Some(parts),
        artifact: planned.artifact.clone(),
        missing: None,
        done: planned.done,
    };
    let writer = GroupWriter {
        arguments,
        overrides: &selection.set,
        planned: &of_stage,
    };
    let command = |words: &[&str], more: &[&str]| -> Result<Vec<String>> {
        let mut command = writer.command(words, more.contains(&"--shard"))?;
        for (option, names) in [("--rows", &selection.rows), ("--columns", &selection.columns)] {
            if !names.is_empty() {
                command.extend([option.to_owned(), names.join(",")]);
            }
        }
        if let Some(seeds) = &selection.seeds {
            command.extend(["--seeds".to_owned(), seeds.text().to_owned()]);
        }
        command.extend(
            more.iter()
                .filter(|word| **word != "--shard")
                .map(|&word| word.to_owned()),
        );
        Ok(command)
    };
    // Trainings take place where inputs are made, and in the tasks of cells whose dataset no other part reads.
    let mut push = |id: &str, count: u32, missing: Option<&[bool]>, memory: Stage, command: Vec<String>| {
        let after = groups.last().map(|group| group.id.clone()).into_iter().collect();
        let mut group = writer.group(id, count, after, command);
        group.memory_mb = memory_mb(memory);
        if let Some(missing) = missing.filter(|_| arguments.missing) {
            let numbers: Vec<u32> = (0..)
                .zip(missing)
                .filter(|(_, missing)| **missing)
                .map(|(n, _)| n)
                .collect();
            let indices = indices_of(count, missing.len() as u32, &numbers);
            if indices.is_empty() {
                return;
            }
            group.indices = (indices.len() < count as usize).then_some(indices);
        }
        groups.push(group);
    };
    if parts <= 1 {
        push("compare", 1, None, Stage::Train, command(&["compare"], &[])?);
        return Ok(groups);
    }
    let inputs: Vec<bool> = planned.inputs.iter().map(|complete| !complete).collect();
    if !inputs.is_empty() {
        let count = (inputs.len() as u32).min(arguments.shards.get());
        let command = command(&["compare"], &["--shard", "--inputs"])?;
        push(INPUTS, count, Some(&inputs), Stage::Train, command);
    }
    let mut missing = vec![false; parts as usize];
    for part in planned.missing() {
        missing[part as usize] = true;
    }
    push(
        "compare",
        count,
        Some(&missing),
        Stage::Train,
        command(&["compare"], &["--shard"])?,
    );
    push(
        "compare.merge",
        1,
        None,
        Stage::Compare,
        command(&["merge", "compare"], &[])?,
    );
    Ok(groups)
}

/// `re4-pipe status` of the plan of a suite.
pub(super) fn status(console: Console, common: &Common, plan: &Plan, selection: &Selection) -> Result<Outcome> {
    let (suite, cells) = read_suite(&plan.pipeline, selection)?;
    let common = Common {
        artifacts: plan.artifacts.clone(),
        quiet: true,
        ..common.clone()
    };
    let session = session(&common, &plan.sources)?;
    let planned = planned_suite(&session, &suite, &cells)?;
    let missing = planned.missing();
    let rows: Vec<_> = planned
        .cells
        .iter()
        .map(
            |cell| json!({ "cell": cell.name, "parts": cell.parts, "missing": cell.missing, "cannot_run": cell.error }),
        )
        .collect();
    let complete = planned.cells.iter().filter(|cell| cell.missing.is_empty()).count();
    let state = match (planned.done, missing.is_empty()) {
        (true, _) => "done".to_owned(),
        (_, true) => "all cells ran, not compared".to_owned(),
        _ => format!(
            "{complete} of {} cells ran, {} parts missing",
            cells.len(),
            missing.len()
        ),
    };
    let row = json!({
        "stage": Stage::Compare.as_str(),
        "artifact": planned.artifact,
        "parts": planned.parts(),
        "missing": missing,
        "state": state,
        "cells": rows,
    });
    console.answer(&json!({ "done": planned.done, "stages": [row] }))?;
    let mut text = "  cell                                parts    state".to_owned();
    for cell in &planned.cells {
        let state = match (&cell.error, cell.missing.len()) {
            (Some(_), _) => "cannot run".to_owned(),
            (None, 0) => "done".to_owned(),
            (None, count) => format!("{count} parts missing"),
        };
        let made = cell.parts as usize - cell.missing.len();
        let parts = format!("{made}/{}", cell.parts);
        write!(text, "\n  {:<34} {parts:>6}  {state}", cell.name)?;
    }
    write!(text, "\n  compare: {state}")?;
    console.say(&text)?;
    Ok(Outcome::Done)
}

/// Refuses options of suites for a pipeline.
pub(super) fn refuse_selected(selected: &SelectedArguments, pipeline: &Path) -> Result<()> {
    ensure!(
        selected.are_all(),
        "--rows and --columns do not apply to {}, which is no suite", pipeline.display(); "remove them"
    );
    Ok(())
}
