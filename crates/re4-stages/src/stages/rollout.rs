//! Rollout: `index` and perhaps `scenes` to `rollouts`.

mod budgets;
mod estimators;
mod spatial;

use std::sync::Arc;
use std::time::Instant;

use anyhow::{Context as _, Result};
use re4_artifact::{Artifact, Columns, Facts, Recipe, Stage, Writer, col_f64, col_u32, tables};
use re4_episode::PlanarFrame;
use re4_fault::bail;
use re4_geometry::{Point2, Pose2};
use re4_policy::{Decision, DemoNames, Re4Factory};
use re4_rollout::{Harness, Plane, PushTEnv, Rollout, Source, Start, StepRecord, rollouts};
use re4_sim::{
    AGENT_RADIUS, DAMPING_GAIN, GOAL, PROPORTIONAL_GAIN, ResetOrder, SUBSTEPS, SUCCESS_COVERAGE, TIME_STEP,
    chipmunk_version,
};
use re4_stats::{mean_interval, median, wilson_interval};
use serde_json::{Value, json};

pub use budgets::BUDGET_MEASURES;
pub(crate) use spatial::{Watching, studio};

use self::budgets::Budgets;
use self::estimators::LogPolar;
use crate::inputs::demos::demo_names;
use crate::inputs::estimators::open_estimator;
use crate::inputs::index::open_index;
use crate::inputs::starts::read_starts;
use crate::runner::{Built, Runner};

/// Raised whenever the same input gives other bytes.
const CODE_VERSION: u32 = 5;

type EpisodeRollout = Rollout<Plane, Decision>;

/// Seed of the bootstrap, so that intervals are the same in every run.
const BOOTSTRAP_SEED: u64 = 0;

impl Runner {
    /// The `rollouts` artifact: from the scenes where there are any, from those of the seeds otherwise.
    ///
    /// # Errors
    /// When an input, or a setting of the pipeline, does not allow it; or at Ctrl-C.
    pub fn rollout(
        &self,
        episodes: &Built,
        poses: Option<&Built>,
        index: &Built,
        scenes: Option<&Built>,
    ) -> Result<Built> {
        let section = self.pipeline.rollout()?;
        let policy = section.policy_config();
        let mut config = json!({
            "task": self.pipeline.task,
            "variant": self.pipeline.variant,
            "preset": section.policy,
            "policy": policy,
            "max_steps": section.max_steps,
        });
        extend(&mut config, self.starts_config()?);
        let mut recipe = Recipe::new(Stage::Rollout, CODE_VERSION)
            .config(&config)?
            .input("index", index.artifact.key());
        if let Some(poses) = poses {
            recipe = recipe.input("poses", poses.artifact.key());
        }
        if let Some(scenes) = scenes {
            recipe = recipe.input("scenes", scenes.artifact.key());
        }
        self.build(&recipe, |writer| {
            let opening = Instant::now();
            let knowledge = Arc::new(open_index(&index.artifact, &policy, demo_names(&episodes.artifact)?)?);
            self.notes.note(&format!(
                "{:>10}  index opened in {:.1} ms",
                "rollout",
                1e3 * opening.elapsed().as_secs_f64()
            ));
            let estimator = poses
                .map(|poses| Ok::<_, anyhow::Error>(Arc::new(open_estimator(&poses.artifact, self.pipeline.pose()?)?)))
                .transpose()?;
            let source = |_| match &estimator {
                Some(estimator) => Source::Image {
                    camera: "image".to_owned(),
                    estimator: Box::new(LogPolar::new(estimator)),
                },
                None => Source::Recorded,
            };
            let starts = self.starts(scenes)?;
            let bar = self.notes.progress(starts.len() as u64, "rollouts");
            let going = || {
                bar.inc(1);
                !self.interrupt.requested()
            };
            let harness = Harness {
                env: &|_| Ok(Box::new(PushTEnv::new()?)),
                source: &source,
                max_steps: section.max_steps,
                progress: &going,
            };
            let factory = Re4Factory {
                config: policy.clone(),
                knowledge,
            };
            let mut tables = Tables::begin(writer, factory.knowledge.demos.names())?;
            let mut outcomes = Outcomes::default();
            let mut budgets = Budgets::up_to(section.max_steps);
            // In batches, so that memory does not grow with the number of steps.
            for batch in starts.chunks(BATCH) {
                let episodes = rollouts(&factory, &harness, batch)?;
                outcomes.add(&episodes);
                budgets.add(&episodes);
                tables.write(&episodes)?;
            }
            bar.finish_and_clear();
            tables.finish()?;
            let mut table = writer.table(&tables::BUDGETS)?;
            table.write_columns(budgets.columns())?;
            table.finish()?;
            Ok(Facts {
                summary: self.summary(&outcomes, &episodes.artifact)?,
                warnings: Vec::new(),
            })
        })
    }

    fn starts(&self, scenes: Option<&Built>) -> Result<Vec<Start<Plane>>> {
        if let Some(scenes) = scenes {
            return read_starts(&scenes.artifact);
        }
        let section = self.pipeline.rollout()?;
        let seeds = section.seeds.as_ref().context("no seeds and no scenes to start from")?;
        let start = |&seed: &u32| Start::from_seed(section.seed_scheme, section.reset, seed);
        Ok(seeds.as_slice().iter().map(start).collect())
    }

    /// What the starts follow from, beside the `scenes` artifact.
    fn starts_config(&self) -> Result<Value> {
        let section = self.pipeline.rollout()?;
        Ok(match &self.pipeline.scenes {
            Some(scenes) => json!({ "scenes": scenes, "reset": ResetOrder::PoseIsPose }),
            None => json!({ "seeds": section.seeds, "seed_scheme": section.seed_scheme, "reset": section.reset }),
        })
    }

    fn summary(&self, outcomes: &Outcomes, episodes: &Artifact) -> Result<Value> {
        let section = self.pipeline.rollout()?;
        let mut protocol = json!({
            "dataset": episodes.manifest().source,
            "dataset_blake3": episodes.manifest().source_blake3,
            "demonstrations": episodes.manifest().config,
            "max_steps": section.max_steps,
            "measure": "greatest value over the steps of an episode, mean over episodes; score = min(coverage / 0.95, 1)",
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
        Ok(json!({
            "rollouts": outcomes.score.len(),
            "metrics": outcomes.metrics(),
            "medians": {
                "score_scaled": median(&outcomes.score),
                "coverage_raw": median(&outcomes.coverage),
                "iou": median(&outcomes.iou),
                "steps": median(&outcomes.steps),
            },
            "protocol": protocol,
        }))
    }
}

/// Adds the fields of one object to another.
fn extend(object: &mut Value, more: Value) {
    if let (Value::Object(object), Value::Object(more)) = (object, more) {
        object.extend(more);
    }
}

/// Scenes rolled out before their rows are written.
const BATCH: usize = 1024;

#[derive(Default)]
struct Outcomes {
    score: Vec<f64>,
    coverage: Vec<f64>,
    iou: Vec<f64>,
    steps: Vec<f64>,
    successes: u64,
}

impl Outcomes {
    fn add(&mut self, episodes: &[EpisodeRollout]) {
        for episode in episodes {
            self.score.push(episode.maximum(|s| s.score));
            self.coverage.push(episode.maximum(|s| s.coverage));
            self.iou.push(episode.maximum(|s| s.iou));
            self.steps.push(episode.steps.len() as f64);
            self.successes += u64::from(episode.success());
        }
    }

    fn metrics(&self) -> Value {
        let mean = |values: &[f64]| mean_interval(values, BOOTSTRAP_SEED);
        json!({
            "score_scaled_mean": mean(&self.score),
            "coverage_raw_mean": mean(&self.coverage),
            "iou_mean": mean(&self.iou),
            "success_rate": wilson_interval(self.successes, self.score.len() as u64),
        })
    }
}

/// Metrics that a `rollouts` artifact states.
pub fn metrics(artifact: &Artifact) -> Value {
    artifact
        .manifest()
        .summary
        .get("metrics")
        .cloned()
        .unwrap_or(Value::Null)
}

struct Tables<'a> {
    names: &'a DemoNames,
    results: re4_artifact::TableWriter,
    steps: re4_artifact::TableWriter,
    decisions: re4_artifact::TableWriter,
    episodes: u32,
}

impl<'a> Tables<'a> {
    fn begin(writer: &Writer, names: &'a DemoNames) -> Result<Self> {
        Ok(Self {
            names,
            results: writer.table(&tables::RESULTS)?,
            steps: writer.table(&tables::STEPS)?,
            decisions: writer.table(&tables::DECISIONS)?,
            episodes: 0,
        })
    }

    fn write(&mut self, episodes: &[EpisodeRollout]) -> Result<()> {
        self.results.write_columns(result_columns(episodes, self.episodes))?;
        self.episodes += episodes.len() as u32;
        self.steps.write_columns(step_columns(episodes))?;
        self.decisions.write_columns(decision_columns(episodes, self.names))?;
        Ok(())
    }

    fn finish(self) -> Result<()> {
        self.results.finish()?;
        self.steps.finish()?;
        self.decisions.finish()?;
        Ok(())
    }
}

fn result_columns(episodes: &[EpisodeRollout], first: u32) -> Columns {
    let of = |value: fn(&EpisodeRollout) -> f64| episodes.iter().map(value).collect::<Vec<f64>>();
    Columns::new(&tables::RESULTS)
        .u32("episode", (first..first + episodes.len() as u32).collect())
        .u32("seed", episodes.iter().map(|e| e.start.seed).collect())
        .f64("agent_x", of(|e| e.first.observation.agent.x))
        .f64("agent_y", of(|e| e.first.observation.agent.y))
        .f64("block_x", of(|e| e.first.observation.block.x))
        .f64("block_y", of(|e| e.first.observation.block.y))
        .f64("block_theta", of(|e| e.first.observation.block.theta))
        .f64("contacts", of(|e| f64::from(e.first.contacts)))
        .f64("coverage_max", of(|e| e.maximum(|s| s.coverage)))
        .f64("iou_max", of(|e| e.maximum(|s| s.iou)))
        .f64("score_max", of(|e| e.maximum(|s| s.score)))
        .f64(
            "coverage_final",
            of(|e| e.steps.last().map_or(e.first.coverage, |s| s.after.coverage)),
        )
        .u32("steps", episodes.iter().map(|e| e.steps.len() as u32).collect())
        .bool("success", episodes.iter().map(EpisodeRollout::success).collect())
        .u32("decisions", episodes.iter().map(|e| e.decisions.len() as u32).collect())
}

fn step_columns(episodes: &[EpisodeRollout]) -> Columns {
    let rows = || {
        episodes
            .iter()
            .flat_map(|e| e.steps.iter().enumerate().map(|(i, s)| (e.start.seed, i as u32, s)))
    };
    let of = |value: fn(&StepRecord<Plane>) -> f64| rows().map(|(_, _, s)| value(s)).collect::<Vec<f64>>();
    let told = |value: fn(Pose2) -> f64| {
        rows()
            .map(|(_, _, s)| {
                s.asked
                    .object
                    .filter(|told| told.flag.is_some())
                    .map(|told| value(told.pose))
            })
            .collect::<Vec<_>>()
    };
    Columns::new(&tables::STEPS)
        .u32("seed", rows().map(|(seed, ..)| seed).collect())
        .u32("step", rows().map(|(_, step, _)| step).collect())
        .f64("action_x", of(|s| s.action.x))
        .f64("action_y", of(|s| s.action.y))
        .f64("eef_x", of(|s| s.after.observation.agent.x))
        .f64("eef_y", of(|s| s.after.observation.agent.y))
        .f64("object_x", of(|s| s.after.observation.block.x))
        .f64("object_y", of(|s| s.after.observation.block.y))
        .f64("object_theta", of(|s| s.after.observation.block.theta))
        .f64("contacts", of(|s| f64::from(s.after.contacts)))
        .f64("coverage", of(|s| s.after.coverage))
        .f64("iou", of(|s| s.after.iou))
        .f64("score", of(|s| s.after.score))
        .u32("decision", rows().map(|(_, _, s)| s.decision).collect())
        .text("phase", rows().map(|(_, _, s)| s.phase.as_str()))
        .f64_or_null("observed_object_x", told(|p| p.x))
        .f64_or_null("observed_object_y", told(|p| p.y))
        .f64_or_null("observed_object_theta", told(|p| p.theta))
        .f64_or_null(
            "pose_confidence",
            rows()
                .map(|(_, _, s)| s.asked.object.and_then(|told| told.confidence))
                .collect(),
        )
        .text_or_null(
            "pose_flag",
            rows().map(|(_, _, s)| s.asked.object.and_then(|told| told.flag)),
        )
}

fn decision_columns(episodes: &[EpisodeRollout], names: &DemoNames) -> Columns {
    let rows = || {
        episodes
            .iter()
            .flat_map(|e| e.decisions.iter().enumerate().map(|(i, d)| (e.start.seed, i as u32, d)))
    };
    let number = |value: fn(&Decision) -> u32| rows().map(|(_, _, d)| value(d)).collect::<Vec<u32>>();
    let of = |value: fn(&Decision) -> f64| rows().map(|(_, _, d)| value(d)).collect::<Vec<f64>>();
    Columns::new(&tables::DECISIONS)
        .u32("seed", rows().map(|(seed, ..)| seed).collect())
        .u32("decision", rows().map(|(_, i, _)| i).collect())
        .u32("step", number(|d| d.step))
        .text("mode", rows().map(|(_, _, d)| d.mode.as_str()))
        .text(
            "selector",
            rows().map(|(_, _, d)| if d.d_q.is_some() { "two_stage" } else { "outcome" }),
        )
        .f64("query_eef_x", of(|d| d.eef.x))
        .f64("query_eef_y", of(|d| d.eef.y))
        .f64("query_object_x", of(|d| d.object.x))
        .f64("query_object_y", of(|d| d.object.y))
        .f64("query_object_theta", of(|d| d.object.theta))
        .u32("demo", number(|d| d.demo))
        .u32("demo_frame", number(|d| d.demo_frame))
        .u32("demo_end", number(|d| d.demo_end))
        .u32("compared", number(|d| d.compared))
        .f64_or_null("d_q", rows().map(|(_, _, d)| d.d_q).collect())
        .f64_or_null("d_o", rows().map(|(_, _, d)| d.d_o).collect())
        .f64("delta_x", of(|d| d.delta.x))
        .f64("delta_y", of(|d| d.delta.y))
        .f64("delta_theta", of(|d| d.delta.theta))
        .f64("set_point_x", of(|d| d.set_point.x))
        .f64("set_point_y", of(|d| d.set_point.y))
        .text("plan", rows().map(|(_, _, d)| d.plan_kind.as_str()))
        .u32("plan_steps", number(|d| d.plan_steps))
        .u32("plan_nodes", number(|d| d.plan_nodes))
        .f64_list(
            "plan_path",
            rows().map(|(_, _, d)| d.plan_path.iter().flat_map(|p| [p.x, p.y]).collect::<Vec<_>>()),
        )
        .u32("replay_steps", number(|d| d.replay_steps))
        .f64("predicted_object_x", of(|d| d.predicted_object.x))
        .f64("predicted_object_y", of(|d| d.predicted_object.y))
        .f64("predicted_object_theta", of(|d| d.predicted_object.theta))
        .f64("predicted_coverage", of(|d| d.predicted_coverage))
        .text("reason", rows().map(|(_, _, d)| d.reason(names)))
        .text_or_null("demo_name", rows().map(|(_, _, d)| names.get(d.demo)))
}

/// Reads the rollouts of an artifact back: the state before each action, the action, and the contact points counted in
/// the step that led to the state. Rollouts without steps are left out.
///
/// # Errors
/// When the tables cannot be read, or the steps end too early.
pub fn read_rollouts(artifact: &Artifact) -> Result<Vec<Vec<PlanarFrame>>> {
    let results = artifact.table(&tables::RESULTS)?.read_all()?;
    let steps = artifact.table(&tables::STEPS)?.read_all()?;
    let start = |name| col_f64(&results, name);
    let starts = [
        start("agent_x")?,
        start("agent_y")?,
        start("block_x")?,
        start("block_y")?,
        start("block_theta")?,
    ];
    let first_contacts = start("contacts")?;
    let step = |name| col_f64(&steps, name);
    let after = [
        step("eef_x")?,
        step("eef_y")?,
        step("object_x")?,
        step("object_y")?,
        step("object_theta")?,
    ];
    let (action_x, action_y, contacts) = (step("action_x")?, step("action_y")?, step("contacts")?);
    let mut rollouts = Vec::new();
    let mut row = 0;
    for (i, (&seed, &count)) in col_u32(&results, "seed")?
        .iter()
        .zip(col_u32(&results, "steps")?)
        .enumerate()
    {
        let end = row + count as usize;
        if end > action_x.len() {
            bail!(
                "cannot read {}: table steps ends in the rollout of seed {seed}", artifact.path().display();
                "build it again"
            );
        }
        let (mut state, mut contact) = (starts.map(|column| column[i]), first_contacts[i]);
        let mut frames = Vec::with_capacity(end - row);
        for at in row..end {
            let [eef_x, eef_y, x, y, theta] = state;
            frames.push(PlanarFrame {
                eef: Point2::new(eef_x, eef_y),
                object: Pose2::new(x, y, theta),
                action: Point2::new(action_x[at], action_y[at]),
                contacts: contact,
            });
            (state, contact) = (after.map(|column| column[at]), contacts[at]);
        }
        row = end;
        if !frames.is_empty() {
            rollouts.push(frames);
        }
    }
    Ok(rollouts)
}
