//! Parsing of the attributes that describe how demonstrations were recorded.

use std::borrow::Cow;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use serde_json::Value;
use thiserror::Error;

use crate::conventions::ActionKind;

/// Reasons why an attribute cannot be used.
#[derive(Debug, Clone, PartialEq, Eq, Error)]
pub enum EnvArgsError {
    /// The text is not JSON.
    #[error("the attribute {attribute} is not valid JSON: {reason}")]
    Json {
        /// `env_args` or `env_info`.
        attribute: &'static str,
        /// The parser's message.
        reason: String,
    },
    /// The JSON lacks the environment's name.
    #[error("the attribute {attribute} has no env_name, so the task is unknown")]
    NoName {
        /// `env_args` or `env_info`.
        attribute: &'static str,
    },
    /// An entry has an invalid value.
    #[error("the attribute {attribute} has {entry} = {found}, which must be {need}")]
    Entry {
        /// `env_args` or `env_info`.
        attribute: &'static str,
        /// Name of the entry.
        entry: &'static str,
        /// Its value.
        found: String,
        /// Description of the valid values.
        need: &'static str,
    },
}

/// The controller of the arm as the file declares it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Controller {
    /// Type of the controller, for example `OSC_POSE` or `JOINT_POSITION`.
    pub kind: Option<String>,
    /// Minimum command of each axis (3 translations, 3 rotations).
    pub input_min: [f64; 6],
    /// Maximum command of each axis.
    pub input_max: [f64; 6],
    /// Motion that the minimum command means, in metres and radians per step, or `None` if it is not declared.
    pub output_min: Option<[f64; 6]>,
    /// Motion that the maximum command means, in metres and radians per step, or `None` if it is not declared.
    pub output_max: Option<[f64; 6]>,
    /// Declared kind of actions, from `control_delta` (1.4) or `input_type` (1.5). It proves nothing, because converters leave it
    /// unchanged.
    pub declared: Option<ActionKind>,
    /// `world` or `base` (1.5 only).
    pub input_ref_frame: Option<String>,
    /// Stiffness of translations, or `None` if it is not declared.
    pub kp: Option<f64>,
    /// Damping ratio of translations (`damping_ratio`, or `damping` in older versions), or `None` if it is not declared.
    pub damping_ratio: Option<f64>,
}

/// The declarations of a file. Everything except the name of the environment may be missing.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct EnvArgs {
    /// robosuite's name of the environment, e.g. `PickPlaceCan`.
    pub env_name: String,
    /// robosuite's version, e.g. `1.4.1`.
    pub env_version: Option<String>,
    /// Names of the robots, e.g. `Panda`.
    pub robots: Vec<String>,
    /// Actions per second.
    pub control_freq: Option<f64>,
    /// Controller of the first arm.
    pub controller: Option<Controller>,
    /// robomimic's number for the type of the environment: 1 for robosuite, 2 for gym (also in Isaac Lab's files). `None` in raw
    /// files.
    pub kind: Option<i64>,
}

impl EnvArgs {
    /// Parses robomimic's attribute `env_args` of `/data`.
    ///
    /// # Errors
    /// If the text is not JSON, has no `env_name`, or an entry that is used has the wrong type.
    pub fn parse(json: &str) -> Result<Self, EnvArgsError> {
        let attribute = "env_args";
        let value = read(attribute, json)?;
        let version = string(&value["env_version"]);
        let env = Self::from_parts(attribute, string(&value["env_name"]), version, &value["env_kwargs"])?;
        Ok(Self {
            kind: value["type"].as_i64(),
            ..env
        })
    }

    /// Parses the attributes of a raw robosuite file: `env`, `env_info` and `repository_version` of `/data`.
    ///
    /// # Errors
    /// The same as [`EnvArgs::parse`].
    pub fn parse_raw(
        env: Option<&str>,
        env_info: Option<&str>,
        repository_version: Option<&str>,
    ) -> Result<Self, EnvArgsError> {
        let attribute = "env_info";
        let value = env_info.map_or(Ok(Value::Null), |json| read(attribute, json))?;
        let name = env.map(str::to_owned).or_else(|| string(&value["env_name"]));
        Self::from_parts(attribute, name, repository_version.map(str::to_owned), &value)
    }

    fn from_parts(
        attribute: &'static str,
        name: Option<String>,
        env_version: Option<String>,
        kwargs: &Value,
    ) -> Result<Self, EnvArgsError> {
        let env_name = name
            .filter(|name| !name.is_empty())
            .ok_or(EnvArgsError::NoName { attribute })?;
        let robots = match &kwargs["robots"] {
            Value::String(robot) => vec![robot.clone()],
            Value::Array(robots) => robots.iter().filter_map(string).collect(),
            _ => Vec::new(),
        };
        let control_freq = match &kwargs["control_freq"] {
            Value::Null => None,
            value => match value.as_f64().filter(|freq| freq.is_finite() && *freq > 0.0) {
                Some(freq) => Some(freq),
                None => return entry(attribute, "control_freq", value, "a number above zero"),
            },
        };
        let configs = match &kwargs["controller_configs"] {
            Value::Array(configs) => configs.first().unwrap_or(&Value::Null),
            value => value,
        };
        let controller = match configs {
            Value::Object(_) => Some(controller(attribute, configs)?),
            _ => None,
        };
        Ok(Self {
            env_name,
            env_version,
            robots,
            control_freq,
            controller,
            kind: None,
        })
    }

    /// Whether robomimic's environment type declares an environment that is not robosuite's.
    #[must_use]
    pub fn is_foreign(&self) -> bool {
        self.kind.is_some_and(|kind| kind != ROBOSUITE)
    }

    /// Whether the robot is a Panda that starts in robosuite's own pose. LIBERO resets its Panda to another pose.
    #[must_use]
    pub fn resets_panda(&self) -> bool {
        let panda = self.robots.iter().all(|robot| robot == "Panda");
        panda && !self.env_name.to_ascii_lowercase().starts_with("libero")
    }

    /// Whether the controller reads deltas in the frame of the robot's base, as declared: since robosuite 1.5, unless it says
    /// otherwise.
    #[must_use]
    pub fn declares_base_frame(&self) -> bool {
        let declared = self
            .controller
            .as_ref()
            .and_then(|controller| controller.input_ref_frame.as_deref());
        match declared {
            Some(frame) => frame == "base",
            None => self.version().is_some_and(|version| version >= (1, 5)),
        }
    }

    /// The same declaration with a controller that accepts commands of twice the range with the same scale. Deltas that were
    /// rotated from the axes of a base to those of the world can exceed the range of one axis.
    #[must_use]
    pub fn with_wider_commands(&self) -> Self {
        let twice = |numbers: [f64; 6]| numbers.map(|number| 2.0 * number);
        let controller = self.controller.clone().map(|controller| Controller {
            input_min: twice(controller.input_min),
            input_max: twice(controller.input_max),
            output_min: controller.output_min.map(twice),
            output_max: controller.output_max.map(twice),
            ..controller
        });
        Self {
            controller,
            ..self.clone()
        }
    }

    /// Major and minor number of the declared robosuite version, or `None` if it is missing or not a version.
    #[must_use]
    pub fn version(&self) -> Option<(u32, u32)> {
        let mut parts = self.env_version.as_deref()?.trim_start_matches('v').split('.');
        Some((parts.next()?.parse().ok()?, parts.next()?.parse().ok()?))
    }
}

/// robomimic's number for robosuite's environments (`EnvType.ROBOSUITE_TYPE`).
const ROBOSUITE: i64 = 1;

/// Converts the output of Python's `json` module to standard JSON: `NaN`, `Infinity` and `-Infinity`, which that module writes for
/// such numbers, become `null`. No entry that is used here may have such a value.
fn as_json(text: &str) -> Cow<'_, str> {
    const WORDS: [&str; 3] = ["-Infinity", "Infinity", "NaN"];
    if !WORDS.iter().any(|word| text.contains(word)) {
        return Cow::Borrowed(text);
    }
    let mut json = String::with_capacity(text.len());
    let (mut rest, mut quoted) = (text, false);
    while let Some(letter) = rest.chars().next() {
        let word = WORDS.iter().find(|word| !quoted && rest.starts_with(**word));
        let taken = match (word, letter) {
            (Some(word), _) => {
                json.push_str("null");
                rest = &rest[word.len()..];
                continue;
            }
            // Take the escaped character as well: an escaped quote does not end a string.
            (None, '\\') if quoted => rest.chars().take(2).map(char::len_utf8).sum(),
            (None, '"') => {
                quoted = !quoted;
                1
            }
            (None, letter) => letter.len_utf8(),
        };
        json.push_str(&rest[..taken]);
        rest = &rest[taken..];
    }
    Cow::Owned(json)
}

/// Parses the JSON of an attribute.
fn read(attribute: &'static str, json: &str) -> Result<Value, EnvArgsError> {
    serde_json::from_str(&as_json(json)).map_err(|error| EnvArgsError::Json {
        attribute,
        reason: if json.trim_start().starts_with("{'") {
            "it is the text of a Python dict, not the output of json.dumps".to_owned()
        } else {
            error.to_string()
        },
    })
}

fn string(value: &Value) -> Option<String> {
    value.as_str().map(str::to_owned)
}

/// The error for an entry with an invalid value, which is shortened to 60 characters.
fn entry<T>(
    attribute: &'static str,
    entry: &'static str,
    found: &Value,
    need: &'static str,
) -> Result<T, EnvArgsError> {
    let mut found = found.to_string();
    if found.chars().count() > 60 {
        found = found.chars().take(60).chain("...".chars()).collect();
    }
    Err(EnvArgsError::Entry {
        attribute,
        entry,
        found,
        need,
    })
}

/// Parses the controller's configuration: flat in robosuite 1.4, in `body_parts.right` (or the only part) in 1.5.
fn controller(attribute: &'static str, configs: &Value) -> Result<Controller, EnvArgsError> {
    let parts = ["body_parts", "body_parts_controller_configs"].map(|name| &configs[name]);
    let parts = parts
        .into_iter()
        .find(|parts| parts.is_object())
        .unwrap_or(&Value::Null);
    let arm = match parts {
        Value::Object(table) => [parts.get("right"), parts.get("arms").and_then(|arms| arms.get("right"))]
            .into_iter()
            .flatten()
            .next()
            .or_else(|| {
                table
                    .values()
                    .find(|part| string(&part["type"]).is_some_and(|kind| kind.starts_with("OSC")))
            })
            .or_else(|| table.values().next())
            .unwrap_or(configs),
        _ => configs,
    };
    let kind = string(&arm["type"]);
    let limit = |name: &'static str| six(attribute, name, &arm[name]);
    let declared = match (arm["control_delta"].as_bool(), arm["input_type"].as_str()) {
        (_, Some("absolute")) | (Some(false), None) => Some(ActionKind::Absolute),
        (_, Some("delta")) | (Some(true), None) => Some(ActionKind::Delta),
        _ => None,
    };
    Ok(Controller {
        kind,
        input_min: limit("input_min")?.unwrap_or([-1.0; 6]),
        input_max: limit("input_max")?.unwrap_or([1.0; 6]),
        output_min: limit("output_min")?,
        output_max: limit("output_max")?,
        declared,
        input_ref_frame: string(&arm["input_ref_frame"]),
        kp: first_number(&arm["kp"]),
        damping_ratio: first_number(&arm["damping_ratio"]).or_else(|| first_number(&arm["damping"])),
    })
}

/// The value if it is a number, or the first number of an array.
fn first_number(value: &Value) -> Option<f64> {
    value
        .as_array()
        .and_then(|values| values.first())
        .unwrap_or(value)
        .as_f64()
}

/// Six numbers, or one number for all six axes. Returns `None` if nothing is declared or the controller has another number of
/// axes.
fn six(attribute: &'static str, name: &'static str, value: &Value) -> Result<Option<[f64; 6]>, EnvArgsError> {
    match value {
        Value::Null => Ok(None),
        Value::Number(number) => Ok(number.as_f64().map(|number| [number; 6])),
        Value::Array(values) => {
            let numbers: Option<Vec<f64>> = values.iter().map(Value::as_f64).collect();
            match numbers {
                Some(numbers) => Ok(numbers.try_into().ok()),
                None => entry(attribute, name, value, "an array of numbers"),
            }
        }
        _ => entry(attribute, name, value, "a number or an array of six numbers"),
    }
}
