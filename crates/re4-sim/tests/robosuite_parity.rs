//! Replays robosuite's traces: physics is bit-exact; torques, states and observations agree within tolerances.
//!
//! `tests/robosuite_reference.py` recorded the traces with robosuite itself; `-- --nocapture` prints all differences.
#![allow(
    clippy::unwrap_used,
    clippy::panic,
    clippy::print_stdout,
    reason = "a test may panic"
)]

mod reference;
mod simulators;

use re4_sim::Simulator as _;
use re4_sim::robosuite::{
    Fidelity, FirstTorques, INITIAL_JOINTS, Profile, RobosuiteObservation, RobosuiteScene, simulation_steps,
};
use simulators::{Form, Trace, apart, apart_as_rotations, apart_without, simulators};

const CONTROLS: usize = 9;

#[test]
fn traces_match_the_assumptions_of_the_simulation() {
    for trace in Trace::all() {
        let file = &trace.file;
        assert_eq!(
            file.f64s("ctrl").shape,
            [60, simulation_steps(trace.task), CONTROLS],
            "{}",
            trace.name
        );
        assert_eq!(file.f64s("q_init").numbers, INITIAL_JOINTS, "{}", trace.name);
        // 1.4 calls `mj_forward` in the environment and in the controller, whose state is already current in the first step.
        let calls = file.u8s("forwards").numbers;
        let expected = |step: usize| match trace.profile {
            Profile::V1_4 => 1 + u8::from(step > 0),
            Profile::V1_5 => 0,
        };
        assert!(
            calls.iter().enumerate().all(|(step, &calls)| calls == expected(step)),
            "{}",
            trace.name
        );
    }
}

#[test]
fn equal_controls_give_bit_identical_states() {
    let Some(folder) = simulators() else { return };
    for trace in Trace::all() {
        let (qpos, qvel, controls) = (
            trace.file.f64s("qpos"),
            trace.file.f64s("qvel"),
            trace.file.f64s("ctrl"),
        );
        let mut simulation = trace.start(&folder, Form::Whole, Fidelity::Robosuite);
        let (mut coordinates, mut velocities) = (0.0_f64, 0.0_f64);
        for step in 0..60 {
            let rows: Vec<Vec<f64>> = controls.row(step).chunks_exact(CONTROLS).map(<[f64]>::to_vec).collect();
            simulation.step_with_controls(&rows).unwrap();
            coordinates = coordinates.max(apart(simulation.data().qpos(), qpos.row(step + 1)));
            velocities = velocities.max(apart(simulation.data().qvel(), qvel.row(step + 1)));
        }
        println!(
            "{:22} same controls: maximum difference of qpos {coordinates:e}, of qvel {velocities:e}",
            trace.name
        );
        assert_eq!((coordinates, velocities), (0.0, 0.0), "{}", trace.name);
    }
}

#[test]
fn torques_in_the_same_states_are_equal() {
    let Some(folder) = simulators() else { return };
    for trace in Trace::all() {
        let controls = trace.file.f64s("ctrl");
        let mut simulation = trace.start(&folder, Form::Whole, Fidelity::Robosuite);
        let (mut torques, mut fingers) = (0.0_f64, 0.0_f64);
        for (step, action) in trace.actions.iter().enumerate() {
            let mut rows = controls.row(step).chunks_exact(CONTROLS);
            simulation
                .step_through(action, |_, ours| {
                    let theirs = rows.next().unwrap();
                    torques = torques.max(apart(&ours[..7], &theirs[..7]));
                    fingers = fingers.max(apart(&ours[7..], &theirs[7..]));
                    ours.copy_from_slice(theirs);
                })
                .unwrap();
            assert!(rows.next().is_none());
        }
        println!(
            "{:22} same states: torques within {torques:e} Nm, finger targets within {fingers:e} m",
            trace.name
        );
        assert!(torques <= 1e-9, "{}: {torques:e}", trace.name);
        assert!(fingers <= 1e-15, "{}: {fingers:e}", trace.name);
    }
}

#[test]
fn closed_loop_follows_robosuite_until_contact() {
    let Some(folder) = simulators() else { return };
    for trace in Trace::all() {
        let qpos = trace.file.f64s("qpos");
        let mut simulation = trace.start(&folder, Form::Whole, Fidelity::Robosuite);
        let free = trace.steps_before_contact();
        let away = trace.coordinates_in_contact_from_the_start(&simulation);
        let (mut kept, mut heap) = (Vec::new(), 0.0_f64);
        for (step, action) in trace.actions.iter().enumerate() {
            simulation.step(action).unwrap();
            let (ours, theirs) = (simulation.data().qpos(), qpos.row(step + 1));
            kept.push(apart_without(ours, theirs, &away));
            for &at in &away {
                heap = heap.max((ours[at] - theirs[at]).abs());
            }
        }
        let until = |steps: usize| kept[..steps].iter().copied().fold(0.0, f64::max);
        println!(
            "{:22} closed loop: {:.1e} {:.1e} {:.1e} {:.1e} in 10, 20, 30, 60 policy steps; {:.1e} in the {free} before contact; \
             heap of objects put away {heap:.1e}",
            trace.name,
            until(10),
            until(20),
            until(30),
            until(60),
            until(free)
        );
        assert!(until(free) <= 1e-9, "{}: {:e}", trace.name, until(free));
    }
}

/// Newer traces contain the environment's success verdicts around every edge of its success rule.
#[test]
fn verdicts_at_every_edge_are_equal() {
    let Some(folder) = simulators() else { return };
    for trace in Trace::all().filter(|trace| trace.file.has("hands")) {
        let (hands, places) = (trace.file.f64s("hands"), trace.file.f64s("moved_to"));
        let (of_hand, theirs) = (
            trace.file.u32s("moved_hand").numbers,
            trace.file.u8s("moved_success").numbers,
        );
        let mut simulation = trace.start(&folder, Form::Physics, Fidelity::Robosuite);
        let joint = simulation.model().mujoco().joint(&trace.task.joint()).unwrap();
        for (row, (&hand, &verdict)) in of_hand.iter().zip(&theirs).enumerate() {
            let mut state = hands.row(hand as usize).to_vec();
            state[1 + joint.0..][..3].copy_from_slice(places.row(row));
            simulation
                .reset(&RobosuiteScene::Recorded(state), FirstTorques::Fresh)
                .unwrap();
            assert_eq!(u8::from(simulation.success()), verdict, "{} row {row}", trace.name);
        }
        let successes: usize = theirs.iter().map(|&verdict| usize::from(verdict)).sum();
        println!(
            "{:22} {successes} successes among {} equal verdicts",
            trace.name,
            theirs.len()
        );
        assert!(successes > 0 && successes < theirs.len(), "{}", trace.name);
    }
}

/// The values that correspond to a row of a trace: poses and finger positions are from different simulation steps.
struct Sampled {
    poses: RobosuiteObservation,
    fingers: [f64; 2],
    success: bool,
}

#[test]
fn observations_and_verdicts_are_equal() {
    let Some(folder) = simulators() else { return };
    for trace in Trace::all() {
        assert_eq!(trace.file.header["forced_updates"], 2);
        let controls = trace.file.f64s("ctrl");
        let mut simulation = trace.start(&folder, Form::Whole, Fidelity::Robosuite);
        let first = simulation.observation();
        let mut rows = vec![Sampled {
            poses: first,
            fingers: first.fingers,
            success: simulation.success(),
        }];
        for (step, action) in trace.actions.iter().enumerate() {
            let mut recorded = controls.row(step).chunks_exact(CONTROLS);
            let mut observations = Vec::new();
            // With two forced updates since the reset, robosuite samples after simulation step 24, when poses are those of
            // step 23.
            let done = simulation
                .step_through(action, |simulation, controls| {
                    observations.push(simulation.observation());
                    controls.copy_from_slice(recorded.next().unwrap());
                })
                .unwrap();
            rows.push(Sampled {
                poses: observations[23],
                fingers: observations[24].fingers,
                success: done.success,
            });
        }
        compare(&trace, &rows);
    }
}

fn compare(trace: &Trace, rows: &[Sampled]) {
    let file = &trace.file;
    let (positions, hands) = (file.f64s("robot0_eef_pos"), file.f64s("robot0_eef_quat"));
    let (fingers, objects, success) = (
        file.f64s("robot0_gripper_qpos"),
        file.f64s("object"),
        file.u8s("success").numbers,
    );
    let sites = (trace.profile == Profile::V1_5).then(|| file.f64s("robot0_eef_quat_site"));
    let [
        mut eef,
        mut hand,
        mut site,
        mut finger,
        mut object,
        mut relative,
        mut relative_rotation,
    ] = [0.0_f64; 7];
    let mut verdicts = [0; 2];
    for (row, sampled) in rows.iter().enumerate() {
        let observed = RobosuiteObservation {
            fingers: sampled.fingers,
            ..sampled.poses
        };
        eef = eef.max(apart(
            observed.grip_site.translation.vector.as_slice(),
            positions.row(row),
        ));
        hand = hand.max(apart_as_rotations(observed.hand.coords.as_slice(), hands.row(row)));
        if let Some(sites) = &sites {
            let ours = observed.grip_site.rotation;
            site = site.max(apart_as_rotations(ours.coords.as_slice(), sites.row(row)));
        }
        finger = finger.max(apart(&observed.fingers, fingers.row(row)));
        let theirs = objects.row(row);
        let ours = observed.object_state(trace.task, trace.profile);
        assert_eq!(ours.len(), theirs.len());
        // robosuite 1.5 computes the relative pose from the object's pose of the previous sample. For row 0 this is a sample of
        // the reset, which traces do not contain.
        let is_late = trace.profile == Profile::V1_5 && trace.task.layouts[1].relates_rotations();
        let late = RobosuiteObservation {
            object: rows[row.saturating_sub(1)].poses.object,
            ..observed
        };
        let (absolute_from, relative_from) = if is_late { (7, 0) } else { (0, 7) };
        let pose = &ours[absolute_from..absolute_from + 7];
        object = object
            .max(apart(&pose[..3], &theirs[absolute_from..absolute_from + 3]))
            .max(apart_as_rotations(
                &pose[3..],
                &theirs[absolute_from + 3..absolute_from + 7],
            ));
        if !is_late || row > 0 {
            let ours = if is_late {
                late.object_state(trace.task, trace.profile)
            } else {
                ours
            };
            relative = relative.max(apart(
                &ours[relative_from..relative_from + 3],
                &theirs[relative_from..relative_from + 3],
            ));
            if trace.task.layouts[0].relates_rotations() {
                let rotation = relative_from + 3..relative_from + 7;
                relative_rotation =
                    relative_rotation.max(apart_as_rotations(&ours[rotation.clone()], &theirs[rotation]));
            }
        }
        assert_eq!(u8::from(sampled.success), success[row], "{} row {row}", trace.name);
        verdicts[usize::from(sampled.success)] += 1;
    }
    println!(
        "{:22} observations: eef {eef:.1e} m, hand {hand:.1e}, site {site:.1e}, fingers {finger:.1e} m, object {object:.1e}, \
         relative {relative:.1e} m and {relative_rotation:.1e}; {} successes among {} equal verdicts",
        trace.name,
        verdicts[1],
        rows.len()
    );
    for difference in [eef, hand, finger, object] {
        assert!(difference <= 1e-12, "{}: {difference:e}", trace.name);
    }
    // robosuite converts between matrices and quaternions in single precision, which affects these values.
    for difference in [site, relative, relative_rotation] {
        assert!(difference <= 1e-6, "{}: {difference:e}", trace.name);
    }
}
