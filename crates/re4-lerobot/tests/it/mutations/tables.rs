//! The tables of episodes and tasks.

use std::sync::Arc;

use arrow_array::{Int64Array, StringArray};

use super::super::support::{named, of_columns, rows, with_column, without};
use super::{AV1, DATA, EPISODES, IMAGE, INFO, MULTI, OLD, OLD_DATA, Refused, Same, TASKS, check, counts, floats};

#[test]
fn tables_of_episodes_and_tasks() {
    const FROM: &str = "videos/observation.image/from_timestamp";
    check(&[
        (
            "no statistics of episodes",
            AV1,
            |c| c.table(EPISODES, |t| without(&t, |name| name.starts_with("stats/"))),
            Same,
        ),
        (
            "no place in meta/episodes",
            AV1,
            |c| c.table(EPISODES, |t| without(&t, |name| name.starts_with("meta/"))),
            Same,
        ),
        (
            "no place of the data",
            AV1,
            |c| c.table(EPISODES, |t| without(&t, |name| name.starts_with("data/"))),
            Same,
        ),
        (
            "no place of the data in several files",
            MULTI,
            |c| {
                c.table(EPISODES, |t| without(&t, |name| name.starts_with("data/")));
            },
            Same,
        ),
        (
            "half a place of the data",
            AV1,
            |c| c.table(EPISODES, |t| without(&t, |name| name == "data/file_index")),
            Refused(EPISODES, "data/file_index"),
        ),
        (
            "no rows of the dataset",
            AV1,
            |c| c.table(EPISODES, |t| without(&t, |name| name.starts_with("dataset_"))),
            Same,
        ),
        (
            "no place of the videos",
            AV1,
            |c| c.table(EPISODES, |t| without(&t, |name| name.starts_with("videos/"))),
            Refused(EPISODES, "videos/observation.image/chunk_index"),
        ),
        (
            "no lengths",
            AV1,
            |c| c.table(EPISODES, |t| without(&t, |name| name == "length")),
            Refused(EPISODES, "length"),
        ),
        (
            "own columns",
            AV1,
            |c| {
                c.table(EPISODES, |t| {
                    with_column(&t, "re4/seed", Arc::new(Int64Array::from(vec![1, 2, 3])))
                });
            },
            Same,
        ),
        (
            "columns in another order",
            AV1,
            |c| c.table(EPISODES, |t| of_columns(named(&t).into_iter().rev().collect())),
            Same,
        ),
        (
            "episodes in another order",
            AV1,
            |c| c.table(EPISODES, |t| rows(&t, &[2, 0, 1])),
            Same,
        ),
        (
            "an episode not listed",
            AV1,
            |c| c.table(EPISODES, |t| rows(&t, &[0, 2])),
            Refused(EPISODES, "episode_index"),
        ),
        (
            "the last episode not listed",
            AV1,
            |c| c.table(EPISODES, |t| rows(&t, &[0, 1])),
            Refused(INFO, "total_episodes"),
        ),
        (
            "an episode listed twice",
            AV1,
            |c| c.table(EPISODES, |t| rows(&t, &[0, 1, 1, 2])),
            Refused(EPISODES, "episode_index"),
        ),
        (
            "episodes from 1",
            AV1,
            |c| c.column(EPISODES, "episode_index", |a| counts(a, |_, v| v + 1)),
            Refused(EPISODES, "episode_index"),
        ),
        (
            "a negative episode",
            AV1,
            |c| c.column(EPISODES, "episode_index", |a| counts(a, |_, v| v - 1)),
            Refused(EPISODES, "episode_index"),
        ),
        (
            "a length wrong",
            AV1,
            |c| c.column(EPISODES, "length", |a| counts(a, |row, v| v + i64::from(row == 1))),
            Refused(EPISODES, "dataset_to_index"),
        ),
        (
            "two lengths wrong, the same sum",
            AV1,
            |c| {
                c.column(EPISODES, "length", |a| counts(a, |row, v| v + [1, -1, 0][row]));
                c.table(EPISODES, |t| without(&t, |name| name.starts_with("dataset_")));
            },
            Refused(EPISODES, FROM),
        ),
        (
            "two lengths wrong without videos",
            IMAGE,
            |c| {
                c.column(EPISODES, "length", |a| counts(a, |row, v| v + [1, -1, 0][row]));
                c.table(EPISODES, |t| without(&t, |name| name.starts_with("dataset_")));
            },
            Refused(DATA, "episode_index"),
        ),
        (
            "a huge length",
            IMAGE,
            |c| {
                c.column(EPISODES, "length", |a| {
                    counts(a, |row, v| if row == 1 { i64::MAX } else { v })
                });
            },
            Refused(DATA, ""),
        ),
        (
            "an empty episode",
            IMAGE,
            |c| c.column(EPISODES, "length", |a| counts(a, |row, v| if row == 1 { 0 } else { v })),
            Refused(EPISODES, "length"),
        ),
        (
            "dataset_from_index wrong",
            AV1,
            |c| c.column(EPISODES, "dataset_from_index", |a| counts(a, |row, v| v + row as i64)),
            Refused(EPISODES, "dataset_from_index"),
        ),
        (
            "data/file_index wrong",
            AV1,
            |c| c.column(EPISODES, "data/file_index", |a| counts(a, |_, _| 7)),
            Refused("data/chunk-000/file-007.parquet", ""),
        ),
        (
            "data/chunk_index wrong",
            AV1,
            |c| {
                c.column(EPISODES, "data/chunk_index", |a| {
                    counts(a, |row, v| v + i64::from(row == 2))
                });
            },
            Refused("data/chunk-001/file-000.parquet", ""),
        ),
        (
            "file_index of a video wrong",
            AV1,
            |c| {
                c.column(EPISODES, "videos/observation.image/file_index", |a| counts(a, |_, _| 1));
            },
            Refused("videos/observation.image/chunk-000/file-001.mp4", ""),
        ),
        (
            "files of two videos swapped",
            MULTI,
            |c| {
                c.column(EPISODES, "videos/observation.image/file_index", |a| {
                    counts(a, |row, _| [1, 0, 0][row])
                });
            },
            Refused("videos/observation.image/chunk-000/file-001.mp4", ""),
        ),
        (
            "from_timestamp off by 5e-5",
            AV1,
            |c| c.column(EPISODES, FROM, |a| floats(a, |_, v| v + 5e-5)),
            Same,
        ),
        (
            "from_timestamp off by 2e-4",
            AV1,
            |c| c.column(EPISODES, FROM, |a| floats(a, |_, v| v + 2e-4)),
            Refused(EPISODES, FROM),
        ),
        (
            "from_timestamp swapped",
            AV1,
            |c| c.column(EPISODES, FROM, |a| floats(a, |row, v| [16.1, 0.0, v][row])),
            Refused(EPISODES, FROM),
        ),
        (
            "from_timestamp not a number",
            AV1,
            |c| c.column(EPISODES, FROM, |a| floats(a, |_, _| f64::NAN)),
            Refused(EPISODES, FROM),
        ),
        (
            "to_timestamp off by a frame",
            AV1,
            |c| {
                c.column(EPISODES, "videos/observation.image/to_timestamp", |a| {
                    floats(a, |row, v| v + [0.0, 0.1, 0.0][row])
                });
            },
            Refused(EPISODES, "videos/observation.image/to_timestamp"),
        ),
        (
            "tasks without the metadata of pandas",
            AV1,
            |c| c.table(TASKS, |t| t),
            Same,
        ),
        (
            "tasks under the name of an index",
            AV1,
            |c| {
                c.table(TASKS, |t| {
                    of_columns(
                        named(&t)
                            .into_iter()
                            .map(|(name, array)| {
                                (
                                    if name == "task" {
                                        "__index_level_0__".to_owned()
                                    } else {
                                        name
                                    },
                                    array,
                                )
                            })
                            .collect(),
                    )
                });
            },
            Same,
        ),
        (
            "another task",
            AV1,
            |c| c.column(TASKS, "task", |_| Arc::new(StringArray::from(vec!["Pull it."]))),
            Refused(DATA, "task_index"),
        ),
        (
            "tasks numbered from 1",
            AV1,
            |c| c.column(TASKS, "task_index", |a| counts(a, |_, v| v + 1)),
            Refused(DATA, "task_index"),
        ),
        (
            "tasks without numbers",
            AV1,
            |c| c.table(TASKS, |t| without(&t, |name| name == "task_index")),
            Refused(TASKS, "task_index"),
        ),
        (
            "a line of v2 missing",
            OLD,
            |c| c.lines("meta/episodes.jsonl", |lines| drop(lines.remove(1))),
            Refused("meta/episodes.jsonl", "episode_index"),
        ),
        (
            "a line of v2 broken",
            OLD,
            |c| c.lines("meta/episodes.jsonl", |lines| lines[1].truncate(20)),
            Refused("meta/episodes.jsonl", "2"),
        ),
        (
            "a length of v2 wrong",
            OLD,
            |c| {
                c.lines("meta/episodes.jsonl", |lines| lines[1] = lines[1].replace("118", "117"));
            },
            Refused(OLD_DATA[1], ""),
        ),
        (
            "a length of v2 missing",
            OLD,
            |c| {
                c.lines("meta/episodes.jsonl", |lines| {
                    lines[1] = lines[1].replace("\"length\"", "\"frames\"");
                });
            },
            Refused("meta/episodes.jsonl", "length"),
        ),
        (
            "lines of v2 in another order",
            OLD,
            |c| c.lines("meta/episodes.jsonl", |lines| lines.reverse()),
            Same,
        ),
        (
            "a task of v2 twice",
            OLD,
            |c| c.lines("meta/tasks.jsonl", |lines| lines.push(lines[0].clone())),
            Refused("meta/tasks.jsonl", "task_index"),
        ),
    ]);
}
