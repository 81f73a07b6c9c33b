//! Only data with the bytes that were hashed is read: changes of files, removed and added files, and requests to stop.
#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    reason = "helpers of tests may fail like tests"
)]

mod common;

use std::fs;
use std::path::Path;
use std::sync::atomic::{AtomicU32, Ordering};

use common::{Copy, files_of, fixture, zip_files};
use re4_ingest::pusht::{PushtOptions, PushtReader};
use re4_ingest::{Fault, IngestError, Selection};
use tempfile::TempDir;

const NEVER: &(dyn Fn() -> bool + Sync) = &|| false;

fn is_change(error: &IngestError) -> bool {
    matches!(*error.fault, Fault::Changed { .. })
}

/// Opens, hashes and reads everything, with an event after the given step. Returns whether the result would be published.
fn run(dataset: &Path, step: usize, happens: &dyn Fn()) -> Result<(), IngestError> {
    let mut happened = false;
    let mut at = |number: usize| {
        if number == step && !happened {
            happened = true;
            happens();
        }
    };
    let reader = PushtReader::open(dataset)?;
    at(0);
    reader.source_hash(NEVER)?;
    at(1);
    let episodes = reader.read_episodes(&Selection::All)?.0;
    at(2);
    for block in reader.image_blocks_of(&episodes)? {
        block?;
        at(3);
    }
    at(4);
    reader.unchanged()
}

type Change = fn(&Path);

const CHANGES: [(&str, Change); 10] = [
    ("a chunk is rewritten", |store| {
        let path = store.join("data/state/3.0");
        fs::write(&path, fs::read(&path).unwrap()).unwrap();
    }),
    ("a chunk is replaced", |store| {
        fs::copy(store.join("data/action/1.0"), store.join("new")).unwrap();
        fs::rename(store.join("new"), store.join("data/action/1.0")).unwrap();
    }),
    ("a chunk is cut off", |store| {
        let file = fs::File::options()
            .write(true)
            .open(store.join("data/img/1.0.0.0"))
            .unwrap();
        file.set_len(10).unwrap();
    }),
    ("a chunk is removed", |store| {
        fs::remove_file(store.join("data/keypoint/2.0.0")).unwrap();
    }),
    ("a chunk is added", |store| {
        fs::write(store.join("data/state/99.0"), "x").unwrap();
    }),
    ("metadata is rewritten", |store| {
        let path = store.join("data/n_contacts/.zarray");
        let text = fs::read_to_string(&path).unwrap();
        fs::write(&path, text + " ").unwrap();
    }),
    ("ends are rewritten", |store| {
        let path = store.join("meta/episode_ends/0");
        fs::write(&path, fs::read(&path).unwrap()).unwrap();
    }),
    ("metadata of the group is removed", |store| {
        fs::remove_file(store.join("data/.zgroup")).unwrap();
    }),
    ("an array is replaced", |store| {
        fs::rename(store.join("data/state"), store.join("old")).unwrap();
        common::copy_folder(&fixture("original").join("data/state"), &store.join("data/state"));
    }),
    ("the store is moved away", |store| {
        fs::rename(store, store.with_extension("moved")).unwrap();
    }),
];

#[test]
fn a_source_that_changes_at_any_time_is_refused() {
    for (name, change) in CHANGES {
        for step in 0..5 {
            let copy = Copy::of("original");
            let outcome = run(&copy.path(), step, &|| change(&copy.path()));
            let error = outcome.expect_err(&format!("{name} after step {step}"));
            // Images are read ahead; after all have been read, only the final check detects a change.
            assert!(is_change(&error), "{name} after step {step}: {error}");
        }
    }
}

#[test]
fn an_unchanged_source_is_read() {
    for name in ["original", "format3"] {
        let copy = Copy::of(name);
        run(&copy.path(), 0, &|| {
            // Changes outside the dataset's files have no effect.
            fs::write(copy.path().join("data/note.txt"), "x").unwrap();
            fs::create_dir(copy.path().join("checkpoints")).unwrap();
        })
        .unwrap();
    }
}

/// The archive is read through one handle and its unpacked copy is hashed; a change of the archive is detected nevertheless.
#[test]
fn a_zip_file_that_changes_is_refused() {
    let folder = TempDir::new().unwrap();
    let path = folder.path().join("store.zip");
    let write = |name: &str| zip_files(&path, &files_of(&fixture(name), ""), true);
    for step in 0..5 {
        write("original");
        let error = run(&path, step, &|| write("modern")).unwrap_err();
        assert!(is_change(&error), "{step}: {error}");
        assert!(
            error.to_string().contains("store.zip changed while it was read"),
            "{error}"
        );
    }
    // Truncated while it is unpacked, so that the rest cannot be unpacked.
    write("original");
    let asked = AtomicU32::new(0);
    let stop = || {
        if asked.fetch_add(1, Ordering::Relaxed) == 20 {
            fs::File::options()
                .write(true)
                .open(&path)
                .unwrap()
                .set_len(100)
                .unwrap();
        }
        false
    };
    let error = PushtReader::open_for(&path, true, &stop).map(|_| ()).unwrap_err();
    assert!(is_change(&error), "{error}");
    // Replaced by an equal file, which could have been different.
    write("original");
    let stop = || {
        if asked.fetch_add(1, Ordering::Relaxed) == 40 {
            write("original");
        }
        false
    };
    asked.store(21, Ordering::Relaxed);
    let error = PushtReader::open_for(&path, true, &stop).map(|_| ()).unwrap_err();
    assert!(is_change(&error), "{error}");
}

#[test]
fn a_request_to_stop_is_honored_at_any_point() {
    let folder = TempDir::new().unwrap();
    let path = folder.path().join("store.zip");
    zip_files(&path, &files_of(&fixture("original"), ""), true);
    let is_stop = |error: &IngestError| matches!(*error.fault, Fault::Stopped);
    // Counts the calls of `stop`.
    let asked = AtomicU32::new(0);
    let attempt = |after: u32| {
        asked.store(0, Ordering::Relaxed);
        let stop = || asked.fetch_add(1, Ordering::Relaxed) >= after;
        let reader = PushtReader::open_for(&path, true, &stop)?;
        reader.source_hash(&stop)?;
        let options = PushtOptions {
            images: true,
            stop: &stop,
            ..PushtOptions::default()
        };
        reader.read(&Selection::All, &options).map(|_| ())
    };
    attempt(u32::MAX).unwrap();
    let all = asked.load(Ordering::Relaxed);
    assert!(all > 100, "{all}");
    for after in (0..all).step_by(7) {
        match attempt(after) {
            Err(error) => assert!(is_stop(&error), "{after} of {all}: {error}"),
            // Recently written files are listed twice, so that the later attempts may call `stop` less often.
            Ok(()) => assert!(asked.load(Ordering::Relaxed) <= after, "{after} of {all}"),
        }
    }
}
