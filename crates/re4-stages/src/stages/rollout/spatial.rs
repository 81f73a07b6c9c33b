//! Rollouts of robosuite's tasks.

use std::collections::BTreeSet;
use std::sync::Arc;

use anyhow::{Context as _, Result};
use nalgebra::Isometry3;
use re4_artifact::{Artifact, Columns, Facts, Recipe, Stage, TableWriter, Writer, tables};
use re4_encoder::{Predictor, SIDE};
use re4_mujoco::Gl;
use re4_policy::DemoNames;
use re4_policy::spatial::{SpatialChoice, SpatialDecision, SpatialDecisionKind, SpatialRe4Factory};
use re4_rollout::{
    Env, Estimator, Harness, PoseNoise, RobosuiteEnv, Rollout, Source, Space, Start, StepRecord, Studio, rollouts,
};
use re4_sim::robosuite::{Placement, RobosuiteModel, RobosuiteTask, simulation_steps};
use re4_stats::{median, wilson_interval};
use serde_json::{Value, json};

use super::estimators::Encoder;
use crate::inputs::demos::demo_names;
use crate::inputs::estimators::WEIGHTS;
use crate::inputs::poses::pose_columns;
use crate::inputs::simulators::{Scenes, profile};
use crate::inputs::spatial_index::open_spatial_index;
use crate::pipeline::SpatialRolloutSection;
use crate::runner::{Built, Runner};

/// Raised whenever the same input gives other bytes.
const CODE_VERSION: u32 = 2;

/// Seeds rolled out before their rows are written.
const BATCH: usize = 128;

/// Raised whenever the same states give other pictures.
const DRAWING_VERSION: u32 = 1;

type SpatialRollout = Rollout<Space, SpatialDecision>;

/// Makes the estimator of an episode.
pub(crate) type MakeEstimator = dyn Fn() -> Box<dyn Estimator<Space>> + Sync;

/// A `poses` artifact, and who looks at images.
pub(crate) struct Watching<'a> {
    pub(crate) poses: &'a Built,
    /// Opens the estimators.
    pub(crate) open: &'a dyn Fn() -> Result<Box<MakeEstimator>>,
    /// What the simulation is seen through.
    pub(crate) through: for<'e> fn(Box<dyn Env<Space> + 'e>) -> Box<dyn Env<Space> + 'e>,
}

/// What the key of an artifact says of pictures drawn in rollouts.
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
pub(crate) fn studio(scenes: &Scenes, episodes: &Artifact, camera: &str) -> Result<Studio> {
    let mjcf = scenes.drawn_mjcf(episodes)?;
    let model = scenes.compile(&mjcf)?.mujoco().clone();
    let studio = Studio::new(mjcf, model, SIDE);
    studio
        .camera(camera)
        .with_context(|| format!("cannot draw what the policy sees of {}", episodes.path().display()))?;
    Ok(studio)
}

impl Runner {
    /// The `rollouts` artifact of a robosuite task: with the simulator's own object poses, or, where there is a `poses` artifact,
    /// with what its encoder says of pictures.
    ///
    /// # Errors
    /// When an input, or a setting of the pipeline, does not allow it; or at Ctrl-C.
    pub fn rollout_spatial(&self, episodes: &Built, poses: Option<&Built>, index: &Built) -> Result<Built> {
        let Some(poses) = poses else {
            return self.rollout_watching(episodes, None, index);
        };
        let backend = self.pipeline.pose()?.encoder().backend;
        let open = || -> Result<Box<MakeEstimator>> {
            let predictor = Predictor::open(&poses.artifact.path().join(WEIGHTS), backend)?;
            Ok(Box::new(move || Box::new(Encoder(predictor.clone()))))
        };
        let watching = Watching {
            poses,
            open: &open,
            through: |env| env,
        };
        self.rollout_watching(episodes, Some(&watching), index)
    }

    /// The `rollouts` artifact, with the estimators that are opened for a `poses` artifact.
    pub(crate) fn rollout_watching(
        &self,
        episodes: &Built,
        watching: Option<&Watching<'_>>,
        index: &Built,
    ) -> Result<Built> {
        let section = self.pipeline.spatial_rollout()?;
        let task = self.pipeline.task.robosuite().context("no simulator for this task")?;
        let policy = section.policy_config();
        let symmetry = section.symmetry(task, self.pipeline.variant);
        let profile = profile(&episodes.artifact)?;
        let mut config = json!({
                "task": self.pipeline.task,
                "variant": self.pipeline.variant,
                "preset": section.policy,
                "policy": policy,
                "symmetry": symmetry,
                "noise": section.noise,
                "fidelity": section.fidelity,
                "robosuite": profile,
                "seeds": section.seeds,
                "max_steps": section.max_steps,
        });
        let camera = self.pipeline.pose()?.encoder().camera.clone();
        if watching.is_some() {
            config["pictures"] = drawing(&camera)?;
        }
        let mut recipe = Recipe::new(Stage::Rollout, CODE_VERSION)
            .config(&config)?
            .input("episodes", episodes.artifact.key())
            .input("index", index.artifact.key());
        if let Some(watching) = watching {
            recipe = recipe.input("poses", watching.poses.artifact.key());
        }
        self.build(&recipe, |writer| {
            let knowledge = Arc::new(open_spatial_index(
                &index.artifact,
                &policy.retrieve,
                symmetry,
                demo_names(&episodes.artifact)?,
            )?);
            let scenes = Scenes::open(&episodes.artifact, task, section.fidelity)?;
            let mjcf = scenes.first_mjcf()?;
            // Where the size of a box is drawn, every seed has a model of its own.
            let shared = (!task.draws_models()).then(|| scenes.compile(mjcf)).transpose()?;
            let seen = watching
                .map(|watching| {
                    let studio = studio(&scenes, &episodes.artifact, &camera)?;
                    Ok::<_, anyhow::Error>((studio, (watching.open)()?, watching.through))
                })
                .transpose()?;
            let env = |start: &Start<Space>| {
                let model: RobosuiteModel = match &shared {
                    Some(model) => model.clone(),
                    None => scenes.compile(&start.scene.in_model(mjcf)?)?,
                };
                let studio = seen.as_ref().map(|(studio, ..)| studio);
                let env: Box<dyn Env<Space> + '_> = Box::new(RobosuiteEnv::new(&model, studio)?);
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
            let seeds = section.seeds.as_slice();
            let bar = self.notes.progress(seeds.len() as u64, "rollouts");
            let going = || {
                bar.inc(1);
                !self.interrupt.requested()
            };
            let harness = Harness {
                env: &env,
                source: &source,
                max_steps: section.max_steps,
                progress: &going,
            };
            let factory = SpatialRe4Factory {
                config: policy.clone(),
                knowledge,
            };
            let mut tables = Tables::begin(writer, factory.knowledge.demos().names())?;
            let mut outcomes = Outcomes::default();
            for batch in seeds.chunks(BATCH) {
                let starts: Vec<_> = batch
                    .iter()
                    .map(|&seed| Start {
                        seed,
                        scene: Placement::draw(task, seed),
                    })
                    .collect();
                let rollouts = rollouts(&factory, &harness, &starts)?;
                outcomes.add(&rollouts);
                tables.write(&rollouts)?;
            }
            bar.finish_and_clear();
            tables.finish()?;
            let summary = outcomes.summary(section, task, &scenes, &episodes.artifact, watching.is_some());
            Ok(Facts {
                summary,
                warnings: Vec::new(),
            })
        })
    }
}

#[derive(Default)]
struct Outcomes {
    steps: Vec<f64>,
    success_steps: Vec<f64>,
    successes: u64,
    losses: u64,
    looks: u64,
}

impl Outcomes {
    fn summary(
        &self,
        section: &SpatialRolloutSection,
        task: RobosuiteTask,
        scenes: &Scenes,
        episodes: &Artifact,
        watched: bool,
    ) -> Value {
        let success = wilson_interval(self.successes, self.steps.len() as u64);
        let mut summary = json!({
            "rollouts": self.steps.len(),
            "successes": self.successes,
            "metrics": { "success_rate": success },
            "medians": { "steps_of_successes": median(&self.success_steps) },
            "longest_success": self.success_steps.iter().copied().fold(0.0, f64::max),
            "losses": self.losses,
            "protocol": {
                "dataset": episodes.manifest().source,
                "dataset_blake3": episodes.manifest().source_blake3,
                "demonstrations": episodes.manifest().config,
                "max_steps": section.max_steps,
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
            },
        });
        if watched {
            summary["pictures"] = json!(self.looks);
            summary["protocol"]["observation"] = json!(
                "grip site, fingers, and at decisions the picture of the camera, 84 x 84; no recorded object pose"
            );
        }
        summary
    }

    fn add(&mut self, rollouts: &[SpatialRollout]) {
        for rollout in rollouts {
            let steps = rollout.steps.len() as f64;
            self.steps.push(steps);
            if rollout.success() {
                self.successes += 1;
                self.success_steps.push(steps);
            }
            self.losses += u64::from(losses(rollout));
            self.looks += u64::from(rollout.images());
        }
    }
}

fn losses(rollout: &SpatialRollout) -> u32 {
    let lost = |decision: &&SpatialDecision| decision.kind == SpatialDecisionKind::GraspLost;
    rollout.decisions.iter().filter(lost).count() as u32
}

struct Tables<'a> {
    names: &'a DemoNames,
    results: TableWriter,
    steps: TableWriter,
    decisions: TableWriter,
    rollouts: u32,
}

impl<'a> Tables<'a> {
    fn begin(writer: &Writer, names: &'a DemoNames) -> Result<Self> {
        Ok(Self {
            names,
            results: writer.table(&tables::SPATIAL_RESULTS)?,
            steps: writer.table(&tables::SPATIAL_STEPS)?,
            decisions: writer.table(&tables::SPATIAL_DECISIONS)?,
            rollouts: 0,
        })
    }

    fn write(&mut self, rollouts: &[SpatialRollout]) -> Result<()> {
        self.results.write_columns(result_columns(rollouts, self.rollouts))?;
        self.rollouts += rollouts.len() as u32;
        self.steps.write_columns(step_columns(rollouts))?;
        self.decisions.write_columns(decision_columns(rollouts, self.names))?;
        Ok(())
    }

    fn finish(self) -> Result<()> {
        self.results.finish()?;
        self.steps.finish()?;
        self.decisions.finish()?;
        Ok(())
    }
}

fn result_columns(rollouts: &[SpatialRollout], first: u32) -> Columns {
    let number = |value: fn(&SpatialRollout) -> u32| rollouts.iter().map(value).collect::<Vec<u32>>();
    let eef: Vec<_> = rollouts
        .iter()
        .map(|r| r.first.observation.grip_site.translation.vector)
        .collect();
    let object: Vec<_> = rollouts.iter().map(|r| r.first.observation.object).collect();
    let columns = Columns::new(&tables::SPATIAL_RESULTS)
        .u32("episode", (first..first + rollouts.len() as u32).collect())
        .u32("seed", number(|r| r.start.seed))
        .bool("success", rollouts.iter().map(SpatialRollout::success).collect())
        .u32("steps", number(|r| r.steps.len() as u32))
        .u32("decisions", number(|r| r.decisions.len() as u32))
        .u32("losses", number(losses))
        .u32("banned", number(|r| r.decisions.last().map_or(0, |d| d.banned)))
        .u32(
            "demos",
            number(|r| {
                let followed: BTreeSet<u32> = r.decisions.iter().filter_map(|d| Some(d.choice?.demo)).collect();
                followed.len() as u32
            }),
        )
        .f64("eef_x", eef.iter().map(|p| p.x).collect())
        .f64("eef_y", eef.iter().map(|p| p.y).collect())
        .f64("eef_z", eef.iter().map(|p| p.z).collect());
    pose_columns(columns, "object", &object).f64_list("state", rollouts.iter().map(|r| r.first.state.as_slice()))
}

fn step_columns(rollouts: &[SpatialRollout]) -> Columns {
    let rows = || {
        rollouts
            .iter()
            .flat_map(|r| r.steps.iter().enumerate().map(|(i, s)| (r.start.seed, i as u32, s)))
    };
    let of = |value: &dyn Fn(&StepRecord<Space>) -> f64| rows().map(|(_, _, s)| value(s)).collect::<Vec<f64>>();
    let poses = |value: fn(&StepRecord<Space>) -> Isometry3<f64>| rows().map(|(_, _, s)| value(s)).collect::<Vec<_>>();
    let mut columns = Columns::new(&tables::SPATIAL_STEPS)
        .u32("seed", rows().map(|(seed, ..)| seed).collect())
        .u32("step", rows().map(|(_, step, _)| step).collect());
    for (k, axis) in ["x", "y", "z"].into_iter().enumerate() {
        columns = columns
            .f64(&format!("action_{axis}"), of(&|s| s.action.goal.translation.vector[k]))
            .f64(
                &format!("action_r{axis}"),
                of(&|s| s.action.goal.rotation.scaled_axis()[k]),
            );
    }
    columns = columns.f64("gripper", of(&|s| s.action.gripper));
    columns = pose_columns(columns, "eef", &poses(|s| s.after.observation.grip_site));
    columns = pose_columns(columns, "object", &poses(|s| s.after.observation.object));
    columns = columns
        .f64("finger_0", of(&|s| s.after.observation.fingers[0]))
        .f64("finger_1", of(&|s| s.after.observation.fingers[1]))
        .bool("success", rows().map(|(_, _, s)| s.after.success).collect())
        .u32("decision", rows().map(|(_, _, s)| s.decision).collect())
        .text("phase", rows().map(|(_, _, s)| s.phase.as_str()));
    pose_columns(columns, "seen", &poses(|s| s.seen.unwrap_or_else(Isometry3::identity)))
}

fn decision_columns(rollouts: &[SpatialRollout], names: &DemoNames) -> Columns {
    let rows = || {
        rollouts
            .iter()
            .flat_map(|r| r.decisions.iter().enumerate().map(|(i, d)| (r.start.seed, i as u32, d)))
    };
    let number = |value: fn(&SpatialDecision) -> u32| rows().map(|(_, _, d)| value(d)).collect::<Vec<u32>>();
    let poses = |value: fn(&SpatialDecision) -> Isometry3<f64>| rows().map(|(_, _, d)| value(d)).collect::<Vec<_>>();
    let chosen = |value: fn(&SpatialChoice) -> u32| {
        rows()
            .map(|(_, _, d)| d.choice.as_ref().map(value))
            .collect::<Vec<Option<u32>>>()
    };
    let measured = |value: &dyn Fn(&SpatialChoice) -> f64| {
        rows()
            .map(|(_, _, d)| d.choice.as_ref().map(value))
            .collect::<Vec<Option<f64>>>()
    };
    let mut columns = Columns::new(&tables::SPATIAL_DECISIONS)
        .u32("seed", rows().map(|(seed, ..)| seed).collect())
        .u32("decision", rows().map(|(_, i, _)| i).collect())
        .u32("step", number(|d| d.step))
        .text("kind", rows().map(|(_, _, d)| d.kind.as_str()))
        .text("mode", rows().map(|(_, _, d)| d.mode.as_str()));
    columns = pose_columns(columns, "query_eef", &poses(|d| d.eef));
    columns = pose_columns(columns, "query_object", &poses(|d| d.object));
    columns = columns
        .f64(
            "finger_separation",
            rows().map(|(_, _, d)| (d.fingers[0] - d.fingers[1]).abs()).collect(),
        )
        .u32_or_null("demo", chosen(|c| c.demo))
        .u32_or_null("demo_frame", chosen(|c| c.demo_frame))
        .u32_or_null("demo_end", chosen(|c| c.demo_end))
        .u32_or_null("compared", chosen(|c| c.compared))
        .f64_or_null("d_q", measured(&|c| c.d_q))
        .f64_or_null("d_o", measured(&|c| c.d_o))
        .f64_or_null("d_e", measured(&|c| c.d_e));
    for (k, axis) in ["x", "y", "z"].into_iter().enumerate() {
        columns = columns
            .f64_or_null(&format!("delta_{axis}"), measured(&|c| c.delta.translation.vector[k]))
            .f64_or_null(
                &format!("delta_r{axis}"),
                measured(&|c| c.delta.rotation.scaled_axis()[k]),
            );
    }
    columns = columns
        .f64_or_null("symmetry_turn", measured(&|c| c.turn))
        .u32_or_null("replay_steps", chosen(|c| c.replay_steps));
    pose_columns(columns, "set_point", &poses(|d| d.set_point))
        .bool("bridge", rows().map(|(_, _, d)| d.bridge).collect())
        .u32("banned", number(|d| d.banned))
        .text("reason", rows().map(|(_, _, d)| d.reason(names)))
        .text_or_null(
            "demo_name",
            rows().map(|(_, _, d)| d.choice.and_then(|c| names.get(c.demo))),
        )
}
