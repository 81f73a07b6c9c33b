//! `re4-pipe report`: one self-contained HTML page over `rollouts` artifacts.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

use anyhow::{Context as _, Result, bail, ensure};
use re4_artifact::Row as _;
use re4_artifact::{Artifact, Key, MANIFEST_NAME, Stage, col_f64, col_u32};
use re4_report::html::spatial::{SpatialReport, SpatialRollouts, spatial_page};
use re4_report::html::{Demonstration, Report, Rollouts, World, page};
use serde_json::json;

use super::Outcome;
use crate::arguments::ReportArguments;
use crate::console::Console;
use crate::output::Output;
use re4_stages::Seeds;

mod pictures;
mod rollouts;
mod spatial;

pub(super) use rollouts::stated;

/// A page beyond this many bytes takes a while to open, which is said.
const LARGE_PAGE: usize = 12_000_000;

/// What the viewer holds.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Shown<'a> {
    /// Seeds of its rollouts; all where there are none.
    pub(crate) seeds: Option<&'a Seeds>,
    /// How many of the rollouts have pictures; where it is left open, it depends on where poses come from.
    pub(crate) pictures: Option<usize>,
}

/// What was written.
pub(crate) struct Written {
    bytes: usize,
    artifacts: Vec<Artifact>,
    rollouts: usize,
    demonstrations: usize,
    warnings: Vec<String>,
}

impl Written {
    /// What the page holds, in words.
    pub(crate) fn headline(&self) -> String {
        format!(
            "{} in the viewer, {} demonstrations, {:.1} MB",
            if self.rollouts == 1 {
                "1 rollout".to_owned()
            } else {
                format!("{} rollouts", self.rollouts)
            },
            self.demonstrations,
            self.bytes as f64 / 1e6
        )
    }

    /// What the user should know.
    pub(crate) fn say_warnings(&self, console: Console) {
        for warning in &self.warnings {
            console.note(&format!("warning: {warning}"));
        }
    }
}

/// `re4-pipe report`.
pub(crate) fn report(arguments: &ReportArguments) -> Result<Outcome> {
    let console = Console::new(&arguments.common);
    let seeds = arguments.seeds.as_deref().map(str::parse).transpose()?;
    let output = Output::at(&arguments.output, "report")?;
    let shown = Shown {
        seeds: seeds.as_ref(),
        pictures: arguments.pictures,
    };
    let written = write(&arguments.paths, shown, &output, &arguments.common.artifacts)?;
    written.say_warnings(console);
    console.answer(&json!({
        "report": arguments.output,
        "bytes": written.bytes,
        "artifacts": written.artifacts.iter().map(|artifact| json!({ "path": artifact.path(), "key": artifact.key() })).collect::<Vec<_>>(),
        "rollouts_in_viewer": written.rollouts,
        "demonstrations_in_viewer": written.demonstrations,
        "warnings": written.warnings,
    }))?;
    console.say(&format!(
        "report {}  {}",
        arguments.output.display(),
        written.headline()
    ))?;
    Ok(Outcome::Done)
}

/// Reads the artifacts, makes the page and writes it whole. Indices are looked for beside the artifacts and in `store`.
pub(crate) fn write(paths: &[PathBuf], shown: Shown<'_>, output: &Output, store: &Path) -> Result<Written> {
    let artifacts = open_all(paths)?;
    let made = if spatial::all_spatial(&artifacts)? {
        in_space(&artifacts, shown, store)?
    } else {
        ensure!(
            shown.pictures.unwrap_or(0) == 0,
            "cannot show pictures of {}: its rollouts are Push-T's, which the page draws itself; leave --pictures out",
            artifacts[0].path().display()
        );
        planar(&artifacts, shown.seeds, store)?
    };
    let Page {
        html,
        rollouts,
        demonstrations,
        mut warnings,
    } = made;
    if html.len() > LARGE_PAGE {
        warnings.push(format!(
            "the page is {} MB large; re4-pipe report --seeds limits the rollouts that the viewer holds",
            html.len() / 1_000_000
        ));
    }
    output.write(&html)?;
    Ok(Written {
        bytes: html.len(),
        artifacts,
        rollouts,
        demonstrations,
        warnings,
    })
}

/// A page, and what it holds.
struct Page {
    html: String,
    rollouts: usize,
    demonstrations: usize,
    warnings: Vec<String>,
}

fn planar(artifacts: &[Artifact], seeds: Option<&Seeds>, store: &Path) -> Result<Page> {
    let mut sets = artifacts
        .iter()
        .map(rollouts::read)
        .collect::<Result<Vec<Rollouts>>>()?;
    if let Some(seeds) = seeds {
        let all = sets.iter_mut().flat_map(|set| &mut set.rollouts);
        show_only(all.map(|rollout| (rollout.seed, &mut rollout.shown)), seeds)?;
    }
    let mut warnings = Vec::new();
    let mut demonstrations = BTreeMap::new();
    for (artifact, set) in artifacts.iter().zip(&sets) {
        if demonstrations.contains_key(&set.index_key) {
            continue;
        }
        let needed = sets
            .iter()
            .filter(|other| other.index_key == set.index_key)
            .flat_map(|other| other.rollouts.iter().filter(|rollout| rollout.shown))
            .flat_map(|rollout| rollout.decisions.iter().map(|decision| decision.demo))
            .collect();
        match find_index(artifact, store)? {
            Some(index) => {
                demonstrations.insert(set.index_key.clone(), read_demonstrations(&index, &needed)?);
            }
            None => warnings.push(without_frames(artifact, &set.index_key, store)),
        }
    }
    let shown = |set: &Rollouts| set.rollouts.iter().filter(|rollout| rollout.shown).count();
    Ok(Page {
        rollouts: sets.iter().map(shown).sum(),
        demonstrations: demonstrations.values().map(BTreeMap::len).sum(),
        warnings,
        html: page(&Report {
            tool_version: env!("CARGO_PKG_VERSION").to_owned(),
            world: world(),
            artifacts: sets,
            demonstrations,
        }),
    })
}

fn in_space(artifacts: &[Artifact], viewer: Shown<'_>, store: &Path) -> Result<Page> {
    let indices = artifacts
        .iter()
        .map(|artifact| find_index(artifact, store))
        .collect::<Result<Vec<Option<Artifact>>>>()?;
    let mut sets = artifacts
        .iter()
        .zip(&indices)
        .map(|(artifact, index)| spatial::read(artifact, index.as_ref()))
        .collect::<Result<Vec<SpatialRollouts>>>()?;
    if let Some(seeds) = viewer.seeds {
        let all = sets.iter_mut().flat_map(|set| &mut set.rollouts);
        show_only(all.map(|rollout| (rollout.seed, &mut rollout.shown)), seeds)?;
    }
    let mut warnings = Vec::new();
    for (artifact, set) in artifacts.iter().zip(&mut sets) {
        warnings.extend(pictures::add(artifact, set, viewer.pictures, store)?);
    }
    let mut demonstrations = BTreeMap::new();
    for ((artifact, index), set) in artifacts.iter().zip(&indices).zip(&sets) {
        if demonstrations.contains_key(&set.index_key) {
            continue;
        }
        let Some(index) = index else {
            warnings.push(without_frames(artifact, &set.index_key, store));
            continue;
        };
        let needed = sets
            .iter()
            .filter(|other| other.index_key == set.index_key)
            .flat_map(|other| other.rollouts.iter().filter(|rollout| rollout.shown))
            .flat_map(|rollout| {
                rollout
                    .decisions
                    .iter()
                    .filter_map(|decision| Some(decision.choice.as_ref()?.demo))
            })
            .collect();
        demonstrations.insert(set.index_key.clone(), spatial::read_demonstrations(index, &needed)?);
    }
    let shown = |set: &SpatialRollouts| set.rollouts.iter().filter(|rollout| rollout.shown).count();
    Ok(Page {
        rollouts: sets.iter().map(shown).sum(),
        demonstrations: demonstrations.values().map(BTreeMap::len).sum(),
        warnings,
        html: spatial_page(&SpatialReport {
            tool_version: env!("CARGO_PKG_VERSION").to_owned(),
            artifacts: sets,
            demonstrations,
        }),
    })
}

fn without_frames(artifact: &Artifact, index_key: &str, store: &Path) -> String {
    format!(
        "the page shows no recorded frames for {}: its index artifact index/{} is neither beside it nor in {}",
        artifact.path().display(),
        short(index_key),
        store.display()
    )
}

fn short(key: &str) -> &str {
    key.get(..16).unwrap_or(key)
}

/// Opens and verifies the artifacts; each is named once, and each holds rollouts.
fn open_all(paths: &[PathBuf]) -> Result<Vec<Artifact>> {
    let mut artifacts: Vec<Artifact> = Vec::new();
    for path in paths {
        let artifact = Artifact::open(path)?;
        let kind = &artifact.manifest().artifact;
        ensure!(
            *kind == Stage::Rollout.artifact(),
            "cannot report on {}: it is an artifact of kind {kind}, and a report is made of rollouts; name a folder below {}",
            path.display(),
            Path::new("artifacts").join(Stage::Rollout.artifact()).display()
        );
        if let Some(first) = artifacts.iter().find(|first| first.key() == artifact.key()) {
            bail!(
                "cannot report on {}: it is the same artifact as {}; name each artifact once",
                path.display(),
                first.path().display()
            );
        }
        artifact.verify_bytes()?;
        artifacts.push(artifact);
    }
    Ok(artifacts)
}

/// Keeps the traces of these seeds only; figures count all.
fn show_only<'a>(rollouts: impl Iterator<Item = (u32, &'a mut bool)>, seeds: &Seeds) -> Result<()> {
    let wanted: BTreeSet<u32> = seeds.as_slice().iter().copied().collect();
    let mut found = BTreeSet::new();
    for (seed, shown) in rollouts {
        *shown = wanted.contains(&seed);
        if *shown {
            found.insert(seed);
        }
    }
    if let Some(seed) = wanted.difference(&found).next() {
        bail!("cannot show seed {seed}: none of the artifacts has a rollout of it; give seeds that they have");
    }
    Ok(())
}

/// The index that an artifact's demonstrations were retrieved from: beside it, or in the artifacts folder.
fn find_index(rollouts: &Artifact, store: &Path) -> Result<Option<Artifact>> {
    find_input(rollouts, Stage::Index, store)
}

/// An artifact that rollouts were made from: beside them, or in the artifacts folder.
pub(super) fn find_input(rollouts: &Artifact, stage: Stage, store: &Path) -> Result<Option<Artifact>> {
    let key = input_key(rollouts, stage)?;
    let beside = std::fs::canonicalize(rollouts.path())
        .ok()
        .and_then(|path| path.ancestors().nth(2).map(Path::to_path_buf));
    let folders = beside.into_iter().chain([store.to_path_buf()]);
    for folder in folders.map(|root| root.join(stage.artifact()).join(key.short())) {
        if !folder.join(MANIFEST_NAME).exists() {
            continue;
        }
        let input = Artifact::open(&folder)?;
        ensure!(
            input.key() == key,
            "cannot read {}: it is the {} {}, and the rollouts in {} were made from {key}; move the folder away and run the pipeline again",
            folder.display(),
            stage.artifact(),
            input.key(),
            rollouts.path().display()
        );
        input.verify_bytes()?;
        return Ok(Some(input));
    }
    Ok(None)
}

fn index_key(rollouts: &Artifact) -> Result<&Key> {
    input_key(rollouts, Stage::Index)
}

fn input_key(rollouts: &Artifact, stage: Stage) -> Result<&Key> {
    rollouts.manifest().inputs.get(stage.artifact()).with_context(|| {
        format!(
            "cannot read the rollouts in {}: their manifest names no {}; run the rollout again",
            rollouts.path().display(),
            stage.artifact()
        )
    })
}

/// The frames of the demonstrations that are referred to.
fn read_demonstrations(index: &Artifact, needed: &BTreeSet<u32>) -> Result<BTreeMap<u32, Demonstration>> {
    let columns = ["eef_x", "eef_y", "object_x", "object_y", "object_theta"];
    let table = index.table(re4_index::IndexRow::<re4_index::PlanarState>::table())?;
    let rows = table.read_columns(&[&["episode"], &columns[..]].concat())?;
    let mut values = Vec::with_capacity(columns.len());
    for column in columns {
        values.push(col_f64(&rows, column)?);
    }
    let mut demonstrations: BTreeMap<u32, Demonstration> = BTreeMap::new();
    for (row, episode) in col_u32(&rows, "episode")?.iter().enumerate() {
        if needed.contains(episode) {
            let frame = std::array::from_fn(|column| values[column][row]);
            demonstrations.entry(*episode).or_default().push(frame);
        }
    }
    Ok(demonstrations)
}

/// Push-T's plane. The walls' inner edges are where gym-pusht draws them, 5 px inside.
fn world() -> World {
    World {
        side: 512.0,
        wall: 5.0,
        goal: [re4_sim::GOAL.x, re4_sim::GOAL.y, re4_sim::GOAL.theta],
        outline: block_outline(),
        pusher_radius: re4_sim::AGENT_RADIUS,
        success_coverage: re4_sim::SUCCESS_COVERAGE,
    }
}

/// Corners of Push-T's block in its own frame, in order.
pub(super) fn block_outline() -> Vec<[f64; 2]> {
    let [bar, stem] = re4_sim::tee_rectangles();
    let corners = [bar[0], bar[1], bar[2], stem[1], stem[2], stem[3], stem[0], bar[3]];
    corners.iter().map(|corner| [corner.x, corner.y]).collect()
}
