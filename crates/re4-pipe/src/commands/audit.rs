//! `re4-pipe audit`.

use anyhow::Result;

use super::{Outcome, audit_page, audit_text};
use crate::arguments::{AuditArguments, FailOn};
use crate::console::Console;
use crate::output::Output;

/// `re4-pipe audit`.
pub(crate) fn audit(arguments: &AuditArguments) -> Result<Outcome> {
    let console = Console::new(&arguments.stage.common);
    // Where it cannot be written, that is said before any work.
    let page = arguments
        .html
        .as_deref()
        .map(|path| Output::at(path, "page"))
        .transpose()?;
    // What cannot be used is what an audit is there to find.
    let runner = arguments.stage.runner(&["ingest.on_bad=leave_out".to_owned()])?;
    if let Some(page) = &page {
        page.spares(&runner.inputs()?)?;
    }
    let episodes = runner.ingest()?;
    let modes = runner.segment(&episodes)?;
    let built = runner.audit(&episodes, &modes)?;
    if let Some(output) = &page {
        let sources = audit_page::Sources::of(&runner, &arguments.stage, [&episodes, &modes, &built]);
        audit_page::write(&sources, output, console)?;
    }
    let told = audit_text::Told::read(&built.artifact)?;
    console.answer(&told.to_json(built.to_json()))?;
    console.say(&told.text()?)?;
    // The gate comes last: whatever it says, everything is written and told.
    let failed = match arguments.fail_on {
        None => false,
        Some(FailOn::Error) => told.count("error") > 0,
        Some(FailOn::Warning) => told.count("error") + told.count("warning") > 0,
    };
    Ok(if failed { Outcome::GateFailed } else { Outcome::Done })
}
