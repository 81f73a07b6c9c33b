//! `re4-pipe fetch`: downloads a dataset or weights.

use anyhow::Result;
use re4_fault::Fault;
use re4_fetch::{Outcome as Fetched, find};
use serde_json::json;

use super::Outcome;
use crate::arguments::FetchArguments;
use crate::console::Console;
use re4_stages::data_folders;

/// Downloads and verifies a dataset or weights, unless they exist already.
pub(crate) fn fetch(arguments: &FetchArguments) -> Result<Outcome> {
    let console = Console::new(&arguments.common);
    let destination = arguments
        .destination
        .clone()
        .or_else(|| data_folders().into_iter().next())
        .unwrap_or_default();
    let mut dataset = find(&arguments.dataset).map_err(|error| Fault::of(&error))?;
    if let Some(url) = &arguments.url {
        dataset = dataset.with_url(url);
    }
    if !destination.join(&dataset.provides).exists() {
        console.note(&format!(
            "fetching {} ({}) to {}",
            dataset.url,
            dataset.licence,
            destination.display()
        ));
    }
    tracing::info!(provides = %dataset.provides, destination = %destination.display(), "looking for existing files");
    let bar = console.progress(0, "bytes");
    let report = re4_fetch::fetch(&dataset, &destination, &mut |done, length| {
        bar.set_length(length.unwrap_or(done));
        bar.set_position(done);
    })
    .map_err(|error| Fault::of(&error))?;
    bar.finish_and_clear();
    let path = report.path.display();
    let (text, summary) = match &report.outcome {
        Fetched::AlreadyThere => (
            format!("{path} exists already; nothing was downloaded"),
            json!({ "skipped": true }),
        ),
        Fetched::Fetched {
            bytes,
            resumed_from,
            sha256,
            verified,
        } => {
            let check = if *verified {
                "equal to the recorded checksum"
            } else {
                "no checksum is recorded for comparison"
            };
            (
                format!("{path}: {bytes} bytes downloaded, sha256 {sha256} ({check})"),
                json!({ "skipped": false, "bytes": bytes, "resumed_from": resumed_from, "sha256": sha256, "verified": verified }),
            )
        }
    };
    console.answer(&json!({ "dataset": report.dataset, "path": report.path, "outcome": summary }))?;
    console.say(&text)?;
    Ok(Outcome::Done)
}
