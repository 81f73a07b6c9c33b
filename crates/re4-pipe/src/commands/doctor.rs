//! `re4-pipe doctor`: reports what is installed and what is missing.

use std::fmt::Write as _;

use anyhow::Result;
use re4_stages::{State, doctor as look};
use serde_json::json;

use super::Outcome;
use crate::arguments::DoctorArguments;
use crate::console::Console;
use crate::terminal::{paragraph, width};

/// Prints one line per component. For a component that was not found, also prints what needs it and how to install it.
pub(crate) fn doctor(arguments: &DoctorArguments) -> Result<Outcome> {
    let console = Console::new(&arguments.common);
    let pipeline = arguments
        .pipeline
        .as_deref()
        .map(|path| re4_stages::read_pipeline(path, &arguments.set))
        .transpose()?;
    let found = look(pipeline.as_ref(), &arguments.common.artifacts);
    let missing = found.iter().filter(|finding| finding.state == State::Missing).count();
    console.answer(&json!({ "findings": found, "missing": missing }))?;
    let width = width();
    let mut text = String::new();
    let mut group = "";
    for finding in &found {
        if finding.group != group {
            group = finding.group;
            writeln!(text, "{group}")?;
        }
        let line = format!("{:<7}  {:<22} {}", finding.state, finding.name, finding.detail);
        writeln!(text, "{}", paragraph(&line, 2, 9, width))?;
        if finding.state == State::Found {
            continue;
        }
        if !finding.needed_by.is_empty() {
            let line = format!("needed by: {}", finding.needed_by);
            writeln!(text, "{}", paragraph(&line, 11, 2, width))?;
        }
        if let Some(fix) = &finding.fix {
            writeln!(text, "{}", paragraph(&format!("fix: {fix}"), 11, 2, width))?;
        }
    }
    let conclusion = match (missing, &arguments.pipeline) {
        (0, Some(path)) => format!("{} can be run", path.display()),
        (0, None) => "nothing that all commands need is missing".to_owned(),
        (1, _) => "1 component is missing".to_owned(),
        (n, _) => format!("{n} components are missing"),
    };
    text.push_str(&conclusion);
    console.say(&text)?;
    Ok(if missing == 0 {
        Outcome::Done
    } else {
        Outcome::GateFailed
    })
}
