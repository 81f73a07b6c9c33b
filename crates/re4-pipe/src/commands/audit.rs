//! `re4-pipe audit`.

use anyhow::Result;

use super::{Outcome, audit_page};
use crate::arguments::AuditArguments;
use crate::output::Output;
use crate::stages::Runner;

/// `re4-pipe audit`.
pub(crate) fn audit(arguments: &AuditArguments) -> Result<Outcome> {
    let page = arguments
        .html
        .as_deref()
        .map(|path| Output::at(path, "page"))
        .transpose()?;
    let runner = Runner::new(&arguments.stage, &[])?;
    let episodes = runner.ingest()?;
    let modes = runner.segment(&episodes)?;
    let built = runner.audit(&episodes, &modes)?;
    if let Some(output) = &page {
        let sources = audit_page::Sources::of(&runner, &arguments.stage, [&episodes, &modes, &built]);
        audit_page::write(&sources, output, runner.console)?;
    }
    runner.console.answer(&built.to_json())?;
    Ok(Outcome::Done)
}
