//! Thresholds of the checks, each with its origin.

use std::collections::BTreeMap;

use nalgebra::Vector3;

use crate::checks::{Basis, CHECKS, Check, ENOUGH};
use crate::config::AuditConfig;
use re4_stats::{median, outer_fence, robust_deviation};

/// The origin of a threshold.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Origin {
    /// Derived from the dataset.
    Data,
    /// Set in the pipeline file.
    Setting,
    /// A built-in default.
    Default,
}

impl Origin {
    /// The word used in tables.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Data => "data",
            Self::Setting => "setting",
            Self::Default => "default",
        }
    }
}

/// The threshold of one check on one dataset.
#[derive(Debug, Clone, PartialEq)]
pub struct Threshold {
    /// The threshold, in the unit of the check; `None` if the check has no threshold or is not made.
    pub value: Option<f64>,
    /// The origin of the threshold.
    pub origin: Origin,
    /// Describes how the threshold was determined.
    pub derivation: String,
    /// Whether the check is made. A check is not made if its threshold cannot be derived from so few values.
    pub made: bool,
}

/// The measurements of the first pass over one demonstration. [`Thresholds::derive`] derives thresholds from them.
#[derive(Debug, Clone, PartialEq)]
pub struct Observation {
    /// Number of the demonstration in the artifact, from 0.
    pub episode: u32,
    /// Name of the demonstration in its source.
    pub demo: String,
    /// Number of frames.
    pub frames: u32,
    /// Measured values, each with the code of the check whose threshold is derived from it.
    pub values: Vec<(&'static str, f64)>,
    /// Position of the object at the last frame, world frame, m; for Push-T its planar pose (x, y in px, theta in rad).
    pub last_object: Vector3<f64>,
    /// Whether a reward above 0 was recorded; `None` if no rewards were recorded.
    pub rewarded: Option<bool>,
    /// Hash of all poses, finger positions and actions.
    pub recording: [u8; 32],
    /// Hash of all actions.
    pub actions: [u8; 32],
}

/// The thresholds of all checks that apply to a dataset, and the dataset's statistics that checks compare with.
#[derive(Debug, Clone, PartialEq)]
pub struct Thresholds {
    planar: bool,
    by_code: BTreeMap<&'static str, Threshold>,
    /// Median of the final object positions, coordinate by coordinate; `None` without demonstrations.
    pub(crate) usual_end: Option<Vector3<f64>>,
    /// Median of the numbers of frames.
    pub(crate) usual_length: f64,
    /// Robust standard deviation of the numbers of frames, from the median absolute deviation.
    pub(crate) length_deviation: f64,
    /// Whether any demonstration has a reward above 0.
    pub(crate) rewards: bool,
}

impl Thresholds {
    /// Derives the thresholds from the first pass over all demonstrations. `planar` selects the checks and units of Push-T.
    /// `closed` is the pipeline's `segment.gripper.closed`, in m.
    pub fn derive(observations: &[Observation], config: &AuditConfig, planar: bool, closed: f64) -> Self {
        let usual_end = usual_end(observations);
        let mut values: BTreeMap<&'static str, Vec<f64>> = BTreeMap::new();
        for observation in observations {
            for &(code, value) in &observation.values {
                values.entry(code).or_default().push(value);
            }
            if let Some(end) = usual_end {
                let distance = (observation.last_object - end).norm();
                values.entry("early_release").or_default().push(distance);
            }
        }
        let lengths: Vec<f64> = observations.iter().map(|o| f64::from(o.frames)).collect();
        let by_code = CHECKS
            .iter()
            .filter(|check| check.applies_to(planar))
            .map(|check| {
                let observed = values.get(check.code).map_or(&[] as &[f64], Vec::as_slice);
                let threshold = config
                    .threshold(check.code)
                    .map_or_else(|| derive(check, observed, planar, closed), |value| set(check, value));
                (check.code, threshold)
            })
            .collect();
        Self {
            planar,
            by_code,
            usual_end,
            usual_length: median(&lengths).unwrap_or(0.0),
            length_deviation: robust_deviation(&lengths).unwrap_or(0.0),
            rewards: observations.iter().any(|o| o.rewarded == Some(true)),
        }
    }

    /// Whether the dataset is planar.
    pub fn planar(&self) -> bool {
        self.planar
    }

    /// Iterates over the checks that apply and their thresholds, sorted by code.
    pub fn iter(&self) -> impl Iterator<Item = (&'static Check, &Threshold)> {
        CHECKS
            .iter()
            .filter_map(|check| Some((check, self.by_code.get(check.code)?)))
    }

    /// Returns the threshold of a check; infinity if it has none or is not made, so that no value exceeds it.
    pub(crate) fn over(&self, code: &str) -> f64 {
        self.by_code
            .get(code)
            .and_then(|threshold| threshold.value)
            .unwrap_or(f64::INFINITY)
    }

    pub(crate) fn value(&self, code: &str) -> Option<f64> {
        self.by_code.get(code)?.value
    }
}

/// Returns the median of the final object positions, coordinate by coordinate.
fn usual_end(observations: &[Observation]) -> Option<Vector3<f64>> {
    let coordinate = |axis: usize| median(&observations.iter().map(|o| o.last_object[axis]).collect::<Vec<_>>());
    Some(Vector3::new(coordinate(0)?, coordinate(1)?, coordinate(2)?))
}

fn set(check: &Check, value: f64) -> Threshold {
    Threshold {
        value: Some(value),
        origin: Origin::Setting,
        derivation: format!("set by audit.{} in the pipeline file", check.code),
        made: true,
    }
}

fn derive(check: &Check, observed: &[f64], planar: bool, closed: f64) -> Threshold {
    let constant = |value: Option<f64>, derivation: String| Threshold {
        value,
        origin: Origin::Default,
        derivation,
        made: true,
    };
    let data = |value: f64, derivation: String| Threshold {
        value: Some(value),
        origin: Origin::Data,
        derivation,
        made: true,
    };
    let count = observed.len();
    let pick = |spatial, flat| if planar { flat } else { spatial };
    match check.basis {
        Basis::Nothing => constant(None, "the check has no threshold".to_owned()),
        Basis::Constant {
            spatial,
            planar: flat,
            why,
        } => constant(Some(pick(spatial, flat)), why.to_owned()),
        Basis::ClosedFingers => Threshold {
            value: Some(closed),
            origin: if closed == re4_segment::GripperConfig::default().closed {
                Origin::Default
            } else {
                Origin::Setting
            },
            derivation: "segment.gripper.closed, by default the paper's value for a failed grasp".to_owned(),
            made: true,
        },
        Basis::Fence {
            of,
            spatial,
            planar: flat,
            small,
        } => {
            let minimum = pick(spatial, flat);
            match outer_fence(observed).filter(|_| count >= ENOUGH) {
                Some(fence) if fence > minimum => data(fence, format!("Q3 + 3 (Q3 - Q1) of {count} {of}")),
                Some(fence) => constant(
                    Some(minimum),
                    format!("the minimum; Q3 + 3 (Q3 - Q1) of {count} {of} is only {fence:.4}"),
                ),
                None if small => constant(
                    Some(minimum),
                    format!("the minimum; {count} {of} are too few to derive a threshold"),
                ),
                None => Threshold {
                    value: None,
                    origin: Origin::Data,
                    derivation: format!("not made: {count} {of} are too few to derive a threshold"),
                    made: false,
                },
            }
        }
        Basis::Multiple {
            of,
            factor,
            spatial,
            planar: flat,
        } => {
            let minimum = pick(spatial, flat);
            match median(observed).filter(|_| count >= ENOUGH) {
                Some(middle) if factor * middle > minimum => {
                    data(factor * middle, format!("{factor} times the median of {count} {of}"))
                }
                Some(middle) => constant(
                    Some(minimum),
                    format!(
                        "the minimum; {factor} times the median of {count} {of} is only {:.4}",
                        factor * middle
                    ),
                ),
                None if factor == 1.0 => constant(
                    Some(minimum),
                    format!("the minimum; {count} {of} are too few to derive a threshold"),
                ),
                None => constant(
                    Some(2.0 * minimum),
                    format!("twice the minimum; {count} {of} are too few to derive a threshold"),
                ),
            }
        }
    }
}
