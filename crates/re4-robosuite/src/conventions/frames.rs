//! The frame of delta actions: the axes of the world, or those of the robot's base, which robosuite 1.5 uses by default.
//!
//! If the base is rotated, one and the same command moves the end effector in other directions under the two hypotheses. The test
//! compares the motion of the end effector with the motion that the controller makes for the commands, under each of them.

use nalgebra::UnitQuaternion;

use super::commands::proof;
use super::evidence::{Basis, Proof, Test, name};
use super::reading::ActionFrame;
use super::response::{Response, Sums, TRANSLATION};
use super::{Settings, Unproven};
use crate::actions::{Action, Osc};
use crate::env_args::EnvArgs;

/// The end effector's positions (metres, world frame), the recorded deltas, and the orientation of the robot's base in the world
/// frame in each frame of a demonstration.
#[derive(Debug, Clone, Copy)]
pub struct BasedDeltas<'a> {
    /// Positions of the end effector.
    pub eef_pos: &'a [[f64; 3]],
    /// Recorded actions.
    pub actions: &'a [Action],
    /// Orientations of the base, one per frame.
    pub base: &'a [UnitQuaternion<f64>],
}

const TEST: Test = Test {
    name: "motion of the end effector that the commands leave unexplained, read in the axes of the base and of the world",
    unit: "of the motion",
    threshold: super::detect::UNEXPLAINED,
    rival: super::detect::UNEXPLAINED,
    frames: super::commands::ROWS,
};
/// Minimum factor by which one frame must fit better than the other. Below it the data does not decide.
const BETTER: f64 = 2.0;

/// Determines the frame of deltas. The declared frame is used if the data does not decide, as for a base that is hardly rotated. Returns
/// `None` if the motion follows the actions in neither frame: they are no deltas.
///
/// # Errors
/// If the data proves another frame than the declared one or the setting `action_frame`.
pub fn delta_frame(
    demos: &[BasedDeltas<'_>],
    osc: &Osc,
    env: &EnvArgs,
    settings: &Settings,
) -> Result<Option<(ActionFrame, Proof)>, Unproven> {
    let response = Response::of(env);
    let unexplained = |frame: ActionFrame| {
        let mut total = Sums::default();
        for demo in demos {
            let steps: Vec<[f64; 6]> = demo
                .eef_pos
                .windows(2)
                .map(|pair| {
                    let axis = |i: usize| pair[1][i] - pair[0][i];
                    [axis(0), axis(1), axis(2), 0.0, 0.0, 0.0]
                })
                .collect();
            let ask = |t: usize| {
                let motion = osc.motion(&demo.actions[t]);
                if frame == ActionFrame::World {
                    return motion;
                }
                let shift = demo.base[t] * nalgebra::Vector3::new(motion[0], motion[1], motion[2]);
                [shift.x, shift.y, shift.z, 0.0, 0.0, 0.0]
            };
            total.add(&Sums::of(&response, &steps, ask));
        }
        let line = total.line(&TRANSLATION);
        // A negative gain is motion in the opposite direction, which explains nothing.
        let rest = line.map_or(
            f64::INFINITY,
            |line| if line.gain > 0.0 { line.unexplained } else { 1.0 },
        );
        (rest, total.frames())
    };
    let (base, frames) = unexplained(ActionFrame::Base);
    let (world, _) = unexplained(ActionFrame::World);
    let mut candidates = vec![(name(ActionFrame::Base), base), (name(ActionFrame::World), world)];
    candidates.sort_by(|a, b| a.1.total_cmp(&b.1));
    if frames >= TEST.frames && base.min(world) > TEST.threshold {
        return Ok(None);
    }
    let decides = |own: f64, other: f64| {
        frames >= TEST.frames && own <= TEST.threshold && own.is_finite() && other >= BETTER * own && other - own > 0.05
    };
    let proven = match (decides(base, world), decides(world, base)) {
        (true, _) => Some(ActionFrame::Base),
        (_, true) => Some(ActionFrame::World),
        _ => None,
    };
    let declared = if env.declares_base_frame() {
        ActionFrame::Base
    } else {
        ActionFrame::World
    };
    let residuals = || {
        format!(
            "{}: base {base:.2e}, world {world:.2e}, over {frames} frames",
            TEST.name
        )
    };
    match (proven, settings.action_frame) {
        (Some(proven), Some(set)) if proven != set => Err(Unproven::Setting {
            convention: "action_frame",
            setting: format!("action_frame = \"{}\"", name(set)),
            proven: name(proven),
            residuals: residuals(),
        }),
        (Some(proven), None) if proven != declared => Err(Unproven::Declared {
            convention: "action_frame",
            proven: name(proven),
            declared: name(declared),
            declared_by: "the file declares a controller of robosuite 1.5 (input_ref_frame)".to_owned(),
            residuals: residuals(),
        }),
        (proven, set) => {
            let value = proven.or(set).unwrap_or(declared);
            let basis = match (proven, set) {
                (Some(_), _) => Basis::Data,
                (None, Some(_)) => Basis::Setting,
                (None, None) => Basis::Declared,
            };
            let row = proof("action_frame", name(value), basis, TEST, &candidates, frames, None);
            Ok(Some((value, row)))
        }
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::Vector3;

    use super::*;

    const ENV: &str = r#"{"env_name": "Lift", "env_version": "1.5.1", "type": 1, "env_kwargs": {"robots": ["Panda"], "control_freq": 20,
        "controller_configs": {"type": "BASIC", "body_parts": {"right": {"type": "OSC_POSE", "input_min": -1, "input_max": 1,
        "output_min": [-0.05, -0.05, -0.05, -0.5, -0.5, -0.5], "output_max": [0.05, 0.05, 0.05, 0.5, 0.5, 0.5], "kp": 150,
        "input_type": "delta", "input_ref_frame": "FRAME"}}}}}"#;

    /// The end effector of a controller that follows its equation of motion, with commands in the axes of a base.
    fn recorded(base: &UnitQuaternion<f64>) -> (Vec<[f64; 3]>, Vec<Action>) {
        let env = EnvArgs::parse(ENV).unwrap();
        let (osc, response) = (Osc::from_env(&env).unwrap(), Response::of(&env));
        let actions: Vec<Action> = (0..120)
            .map(|t| {
                let t = f64::from(t);
                [
                    (0.31 * t).sin(),
                    (0.17 * t + 1.0).sin(),
                    (0.07 * t).cos(),
                    0.0,
                    0.0,
                    0.0,
                    -1.0,
                ]
            })
            .collect();
        let ask = |t: usize| {
            let motion = osc.motion(&actions[t]);
            base * Vector3::new(motion[0], motion[1], motion[2])
        };
        let (mut position, mut step) = (Vector3::zeros(), Vector3::zeros());
        let mut positions = vec![position.into()];
        for t in 1..actions.len() {
            step = step * response.kept + ask(t) * response.now + ask(t - 1) * response.before;
            position += step;
            positions.push(position.into());
        }
        (positions, actions)
    }

    fn frame(
        angle: f64,
        declared: &str,
        set: Option<ActionFrame>,
        moved_by: f64,
    ) -> Result<Option<(ActionFrame, Basis)>, Unproven> {
        let yaw = |angle: f64| UnitQuaternion::from_axis_angle(&Vector3::z_axis(), angle);
        let (eef_pos, actions) = recorded(&yaw(moved_by));
        let base = vec![yaw(angle); actions.len()];
        let demo = BasedDeltas {
            eef_pos: &eef_pos,
            actions: &actions,
            base: &base,
        };
        let env = EnvArgs::parse(&ENV.replace("FRAME", declared)).unwrap();
        let settings = Settings {
            action_frame: set,
            ..Settings::default()
        };
        let found = delta_frame(&[demo], &Osc::from_env(&env).unwrap(), &env, &settings)?;
        Ok(found.map(|(frame, proof)| (frame, proof.basis)))
    }

    #[test]
    fn the_motion_decides_for_a_base_that_is_rotated() {
        use ActionFrame::{Base, World};
        for angle in [0.7, 1.6, -2.0, 3.1] {
            assert_eq!(frame(angle, "base", None, angle).unwrap(), Some((Base, Basis::Data)));
            assert_eq!(frame(angle, "world", None, 0.0).unwrap(), Some((World, Basis::Data)));
            assert!(matches!(
                frame(angle, "base", None, 0.0),
                Err(Unproven::Declared { .. })
            ));
            assert!(matches!(
                frame(angle, "world", None, angle),
                Err(Unproven::Declared { .. })
            ));
            assert_eq!(
                frame(angle, "base", Some(World), 0.0).unwrap(),
                Some((World, Basis::Data))
            );
            assert!(matches!(
                frame(angle, "base", Some(World), angle),
                Err(Unproven::Setting { .. })
            ));
        }
    }

    #[test]
    fn a_base_that_is_hardly_rotated_decides_nothing() {
        use ActionFrame::{Base, World};
        assert_eq!(frame(0.02, "base", None, 0.02).unwrap(), Some((Base, Basis::Declared)));
        assert_eq!(
            frame(0.02, "base", Some(World), 0.02).unwrap(),
            Some((World, Basis::Setting))
        );
    }

    #[test]
    fn actions_that_are_no_deltas_have_no_frame() {
        let (eef_pos, mut actions) = recorded(&UnitQuaternion::identity());
        let base = vec![UnitQuaternion::from_euler_angles(0.0, 0.0, 2.0); actions.len()];
        for (t, action) in actions.iter_mut().enumerate() {
            *action = [
                (1.9 * t as f64).sin(),
                (2.7 * t as f64).cos(),
                (0.9 * t as f64).sin(),
                0.0,
                0.0,
                0.0,
                1.0,
            ];
        }
        let demo = BasedDeltas {
            eef_pos: &eef_pos,
            actions: &actions,
            base: &base,
        };
        let env = EnvArgs::parse(&ENV.replace("FRAME", "base")).unwrap();
        let osc = Osc::from_env(&env).unwrap();
        assert!(
            delta_frame(&[demo], &osc, &env, &Settings::default())
                .unwrap()
                .is_none()
        );
    }

    #[test]
    fn a_command_is_clipped_before_it_is_rotated() {
        let env = EnvArgs::parse(ENV).unwrap();
        let osc = Osc::from_env(&env).unwrap();
        let rotation = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), std::f64::consts::FRAC_PI_4);
        let action = [3.0, 1.0, -0.5, 0.2, 0.0, 0.1, -1.0];
        let rotated = osc.in_world_axes(&action, &rotation).unwrap();
        let wide = Osc::from_env(&env.with_wider_commands()).unwrap();
        let [before, after] =
            [osc.motion(&action), wide.motion(&rotated)].map(|motion| Vector3::new(motion[0], motion[1], motion[2]));
        assert!((rotation * before - after).norm() < 1e-15);
        assert!((rotated[1] - 2.0_f64.sqrt()).abs() < 1e-15, "{rotated:?}");
        let uneven = EnvArgs::parse(&ENV.replace("[0.05, 0.05, 0.05, 0.5", "[0.05, 0.04, 0.05, 0.5")).unwrap();
        assert!(
            Osc::from_env(&uneven)
                .unwrap()
                .in_world_axes(&action, &rotation)
                .is_none()
        );
    }
}
