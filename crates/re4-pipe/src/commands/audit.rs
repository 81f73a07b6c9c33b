//! `re4-pipe audit`.

use anyhow::Result;
use re4_artifact::Stage;
use re4_audit::Severity;
use re4_report::{AuditSources, Findings, LARGE_PAGE, audit_page};
use re4_stages::{Built, Runner};
use serde_json::json;

use super::Outcome;
use crate::arguments::{AuditArguments, FailOn, StageArguments};
use crate::console::Console;
use crate::output::Output;

/// The audit reports unusable demonstrations instead of refusing the dataset.
pub(crate) const LEAVE_OUT: &str = "ingest.on_bad=leave_out";

/// `re4-pipe audit`.
pub(crate) fn audit(arguments: &AuditArguments) -> Result<Outcome> {
    let console = Console::new(&arguments.stage.common);
    // An output path that cannot be written to is refused before any computation.
    let page = arguments
        .html
        .as_deref()
        .map(|path| Output::at(path, "page"))
        .transpose()?;
    let runner = arguments.stage.runner_of(Stage::Audit, &[LEAVE_OUT.to_owned()])?;
    if let Some(page) = &page {
        page.refuse_inputs(&runner.inputs()?)?;
    }
    let episodes = runner.ingest()?;
    let modes = runner.segment(&episodes)?;
    let built = runner.audit(&episodes, &modes)?;
    if let Some(output) = &page {
        write_page(&runner, &arguments.stage, [&episodes, &modes, &built], output, console)?;
    }
    let found = Findings::read(&built.artifact)?;
    let mut answer = found.to_json(built.to_json());
    answer["warnings"] = json!(runner.warnings());
    console.answer(&answer)?;
    console.say(&found.text()?)?;
    // Checked last, so that the artifacts and the page are written even if the check fails.
    let errors = found.count(Severity::Error);
    let failed = match arguments.fail_on {
        None => false,
        Some(FailOn::Error) => errors > 0,
        Some(FailOn::Warning) => errors + found.count(Severity::Warning) > 0,
    };
    Ok(if failed { Outcome::GateFailed } else { Outcome::Done })
}

/// Writes the HTML page about a pipeline's artifacts `episodes`, `modes` and `audit`.
fn write_page(
    runner: &Runner,
    arguments: &StageArguments,
    [episodes, modes, audit]: [&Built; 3],
    output: &Output,
    console: Console,
) -> Result<()> {
    let ingest = &runner.pipeline.ingest;
    let source = &ingest.source;
    let settings: String = arguments
        .set
        .iter()
        .map(|setting| [" --set ", setting].concat())
        .collect();
    let text = audit_page(&AuditSources {
        task: runner.pipeline.task,
        dataset: match &ingest.filter {
            Some(filter) => format!("{source}, filter {filter}"),
            None => source.to_string(),
        },
        command: format!("re4-pipe audit {}{settings}", arguments.pipeline.display()),
        episodes: &episodes.artifact,
        modes: &modes.artifact,
        audit: &audit.artifact,
    })?;
    output.write(&text)?;
    let size = text.len() as f64 / 1e6;
    console.note(&format!("{:>10}  {}  {size:.1} MB", "page", output.named().display()));
    if text.len() > LARGE_PAGE {
        console.note(&format!(
            "warning: the page has {size:.0} MB and may open slowly; ingest.filter or ingest.select limits the demonstrations"
        ));
    }
    Ok(())
}
