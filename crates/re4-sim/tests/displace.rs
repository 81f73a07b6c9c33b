//! Disturbances of robosuite's tasks: only an object that rests and is not held is moved.
#![allow(
    clippy::unwrap_used,
    clippy::panic,
    clippy::print_stdout,
    reason = "a test may panic"
)]

mod reference;
mod simulators;

use nalgebra::Vector3;
use re4_geometry::Pose2;
use re4_sim::robosuite::Fidelity;
use re4_sim::{SimError, Simulator as _};
use simulators::{Form, Trace, simulators};

#[test]
fn a_resting_object_is_moved_and_a_held_one_is_not() {
    let Some(folder) = simulators() else { return };
    let mut moved_at_all = 0;
    for trace in Trace::all() {
        let mut simulation = trace.start(&folder, Form::Physics, Fidelity::Robosuite);
        let motion = Pose2::new(0.02, -0.01, 0.4);
        let (mut moved, mut refused) = (0, 0);
        for action in &trace.actions {
            let before = simulation.observation();
            let (state, velocities) = (simulation.state(), simulation.data().qvel().to_vec());
            let applied = simulation.displace_object(motion).unwrap();
            let after = simulation.observation();
            if applied {
                moved += 1;
                // The poses before were those of 2 ms earlier.
                let away = after.object.translation.vector - before.object.translation.vector;
                assert!(
                    (away - Vector3::new(0.02, -0.01, 0.0)).norm() < 2e-4,
                    "{}: {away}",
                    trace.name
                );
                let turn = after.object.rotation * before.object.rotation.inverse();
                assert!((turn.angle() - 0.4).abs() < 0.02, "{}", trace.name);
                assert!((after.grip_site.translation.vector - before.object.translation.vector).norm() > 0.1);
                // Back, so that the trace goes on.
                simulation.displace_object(Pose2::new(-0.02, 0.01, -0.4)).unwrap();
            } else {
                refused += 1;
                assert_eq!(simulation.state(), state, "{}", trace.name);
                assert_eq!(simulation.data().qvel(), velocities);
            }
            simulation.step(action).unwrap();
        }
        moved_at_all += moved;
        println!("{}: moved at {moved} steps, refused at {refused}", trace.name);
        let error = simulation.displace_object(Pose2::new(f64::NAN, 0.0, 0.0)).unwrap_err();
        assert!(matches!(
            error,
            SimError::NotFinite {
                operation: "displace",
                ..
            }
        ));
    }
    assert!(moved_at_all > 0);
}
