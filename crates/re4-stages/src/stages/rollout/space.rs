//! The stage `rollout` for robosuite tasks.

use std::time::Instant;

use anyhow::{Context as _, Result};
use re4_artifact::{Artifact, ArtifactSummary, Recipe, Stage};
use re4_encoder::{Predictor, SIDE};
use re4_mujoco::Gl;
use re4_policy::kinds::{Kinds as _, SpacePolicy};
use re4_rollout::{
    Batch, Env, Estimator, PoseNoise, RobosuiteEnv, SceneRenderer, Source, Space, SpaceDecisionRow, SpaceResultRow,
    Start,
};
use re4_sim::robosuite::{Placement, Profile, RobosuiteModel, RobosuiteTask, simulation_steps};
use re4_stats::{median, wilson_interval};
use serde_json::{Value, json};

use super::estimators::Encoder;
use super::{CODE_VERSION, RolloutArtifacts, RolloutSetup, extend};
use crate::inputs::estimators::{WEIGHTS, read_calibration};
use crate::inputs::simulators::{Scenes, profile};
use crate::parts::parts_of;
use crate::runner::{Built, Runner};

/// Increase it whenever the same states give different images.
const RENDERING_VERSION: u32 = 1;

/// Rollouts per part. Another number gives other files, see [`CODE_VERSION`].
pub(super) const ROLLOUTS_IN_PART: usize = 128;

/// Makes the pose estimator of an episode.
pub(crate) type MakeEstimator = dyn Fn() -> Box<dyn Estimator<Space>> + Sync;

/// Wraps an environment before it is observed. Tests use it to record what is rendered.
type WrapEnv = for<'e> fn(Box<dyn Env<Space> + 'e>) -> Box<dyn Env<Space> + 'e>;

/// How a policy observes the object through images.
pub(crate) struct ImageObserver<'a> {
    /// Opens the encoder and returns the constructor of estimators.
    pub(crate) open: &'a dyn Fn() -> Result<Box<MakeEstimator>>,
    /// Wraps each environment.
    pub(crate) wrap: WrapEnv,
}

/// The rendering settings that are part of the artifact's key.
fn rendering(camera: &str) -> Result<Value> {
    Ok(json!({
        "assets": "robosuite-1.4.1",
        "camera": camera,
        "gl": Gl::of_process().context("cannot render the policy's images")?.to_string(),
        "side": SIDE,
        "version": RENDERING_VERSION,
    }))
}

/// A renderer of these demonstrations' scene.
///
/// # Errors
/// If an asset is missing, or the model has no such camera.
pub(crate) fn scene_renderer(scenes: &Scenes, episodes: &Artifact, camera: &str) -> Result<SceneRenderer> {
    let mjcf = scenes.rendered_mjcf(episodes)?;
    let model = scenes.compile(&mjcf)?.mujoco().clone();
    let scene_renderer = SceneRenderer::new(mjcf, model, SIDE);
    scene_renderer.camera(camera).with_context(|| {
        format!(
            "cannot render the policy's images with the models of {}",
            episodes.path().display()
        )
    })?;
    Ok(scene_renderer)
}

impl Runner {
    /// Makes the `rollouts` artifact of a robosuite task, or returns the existing one. The policy observes the simulator's object
    /// pose or, if `artifacts.encoder` is given, the estimates of the encoder.
    pub(super) fn rollout_space(&self, policy: &SpacePolicy, artifacts: &RolloutArtifacts<'_>) -> Result<Built> {
        self.observed(artifacts, |observer| {
            self.rollout_with_observer(policy, artifacts, observer)
        })
    }

    /// Calls `body` with the observer of the pipeline: `artifacts.encoder`, or `None` for the simulator's poses.
    pub(super) fn observed<R>(
        &self,
        artifacts: &RolloutArtifacts<'_>,
        body: impl FnOnce(Option<&ImageObserver<'_>>) -> Result<R>,
    ) -> Result<R> {
        let Some(encoder) = artifacts.encoder else {
            return body(None);
        };
        let config = self.pipeline.pose()?.encoder().into_owned();
        let open = || -> Result<Box<MakeEstimator>> {
            let predictor = Predictor::open(&encoder.artifact.path().join(WEIGHTS), &config)?;
            let calibration = read_calibration(encoder.artifact.path())?;
            Ok(Box::new(move || {
                Box::new(Encoder::new(&predictor, calibration.as_ref()))
            }))
        };
        body(Some(&ImageObserver {
            open: &open,
            wrap: |env| env,
        }))
    }

    /// As [`Self::rollout_space`], with the given estimators.
    pub(crate) fn rollout_with_observer(
        &self,
        policy: &SpacePolicy,
        artifacts: &RolloutArtifacts<'_>,
        observer: Option<&ImageObserver<'_>>,
    ) -> Result<Built> {
        let mut recipe =
            Recipe::new(Stage::Rollout, CODE_VERSION).config(&self.space_config(policy, artifacts, observer)?)?;
        for built in artifacts.all() {
            recipe = recipe.input(built.stage.artifact(), built.artifact.key());
        }
        let section = self.pipeline.rollout()?;
        let episodes = &artifacts.episodes.artifact;
        let finish = |summary: &Summary, task: RobosuiteTask, profile: Profile| {
            let mut protocol = self.protocol(
                episodes,
                json!({
                    "measure": "success by the task's own rule after any control step",
                    "intervals": "95 %, Wilson",
                    "seeds": section.seeds,
                    "scene_of_a_seed": "np.random.seed(seed) before a hard reset of robosuite; model of the first demonstration, with the cube size of the seed",
                    "robosuite": profile,
                    "physics": format!("MuJoCo {}", profile.mujoco()),
                    "fidelity": section.fidelity,
                    "simulation_steps_per_control_step": simulation_steps(task),
                    "control_frequency_hz": task.control_rate,
                    "controller": "OSC_POSE, absolute goals of the grip site",
                }),
            )?;
            extend(&mut protocol, Value::Object(self.conditions_config()?));
            anyhow::Ok(ArtifactSummary {
                summary: summary.state(&protocol, observer.is_some()),
                warnings: Vec::new(),
            })
        };
        if parts_of(self.space_starts(self.simulated()?)?.len(), ROLLOUTS_IN_PART) == 1 {
            return self.build(&recipe, |writer| {
                let mut summary = Summary::default();
                let add = &mut |batch: &Batch<Space>| summary.add(&batch.results, &batch.decisions);
                let (task, profile) = self.with_space(policy, artifacts, observer, |setup, task, scenes| {
                    let opened = self.opened(setup, artifacts)?;
                    self.record(setup, &*opened, 0, &mut self.space_starts(task)?, writer, add)?;
                    Ok((task, scenes.profile()))
                })?;
                finish(&summary, task, profile)
            });
        }
        // Opening the scenes takes seconds.
        if let Some(built) = self.unchanged(&recipe, Instant::now())? {
            return Ok(built);
        }
        self.with_space(policy, artifacts, observer, |setup, task, scenes| {
            let starts: Vec<Start<Space>> = self.space_starts(task)?.collect();
            self.record_parts((&recipe, setup), artifacts, &starts, ROLLOUTS_IN_PART, |parts, _| {
                let mut summary = Summary::default();
                for part in parts {
                    summary.add(&part.read()?, &part.read()?);
                }
                finish(&summary, task, scenes.profile())
            })
        })
    }
}

impl Runner {
    /// The settings that the key of rollouts depends on besides its inputs.
    pub(super) fn space_config(
        &self,
        policy: &SpacePolicy,
        artifacts: &RolloutArtifacts<'_>,
        observer: Option<&ImageObserver<'_>>,
    ) -> Result<Value> {
        let section = self.pipeline.rollout()?;
        let task = self.simulated()?;
        let mut config = self.rollout_config(json!({
            "symmetry": section.symmetry(task, self.pipeline.variant, policy),
            "noise": section.noise,
            "fidelity": section.fidelity,
            "robosuite": profile(&artifacts.episodes.artifact)?,
            "seeds": section.seeds,
        }))?;
        if observer.is_some() {
            config["images"] = rendering(&self.pipeline.pose()?.encoder().camera)?;
        }
        Ok(config)
    }

    fn simulated(&self) -> Result<RobosuiteTask> {
        self.pipeline.task.robosuite().context("no simulator for this task")
    }

    /// The scenes that the pipeline asks for.
    pub(super) fn space_starts(&self, task: RobosuiteTask) -> Result<impl ExactSizeIterator<Item = Start<Space>>> {
        let seeds = self.pipeline.rollout()?.seeds.as_ref();
        let seeds = seeds.context("no seeds to start from")?.as_slice();
        Ok(seeds.iter().map(move |&seed| Start {
            seed,
            scene: Placement::sample(task, seed),
        }))
    }

    /// Calls `body` with the policy, its environments and its observations.
    pub(super) fn with_space<R>(
        &self,
        policy: &SpacePolicy,
        artifacts: &RolloutArtifacts<'_>,
        observer: Option<&ImageObserver<'_>>,
        body: impl FnOnce(&RolloutSetup<'_, '_, Space>, RobosuiteTask, &Scenes) -> Result<R>,
    ) -> Result<R> {
        let section = self.pipeline.rollout()?;
        let task = self.simulated()?;
        let episodes = &artifacts.episodes.artifact;
        let camera = self.pipeline.pose()?.encoder().camera.clone();
        let scenes = Scenes::open(episodes, task, section.fidelity)?;
        let mjcf = scenes.first_mjcf()?;
        // If the seed determines the size of a box (Lift's cube), every seed needs its own compiled model.
        let shared = (!task.samples_models()).then(|| scenes.compile(mjcf)).transpose()?;
        let observed = match observer {
            Some(observer) => Some((
                scene_renderer(&scenes, episodes, &camera)?,
                (observer.open)()?,
                observer.wrap,
            )),
            None => None,
        };
        let env = |start: &Start<Space>| {
            let model: RobosuiteModel = match &shared {
                Some(model) => model.clone(),
                None => scenes.compile(&start.scene.in_model(mjcf)?)?,
            };
            let scene_renderer = observed.as_ref().map(|(scene_renderer, ..)| scene_renderer);
            let env: Box<dyn Env<Space> + '_> = Box::new(RobosuiteEnv::new(&model, scene_renderer)?);
            Ok(match &observed {
                Some((.., wrap)) => wrap(env),
                None => env,
            })
        };
        let source = |seed: u32| match (&observed, section.noise) {
            (Some((_, estimator, _)), _) => Source::Image {
                camera: camera.clone(),
                estimator: estimator(),
            },
            (None, Some(noise)) if noise.is_noisy() => {
                let mut errors = PoseNoise::new(u64::from(seed), noise.translation, noise.rotation);
                Source::Noisy(Box::new(move |pose| errors.perturb(pose)))
            }
            _ => Source::Recorded,
        };
        let setup = RolloutSetup {
            policy: policy.settings(),
            symmetry: section.symmetry(task, self.pipeline.variant, policy),
            env: &env,
            source: &source,
        };
        body(&setup, task, &scenes)
    }
}

/// Accumulates the summary of rollouts.
#[derive(Default)]
struct Summary {
    rollouts: u64,
    success_steps: Vec<f64>,
    losses: u64,
    images: u64,
}

impl Summary {
    /// Adds rollouts and their decisions.
    fn add(&mut self, results: &[SpaceResultRow], decisions: &[SpaceDecisionRow]) {
        for SpaceResultRow { core, .. } in results {
            self.rollouts += 1;
            self.success_steps.extend(core.success.then(|| f64::from(core.steps)));
            self.images += u64::from(core.images.unwrap_or(0));
        }
        let lost = |row: &&SpaceDecisionRow| row.core.kind.as_deref() == Some("grasp_lost");
        self.losses += decisions.iter().filter(lost).count() as u64;
    }

    fn state(&self, protocol: &Value, watched: bool) -> Value {
        let successes = self.success_steps.len() as u64;
        let mut summary = json!({
            "rollouts": self.rollouts,
            "successes": successes,
            "metrics": { "success_rate": wilson_interval(successes, self.rollouts) },
            "medians": { "steps_of_successes": median(&self.success_steps) },
            "longest_success": self.success_steps.iter().copied().fold(0.0, f64::max),
            "losses": self.losses,
            "protocol": protocol,
        });
        if watched {
            summary["images"] = json!(self.images);
            summary["protocol"]["observation"] = json!(
                "grip site, fingers and, when the policy requests it, the camera image, 84 x 84; no recorded object pose"
            );
        }
        summary
    }
}
