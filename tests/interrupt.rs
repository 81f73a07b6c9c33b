//! Ctrl-C: the run ends soon, says so in one sentence, and leaves nothing half-written.

use std::io::{BufRead as _, BufReader, Read as _};
use std::os::unix::process::ExitStatusExt as _;
use std::time::{Duration, Instant};

use crate::support::{Place, assert_same_bytes, signal};

/// So many rollouts that no machine is done with them before it is interrupted.
const LONG: &str = "run small.toml --set rollout.seeds=0..200000 --policy paper";

/// Latest that an interrupted run may end, on a machine however busy. On a quiet one it takes some milliseconds.
const LATEST: Duration = Duration::from_secs(30);

/// The stage says that it was interrupted, or where it is too slow for that, the watchdog does.
#[track_caller]
fn assert_interrupted(said: &str) {
    assert!(
        said.starts_with("error: ") && said.contains(" was interrupted; nothing ") && said.contains(" again"),
        "{said}"
    );
}

#[test]
fn an_interrupted_run_ends_soon_and_leaves_nothing_half_written() {
    let place = Place::new();
    let mut child = place.start(LONG);
    let mut notes = BufReader::new(child.stderr.take().unwrap());
    let mut line = String::new();
    while !line.trim_start().starts_with("index") {
        line.clear();
        assert!(notes.read_line(&mut line).unwrap() > 0, "it ended before the rollouts");
    }
    // Into the rollouts, or before them: every moment is as good.
    std::thread::sleep(Duration::from_millis(200));
    signal(&child, "INT");
    let start = Instant::now();
    let mut said = String::new();
    notes.read_to_string(&mut said).unwrap();
    let status = child.wait().unwrap();
    let latency = start.elapsed();
    assert_eq!(status.code(), Some(2), "{said}");
    let mut out = String::new();
    child.stdout.take().unwrap().read_to_string(&mut out).unwrap();
    assert_eq!(out, "");
    assert_interrupted(said.lines().last().unwrap_or_default());
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
fn an_interrupt_at_any_moment_is_answered_cleanly() {
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
        let said = String::from_utf8(output.stderr).unwrap();
        match (output.status.code(), output.status.signal()) {
            // Done before the signal came.
            (Some(0), _) => {}
            (Some(2), _) => {
                let last = said.lines().last().unwrap_or_default();
                assert_interrupted(last);
            }
            // Before the program listens there is nothing to clean up.
            (None, Some(2)) => assert_eq!(said, ""),
            other => panic!("{other:?}: {said}"),
        }
        assert!(place.temporaries().is_empty(), "{:?}", place.temporaries());
        let whole = expected.bytes();
        assert!(
            place.bytes().iter().all(|(name, bytes)| whole.get(name) == Some(bytes)),
            "a part stayed"
        );
        if tenth % 3 == 0 {
            // Start over, so that the next signals meet every stage again.
            let _ = std::fs::remove_dir_all(place.artifacts());
        }
    }
    place.run("run small.toml").done();
    assert_same_bytes(&place.bytes(), &expected.bytes());
}
