//! Damaged HDF5 files and crashing workers: the program prints one sentence, exits with code 2 and leaves no files behind.

use std::collections::BTreeMap;
use std::fs;
use std::process::{Command, Stdio};
use std::time::Instant;

use crate::support::{Answer, Gate, LONGEST, Place, assert_same_bytes, filters, repository, signal};
use insta::{assert_snapshot, with_settings};

/// Number of mutated copies. `RE4_MUTATIONS` overrides it.
const MUTATIONS: u64 = 40;

fn place(select: &str) -> Place {
    let place = Place::empty();
    fs::copy(
        repository().join("data/can-sample.hdf5"),
        place.path().join("data/can.hdf5"),
    )
    .unwrap();
    place.write(
        "can.toml",
        format!("task = \"can\"\n[ingest]\nsource = \"can.hdf5\"\nselect = {select}\n[segment]\n"),
    );
    place
}

/// A seeded random number generator (splitmix64).
struct Numbers(u64);

impl Numbers {
    fn next(&mut self, below: u64) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        (z ^ (z >> 31)) % below
    }
}

/// Flips bits, overwrites bytes, or truncates the file. Most changes are near the start, which has most of the structure.
fn mutate(bytes: &mut Vec<u8>, seed: u64) {
    let mut numbers = Numbers(seed);
    let length = bytes.len() as u64;
    if numbers.next(10) == 0 {
        bytes.truncate(numbers.next(length) as usize);
        return;
    }
    let changes = 1 << numbers.next(8);
    let near = numbers.next(3) > 0;
    for _ in 0..changes {
        let place = if near {
            numbers.next(16_384)
        } else {
            numbers.next(length)
        };
        let byte = &mut bytes[place as usize];
        *byte = match numbers.next(4) {
            0 => 0,
            1 => 0xff,
            2 => numbers.next(256) as u8,
            _ => *byte ^ (1 << numbers.next(8)),
        };
    }
}

/// Every mutated copy is ingested or refused with one sentence, without another exit code, a hang or files left behind.
#[test]
fn mutated_files_are_ingested_or_refused_with_one_sentence() {
    let mutations = std::env::var("RE4_MUTATIONS").ok().and_then(|text| text.parse().ok());
    let first: u64 = std::env::var("RE4_MUTATIONS_FROM")
        .ok()
        .and_then(|text| text.parse().ok())
        .unwrap_or(0);
    let place = place("{ first = 3 }");
    let original = fs::read(place.path().join("data/can.hdf5")).unwrap();
    let mut counts: BTreeMap<&str, u64> = BTreeMap::new();
    for seed in first..first + mutations.unwrap_or(MUTATIONS) {
        let mut bytes = original.clone();
        mutate(&mut bytes, seed);
        place.write("data/can.hdf5", &bytes);
        let _ = fs::remove_dir_all(place.artifacts());
        let start = Instant::now();
        let output = place
            .command()
            .args(["ingest", "can.toml", "--quiet"])
            .env("RE4_HDF5", "library")
            .env("RE4_WORKER_PATIENCE", "10")
            .output()
            .unwrap();
        let answer = Answer::new(&output, place.path());
        let kind = if answer.code == Some(0) {
            "accepted"
        } else {
            let message = answer.refused();
            assert!(!message.contains("stopped with exit code"), "seed {seed}: {message}");
            if message.contains("library crashed") {
                println!("seed {seed}: {message}");
                "the library crashed"
            } else if message.contains("no progress") {
                println!("seed {seed}: {message}");
                "the library hung"
            } else if message.contains("GiB of memory") {
                println!("seed {seed}: {message}");
                "out of memory"
            } else {
                "refused"
            }
        };
        *counts.entry(kind).or_default() += 1;
        assert!(start.elapsed() < LONGEST, "seed {seed} took {:?}", start.elapsed());
        assert!(place.temporaries().is_empty(), "seed {seed}: {:?}", place.temporaries());
    }
    println!("{counts:?}");
}

/// A command that ingests the sample, with a gate at which its worker waits after the first demonstration, in the middle of
/// writing the artifact.
fn at_gate(place: &Place) -> (Command, Gate) {
    let mut command = place.command();
    command
        .args(["ingest", "can.toml", "--quiet"])
        .stdout(Stdio::piped())
        .stderr(Stdio::piped());
    let gate = Gate::before(&mut command, place, 1);
    (command, gate)
}

#[test]
fn a_killed_or_hanging_worker_is_reported() {
    let mut errors = Vec::new();
    for name in ["KILL", "TERM"] {
        let place = place("\"all\"");
        let (mut command, gate) = at_gate(&place);
        let mut child = command.spawn().unwrap();
        let worker = gate.wait(&mut child);
        assert!(!place.temporaries().is_empty(), "the artifact was not begun");
        worker.end_by(name);
        let answer = Answer::new(&child.wait_with_output().unwrap(), place.path());
        errors.push(format!("{name}: {}", by_either(&answer.refused_at_once())));
        assert!(place.temporaries().is_empty(), "{:?}", place.temporaries());
        place.run("ingest can.toml").done();
    }
    // The worker is silent at the gate or, on a busy machine, already before it.
    let place = place("\"all\"");
    let (mut command, gate) = at_gate(&place);
    let output = command.env("RE4_WORKER_PATIENCE", "1").output().unwrap();
    errors.push(format!(
        "silent: {}",
        Answer::new(&output, place.path()).refused_at_once()
    ));
    assert!(
        gate.worker().is_none_or(|worker| !worker.is_running()),
        "the worker is still running"
    );
    assert!(place.temporaries().is_empty(), "{:?}", place.temporaries());
    with_settings!({ filters => filters() }, { assert_snapshot!(errors.join("\n")) });
}

/// After the library has crashed, a second worker reads the file cautiously, and here finds no error.
#[test]
fn after_a_crash_of_the_library_ingest_tries_again() {
    let undisturbed = place("\"all\"");
    undisturbed.run("ingest can.toml").done();
    for name in ["SEGV", "ABRT", "BUS"] {
        let place = place("\"all\"");
        let (mut command, gate) = at_gate(&place);
        let mut child = command.spawn().unwrap();
        let worker = gate.wait(&mut child);
        worker.end_by(name);
        Answer::new(&child.wait_with_output().unwrap(), place.path()).done();
        assert!(place.temporaries().is_empty(), "{name}: {:?}", place.temporaries());
        assert_same_bytes(&place.bytes(), &undisturbed.bytes());
    }
}

#[test]
fn a_worker_ends_with_its_parent_and_leaves_no_files() {
    let place = place("\"all\"");
    let (mut command, gate) = at_gate(&place);
    let mut child = command.spawn().unwrap();
    let worker = gate.wait(&mut child);
    child.kill().unwrap();
    child.wait().unwrap();
    worker.wait();
    assert!(place.temporaries().is_empty(), "{:?}", place.temporaries());
}

/// The interruption is reported by the stage or, if the stage is too slow, by the watchdog; makes both messages equal.
fn by_either(message: &str) -> String {
    message.replace("the run was interrupted", "ingest was interrupted")
}

#[test]
fn an_interrupt_ends_both_processes_and_leaves_no_files() {
    let place = place("\"all\"");
    let (mut command, gate) = at_gate(&place);
    let mut child = command.spawn().unwrap();
    let worker = gate.wait(&mut child);
    signal(&child, "INT");
    let answer = Answer::new(&child.wait_with_output().unwrap(), place.path());
    assert_eq!(
        by_either(&answer.interrupted_at_once()),
        "error: ingest was interrupted; no unfinished artifact remains, so run the same command again to continue"
    );
    assert!(!worker.is_running(), "the worker lives on");
    assert!(place.temporaries().is_empty(), "{:?}", place.temporaries());
}

#[test]
fn the_worker_command_is_internal() {
    let place = Place::empty();
    assert_eq!(
        place.run("ingest-worker").refused_at_once(),
        "error: ingest-worker is an internal command: EOF while parsing a value at line 1 column 0; use re4-pipe ingest"
    );
}
