//! Messages of a worker process to its parent.

use std::io::Write as _;
use std::path::PathBuf;

use re4_artifact::Key;
use re4_fault::{Fault, Remedy as _};
use re4_ingest::Description;
use re4_ingest::lerobot::LerobotFiles;
use re4_ingest::robomimic::Surveyed;
use serde::{Deserialize, Serialize};

use crate::parts::Partly;

/// A message of a worker: one JSON object per line.
#[derive(Debug, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub(crate) enum Message {
    /// Number of finished demonstrations or images, and their total number.
    Progress(u64, u64),
    /// What was found out about the demonstrations of an HDF5 file.
    Surveyed(PathBuf, Box<Surveyed>),
    /// Names of the model files that the source refers to.
    Models(Vec<String>),
    /// Hash and identity of the files of a LeRobot dataset. Which files these are is known only after it was opened.
    Hashed(Key, LerobotFiles),
    /// What a dataset is.
    Described(Description),
    /// The artifact is published.
    Done,
    /// The worker has made its shard of the artifact, or found that parts are missing.
    Partly(Partly),
    /// The worker stopped with an error.
    Failed {
        /// What is wrong.
        what: String,
        /// How to fix it, if known.
        remedy: Option<String>,
    },
}

/// Sends a message to the parent process.
pub(super) fn send(message: &Message) {
    if let Ok(text) = serde_json::to_string(message) {
        let mut output = std::io::stdout().lock();
        // If the parent has ended, this process is about to stop, too.
        let _ = writeln!(output, "{text}").and_then(|()| output.flush());
    }
}

impl Message {
    /// The message about an error that stopped the worker.
    pub(super) fn failed(fault: &Fault) -> Self {
        Self::Failed {
            what: fault.to_string(),
            remedy: fault.remedy().map(Into::into),
        }
    }
}
