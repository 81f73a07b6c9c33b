//! What is known about a dataset of an arm without an object: what moves, what commands it, and which checks that allows.

use std::collections::BTreeSet;

use re4_artifact::episodes::{ArmColumns, SignalRole, SignalRow, SignalVector};
use re4_segment::{ArmEpisode, Gripper, Rule};
use re4_stats::median;
use re4_task::Domain;

use crate::checks::Need;
use crate::rows::{Rows, norm};
use crate::thresholds::Dataset;

/// Actions are targets, not displacements, if the mean square of their difference from the state is less than this fraction of the
/// state's variance.
const ABSOLUTE: f64 = 0.25;

/// A number is the limit of an element of the actions if at least this many frames reach it exactly and none goes beyond, in two
/// demonstrations, or with the same size in two elements or directions: a controller has the same limits for all of them.
const AT_LIMIT: u32 = 3;

/// A command is idle if it is shorter than this fraction of the largest commands: a twentieth of a controller's limit.
const IDLE: f64 = 0.05;

/// What moves, and the elements of the actions that command it.
#[derive(Debug, Clone, PartialEq)]
struct Arm {
    /// Elements of the state, or none if the position of the end effector moves.
    joints: Vec<usize>,
    /// Elements of the actions, one per coordinate of the motion; none if no actions are known to command it.
    commands: Vec<usize>,
    names: Vec<String>,
}

/// The measurements of one demonstration that [`ArmSurvey::facts`] needs.
#[derive(Debug, Clone, PartialEq)]
pub struct ArmObservation {
    state: Vec<[f64; 2]>,
    action: Vec<Extremes>,
    /// Sums over frames and coordinates: count, position, its square, square of command minus position; the first three per coordinate.
    sums: Vec<[f64; 4]>,
    /// Largest command, and largest change of a command, of each group of elements.
    largest: Vec<[f64; 2]>,
    /// Duration of a frame.
    period: Option<f64>,
    eef: bool,
    orientation: bool,
    rewards: bool,
}

/// The smallest and the largest value of an element, and how often each occurs.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Extremes {
    low: f64,
    high: f64,
    at_low: u32,
    at_high: u32,
}

impl Extremes {
    fn of(values: impl Iterator<Item = f64>) -> Self {
        let mut found = Self {
            low: f64::INFINITY,
            high: f64::NEG_INFINITY,
            at_low: 0,
            at_high: 0,
        };
        for value in values {
            if value < found.low {
                (found.low, found.at_low) = (value, 0);
            }
            if value > found.high {
                (found.high, found.at_high) = (value, 0);
            }
            found.at_low += u32::from(value == found.low);
            found.at_high += u32::from(value == found.high);
        }
        found
    }
}

/// Finds out what is known about a dataset, in one pass over its demonstrations.
#[derive(Debug, Clone)]
pub struct ArmSurvey {
    signals: Vec<SignalRow>,
    arm: Option<Arm>,
    groups: Vec<Vec<usize>>,
}

impl ArmSurvey {
    /// Starts from the names and roles of the elements. `eef` states whether the dataset has positions of the end effector.
    pub fn new(signals: Vec<SignalRow>, eef: bool) -> Self {
        let elements = |vector: SignalVector, role: SignalRole| -> Vec<usize> {
            let own = signals.iter().filter(|row| row.vector == vector && row.role == role);
            own.map(|row| row.index as usize).collect()
        };
        let names = |indices: &[usize]| -> Vec<String> {
            let name = |index: &usize| {
                let own = |row: &&SignalRow| row.vector == SignalVector::State && row.index as usize == *index;
                signals
                    .iter()
                    .find(own)
                    .map_or_else(String::new, |row| row.name.clone())
            };
            indices.iter().map(name).collect()
        };
        let (state, action) = (SignalVector::State, SignalVector::Action);
        let position = elements(action, SignalRole::EefPosition);
        let commanded = elements(action, SignalRole::Joint);
        let joints = elements(state, SignalRole::Joint);
        let (unnamed, others) = (elements(state, SignalRole::Other), elements(action, SignalRole::Other));
        let of_joints = |joints: Vec<usize>, commands: Vec<usize>| Arm {
            names: names(&joints),
            joints,
            commands,
        };
        let of_eef = |commands: Vec<usize>| Arm {
            joints: Vec::new(),
            commands,
            names: ["x", "y", "z"].map(str::to_owned).to_vec(),
        };
        let arm = if eef && position.len() == 3 {
            Some(of_eef(position))
        } else if !joints.is_empty() && joints.len() == commanded.len() {
            Some(of_joints(joints, commanded))
        } else if eef {
            Some(of_eef(Vec::new()))
        } else if !joints.is_empty() {
            Some(of_joints(joints, Vec::new()))
        } else if !unnamed.is_empty() && unnamed.len() == others.len() {
            Some(of_joints(unnamed, others))
        } else {
            None
        };
        let roles = [SignalRole::EefPosition, SignalRole::EefOrientation, SignalRole::Joint];
        let mut groups: Vec<Vec<usize>> = roles.into_iter().map(|role| elements(action, role)).collect();
        if groups.iter().all(Vec::is_empty) {
            groups = vec![elements(action, SignalRole::Other)];
        }
        groups.retain(|group| !group.is_empty());
        Self { signals, arm, groups }
    }

    /// Measures one demonstration.
    pub fn observe(&self, episode: &ArmEpisode) -> ArmObservation {
        let frames = &episode.frames;
        let width = |of: fn(&ArmColumns) -> &Vec<f64>| frames.first().map_or(0, |frame| of(frame).len());
        let column = |of: fn(&ArmColumns) -> &Vec<f64>, element: usize| {
            frames.iter().filter_map(move |frame| of(frame).get(element).copied())
        };
        let state = (0..width(|frame| &frame.state)).map(|element| {
            let found = Extremes::of(column(|frame| &frame.state, element));
            [found.low, found.high]
        });
        let action =
            (0..width(|frame| &frame.action)).map(|element| Extremes::of(column(|frame| &frame.action, element)));
        let sums = self.arm.iter().flat_map(|arm| {
            arm.commands.iter().enumerate().map(|(axis, &command)| {
                let mut sums = [0.0; 4];
                for frame in frames {
                    if let (Some(position), Some(action)) = (position(frame, arm, axis), frame.action.get(command)) {
                        let parts = [1.0, position, position * position, (action - position).powi(2)];
                        sums.iter_mut().zip(parts).for_each(|(sum, part)| *sum += part);
                    }
                }
                sums
            })
        });
        let largest = self.groups.iter().map(|group| {
            let size = |parts: &mut dyn Iterator<Item = f64>| parts.map(f64::abs).fold(0.0, f64::max);
            let of = |frame: &ArmColumns, element: &usize| frame.action.get(*element).copied().unwrap_or_default();
            let commands = frames
                .iter()
                .flat_map(|frame| group.iter().map(move |element| of(frame, element)));
            let changes = frames
                .iter()
                .zip(frames.iter().skip(1))
                .flat_map(|(now, next)| group.iter().map(move |element| of(next, element) - of(now, element)));
            [size(&mut { commands }), size(&mut { changes })]
        });
        let times: Vec<f64> = frames.iter().filter_map(|frame| frame.time).collect();
        let periods: Vec<f64> = times.windows(2).map(|pair| pair[1] - pair[0]).collect();
        ArmObservation {
            state: state.collect(),
            action: action.collect(),
            sums: sums.collect(),
            largest: largest.collect(),
            period: median(&periods),
            eef: frames.iter().any(|frame| frame.eef.is_some()),
            orientation: frames.iter().any(|frame| frame.eef_orientation.is_some()),
            rewards: frames.iter().any(|frame| frame.reward.is_some()),
        }
    }

    /// What the observations of all demonstrations say. `rule` is that of the segmentation, `rate` the frames per second that the
    /// dataset states.
    pub fn facts(
        self,
        observations: &[ArmObservation],
        gripper: Option<Gripper>,
        rule: Rule,
        rate: Option<f64>,
    ) -> ArmFacts {
        let absolute = is_absolute(observations);
        let range = |element: usize| {
            let own = || observations.iter().filter_map(|o| o.state.get(element));
            let low = own().map(|range| range[0]).fold(f64::INFINITY, f64::min);
            let high = own().map(|range| range[1]).fold(f64::NEG_INFINITY, f64::max);
            if high > low { high - low } else { 0.0 }
        };
        let scales = self.arm.as_ref().map_or_else(Vec::new, |arm| {
            let scale = |range: f64| if range > 0.0 { 1.0 / range } else { 0.0 };
            arm.joints.iter().map(|&joint| scale(range(joint))).collect()
        });
        let actions = observations.first().map_or(0, |o| o.action.len());
        let own: BTreeSet<usize> = self.groups.iter().flatten().copied().collect();
        let limits = if absolute == Some(false) {
            limits(observations, &own, actions)
        } else {
            vec![None; actions]
        };
        let typical = self.groups.iter().enumerate().map(|(group, _)| {
            let which = usize::from(absolute == Some(true));
            let sizes: Vec<f64> = observations
                .iter()
                .filter_map(|o| Some(o.largest.get(group)?[which]))
                .collect();
            median(&sizes).unwrap_or(0.0)
        });
        let periods: Vec<f64> = observations.iter().filter_map(|o| o.period).collect();
        let mut lacks = BTreeSet::from([Need::Object]);
        let mut need = |need: Need, there: bool| {
            if !there {
                lacks.insert(need);
            }
        };
        let arm = self.arm.as_ref();
        need(Need::Arm, arm.is_some());
        need(Need::Eef, observations.iter().any(|o| o.eef));
        need(Need::Orientation, observations.iter().any(|o| o.orientation));
        need(Need::Actions, !self.groups.is_empty());
        need(Need::Limits, limits.iter().any(Option::is_some));
        need(Need::Gripper, gripper.is_some() && rule == Rule::Gripper);
        need(Need::Opening, gripper.as_ref().is_some_and(|gripper| gripper.measured));
        need(
            Need::Shut,
            gripper.as_ref().is_some_and(|gripper| gripper.shut.is_some()),
        );
        need(
            Need::Command,
            gripper.as_ref().is_some_and(|gripper| gripper.commands.is_some()),
        );
        need(Need::Reward, observations.iter().any(|o| o.rewards));
        need(Need::Times, !periods.is_empty());
        let known = |row: &SignalRow| row.vector == SignalVector::State && row.role != SignalRole::Other;
        need(Need::Signals, self.signals.iter().any(known));
        ArmFacts {
            typical: typical.collect(),
            varying: (0..observations.first().map_or(0, |o| o.state.len()))
                .map(|element| range(element) > 0.0)
                .collect(),
            period: rate.map(|rate| 1.0 / rate).or_else(|| median(&periods)),
            signals: self.signals,
            arm: self.arm,
            groups: self.groups,
            absolute: absolute == Some(true),
            scales,
            limits,
            gripper,
            rate,
            lacks,
        }
    }
}

/// A coordinate of what moves.
fn position(frame: &ArmColumns, arm: &Arm, axis: usize) -> Option<f64> {
    match arm.joints.get(axis) {
        Some(&joint) => frame.state.get(joint).copied(),
        None => frame.eef.map(|eef| eef[axis]),
    }
}

/// Whether actions are targets; `None` if no actions command the arm.
fn is_absolute(observations: &[ArmObservation]) -> Option<bool> {
    let axes = observations
        .iter()
        .map(|o| o.sums.len())
        .max()
        .filter(|axes| *axes > 0)?;
    let (mut variance, mut apart) = (0.0, 0.0);
    for axis in 0..axes {
        let mut sums = [0.0; 4];
        for own in observations.iter().filter_map(|o| o.sums.get(axis)) {
            sums.iter_mut().zip(own).for_each(|(sum, part)| *sum += part);
        }
        let [count, sum, squares, differences] = sums;
        if count > 0.0 {
            variance += squares / count - (sum / count).powi(2);
            apart += differences / count;
        }
    }
    Some(apart < ABSOLUTE * variance)
}

/// The limits of the elements of the actions: the smallest and the largest number of each, as far as frames reach them exactly.
fn limits(observations: &[ArmObservation], elements: &BTreeSet<usize>, count: usize) -> Vec<Option<[f64; 2]>> {
    // Size, number of demonstrations that reach it, for each element and direction.
    let extreme = |element: usize, lowest: bool| {
        let own = observations.iter().filter_map(|o| o.action.get(element));
        let sign = if lowest { -1.0 } else { 1.0 };
        let of = move |e: &Extremes| {
            if lowest {
                (-e.low, e.at_low)
            } else {
                (e.high, e.at_high)
            }
        };
        let most = own.clone().map(|e| of(e).0).fold(f64::NEG_INFINITY, f64::max);
        let reached: Vec<u32> = own
            .map(of)
            .filter(|(value, _)| *value == most)
            .map(|(_, count)| count)
            .collect();
        (reached.iter().sum::<u32>() >= AT_LIMIT && most > 0.0).then_some((sign * most, most, reached.len()))
    };
    let sizes: Vec<f64> = elements
        .iter()
        .flat_map(|&element| [true, false].map(|lowest| extreme(element, lowest)))
        .flatten()
        .map(|(_, size, _)| size)
        .collect();
    let shared = |size: f64| sizes.iter().filter(|other| **other == size).count() > 1;
    let limit = |element: usize, lowest: bool| {
        let found = extreme(element, lowest).filter(|(_, size, demos)| *demos > 1 || shared(*size));
        found.map(|(value, ..)| value)
    };
    (0..count)
        .map(|element| {
            let ends = [limit(element, true), limit(element, false)];
            let known = elements.contains(&element) && ends.iter().any(Option::is_some);
            known.then(|| [ends[0].unwrap_or(f64::NEG_INFINITY), ends[1].unwrap_or(f64::INFINITY)])
        })
        .collect()
}

/// What is known about a dataset of an arm.
#[derive(Debug, Clone, PartialEq)]
pub struct ArmFacts {
    signals: Vec<SignalRow>,
    arm: Option<Arm>,
    groups: Vec<Vec<usize>>,
    /// Size of a large command of each group.
    typical: Vec<f64>,
    scales: Vec<f64>,
    limits: Vec<Option<[f64; 2]>>,
    /// Whether each element of the state varies in the dataset.
    varying: Vec<bool>,
    /// Whether actions are targets.
    pub absolute: bool,
    /// The meaning of the gripper's numbers.
    pub gripper: Option<Gripper>,
    /// Frames per second that the dataset states.
    pub rate: Option<f64>,
    /// Duration of a frame, in s.
    pub period: Option<f64>,
    lacks: BTreeSet<Need>,
}

impl ArmFacts {
    /// What the thresholds depend on.
    pub fn dataset(&self) -> Dataset {
        Dataset {
            lacks: self.lacks.clone(),
            rate: self.rate.or(self.period.map(|period| 1.0 / period)),
            ..Dataset::new(Domain::Arm, SHUT)
        }
    }

    /// What moves, as the subject of a sentence.
    pub(crate) fn subject(&self) -> &'static str {
        match &self.arm {
            Some(arm) if !arm.joints.is_empty() => "the arm",
            _ => "the end effector",
        }
    }

    /// Names of the coordinates of the motion.
    pub(crate) fn axes(&self) -> Vec<&str> {
        let names = self.arm.as_ref().map_or(&[] as &[String], |arm| &arm.names);
        names.iter().map(String::as_str).collect()
    }

    /// Number of coordinates of the motion.
    fn width(&self) -> usize {
        self.arm
            .as_ref()
            .map_or(0, |arm| if arm.joints.is_empty() { 3 } else { arm.joints.len() })
    }

    /// Positions of what moves: the end effector in m, or joints as fractions of their ranges in the dataset.
    pub(crate) fn positions(&self, frames: &[ArmColumns]) -> Rows {
        let width = self.width();
        let values = frames
            .iter()
            .flat_map(|frame| (0..width).map(|axis| self.at(frame, axis)));
        Rows::new(width, values)
    }

    fn at(&self, frame: &ArmColumns, axis: usize) -> f64 {
        let scale = self.scales.get(axis).copied().unwrap_or(1.0);
        let position = self.arm.as_ref().and_then(|arm| position(frame, arm, axis));
        position.unwrap_or_default() * scale
    }

    /// The commanded displacements of what moves; `None` if no actions command it.
    pub(crate) fn commands(&self, frames: &[ArmColumns]) -> Option<Rows> {
        let arm = self.arm.as_ref().filter(|arm| !arm.commands.is_empty())?;
        let values = frames.iter().flat_map(|frame| {
            arm.commands.iter().enumerate().map(|(axis, &command)| {
                let scale = self.scales.get(axis).copied().unwrap_or(1.0);
                let action = frame.action.get(command).copied().unwrap_or_default() * scale;
                if self.absolute {
                    action - self.at(frame, axis)
                } else {
                    action
                }
            })
        });
        Some(Rows::new(arm.commands.len(), values))
    }

    /// Whether the arm is hardly commanded to move, frame by frame: displacements, or changes of targets, are less than a twentieth of
    /// large ones.
    pub(crate) fn idle(&self, frames: &[ArmColumns]) -> Vec<bool> {
        let value = |frame: &ArmColumns, element: usize| frame.action.get(element).copied().unwrap_or_default();
        (0..frames.len())
            .map(|place| {
                let now = &frames[place];
                // No change follows the last target, so the change before it counts.
                let (from, to) = match frames.get(place + 1) {
                    Some(next) => (now, next),
                    None => (&frames[place.saturating_sub(1)], now),
                };
                self.groups.iter().zip(&self.typical).all(|(group, typical)| {
                    let part = |&element: &usize| {
                        if self.absolute {
                            value(to, element) - value(from, element)
                        } else {
                            value(now, element)
                        }
                    };
                    norm(&group.iter().map(part).collect::<Vec<_>>()) < IDLE * typical
                })
            })
            .map(|idle| idle && !self.groups.is_empty())
            .collect()
    }

    /// Whether an element of the state is commanded to move in the step from a frame to the next one; true if nothing is known to
    /// command this element.
    pub(crate) fn is_commanded(&self, frames: &[ArmColumns], step: usize, element: usize) -> bool {
        let positions = |row: &&SignalRow| row.vector == SignalVector::State && row.role == SignalRole::EefPosition;
        let axis = self.arm.as_ref().and_then(|arm| {
            if arm.joints.is_empty() {
                let mut own = self.signals.iter().filter(positions);
                own.position(|row| row.index as usize == element)
            } else {
                arm.joints.iter().position(|joint| *joint == element)
            }
        });
        let command = axis.and_then(|axis| self.arm.as_ref()?.commands.get(axis));
        let Some(command) = command else { return true };
        let group = self.groups.iter().position(|group| group.contains(command));
        let typical = group.and_then(|group| self.typical.get(group)).copied().unwrap_or(0.0);
        let value = |frame: usize| frames.get(frame).and_then(|frame| frame.action.get(*command)).copied();
        let size = if self.absolute {
            value(step + 1).zip(value(step)).map(|(next, now)| next - now)
        } else {
            value(step)
        };
        size.is_some_and(|size| size.abs() >= IDLE * typical)
    }

    /// Fraction of the frames in which at least one and at least two controls are at their limits.
    pub(crate) fn saturated(&self, frames: &[ArmColumns]) -> [f64; 2] {
        let at_limit = |frame: &ArmColumns| {
            let limits = frame.action.iter().zip(&self.limits);
            limits
                .filter(|(value, limit)| limit.is_some_and(|[low, high]| **value <= low || **value >= high))
                .count()
        };
        [1, 2].map(|least| {
            frames.iter().filter(|frame| at_limit(frame) >= least).count() as f64 / frames.len().max(1) as f64
        })
    }

    /// The elements of the state with the same role as others, which move in the dataset: index and name, by role.
    pub(crate) fn signal_groups(&self) -> Vec<Vec<(usize, &str)>> {
        let roles = [SignalRole::Joint, SignalRole::EefPosition, SignalRole::EefOrientation];
        let groups = roles.into_iter().map(|role| {
            let own = self
                .signals
                .iter()
                .filter(|row| row.vector == SignalVector::State && row.role == role);
            own.map(|row| (row.index as usize, row.name.as_str()))
                .filter(|(index, _)| self.varying.get(*index) == Some(&true))
                .collect::<Vec<_>>()
        });
        groups.filter(|group| group.len() > 1).collect()
    }
}

/// A gripper that settles below this fraction of its travel is shut: the paper's value for a failed grasp, 1 cm, as a fraction of the
/// opening of the simulated gripper, 8 cm.
pub(crate) const SHUT: f64 = 0.125;
