//! Detection of the unit, the offset and the direction of delta actions from the end effector's motion.

use std::collections::HashMap;

use nalgebra::Vector3;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::demo::ValidDemo;
use super::evidence::{Basis, Candidate, Declared, Evidence, Fit, Proof, Test, Verdict, name};
use super::reading::{ActionReading, ActionRotation, ActionScale};
use super::response::{Line, ROTATION, Response, Sums, TRANSLATION};
use super::{EefOrientation, QuaternionOrder, Settings, Unproven};
use crate::actions::{Action, Osc};
use crate::env_args::EnvArgs;

/// The controller that executes the actions.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Controls {
    /// Scales of its commands.
    pub osc: Osc,
    /// Motion of the end effector in response to commands.
    pub response: Response,
}

impl Controls {
    /// The controller that a file declares, or `None` if it declares no scales.
    pub(super) fn of(env: &EnvArgs) -> Option<Self> {
        Some(Self {
            osc: Osc::from_env(env).ok()?,
            response: Response::of(env),
        })
    }
}

/// If a translation exceeds the controller's maximum step by more than this factor, the deltas are not in metres.
const BEYOND: f64 = 10.0;
/// Minimum factor by which one unit must fit better than another. Below it the data does not decide between the two.
const BETTER: f64 = 2.0;
/// Minimum number of rows for fitting a line.
pub(super) const ROWS: usize = 20;
/// Maximum gain of translations: the end effector moves at most this many times as far as robosuite's controller would move it.
/// The largest gain observed is 1.01.
pub(super) const FURTHER: f64 = 1.6;
/// Inverse of the minimum gain of translations. Contacts may hold the end effector back: the smallest gain observed is 0.41,
/// for an end effector that opens a door.
pub(super) const LESS: f64 = 3.0;
/// Maximum fraction of the translation that a line may leave unexplained. Beyond it the line does not determine the unit.
pub(super) const TRANSLATION_UNEXPLAINED: f64 = 0.6;
/// The same for rotations. It is smaller because translations rotate the end effector slightly. If hardly any rotation is
/// commanded, this looks like a gain of 1.4 that leaves half of the rotation unexplained.
pub(super) const ROTATION_UNEXPLAINED: f64 = 0.35;
/// Maximum gain of rotations. The largest gain observed is 1.02.
pub(super) const ROTATES_FURTHER: f64 = 1.3;
/// Maximum gain and unexplained fraction of a rotation line that shows that commands are too large, although it explains
/// little of the rotation.
const ROTATES_LESS: (f64, f64) = (0.25, 0.75);
/// Maximum absolute command (in controller commands) at which the end effector may rest. Beyond it the actions are shifted.
/// Friction and weight cause up to 0.034 over several demonstrations.
const SHIFTED: f64 = 0.15;
/// Maximum fraction of the motion along one axis that a line may leave unexplained to determine where the end effector rests.
const AXIS_UNEXPLAINED: f64 = 0.5;
/// Minimum gain of such a line.
const AXIS_GAIN: f64 = 0.05;
/// Minimum number of frames at rest under the same command that show a shift.
const RESTS: usize = 10;

/// Motion of the end effector in each step: translation (metres) and rotation vector (radians) in world axes. Returns one row
/// less than the demonstration has.
pub(super) fn steps(demo: &ValidDemo<'_>, order: QuaternionOrder) -> Vec<[f64; 6]> {
    let parts = |[a, b, c, d]: [f64; 4]| match order {
        QuaternionOrder::Xyzw => (Vector3::new(a, b, c), d),
        QuaternionOrder::Wxyz => (Vector3::new(b, c, d), a),
    };
    let poses = demo.arrays.eef_pos.windows(2).zip(demo.arrays.eef_quat.windows(2));
    poses
        .map(|(positions, quaternions)| {
            let ((v, w), (next, next_w)) = (parts(quaternions[0]), parts(quaternions[1]));
            let rotation = next * w - v * next_w - next.cross(&v);
            // Steps are small, so twice the sine of half the angle approximates the angle to 1e-4. The sign of the factor selects
            // the shorter of the two rotations that the quaternions allow.
            let factor = if next_w * w + next.dot(&v) < 0.0 { -2.0 } else { 2.0 };
            let [before, now] = [positions[0], positions[1]];
            let [rx, ry, rz] = [rotation.x, rotation.y, rotation.z].map(|value| factor * value);
            [now[0] - before[0], now[1] - before[1], now[2] - before[2], rx, ry, rz]
        })
        .collect()
}

/// Sums for actions that are read as controller commands.
pub(super) fn deltas(controls: &Controls, steps: &[[f64; 6]], actions: &[Action]) -> Sums {
    Sums::of(&controls.response, steps, |t| controls.osc.motion(&actions[t]))
}

/// The line through the rotations about all three axes, or the one about the single axis that explains most if the common line
/// leaves too much unexplained. Returns `None` if no line is significant.
pub(super) fn rotation_line(sums: &Sums) -> Option<Line> {
    let significant =
        |line: Option<Line>| line.filter(|line| line.unexplained <= ROTATION_UNEXPLAINED && sums.frames() >= ROWS);
    significant(sums.line(&ROTATION)).or_else(|| {
        let axes = ROTATION.iter().filter_map(|axis| significant(sums.line(&[*axis])));
        axes.min_by(|a, b| a.unexplained.total_cmp(&b.unexplained))
    })
}

/// The fitted lines for one hypothesis about the unit of deltas.
struct Lines {
    translation: Option<Line>,
    rotation: Option<Line>,
    rotation_line: Option<Line>,
    frames: usize,
}

/// Result of testing a hypothesis about the unit of deltas.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum UnitFit {
    Fits,
    /// Translations have another unit.
    NotTranslation,
    /// Only rotations have another unit.
    NotRotation,
    /// The end effector moves too little, or its motion does not follow the actions.
    Undecided,
}

impl Lines {
    fn of(sums: &Sums) -> Self {
        Self {
            translation: sums.line(&TRANSLATION),
            rotation: sums.line(&ROTATION),
            rotation_line: rotation_line(sums),
            frames: sums.frames(),
        }
    }

    /// The line through the translations, if it is significant.
    fn translation_line(&self) -> Option<Line> {
        self.translation
            .filter(|line| line.unexplained <= TRANSLATION_UNEXPLAINED && self.frames >= ROWS)
    }

    /// Whether the gains of the lines agree with the hypothesis.
    fn unit_fit(&self) -> UnitFit {
        let Some(translation) = self.translation_line() else {
            return UnitFit::Undecided;
        };
        if !(1.0 / LESS..=FURTHER).contains(&translation.gain) {
            return UnitFit::NotTranslation;
        }
        let other_unit = |line: &Line| !(1.0 / LESS..=ROTATES_FURTHER).contains(&line.gain.abs());
        let flat = |line: &Line| line.gain.abs() < ROTATES_LESS.0 && line.unexplained <= ROTATES_LESS.1;
        if self.rotation_line.is_some_and(|line| other_unit(&line)) || self.rotation.is_some_and(|line| flat(&line)) {
            return UnitFit::NotRotation;
        }
        UnitFit::Fits
    }

    /// Factor, at least 1, between the distance that the end effector moves and the commanded distance, in either direction.
    /// It is infinite if there is no significant line or the end effector moves backwards.
    fn factor(&self) -> f64 {
        self.translation_line().map_or(f64::INFINITY, |line| {
            if line.gain > 0.0 {
                line.gain.max(1.0 / line.gain)
            } else {
                f64::INFINITY
            }
        })
    }
}

const SCALE: &str =
    "factor between the end effector's motion and the motion that the controller makes for its commands";

/// A proof with explicit candidates (value and residual).
#[allow(clippy::too_many_arguments, reason = "one argument per part of the proof")]
pub(super) fn proof(
    convention: &str,
    value: String,
    basis: Basis,
    test: Test,
    candidates: &[(String, f64)],
    frames: usize,
    warning: Option<String>,
) -> Proof {
    let candidate = |(value, residual): &(String, f64)| Candidate {
        value: value.clone(),
        residual: *residual,
        median: *residual,
    };
    Proof {
        convention: convention.to_owned(),
        value,
        basis,
        evidence: Evidence {
            test: test.name.to_owned(),
            unit: test.unit.to_owned(),
            threshold: test.threshold,
            rival_threshold: test.rival,
            candidates: candidates.iter().map(candidate).collect(),
            frames,
            frames_needed: test.frames,
        },
        warning,
    }
}

/// Formats candidates with their residuals for a message.
pub(super) fn listed(candidates: &[(String, f64)], digits: usize) -> String {
    let each: Vec<String> = candidates
        .iter()
        .map(|(value, residual)| format!("{value} {residual:.digits$}"))
        .collect();
    each.join(", ")
}

/// Tests the unit, offset, direction and frame of the actions of some demonstrations.
pub(super) struct ActionTests<'a, 'd> {
    pub(super) demos: &'a [ValidDemo<'d>],
    pub(super) controls: Option<Controls>,
    pub(super) settings: &'a Settings,
    pub(super) env: &'a EnvArgs,
    /// Conversion that the settings ask for.
    pub(super) reading: ActionReading,
    pub(super) order: QuaternionOrder,
    pub(super) orientation: EefOrientation,
}

impl ActionTests<'_, '_> {
    /// The sums over all demonstrations.
    pub(super) fn total(&self, sums: impl Fn(&ValidDemo<'_>, &[[f64; 6]]) -> Sums) -> Sums {
        let mut total = Sums::default();
        for demo in self.demos {
            total.add(&sums(demo, &steps(demo, self.order)));
        }
        total
    }

    /// Recorded actions, converted in another way than the settings ask for.
    pub(super) fn as_read(demo: &ValidDemo<'_>, reading: &ActionReading) -> Vec<Action> {
        demo.arrays.actions.iter().map(|action| reading.read(action)).collect()
    }

    /// Lines for deltas with this conversion.
    fn lines(&self, controls: &Controls, reading: &ActionReading) -> Lines {
        Lines::of(&self.total(|demo, steps| deltas(controls, steps, &Self::as_read(demo, reading))))
    }

    /// Lines for deltas that are read as metres and radians.
    ///
    /// The controller clips commands to its range. If some deltas exceed that range by a factor of [`BEYOND`], they are not
    /// clipped here: otherwise deltas of any larger unit would look like commands that are always at the limit.
    fn metres(&self, controls: &Controls) -> Lines {
        let plain = ActionReading {
            gain: [1.0; 6],
            offset: [0.0; 6],
            ..self.reading
        };
        let unit = controls.osc.unit();
        let beyond = self.demos.iter().any(|demo| {
            let far = |action: &Action| (0..3).any(|axis| action[axis].abs() > BEYOND * unit[axis].abs());
            demo.arrays.actions.iter().any(far)
        });
        if !beyond {
            return self.lines(controls, &plain.metres(&controls.osc));
        }
        let sign = match self.reading.rotation {
            ActionRotation::Forward => 1.0,
            ActionRotation::Reversed => -1.0,
        };
        Lines::of(&self.total(|demo, steps| {
            Sums::of(&controls.response, steps, |t| {
                let action = &demo.arrays.actions[t];
                std::array::from_fn(|axis| if axis < 3 { action[axis] } else { sign * action[axis] })
            })
        }))
    }

    /// Determines the unit, the offset and the direction of deltas.
    pub(super) fn deltas(&self) -> Result<(ActionReading, Vec<Proof>), Unproven> {
        let mut reading = self.reading;
        let Some(controls) = self.controls else {
            let value = name(reading.scale);
            let basis = if reading.scale == ActionScale::Controller {
                Basis::Declared
            } else {
                Basis::Setting
            };
            let row = proof("action_scale", value, basis, SCALE_TEST, &[], 0, None);
            return Ok((reading, vec![row]));
        };
        let total = self.total(|demo, steps| deltas(&controls, steps, &demo.actions));
        let metres = self.metres(&controls);
        let own = match reading.scale {
            ActionScale::Metres => self.metres(&controls),
            _ => Lines::of(&total),
        };
        let plain = self.lines(
            &controls,
            &ActionReading {
                scale: ActionScale::Controller,
                gain: [1.0; 6],
                offset: [0.0; 6],
                ..reading
            },
        );
        let set = self.settings.states_scale();
        let mut candidates = vec![(name(ActionScale::Controller), plain.factor())];
        if reading.scale == ActionScale::Numbers {
            candidates.push((name(ActionScale::Numbers), own.factor()));
        }
        candidates.push((name(ActionScale::Metres), metres.factor()));
        candidates.sort_by(|a, b| a.1.total_cmp(&b.1));
        let frames = own.frames;
        let numbers = || format!("{SCALE}: {}, over {frames} frames", listed(&candidates, 2));
        let fit = own.unit_fit();
        if matches!(fit, UnitFit::NotTranslation | UnitFit::NotRotation) {
            let others = [(ActionScale::Controller, &plain), (ActionScale::Metres, &metres)];
            let mut others = others.into_iter().filter(|(scale, _)| *scale != reading.scale);
            let better = others
                .find(|(_, lines)| lines.unit_fit() == UnitFit::Fits && BETTER * lines.factor() <= own.factor())
                .map(|(scale, _)| scale);
            return Err(self.another_unit(&controls, &own, fit, better, numbers()));
        }
        self.check_shift(&controls, &total)?;
        let (basis, warning) = match (fit, set) {
            (UnitFit::Fits, true) if plain.unit_fit() != UnitFit::Fits || plain.factor() >= BETTER * own.factor() => {
                (Basis::Data, None)
            }
            (UnitFit::Fits, false) if metres.factor() >= BETTER * own.factor() => (Basis::Data, None),
            (UnitFit::Fits, true) => {
                let text = format!(
                    "taken from the setting action_scale: the controller's own unit also fits ({})",
                    numbers()
                );
                (Basis::Setting, Some(text))
            }
            (_, true) => {
                let text = format!(
                    "taken from the setting action_scale: the end effector moves too little for a proof ({})",
                    numbers()
                );
                (Basis::Setting, Some(text))
            }
            (_, false) => (Basis::Declared, None),
        };
        let value = name(reading.scale);
        let mut rows = vec![proof(
            "action_scale",
            value,
            basis,
            SCALE_TEST,
            &candidates,
            frames,
            warning,
        )];
        let (rotation, row) = self.rotation(&own)?;
        reading.rotation = rotation;
        rows.push(row);
        Ok((reading, rows))
    }

    /// The error for deltas that are in another unit than the one that they were read in.
    fn another_unit(
        &self,
        controls: &Controls,
        own: &Lines,
        fit: UnitFit,
        better: Option<ActionScale>,
        evidence: String,
    ) -> Unproven {
        let unit = controls.osc.unit();
        let steady = controls.response.steady();
        let set = self.settings.states_scale();
        let (verb, line, unit, axes) = match fit {
            UnitFit::NotRotation => ("rotates", own.rotation_line.or(own.rotation), unit[3], "rad"),
            _ => ("moves", own.translation, unit[0], "m"),
        };
        let gain = line.map_or(0.0, |line| line.gain.abs());
        let moves = format!(
            "the end effector {verb} {:.3} {axes} per step and unit of command, {gain:.2} times as far as with a controller with output_max {unit}",
            gain * steady * unit
        );
        let (what, fix) = match (better, set) {
            (Some(ActionScale::Metres), false) => (
                format!("{moves}: the actions are deltas in metres and radians"),
                "set action_scale = \"metres\"".to_owned(),
            ),
            (Some(better), _) => (
                format!(
                    "{moves} with the settings for the scale of actions, but action_scale = \"{}\" fits",
                    name(better)
                ),
                "correct the setting".to_owned(),
            ),
            (None, true) => (
                format!("{moves} with the settings for the scale of actions"),
                "correct action_scale, action_gain or action_offset".to_owned(),
            ),
            (None, false) => (
                format!("{moves}: the actions are deltas in another unit"),
                "set action_gain and action_offset to the six numbers each that convert them to controller commands (command = gain * recorded + offset)"
                    .to_owned(),
            ),
        };
        Unproven::Actions {
            convention: "action_scale",
            what,
            evidence,
            fix,
        }
    }

    /// Refuses deltas under which the end effector rests at commands other than 0.
    fn check_shift(&self, controls: &Controls, total: &Sums) -> Result<(), Unproven> {
        let names = [
            "x",
            "y",
            "z",
            "rotation about x",
            "rotation about y",
            "rotation about z",
        ];
        let unit = controls.osc.unit();
        let mut worst: Option<(usize, f64, f64)> = None;
        for (axis, unit) in unit.into_iter().enumerate() {
            let Some(line) = total.line(&[axis]) else { continue };
            if line.unexplained > AXIS_UNEXPLAINED || line.gain.abs() < AXIS_GAIN || total.frames() < ROWS {
                continue;
            }
            let shift = total.at_rest(&controls.response, axis, line.gain) / unit;
            if shift.abs() > SHIFTED && worst.is_none_or(|(_, largest, _)| shift.abs() > largest.abs()) {
                worst = Some((axis, shift, line.unexplained));
            }
        }
        let fix = if self.settings.states_scale() {
            "correct action_gain and action_offset"
        } else {
            "set action_gain and action_offset to the six numbers each that undo the shift (command = gain * recorded + offset)"
        };
        let refuse = |what: String, evidence: String| Unproven::Actions {
            convention: "action_scale",
            what,
            evidence,
            fix: fix.to_owned(),
        };
        if let Some((axis, shift, unexplained)) = worst {
            return Err(refuse(
                format!(
                    "the end effector rests when the command for {} is {shift:.2}, but the controller rests at 0: the actions are shifted, for example by a normalisation to their range or mean",
                    names[axis]
                ),
                format!(
                    "a line fitted to commands and motion along this axis leaves a fraction of {unexplained:.2} of the motion unexplained, over {} frames",
                    total.frames()
                ),
            ));
        }
        let rests = self.rests();
        let zero = rests.get(&[0_u64; 6]).copied().unwrap_or(0);
        // The bits of the command break ties, because the order of a hash table differs from run to run.
        let most_frequent = rests.iter().max_by_key(|(command, count)| (**count, **command));
        if let Some((command, &count)) = most_frequent {
            let command = command.map(f64::from_bits);
            let maximum = command.iter().fold(0.0_f64, |maximum, value| maximum.max(value.abs()));
            if count >= RESTS && count > 2 * zero && (1e-3..0.99).contains(&maximum) {
                let shown: Vec<String> = command.iter().map(|value| format!("{value:.3}")).collect();
                return Err(refuse(
                    format!(
                        "the end effector rests under the command ({}), but the controller rests at 0: the actions are shifted, for example by a normalisation to their range or mean",
                        shown.join(", ")
                    ),
                    format!("{count} frames at rest have exactly this command, and {zero} have the command 0"),
                ));
            }
        }
        Ok(())
    }

    /// Arm commands (as bits) under which the end effector does not move, with the number of frames.
    fn rests(&self) -> HashMap<[u64; 6], usize> {
        let mut rests = HashMap::new();
        for demo in self.demos {
            let steps = steps(demo, self.order);
            let arm = |t: usize| -> [u64; 6] {
                // Adding 0 makes negative zeros positive, so that both kinds count as the same command.
                std::array::from_fn(|axis| (demo.actions[t][axis] + 0.0).to_bits())
            };
            // Less than 0.2 mm and 1 mrad in a step.
            let still = |step: &[f64; 6]| {
                let sum = |axes: [usize; 3]| axes.iter().map(|axis| step[*axis] * step[*axis]).sum::<f64>();
                sum(TRANSLATION) < 4e-8 && sum(ROTATION) < 1e-6
            };
            for t in 1..steps.len() {
                if still(&steps[t]) && still(&steps[t - 1]) && arm(t) == arm(t - 1) {
                    *rests.entry(arm(t)).or_insert(0) += 1;
                }
            }
        }
        rests
    }

    /// Determines the direction in which deltas rotate.
    fn rotation(&self, own: &Lines) -> Result<(ActionRotation, Proof), Unproven> {
        let test = Test {
            name: "direction of the end effector's rotation relative to the commanded one (0: same, 1: opposite)",
            unit: "",
            threshold: 0.25,
            rival: 0.75,
            frames: ROWS,
        };
        let old = self.env.version() == Some((1, 0));
        let declared = if old {
            ActionRotation::Reversed
        } else {
            ActionRotation::Forward
        };
        // `own` was fitted to converted actions. If the setting already reverses them, the gain changes its sign back.
        let read = |gain: f64| match self.reading.rotation {
            ActionRotation::Forward => gain,
            ActionRotation::Reversed => -gain,
        };
        let gain = own.rotation_line.map(|line| read(line.gain));
        let against = gain.map(|gain| if gain < 0.0 { 1.0 } else { 0.0 });
        let frames = if gain.is_some() { own.frames } else { 0 };
        let verdict = Verdict::new(
            test,
            [
                (
                    ActionRotation::Forward,
                    Fit::whole(against.unwrap_or(f64::INFINITY), frames),
                ),
                (
                    ActionRotation::Reversed,
                    Fit::whole(against.map_or(f64::INFINITY, |against| 1.0 - against), frames),
                ),
            ],
        );
        let declared = Declared {
            value: declared,
            by: format!(
                "the file declares robosuite {}",
                self.env.env_version.as_deref().unwrap_or("of an undeclared version")
            ),
            strict: true,
        };
        verdict.settle_or_declared("action_rotation", self.settings.action_rotation, &declared)
    }
}

const SCALE_TEST: Test = Test {
    name: SCALE,
    unit: "times",
    threshold: LESS,
    rival: LESS,
    frames: ROWS,
};
