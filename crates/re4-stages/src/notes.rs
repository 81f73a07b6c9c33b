//! What people are told while stages work, on standard error.

use std::io::{IsTerminal as _, Write as _};

use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};

/// Notes and progress bars, or none of them.
#[derive(Debug, Clone, Copy)]
pub struct Notes {
    quiet: bool,
}

impl Notes {
    /// Notes that are told unless asked to be quiet.
    pub fn new(quiet: bool) -> Self {
        Self { quiet }
    }

    /// A note on progress.
    pub fn note(self, text: &str) {
        if !self.quiet {
            // A closed standard error is no reason to stop the work.
            let _ = writeln!(std::io::stderr(), "{text}");
        }
    }

    /// A progress bar; invisible when asked to be quiet or when standard error is no terminal.
    pub fn progress(self, length: u64, what: &'static str) -> ProgressBar {
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

/// Prints an error as one sentence.
pub fn print_error(error: &anyhow::Error) {
    let _ = writeln!(std::io::stderr(), "error: {}", sentence(error));
}

/// What, where and how to mend: contexts are written `what; mend`, and their cause stands between the two. A cause that
/// the sentence already tells is not told again.
pub fn sentence(error: &anyhow::Error) -> String {
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
