//! The list of all checks.

use crate::checks::{Applies, Basis, Check, Need};
use crate::finding::Severity;

const fn check(code: &'static str, severity: Severity, applies: Applies, needs: &'static [Need]) -> Check {
    Check {
        code,
        severity,
        applies,
        needs,
        meaning: "",
        measure: "",
        unit: "",
        planar_unit: "",
        basis: Basis::Nothing,
    }
}

/// All checks, sorted by code.
pub const CHECKS: &[Check] = &[
    Check {
        meaning: "The end effector moves opposite to its actions, along one axis or along all of them, unlike in the other demonstrations: the actions were recorded with another sign. Repair the sign, or leave the demonstration out.",
        measure: "Correlation of the end effector's steps with the actions, at the lag of the other demonstrations, with the opposite sign",
        basis: Basis::Constant {
            spatial: 0.5,
            planar: 0.0,
            why: "a quarter of the motion is explained by opposite actions; in sound demonstrations, the correlation along every axis that moves is positive",
        },
        ..check(
            "actions_opposed",
            Severity::Error,
            Applies::Gripper,
            &[Need::Arm, Need::Actions],
        )
    },
    Check {
        meaning: "The end effector moves further or less far for an action of the same size than in the other demonstrations: the actions were recorded in another unit or with other limits of the controller. Scale them, or leave the demonstration out.",
        measure: "Logarithm of the ratio between the gain of the end effector's steps on the actions and the median gain, without its sign",
        basis: Basis::Fence {
            of: "logarithmic ratios (one per demonstration)",
            whisker: 3.0,
            spatial: 0.3466,
            planar: 0.0,
            small: false,
            most: 0.65,
        },
        ..check(
            "actions_scaled",
            Severity::Error,
            Applies::Gripper,
            &[Need::Arm, Need::Actions],
        )
    },
    Check {
        meaning: "The end effector follows its actions later or earlier than in the other demonstrations, by about one step or more: actions and observations were recorded with another alignment. Shift the actions, or leave the demonstration out.",
        measure: "Difference between the lag at which changes of the end effector's steps correlate best with changes of the actions, and the median lag",
        unit: "frames",
        basis: Basis::Fence {
            of: "differences (one per demonstration)",
            whisker: 3.0,
            spatial: 0.5,
            planar: 0.0,
            small: false,
            most: 0.9,
        },
        ..check(
            "actions_shifted",
            Severity::Error,
            Applies::Gripper,
            &[Need::Arm, Need::Actions],
        )
    },
    Check {
        meaning: "The motion of the end effector is not that of its actions, unlike in the other demonstrations: something else moved the arm, or the actions belong to another demonstration.",
        measure: "Fraction of the end effector's motion that the actions do not explain at the best lag: 1 minus the squared correlation",
        basis: Basis::Fence {
            of: "fractions (one per demonstration)",
            whisker: 3.0,
            spatial: 0.5,
            planar: 0.0,
            small: false,
            most: 0.9,
        },
        ..check(
            "actions_unrelated",
            Severity::Warning,
            Applies::Gripper,
            &[Need::Arm, Need::Actions],
        )
    },
    Check {
        meaning: "The fingers do not follow the gripper command: they have had enough time to move, but have neither moved nor closed on anything. Command and mode then do not describe the gripper. Look for a stuck gripper or for commands with the opposite sign.",
        measure: "Frames since the gripper command changed",
        unit: "frames",
        basis: Basis::Constant {
            spatial: 12.0,
            planar: 0.0,
            why: "the full travel of the simulated fingers takes 8 control steps in robosuite 1.4 and 10 in 1.5, and the servo needs two more",
        },
        ..check(
            "command_fingers_disagree",
            Severity::Warning,
            Applies::Gripper,
            &[Need::Opening, Need::Command],
        )
    },
    Check {
        meaning: "The pusher touches the block, but the block does not move. A mode derived from contacts is wrong there; a mode derived from motion is not.",
        measure: "Consecutive frames with contact but without motion of the block",
        planar_unit: "frames",
        basis: Basis::Constant {
            spatial: 0.0,
            planar: 5.0,
            why: "half a second at Push-T's 10 Hz",
        },
        ..check(
            "contact_without_motion",
            Severity::Note,
            Applies::Planar,
            &[Need::Object],
        )
    },
    Check {
        meaning: "The end effector jumps between two consecutive frames: frames are missing, two demonstrations were joined, or poses are wrong. Split the demonstration at the jump or leave it out; a chunk that spans the jump cannot be replayed.",
        measure: "Distance that the end effector moves in one step",
        unit: "m",
        planar_unit: "px",
        basis: Basis::Multiple {
            of: "largest end-effector steps (one per demonstration)",
            factor: 3.0,
            spatial: 0.03,
            planar: 60.0,
        },
        ..check("discontinuity_eef", Severity::Error, Applies::Everywhere, &[Need::Eef])
    },
    Check {
        meaning: "The object jumps between two consecutive frames, faster than it could fall: the poses of two objects were mixed up, or the scene was reset during the demonstration.",
        measure: "Distance that the object's origin moves in one step",
        unit: "m",
        planar_unit: "px",
        basis: Basis::Constant {
            spatial: 0.15,
            planar: 120.0,
            why: "robosuite: a free fall from half a meter ends at 3 m/s, which is 0.15 m in one step; Push-T: the length of the block's bar",
        },
        ..check(
            "discontinuity_object",
            Severity::Error,
            Applies::Everywhere,
            &[Need::Object],
        )
    },
    Check {
        meaning: "The end effector rotates further in one step than it physically can: frames are missing, or a part of the file uses another orientation convention.",
        measure: "Angle by which the end effector rotates in one step",
        unit: "rad",
        basis: Basis::Multiple {
            of: "largest end-effector rotations in one step (one per demonstration)",
            factor: 3.0,
            spatial: 0.3,
            planar: 0.0,
        },
        ..check(
            "discontinuity_rotation",
            Severity::Error,
            Applies::Gripper,
            &[Need::Orientation],
        )
    },
    Check {
        meaning: "The object is let go in the air: it falls, and either it is grasped again or the demonstration ends without success. Cut the frames out, or leave the demonstration out.",
        measure: "Height of the object when the fingers let it go, minus its height when it comes to rest",
        unit: "m",
        basis: Basis::Constant {
            spatial: 0.02,
            planar: 0.0,
            why: "half of a finger's travel: objects that are put down, or let go just above the surface for a second attempt, fall less",
        },
        ..check("dropped", Severity::Warning, Applies::Gripper, &[Need::Object])
    },
    Check {
        meaning: "The demonstration is identical to an earlier one, bit for bit. It counts twice in training, and if one copy is used for validation, the validation is invalid. Leave one of them out.",
        measure: "Equality of all poses, finger positions and actions",
        ..check("duplicate", Severity::Warning, Applies::Everywhere, &[])
    },
    Check {
        meaning: "The object is released far from where the demonstrations leave it. Either a second grasp or a failure follows; do not use this release as the goal of the task.",
        measure: "Distance of the object, when it has come to rest after a release, from the median of the final object positions",
        unit: "m",
        basis: Basis::Fence {
            of: "distances of final object positions from their median",
            whisker: 3.0,
            spatial: 0.05,
            planar: 0.0,
            small: false,
            most: f64::INFINITY,
        },
        ..check("early_release", Severity::Warning, Applies::Gripper, &[Need::Object])
    },
    Check {
        meaning: "The demonstration ends before the task's own success criterion is met. Replaying it to the end does not complete the task: the policy needs a way to continue from there.",
        measure: "Push-T: coverage of the goal at the last frame. robosuite's tasks: the largest recorded reward, if any demonstration has a reward",
        basis: Basis::Constant {
            spatial: 0.0,
            planar: 0.95,
            why: "Push-T's own success threshold; in robosuite's tasks, any reward above 0 is a success",
        },
        ..check(
            "ends_before_success",
            Severity::Warning,
            Applies::Everywhere,
            &[Need::Reward],
        )
    },
    Check {
        meaning: "The mode changes and changes back before the gripper can react. Such segments are noise in the command: they split chunks and create anchors where nothing is grasped.",
        measure: "Number of frames of the shortest segment in a row of short segments between two other segments",
        unit: "frames",
        planar_unit: "frames",
        basis: Basis::Constant {
            spatial: 5.0,
            planar: 3.0,
            why: "the simulated gripper needs five control steps to release, or to clamp, an object half as wide as its opening",
        },
        ..check("flicker", Severity::Warning, Applies::Everywhere, &[Need::Gripper])
    },
    Check {
        meaning: "Nothing changes at all, bit for bit: the recorder repeated a state. Actions and states do not match there; cut these frames out.",
        measure: "Consecutive frames with exactly the same poses and finger positions",
        unit: "frames",
        planar_unit: "frames",
        basis: Basis::Constant {
            spatial: 3.0,
            planar: 5.0,
            why: "simulated joints are never exactly at rest; Push-T's pusher, which follows the mouse, can be for a moment",
        },
        ..check("frozen", Severity::Warning, Applies::Everywhere, &[])
    },
    Check {
        meaning: "The end effector's pose repeats, bit for bit, although it is commanded to move: its pose was not updated. Poses and actions do not match there; cut these frames out.",
        measure: "Consecutive frames with exactly the same end-effector pose while the arm is commanded to move",
        unit: "frames",
        basis: Basis::Constant {
            spatial: 3.0,
            planar: 0.0,
            why: "simulated joints are never exactly at rest",
        },
        ..check(
            "frozen_eef",
            Severity::Error,
            Applies::Gripper,
            &[Need::Eef, Need::Actions],
        )
    },
    Check {
        meaning: "The object's pose repeats, bit for bit, while the closed fingers carry it: its pose was not updated, as when a tracker loses a covered object. The grasp is judged without these frames. Repair the poses, for example from the end effector's motion, or leave the demonstration out.",
        measure: "Consecutive frames with exactly the same object pose while the fingers hold something and the end effector moves",
        unit: "frames",
        basis: Basis::Constant {
            spatial: 3.0,
            planar: 0.0,
            why: "a carried object is never exactly at rest",
        },
        ..check("frozen_object", Severity::Error, Applies::Gripper, &[Need::Object])
    },
    Check {
        meaning: "An element of the state repeats, bit for bit, while others of its kind move: a sensor was not read, or a cable was loose. States and actions do not match there; cut these frames out, or leave the demonstration out.",
        measure: "Consecutive frames with exactly the same number in one element of the state, other than the gripper, while it is commanded to move and an element of the same role changes in every step",
        unit: "frames",
        basis: Basis::Fence {
            of: "longest stretches (one per demonstration)",
            whisker: 3.0,
            spatial: 10.0,
            planar: 0.0,
            small: true,
            most: f64::INFINITY,
        },
        ..check("frozen_signal", Severity::Warning, Applies::Arm, &[Need::Signals])
    },
    Check {
        meaning: "The fingers move opposite to the gripper commands of the whole demonstration: the command was recorded with the other sign. All modes of the demonstration are wrong; repair the sign, or leave the demonstration out.",
        measure: "Fraction of the fingers' travel that goes against the last gripper command",
        basis: Basis::Constant {
            spatial: 0.5,
            planar: 0.0,
            why: "most of the travel; fingers that obey go against the command only in the frames of a change",
        },
        ..check(
            "gripper_reversed",
            Severity::Error,
            Applies::Gripper,
            &[Need::Opening, Need::Command],
        )
    },
    Check {
        meaning: "The demonstrator waits. A policy learned from these frames may wait forever; skip them if your policy copies actions frame by frame.",
        measure: "Consecutive frames in which the arm is commanded to move and to rotate by less than a twentieth of its limits (Push-T: with the same target)",
        unit: "frames",
        planar_unit: "frames",
        basis: Basis::Fence {
            of: "longest idle stretches (one per demonstration)",
            whisker: 3.0,
            spatial: 10.0,
            planar: 10.0,
            small: true,
            most: f64::INFINITY,
        },
        ..check("idle", Severity::Note, Applies::Everywhere, &[Need::Actions])
    },
    Check {
        meaning: "The demonstration cannot be read, or contradicts the conventions that the other demonstrations establish. The rest of the audit does not include it. Repair it, or leave it out with ingest.select.",
        measure: "Whether ingest can use the demonstration",
        ..check("left_out", Severity::Error, Applies::Everywhere, &[])
    },
    Check {
        meaning: "The object was held, and left the gripper while the command was still to close. The frames after the loss are labeled transfer although the gripper no longer carries the object: object poses derived from the end effector are wrong there. Leave the demonstration out, or cut it at the loss.",
        measure: "Distance of the end effector, in the object's frame, from the grasp transform",
        unit: "m",
        basis: Basis::Constant {
            spatial: 0.02,
            planar: 0.0,
            why: "half of a finger's travel: an object that has moved this far in the gripper is no longer between the fingers",
        },
        ..check(
            "lost_grasp",
            Severity::Error,
            Applies::Gripper,
            &[Need::Opening, Need::Shut],
        )
    },
    Check {
        meaning: "The gripper was commanded to close, but did not grasp the object: the fingers closed on nothing, or on something else, so that the object does not follow the end effector. The frames are labeled transfer, but this object is not carried. If this is the first transfer segment, the demonstration's anchor is wrong. Cut the attempt out or, if another object is carried, audit that object (ingest.object).",
        measure: "Smallest distance between the fingers, and whether the object follows the end effector",
        unit: "m",
        basis: Basis::ClosedFingers,
        ..check(
            "missed_grasp",
            Severity::Error,
            Applies::Gripper,
            &[Need::Opening, Need::Shut],
        )
    },
    Check {
        meaning: "The block moves, but no contact was counted: the contact was lost within the control step, or the block is still sliding. A mode derived from contacts is wrong there.",
        measure: "Consecutive frames with motion of the block but without contact",
        planar_unit: "frames",
        basis: Basis::Constant {
            spatial: 0.0,
            planar: 3.0,
            why: "a contact lost within one control step shows in one or two frames",
        },
        ..check(
            "motion_without_contact",
            Severity::Note,
            Applies::Planar,
            &[Need::Object],
        )
    },
    Check {
        meaning: "The demonstration is almost the same as an earlier one: a copy with noise, or at another speed. It counts twice in training, and if one copy is used for validation, the validation is invalid. Leave one of them out.",
        measure: "Root mean square distance between the paths of end effector and object and those of the other demonstration, at the same fractions of the duration",
        unit: "m",
        planar_unit: "px",
        basis: Basis::Nearest {
            spatial: 0.001,
            planar: 1.0,
        },
        ..check("near_duplicate", Severity::Warning, Applies::Everywhere, &[Need::Arm])
    },
    Check {
        meaning: "No frame is in transfer: the gripper is never commanded to close. The demonstration has no grasp frame and no anchor; leave it out.",
        measure: "Number of transfer frames",
        unit: "frames",
        ..check("no_transfer", Severity::Error, Applies::Gripper, &[Need::Gripper])
    },
    Check {
        meaning: "The object rotates in the gripper further than in the other demonstrations: the grasp is not rigid in rotation, and object poses derived from the end effector are off by this angle.",
        measure: "Largest angle of the end effector, in the object's frame, from the grasp transform, over a held segment",
        unit: "rad",
        basis: Basis::Fence {
            of: "largest angles (one per held grasp)",
            whisker: 3.0,
            spatial: 0.1,
            planar: 0.0,
            small: true,
            most: f64::INFINITY,
        },
        ..check("non_rigid_rotation", Severity::Note, Applies::Gripper, &[Need::Object])
    },
    Check {
        meaning: "The object moves in the gripper further than in the other demonstrations, without being lost: it slips between the fingers, or something pushes it aside together with them. Transfer is not rigid there, and object poses derived from the end effector are off by this distance.",
        measure: "Largest distance of the end effector, in the object's frame, from the grasp transform, over a held segment, until the object is within 3 cm of its place of release",
        unit: "m",
        basis: Basis::Fence {
            of: "largest distances (one per held grasp)",
            whisker: 1.5,
            spatial: 0.005,
            planar: 0.0,
            small: true,
            most: f64::INFINITY,
        },
        ..check(
            "non_rigid_transfer",
            Severity::Warning,
            Applies::Gripper,
            &[Need::Object],
        )
    },
    Check {
        meaning: "The demonstration is much longer or shorter than the others. This is often a sign of another problem; inspect the demonstration.",
        measure: "Deviation of the number of frames from the median, in standard deviations estimated from the median absolute deviation",
        basis: Basis::Constant {
            spatial: 3.5,
            planar: 3.5,
            why: "the usual cutoff of the modified z-score",
        },
        ..check("outlier_length", Severity::Note, Applies::Everywhere, &[])
    },
    Check {
        meaning: "The open gripper moves the object. The mode is transit, in which the object is assumed to rest until the grasp: before the push, the pose of the anchor relative to the object is wrong.",
        measure: "Distance of the object's origin from its rest position, in transit, after the object has settled",
        unit: "m",
        basis: Basis::Constant {
            spatial: 0.01,
            planar: 0.0,
            why: "an eighth of the gripper's opening; a gripper that centers itself on the object moves it less",
        },
        ..check(
            "pushed_in_transit",
            Severity::Warning,
            Applies::Gripper,
            &[Need::Object],
        )
    },
    Check {
        meaning: "The demonstration grasps more often than the others. Its anchor belongs to the first grasp only; do not train a policy that assumes one grasp and one transfer on it.",
        measure: "Number of transfer segments, without flicker",
        basis: Basis::Multiple {
            of: "numbers of transfer segments (one per demonstration)",
            factor: 1.0,
            spatial: 1.0,
            planar: 0.0,
        },
        ..check("regrasp", Severity::Warning, Applies::Gripper, &[Need::Gripper])
    },
    Check {
        meaning: "The object is released from higher above its place of rest than in the other demonstrations. It may bounce, roll away or break.",
        measure: "Height of the object when the fingers let it go, minus its height when it comes to rest",
        unit: "m",
        basis: Basis::Fence {
            of: "fall heights after the last releases of demonstrations",
            whisker: 1.0,
            spatial: 0.05,
            planar: 0.0,
            small: false,
            most: f64::INFINITY,
        },
        ..check("released_high", Severity::Warning, Applies::Gripper, &[Need::Object])
    },
    Check {
        meaning: "The gripper is commanded to open while the arm still moves sideways, faster than in the other demonstrations: the object is released on the way, and is thrown.",
        measure: "Horizontal distance that the end effector moves in the step of the command to open",
        unit: "m",
        basis: Basis::Fence {
            of: "distances at the last releases of demonstrations",
            whisker: 3.0,
            spatial: 0.005,
            planar: 0.0,
            small: true,
            most: f64::INFINITY,
        },
        ..check("released_moving", Severity::Warning, Applies::Gripper, &[Need::Object])
    },
    Check {
        meaning: "The rows are in reverse order: the motion precedes the actions that would cause it, and is opposite to them. Reverse the rows of all arrays, or leave the demonstration out.",
        measure: "Correlation of the end effector's steps with the actions, at the lag that reversal gives, with the opposite sign",
        basis: Basis::Constant {
            spatial: 0.5,
            planar: 0.0,
            why: "a quarter of the motion is explained by opposite actions",
        },
        ..check(
            "reversed",
            Severity::Error,
            Applies::Gripper,
            &[Need::Arm, Need::Actions],
        )
    },
    Check {
        meaning: "The actions are the same as in an earlier demonstration, but the states differ: one of the two is a replay, or states and actions were mixed up.",
        measure: "Equality of all actions",
        ..check("same_actions", Severity::Note, Applies::Everywhere, &[Need::Actions])
    },
    Check {
        meaning: "The arm's controls are at their limits in an unusually large fraction of the demonstration: the demonstrator probably intended larger motions than the controls allow.",
        measure: "Fraction of the frames in which at least one of the arm's controls is at its limit",
        basis: Basis::Share {
            of: "fractions of saturated frames (one per demonstration)",
            minimum: 0.25,
        },
        ..check("saturated", Severity::Warning, Applies::Gripper, &[Need::Limits])
    },
    Check {
        meaning: "Several of the arm's controls are at their limits at the same time in an unusually large fraction of the demonstration. The arm then moves in another direction than intended, because each control is clipped by itself.",
        measure: "Fraction of the frames in which at least two of the arm's controls are at their limits",
        basis: Basis::Share {
            of: "fractions (one per demonstration)",
            minimum: 0.05,
        },
        ..check(
            "saturated_together",
            Severity::Warning,
            Applies::Gripper,
            &[Need::Limits],
        )
    },
    Check {
        meaning: "The numbers jump although the motion does not: a quaternion changes its sign, the rotation vector of a goal passes pi, or an angle wraps around. Goals are checked only if absolute actions were recorded. Differences, means and distances of the raw numbers are wrong across such a step; use a continuous representation, or compare angles on the circle.",
        measure: "Number of steps across which the representation jumps",
        unit: "frames",
        planar_unit: "frames",
        ..check("seam", Severity::Note, Applies::Everywhere, &[Need::Orientation])
    },
    Check {
        meaning: "The demonstration succeeds, but its last frames do not: the success was lost again. Cut it after the success, or leave it out.",
        measure: "Number of frames without reward at the end, after frames with a reward",
        unit: "frames",
        basis: Basis::Constant {
            spatial: 3.0,
            planar: 0.0,
            why: "recordings end up to three frames after the last counted reward",
        },
        ..check("success_lost", Severity::Warning, Applies::Gripper, &[Need::Reward])
    },
    Check {
        meaning: "While the fingers keep their distance, the object's pose jumps away from them: it is the pose of another object, or was estimated wrongly. The grasp is judged without these frames.",
        measure: "Distance that the end effector moves in the object's frame in one step, out of rest, while the fingers hold something",
        unit: "m",
        basis: Basis::Constant {
            spatial: 0.03,
            planar: 0.0,
            why: "in one step of 1/20 s, an object falls by 12 mm out of rest, and the end effector moves by at most 13 mm",
        },
        ..check("swapped_object", Severity::Error, Applies::Gripper, &[Need::Object])
    },
    Check {
        meaning: "In a single step, the arm moves much further than in the steps around it, and faster than it usually does: frames are missing, or the recording was interrupted. Split the demonstration there; a chunk that spans the gap cannot be replayed.",
        measure: "Motion of the end effector in one step, in multiples of the usual top speed (the median of the largest steps, or of the largest rotations, of all demonstrations), while it moves at most half as far in the two steps before and after",
        basis: Basis::Constant {
            spatial: 1.5,
            planar: 0.0,
            why: "an arm that exceeds its usual top speed by half does not do so for a single step, because it has to accelerate and to brake",
        },
        ..check("time_gap", Severity::Error, Applies::Gripper, &[Need::Arm])
    },
    Check {
        meaning: "The recorded times do not advance by one frame per frame: frames were lost or recorded late, or the times run backwards. A policy that assumes a constant rate learns a wrong speed there. Split the demonstration at the gap, or resample it.",
        measure: "Largest deviation of a difference between consecutive times from the duration of a frame, in durations of a frame",
        basis: Basis::Constant {
            spatial: 0.5,
            planar: 0.0,
            why: "half the duration of a frame: from there on, the nearest frame of a constant rate is another one",
        },
        ..check("timestamps", Severity::Warning, Applies::Arm, &[Need::Times])
    },
];
