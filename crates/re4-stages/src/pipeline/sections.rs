//! The tables `[ingest]`, `[pose]` and `[index]` of the pipeline file.

use std::borrow::Cow;
use std::path::PathBuf;

use re4_encoder::EncoderConfig;
use re4_geometry::Pose2;
use re4_index::trim::Trim;
use re4_ingest::lerobot::LerobotKeys;
use re4_ingest::pusht::PushtConventions;
use re4_ingest::robomimic::ArmConfig;
use re4_ingest::{OnBad, Selection};
use re4_robosuite::conventions::Settings as Conventions;
use re4_sim::GOAL;
use re4_task::Camera;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::source::SourcePaths;

/// How the raw dataset is converted to the artifact `episodes`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct IngestSection {
    /// Path of the dataset: the folder or zip file of the Push-T zarr store, the folder of a LeRobot dataset, or the HDF5 file of a
    /// robosuite task. A folder of HDF5 files (`*.hdf5`, `*.h5`), or a list of their paths, is one dataset: see
    /// [Several files](../guides/several-files.md). A relative path is looked up in the folder that `RE4_DATA` names, then in `data`,
    /// then in the current folder.
    pub source: SourcePaths,
    /// robosuite tasks: filter key below `/mask`, such as `train`; LeRobot datasets: name of a split. Only its demonstrations are
    /// ingested.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub filter: Option<String>,
    /// robosuite tasks: name of the manipulated object's body. Only for `task = "robosuite"`; the other tasks define it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub object: Option<String>,
    /// robosuite tasks: JSON text to use for the attribute `env_args` if the file has none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub env_args: Option<String>,
    /// robosuite tasks: another file with the same demonstrations and the other kind of actions (delta or absolute). The
    /// converted actions are compared with those of this file. A relative path is looked up as for `source`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub compare: Option<PathBuf>,
    /// robosuite tasks: cameras whose recorded images are ingested, such as `["agentview"]`. Default: all cameras of the file.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub cameras: Option<Vec<String>>,
    /// robosuite tasks: conventions of the file that its data cannot prove and that are therefore stated here.
    #[serde(default)]
    pub conventions: Conventions,
    /// Push-T: units and conventions of the dataset if they differ from those of the original dataset.
    #[serde(default, skip_serializing_if = "PushtConventions::is_default")]
    pub pusht: PushtConventions,
    /// LeRobot datasets: which features are used for what.
    #[serde(default, skip_serializing_if = "LerobotKeys::is_default")]
    pub lerobot: LerobotKeys,
    /// Task `arm`: which arrays of the dataset are read.
    #[serde(default, skip_serializing_if = "ArmConfig::is_default")]
    pub arm: ArmConfig,
    /// Whether to ingest the images.
    #[serde(default = "yes")]
    pub images: bool,
    /// For datasets without images: cameras whose images are rendered by the simulator from the recorded states. `image` for
    /// Push-T; `agentview` and `robot0_eye_in_hand` for robosuite tasks, at 84 x 84 pixels.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub render: Vec<Camera>,
    /// Which episodes to ingest.
    #[serde(default)]
    pub select: Selection,
    /// What to do with a demonstration that cannot be read or that contradicts the others: `refuse` the dataset, or
    /// `leave_out` that demonstration. `audit` always leaves it out and reports it.
    #[serde(default, skip_serializing_if = "is_default")]
    pub on_bad: OnBad,
}

/// Whether a setting has its default value and is therefore not serialized.
fn is_default<T: Default + PartialEq>(value: &T) -> bool {
    *value == T::default()
}

/// Where object poses come from.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct PoseSection {
    /// Source of the object poses, both of those that are indexed and of those that the policy observes.
    pub source: PoseSource,
    /// For `log_polar`: whether to refine the paper's closed-form estimate by aligning the block's outline with the image.
    #[serde(default = "yes")]
    #[schemars(extend("only_with" = { "pose.source": "log_polar" }))]
    pub refine: bool,
    /// For `log_polar`: goal pose of the task as [x, y, theta] in px, px and rad, world frame. It calibrates the anchor. Default:
    /// Push-T's goal.
    #[serde(default = "goal")]
    #[schemars(extend("only_with" = { "pose.source": "log_polar" }))]
    pub goal: [f64; 3],
    /// For `log_polar`: whether the images were once compressed with loss, as videos are. Default: whether the source says so. Set it for
    /// images that were decoded from a video before they were stored.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schemars(extend("only_with" = { "pose.source": "log_polar" }))]
    pub lossy: Option<bool>,
    /// For `encoder`: the encoder and how it is trained. Default: the preset `re4`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub encoder: Option<EncoderConfig>,
}

impl PoseSection {
    /// Settings of the encoder and its training: those of the file, or the defaults.
    pub fn encoder(&self) -> Cow<'_, EncoderConfig> {
        match &self.encoder {
            Some(config) => Cow::Borrowed(config),
            None => Cow::Owned(EncoderConfig::default()),
        }
    }

    /// The goal pose: position in px, angle in rad, world frame.
    pub fn goal(&self) -> Pose2 {
        let [x, y, theta] = self.goal;
        Pose2::new(x, y, theta)
    }
}

/// Source of object poses.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum PoseSource {
    /// The poses recorded in the dataset. Nothing is trained.
    Recorded,
    /// Push-T: closed-form estimates from the images. The position is the centroid of the block's colour, the angle comes from
    /// the log-polar transform.
    LogPolar,
    /// robosuite tasks: an encoder trained on the demonstrations' images and end-effector poses estimates the object pose.
    Encoder,
}

/// How frames are indexed for retrieval: `episodes` and `modes` to `index`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct IndexSection {
    /// Push-T: length of the longest chunk that can be retrieved by outcome, in frames.
    #[serde(default = "longest_chunk")]
    pub longest_chunk: u32,
    /// robosuite tasks: codes of audit checks, such as `missed_grasp`. In each demonstration, the frames up to the end of the
    /// last finding of these checks are not retrieved.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub leave_out: Vec<String>,
    /// robosuite tasks: what is cut out of the demonstrations, so that it is neither retrieved nor replayed: `idle` stretches, and
    /// `detours` that lead back to an earlier state. Frames near a change of the gripper command are kept.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub trim: Vec<Trim>,
    /// robosuite tasks from images: how the encoder's estimates are stored in the index.
    #[serde(default, skip_serializing_if = "Estimates::is_default")]
    pub estimates: Estimates,
}

/// How the estimates of an encoder are stored in an index.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Estimates {
    /// Each frame has its own estimate, as in the paper.
    #[default]
    EachFrame,
    /// Estimates are combined by mode. Before a grasp the object is at rest, at the median of the estimates of these frames; from
    /// the grasp on it moves with the gripper; after the last release it stays where it was released.
    ByMode,
}

impl Estimates {
    #[expect(clippy::trivially_copy_pass_by_ref, reason = "serde passes a reference")]
    fn is_default(&self) -> bool {
        *self == Self::default()
    }
}

fn yes() -> bool {
    true
}

fn goal() -> [f64; 3] {
    [GOAL.x, GOAL.y, GOAL.theta]
}

fn longest_chunk() -> u32 {
    256
}
