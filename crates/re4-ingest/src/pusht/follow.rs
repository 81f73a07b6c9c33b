//! Checks that the agent follows its targets.
//!
//! A controller pulls the agent of Push-T towards the target of its action: each step is exactly a weighted sum of the offset to
//! the target and the previous step. In the original dataset the weights are 0.314 and 0.234. Of the variance of the steps that
//! the previous step leaves unexplained, the offset to the target explains 99.6 %. Actions of another kind, in another unit or in
//! another row explain almost nothing of it, so that the kind of actions can be recognized.

use std::ops::Range;

use super::conventions::{ActionKind, PushtConventions, rounded};
use super::episodes::PushtEpisodes;
use super::validate::WINDOW;
use crate::error::Fault;

/// Minimum number of steps along either axis with motion for judging the dataset.
const MIN_STEPS: usize = 100;

/// The same for a single episode.
const MIN_STEPS_IN_EPISODE: usize = 60;

/// Minimum length of a step along an axis that counts as motion, in pixels.
const MIN_STEP: f64 = 0.2;

/// Minimum RMS of the part of a step that the previous step does not explain, in pixels. Below it, the controller's effect is not
/// measurable.
const MIN_CHANGE: f64 = 0.5;

/// Minimum fraction of the variance that the targets must explain. Targets of the original dataset explain 0.996; relative
/// targets read as absolute ones explain 0.01; those of the previous or the next row explain 0.5 and 0.84.
const MIN_EXPLAINED: f64 = 0.5;

/// Minimum explained fraction to accept another interpretation of the actions.
const MIN_ACCEPTED: f64 = 0.9;

/// Explained fraction below which there is a warning.
pub(super) const USUAL: f64 = 0.9;

/// Fraction of the offset to the target that the agent covers in one step (0.1 s) of the original dataset.
const REACH: f64 = 0.314;

/// Maximum error of the targets, in pixels, before another unit is assumed. Fits of single episodes deviate by up to 7.
const MAX_ERROR: f64 = 10.0;

/// Result of checking the actions against the agent's steps.
pub(super) struct Following {
    /// Fraction of the variance of the agent's steps that the targets explain; `None` if there is too little motion.
    pub(super) explained: Option<f64>,
    /// Contradiction of the dataset as a whole.
    pub(super) fault: Option<Fault>,
    /// Indices of episodes in which the agent does not follow its targets, unlike in the dataset as a whole, with the explained
    /// fraction.
    pub(super) outliers: Vec<(usize, f64)>,
}

/// A step of the agent along one axis. All values are in pixels except the action, which is as in the dataset.
#[derive(Clone, Copy)]
struct Step {
    /// Displacement from this row to the next.
    onward: f64,
    /// Displacement from the previous row to this one.
    before: f64,
    /// Position of the agent.
    agent: f64,
    /// The row's action.
    action: f64,
    /// The row's target.
    target: f64,
    /// The target of the previous row.
    earlier: f64,
    /// The target of the next row.
    later: f64,
    /// Axis, 0 or 1.
    axis: usize,
}

/// Checks the actions of the good episodes against the agent's steps. `episodes` is converted; `actions` are as in the dataset.
pub(super) fn judge(
    conventions: &PushtConventions,
    episodes: &PushtEpisodes,
    actions: &[[f64; 2]],
    good: &[bool],
) -> Following {
    let of = |frames: &Range<usize>| steps(conventions, episodes, actions, frames);
    let each: Vec<Vec<Step>> = episodes
        .frames
        .iter()
        .zip(good)
        .map(|(frames, good)| if *good { of(frames) } else { Vec::new() })
        .collect();
    let all = each.concat();
    let mut following = Following {
        explained: None,
        fault: None,
        outliers: Vec::new(),
    };
    let Some(unexplained) = evidence(&all, MIN_STEPS) else {
        return following;
    };
    let (explained, [reach, _]) = explain(&all, unexplained, |step| [step.target - step.agent, step.before]);
    following.explained = Some(explained);
    following.fault = fault(
        conventions,
        &episodes.recorded.action,
        &all,
        unexplained,
        explained,
        reach,
    );
    if following.fault.is_none() {
        following.outliers = each
            .iter()
            .enumerate()
            .filter_map(|(number, steps)| {
                let unexplained = evidence(steps, MIN_STEPS_IN_EPISODE)?;
                let (explained, _) = explain(steps, unexplained, |step| [step.target - step.agent, step.before]);
                (explained < MIN_EXPLAINED).then_some((number, explained))
            })
            .collect();
    }
    following
}

fn steps(
    conventions: &PushtConventions,
    episodes: &PushtEpisodes,
    actions: &[[f64; 2]],
    frames: &Range<usize>,
) -> Vec<Step> {
    let agent = |frame: usize| [episodes.state[frame][0], episodes.state[frame][1]];
    let target = |frame: usize| conventions.target(agent(frame), actions[frame]);
    let inner = frames.start + 1..frames.end.saturating_sub(1).max(frames.start + 1);
    inner
        .flat_map(|frame| {
            let [before, here, after] = [agent(frame - 1), agent(frame), agent(frame + 1)];
            let [earlier, now, later] = [target(frame - 1), target(frame), target(frame + 1)];
            [0, 1].map(|axis| Step {
                onward: after[axis] - here[axis],
                before: here[axis] - before[axis],
                agent: here[axis],
                action: actions[frame][axis],
                target: now[axis],
                earlier: earlier[axis],
                later: later[axis],
                axis,
            })
        })
        .collect()
}

/// Sum of squares of the steps that the previous step does not explain; `None` if there is too little motion.
fn evidence(steps: &[Step], enough: usize) -> Option<f64> {
    let moves = |step: &&Step| step.onward.abs() > MIN_STEP || step.before.abs() > MIN_STEP;
    let moving = steps.iter().filter(moves).count();
    let (_, left) = fit(steps.iter().map(|step| ([step.before], step.onward)));
    (moving >= enough && (left / moving as f64).sqrt() >= MIN_CHANGE).then_some(left)
}

/// Fraction of that sum of squares that the quantities of `of` explain, and their weights.
fn explain<const N: usize>(steps: &[Step], unexplained: f64, of: impl Fn(&Step) -> [f64; N]) -> (f64, [f64; N]) {
    let (weights, left) = fit(steps.iter().map(|step| (of(step), step.onward)));
    ((1.0 - left / unexplained).clamp(0.0, 1.0), weights)
}

/// Least-squares fit. Returns the weights and the residual sum of squares.
fn fit<const N: usize>(rows: impl Iterator<Item = ([f64; N], f64)> + Clone) -> ([f64; N], f64) {
    let mut squares = [[0.0; N]; N];
    let mut products = [0.0; N];
    for (row, value) in rows.clone() {
        for i in 0..N {
            products[i] += row[i] * value;
            for j in 0..N {
                squares[i][j] += row[i] * row[j];
            }
        }
    }
    let weights = solve(squares, products);
    let left = rows
        .map(|(row, value)| {
            let fitted: f64 = row.iter().zip(&weights).map(|(value, weight)| value * weight).sum();
            (value - fitted).powi(2)
        })
        .sum();
    (weights, left)
}

/// Solves the normal equations by elimination. A quantity that is linearly dependent on those before it gets the weight 0.
fn solve<const N: usize>(mut squares: [[f64; N]; N], mut products: [f64; N]) -> [f64; N] {
    // Scale all quantities to unit size, so that a small pivot is distinguishable from rounding errors.
    let sizes: [f64; N] = std::array::from_fn(|i| squares[i][i].sqrt().max(f64::MIN_POSITIVE));
    for i in 0..N {
        products[i] /= sizes[i];
        for j in 0..N {
            squares[i][j] /= sizes[i] * sizes[j];
        }
    }
    let mut used = [true; N];
    for i in 0..N {
        if squares[i][i] < 1e-10 {
            used[i] = false;
            continue;
        }
        for other in 0..N {
            if other != i {
                let factor = squares[other][i] / squares[i][i];
                let pivot = squares[i];
                for (value, pivot) in squares[other].iter_mut().zip(pivot) {
                    *value -= factor * pivot;
                }
                products[other] -= factor * products[i];
            }
        }
    }
    std::array::from_fn(|i| {
        if used[i] {
            products[i] / squares[i][i] / sizes[i]
        } else {
            0.0
        }
    })
}

/// Targets as a linear function of the actions of one axis, in pixels.
#[derive(Clone, Copy)]
struct Line {
    scale: f64,
    offset: f64,
}

impl Line {
    fn at(self, action: f64) -> f64 {
        self.scale * action + self.offset
    }

    /// Actions at the edges of the window.
    fn window(self) -> [f64; 2] {
        [-self.offset / self.scale, (WINDOW - self.offset) / self.scale]
    }
}

/// Fits a line for each axis to the steps. Returns the fraction that they explain, and the lines.
fn lines(steps: &[Step]) -> Option<(f64, [Line; 2])> {
    let mut lines = [Line {
        scale: 1.0,
        offset: 0.0,
    }; 2];
    let (mut left, mut open) = (0.0, 0.0);
    for (axis, line) in lines.iter_mut().enumerate() {
        let of_axis: Vec<Step> = steps.iter().filter(|step| step.axis == axis).copied().collect();
        let rows = of_axis
            .iter()
            .map(|step| ([step.action, step.agent, 1.0, step.before], step.onward));
        let ([action, agent, one, _], rest) = fit(rows);
        // The weight of the agent's position is minus the fraction of the offset that a step covers. Without such a pull to a
        // target, the line is undefined.
        if agent > -0.05 {
            return None;
        }
        *line = Line {
            scale: action / -agent,
            offset: one / -agent,
        };
        left += rest;
        open += fit(of_axis.iter().map(|step| ([step.before], step.onward))).1;
    }
    Some((1.0 - left / open, lines))
}

fn percent(fraction: f64) -> String {
    format!("{:.0} %", 100.0 * fraction)
}

/// Returns what is wrong with the actions, if anything.
fn fault(
    conventions: &PushtConventions,
    actions: &str,
    steps: &[Step],
    unexplained: f64,
    explained: f64,
    reach: f64,
) -> Option<Fault> {
    let settings = conventions.action_settings();
    let relative = conventions.action == Some(ActionKind::Relative);
    let describe = |then: &str| {
        let with = settings
            .as_ref()
            .map_or_else(String::new, |settings| format!("with {settings}, "));
        let kind = if relative { "relative" } else { "absolute" };
        format!(
            "{with}{actions} explains {} of the change in the agent's steps if read as {kind} targets{then}",
            percent(explained)
        )
    };
    let convention = |what: String, fix: String| Some(Fault::Convention { what, fix });
    let (of_relative, [weight, carried]) = explain(steps, unexplained, |step| [step.action, step.before]);
    let fitted = lines(steps);
    if relative && explained >= MIN_EXPLAINED {
        return wrong_reach(conventions, reach, carried, &describe);
    }
    // Another interpretation must explain the motion well by itself, and much better than that of the settings.
    let better = |other: f64| {
        if explained < MIN_EXPLAINED {
            other >= MIN_ACCEPTED
        } else {
            other >= 0.97 && other > explained + 0.05
        }
    };
    if !relative && better(of_relative) {
        if is_displacement(weight, carried, of_relative) {
            return Some(displacement(&describe(
                ", and all of it as the agent's own displacement to the next row",
            )));
        }
        let what = describe(&format!(
            ", and {} as targets relative to the agent",
            percent(of_relative)
        ));
        let pixels = weight / REACH;
        let scale = if (0.4..=3.0).contains(&(pixels / conventions.pixels_per_unit())) {
            String::new()
        } else {
            format!(
                " and ingest.pusht.action_scale to the number of pixels per unit of an action, about {}",
                usual_scale(pixels)
            )
        };
        return convention(what, format!("set ingest.pusht.action = \"relative\"{scale}"));
    }
    if let Some((fraction, lines)) = fitted {
        if relative && better(fraction) {
            let what = describe(&format!(", and {} as absolute targets", percent(fraction)));
            return convention(what, "remove ingest.pusht.action".to_owned());
        }
        let off = farthest(conventions, lines);
        let is_off = fraction >= 0.95 && off > MAX_ERROR && steps.len() >= 4 * MIN_STEPS;
        if !relative && (is_off || off > MAX_ERROR && better(fraction)) {
            let off = (explained >= MIN_EXPLAINED).then_some(off);
            return Some(other_window(conventions, actions, &describe, fraction, lines, off));
        }
    }
    if explained >= MIN_EXPLAINED {
        return other_row(actions, steps, unexplained, explained, &describe);
    }
    let row = other_row(actions, steps, unexplained, explained, &describe);
    row.or_else(|| {
        convention(
            describe(&format!(
                ", and {} as relative targets (absolute targets of the original dataset explain 99.6 %)",
                percent(of_relative)
            )),
            "write to each row the absolute target that applies from its state on, in the unit of the states, or write that target relative to the agent and set ingest.pusht.action = \"relative\""
                .to_owned(),
        )
    })
}

/// Checks the unit of relative actions.
fn wrong_reach(
    conventions: &PushtConventions,
    reach: f64,
    carried: f64,
    describe: &impl Fn(&str) -> String,
) -> Option<Fault> {
    let scale = conventions.pixels_per_action();
    if is_displacement(reach * scale, carried, 1.0) {
        return Some(displacement(&describe(
            ", and all of it as the agent's own displacement to the next row",
        )));
    }
    let pixels = reach * scale / REACH;
    (!(0.4..=3.0).contains(&(pixels / scale))).then(|| Fault::Convention {
        what: describe(&format!(
            ", but a step covers {} of the distance to such a target, and about a third is usual",
            rounded(reach)
        )),
        fix: format!(
            "set ingest.pusht.action_scale to the number of pixels per unit of an action, about {}",
            usual_scale(pixels)
        ),
    })
}

/// Whether an action is the agent's step itself, not a target.
fn is_displacement(weight: f64, carried: f64, fraction: f64) -> bool {
    (weight - 1.0).abs() < 0.02 && carried.abs() < 0.02 && fraction > 0.999
}

fn displacement(what: &str) -> Fault {
    Fault::Convention {
        what: what.to_owned(),
        fix: "write target positions instead: the agent moves about a third of the distance to its target in one step, so a displacement is not a target".to_owned(),
    }
}

/// Checks whether the targets of the previous or the next row explain the motion better.
fn other_row(
    actions: &str,
    steps: &[Step],
    unexplained: f64,
    explained: f64,
    describe: &impl Fn(&str) -> String,
) -> Option<Fault> {
    let (of_earlier, _) = explain(steps, unexplained, |step| [step.earlier - step.agent, step.before]);
    let (of_later, _) = explain(steps, unexplained, |step| [step.later - step.agent, step.before]);
    let (fraction, row, move_by) = if of_earlier > of_later {
        (of_earlier, "previous", "down")
    } else {
        (of_later, "next", "up")
    };
    (fraction >= 0.97 && fraction > explained + 0.05).then(|| Fault::Convention {
        what: describe(&format!(", and {} as the targets of the {row} row", percent(fraction))),
        fix: format!(
            "move {actions} {move_by} by one row within each episode, so that each row has the target that applies from its state on"
        ),
    })
}

/// Maximum distance at the edges of the window between the targets by the settings and the fitted targets, in pixels.
fn farthest(conventions: &PushtConventions, lines: [Line; 2]) -> f64 {
    let window = conventions
        .action_window
        .or(conventions.window)
        .unwrap_or([0.0, WINDOW]);
    let edges = [(window[0], 0.0), (window[1], WINDOW)];
    lines
        .iter()
        .flat_map(|line| edges.map(|(action, target)| (line.at(action) - target).abs()))
        .fold(0.0, f64::max)
}

/// The fault of absolute targets in another unit, with the window that fits.
fn other_window(
    conventions: &PushtConventions,
    actions: &str,
    describe: &impl Fn(&str) -> String,
    fraction: f64,
    lines: [Line; 2],
    off: Option<f64>,
) -> Fault {
    let windows = lines.map(Line::window);
    let width = (windows[0][1] - windows[0][0]).abs();
    let alike = |a: [f64; 2], b: [f64; 2], slack: f64| (a[0] - b[0]).abs() <= slack && (a[1] - b[1]).abs() <= slack;
    // The same tolerance as `MAX_ERROR`, in units of actions, so that the suggested window passes this check.
    let slack = MAX_ERROR / WINDOW * width;
    let usual = [
        [0.0, WINDOW],
        [-1.0, 1.0],
        [0.0, 1.0],
        [0.0, 96.0],
        [-256.0, 256.0],
        [0.0, 1024.0],
    ]
    .into_iter()
    .find(|usual| windows.iter().all(|window| alike(*window, *usual, slack)));
    let off = off.map_or_else(String::new, |off| {
        format!(", but the targets are off by up to {off:.0} px")
    });
    let of_axes = |axes: [&str; 2]| {
        windows
            .iter()
            .zip(axes)
            .map(|([low, high], axis)| format!("{} to {}{axis}", rounded(*low), rounded(*high)))
            .collect::<Vec<_>>()
            .join(" and ")
    };
    let what = describe(&format!(
        "{off}, and {} if its window is {}",
        percent(fraction),
        of_axes([" along x", " along y"])
    ));
    let points_up = |[low, high]: [f64; 2]| high < low;
    let fix = if points_up(windows[1]) && !points_up(windows[0]) {
        format!("flip y in {actions}, because it points up there but down in the states")
    } else {
        match usual {
            Some(window)
                if Some(window) == conventions.window || window == [0.0, WINDOW] && conventions.window.is_none() =>
            {
                "remove ingest.pusht.action_window".to_owned()
            }
            Some([low, high]) => format!("set ingest.pusht.action_window = [{low}, {high}]"),
            None if alike(windows[0], windows[1], slack) => format!(
                "set ingest.pusht.action_window = [{}, {}]",
                rounded(f64::midpoint(windows[0][0], windows[1][0])),
                rounded(f64::midpoint(windows[0][1], windows[1][1]))
            ),
            None => format!(
                "undo the scaling of each axis: the target is {} in x and {} in y, in pixels",
                formula(lines[0]),
                formula(lines[1])
            ),
        }
    };
    Fault::Convention { what, fix }
}

fn formula(line: Line) -> String {
    format!("{} * action + {}", rounded(line.scale), rounded(line.offset))
}

/// The usual scale near a fitted one, or the fitted one.
fn usual_scale(pixels: f64) -> f64 {
    [1.0, WINDOW / 96.0, 10.0, 20.0, 50.0, 100.0, 256.0, WINDOW]
        .into_iter()
        .find(|usual| (0.75..=1.33).contains(&(pixels / usual)))
        .map_or_else(|| rounded(pixels), rounded)
}
