//! `re4-pipe verify`: verifies every byte of artifacts against their manifests.

use std::path::{Path, PathBuf};

use anyhow::Result;
use re4_artifact::{MANIFEST_NAME, verify as verify_artifact};
use re4_fault::{OrFault as _, Remedy, ensure, fault};
use serde_json::json;

use super::Outcome;
use crate::arguments::VerifyArguments;
use crate::console::Console;
use re4_stages::print_error;

/// Verifies the given artifacts, or all in the artifacts folder.
///
/// # Errors
/// If an artifact is damaged. The error is that of the first; those of the others are printed.
pub(crate) fn verify(arguments: &VerifyArguments) -> Result<Outcome> {
    let console = Console::new(&arguments.common);
    let paths = if arguments.paths.is_empty() {
        all_artifacts(&arguments.common.artifacts)?
    } else {
        arguments.paths.clone()
    };
    let mut verified = Vec::new();
    let mut damaged = Vec::new();
    for path in &paths {
        match verify_artifact(path, &re4_stages::tables::described) {
            Ok(report) => {
                let bytes: u64 = report.files.iter().map(|file| file.bytes).sum();
                console.say(&format!(
                    "intact  {}  {} files, {bytes} bytes",
                    path.display(),
                    report.files.len()
                ))?;
                verified.push(json!({ "artifact": path, "key": report.manifest.key, "files": report.files.len(), "bytes": bytes }));
            }
            Err(error) => damaged.push(error),
        }
    }
    console.answer(&json!({
        "intact": verified,
        "damaged": damaged.iter().map(Remedy::sentence).collect::<Vec<_>>(),
    }))?;
    // The command returns the error of the first damaged artifact and prints those of the others.
    let mut errors = damaged.into_iter().map(anyhow::Error::from);
    let Some(first) = errors.next() else {
        return Ok(Outcome::Done);
    };
    for error in errors {
        print_error(&error);
    }
    Err(first)
}

fn all_artifacts(root: &Path) -> Result<Vec<PathBuf>> {
    let listing = |folder: &Path| -> Result<Vec<PathBuf>> {
        let entries = std::fs::read_dir(folder).or_fault(|| {
            fault!("cannot verify: {} is not a folder with artifacts", folder.display(); "give another folder with --artifacts")
        })?;
        let mut paths = entries
            .map(|entry| entry.map(|e| e.path()))
            .collect::<std::io::Result<Vec<_>>>()?;
        paths.sort();
        Ok(paths)
    };
    let mut found = Vec::new();
    // Names of unfinished artifacts start with a dot.
    let hidden = |path: &Path| {
        path.file_name()
            .is_some_and(|name| name.to_string_lossy().starts_with('.'))
    };
    for kind in listing(root)?.into_iter().filter(|path| path.is_dir() && !hidden(path)) {
        found.extend(
            listing(&kind)?
                .into_iter()
                .filter(|path| path.join(MANIFEST_NAME).exists()),
        );
    }
    ensure!(!found.is_empty(), "cannot verify: there is no artifact in {}", root.display(); "run a pipeline first");
    Ok(found)
}
