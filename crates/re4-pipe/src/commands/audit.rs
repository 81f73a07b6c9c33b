//! `re4-pipe audit`.

use anyhow::Result;

use super::{Outcome, audit_text};
use crate::arguments::{AuditArguments, FailOn};
use crate::stages::Runner;

/// `re4-pipe audit`.
pub(crate) fn audit(arguments: &AuditArguments) -> Result<Outcome> {
    let runner = Runner::new(&arguments.stage, &[])?;
    let episodes = runner.ingest()?;
    let modes = runner.segment(&episodes)?;
    let built = runner.audit(&episodes, &modes)?;
    let told = audit_text::Told::read(&built.artifact)?;
    runner.console.answer(&told.to_json(built.to_json()))?;
    runner.console.say(&told.text()?)?;
    // The gate comes last: whatever it says, everything is written and told.
    let failed = match arguments.fail_on {
        None => false,
        Some(FailOn::Error) => told.count("error") > 0,
        Some(FailOn::Warning) => told.count("error") + told.count("warning") > 0,
    };
    Ok(if failed { Outcome::GateFailed } else { Outcome::Done })
}
