//! Rollouts of robosuite's tasks.

use anyhow::{Context as _, Result};
use re4_artifact::{Artifact, ArtifactSummary, Recipe, Stage};
use re4_encoder::{Predictor, SIDE};
use re4_mujoco::Gl;
use re4_policy::kinds::{Kinds as _, SpacePolicy};
use re4_rollout::{
    Batch, Env, Estimator, PoseNoise, RobosuiteEnv, SceneRenderer, Source, Space, SpaceDecisionRow, SpaceResultRow,
    Start,
};
use re4_sim::robosuite::{Placement, RobosuiteModel, simulation_steps};
use re4_stats::{median, wilson_interval};
use serde_json::{Value, json};

use super::estimators::Encoder;
use super::{CODE_VERSION, Made, Play};
use crate::inputs::estimators::WEIGHTS;
use crate::inputs::simulators::{Scenes, profile};
use crate::runner::{Built, Runner};

/// Raised whenever the same states give other images.
const DRAWING_VERSION: u32 = 1;

/// Makes the estimator of an episode.
pub(crate) type MakeEstimator = dyn Fn() -> Box<dyn Estimator<Space>> + Sync;

/// What stands between a simulation and who senses it.
type Through = for<'e> fn(Box<dyn Env<Space> + 'e>) -> Box<dyn Env<Space> + 'e>;

/// Who looks at images.
pub(crate) struct Watching<'a> {
    /// Opens the estimators.
    pub(crate) open: &'a dyn Fn() -> Result<Box<MakeEstimator>>,
    /// What the simulation is seen through.
    pub(crate) through: Through,
}

/// What the key of an artifact says of images drawn in rollouts.
fn drawing(camera: &str) -> Result<Value> {
    Ok(json!({
        "assets": "robosuite-1.4.1",
        "camera": camera,
        "gl": Gl::of_process().context("cannot draw what the policy sees")?.to_string(),
        "side": SIDE,
        "version": DRAWING_VERSION,
    }))
}

/// The scene of these demonstrations, which has this camera.
///
/// # Errors
/// When an asset is missing, or the model has no such camera.
pub(crate) fn scene_renderer(scenes: &Scenes, episodes: &Artifact, camera: &str) -> Result<SceneRenderer> {
    let mjcf = scenes.rendered_mjcf(episodes)?;
    let model = scenes.compile(&mjcf)?.mujoco().clone();
    let scene_renderer = SceneRenderer::new(mjcf, model, SIDE);
    scene_renderer
        .camera(camera)
        .with_context(|| format!("cannot draw what the policy sees of {}", episodes.path().display()))?;
    Ok(scene_renderer)
}

impl Runner {
    /// The `rollouts` artifact of a robosuite task: with the simulator's own object poses, or, where there is a `poses` artifact,
    /// with what its encoder says of images.
    pub(super) fn rollout_space(&self, policy: &SpacePolicy, made: &Made<'_>) -> Result<Built> {
        let Some(poses) = made.poses else {
            return self.rollout_watching(policy, made, None);
        };
        let backend = self.pipeline.pose()?.encoder().backend;
        let open = || -> Result<Box<MakeEstimator>> {
            let predictor = Predictor::open(&poses.artifact.path().join(WEIGHTS), backend)?;
            Ok(Box::new(move || Box::new(Encoder(predictor.clone()))))
        };
        let watching = Watching {
            open: &open,
            through: |env| env,
        };
        self.rollout_watching(policy, made, Some(&watching))
    }

    /// The `rollouts` artifact, with the estimators that are opened for a `poses` artifact.
    pub(crate) fn rollout_watching(
        &self,
        policy: &SpacePolicy,
        made: &Made<'_>,
        watching: Option<&Watching<'_>>,
    ) -> Result<Built> {
        let section = self.pipeline.rollout()?;
        let task = self.pipeline.task.robosuite().context("no simulator for this task")?;
        let symmetry = section.symmetry(task, self.pipeline.variant, policy);
        let camera = self.pipeline.pose()?.encoder().camera.clone();
        let mut config = self.rollout_config(json!({
            "symmetry": symmetry,
            "noise": section.noise,
            "fidelity": section.fidelity,
            "robosuite": profile(&made.episodes.artifact)?,
            "seeds": section.seeds,
        }))?;
        if watching.is_some() {
            config["images"] = drawing(&camera)?;
        }
        let mut recipe = Recipe::new(Stage::Rollout, CODE_VERSION).config(&config)?;
        for built in made.all() {
            recipe = recipe.input(built.stage.artifact(), built.artifact.key());
        }
        let episodes = &made.episodes.artifact;
        self.build(&recipe, |writer| {
            let scenes = Scenes::open(episodes, task, section.fidelity)?;
            let mjcf = scenes.first_mjcf()?;
            // Where the size of a box is drawn, every seed has a model of its own.
            let shared = (!task.draws_models()).then(|| scenes.compile(mjcf)).transpose()?;
            let seen = match watching {
                Some(watching) => Some((
                    scene_renderer(&scenes, episodes, &camera)?,
                    (watching.open)()?,
                    watching.through,
                )),
                None => None,
            };
            let env = |start: &Start<Space>| {
                let model: RobosuiteModel = match &shared {
                    Some(model) => model.clone(),
                    None => scenes.compile(&start.scene.in_model(mjcf)?)?,
                };
                let scene_renderer = seen.as_ref().map(|(scene_renderer, ..)| scene_renderer);
                let env: Box<dyn Env<Space> + '_> = Box::new(RobosuiteEnv::new(&model, scene_renderer)?);
                Ok(match &seen {
                    Some((.., through)) => through(env),
                    None => env,
                })
            };
            let source = |seed: u32| match (&seen, section.noise) {
                (Some((_, estimator, _)), _) => Source::Image {
                    camera: camera.clone(),
                    estimator: estimator(),
                },
                (None, Some(noise)) if noise.translation != 0.0 || noise.rotation != 0.0 => {
                    let mut errors = PoseNoise::new(u64::from(seed), noise.translation, noise.rotation);
                    Source::Noisy(Box::new(move |pose| errors.perturb(pose)))
                }
                _ => Source::Recorded,
            };
            let seeds = section.seeds.as_ref().context("no seeds to start from")?;
            let mut starts = seeds.as_slice().iter().map(|&seed| Start {
                seed,
                scene: Placement::draw(task, seed),
            });
            let play = Play {
                policy: policy.settings(),
                symmetry,
                env: &env,
                source: &source,
            };
            let mut summary = Summary::default();
            let add = &mut |batch: &Batch<Space>| summary.add(&batch.results, &batch.decisions);
            self.record(&play, made, &mut starts, writer, add)?;
            let protocol = self.protocol(
                episodes,
                json!({
                    "measure": "success of the task's own rule after any control step",
                    "intervals": "95 %, Wilson",
                    "seeds": section.seeds,
                    "scene_of_a_seed": "np.random.seed(seed) before a hard reset of robosuite; model of the first demonstration, with the cube's size of the seed",
                    "robosuite": scenes.profile(),
                    "physics": format!("MuJoCo {}", scenes.profile().mujoco()),
                    "fidelity": section.fidelity,
                    "simulation_steps_per_control_step": simulation_steps(task),
                    "control_frequency_hz": task.control_rate,
                    "controller": "OSC_POSE, absolute goals of the grip site",
                }),
            )?;
            Ok(ArtifactSummary {
                summary: summary.state(&protocol, watching.is_some()),
                warnings: Vec::new(),
            })
        })
    }
}

/// What the tables of rollouts come to.
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
                "grip site, fingers, and where the policy asks for it the image of the camera, 84 x 84; no recorded object pose"
            );
        }
        summary
    }
}
