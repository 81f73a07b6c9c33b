//! robosuite's traces replayed here: physics to the bit, torques, states and observations.
//!
//! `tests/robosuite_reference.py` made the traces with robosuite itself; `-- --nocapture` prints every figure.
#![allow(
    clippy::unwrap_used,
    clippy::panic,
    clippy::print_stdout,
    reason = "a test may stop where it fails"
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
fn traces_are_as_the_simulation_assumes() {
    for trace in Trace::all() {
        let file = &trace.file;
        assert_eq!(
            file.f64s("ctrl").shape,
            [60, simulation_steps(trace.task), CONTROLS],
            "{}",
            trace.name
        );
        assert_eq!(file.f64s("q_init").numbers, INITIAL_JOINTS, "{}", trace.name);
        // The environment's own call and the controller's, which has a fresh state in the first step.
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
fn the_same_controls_lead_to_the_same_bits() {
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
fn closed_loop_stays_with_robosuite_until_contact() {
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

/// Newer traces hold the environment's verdicts about every edge of its rule.
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

/// What was seen in a row of a trace: poses and finger positions are of different simulation steps.
struct Seen {
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
        let mut rows = vec![Seen {
            poses: first,
            fingers: first.fingers,
            success: simulation.success(),
        }];
        for (step, action) in trace.actions.iter().enumerate() {
            let mut recorded = controls.row(step).chunks_exact(CONTROLS);
            let mut seen = Vec::new();
            // With two forced updates since the reset robosuite samples after simulation step 24, where poses are those of 23.
            let done = simulation
                .step_through(action, |simulation, controls| {
                    seen.push(simulation.observation());
                    controls.copy_from_slice(recorded.next().unwrap());
                })
                .unwrap();
            rows.push(Seen {
                poses: seen[23],
                fingers: seen[24].fingers,
                success: done.success,
            });
        }
        compare(&trace, &rows);
    }
}

fn compare(trace: &Trace, rows: &[Seen]) {
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
        mut turn,
    ] = [0.0_f64; 7];
    let mut verdicts = [0; 2];
    for (row, seen) in rows.iter().enumerate() {
        let observed = RobosuiteObservation {
            fingers: seen.fingers,
            ..seen.poses
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
        // robosuite 1.5 relates the hand to the object's pose of the sample before; before row 0 that is one of the reset, which
        // no trace holds.
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
                turn = turn.max(apart_as_rotations(&ours[rotation.clone()], &theirs[rotation]));
            }
        }
        assert_eq!(u8::from(seen.success), success[row], "{} row {row}", trace.name);
        verdicts[usize::from(seen.success)] += 1;
    }
    println!(
        "{:22} observations: eef {eef:.1e} m, hand {hand:.1e}, site {site:.1e}, fingers {finger:.1e} m, object {object:.1e}, \
         relative {relative:.1e} m and {turn:.1e}; {} successes among {} equal verdicts",
        trace.name,
        verdicts[1],
        rows.len()
    );
    for difference in [eef, hand, finger, object] {
        assert!(difference <= 1e-12, "{}: {difference:e}", trace.name);
    }
    // robosuite turns matrices into quaternions and back in single precision, which these go through.
    for difference in [site, relative, turn] {
        assert!(difference <= 1e-6, "{}: {difference:e}", trace.name);
    }
}
