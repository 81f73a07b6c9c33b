//! The pose that the controller holds before the first step of a demo.
//!
//! robosuite's collector and robomimic load each scene into a robot that was just reset, so that the controller's own pose is
//! the reset's, until its first update after the first step: the goal of the first step is made from it, and its orientation
//! stays the goal until a rotation is commanded. Recordings show it: the hand turns towards the reset's orientation, and not
//! towards that of its first frame.

use nalgebra::Isometry3;
use re4_stats::upper_median;

use super::commands::{Controls, proof, steps};
use super::demo::Sound;
use super::evidence::{Basis, Proof, Test, name};
use super::reading::InitialGoal;
use super::{Conventions, Unproven};
use crate::actions;
use crate::kinematics::PANDA_RESET;

const TEST: Test = Test {
    name: "where the hand goes before the first rotation command: distance from each pose, as a fraction of that between the two",
    unit: "of the distance",
    threshold: 0.4,
    rival: 0.6,
    frames: 4,
};
const GOALS: Test = Test {
    name: "the median angle of the first absolute goal to each pose",
    unit: "rad",
    threshold: 1e-3,
    rival: 5e-3,
    frames: 2,
};
/// Metres that count as much as a radian.
const LEVER: f64 = 0.5;
/// Poses closer than this (metres and radians) are the same for all purposes.
const SAME: (f64, f64) = (2e-3, 0.01);

/// Distance and angle between two poses.
fn apart(a: &Isometry3<f64>, b: &Isometry3<f64>) -> (f64, f64) {
    let distance = (a.translation.vector - b.translation.vector).norm();
    (distance, a.rotation.angle_to(&b.rotation))
}

/// Which pose it is, from deltas (given controls) or goals.
pub(super) fn initial_goal(
    conventions: &Conventions,
    demos: &[Sound<'_>],
    controls: Option<&Controls>,
    set: Option<InitialGoal>,
) -> Result<(InitialGoal, Proof), Unproven> {
    let mut known = Vec::new();
    for demo in demos {
        let reset = demo.arrays.model.and_then(|model| model.site_at(&PANDA_RESET).ok());
        let first = demo.arrays.eef_pos.first().zip(demo.arrays.eef_quat.first());
        let first = first.and_then(|(position, quaternion)| conventions.site_pose(*position, *quaternion));
        known.extend(first.zip(reset).map(|(first, reset)| (demo, first, reset)));
    }
    let (test, [to_reset, to_first], frames) = match controls {
        Some(controls) => {
            let (place, frames) = place_between(conventions, controls, &known);
            (TEST, [(1.0 - place).abs(), place.abs()], frames)
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
    // Where nothing is known of the reset, the first pose is all there is.
    let fallback = if known.is_empty() {
        InitialGoal::FirstPose
    } else {
        InitialGoal::ResetPose
    };
    if set == Some(InitialGoal::ResetPose) && known.is_empty() {
        return Err(Unproven::Actions {
            convention: "initial_goal",
            what: "the setting initial_goal = \"reset_pose\" needs a Panda in the demonstrations' models".to_owned(),
            evidence: "no demonstration has the attribute model_file with arm joints robot0_joint1 to robot0_joint7"
                .to_owned(),
            fix: "remove the setting, or restore the models".to_owned(),
        });
    }
    let value = proven.or(set).unwrap_or(fallback);
    let basis = match (proven, set) {
        (Some(_), _) => Basis::Data,
        (None, Some(_)) => Basis::Setting,
        (None, None) => Basis::Declared,
    };
    let most = known.iter().map(|(_, first, reset)| apart(first, reset));
    let (distance, angle) = most.fold((0.0_f64, 0.0_f64), |most, pair| {
        (most.0.max(pair.0), most.1.max(pair.1))
    });
    let matters = distance > SAME.0 || angle > SAME.1;
    let warning = (basis == Basis::Declared && matters).then(|| {
        format!(
            "what the controller held before the first step is not proven and taken to be the pose of the robot's reset, which is up to {:.1} mm and {:.2} degrees from the first frame's; if it was that one, set initial_goal = \"first_pose\"",
            distance * 1e3,
            angle.to_degrees()
        )
    });
    Ok((
        value,
        proof("initial_goal", name(value), basis, test, &candidates, frames, warning),
    ))
}

/// Where the goals of the opening frames are on the way from the first pose (0) to the reset's (1), and on how many rows.
fn place_between(
    conventions: &Conventions,
    controls: &Controls,
    known: &[(&Sound<'_>, Isometry3<f64>, Isometry3<f64>)],
) -> (f64, usize) {
    let (response, osc) = (&controls.response, &controls.osc);
    let [mut along, mut square] = [0.0_f64; 2];
    let mut rows = 0;
    for (demo, first, reset) in known {
        let steps = steps(demo, conventions.eef_quaternion);
        let motion: Vec<[f64; 6]> = demo.actions.iter().take(2).map(|action| osc.motion(action)).collect();
        if steps.len() < 2 || motion.len() < 2 {
            continue;
        }
        let way = reset.translation.vector - first.translation.vector;
        for axis in 0..3 {
            let left = [steps[0][axis], steps[1][axis] - response.kept * steps[0][axis]];
            let asked = [
                response.now * motion[0][axis],
                response.now * motion[1][axis] + response.before * motion[0][axis],
            ];
            let part = [response.now * way[axis], response.before * way[axis]];
            for row in 0..2 {
                along += part[row] * (left[row] - asked[row]);
                square += part[row] * part[row];
            }
        }
        rows += 2;
        let turn = (reset.rotation * first.rotation.inverse()).scaled_axis() * LEVER;
        let unturned = demo
            .actions
            .iter()
            .take_while(|action| action[3..6] == [0.0; 3])
            .count();
        let mut before = None;
        for (t, step) in steps.iter().enumerate().take(unturned) {
            let Some(now) = conventions.site_pose(demo.arrays.eef_pos[t], demo.arrays.eef_quat[t]) else {
                break;
            };
            let ask = (first.rotation * now.rotation.inverse()).scaled_axis() * LEVER;
            for axis in 0..3 {
                let kept = if t == 0 { 0.0 } else { steps[t - 1][axis + 3] };
                let left = LEVER * (step[axis + 3] - response.kept * kept);
                let (asked, part) = match before {
                    None => (response.now * ask[axis], response.now * turn[axis]),
                    Some(before) => {
                        let before: nalgebra::Vector3<f64> = before;
                        (
                            response.now * ask[axis] + response.before * before[axis],
                            response.both() * turn[axis],
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

/// Median angles of the first goals to the reset's orientation and to the first frame's.
fn goal_angles(known: &[(&Sound<'_>, Isometry3<f64>, Isometry3<f64>)]) -> [f64; 2] {
    let angles = known.iter().filter_map(|(demo, first, reset)| {
        let goal = actions::rotation(demo.actions.first()?);
        Some([reset, first].map(|pose| goal.angle_to(&pose.rotation)))
    });
    let angles: Vec<[f64; 2]> = angles.collect();
    [0, 1].map(|pose| upper_median(angles.iter().map(|pair| pair[pose])).unwrap_or(f64::INFINITY))
}
