//! Proving all conventions of a file from some of its demos.

use super::demo::Sound;
use super::evidence::{Basis, Declared, Fit, MARGIN, Test, Verdict};
use super::residuals::{self, Kinds, Relation, Share};
use super::{
    ActionKind, Conventions, DemoArrays, EefOrientation, GripperSign, ObjectLayout, Proof, QuaternionOrder,
    RelativeLag, Settings, Task, Unproven,
};
use crate::env_args::EnvArgs;

const ORDERS: [QuaternionOrder; 2] = [QuaternionOrder::Xyzw, QuaternionOrder::Wxyz];
const FRAMES: [EefOrientation; 2] = [EefOrientation::HandBody, EefOrientation::GripSite];
const LAGS: [RelativeLag; 3] = [
    RelativeLag::Current,
    RelativeLag::ObjectOneLate,
    RelativeLag::BothOneLate,
];

/// Residuals of exact relations: rounding of models saved with six digits and of 32-bit columns is far below.
pub(super) const EXACT: f64 = 1e-3;
/// Share of finger travel against the command that play and contacts may cause.
const FINGERS_AGAINST: f64 = 0.1;
/// Finger travel (metres) that tells the command's sign.
pub(super) const FINGER_TRAVEL: f64 = 0.01;
/// Share of the hand's motion that inertia and contacts leave unexplained by the action.
pub(super) const UNEXPLAINED: f64 = 0.6;
/// The same for the wrong kind of action.
pub(super) const NOT_EXPLAINED: f64 = 0.8;

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
    exact("robot0_eef_pos and robot0_eef_quat against the poses that states and model_file give");
const EEF_RELATION: Test = exact("the relative part of obs/object against object and end-effector pose");
const OBJECT: Test =
    exact("the parts of obs/object against each other, and against states and model_file where they are there");
const ANGULAR_VELOCITY: Test = Test {
    name: "the change of robot0_eef_quat against robot0_eef_vel_ang",
    unit: "of the velocity",
    threshold: 0.25,
    rival: 0.6,
    frames: 20,
};
const GOALS: Test = Test {
    name: "the median angle between robot0_eef_quat and absolute goals",
    unit: "rad",
    threshold: 0.4,
    rival: 1.0,
    frames: 20,
};
const REST: Test = Test {
    name: "the tilt of the cube where it rests at the start of demos",
    unit: "rad",
    threshold: 0.03,
    rival: 0.1,
    frames: 5,
};
const FINGERS: Test = Test {
    name: "the gripper command against the fingers' motion in the next frame",
    unit: "of the travel",
    threshold: FINGERS_AGAINST,
    rival: 1.0 - FINGERS_AGAINST,
    frames: 5,
};
const MOTION: Test = Test {
    name: "the hand's motion over four frames left unexplained by their actions, as deltas and as goals",
    unit: "of the motion",
    threshold: UNEXPLAINED,
    rival: NOT_EXPLAINED,
    frames: 20,
};

/// A hypothesis about the object vector and the end effector with its fit.
type Related = (Relation, Fit);

impl Conventions {
    /// Proves the conventions of a file from some of its demos (ten are plenty).
    ///
    /// The proofs come in a fixed order. `env` gives the task and what is declared; nothing else is believed.
    ///
    /// # Errors
    /// The first convention that is not proven, with the setting that would accept it; one that is proven to be other than
    /// the file declares; a setting that the data contradicts; a demo with arrays of other lengths or numbers that are not
    /// finite.
    pub fn detect(
        demos: &[DemoArrays<'_>],
        env: &EnvArgs,
        settings: &Settings,
    ) -> Result<(Self, Vec<Proof>), Unproven> {
        let task = Task::of(&env.env_name);
        let by_data = |proofs: &[Proof]| proofs.iter().all(|proof| proof.basis == Basis::Data);
        let demos = demos
            .iter()
            .map(|demo| Sound::new(demo, task))
            .collect::<Result<Vec<_>, _>>()?;
        let mut proofs = Vec::new();
        let (action_kind, proof) =
            action_kind(&demos).settle("action_kind", settings.action_kind, declared_kind(env).as_ref())?;
        proofs.push(proof);
        let (gripper_sign, proof) = gripper_sign(&demos).settle(
            "gripper_sign",
            settings.gripper_sign,
            Some(&robosuite(env, GripperSign::PositiveCloses)),
        )?;
        proofs.push(proof);

        let has_object = task != Task::Other && demos.iter().any(|demo| demo.arrays.object.is_some());
        let eef = eef(&demos, task, has_object, action_kind, env);
        let (eef_quaternion, proof) = eef.order.settle(
            "eef_quaternion",
            settings.eef_quaternion,
            Some(&robosuite(env, QuaternionOrder::Xyzw)),
        )?;
        proofs.push(proof);
        let hand = Declared {
            strict: false,
            ..robosuite(env, EefOrientation::HandBody)
        };
        let (eef_orientation, proof) =
            eef.frame(eef_quaternion)
                .settle("eef_orientation", settings.eef_orientation, Some(&hand))?;
        proofs.push(proof);

        let mut conventions = Self {
            task,
            object_layout: None,
            relative_lag: RelativeLag::Current,
            eef_orientation,
            eef_quaternion,
            object_quaternion: None,
            action_kind,
            gripper_sign,
            eef_proven: by_data(&proofs[2..]),
            object_proven: false,
            allow_actions_beyond_range: settings.allow_actions_beyond_range,
        };
        if has_object {
            let related = relations(&demos, task, &[eef_quaternion], &[eef_orientation], true);
            let (layout, proof) = Verdict::new(OBJECT, related.iter().map(|(relation, fit)| (relation.layout, *fit)))
                .settle(
                "object_layout",
                settings.object_layout,
                declared_layout(env, task).as_ref(),
            )?;
            proofs.push(proof);
            let of_layout = || related.iter().filter(|(relation, _)| relation.layout == layout);
            let mut order = Verdict::new(OBJECT, of_layout().map(|(relation, fit)| (relation.object, *fit)));
            if task == Task::Lift && order.proven().is_none() {
                order = at_rest(&demos);
            }
            let (object_quaternion, proof) = order.settle(
                "object_quaternion",
                settings.object_quaternion,
                Some(&robosuite(env, QuaternionOrder::Xyzw)),
            )?;
            proofs.push(proof);
            conventions.object_proven = by_data(&proofs[4..]);
            conventions.object_layout = Some(layout);
            conventions.object_quaternion = Some(object_quaternion);
            conventions.relative_lag = of_layout()
                .filter(|(relation, _)| relation.object == object_quaternion)
                .min_by(|a, b| a.1.high.total_cmp(&b.1.high))
                .map_or(RelativeLag::Current, |(relation, _)| relation.lag);
        }
        Ok((conventions, proofs))
    }
}

/// What robosuite writes in every version.
fn robosuite<V>(env: &EnvArgs, value: V) -> Declared<V> {
    let version = env.env_version.as_deref().unwrap_or("of an undeclared version");
    Declared {
        value,
        by: format!("the file declares robosuite {version}"),
        strict: true,
    }
}

fn declared_kind(env: &EnvArgs) -> Option<Declared<ActionKind>> {
    let value = env.controller.as_ref()?.declared?;
    Some(Declared {
        value,
        by: "env_args declares the controller's input (control_delta or input_type)".to_owned(),
        strict: false,
    })
}

fn declared_layout(env: &EnvArgs, task: Task) -> Option<Declared<ObjectLayout>> {
    let relative_first = env.version()? >= (1, 5);
    let value = match (task, relative_first) {
        (Task::Lift, false) => ObjectLayout::LiftEefMinusCube,
        (Task::Lift, true) => ObjectLayout::LiftCubeMinusEef,
        (Task::Can | Task::Square, false) => ObjectLayout::PoseFirst,
        (Task::Can | Task::Square, true) => ObjectLayout::RelativeFirst,
        (Task::Other, _) => return None,
    };
    Some(robosuite(env, value))
}

fn layouts(task: Task) -> &'static [ObjectLayout] {
    match task {
        Task::Lift => &[ObjectLayout::LiftEefMinusCube, ObjectLayout::LiftCubeMinusEef],
        Task::Can | Task::Square => &[ObjectLayout::PoseFirst, ObjectLayout::RelativeFirst],
        Task::Other => &[],
    }
}

/// Order and frame of the end effector's quaternion.
struct Eef {
    order: Verdict<QuaternionOrder>,
    test: Test,
    fits: Vec<(QuaternionOrder, EefOrientation, Fit)>,
}

impl Eef {
    /// From hypotheses that are of both at once.
    fn joint(test: Test, fits: impl Iterator<Item = (QuaternionOrder, EefOrientation, Fit)>) -> Self {
        let fits: Vec<_> = fits.collect();
        Self {
            order: Verdict::new(test, fits.iter().map(|(order, _, fit)| (*order, *fit))),
            test,
            fits,
        }
    }

    /// The frame, given the order.
    fn frame(&self, order: QuaternionOrder) -> Verdict<EefOrientation> {
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

fn eef(demos: &[Sound<'_>], task: Task, has_object: bool, kind: ActionKind, env: &EnvArgs) -> Eef {
    if demos.iter().any(|demo| !demo.observed.is_empty()) {
        let fits = eef_hypotheses().map(|(order, frame)| {
            let residuals = every(demos, |demo, t| residuals::eef_kinematics(demo, t, order, frame));
            (order, frame, Fit::of(residuals))
        });
        return Eef::joint(EEF_KINEMATICS, fits);
    }
    if has_object && task != Task::Lift {
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
            let mut share = Share::default();
            for demo in demos {
                share.add(residuals::angular_velocity(demo, order, freq));
            }
            (order, Fit::whole(share.value(), share.frames))
        }),
    );
    let fits = eef_hypotheses().map(|(order, frame)| {
        if kind == ActionKind::Delta {
            // Deltas turn the goal in world axes: they do not tell which frame is turned.
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

/// A residual of every frame that has one.
fn every(demos: &[Sound<'_>], residual: impl Fn(&Sound<'_>, usize) -> Option<f64>) -> Vec<f64> {
    let residual = &residual;
    demos
        .iter()
        .flat_map(|demo| (0..demo.arrays.actions.len()).filter_map(move |t| residual(demo, t)))
        .collect()
}

/// All hypotheses about the object vector under the given ones about the end effector.
fn relations(
    demos: &[Sound<'_>],
    task: Task,
    eefs: &[QuaternionOrder],
    frames: &[EefOrientation],
    with_states: bool,
) -> Vec<Related> {
    let mut related = Vec::new();
    for &layout in layouts(task) {
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
                    // A later one only where the current row does not fit.
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

/// Lift without states: a cube that rests stands upright, under the right order, whatever its yaw.
fn at_rest(demos: &[Sound<'_>]) -> Verdict<QuaternionOrder> {
    let fits = ORDERS.map(|order| {
        let rows = demos
            .iter()
            .filter_map(|demo| demo.arrays.object.filter(|rows| !rows.is_empty()));
        let tilts: Vec<f64> = rows.filter_map(|rows| residuals::tilt(rows.row(0), order)).collect();
        (order, Fit::of(tilts))
    });
    Verdict::new(REST, fits)
}

fn gripper_sign(demos: &[Sound<'_>]) -> Verdict<GripperSign> {
    let mut share = Share::default();
    for demo in demos {
        share.add(residuals::finger_travel(demo));
    }
    let frames = if share.total() >= FINGER_TRAVEL {
        share.frames
    } else {
        0
    };
    let fit = |share: Share| Fit::whole(share.value(), frames);
    Verdict::new(
        FINGERS,
        [
            (GripperSign::PositiveCloses, fit(share)),
            (GripperSign::PositiveOpens, fit(share.complement())),
        ],
    )
}

fn action_kind(demos: &[Sound<'_>]) -> Verdict<ActionKind> {
    let mut kinds = Kinds::default();
    for demo in demos {
        kinds.add(residuals::motion(demo));
    }
    let fit = |kind: ActionKind| (kind, Fit::whole(kinds.unexplained(kind), kinds.frames()));
    Verdict::new(MOTION, [fit(ActionKind::Delta), fit(ActionKind::Absolute)])
}
