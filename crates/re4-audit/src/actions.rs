//! The relation between the actions of a demonstration and the motion of its end effector: lag, gain and sign.

use nalgebra::Vector3;
use re4_episode::SpatialFrame;

use crate::common::Sink;
use crate::runs::runs;
use crate::thresholds::Usual;

/// Lags, in frames, at which steps are compared with actions: from -LAGS to LAGS.
const LAGS: isize = 4;

/// Minimum number of steps, and minimum length of their path in m, from which lag and gain are measured.
const MINIMUM_STEPS: usize = 20;
const MINIMUM_PATH: f64 = 0.05;

/// A step longer than this multiple of the demonstration's 90th percentile is a jump, not a response to an action.
const JUMP: f64 = 2.0;

/// Minimum fraction of the motion along an axis for judging its sign.
const MINIMUM_PART: f64 = 0.05;

/// How the end effector's steps follow the translation of the actions.
#[derive(Debug, Clone, Copy, PartialEq)]
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
    axes: [Option<f64>; 3],
}

impl ActionFit {
    /// Measures the response of a demonstration; `None` if the end effector hardly moves. Steps that are exactly 0 or much longer
    /// than the others do not count: they are faults of the recorded poses.
    pub(crate) fn of(frames: &[SpatialFrame]) -> Option<Self> {
        let steps: Vec<Vector3<f64>> = frames
            .iter()
            .zip(frames.iter().skip(1))
            .map(|(now, next)| next.eef.translation.vector - now.eef.translation.vector)
            .collect();
        let lengths = re4_stats::sorted(steps.iter().map(Vector3::norm));
        let longest = JUMP * re4_stats::quantile(&lengths, 0.9)?;
        let counted = |step: &Vector3<f64>| step.norm() > 0.0 && step.norm() <= longest;
        let path: f64 = steps.iter().filter(|step| counted(step)).map(Vector3::norm).sum();
        if steps.iter().filter(|step| counted(step)).count() < MINIMUM_STEPS || path < MINIMUM_PATH {
            return None;
        }
        let actions: Vec<Vector3<f64>> = frames
            .iter()
            .map(|frame| Vector3::from_column_slice(&frame.delta[..3]))
            .collect();
        let valid: Vec<bool> = steps.iter().map(counted).collect();
        let plain = Lagged::of(&steps, &actions, &valid);
        let changes = |values: &[Vector3<f64>]| values.windows(2).map(|pair| pair[1] - pair[0]).collect::<Vec<_>>();
        let both_valid: Vec<bool> = valid.windows(2).map(|pair| pair[0] && pair[1]).collect();
        let changed = Lagged::of(&changes(&steps), &changes(&actions), &both_valid);
        let (best, sharpest) = (plain.best()?, changed.best()?);
        let one = plain.0.get((LAGS + 1) as usize)?;
        Some(Self {
            lag: (changed.correlation(sharpest).powi(2) >= EXPLAINED).then(|| changed.fine(sharpest)),
            gain: plain.0[best].gain(),
            correlation: plain.correlation(best),
            axes: std::array::from_fn(|axis| one.axis(axis)),
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
    fn of(steps: &[Vector3<f64>], actions: &[Vector3<f64>], valid: &[bool]) -> Self {
        let at = |lag: isize| {
            let mut sums = Sums::default();
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
#[derive(Debug, Clone, Copy, Default)]
struct Sums {
    steps: [f64; 3],
    actions: [f64; 3],
    both: [f64; 3],
}

impl Sums {
    fn add(&mut self, step: &Vector3<f64>, action: &Vector3<f64>) {
        for axis in 0..3 {
            self.steps[axis] += step[axis] * step[axis];
            self.actions[axis] += action[axis] * action[axis];
            self.both[axis] += step[axis] * action[axis];
        }
    }

    fn correlation(&self) -> f64 {
        let total = |sums: &[f64; 3]| sums.iter().sum::<f64>();
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

/// The fraction of the fingers' travel that goes against the last gripper command; `None` if the fingers travel by less than a
/// quarter of their opening.
pub(crate) fn against_command(frames: &[SpatialFrame]) -> Option<f64> {
    let (mut against, mut all) = (0.0, 0.0);
    for (before, (now, next)) in frames.iter().zip(frames.iter().skip(1).zip(frames.iter().skip(2))) {
        let change = next.finger_separation() - now.finger_separation();
        // The first step after a change of the command still has the old direction.
        if before.closes() != now.closes() {
            continue;
        }
        all += change.abs();
        if (change > 0.0) == now.closes() {
            against += change.abs();
        }
    }
    (all >= 0.02).then(|| against / all)
}

/// Compares the actions with the motion, and both with those of the other demonstrations.
pub(crate) fn check_actions_and_motion(fit: Option<&ActionFit>, frames: &[SpatialFrame], sink: &mut Sink<'_>) {
    let all = 0..frames.len();
    let mut reversed = false;
    if let (Some(fit), Some(usual)) = (fit, sink.thresholds.usual_response) {
        // If the rows are reversed, the step that followed an action by `lag` precedes it by one more.
        let backwards = |lag: f64| (lag + 1.0 + usual.lag).abs() < (lag - usual.lag).abs();
        reversed = fit.lag.is_some_and(backwards) && -fit.correlation > sink.thresholds.over("reversed");
        let opposed = |axis: &usize| fit.axes[*axis].is_some_and(|c| -c > sink.thresholds.over("actions_opposed"));
        let axes: Vec<usize> = (0..3).filter(opposed).collect();
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
            let names: Vec<&str> = axes.iter().map(|&axis| ["x", "y", "z"][axis]).collect();
            sink.add(
                "actions_opposed",
                all.clone(),
                fit.axes[axis].map(|correlation| -correlation),
                format!(
                    "along {}, the end effector moves opposite to its actions",
                    names.join(" and ")
                ),
            );
        } else {
            let unrelated = 1.0 - fit.correlation.powi(2) > sink.thresholds.over("actions_unrelated");
            // Lag and gain mean nothing if the actions do not explain the motion.
            let meaningful = |code: &str| !unrelated || code == "actions_unrelated";
            for (code, value) in fit.values(&usual).filter(|(code, _)| meaningful(code)) {
                sink.exceeding(code, all.clone(), value, |value| match code {
                    "actions_shifted" => format!(
                        "the end effector follows changes of its actions after {:.2} frames; the median of the demonstrations is {:.2}",
                        fit.lag.unwrap_or_default(),
                        usual.lag
                    ),
                    "actions_scaled" => format!(
                        "the end effector moves {:.2} times as far for the same action as in the other demonstrations",
                        fit.scale(&usual)
                    ),
                    _ => format!("the actions do not explain {:.0} % of the end effector's motion", 1e2 * value),
                });
            }
        }
    }
    if let Some(against) = against_command(frames).filter(|_| !reversed) {
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

/// Reports idle stretches and controls at their limits.
pub(crate) fn check_commands(frames: &[SpatialFrame], sink: &mut Sink<'_>) {
    for run in runs(frames.iter().map(is_idle), 1) {
        sink.exceeding("idle", run.clone(), run.len() as f64, |value| {
            format!("hardly any arm action in {value} consecutive frames")
        });
    }
    for (code, least, what) in [
        ("saturated", 1, "a control is at its limit"),
        ("saturated_together", 2, "two or more controls are at their limits"),
    ] {
        sink.exceeding(code, 0..frames.len(), saturated_fraction(frames, least), |value| {
            format!("{what} in {:.0} % of the frames", 1e2 * value)
        });
    }
}
