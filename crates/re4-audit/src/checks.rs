//! The descriptions of all checks. The artifact's table `checks` and the documentation are both generated from them.

use std::fmt::Write as _;

use crate::finding::Severity;

/// A check: one kind of finding with one threshold.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Check {
    /// Code of its findings; also the name of the setting in `[audit]` that replaces its threshold.
    pub code: &'static str,
    /// Severity of its findings.
    pub severity: Severity,
    /// The demonstrations that it applies to.
    pub applies: Applies,
    /// What a finding means, and what to do about it.
    pub meaning: &'static str,
    /// What is measured.
    pub measure: &'static str,
    /// Unit of the measure in robosuite's tasks.
    pub unit: &'static str,
    /// Unit of the measure in Push-T.
    pub planar_unit: &'static str,
    /// How its threshold is determined.
    pub basis: Basis,
}

/// The demonstrations that a check applies to.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Applies {
    /// All demonstrations.
    Everywhere,
    /// Demonstrations with a gripper, that is, of robosuite's tasks.
    Gripper,
    /// Demonstrations of Push-T.
    Planar,
}

/// How a threshold is determined unless the pipeline file sets it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Basis {
    /// The check has no threshold.
    Nothing,
    /// A constant.
    Constant {
        /// Value for robosuite's tasks.
        spatial: f64,
        /// Value for Push-T.
        planar: f64,
        /// The reason for this value.
        why: &'static str,
    },
    /// The setting `segment.gripper.closed`.
    ClosedFingers,
    /// The upper outer fence of the values measured on the dataset: Q3 + 3 (Q3 - Q1), but at least a minimum.
    Fence {
        /// Description of the measured values.
        of: &'static str,
        /// Minimum threshold in robosuite's tasks.
        spatial: f64,
        /// Minimum threshold in Push-T.
        planar: f64,
        /// Whether a dataset that is too small for a fence uses the minimum. If false, the check is not made on it.
        small: bool,
    },
    /// `factor` times the median of the values measured on each demonstration, but at least a minimum.
    Multiple {
        /// Description of the measured values.
        of: &'static str,
        /// The factor.
        factor: f64,
        /// Minimum threshold in robosuite's tasks.
        spatial: f64,
        /// Minimum threshold in Push-T.
        planar: f64,
    },
}

/// Minimum number of values from which a threshold is derived. Quartiles and medians of fewer values depend too much on single
/// ones.
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
        meaning: "The fingers do not follow the gripper command: they have had enough time to move, but have neither moved nor closed on anything. Command and mode then do not describe the gripper. Look for a stuck gripper or for commands with the opposite sign.",
        measure: "Frames since the gripper command changed",
        unit: "frames",
        basis: Basis::Constant {
            spatial: 12.0,
            planar: 0.0,
            why: "the full travel of the simulated fingers takes 8 control steps in robosuite 1.4 and 10 in 1.5, and the servo needs two more",
        },
        ..check("command_fingers_disagree", Severity::Warning, Applies::Gripper)
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
        ..check("contact_without_motion", Severity::Note, Applies::Planar)
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
        ..check("discontinuity_eef", Severity::Error, Applies::Everywhere)
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
        ..check("discontinuity_object", Severity::Error, Applies::Everywhere)
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
        ..check("discontinuity_rotation", Severity::Error, Applies::Gripper)
    },
    Check {
        meaning: "After its release, the object falls further than in the other demonstrations: it was dropped rather than put down.",
        measure: "Height of the object at the command to open, minus its height when it comes to rest",
        unit: "m",
        basis: Basis::Fence {
            of: "fall heights after releases",
            spatial: 0.05,
            planar: 0.0,
            small: false,
        },
        ..check("dropped", Severity::Warning, Applies::Gripper)
    },
    Check {
        meaning: "The demonstration is identical to an earlier one, bit for bit. It counts twice in training, and if one copy is used for validation, the validation is invalid. Leave one of them out.",
        measure: "Equality of all poses, finger positions and actions",
        ..check("duplicate", Severity::Warning, Applies::Everywhere)
    },
    Check {
        meaning: "The object is released far from where the demonstrations leave it. Either a second grasp or a failure follows; do not use this release as the goal of the task.",
        measure: "Distance of the object, when it has come to rest after a release, from the median of the final object positions",
        unit: "m",
        basis: Basis::Fence {
            of: "distances of final object positions from their median",
            spatial: 0.05,
            planar: 0.0,
            small: false,
        },
        ..check("early_release", Severity::Warning, Applies::Gripper)
    },
    Check {
        meaning: "The demonstration ends before the task's own success criterion is met. Replaying it to the end does not complete the task: the policy needs a way to continue from there.",
        measure: "Push-T: coverage of the goal at the last frame. robosuite's tasks: the largest recorded reward, if any demonstration has a reward",
        basis: Basis::Constant {
            spatial: 0.0,
            planar: 0.95,
            why: "Push-T's own success threshold; in robosuite's tasks, any reward above 0 is a success",
        },
        ..check("ends_before_success", Severity::Warning, Applies::Everywhere)
    },
    Check {
        meaning: "The mode changes and changes back before the gripper can react. Such segments are noise in the command: they split chunks and create anchors where nothing is grasped.",
        measure: "Number of frames of a segment between two other segments",
        unit: "frames",
        planar_unit: "frames",
        basis: Basis::Constant {
            spatial: 5.0,
            planar: 3.0,
            why: "the simulated gripper needs five control steps to release, or to clamp, an object half as wide as its opening",
        },
        ..check("flicker", Severity::Warning, Applies::Everywhere)
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
        ..check("frozen", Severity::Warning, Applies::Everywhere)
    },
    Check {
        meaning: "The demonstrator waits. A policy learned from these frames may wait forever; skip them if your policy copies actions frame by frame.",
        measure: "Consecutive frames with an arm action of exactly zero (Push-T: with the same target)",
        unit: "frames",
        planar_unit: "frames",
        basis: Basis::Fence {
            of: "longest idle stretches (one per demonstration)",
            spatial: 10.0,
            planar: 10.0,
            small: true,
        },
        ..check("idle", Severity::Note, Applies::Everywhere)
    },
    Check {
        meaning: "The demonstration cannot be read, or contradicts the conventions that the other demonstrations establish. The rest of the audit does not include it. Repair it, or leave it out with ingest.select.",
        measure: "Whether ingest can use the demonstration",
        ..check("left_out", Severity::Error, Applies::Everywhere)
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
        ..check("lost_grasp", Severity::Error, Applies::Gripper)
    },
    Check {
        meaning: "The gripper was commanded to close, but did not grasp the object: the fingers closed on nothing, or on something else, so that the object does not follow the end effector. The frames are labeled transfer, but this object is not carried. If this is the first transfer segment, the demonstration's anchor is wrong. Cut the attempt out or, if another object is carried, audit that object (ingest.object).",
        measure: "Smallest distance between the fingers, and whether the object follows the end effector",
        unit: "m",
        basis: Basis::ClosedFingers,
        ..check("missed_grasp", Severity::Error, Applies::Gripper)
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
        ..check("motion_without_contact", Severity::Note, Applies::Planar)
    },
    Check {
        meaning: "No frame is in transfer: the gripper is never commanded to close. The demonstration has no grasp frame and no anchor; leave it out.",
        measure: "Number of transfer frames",
        unit: "frames",
        ..check("no_transfer", Severity::Error, Applies::Gripper)
    },
    Check {
        meaning: "The object rotates in the gripper further than in the other demonstrations: the grasp is not rigid in rotation, and object poses derived from the end effector are off by this angle.",
        measure: "Largest angle of the end effector, in the object's frame, from the grasp transform, over a held segment",
        unit: "rad",
        basis: Basis::Fence {
            of: "largest angles (one per held grasp)",
            spatial: 0.1,
            planar: 0.0,
            small: true,
        },
        ..check("non_rigid_rotation", Severity::Note, Applies::Gripper)
    },
    Check {
        meaning: "The object slips in the gripper further than in the other demonstrations, without being lost: transfer is not rigid there, and object poses derived from the end effector are off by this distance.",
        measure: "Largest distance of the end effector, in the object's frame, from the grasp transform, over a held segment",
        unit: "m",
        basis: Basis::Fence {
            of: "largest distances (one per held grasp)",
            spatial: 0.005,
            planar: 0.0,
            small: true,
        },
        ..check("non_rigid_transfer", Severity::Warning, Applies::Gripper)
    },
    Check {
        meaning: "The demonstration is much longer or shorter than the others. This is often a sign of another problem; inspect the demonstration.",
        measure: "Deviation of the number of frames from the median, in standard deviations estimated from the median absolute deviation",
        basis: Basis::Constant {
            spatial: 3.5,
            planar: 3.5,
            why: "the usual cutoff of the modified z-score",
        },
        ..check("outlier_length", Severity::Note, Applies::Everywhere)
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
        ..check("pushed_in_transit", Severity::Warning, Applies::Gripper)
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
        ..check("regrasp", Severity::Warning, Applies::Gripper)
    },
    Check {
        meaning: "The actions are the same as in an earlier demonstration, but the states differ: one of the two is a replay, or states and actions were mixed up.",
        measure: "Equality of all actions",
        ..check("same_actions", Severity::Note, Applies::Everywhere)
    },
    Check {
        meaning: "The arm's controls are at their limits in an unusually large fraction of the demonstration: the demonstrator probably intended larger motions than the controls allow.",
        measure: "Fraction of the frames in which at least one of the arm's controls is at its limit",
        basis: Basis::Fence {
            of: "fractions of saturated frames (one per demonstration)",
            spatial: 0.25,
            planar: 1.0,
            small: true,
        },
        ..check("saturated", Severity::Warning, Applies::Gripper)
    },
    Check {
        meaning: "The numbers jump although the motion does not: a quaternion changes its sign, the rotation vector of a goal passes pi, or an angle wraps around. Differences, means and distances of the raw numbers are wrong across such a step; use a continuous representation, or compare angles on the circle.",
        measure: "Number of steps across which the representation jumps",
        unit: "frames",
        planar_unit: "frames",
        ..check("seam", Severity::Note, Applies::Everywhere)
    },
];

/// Returns the check with this code.
pub(crate) fn find(code: &str) -> Option<&'static Check> {
    CHECKS.iter().find(|check| check.code == code)
}

impl Check {
    /// Whether the check applies to Push-T (`planar`) or to demonstrations with a gripper (otherwise).
    pub fn applies_to(&self, planar: bool) -> bool {
        match self.applies {
            Applies::Everywhere => true,
            Applies::Gripper => !planar,
            Applies::Planar => planar,
        }
    }

    /// Unit of the measure and of the threshold, for Push-T (`planar`) or for robosuite's tasks; empty if they have none.
    pub fn unit_of(&self, planar: bool) -> &'static str {
        if planar { self.planar_unit } else { self.unit }
    }

    /// Describes how the threshold is determined.
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
                "`segment.gripper.closed`, by default 0.01 m, the paper's value for a failed grasp".to_owned()
            }
            Basis::Fence {
                of,
                spatial,
                planar,
                small,
            } => format!(
                "Q3 + 3 (Q3 - Q1) of the {of}, but at least {}; with fewer than {ENOUGH} values, {}",
                both(spatial, planar),
                if small { "that minimum" } else { "the check is skipped" }
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
                    "{times} of the {of}, but at least {}; with fewer than {ENOUGH} demonstrations, {}",
                    both(spatial, planar),
                    if factor == 1.0 {
                        "that minimum"
                    } else {
                        "twice that minimum"
                    }
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

/// Returns all checks as a Markdown table, for the documentation.
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
    fn checks_are_sorted_by_unique_code_and_complete() {
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
