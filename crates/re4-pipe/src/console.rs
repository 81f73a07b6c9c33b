//! Everything that is printed. Results go to standard output, notes and progress to standard error.

use std::io::Write as _;
use std::path::Path;

use anyhow::Result;
use indicatif::ProgressBar;
use re4_fault::{Fault, Remedy as _, fault};
use re4_stages::{Notes, fault_of};
use serde_json::{Value, json};

use crate::arguments::Common;
use crate::output::Output;

/// How to print.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Console {
    json: bool,
    notes: Notes,
}

impl Console {
    /// Printing as the command line asks.
    pub(crate) fn new(common: &Common) -> Self {
        Self {
            json: common.json,
            notes: Notes::new(common.quiet),
        }
    }

    /// A note on progress, on standard error.
    pub(crate) fn note(self, text: &str) {
        self.notes.note(text);
    }

    /// A part of the result for people, on standard output.
    pub(crate) fn say(self, text: &str) -> std::io::Result<()> {
        if self.json {
            Ok(())
        } else {
            closed_pipe_is_fine(writeln!(std::io::stdout(), "{text}"))
        }
    }

    /// The result for machines, on standard output.
    pub(crate) fn answer(self, value: &Value) -> std::io::Result<()> {
        if self.json {
            closed_pipe_is_fine(writeln!(std::io::stdout(), "{value}"))
        } else {
            Ok(())
        }
    }

    /// Writes an image, and says where it is.
    pub(crate) fn image(self, path: &Path, svg: &str) -> Result<()> {
        Output::at(path, "image")?.write(svg)?;
        self.note(&format!("image in {}", path.display()));
        Ok(())
    }

    /// A progress bar; invisible when asked to be quiet or when standard error is no terminal.
    pub(crate) fn progress(self, length: u64, what: &'static str) -> ProgressBar {
        self.notes.progress(length, what)
    }
}

/// A reader that has read enough (`| head`) ends the printing, not the work.
fn closed_pipe_is_fine(result: std::io::Result<()>) -> std::io::Result<()> {
    match result {
        Err(error) if error.kind() == std::io::ErrorKind::BrokenPipe => Ok(()),
        other => other,
    }
}

/// Prints an error: one sentence on standard error, and where JSON was asked for, what is wrong and how to fix it on standard
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

/// Prints what is wrong with the command line, as one sentence on standard error.
pub(crate) fn print_usage_error(error: &clap::Error) {
    re4_stages::print_error(&usage_fault(&error.render().to_string()).into());
}

/// The parser answers in paragraphs: what is wrong (in its last line, the names it is about), a tip, the usage.
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
