//! The checks, described once: what the artifact's table says and the documentation shows follows from here.

use std::fmt::Write as _;

use crate::finding::Severity;

/// A check: one kind of finding, one threshold.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Check {
    /// Kind of its findings; also the name of the setting in `[audit]` that replaces its threshold.
    pub code: &'static str,
    /// Severity of its findings.
    pub severity: Severity,
    /// Which demonstrations it is made on.
    pub applies: Applies,
    /// What a finding means and what to do about it.
    pub meaning: &'static str,
    /// What is measured.
    pub measure: &'static str,
    /// Unit of the measure in robosuite's tasks.
    pub unit: &'static str,
    /// Unit of the measure in Push-T.
    pub planar_unit: &'static str,
    /// Where its threshold comes from.
    pub basis: Basis,
}

/// Which demonstrations a check is made on.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Applies {
    /// All.
    Everywhere,
    /// Those with a gripper.
    Gripper,
    /// Push-T.
    Planar,
}

/// Where a threshold comes from unless it is set.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Basis {
    /// There is nothing to compare with.
    Nothing,
    /// A constant.
    Constant {
        /// In robosuite's tasks.
        spatial: f64,
        /// In Push-T.
        planar: f64,
        /// Why this one.
        why: &'static str,
    },
    /// From `segment.gripper.closed`.
    ClosedFingers,
    /// The upper outer fence of what was measured on the dataset: Q3 + 3 (Q3 - Q1), at least `minimum`.
    Fence {
        /// Values measured, in words.
        of: &'static str,
        /// Minimum threshold in robosuite's tasks.
        spatial: f64,
        /// Minimum threshold in Push-T.
        planar: f64,
        /// Whether the minimum serves where the dataset is too small; else the check is not made.
        small: bool,
    },
    /// `factor` times the median of what was measured on each demonstration, at least `minimum`.
    Multiple {
        /// Values measured, in words.
        of: &'static str,
        /// The factor.
        factor: f64,
        /// Minimum threshold in robosuite's tasks.
        spatial: f64,
        /// Minimum threshold in Push-T.
        planar: f64,
    },
}

/// A dataset of fewer values than this gives no quartiles worth deriving a threshold from.
pub(crate) const ENOUGH: usize = 8;

const fn check(code: &'static str, severity: Severity, applies: Applies) -> Check {
    Check {
        code,
        severity,
        applies,
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
        meaning: "The fingers do not do what the gripper is told: after the time that they need, they have neither moved nor met anything. Command and mode then say nothing about the hand; look for a stuck gripper or for commands with the other sign.",
        measure: "Frames since the gripper's command changed",
        unit: "frames",
        basis: Basis::Constant {
            spatial: 12.0,
            planar: 0.0,
            why: "full travel takes the simulated gripper 8 (robosuite 1.4) or 10 (1.5) control steps, and its servo two more",
        },
        ..check("command_fingers_disagree", Severity::Warning, Applies::Gripper)
    },
    Check {
        meaning: "The pusher touches the block and the block rests. A mode that is read from contacts is wrong there; one that is read from motion is not.",
        measure: "Frames in a row with contact and without motion of the block",
        planar_unit: "frames",
        basis: Basis::Constant {
            spatial: 0.0,
            planar: 5.0,
            why: "half a second at Push-T's 10 Hz",
        },
        ..check("contact_without_motion", Severity::Note, Applies::Planar)
    },
    Check {
        meaning: "The end effector is somewhere else from one frame to the next: frames are missing, two demonstrations are joined, or poses are wrong. Cut the demonstration there or leave it out; a chunk across the jump cannot be replayed.",
        measure: "Distance that the end effector moves in a step",
        unit: "m",
        planar_unit: "px",
        basis: Basis::Multiple {
            of: "the demonstrations' largest steps of the end effector",
            factor: 3.0,
            spatial: 0.03,
            planar: 60.0,
        },
        ..check("discontinuity_eef", Severity::Error, Applies::Everywhere)
    },
    Check {
        meaning: "The object is somewhere else from one frame to the next, faster than it could fall: poses of two objects are mixed up, or the scene was reset within the demonstration.",
        measure: "Distance that the object's origin moves in a step",
        unit: "m",
        planar_unit: "px",
        basis: Basis::Constant {
            spatial: 0.15,
            planar: 120.0,
            why: "robosuite: a free fall from half a metre ends at 3 m/s, which is 0.15 m in a step; Push-T: as long as the block's bar",
        },
        ..check("discontinuity_object", Severity::Error, Applies::Everywhere)
    },
    Check {
        meaning: "The end effector turns further in a step than it can. Frames are missing, or orientations are in another convention for a part of the file.",
        measure: "Angle that the end effector turns in a step",
        unit: "rad",
        basis: Basis::Multiple {
            of: "the demonstrations' largest turns of the end effector",
            factor: 3.0,
            spatial: 0.3,
            planar: 0.0,
        },
        ..check("discontinuity_rotation", Severity::Error, Applies::Gripper)
    },
    Check {
        meaning: "After its release the object falls further than it does in the other demonstrations: it was dropped rather than put down.",
        measure: "Height of the object at the command to open over that at which it comes to rest",
        unit: "m",
        basis: Basis::Fence {
            of: "falls after releases",
            spatial: 0.05,
            planar: 0.0,
            small: false,
        },
        ..check("dropped", Severity::Warning, Applies::Gripper)
    },
    Check {
        meaning: "The same demonstration twice, bit for bit. It counts double in training, and where one copy is for validation, the validation is void. Leave one out.",
        measure: "Equality of all poses, fingers and actions",
        ..check("duplicate", Severity::Warning, Applies::Everywhere)
    },
    Check {
        meaning: "The object is let go far from where the demonstrations leave it. What follows is either a second grasp or a failure; do not take the release for the task's goal.",
        measure: "Distance of the object, when it has come to rest after a release, from the median of the demonstrations' last object positions",
        unit: "m",
        basis: Basis::Fence {
            of: "distances of the demonstrations' last object positions from their median",
            spatial: 0.05,
            planar: 0.0,
            small: false,
        },
        ..check("early_release", Severity::Warning, Applies::Gripper)
    },
    Check {
        meaning: "The demonstration ends, or is over, before the task succeeds by its own measure. Replaying it to the end is not enough: the policy needs to know what to do then.",
        measure: "Push-T: coverage of the goal at the last frame. Robosuite's tasks: the largest recorded reward, where any demonstration has a reward",
        basis: Basis::Constant {
            spatial: 0.0,
            planar: 0.95,
            why: "Push-T's own threshold of success; a reward above 0 in robosuite's tasks",
        },
        ..check("ends_before_success", Severity::Warning, Applies::Everywhere)
    },
    Check {
        meaning: "The mode changes and changes back before the gripper can do anything about it. Such segments are noise of the command: they break chunks and give anchors where nothing is grasped.",
        measure: "Frames of a segment between two others",
        unit: "frames",
        planar_unit: "frames",
        basis: Basis::Constant {
            spatial: 5.0,
            planar: 3.0,
            why: "the simulated gripper needs five control steps to let go of, or to clamp, an object of half its width",
        },
        ..check("flicker", Severity::Warning, Applies::Everywhere)
    },
    Check {
        meaning: "Nothing moves at all, to the last bit: the recorder repeated a state. Actions and states do not belong together there; cut the stretch out.",
        measure: "Frames in a row with the very same poses and fingers",
        unit: "frames",
        planar_unit: "frames",
        basis: Basis::Constant {
            spatial: 3.0,
            planar: 5.0,
            why: "simulated joints are never at rest to the last bit; Push-T's pusher can be, with the mouse, for a moment",
        },
        ..check("frozen", Severity::Warning, Applies::Everywhere)
    },
    Check {
        meaning: "The demonstrator waits. A policy learnt from it may wait for ever; skip the frames where that matters.",
        measure: "Frames in a row with an arm action of exactly zero (Push-T: with the same target)",
        unit: "frames",
        planar_unit: "frames",
        basis: Basis::Fence {
            of: "the demonstrations' longest idle stretches",
            spatial: 10.0,
            planar: 10.0,
            small: true,
        },
        ..check("idle", Severity::Note, Applies::Everywhere)
    },
    Check {
        meaning: "The demonstration cannot be read, or contradicts the conventions that the others prove. It is in none of what follows. Repair it, or leave it out by ingest.select.",
        measure: "Whether ingest can use it",
        ..check("left_out", Severity::Error, Applies::Everywhere)
    },
    Check {
        meaning: "The object was held, and left the hand while the command was still to close. The frames after that are labelled transfer and are not: poses taken from the hand are wrong there. Leave the demonstration out, or cut it at the loss.",
        measure: "Distance of the end effector, in the object's frame, from the grasp transform",
        unit: "m",
        basis: Basis::Constant {
            spatial: 0.02,
            planar: 0.0,
            why: "half of a finger's travel: an object that has moved so far in the hand is no longer between the fingers",
        },
        ..check("lost_grasp", Severity::Error, Applies::Gripper)
    },
    Check {
        meaning: "A command to close without a grasp of the object: the fingers closed on nothing, or on something else, so that the object does not follow the hand. The frames are labelled transfer and are not transfer of this object, and where it is the first transfer segment, the demonstration's anchor is wrong. Cut the attempt out, or, where another object is carried, audit that one (ingest.object).",
        measure: "Distance between the fingers at their narrowest, and whether the object follows the hand",
        unit: "m",
        basis: Basis::ClosedFingers,
        ..check("missed_grasp", Severity::Error, Applies::Gripper)
    },
    Check {
        meaning: "The block moves and no contact was counted: the contact was lost within the control step, or the block still slides. A mode that is read from contacts is wrong there.",
        measure: "Frames in a row with motion of the block and without contact",
        planar_unit: "frames",
        basis: Basis::Constant {
            spatial: 0.0,
            planar: 3.0,
            why: "a contact lost within one control step shows in one frame, or in two",
        },
        ..check("motion_without_contact", Severity::Note, Applies::Planar)
    },
    Check {
        meaning: "No frame is in transfer: the gripper is never told to close. The demonstration has no grasp frame and no anchor; leave it out.",
        measure: "Transfer frames",
        unit: "frames",
        ..check("no_transfer", Severity::Error, Applies::Gripper)
    },
    Check {
        meaning: "The object turns in the hand further than in the other demonstrations: the grasp is not rigid in its rotation, and relative poses taken from the hand are off by as much.",
        measure: "Largest angle of the end effector, in the object's frame, from the grasp transform, over a segment that is held",
        unit: "rad",
        basis: Basis::Fence {
            of: "angles of held grasps",
            spatial: 0.1,
            planar: 0.0,
            small: true,
        },
        ..check("non_rigid_rotation", Severity::Note, Applies::Gripper)
    },
    Check {
        meaning: "The object slips in the hand further than in the other demonstrations, without being lost: transfer is not rigid there, and relative poses taken from the hand are off by as much.",
        measure: "Largest distance of the end effector, in the object's frame, from the grasp transform, over a segment that is held",
        unit: "m",
        basis: Basis::Fence {
            of: "distances of held grasps",
            spatial: 0.005,
            planar: 0.0,
            small: true,
        },
        ..check("non_rigid_transfer", Severity::Warning, Applies::Gripper)
    },
    Check {
        meaning: "Much longer or shorter than the other demonstrations. Often the sign of something else; look at it.",
        measure: "Distance of the number of frames from the median, in standard deviations as estimated from the median absolute deviation",
        basis: Basis::Constant {
            spatial: 3.5,
            planar: 3.5,
            why: "the usual cut of the modified z-score",
        },
        ..check("outlier_length", Severity::Note, Applies::Everywhere)
    },
    Check {
        meaning: "The open hand moves the object. The mode says transit, where the object is taken to rest at the anchor: the anchor's relation to the object is wrong before the push.",
        measure: "Distance of the object's origin from where it rested, in transit, after it has settled",
        unit: "m",
        basis: Basis::Constant {
            spatial: 0.01,
            planar: 0.0,
            why: "an eighth of the gripper's opening: more than the nudge of a hand that centres itself on the object",
        },
        ..check("pushed_in_transit", Severity::Warning, Applies::Gripper)
    },
    Check {
        meaning: "The demonstration grasps more often than the others. Its anchor is that of the first grasp alone; a learner of one grasp and one transfer should not get it.",
        measure: "Transfer segments, flicker apart",
        basis: Basis::Multiple {
            of: "the demonstrations' numbers of transfer segments",
            factor: 1.0,
            spatial: 1.0,
            planar: 0.0,
        },
        ..check("regrasp", Severity::Warning, Applies::Gripper)
    },
    Check {
        meaning: "The same actions as in another demonstration, from other states: one of the two is a replay, or states and actions were mixed up.",
        measure: "Equality of all actions",
        ..check("same_actions", Severity::Note, Applies::Everywhere)
    },
    Check {
        meaning: "The controls are at their limit in an unusual fraction of the demonstration: what the demonstrator wanted was more than was recorded.",
        measure: "Fraction of the frames at which one of the arm's controls is at its limit",
        basis: Basis::Fence {
            of: "the demonstrations' shares",
            spatial: 0.25,
            planar: 1.0,
            small: true,
        },
        ..check("saturated", Severity::Warning, Applies::Gripper)
    },
    Check {
        meaning: "The numbers jump where the motion does not: a quaternion changes its sign, the rotation vector of a goal passes pi, an angle wraps around. Differences, means and distances of the raw numbers are wrong across it; use a representation without seam, or compare on the circle.",
        measure: "Steps that cross a seam",
        unit: "frames",
        planar_unit: "frames",
        ..check("seam", Severity::Note, Applies::Everywhere)
    },
];

/// The check of this code.
pub(crate) fn find(code: &str) -> Option<&'static Check> {
    CHECKS.iter().find(|check| check.code == code)
}

impl Check {
    /// Whether it is made on demonstrations with a gripper, or on planar ones.
    pub fn applies_to(&self, planar: bool) -> bool {
        match self.applies {
            Applies::Everywhere => true,
            Applies::Gripper => !planar,
            Applies::Planar => planar,
        }
    }

    /// Unit of measure and threshold.
    pub fn unit_of(&self, planar: bool) -> &'static str {
        if planar { self.planar_unit } else { self.unit }
    }

    /// How the threshold comes about, in words.
    pub fn rule(&self) -> String {
        let both = |spatial: f64, planar: f64| match self.applies {
            Applies::Gripper => with_unit(spatial, self.unit),
            Applies::Planar => with_unit(planar, self.planar_unit),
            Applies::Everywhere if spatial == planar && self.unit == self.planar_unit => with_unit(spatial, self.unit),
            Applies::Everywhere => format!(
                "{} (Push-T: {})",
                with_unit(spatial, self.unit),
                with_unit(planar, self.planar_unit)
            ),
        };
        match self.basis {
            Basis::Nothing => "none".to_owned(),
            Basis::Constant { spatial, planar, why } => format!("{}: {why}", both(spatial, planar)),
            Basis::ClosedFingers => {
                "`segment.gripper.closed`, 0.01 m by default: the paper's figure for a failed grasp".to_owned()
            }
            Basis::Fence {
                of,
                spatial,
                planar,
                small,
            } => format!(
                "Q3 + 3 (Q3 - Q1) of {of}, at least {}; with fewer than {ENOUGH} values {}",
                both(spatial, planar),
                if small { "that" } else { "not made" }
            ),
            Basis::Multiple {
                of,
                factor,
                spatial,
                planar,
            } => {
                let times = if factor == 1.0 {
                    "the median".to_owned()
                } else {
                    format!("{factor} times the median")
                };
                format!(
                    "{times} of {of}, at least {}; with fewer than {ENOUGH} demonstrations {}",
                    both(spatial, planar),
                    if factor == 1.0 { "that" } else { "twice that" }
                )
            }
        }
    }
}

fn with_unit(value: f64, unit: &str) -> String {
    if unit.is_empty() {
        value.to_string()
    } else {
        format!("{value} {unit}")
    }
}

/// The checks as a table in Markdown, for the documentation.
pub fn markdown() -> String {
    let mut text =
        "| code | severity | on | what it means | measure | threshold |\n|---|---|---|---|---|---|\n".to_owned();
    for check in CHECKS {
        let on = match check.applies {
            Applies::Everywhere => "all",
            Applies::Gripper => "robosuite",
            Applies::Planar => "Push-T",
        };
        let _ = writeln!(
            text,
            "| `{}` | {} | {on} | {} | {} | {} |",
            check.code,
            check.severity.as_str(),
            check.meaning,
            check.measure,
            check.rule()
        );
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn checks_are_sorted_complete_and_unlike() {
        assert!(CHECKS.windows(2).all(|pair| pair[0].code < pair[1].code));
        for check in CHECKS {
            assert!(
                check.meaning.ends_with('.') && !check.measure.is_empty(),
                "{}",
                check.code
            );
        }
    }
}
