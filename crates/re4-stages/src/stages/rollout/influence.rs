//! The stage `influence`: makes `influence`, the exact effect of leaving out each demonstration, from what rollouts are made from.

use std::cell::RefCell;
use std::collections::BTreeSet;
use std::sync::Arc;
use std::time::Instant;

use anyhow::Result;
use re4_artifact::{Artifact, ArtifactSummary, Recipe, Stage};
use re4_episode::{PlanarEpisode, SpatialEpisode};
use re4_fault::{bail, ensure};
use re4_influence::{
    Change, Demo, Episode, Evaluation, InfluenceRow, JudgedEpisodeRow, PairRow, Roll, Scenes, Without, episode_rows,
    evaluate, influence_rows, leave_one_out, pair_rows,
};
use re4_policy::kinds::Kinds as _;
use re4_rollout::{ActTimes, Harness, Job, Plane, PlaneScene, PoseNoise, Recorded, Space, Start, Traced};
use re4_sim::robosuite::{Placement, RobosuiteTask};
use re4_sim::{GOAL, ResetOrder, Scene};
use serde_json::{Value, json};

use super::{RolloutArtifacts, RolloutSetup};
use crate::inputs::demos::{SpatialEpisodes, demo_names, is_spatial};
use crate::inputs::episodes::read_episodes;
use crate::parts::parts_of;
use crate::pipeline::Policy;
use crate::runner::{Built, Runner};

/// Increase it whenever the same input gives different bytes.
const CODE_VERSION: u32 = 1;

/// Scenes per part. Each is rolled out once, and once more for every demonstration on which its episode depends: some tens of times.
const SCENES_IN_PART: usize = 128;

/// Standard deviations of the perturbations of start states: translation in px and m, rotation in rad. They are small against the
/// distances between demonstrations, so that a perturbed start is nearest to its own demonstration.
const PLANE_NOISE: [f64; 2] = [3.0, 0.03];
const SPACE_NOISE: [f64; 2] = [0.003, 0.03];

/// What the influence is judged on besides the scenes of the pipeline.
#[derive(Debug, Clone, Copy, Default)]
pub struct Judge {
    /// Number of scenes per demonstration that start from its own first state, perturbed.
    pub starts: u32,
}

/// The influence of demonstrations.
pub struct Influenced {
    /// The `influence` artifact.
    pub built: Built,
    /// The rows of its table `influence`.
    pub rows: Vec<InfluenceRow>,
}

/// The result of a comparison with brute force.
#[derive(Debug, Clone, PartialEq)]
pub struct Checked {
    /// Names of the demonstrations without which every scene was rolled out.
    pub demos: Vec<String>,
    /// Number of episodes that were rolled out.
    pub episodes: usize,
    /// One sentence for each episode that differs from the artifact.
    pub differing: Vec<String>,
}

/// The scenes that demonstrations are judged on, and the demonstrations.
pub(crate) struct OnScenes<'a> {
    /// The kind of every scene: first the given ones.
    pub(crate) scenes: &'a [Scenes],
    /// The demonstrations.
    pub(crate) demos: &'a [Demo],
}

/// What is computed from the episodes of the scenes.
type Body<'a, R> = dyn Fn(&OnScenes<'_>, &mut Roll<'_, anyhow::Error>) -> Result<R> + 'a;

impl Runner {
    /// Makes the `influence` artifact, or returns the existing one.
    ///
    /// # Errors
    /// If the policy cannot do without single demonstrations, an input cannot be read, or the run is interrupted.
    pub fn influence(&self, judge: Judge) -> Result<Influenced> {
        self.refuse_learned()?;
        let (built, _) = self.with_artifacts(&|policy, artifacts| {
            let recipe = self.judged_recipe(Stage::Influence, CODE_VERSION, policy, artifacts, &json!(judge.starts))?;
            if let Some(built) = self.unchanged(&recipe, Instant::now())? {
                return Ok(built);
            }
            self.with_episodes(policy, artifacts, judge, &|on, roll| {
                self.build_influence(&recipe, on, roll)
            })
        })?;
        Ok(Influenced {
            rows: built.artifact.read()?,
            built,
        })
    }

    /// Makes the artifact in parts of scenes. Episodes of different scenes do not depend on each other.
    fn build_influence(&self, recipe: &Recipe, on: &OnScenes<'_>, roll: &mut Roll<'_, anyhow::Error>) -> Result<Built> {
        let scenes = on.scenes.len();
        let roll = RefCell::new(roll);
        let judged = |first: usize| {
            let own = &on.scenes[first..scenes.min(first + SCENES_IN_PART)];
            let mut roll = roll.borrow_mut();
            self.judged(own, first, on.demos, &mut **roll)
        };
        let parts = parts_of(scenes, SCENES_IN_PART);
        let of_all =
            |rows: &[InfluenceRow], (episodes, pairs): &(Vec<JudgedEpisodeRow>, Vec<PairRow>)| ArtifactSummary {
                summary: summary(rows, episodes, pairs.len()),
                warnings: Vec::new(),
            };
        if parts == 1 {
            return self.build(recipe, |writer| {
                let judged = judged(0)?;
                let rows = influence_rows(on.demos, &judged.0, &judged.1);
                let summary = of_all(&rows, &judged);
                writer.write_rows(rows)?;
                writer.write_rows(judged.0)?;
                writer.write_rows(judged.1)?;
                Ok(summary)
            });
        }
        self.build_parts(
            recipe,
            parts,
            |writer, part| {
                let (episodes, pairs) = judged(part as usize * SCENES_IN_PART)?;
                writer.write_rows(episodes)?;
                writer.write_rows(pairs)?;
                Ok(ArtifactSummary::default())
            },
            |parts, writer| {
                let mut judged = (Vec::new(), Vec::new());
                for part in parts {
                    judged.0.extend(part.read::<JudgedEpisodeRow>()?);
                    judged.1.extend(part.read::<PairRow>()?);
                }
                let rows = influence_rows(on.demos, &judged.0, &judged.1);
                let summary = of_all(&rows, &judged);
                writer.write_rows(rows)?;
                Ok(summary)
            },
        )
    }

    /// The episodes of some scenes, and each again without every demonstration on which it depends. `first` is the number of the first
    /// scene.
    fn judged(
        &self,
        scenes: &[Scenes],
        first: usize,
        demos: &[Demo],
        roll: &mut Roll<'_, anyhow::Error>,
    ) -> Result<(Vec<JudgedEpisodeRow>, Vec<PairRow>)> {
        let mut roll = |episodes: &[Episode]| {
            let numbered = |episode: &Episode| Episode {
                scene: first + episode.scene,
                without: Arc::clone(&episode.without),
            };
            roll(&episodes.iter().map(numbered).collect::<Vec<_>>())
        };
        let all = evaluate(&mut roll, scenes.len(), &Without::default())?;
        self.notes.note(&format!(
            "{:>10}  {} episodes with all demonstrations",
            "influence",
            all.episodes.len()
        ));
        let changes = leave_one_out(&mut roll, &all)?;
        let (mut episodes, mut pairs) = (Vec::new(), Vec::new());
        for kind in [Scenes::Given, Scenes::Starts] {
            let (base, changes) = of_kind(kind, scenes, &all, &changes);
            episodes.extend(episode_rows(kind, &base, &changes));
            pairs.extend(pair_rows(kind, demos, &base, &changes));
        }
        Ok((episodes, pairs))
    }

    /// Rolls out every scene without each of up to `count` demonstrations, evenly spaced among those on which an episode depends, and
    /// compares the results with an `influence` artifact.
    ///
    /// # Errors
    /// If a rollout fails or the run is interrupted.
    pub fn check_influence(&self, judge: Judge, influenced: &Influenced, count: usize) -> Result<Checked> {
        let pairs: Vec<PairRow> = influenced.built.artifact.read()?;
        let episodes: Vec<JudgedEpisodeRow> = influenced.built.artifact.read()?;
        let depending: BTreeSet<u32> = pairs.iter().map(|pair| pair.demo).collect();
        let depending: Vec<u32> = depending.into_iter().collect();
        let sample: Vec<u32> = (0..count.min(depending.len()))
            .map(|place| depending[place * depending.len() / count.min(depending.len())])
            .collect();
        let (checked, _) = self.with_artifacts(&|policy, artifacts| {
            self.with_episodes(policy, artifacts, judge, &|on, roll| {
                let mut differing = Vec::new();
                for &demo in &sample {
                    let without = Arc::new(BTreeSet::from([demo]));
                    let brute = evaluate(roll, on.scenes.len(), &without)?;
                    for (episode, known) in brute.episodes.iter().zip(&episodes) {
                        let pair = pairs
                            .iter()
                            .find(|pair| (pair.scenes, pair.demo, pair.seed) == (known.scenes, demo, known.seed));
                        let expected = pair.map_or((known.success, known.score, known.steps), |pair| {
                            (pair.success_without, pair.score_without, pair.steps_without)
                        });
                        if (episode.success, episode.score, episode.steps) != expected {
                            differing.push(format!(
                                "scene {} without {}: success {}, score {}, {} steps instead of {}, {}, {}",
                                episode.seed,
                                on.demos.get(demo as usize).map_or("?", |demo| &demo.name),
                                episode.success,
                                episode.score,
                                episode.steps,
                                expected.0,
                                expected.1,
                                expected.2
                            ));
                        }
                    }
                }
                Ok(Checked {
                    demos: sample
                        .iter()
                        .filter_map(|&demo| on.demos.get(demo as usize).map(|demo| demo.name.clone()))
                        .collect(),
                    episodes: sample.len() * on.scenes.len(),
                    differing,
                })
            })
        })?;
        Ok(checked)
    }

    /// Refuses a policy that is trained on all demonstrations, before anything is trained.
    pub(crate) fn refuse_learned(&self) -> Result<()> {
        let policy = self.pipeline.policy()?;
        if policy.inputs().contains(&Stage::Train) {
            bail!("{}", not_single(policy.kind()); "choose a policy by retrieval, such as --policy re4");
        }
        Ok(())
    }

    /// The recipe of an artifact that depends on what rollouts are made from.
    pub(crate) fn judged_recipe(
        &self,
        stage: Stage,
        code_version: u32,
        policy: &Policy,
        artifacts: &RolloutArtifacts<'_>,
        more: &Value,
    ) -> Result<Recipe> {
        let rollout = match policy {
            Policy::Plane(_) => self.rollout_config(self.starts_config()?)?,
            Policy::Space(policy) => {
                self.observed(artifacts, |observer| self.space_config(policy, artifacts, observer))?
            }
        };
        let config = json!({
            "rollout": rollout,
            "rollout_version": super::CODE_VERSION,
            "starts": more,
        });
        let mut recipe = Recipe::new(stage, code_version).config(&config)?;
        for built in artifacts.all() {
            recipe = recipe.input(built.stage.artifact(), built.artifact.key());
        }
        Ok(recipe)
    }

    /// Calls `body` with a function that rolls out scenes without some demonstrations.
    pub(crate) fn with_episodes<R>(
        &self,
        policy: &Policy,
        artifacts: &RolloutArtifacts<'_>,
        judge: Judge,
        body: &Body<'_, R>,
    ) -> Result<R> {
        match policy {
            Policy::Plane(policy) => self.with_plane(policy, artifacts, |setup| {
                let given = self.starts(artifacts.scenes)?;
                let own = self.own_plane_starts(artifacts, judge.starts)?;
                self.rolled(setup, artifacts, policy.kind(), given, own, body)
            }),
            Policy::Space(policy) => self.observed(artifacts, |observer| {
                self.with_space(policy, artifacts, observer, |setup, task, _| {
                    let given = self.space_starts(task)?.collect();
                    let own = own_space_starts(artifacts, task, judge.starts)?;
                    self.rolled(setup, artifacts, policy.kind(), given, own, body)
                })
            }),
        }
    }

    fn rolled<D: Recorded, R>(
        &self,
        setup: &RolloutSetup<'_, '_, D>,
        artifacts: &RolloutArtifacts<'_>,
        kind: &str,
        given: Vec<Start<D>>,
        own: Vec<Start<D>>,
        body: &Body<'_, R>,
    ) -> Result<R> {
        let demos = read_demos(&artifacts.episodes.artifact)?;
        ensure!(
            demos.len() > 1,
            "there is only one demonstration, and the policy cannot act without it";
            "select more demonstrations"
        );
        let opened = self.opened(setup, artifacts)?;
        let times = ActTimes::default();
        let scenes: Vec<Scenes> = std::iter::repeat_n(Scenes::Given, given.len())
            .chain(std::iter::repeat_n(Scenes::Starts, own.len()))
            .collect();
        let starts = [given, own].concat();
        let mut roll = |episodes: &[Episode]| -> Result<Vec<Traced>> {
            let jobs: Vec<Job<D>> = episodes
                .iter()
                .map(|episode| Job {
                    start: starts[episode.scene].clone(),
                    without: Arc::clone(&episode.without),
                })
                .collect();
            let bar = self.notes.progress(jobs.len() as u64, "rollouts");
            let going = || {
                bar.inc(1);
                !self.interrupt.requested()
            };
            let harness = Harness {
                env: setup.env,
                source: setup.source,
                max_steps: self.pipeline.rollout()?.max_steps,
                conditions: self.pipeline.rollout()?.conditions(),
                progress: &going,
                times: &times,
            };
            let traced = opened.traced(&harness, &jobs)?;
            bar.finish_and_clear();
            match traced {
                Some(traced) => Ok(traced),
                None => bail!("{}", not_single(kind); "choose another policy by retrieval, such as --policy re4"),
            }
        };
        body(
            &OnScenes {
                scenes: &scenes,
                demos: &demos,
            },
            &mut roll,
        )
    }

    /// Scenes that start from the first states of the demonstrations, perturbed.
    fn own_plane_starts(&self, artifacts: &RolloutArtifacts<'_>, count: u32) -> Result<Vec<Start<Plane>>> {
        if count == 0 {
            return Ok(Vec::new());
        }
        let [translation, rotation] = PLANE_NOISE;
        let episodes = read_episodes(&artifacts.episodes.artifact)?;
        let mut starts = Vec::new();
        for (demo, episode) in (0..).zip(episodes) {
            let Some(first) = episode.frames.first() else { continue };
            for seed in (0..count).map(|number| demo * count + number) {
                let mut noise = PoseNoise::new(u64::from(seed), translation, rotation);
                let state = Scene {
                    agent: first.eef,
                    block: noise.perturb_planar(&first.object),
                };
                let scene = PlaneScene {
                    state,
                    order: ResetOrder::PoseIsPose,
                    goal: GOAL,
                };
                starts.push(Start { seed, scene });
            }
        }
        self.with_goals(starts)
    }
}

/// The names of demonstrations and the first positions of their objects.
fn read_demos(episodes: &Artifact) -> Result<Vec<Demo>> {
    let names = demo_names(episodes)?;
    let starts: Vec<[f64; 2]> = if is_spatial(episodes)? {
        let first = |demo: Result<(u32, SpatialEpisode)>| {
            let (_, episode) = demo?;
            let at = episode.frames.first().map(|frame| frame.object.translation.vector);
            Ok(at.map_or([f64::NAN; 2], |at| [at.x, at.y]))
        };
        SpatialEpisodes::open(episodes)?.map(first).collect::<Result<_>>()?
    } else {
        let first = |episode: &PlanarEpisode| episode.frames.first().map(|frame| frame.object);
        let all = read_episodes(episodes)?;
        all.iter()
            .map(|episode| first(episode).map_or([f64::NAN; 2], |at| [at.x, at.y]))
            .collect()
    };
    let demos = (0..).zip(starts).map(|(demo, start)| Demo {
        name: names.of(demo),
        start,
    });
    Ok(demos.collect())
}

/// Scenes that start from the first object poses of the demonstrations, perturbed. The arm starts as in the scene of a seed.
fn own_space_starts(artifacts: &RolloutArtifacts<'_>, task: RobosuiteTask, count: u32) -> Result<Vec<Start<Space>>> {
    let mut starts = Vec::new();
    if count == 0 {
        return Ok(starts);
    }
    let [translation, rotation] = SPACE_NOISE;
    let used = task.placement.iter().position(|rule| rule.used);
    for demo in SpatialEpisodes::open(&artifacts.episodes.artifact)? {
        let (demo, episode) = demo?;
        let Some(first) = episode.frames.first() else { continue };
        for seed in (0..count).map(|number| demo * count + number) {
            let mut scene = Placement::sample(task, seed);
            let mut noise = PoseNoise::new(u64::from(seed), translation, 0.0);
            let moved = noise.perturb(&first.object);
            let mut noise = PoseNoise::new(u64::from(seed), rotation, 0.0);
            // The object rests on its base, so it is only rotated about the vertical axis.
            let angle = noise.perturb(&nalgebra::Isometry3::identity()).translation.z;
            let about_vertical = nalgebra::UnitQuaternion::from_axis_angle(&nalgebra::Vector3::z_axis(), angle);
            let rotated = about_vertical * first.object.rotation;
            if let Some(object) = used.and_then(|used| scene.objects.get_mut(used)) {
                [object.position[0], object.position[1]] = [moved.translation.x, moved.translation.y];
                object.quaternion = [rotated.w, rotated.i, rotated.j, rotated.k];
            }
            starts.push(Start { seed, scene });
        }
    }
    Ok(starts)
}

fn not_single(kind: &str) -> String {
    format!(
        "the policy {kind:?} does not choose between demonstrations one by one, so the exact effect of leaving one out cannot be \
         computed"
    )
}

/// The scenes of one kind, which are numbered from 0.
fn of_kind(kind: Scenes, scenes: &[Scenes], all: &Evaluation, changes: &[Change]) -> (Evaluation, Vec<Change>) {
    let first = scenes.iter().position(|other| *other == kind).unwrap_or(scenes.len());
    let of = |scene: usize| scenes.get(scene) == Some(&kind);
    let episodes = all.episodes.iter().enumerate().filter(|(scene, _)| of(*scene));
    let base = Evaluation {
        without: Arc::clone(&all.without),
        episodes: episodes.map(|(_, episode)| episode.clone()).collect(),
    };
    let changes = changes.iter().filter(|change| of(change.scene)).map(|change| Change {
        scene: change.scene - first,
        ..change.clone()
    });
    (base, changes.collect())
}

fn summary(rows: &[InfluenceRow], episodes: &[JudgedEpisodeRow], pairs: usize) -> Value {
    let demos: BTreeSet<u32> = rows.iter().map(|row| row.demo).collect();
    let with = |admit: &dyn Fn(&InfluenceRow) -> bool| {
        let found: BTreeSet<u32> = rows.iter().filter(|row| admit(row)).map(|row| row.demo).collect();
        found.len()
    };
    json!({
        "demonstrations": demos.len(),
        "episodes": episodes.len(),
        "episodes_again": pairs,
        "never_judged": demos.len() - with(&|row| row.depending > 0),
        "harmful": with(&|row| row.repaired > row.broken),
        "helpful": with(&|row| row.broken > row.repaired),
    })
}
