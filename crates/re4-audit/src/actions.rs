//! The relation between the actions of a demonstration and the motion of its end effector: lag, gain and sign.

use nalgebra::Vector3;
use re4_episode::SpatialFrame;

use crate::common::Sink;
use crate::rows::{Rows, norm};
use crate::runs::runs;
use crate::thresholds::Usual;

/// Lags, in frames, at which steps are compared with actions: from -LAGS to LAGS.
const LAGS: isize = 4;

/// Minimum number of steps, and minimum length of their path in m (of joints: in ranges of the dataset), from which lag and gain are
/// measured.
const MINIMUM_STEPS: usize = 20;
const MINIMUM_PATH: f64 = 0.05;

/// A step longer than this multiple of the demonstration's 90th percentile is a jump, not a response to an action.
const JUMP: f64 = 2.0;

/// Minimum fraction of the motion along an axis for judging its sign.
const MINIMUM_PART: f64 = 0.05;

/// How the end effector's steps follow the translation of the actions.
#[derive(Debug, Clone, PartialEq)]
pub struct ActionFit {
    /// Lag of the largest correlation between changes of steps and changes of actions in frames, between whole frames by a
    /// parabola; 0 if step t follows action t at once. Changes have a sharper correlation than the smooth steps themselves. `None`
    /// if the actions explain less than a quarter of the changes.
    pub lag: Option<f64>,
    /// Metres of motion per step for an action of 1, at the whole lag of the largest correlation of steps and actions.
    pub gain: f64,
    /// Correlation of steps and actions at that lag, with its sign.
    pub correlation: f64,
    /// Correlation along each axis at lag 1, to which responses of a step or less contribute; `None` for an axis without motion.
    axes: Vec<Option<f64>>,
}

impl ActionFit {
    /// A response that was measured before. Its axes are not known; thresholds do not depend on them.
    pub(crate) fn known(lag: Option<f64>, gain: f64, correlation: f64) -> Self {
        let axes = Vec::new();
        Self {
            lag,
            gain,
            correlation,
            axes,
        }
    }

    /// Measures the response of a demonstration with a gripper; see [`ActionFit::between`].
    pub(crate) fn of(frames: &[SpatialFrame]) -> Option<Self> {
        let positions = frames
            .iter()
            .flat_map(|frame| <[f64; 3]>::from(frame.eef.translation.vector));
        let actions = frames.iter().flat_map(|frame| frame.delta[..3].iter().copied());
        Self::between(&Rows::new(3, positions).steps(), &Rows::new(3, actions))
    }

    /// Measures how the steps of an arm follow its actions; `None` if it hardly moves. Steps that are exactly 0 or much longer than
    /// the others do not count: they are faults of the recording.
    pub(crate) fn between(steps: &Rows, actions: &Rows) -> Option<Self> {
        let norms: Vec<f64> = steps.iter().map(norm).collect();
        let lengths = re4_stats::sorted(norms.iter().copied());
        let longest = JUMP * re4_stats::quantile(&lengths, 0.9)?;
        let valid: Vec<bool> = norms.iter().map(|&step| step > 0.0 && step <= longest).collect();
        let counted = || {
            norms
                .iter()
                .zip(&valid)
                .filter(|(_, valid)| **valid)
                .map(|(norm, _)| norm)
        };
        let path: f64 = counted().sum();
        if counted().count() < MINIMUM_STEPS || path < MINIMUM_PATH {
            return None;
        }
        let plain = Lagged::of(steps, actions, &valid);
        let both_valid: Vec<bool> = valid.windows(2).map(|pair| pair[0] && pair[1]).collect();
        let changed = Lagged::of(&steps.steps(), &actions.steps(), &both_valid);
        let (best, sharpest) = (plain.best()?, changed.best()?);
        let one = plain.0.get((LAGS + 1) as usize)?;
        Some(Self {
            lag: (changed.correlation(sharpest).powi(2) >= EXPLAINED).then(|| changed.fine(sharpest)),
            gain: plain.0[best].gain(),
            correlation: plain.correlation(best),
            axes: (0..steps.width()).map(|axis| one.axis(axis)).collect(),
        })
    }

    /// The values from which thresholds are derived.
    pub(crate) fn values(&self, usual: &Usual) -> impl Iterator<Item = (&'static str, f64)> + use<> {
        let shift = self.lag.map(|lag| ("actions_shifted", (lag - usual.lag).abs()));
        let others = [
            ("actions_scaled", self.scale(usual).ln().abs()),
            ("actions_unrelated", 1.0 - self.correlation.powi(2)),
        ];
        shift.into_iter().chain(others)
    }

    /// Ratio of the gain to the usual one, without the sign.
    fn scale(&self, usual: &Usual) -> f64 {
        (self.gain / usual.gain).abs().max(1e-9)
    }
}

/// Minimum fraction of the changes that the actions explain for measuring the lag.
const EXPLAINED: f64 = 0.25;

/// The sums at every lag from -LAGS to LAGS.
struct Lagged(Vec<Sums>);

impl Lagged {
    fn of(steps: &Rows, actions: &Rows, valid: &[bool]) -> Self {
        let at = |lag: isize| {
            let mut sums = Sums::new(steps.width());
            for (place, (step, _)) in steps.iter().zip(valid).enumerate().filter(|(_, (_, valid))| **valid) {
                let action = place.checked_add_signed(-lag).and_then(|place| actions.get(place));
                if let Some(action) = action {
                    sums.add(step, action);
                }
            }
            sums
        };
        Self((-LAGS..=LAGS).map(at).collect())
    }

    fn correlation(&self, place: usize) -> f64 {
        self.0.get(place).map_or(0.0, Sums::correlation)
    }

    /// Place of the largest correlation of either sign.
    fn best(&self) -> Option<usize> {
        (0..self.0.len()).max_by(|&a, &b| self.correlation(a).abs().total_cmp(&self.correlation(b).abs()))
    }

    /// The lag of the maximum of a parabola through the largest correlation and its neighbours.
    fn fine(&self, best: usize) -> f64 {
        let at = |place: usize| self.correlation(place).abs();
        let part = if best == 0 || best + 1 == self.0.len() {
            0.0
        } else {
            let (before, here, after) = (at(best - 1), at(best), at(best + 1));
            let curvature = before - 2.0 * here + after;
            if curvature < 0.0 {
                0.5 * (before - after) / curvature
            } else {
                0.0
            }
        };
        best as f64 - LAGS as f64 + part
    }
}

/// Sums over the pairs of steps and actions at one lag, axis by axis.
#[derive(Debug, Clone)]
struct Sums {
    steps: Vec<f64>,
    actions: Vec<f64>,
    both: Vec<f64>,
}

impl Sums {
    fn new(width: usize) -> Self {
        let zeros = || vec![0.0; width];
        Self {
            steps: zeros(),
            actions: zeros(),
            both: zeros(),
        }
    }

    fn add(&mut self, step: &[f64], action: &[f64]) {
        for (axis, (step, action)) in step.iter().zip(action).enumerate() {
            self.steps[axis] += step * step;
            self.actions[axis] += action * action;
            self.both[axis] += step * action;
        }
    }

    fn correlation(&self) -> f64 {
        let total = |sums: &[f64]| sums.iter().sum::<f64>();
        let scale = (total(&self.steps) * total(&self.actions)).sqrt();
        if scale > 0.0 { total(&self.both) / scale } else { 0.0 }
    }

    fn gain(&self) -> f64 {
        let actions: f64 = self.actions.iter().sum();
        if actions > 0.0 {
            self.both.iter().sum::<f64>() / actions
        } else {
            0.0
        }
    }

    fn axis(&self, axis: usize) -> Option<f64> {
        let all: f64 = self.steps.iter().sum();
        let scale = (self.steps[axis] * self.actions[axis]).sqrt();
        (self.steps[axis] > MINIMUM_PART * all && scale > 0.0).then(|| self.both[axis] / scale)
    }
}

/// The fraction of the fingers' travel that goes against the last gripper command; `None` if the fingers travel by less than `least`.
pub(crate) fn against_command(separation: &[f64], closes: &[bool], least: f64) -> Option<f64> {
    let (mut against, mut all) = (0.0, 0.0);
    let steps = separation.iter().skip(1).zip(separation.iter().skip(2));
    for ((now, next), commands) in steps.zip(closes.windows(2)) {
        let change = next - now;
        // The first step after a change of the command still has the old direction.
        if commands[0] != commands[1] {
            continue;
        }
        all += change.abs();
        if (change > 0.0) == commands[1] {
            against += change.abs();
        }
    }
    (all >= least).then(|| against / all)
}

/// Smallest travel of the fingers, in m, from which the sign of their command is judged: a quarter of the opening.
pub(crate) const LEAST_TRAVEL: f64 = 0.02;

/// What the actions of a demonstration are compared with.
pub(crate) struct Response<'a> {
    pub(crate) frames: usize,
    pub(crate) fit: Option<&'a ActionFit>,
    /// The fraction of the fingers' travel that goes against the command.
    pub(crate) against: Option<f64>,
    /// What moves, as the subject of a sentence.
    pub(crate) arm: &'static str,
    /// Names of the axes of steps and actions.
    pub(crate) axes: &'a [&'a str],
}

/// Compares the actions with the motion, and both with those of the other demonstrations.
pub(crate) fn check_actions_and_motion(response: &Response<'_>, sink: &mut Sink<'_>) {
    let Response { fit, arm, .. } = *response;
    let all = 0..response.frames;
    let mut reversed = false;
    if let (Some(fit), Some(usual)) = (fit, sink.thresholds.usual_response) {
        // If the rows are reversed, the step that followed an action by `lag` precedes it by one more.
        let backwards = |lag: f64| (lag + 1.0 + usual.lag).abs() < (lag - usual.lag).abs();
        reversed = fit.lag.is_some_and(backwards) && -fit.correlation > sink.thresholds.over("reversed");
        let opposed = |axis: &usize| fit.axes[*axis].is_some_and(|c| -c > sink.thresholds.over("actions_opposed"));
        let axes: Vec<usize> = (0..fit.axes.len()).filter(opposed).collect();
        if reversed {
            sink.add(
                "reversed",
                all.clone(),
                Some(-fit.correlation),
                format!(
                    "the motion precedes the actions by {:.1} frames and is opposite to them",
                    -fit.lag.unwrap_or_default()
                ),
            );
        } else if let Some(&axis) = axes.first() {
            let name = |axis: &usize| response.axes.get(*axis).copied().unwrap_or_default();
            let names: Vec<&str> = axes.iter().map(name).collect();
            sink.add(
                "actions_opposed",
                all.clone(),
                fit.axes[axis].map(|correlation| -correlation),
                format!("along {}, {arm} moves opposite to its actions", names.join(" and ")),
            );
        } else {
            let unrelated = 1.0 - fit.correlation.powi(2) > sink.thresholds.over("actions_unrelated");
            // Lag and gain mean nothing if the actions do not explain the motion.
            let meaningful = |code: &str| !unrelated || code == "actions_unrelated";
            for (code, value) in fit.values(&usual).filter(|(code, _)| meaningful(code)) {
                sink.exceeding(code, all.clone(), value, |value| match code {
                    "actions_shifted" => format!(
                        "{arm} follows changes of its actions after {:.2} frames; the median of the demonstrations is {:.2}",
                        fit.lag.unwrap_or_default(),
                        usual.lag
                    ),
                    "actions_scaled" => format!(
                        "{arm} moves {:.2} times as far for the same action as in the other demonstrations",
                        fit.scale(&usual)
                    ),
                    _ => format!("the actions do not explain {:.0} % of the end effector's motion", 1e2 * value),
                });
            }
        }
    }
    if let Some(against) = response.against.filter(|_| !reversed) {
        sink.exceeding("gripper_reversed", all, against, |value| {
            format!(
                "{:.0} % of the fingers' travel goes against the gripper command",
                1e2 * value
            )
        });
    }
}

/// The fraction of the frames in which at least `least` controls of the arm are at their limits.
pub(crate) fn saturated_fraction(frames: &[SpatialFrame], least: usize) -> f64 {
    let at_limit = |frame: &&SpatialFrame| frame.delta.iter().filter(|part| part.abs() >= LIMIT).count() >= least;
    frames.iter().filter(at_limit).count() as f64 / frames.len().max(1) as f64
}

/// A control of at least this magnitude is at its limit, which is 1. The margin allows for rounding in the recording.
const LIMIT: f64 = 1.0 - 1e-9;

/// An arm that is commanded to translate and to rotate by less than this fraction of its limits is idle: it moves by less than
/// 0.7 mm per step.
const IDLE: f64 = 0.05;

pub(crate) fn is_idle(frame: &SpatialFrame) -> bool {
    let [x, y, z, rx, ry, rz] = frame.delta;
    Vector3::new(x, y, z).norm() < IDLE && Vector3::new(rx, ry, rz).norm() < IDLE
}

/// Reports idle stretches, and fractions of the frames with one control and with two controls at their limits.
pub(crate) fn check_commands(idle: &[bool], saturated: [f64; 2], sink: &mut Sink<'_>) {
    for run in runs(idle.iter().copied(), 1) {
        sink.exceeding("idle", run.clone(), run.len() as f64, |value| {
            format!("hardly any arm action in {value} consecutive frames")
        });
    }
    for (code, fraction, what) in [
        ("saturated", saturated[0], "a control is at its limit"),
        (
            "saturated_together",
            saturated[1],
            "two or more controls are at their limits",
        ),
    ] {
        sink.exceeding(code, 0..idle.len(), fraction, |value| {
            format!("{what} in {:.0} % of the frames", 1e2 * value)
        });
    }
}
