//! Thresholds of the checks, each with its origin.

use std::collections::{BTreeMap, BTreeSet};
use std::f64::consts::FRAC_PI_2;

use nalgebra::Vector3;

use crate::actions::ActionFit;
use crate::checks::{Basis, Check, ENOUGH, Need, find};
use crate::config::AuditConfig;
use crate::copies::{Neighbours, Path};
use crate::list::CHECKS;
use crate::observed::{ThresholdRow, UsualRow};
use re4_task::Domain;

use re4_stats::{median, quantile, robust_deviation, sorted};

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
    const ALL: [Self; 3] = [Self::Data, Self::Setting, Self::Default];

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
    /// How the end effector follows its actions; `None` for Push-T, and if it hardly moves.
    pub response: Option<ActionFit>,
    /// The path of end effector and object.
    pub path: Path,
}

/// How the end effectors of most demonstrations follow their actions.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Usual {
    /// Median lag in frames.
    pub lag: f64,
    /// Median gain in m per step.
    pub gain: f64,
}

impl Usual {
    /// The medians over the demonstrations whose actions explain most of the motion, or why there are none: these demonstrations are
    /// too few, or fewer than half of all.
    fn of(all: &[ActionFit]) -> Result<Self, &'static str> {
        let explained: Vec<&ActionFit> = all.iter().filter(|fit| fit.correlation.powi(2) > 0.5).collect();
        const { assert!(ENOUGH == 8, "the sentence has the number") };
        let few = "fewer than 8 demonstrations have actions that explain most of their motion";
        match (explained.len(), all.len()) {
            (_, 0) => return Err("no actions are known to command the motion, or nothing moves"),
            (count, _) if count < ENOUGH => return Err(few),
            (count, all) if 2 * count <= all => {
                return Err("the actions explain most of the motion in fewer than half of the demonstrations");
            }
            _ => {}
        }
        let lags: Vec<f64> = explained.iter().filter_map(|fit| fit.lag).collect();
        let gains: Vec<f64> = explained.iter().map(|fit| fit.gain).collect();
        match (median(&lags), median(&gains)) {
            (Some(lag), Some(gain)) if gain > 0.0 => Ok(Self { lag, gain }),
            _ => Err("the actions do not explain how the motion changes"),
        }
    }
}

/// What the checks of a dataset depend on besides its demonstrations.
#[derive(Debug, Clone, PartialEq)]
pub struct Dataset {
    /// The kind of its demonstrations.
    pub domain: Domain,
    /// Fingers closer together than this hold nothing, in m, or as a fraction of the travel for an arm without an object.
    pub closed: f64,
    /// What it lacks of what checks need.
    pub lacks: BTreeSet<Need>,
    /// Frames per second, if known.
    pub rate: Option<f64>,
}

impl Dataset {
    /// A dataset that lacks nothing.
    pub fn new(domain: Domain, closed: f64) -> Self {
        Self {
            domain,
            closed,
            lacks: BTreeSet::new(),
            rate: None,
        }
    }

    /// Why a check cannot be made; `None` if the dataset has everything that it needs.
    fn lacks(&self, check: &Check) -> Option<&'static str> {
        let lacking = check.needs.iter().find(|need| self.lacks.contains(need));
        lacking.map(|need| need.lacking())
    }

    /// A constant of a check, in frames of this dataset if it is a duration: durations are those at 20 frames per second.
    fn frames(&self, check: &Check, value: f64) -> f64 {
        let duration = check.unit == "frames" && check.code != "actions_shifted";
        match self.rate {
            Some(rate) if duration => (value * rate / RATE).round().max(1.0),
            _ => value,
        }
    }
}

/// Frames per second of the datasets for which durations are stated.
const RATE: f64 = 20.0;

/// The thresholds of all checks that apply to a dataset, and the dataset's statistics that checks compare with.
#[derive(Debug, Clone, PartialEq)]
pub struct Thresholds {
    domain: Domain,
    by_code: BTreeMap<&'static str, Threshold>,
    /// Median of the final object positions, coordinate by coordinate; `None` without demonstrations.
    pub(crate) usual_end: Option<Vector3<f64>>,
    /// Median of the numbers of frames.
    pub(crate) usual_length: f64,
    /// Robust standard deviation of the numbers of frames, from the median absolute deviation.
    pub(crate) length_deviation: f64,
    /// Whether any demonstration has a reward above 0.
    pub(crate) rewards: bool,
    /// How the end effectors of most demonstrations follow their actions; `None` if that is not clear.
    pub(crate) usual_response: Option<Usual>,
    /// Medians of the largest steps (m) and rotations (rad) of the end effector in one step.
    pub(crate) top_speed: (f64, f64),
    /// Whether absolute actions were recorded.
    pub(crate) recorded_goals: bool,
}

impl Thresholds {
    /// Derives the thresholds from the first pass over all demonstrations. `planar` selects the checks and units of Push-T.
    /// `closed` is the pipeline's `segment.gripper.closed`, in m.
    pub fn derive(observations: &[Observation], config: &AuditConfig, planar: bool, closed: f64) -> Self {
        let domain = if planar { Domain::Plane } else { Domain::Space };
        Self::of(observations, config, &Dataset::new(domain, closed))
    }

    /// Derives the thresholds from the first pass over all demonstrations of a dataset.
    pub fn of(observations: &[Observation], config: &AuditConfig, dataset: &Dataset) -> Self {
        let mut survey = Survey::default();
        let mut neighbours = Neighbours::new(observations.len());
        for observation in observations {
            survey.add(observation);
            neighbours.sample(observation);
        }
        for observation in observations {
            neighbours.compare(observation);
        }
        survey.thresholds(neighbours, config, dataset)
    }

    /// States whether absolute actions were recorded. Otherwise, seams of goals are not reported.
    #[must_use]
    pub fn with_recorded_goals(mut self, recorded: bool) -> Self {
        self.recorded_goals = recorded;
        self
    }

    /// The rows of tables `thresholds` and `usual`.
    pub fn to_rows(&self) -> (Vec<ThresholdRow>, UsualRow) {
        let rows = self.by_code.iter().map(|(code, threshold)| ThresholdRow {
            code: (*code).into(),
            threshold: threshold.value,
            origin: threshold.origin.as_str().into(),
            derivation: threshold.derivation.clone(),
            made: threshold.made,
        });
        let usual = UsualRow {
            last_object: self.usual_end.map(Into::into),
            frames: self.usual_length,
            frames_deviation: self.length_deviation,
            rewards: self.rewards,
            lag: self.usual_response.map(|usual| usual.lag),
            gain: self.usual_response.map(|usual| usual.gain),
            largest_step: self.top_speed.0,
            largest_rotation: self.top_speed.1,
            recorded_goals: self.recorded_goals,
        };
        (rows.collect(), usual)
    }

    /// The thresholds of a dataset in SE(3), from their rows. `None` if a row names no check or no origin of this build.
    pub fn from_rows(rows: Vec<ThresholdRow>, usual: &UsualRow) -> Option<Self> {
        let threshold = |row: ThresholdRow| {
            let origin = Origin::ALL.into_iter().find(|origin| origin.as_str() == &*row.origin)?;
            let threshold = Threshold {
                value: row.threshold,
                origin,
                derivation: row.derivation,
                made: row.made,
            };
            Some((find(&row.code)?.code, threshold))
        };
        Some(Self {
            domain: Domain::Space,
            by_code: rows.into_iter().map(threshold).collect::<Option<_>>()?,
            usual_end: usual.last_object.map(Into::into),
            usual_length: usual.frames,
            length_deviation: usual.frames_deviation,
            rewards: usual.rewards,
            usual_response: usual.lag.zip(usual.gain).map(|(lag, gain)| Usual { lag, gain }),
            top_speed: (usual.largest_step, usual.largest_rotation),
            recorded_goals: usual.recorded_goals,
        })
    }

    /// The kind of the demonstrations.
    pub fn domain(&self) -> Domain {
        self.domain
    }

    /// Whether a check is made.
    pub(crate) fn made(&self, code: &str) -> bool {
        self.by_code.get(code).is_some_and(|threshold| threshold.made)
    }

    /// How most arms follow their actions: the median lag in frames and the median gain. `None` if that is not clear.
    pub fn usual_response(&self) -> Option<Usual> {
        self.usual_response
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

/// What thresholds depend on, of observations that are added one at a time: about 250 bytes of each demonstration.
#[derive(Debug, Default)]
pub struct Survey {
    values: BTreeMap<&'static str, Vec<f64>>,
    ends: Vec<Vector3<f64>>,
    lengths: Vec<f64>,
    rewards: bool,
    responses: Vec<ActionFit>,
}

impl Survey {
    /// Adds a demonstration.
    pub fn add(&mut self, observation: &Observation) {
        for &(code, value) in &observation.values {
            self.values.entry(code).or_default().push(value);
        }
        self.ends.push(observation.last_object);
        self.lengths.push(f64::from(observation.frames));
        self.rewards |= observation.rewarded == Some(true);
        self.responses.extend(observation.response.clone());
    }

    /// Derives the thresholds. The neighbours have been compared with all demonstrations.
    pub fn thresholds(self, neighbours: Neighbours, config: &AuditConfig, dataset: &Dataset) -> Thresholds {
        let Self {
            mut values,
            ends,
            lengths,
            rewards,
            responses,
        } = self;
        let planar = dataset.domain == Domain::Plane;
        let usual_end = usual_end(&ends);
        if let Some(end) = usual_end {
            let distances = ends.iter().map(|last| (last - end).norm());
            values.entry("early_release").or_default().extend(distances);
        }
        let usual_response = Usual::of(&responses);
        if let Ok(usual) = usual_response {
            for (code, value) in responses.iter().flat_map(|fit| fit.values(&usual)) {
                values.entry(code).or_default().push(value);
            }
        }
        values.insert("near_duplicate", neighbours.distances());
        let middle = |code| values.get(code).and_then(|values| median(values)).unwrap_or_default();
        let top_speed = (middle("discontinuity_eef"), middle("discontinuity_rotation"));
        let length_deviation = robust_deviation(&lengths).unwrap_or(0.0);
        // Checks whose measure does not exist in this dataset.
        let unmeasured = |check: &Check| match check.code {
            _ if dataset.lacks(check).is_some() => dataset.lacks(check),
            "ends_before_success" | "success_lost" if !planar && !rewards => {
                Some("no demonstration has a reward above 0")
            }
            "outlier_length" if length_deviation == 0.0 => Some("most demonstrations have the same number of frames"),
            "reversed" | "actions_opposed" | "actions_scaled" | "actions_shifted" | "actions_unrelated" => {
                usual_response.err()
            }
            _ => None,
        };
        let by_code = CHECKS
            .iter()
            .filter(|check| check.applies_to(dataset.domain))
            .map(|check| {
                let observed = values.get(check.code).map_or(&[] as &[f64], Vec::as_slice);
                let threshold = match (config.threshold(check.code), unmeasured(check)) {
                    (_, Some(why)) if dataset.lacks(check).is_some() => not_made(why),
                    (Some(value), _) => set(check, value),
                    (None, Some(why)) => not_made(why),
                    (None, None) => derive(check, observed, dataset),
                };
                (check.code, threshold)
            })
            .collect();
        Thresholds {
            domain: dataset.domain,
            by_code,
            usual_end,
            usual_length: median(&lengths).unwrap_or(0.0),
            length_deviation,
            rewards,
            usual_response: usual_response.ok(),
            top_speed,
            recorded_goals: true,
        }
    }
}

/// Returns the median of the final object positions, coordinate by coordinate.
fn usual_end(ends: &[Vector3<f64>]) -> Option<Vector3<f64>> {
    let coordinate = |axis: usize| median(&ends.iter().map(|end| end[axis]).collect::<Vec<_>>());
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

fn constant(value: Option<f64>, derivation: String) -> Threshold {
    Threshold {
        value,
        origin: Origin::Default,
        derivation,
        made: true,
    }
}

fn data(value: f64, derivation: String) -> Threshold {
    Threshold {
        value: Some(value),
        origin: Origin::Data,
        derivation,
        made: true,
    }
}

fn not_made(why: &str) -> Threshold {
    Threshold {
        value: None,
        origin: Origin::Data,
        derivation: format!("not made: {why}"),
        made: false,
    }
}

fn too_few(minimum: f64, count: usize, of: &str) -> Threshold {
    let why = format!("the minimum; {count} {of} are too few to derive a threshold");
    constant(Some(minimum), why)
}

fn derive(check: &Check, observed: &[f64], dataset: &Dataset) -> Threshold {
    let pick = |spatial, flat| match dataset.domain {
        Domain::Plane => flat,
        Domain::Space => spatial,
        Domain::Arm => dataset.frames(check, spatial),
    };
    let closed = dataset.closed;
    // Without an object, the fingers alone show that it is lost: they shut.
    let basis = match check.code {
        "lost_grasp" if dataset.domain == Domain::Arm => Basis::ClosedFingers,
        _ => check.basis,
    };
    match basis {
        Basis::Nothing => constant(None, "the check has no threshold".to_owned()),
        Basis::Constant {
            spatial,
            planar: flat,
            why,
        } => constant(Some(pick(spatial, flat)), why.to_owned()),
        Basis::ClosedFingers => Threshold {
            value: Some(closed),
            origin: if dataset.domain == Domain::Arm || closed == re4_segment::GripperConfig::default().closed {
                Origin::Default
            } else {
                Origin::Setting
            },
            derivation: match dataset.domain {
                Domain::Arm => "the paper's value for a failed grasp as a fraction of the simulated gripper's opening",
                Domain::Plane | Domain::Space => {
                    "segment.gripper.closed, by default the paper's value for a failed grasp"
                }
            }
            .to_owned(),
            made: true,
        },
        Basis::Fence {
            of,
            whisker,
            spatial,
            planar: flat,
            small,
            most,
        } => {
            let (minimum, count) = (pick(spatial, flat), observed.len());
            let rule = format!("Q3 + {whisker} (Q3 - Q1) of {count} {of}");
            match fence(observed, whisker).filter(|_| count >= ENOUGH) {
                Some(fence) if fence > most => not_made(&format!("{rule} is {fence:.4}, which no fault would exceed")),
                Some(fence) if fence > minimum => data(fence, rule),
                Some(fence) => constant(Some(minimum), format!("the minimum; {rule} is only {fence:.4}")),
                None if small => too_few(minimum, count, of),
                None => not_made(&format!("{count} {of} are too few to derive a threshold")),
            }
        }
        Basis::Share { of, minimum } => of_shares(observed, of, minimum),
        Basis::Nearest { spatial, planar: flat } => of_nearest(observed, pick(spatial, flat)),
        Basis::Multiple {
            of,
            factor,
            spatial,
            planar: flat,
        } => of_median(observed, of, factor, pick(spatial, flat)),
    }
}

/// The threshold of [`Basis::Share`].
fn of_shares(observed: &[f64], of: &str, minimum: f64) -> Threshold {
    let count = observed.len();
    let angles = observed.iter().map(|share| share.clamp(0.0, 1.0).sqrt().asin());
    let rule = format!("Q3 + 1.5 (Q3 - Q1), on the scale of arcsin(sqrt(share)), of {count} {of}");
    let fence = fence(&angles.collect::<Vec<_>>(), 1.5).filter(|_| count >= ENOUGH);
    match fence {
        Some(fence) if fence >= FRAC_PI_2 => not_made(&format!("{rule} is above 1, so that no value exceeds it")),
        Some(fence) if fence.sin().powi(2) > minimum => data(fence.sin().powi(2), rule),
        Some(_) => constant(Some(minimum), format!("the minimum; {rule} is less")),
        None => too_few(minimum, count, of),
    }
}

/// The threshold of [`Basis::Nearest`].
fn of_nearest(observed: &[f64], minimum: f64) -> Threshold {
    let count = observed.len();
    let values = sorted(observed.iter().copied());
    let quartiles = quantile(&values, 0.25).zip(quantile(&values, 0.75));
    let of = "distances to the nearest other demonstration";
    let rule = format!("Q1 (Q1 / Q3)^3, but at most Q1 / 2, of {count} {of}");
    // Scenes on a regular grid have equal distances, which are no copies.
    let fence = quartiles.map(|(low, high)| low * (low / high).powi(3).min(0.5));
    match fence.filter(|_| count >= ENOUGH) {
        Some(fence) if fence > minimum => data(fence, rule),
        Some(_) => constant(Some(minimum), format!("the minimum; {rule} is less")),
        None => too_few(minimum, count, of),
    }
}

/// The threshold of [`Basis::Multiple`].
fn of_median(observed: &[f64], of: &str, factor: f64, minimum: f64) -> Threshold {
    let count = observed.len();
    let rule = format!("{factor} times the median of {count} {of}");
    match median(observed).filter(|_| count >= ENOUGH) {
        Some(middle) if factor * middle > minimum => data(factor * middle, rule),
        Some(middle) => constant(
            Some(minimum),
            format!("the minimum; {rule} is only {:.4}", factor * middle),
        ),
        None if factor == 1.0 => too_few(minimum, count, of),
        None => constant(
            Some(2.0 * minimum),
            format!("twice the minimum; {count} {of} are too few to derive a threshold"),
        ),
    }
}

/// Q3 + `whisker` (Q3 - Q1). `None` if there are no values or one is NaN.
fn fence(values: &[f64], whisker: f64) -> Option<f64> {
    let values = sorted(values.iter().copied());
    let (low, high) = (quantile(&values, 0.25)?, quantile(&values, 0.75)?);
    Some(high + whisker * (high - low))
}
