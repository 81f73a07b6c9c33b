//! `re4-pipe audit`.

use anyhow::Result;

use super::Outcome;
use crate::arguments::AuditArguments;
use crate::stages::Runner;

/// `re4-pipe audit`.
pub(crate) fn audit(arguments: &AuditArguments) -> Result<Outcome> {
    let runner = Runner::new(&arguments.stage, &[])?;
    let episodes = runner.ingest()?;
    let modes = runner.segment(&episodes)?;
    let built = runner.audit(&episodes, &modes)?;
    runner.console.answer(&built.to_json())?;
    Ok(Outcome::Done)
}
