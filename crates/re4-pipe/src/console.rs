//! Everything that is printed. Results go to standard output, notes and progress to standard error.

use std::io::{IsTerminal as _, Write as _};
use std::path::Path;

use anyhow::Result;
use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use serde_json::Value;

use crate::arguments::Common;
use crate::output::Output;

/// How to print.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Console {
    json: bool,
    quiet: bool,
}

impl Console {
    /// Printing as the command line asks.
    pub(crate) fn new(common: &Common) -> Self {
        Self {
            json: common.json,
            quiet: common.quiet,
        }
    }

    /// A note on progress, on standard error.
    pub(crate) fn note(self, text: &str) {
        if !self.quiet {
            // A closed standard error is no reason to stop the work.
            let _ = writeln!(std::io::stderr(), "{text}");
        }
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

    /// Writes a picture, and says where it is.
    pub(crate) fn picture(self, path: &Path, svg: &str) -> Result<()> {
        Output::at(path, "picture")?.write(svg)?;
        self.note(&format!("picture in {}", path.display()));
        Ok(())
    }

    /// A progress bar; invisible when asked to be quiet or when standard error is no terminal.
    pub(crate) fn progress(self, length: u64, what: &'static str) -> ProgressBar {
        let visible = !self.quiet && std::io::stderr().is_terminal();
        let target = if visible {
            ProgressDrawTarget::stderr()
        } else {
            ProgressDrawTarget::hidden()
        };
        let bar = ProgressBar::with_draw_target(Some(length), target);
        if let Ok(style) = ProgressStyle::with_template("{msg:>10} [{bar:40}] {pos}/{len} {per_sec} eta {eta}") {
            bar.set_style(style.progress_chars("=> "));
        }
        bar.set_message(what);
        bar
    }
}

/// One line of JSON for the process that started this one.
pub(crate) fn tell(word: &impl serde::Serialize) {
    if let Ok(text) = serde_json::to_string(word) {
        let mut output = std::io::stdout().lock();
        // Where nobody listens any more, this process is about to stop, too.
        let _ = writeln!(output, "{text}").and_then(|()| output.flush());
    }
}

/// A reader that has read enough (`| head`) ends the printing, not the work.
fn closed_pipe_is_fine(result: std::io::Result<()>) -> std::io::Result<()> {
    match result {
        Err(error) if error.kind() == std::io::ErrorKind::BrokenPipe => Ok(()),
        other => other,
    }
}

/// Prints an error as one sentence on standard error.
pub(crate) fn print_error(error: &anyhow::Error) {
    let _ = writeln!(std::io::stderr(), "error: {}", sentence(error));
}

/// Prints what is wrong with the command line, as one sentence on standard error.
pub(crate) fn print_usage_error(error: &clap::Error) {
    let _ = writeln!(
        std::io::stderr(),
        "error: {}",
        usage_sentence(&error.render().to_string())
    );
}

/// What, where and how to mend: contexts are written `what; mend`, and their cause stands between the two. A cause that
/// the sentence already tells is not told again.
pub(crate) fn sentence(error: &anyhow::Error) -> String {
    let (mut text, mut mend) = (String::new(), String::new());
    for words in error.chain().map(ToString::to_string) {
        if text.contains(&words) || mend.contains(&words) {
            continue;
        }
        let (what, how) = words
            .split_once("; ")
            .map_or((words.as_str(), None), |(what, how)| (what, Some(how)));
        if !text.contains(what) {
            text.push_str(if text.is_empty() { "" } else { ": " });
            text.push_str(what);
        }
        if let Some(how) = how.filter(|how| !mend.contains(how)) {
            mend.push_str("; ");
            mend.push_str(how);
        }
    }
    text + &mend
}

/// The parser answers in paragraphs: what is wrong (in its last line, the names it is about), a tip, the usage.
fn usage_sentence(rendered: &str) -> String {
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
    format!("{}; see re4-pipe --help", parts.join("; "))
}
