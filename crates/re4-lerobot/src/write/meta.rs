//! The folder `meta`: episodes, tasks and `info.json`.

use std::sync::Arc;

use arrow_array::builder::{BooleanBuilder, Float64Builder, Int64Builder, ListBuilder, StringBuilder};
use arrow_array::{ArrayRef, Float64Array, Int64Array, RecordBatch, StringArray};
use arrow_schema::{DataType, Field, Fields, Schema, SchemaRef};
use serde_json::{Map, Value, json};

use super::folder::Staging;
use super::stats::Stats;
use super::tables::{Table, properties};
use super::video::VideoPlace;
use super::{Declaration, EpisodeValue, FeatureKind, Number, WriteError, names};
use crate::info::{BOOKKEEPING, Version};
use crate::meta::{EPISODES_V2, EPISODES_V3, TASKS_V2, TASKS_V3, video_column};

/// Statistics by episode, v2.1.
const EPISODE_STATS_V2: &str = "meta/episodes_stats.jsonl";

/// Episodes of a row group of the table of episodes, which are in memory at once.
const ROWS: usize = 256;

/// A row of the table of episodes.
pub(super) struct Row {
    pub(super) index: usize,
    pub(super) task: String,
    pub(super) length: usize,
    /// Chunk and file of its frames.
    pub(super) data: [usize; 2],
    /// Its frames in the videos, camera by camera.
    pub(super) videos: Vec<VideoPlace>,
    /// Its first row in the whole dataset.
    pub(super) from: usize,
    pub(super) values: Vec<EpisodeValue>,
    /// In the order of [`names`].
    pub(super) stats: Vec<Stats>,
}

/// The table of episodes.
pub(super) struct Episodes {
    version: Version,
    /// Names of all features.
    features: Vec<String>,
    /// Names of the features that are videos.
    videos: Vec<String>,
    columns: Vec<String>,
    count: usize,
    rows: Vec<Row>,
    table: Option<Table>,
    /// v2.1: the two files as text.
    lines: [String; 2],
}

impl Episodes {
    pub(super) fn new(declared: &Declaration) -> Self {
        Self {
            version: declared.version,
            features: names(declared).map(str::to_owned).collect(),
            videos: declared
                .features
                .iter()
                .filter(|of| matches!(of.kind, FeatureKind::Video(..)))
                .map(|of| of.name.clone())
                .collect(),
            columns: declared.columns.clone(),
            count: 0,
            rows: Vec::new(),
            table: None,
            lines: [String::new(), String::new()],
        }
    }

    /// Number of episodes so far.
    pub(super) fn count(&self) -> usize {
        self.count
    }

    pub(super) fn add(&mut self, staging: &Staging, row: Row) -> Result<(), WriteError> {
        self.count += 1;
        if self.version == Version::V2 {
            self.add_lines(&row);
            return Ok(());
        }
        self.rows.push(row);
        if self.rows.len() == ROWS {
            self.flush(staging)
        } else {
            Ok(())
        }
    }

    pub(super) fn close(&mut self, staging: &Staging) -> Result<(), WriteError> {
        if self.version == Version::V2 {
            let [episodes, stats] = &self.lines;
            staging.write(EPISODES_V2, episodes.as_bytes())?;
            return staging.write(EPISODE_STATS_V2, stats.as_bytes());
        }
        self.flush(staging)?;
        self.table.take().map_or(Ok(()), |table| table.close(staging))
    }

    fn add_lines(&mut self, row: &Row) {
        let mut episode = json!({ "episode_index": row.index, "tasks": [row.task], "length": row.length });
        for (name, value) in self.columns.iter().zip(&row.values) {
            episode[name] = match value {
                EpisodeValue::Text(value) => json!(value),
                EpisodeValue::Integer(value) => json!(value),
                EpisodeValue::Double(value) => json!(value),
                EpisodeValue::Truth(value) => json!(value),
            };
        }
        let stats: Map<String, Value> = self
            .features
            .iter()
            .zip(&row.stats)
            .map(|(name, stats)| (name.clone(), without_quantiles(stats)))
            .collect();
        let stats = json!({ "episode_index": row.index, "stats": stats });
        for (lines, line) in self.lines.iter_mut().zip([episode, stats]) {
            *lines += &line.to_string();
            lines.push('\n');
        }
    }

    /// Writes the rows in memory as a row group.
    fn flush(&mut self, staging: &Staging) -> Result<(), WriteError> {
        if self.rows.is_empty() {
            return Ok(());
        }
        let columns = self.arrays();
        let fields: Fields = columns
            .iter()
            .map(|(name, array)| Field::new(name, array.data_type().clone(), true))
            .collect();
        let schema: SchemaRef = Arc::new(Schema::new(fields));
        let arrays = columns.into_iter().map(|(_, array)| array).collect();
        let name = format!("{EPISODES_V3}/chunk-000/file-000.parquet");
        let batch = RecordBatch::try_new(Arc::clone(&schema), arrays)
            .map_err(|error| staging.failed("write", &name, std::io::Error::other(error.to_string())))?;
        let table = match &mut self.table {
            Some(table) => table,
            closed => closed.insert(Table::create(staging, &name, &schema, properties(None).build())?),
        };
        table.write(staging, &batch)?;
        self.rows.clear();
        Ok(())
    }

    /// The columns of the rows in memory.
    fn arrays(&self) -> Vec<(String, ArrayRef)> {
        let whole = |of: &dyn Fn(&Row) -> usize| -> ArrayRef {
            let values = self.rows.iter().map(|row| of(row) as i64);
            Arc::new(Int64Array::from_iter_values(values))
        };
        let mut tasks = ListBuilder::new(StringBuilder::new()).with_field(element(DataType::Utf8));
        for row in &self.rows {
            tasks.values().append_value(&row.task);
            tasks.append(true);
        }
        let mut all: Vec<(String, ArrayRef)> = vec![
            ("episode_index".to_owned(), whole(&|row| row.index)),
            ("tasks".to_owned(), Arc::new(tasks.finish())),
            ("length".to_owned(), whole(&|row| row.length)),
            ("data/chunk_index".to_owned(), whole(&|row| row.data[0])),
            ("data/file_index".to_owned(), whole(&|row| row.data[1])),
            ("dataset_from_index".to_owned(), whole(&|row| row.from)),
            ("dataset_to_index".to_owned(), whole(&|row| row.from + row.length)),
        ];
        for (camera, name) in self.videos.iter().enumerate() {
            let place = |row: &Row| row.videos.get(camera).copied();
            let number = |part: usize| whole(&|row| place(row).map_or(0, |place| place.file[part]));
            let time = |part: usize| -> ArrayRef {
                let times = self
                    .rows
                    .iter()
                    .map(|row| place(row).map_or(0.0, |place| place.times[part]));
                Arc::new(Float64Array::from_iter_values(times))
            };
            all.push((video_column(name, "chunk_index"), number(0)));
            all.push((video_column(name, "file_index"), number(1)));
            all.push((video_column(name, "from_timestamp"), time(0)));
            all.push((video_column(name, "to_timestamp"), time(1)));
        }
        for (number, name) in self.columns.iter().enumerate() {
            all.push((name.clone(), self.values(number)));
        }
        for (number, name) in self.features.iter().enumerate() {
            let of: Vec<&Stats> = self.rows.iter().filter_map(|row| row.stats.get(number)).collect();
            let Some(first) = of.first() else {
                continue;
            };
            for (at, (figure, _)) in first.figures().enumerate() {
                let values = of
                    .iter()
                    .filter_map(|stats| stats.figures().nth(at))
                    .map(|(_, values)| values);
                all.push((format!("stats/{name}/{figure}"), figures(values, first.image)));
            }
            let mut counts = ListBuilder::new(Int64Builder::new()).with_field(element(DataType::Int64));
            for stats in &of {
                counts.values().append_value(stats.count as i64);
                counts.append(true);
            }
            all.push((format!("stats/{name}/count"), Arc::new(counts.finish())));
        }
        for column in ["meta/episodes/chunk_index", "meta/episodes/file_index"] {
            all.push((column.to_owned(), whole(&|_| 0)));
        }
        all
    }

    /// A column of the caller. Its type is that of its first value.
    fn values(&self, number: usize) -> ArrayRef {
        let values = || self.rows.iter().map(|row| row.values.get(number));
        macro_rules! build {
            ($builder:ident, $kind:ident, $value:ident => $append:expr) => {{
                let mut builder = $builder::new();
                for value in values() {
                    match value {
                        Some(EpisodeValue::$kind($value)) => builder.append_value($append),
                        _ => builder.append_null(),
                    }
                }
                Arc::new(builder.finish())
            }};
        }
        match values().next().flatten() {
            Some(EpisodeValue::Integer(_)) => build!(Int64Builder, Integer, value => *value),
            Some(EpisodeValue::Double(_)) => build!(Float64Builder, Double, value => *value),
            Some(EpisodeValue::Truth(_)) => build!(BooleanBuilder, Truth, value => *value),
            _ => build!(StringBuilder, Text, value => value),
        }
    }
}

fn without_quantiles(stats: &Stats) -> Value {
    let mut stats = stats.clone();
    stats.quantiles.clear();
    stats.to_json()
}

fn element(data_type: DataType) -> Arc<Field> {
    Arc::new(Field::new("element", data_type, true))
}

/// A column of figures: one list per row, nested as `[3][1][1]` for images.
fn figures<'a>(rows: impl Iterator<Item = &'a Vec<f64>>, image: bool) -> ArrayRef {
    if !image {
        let mut lists = ListBuilder::new(Float64Builder::new()).with_field(element(DataType::Float64));
        for values in rows {
            lists.values().append_slice(values);
            lists.append(true);
        }
        return Arc::new(lists.finish());
    }
    let inner = DataType::List(element(DataType::Float64));
    let middle = DataType::List(element(inner.clone()));
    let innermost = ListBuilder::new(Float64Builder::new()).with_field(element(DataType::Float64));
    let nested = ListBuilder::new(innermost).with_field(element(inner));
    let mut lists = ListBuilder::new(nested).with_field(element(middle));
    for values in rows {
        for value in values {
            lists.values().values().values().append_value(*value);
            lists.values().values().append(true);
            lists.values().append(true);
        }
        lists.append(true);
    }
    Arc::new(lists.finish())
}

/// Writes the table of tasks.
pub(super) fn tasks(staging: &Staging, version: Version, tasks: &[String]) -> Result<(), WriteError> {
    if version == Version::V2 {
        let line = |(index, task): (usize, &String)| format!("{}\n", json!({ "task_index": index, "task": task }));
        let text: String = tasks.iter().enumerate().map(line).collect();
        return staging.write(TASKS_V2, text.as_bytes());
    }
    let column = |name, pandas, numpy| json!({ "name": name, "field_name": name, "pandas_type": pandas, "numpy_type": numpy, "metadata": null });
    // Makes the task the index of the table. Without it, the official loader returns the number of a task in place of its text.
    let pandas = json!({
        "index_columns": ["task"],
        "column_indexes": [],
        "columns": [column("task_index", "int64", "int64"), column("task", "unicode", "object")],
        "creator": { "library": "re4-pipe", "version": env!("CARGO_PKG_VERSION") },
        "pandas_version": "2.0.0",
    })
    .to_string();
    let fields: Fields = Fields::from(vec![
        Field::new("task_index", DataType::Int64, false),
        Field::new("task", DataType::Utf8, false),
    ]);
    let metadata: std::collections::HashMap<String, String> = [("pandas".to_owned(), pandas.clone())].into();
    let schema: SchemaRef = Arc::new(Schema::new_with_metadata(fields, metadata));
    let arrays: Vec<ArrayRef> = vec![
        Arc::new(Int64Array::from_iter_values(0..tasks.len() as i64)),
        Arc::new(StringArray::from_iter_values(tasks)),
    ];
    let batch = RecordBatch::try_new(Arc::clone(&schema), arrays)
        .map_err(|error| staging.failed("write", TASKS_V3, std::io::Error::other(error.to_string())))?;
    let mut table = Table::create(staging, TASKS_V3, &schema, properties(Some(pandas)).build())?;
    table.write(staging, &batch)?;
    table.close(staging)
}

/// The contents of `info.json`, with the numbers of episodes, frames, tasks and videos.
pub(super) fn info(declared: &Declaration, [episodes, frames, tasks, videos]: [usize; 4]) -> Value {
    let v2 = declared.version == Version::V2;
    let (data_path, video_path) = declared.version.patterns();
    let mut info = json!({
        "codebase_version": if v2 { "v2.1" } else { "v3.0" },
        "robot_type": declared.robot,
        "total_episodes": episodes,
        "total_frames": frames,
        "total_tasks": tasks,
        "chunks_size": declared.limits.chunk,
    });
    if v2 {
        info["total_videos"] = json!(videos);
        info["total_chunks"] = json!(episodes.div_ceil(declared.limits.chunk.max(1)));
    } else {
        info["data_files_size_in_mb"] = json!(declared.limits.data_bytes >> 20);
        info["video_files_size_in_mb"] = json!(declared.limits.video_bytes >> 20);
    }
    info["fps"] = json!(declared.fps);
    info["splits"] = json!({ "train": format!("0:{episodes}") });
    info["data_path"] = json!(data_path);
    info["video_path"] = if videos > 0 { json!(video_path) } else { Value::Null };
    let own = declared
        .features
        .iter()
        .map(|of| (of.name.clone(), feature(&of.kind, declared.fps)));
    let more = BOOKKEEPING.map(|name| {
        let number = if name == "timestamp" {
            Number::Single
        } else {
            Number::Integer
        };
        (name.to_owned(), feature(&FeatureKind::Scalar(number), declared.fps))
    });
    info["features"] = Value::Object(own.chain(more).collect());
    info["re4"] = Value::Object(declared.about.clone());
    info
}

fn feature(kind: &FeatureKind, fps: usize) -> Value {
    let dtype = |number: &Number| match number {
        Number::Single => "float32",
        Number::Double => "float64",
        Number::Integer => "int64",
        Number::Truth => "bool",
    };
    match kind {
        FeatureKind::Scalar(number) => json!({ "dtype": dtype(number), "shape": [1], "names": null }),
        FeatureKind::Vector(number, names) => json!({ "dtype": dtype(number), "shape": [names.len()], "names": names }),
        FeatureKind::Image(width, height) => {
            json!({ "dtype": "image", "shape": [height, width, 3], "names": ["height", "width", "channels"] })
        }
        FeatureKind::Video(width, height) => json!({
            "dtype": "video",
            "shape": [height, width, 3],
            "names": ["height", "width", "channels"],
            "info": {
                "video.height": height,
                "video.width": width,
                "video.codec": "h264",
                "video.pix_fmt": "yuv420p",
                "video.is_depth_map": false,
                "video.fps": fps,
                "video.channels": 3,
                "has_audio": false,
            },
        }),
    }
}
