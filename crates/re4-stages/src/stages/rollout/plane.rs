//! The stage `rollout` for Push-T.

use std::sync::Arc;

use anyhow::{Context as _, Result};
use re4_artifact::{Artifact, ArtifactSummary, Recipe, Stage, Writer};
use re4_episode::PlanarFrame;
use re4_fault::bail;
use re4_geometry::spatial::Symmetry;
use re4_policy::kinds::{Kinds as _, PlanePolicy};
use re4_rollout::{Batch, Env, Plane, PlaneResultRow, PlaneStepRow, PoseNoise, PushTEnv, Source, Start};
use re4_sim::{
    AGENT_RADIUS, DAMPING_GAIN, GOAL, PROPORTIONAL_GAIN, ResetOrder, SUBSTEPS, SUCCESS_COVERAGE, TIME_STEP,
    chipmunk_version, random_goal,
};
use re4_stats::{mean_interval, median, wilson_interval};
use serde_json::{Value, json};

use super::budgets::{BOOTSTRAP_SEED, Budgets};
use super::estimators::LogPolar;
use super::{CODE_VERSION, RolloutArtifacts, RolloutSetup, extend};
use crate::inputs::estimators::open_estimator;
use crate::inputs::starts::read_starts;
use crate::parts::parts_of;
use crate::pipeline::{Goal, NoiseSection};
use crate::runner::{Built, Runner};

/// Rollouts per part, about 4 MB. Another number gives other files, see [`CODE_VERSION`].
pub(super) const ROLLOUTS_IN_PART: usize = 1024;

impl Runner {
    /// Makes the `rollouts` artifact, or returns the existing one. Rollouts start from `artifacts.scenes` if given, otherwise
    /// from seeds.
    pub(super) fn rollout_plane(&self, policy: &PlanePolicy, artifacts: &RolloutArtifacts<'_>) -> Result<Built> {
        let mut recipe =
            Recipe::new(Stage::Rollout, CODE_VERSION).config(&self.rollout_config(self.starts_config()?)?)?;
        for built in artifacts.all() {
            recipe = recipe.input(built.stage.artifact(), built.artifact.key());
        }
        let starts = self.starts(artifacts.scenes)?;
        let max_steps = self.pipeline.rollout()?.max_steps;
        let finish = |summary: Summary, writer: &Writer| {
            writer.write_rows(summary.budgets.rows())?;
            let mut protocol = json!({
                "measure": "maximum value over the steps of an episode, mean over episodes; score = min(coverage / 0.95, 1)",
                "intervals": "95 %; percentile bootstrap of the mean (10,000 resamples), Wilson for the success rate",
                "success_coverage": SUCCESS_COVERAGE,
                "goal": [GOAL.x, GOAL.y, GOAL.theta],
                "agent_radius": AGENT_RADIUS,
                "proportional_gain": PROPORTIONAL_GAIN,
                "damping_gain": DAMPING_GAIN,
                "physics_steps_per_control_step": SUBSTEPS,
                "physics_time_step_s": TIME_STEP,
                "physics": format!("Chipmunk {}", chipmunk_version()),
            });
            extend(&mut protocol, self.starts_config()?);
            extend(&mut protocol, Value::Object(self.conditions_config()?));
            anyhow::Ok(ArtifactSummary {
                summary: summary.state(&self.protocol(&artifacts.episodes.artifact, protocol)?),
                warnings: Vec::new(),
            })
        };
        if parts_of(starts.len(), ROLLOUTS_IN_PART) == 1 {
            return self.build(&recipe, |writer| {
                let mut summary = Summary::up_to(max_steps);
                let add = &mut |batch: &Batch<Plane>| summary.add(&batch.results, &batch.steps);
                self.with_plane(policy, artifacts, |setup| {
                    let opened = self.opened(setup, artifacts)?;
                    self.record(setup, &*opened, 0, &mut starts.iter().cloned(), writer, add)
                })?;
                finish(summary, writer)
            });
        }
        self.with_plane(policy, artifacts, |setup| {
            self.record_parts(
                (&recipe, setup),
                artifacts,
                &starts,
                ROLLOUTS_IN_PART,
                |parts, writer| {
                    let mut summary = Summary::up_to(max_steps);
                    for part in parts {
                        summary.add(&part.read::<PlaneResultRow>()?, &part.read::<PlaneStepRow>()?);
                    }
                    finish(summary, writer)
                },
            )
        })
    }

    /// Calls `body` with the policy, its environments and its observations.
    pub(super) fn with_plane<R>(
        &self,
        policy: &PlanePolicy,
        artifacts: &RolloutArtifacts<'_>,
        body: impl FnOnce(&RolloutSetup<'_, '_, Plane>) -> Result<R>,
    ) -> Result<R> {
        let estimator = match artifacts.poses {
            Some(poses) => Some(Arc::new(open_estimator(&poses.artifact, self.pipeline.pose()?)?)),
            None => None,
        };
        let env = |_: &Start<Plane>| -> Result<Box<dyn Env<Plane>>, _> { Ok(Box::new(PushTEnv::new()?)) };
        let noise = self.pipeline.rollout()?.noise.filter(NoiseSection::is_noisy);
        let source = |seed| match (&estimator, noise) {
            (Some(estimator), _) => Source::Image {
                camera: "image".to_owned(),
                estimator: Box::new(LogPolar::new(estimator)),
            },
            (None, Some(noise)) => {
                let mut errors = PoseNoise::new(u64::from(seed), noise.translation, noise.rotation);
                Source::Noisy(Box::new(move |pose| errors.perturb_planar(pose)))
            }
            (None, None) => Source::Recorded,
        };
        body(&RolloutSetup {
            policy: policy.settings(),
            symmetry: Symmetry::None,
            env: &env,
            source: &source,
        })
    }

    /// The scenes that the pipeline asks for, with their goals.
    pub(super) fn starts(&self, scenes: Option<&Built>) -> Result<Vec<Start<Plane>>> {
        let starts = self.scenes_of_starts(scenes)?;
        self.with_goals(starts)
    }

    /// The same scenes with the goals that the pipeline asks for.
    pub(super) fn with_goals(&self, mut starts: Vec<Start<Plane>>) -> Result<Vec<Start<Plane>>> {
        let goal = self.pipeline.rollout()?.goal;
        for Start { seed, scene } in &mut starts {
            match goal {
                Some(Goal::Random) => scene.goal = random_goal(*seed, scene.state.arrival(scene.order)),
                Some(Goal::Fixed(goal)) => scene.goal = goal,
                None => {}
            }
        }
        Ok(starts)
    }

    fn scenes_of_starts(&self, scenes: Option<&Built>) -> Result<Vec<Start<Plane>>> {
        if let Some(scenes) = scenes {
            return read_starts(&scenes.artifact);
        }
        let section = self.pipeline.rollout()?;
        let seeds = section.seeds.as_ref().context("no seeds and no scenes to start from")?;
        let start = |&seed: &u32| Start::from_seed(section.seed_scheme, section.reset, seed);
        Ok(seeds.as_slice().iter().map(start).collect())
    }

    /// The settings that determine the start scenes.
    pub(super) fn starts_config(&self) -> Result<Value> {
        let section = self.pipeline.rollout()?;
        Ok(match &self.pipeline.scenes {
            Some(scenes) => json!({ "scenes": scenes, "reset": ResetOrder::PoseIsPose }),
            None => json!({ "seeds": section.seeds, "seed_scheme": section.seed_scheme, "reset": section.reset }),
        })
    }
}

/// Accumulates the summary of rollouts.
struct Summary {
    score: Vec<f64>,
    coverage: Vec<f64>,
    iou: Vec<f64>,
    steps: Vec<f64>,
    successes: u64,
    budgets: Budgets,
}

impl Summary {
    /// An empty summary for rollouts of at most `max_steps` steps.
    fn up_to(max_steps: u32) -> Self {
        Self {
            score: Vec::new(),
            coverage: Vec::new(),
            iou: Vec::new(),
            steps: Vec::new(),
            successes: 0,
            budgets: Budgets::up_to(max_steps),
        }
    }

    /// Adds rollouts and their steps, in the same order.
    fn add(&mut self, results: &[PlaneResultRow], steps: &[PlaneStepRow]) {
        for row in results {
            self.score.push(row.score_max);
            self.coverage.push(row.coverage_max);
            self.iou.push(row.iou_max);
            self.steps.push(f64::from(row.core.steps));
            self.successes += u64::from(row.core.success);
        }
        self.budgets.add(results, steps);
    }

    fn state(&self, protocol: &Value) -> Value {
        let mean = |values: &[f64]| mean_interval(values, BOOTSTRAP_SEED);
        json!({
            "rollouts": self.score.len(),
            "metrics": {
                "score_scaled_mean": mean(&self.score),
                "coverage_raw_mean": mean(&self.coverage),
                "iou_mean": mean(&self.iou),
                "success_rate": wilson_interval(self.successes, self.score.len() as u64),
            },
            "medians": {
                "score_scaled": median(&self.score),
                "coverage_raw": median(&self.coverage),
                "iou": median(&self.iou),
                "steps": median(&self.steps),
            },
            "protocol": protocol,
        })
    }
}

/// Reads the rollouts of an artifact as demonstrations. Each frame has the state before an action, the action, and the number of
/// contact points in the step that ended in the state. Rollouts without steps are skipped.
///
/// # Errors
/// If a table cannot be read, or the tables `steps` and `results` do not match.
pub fn read_rollouts(artifact: &Artifact) -> Result<Vec<Vec<PlanarFrame>>> {
    let results: Vec<PlaneResultRow> = artifact.read()?;
    let steps: Vec<PlaneStepRow> = artifact.read()?;
    let mut rest = steps.as_slice();
    let mut rollouts = Vec::new();
    for row in results {
        let Some((steps, others)) = rest.split_at_checked(row.core.steps as usize) else {
            bail!(
                "cannot read {}: table steps ends within the rollout of seed {}", artifact.path().display(), row.core.seed;
                "delete the artifact and roll out again"
            );
        };
        rest = others;
        let mut state = (row.eef, row.object, row.contacts);
        let frames = steps.iter().map(|step| {
            let (eef, object, contacts) = std::mem::replace(&mut state, (step.eef, step.object, step.contacts));
            PlanarFrame {
                eef,
                object,
                action: step.action,
                contacts,
            }
        });
        rollouts.push(frames.collect::<Vec<_>>());
    }
    rollouts.retain(|frames| !frames.is_empty());
    Ok(rollouts)
}
