//! Messages to the user on standard error: notes, progress bars and errors.

use std::borrow::Cow;
use std::error::Error;
use std::io::{IsTerminal as _, Write as _};

use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use re4_fault::{Fault, Remedy as _};
use serde_json::Value;

use crate::runner::warning_text;

/// Prints notes and progress bars, unless it is quiet.
#[derive(Debug, Clone, Copy)]
pub struct Notes {
    quiet: bool,
}

impl Notes {
    /// Prints nothing if `quiet`.
    pub fn new(quiet: bool) -> Self {
        Self { quiet }
    }

    /// Prints a note as one line.
    pub fn note(self, text: &str) {
        if !self.quiet {
            // A closed standard error does not stop the stage.
            let _ = writeln!(std::io::stderr(), "{text}");
        }
    }

    /// Prints a warning of a manifest.
    pub(crate) fn warning(self, warning: &Value) {
        self.note(&format!("{:>10}  {}", "warning", warning_text(warning)));
    }

    /// A progress bar. It is hidden if notes are quiet or standard error is not a terminal.
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

/// Prints an error and its remedy as one sentence.
pub fn print_error(error: &anyhow::Error) {
    let _ = writeln!(std::io::stderr(), "error: {}", fault_of(error).sentence());
}

/// Joins the messages of an error and its causes, outermost first, and their remedies. Repeated messages and remedies are
/// dropped.
pub fn fault_of(error: &anyhow::Error) -> Fault {
    let (mut what, mut remedies) = (String::new(), Vec::<String>::new());
    for error in error.chain() {
        let mut words = error.to_string();
        let mut remedy = remedy_of(error);
        // The text of an ingest error is complete: what is wrong with the dataset, the first "; ", and how to fix it. Its causes
        // are skipped.
        let last = error.is::<re4_ingest::IngestError>();
        if last {
            let fault = Fault::from_sentence(&words);
            remedy = fault.remedy().map(|remedy| Cow::Owned(remedy.into_owned()));
            words = fault.to_string();
        }
        if !what.contains(&words) {
            what.push_str(if what.is_empty() { "" } else { ": " });
            what.push_str(&words);
        }
        if let Some(remedy) = remedy.filter(|remedy| !remedies.iter().any(|known| known.contains(&**remedy))) {
            remedies.push(remedy.into_owned());
        }
        if last {
            break;
        }
    }
    Fault::new(what, (!remedies.is_empty()).then(|| remedies.join("; ")))
}

/// The remedy of an error, if it is of one of the listed error types. `anyhow` erases types, so each is tried.
fn remedy_of<'a>(error: &'a (dyn Error + 'static)) -> Option<Cow<'a, str>> {
    macro_rules! first {
        ($($kind:ty),* $(,)?) => {
            $(if let Some(error) = error.downcast_ref::<$kind>() {
                return error.remedy();
            })*
        };
    }
    first!(
        Fault,
        re4_artifact::ArtifactError,
        re4_audit::AuditError,
        re4_encoder::EncoderError,
        re4_generative::GenerativeError,
        re4_geometry::spatial::SymmetryError,
        re4_index::IndexError,
        re4_ingest::robomimic::MaskError,
        re4_mujoco::MujocoError,
        re4_policy::LookupError,
        re4_policy::kinds::OpenError,
        re4_pose::AnchorError,
        re4_pose::ImageError,
        re4_robosuite::models::AssetsError,
        re4_rollout::PolicyError,
        re4_rollout::RecordError,
        re4_rollout::RolloutError,
        re4_scenes::ScenesError,
        re4_segment::SegmentError,
        re4_sim::SimError,
        re4_train::TrainError,
        crate::parts::Partly,
        crate::stages::WorkerCrashed,
    );
    #[cfg(feature = "object-store")]
    first!(re4_object::AddressError);
    None
}
