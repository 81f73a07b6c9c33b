//! `re4-pipe query`: SQL over the tables of any artifacts.

use std::io::{BufWriter, Write as _};

use anyhow::Result;
use re4_query::{Preview, Sources, limit_threads, write_csv, write_json};
use serde_json::json;

use super::Outcome;
use crate::arguments::QueryArguments;
use crate::console::Console;
use crate::output::Output;
use crate::terminal::width;

/// Answers a query.
pub(crate) fn query(arguments: &QueryArguments) -> Result<Outcome> {
    if let Some(jobs) = arguments.common.jobs {
        limit_threads(jobs);
    }
    let console = Console::new(&arguments.common);
    let output = arguments
        .parquet
        .as_deref()
        .map(|path| Output::at(path, "table"))
        .transpose()?;
    let paths = if arguments.paths.is_empty() {
        std::slice::from_ref(&arguments.common.artifacts)
    } else {
        &arguments.paths
    };
    let specs = re4_stages::tables::all().map(|(_, spec)| spec).collect();
    let answer = Sources::open(paths, specs)?.query(&arguments.sql)?;
    if let Some(output) = output {
        let file = output.temporary()?;
        answer.write_parquet(file.path())?;
        output.keep(file)?;
        console.note(&format!("table written to {}", output.named().display()));
        console.answer(&json!({ "parquet": output.named() }))?;
        return Ok(Outcome::Done);
    }
    if !arguments.csv && !arguments.common.json {
        console.say(&Preview::of(answer, arguments.rows)?.text(width()))?;
        return Ok(Outcome::Done);
    }
    let mut to = BufWriter::new(std::io::stdout().lock());
    let written = if arguments.csv {
        write_csv(answer, &mut to)
    } else {
        write_json(answer, &mut to)
    };
    let written = written.and_then(|()| Ok(to.flush()?));
    match written {
        // A closed pipe (`| head`) ends the printing.
        Err(error)
            if error
                .downcast_ref::<std::io::Error>()
                .is_some_and(|error| error.kind() == std::io::ErrorKind::BrokenPipe) => {}
        other => other?,
    }
    Ok(Outcome::Done)
}
