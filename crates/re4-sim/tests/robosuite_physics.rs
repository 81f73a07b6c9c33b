//! Properties of the simulation of robosuite's tasks: stages of a step, threads, resets, and reduced models.
#![allow(
    clippy::unwrap_used,
    clippy::panic,
    clippy::print_stdout,
    reason = "a test may panic"
)]

mod reference;
mod simulators;

use re4_mujoco::Data;
use re4_sim::Simulator as _;
use re4_sim::robosuite::Fidelity;
use simulators::{Form, Trace, apart_without, bits, simulators};

/// Coordinates, velocities and the solver's next warm start, as bits.
fn everything(data: &Data) -> Vec<u64> {
    [data.qpos(), data.qvel(), data.qacc_warmstart()].map(bits).concat()
}

#[test]
fn a_step_equals_its_stages() {
    let Some(folder) = simulators() else { return };
    for trace in Trace::all() {
        let controls = trace.file.f64s("ctrl");
        let state = trace.file.f64s("initial_state").numbers;
        let model = trace.model(&folder, Form::Whole);
        let nq = model.mujoco().nq();
        let [mut whole, mut parts] = [(); 2].map(|()| {
            let mut data = Data::new(model.mujoco()).unwrap();
            data.qpos_mut().copy_from_slice(&state[1..=nq]);
            data.qvel_mut().copy_from_slice(&state[1 + nq..]);
            data
        });
        // The whole trace: 1500 steps, free and in contact.
        for (step, row) in controls.numbers.chunks_exact(9).enumerate() {
            whole.ctrl_mut().copy_from_slice(row);
            whole.step();
            parts.motion_stages();
            parts.ctrl_mut().copy_from_slice(row);
            parts.force_stages();
            parts.euler();
            assert_eq!(everything(&whole), everything(&parts), "{} step {step}", trace.name);
            assert_eq!(whole.time().to_bits(), parts.time().to_bits());
        }
        assert_ne!(bits(whole.qpos()), bits(&state[1..=nq]));
        assert_eq!(whole.diverged(), None);
    }
}

/// The states of an episode, as bits.
fn episode(trace: &Trace, folder: &std::path::Path) -> Vec<Vec<u64>> {
    let mut simulation = trace.start(folder, Form::Physics, Fidelity::Robosuite);
    let step = |action| {
        simulation.step(action).unwrap();
        everything(simulation.data())
    };
    trace.actions.iter().map(step).collect()
}

#[test]
fn threads_do_not_change_a_bit() {
    let Some(folder) = simulators() else { return };
    let traces: Vec<Trace> = Trace::all().collect();
    let sequential: Vec<_> = traces.iter().map(|trace| episode(trace, &folder)).collect();
    // All at once, with two simulations of every model.
    let together: Vec<_> = std::thread::scope(|scope| {
        let threads: Vec<_> = traces
            .iter()
            .chain(&traces)
            .map(|trace| scope.spawn(|| episode(trace, &folder)))
            .collect();
        threads.into_iter().map(|thread| thread.join().unwrap()).collect()
    });
    assert_eq!(together.len(), 2 * sequential.len());
    for (at, states) in together.iter().enumerate() {
        let at = at % sequential.len();
        assert!(*states == sequential[at], "{}", traces[at].name);
    }
}

#[test]
fn episodes_after_a_reset_are_independent_of_earlier_ones() {
    let Some(folder) = simulators() else { return };
    for trace in Trace::all() {
        let mut simulation = trace.start(&folder, Form::Physics, Fidelity::Robosuite);
        let mut play = || -> Vec<_> {
            simulation
                .reset(&trace.scene(), re4_sim::robosuite::FirstTorques::AsRobosuite)
                .unwrap();
            let actions = trace.actions.iter().take(50);
            actions
                .map(|action| {
                    simulation.step(action).unwrap();
                    everything(simulation.data())
                })
                .collect()
        };
        let first = play();
        assert!(first == play(), "{}", trace.name);
    }
}

#[test]
fn reduced_models_and_less_computation_give_the_same_motion() {
    let Some(folder) = simulators() else { return };
    for trace in Trace::all() {
        let play = |form, fidelity| {
            let mut simulation = trace.start(&folder, form, fidelity);
            let step = |action| {
                simulation.step(action).unwrap();
                simulation.data().qpos().to_vec()
            };
            trace.actions.iter().map(step).collect::<Vec<_>>()
        };
        let whole = play(Form::Whole, Fidelity::Robosuite);
        let free = trace.steps_before_contact();
        // Objects that are put away fall through the floor if they do not collide.
        let away = trace.coordinates_put_away(&trace.model(&folder, Form::Whole));
        let physics = play(Form::Physics, Fidelity::Robosuite);
        for (step, (less, whole)) in physics.iter().zip(&whole).enumerate() {
            assert_eq!(bits(less), bits(whole), "{} step {step}", trace.name);
        }
        let fast = play(Form::Apart, Fidelity::Fast);
        let until = |steps: usize| {
            let pairs = fast.iter().zip(&whole).take(steps);
            pairs.map(|(a, b)| apart_without(a, b, &away)).fold(0.0, f64::max)
        };
        let (before, all) = (until(free), until(60));
        println!(
            "{:22} fast: {before:.1e} in {free} policy steps before contact, {all:.1e} in 60",
            trace.name
        );
        assert!(before <= 1e-7, "{}: {before:e}", trace.name);
    }
}
