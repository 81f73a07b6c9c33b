//! The pipeline file, which describes one experiment stage by stage.

mod checks;
mod goal;
mod load;
mod rollout;
mod schema;
mod sections;
mod seeds;
mod source;
mod task;

use anyhow::Result;
use re4_audit::AuditConfig;
use re4_fault::{Fault, OrFault as _, fault};
use re4_scenes::ScenesConfig;
use re4_segment::SegmentConfig;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

pub(crate) use goal::Goal;
pub use load::read_pipeline;
pub(crate) use load::{one_line, parse, placed, resolve, suggestion};
pub use re4_task::{Camera, Task};
pub use rollout::{NoiseSection, Policy, RolloutSection};
pub use schema::schema;
pub use sections::{Estimates, IndexSection, IngestSection, PoseSection, PoseSource};
pub use seeds::Seeds;
pub use source::SourcePaths;
pub(crate) use source::label;
pub use task::Variant;

/// One experiment: the dataset, how it is segmented and indexed, and how the policy is rolled out.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Pipeline {
    /// The task of the experiment.
    pub task: Task,
    /// What the policy observes.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub variant: Option<Variant>,
    /// How the raw dataset is converted to the artifact `episodes`.
    pub ingest: IngestSection,
    /// How demonstrations are segmented into modes: `episodes` to `modes`.
    pub segment: SegmentConfig,
    /// Thresholds of the audit: `episodes` and `modes` to `audit`.
    #[serde(default)]
    pub audit: AuditConfig,
    /// Where object poses come from.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub pose: Option<PoseSection>,
    /// How frames are indexed for retrieval: `episodes` and `modes` to `index`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub index: Option<IndexSection>,
    /// How start scenes are chosen: `episodes` to `scenes`. Leave it out if rollouts start from the scenes of seeds.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub scenes: Option<ScenesConfig>,
    /// The policy that is rolled out.
    #[serde(skip)]
    pub policy: Option<Policy>,
    /// How the policy is rolled out: `index` to `rollouts`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub rollout: Option<RolloutSection>,
    /// One sentence for each setting of the file, or of the command line, that has no effect.
    #[serde(skip)]
    pub without_effect: Vec<String>,
}

impl Pipeline {
    /// Refuses the task `arm` for a command that needs object poses or a simulation.
    ///
    /// # Errors
    /// If the task is `arm`.
    pub fn needs_object(&self) -> Result<()> {
        if self.task == Task::Arm {
            return Err(Self::no_object().into());
        }
        Ok(())
    }

    fn no_object() -> Fault {
        fault!(
            "a dataset of the task \"arm\" has no object, so it can be audited and segmented, but this command needs object poses";
            "set task to a task with an object, such as \"can\", and give a dataset that has its poses"
        )
    }

    fn missing(&self, table: &str) -> Fault {
        if self.task == Task::Arm {
            return Self::no_object();
        }
        fault!(
            "the pipeline file has no table [{table}], which this command needs";
            "add it, or stop at an earlier stage"
        )
    }

    /// Whether a stage needs MuJoCo and robosuite's meshes.
    pub(crate) fn needs_simulator(&self) -> bool {
        !self.task.is_planar() && (self.rollout.is_some() || !self.ingest.render.is_empty())
    }

    /// Whether a stage needs a library that renders images of MuJoCo's scenes.
    pub(crate) fn needs_renderer(&self) -> bool {
        let encoder = self
            .pose
            .as_ref()
            .is_some_and(|pose| pose.source == PoseSource::Encoder);
        !self.task.is_planar() && (!self.ingest.render.is_empty() || self.rollout.is_some() && encoder)
    }

    /// The table `[pose]`: where object poses come from.
    ///
    /// # Errors
    /// If the pipeline has no table `[pose]`.
    pub fn pose(&self) -> Result<&PoseSection> {
        self.pose.as_ref().or_fault(|| self.missing("pose"))
    }

    /// The table `[index]`: how the index is built.
    ///
    /// # Errors
    /// If the pipeline has no table `[index]`.
    pub fn index(&self) -> Result<&IndexSection> {
        self.index.as_ref().or_fault(|| self.missing("index"))
    }

    /// The table `[policy]`.
    ///
    /// # Errors
    /// If the pipeline has no table `[policy]`.
    pub fn policy(&self) -> Result<&Policy> {
        self.policy.as_ref().or_fault(|| self.missing("policy"))
    }

    /// The table `[rollout]`: how the policy is rolled out.
    ///
    /// # Errors
    /// If the pipeline has no table `[rollout]`.
    pub fn rollout(&self) -> Result<&RolloutSection> {
        self.rollout.as_ref().or_fault(|| self.missing("rollout"))
    }
}
