//! Missing, stray, damaged and exchanged files.

use std::fs;

use super::super::support::without;
use super::{
    AV1, DATA, EPISODES, MULTI, OLD, OLD_DATA, OLD_MP4, OLD_VIDEO, Refused, Same, TASKS, VIDEO, check, replace,
};

#[test]
fn missing_and_stray_files() {
    check(&[
        ("tasks missing", AV1, |c| c.remove(TASKS), Refused(TASKS, "")),
        ("video missing", AV1, |c| c.remove(VIDEO), Refused(VIDEO, "")),
        ("data missing", AV1, |c| c.remove(DATA), Refused(DATA, "")),
        ("episodes missing", AV1, |c| c.remove(EPISODES), Refused(EPISODES, "")),
        (
            "one of several files missing",
            MULTI,
            |c| c.remove("data/chunk-001/file-000.parquet"),
            Refused("data/chunk-001/file-000.parquet", ""),
        ),
        (
            "tasks of v2 missing",
            OLD,
            |c| c.remove("meta/tasks.jsonl"),
            Refused("meta/tasks.jsonl", ""),
        ),
        (
            "an episode of v2 missing",
            OLD,
            |c| c.remove(OLD_DATA[1]),
            Refused(OLD_DATA[1], ""),
        ),
        (
            "a video of v2 missing",
            OLD_VIDEO,
            |c| c.remove(OLD_MP4[1]),
            Refused(OLD_MP4[1], ""),
        ),
        (
            "stray data",
            AV1,
            |c| {
                fs::copy(c.path(DATA), c.path("data/chunk-000/file-001.parquet")).unwrap();
            },
            Refused("data/chunk-000/file-001.parquet", ""),
        ),
        (
            "stray video",
            AV1,
            |c| {
                fs::copy(c.path(VIDEO), c.path("videos/observation.image/chunk-000/file-001.mp4")).unwrap();
            },
            Refused("videos/observation.image/chunk-000/file-001.mp4", ""),
        ),
        (
            "stray episodes",
            AV1,
            |c| {
                fs::copy(c.path(EPISODES), c.path("meta/episodes/chunk-000/file-001.parquet")).unwrap();
            },
            Refused("meta/episodes/chunk-000/file-001.parquet", "meta/episodes/file_index"),
        ),
        (
            "stray episodes without their own place",
            AV1,
            |c| {
                c.table(EPISODES, |t| without(&t, |name| name.starts_with("meta/")));
                fs::copy(c.path(EPISODES), c.path("meta/episodes/chunk-000/file-001.parquet")).unwrap();
            },
            Refused("meta/episodes/chunk-000/file-001.parquet", "episode_index"),
        ),
        (
            "stray episode of v2",
            OLD,
            |c| {
                fs::copy(c.path(OLD_DATA[0]), c.path("data/chunk-000/episode_000003.parquet")).unwrap();
            },
            Refused("data/chunk-000/episode_000003.parquet", ""),
        ),
        (
            "images of v2 beside the data",
            OLD,
            |c| {
                fs::create_dir_all(c.path("images/observation.image/episode_000000")).unwrap();
                fs::write(c.path("images/observation.image/episode_000000/frame_000000.png"), "").unwrap();
            },
            Same,
        ),
        (
            "data cut off",
            AV1,
            |c| c.bytes(DATA, |bytes| bytes.truncate(9000)),
            Refused(DATA, ""),
        ),
        ("data empty", AV1, |c| c.bytes(DATA, Vec::clear), Refused(DATA, "")),
        (
            "data is a placeholder",
            AV1,
            |c| {
                c.bytes(DATA, |bytes| {
                    *bytes = b"version https://git-lfs.github.com/spec/v1\noid sha256:0\n".to_vec();
                });
            },
            Refused(DATA, ""),
        ),
        (
            "video cut off",
            AV1,
            |c| c.bytes(VIDEO, |bytes| bytes.truncate(60_000)),
            Refused(VIDEO, ""),
        ),
        (
            "video without an index",
            AV1,
            |c| c.bytes(VIDEO, |bytes| replace(bytes, b"moov", b"free")),
            Refused(VIDEO, ""),
        ),
        (
            "video in MPEG-4 Part 2",
            AV1,
            |c| c.bytes(VIDEO, |bytes| replace(bytes, b"av01\0\0\0\0\0\0", b"mp4v")),
            Refused(VIDEO, ""),
        ),
        (
            "two videos swapped",
            OLD_VIDEO,
            |c| c.swap(OLD_MP4[0], OLD_MP4[1]),
            Refused(OLD_MP4[0], ""),
        ),
        (
            "two episodes swapped",
            OLD,
            |c| c.swap(OLD_DATA[0], OLD_DATA[1]),
            Refused(OLD_DATA[0], ""),
        ),
        (
            "two files of data swapped",
            MULTI,
            |c| c.swap(DATA, "data/chunk-000/file-001.parquet"),
            Refused(DATA, ""),
        ),
    ]);
}
