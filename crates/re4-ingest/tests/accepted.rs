//! All accepted kinds of stores are read to the same numbers.
#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    reason = "helpers of tests may fail like tests"
)]

mod common;

use std::ops::Range;

use common::{Copy, FRAMES, SIDE, copy_folder, expected, files_of, fixture, image, read_all, zip_files};
use re4_ingest::pusht::{ImageBlock, PushtReader};
use re4_ingest::{EpisodeRange, Selection, WarningCode};
use tempfile::TempDir;

const VARIETIES: [(&str, bool, bool); 7] = [
    ("original", true, true),
    ("modern", true, true),
    ("minimal", false, false),
    ("mixed", true, true),
    ("format3", true, true),
    ("sharded", true, true),
    ("fortran", true, true),
];

fn blocks(reader: &PushtReader, selection: &Selection) -> Vec<ImageBlock> {
    reader
        .image_blocks(selection)
        .unwrap()
        .collect::<Result<_, _>>()
        .unwrap()
}

fn check_images(blocks: &[ImageBlock], frames: impl Iterator<Item = usize>) {
    let mut delivered = Vec::new();
    for block in blocks {
        let images: Vec<&[u8]> = block.bytes.chunks(SIDE * SIDE * 3).collect();
        assert_eq!(images.len(), block.frames.len());
        for (frame, bytes) in block.frames.clone().zip(images) {
            assert_eq!(bytes, image(frame), "frame {frame}");
            delivered.push(frame);
        }
    }
    assert_eq!(delivered, frames.collect::<Vec<_>>());
}

#[test]
fn every_variety_reads_as_the_same_numbers() {
    for (name, complete, images) in VARIETIES {
        let reader = PushtReader::open(&fixture(name)).unwrap();
        assert_eq!(reader.episode_ranges(), [0..12, 12..17, 17..30], "{name}");
        assert_eq!(reader.frame_count(), FRAMES);
        let (episodes, _) = reader.read_episodes(&Selection::All).unwrap();
        assert_eq!(episodes, expected(&[0, 1, 2], complete), "{name}");
        assert_eq!(reader.image_shape(), images.then_some([SIDE, SIDE, 3]), "{name}");
        if images {
            check_images(&blocks(&reader, &Selection::All), 0..FRAMES);
        }
    }
}

#[test]
fn selections_read_their_episodes_in_dataset_order() {
    let range = |start, end| Selection::Range(EpisodeRange { start, end });
    for name in ["original", "modern", "mixed", "format3", "sharded", "fortran"] {
        let reader = PushtReader::open(&fixture(name)).unwrap();
        for (selection, sources) in [
            (Selection::First(2), vec![0, 1]),
            (Selection::Last(1), vec![2]),
            (Selection::List(vec![2.into(), 0.into()]), vec![0, 2]),
            (range(1, 2), vec![1]),
        ] {
            let (episodes, _) = reader.read_episodes(&selection).unwrap();
            assert_eq!(episodes, expected(&sources, true), "{name} {selection}");
            let rows: Vec<Range<usize>> = episodes.rows.clone();
            check_images(&blocks(&reader, &selection), rows.into_iter().flatten());
        }
    }
}

#[test]
fn blocks_end_at_chunks_and_gaps_only() {
    let frames = |name, selection| -> Vec<Range<usize>> {
        let reader = PushtReader::open(&fixture(name)).unwrap();
        blocks(&reader, &selection)
            .into_iter()
            .map(|block| block.frames)
            .collect()
    };
    assert_eq!(
        frames("original", Selection::All),
        [0..7, 7..14, 14..21, 21..28, 28..30]
    );
    assert_eq!(
        frames("original", Selection::List(vec![0.into(), 2.into()])),
        [0..7, 7..12, 17..21, 21..28, 28..30]
    );
    assert_eq!(
        frames("modern", Selection::List(vec![0.into(), 2.into()])),
        [0..12, 17..30]
    );
    assert_eq!(frames("modern", Selection::First(2)), [0..16, 16..17]);
}

#[test]
fn blocks_do_not_depend_on_the_thread_pool() {
    let reader = PushtReader::open(&fixture("original")).unwrap();
    let reference = blocks(&reader, &Selection::All);
    for threads in 1..4 {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        assert_eq!(pool.install(|| blocks(&reader, &Selection::All)), reference);
    }
    // Stopping early leaves no task that could block.
    drop(reader.image_blocks(&Selection::All).unwrap().next());
}

#[test]
fn zip_files_read_as_their_folders() {
    let folder = TempDir::new().unwrap();
    for (name, _, _) in VARIETIES {
        let hash = PushtReader::open(&fixture(name))
            .unwrap()
            .source_hash(&|| false)
            .unwrap();
        for (prefix, stored) in [
            ("", true),
            ("", false),
            ("store.zarr/", false),
            ("pusht/store.zarr/", true),
        ] {
            let path = folder.path().join("store.zip");
            zip_files(&path, &files_of(&fixture(name), prefix), stored);
            let reader = PushtReader::open(&path).unwrap();
            assert_eq!(reader.source_hash(&|| false).unwrap(), hash, "{name} at {prefix}");
            assert_eq!(read_all(&path), read_all(&fixture(name)), "{name} at {prefix}");
        }
    }
}

#[test]
fn large_compressed_zip_entries_unpack_completely() {
    // 3 MiB of images in one uncompressed chunk that DEFLATE shrinks to much less: larger than any intermediate buffer.
    let side = 187;
    let bytes: Vec<u8> = (0..FRAMES * side * side * 3).map(|i| (i / 40 % 256) as u8).collect();
    assert!(bytes.len() > 3 << 20);
    let store = Copy::of("minimal");
    std::fs::create_dir(store.path().join("data/img")).unwrap();
    let store = store.replace("data/img", "|u1", &[FRAMES, side, side, 3], bytes.clone());
    let folder = TempDir::new().unwrap();
    let path = folder.path().join("store.zip");
    zip_files(&path, &files_of(&store.path(), "pusht.zarr/"), false);
    assert!(std::fs::metadata(&path).unwrap().len() < 1 << 20);
    let reader = PushtReader::open(&path).unwrap();
    let read: Vec<u8> = blocks(&reader, &Selection::All)
        .into_iter()
        .flat_map(|block| block.bytes)
        .collect();
    assert!(read == bytes);
}

#[test]
fn an_unpacked_zip_is_kept_while_it_is_read() {
    let folder = TempDir::new().unwrap();
    let path = folder.path().join("store.zip");
    zip_files(&path, &files_of(&fixture("original"), ""), false);
    let reader = PushtReader::open(&path).unwrap();
    let iterator = reader.image_blocks(&Selection::All).unwrap();
    drop(reader);
    let blocks: Vec<ImageBlock> = iterator.collect::<Result<_, _>>().unwrap();
    check_images(&blocks, 0..FRAMES);
}

#[test]
fn the_hash_covers_names_lengths_and_bytes() {
    let hash = |copy: &Copy| PushtReader::open(&copy.path()).unwrap().source_hash(&|| false).unwrap();
    let reference = hash(&Copy::of("original"));
    assert_eq!(hash(&Copy::of("original")), reference);
    let changed = [
        Copy::of("original").edit("data/.zgroup", |bytes| bytes.push(b' ')),
        Copy::of("original").write("data/.zgroup", "{}"),
        Copy::of("original").write("data/img/.zattrs", ""),
        Copy::of("original").edit("data/img/1.0.0.0", |bytes| bytes[300] ^= 1),
        // One byte moved from one file to the next.
        Copy::of("original")
            .write("data/action/.zattrs", "a")
            .write("data/img/.zattrs", "b"),
        Copy::of("original")
            .write("data/action/.zattrs", "ab")
            .write("data/img/.zattrs", ""),
    ];
    let mut hashes: Vec<[u8; 32]> = changed.iter().map(hash).chain([reference]).collect();
    hashes.sort_unstable();
    hashes.dedup();
    assert_eq!(hashes.len(), changed.len() + 1);
}

/// An independent implementation of the documented hash, with names in byte order (`c/10` before `c/2`).
#[test]
fn the_hash_matches_its_documentation() {
    for name in ["original", "format3"] {
        let mut files = files_of(&fixture(name), "");
        files.sort();
        let mut whole = blake3::Hasher::new();
        for (name, bytes) in files {
            whole.update(&(name.len() as u64).to_le_bytes());
            whole.update(name.as_bytes());
            whole.update(&(bytes.len() as u64).to_le_bytes());
            whole.update(blake3::hash(&bytes).as_bytes());
        }
        let reader = PushtReader::open(&fixture(name)).unwrap();
        assert_eq!(&reader.source_hash(&|| false).unwrap(), whole.finalize().as_bytes());
    }
}

/// Other arrays, a folder of checkpoints, and files of editors and file managers, including unreadable ones.
#[test]
fn unrelated_files_do_not_affect_the_hash() {
    let copy = Copy::of("original");
    let hash = || PushtReader::open(&copy.path()).unwrap().source_hash(&|| false).unwrap();
    let reference = hash();
    let at = |name: &str| copy.path().join(name);
    for folder in [
        "checkpoints",
        "data/timestamp",
        "data/state/.ipynb_checkpoints",
        "meta/info",
    ] {
        std::fs::create_dir(at(folder)).unwrap();
    }
    for file in [
        ".DS_Store",
        ".zmetadata",
        "checkpoints/last.ckpt",
        "data/extra",
        "data/timestamp/.zarray",
        "data/timestamp/0.0",
        "data/state/.DS_Store",
        "data/state/1.0.swp",
        "data/state/.1.0.tmp",
        "meta/info/.zarray",
    ] {
        std::fs::write(at(file), "{").unwrap();
    }
    for fifo in ["data/pipe", "data/state/pipe"] {
        assert!(
            std::process::Command::new("mkfifo")
                .arg(at(fifo))
                .status()
                .unwrap()
                .success()
        );
    }
    std::os::unix::fs::symlink("..", at("data/up")).unwrap();
    std::os::unix::fs::symlink("nowhere", at("data/state/dangling")).unwrap();
    assert_eq!(hash(), reference);
    assert_eq!(read_all(&copy.path()), read_all(&fixture("original")));
}

#[test]
fn a_folder_reads_the_same_under_another_name() {
    let folder = TempDir::new().unwrap();
    copy_folder(&fixture("mixed"), &folder.path().join("renamed"));
    assert_eq!(read_all(&folder.path().join("renamed")), read_all(&fixture("mixed")));
}

#[test]
fn warnings_are_counted_and_placed() {
    let warnings = |name: &str, selection: &Selection| {
        PushtReader::open(&fixture(name))
            .unwrap()
            .read_episodes(selection)
            .unwrap()
            .1
    };
    // The angle falls from 6 to 0 at frame 25, the 9th of episode 2; episode 1 has 5 frames.
    let found = warnings("original", &Selection::All);
    let brief: Vec<_> = found.iter().map(|w| (w.code, w.episode, w.frame, w.count)).collect();
    assert_eq!(
        brief,
        [
            (WarningCode::AngleSeam, Some(2), Some(8), 1),
            (WarningCode::ShortEpisode, Some(1), Some(0), 1)
        ]
    );
    assert!(warnings("original", &Selection::First(1)).is_empty());
    insta::assert_snapshot!(serde_json::to_string_pretty(&warnings("minimal", &Selection::All)).unwrap());

    let mut states: Vec<f64> = (0..FRAMES).flat_map(common::state).collect();
    states.copy_within(5 * 3..5 * 4, 5 * 4);
    // Equal states on both sides of an episode boundary are not a repetition.
    states.copy_within(5 * 11..5 * 12, 5 * 12);
    let mut actions: Vec<f64> = (0..FRAMES).flat_map(common::action).collect();
    actions[2 * 20] = -3.0;
    actions[2 * 21 + 1] = 512.5;
    let copy =
        Copy::of("original")
            .floats("data/state", &[FRAMES, 5], &states)
            .floats("data/action", &[FRAMES, 2], &actions);
    let found = PushtReader::open(&copy.path())
        .unwrap()
        .read_episodes(&Selection::All)
        .unwrap()
        .1;
    let brief: Vec<_> = found.iter().map(|w| (w.code, w.episode, w.frame, w.count)).collect();
    assert_eq!(
        brief,
        [
            (WarningCode::AngleSeam, Some(2), Some(8), 1),
            (WarningCode::ActionOutsideWindow, Some(2), Some(3), 2),
            (WarningCode::ShortEpisode, Some(1), Some(0), 1),
            (WarningCode::RepeatedState, Some(0), Some(4), 1),
        ]
    );
}

#[test]
fn planar_episodes_contain_the_columns() {
    let (episodes, _) = PushtReader::open(&fixture("original"))
        .unwrap()
        .read_episodes(&Selection::Last(2))
        .unwrap();
    let planar = episodes.planar_episodes();
    assert_eq!(
        planar.iter().map(|e| (e.source, e.frames.len())).collect::<Vec<_>>(),
        [(1, 5), (2, 13)]
    );
    let frame = planar[1].frames[4];
    let state = common::state(21);
    assert_eq!(
        [
            frame.eef.x,
            frame.eef.y,
            frame.object.x,
            frame.object.y,
            frame.object.theta
        ],
        state
    );
    assert_eq!([frame.action.x, frame.action.y], common::action(21));
    assert_eq!(frame.contacts, common::contacts(21));
    let (episodes, _) = PushtReader::open(&fixture("minimal"))
        .unwrap()
        .read_episodes(&Selection::All)
        .unwrap();
    assert!(episodes.planar_episodes()[0].frames[0].contacts.is_nan());
}
