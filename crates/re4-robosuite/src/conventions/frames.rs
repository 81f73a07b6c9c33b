//! The frame of delta actions: the axes of the world, or those of the robot's base, which robosuite 1.5 uses by default.
//!
//! If the base is turned, one and the same command moves the end effector in other directions under the two hypotheses. The test
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

/// Determines the frame of deltas. The declared frame is used if the data does not decide, as for a base that is hardly turned. Returns
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
