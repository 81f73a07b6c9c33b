//! A source that changes while it is read is refused with one sentence, or the published artifact matches the hash in its key.
//!
//! `RE4_CHANGES=200 cargo test -p re4-pipe source_changes::` makes more changes than the default of 12 per test.

use std::collections::BTreeMap;
use std::fs::{self, OpenOptions};
use std::os::unix::fs::FileExt as _;
use std::path::{Path, PathBuf};
use std::process::Stdio;
use std::time::{Duration, Instant};

use crate::support::{Answer, Place, dataset, repository};

/// A change of a file.
#[derive(Debug, Clone, Copy)]
enum Change {
    /// It is replaced by another file, as by a synchronization.
    Replaced,
    /// It is truncated.
    CutOff,
    /// Some of its bytes are overwritten.
    Overwritten,
}

/// A seeded random number generator (xorshift64*).
struct Numbers(u64);

impl Numbers {
    fn next(&mut self, below: u64) -> u64 {
        self.0 ^= self.0 >> 12;
        self.0 ^= self.0 << 25;
        self.0 ^= self.0 >> 27;
        self.0.wrapping_mul(0x2545_f491_4f6c_dd1d) % below
    }
}

/// A source, and the file in it that changes.
struct Case {
    place: Place,
    file: PathBuf,
    other: Vec<u8>,
    library: bool,
}

impl Case {
    fn hdf5(library: bool) -> Self {
        let place = Place::empty();
        let file = place.path().join("data/source.hdf5");
        fs::copy(repository().join("data/can-sample.hdf5"), &file).unwrap();
        place.write(
            "pipeline.toml",
            "task = \"can\"\n[ingest]\nsource = \"source.hdf5\"\n[segment]\n",
        );
        let other = fs::read(repository().join("crates/re4-ingest/tests/fixtures/hdf5/plain.hdf5")).unwrap();
        Self {
            place,
            file,
            other,
            library,
        }
    }

    /// A zarr store whose chunk of states is replaced by that of a store with other episodes.
    fn store() -> Self {
        let place = Place::empty();
        let folder = place.path().join("data/source.zarr");
        dataset::write(&folder, 12, true);
        let others = place.path().join("other.zarr");
        dataset::write(&others, 11, true);
        place.write(
            "pipeline.toml",
            "task = \"pusht\"\n[ingest]\nsource = \"source.zarr\"\n[segment]\n",
        );
        Self {
            file: folder.join("data/state/0.0"),
            other: fs::read(others.join("data/state/0.0")).unwrap(),
            place,
            library: false,
        }
    }

    fn start(&self, artifacts: &str) -> std::process::Child {
        let mut command = self.place.command();
        if self.library {
            command.env("RE4_HDF5", "library");
        }
        command
            .args(["ingest", "pipeline.toml", "--quiet", "--artifacts", artifacts])
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .unwrap()
    }

    /// The artifact bytes of an undisturbed ingest of the source in its present state; empty if it is refused.
    fn expected(&self) -> BTreeMap<String, Vec<u8>> {
        let output = self.start("expected").wait_with_output().unwrap();
        let answer = Answer::new(&output, self.place.path());
        assert!(matches!(answer.code, Some(0 | 2)), "{}", answer.stderr);
        self.artifacts("expected")
    }

    /// Returns the artifact bytes in a folder, and removes the folder.
    fn artifacts(&self, folder: &str) -> BTreeMap<String, Vec<u8>> {
        let folder = self.place.path().join(folder);
        let bytes = crate::support::artifact_bytes(&folder);
        let _ = fs::remove_dir_all(folder);
        bytes
    }

    fn change(&self, change: Change, numbers: &mut Numbers) {
        let length = fs::metadata(&self.file).unwrap().len();
        let open = || OpenOptions::new().write(true).open(&self.file).unwrap();
        match change {
            Change::Replaced => replace(&self.file, &self.other),
            Change::CutOff => open().set_len(numbers.next(length)).unwrap(),
            Change::Overwritten => {
                let at = numbers.next(length - 8);
                open().write_all_at(&numbers.next(u64::MAX).to_le_bytes(), at).unwrap();
            }
        }
    }
}

/// Replaces a file atomically.
fn replace(file: &Path, content: &[u8]) {
    let new = file.with_extension("new");
    fs::write(&new, content).unwrap();
    fs::rename(new, file).unwrap();
}

fn changed_at_any_moment(case: &Case, seed: u64) {
    let tries = std::env::var("RE4_CHANGES")
        .ok()
        .and_then(|text| text.parse().ok())
        .unwrap_or(12);
    let original = fs::read(&case.file).unwrap();
    let start = Instant::now();
    let before = case.expected();
    assert!(!before.is_empty());
    // The moments cover the duration of a run and a little more.
    let span = start.elapsed().as_micros() as u64;
    let mut numbers = Numbers(seed);
    let mut counts: BTreeMap<String, u32> = BTreeMap::new();
    for number in 0..tries {
        let change = [Change::Replaced, Change::CutOff, Change::Overwritten][number % 3];
        let child = case.start("artifacts");
        std::thread::sleep(Duration::from_micros(numbers.next(span)));
        case.change(change, &mut numbers);
        let output = child.wait_with_output().unwrap();
        let answer = Answer::new(&output, case.place.path());
        assert!(
            case.place.temporaries().is_empty(),
            "{change:?}: {:?}",
            case.place.temporaries()
        );
        let made = case.artifacts("artifacts");
        let what = if answer.code == Some(0) {
            // The run finished before the change or began after it.
            assert!(
                made == before || made == case.expected(),
                "{change:?}: the artifact matches neither content"
            );
            "done"
        } else {
            let message = answer.refused_at_once();
            assert!(
                made.is_empty(),
                "{change:?}: an artifact was published with an error: {message}"
            );
            if message.contains("changed while it was read") {
                "refused as changed"
            } else {
                // The run began after the change, and the changed source is not valid.
                assert!(case.expected().is_empty(), "{change:?}: {message}");
                "refused as invalid"
            }
        };
        *counts.entry(format!("{change:?} {what}")).or_default() += 1;
        replace(&case.file, &original);
    }
    println!("{counts:?}");
}

#[test]
fn a_changing_hdf5_file_is_not_published_under_its_old_hash() {
    changed_at_any_moment(&Case::hdf5(false), 1);
}

#[test]
fn a_changing_hdf5_file_that_the_library_reads_is_not_published_under_its_old_hash() {
    changed_at_any_moment(&Case::hdf5(true), 2);
}

#[test]
fn a_changing_store_is_not_published_under_its_old_hash() {
    changed_at_any_moment(&Case::store(), 3);
}
