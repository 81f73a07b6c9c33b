//! The page of `rollouts` artifacts.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

use anyhow::{Result, bail, ensure};
use re4_artifact::{Artifact, Stage};

use super::{Source, demonstrations, find_input, is_spatial, rollouts};
use crate::html::rollouts::plane::Plane;
use crate::html::rollouts::space::Space;
use crate::html::rollouts::{Report, Rollouts, Scene, page};

/// A page of more bytes than this opens slowly, so that the user gets a warning.
pub const LARGE_PAGE: usize = 12_000_000;

/// A page and its contents.
#[derive(Debug)]
pub struct ReportPage {
    /// The page.
    pub html: String,
    /// Number of rollouts in its viewer.
    pub rollouts: usize,
    /// Number of demonstrations that these refer to and whose frames the page contains.
    pub demonstrations: usize,
    /// Warnings for the user.
    pub warnings: Vec<String>,
}

/// Adds images of decisions to rollouts of robosuite's tasks. Returns a warning if this is impossible and the user did not ask
/// for images.
pub type AddImages<'a> = dyn FnMut(&Artifact, &mut Rollouts<Space>) -> Result<Option<String>> + 'a;

/// Opens and verifies `rollouts` artifacts.
///
/// # Errors
/// If one cannot be opened, is damaged, is of another kind, or is named twice.
pub fn open_rollouts(paths: &[PathBuf]) -> Result<Vec<Artifact>> {
    let mut artifacts: Vec<Artifact> = Vec::new();
    for path in paths {
        let artifact = Artifact::open(path)?;
        let kind = &artifact.manifest().artifact;
        ensure!(
            *kind == Stage::Rollout.artifact(),
            "cannot report on {}: it is an artifact of kind {kind}, but a report needs rollouts, or one poses artifact alone; name a folder below {}",
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

/// Makes the page of artifacts. Its viewer has the rollouts of `seeds`, or all rollouts. Index artifacts are searched in the
/// folders that contain the rollouts, and in `store`. `images` is the number of rollouts for which the user asked for images of
/// decisions; `add` adds these.
///
/// # Errors
/// If some rollouts are of Push-T and some of robosuite's tasks, if no artifact has a rollout of one of the seeds, or if tables
/// cannot be read.
pub fn report_page(
    artifacts: &[Artifact],
    seeds: Option<&[u32]>,
    store: &Path,
    images: Option<usize>,
    add: &mut AddImages<'_>,
) -> Result<ReportPage> {
    let planar = artifacts.iter().find(|artifact| !is_spatial(artifact));
    let spatial = artifacts.iter().find(|artifact| is_spatial(artifact));
    let mut made = match (planar, spatial) {
        (Some(planar), Some(spatial)) => bail!(
            "cannot report on rollouts of Push-T and of robosuite's tasks in one page: {} has rollouts of Push-T, {} of a robosuite task; make one page of each",
            planar.path().display(),
            spatial.path().display()
        ),
        (None, Some(_)) => make(artifacts, seeds, store, add)?,
        (Some(planar), None) => {
            ensure!(
                images.unwrap_or(0) == 0,
                "cannot show images of {}: it has rollouts of Push-T, which the page renders itself; leave --images out",
                planar.path().display()
            );
            make(artifacts, seeds, store, &mut |_, _: &mut Rollouts<Plane>| Ok(None))?
        }
        (None, None) => bail!("cannot make a report without artifacts; name a rollouts artifact"),
    };
    if made.html.len() > LARGE_PAGE {
        made.warnings.push(format!(
            "the page has {} MB and may open slowly; re4-pipe report --seeds limits the rollouts in its viewer",
            made.html.len() / 1_000_000
        ));
    }
    Ok(made)
}

/// Adds data that is not in the artifact to a set of rollouts. Returns a warning if this is impossible.
type Add<'a, S> = &'a mut dyn FnMut(&Artifact, &mut Rollouts<S>) -> Result<Option<String>>;

fn make<S: Source>(artifacts: &[Artifact], seeds: Option<&[u32]>, store: &Path, add: Add<'_, S>) -> Result<ReportPage> {
    let mut indices = Vec::new();
    let mut sets = Vec::new();
    for artifact in artifacts {
        let index = find_input(artifact, Stage::Index, store)?;
        sets.push(rollouts::<S>(artifact, index.as_ref())?);
        indices.push(index);
    }
    if let Some(seeds) = seeds {
        show_only(&mut sets, seeds)?;
    }
    let mut warnings = Vec::new();
    for (artifact, set) in artifacts.iter().zip(&mut sets) {
        warnings.extend(add(artifact, set)?);
    }
    let mut known = BTreeMap::new();
    for ((artifact, index), set) in artifacts.iter().zip(&indices).zip(&sets) {
        match index {
            _ if known.contains_key(&set.index_key) => {}
            Some(index) => {
                known.insert(set.index_key.clone(), demonstrations(index, &sets)?);
            }
            None => warnings.push(format!(
                "the page shows no recorded frames for {}: its index artifact index/{} is neither next to it nor in {}",
                artifact.path().display(),
                set.index_key.get(..16).unwrap_or(&set.index_key),
                store.display()
            )),
        }
    }
    Ok(ReportPage {
        rollouts: sets.iter().map(|set| set.shown().count()).sum(),
        demonstrations: known.values().map(BTreeMap::len).sum(),
        warnings,
        html: page(&Report {
            tool_version: env!("CARGO_PKG_VERSION").to_owned(),
            artifacts: sets,
            demonstrations: known,
        }),
    })
}

/// Limits the viewer to the rollouts of these seeds. The scores still count all rollouts.
fn show_only<S: Scene>(sets: &mut [Rollouts<S>], seeds: &[u32]) -> Result<()> {
    let wanted: BTreeSet<u32> = seeds.iter().copied().collect();
    let mut found = BTreeSet::new();
    for rollout in sets.iter_mut().flat_map(|set| &mut set.rollouts) {
        let seed = rollout.core().seed;
        rollout.shown = wanted.contains(&seed);
        if rollout.shown {
            found.insert(seed);
        }
    }
    if let Some(seed) = wanted.difference(&found).next() {
        bail!("cannot show seed {seed}: none of the artifacts has a rollout of that seed; give seeds that they have");
    }
    Ok(())
}
