//! The groups of tasks of a plan: which commands make what of a pipeline or a suite, and after which others.

use std::path::{Path, PathBuf};

use anyhow::{Context as _, Result};
use re4_artifact::{Shard, Stage};
use re4_fault::{OrFault as _, fault};

use crate::addresses::address_of;
use crate::plan::PlannedStage;
use crate::plan_file::{Group, memory_mb};
use crate::stages::PlannedSuite;
use crate::suite::Selection;

/// Id of the group that makes what several parts of a suite read.
const INPUTS: &str = "compare.inputs";

/// What all tasks of a plan have in common.
#[derive(Debug)]
pub struct Tasks<'a> {
    /// The pipeline or suite file.
    pub pipeline: &'a Path,
    /// The artifacts folder, or the address of an object store.
    pub artifacts: &'a Path,
    /// Processors per task.
    pub cpus: u32,
    /// Maximum number of tasks of a group.
    pub shards: u32,
    /// Whether only tasks whose parts or artifacts do not exist are listed.
    pub missing: bool,
    /// Values of `--set`.
    pub overrides: &'a [String],
}

impl Tasks<'_> {
    /// The groups of a pipeline: each stage's shards and its merge, after those of the stage before.
    ///
    /// # Errors
    /// If the path of a file cannot be written in a plan.
    pub fn of_stages(&self, planned: &[PlannedStage]) -> Result<Vec<Group>> {
        let mut groups: Vec<Group> = Vec::new();
        let mut previous: Option<String> = None;
        for planned in planned.iter().filter(|planned| !(self.missing && planned.done)) {
            let parts = planned.parts.unwrap_or(1);
            let count = parts.min(self.shards);
            let id = planned.stage.to_string();
            let (stage, artifact) = (planned.stage, planned.artifact.as_ref());
            let group = |id: &str, count, after: &Option<String>, command| {
                self.group(stage, artifact, id, count, after.as_deref(), command)
            };
            if parts == 1 {
                groups.push(group(&id, 1, &previous, self.command(&[&id], false)?));
                previous = Some(id);
                continue;
            }
            let mut tasks = group(&id, count, &previous, self.command(&[&id], true)?);
            let indices = match &planned.missing {
                Some(missing) if self.missing => indices_of(count, parts, missing),
                _ => (0..count).collect(),
            };
            if !indices.is_empty() {
                tasks.indices = (indices.len() < count as usize).then_some(indices);
                groups.push(tasks);
                previous = Some(id.clone());
            }
            let merge = format!("{id}.merge");
            groups.push(group(&merge, 1, &previous, self.command(&["merge", &id], false)?));
            previous = Some(merge);
        }
        Ok(groups)
    }

    /// The groups of a suite: what several parts read, the rollouts, and the comparison.
    ///
    /// # Errors
    /// As [`Tasks::of_stages`].
    pub fn of_suite(&self, selection: &Selection, planned: &PlannedSuite) -> Result<Vec<Group>> {
        let mut groups: Vec<Group> = Vec::new();
        if self.missing && planned.done {
            return Ok(groups);
        }
        let parts = planned.parts();
        let command = |words: &[&str], sharded: bool, more: &[&str]| -> Result<Vec<String>> {
            let mut command = self.command(words, sharded)?;
            for (option, names) in [("--rows", &selection.rows), ("--columns", &selection.columns)] {
                if !names.is_empty() {
                    command.extend([option.to_owned(), names.join(",")]);
                }
            }
            if let Some(seeds) = &selection.seeds {
                command.extend(["--seeds".to_owned(), seeds.text().to_owned()]);
            }
            command.extend(more.iter().map(|&word| word.to_owned()));
            Ok(command)
        };
        // Trainings take place where inputs are made, and in the tasks of cells whose dataset no other part reads.
        let mut push = |id: &str, count: u32, missing: Option<&[bool]>, memory: Stage, command: Vec<String>| {
            let after = groups.last().map(|group| group.id.clone());
            let mut group = self.group(
                Stage::Compare,
                planned.artifact.as_ref(),
                id,
                count,
                after.as_deref(),
                command,
            );
            group.memory_mb = memory_mb(memory);
            if let Some(missing) = missing.filter(|_| self.missing) {
                let numbers = (0..).zip(missing).filter(|(_, missing)| **missing);
                let numbers: Vec<u32> = numbers.map(|(number, _)| number).collect();
                let indices = indices_of(count, missing.len() as u32, &numbers);
                if indices.is_empty() {
                    return;
                }
                group.indices = (indices.len() < count as usize).then_some(indices);
            }
            groups.push(group);
        };
        if parts <= 1 {
            push("compare", 1, None, Stage::Train, command(&["compare"], false, &[])?);
            return Ok(groups);
        }
        let inputs: Vec<bool> = planned.inputs.iter().map(|complete| !complete).collect();
        if !inputs.is_empty() {
            let count = (inputs.len() as u32).min(self.shards);
            let command = command(&["compare"], true, &["--inputs"])?;
            push(INPUTS, count, Some(&inputs), Stage::Train, command);
        }
        let mut missing = vec![false; parts as usize];
        for part in planned.missing() {
            missing[part as usize] = true;
        }
        let count = parts.min(self.shards);
        let shards = command(&["compare"], true, &[])?;
        push("compare", count, Some(&missing), Stage::Train, shards);
        let merge = command(&["merge", "compare"], false, &[])?;
        push("compare.merge", 1, None, Stage::Compare, merge);
        Ok(groups)
    }

    fn group(
        &self,
        stage: Stage,
        artifact: Option<&PathBuf>,
        id: &str,
        count: u32,
        after: Option<&str>,
        command: Vec<String>,
    ) -> Group {
        Group {
            id: id.to_owned(),
            stage: stage.to_string(),
            count,
            indices: None,
            after: after.into_iter().map(str::to_owned).collect(),
            cpus: self.cpus,
            memory_mb: memory_mb(stage),
            gpus: 0,
            outputs: artifact.into_iter().map(|path| address_of(path)).collect(),
            command,
        }
    }

    /// The command that begins with these words of the command line.
    fn command(&self, words: &[&str], sharded: bool) -> Result<Vec<String>> {
        let program = std::env::current_exe().context("cannot find the program's own file")?;
        let path = |path: &Path| -> Result<String> {
            let text = path.to_str().map(str::to_owned);
            text.or_fault(|| fault!("cannot plan with {}: its name is not UTF-8", path.display(); "rename it"))
        };
        let mut command = vec![path(&program)?];
        command.extend(words.iter().map(|&word| word.to_owned()));
        command.push(path(self.pipeline)?);
        command.extend(["--artifacts".to_owned(), path(&address_of(self.artifacts))?]);
        command.extend(["--jobs".to_owned(), self.cpus.to_string(), "--quiet".to_owned()]);
        for set in self.overrides {
            command.extend(["--set".to_owned(), set.clone()]);
        }
        if sharded {
            command.extend(["--shard".to_owned(), "{index}/{count}".to_owned()]);
        }
        Ok(command)
    }
}

/// The tasks of `count` that make one of the missing parts.
fn indices_of(count: u32, parts: u32, missing: &[u32]) -> Vec<u32> {
    let makes = |index: &u32| {
        let shard: Option<Shard> = format!("{index}/{count}").parse().ok();
        let own = shard.map(|shard| shard.parts(parts));
        own.is_some_and(|own| missing.iter().any(|part| own.contains(part)))
    };
    (0..count).filter(makes).collect()
}
