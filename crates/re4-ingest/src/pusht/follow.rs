//! Whether the agent follows its targets.
//!
//! The agent of Push-T is moved by a controller that pulls it towards the target of its action: a step of it is, exactly, a fraction
//! of the way to the target and a fraction of the step before. In the original dataset a step is 0.314 of the way and 0.234 of the
//! step before, and what the step before leaves open the way to the target explains to 99.6 %. Actions of another kind, in
//! another unit or in another row explain next to nothing of it, so that their kind can be told.

use std::ops::Range;

use super::conventions::{ActionKind, PushtConventions, rounded};
use super::episodes::PushtEpisodes;
use super::validate::WINDOW;
use crate::error::Fault;

/// Steps along either axis, of those that move, from which the dataset says something.
const ENOUGH_STEPS: usize = 100;

/// The same for a single episode.
const ENOUGH_IN_EPISODE: usize = 60;

/// A step along an axis that counts as a move, in pixels.
const MOVE: f64 = 0.2;

/// Typical change from one step to the next from which the controller shows, in pixels.
const CHANGE: f64 = 0.5;

/// Fraction of the changes that targets have to explain. Those of the original explain 0.996, those that are relative and taken for
/// absolute 0.01, those of a row earlier or later 0.5 and 0.84.
const LEAST: f64 = 0.5;

/// Share from which another reading of the actions is the right one.
const SURE: f64 = 0.9;

/// Share below which a warning says so.
pub(super) const USUAL: f64 = 0.9;

/// Fraction of the way to the target that the agent goes in a step of the original dataset, a tenth of a second.
const REACH: f64 = 0.314;

/// How far the targets may be off before their unit is another one, in pixels. Fits of single episodes are off by up to 7.
const OFF: f64 = 10.0;

/// What the steps of the agent say of the actions.
pub(super) struct Following {
    /// Fraction of the agent's changes of step that the targets explain; `None` where too little moves.
    pub(super) explained: Option<f64>,
    /// What does not fit the dataset as a whole.
    pub(super) fault: Option<Fault>,
    /// Positions of episodes whose agent does not follow, while it does in most, with the fraction.
    pub(super) odd: Vec<(usize, f64)>,
}

/// A step of the agent along one axis, in pixels, but for the action, which is as in the dataset.
#[derive(Clone, Copy)]
struct Step {
    /// From this row to the next.
    onward: f64,
    /// From the row before to this one.
    before: f64,
    /// Where the agent is.
    agent: f64,
    /// The row's action.
    action: f64,
    /// The row's target.
    target: f64,
    /// The target of the row before.
    earlier: f64,
    /// The target of the row after.
    later: f64,
    /// Axis.
    axis: usize,
}

/// Holds the actions of the good episodes against the agent's steps. `episodes` is converted; `actions` are as in the dataset.
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
        odd: Vec::new(),
    };
    let Some(unexplained) = evidence(&all, ENOUGH_STEPS) else {
        return following;
    };
    let (explained, [reach, _]) = share(&all, unexplained, |step| [step.target - step.agent, step.before]);
    following.explained = Some(explained);
    following.fault = fault(conventions, &all, unexplained, explained, reach);
    if following.fault.is_none() {
        following.odd = each
            .iter()
            .enumerate()
            .filter_map(|(number, steps)| {
                let unexplained = evidence(steps, ENOUGH_IN_EPISODE)?;
                let (explained, _) = share(steps, unexplained, |step| [step.target - step.agent, step.before]);
                (explained < LEAST).then_some((number, explained))
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

/// What the step before leaves open of the steps, as a sum of squares; `None` if too little moves.
fn evidence(steps: &[Step], enough: usize) -> Option<f64> {
    let moves = |step: &&Step| step.onward.abs() > MOVE || step.before.abs() > MOVE;
    let moving = steps.iter().filter(moves).count();
    let (_, left) = fit(steps.iter().map(|step| ([step.before], step.onward)));
    (moving >= enough && (left / moving as f64).sqrt() >= CHANGE).then_some(left)
}

/// Fraction of what the step before leaves open that some quantities explain, and their weights.
fn share<const N: usize>(steps: &[Step], unexplained: f64, of: impl Fn(&Step) -> [f64; N]) -> (f64, [f64; N]) {
    let (weights, left) = fit(steps.iter().map(|step| (of(step), step.onward)));
    ((1.0 - left / unexplained).clamp(0.0, 1.0), weights)
}

/// Least squares: the weights, and the sum of squares that is left.
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

/// Solves equations whose matrix is one of squares, by elimination. A quantity that says nothing beside those before it has no
/// weight.
fn solve<const N: usize>(mut squares: [[f64; N]; N], mut products: [f64; N]) -> [f64; N] {
    // Quantities of the same size, so that a small rest can be told from rounding.
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

/// Targets as a line through the actions of an axis, in pixels.
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

/// The lines of both axes that explain the steps best, and the fraction that they explain.
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

fn percent(share: f64) -> String {
    format!("{:.0} %", 100.0 * share)
}

/// What is wrong with the actions, if something is.
fn fault(
    conventions: &PushtConventions,
    steps: &[Step],
    unexplained: f64,
    explained: f64,
    reach: f64,
) -> Option<Fault> {
    let settings = conventions.action_in_words();
    let relative = conventions.action == Some(ActionKind::Relative);
    let so_far = |then: &str| {
        let with = settings
            .as_ref()
            .map_or_else(String::new, |settings| format!("with {settings} "));
        let kind = if relative { "relative" } else { "absolute" };
        format!(
            "{with}data/action explains {} of how the agent's step changes if it is taken for {kind} targets{then}",
            percent(explained)
        )
    };
    let convention = |what: String, fix: String| Some(Fault::Convention { what, fix });
    let (of_relative, [weight, carried]) = share(steps, unexplained, |step| [step.action, step.before]);
    let fitted = lines(steps);
    if relative && explained >= LEAST {
        return wrong_reach(conventions, reach, carried, &so_far);
    }
    // Another reading has to be right by itself, and better than that of the settings by far.
    let better = |other: f64| {
        if explained < LEAST {
            other >= SURE
        } else {
            other >= 0.97 && other > explained + 0.05
        }
    };
    if !relative && better(of_relative) {
        if is_displacement(weight, carried, of_relative) {
            return Some(displacement(&so_far(
                ", and all of it as the agent's own displacement to the next row",
            )));
        }
        let what = so_far(&format!(
            ", and {} as targets relative to the agent",
            percent(of_relative)
        ));
        let pixels = weight / REACH;
        let scale = if (0.4..=3.0).contains(&(pixels / conventions.pixels_a_unit())) {
            String::new()
        } else {
            format!(
                " and ingest.pusht.action_scale to the pixels of one unit of an action, about {}",
                usual_scale(pixels)
            )
        };
        return convention(what, format!("set ingest.pusht.action = \"relative\"{scale}"));
    }
    if let Some((share, lines)) = fitted {
        if relative && better(share) {
            let what = so_far(&format!(", and {} as absolute ones", percent(share)));
            return convention(what, "leave ingest.pusht.action out".to_owned());
        }
        let off = farthest(conventions, lines);
        let is_off = share >= 0.95 && off > OFF && steps.len() >= 4 * ENOUGH_STEPS;
        if !relative && (is_off || off > OFF && better(share)) {
            let off = (explained >= LEAST).then_some(off);
            return Some(other_window(conventions, &so_far, share, lines, off));
        }
    }
    if explained >= LEAST {
        return other_row(steps, unexplained, explained, &so_far);
    }
    let row = other_row(steps, unexplained, explained, &so_far);
    row.or_else(|| {
        convention(
            so_far(&format!(
                ", and {} as relative ones (in the original dataset it is 99.6 %)",
                percent(of_relative)
            )),
            "write into each row the absolute target in force from its state on, in the unit of the states, or that target seen from the agent with ingest.pusht.action = \"relative\""
                .to_owned(),
        )
    })
}

/// Relative actions in another unit.
fn wrong_reach(
    conventions: &PushtConventions,
    reach: f64,
    carried: f64,
    so_far: &impl Fn(&str) -> String,
) -> Option<Fault> {
    let scale = conventions.pixels_an_action();
    if is_displacement(reach * scale, carried, 1.0) {
        return Some(displacement(&so_far(
            ", and all of it as the agent's own displacement to the next row",
        )));
    }
    let pixels = reach * scale / REACH;
    (!(0.4..=3.0).contains(&(pixels / scale))).then(|| Fault::Convention {
        what: so_far(&format!(
            ", but a step is {} of the way to such a target and about a third is usual",
            rounded(reach)
        )),
        fix: format!(
            "set ingest.pusht.action_scale to the pixels of one unit of an action, about {}",
            usual_scale(pixels)
        ),
    })
}

/// Whether an action is the step itself, and no target.
fn is_displacement(weight: f64, carried: f64, share: f64) -> bool {
    (weight - 1.0).abs() < 0.02 && carried.abs() < 0.02 && share > 0.999
}

fn displacement(what: &str) -> Fault {
    Fault::Convention {
        what: what.to_owned(),
        fix: "write targets: the agent goes about a third of the way to a target in one step, so that a displacement is none".to_owned(),
    }
}

/// Targets of the row before or after.
fn other_row(steps: &[Step], unexplained: f64, explained: f64, so_far: &impl Fn(&str) -> String) -> Option<Fault> {
    let (of_earlier, _) = share(steps, unexplained, |step| [step.earlier - step.agent, step.before]);
    let (of_later, _) = share(steps, unexplained, |step| [step.later - step.agent, step.before]);
    let (share, row, move_by) = if of_earlier > of_later {
        (of_earlier, "before", "down")
    } else {
        (of_later, "after", "up")
    };
    (share >= 0.97 && share > explained + 0.05).then(|| Fault::Convention {
        what: so_far(&format!(", and {} as the targets of the row {row}", percent(share))),
        fix: format!(
            "move data/action {move_by} by one row within each episode, so that a row holds the target in force from its state on"
        ),
    })
}

/// How far the targets of the settings are from those that fit, at the edges of the window.
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

/// Absolute targets in another unit.
fn other_window(
    conventions: &PushtConventions,
    so_far: &impl Fn(&str) -> String,
    share: f64,
    lines: [Line; 2],
    off: Option<f64>,
) -> Fault {
    let windows = lines.map(Line::window);
    let width = (windows[0][1] - windows[0][0]).abs();
    let alike = |a: [f64; 2], b: [f64; 2], slack: f64| (a[0] - b[0]).abs() <= slack && (a[1] - b[1]).abs() <= slack;
    // The distance that is told of above, in actions, so that what is named is not refused again.
    let slack = OFF / WINDOW * width;
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
    let what = so_far(&format!(
        "{off}, and {} if the window is {} in it",
        percent(share),
        of_axes([" along x", " along y"])
    ));
    let points_up = |[low, high]: [f64; 2]| high < low;
    let fix = if points_up(windows[1]) && !points_up(windows[0]) {
        "y points up in data/action: turn it around, as y points down in the states".to_owned()
    } else {
        match usual {
            Some(window)
                if Some(window) == conventions.window || window == [0.0, WINDOW] && conventions.window.is_none() =>
            {
                "leave ingest.pusht.action_window out".to_owned()
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

/// The usual number near a fitted one.
fn usual_scale(pixels: f64) -> f64 {
    [1.0, WINDOW / 96.0, 10.0, 20.0, 50.0, 100.0, 256.0, WINDOW]
        .into_iter()
        .find(|usual| (0.75..=1.33).contains(&(pixels / usual)))
        .map_or_else(|| rounded(pixels), rounded)
}
