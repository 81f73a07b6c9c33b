//! How checks are described. The artifact's table `checks` and the documentation are both generated from the descriptions.

use std::fmt::Write as _;

use crate::finding::Severity;
use crate::list::CHECKS;
use re4_task::Domain;

/// A check: one kind of finding with one threshold.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Check {
    /// Code of its findings; also the name of the setting in `[audit]` that replaces its threshold.
    pub code: &'static str,
    /// Severity of its findings.
    pub severity: Severity,
    /// The demonstrations that it applies to.
    pub applies: Applies,
    /// What it needs of a dataset of the task `arm`. Other datasets have everything that their checks need.
    pub needs: &'static [Need],
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
    /// Demonstrations of the task `arm`.
    Arm,
}

/// What a check needs.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Need {
    /// The pose of the manipulated object.
    Object,
    /// The motion of the arm: the position of the end effector, or joints.
    Arm,
    /// The position of the end effector.
    Eef,
    /// The orientation of the end effector.
    Orientation,
    /// Actions.
    Actions,
    /// Actions that command a displacement and reach a limit.
    Limits,
    /// A gripper, by its opening or its command, which the rule of segmentation reads.
    Gripper,
    /// The measured opening of the gripper.
    Opening,
    /// The opening of the shut gripper.
    Shut,
    /// A gripper command that is known to move the gripper.
    Command,
    /// Rewards.
    Reward,
    /// Recorded times.
    Times,
    /// Elements of the state with a known role.
    Signals,
}

impl Need {
    /// Why a check is not made on a dataset without it.
    pub fn lacking(self) -> &'static str {
        match self {
            Self::Object => "the dataset has no pose of an object",
            Self::Arm => "the dataset has neither a position of the end effector nor joint positions",
            Self::Eef => "the dataset has no position of the end effector",
            Self::Orientation => "the dataset has no orientation of the end effector",
            Self::Actions => "no elements of the actions are known to command the motion of the arm",
            Self::Limits => "the actions are not displacements with a limit that several frames reach",
            Self::Gripper => "the rule of segmentation does not read a gripper",
            Self::Opening => "the opening of the gripper was not recorded",
            Self::Shut => "the opening of the shut gripper is not known (segment.opening.shut)",
            Self::Command => "no command is known to move the gripper",
            Self::Reward => "the dataset has no rewards",
            Self::Times => "the dataset has no times of frames",
            Self::Signals => "no elements of the state have a known role",
        }
    }

    /// Its name in the documentation.
    pub fn name(self) -> &'static str {
        match self {
            Self::Object => "object pose",
            Self::Arm => "end effector or joints",
            Self::Eef => "end-effector position",
            Self::Orientation => "end-effector orientation",
            Self::Actions => "actions",
            Self::Limits => "actions with limits",
            Self::Gripper => "gripper",
            Self::Opening => "gripper opening",
            Self::Shut => "shut opening",
            Self::Command => "gripper command",
            Self::Reward => "rewards",
            Self::Times => "times",
            Self::Signals => "state",
        }
    }
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
    /// An upper fence of the values measured on the dataset: Q3 + `whisker` (Q3 - Q1), but at least a minimum.
    Fence {
        /// Description of the measured values.
        of: &'static str,
        /// Number of interquartile ranges above the third quartile: 3 for Tukey's outer fence, 1.5 for his inner one, and 1 for
        /// heights of releases, which are bounded: objects are not released higher than they are carried.
        whisker: f64,
        /// Minimum threshold in robosuite's tasks.
        spatial: f64,
        /// Minimum threshold in Push-T.
        planar: f64,
        /// Whether a dataset that is too small for a fence uses the minimum. If false, the check is not made on it.
        small: bool,
        /// The check is not made if the fence is higher than this: no value of a fault would exceed it.
        most: f64,
    },
    /// Tukey's inner fence of shares, on the scale of arcsin(sqrt(share)), on which their variance does not depend on their mean.
    /// It can exceed 1, and then the check is not made.
    Share {
        /// Description of the measured values.
        of: &'static str,
        /// Minimum threshold.
        minimum: f64,
    },
    /// The lower outer fence of the distances to the nearest other demonstration, on a logarithmic scale: Q1 (Q1 / Q3)^3, but at
    /// most Q1 / 2 and at least a minimum.
    Nearest {
        /// Minimum threshold in robosuite's tasks.
        spatial: f64,
        /// Minimum threshold in Push-T.
        planar: f64,
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

/// Number of demonstrations whose nearest other demonstration is searched for the threshold of near-duplicates.
pub(crate) const SAMPLE: usize = 256;

/// Returns the check with this code.
pub(crate) fn find(code: &str) -> Option<&'static Check> {
    CHECKS.iter().find(|check| check.code == code)
}

impl Check {
    /// Whether the check applies to the demonstrations of a kind of task.
    pub fn applies_to(&self, domain: Domain) -> bool {
        match self.applies {
            Applies::Everywhere => true,
            Applies::Gripper => domain != Domain::Plane,
            Applies::Planar => domain == Domain::Plane,
            Applies::Arm => domain == Domain::Arm,
        }
    }

    /// Unit of the measure and of the threshold, for a kind of task; empty if they have none.
    pub fn unit_of(&self, domain: Domain) -> &'static str {
        match domain {
            Domain::Plane => self.planar_unit,
            // Openings are fractions of the travel.
            Domain::Arm if self.needs.contains(&Need::Opening) && self.unit == "m" => "of the travel",
            Domain::Space | Domain::Arm => self.unit,
        }
    }

    /// Describes how the threshold is determined.
    pub fn rule(&self) -> String {
        let both = |spatial: f64, planar: f64| match self.applies {
            Applies::Gripper | Applies::Arm => with_unit(spatial, self.unit),
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
                whisker,
                spatial,
                planar,
                small,
                most,
            } => format!(
                "Q3 + {whisker} (Q3 - Q1) of the {of}, but at least {}; with fewer than {ENOUGH} values, {}{}",
                both(spatial, planar),
                if small { "that minimum" } else { "the check is skipped" },
                if most.is_finite() {
                    format!("; skipped if the fence is above {most}, because no fault would exceed it")
                } else {
                    String::new()
                }
            ),
            Basis::Share { of, minimum } => format!(
                "Q3 + 1.5 (Q3 - Q1) of the {of}, on the scale of arcsin(sqrt(share)), but at least {minimum}; with fewer than {ENOUGH} values, that minimum; skipped if the fence is above 1"
            ),
            Basis::Nearest { spatial, planar } => format!(
                "Q1 (Q1 / Q3)^3, but at most Q1 / 2, of the distances of up to {SAMPLE} demonstrations to their nearest other one, but at least {}; with fewer than {ENOUGH} demonstrations, that minimum",
                both(spatial, planar)
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
        "| code | severity | on | needs | what it means | measure | threshold |\n|---|---|---|---|---|---|---|\n"
            .to_owned();
    for check in CHECKS {
        let on = match check.applies {
            Applies::Everywhere => "all",
            Applies::Gripper => "robosuite, arm",
            Applies::Planar => "Push-T",
            Applies::Arm => "arm",
        };
        let needs: Vec<&str> = check.needs.iter().map(|need| need.name()).collect();
        let _ = writeln!(
            text,
            "| `{}` | {} | {on} | {} | {} | {} | {} |",
            check.code,
            check.severity.as_str(),
            needs.join(", "),
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
