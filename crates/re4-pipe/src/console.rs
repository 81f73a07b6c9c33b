//! Printing. Results go to standard output; notes, progress bars and errors go to standard error.

use std::io::Write as _;
use std::path::Path;
use std::process::ExitCode;

use anyhow::Result;
use indicatif::ProgressBar;
use re4_fault::{Fault, Remedy as _, fault};
use re4_stages::{Notes, Partly, fault_of};
use serde_json::{Value, json};

use crate::arguments::Common;
use crate::output::Output;

/// Prints which shard of an artifact the process has made.
pub(crate) fn print_share(share: &Partly, json: bool) -> ExitCode {
    let printed = if json {
        let value = serde_json::to_value(share).unwrap_or_default();
        // The name of the variant is left out.
        let fields = value.as_object().and_then(|variant| variant.values().next());
        writeln!(std::io::stdout(), "{}", fields.unwrap_or(&Value::Null))
    } else {
        writeln!(std::io::stdout(), "{share}")
    };
    match closed_pipe_is_fine(printed) {
        Ok(()) => ExitCode::SUCCESS,
        Err(_) => ExitCode::from(2),
    }
}

/// Prints results, notes and progress bars.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Console {
    json: bool,
    notes: Notes,
}

impl Console {
    /// Uses the options `--json` and `--quiet` of the command line.
    pub(crate) fn new(common: &Common) -> Self {
        Self {
            json: common.json,
            notes: Notes::new(common.quiet),
        }
    }

    /// Prints a note on standard error.
    pub(crate) fn note(self, text: &str) {
        self.notes.note(text);
    }

    /// Prints a part of the result as text on standard output, unless JSON was requested.
    pub(crate) fn say(self, text: &str) -> std::io::Result<()> {
        if self.json {
            Ok(())
        } else {
            closed_pipe_is_fine(writeln!(std::io::stdout(), "{text}"))
        }
    }

    /// Prints the result as JSON on standard output, if requested.
    pub(crate) fn answer(self, value: &Value) -> std::io::Result<()> {
        if self.json {
            closed_pipe_is_fine(writeln!(std::io::stdout(), "{value}"))
        } else {
            Ok(())
        }
    }

    /// Writes an SVG image and prints its path.
    pub(crate) fn image(self, path: &Path, svg: &str) -> Result<()> {
        Output::at(path, "image")?.write(svg)?;
        self.note(&format!("image written to {}", path.display()));
        Ok(())
    }

    /// A progress bar. It is hidden with `--quiet` or if standard error is not a terminal.
    pub(crate) fn progress(self, length: u64, what: &'static str) -> ProgressBar {
        self.notes.progress(length, what)
    }
}

/// Ignores a closed pipe (`| head`): the printing ends, and the command continues.
fn closed_pipe_is_fine(result: std::io::Result<()>) -> std::io::Result<()> {
    match result {
        Err(error) if error.kind() == std::io::ErrorKind::BrokenPipe => Ok(()),
        other => other,
    }
}

/// Prints an error as one sentence on standard error. If JSON was requested, also prints the error and its remedy on standard
/// output.
pub(crate) fn print_error(error: &anyhow::Error, json: bool) {
    re4_stages::print_error(error);
    if json {
        let fault = fault_of(error);
        let _ = writeln!(
            std::io::stdout(),
            "{}",
            json!({ "error": fault.to_string(), "remedy": fault.remedy() })
        );
    }
}

/// Prints an error in the arguments as one sentence on standard error.
pub(crate) fn print_usage_error(error: &clap::Error) {
    re4_stages::print_error(&usage_fault(&error.render().to_string()).into());
}

/// Converts clap's message to one sentence. Its paragraphs are the error, whose last lines may list arguments, tips, and the usage,
/// which is dropped.
fn usage_fault(rendered: &str) -> Fault {
    let mut parts = Vec::new();
    for paragraph in rendered.split("\n\n") {
        let lines: Vec<&str> = paragraph
            .lines()
            .map(str::trim)
            .filter(|line| !line.is_empty())
            .collect();
        match lines.first() {
            None => {}
            Some(line) if line.starts_with("Usage:") || line.starts_with("For more information") => {}
            Some(line) => parts.push(
                lines
                    .join(" ")
                    .replacen("error: ", "", usize::from(line.starts_with("error: "))),
            ),
        }
    }
    fault!("{}", parts.join("; "); "see re4-pipe --help")
}
