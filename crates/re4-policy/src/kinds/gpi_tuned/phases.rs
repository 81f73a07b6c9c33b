//! Phases of the demonstrations and of a rollout, with thresholds that are calibrated from the demonstrations.

use nalgebra::{Isometry3, Vector3};
use re4_rollout::ArmState;

use super::frames::{Frame, apart, in_object_frame, off_target};
use super::tuning::{OPEN, Rule, Tuning};

/// Phase of a task.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Stage {
    Pick,
    Lift,
    Transport,
    PreInsert,
    Insert,
}

impl Stage {
    const ALL: [Self; 5] = [Self::Pick, Self::Lift, Self::Transport, Self::PreInsert, Self::Insert];

    pub(super) fn as_str(self) -> &'static str {
        match self {
            Self::Pick => "pick",
            Self::Lift => "lift",
            Self::Transport => "transport",
            Self::PreInsert => "pre_insert",
            Self::Insert => "insert",
        }
    }

    pub(super) fn next(self) -> Self {
        Self::ALL[(self as usize + 1).min(4)]
    }
}

/// Number of steps from lifting to transport.
pub(super) const LIFT_STEPS: usize = 24;

/// The phase of a frame of a demonstration.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Label {
    pub(super) stage: Stage,
    /// Number of frames since the phase began.
    pub(super) since: usize,
    /// Whether the frame is near the start of the lift.
    pub(super) lift_start: bool,
}

/// Thresholds of the phases, in metres.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Thresholds {
    pub(super) lift_delta: f64,
    pub(super) contact: f64,
    pub(super) close: f64,
    pub(super) transport: f64,
    pub(super) pre_insert: f64,
    pub(super) insert: f64,
    pub(super) insert_height: f64,
}

/// Mean, standard deviation and largest accepted z-score of the numbers before a lift: position of the grip site in the frame of
/// the object, and finger positions.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Window {
    scores: [(f64, f64); 5],
    limits: [f64; 2],
}

impl Window {
    fn z(&self, arm: &ArmState, object: &Isometry3<f64>) -> [f64; 2] {
        let values = window_values(arm, object);
        let z: [f64; 5] = std::array::from_fn(|i| ((values[i] - self.scores[i].0) / self.scores[i].1).abs());
        [z[0].max(z[1]).max(z[2]), z[3].max(z[4])]
    }
}

fn window_values(arm: &ArmState, object: &Isometry3<f64>) -> [f64; 5] {
    let p = in_object_frame(arm, object);
    [p.x, p.y, p.z, arm.fingers[0], arm.fingers[1]]
}

/// What the demonstrations say about phases.
pub(super) struct Phases {
    rule: Rule,
    target: Vector3<f64>,
    pub(super) thresholds: Thresholds,
    pub(super) labels: Vec<Label>,
    window: Option<Window>,
}

/// Frames at which something happens in a demonstration.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
struct Events {
    /// Height of the object on the table.
    table: f64,
    lifted: Option<usize>,
    closed: Option<usize>,
    transport: Option<usize>,
    pre_insert: Option<usize>,
    insert: Option<usize>,
}

impl Events {
    fn find(demo: &[Frame], rule: Rule, limits: &Thresholds, target: &Vector3<f64>) -> Self {
        let mut heights: Vec<f64> = demo.iter().take(40).map(Frame::height).collect();
        let table = percentile(&mut heights, 0.05);
        let high: Vec<bool> = demo.iter().map(|f| f.height() >= table + limits.lift_delta).collect();
        let lifted = high.windows(3).position(|three| three.iter().all(|high| *high));
        let opened = demo.iter().position(|f| f.arm.fingers[0] > OPEN);
        let closed = opened.and_then(|opened| {
            let after = demo.iter().skip(opened + 1);
            let found = after
                .enumerate()
                .find(|(_, f)| f.arm.fingers[0] <= limits.close && f.apart() <= limits.contact);
            found.map(|(i, _)| opened + 1 + i)
        });
        let mut events = Self {
            table,
            lifted,
            closed,
            ..Self::default()
        };
        let Some(lifted) = lifted else { return events };
        let from = |start: usize, reached: &dyn Fn(&Frame) -> bool| {
            let found = demo.iter().enumerate().skip(start).find(|(_, frame)| reached(frame));
            found.map(|(at, _)| at)
        };
        match rule {
            Rule::Lift => {}
            Rule::Can => events.transport = Some(lifted + LIFT_STEPS).filter(|at| *at < demo.len()),
            Rule::Square => {
                events.transport = from(lifted, &|f| f.off_target(target) <= limits.transport)
                    .map(|at| at.max(lifted + LIFT_STEPS))
                    .filter(|at| *at < demo.len());
                events.pre_insert = events
                    .transport
                    .and_then(|start| from(start, &|f| f.off_target(target) <= limits.pre_insert));
                events.insert = events.pre_insert.and_then(|start| {
                    from(start, &|f| {
                        f.off_target(target) <= limits.insert && f.height() <= limits.insert_height
                    })
                });
            }
        }
        events
    }

    fn lift_start(&self) -> Option<usize> {
        let lifted = self.lifted?.saturating_sub(4);
        Some(
            self.closed
                .map_or(lifted, |closed| closed.saturating_sub(4).min(lifted)),
        )
    }

    fn labels(&self, length: usize) -> Vec<Label> {
        let starts = [
            (Stage::Lift, self.lift_start()),
            (Stage::Transport, self.transport),
            (Stage::PreInsert, self.pre_insert),
            (Stage::Insert, self.insert),
        ];
        let window = match (self.lift_start(), self.lifted) {
            (Some(start), Some(lifted)) => start..(start + 1).max(lifted + 12),
            _ => 0..0,
        };
        let label = |t: usize| {
            let (mut stage, mut began) = (Stage::Pick, 0);
            for (next, start) in starts {
                if let Some(start) = start.filter(|start| *start <= t) {
                    (stage, began) = (next, start);
                }
            }
            Label {
                stage,
                since: t - began,
                lift_start: window.contains(&t),
            }
        };
        (0..length).map(label).collect()
    }
}

impl Phases {
    /// Labels the demonstrations and calibrates the thresholds.
    pub(super) fn fit(tuning: &Tuning, target: Vector3<f64>, frames: &[Frame]) -> Self {
        let demos: Vec<&[Frame]> = frames.chunk_by(|a, b| a.demo == b.demo).collect();
        let mut limits = Thresholds {
            lift_delta: tuning.lift_delta,
            contact: tuning.contact,
            close: tuning.close,
            transport: 0.16,
            pre_insert: 0.08,
            insert: 0.04,
            insert_height: 0.94,
        };
        let find = |limits: &Thresholds| -> Vec<Events> {
            demos
                .iter()
                .map(|demo| Events::find(demo, tuning.rule, limits, &target))
                .collect()
        };
        if tuning.rule == Rule::Square {
            let events = find(&limits);
            calibrate_insertion(&mut limits, &demos, &events, &target);
        }
        let events = find(&limits);
        let labels = demos
            .iter()
            .zip(&events)
            .flat_map(|(demo, events)| events.labels(demo.len()))
            .collect();
        let window = calibrate_lift(&mut limits, &demos, &events);
        Self {
            rule: tuning.rule,
            target,
            thresholds: limits,
            labels,
            window,
        }
    }

    /// Whether the gripper has just grasped the object, as in the frames before a lift.
    fn grasped(&self, live: &Live, arm: &ArmState, object: &Isometry3<f64>) -> bool {
        let Some(window) = &self.window else { return false };
        let z = window.z(arm, object);
        live.opened
            && arm.fingers[0] <= self.thresholds.close
            && apart(arm, object) <= self.thresholds.contact
            && z.iter().zip(window.limits).all(|(z, limit)| *z <= limit)
    }
}

/// Sets the thresholds of Square's last phases to the largest values at which they begin in a demonstration, plus a margin.
fn calibrate_insertion(limits: &mut Thresholds, demos: &[&[Frame]], events: &[Events], target: &Vector3<f64>) {
    let largest = |of: &dyn Fn(&[Frame], &Events) -> Option<f64>| {
        demos
            .iter()
            .zip(events)
            .filter_map(|(demo, events)| of(demo, events))
            .reduce(f64::max)
    };
    let off = |demo: &[Frame], at: Option<usize>| Some(demo.get(at?)?.off_target(target));
    let last = |demo: &[Frame]| demo.len().checked_sub(1);
    if let Some(value) = largest(&|demo, events| off(demo, events.transport)) {
        limits.transport = value + 0.005;
    }
    if let Some(value) = largest(&|demo, events| off(demo, events.pre_insert)) {
        limits.pre_insert = value + 0.003;
    }
    if let Some(value) = largest(&|demo, events| Some(off(demo, events.insert)?.max(off(demo, last(demo))?))) {
        limits.insert = value + 0.002;
    }
    let height = |demo: &[Frame], at: Option<usize>| Some(demo.get(at?)?.height());
    if let Some(value) = largest(&|demo, events| Some(height(demo, events.insert)?.max(height(demo, last(demo))?))) {
        limits.insert_height = value + 0.002;
    }
    limits.pre_insert = limits.pre_insert.min(limits.transport);
    limits.insert = limits.insert.min(limits.pre_insert);
}

/// Calibrates the thresholds of lifting and of the grasp from the frames before each lift.
fn calibrate_lift(limits: &mut Thresholds, demos: &[&[Frame]], events: &[Events]) -> Option<Window> {
    let mut least = f64::INFINITY;
    let (mut contact, mut close) = (f64::NEG_INFINITY, f64::NEG_INFINITY);
    let mut samples: Vec<&Frame> = Vec::new();
    for (demo, events) in demos.iter().zip(events) {
        let Some(lifted) = events.lifted else { continue };
        least = least.min(demo[lifted].height() - events.table);
        for frame in &demo[lifted.saturating_sub(4)..=lifted] {
            contact = contact.max(frame.apart());
            close = close.max(frame.arm.fingers[0]);
            samples.push(frame);
        }
    }
    if samples.is_empty() {
        return None;
    }
    limits.lift_delta = least - 0.002;
    limits.contact = contact + 0.005;
    limits.close = close + 0.003;
    let count = samples.len() as f64;
    let values: Vec<[f64; 5]> = samples.iter().map(|f| window_values(&f.arm, &f.object)).collect();
    let scores = std::array::from_fn(|i| {
        let mean = values.iter().map(|v| v[i]).sum::<f64>() / count;
        let variance = values.iter().map(|v| (v[i] - mean) * (v[i] - mean)).sum::<f64>() / count;
        (mean, variance.sqrt().max(0.01))
    });
    let mut window = Window {
        scores,
        limits: [0.0; 2],
    };
    let z = samples.iter().map(|f| window.z(&f.arm, &f.object));
    let largest = z.fold([0.0f64; 2], |most, z| [most[0].max(z[0]), most[1].max(z[1])]);
    window.limits = largest.map(|limit| limit + 0.25);
    Some(window)
}

/// The percentile of values, with linear interpolation. Sorts the values.
fn percentile(values: &mut [f64], part: f64) -> f64 {
    values.sort_by(f64::total_cmp);
    let Some(last) = values.len().checked_sub(1) else {
        return 0.0;
    };
    let place = part * last as f64;
    let below = place.floor() as usize;
    let above = (below + 1).min(last);
    values[below] + (values[above] - values[below]) * (place - place.floor())
}

/// The phase of a rollout.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Live {
    /// Lowest height of the object so far.
    table: f64,
    opened: bool,
    since_lift: usize,
    pub(super) stage: Stage,
    pub(super) grasped: bool,
}

impl Live {
    pub(super) fn new() -> Self {
        Self {
            table: f64::INFINITY,
            opened: false,
            since_lift: 0,
            stage: Stage::Pick,
            grasped: false,
        }
    }

    /// Updates the phase by an observation.
    pub(super) fn observe(&mut self, phases: &Phases, arm: &ArmState, object: &Isometry3<f64>) {
        let height = object.translation.z;
        self.table = self.table.min(height);
        let lifted = height >= self.table + phases.thresholds.lift_delta;
        if lifted {
            let raw = phases.raw_stage(object, self.since_lift);
            self.stage = self.stage.max(raw.min(self.stage.next()));
            self.since_lift += 1;
        } else {
            (self.stage, self.since_lift) = (Stage::Pick, 0);
        }
        self.grasped = !lifted && phases.grasped(self, arm, object);
        self.opened |= arm.fingers[0] > OPEN;
    }
}

impl Phases {
    /// The phase of a lifted object by the thresholds.
    pub(super) fn raw_stage(&self, object: &Isometry3<f64>, since_lift: usize) -> Stage {
        let limits = &self.thresholds;
        let off = off_target(object, &self.target);
        match self.rule {
            Rule::Can if since_lift >= LIFT_STEPS => Stage::Transport,
            Rule::Square if off <= limits.insert && object.translation.z <= limits.insert_height => Stage::Insert,
            Rule::Square if off <= limits.pre_insert => Stage::PreInsert,
            Rule::Square if off <= limits.transport => Stage::Transport,
            Rule::Lift | Rule::Can | Rule::Square => Stage::Lift,
        }
    }
}
