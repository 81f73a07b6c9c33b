//! `re4-pipe plan`, `merge` and `status` of suites, whose cells several processes run.

use std::fmt::Write as _;
use std::path::Path;
use std::time::Instant;

use anyhow::{Context as _, Result};
use re4_artifact::Stage;
use re4_fault::ensure;
use re4_stages::{
    HashedFile, Notes, Plan, Selection, Session, address_of, merge_comparison, planned_suite, read_suite,
};
use serde_json::json;

use super::plan::{overrides_of, print, sources_of, tasks};
use super::{Outcome, compare};
use crate::arguments::{Common, MergeArguments, PlanArguments, RolledArguments, SelectedArguments, StageArguments};
use crate::console::Console;

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
    let groups = tasks(arguments, &selection.set).of_suite(&selection, &planned)?;
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
