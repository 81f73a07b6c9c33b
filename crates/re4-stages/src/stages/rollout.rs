//! Rollout: a policy, and what it was made from, to `rollouts`.

mod budgets;
mod estimators;
mod plane;
mod space;

use anyhow::{Result, bail};
use re4_artifact::{Artifact, Stage, Writer};
use re4_geometry::spatial::Symmetry;
use re4_policy::kinds::{Inputs, Settings};
use re4_rollout::{Batch, Harness, MakeEnv, MakeSource, Recorded, Start};
use serde_json::{Value, json};

use crate::inputs::demos::demo_names;
use crate::pipeline::Policy;
use crate::runner::{Built, Runner};

pub use budgets::BudgetRow;
pub use plane::read_rollouts;
pub(crate) use space::{MakeEstimator, Watching, scene_renderer};

/// Raised whenever the same input gives other bytes.
const CODE_VERSION: u32 = 7;

/// Starts rolled out before their rows are written, so that memory does not grow with the number of steps.
const BATCH: usize = 128;

/// What rollouts were made from.
pub(crate) struct Made<'a> {
    /// The demonstrations.
    pub(crate) episodes: &'a Built,
    /// What estimates the object's pose from images, where something does.
    pub(crate) poses: Option<&'a Built>,
    /// The scenes, where rollouts do not start from seeds.
    pub(crate) scenes: Option<&'a Built>,
    /// What the policy opens.
    pub(crate) inputs: &'a [Built],
}

impl Made<'_> {
    /// All of it, in the order in which it was made.
    fn all(&self) -> impl Iterator<Item = &Built> {
        let own = [Some(self.episodes), self.poses, self.scenes];
        own.into_iter().flatten().chain(self.inputs)
    }
}

/// A policy and what it is rolled out in.
struct Play<'a, 'e, D: Recorded> {
    policy: &'a dyn Settings<D>,
    symmetry: Symmetry,
    env: &'a MakeEnv<'a, 'e, D>,
    source: &'a MakeSource<'a, D>,
}

impl Runner {
    /// Runs every stage up to the rollouts. The answer holds the scenes, too, where rollouts start from some.
    ///
    /// # Errors
    /// When an input, or a setting of the pipeline, does not allow it; or at Ctrl-C.
    pub fn roll_out(&self) -> Result<(Built, Option<Built>)> {
        let (policy, _) = (self.pipeline.policy()?, self.pipeline.rollout()?);
        let planar = self.pipeline.task.is_planar();
        // Before ingest, which can take minutes.
        self.require_simulator("roll out")?;
        let episodes = self.ingest()?;
        let modes = self.segment(&episodes)?;
        let poses = if planar {
            self.train_pose(&episodes)?
        } else {
            self.train_spatial(&episodes, &modes)?
        };
        let mut inputs = Vec::new();
        for stage in policy.inputs() {
            inputs.push(match stage {
                Stage::Index if planar => self.index(&episodes, &modes, poses.as_ref())?,
                Stage::Index => self.index_spatial(&episodes, &modes, poses.as_ref())?,
                other => bail!("no policy is opened with what {} makes", other.as_str()),
            });
        }
        let scenes = if planar { self.scenes(&episodes)? } else { None };
        let made = Made {
            episodes: &episodes,
            poses: poses.as_ref(),
            scenes: scenes.as_ref(),
            inputs: &inputs,
        };
        let built = match policy {
            Policy::Plane(policy) => self.rollout_plane(policy, &made)?,
            Policy::Space(policy) => self.rollout_space(policy, &made)?,
        };
        Ok((built, scenes))
    }

    /// Rolls out from the starts, and writes the tables of every domain and policy. `add` gets all rows, batch after batch.
    fn record<D: Recorded>(
        &self,
        play: &Play<'_, '_, D>,
        made: &Made<'_>,
        starts: &mut dyn ExactSizeIterator<Item = Start<D>>,
        writer: &Writer,
        add: &mut dyn FnMut(&Batch<D>),
    ) -> Result<()> {
        let inputs: Vec<(Stage, &Artifact)> = made.inputs.iter().map(|built| (built.stage, &built.artifact)).collect();
        let opened = play.policy.open(&Inputs {
            artifacts: &inputs,
            names: demo_names(&made.episodes.artifact)?,
            symmetry: play.symmetry,
        })?;
        let bar = self.notes.progress(starts.len() as u64, "rollouts");
        let going = || {
            bar.inc(1);
            !self.interrupt.requested()
        };
        let harness = Harness {
            env: play.env,
            source: play.source,
            max_steps: self.pipeline.rollout()?.max_steps,
            progress: &going,
        };
        let mut recording = opened.begin(writer)?;
        let (mut results, mut steps, mut decisions) = (writer.rows()?, writer.rows()?, writer.rows()?);
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
        }
        bar.finish_and_clear();
        recording.finish()?;
        results.finish()?;
        steps.finish()?;
        decisions.finish()?;
        Ok(())
    }

    /// What the protocol of rollouts says of the demonstrations, with what a domain adds.
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

    /// What the key of rollouts depends on beside its inputs, with what a domain adds.
    fn rollout_config(&self, more: Value) -> Result<Value> {
        let mut config = json!({
            "task": self.pipeline.task,
            "variant": self.pipeline.variant,
            "policy": self.pipeline.policy()?,
            "max_steps": self.pipeline.rollout()?.max_steps,
        });
        extend(&mut config, more);
        Ok(config)
    }
}

/// Adds the fields of one object to another.
fn extend(object: &mut Value, more: Value) {
    if let (Value::Object(object), Value::Object(more)) = (object, more) {
        object.extend(more);
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
