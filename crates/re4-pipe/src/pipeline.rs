//! The pipeline file: one experiment, stage by stage.

use std::borrow::Cow;
use std::path::{Path, PathBuf};

use anyhow::{Context as _, Result, bail};
use re4_audit::AuditConfig;
use re4_encoder::EncoderConfig;
use re4_geometry::Pose2;
use re4_geometry::spatial::Symmetry;
use re4_ingest::pusht::PushtConventions;
use re4_ingest::{OnBad, Selection};
use re4_policy::spatial::{
    PoseFilterConfig, SPATIAL_PRESETS, SpatialPolicyConfig, SpatialRecoveryConfig, SpatialReframeConfig,
    SpatialReplanConfig, SpatialReplayConfig, SpatialRetrieveConfig,
};
use re4_policy::{PRESETS, PolicyConfig, ReframeConfig, ReplanConfig, ReplayConfig, RetrieveConfig};
use re4_robosuite::conventions::Settings as Conventions;
use re4_scenes::ScenesConfig;
use re4_segment::SegmentConfig;
use re4_sim::robosuite::{Fidelity, RobosuiteTask};
use re4_sim::{GOAL, ResetOrder, SeedScheme};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use serde_json::{Map, Value, json};

use crate::limits;
use crate::seeds::Seeds;

/// One experiment: which dataset, how it is segmented and indexed, and how the policy is rolled out.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub(crate) struct Pipeline {
    /// Task of the experiment.
    pub(crate) task: TaskName,
    /// What the policy observes.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(crate) variant: Option<Variant>,
    /// Raw dataset to `episodes`.
    pub(crate) ingest: IngestSection,
    /// `episodes` to `modes`.
    pub(crate) segment: SegmentConfig,
    /// `episodes` and `modes` to `audit`.
    #[serde(default)]
    pub(crate) audit: AuditConfig,
    /// Where object poses come from.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(crate) pose: Option<PoseSection>,
    /// `episodes` and `modes` to `index`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(crate) index: Option<IndexSection>,
    /// `episodes` to `scenes`, from which the rollouts then start; absent where they start from seeds.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(crate) scenes: Option<ScenesConfig>,
    /// `index` to `rollouts`, for Push-T.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(crate) rollout: Option<RolloutSection>,
    /// `index` to `rollouts`, for robosuite's tasks. In files it is called `rollout`, too.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(crate) spatial_rollout: Option<SpatialRolloutSection>,
}

impl Pipeline {
    fn missing(table: &str) -> String {
        format!(
            "the pipeline file has no table [{table}], which this command needs; add it, or stop at an earlier stage"
        )
    }

    /// Where object poses come from.
    ///
    /// # Errors
    /// When the pipeline has no table `[pose]`.
    pub(crate) fn pose(&self) -> Result<&PoseSection> {
        self.pose.as_ref().with_context(|| Self::missing("pose"))
    }

    /// How the index is made.
    ///
    /// # Errors
    /// When the pipeline has no table `[index]`.
    pub(crate) fn index(&self) -> Result<&IndexSection> {
        self.index.as_ref().with_context(|| Self::missing("index"))
    }

    /// How the policy is rolled out, for Push-T.
    ///
    /// # Errors
    /// When the pipeline has no table `[rollout]`.
    pub(crate) fn rollout(&self) -> Result<&RolloutSection> {
        self.rollout.as_ref().with_context(|| Self::missing("rollout"))
    }

    /// How the policy is rolled out, for robosuite's tasks.
    ///
    /// # Errors
    /// When the pipeline has no table `[rollout]`.
    pub(crate) fn spatial_rollout(&self) -> Result<&SpatialRolloutSection> {
        self.spatial_rollout.as_ref().with_context(|| Self::missing("rollout"))
    }
}

/// Tasks that this version knows.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub(crate) enum TaskName {
    /// Push-T: a disc pushes a T-shaped block onto a goal pose in the plane.
    PushT,
    /// robosuite's `Lift`: a Panda lifts a cube.
    Lift,
    /// robosuite's `PickPlaceCan`: a Panda carries a can from one bin to another.
    Can,
    /// robosuite's `NutAssemblySquare`: a Panda puts a square nut onto a peg.
    Square,
    /// Any other robosuite environment of one arm with a two-finger gripper; `ingest.object` names the manipulated object.
    Robosuite,
}

impl TaskName {
    /// Whether it takes place in the plane.
    pub(crate) fn is_planar(self) -> bool {
        self == Self::PushT
    }

    /// The task in robosuite's simulator, where there is one.
    pub(crate) fn simulated(self) -> Option<RobosuiteTask> {
        match self {
            Self::Lift => Some(RobosuiteTask::Lift),
            Self::Can => Some(RobosuiteTask::Can),
            Self::Square => Some(RobosuiteTask::Square),
            Self::PushT | Self::Robosuite => None,
        }
    }

    /// Turns after which the manipulated object looks the same: four quarters of a turn for the cube, any turn for the can.
    pub(crate) fn symmetry(self) -> Symmetry {
        self.simulated().map_or(Symmetry::None, symmetry_of)
    }
}

/// Turns after which the object of a task looks the same, in its own frame.
fn symmetry_of(task: RobosuiteTask) -> Symmetry {
    let axis = [0.0, 0.0, 1.0];
    match task {
        RobosuiteTask::Lift => Symmetry::Fold { axis, n: 4 },
        RobosuiteTask::Can => Symmetry::Full { axis },
        RobosuiteTask::Square => Symmetry::None,
    }
}

/// What the policy observes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub(crate) enum Variant {
    /// End-effector state and the object's true pose.
    State,
    /// Pictures, and the end effector's state.
    Image,
}

/// Raw dataset to `episodes`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub(crate) struct IngestSection {
    /// Folder or zip file of the Push-T zarr store, or HDF5 file of the robosuite tasks: absolute, or looked for below
    /// `RE4_DATA`, below `data` and in the current folder.
    pub(crate) source: PathBuf,
    /// robosuite tasks: name of the filter key below `/mask` whose demonstrations are taken, such as `train`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(crate) filter: Option<String>,
    /// robosuite tasks: body of the manipulated object, where the task does not say it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(crate) object: Option<String>,
    /// robosuite tasks: JSON text that stands for the file's attribute `env_args`, where it has none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(crate) env_args: Option<String>,
    /// robosuite tasks: another file of the same demonstrations whose actions are of the other kind (delta or absolute);
    /// converted actions are compared with them. Looked for as the source is.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(crate) compare: Option<PathBuf>,
    /// robosuite tasks: cameras whose pictures are taken, such as `["agentview"]`; all of the file by default.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(crate) cameras: Option<Vec<String>>,
    /// robosuite tasks: conventions of the file that are stated, because its data cannot prove them.
    #[serde(default)]
    pub(crate) conventions: Conventions,
    /// Push-T: what the numbers of the dataset mean, where it is not what those of the original dataset do.
    #[serde(default, skip_serializing_if = "PushtConventions::is_default")]
    pub(crate) pusht: PushtConventions,
    /// Whether the pictures are ingested too.
    #[serde(default = "yes")]
    pub(crate) images: bool,
    /// Cameras whose pictures are drawn by the simulator's own renderer from the recorded states, for a dataset without
    /// pictures: `image` (Push-T); `agentview`, `robot0_eye_in_hand` (robosuite tasks, 84 x 84).
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub(crate) render: Vec<Camera>,
    /// Which episodes to take.
    #[serde(default)]
    pub(crate) select: Selection,
    /// What to do with a demonstration that cannot be read, or that contradicts the others: `refuse` the dataset, or
    /// `leave_out` that demonstration. `audit` always leaves it out, and reports it.
    #[serde(default, skip_serializing_if = "is_default")]
    pub(crate) on_bad: OnBad,
}

/// Whether a setting need not be written.
fn is_default<T: Default + PartialEq>(value: &T) -> bool {
    *value == T::default()
}

/// Cameras of the tasks.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub(crate) enum Camera {
    /// Push-T's only one: the window from above, 96 x 96.
    Image,
    /// robosuite's camera that looks at robot and table from the front, 84 x 84.
    Agentview,
    /// robosuite's camera on the hand, 84 x 84.
    #[serde(rename = "robot0_eye_in_hand")]
    EyeInHand,
}

impl Camera {
    /// Its name in files and tables.
    pub(crate) fn name(self) -> &'static str {
        match self {
            Self::Image => "image",
            Self::Agentview => "agentview",
            Self::EyeInHand => "robot0_eye_in_hand",
        }
    }
}

/// Where object poses come from.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub(crate) struct PoseSection {
    /// Source of the poses that are indexed and that the policy sees.
    pub(crate) source: PoseSource,
    /// For `log_polar`: whether the block's outline is aligned with the picture after the paper's closed-form estimate.
    #[serde(default = "yes")]
    pub(crate) refine: bool,
    /// For `log_polar`: goal pose of the task as x and y in px and theta in rad, which calibrates the anchor. Push-T's own by
    /// default.
    #[serde(default = "goal")]
    pub(crate) goal: [f64; 3],
    /// For `encoder`: the encoder and how it is trained; the paper's settings by default.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(crate) encoder: Option<EncoderConfig>,
}

impl PoseSection {
    /// The encoder and how it is trained, where poses come from one.
    pub(crate) fn encoder(&self) -> Cow<'_, EncoderConfig> {
        match &self.encoder {
            Some(config) => Cow::Borrowed(config),
            None => Cow::Owned(EncoderConfig::default()),
        }
    }

    /// The goal pose, world frame.
    pub(crate) fn goal(&self) -> Pose2 {
        let [x, y, theta] = self.goal;
        Pose2::new(x, y, theta)
    }
}

/// Source of object poses.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub(crate) enum PoseSource {
    /// The pose recorded in the dataset is the pose; nothing is trained.
    Recorded,
    /// The pose is estimated from the pictures in closed form: centroid of the block's colour, angle by the log-polar
    /// transform.
    LogPolar,
    /// The pose is what an encoder says of the picture that was trained on the demonstrations' pictures and end-effector poses
    /// (robosuite's tasks).
    Encoder,
}

/// `episodes` and `modes` to `index`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub(crate) struct IndexSection {
    /// Push-T: longest chunk searchable by outcome, in frames.
    #[serde(default = "longest_chunk")]
    pub(crate) longest_chunk: u32,
    /// robosuite tasks: codes of audit checks, such as `missed_grasp`. Frames of a demonstration up to the end of such a finding
    /// are not retrieved.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub(crate) leave_out: Vec<String>,
    /// robosuite tasks from pictures: which of the encoder's estimates stand in the index.
    #[serde(default, skip_serializing_if = "Estimates::is_default")]
    pub(crate) estimates: Estimates,
}

/// Which estimates of an encoder stand in an index.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub(crate) enum Estimates {
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

/// `index` to `rollouts`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub(crate) struct RolloutSection {
    /// Preset that the policy starts from: `paper`, `re4` or `re2`. The tables below change single settings of it.
    #[schemars(extend("enum" = PRESETS))]
    pub(crate) policy: String,
    /// Seeds of the scenes: a half-open range `"500..600"`, several of them joined by commas, or a list of numbers. Left out
    /// where the pipeline has a table `[scenes]`, and nowhere else.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(crate) seeds: Option<Seeds>,
    /// Whose seeds: which generator makes the scene of a seed.
    #[serde(default = "diffusion_policy")]
    pub(crate) seed_scheme: SeedScheme,
    /// In which order a reset to the scene of a seed sets the block's position and angle. The block of a scene from
    /// `[scenes]` always arrives at the pose that the scene says.
    #[serde(default)]
    pub(crate) reset: ResetOrder,
    /// Control steps an episode lasts at most.
    #[serde(default = "paper_steps")]
    pub(crate) max_steps: u32,
    /// Retrieve.
    pub(crate) retrieve: RetrieveConfig,
    /// Reframe.
    pub(crate) reframe: ReframeConfig,
    /// Replan.
    pub(crate) replan: ReplanConfig,
    /// Replay.
    pub(crate) replay: ReplayConfig,
}

impl RolloutSection {
    /// The policy with all its settings.
    pub(crate) fn policy_config(&self) -> PolicyConfig {
        PolicyConfig {
            retrieve: self.retrieve.clone(),
            reframe: self.reframe,
            replan: self.replan.clone(),
            replay: self.replay.clone(),
        }
    }
}

/// `index` to `rollouts` of robosuite's tasks.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub(crate) struct SpatialRolloutSection {
    /// Preset that the policy starts from: `paper`, `re4` or `re2`. The tables below change single settings of it.
    #[schemars(extend("enum" = SPATIAL_PRESETS))]
    pub(crate) policy: String,
    /// Seeds of the scenes: a half-open range `"500..600"`, several of them joined by commas, or a list of numbers. The scene of
    /// a seed is the one that robosuite draws for it.
    pub(crate) seeds: Seeds,
    /// Control steps an episode lasts at most.
    #[serde(default = "robomimic_steps")]
    pub(crate) max_steps: u32,
    /// Turns after which the object looks the same, in its own frame. By default, with `re4` that of the task's object: four
    /// quarters of a turn for the cube, any turn for the can, none for the nut; with the other presets none. With
    /// `variant = "image"` none either: the frame that the encoder estimates is that of the gripper as it would hold the object,
    /// whose axes are not the object's.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(crate) symmetry: Option<Symmetry>,
    /// Errors that the object poses which the policy is told are given on purpose.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(crate) noise: Option<NoiseSection>,
    /// How closely robosuite is followed: `robosuite`, to the bit, or `fast`.
    #[serde(default)]
    pub(crate) fidelity: Fidelity,
    /// Retrieve.
    pub(crate) retrieve: SpatialRetrieveConfig,
    /// Reframe.
    pub(crate) reframe: SpatialReframeConfig,
    /// Replan: the bridge to the start of a chunk.
    pub(crate) replan: SpatialReplanConfig,
    /// Replay.
    pub(crate) replay: SpatialReplayConfig,
    /// What is done about failure.
    pub(crate) recovery: SpatialRecoveryConfig,
    /// How observed object poses are averaged; every one is taken as it is where the preset has no such table.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(crate) filter: Option<PoseFilterConfig>,
}

/// Errors of the object poses that a policy is told: normal, independent at every control step, drawn by the scene's seed.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub(crate) struct NoiseSection {
    /// Standard deviation along each axis of the world, in metres, 1 at most.
    #[serde(default)]
    pub(crate) translation: f64,
    /// Standard deviation of each component of a rotation vector, in rad, 3.14 at most.
    #[serde(default)]
    pub(crate) rotation: f64,
}

impl SpatialRolloutSection {
    /// The policy with all its settings.
    pub(crate) fn policy_config(&self) -> SpatialPolicyConfig {
        SpatialPolicyConfig {
            retrieve: self.retrieve.clone(),
            reframe: self.reframe.clone(),
            replan: self.replan.clone(),
            replay: self.replay.clone(),
            recovery: self.recovery.clone(),
            filter: self.filter.clone(),
        }
    }

    /// Symmetry of the task's object that the policy uses.
    pub(crate) fn symmetry(&self, task: RobosuiteTask, variant: Option<Variant>) -> Symmetry {
        let usual = if self.policy == "re4" && variant != Some(Variant::Image) {
            symmetry_of(task)
        } else {
            Symmetry::None
        };
        self.symmetry.unwrap_or(usual)
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

fn diffusion_policy() -> SeedScheme {
    SeedScheme::DiffusionPolicy
}

fn paper_steps() -> u32 {
    200
}

fn robomimic_steps() -> u32 {
    400
}

/// Tables of the policy, which the preset fills.
const POLICY_TABLES: [&str; 6] = ["retrieve", "reframe", "replan", "replay", "recovery", "filter"];

/// JSON Schema of the pipeline file: the table `[rollout]` is one for Push-T, or one for robosuite's tasks.
pub(crate) fn schema() -> Value {
    let mut schema = inner_schema();
    if let Some(properties) = schema.get_mut("properties").and_then(Value::as_object_mut) {
        properties.remove(SPATIAL_ROLLOUT);
        properties.insert(
            "rollout".to_owned(),
            json!({
                "description": "`index` to `rollouts`: for Push-T, or for robosuite's tasks.",
                "anyOf": [
                    { "$ref": "#/$defs/RolloutSection" },
                    { "$ref": "#/$defs/SpatialRolloutSection" },
                ],
            }),
        );
    }
    schema
}

/// Name that the table `[rollout]` of robosuite's tasks has inside of this program.
const SPATIAL_ROLLOUT: &str = "spatial_rollout";

/// The schema after `[rollout]` was told apart by task. The policy's own tables need not be complete: the preset fills them.
fn inner_schema() -> Value {
    let mut schema = json!(schemars::schema_for!(Pipeline));
    if let Some(definitions) = schema.get_mut("$defs").and_then(Value::as_object_mut) {
        for name in [
            "RetrieveConfig",
            "ReframeConfig",
            "ReplanConfig",
            "ReplayConfig",
            "SpatialRetrieveConfig",
            "SpatialReframeConfig",
            "SpatialReplanConfig",
            "SpatialReplayConfig",
            "SpatialRecoveryConfig",
            "BanConfig",
            "PoseFilterConfig",
        ] {
            if let Some(definition) = definitions.get_mut(name).and_then(Value::as_object_mut) {
                definition.remove("required");
            }
        }
        for section in ["RolloutSection", "SpatialRolloutSection"] {
            let required = definitions
                .get_mut(section)
                .and_then(|section| section.get_mut("required"))
                .and_then(Value::as_array_mut);
            if let Some(required) = required {
                required.retain(|name| !POLICY_TABLES.iter().any(|table| name == table));
            }
        }
    }
    schema
}

/// Reads a pipeline file and applies `--set` overrides.
///
/// # Errors
/// When the file cannot be read, is not TOML, has an unknown key (named, with the nearest known one) or a value that
/// does not fit.
pub(crate) fn load(path: &Path, overrides: &[String]) -> Result<Pipeline> {
    let text = std::fs::read_to_string(path).with_context(|| {
        format!(
            "cannot read the pipeline file {}; give the path of a TOML file such as pipelines/demo.toml",
            path.display()
        )
    })?;
    parse(&text, path, overrides)
}

/// The pipeline in the text of a file; the path is for messages only.
///
/// # Errors
/// As [`load`], but for reading the file.
pub(crate) fn parse(text: &str, path: &Path, overrides: &[String]) -> Result<Pipeline> {
    let table: toml::Table = text.parse().map_err(|error: toml::de::Error| {
        anyhow::anyhow!(
            "cannot read the pipeline file {}: {}",
            path.display(),
            one_line(text, &error)
        )
    })?;
    let mut document = serde_json::to_value(table).context("cannot represent the pipeline file")?;
    for text in overrides {
        apply(&mut document, text)?;
    }
    let unusable = || format!("cannot use the pipeline file {}", path.display());
    refuse_not_finite(&document, "").with_context(unusable)?;
    tell_rollouts_apart(&mut document).with_context(unusable)?;
    let schema = inner_schema();
    refuse_unknown(&schema, &schema, &document, "").with_context(unusable)?;
    complete_segment(&mut document)?;
    complete_policy(&mut document, "rollout", PRESETS, preset).with_context(unusable)?;
    complete_policy(&mut document, SPATIAL_ROLLOUT, SPATIAL_PRESETS, spatial_preset).with_context(unusable)?;
    let pipeline: Pipeline = serde_path_to_error::deserialize(document).map_err(|error| {
        let place = match error.path().to_string().as_str() {
            "." => String::new(),
            place => format!("{}: ", place.replace(SPATIAL_ROLLOUT, "rollout")),
        };
        let why = in_words(&error.into_inner().to_string());
        anyhow::anyhow!("cannot use the pipeline file {}: {place}{why}", path.display())
    })?;
    limits::check(&pipeline).with_context(unusable)?;
    Ok(pipeline)
}

/// The message with line and column, both counted from 1.
fn one_line(text: &str, error: &toml::de::Error) -> String {
    let message = error.message().replace('\n', "; ");
    let Some(before) = error.span().and_then(|span| text.get(..span.start)) else {
        return message;
    };
    let line = before.matches('\n').count() + 1;
    let column = before.chars().rev().take_while(|c| *c != '\n').count() + 1;
    format!("line {line}, column {column}: {message}")
}

/// The decoder's words without names of Rust types.
fn in_words(message: &str) -> String {
    let mut words = Vec::new();
    let mut rest = message.split(' ').peekable();
    while let Some(word) = rest.next() {
        words.push(match word {
            "struct" if words.last() == Some(&"expected") => {
                rest.next();
                "a table"
            }
            "u32" => "a whole number from 0 to 4294967295",
            "usize" => "a whole number of at least 0",
            "f64" => "a number",
            // Neither TOML nor JSON can say null: it stands for what JSON cannot say.
            "null," => "nan or inf,",
            other => other,
        });
    }
    words.join(" ")
}

/// Most parts of a key on the command line, more than any setting has. Tables inside of tables are walked recursively.
const DEEPEST: usize = 16;

/// Applies one `stage.key=value`; the value is TOML, or a plain string where it is not.
fn apply(document: &mut Value, text: &str) -> Result<()> {
    let Some((path, value)) = text.split_once('=') else {
        bail!("cannot apply --set {text}: write stage.key=value, for instance rollout.seeds=500..600");
    };
    let parsed = format!("value = {value}")
        .parse::<toml::Table>()
        .ok()
        .and_then(|mut table| table.remove("value"))
        .map_or_else(|| Ok(Value::String(value.to_owned())), serde_json::to_value)?;
    let depth = path.split('.').count();
    if depth > DEEPEST {
        bail!(
            "cannot apply --set: the key has {depth} parts, and no setting has more than {DEEPEST}; write stage.key=value"
        );
    }
    let mut at = document;
    for key in path.trim().split('.') {
        if key.is_empty() {
            bail!("cannot apply --set {text}: the key is empty; write stage.key=value");
        }
        if !at.is_object() {
            *at = Value::Object(Map::new());
        }
        let Value::Object(map) = at else { continue };
        at = map.entry(key).or_insert(Value::Null);
    }
    *at = parsed;
    Ok(())
}

/// Gives robosuite's tasks, which are in metres, their own defaults of `[segment]` for what the file leaves out.
fn complete_segment(document: &mut Value) -> Result<()> {
    if document.get("task").and_then(Value::as_str) == Some("pusht") {
        return Ok(());
    }
    let Some(section) = document.get_mut("segment").and_then(Value::as_object_mut) else {
        return Ok(());
    };
    if let Value::Object(defaults) = serde_json::to_value(SegmentConfig::spatial())? {
        for (key, value) in defaults {
            section.entry(key).or_insert(value);
        }
    }
    Ok(())
}

/// Puts the table `[rollout]` of robosuite's tasks where it is read.
fn tell_rollouts_apart(document: &mut Value) -> Result<()> {
    let Some(map) = document.as_object_mut() else {
        return Ok(());
    };
    if map.contains_key(SPATIAL_ROLLOUT) {
        bail!("unknown key {SPATIAL_ROLLOUT}; the table is called rollout for every task");
    }
    let robosuite = map
        .get("task")
        .and_then(Value::as_str)
        .is_some_and(|task| task != "pusht");
    if robosuite && let Some(rollout) = map.remove("rollout") {
        map.insert(SPATIAL_ROLLOUT.to_owned(), rollout);
    }
    Ok(())
}

fn preset(name: &str) -> Option<Result<Value, serde_json::Error>> {
    PolicyConfig::preset(name).map(serde_json::to_value)
}

fn spatial_preset(name: &str) -> Option<Result<Value, serde_json::Error>> {
    SpatialPolicyConfig::preset(name).map(serde_json::to_value)
}

/// Starts from the preset and lets the file's own settings replace single ones.
fn complete_policy(
    document: &mut Value,
    table: &str,
    presets: [&str; 3],
    preset: fn(&str) -> Option<Result<Value, serde_json::Error>>,
) -> Result<()> {
    let Some(rollout) = document.get_mut(table).and_then(Value::as_object_mut) else {
        return Ok(());
    };
    let Some(name) = rollout.get("policy").and_then(Value::as_str) else {
        return Ok(());
    };
    let Some(preset) = preset(name) else {
        bail!(
            "unknown policy {name:?} in rollout.policy{}; the presets are {}",
            suggestion(name, presets),
            presets.join(", ")
        );
    };
    if let Value::Object(sections) = preset? {
        for (section, settings) in sections {
            let own = rollout.remove(&section);
            if let Some(merged) = merge(settings, own) {
                rollout.insert(section, merged);
            }
        }
    }
    Ok(())
}

/// A preset's settings with one's own in their place, table by table. `false` switches an optional table off.
fn merge(preset: Value, own: Option<Value>) -> Option<Value> {
    match (preset, own) {
        (Value::Null, None) => None,
        // An optional setting that is switched off.
        (preset, Some(Value::Bool(false))) if !preset.is_boolean() => None,
        (preset, None) => Some(preset),
        (Value::Object(mut settings), Some(Value::Object(own))) => {
            for (key, value) in own {
                let merged = merge(settings.remove(&key).unwrap_or(Value::Null), Some(value));
                settings.extend(merged.map(|value| (key, value)));
            }
            Some(Value::Object(settings))
        }
        // Not a table: left for the decoder to refuse.
        (_, Some(own)) => Some(own),
    }
}

/// JSON cannot say nan and inf and has null in their place, which an optional setting would take for absence.
fn refuse_not_finite(document: &Value, place: &str) -> Result<()> {
    match document {
        Value::Null => bail!("{place} is nan or inf; give a finite number, or leave it out"),
        Value::Object(map) => map.iter().try_for_each(|(key, value)| {
            let dot = if place.is_empty() { "" } else { "." };
            refuse_not_finite(value, &format!("{place}{dot}{key}"))
        }),
        Value::Array(items) => items.iter().try_for_each(|item| refuse_not_finite(item, place)),
        _ => Ok(()),
    }
}

/// Walks the document along its schema and refuses the first key that the schema does not know.
fn refuse_unknown(root: &Value, schema: &Value, document: &Value, place: &str) -> Result<()> {
    let schema = resolve(root, schema);
    let (Value::Object(map), Some(properties)) = (document, schema.get("properties").and_then(Value::as_object)) else {
        return Ok(());
    };
    for (key, value) in map {
        let path = if place.is_empty() {
            key.clone()
        } else {
            format!("{place}.{key}")
        };
        let shown = path.replace(SPATIAL_ROLLOUT, "rollout");
        match properties.get(key) {
            Some(inner) => refuse_unknown(root, inner, value, &path)?,
            None => bail!(
                "unknown key {shown}{}; known here: {}",
                suggestion(key, known(properties)),
                known(properties).collect::<Vec<_>>().join(", ")
            ),
        }
    }
    Ok(())
}

/// Keys that a file may have.
fn known(properties: &Map<String, Value>) -> impl Iterator<Item = &str> {
    properties
        .keys()
        .map(String::as_str)
        .filter(|key| *key != SPATIAL_ROLLOUT)
}

fn resolve<'a>(root: &'a Value, schema: &'a Value) -> &'a Value {
    // An optional table is one of the table and null.
    let table = schema.get("anyOf").and_then(|schemas| schemas.get(0));
    let schema = table.filter(|schema| schema.get("$ref").is_some()).unwrap_or(schema);
    let target = schema
        .get("$ref")
        .and_then(Value::as_str)
        .and_then(|r| r.strip_prefix('#'));
    target.and_then(|pointer| root.pointer(pointer)).unwrap_or(schema)
}

fn suggestion<'a>(word: &str, known: impl IntoIterator<Item = &'a str>) -> String {
    known
        .into_iter()
        .map(|candidate| (strsim::jaro_winkler(word, candidate), candidate))
        .filter(|(likeness, _)| *likeness > 0.75)
        .max_by(|a, b| a.0.total_cmp(&b.0))
        .map_or_else(String::new, |(_, candidate)| format!(" (did you mean {candidate}?)"))
}
