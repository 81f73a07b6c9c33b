//! Tests for the conventions of the end effector's orientation and of the object vector, from their relation to each other and
//! from the states.

use super::demo::ValidDemo;
use super::evidence::{Fit, MARGIN, Test, Verdict};
use super::residuals::{self, Fraction, Relation};
use super::{ActionKind, EefOrientation, QuaternionOrder, RelativeLag, RobosuiteTask};
use crate::env_args::EnvArgs;

const ORDERS: [QuaternionOrder; 2] = [QuaternionOrder::Xyzw, QuaternionOrder::Wxyz];
const FRAMES: [EefOrientation; 2] = [EefOrientation::HandBody, EefOrientation::GripSite];
const LAGS: [RelativeLag; 3] = [
    RelativeLag::Current,
    RelativeLag::ObjectOneLate,
    RelativeLag::BothOneLate,
];

/// Maximum residual (metres or radians) of exact relations. Errors from models that are saved with six digits and from 32-bit
/// columns are far below.
pub(super) const EXACT: f64 = 1e-3;

const fn exact(name: &'static str) -> Test {
    Test {
        name,
        unit: "m or rad",
        threshold: EXACT,
        rival: MARGIN * EXACT,
        frames: 10,
    }
}

const EEF_KINEMATICS: Test =
    exact("difference of robot0_eef_pos and robot0_eef_quat from the poses that states and model_file give");
const EEF_RELATION: Test =
    exact("difference of the relative part of obs/object from the one that the object and end-effector poses give");
pub(super) const OBJECT: Test =
    exact("difference between the parts of obs/object, and from states and model_file if the file has them");
const ANGULAR_VELOCITY: Test = Test {
    name: "difference of the change of robot0_eef_quat from robot0_eef_vel_ang",
    unit: "of the velocity",
    threshold: 0.25,
    rival: 0.6,
    frames: 20,
};
const GOALS: Test = Test {
    name: "median angle between robot0_eef_quat and absolute goals",
    unit: "rad",
    threshold: 0.4,
    rival: 1.0,
    frames: 20,
};
const REST: Test = Test {
    name: "tilt of the resting cube in the first frame of each demonstration",
    unit: "rad",
    threshold: 0.03,
    rival: 0.1,
    frames: 5,
};

/// A hypothesis about the object vector and the end effector, with its residuals.
pub(super) type Related = (Relation, Fit);

/// The tests for the component order and the frame of the end effector's quaternion.
pub(super) struct Eef {
    pub(super) order: Verdict<QuaternionOrder>,
    test: Test,
    fits: Vec<(QuaternionOrder, EefOrientation, Fit)>,
}

impl Eef {
    /// Tests that determine both at once.
    fn joint(test: Test, fits: impl Iterator<Item = (QuaternionOrder, EefOrientation, Fit)>) -> Self {
        let fits: Vec<_> = fits.collect();
        Self {
            order: Verdict::new(test, fits.iter().map(|(order, _, fit)| (*order, *fit))),
            test,
            fits,
        }
    }

    /// The test for the frame, given the order.
    pub(super) fn frame(&self, order: QuaternionOrder) -> Verdict<EefOrientation> {
        let fits = self.fits.iter().filter(|(given, _, _)| *given == order);
        Verdict::new(self.test, fits.map(|(_, frame, fit)| (*frame, *fit)))
    }
}

/// All pairs of order and frame.
fn eef_hypotheses() -> impl Iterator<Item = (QuaternionOrder, EefOrientation)> {
    ORDERS
        .into_iter()
        .flat_map(|order| FRAMES.into_iter().map(move |frame| (order, frame)))
}

/// Tests the conventions of the end effector's quaternion with the best data that is available: states and models, else the
/// relative part of the object vector (if `task` is given), else angular velocities and absolute goals.
pub(super) fn eef(demos: &[ValidDemo<'_>], task: Option<RobosuiteTask>, kind: ActionKind, env: &EnvArgs) -> Eef {
    if demos.iter().any(|demo| !demo.observed.is_empty()) {
        let fits = eef_hypotheses().map(|(order, frame)| {
            let residuals = every(demos, |demo, t| residuals::eef_kinematics(demo, t, order, frame));
            (order, frame, Fit::of(residuals))
        });
        return Eef::joint(EEF_KINEMATICS, fits);
    }
    if let Some(task) = task.filter(|task| task.layouts[0].relates_rotations()) {
        let related = relations(demos, task, &ORDERS, &FRAMES, false);
        let fits = related
            .iter()
            .map(|(relation, fit)| (relation.eef, relation.frame, *fit));
        return Eef::joint(EEF_RELATION, fits);
    }
    let freq = env.control_freq.unwrap_or(20.0);
    let order = Verdict::new(
        ANGULAR_VELOCITY,
        ORDERS.map(|order| {
            let mut fraction = Fraction::default();
            for demo in demos {
                fraction.add(residuals::angular_velocity(demo, order, freq));
            }
            (order, Fit::whole(fraction.value(), fraction.frames))
        }),
    );
    let fits = eef_hypotheses().map(|(order, frame)| {
        if kind == ActionKind::Delta {
            // Deltas rotate the goal about world axes, whichever frame is recorded. They provide no evidence about the frame.
            return (order, frame, Fit::of(Vec::new()));
        }
        let fit = Fit::of(every(demos, |demo, t| residuals::goal_angle(demo, t, order, frame)));
        (order, frame, Fit::whole(fit.median, fit.frames))
    });
    Eef {
        order,
        test: GOALS,
        fits: fits.collect(),
    }
}

/// The residuals of all frames that have one.
fn every(demos: &[ValidDemo<'_>], residual: impl Fn(&ValidDemo<'_>, usize) -> Option<f64>) -> Vec<f64> {
    let residual = &residual;
    demos
        .iter()
        .flat_map(|demo| (0..demo.arrays.actions.len()).filter_map(move |t| residual(demo, t)))
        .collect()
}

/// The residuals of all hypotheses about the object vector, combined with the given orders and frames of the end effector. If
/// `with_states` is set, the residual also includes the difference from the object pose that the states give.
pub(super) fn relations(
    demos: &[ValidDemo<'_>],
    task: RobosuiteTask,
    eefs: &[QuaternionOrder],
    frames: &[EefOrientation],
    with_states: bool,
) -> Vec<Related> {
    let mut related = Vec::new();
    for &layout in &task.layouts {
        for object in ORDERS {
            for &eef in eefs {
                for &frame in frames {
                    let fits = LAGS.map(|lag| {
                        let relation = Relation {
                            layout,
                            object,
                            eef,
                            frame,
                            lag,
                        };
                        let fit = Fit::of(every(demos, |demo, t| {
                            let relative = residuals::relative(demo, t, relation)?;
                            let known = with_states.then(|| residuals::object_kinematics(demo, t, layout, object));
                            Some(relative.max(known.flatten().unwrap_or(0.0)))
                        }));
                        (relation, fit)
                    });
                    // A delay is considered only if the current row does not fit.
                    related.extend(fits.into_iter().reduce(|best, next| {
                        if best.1.high <= EXACT || best.1.high <= next.1.high {
                            best
                        } else {
                            next
                        }
                    }));
                }
            }
        }
    }
    related
}

/// Tests the component order of the object quaternion for Lift without states. Under the right order, one axis of a resting
/// cube is vertical, whatever its yaw.
pub(super) fn at_rest(demos: &[ValidDemo<'_>]) -> Verdict<QuaternionOrder> {
    let fits = ORDERS.map(|order| {
        let rows = demos
            .iter()
            .filter_map(|demo| demo.arrays.object.filter(|rows| !rows.is_empty()));
        let tilts: Vec<f64> = rows.filter_map(|rows| residuals::tilt(rows.row(0), order)).collect();
        (order, Fit::of(tilts))
    });
    Verdict::new(REST, fits)
}
