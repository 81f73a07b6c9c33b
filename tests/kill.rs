//! Runs that are killed at random moments, and concurrent runs: the next run gives the same bytes as an undisturbed one.
//!
//! `RE4_KILLS=200 cargo test -p re4-pipe kill::` kills more often than the default of 12.

use std::collections::BTreeMap;
use std::fs;
use std::process::Child;
use std::time::{Duration, Instant};

use crate::support::{Place, assert_same_bytes};

const COMMAND: &str = "run small.toml --set rollout.seeds=500..512";

/// Bytes of an undisturbed run, and how long it took.
fn undisturbed() -> (BTreeMap<String, Vec<u8>>, Duration) {
    let place = Place::new();
    let start = Instant::now();
    place.run(COMMAND).done();
    (place.bytes(), start.elapsed())
}

/// Numbers in `[0, 1)` from a seed (splitmix64).
struct Moments(u64);

impl Moments {
    fn next(&mut self) -> f64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut bits = self.0;
        bits = (bits ^ (bits >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        bits = (bits ^ (bits >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        (bits >> 11) as f64 / (1_u64 << 53) as f64
    }
}

/// Kills programs at random moments of their runs.
struct Killer {
    moments: Moments,
    /// Approximate duration of a run.
    span: Duration,
}

impl Killer {
    fn new(seed: u64, wall: Duration) -> Self {
        Self {
            moments: Moments(seed),
            span: wall,
        }
    }

    /// Kills a program that was just started. Returns whether it was still running.
    fn kill(&mut self, child: &mut Child) -> bool {
        std::thread::sleep(self.span.mul_f64(self.moments.next()));
        child.kill().unwrap();
        let killed = child.wait().unwrap().code().is_none();
        // The duration of a run depends on the load of the machine, so the delay is adapted until three in four runs are killed
        // while they run.
        self.span = self.span.mul_f64(if killed { 1.1 } else { 0.75 });
        killed
    }
}

#[test]
fn a_killed_run_can_be_run_again() {
    let kills: usize = std::env::var("RE4_KILLS").map_or(12, |text| text.parse().unwrap());
    let (expected, wall) = undisturbed();
    let place = Place::new();
    let mut killer = Killer::new(20_260_726, wall);
    let (mut round, mut killed) = (0, 0);
    while round < kills || killed < kills / 2 {
        let _ = fs::remove_dir_all(place.artifacts());
        // Kills up to two of the runs that continue from there.
        for _ in 0..=round % 3 {
            killed += usize::from(killer.kill(&mut place.start(COMMAND)));
        }
        place.run(COMMAND).done();
        assert!(
            place.temporaries().is_empty(),
            "round {round}: {:?}",
            place.temporaries()
        );
        assert_same_bytes(&place.bytes(), &expected);
        round += 1;
        assert!(
            round < 20 * kills.max(1),
            "only {killed} runs were killed before they ended"
        );
    }
    place.run("verify").done();
}

#[test]
fn a_killed_recording_leaves_no_dataset() {
    let (_, wall) = undisturbed();
    let place = Place::new();
    let mut killer = Killer::new(7, wall);
    let out = place.path().join("out.zarr");
    for _ in 0..4 {
        killer.kill(&mut place.start(&format!("{COMMAND} --record out.zarr")));
        if out.exists() {
            // If the dataset exists, it is complete.
            re4_ingest::pusht::PushtReader::open(&out).unwrap();
            fs::remove_dir_all(&out).unwrap();
        }
    }
    place.run(&format!("{COMMAND} --record out.zarr")).done();
    re4_ingest::pusht::PushtReader::open(&out).unwrap();
}

#[test]
fn concurrent_runs_give_the_same_bytes() {
    let (expected, _) = undisturbed();
    for round in 0..3 {
        let place = Place::new();
        let children: Vec<_> = (0..2 + round).map(|_| place.start(COMMAND)).collect();
        for child in children {
            let output = child.wait_with_output().unwrap();
            let message = String::from_utf8_lossy(&output.stderr);
            assert_eq!(output.status.code(), Some(0), "{message}");
        }
        assert!(place.temporaries().is_empty(), "{:?}", place.temporaries());
        assert_same_bytes(&place.bytes(), &expected);
    }
}

#[test]
fn a_concurrent_run_survives_a_killed_one() {
    let (expected, wall) = undisturbed();
    let mut killer = Killer::new(99, wall);
    for _ in 0..3 {
        let place = Place::new();
        let mut victim = place.start(COMMAND);
        let survivor = place.start(COMMAND);
        killer.kill(&mut victim);
        let output = survivor.wait_with_output().unwrap();
        assert_eq!(
            output.status.code(),
            Some(0),
            "{}",
            String::from_utf8_lossy(&output.stderr)
        );
        place.run(COMMAND).done();
        assert!(place.temporaries().is_empty(), "{:?}", place.temporaries());
        assert_same_bytes(&place.bytes(), &expected);
    }
}
