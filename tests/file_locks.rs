//! A store on file systems that have no locks between machines, or none at all: no process removes what another one is writing.
//!
//! A preloaded library (`tests/file_locks.c`) replaces `flock` and the name of the machine. Processes are stopped in the middle of a
//! part, so that others certainly run meanwhile.

use std::collections::{BTreeMap, BTreeSet};
use std::fs::{self, File, TryLockError};
use std::path::PathBuf;
use std::process::{Child, Command, Stdio};

use tempfile::TempDir;

use crate::support::{Place, assert_same_bytes, repository, signal, wait_for};

/// Rollouts of three parts.
const ROLLOUT: &str = "rollout small.toml --seeds 300000..302500 --max-steps 8 --jobs 1 --quiet";

/// How often a process that has ended before it was stopped is started again.
const TRIES: usize = 20;

/// The library, and files with the names of two machines.
struct Library(TempDir);

impl Library {
    fn new() -> Self {
        let folder = TempDir::with_prefix("re4-").unwrap();
        let compiled = Command::new("cc")
            .args(["-shared", "-fPIC", "-O1", "-o"])
            .arg(folder.path().join("locks.so"))
            .arg(repository().join("tests/file_locks.c"))
            .arg("-ldl")
            .status();
        assert!(compiled.unwrap().success());
        for name in ["node1", "node2"] {
            fs::write(folder.path().join(name), format!("{name}\n")).unwrap();
        }
        Self(folder)
    }

    /// Starts the rollouts on a machine with this name. `locks` is `free` or `none`.
    fn start(&self, place: &Place, node: &str, locks: &str) -> Writer {
        let mut command = place.command();
        command
            .args(ROLLOUT.split(' '))
            .env("LD_PRELOAD", self.0.path().join("locks.so"))
            .env("RE4_TEST_HOSTNAME", self.0.path().join(node))
            .env("RE4_TEST_FLOCK", locks)
            .stdout(Stdio::null());
        Writer(command.spawn().unwrap())
    }
}

/// Temporary folders of a process: `.tmp-WHAT-HOST-BOOT-NAMESPACE-PROCESS-START-RANDOM`.
fn unfinished(place: &Place, process: u32) -> Vec<PathBuf> {
    let entries = fs::read_dir(place.artifacts()).into_iter().flatten();
    let of_process = |path: &PathBuf| {
        let name = path.file_name().unwrap().to_str().unwrap();
        name.split('-').nth(5) == Some(&process.to_string())
    };
    entries
        .filter_map(|entry| Some(entry.ok()?.path()))
        .filter(of_process)
        .collect()
}

/// Stops a process in the middle of a part, after `before` others. Returns its temporary folders; `None` if it has ended before.
fn caught(place: &Place, child: &mut Child, before: usize) -> Option<Vec<PathBuf>> {
    let mut seen = BTreeSet::new();
    wait_for("a process in the middle of a part", || {
        if child.try_wait().unwrap().is_some() {
            return Some(None);
        }
        let own = unfinished(place, child.id());
        seen.extend(own.clone());
        if own.is_empty() || seen.len() <= before {
            return None;
        }
        signal(child, "STOP");
        wait_for("a stopped process", || {
            let state = fs::read_to_string(format!("/proc/{}/stat", child.id())).unwrap();
            matches!(state.rsplit_once(") ")?.1.chars().next()?, 'T' | 'Z').then_some(())
        });
        let whole = own.iter().all(|path| path.is_dir());
        if !whole {
            signal(child, "CONT");
        }
        whole.then_some(Some(own))
    })
}

/// A process that is killed if the test fails while it is stopped.
struct Writer(Child);

impl Writer {
    /// Lets it go on.
    fn go_on(&self) {
        signal(&self.0, "CONT");
    }

    #[track_caller]
    fn ends_well(mut self) {
        assert_eq!(self.0.wait().unwrap().code(), Some(0));
    }
}

impl Drop for Writer {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// The files in folders that exist, by path.
fn files(folders: &[PathBuf]) -> BTreeMap<PathBuf, u64> {
    let entries = folders
        .iter()
        .flat_map(|folder| fs::read_dir(folder).into_iter().flatten());
    entries
        .map(Result::unwrap)
        .map(|entry| (entry.path(), entry.metadata().unwrap().len()))
        .collect()
}

/// One process is stopped in the middle of its second part, as a node that is lost for the others. Another one runs meanwhile: to its end,
/// or, if `together`, into the middle of a part, and then both go on. Returns the artifacts; `None` if a process was not stopped in
/// time.
fn two_writers(library: &Library, nodes: [&str; 2], locks: &str, together: bool) -> Option<BTreeMap<String, Vec<u8>>> {
    let place = Place::new();
    place.run("index small.toml").done();
    let mut first = library.start(&place, nodes[0], locks);
    let own = caught(&place, &mut first.0, 1)?;
    for folder in &own {
        // The replaced functions were used.
        let name = folder.file_name().unwrap().to_str().unwrap();
        assert_eq!(name.split('-').nth(2), Some(nodes[0]), "{name}");
        let lock = File::open(folder).unwrap().try_lock();
        assert!(!matches!(lock, Err(TryLockError::WouldBlock)), "{name} is locked");
    }
    let written = files(&own);
    assert!(!written.is_empty());
    let mut second = library.start(&place, nodes[1], locks);
    if together {
        let theirs = caught(&place, &mut second.0, 0)?;
        assert!(!theirs.is_empty());
        assert_eq!(files(&own), written, "another process removed what a process writes");
        second.go_on();
        first.go_on();
        second.ends_well();
    } else {
        second.ends_well();
        assert_eq!(files(&own), written, "another process removed what a process writes");
        first.go_on();
    }
    first.ends_well();
    assert_eq!(place.temporaries(), Vec::<PathBuf>::new());
    place.run("verify").done();
    Some(place.bytes())
}

#[test]
fn a_writer_survives_another_machine_without_locks_between_them() {
    let library = Library::new();
    let place = Place::new();
    place.run(ROLLOUT).done();
    let expected = place.bytes();
    for locks in ["free", "none"] {
        for (second, together) in [("node2", false), ("node2", true), ("node1", false)] {
            let made = (0..TRIES).find_map(|_| two_writers(&library, ["node1", second], locks, together));
            assert_same_bytes(&made.unwrap(), &expected);
        }
    }
}
