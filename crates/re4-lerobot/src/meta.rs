//! The tables of tasks and episodes in `meta/`.

use std::collections::BTreeMap;
use std::path::Path;

use serde_json::{Map, Value};

use crate::column::{Place, integers, numbers, text_lists, texts};
use crate::fault::{Fault, Faults, Kind};
use crate::files;
use crate::info::{Content, Info, Version};
use crate::table::Table;

/// Maximum size of a file of JSON, which is read into memory.
const JSON_LIMIT: u64 = 1 << 30;

/// Rows of a table of `meta/` that are in memory at once.
const ROWS: usize = 4096;

/// Files of `meta/`.
pub(crate) const TASKS_V2: &str = "meta/tasks.jsonl";
pub(crate) const TASKS_V3: &str = "meta/tasks.parquet";
pub(crate) const EPISODES_V2: &str = "meta/episodes.jsonl";
pub(crate) const EPISODES_V3: &str = "meta/episodes";

/// What the metadata states about an episode.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Stated {
    /// The file of this statement.
    pub(crate) file: String,
    /// Its line or row.
    pub(crate) row: usize,
    pub(crate) index: u64,
    pub(crate) length: u64,
    pub(crate) tasks: Vec<String>,
    /// Rows over the whole dataset, from and to.
    pub(crate) rows: [Option<u64>; 2],
    /// Folder and file of its rows.
    pub(crate) data: Option<[u64; 2]>,
    /// For each video feature: folder and file, and seconds from and to.
    pub(crate) videos: Vec<([u64; 2], [f64; 2])>,
}

/// Reads a file of JSON into memory.
fn text(root: &Path, name: &str) -> Result<String, Fault> {
    let path = root.join(name);
    let about = std::fs::metadata(&path).map_err(|error| Fault::io(name, "opened", &error))?;
    if !about.is_file() {
        return Err(Fault::of_file(
            Kind::Damaged,
            name,
            "it is not a regular file",
            "restore the file",
        ));
    }
    if about.len() > JSON_LIMIT {
        let what = format!("it has {} bytes", about.len());
        return Err(Fault::of_file(Kind::Unsupported, name, what, "restore the file"));
    }
    let bytes = std::fs::read(&path).map_err(|error| Fault::io(name, "read", &error))?;
    match String::from_utf8(bytes) {
        Ok(text) => Ok(text.trim_start_matches('\u{feff}').to_owned()),
        Err(error) => {
            let at = error.utf8_error().valid_up_to();
            Err(Fault::damaged(name, format!("byte {at} is not valid UTF-8")))
        }
    }
}

/// An object of JSON.
pub(crate) fn object(root: &Path, name: &str) -> Result<Map<String, Value>, Fault> {
    match serde_json::from_str(&text(root, name)?) {
        Ok(Value::Object(map)) => Ok(map),
        Ok(_) => Err(Fault::damaged(name, "it is not an object of JSON")),
        Err(error) => Err(Fault::damaged(name, format!("it is not valid JSON ({error})"))),
    }
}

/// The lines of a file, each an object of JSON.
fn lines(
    root: &Path,
    name: &str,
    mut take: impl FnMut(usize, &Map<String, Value>) -> Result<(), Fault>,
) -> Result<(), Faults> {
    let mut faults = Faults::default();
    for (number, line) in text(root, name)?.lines().enumerate() {
        if line.trim().is_empty() {
            continue;
        }
        let result = match serde_json::from_str(line) {
            Ok(Value::Object(map)) => take(number + 1, &map),
            Ok(_) => Err(Fault::damaged(name, "it is not an object of JSON")),
            Err(error) => Err(Fault::damaged(name, format!("it is not valid JSON ({error})"))),
        };
        faults.keep(result.map_err(|fault| match fault.object {
            Some(_) => fault,
            None => fault.at(format!("line {}", number + 1)),
        }));
    }
    faults.or(())
}

/// A whole number of a line.
fn whole(map: &Map<String, Value>, name: &str, line: usize, key: &str) -> Result<u64, Fault> {
    let fault = |kind, what: String| {
        Fault::of_file(kind, name, what, "write a whole number").at(format!("line {line}, key {key}"))
    };
    let value = map
        .get(key)
        .ok_or_else(|| fault(Kind::Missing, "it is missing".to_owned()))?;
    let float = value
        .as_f64()
        .filter(|number| number.fract() == 0.0 && (0.0..9.0e15).contains(number));
    let found = value.as_u64().or(float.map(|number| number as u64));
    found.ok_or_else(|| fault(Kind::Type, format!("it is {value}, not a whole number")))
}

/// The tasks by their index.
pub(crate) fn tasks(root: &Path, version: Version) -> Result<BTreeMap<u64, String>, Faults> {
    let mut found = BTreeMap::new();
    let twice = |file: &str, index: u64| {
        let what = format!("task {index} is listed twice");
        Fault::column(Kind::Value, file, "task_index", what, "number the tasks from 0")
    };
    match version {
        Version::V2 => lines(root, TASKS_V2, |line, map| {
            let index = whole(map, TASKS_V2, line, "task_index")?;
            let Some(task) = map.get("task").and_then(Value::as_str) else {
                let fault = Fault::of_file(Kind::Missing, TASKS_V2, "there is no text", "write the task in words");
                return Err(fault.at(format!("line {line}, key task")));
            };
            match found.insert(index, task.to_owned()) {
                None => Ok(()),
                Some(_) => Err(twice(TASKS_V2, index)),
            }
        })?,
        Version::V3 => {
            let table = Table::open(root, TASKS_V3)?;
            // The writer stores the text as the index of a pandas table; without a name it gets this one.
            let text = ["task", "__index_level_0__"]
                .into_iter()
                .find(|name| table.has(name))
                .unwrap_or("task");
            require(&table, TASKS_V3, &["task_index", text]).map_or(Ok(()), Err)?;
            let mut numbers = Vec::new();
            let mut names = Vec::new();
            let of = |column, first| Place {
                file: TASKS_V3,
                column,
                first,
            };
            table.each_block("task_index", 0..table.rows(), ROWS, |first, array| {
                numbers.extend(integers(array, &of("task_index", first))?);
                Ok(())
            })?;
            table.each_block(text, 0..table.rows(), ROWS, |first, array| {
                names.extend(texts(array, &of(text, first))?);
                Ok(())
            })?;
            for (number, name) in numbers.into_iter().zip(names) {
                let Ok(index) = u64::try_from(number) else {
                    let what = format!("a task has the number {number}");
                    return Err(
                        Fault::column(Kind::Value, TASKS_V3, "task_index", what, "number the tasks from 0").into(),
                    );
                };
                if found.insert(index, name).is_some() {
                    return Err(twice(TASKS_V3, index).into());
                }
            }
        }
    }
    Ok(found)
}

/// Faults for columns that a table lacks.
fn require(table: &Table, file: &str, columns: &[&str]) -> Option<Faults> {
    let mut faults = Faults::default();
    for column in columns.iter().filter(|column| !table.has(column)) {
        let fix = "restore the column, or write the table again with the lerobot package";
        faults.push(Fault::column(Kind::Missing, file, column, "it is missing", fix));
    }
    (!faults.is_empty()).then_some(faults)
}

/// What the metadata states about all episodes, in the order of their index.
pub(crate) fn episodes(root: &Path, info: &Info) -> Result<Vec<Stated>, Faults> {
    let (mut stated, mut faults) = match info.version {
        Version::V2 => episodes_v2(root)?,
        Version::V3 => episodes_v3(root, info)?,
    };
    // Stable: of two statements about an episode, the second is the fault.
    stated.sort_by_key(|episode| episode.index);
    for pair in stated.windows(2) {
        let (before, episode) = (&pair[0], &pair[1]);
        let what = match episode.index {
            index if index == before.index => format!("row {}: episode {index} is listed twice", episode.row),
            index if index != before.index + 1 => format!("episode {} is missing", before.index + 1),
            _ => continue,
        };
        let fix = "list every episode once, numbered from 0";
        faults.push(Fault::column(Kind::Count, &episode.file, "episode_index", what, fix));
    }
    if let Some(first) = stated.first()
        && first.index != 0
    {
        let what = format!("the first episode is number {}", first.index);
        let fix = "list every episode once, numbered from 0";
        faults.push(Fault::column(Kind::Count, &first.file, "episode_index", what, fix));
    }
    faults.or(stated)
}

fn episodes_v2(root: &Path) -> Result<(Vec<Stated>, Faults), Faults> {
    let mut stated = Vec::new();
    lines(root, EPISODES_V2, |line, map| {
        let tasks = match map.get("tasks") {
            Some(Value::Array(tasks)) => tasks
                .iter()
                .filter_map(|task| task.as_str().map(str::to_owned))
                .collect(),
            Some(Value::String(task)) => vec![task.clone()],
            _ => Vec::new(),
        };
        stated.push(Stated {
            file: EPISODES_V2.to_owned(),
            row: line,
            index: whole(map, EPISODES_V2, line, "episode_index")?,
            length: whole(map, EPISODES_V2, line, "length")?,
            tasks,
            rows: [None; 2],
            data: None,
            videos: Vec::new(),
        });
        Ok(())
    })?;
    Ok((stated, Faults::default()))
}

/// Columns of numbers of an episodes table, read as a whole: a few numbers per episode.
struct Columns<'a> {
    table: &'a Table,
    file: &'a str,
}

impl Columns<'_> {
    fn counts(&self, column: &str) -> Result<Option<Vec<u64>>, Fault> {
        if !self.table.has(column) {
            return Ok(None);
        }
        let mut values = Vec::new();
        self.table
            .each_block(column, 0..self.table.rows(), ROWS, |first, array| {
                let place = Place {
                    file: self.file,
                    column,
                    first,
                };
                for (row, value) in integers(array, &place)?.into_iter().enumerate() {
                    let negative =
                        || place.fault(Kind::Value, row, format!("it is {value}"), "write a number from 0 up");
                    values.push(u64::try_from(value).map_err(|_| negative())?);
                }
                Ok(())
            })?;
        Ok(Some(values))
    }

    fn seconds(&self, column: &str) -> Result<Option<Vec<f64>>, Fault> {
        if !self.table.has(column) {
            return Ok(None);
        }
        let mut values = Vec::new();
        self.table
            .each_block(column, 0..self.table.rows(), ROWS, |first, array| {
                values.extend(numbers(
                    array,
                    &Place {
                        file: self.file,
                        column,
                        first,
                    },
                )?);
                Ok(())
            })?;
        Ok(Some(values))
    }
}

/// The name of a column of a video.
pub(crate) fn video_column(feature: &str, part: &str) -> String {
    format!("videos/{feature}/{part}")
}

fn episodes_v3(root: &Path, info: &Info) -> Result<(Vec<Stated>, Faults), Faults> {
    let mut faults = Faults::default();
    let mut stated = Vec::new();
    let names = files::below(root, EPISODES_V3, "parquet")?;
    if names.is_empty() {
        let name = "meta/episodes/chunk-000/file-000.parquet";
        let fix = "restore it, or download the dataset again";
        return Err(Fault::of_file(Kind::MissingFile, name, "it is missing", fix).into());
    }
    for name in names {
        match episodes_of(root, &name, info) {
            Ok(more) => stated.extend(more),
            Err(more) => faults.extend(more),
        }
    }
    Ok((stated, faults))
}

/// The episodes of one file.
fn episodes_of(root: &Path, name: &str, info: &Info) -> Result<Vec<Stated>, Faults> {
    let table = Table::open(root, name)?;
    let videos: Vec<&str> = info.with(Content::Video).map(|feature| feature.name.as_str()).collect();
    let video_columns = |feature: &str| {
        ["chunk_index", "file_index", "from_timestamp", "to_timestamp"].map(|part| video_column(feature, part))
    };
    let mut required = vec!["episode_index".to_owned(), "length".to_owned()];
    // A table without these two has all rows in the order of the files; with only one of them it is broken.
    let data = ["data/chunk_index", "data/file_index"];
    if data.iter().any(|column| table.has(column)) {
        required.extend(data.map(str::to_owned));
    }
    required.extend(videos.iter().flat_map(|feature| video_columns(feature)));
    let required: Vec<&str> = required.iter().map(String::as_str).collect();
    require(&table, name, &required).map_or(Ok(()), Err)?;

    let columns = Columns {
        table: &table,
        file: name,
    };
    let mut faults = Faults::default();
    let mut counts = |column: &str| faults.keep(columns.counts(column)).flatten();
    let (index, length) = (counts("episode_index"), counts("length"));
    let (from, to) = (counts("dataset_from_index"), counts("dataset_to_index"));
    let data = data.map(&mut counts);
    let own = ["meta/episodes/chunk_index", "meta/episodes/file_index"].map(&mut counts);
    let files: Vec<[Option<Vec<u64>>; 2]> = videos
        .iter()
        .map(|feature| ["chunk_index", "file_index"].map(|part| counts(&video_column(feature, part))))
        .collect();
    let mut seconds = |feature: &str, part: &str| faults.keep(columns.seconds(&video_column(feature, part))).flatten();
    let times: Vec<[Option<Vec<f64>>; 2]> = videos
        .iter()
        .map(|feature| ["from_timestamp", "to_timestamp"].map(|part| seconds(feature, part)))
        .collect();
    let mut tasks = Vec::new();
    if table.has("tasks") {
        let read = table.each_block("tasks", 0..table.rows(), ROWS, |first, array| {
            tasks.extend(text_lists(
                array,
                &Place {
                    file: name,
                    column: "tasks",
                    first,
                },
            )?);
            Ok(())
        });
        faults.keep(read);
    }
    stray_rows(name, &own, &mut faults);
    let (Some(index), Some(length), true) = (index, length, faults.is_empty()) else {
        return Err(faults);
    };
    let at = |column: &Option<Vec<u64>>, row: usize| column.as_ref().and_then(|column| column.get(row)).copied();
    let pair = |columns: &[Option<Vec<u64>>; 2], row: usize| Some([at(&columns[0], row)?, at(&columns[1], row)?]);
    let time = |columns: &[Option<Vec<f64>>; 2], row: usize| {
        [0, 1].map(|end| {
            columns[end]
                .as_ref()
                .and_then(|column| column.get(row))
                .copied()
                .unwrap_or(f64::NAN)
        })
    };
    let episode = |row: usize| Stated {
        file: name.to_owned(),
        row,
        index: index[row],
        length: length[row],
        tasks: tasks.get(row).cloned().unwrap_or_default(),
        rows: [at(&from, row), at(&to, row)],
        data: pair(&data, row),
        videos: files
            .iter()
            .zip(&times)
            .map(|(file, times)| (pair(file, row).unwrap_or([u64::MAX; 2]), time(times, row)))
            .collect(),
    };
    Ok((0..table.rows()).map(episode).collect())
}

/// Checks that the rows of an episodes table name the file that they are in.
fn stray_rows(name: &str, own: &[Option<Vec<u64>>; 2], faults: &mut Faults) {
    let [Some(chunks), Some(files)] = own else {
        return;
    };
    for (row, (chunk, file)) in chunks.iter().zip(files).enumerate() {
        let stated = format!("meta/episodes/chunk-{chunk:03}/file-{file:03}.parquet");
        if stated != name {
            let what = format!("row {row} states the file {stated}");
            let fix = "correct the column, or move the rows to the file that they name";
            faults.push(Fault::column(Kind::Value, name, "meta/episodes/file_index", what, fix));
            return;
        }
    }
}
