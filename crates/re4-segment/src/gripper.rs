//! What the numbers of a gripper mean: which way it closes, how far it travels, how its command relates to its opening. Everything
//! is proven from the whole dataset, or stated by a setting.
//!
//! [`GripperObservation`] keeps a few numbers of each demonstration, so that a dataset need not fit in memory.

use re4_stats::{median, quantile, sorted};
use serde::Serialize;

use crate::arm::ArmEpisode;
use crate::config::{Closes, OpeningConfig};
use crate::error::SegmentError;

/// Quantile of a demonstration's numbers that is its lowest one; a reading that is wrong in a few frames does not count.
const LOW: f64 = 0.02;

/// Part of the variance of the opening that the command has to explain, so that its sign counts as proven: a quarter, a correlation
/// of one half.
const RELATED: f64 = 0.5;

/// A gripper's opening and its target differ, if something keeps it from its target, by more than this fraction of its travel.
const KEPT_AWAY: f64 = 0.05;

/// Part of the frames, in which the gripper is kept away from its target, that lie on one side of it, so that this side is proven to
/// be that of closing.
const ONE_SIDE: f64 = 0.95;

/// Number of demonstrations in which a gripper has to be kept away from its target.
const DEMOS: usize = 3;

/// A command has two values if at least this part of its frames is within a tenth of its range from one of its ends.
const TWO_VALUES: f64 = 0.95;

/// The measurements of the gripper in one demonstration.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct GripperObservation {
    opening: Option<[f64; 2]>,
    command: Option<[f64; 2]>,
    /// Median change of the opening in a step.
    noise: f64,
    /// Number of frames, and sums over them: opening, command, their squares and their product.
    sums: [f64; 6],
    /// Mean difference between opening and command in the frames in which both rest, if there are any; positive and negative parts.
    rests: Vec<f64>,
    /// Frames of the command that are near one of its ends, by the demonstration's own range.
    two_values: f64,
}

/// Number of frames over which both opening and command have to be constant, so that the gripper has settled.
const SETTLED: usize = 5;

impl GripperObservation {
    /// Measures one demonstration.
    #[must_use]
    pub fn of(episode: &ArmEpisode) -> Self {
        let openings: Vec<f64> = episode.frames.iter().filter_map(|frame| frame.opening).collect();
        let commands: Vec<f64> = episode.frames.iter().filter_map(|frame| frame.gripper).collect();
        let range = |values: &[f64]| {
            let values = sorted(values.iter().copied());
            Some([quantile(&values, LOW)?, quantile(&values, 1.0 - LOW)?])
        };
        let steps: Vec<f64> = openings.windows(2).map(|pair| (pair[1] - pair[0]).abs()).collect();
        let mut sums = [0.0; 6];
        for (&opening, &command) in openings.iter().zip(&commands) {
            let parts = [
                1.0,
                opening,
                command,
                opening * opening,
                command * command,
                opening * command,
            ];
            sums.iter_mut().zip(parts).for_each(|(sum, part)| *sum += part);
        }
        let command = range(&commands);
        let near_end = |value: f64, [low, high]: [f64; 2]| {
            let margin = 0.1 * (high - low);
            value <= low + margin || value >= high - margin
        };
        let near = command.map_or(0, |range| {
            commands.iter().filter(|value| near_end(**value, range)).count()
        });
        Self {
            opening: range(&openings),
            noise: median(&steps).unwrap_or(0.0),
            sums,
            rests: rests(&openings, &commands),
            two_values: near as f64 / commands.len().max(1) as f64,
            command,
        }
    }
}

/// Differences between opening and command at the ends of the stretches in which both have settled.
fn rests(openings: &[f64], commands: &[f64]) -> Vec<f64> {
    let calm = |values: &[f64]| {
        let ends = sorted(values.iter().copied());
        ends.last()
            .zip(ends.first())
            .is_some_and(|(high, low)| high - low <= 0.01 * high.abs().max(low.abs()))
    };
    let windows = openings.windows(SETTLED).zip(commands.windows(SETTLED));
    windows
        .filter(|(own, commanded)| calm(own) && calm(commanded))
        .map(|(own, commanded)| own[SETTLED - 1] - commanded[SETTLED - 1])
        .collect()
}

/// Where a fact about the gripper comes from.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Proof {
    /// From a setting.
    Setting,
    /// From the name of the recorded number, such as a width.
    Name,
    /// From the distance between two fingers, which is 0 when they touch.
    FingerDistance,
    /// From the recording: the gripper stops before its target only when it closes on something.
    KeptFromTarget,
}

/// What the source states about the numbers of a gripper.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Known {
    /// Whether the opening is the distance between two fingers.
    pub finger_distance: bool,
    /// Names of the elements of the state that measure the gripper.
    pub names: Vec<String>,
    /// Frames per second, if known.
    pub rate: Option<f64>,
}

/// How a command moves the gripper.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Commands {
    /// Lowest and highest command.
    pub range: [f64; 2],
    /// Whether a larger command opens the gripper further.
    pub larger_opens: bool,
    /// Whether the command has two values, to open and to close. Otherwise it is a target.
    pub two_values: bool,
    /// Correlation between command and opening; null if there is no opening.
    pub correlation: Option<f64>,
}

/// The meaning of a gripper's numbers in a dataset.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Gripper {
    /// How the opening changes when the gripper closes.
    pub closes: Closes,
    /// Where that comes from.
    pub basis: Proof,
    /// Lowest and highest opening of the dataset, in the recorded unit; those of the command if no opening was recorded.
    pub range: [f64; 2],
    /// The opening at which the gripper is fully shut, if it is known.
    pub shut: Option<f64>,
    /// Whether the opening was recorded. Otherwise, the command stands for it.
    pub measured: bool,
    /// Median change of the opening in a step, as a fraction of the travel.
    pub noise: f64,
    /// How the command moves the gripper; null if there is none, or its relation to the opening is not proven.
    pub commands: Option<Commands>,
    /// Frames per second; null if they are not known.
    pub rate: Option<f64>,
}

impl Gripper {
    /// Proves the meaning from the observations of all demonstrations.
    ///
    /// # Errors
    /// [`SegmentError::NothingOfGripper`] and [`SegmentError::ClosingUnknown`].
    pub fn prove(
        observations: &[GripperObservation],
        known: &Known,
        config: &OpeningConfig,
    ) -> Result<Self, SegmentError> {
        let range = |of: fn(&GripperObservation) -> Option<[f64; 2]>| {
            let all: Vec<[f64; 2]> = observations.iter().filter_map(of).collect();
            let ends = |end: usize| sorted(all.iter().map(|range| range[end]));
            Some([quantile(&ends(0), LOW)?, quantile(&ends(1), 1.0 - LOW)?])
        };
        let (opening, command) = (range(|o| o.opening), range(|o| o.command));
        let measured = opening.is_some();
        let own = opening.or(command).ok_or(SegmentError::NothingOfGripper)?;
        let correlation = correlation(observations).filter(|_| measured);
        let commands = command.map(|range| Commands {
            range,
            larger_opens: true,
            two_values: observations
                .iter()
                .filter(|o| o.command.is_some())
                .all(|o| o.two_values >= TWO_VALUES),
            correlation,
        });
        let (closes, basis) = match config.closes {
            Some(closes) => (closes, Proof::Setting),
            None if known.finger_distance && measured => (Closes::Decreasing, Proof::FingerDistance),
            None => closing(observations, own, commands.as_ref(), known, measured)?,
        };
        let commands = match correlation {
            _ if !measured => commands.map(|commands| Commands {
                larger_opens: closes == Closes::Decreasing,
                ..commands
            }),
            Some(correlation) if correlation.abs() > RELATED => commands.map(|commands| Commands {
                larger_opens: (correlation > 0.0) == (closes == Closes::Decreasing),
                ..commands
            }),
            _ => None,
        };
        let shut = config.shut.or_else(|| match basis {
            _ if !measured => None,
            Proof::FingerDistance => Some(0.0),
            _ => nominal(own, closes).or_else(|| {
                // A target in the unit of the opening has the same scale, and goes beyond what an object lets the gripper reach.
                let target = commands.filter(|commands| !commands.two_values && correlation > Some(RELATED));
                nominal(target?.range, closes)
            }),
        });
        let mut gripper = Self {
            closes,
            basis,
            range: own,
            shut,
            measured,
            noise: 0.0,
            commands,
            rate: known.rate,
        };
        let noises: Vec<f64> = observations.iter().map(|observation| observation.noise).collect();
        let travel = gripper.travel();
        gripper.noise = if travel > 0.0 {
            median(&noises).unwrap_or(0.0) / travel
        } else {
            0.0
        };
        Ok(gripper)
    }

    /// The opening of the open gripper, and that of the shut one: the closed end of the range if it is not known.
    fn ends(&self) -> [f64; 2] {
        let [low, high] = self.range;
        let (open, closed) = match self.closes {
            Closes::Decreasing => (high, low),
            Closes::Increasing => (low, high),
        };
        [open, self.shut.unwrap_or(closed)]
    }

    /// Distance between the open and the shut gripper, in the recorded unit. 0 if the gripper never moves.
    #[must_use]
    pub fn travel(&self) -> f64 {
        let [open, shut] = self.ends();
        ((open - shut) * self.closes.sign()).max(0.0)
    }

    /// The opening as a fraction of the travel: 0 is shut, or as far closed as in any demonstration if the shut opening is not known;
    /// 1 is open. `None` if the gripper never moves.
    #[must_use]
    pub fn fraction(&self, opening: f64) -> Option<f64> {
        let [_, shut] = self.ends();
        let travel = self.travel();
        (travel > 0.0).then(|| (opening - shut) * self.closes.sign() / travel)
    }

    /// The command as a fraction of its range: 0 closes, 1 opens. `None` if there is no command that moves the gripper.
    #[must_use]
    pub fn commanded(&self, command: f64) -> Option<f64> {
        let commands = self.commands?;
        let [low, high] = commands.range;
        let fraction = (command - low) / (high - low);
        (high > low).then_some(if commands.larger_opens {
            fraction
        } else {
            1.0 - fraction
        })
    }

    /// Whether each command closes the gripper, with hysteresis: it has to pass two thirds of its range to open and a third to close,
    /// so that noise below a third of the range changes nothing. `None` if no command is known.
    #[must_use]
    pub fn closing_commands(&self, commands: impl Iterator<Item = Option<f64>>) -> Option<Vec<bool>> {
        let fractions: Option<Vec<f64>> = commands.map(|command| self.commanded(command?)).collect();
        fractions.map(|fractions| below(&fractions))
    }

    /// Number of control steps of 1/20 s, for which durations are stated, in frames of this dataset.
    #[must_use]
    pub fn frames(&self, steps: usize) -> usize {
        self.rate
            .map_or(steps, |rate| ((steps as f64) * rate / 20.0).round().max(1.0) as usize)
    }
}

/// Whether values, fractions of a range, are at its lower end, with hysteresis between a third and two thirds. Before the first value
/// beyond these, the nearer end counts.
pub(crate) fn below(fractions: &[f64]) -> Vec<bool> {
    let mut low = fractions.first().is_some_and(|first| *first < 0.5);
    fractions
        .iter()
        .map(|&value| {
            if value < 1.0 / 3.0 {
                low = true;
            } else if value > 2.0 / 3.0 {
                low = false;
            }
            low
        })
        .collect()
}

/// Correlation between command and opening over all frames.
fn correlation(observations: &[GripperObservation]) -> Option<f64> {
    let mut sums = [0.0; 6];
    for observation in observations {
        sums.iter_mut()
            .zip(observation.sums)
            .for_each(|(sum, part)| *sum += part);
    }
    let [n, opening, command, openings, commands, both] = sums;
    let covariance = |sum: f64, a: f64, b: f64| sum / n - a / n * (b / n);
    let scale = covariance(openings, opening, opening) * covariance(commands, command, command);
    (n > 0.0 && scale > 0.0).then(|| covariance(both, opening, command) / scale.sqrt())
}

/// Which way the gripper closes, from the name of the number or from where something keeps it from its target.
fn closing(
    observations: &[GripperObservation],
    [low, high]: [f64; 2],
    commands: Option<&Commands>,
    known: &Known,
    measured: bool,
) -> Result<(Closes, Proof), SegmentError> {
    let named = |words: &[&str]| {
        let has = |name: &String| words.iter().any(|word| name.to_lowercase().contains(word));
        measured && known.names.iter().any(has)
    };
    match (
        named(&["width", "opening", "aperture"]),
        named(&["closing", "closure", "closedness"]),
    ) {
        (true, false) => return Ok((Closes::Decreasing, Proof::Name)),
        (false, true) => return Ok((Closes::Increasing, Proof::Name)),
        _ => {}
    }
    let unknown = |what: &'static str, why: &str| {
        Err(SegmentError::ClosingUnknown {
            what,
            why: why.to_owned(),
        })
    };
    if !measured {
        return unknown("command", "no opening was recorded");
    }
    let Some(commands) = commands else {
        return unknown("opening", "there is no command to compare it with");
    };
    // A target is in the unit of the opening.
    let [least, most] = commands.range;
    let same_unit = (most - least) > 0.5 * (high - low) && (most - least) < 2.0 * (high - low);
    let follows = commands.correlation.is_some_and(|correlation| correlation > RELATED);
    if commands.two_values || !same_unit || !follows {
        return unknown("opening", "the command is no target in the unit of the opening");
    }
    let far = KEPT_AWAY * (high - low);
    let (mut above, mut below, mut demos) = (0, 0, 0);
    for observation in observations {
        let away = observation.rests.iter().filter(|rest| rest.abs() > far);
        let (over, under): (Vec<f64>, Vec<f64>) = away.partition(|rest| **rest > 0.0);
        demos += usize::from(!over.is_empty() || !under.is_empty());
        above += over.len();
        below += under.len();
    }
    let all = (above + below) as f64;
    if demos >= DEMOS && above as f64 >= ONE_SIDE * all {
        Ok((Closes::Decreasing, Proof::KeptFromTarget))
    } else if demos >= DEMOS && below as f64 >= ONE_SIDE * all {
        Ok((Closes::Increasing, Proof::KeptFromTarget))
    } else {
        unknown("opening", "it is not kept from its target on one side only")
    }
}

/// The shut opening of a number that is a fraction or a percentage of the travel: it reaches within 2 % of 1 or of 100, and nothing
/// lies beyond these ends by more than 2 %.
fn nominal([low, high]: [f64; 2], closes: Closes) -> Option<f64> {
    let scale = [1.0, 100.0]
        .into_iter()
        .find(|scale| (high - scale).abs() <= 0.02 * scale && low >= -0.02 * scale)?;
    match closes {
        Closes::Decreasing => Some(0.0),
        // The open end has to be 0, or the largest number is the widest opening of another scale.
        Closes::Increasing => (low.abs() <= 0.02 * scale).then_some(scale),
    }
}
