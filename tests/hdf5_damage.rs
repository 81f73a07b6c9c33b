//! Damaged HDF5 files and dying workers: one sentence, exit code 2, nothing left behind.

use std::collections::BTreeMap;
use std::fs;
use std::process::{Command, Stdio};
use std::time::Instant;

use crate::support::{Answer, Gate, LONGEST, Place, assert_same_bytes, filters, repository, signal};
use insta::{assert_snapshot, with_settings};

/// Mutated copies in an ordinary run; `RE4_MUTATIONS` says another number.
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

/// A generator of numbers from a seed: splitmix64.
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

/// Flips bits, overwrites bytes, or cuts the file off; most changes are where most of the structure is.
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

/// Every mutated copy is ingested or refused in one sentence: no other exit code, no hang, nothing left behind.
#[test]
fn mutated_files_never_end_without_our_own_sentence() {
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
            let said = answer.refused();
            assert!(!said.contains("stopped with exit code"), "seed {seed}: {said}");
            if said.contains("fell over") {
                println!("seed {seed}: {said}");
                "the library fell over"
            } else if said.contains("no headway") {
                println!("seed {seed}: {said}");
                "hung and ended"
            } else if said.contains("GiB of memory") {
                println!("seed {seed}: {said}");
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

/// The program that ingests the sample, with a gate at which its worker waits after the first demonstration: what it writes is
/// begun, and not done.
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
fn a_worker_that_dies_or_hangs_is_told_of_in_one_sentence() {
    let mut told = Vec::new();
    for name in ["KILL", "TERM"] {
        let place = place("\"all\"");
        let (mut command, gate) = at_gate(&place);
        let mut child = command.spawn().unwrap();
        let worker = gate.wait(&mut child);
        assert!(!place.temporaries().is_empty(), "nothing was begun");
        worker.end_by(name);
        let answer = Answer::new(&child.wait_with_output().unwrap(), place.path());
        told.push(format!("{name}: {}", by_whoever(&answer.refused_at_once())));
        assert!(place.temporaries().is_empty(), "{:?}", place.temporaries());
        place.run("ingest can.toml").done();
    }
    // Whether it is silent at the gate or, on a busy machine, on its way there.
    let place = place("\"all\"");
    let (mut command, gate) = at_gate(&place);
    let output = command.env("RE4_WORKER_PATIENCE", "1").output().unwrap();
    told.push(format!(
        "silent: {}",
        Answer::new(&output, place.path()).refused_at_once()
    ));
    assert!(
        gate.worker().is_none_or(|worker| !worker.is_running()),
        "the worker lives on"
    );
    assert!(place.temporaries().is_empty(), "{:?}", place.temporaries());
    with_settings!({ filters => filters() }, { assert_snapshot!(told.join("\n")) });
}

/// Where the library falls over, another worker reads the file more cautiously, and here finds nothing wrong.
#[test]
fn a_library_that_falls_over_gets_a_second_try() {
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
fn a_worker_ends_with_its_parent_and_leaves_nothing() {
    let place = place("\"all\"");
    let (mut command, gate) = at_gate(&place);
    let mut child = command.spawn().unwrap();
    let worker = gate.wait(&mut child);
    child.kill().unwrap();
    child.wait().unwrap();
    worker.wait();
    assert!(place.temporaries().is_empty(), "{:?}", place.temporaries());
}

/// An interrupted stage says so, or where it is too slow for that, the watchdog does.
fn by_whoever(said: &str) -> String {
    said.replace("the run was interrupted", "ingest was interrupted")
}

#[test]
fn an_interrupt_ends_both_and_leaves_nothing() {
    let place = place("\"all\"");
    let (mut command, gate) = at_gate(&place);
    let mut child = command.spawn().unwrap();
    let worker = gate.wait(&mut child);
    signal(&child, "INT");
    let answer = Answer::new(&child.wait_with_output().unwrap(), place.path());
    assert_eq!(
        by_whoever(&answer.refused_at_once()),
        "error: ingest was interrupted; no unfinished artifact remains, so run the same command again to continue"
    );
    assert!(!worker.is_running(), "the worker lives on");
    assert!(place.temporaries().is_empty(), "{:?}", place.temporaries());
}

#[test]
fn the_worker_is_no_command_for_people() {
    let place = Place::empty();
    assert_eq!(
        place.run("ingest-worker").refused_at_once(),
        "error: ingest-worker is an internal command: EOF while parsing a value at line 1 column 0; use re4-pipe ingest"
    );
}
