//! The artifacts that are exported, and the choice of episodes.

use std::collections::BTreeSet;
use std::path::Path;

use anyhow::Result;
use re4_artifact::{Artifact, ByEpisode, Row, Stage};
use re4_episode::{Mode, episode_name};
use re4_fault::{bail, ensure, fault};
use re4_influence::CuratedRow;
use re4_ingest::{ArmColumns, DemoRow, EpisodeRow, FrameRow, SpatialColumns};
use re4_rollout::SpaceResultRow;
use re4_segment::{Evidence, ModeRow, SpatialEvidence};
use re4_task::Task;
use serde_json::{Map, Value, json};

use crate::take::ModeOfFrame;
use crate::{Format, Request};

/// Kinds of artifacts that have episodes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Kind {
    Episodes,
    Rollouts,
}

/// Opened and verified artifacts.
pub(crate) struct Inputs {
    pub(crate) kind: Kind,
    pub(crate) artifact: Artifact,
    pub(crate) modes: Option<Artifact>,
    pub(crate) poses: Option<Artifact>,
    pub(crate) task: Task,
    /// Names of the chosen demonstrations or rollouts; `None` for all.
    keep: Option<BTreeSet<String>>,
    /// Whether rollouts that failed are left out.
    successes: bool,
}

impl Inputs {
    /// Opens the artifacts of a request.
    pub(crate) fn open(request: &Request<'_>) -> Result<Self> {
        let artifact = Artifact::open(request.artifact)?;
        let kind = match artifact.manifest().artifact.as_str() {
            kind if kind == Stage::Ingest.artifact() => Kind::Episodes,
            kind if kind == Stage::Rollout.artifact() => Kind::Rollouts,
            kind => bail!(
                "cannot export {}: it is an artifact of kind {kind}, not episodes or rollouts", request.artifact.display();
                "give the folder of the demonstrations or of the rollouts"
            ),
        };
        let of_task = serde_json::from_value(artifact.manifest().config["task"].clone());
        let Ok(task) = of_task else {
            bail!(
                "cannot export {}: its manifest names no known task", request.artifact.display();
                "make the artifact again with this version of re4-pipe"
            );
        };
        let demonstrations = kind == Kind::Episodes;
        ensure!(
            demonstrations || (request.modes.is_none() && request.poses.is_none()),
            "modes and poses are those of demonstrations, but {} has rollouts", request.artifact.display();
            "leave --modes and --poses out"
        );
        ensure!(
            !demonstrations || !request.successes,
            "only rollouts have a success, but {} has demonstrations", request.artifact.display();
            "leave --successes out"
        );
        artifact.verify_bytes()?;
        let of_same = |path: Option<&Path>, stage| path.map(|path| of_same(path, stage, &artifact)).transpose();
        let (modes, poses) = (
            of_same(request.modes, Stage::Segment)?,
            of_same(request.poses, Stage::TrainPose)?,
        );
        let mut inputs = Self {
            kind,
            modes,
            poses,
            task,
            keep: None,
            successes: request.successes,
            artifact,
        };
        if let Some(path) = request.keep {
            inputs.keep = Some(inputs.chosen(path)?);
        }
        Ok(inputs)
    }

    /// Whether the frames are planar.
    ///
    /// # Errors
    /// If the artifact cannot be read, or its demonstrations are of the task `arm`, which no format is written for.
    pub(crate) fn planar(&self) -> Result<bool> {
        let (name, domain) = match self.kind {
            Kind::Episodes => (
                FrameRow::<SpatialColumns>::NAME,
                FrameRow::<SpatialColumns>::table().domain,
            ),
            Kind::Rollouts => (SpaceResultRow::NAME, SpaceResultRow::table().domain),
        };
        let found = self.artifact.table_named(name)?.domain();
        ensure!(
            found.as_deref() != Some(FrameRow::<ArmColumns>::table().domain),
            "cannot export {}: its demonstrations are of the task \"arm\", for which there is no export", self.artifact.path().display();
            "ingest the dataset with the task of its environment"
        );
        Ok(found.as_deref() != Some(domain))
    }

    /// Names of the demonstrations, by their number in the artifact.
    pub(crate) fn demo_names(&self) -> Result<Vec<String>> {
        if self.artifact.has::<DemoRow>() {
            return Ok(self
                .artifact
                .read::<DemoRow>()?
                .into_iter()
                .map(|row| row.demo)
                .collect());
        }
        let rows = self.artifact.read::<EpisodeRow>()?.into_iter();
        Ok(rows
            .map(|row| episode_name(row.source_episode.unwrap_or(row.episode)))
            .collect())
    }

    /// Whether an episode is exported. `success` is that of a rollout.
    pub(crate) fn keeps(&self, name: &str, success: Option<bool>) -> bool {
        let listed = self.keep.as_ref().is_none_or(|keep| keep.contains(name));
        listed && !(self.successes && success == Some(false))
    }

    /// Reads the names to keep, and checks that they exist.
    fn chosen(&self, path: &Path) -> Result<BTreeSet<String>> {
        let names: BTreeSet<String> = if path.is_dir() {
            let curation = Artifact::open(path)?;
            ensure!(
                curation.manifest().artifact == Stage::Curate.artifact(),
                "cannot choose demonstrations by {}: it is an artifact of kind {}, not curation",
                path.display(), curation.manifest().artifact;
                "give a keep-list or the folder of a curation"
            );
            curation.verify_bytes()?;
            let rows = curation.read::<CuratedRow>()?.into_iter();
            rows.filter(|row| row.kept).map(|row| row.demo_name).collect()
        } else {
            let text = std::fs::read_to_string(path).map_err(|error| {
                fault!("cannot read the keep-list {}: {error}", path.display(); "give a text file with one name per line")
            })?;
            let lines = text.lines().map(str::trim);
            lines
                .filter(|line| !line.is_empty() && !line.starts_with('#'))
                .map(str::to_owned)
                .collect()
        };
        let there: BTreeSet<String> = match self.kind {
            Kind::Episodes => self.demo_names()?.into_iter().collect(),
            Kind::Rollouts => crate::plane::seeds(&self.artifact)?
                .into_iter()
                .map(crate::take::seed_name)
                .collect(),
        };
        let unknown: Vec<&str> = names.difference(&there).map(String::as_str).collect();
        if let Some(first) = unknown.first() {
            let example = there.first().map_or("", String::as_str);
            bail!(
                "the keep-list {} names {first:?}, which {} does not contain (and {} more)",
                path.display(), self.artifact.path().display(), unknown.len() - 1;
                "use the names of its demonstrations, such as {example:?}"
            );
        }
        ensure!(
            !names.is_empty(),
            "the keep-list {} keeps no demonstration", path.display();
            "name at least one"
        );
        Ok(names)
    }

    /// Provenance, for the output.
    pub(crate) fn about(&self, request: &Request<'_>) -> Map<String, Value> {
        let manifest = self.artifact.manifest();
        let mut about = Map::new();
        let mut add = |key: &str, value: Value| about.insert(key.to_owned(), value);
        add("program", json!(request.program));
        add("artifact", json!(manifest.artifact));
        add("key", json!(manifest.key));
        add("task", json!(self.task.name()));
        if let Some(source) = &manifest.source_blake3 {
            add("source_blake3", json!(source));
        }
        for (name, artifact) in [("modes_key", &self.modes), ("poses_key", &self.poses)] {
            if let Some(artifact) = artifact {
                add(name, json!(artifact.key()));
            }
        }
        if let Some(keep) = &self.keep {
            add("kept", json!(keep));
        }
        if self.successes {
            add("successes_only", json!(true));
        }
        if let Some(policy) = manifest.config.get("policy") {
            add("policy", policy.clone());
        }
        about
    }

    /// The modes of the frames, one demonstration at a time.
    pub(crate) fn modes(&self, planar: bool) -> Result<Option<Modes>> {
        let open = |modes: &Artifact| {
            let spec = if planar {
                ModeRow::<Evidence>::table()
            } else {
                ModeRow::<SpatialEvidence>::table()
            };
            let rows = ByEpisode::of(&modes.table(spec)?, |row: &ModeOfFrame| row.episode)?;
            Ok(Modes { rows })
        };
        self.modes.as_ref().map(open).transpose()
    }

    /// The estimated poses, one demonstration at a time. `episode` returns the demonstration of a row.
    pub(crate) fn poses<R: Row>(&self, episode: fn(&R) -> u32) -> Result<Option<ByEpisode<R>>> {
        let open = |poses: &Artifact| Ok(ByEpisode::open(poses, episode)?);
        self.poses.as_ref().map(open).transpose()
    }

    /// Refuses a format that does not fit the task.
    pub(crate) fn require(&self, format: Format, planar: bool) -> Result<()> {
        if self.planar()? == planar {
            return Ok(());
        }
        let (of, instead) = if planar {
            ("Push-T", "lerobot or robomimic")
        } else {
            ("robosuite's tasks", "lerobot or pusht-zarr")
        };
        bail!(
            "the format {} is that of {of}, but {} is of the task {}",
            format.name(), self.artifact.path().display(), self.task.name();
            "use --format {instead}"
        )
    }
}

/// Opens an artifact that was made from the demonstrations.
fn of_same(path: &Path, stage: Stage, demonstrations: &Artifact) -> Result<Artifact> {
    let artifact = Artifact::open(path)?;
    ensure!(
        artifact.manifest().artifact == stage.artifact(),
        "cannot export {} as {}: it is an artifact of kind {}", path.display(), stage.artifact(),
        artifact.manifest().artifact;
        "give the folder of a {} artifact", stage.artifact()
    );
    let inputs = &artifact.manifest().inputs;
    ensure!(
        inputs.get(Stage::Ingest.artifact()) == Some(demonstrations.key()),
        "{} was not made from the demonstrations {}", path.display(), demonstrations.path().display();
        "give the {} of these demonstrations", stage.artifact()
    );
    artifact.verify_bytes()?;
    Ok(artifact)
}

/// The modes of demonstrations, in their order.
pub(crate) struct Modes {
    rows: ByEpisode<ModeOfFrame>,
}

impl Modes {
    /// The modes of the frames of a demonstration. Demonstrations must be requested in ascending order.
    pub(crate) fn of(&mut self, number: u32, frames: usize) -> Result<Vec<Mode>> {
        matching(&mut self.rows, number, frames, "modes").map(|rows| rows.into_iter().map(|row| row.mode).collect())
    }
}

/// The rows of a demonstration in a table that is sorted by demonstration.
pub(crate) fn matching<C: re4_artifact::Cell>(
    rows: &mut ByEpisode<C>,
    number: u32,
    frames: usize,
    what: &str,
) -> Result<Vec<C>> {
    for found in rows {
        let (of, found) = found?;
        if of == number && found.len() == frames {
            return Ok(found);
        }
        if of >= number {
            break;
        }
    }
    bail!(
        "the table {what} does not have the {frames} frames of demonstration {number}";
        "delete the artifact and run the stage that makes it again"
    )
}
