//! The file that `re4-pipe plan` writes: the commands that run a pipeline in parts.

use std::fmt::Write as _;
use std::path::{Path, PathBuf};

use anyhow::{Context as _, Result};
use re4_artifact::Stage;
use re4_fault::{OrFault as _, ensure, fault};
use serde::{Deserialize, Serialize};

use crate::hashes::HashedFile;
use crate::suite::Selection;

/// The tasks of a pipeline, in groups. The tasks of a group can run at the same time.
#[derive(Debug, Serialize, Deserialize)]
pub struct Plan {
    /// Format of the file.
    pub format: u32,
    /// Folder in which the commands run.
    pub directory: PathBuf,
    /// The pipeline file.
    pub pipeline: PathBuf,
    /// The artifacts folder, or the address of an object store.
    pub artifacts: PathBuf,
    /// Files of the dataset that were hashed. Tasks trust these hashes unless a file has changed.
    pub sources: Vec<HashedFile>,
    /// Overrides of the pipeline's settings.
    pub overrides: Vec<String>,
    /// For a suite: the cells. The field `pipeline` is the suite file.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub suite: Option<Selection>,
    /// Maximum number of tasks of a group.
    pub shards: u32,
    /// The groups, in an order in which they can run.
    pub groups: Vec<Group>,
}

impl Plan {
    /// The format that this build writes and reads.
    pub const FORMAT: u32 = 1;

    /// Reads the output of `re4-pipe plan --json`.
    ///
    /// # Errors
    /// If the file cannot be read or is not a plan of this format.
    pub fn read(path: &Path) -> Result<Self> {
        let bytes = std::fs::read(path).with_context(|| format!("cannot read {}", path.display()))?;
        let plan: Self = serde_json::from_slice(&bytes).or_fault(|| {
            fault!(
                "cannot read {}: it is not the output of re4-pipe plan --json", path.display();
                "write it again with re4-pipe plan PIPELINE.toml --shards N --json"
            )
        })?;
        ensure!(
            plan.format == Self::FORMAT,
            "cannot read {}: it has format {}, but this build reads format {}", path.display(), plan.format, Self::FORMAT;
            "write it again with re4-pipe plan"
        );
        Ok(plan)
    }
}

impl Plan {
    /// The plan as text for a person.
    pub fn text(&self) -> String {
        let mut text = "  group              tasks  after              memory".to_owned();
        for group in &self.groups {
            let tasks = match &group.indices {
                Some(indices) => format!("{} of {}", indices.len(), group.count),
                None => group.count.to_string(),
            };
            let after = group.after.join(", ");
            let (id, memory) = (&group.id, group.memory_mb);
            // Writing to a string cannot fail.
            let _ = write!(text, "\n  {id:<17} {tasks:>6}  {after:<17} {memory:>4} MiB");
        }
        if self.groups.is_empty() {
            return "nothing is missing".to_owned();
        }
        text += "\nadd --json to get the commands; scripts/engines has programs that run them";
        text
    }
}

/// Tasks that run the same command with another index.
#[derive(Debug, Serialize, Deserialize)]
pub struct Group {
    /// Name of the group, unique in the plan.
    pub id: String,
    /// Name of the stage.
    pub stage: String,
    /// Number of tasks.
    pub count: u32,
    /// The tasks to run; omitted if all.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub indices: Option<Vec<u32>>,
    /// Groups that must have ended successfully before.
    pub after: Vec<String>,
    /// Processors of a task.
    pub cpus: u32,
    /// Memory of a task in MiB.
    pub memory_mb: u32,
    /// GPUs of a task.
    pub gpus: u32,
    /// Folder of the artifact; empty if its key is not known yet.
    pub outputs: Vec<PathBuf>,
    /// Words of the command. `{index}` and `{count}` stand for the number of the task and of all tasks.
    pub command: Vec<String>,
}

/// Memory of a task, in MiB. Measured, with room for larger demonstrations; see docs/scale.md.
pub(crate) fn memory_mb(stage: Stage) -> u32 {
    match stage {
        Stage::TrainEncoder | Stage::Train => 6144,
        Stage::TrainPose | Stage::Rollout => 2048,
        _ => 1024,
    }
}
