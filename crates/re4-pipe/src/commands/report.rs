//! `re4-pipe report`: writes one self-contained HTML page about `rollouts` artifacts, about the training of an encoder, or about a
//! comparison.

use std::path::{Path, PathBuf};

use anyhow::{Result, ensure};
use re4_artifact::{Artifact, Stage};
use re4_report::{ReportPage, comparison_page, open_rollouts, report_page, training_page};
use re4_stages::{Seeds, add_images};
use serde_json::json;

use super::Outcome;
use crate::arguments::ReportArguments;
use crate::console::Console;
use crate::output::Output;

/// Which rollouts the viewer contains.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Shown<'a> {
    /// Seeds of its rollouts. `None`: all rollouts.
    pub(crate) seeds: Option<&'a Seeds>,
    /// Number of rollouts with camera images. `None`: the default, which depends on the source of the poses.
    pub(crate) images: Option<usize>,
}

/// The page that was written.
pub(crate) struct Written {
    artifacts: Vec<Artifact>,
    page: ReportPage,
}

impl Written {
    /// The contents of the page in one line.
    pub(crate) fn headline(&self) -> String {
        let ReportPage {
            rollouts,
            demonstrations,
            html,
            ..
        } = &self.page;
        let noun = if *rollouts == 1 { "rollout" } else { "rollouts" };
        let size = html.len() as f64 / 1e6;
        format!("{rollouts} {noun} in the viewer, {demonstrations} demonstrations, {size:.1} MB")
    }

    /// Prints the warnings.
    pub(crate) fn say_warnings(&self, console: Console) {
        for warning in &self.page.warnings {
            console.note(&format!("warning: {warning}"));
        }
    }
}

/// Makes the page of an artifact.
type MakePage = fn(&Artifact) -> Result<String>;

/// Pages of a single artifact without settings.
const PAGES: [(Stage, MakePage); 2] = [
    (Stage::Influence, re4_report::influence_page),
    (Stage::Curate, re4_report::curation_page),
];

/// `re4-pipe report`.
pub(crate) fn report(arguments: &ReportArguments) -> Result<Outcome> {
    let console = Console::new(&arguments.common);
    let seeds = arguments.seeds.as_deref().map(str::parse).transpose()?;
    let output = Output::at(&arguments.output, "report")?;
    if let [path] = arguments.paths.as_slice() {
        let artifact = Artifact::open(path)?;
        if artifact.manifest().artifact == Stage::TrainPose.artifact() {
            return report_training(&artifact, arguments, &output, console);
        }
        if artifact.manifest().artifact == Stage::Compare.artifact() {
            return report_comparison(&artifact, arguments, &output, console);
        }
        for (stage, page) in PAGES {
            if artifact.manifest().artifact == stage.artifact() {
                refuse_selection(&artifact, arguments)?;
                return answer_single(
                    &artifact,
                    arguments,
                    &output,
                    console,
                    (stage.as_str(), &page(&artifact)?, &[]),
                );
            }
        }
    }
    let shown = Shown {
        seeds: seeds.as_ref(),
        images: arguments.images,
    };
    let written = write(&arguments.paths, shown, &output, &arguments.common.artifacts)?;
    written.say_warnings(console);
    console.answer(&json!({
        "report": arguments.output,
        "bytes": written.page.html.len(),
        "artifacts": written.artifacts.iter().map(|artifact| json!({ "path": artifact.path(), "key": artifact.key() })).collect::<Vec<_>>(),
        "rollouts_in_viewer": written.page.rollouts,
        "demonstrations_in_viewer": written.page.demonstrations,
        "warnings": written.page.warnings,
    }))?;
    console.say(&format!(
        "report {}  {}",
        arguments.output.display(),
        written.headline()
    ))?;
    Ok(Outcome::Done)
}

/// Writes the page of a training.
fn report_training(
    artifact: &Artifact,
    arguments: &ReportArguments,
    output: &Output,
    console: Console,
) -> Result<Outcome> {
    refuse_selection(artifact, arguments)?;
    artifact.verify_bytes()?;
    let (html, warnings) = training_page(artifact, &arguments.common.artifacts)?;
    answer_single(
        artifact,
        arguments,
        output,
        console,
        ("training of an encoder", &html, &warnings),
    )
}

/// Writes the page of a comparison.
fn report_comparison(
    artifact: &Artifact,
    arguments: &ReportArguments,
    output: &Output,
    console: Console,
) -> Result<Outcome> {
    refuse_selection(artifact, arguments)?;
    let html = comparison_page(artifact, &arguments.common.artifacts)?;
    answer_single(artifact, arguments, output, console, ("comparison", &html, &[]))
}

/// Refuses options that select rollouts for an artifact without rollouts.
fn refuse_selection(artifact: &Artifact, arguments: &ReportArguments) -> Result<()> {
    ensure!(
        arguments.seeds.is_none() && arguments.images.is_none(),
        "cannot show rollouts of {}: it has a {} artifact, not rollouts; leave --seeds and --images out",
        artifact.path().display(),
        artifact.manifest().artifact
    );
    Ok(())
}

/// Writes a page that was made from one artifact, and prints what it is.
fn answer_single(
    artifact: &Artifact,
    arguments: &ReportArguments,
    output: &Output,
    console: Console,
    (what, html, warnings): (&str, &str, &[String]),
) -> Result<Outcome> {
    output.write(html)?;
    for warning in warnings {
        console.note(&format!("warning: {warning}"));
    }
    console.answer(&json!({
        "report": arguments.output,
        "bytes": html.len(),
        "artifacts": [{ "path": artifact.path(), "key": artifact.key() }],
        "warnings": warnings,
    }))?;
    console.say(&format!(
        "report {}  {what}, {:.1} MB",
        arguments.output.display(),
        html.len() as f64 / 1e6
    ))?;
    Ok(Outcome::Done)
}

/// Reads the artifacts and writes the page. `index` artifacts are searched for beside the artifacts and in `store`.
pub(crate) fn write(paths: &[PathBuf], shown: Shown<'_>, output: &Output, store: &Path) -> Result<Written> {
    let artifacts = open_rollouts(paths)?;
    let page = report_page(
        &artifacts,
        shown.seeds.map(Seeds::as_slice),
        store,
        shown.images,
        &mut |artifact, set| add_images(artifact, set, shown.images, store),
    )?;
    output.write(&page.html)?;
    Ok(Written { artifacts, page })
}
