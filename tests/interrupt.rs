//! Ctrl-C: the run ends soon, prints one sentence, and leaves nothing half-written.

use std::io::{BufRead as _, BufReader, Read as _};
use std::os::unix::process::ExitStatusExt as _;
use std::time::{Duration, Instant};

use crate::support::{Place, assert_same_bytes, signal};

/// More rollouts than any machine finishes before the interrupt.
const LONG: &str = "run small.toml --set rollout.seeds=0..200000 --policy paper";

/// Maximum time that an interrupted run may take to end on a busy machine. On an idle one it takes some milliseconds.
const LATEST: Duration = Duration::from_secs(30);

/// The interruption is reported by the stage or, if the stage is too slow, by the watchdog.
#[track_caller]
fn assert_interrupted(message: &str) {
    assert!(
        message.starts_with("error: ")
            && message.contains(" was interrupted; no unfinished artifact ")
            && message.contains(" again"),
        "{message}"
    );
}

#[test]
fn an_interrupted_run_ends_soon_and_leaves_nothing_half_written() {
    interrupted_during_rollouts("INT");
}

/// Slurm and Kubernetes end, preempt and cancel with SIGTERM.
#[test]
fn a_terminated_run_ends_soon_and_leaves_nothing_half_written() {
    interrupted_during_rollouts("TERM");
}

fn interrupted_during_rollouts(name: &str) {
    let place = Place::new();
    let mut child = place.start(LONG);
    let mut notes = BufReader::new(child.stderr.take().unwrap());
    let mut line = String::new();
    while !line.trim_start().starts_with("index") {
        line.clear();
        assert!(
            notes.read_line(&mut line).unwrap() > 0,
            "the run ended before the rollouts"
        );
    }
    // The signal may arrive before or during the rollouts; both are fine.
    std::thread::sleep(Duration::from_millis(200));
    signal(&child, name);
    let start = Instant::now();
    let mut message = String::new();
    notes.read_to_string(&mut message).unwrap();
    let status = child.wait().unwrap();
    let latency = start.elapsed();
    assert_eq!(status.code(), Some(75), "{message}");
    let mut out = String::new();
    child.stdout.take().unwrap().read_to_string(&mut out).unwrap();
    assert_eq!(out, "");
    assert_interrupted(message.lines().last().unwrap_or_default());
    println!("it took {latency:?} to stop");
    assert!(latency < LATEST, "it took {latency:?} to stop");
    assert!(place.temporaries().is_empty(), "{:?}", place.temporaries());
    assert!(place.bytes().keys().all(|name| !name.starts_with("rollouts/")));
    place.run("run small.toml").done();
    let other = Place::new();
    other.run("run small.toml").done();
    assert_same_bytes(&place.bytes(), &other.bytes());
}

#[test]
fn an_interrupt_at_any_moment_is_handled_cleanly() {
    let expected = Place::new();
    let start = Instant::now();
    expected.run("run small.toml").done();
    let wall = start.elapsed();
    let place = Place::new();
    for tenth in 0..=10 {
        let child = place.start("run small.toml");
        std::thread::sleep(wall * tenth / 10);
        signal(&child, "INT");
        let output = child.wait_with_output().unwrap();
        let message = String::from_utf8(output.stderr).unwrap();
        match (output.status.code(), output.status.signal()) {
            // The run had finished before the signal arrived.
            (Some(0), _) => {}
            (Some(75), _) => {
                let last = message.lines().last().unwrap_or_default();
                assert_interrupted(last);
            }
            // The signal arrived before the program handled it; nothing has to be removed.
            (None, Some(2)) => assert_eq!(message, ""),
            other => panic!("{other:?}: {message}"),
        }
        assert!(place.temporaries().is_empty(), "{:?}", place.temporaries());
        let whole = expected.bytes();
        assert!(
            place.bytes().iter().all(|(name, bytes)| whole.get(name) == Some(bytes)),
            "an incomplete file was left"
        );
        if tenth % 3 == 0 {
            // Deletes the artifacts, so that the next signals arrive during all stages again.
            let _ = std::fs::remove_dir_all(place.artifacts());
        }
    }
    place.run("run small.toml").done();
    assert_same_bytes(&place.bytes(), &expected.bytes());
}
