//! Bit-exact agreement with gym-pusht 0.1.8 on a recorded trace, with one simulator and with many.

#![expect(clippy::unwrap_used, reason = "helpers of a test may panic")]

mod common;

use common::{State, Trace, hash_of, state_of};
use re4_sim::{PushT, ResetOrder, SUBSTEPS, Simulator};

fn bits(state: &State) -> [u64; 7] {
    state.map(f64::to_bits)
}

/// Runs one episode and compares every step with the trace.
fn check_episode(simulator: &mut PushT, trace: &Trace, index: usize) {
    let episode = &trace.episodes[index];
    let first = simulator.reset(&episode.scene, ResetOrder::Legacy).unwrap();
    let first = state_of(&first);
    assert_eq!(
        bits(&first),
        bits(&episode.first),
        "episode {index} after the reset: {first:?}, not {:?}",
        episode.first
    );
    for (s, expected) in episode.steps.iter().enumerate() {
        let step = simulator.step(&expected.action).unwrap();
        let state = state_of(&step.observation);
        if let Some(stored) = expected.state {
            assert_eq!(
                bits(&state),
                bits(&stored),
                "episode {index}, step {s}: {state:?}, not {stored:?}"
            );
        }
        assert_eq!(hash_of(&state), expected.hash, "episode {index}, step {s}: {state:?}");
        assert_eq!(
            simulator.contact_points(),
            expected.contact_points,
            "episode {index}, step {s}"
        );
        assert_eq!(step.contacts, expected.contact_points.div_ceil(SUBSTEPS));
        assert!(
            (step.coverage - expected.coverage).abs() < 1e-12,
            "episode {index}, step {s}: coverage {}, not {}",
            step.coverage,
            expected.coverage
        );
        assert_eq!(step.success, step.coverage > 0.95);
        assert_eq!(step, simulator.outcome());
    }
}

#[test]
fn gym_pusht_and_this_simulator_agree_bit_for_bit() {
    let trace = common::read(&common::path());
    assert!(trace.versions.contains("gym-pusht 0.1.8"), "{}", trace.versions);
    let steps: Vec<_> = trace.episodes.iter().flat_map(|e| &e.steps).collect();
    assert_eq!((trace.episodes.len(), steps.len(), trace.stride), (40, 12_000, 10));
    // The comparison is meaningful only if the agent pushes in much of the trace.
    let touching = steps.iter().filter(|s| s.contact_points > 0).count();
    assert!(touching > 6_000, "only {touching} steps have contacts");
    assert!(steps.iter().filter(|s| s.coverage > 0.3).count() > 100);

    let mut simulator = PushT::new().unwrap();
    for index in 0..trace.episodes.len() {
        check_episode(&mut simulator, &trace, index);
    }
}

#[test]
fn many_simulators_at_once_give_the_same_bits() {
    let trace = common::read(&common::path());
    std::thread::scope(|scope| {
        for thread in 0..8 {
            let trace = &trace;
            scope.spawn(move || {
                // Two simulators per thread run different episodes alternately; the second one was created in another
                // thread.
                let mut own = PushT::new().unwrap();
                let mut sent = std::thread::spawn(|| PushT::new().unwrap()).join().unwrap();
                for round in 0..3 {
                    check_episode(&mut own, trace, (5 * thread + round) % 40);
                    check_episode(&mut sent, trace, (5 * thread + round + 20) % 40);
                }
            });
        }
    });
}

#[test]
fn interleaved_simulators_do_not_affect_each_other() {
    let trace = common::read(&common::path());
    let mut simulators: Vec<_> = trace.episodes[..8]
        .iter()
        .map(|episode| {
            let mut simulator = PushT::new().unwrap();
            simulator.reset(&episode.scene, ResetOrder::Legacy).unwrap();
            simulator
        })
        .collect();
    for s in 0..trace.episodes[0].steps.len() {
        for (simulator, episode) in simulators.iter_mut().zip(&trace.episodes) {
            let step = simulator.step(&episode.steps[s].action).unwrap();
            assert_eq!(hash_of(&state_of(&step.observation)), episode.steps[s].hash);
        }
    }
}
