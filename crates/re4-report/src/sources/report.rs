//! The page over `rollouts` artifacts.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

use anyhow::{Result, bail, ensure};
use re4_artifact::{Artifact, Stage};

use super::{Source, demonstrations, find_input, is_spatial, rollouts};
use crate::html::rollouts::plane::Plane;
use crate::html::rollouts::space::Space;
use crate::html::rollouts::{Report, Rollouts, Scene, page};

/// A page beyond this many bytes takes a while to open, which is said.
pub const LARGE_PAGE: usize = 12_000_000;

/// A page, and what it holds.
#[derive(Debug)]
pub struct ReportPage {
    /// The page.
    pub html: String,
    /// Rollouts in its viewer.
    pub rollouts: usize,
    /// Demonstrations that these refer to and whose frames it has.
    pub demonstrations: usize,
    /// What the user should know.
    pub warnings: Vec<String>,
}

/// Adds images of decisions to rollouts in space; what keeps it from that, where nobody asked for them.
pub type AddImages<'a> = dyn FnMut(&Artifact, &mut Rollouts<Space>) -> Result<Option<String>> + 'a;

/// Opens and verifies artifacts; each is named once, and each holds rollouts.
///
/// # Errors
/// When one cannot be opened, is damaged, is of another kind, or is there twice.
pub fn open_rollouts(paths: &[PathBuf]) -> Result<Vec<Artifact>> {
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

/// Makes the page of artifacts. Its viewer holds the rollouts of `seeds`, or all. Indices are looked for beside the artifacts and
/// in `store`. `images` says in how many rollouts images of decisions were asked for, and `add` adds those.
///
/// # Errors
/// When some are in the plane and some in space, when none has a seed, or when tables cannot be read.
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
            "cannot report on Push-T's rollouts and robosuite's in one page: {} holds Push-T's, {} robosuite's; make a page of each",
            planar.path().display(),
            spatial.path().display()
        ),
        (None, Some(_)) => make(artifacts, seeds, store, add)?,
        (Some(planar), None) => {
            ensure!(
                images.unwrap_or(0) == 0,
                "cannot show images of {}: its rollouts are Push-T's, which the page draws itself; leave --images out",
                planar.path().display()
            );
            make(artifacts, seeds, store, &mut |_, _: &mut Rollouts<Plane>| Ok(None))?
        }
        (None, None) => bail!("cannot make a report of nothing; name a rollouts artifact"),
    };
    if made.html.len() > LARGE_PAGE {
        made.warnings.push(format!(
            "the page is {} MB large; re4-pipe report --seeds limits the rollouts that the viewer holds",
            made.html.len() / 1_000_000
        ));
    }
    Ok(made)
}

/// Adds to a set of rollouts what its artifact does not hold, or says why it cannot.
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
                "the page shows no recorded frames for {}: its index artifact index/{} is neither beside it nor in {}",
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

/// Keeps the traces of these seeds only; figures count all.
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
        bail!("cannot show seed {seed}: none of the artifacts has a rollout of it; give seeds that they have");
    }
    Ok(())
}
