//! `meta/info.json`.

use std::ops::Range;

use serde_json::{Map, Value};

use crate::column::width;
use crate::fault::{Fault, Faults, Kind};
use crate::template::Template;

/// Name of the file.
pub(crate) const INFO: &str = "meta/info.json";

/// Files, or for v2 episodes, of a folder `chunk-000`, if `info.json` does not state it.
const CHUNKS_SIZE: u64 = 1000;

/// The columns that every dataset has, each one number per frame.
pub(crate) const BOOKKEEPING: [&str; 5] = ["timestamp", "frame_index", "episode_index", "index", "task_index"];

/// The version of the format, by the files that are there.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Version {
    /// v2.0 and v2.1: a file per episode. They differ only in statistics, which are not read.
    V2,
    /// v3.0: several episodes per file.
    V3,
}

impl Version {
    /// The patterns of the official writer, for data and videos.
    pub(crate) fn patterns(self) -> (&'static str, &'static str) {
        match self {
            Self::V2 => (
                "data/chunk-{episode_chunk:03d}/episode_{episode_index:06d}.parquet",
                "videos/chunk-{episode_chunk:03d}/{video_key}/episode_{episode_index:06d}.mp4",
            ),
            Self::V3 => (
                "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet",
                "videos/{video_key}/chunk-{chunk_index:03d}/file-{file_index:03d}.mp4",
            ),
        }
    }

    /// The numbers in the names of its files.
    fn numbers(self) -> [&'static str; 2] {
        match self {
            Self::V2 => ["episode_chunk", "episode_index"],
            Self::V3 => ["chunk_index", "file_index"],
        }
    }
}

/// What a feature contains.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Content {
    /// Numbers, also true and false.
    Numbers,
    /// Text.
    Text,
    /// PNG images in the tables of data.
    Images,
    /// Frames of video files.
    Video,
    /// Annotations that are not read.
    Annotations,
}

/// A feature.
#[derive(Debug, Clone, PartialEq)]
pub struct Feature {
    /// Its name.
    pub name: String,
    /// What it contains.
    pub content: Content,
    /// The type as it is stated.
    pub dtype: String,
    /// The shape as it is stated.
    pub shape: Vec<usize>,
    /// Names of its elements; empty if they are not stated, or not one per element.
    pub names: Vec<String>,
    /// Whether it is stated to be a depth map.
    pub depth: bool,
}

impl Feature {
    /// Number of values of a frame.
    pub(crate) fn width(&self) -> usize {
        width(&self.shape)
    }
}

/// The contents of `info.json`.
#[derive(Debug, Clone, PartialEq)]
pub struct Info {
    /// The version by the files.
    pub version: Version,
    /// `codebase_version`; empty if it is not stated.
    pub stated_version: String,
    /// Frames per second.
    pub fps: f64,
    /// The features, in the order of the file.
    pub features: Vec<Feature>,
    /// Number of episodes, if stated.
    pub total_episodes: Option<u64>,
    /// Number of frames, if stated.
    pub total_frames: Option<u64>,
    /// Number of tasks, if stated.
    pub total_tasks: Option<u64>,
    /// Type of the robot, if stated.
    pub robot_type: Option<String>,
    /// Named ranges of episodes. They may exceed the episodes that there are.
    pub splits: Vec<(String, Range<u64>)>,
    /// Files (v3) or episodes (v2) of a folder `chunk-000`.
    pub chunks_size: u64,
    pub(crate) data_path: Template,
    pub(crate) video_path: Template,
}

impl Info {
    /// The features with these contents.
    pub fn with(&self, content: Content) -> impl Iterator<Item = &Feature> {
        self.features.iter().filter(move |feature| feature.content == content)
    }

    /// The feature of a name.
    pub fn feature(&self, name: &str) -> Option<&Feature> {
        self.features.iter().find(|feature| feature.name == name)
    }
}

/// The major version that `codebase_version` states.
///
/// # Errors
/// A version that this reader does not know.
pub(crate) fn stated_major(info: &Map<String, Value>) -> Result<Option<u32>, Fault> {
    let wrong = |what: String, fix: &str| Fault::key(Kind::Format, INFO, "codebase_version", what, fix);
    let convert = "convert it with the scripts of the lerobot package";
    let stated = match info.get("codebase_version") {
        None | Some(Value::Null) => return Ok(None),
        Some(Value::String(stated)) => stated.clone(),
        Some(other) => other.to_string(),
    };
    let major = stated
        .trim_start_matches(['v', 'V'])
        .split('.')
        .next()
        .and_then(|major| major.parse().ok());
    match major {
        Some(major @ (2 | 3)) => Ok(Some(major)),
        Some(0 | 1) => Err(wrong(
            format!("it is {stated}, but v2.0, v2.1 and v3.0 can be read"),
            convert,
        )),
        _ => Err(wrong(
            format!("it is {stated}, but v2.0, v2.1 and v3.0 can be read"),
            "correct it, or convert the dataset to v3.0",
        )),
    }
}

/// Reads keys and collects faults.
struct Keys<'a> {
    map: &'a Map<String, Value>,
    faults: Faults,
}

impl Keys<'_> {
    fn wrong(&mut self, kind: Kind, key: &str, what: impl Into<String>, fix: &str) {
        self.faults.push(Fault::key(kind, INFO, key, what, fix));
    }

    fn present(&self, key: &str) -> Option<&Value> {
        self.map.get(key).filter(|value| !value.is_null())
    }

    /// A count.
    fn count(&mut self, key: &str) -> Option<u64> {
        let value = self.present(key)?.clone();
        // Some converters write counts as floating-point numbers.
        let whole = value
            .as_f64()
            .filter(|number| number.fract() == 0.0 && (0.0..9.0e15).contains(number));
        let count = value.as_u64().or(whole.map(|number| number as u64));
        if count.is_none() {
            self.wrong(
                Kind::Type,
                key,
                format!("it is {value}, not a count"),
                "write a whole number",
            );
        }
        count
    }

    fn text(&mut self, key: &str) -> Option<String> {
        let value = self.present(key)?.clone();
        let text = value.as_str().map(str::to_owned);
        if text.is_none() {
            self.wrong(Kind::Type, key, format!("it is {value}, not text"), "write text");
        }
        text
    }

    fn template(&mut self, key: &str, version: Version, default: &str) -> Option<Template> {
        let text = self.text(key).unwrap_or_else(|| default.to_owned());
        match Template::parse(&text, &version.numbers()) {
            Ok(template) => Some(template),
            Err(why) => {
                let fix = format!("write {default}");
                self.wrong(
                    Kind::Value,
                    key,
                    format!("\"{text}\" is not a pattern of file names: {why}"),
                    &fix,
                );
                None
            }
        }
    }

    fn fps(&mut self) -> Option<f64> {
        let fix = "write the number of frames per second";
        let Some(value) = self.present("fps").cloned() else {
            self.wrong(Kind::Missing, "fps", "it is missing", fix);
            return None;
        };
        let fps = value.as_f64().filter(|fps| fps.is_finite() && *fps > 0.0);
        if fps.is_none() {
            self.wrong(Kind::Value, "fps", format!("it is {value}, not a positive number"), fix);
        }
        fps
    }

    fn features(&mut self) -> Vec<Feature> {
        let fix = "restore the description of the columns";
        let features = match self.present("features").cloned() {
            None => {
                self.wrong(Kind::Missing, "features", "it is missing", fix);
                return Vec::new();
            }
            Some(Value::Object(features)) => features,
            Some(_) => {
                self.wrong(Kind::Type, "features", "it is not an object", fix);
                return Vec::new();
            }
        };
        features
            .iter()
            .filter_map(|(name, feature)| self.feature(name, feature))
            .collect()
    }

    fn feature(&mut self, name: &str, feature: &Value) -> Option<Feature> {
        let key = |part: &str| format!("features.{name}{part}");
        if name.is_empty() || name.contains('/') || name.split('.').all(str::is_empty) {
            let what = "a name of a feature must not be empty, only dots, or contain /";
            self.wrong(Kind::Value, &key(""), what, "rename the feature");
            return None;
        }
        let Some(dtype) = feature.get("dtype").and_then(Value::as_str) else {
            self.wrong(
                Kind::Missing,
                &key(".dtype"),
                "it is missing",
                "write the type of the column",
            );
            return None;
        };
        let content = match dtype {
            "image" => Content::Images,
            "video" => Content::Video,
            "string" | "str" | "large_string" => Content::Text,
            "language" => Content::Annotations,
            "bool" | "boolean" | "half" | "float" | "double" => Content::Numbers,
            number if ["float", "int", "uint"].iter().any(|kind| bits(number, kind)) => Content::Numbers,
            other => {
                let what = format!("the type {other} is not known");
                self.wrong(
                    Kind::Unsupported,
                    &key(".dtype"),
                    what,
                    "write a type of numpy, image, video or string",
                );
                return None;
            }
        };
        let shape = match feature.get("shape") {
            None | Some(Value::Null) => Some(vec![1]),
            Some(Value::Array(sides)) => sides
                .iter()
                .map(|side| side.as_u64().map(|side| side as usize))
                .collect(),
            Some(side) => side.as_u64().map(|side| vec![side as usize]),
        };
        let Some(shape) = shape else {
            self.wrong(
                Kind::Type,
                &key(".shape"),
                "it is not a list of whole numbers",
                "write the shape of a frame",
            );
            return None;
        };
        let info = feature.get("info").or_else(|| feature.get("video_info"));
        let depth = ["is_depth_map", "video.is_depth_map"];
        let depth = depth
            .iter()
            .any(|key| info.and_then(|info| info.get(key)).and_then(Value::as_bool) == Some(true));
        let mut feature = Feature {
            name: name.to_owned(),
            content,
            dtype: dtype.to_owned(),
            names: names(feature.get("names").unwrap_or(&Value::Null)),
            shape,
            depth,
        };
        if content == Content::Numbers && feature.names.len() != feature.width() {
            feature.names.clear();
        }
        Some(feature)
    }

    fn splits(&self) -> Vec<(String, Range<u64>)> {
        let splits = self.present("splits").and_then(Value::as_object);
        let range = |text: &Value| {
            let (start, end) = text.as_str()?.split_once(':')?;
            let (start, end): (u64, u64) = (start.trim().parse().ok()?, end.trim().parse().ok()?);
            (start <= end).then_some(start..end)
        };
        let named = splits
            .into_iter()
            .flatten()
            .filter_map(|(name, text)| Some((name.clone(), range(text)?)));
        named.collect()
    }
}

/// Whether a type of numpy is this kind, followed by its number of bits.
fn bits(dtype: &str, kind: &str) -> bool {
    dtype
        .strip_prefix(kind)
        .is_some_and(|bits| ["8", "16", "32", "64"].contains(&bits))
}

/// Names of elements: a list, a list of lists, or an object with one list.
fn names(value: &Value) -> Vec<String> {
    match value {
        Value::Array(values) => values.iter().flat_map(names).collect(),
        Value::Object(map) if map.len() == 1 => map.values().flat_map(names).collect(),
        Value::String(name) => vec![name.clone()],
        _ => Vec::new(),
    }
}

/// Interprets the file.
pub(crate) fn parse(map: &Map<String, Value>, version: Version) -> Result<Info, Faults> {
    let mut keys = Keys {
        map,
        faults: Faults::default(),
    };
    let (data, video) = version.patterns();
    let fps = keys.fps();
    let features = keys.features();
    let data_path = keys.template("data_path", version, data);
    let video_path = keys.template("video_path", version, video);
    let [total_episodes, total_frames, total_tasks] =
        ["total_episodes", "total_frames", "total_tasks"].map(|key| keys.count(key));
    let chunks_size = keys.count("chunks_size").unwrap_or(CHUNKS_SIZE);
    if chunks_size == 0 {
        keys.wrong(
            Kind::Value,
            "chunks_size",
            "it is 0",
            "write 1000, or the number that the folders have",
        );
    }
    let splits = keys.splits();
    let text = |key: &str| map.get(key).and_then(Value::as_str).unwrap_or_default().to_owned();
    let (Some(fps), Some(data_path), Some(video_path)) = (fps, data_path, video_path) else {
        return Err(keys.faults);
    };
    let robot_type = Some(text("robot_type")).filter(|text| !text.is_empty());
    let info = Info {
        version,
        stated_version: text("codebase_version"),
        fps,
        features,
        total_episodes,
        total_frames,
        total_tasks,
        robot_type,
        splits,
        chunks_size,
        data_path,
        video_path,
    };
    keys.faults.or(info)
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    #[test]
    fn the_forms_of_names_are_read() {
        assert_eq!(names(&json!(["a", "b"])), ["a", "b"]);
        assert_eq!(names(&json!([["a"], ["b"]])), ["a", "b"]);
        assert_eq!(names(&json!({"motors": ["a", "b"]})), ["a", "b"]);
        assert!(names(&Value::Null).is_empty());
    }

    #[test]
    fn all_faults_are_found_at_once() {
        let info = json!({
            "fps": 0, "total_frames": 1.5, "chunks_size": 0, "data_path": "../{episode_index}", "video_path": null,
            "features": {"a/b": {"dtype": "float32"}, "c": {}, "d": {"dtype": "complex64"}, "e": {"dtype": "int64", "shape": ["x"]}}
        });
        let faults = parse(info.as_object().unwrap(), Version::V3).unwrap_err();
        let found: Vec<&str> = faults.iter().filter_map(|fault| fault.object.as_deref()).collect();
        assert_eq!(
            found,
            [
                "key fps",
                "key features.a/b",
                "key features.c.dtype",
                "key features.d.dtype",
                "key features.e.shape",
                "key data_path",
                "key total_frames",
                "key chunks_size",
            ]
        );
    }

    #[test]
    fn versions_are_recognized() {
        let major = |version: Value| {
            let map = json!({ "codebase_version": version });
            stated_major(map.as_object().unwrap()).ok()
        };
        assert_eq!(major(json!("v2.1")), Some(Some(2)));
        assert_eq!(major(json!("3.0")), Some(Some(3)));
        assert_eq!(major(json!("v3.1")), Some(Some(3)));
        assert_eq!(major(Value::Null), Some(None));
        for unknown in [json!("v4.0"), json!("v1.6"), json!("three"), json!(30)] {
            assert_eq!(major(unknown), None);
        }
    }
}
