//! Resets do not leak memory. This is a separate test program because it measures the memory of its process.
#![cfg(target_os = "linux")]
#![expect(clippy::unwrap_used, reason = "helpers of a test may panic")]

use re4_sim::{PushT, ResetOrder, SeedScheme, Simulator, scene_from_seed};

/// Anonymous resident memory of this process, in kB. File-backed memory is excluded, because it varies with other processes.
fn resident() -> u64 {
    let status = std::fs::read_to_string("/proc/self/status").unwrap();
    let line = status.lines().find(|line| line.starts_with("RssAnon:")).unwrap();
    line.split_whitespace().nth(1).unwrap().parse().unwrap()
}

fn run(resets: u32) {
    let mut simulator = PushT::new().unwrap();
    for i in 0..resets {
        let scene = scene_from_seed(SeedScheme::GymPusht, i % 5000);
        simulator.reset(&scene, ResetOrder::Legacy).unwrap();
        if i % 50 == 0 {
            // Some steps with contacts, for which Chipmunk allocates buffers; and some simulators are dropped.
            simulator.step(&scene.block.translation()).unwrap();
            simulator = PushT::new().unwrap();
        }
    }
}

#[test]
fn resets_do_not_leak() {
    // RESETS sets a longer measurement than the usual test run has time for.
    let resets = std::env::var("RESETS").map_or(100_000, |text| text.parse().expect("RESETS is a number"));
    run(2_000);
    let before = resident();
    run(resets);
    let grown = resident().saturating_sub(before);
    println!("{resets} resets: {before} kB before, grown by {grown} kB");
    // One space takes about 100 kB, so a leak of any part of it would appear as many megabytes.
    assert!(grown < 4_096, "{resets} resets made the process grow by {grown} kB");
}
