//! The stage `rollout`: makes `rollouts` from a policy and the artifacts that it needs.

mod budgets;
mod curate;
mod estimators;
mod influence;
mod live;
mod plane;
mod space;

use anyhow::{Context as _, Result, bail};
use re4_artifact::{Artifact, ArtifactSummary, Recipe, Stage, Writer};
use re4_geometry::spatial::Symmetry;
use re4_policy::kinds::{Inputs, Settings};
use re4_rollout::{ActTimes, Batch, Harness, MakeEnv, MakeSource, Opened, Recorded, Start};
use re4_stats::Durations;
use serde_json::{Map, Value, json};

use crate::inputs::demos::demo_names;
use crate::inputs::simulators::simulator_of;
use crate::parts::{Lazy, parts_of};
use crate::pipeline::Policy;
use crate::runner::{Built, Runner};

pub use budgets::BudgetRow;
pub use curate::{Curated, Curation};
pub use influence::{Checked, Influenced, Judge};
pub use live::{AnyLivePolicy, LivePolicy, open_policy};
pub use plane::read_rollouts;
pub(crate) use space::{ImageObserver, MakeEstimator, scene_renderer};

/// Increase it whenever the same input gives different bytes.
const CODE_VERSION: u32 = 9;

/// Number of rollouts whose rows are held in memory before they are written.
const BATCH: usize = 128;

/// The artifacts that rollouts are made from.
pub(crate) struct RolloutArtifacts<'a> {
    /// The `episodes` artifact.
    pub(crate) episodes: &'a Built,
    /// The `encoder` artifact, if a trained encoder estimates object poses.
    pub(crate) encoder: Option<&'a Built>,
    /// The `poses` artifact, if object poses are estimated from images.
    pub(crate) poses: Option<&'a Built>,
    /// The `scenes` artifact, if rollouts do not start from seeds.
    pub(crate) scenes: Option<&'a Built>,
    /// The artifacts that the policy opens.
    pub(crate) inputs: &'a [Built],
}

impl RolloutArtifacts<'_> {
    /// All artifacts, in the order in which they were made.
    fn all(&self) -> impl Iterator<Item = &Built> {
        let own = [Some(self.episodes), self.encoder, self.poses, self.scenes];
        own.into_iter().flatten().chain(self.inputs)
    }
}

/// A policy with the environments and the sources of object poses of its rollouts.
struct RolloutSetup<'a, 'e, D: Recorded> {
    policy: &'a dyn Settings<D>,
    symmetry: Symmetry,
    env: &'a MakeEnv<'a, 'e, D>,
    source: &'a MakeSource<'a, D>,
}

impl Runner {
    /// Runs all stages up to the rollouts. Returns the `rollouts` artifact and, if rollouts start from scenes, the `scenes`
    /// artifact.
    ///
    /// # Errors
    /// If an input cannot be read, a setting does not fit the input, or the run is interrupted.
    pub fn roll_out(&self) -> Result<(Built, Option<Built>)> {
        let (built, scenes) = self.with_artifacts(&|policy, artifacts| match policy {
            Policy::Plane(policy) => self.rollout_plane(policy, artifacts),
            Policy::Space(policy) => self.rollout_space(policy, artifacts),
        })?;
        Ok((built, scenes))
    }

    /// Runs all stages that rollouts need, and then `make` with their artifacts. Returns its result and, if rollouts start from
    /// scenes, the `scenes` artifact.
    pub(crate) fn with_artifacts<R>(
        &self,
        make: &dyn Fn(&Policy, &RolloutArtifacts<'_>) -> Result<R>,
    ) -> Result<(R, Option<Built>)> {
        // A missing table [rollout] is reported before the first stage runs.
        let (policy, _) = (self.pipeline.policy()?, self.pipeline.rollout()?);
        let planar = self.pipeline.task.is_planar();
        // Before ingest, which can take minutes.
        self.require_simulator("roll out")?;
        let episodes = self.ingest()?;
        if !planar {
            // Training an encoder takes hours, and the file is known now.
            simulator_of(&episodes.artifact)?;
        }
        let modes = self.segment(&episodes)?;
        let encoder = if planar {
            None
        } else {
            self.train_encoder(&episodes, &modes)?
        };
        let poses = if planar {
            self.train_pose(&episodes)?
        } else {
            self.estimate_poses(&episodes, &modes, encoder.as_ref())?
        };
        let mut inputs: Vec<Built> = Vec::new();
        for stage in policy.inputs() {
            inputs.push(match stage {
                Stage::Index if planar => self.index(&episodes, &modes, poses.as_ref())?,
                Stage::Index => self.index_spatial(&episodes, &modes, poses.as_ref())?,
                Stage::Train => {
                    let index = inputs.iter().find(|built| built.stage == Stage::Index);
                    let index = index.context("a policy that is trained opens the index first")?;
                    self.train_policy(policy, &episodes, index)?
                }
                other => bail!(
                    "policies cannot be opened from the artifact of stage {}",
                    other.as_str()
                ),
            });
        }
        let scenes = if planar { self.scenes(&episodes)? } else { None };
        let artifacts = RolloutArtifacts {
            episodes: &episodes,
            encoder: encoder.as_ref(),
            poses: poses.as_ref(),
            scenes: scenes.as_ref(),
            inputs: &inputs,
        };
        let made = make(policy, &artifacts)?;
        Ok((made, scenes))
    }

    /// Opens the policy.
    fn opened<D: Recorded>(
        &self,
        setup: &RolloutSetup<'_, '_, D>,
        artifacts: &RolloutArtifacts<'_>,
    ) -> Result<Box<dyn Opened<D>>> {
        let inputs: Vec<(Stage, &Artifact)> = artifacts
            .inputs
            .iter()
            .map(|built| (built.stage, &built.artifact))
            .collect();
        Ok(setup.policy.open(&Inputs {
            artifacts: &inputs,
            episodes: &artifacts.episodes.artifact,
            task: self.pipeline.task.robosuite(),
            names: demo_names(&artifacts.episodes.artifact)?,
            symmetry: setup.symmetry,
        })?)
    }

    /// Rolls out from `starts` and writes the tables that all domains and policies have. `first` is the number of the first rollout.
    /// Calls `add` with each batch of rows.
    fn record<D: Recorded>(
        &self,
        setup: &RolloutSetup<'_, '_, D>,
        opened: &dyn Opened<D>,
        first: u32,
        starts: &mut dyn ExactSizeIterator<Item = Start<D>>,
        writer: &Writer,
        add: &mut dyn FnMut(&Batch<D>),
    ) -> Result<()> {
        let bar = self.notes.progress(starts.len() as u64, "rollouts");
        // Called after every rollout; false stops the harness.
        let going = || {
            bar.inc(1);
            !self.interrupt.requested()
        };
        let times = ActTimes::default();
        let harness = Harness {
            env: setup.env,
            source: setup.source,
            max_steps: self.pipeline.rollout()?.max_steps,
            conditions: self.pipeline.rollout()?.conditions(),
            progress: &going,
            times: &times,
        };
        let mut recording = opened.begin(writer, first)?;
        let (mut results, mut steps, mut decisions) = (writer.rows()?, writer.rows()?, writer.rows()?);
        let mut worlds = self
            .pipeline
            .rollout()?
            .has_worlds()
            .then(|| writer.rows())
            .transpose()?;
        loop {
            let starts: Vec<Start<D>> = starts.take(BATCH).collect();
            if starts.is_empty() {
                break;
            }
            let batch = recording.roll_out(&harness, &starts)?;
            add(&batch);
            results.extend(batch.results)?;
            steps.extend(batch.steps)?;
            decisions.extend(batch.decisions)?;
            if let Some(worlds) = &mut worlds {
                worlds.extend(batch.worlds)?;
            }
        }
        bar.finish_and_clear();
        recording.finish()?;
        results.finish()?;
        steps.finish()?;
        decisions.finish()?;
        if let Some(worlds) = worlds {
            worlds.finish()?;
        }
        self.measured("actions", spread(&times.actions()));
        self.measured("decisions", spread(&times.decisions()));
        Ok(())
    }

    /// Number of parts of the rollouts; `None` if they start from scenes, whose number is not known.
    pub(crate) fn parts_of_rollouts(&self) -> Result<Option<u32>> {
        let in_part = if self.pipeline.task.is_planar() {
            plane::ROLLOUTS_IN_PART
        } else {
            space::ROLLOUTS_IN_PART
        };
        let seeds = self.pipeline.rollout()?.seeds.as_ref();
        Ok(seeds.map(|seeds| parts_of(seeds.as_slice().len(), in_part)))
    }

    /// Makes a `rollouts` artifact in parts of `in_part` rollouts. `finish` gets the parts, writes the tables that describe all rollouts,
    /// and returns the summary.
    fn record_parts<D: Recorded>(
        &self,
        (recipe, setup): (&Recipe, &RolloutSetup<'_, '_, D>),
        artifacts: &RolloutArtifacts<'_>,
        starts: &[Start<D>],
        in_part: usize,
        finish: impl Fn(&[Artifact], &Writer) -> Result<ArtifactSummary>,
    ) -> Result<Built> {
        let known = Lazy::new();
        let make = |writer: &Writer, part: u32| {
            let opened = known.get(|| self.opened(setup, artifacts))?;
            let first = part as usize * in_part;
            let own = &starts[first..starts.len().min(first + in_part)];
            self.record(
                setup,
                &**opened,
                first as u32,
                &mut own.iter().cloned(),
                writer,
                &mut |_| {},
            )?;
            Ok(ArtifactSummary::default())
        };
        self.build_parts(recipe, parts_of(starts.len(), in_part), make, |parts, writer| {
            finish(parts, writer)
        })
    }

    /// The protocol in the summary of rollouts: the demonstrations, the maximum number of steps, and the domain's own entries.
    fn protocol(&self, episodes: &Artifact, more: Value) -> Result<Value> {
        let manifest = episodes.manifest();
        let mut protocol = json!({
            "dataset": manifest.source,
            "dataset_blake3": manifest.source_blake3,
            "demonstrations": manifest.config,
            "max_steps": self.pipeline.rollout()?.max_steps,
        });
        extend(&mut protocol, more);
        Ok(protocol)
    }

    /// The settings that the key of rollouts depends on besides its inputs: those of all domains, and the domain's own entries.
    fn rollout_config(&self, more: Value) -> Result<Value> {
        let mut config = json!({
            "task": self.pipeline.task,
            "variant": self.pipeline.variant,
            "policy": self.pipeline.policy()?,
            "max_steps": self.pipeline.rollout()?.max_steps,
        });
        extend(&mut config, more);
        extend(&mut config, Value::Object(self.conditions_config()?));
        Ok(config)
    }

    /// The conditions of rollouts that are set. Conditions that are not set have no entry, so that they do not change keys.
    fn conditions_config(&self) -> Result<Map<String, Value>> {
        let section = self.pipeline.rollout()?;
        let mut config = Map::new();
        if let Some(goal) = section.goal {
            config.insert("goal".to_owned(), json!(goal));
        }
        if let (Some(noise), true) = (&section.noise, self.pipeline.task.is_planar()) {
            config.insert("noise".to_owned(), json!(noise));
        }
        if let Some(disturbance) = &section.disturbance {
            config.insert("disturbance".to_owned(), json!(disturbance));
        }
        if section.latency != 0 {
            config.insert("latency".to_owned(), json!(section.latency));
        }
        Ok(config)
    }
}

/// Wall times in microseconds, for the record of a run.
fn spread(times: &Durations) -> Value {
    json!({
        "count": times.count(),
        "mean_us": times.mean(),
        "p50_us": times.quantile(0.5),
        "p99_us": times.quantile(0.99),
        "max_us": times.maximum(),
    })
}

/// Adds the fields of one object to another.
fn extend(object: &mut Value, more: Value) {
    if let (Value::Object(object), Value::Object(more)) = (object, more) {
        object.extend(more);
    }
}

/// The metrics in the summary of a `rollouts` artifact; null if it has none.
pub fn metrics(artifact: &Artifact) -> Value {
    artifact
        .manifest()
        .summary
        .get("metrics")
        .cloned()
        .unwrap_or(Value::Null)
}
