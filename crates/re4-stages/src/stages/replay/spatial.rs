//! The stage `replay` for robosuite tasks.

use anyhow::{Context as _, Result};
use rayon::prelude::*;
use re4_artifact::{Artifact, ArtifactSummary, ByEpisode, Recipe, Stage};
use re4_episode::SpatialEpisode;
use re4_fault::{ensure, fault};
use re4_ingest::{Convention, EpisodeRow, StateRow};
use re4_sim::Simulator as _;
use re4_sim::robosuite::{
    ArmAction, Fidelity, FirstTorques, Robosuite, RobosuiteAction, RobosuiteScene, RobosuiteStep,
};
use re4_stats::{spread, wilson_interval};
use re4_task::RobosuiteTask;
use serde_json::{Value, json};

use super::tables::{DivergenceRow, ReplayRow, SpatialDivergence, SpatialReplay};
use crate::inputs::demos::SpatialEpisodes;
use crate::inputs::simulators::{Scenes, profile};
use crate::runner::{Built, Runner};

/// Increase it whenever the same input gives different bytes.
const CODE_VERSION: u32 = 4;

/// Number of demonstrations that are replayed before their rows are written.
const BATCH: usize = 32;

/// The kind of actions that a replay executes.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Kind {
    Delta,
    Absolute,
}

impl Kind {
    const ALL: [Self; 2] = [Self::Delta, Self::Absolute];

    fn as_str(self) -> &'static str {
        match self {
            Self::Delta => "delta",
            Self::Absolute => "absolute",
        }
    }
}

/// A demonstration with its recorded simulator states.
struct Recording {
    number: u32,
    episode: SpatialEpisode,
    states: Vec<Vec<f64>>,
}

/// Distances between the replay and the recording before an action: object position (m), object orientation (rad), grip site
/// position (m), and the largest difference of a joint position (rad).
#[derive(Clone, Copy)]
struct Distance {
    object: f64,
    object_rotation: f64,
    eef: f64,
    arm: f64,
}

struct Replay {
    number: u32,
    name: String,
    kind: Kind,
    success: Vec<bool>,
    distances: Vec<Distance>,
}

impl Runner {
    /// Makes the `replays` artifact of a robosuite task, or returns the existing one. Each demonstration is replayed twice, with
    /// its delta and with its absolute actions.
    ///
    /// # Errors
    /// If an input cannot be read, a setting does not fit the input, or the run is interrupted.
    pub fn replay_spatial(&self, episodes: &Built) -> Result<Built> {
        let task = self
            .pipeline
            .task
            .robosuite()
            .with_context(|| format!("cannot replay: {}", RobosuiteTask::known()))?;
        ensure!(
            episodes.artifact.has::<StateRow>(),
            "cannot replay {}: the demonstrations have no recorded states to start from",
            episodes.artifact.path().display();
            "ingest a file with the datasets /data/demo_*/states"
        );
        let profile = profile(&episodes.artifact)?;
        let recipe = Recipe::new(Stage::Replay, CODE_VERSION)
            .config(&json!({ "task": self.pipeline.task, "robosuite": profile, "kinds": ["delta", "absolute"] }))?
            .input("episodes", episodes.artifact.key());
        self.build(&recipe, |writer| {
            let recorded = recorded_kind(&episodes.artifact)?;
            let listing = episodes.artifact.read::<EpisodeRow>()?.into_iter();
            let numbers: Vec<Option<u32>> = listing.map(|row| row.source_episode).collect();
            let scenes = Scenes::open(&episodes.artifact, task, Fidelity::Robosuite)?;
            let mut recordings = Recordings::open(&episodes.artifact)?;
            let bar = self.notes.progress(2 * recordings.demos as u64, "replays");
            let mut replays = writer.rows()?;
            let mut divergence = writer.rows()?;
            let mut summaries = [Summary::default(), Summary::default()];
            loop {
                self.interrupt.check("replay")?;
                let batch = recordings.by_ref().take(BATCH).collect::<Result<Vec<_>>>()?;
                if batch.is_empty() {
                    break;
                }
                let played: Vec<Replay> = batch
                    .par_iter()
                    .with_max_len(1)
                    .flat_map_iter(|recording| Kind::ALL.map(|kind| (recording, kind)))
                    .map(|(recording, kind)| {
                        let replay = play(&scenes, recording, kind).with_context(|| {
                            format!(
                                "cannot replay {} (a filter key or ingest.select can leave it out)",
                                recording.episode.name
                            )
                        });
                        bar.inc(1);
                        replay
                    })
                    .collect::<Vec<_>>()
                    .into_iter()
                    .collect::<Result<_>>()?;
                for replay in &played {
                    summaries[usize::from(replay.kind == Kind::Absolute)].add(replay);
                }
                for replay in &played {
                    let number = numbers.get(replay.number as usize).copied().flatten();
                    replays.push(&replay.row(&recorded, number))?;
                    divergence.extend(replay.divergence())?;
                }
            }
            bar.finish_and_clear();
            replays.finish()?;
            divergence.finish()?;
            let [delta, absolute] = summaries;
            Ok(ArtifactSummary {
                summary: json!({
                    "replays": delta.replays + absolute.replays,
                    "successes": delta.successes + absolute.successes,
                    "recorded_actions": recorded,
                    "delta": delta.to_json(),
                    "absolute": absolute.to_json(),
                    "physics": format!("MuJoCo {}", scenes.profile().mujoco()),
                    "robosuite": scenes.profile(),
                }),
                warnings: Vec::new(),
            })
        })
    }
}

/// The kind of actions in the dataset, from table `conventions`; empty if it is not listed there.
fn recorded_kind(episodes: &Artifact) -> Result<String> {
    let mut rows = episodes.read::<Convention>()?.into_iter();
    let row = rows.find(|row| row.convention == "action_kind");
    Ok(row.map_or_else(String::new, |row| row.value.to_string()))
}

/// Iterates over demonstrations with their recorded states.
struct Recordings {
    episodes: SpatialEpisodes,
    states: ByEpisode<StateRow>,
    demos: usize,
}

impl Recordings {
    fn open(artifact: &Artifact) -> Result<Self> {
        let episodes = SpatialEpisodes::open(artifact)?;
        Ok(Self {
            demos: episodes.demos(),
            episodes,
            states: ByEpisode::open(artifact, |row: &StateRow| row.episode)?,
        })
    }
}

impl Iterator for Recordings {
    type Item = Result<Recording>;

    fn next(&mut self) -> Option<Self::Item> {
        let episode = self.episodes.next()?;
        Some(episode.and_then(|(number, episode)| {
            let name = episode.name.clone();
            let missing = || {
                fault!(
                    "table states does not match the frames of {name}";
                    "delete the episodes artifact and ingest again"
                )
            };
            let (of, rows) = self.states.next().with_context(missing)??;
            let states: Vec<Vec<f64>> = rows.into_iter().map(|row| row.state).collect();
            ensure!(of == number && states.len() == episode.frames.len(), "{}", missing());
            Ok(Recording {
                number,
                episode,
                states,
            })
        }))
    }
}

fn play(scenes: &Scenes, recording: &Recording, kind: Kind) -> Result<Replay> {
    let model = scenes.of(recording.number)?;
    let mut simulator = Robosuite::new(&model)?;
    let mut success = Vec::with_capacity(recording.states.len());
    let mut distances = Vec::with_capacity(recording.states.len());
    let Some(first) = recording.states.first() else {
        return Ok(Replay {
            number: recording.number,
            name: recording.episode.name.clone(),
            kind,
            success,
            distances,
        });
    };
    simulator.reset(&RobosuiteScene::Recorded(first.clone()), FirstTorques::AsRobosuite)?;
    // Observations after a step are one simulation step (2 ms) old. Resetting a second simulator to the present state gives poses
    // of the state itself, as the recorded ones are.
    let mut mirror = Robosuite::new(&model)?;
    for (frame, state) in recording.episode.frames.iter().zip(&recording.states) {
        let now = simulator.state();
        ensure!(
            now.len() == state.len(),
            "recorded state {} has {} numbers, but the model needs {}",
            success.len(),
            state.len(),
            now.len()
        );
        let observed = mirror.reset(&RobosuiteScene::Recorded(now.clone()), FirstTorques::AsRobosuite)?;
        distances.push(Distance {
            object: (observed.object.translation.vector - frame.object.translation.vector).norm(),
            object_rotation: observed.object.rotation.angle_to(&frame.object.rotation),
            eef: (observed.grip_site.translation.vector - frame.eef.translation.vector).norm(),
            arm: arm_distance(&now, state),
        });
        let arm = match kind {
            Kind::Delta => ArmAction::Delta(frame.delta),
            Kind::Absolute => ArmAction::Absolute(frame.goal),
        };
        let action = RobosuiteAction {
            arm,
            gripper: frame.gripper,
        };
        let RobosuiteStep { success: done, .. } = simulator.step(&action)?;
        success.push(done);
    }
    Ok(Replay {
        number: recording.number,
        name: recording.episode.name.clone(),
        kind,
        success,
        distances,
    })
}

/// The largest difference of the arm's joint positions between two states, in rad. A state is the time, the coordinates and the
/// velocities; the arm's 7 joints are the first coordinates of robosuite's models.
fn arm_distance(a: &[f64], b: &[f64]) -> f64 {
    a.iter()
        .zip(b)
        .skip(1)
        .take(7)
        .map(|(a, b)| (a - b).abs())
        .fold(0.0, f64::max)
}

impl Replay {
    fn succeeded(&self) -> bool {
        self.success.iter().any(|done| *done)
    }

    fn largest(&self, value: fn(&Distance) -> f64) -> f64 {
        self.distances.iter().map(value).fold(0.0, f64::max)
    }

    fn row(&self, recorded: &str, source_episode: Option<u32>) -> ReplayRow<SpatialReplay> {
        let actions = self.kind.as_str();
        let origin = if actions == recorded { "recorded" } else { "converted" };
        ReplayRow {
            episode: self.number,
            source_episode,
            frames: self.success.len(),
            replay: SpatialReplay {
                actions: actions.into(),
                origin: origin.into(),
                success: self.succeeded(),
                first_success: self.success.iter().position(|done| *done),
                success_at_end: self.success.last() == Some(&true),
                object_max: self.largest(|d| d.object),
                object_final: self.distances.last().map_or(0.0, |d| d.object),
                object_rotation_max: self.largest(|d| d.object_rotation),
                eef_max: self.largest(|d| d.eef),
                arm_max: self.largest(|d| d.arm),
            },
            demo_name: Some(self.name.clone()),
        }
    }

    fn divergence(&self) -> impl Iterator<Item = DivergenceRow<SpatialDivergence>> {
        (0..).zip(&self.distances).map(|(frame, distance)| DivergenceRow {
            episode: self.number,
            frame,
            distance: SpatialDivergence {
                actions: self.kind.as_str().into(),
                object: distance.object,
                object_rotation: distance.object_rotation,
                eef: distance.eef,
            },
        })
    }
}

/// Statistics of the replays of one kind.
#[derive(Default)]
struct Summary {
    replays: u64,
    successes: u64,
    object: Vec<f64>,
    failed: Vec<String>,
}

impl Summary {
    fn add(&mut self, replay: &Replay) {
        self.replays += 1;
        self.successes += u64::from(replay.succeeded());
        self.object.push(replay.largest(|d| d.object));
        if !replay.succeeded() {
            self.failed.push(replay.name.clone());
        }
    }

    fn to_json(&self) -> Value {
        json!({
            "replays": self.replays,
            "successes": self.successes,
            "success_rate": wilson_interval(self.successes, self.replays),
            "failed_demonstrations": self.failed,
            "object_max_m": spread(self.object.iter().copied(), &[0.5, 0.9, 0.99, 1.0]),
        })
    }
}
