//! Detection of the pose that the controller holds before the first step of a demonstration.
//!
//! robosuite's collector and robomimic reset the robot and then load the recorded state. The controller still holds the pose of
//! the reset until its first update, which comes after the first step. The goal of the first step is therefore relative to the
//! reset pose, and the orientation of the reset pose remains the goal until a rotation is commanded. Recordings show this: the
//! end effector rotates towards the orientation of the reset, not towards the orientation in its first frame.

use nalgebra::Isometry3;
use re4_stats::upper_median;

use super::commands::{Controls, proof, steps};
use super::demo::ValidDemo;
use super::evidence::{Basis, Proof, Test, name};
use super::reading::InitialGoal;
use super::{Conventions, Unproven};
use crate::actions;
use crate::kinematics::PANDA_RESET;

const TEST: Test = Test {
    name: "distance of each pose from the goal that the motion before the first rotation command implies, relative to the distance between the two poses",
    unit: "of the distance",
    threshold: 0.4,
    rival: 0.6,
    frames: 4,
};
const GOALS: Test = Test {
    name: "median angle between the first absolute goal and each pose",
    unit: "rad",
    threshold: 1e-3,
    rival: 5e-3,
    frames: 2,
};
/// Metres per radian, for sums over translations and rotations.
const LEVER: f64 = 0.5;
/// If the two poses are closer than this (metres, radians), it does not matter which one the controller holds.
const SAME: (f64, f64) = (2e-3, 0.01);

/// Distance (metres) and angle (radians) between two poses.
fn distance_and_angle(a: &Isometry3<f64>, b: &Isometry3<f64>) -> (f64, f64) {
    let distance = (a.translation.vector - b.translation.vector).norm();
    (distance, a.rotation.angle_to(&b.rotation))
}

/// Determines the pose from deltas (if `controls` is given) or from absolute goals. `resets_panda` states whether robosuite's reset
/// pose of a Panda is the one that the robot was reset to.
pub(super) fn initial_goal(
    conventions: &Conventions,
    demos: &[ValidDemo<'_>],
    controls: Option<&Controls>,
    (set, resets_panda): (Option<InitialGoal>, bool),
) -> Result<(InitialGoal, Proof), Unproven> {
    let mut known = Vec::new();
    for demo in demos {
        let model = demo.arrays.model.filter(|_| resets_panda);
        let reset = model.and_then(|model| model.site_at(&PANDA_RESET).ok());
        let first = demo.arrays.eef_pos.first().zip(demo.arrays.eef_quat.first());
        let first = first.and_then(|(position, quaternion)| conventions.site_pose(*position, *quaternion));
        known.extend(first.zip(reset).map(|(first, reset)| (demo, first, reset)));
    }
    let (test, [to_reset, to_first], frames) = match controls {
        Some(controls) => {
            let (fraction, frames) = fraction_to_reset(conventions, controls, &known);
            (TEST, [(1.0 - fraction).abs(), fraction.abs()], frames)
        }
        None => (GOALS, goal_angles(&known), known.len()),
    };
    let frames = if to_reset.is_finite() { frames } else { 0 };
    let mut candidates = vec![
        (name(InitialGoal::ResetPose), to_reset),
        (name(InitialGoal::FirstPose), to_first),
    ];
    candidates.sort_by(|a, b| a.1.total_cmp(&b.1));
    let enough = frames >= test.frames;
    let proven = match (to_reset, to_first) {
        (own, rival) if enough && own <= test.threshold && rival >= test.rival => Some(InitialGoal::ResetPose),
        (rival, own) if enough && own <= test.threshold && rival >= test.rival => Some(InitialGoal::FirstPose),
        _ => None,
    };
    if let (Some(proven), Some(set)) = (proven, set)
        && proven != set
    {
        return Err(Unproven::Setting {
            convention: "initial_goal",
            setting: format!("initial_goal = \"{}\"", name(set)),
            proven: name(proven),
            residuals: format!(
                "{}: {} {:.2e}, {} {:.2e} {}, over {frames} frames",
                test.name, candidates[0].0, candidates[0].1, candidates[1].0, candidates[1].1, test.unit
            ),
        });
    }
    // Without a model the reset pose is not known, so only the first pose is available.
    let fallback = if known.is_empty() {
        InitialGoal::FirstPose
    } else {
        InitialGoal::ResetPose
    };
    if set == Some(InitialGoal::ResetPose) && known.is_empty() {
        return Err(Unproven::Actions {
            convention: "initial_goal",
            what: "the setting initial_goal = \"reset_pose\" needs demonstrations with the model of a Panda".to_owned(),
            evidence: "no demonstration has an attribute model_file with the arm joints robot0_joint1 to robot0_joint7"
                .to_owned(),
            fix: "remove the setting, or restore the attribute model_file".to_owned(),
        });
    }
    let value = proven.or(set).unwrap_or(fallback);
    let basis = match (proven, set) {
        (Some(_), _) => Basis::Data,
        (None, Some(_)) => Basis::Setting,
        (None, None) => Basis::Declared,
    };
    let differences = known.iter().map(|(_, first, reset)| distance_and_angle(first, reset));
    let (distance, angle) = differences.fold((0.0_f64, 0.0_f64), |maximum, pair| {
        (maximum.0.max(pair.0), maximum.1.max(pair.1))
    });
    let matters = distance > SAME.0 || angle > SAME.1;
    let warning = (basis == Basis::Declared && matters).then(|| {
        format!(
            "the pose that the controller held before the first step is not proven, so the reset pose of the robot is assumed, which differs from the pose in the first frame by up to {:.1} mm and {:.2} degrees; if the controller held the pose in the first frame, set initial_goal = \"first_pose\"",
            distance * 1e3,
            angle.to_degrees()
        )
    });
    Ok((
        value,
        proof("initial_goal", name(value), basis, test, &candidates, frames, warning),
    ))
}

/// Position of the goals of the first frames on the line from the first pose (0) to the reset pose (1), and the number of rows
/// that this least-squares estimate is based on.
fn fraction_to_reset(
    conventions: &Conventions,
    controls: &Controls,
    known: &[(&ValidDemo<'_>, Isometry3<f64>, Isometry3<f64>)],
) -> (f64, usize) {
    let (response, osc) = (&controls.response, &controls.osc);
    // The normal equation of the fit `left - asked = fraction * part`: `left` is the measured side of the equation of motion,
    // `asked` its other side for a controller that holds the first pose, and `part` what holding the reset pose adds to it.
    let [mut along, mut square] = [0.0_f64; 2];
    let mut rows = 0;
    for (demo, first, reset) in known {
        let steps = steps(demo, conventions.eef_quaternion);
        let motion: Vec<[f64; 6]> = demo.actions.iter().take(2).map(|action| osc.motion(action)).collect();
        if steps.len() < 2 || motion.len() < 2 {
            continue;
        }
        let translation = reset.translation.vector - first.translation.vector;
        for axis in 0..3 {
            let left = [steps[0][axis], steps[1][axis] - response.kept * steps[0][axis]];
            let asked = [
                response.now * motion[0][axis],
                response.now * motion[1][axis] + response.before * motion[0][axis],
            ];
            // Only the goal of the first step depends on the held position. It acts in this step and in the one after it.
            let part = [response.now * translation[axis], response.before * translation[axis]];
            for row in 0..2 {
                along += part[row] * (left[row] - asked[row]);
                square += part[row] * part[row];
            }
        }
        rows += 2;
        let rotation = (reset.rotation * first.rotation.inverse()).scaled_axis() * LEVER;
        let before_rotation = demo
            .actions
            .iter()
            .take_while(|action| action[3..6] == [0.0; 3])
            .count();
        let mut before = None;
        for (t, step) in steps.iter().enumerate().take(before_rotation) {
            let Some(now) = conventions.site_pose(demo.arrays.eef_pos[t], demo.arrays.eef_quat[t]) else {
                break;
            };
            let ask = (first.rotation * now.rotation.inverse()).scaled_axis() * LEVER;
            for axis in 0..3 {
                let kept = if t == 0 { 0.0 } else { steps[t - 1][axis + 3] };
                let left = LEVER * (step[axis + 3] - response.kept * kept);
                let (asked, part) = match before {
                    None => (response.now * ask[axis], response.now * rotation[axis]),
                    Some(before) => {
                        let before: nalgebra::Vector3<f64> = before;
                        (
                            response.now * ask[axis] + response.before * before[axis],
                            response.both() * rotation[axis],
                        )
                    }
                };
                along += part * (left - asked);
                square += part * part;
            }
            before = Some(ask);
            rows += 1;
        }
    }
    if square < 1e-10 {
        return (f64::INFINITY, 0);
    }
    (along / square, rows)
}

/// Median angles (radians) of the first goals to the orientation of the reset and to the orientation in the first frame.
fn goal_angles(known: &[(&ValidDemo<'_>, Isometry3<f64>, Isometry3<f64>)]) -> [f64; 2] {
    let angles = known.iter().filter_map(|(demo, first, reset)| {
        let goal = actions::rotation(demo.actions.first()?);
        Some([reset, first].map(|pose| goal.angle_to(&pose.rotation)))
    });
    let angles: Vec<[f64; 2]> = angles.collect();
    [0, 1].map(|pose| upper_median(angles.iter().map(|pair| pair[pose])).unwrap_or(f64::INFINITY))
}
