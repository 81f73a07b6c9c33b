//! Damaged HDF5 files and dying workers: one sentence, exit code 2, nothing left behind.
#![allow(
    clippy::unwrap_used,
    clippy::panic,
    clippy::print_stdout,
    reason = "a test may stop where it fails"
)]

mod support;

use std::collections::BTreeMap;
use std::fs;
use std::path::Path;
use std::process::{Child, Command};
use std::time::{Duration, Instant};

use insta::{assert_snapshot, with_settings};
use support::{Answer, Place, filters, repository};

/// Mutated copies in an ordinary run; `RE4_MUTATIONS` says another number.
const MUTATIONS: u64 = 40;

/// Longest that a run on a small file may take.
const HUNG: Duration = Duration::from_secs(30);

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
        assert!(start.elapsed() < HUNG, "seed {seed} took {:?}", start.elapsed());
        assert!(place.temporaries().is_empty(), "seed {seed}: {:?}", place.temporaries());
    }
    println!("{counts:?}");
}

/// The process that reads HDF5 for this one, stopped as soon as it is there.
fn stopped_worker(child: &Child) -> u32 {
    let list = format!("/proc/{0}/task/{0}/children", child.id());
    let start = Instant::now();
    while start.elapsed() < HUNG {
        // A worker shows in its arguments; before that the child is still a copy of its parent.
        if let Some(worker) = fs::read_to_string(&list)
            .ok()
            .and_then(|text| text.split_whitespace().next()?.parse().ok())
            && fs::read_to_string(format!("/proc/{worker}/cmdline")).is_ok_and(|line| line.contains("ingest-worker"))
        {
            signal(worker, "STOP");
            return worker;
        }
    }
    panic!("no worker");
}

fn signal(process: u32, name: &str) {
    let status = Command::new("sh")
        .args(["-c", &format!("kill -{name} {process}")])
        .status()
        .unwrap();
    assert!(status.success());
}

/// A file that takes long enough to read for its reader to be stopped.
fn long_place() -> Place {
    place("\"all\"")
}

#[test]
fn a_worker_that_dies_or_hangs_is_told_of_in_one_sentence() {
    let mut told = Vec::new();
    for name in ["SEGV", "ABRT", "BUS", "KILL", "TERM"] {
        let place = long_place();
        let child = place.start("ingest can.toml --quiet");
        let worker = stopped_worker(&child);
        signal(worker, name);
        if name != "KILL" {
            signal(worker, "CONT");
        }
        let answer = Answer::new(&child.wait_with_output().unwrap(), place.path());
        told.push(format!("{name}: {}", answer.refused_at_once()));
        assert!(place.temporaries().is_empty(), "{:?}", place.temporaries());
        place.run("ingest can.toml").done();
    }
    let place = long_place();
    let child = place
        .command()
        .args(["ingest", "can.toml", "--quiet"])
        .env("RE4_WORKER_PATIENCE", "1")
        .stdout(std::process::Stdio::piped())
        .stderr(std::process::Stdio::piped())
        .spawn()
        .unwrap();
    let worker = stopped_worker(&child);
    let answer = Answer::new(&child.wait_with_output().unwrap(), place.path());
    told.push(format!("silent: {}", answer.refused_at_once()));
    assert!(!Path::new(&format!("/proc/{worker}")).exists(), "the worker lives on");
    with_settings!({ filters => filters() }, { assert_snapshot!(told.join("\n")) });
}

#[test]
fn a_worker_ends_with_its_parent_and_leaves_nothing() {
    let place = long_place();
    let mut child = place.start("ingest can.toml --quiet");
    let worker = stopped_worker(&child);
    child.kill().unwrap();
    child.wait().unwrap();
    signal(worker, "CONT");
    let start = Instant::now();
    while Path::new(&format!("/proc/{worker}")).exists() {
        assert!(start.elapsed() < HUNG, "the worker lives on");
        std::thread::sleep(Duration::from_millis(10));
    }
    assert!(place.temporaries().is_empty(), "{:?}", place.temporaries());
}

#[test]
fn an_interrupt_ends_both_and_leaves_nothing() {
    let place = long_place();
    let child = place.start("ingest can.toml --quiet");
    let worker = stopped_worker(&child);
    signal(child.id(), "INT");
    std::thread::sleep(Duration::from_millis(200));
    signal(worker, "CONT");
    let answer = Answer::new(&child.wait_with_output().unwrap(), place.path());
    assert_eq!(
        answer.refused_at_once(),
        "error: ingest was interrupted; nothing half-written was left, run the same command again to go on"
    );
    assert!(!Path::new(&format!("/proc/{worker}")).exists(), "the worker lives on");
    assert!(place.temporaries().is_empty(), "{:?}", place.temporaries());
}

#[test]
fn the_worker_is_no_command_for_people() {
    let place = long_place();
    assert_eq!(
        place.run("ingest-worker").refused_at_once(),
        "error: ingest-worker is started by re4-pipe itself: EOF while parsing a value at line 1 column 0; use re4-pipe ingest"
    );
}
