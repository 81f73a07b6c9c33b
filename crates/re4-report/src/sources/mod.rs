//! Reads artifacts and converts them to the content of pages, videos and images.

pub(crate) mod arm;
pub(crate) mod audit;
pub(crate) mod comparison;
pub(crate) mod findings;
pub(crate) mod influence;
pub(crate) mod plane;
pub(crate) mod report;
pub(crate) mod space;
pub(crate) mod training;

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use anyhow::{Context as _, Result, anyhow, ensure};
use re4_artifact::{Artifact, Key, MANIFEST_NAME, Row, Stage, fetch};
use re4_policy::kinds::Kinds;
use re4_rollout::SpaceResultRow;
use serde::de::DeserializeOwned;
use serde_json::Value;

use crate::html::rollouts::{Decided, Demonstration, Rollout, Rollouts, Scene};

/// Reads the value `name` from `values`, the object at `place` in the artifact's manifest.
///
/// # Errors
/// If the value is missing or has another type.
pub fn stated<T: DeserializeOwned>(artifact: &Artifact, place: &str, values: &Value, name: &str) -> Result<T> {
    serde_json::from_value(values[name].clone()).map_err(|_| {
        anyhow!(
            "cannot report on {}: its manifest has no valid {place}.{name}; run the rollout again",
            artifact.path().display()
        )
    })
}

/// Whether an artifact contains rollouts of a robosuite task.
pub fn is_spatial(artifact: &Artifact) -> bool {
    let domain = || artifact.table_named(SpaceResultRow::NAME).ok()?.domain();
    artifact.manifest().tables.contains_key(SpaceResultRow::FORMERLY) || domain().as_deref() == Some("space")
}

/// Finds an artifact that another one was made from, in the folder of artifacts that contains the latter, or in `store`. `None`
/// if it is in neither.
///
/// # Errors
/// If the manifest does not name the input, or if the artifact that was found is another one or damaged.
pub fn find_input(made: &Artifact, stage: Stage, store: &Path) -> Result<Option<Artifact>> {
    let key = input_key(made, stage)?;
    // An artifact is at ROOT/STAGE/KEY, so its second ancestor is the folder of artifacts.
    let own_root = std::fs::canonicalize(made.path())
        .ok()
        .and_then(|path| path.ancestors().nth(2).map(Path::to_path_buf));
    for root in own_root.into_iter().chain([store.to_path_buf()]) {
        fetch(&root, stage, key)?;
        let folder = root.join(stage.artifact()).join(key.short());
        if !folder.join(MANIFEST_NAME).exists() {
            continue;
        }
        let input = Artifact::open(&folder)?;
        ensure!(
            input.key() == key,
            "cannot read {}: it is the {} artifact {}, but {} was made from {key}; move the folder away and run the pipeline again",
            folder.display(),
            stage.artifact(),
            input.key(),
            made.path().display()
        );
        input.verify_bytes()?;
        return Ok(Some(input));
    }
    Ok(None)
}

fn input_key(made: &Artifact, stage: Stage) -> Result<&Key> {
    made.manifest().inputs.get(stage.artifact()).with_context(|| {
        format!(
            "cannot read {}: its manifest names no {} artifact; delete it and run the pipeline again",
            made.path().display(),
            stage.artifact()
        )
    })
}

/// A scene whose page is made from artifacts.
pub(crate) trait Source: Scene {
    /// Reads the scene from the manifest of an artifact. `index` is the index that its demonstrations were retrieved from, if it
    /// was found.
    fn stated(artifact: &Artifact, index: Option<&Artifact>) -> Result<Self>;
}

/// Reads a `rollouts` artifact.
fn rollouts<S: Source>(artifact: &Artifact, index: Option<&Artifact>) -> Result<Rollouts<S>> {
    let manifest = artifact.manifest();
    let config = &manifest.config;
    let mut settings = config["policy"].clone();
    // Older versions have the name of the preset outside of the settings.
    let preset: String = match settings.as_object_mut().and_then(|settings| settings.remove("kind")) {
        Some(Value::String(kind)) => kind,
        _ => stated(artifact, "config", config, "preset")?,
    };
    let mut defaults = serde_json::to_value(S::Policies::defaults(&preset))?;
    if let Some(defaults) = defaults.as_object_mut() {
        defaults.remove("kind");
    }
    Ok(Rollouts {
        key: artifact.key().to_string(),
        index_key: input_key(artifact, Stage::Index)?.to_string(),
        altered: defaults != settings,
        preset,
        variant: stated(artifact, "config", config, "variant")?,
        max_steps: stated(artifact, "config", config, "max_steps")?,
        protocol: manifest.summary["protocol"].clone(),
        settings,
        scene: S::stated(artifact, index)?,
        rollouts: traces(artifact)?,
    })
}

/// Reads the rollouts of an artifact, each with its steps and decisions, in the order of table `results`.
fn traces<S: Scene>(artifact: &Artifact) -> Result<Vec<Rollout<S>>> {
    let results: Vec<S::Result> = artifact.read()?;
    let mut steps = artifact.read::<S::Step>()?.into_iter();
    let cores: Vec<S::Decision> = artifact.read()?;
    let details: Vec<Option<S::Detail>> = if artifact.has::<S::Detail>() {
        artifact.read()?.into_iter().map(Some).collect()
    } else {
        vec![None; cores.len()]
    };
    let mut decisions = cores
        .into_iter()
        .zip(details)
        .map(|(core, detail)| Decided { core, detail });
    let worlds: Vec<Option<S::World>> = if artifact.has::<S::World>() {
        artifact.read()?.into_iter().map(Some).collect()
    } else {
        vec![None; results.len()]
    };
    ensure!(
        worlds.len() == results.len(),
        "cannot report on {}: table worlds has {} rows, table results has {}; run the rollout again",
        artifact.path().display(),
        worlds.len(),
        results.len()
    );
    let traces = results.into_iter().zip(worlds).map(|(result, world)| {
        let &core = S::result(&result);
        let (seed, name) = (core.seed, S::Step::NAME);
        let steps = of_seed(artifact, name, &mut steps, seed, core.steps, |step| S::step(step).seed)?;
        let name = S::Decision::NAME;
        let decisions = of_seed(artifact, name, &mut decisions, seed, core.decisions, |d| d.core().seed)?;
        Ok(Rollout {
            result,
            shown: true,
            steps,
            decisions,
            world,
        })
    });
    traces.collect()
}

/// Takes the rows of one seed from a table whose rows are in the order of table `results`.
fn of_seed<R>(
    artifact: &Artifact,
    table: &str,
    rows: &mut impl Iterator<Item = R>,
    seed: u32,
    count: u32,
    seed_of: fn(&R) -> u32,
) -> Result<Vec<R>> {
    let found: Vec<R> = rows.take(count as usize).collect();
    ensure!(
        found.len() == count as usize && found.iter().all(|row| seed_of(row) == seed),
        "cannot report on {}: table {table} does not have the {count} rows of seed {seed} that table results states; run the rollout again",
        artifact.path().display()
    );
    Ok(found)
}

/// Returns the rollout of a seed. `what` is the operation that error messages name.
fn trace_of<'a, S: Scene>(
    artifact: &Artifact,
    traces: &'a [Rollout<S>],
    seed: u32,
    what: &str,
) -> Result<&'a Rollout<S>> {
    let found = traces.iter().find(|trace| trace.core().seed == seed);
    found.with_context(|| {
        format!(
            "cannot {what} seed {seed}: the artifact {} has no rollout of that seed; give one of its seeds",
            artifact.path().display()
        )
    })
}

/// Reads the frames of the demonstrations of this index that the viewer's rollouts refer to.
fn demonstrations<S: Scene>(index: &Artifact, sets: &[Rollouts<S>]) -> Result<BTreeMap<u32, Demonstration>> {
    let key = index.key().to_string();
    let needed: BTreeSet<u32> = sets
        .iter()
        .filter(|set| set.index_key == key)
        .flat_map(|set| set.shown().flat_map(|rollout| &rollout.decisions))
        .filter_map(|decision| decision.core().demo)
        .collect();
    let mut demonstrations: BTreeMap<u32, Demonstration> = BTreeMap::new();
    for frame in index.table(S::Frame::table())?.stream::<S::Frame>()? {
        let (demo, frame, numbers) = S::frame(&frame?);
        if needed.contains(&demo) {
            let frames = demonstrations.entry(demo).or_default();
            // Decisions count the frames of the recording. In place of frames that `index.trim` cut, the frame after them is shown.
            frames.resize(frames.len().max(frame as usize), numbers.clone());
            frames.push(numbers);
        }
    }
    Ok(demonstrations)
}

/// Rewrites half-open ranges of seeds as inclusive ones, which readers of a page expect: `500..600` becomes 500–599.
fn inclusive(seeds: &str) -> String {
    let part = |part: &str| {
        let (start, end) = part.split_once("..")?;
        let last = end.trim().parse::<u64>().ok()?.checked_sub(1)?;
        Some(format!("{}–{last}", start.trim()))
    };
    let parts = seeds.split(',').map(str::trim);
    parts
        .map(|text| part(text).unwrap_or_else(|| text.to_owned()))
        .collect::<Vec<_>>()
        .join(", ")
}
