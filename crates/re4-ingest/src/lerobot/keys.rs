//! Which features of a dataset are used for what.

use re4_lerobot::{Content, Feature, Info};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::error::Fault;

/// Names of the features of a LeRobot dataset, as in `meta/info.json`. By default, they are those of `lerobot/pusht`. Features that
/// are optional can be ignored: `reward = ""`.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct LerobotKeys {
    /// State of the robot. Push-T: position of the agent, with or without the pose of the block after it. Default:
    /// `observation.state`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub state: Option<String>,
    /// Actions. Default: `action`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub action: Option<String>,
    /// Push-T: the camera whose images are ingested. Default: `observation.image`, or the only camera.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub image: Option<String>,
    /// Push-T: the eight corners of the block, from which its poses are computed. Default: `observation.environment_state`, if it is
    /// there.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub keypoints: Option<String>,
    /// Push-T: the pose of the block: x, y in px and the angle in rad, world frame. Default: `re4.object_pose`, which `re4-pipe export`
    /// writes, if it is there.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub pose: Option<String>,
    /// Reward of a step. Push-T: the coverage of the goal in the next frame, divided by 0.95 and at most 1, which is a check of the
    /// block's poses. Default: `next.reward`, if it is there.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub reward: Option<String>,
    /// Task `arm`: elements of the state that measure the opening of the gripper: one, or the positions of two fingers. Default:
    /// those with a word such as `gripper`, `finger` or `claw` in their names.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub gripper: Option<Vec<String>>,
    /// Task `arm`: the element of the action that commands the gripper. Default: the only one with such a word in its name; without
    /// names, the last one of an action of the end effector (4 or 7 elements).
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub gripper_command: Option<String>,
    /// Task `arm`: the arm to read of a dataset with two, by the first word of the names of its elements, such as `left`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub arm: Option<String>,
}

impl LerobotKeys {
    /// Whether no setting is given.
    pub fn is_default(&self) -> bool {
        *self == Self::default()
    }

    /// Refuses settings that do not apply to the task.
    pub(crate) fn check(&self, planar: bool) -> Result<(), Fault> {
        let foreign = if planar {
            [
                ("gripper", self.gripper.is_some()),
                ("gripper_command", self.gripper_command.is_some()),
                ("arm", self.arm.is_some()),
            ]
        } else {
            [
                ("keypoints", self.keypoints.is_some()),
                ("image", self.image.is_some()),
                ("pose", self.pose.is_some()),
            ]
        };
        match foreign.iter().find(|(_, there)| *there) {
            None => Ok(()),
            Some((key, _)) if planar => Err(Fault::Lerobot(format!(
                "ingest.lerobot.{key} applies only to the task \"arm\"; remove it"
            ))),
            Some((key, _)) => {
                let cameras = if *key == "image" {
                    ", and name cameras in ingest.cameras"
                } else {
                    ""
                };
                Err(Fault::Lerobot(format!(
                    "ingest.lerobot.{key} applies only to Push-T; remove it{cameras}"
                )))
            }
        }
    }
}

/// A feature to look for.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Wanted<'a> {
    /// Name of the setting.
    pub(crate) setting: &'static str,
    /// Its value, if it is given.
    pub(crate) given: Option<&'a str>,
    /// The name of the feature without the setting.
    pub(crate) default: &'a str,
}

impl Wanted<'_> {
    /// The feature, if it is there and contains numbers. Only a feature that a setting names has to be there.
    ///
    /// # Errors
    /// There is no such feature, or it contains something else.
    pub(crate) fn optional<'i>(&self, info: &'i Info) -> Result<Option<&'i Feature>, Fault> {
        match (self.given, info.feature(self.default)) {
            (Some(""), _) => Ok(None),
            (Some(_), _) => self.required(info).map(Some),
            (None, found) => Ok(found.filter(|feature| feature.content == Content::Numbers)),
        }
    }

    /// The feature.
    ///
    /// # Errors
    /// There is no such feature, or it does not contain numbers.
    pub(crate) fn required<'i>(&self, info: &'i Info) -> Result<&'i Feature, Fault> {
        let name = self.given.unwrap_or(self.default);
        let setting = self.setting;
        match info.feature(name) {
            Some(feature) if feature.content == Content::Numbers => Ok(feature),
            Some(_) => Err(Fault::Lerobot(format!(
                "meta/info.json, key features.{name}: it does not contain numbers; set ingest.lerobot.{setting} to a feature that does{}",
                listed(info)
            ))),
            None => Err(Fault::Lerobot(format!(
                "meta/info.json: there is no feature {name}; set ingest.lerobot.{setting} to the name of the feature{}",
                listed(info)
            ))),
        }
    }
}

/// Maximum number of features in a message.
const LISTED: usize = 20;

/// The features with numbers, as a clause in parentheses.
fn listed(info: &Info) -> String {
    let names: Vec<&str> = info
        .with(Content::Numbers)
        .map(|feature| feature.name.as_str())
        .take(LISTED)
        .collect();
    if names.is_empty() {
        String::new()
    } else {
        format!(" (there are {})", names.join(", "))
    }
}

/// Number of values of a frame.
pub(crate) fn width(feature: &Feature) -> usize {
    feature
        .shape
        .iter()
        .fold(1, |product: usize, &side| product.saturating_mul(side))
}

/// The camera of a planar task: that of the setting, the default, or the only one. `None` if there is none or the choice is open.
///
/// # Errors
/// There is no camera of the name that the setting gives.
pub(crate) fn only_camera(info: &Info, given: Option<&str>, default: &str) -> Result<Option<String>, Fault> {
    let names = cameras(info);
    let owned = |name: &str| Some(name.to_owned());
    match given {
        Some("") => Ok(None),
        Some(name) if names.contains(&name) => Ok(owned(name)),
        Some(name) => Err(Fault::Lerobot(format!(
            "meta/info.json: there is no camera {name}; set ingest.lerobot.image to one of the cameras ({})",
            if names.is_empty() {
                "none".to_owned()
            } else {
                names.join(", ")
            }
        ))),
        None if names.contains(&default) => Ok(owned(default)),
        None => match names.as_slice() {
            [only] => Ok(owned(only)),
            _ => Ok(None),
        },
    }
}

/// Names of the cameras, except depth cameras.
pub(crate) fn cameras(info: &Info) -> Vec<&str> {
    info.features
        .iter()
        .filter(|feature| matches!(feature.content, Content::Images | Content::Video) && !feature.depth)
        .map(|feature| feature.name.as_str())
        .collect()
}
