//! Detection of the frame of absolute actions and of the representation of their orientations, from the end effector's motion.

use nalgebra::{Isometry3, UnitQuaternion, Vector3};

use super::commands::{ActionTests, ROWS, listed, proof};
use super::evidence::{Basis, Fit, Proof, Test, name};
use super::reading::{ActionFrame, ActionReading};
use super::response::{Response, Sums, TRANSLATION};
use super::{ActionKind, Unproven};
use crate::actions::{self, Action};
use crate::hand_from_site;

/// Maximum distance (metres) between the mean of the goals and the mean of the end effector's targets. If it is larger, the goals
/// are in another frame. Friction, weight and contacts cause up to 0.008.
pub(super) const FRAME: f64 = 0.02;
/// Minimum distance (metres) at which a frame is clearly the wrong one.
const OTHER_FRAME: f64 = 3.0 * FRAME;
const FRAME_TEST: Test = Test {
    name: "mean offset of absolute goals from the end effector's motion",
    unit: "m",
    threshold: FRAME,
    rival: OTHER_FRAME,
    frames: ROWS,
};
const ROTATION_TEST: Test = Test {
    name: "median angle between absolute goals and the grip site",
    unit: "rad",
    threshold: 0.4,
    rival: 0.4,
    frames: ROWS,
};

/// Sums for actions that are read as goals, translations only. Positions are in metres in the world frame.
pub(super) fn goals(response: &Response, steps: &[[f64; 6]], actions: &[Action], positions: &[[f64; 3]]) -> Sums {
    Sums::of(response, steps, |t| {
        let ask = actions::position(&actions[t]) - Vector3::from(positions[t]);
        [ask.x, ask.y, ask.z, 0.0, 0.0, 0.0]
    })
}

/// Mean offset (metres) of the goals from the positions that the end effector's motion implies.
pub(super) fn goal_offset(response: &Response, sums: &Sums) -> Vector3<f64> {
    Vector3::from(TRANSLATION.map(|axis| sums.at_rest(response, axis, 1.0)))
}

impl ActionTests<'_, '_> {
    /// Determines the frame of the goals and checks the representation of their orientations.
    pub(super) fn goals(&self, base: Option<&Isometry3<f64>>) -> Result<(ActionReading, Vec<Proof>), Unproven> {
        let response = self
            .controls
            .map_or_else(|| Response::of(self.env), |controls| controls.response);
        let sums = |reading: &ActionReading| {
            self.total(|demo, steps| goals(&response, steps, &Self::as_read(demo, reading), demo.arrays.eef_pos))
        };
        let world = ActionReading {
            frame: ActionFrame::World,
            ..self.reading
        };
        let total = sums(&world);
        let offset = goal_offset(&response, &total);
        let frames = total.frames();
        let in_base = base.map(|base| goal_offset(&response, &sums(&world.in_base(base))).norm());
        let mut candidates = vec![(name(ActionFrame::World), offset.norm())];
        candidates.extend(in_base.map(|distance| (name(ActionFrame::Base), distance)));
        candidates.sort_by(|a, b| a.1.total_cmp(&b.1));
        let evidence = format!(
            "{}: {} m, over {frames} frames",
            FRAME_TEST.name,
            listed(&candidates, 3)
        );
        let fits = |distance: f64| distance <= FRAME;
        let declares_base = self.env.controller.as_ref().is_some_and(|controller| {
            controller.declared == Some(ActionKind::Absolute) && controller.input_ref_frame.as_deref() == Some("base")
        });
        let world_fits = fits(offset.norm());
        let base_fits = in_base.is_some_and(fits);
        let (value, basis, warning) = match (frames >= ROWS, self.settings.action_frame) {
            (false, None) => (ActionFrame::World, Basis::Declared, None),
            (false, Some(frame)) => {
                let text =
                    "taken from the setting action_frame: the end effector moves too little for a proof".to_owned();
                (frame, Basis::Setting, Some(text))
            }
            (true, None) if world_fits => {
                let unique = in_base.is_none_or(|distance| distance >= OTHER_FRAME);
                (
                    ActionFrame::World,
                    if unique { Basis::Data } else { Basis::Declared },
                    None,
                )
            }
            (true, None) if base_fits && declares_base => (ActionFrame::Base, Basis::Data, None),
            (true, Some(ActionFrame::World)) if world_fits => (ActionFrame::World, Basis::Data, None),
            (true, Some(ActionFrame::Base)) if base_fits => (ActionFrame::Base, Basis::Data, None),
            (true, set) => return Err(another_frame(offset, base_fits, world_fits, set, evidence)),
        };
        let mut reading = world;
        if let (ActionFrame::Base, Some(base)) = (value, base) {
            reading = reading.in_base(base);
        }
        let row = proof(
            "action_frame",
            name(value),
            basis,
            FRAME_TEST,
            &candidates,
            frames,
            warning,
        );
        let rotation = self.goal_rotation(&reading)?;
        Ok((reading, vec![row, rotation]))
    }

    /// Refuses goals whose orientation has another representation than a rotation vector of the grip site.
    fn goal_rotation(&self, reading: &ActionReading) -> Result<Proof, Unproven> {
        type Representation = fn(&Action) -> UnitQuaternion<f64>;
        let representations: [(&str, &str, Representation); 4] = [
            ("rotation_vector", "rotation vectors of the grip site", |action| {
                actions::rotation(action)
            }),
            (
                "hand_rotation_vector",
                "rotation vectors of the hand body, which is rotated by 90 degrees from the grip site",
                |action| actions::rotation(action) * hand_from_site(),
            ),
            ("roll_pitch_yaw", "roll, pitch and yaw", |action| {
                UnitQuaternion::from_euler_angles(action[3], action[4], action[5])
            }),
            (
                "hand_roll_pitch_yaw",
                "roll, pitch and yaw of the hand body",
                |action| UnitQuaternion::from_euler_angles(action[3], action[4], action[5]) * hand_from_site(),
            ),
        ];
        let median = |representation: Representation| {
            let angles = self.demos.iter().flat_map(|demo| {
                let poses = demo.arrays.eef_quat.iter().zip(demo.arrays.actions);
                poses.filter_map(|(quaternion, action)| {
                    let stored = self.order.rotation(*quaternion)?;
                    Some(representation(&reading.read(action)).angle_to(&self.orientation.site(stored)))
                })
            });
            Fit::of(angles.collect())
        };
        let fits = representations.map(|(value, words, representation)| (value, words, median(representation)));
        let frames = fits[0].2.frames;
        let mut candidates: Vec<(String, f64)> = fits
            .iter()
            .map(|(value, _, fit)| ((*value).to_owned(), fit.median))
            .collect();
        let own = fits[0].2.median;
        candidates.sort_by(|a, b| a.1.total_cmp(&b.1));
        if frames >= ROWS && own > ROTATION_TEST.threshold {
            let better = fits[1..]
                .iter()
                .find(|(_, _, fit)| fit.median <= ROTATION_TEST.threshold);
            let are = better.map_or_else(
                || "their last three arm columns are not rotation vectors of the grip site".to_owned(),
                |(_, words, _)| format!("their orientations are {words}"),
            );
            return Err(Unproven::Actions {
                convention: "goal_rotation",
                what: format!("the orientations of absolute actions differ from the end effector's by {own:.2} rad in the median: {are}"),
                evidence: format!("{}: {} rad, over {frames} frames", ROTATION_TEST.name, listed(&candidates, 2)),
                fix: "convert them to rotation vectors of the grip site in the world frame, as robosuite's controller expects".to_owned(),
            });
        }
        let basis = if frames >= ROWS { Basis::Data } else { Basis::Declared };
        let value = "rotation_vector".to_owned();
        Ok(proof(
            "goal_rotation",
            value,
            basis,
            ROTATION_TEST,
            &candidates,
            frames,
            None,
        ))
    }
}

/// The error for goals that are in another frame than the one that they were read in.
fn another_frame(
    offset: Vector3<f64>,
    base_fits: bool,
    world_fits: bool,
    set: Option<ActionFrame>,
    evidence: String,
) -> Unproven {
    let shifted = format!(
        "absolute actions are offset by ({:.3}, {:.3}, {:.3}) m from the end effector's motion",
        offset.x, offset.y, offset.z
    );
    let (what, fix) = match set {
        None if base_fits => (
            format!("{shifted} but fit in the frame of the robot's base"),
            "set action_kind = \"absolute\" and action_frame = \"base\"",
        ),
        None => (
            format!("{shifted}: they are not in the world frame"),
            "convert them to the world frame, or set action_frame = \"base\" if they are in the frame of the robot's base",
        ),
        Some(ActionFrame::Base) if world_fits => (
            "the setting action_frame = \"base\" is contradicted by the data: absolute actions fit in the world frame"
                .to_owned(),
            "remove the setting",
        ),
        Some(ActionFrame::World) if base_fits => (
            format!(
                "the setting action_frame = \"world\" is contradicted by the data: {shifted} but fit in the frame of the robot's base"
            ),
            "set action_frame = \"base\"",
        ),
        Some(frame) => (
            format!("{shifted}, also under the setting action_frame = \"{}\"", name(frame)),
            "convert them to the world frame",
        ),
    };
    Unproven::Actions {
        convention: "action_frame",
        what,
        evidence,
        fix: fix.to_owned(),
    }
}
