//! Thresholds, each with where it comes from.

use std::collections::BTreeMap;

use nalgebra::Vector3;

use crate::checks::{Basis, CHECKS, Check, ENOUGH};
use crate::config::AuditConfig;
use re4_stats::{median, outer_fence, robust_deviation};

/// Where a threshold comes from.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Origin {
    /// Derived from this dataset.
    Data,
    /// Set in the pipeline file.
    Setting,
    /// Built in.
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

/// A threshold of one check on one dataset.
#[derive(Debug, Clone, PartialEq)]
pub struct Threshold {
    /// What is compared with; none where there is nothing to compare with, or where the check is not made.
    pub value: Option<f64>,
    /// Where it comes from.
    pub origin: Origin,
    /// How it came about, in words.
    pub derivation: String,
    /// Whether the check is made.
    pub made: bool,
}

/// What a first look at one demonstration gives: what thresholds are derived from.
#[derive(Debug, Clone, PartialEq)]
pub struct Observation {
    /// Number of the demonstration in the artifact, from 0.
    pub episode: u32,
    /// Its name in its source.
    pub demo: String,
    /// Its frames.
    pub frames: u32,
    /// Values by the code of the check that they serve.
    pub values: Vec<(&'static str, f64)>,
    /// Where the object is at the last frame, world frame.
    pub last_object: Vector3<f64>,
    /// Whether a reward above 0 was recorded; none where no reward was.
    pub rewarded: Option<bool>,
    /// Hash of all poses, fingers and actions.
    pub recording: [u8; 32],
    /// Hash of all actions.
    pub actions: [u8; 32],
}

/// The thresholds of all checks that apply to a dataset, and what else is compared with.
#[derive(Debug, Clone, PartialEq)]
pub struct Thresholds {
    planar: bool,
    by_code: BTreeMap<&'static str, Threshold>,
    /// Median of the demonstrations' last object positions, coordinate by coordinate.
    pub(crate) usual_end: Option<Vector3<f64>>,
    /// Median of the numbers of frames.
    pub(crate) usual_length: f64,
    /// Their robust standard deviation.
    pub(crate) length_deviation: f64,
    /// Whether any demonstration has a reward.
    pub(crate) rewards: bool,
}

impl Thresholds {
    /// Thresholds from the first look at all demonstrations. `closed` is the pipeline's `segment.gripper.closed`.
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

    /// The checks that apply, with their thresholds, in the order of their codes.
    pub fn iter(&self) -> impl Iterator<Item = (&'static Check, &Threshold)> {
        CHECKS
            .iter()
            .filter_map(|check| Some((check, self.by_code.get(check.code)?)))
    }

    /// What a check compares with; infinity where it is not made, so that nothing exceeds it.
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

/// The median of the last object positions, coordinate by coordinate.
fn usual_end(observations: &[Observation]) -> Option<Vector3<f64>> {
    let coordinate = |axis: usize| median(&observations.iter().map(|o| o.last_object[axis]).collect::<Vec<_>>());
    Some(Vector3::new(coordinate(0)?, coordinate(1)?, coordinate(2)?))
}

fn set(check: &Check, value: f64) -> Threshold {
    Threshold {
        value: Some(value),
        origin: Origin::Setting,
        derivation: format!("audit.{} of the pipeline file", check.code),
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
        Basis::Nothing => constant(None, "nothing to compare with".to_owned()),
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
            derivation: "segment.gripper.closed, the paper's figure for a failed grasp by default".to_owned(),
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
                    format!("the minimum, above Q3 + 3 (Q3 - Q1) = {fence:.4} of {count} {of}"),
                ),
                None if small => constant(Some(minimum), format!("{count} {of} are too few to derive it from")),
                None => Threshold {
                    value: None,
                    origin: Origin::Data,
                    derivation: format!("not made: {count} {of} are too few to derive a threshold from"),
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
                        "the minimum; {factor} times the median of {count} {of} is {:.4}",
                        factor * middle
                    ),
                ),
                None => {
                    let wide = if factor == 1.0 { minimum } else { 2.0 * minimum };
                    constant(Some(wide), format!("{count} {of} are too few to derive it from"))
                }
            }
        }
    }
}
