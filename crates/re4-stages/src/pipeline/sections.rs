//! Tables of the pipeline file up to the index.

use std::borrow::Cow;
use std::path::PathBuf;

use re4_encoder::EncoderConfig;
use re4_geometry::Pose2;
use re4_ingest::pusht::PushtConventions;
use re4_ingest::{OnBad, Selection};
use re4_robosuite::conventions::Settings as Conventions;
use re4_sim::GOAL;
use re4_task::Camera;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Raw dataset to `episodes`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct IngestSection {
    /// Folder or zip file of the Push-T zarr store, or HDF5 file of the robosuite tasks: absolute, or looked for below
    /// `RE4_DATA`, below `data` and in the current folder.
    pub source: PathBuf,
    /// robosuite tasks: name of the filter key below `/mask` whose demonstrations are taken, such as `train`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub filter: Option<String>,
    /// robosuite tasks: body of the manipulated object, where the task does not say it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub object: Option<String>,
    /// robosuite tasks: JSON text that stands for the file's attribute `env_args`, where it has none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub env_args: Option<String>,
    /// robosuite tasks: another file of the same demonstrations whose actions are of the other kind (delta or absolute);
    /// converted actions are compared with them. Looked for as the source is.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub compare: Option<PathBuf>,
    /// robosuite tasks: cameras whose images are taken, such as `["agentview"]`; all of the file by default.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub cameras: Option<Vec<String>>,
    /// robosuite tasks: conventions of the file that are stated, because its data cannot prove them.
    #[serde(default)]
    pub conventions: Conventions,
    /// Push-T: what the numbers of the dataset mean, where it is not what those of the original dataset do.
    #[serde(default, skip_serializing_if = "PushtConventions::is_default")]
    pub pusht: PushtConventions,
    /// Whether the images are ingested too.
    #[serde(default = "yes")]
    pub images: bool,
    /// Cameras whose images are drawn by the simulator's own renderer from the recorded states, for a dataset without
    /// images: `image` (Push-T); `agentview`, `robot0_eye_in_hand` (robosuite tasks, 84 x 84).
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub render: Vec<Camera>,
    /// Which episodes to take.
    #[serde(default)]
    pub select: Selection,
    /// What to do with a demonstration that cannot be read, or that contradicts the others: `refuse` the dataset, or
    /// `leave_out` that demonstration. `audit` always leaves it out, and reports it.
    #[serde(default, skip_serializing_if = "is_default")]
    pub on_bad: OnBad,
}

/// Whether a setting need not be written.
fn is_default<T: Default + PartialEq>(value: &T) -> bool {
    *value == T::default()
}

/// Where object poses come from.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct PoseSection {
    /// Source of the poses that are indexed and that the policy sees.
    pub source: PoseSource,
    /// For `log_polar`: whether the block's outline is aligned with the image after the paper's closed-form estimate.
    #[serde(default = "yes")]
    #[schemars(extend("only_with" = { "pose.source": "log_polar" }))]
    pub refine: bool,
    /// For `log_polar`: goal pose of the task as x and y in px and theta in rad, which calibrates the anchor. Push-T's own by
    /// default.
    #[serde(default = "goal")]
    #[schemars(extend("only_with" = { "pose.source": "log_polar" }))]
    pub goal: [f64; 3],
    /// For `encoder`: the encoder and how it is trained; the paper's settings by default.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub encoder: Option<EncoderConfig>,
}

impl PoseSection {
    /// The encoder and how it is trained, where poses come from one.
    pub fn encoder(&self) -> Cow<'_, EncoderConfig> {
        match &self.encoder {
            Some(config) => Cow::Borrowed(config),
            None => Cow::Owned(EncoderConfig::default()),
        }
    }

    /// The goal pose, world frame.
    pub fn goal(&self) -> Pose2 {
        let [x, y, theta] = self.goal;
        Pose2::new(x, y, theta)
    }
}

/// Source of object poses.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum PoseSource {
    /// The pose recorded in the dataset is the pose; nothing is trained.
    Recorded,
    /// The pose is estimated from the images in closed form: centroid of the block's colour, angle by the log-polar
    /// transform.
    LogPolar,
    /// The pose is what an encoder says of the image that was trained on the demonstrations' images and end-effector poses
    /// (robosuite's tasks).
    Encoder,
}

/// `episodes` and `modes` to `index`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct IndexSection {
    /// Push-T: longest chunk searchable by outcome, in frames.
    #[serde(default = "longest_chunk")]
    pub longest_chunk: u32,
    /// robosuite tasks: codes of audit checks, such as `missed_grasp`. Frames of a demonstration up to the end of such a finding
    /// are not retrieved.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub leave_out: Vec<String>,
    /// robosuite tasks from images: which of the encoder's estimates stand in the index.
    #[serde(default, skip_serializing_if = "Estimates::is_default")]
    pub estimates: Estimates,
}

/// Which estimates of an encoder stand in an index.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Estimates {
    /// Each frame's own, as in the paper.
    #[default]
    EachFrame,
    /// What the modes make of them: before a grasp the object lies still, at the median of the estimates of these frames; from the
    /// grasp on it moves with the gripper; and after the last release it lies where it was let go.
    ByMode,
}

impl Estimates {
    #[expect(clippy::trivially_copy_pass_by_ref, reason = "serde asks by reference")]
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
