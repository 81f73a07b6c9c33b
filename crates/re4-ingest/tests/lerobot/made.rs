//! Made-up LeRobot datasets (v2.1, one table per episode).

use std::fs;
use std::path::Path;
use std::sync::Arc;

use arrow_array::builder::{Float32Builder, ListBuilder};
use arrow_array::{ArrayRef, Float32Array, Int64Array, RecordBatch};
use parquet::arrow::ArrowWriter;
use re4_geometry::{Point2, Pose2};
use re4_sim::{GOAL, coverage, tee_vertices};
use serde_json::{Value, json};
use tempfile::TempDir;

/// A feature: its name, the names of its elements, and for each episode its values, frame by frame.
pub(crate) struct Feature {
    pub(crate) name: &'static str,
    pub(crate) names: Value,
    pub(crate) width: usize,
    pub(crate) values: Vec<Vec<f64>>,
}

impl Feature {
    pub(crate) fn of(name: &'static str, names: Value, width: usize, values: Vec<Vec<f64>>) -> Self {
        Self {
            name,
            names,
            width,
            values,
        }
    }
}

fn write(path: &Path, content: &str) {
    fs::create_dir_all(path.parent().unwrap()).unwrap();
    fs::write(path, content).unwrap();
}

/// Writes a dataset.
pub(crate) fn dataset(fps: f64, features: &[Feature]) -> TempDir {
    let folder = TempDir::new().unwrap();
    let lengths: Vec<usize> = features[0]
        .values
        .iter()
        .map(|values| values.len() / features[0].width)
        .collect();
    let mut about = serde_json::Map::new();
    for feature in features {
        let dtype = json!({ "dtype": "float32", "shape": [feature.width], "names": feature.names });
        about.insert(feature.name.to_owned(), dtype);
    }
    for name in ["frame_index", "episode_index", "index", "task_index"] {
        about.insert(
            name.to_owned(),
            json!({ "dtype": "int64", "shape": [1], "names": null }),
        );
    }
    about.insert(
        "timestamp".to_owned(),
        json!({ "dtype": "float32", "shape": [1], "names": null }),
    );
    let half = lengths.len().div_ceil(2);
    let info = json!({
        "codebase_version": "v2.1", "robot_type": "made up", "fps": fps, "features": about, "chunks_size": 1000,
        "total_episodes": lengths.len(), "total_frames": lengths.iter().sum::<usize>(), "total_tasks": 1,
        "splits": { "train": format!("0:{half}"), "test": format!("{half}:{}", lengths.len()) },
    });
    write(&folder.path().join("meta/info.json"), &info.to_string());
    write(
        &folder.path().join("meta/tasks.jsonl"),
        "{\"task_index\": 0, \"task\": \"move it\"}\n",
    );
    let line = |(index, length): (usize, &usize)| {
        format!(
            "{}\n",
            json!({ "episode_index": index, "tasks": ["move it"], "length": length })
        )
    };
    let episodes: String = lengths.iter().enumerate().map(line).collect();
    write(&folder.path().join("meta/episodes.jsonl"), &episodes);
    let mut start = 0;
    for (number, &length) in lengths.iter().enumerate() {
        let table = episode(fps, features, number, start..start + length);
        start += length;
        let path = folder
            .path()
            .join(format!("data/chunk-000/episode_{number:06}.parquet"));
        fs::create_dir_all(path.parent().unwrap()).unwrap();
        let mut writer = ArrowWriter::try_new(fs::File::create(path).unwrap(), table.schema(), None).unwrap();
        writer.write(&table).unwrap();
        writer.close().unwrap();
    }
    folder
}

fn episode(fps: f64, features: &[Feature], number: usize, rows: std::ops::Range<usize>) -> RecordBatch {
    let integers = |value: &dyn Fn(usize) -> usize| -> ArrayRef {
        Arc::new((0..rows.len()).map(|row| value(row) as i64).collect::<Int64Array>())
    };
    let times: ArrayRef = Arc::new(
        (0..rows.len())
            .map(|row| (row as f64 / fps) as f32)
            .collect::<Float32Array>(),
    );
    let mut columns = vec![
        ("timestamp", times),
        ("frame_index", integers(&|row| row)),
        ("episode_index", integers(&|_| number)),
        ("index", integers(&|row| rows.start + row)),
        ("task_index", integers(&|_| 0)),
    ];
    for feature in features {
        let values = &feature.values[number];
        let column: ArrayRef = if feature.width == 1 {
            Arc::new(values.iter().map(|&value| value as f32).collect::<Float32Array>())
        } else {
            let mut lists = ListBuilder::new(Float32Builder::new());
            for frame in values.chunks(feature.width) {
                for &value in frame {
                    lists.values().append_value(value as f32);
                }
                lists.append(true);
            }
            Arc::new(lists.finish())
        };
        columns.push((feature.name, column));
    }
    RecordBatch::try_from_iter(columns).unwrap()
}

/// Push-T demonstrations: an agent that follows its targets as the simulator's does, and a block that moves.
pub(crate) struct Pushes {
    pub(crate) states: Vec<Vec<f64>>,
    pub(crate) actions: Vec<Vec<f64>>,
    pub(crate) poses: Vec<Vec<Pose2>>,
}

impl Pushes {
    pub(crate) fn new(episodes: usize, frames: usize) -> Self {
        let mut pushes = Self {
            states: Vec::new(),
            actions: Vec::new(),
            poses: Vec::new(),
        };
        for episode in 0..episodes {
            let (mut states, mut actions, mut poses) = (Vec::new(), Vec::new(), Vec::new());
            let mut agent = Point2::new(100.0 + 20.0 * episode as f64, 400.0);
            let mut step = Point2::new(0.0, 0.0);
            for frame in 0..frames {
                let t = frame as f64 / 5.0 + episode as f64;
                let target = Point2::new(256.0 + 150.0 * (0.7 * t).sin(), 256.0 + 150.0 * (1.1 * t).cos());
                states.extend([agent.x, agent.y]);
                actions.extend([target.x, target.y]);
                poses.push(Pose2::new(
                    256.0 + 90.0 * (1.25 * t).sin(),
                    240.0,
                    GOAL.theta + 0.02 * t,
                ));
                let pull = |to: f64, at: f64, before: f64| 0.314 * (to - at) + 0.234 * before;
                step = Point2::new(pull(target.x, agent.x, step.x), pull(target.y, agent.y, step.y));
                agent = Point2::new(agent.x + step.x, agent.y + step.y);
            }
            pushes.states.push(states);
            pushes.actions.push(actions);
            pushes.poses.push(poses);
        }
        pushes
    }

    /// State and action.
    pub(crate) fn features(&self) -> Vec<Feature> {
        vec![
            Feature::of(
                "observation.state",
                json!({ "motors": ["motor_0", "motor_1"] }),
                2,
                self.states.clone(),
            ),
            Feature::of("action", json!(["x", "y"]), 2, self.actions.clone()),
        ]
    }

    pub(crate) fn corners(&self) -> Feature {
        let of = |pose: &Pose2| {
            tee_vertices(*pose)
                .concat()
                .into_iter()
                .flat_map(|corner| [corner.x, corner.y])
        };
        let values = self
            .poses
            .iter()
            .map(|poses| poses.iter().flat_map(of).collect())
            .collect();
        Feature::of("observation.environment_state", json!(["keypoints"]), 16, values)
    }

    pub(crate) fn rewards(&self) -> Feature {
        let of = |poses: &Vec<Pose2>| {
            let following = poses.iter().skip(1).chain(poses.last());
            following.map(|pose| (coverage(*pose, GOAL) / 0.95).min(1.0)).collect()
        };
        Feature::of("next.reward", Value::Null, 1, self.poses.iter().map(of).collect())
    }
}
