//! `re4-pipe export`: writes demonstrations and rollouts in the formats of other programs.

use std::cell::RefCell;
use std::fmt::Write as _;
use std::time::Instant;

use anyhow::Result;
use indicatif::ProgressBar;
use re4_artifact::Artifact;
use re4_export::{Exported, Hooks, Request, export as write};
use re4_fault::{bail, ensure};
use re4_stages::Interrupt;
use serde_json::json;

use super::Outcome;
use crate::arguments::{ExportArguments, ExportFormat};
use crate::console::Console;

/// `re4-pipe export`.
pub(crate) fn export(arguments: &ExportArguments) -> Result<Outcome> {
    let start = Instant::now();
    let console = Console::new(&arguments.common);
    let interrupt = Interrupt::listen(None);
    let format = arguments.format;
    ensure!(
        arguments.video.is_none() || matches!(format, ExportFormat::Lerobot | ExportFormat::LerobotV21),
        "only LeRobot datasets have videos, and the format is {}", format.format().name();
        "leave --video out"
    );
    let out = std::path::absolute(&arguments.out)?;
    let inside = out
        .ancestors()
        .skip(1)
        .find(|ancestor| Artifact::open(ancestor).is_ok());
    if let Some(artifact) = inside {
        bail!(
            "cannot export to {}: that path is inside the artifact {}, which would be damaged",
            arguments.out.display(), artifact.display();
            "give another path"
        );
    }
    let bar: RefCell<Option<ProgressBar>> = RefCell::new(None);
    let progress = |done: usize, total: usize| {
        let mut bar = bar.borrow_mut();
        let bar = bar.get_or_insert_with(|| console.progress(total as u64, "export"));
        bar.set_position(done as u64);
    };
    let exported = write(
        &Request {
            artifact: &arguments.artifact,
            format: format.format(),
            out: &arguments.out,
            keep: arguments.keep.as_deref(),
            modes: arguments.modes.as_deref(),
            poses: arguments.poses.as_deref(),
            task: arguments.task.as_deref(),
            successes: arguments.successes,
            double: arguments.float64,
            images: arguments.images(),
            program: concat!("re4-pipe ", env!("CARGO_PKG_VERSION")),
            limits: re4_export::Limits::default(),
        },
        Hooks {
            stop: &|| interrupt.requested(),
            progress: &progress,
        },
    );
    if let Some(bar) = bar.into_inner() {
        bar.finish_and_clear();
    }
    let exported = match exported {
        Err(_) if interrupt.requested() => return interrupt.check("export").map(|()| Outcome::Done),
        exported => exported?,
    };
    for note in &exported.notes {
        console.note(&format!("note: {note}"));
    }
    console.answer(&json!({
        "path": arguments.out,
        "format": format.format().name(),
        "episodes": exported.episodes,
        "frames": exported.frames,
        "bytes": exported.bytes,
        "features": exported.features,
        "notes": exported.notes,
        "wall_s": start.elapsed().as_secs_f64(),
    }))?;
    console.say(&text(arguments, &exported)?)?;
    Ok(Outcome::Done)
}

fn text(arguments: &ExportArguments, exported: &Exported) -> Result<String> {
    let mut text = format!(
        "{} written to {}: {} episodes, {} frames, {} bytes",
        arguments.format.format().name(),
        arguments.out.display(),
        exported.episodes,
        exported.frames,
        exported.bytes
    );
    for feature in &exported.features {
        write!(text, "\n  {feature}")?;
    }
    Ok(text)
}
