//! A source that changes while it is read: it is refused in one sentence, or what was published is what stands in its key.
//!
//! `RE4_CHANGES=200 cargo test -p re4-pipe source_changes::` changes it more often than the default of 12 times each.

use std::collections::BTreeMap;
use std::fs::{self, OpenOptions};
use std::os::unix::fs::FileExt as _;
use std::path::{Path, PathBuf};
use std::process::Stdio;
use std::time::{Duration, Instant};

use crate::support::{Answer, Place, dataset, repository};

/// What happens to a file.
#[derive(Debug, Clone, Copy)]
enum Change {
    /// Another one is put into its place, as a sync does.
    Replaced,
    /// It loses its end.
    CutOff,
    /// Some of its bytes are written anew.
    Overwritten,
}

/// A generator of numbers: xorshift64*.
struct Numbers(u64);

impl Numbers {
    fn next(&mut self, below: u64) -> u64 {
        self.0 ^= self.0 >> 12;
        self.0 ^= self.0 << 25;
        self.0 ^= self.0 >> 27;
        self.0.wrapping_mul(0x2545_f491_4f6c_dd1d) % below
    }
}

/// A source, and the file of it that changes.
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

    /// A store, whose chunk of states changes to that of one with other episodes.
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

    /// What an undisturbed ingest of the source as it is makes of it; nothing where it is refused.
    fn expected(&self) -> BTreeMap<String, Vec<u8>> {
        let output = self.start("expected").wait_with_output().unwrap();
        let answer = Answer::new(&output, self.place.path());
        assert!(matches!(answer.code, Some(0 | 2)), "{}", answer.stderr);
        self.artifacts("expected")
    }

    /// Files of the artifacts in a folder, which is then removed.
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

/// Puts other content into the place of a file in one step.
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
    // The moments cover a run and a little more; where the machine is slower, fewer of them come too late.
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
            // It was done before the change, or began after it.
            assert!(made == before || made == case.expected(), "{change:?}: made of neither");
            "done"
        } else {
            let said = answer.refused_at_once();
            assert!(made.is_empty(), "{change:?}: published and refused: {said}");
            if said.contains("changed while it was read") {
                "refused as changed"
            } else {
                // It began after the change, and the source is refused as it now is.
                assert!(case.expected().is_empty(), "{change:?}: {said}");
                "refused as it is"
            }
        };
        *counts.entry(format!("{change:?} {what}")).or_default() += 1;
        replace(&case.file, &original);
    }
    println!("{counts:?}");
}

#[test]
fn an_hdf5_file_that_changes_is_not_published_as_what_it_was() {
    changed_at_any_moment(&Case::hdf5(false), 1);
}

#[test]
fn an_hdf5_file_that_changes_while_the_library_reads_it_is_not_published_as_what_it_was() {
    changed_at_any_moment(&Case::hdf5(true), 2);
}

#[test]
fn a_store_that_changes_is_not_published_as_what_it_was() {
    changed_at_any_moment(&Case::store(), 3);
}
