//! Unit, offset, direction and frame of actions, and the range of the gripper's command, held against what the hand does.

use std::collections::HashMap;

use nalgebra::Vector3;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::demo::Sound;
use super::evidence::{Basis, Candidate, Declared, Evidence, Fit, Proof, Test, Verdict, name};
use super::reading::{ActionReading, ActionRotation, ActionScale};
use super::response::{Line, ROTATION, Response, Sums, TRANSLATION};
use super::{EefOrientation, QuaternionOrder, Settings, Unproven};
use crate::actions::{Action, Osc};
use crate::env_args::EnvArgs;

/// The controller that actions go to.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Controls {
    /// What its commands mean.
    pub osc: Osc,
    /// How the hand follows.
    pub response: Response,
}

impl Controls {
    /// Those that a file declares; none where it declares no scales.
    pub(super) fn of(env: &EnvArgs) -> Option<Self> {
        Some(Self {
            osc: Osc::from_env(env).ok()?,
            response: Response::of(env),
        })
    }
}

/// Deltas that ask for more than this many times of what the controller can do are not in metres.
const BEYOND: f64 = 10.0;
/// A unit fits this many times better than another one, or the data does not tell the two apart.
const BETTER: f64 = 2.0;
/// Rows that a line needs.
pub(super) const ROWS: usize = 20;
/// A hand goes at most this many times as far as robosuite's controller takes it: 1.01 is the most that was seen.
pub(super) const FURTHER: f64 = 1.6;
/// It may be held back: 0.41 is the minimum that was seen, of a hand that opens a door.
pub(super) const LESS: f64 = 3.0;
/// Fraction of the translation that a line may leave unexplained and still tell the unit.
pub(super) const TRANSLATION_TOLD: f64 = 0.6;
/// The same for rotations. Translations turn the hand a little, too, which looks like a gain of 1.4 where hardly any rotation
/// is commanded, and leaves half of it unexplained.
pub(super) const ROTATION_TOLD: f64 = 0.35;
/// Rotations go at most this many times as far: 1.02 is the most that was seen.
pub(super) const TURNS_FURTHER: f64 = 1.3;
/// A line this flat tells that commands are too large even where it explains little.
const TURNS_LESS: (f64, f64) = (0.25, 0.75);
/// Commands that are further from 0 where the hand rests are shifted (in the controller's commands): friction and weight
/// make up to 0.034 over several demonstrations.
const SHIFTED: f64 = 0.15;
/// Fraction of its motion that the line of one axis may leave unexplained and still tell where the hand rests.
const AXIS_TOLD: f64 = 0.5;
/// Minimum gain of such a line.
const AXIS_GAIN: f64 = 0.05;
/// Frames at rest under one and the same command that tell a shift.
const RESTS: usize = 10;

/// Steps of the hand: translations, and rotation vectors in world axes.
pub(super) fn steps(demo: &Sound<'_>, order: QuaternionOrder) -> Vec<[f64; 6]> {
    let parts = |[a, b, c, d]: [f64; 4]| match order {
        QuaternionOrder::Xyzw => (Vector3::new(a, b, c), d),
        QuaternionOrder::Wxyz => (Vector3::new(b, c, d), a),
    };
    let poses = demo.arrays.eef_pos.windows(2).zip(demo.arrays.eef_quat.windows(2));
    poses
        .map(|(positions, quaternions)| {
            let ((v, w), (next, next_w)) = (parts(quaternions[0]), parts(quaternions[1]));
            let turn = next * w - v * next_w - next.cross(&v);
            // Twice the sine of half the angle is the angle to a ten-thousandth, as steps are small.
            let factor = if next_w * w + next.dot(&v) < 0.0 { -2.0 } else { 2.0 };
            let [before, now] = [positions[0], positions[1]];
            let [rx, ry, rz] = [turn.x, turn.y, turn.z].map(|value| factor * value);
            [now[0] - before[0], now[1] - before[1], now[2] - before[2], rx, ry, rz]
        })
        .collect()
}

/// What these actions ask for as deltas of the controller.
pub(super) fn deltas(controls: &Controls, steps: &[[f64; 6]], actions: &[Action]) -> Sums {
    Sums::of(&controls.response, steps, |t| controls.osc.motion(&actions[t]))
}

/// The line that tells about rotations, over all three axes or over the one that tells most; none where none tells.
pub(super) fn rotation_line(sums: &Sums) -> Option<Line> {
    let significant =
        |line: Option<Line>| line.filter(|line| line.unexplained <= ROTATION_TOLD && sums.frames() >= ROWS);
    significant(sums.line(&ROTATION)).or_else(|| {
        let axes = ROTATION.iter().filter_map(|axis| significant(sums.line(&[*axis])));
        axes.min_by(|a, b| a.unexplained.total_cmp(&b.unexplained))
    })
}

/// Lines of a hypothesis about deltas.
struct Lines {
    translation: Option<Line>,
    rotation: Option<Line>,
    rotation_line: Option<Line>,
    frames: usize,
}

/// What lines say of a hypothesis.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Says {
    Fits,
    /// Translations are of another unit.
    NotTranslation,
    /// Only rotations are of another unit.
    NotRotation,
    Nothing,
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

    fn translation_line(&self) -> Option<Line> {
        self.translation
            .filter(|line| line.unexplained <= TRANSLATION_TOLD && self.frames >= ROWS)
    }

    fn says(&self) -> Says {
        let Some(translation) = self.translation_line() else {
            return Says::Nothing;
        };
        if !(1.0 / LESS..=FURTHER).contains(&translation.gain) {
            return Says::NotTranslation;
        }
        let turns = |line: &Line| !(1.0 / LESS..=TURNS_FURTHER).contains(&line.gain.abs());
        let flat = |line: &Line| line.gain.abs() < TURNS_LESS.0 && line.unexplained <= TURNS_LESS.1;
        if self.rotation_line.is_some_and(|line| turns(&line)) || self.rotation.is_some_and(|line| flat(&line)) {
            return Says::NotRotation;
        }
        Says::Fits
    }

    /// How many times further or less far the hand moves than asked.
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

const SCALE: &str = "how many times further or less far the hand moves than the controller takes it for its commands";

/// A proof with candidates of its own.
#[allow(clippy::too_many_arguments, reason = "a row has as many columns")]
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

/// Candidates with their residuals, as a sentence lists them.
pub(super) fn listed(candidates: &[(String, f64)], digits: usize) -> String {
    let each: Vec<String> = candidates
        .iter()
        .map(|(value, residual)| format!("{value} {residual:.digits$}"))
        .collect();
    each.join(", ")
}

/// What is known when actions are judged.
pub(super) struct Judge<'a, 'd> {
    pub(super) demos: &'a [Sound<'d>],
    pub(super) controls: Option<Controls>,
    pub(super) settings: &'a Settings,
    pub(super) env: &'a EnvArgs,
    /// How actions were read so far: by the settings.
    pub(super) reading: ActionReading,
    pub(super) order: QuaternionOrder,
    pub(super) orientation: EefOrientation,
}

impl Judge<'_, '_> {
    pub(super) fn total(&self, sums: impl Fn(&Sound<'_>, &[[f64; 6]]) -> Sums) -> Sums {
        let mut total = Sums::default();
        for demo in self.demos {
            total.add(&sums(demo, &steps(demo, self.order)));
        }
        total
    }

    /// Recorded actions under another reading than that of the settings.
    pub(super) fn as_read(demo: &Sound<'_>, reading: &ActionReading) -> Vec<Action> {
        demo.arrays.actions.iter().map(|action| reading.read(action)).collect()
    }

    fn lines(&self, controls: &Controls, reading: &ActionReading) -> Lines {
        Lines::of(&self.total(|demo, steps| deltas(controls, steps, &Self::as_read(demo, reading))))
    }

    /// Lines of deltas in metres and radians. A controller would cut what is beyond its range, but nobody asks for ten times
    /// of what it can do: cut to it, commands of any other unit would look like ones that always ask for the most.
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

    /// Unit, offset and direction of deltas.
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
        let numbers = || format!("{SCALE}: {} times, over {frames} frames", listed(&candidates, 2));
        let says = own.says();
        if matches!(says, Says::NotTranslation | Says::NotRotation) {
            let others = [(ActionScale::Controller, &plain), (ActionScale::Metres, &metres)];
            let mut others = others.into_iter().filter(|(scale, _)| *scale != reading.scale);
            let better = others
                .find(|(_, lines)| lines.says() == Says::Fits && BETTER * lines.factor() <= own.factor())
                .map(|(scale, _)| scale);
            return Err(self.another_unit(&controls, &own, says, better, numbers()));
        }
        self.shifted(&controls, &total)?;
        let (basis, warning) = match (says, set) {
            (Says::Fits, true) if plain.says() != Says::Fits || plain.factor() >= BETTER * own.factor() => {
                (Basis::Data, None)
            }
            (Says::Fits, false) if metres.factor() >= BETTER * own.factor() => (Basis::Data, None),
            (Says::Fits, true) => {
                let text = format!(
                    "taken from the setting action_scale: the controller's own unit fits, too ({})",
                    numbers()
                );
                (Basis::Setting, Some(text))
            }
            (_, true) => {
                let text = format!(
                    "taken from the setting action_scale: the hand moves too little for a proof ({})",
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

    /// The sentence for deltas that are in another unit than they were read in.
    fn another_unit(
        &self,
        controls: &Controls,
        own: &Lines,
        says: Says,
        better: Option<ActionScale>,
        evidence: String,
    ) -> Unproven {
        let unit = controls.osc.unit();
        let steady = controls.response.steady();
        let set = self.settings.states_scale();
        let (what, line, unit, axes) = match says {
            Says::NotRotation => ("turns", own.rotation_line.or(own.rotation), unit[3], "rad"),
            _ => ("moves", own.translation, unit[0], "m"),
        };
        let gain = line.map_or(0.0, |line| line.gain.abs());
        let moves = format!(
            "the hand {what} {:.3} {axes} a step per unit of command, {gain:.2} times what a controller with output_max {unit} does",
            gain * steady * unit
        );
        let (what, fix) = match (better, set) {
            (Some(ActionScale::Metres), false) => (
                format!("{moves}: these are deltas in metres and radians"),
                "set action_scale = \"metres\"".to_owned(),
            ),
            (Some(better), _) => (
                format!(
                    "{moves} under the settings for the scale of actions, and action_scale = \"{}\" fits",
                    name(better)
                ),
                "correct the setting".to_owned(),
            ),
            (None, true) => (
                format!("{moves} under the settings for the scale of actions"),
                "correct action_scale, action_gain or action_offset".to_owned(),
            ),
            (None, false) => (
                format!("{moves}: these are deltas in another unit"),
                "give the numbers that take them to the controller's commands as action_gain and action_offset, six of each (command = gain * recorded + offset)"
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

    /// Refuses commands that are not 0 where the hand rests.
    fn shifted(&self, controls: &Controls, total: &Sums) -> Result<(), Unproven> {
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
            if line.unexplained > AXIS_TOLD || line.gain.abs() < AXIS_GAIN || total.frames() < ROWS {
                continue;
            }
            let shift = total.at_rest(&controls.response, axis, line.gain) / unit;
            if shift.abs() > SHIFTED && worst.is_none_or(|(_, most, _)| shift.abs() > most.abs()) {
                worst = Some((axis, shift, line.unexplained));
            }
        }
        let fix = if self.settings.states_scale() {
            "correct action_gain and action_offset"
        } else {
            "give the numbers that undo it as action_gain and action_offset, six of each (command = gain * recorded + offset)"
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
                    "the hand rests where the command for {} is {shift:.2}, and the controller's rests at 0: the actions are shifted, as by a normalisation to their own range or mean",
                    names[axis]
                ),
                format!(
                    "commands against the hand's motion, axis by axis: a line leaves {unexplained:.2} of the motion unexplained, over {} frames",
                    total.frames()
                ),
            ));
        }
        let rests = self.rests();
        let zero = rests.get(&[0_u64; 6]).copied().unwrap_or(0);
        // Ties are broken by the command, not by the order of a hash table.
        let most = rests.iter().max_by_key(|(command, count)| (**count, **command));
        if let Some((command, &count)) = most {
            let command = command.map(f64::from_bits);
            let maximum = command.iter().fold(0.0_f64, |most, value| most.max(value.abs()));
            if count >= RESTS && count > 2 * zero && (1e-3..0.99).contains(&maximum) {
                let shown: Vec<String> = command.iter().map(|value| format!("{value:.3}")).collect();
                return Err(refuse(
                    format!(
                        "the hand rests under the command ({}), and the controller's rests at 0: the actions are shifted, as by a normalisation to their own range or mean",
                        shown.join(", ")
                    ),
                    format!("{count} frames at rest have that very command, and {zero} have 0"),
                ));
            }
        }
        Ok(())
    }

    /// Arm commands under which the hand stays where it is, and how often, by their bits.
    fn rests(&self) -> HashMap<[u64; 6], usize> {
        let mut rests = HashMap::new();
        for demo in self.demos {
            let steps = steps(demo, self.order);
            let arm = |t: usize| -> [u64; 6] {
                // A negative zero is a zero.
                std::array::from_fn(|axis| (demo.actions[t][axis] + 0.0).to_bits())
            };
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

    /// Which way deltas turn.
    fn rotation(&self, own: &Lines) -> Result<(ActionRotation, Proof), Unproven> {
        let test = Test {
            name: "the hand's rotation against the rotation vectors of its commands: 0 where it turns as they say, 1 where it turns the other way",
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
        // Read by a setting, what was turned round is turned back.
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
