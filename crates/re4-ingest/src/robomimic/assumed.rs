//! Conventions of robosuite 1.4, taken for granted. To be replaced by conventions proven from the data.

use nalgebra::{Quaternion, UnitQuaternion, Vector3};

use super::demo::Demo;
use super::fault::Hdf5Fault;

/// What the rows of a demonstration mean.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Interpreted {
    /// Position of the object, then its quaternion x, y, z, w.
    pub object: Vec<[f64; 7]>,
    /// Delta actions.
    pub delta: Vec<[f64; 6]>,
    /// Absolute actions.
    pub goal: Vec<[f64; 6]>,
    /// Whether the delta actions are the recorded ones.
    pub recorded_delta: bool,
}

/// Interprets a demonstration.
///
/// # Errors
/// An object vector of another width than 10 or 14.
pub fn interpret(demo: &Demo) -> Result<Interpreted, Hdf5Fault> {
    let columns = demo.object.columns;
    if ![10, 14].contains(&columns) {
        return Err(Hdf5Fault::Shape {
            object: format!("data/{}/obs/object", demo.name),
            found: vec![demo.object.rows(), columns],
            expected: "(N, 10) for Lift or (N, 14) for Can and Square".to_owned(),
            mend: "give a file of the task that the pipeline names",
        });
    }
    let object = demo
        .object
        .values
        .chunks_exact(columns)
        .map(|row| std::array::from_fn(|i| row[i]))
        .collect();
    let site = |t: usize| {
        let [x, y, z, w] = demo.eef_quaternion[t];
        UnitQuaternion::from_quaternion(Quaternion::new(w, x, y, z))
            * UnitQuaternion::from_axis_angle(&Vector3::z_axis(), -std::f64::consts::FRAC_PI_2)
    };
    let six = |a: &[f64; 7]| std::array::from_fn(|i| a[i]);
    let recorded_delta = demo
        .actions
        .iter()
        .all(|action| action[..6].iter().all(|value| value.abs() <= 1.0));
    let recorded: Vec<[f64; 6]> = demo.actions.iter().map(six).collect();
    let converted: Vec<[f64; 6]> = recorded
        .iter()
        .enumerate()
        .map(|(t, a)| {
            let first = Vector3::new(a[0], a[1], a[2]);
            let turn = Vector3::new(a[3], a[4], a[5]);
            let position = Vector3::from(demo.eef_position[t]);
            let (first, turn) = if recorded_delta {
                (
                    position + first * 0.05,
                    (UnitQuaternion::from_scaled_axis(turn * 0.5) * site(t)).scaled_axis(),
                )
            } else {
                let turn = UnitQuaternion::from_scaled_axis(turn) * site(t).inverse();
                ((first - position) / 0.05, turn.scaled_axis() / 0.5)
            };
            [first.x, first.y, first.z, turn.x, turn.y, turn.z]
        })
        .collect();
    let (delta, goal) = if recorded_delta {
        (recorded, converted)
    } else {
        (converted, recorded)
    };
    Ok(Interpreted {
        object,
        delta,
        goal,
        recorded_delta,
    })
}
