//! Proving all conventions of a file from some of its demos.

use nalgebra::Isometry3;

use super::commands::{self, Controls, Judge};
use super::demo::Sound;
use super::evidence::{Basis, Declared, Fit, MARGIN, Test, Verdict};
use super::opening::initial_goal;
use super::reading::{ActionFrame, ActionReading, ActionRotation, ActionScale, InitialGoal};
use super::residuals::{self, Kinds, Relation, Share};
use super::{
    ActionKind, Contradiction, Conventions, DemoArrays, EefOrientation, GripperSign, Proof, QuaternionOrder,
    RelativeLag, RobosuiteTask, Settings, Unproven,
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

/// A demo that cannot be used beside the others.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Odd {
    /// Its place among those that were given.
    pub place: usize,
    /// Its name.
    pub demo: String,
    /// What is wrong with it, a clause without its name.
    pub why: String,
}

/// Conventions with what they rest on.
#[derive(Debug, Clone, PartialEq)]
pub struct Learned {
    /// The conventions.
    pub conventions: Conventions,
    /// Their proofs, in a fixed order.
    pub proofs: Vec<Proof>,
    /// Demos that were left out, in order.
    pub odd: Vec<Odd>,
}

impl Conventions {
    /// Proves the conventions of a file from some of its demos (ten are plenty).
    ///
    /// The proofs come in a fixed order. `env` gives the task and what is declared; nothing else is believed.
    ///
    /// # Errors
    /// The first convention that is not proven, with the setting that would accept it; one that is proven to be other than
    /// the file declares; a setting that the data contradicts; a demo with arrays of other lengths or numbers that are not
    /// finite. Where most of at least three demos prove everything, and the others contradict them, those
    /// others.
    pub fn detect(
        demos: &[DemoArrays<'_>],
        env: &EnvArgs,
        settings: &Settings,
    ) -> Result<(Self, Vec<Proof>), Unproven> {
        let file = File::new(demos, env, settings)?;
        let demos = demos
            .iter()
            .map(|demo| file.sound(demo))
            .collect::<Result<Vec<_>, _>>()?;
        file.prove(&demos).map_err(|error| {
            let places: Vec<usize> = (0..demos.len()).collect();
            file.odd_ones(&demos, &places)
                .map_or(error, |learned| Unproven::Odd(learned.odd))
        })
    }

    /// As [`Conventions::detect`], but leaves out demos that cannot be used, and those that contradict what most of
    /// the others prove.
    ///
    /// # Errors
    /// As there, where the other demos do not prove everything either.
    pub fn detect_leaving_out(
        demos: &[DemoArrays<'_>],
        env: &EnvArgs,
        settings: &Settings,
    ) -> Result<Learned, Unproven> {
        let file = File::new(demos, env, settings)?;
        let (mut sound, mut places, mut odd) = (Vec::new(), Vec::new(), Vec::new());
        for (place, demo) in demos.iter().enumerate() {
            match file.sound(demo) {
                Ok(demo) => {
                    sound.push(demo);
                    places.push(place);
                }
                Err(contradiction) => odd.push(Odd::of(place, &contradiction)),
            }
        }
        let mut learned = match file.prove(&sound) {
            Ok((conventions, proofs)) => Learned {
                conventions,
                proofs,
                odd: Vec::new(),
            },
            Err(error) => file.odd_ones(&sound, &places).ok_or(error)?,
        };
        learned.odd.extend(odd);
        learned.odd.sort_by_key(|odd| odd.place);
        Ok(learned)
    }
}

impl Odd {
    fn of(place: usize, contradiction: &Contradiction) -> Self {
        let demo = contradiction.demo().to_owned();
        let sentence = contradiction.to_string();
        let why = sentence
            .strip_prefix(&format!("{demo}: "))
            .unwrap_or(&sentence)
            .to_owned();
        Self { place, demo, why }
    }
}

/// What is known of a file beside its demos.
struct File<'a> {
    task: Option<RobosuiteTask>,
    env: &'a EnvArgs,
    settings: &'a Settings,
    controls: Option<Controls>,
    /// Pose of the robot's base, where a model gives it.
    base: Option<Isometry3<f64>>,
    /// How actions are read by the settings alone.
    reading: ActionReading,
}

impl<'a> File<'a> {
    fn new(demos: &[DemoArrays<'_>], env: &'a EnvArgs, settings: &'a Settings) -> Result<Self, Unproven> {
        let controls = Controls::of(env);
        let base = demos.iter().find_map(|demo| demo.model?.base());
        Ok(Self {
            task: RobosuiteTask::of_environment(&env.env_name),
            env,
            settings,
            reading: reading(settings, controls.as_ref(), base.as_ref())?,
            controls,
            base,
        })
    }

    fn sound<'d>(&self, demo: &DemoArrays<'d>) -> Result<Sound<'d>, Contradiction> {
        Sound::new(demo, self.task, &self.reading)
    }

    /// What most of at least three demos prove while the others contradict it; none where there are no such demos.
    fn odd_ones(&self, demos: &[Sound<'_>], places: &[usize]) -> Option<Learned> {
        if demos.len() < 3 {
            return None;
        }
        let some = |chosen: &[usize]| -> Vec<Sound<'_>> { chosen.iter().map(|at| demos[*at].clone()).collect() };
        // One demo may be too short to prove anything, two seldom are.
        let single = (0..demos.len()).map(|at| vec![at]);
        let pairs = (0..demos.len()).flat_map(|a| (a + 1..demos.len()).map(move |b| vec![a, b]));
        let mut most: Vec<usize> = Vec::new();
        for seed in single.chain(pairs) {
            let Ok((conventions, _)) = self.prove(&some(&seed)) else {
                continue;
            };
            let follow = |at: &usize| conventions.check_sound(&demos[*at]).is_ok();
            let following: Vec<usize> = (0..demos.len()).filter(follow).collect();
            if following.len() > most.len() {
                most = following;
            }
            if most.len() + 1 >= demos.len() {
                break;
            }
        }
        if 2 * most.len() <= demos.len() || most.len() == demos.len() {
            return None;
        }
        let (conventions, proofs) = self.prove(&some(&most)).ok()?;
        let told = |names: &[&str]| {
            let mut rows = proofs.iter().filter(|proof| names.contains(&proof.convention.as_str()));
            rows.all(|proof| proof.basis != Basis::Declared)
        };
        let mut odd = Vec::new();
        for (at, demo) in demos.iter().enumerate().filter(|(at, _)| !most.contains(at)) {
            let contradiction = conventions.check_sound(demo).err()?;
            // The others have to tell what this one contradicts.
            let dataset = match &contradiction {
                Contradiction::Whole { dataset, .. } => *dataset,
                _ => "",
            };
            let others_tell = match dataset {
                "actions[:, 0:3]" => told(&["action_scale", "action_frame"]),
                "actions[:, 3:6]" => told(&["action_rotation"]),
                "actions[:, 6]" => told(&["gripper_range"]),
                _ => true,
            };
            if !others_tell {
                return None;
            }
            odd.push(Odd::of(places[at], &contradiction));
        }
        Some(Learned {
            conventions,
            proofs,
            odd,
        })
    }

    /// All conventions, from demos that are sound.
    fn prove(&self, demos: &[Sound<'_>]) -> Result<(Conventions, Vec<Proof>), Unproven> {
        let (env, settings, task) = (self.env, self.settings, self.task);
        let by_data = |proofs: &[Proof]| proofs.iter().all(|proof| proof.basis == Basis::Data);
        let mut proofs = Vec::new();
        let (kind, proof) = self.action_kind(demos)?;
        proofs.push(proof);
        let (gripper, range) = commands::gripper_range(demos, settings)?;
        let (gripper_sign, proof) = gripper_sign(demos).settle(
            "gripper_sign",
            settings.gripper_sign,
            Some(&robosuite(env, GripperSign::PositiveCloses)),
        )?;
        proofs.push(proof);

        let has_object = |demo: &Sound<'_>| demo.arrays.object.is_some();
        let object_task = task.filter(|_| demos.iter().any(has_object));
        let eef = eef(demos, object_task, kind, env);
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

        let mut conventions = Conventions {
            task,
            object_layout: None,
            relative_lag: RelativeLag::Current,
            eef_orientation,
            eef_quaternion,
            object_quaternion: None,
            action_kind: kind,
            gripper_sign,
            eef_proven: by_data(&proofs[2..]),
            object_proven: false,
            allow_actions_beyond_range: settings.allow_actions_beyond_range,
            actions: self.reading,
            initial_goal: InitialGoal::FirstPose,
            controls: self.controls,
        };
        if let Some(task) = object_task {
            let related = relations(demos, task, &[eef_quaternion], &[eef_orientation], true);
            let (layout, proof) = Verdict::new(OBJECT, related.iter().map(|(relation, fit)| (relation.layout, *fit)))
                .settle(
                "object_layout",
                settings.object_layout,
                env.version()
                    .map(|version| robosuite(env, task.layout(version)))
                    .as_ref(),
            )?;
            proofs.push(proof);
            let of_layout = || related.iter().filter(|(relation, _)| relation.layout == layout);
            let mut order = Verdict::new(OBJECT, of_layout().map(|(relation, fit)| (relation.object, *fit)));
            if !layout.relates_rotations() && order.proven().is_none() {
                order = at_rest(demos);
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
        proofs.push(range);
        let judge = self.judge(demos, eef_quaternion, eef_orientation);
        let (reading, rows) = match kind {
            ActionKind::Delta => judge.deltas()?,
            ActionKind::Absolute => judge.goals(self.base.as_ref())?,
        };
        conventions.actions = ActionReading { gripper, ..reading };
        proofs.extend(rows);
        let deltas = self.controls.as_ref().filter(|_| kind == ActionKind::Delta);
        let (initial, proof) = initial_goal(&conventions, demos, deltas, settings.initial_goal)?;
        conventions.initial_goal = initial;
        proofs.push(proof);
        Ok((conventions, proofs))
    }

    /// Whether actions are deltas or goals; where neither fits, what else they are.
    fn action_kind(&self, demos: &[Sound<'_>]) -> Result<(ActionKind, Proof), Unproven> {
        let kinds = kinds(demos);
        let set = self.settings.action_kind;
        let outcome = action_kind(&kinds).settle("action_kind", set, declared_kind(self.env).as_ref());
        let own = match &outcome {
            Ok((_, proof)) if proof.basis == Basis::Data => return outcome,
            Ok((kind, _)) => kinds.unexplained(*kind),
            Err(_) => f64::INFINITY,
        };
        if kinds.frames() < MOTION.frames || own < NOT_EXPLAINED {
            return outcome;
        }
        // Neither as deltas nor as goals in the world: perhaps as goals somewhere else.
        if let Some(error) = self.goals_elsewhere(demos).or_else(|| self.other_deltas(demos)) {
            return Err(error);
        }
        outcome?;
        Err(Unproven::Actions {
            convention: "action_kind",
            what: format!(
                "the setting action_kind = \"{}\" leaves most of the hand's motion unexplained",
                set.map(super::evidence::name).unwrap_or_default()
            ),
            evidence: format!(
                "{}: delta {:.2}, absolute {:.2} of the motion, over {} frames",
                MOTION.name,
                kinds.unexplained(ActionKind::Delta),
                kinds.unexplained(ActionKind::Absolute),
                kinds.frames()
            ),
            mend: "give a file whose actions are deltas of OSC_POSE, or its goals in the world".to_owned(),
        })
    }

    /// The sentence for deltas of another unit or beside 0; none where they are not that either.
    fn other_deltas(&self, demos: &[Sound<'_>]) -> Option<Unproven> {
        if self.settings.action_kind == Some(ActionKind::Absolute) {
            return None;
        }
        let error = self
            .judge(demos, QuaternionOrder::Xyzw, EefOrientation::HandBody)
            .deltas()
            .err()?;
        matches!(&error, Unproven::Actions { .. }).then_some(error)
    }

    fn judge<'s, 'd>(
        &'s self,
        demos: &'s [Sound<'d>],
        order: QuaternionOrder,
        orientation: EefOrientation,
    ) -> Judge<'s, 'd> {
        Judge {
            demos,
            controls: self.controls,
            settings: self.settings,
            env: self.env,
            reading: self.reading,
            order,
            orientation,
        }
    }

    /// The sentence for goals that are in another frame than they are read in; none where that explains nothing.
    fn goals_elsewhere(&self, demos: &[Sound<'_>]) -> Option<Unproven> {
        let mean = |demo: &Sound<'_>| {
            let rows = demo.actions.iter().zip(demo.arrays.eef_pos);
            let all = rows.map(|(action, now)| crate::actions::position(action) - nalgebra::Vector3::from(*now));
            all.sum::<nalgebra::Vector3<f64>>()
        };
        let frames: usize = demos.iter().map(|demo| demo.actions.len()).sum();
        let beside = demos.iter().map(mean).sum::<nalgebra::Vector3<f64>>() / frames.max(1) as f64;
        let shifted: Vec<Sound<'_>> = demos
            .iter()
            .map(|demo| {
                let mut demo = demo.clone();
                for action in demo.actions.to_mut() {
                    for axis in 0..3 {
                        action[axis] -= beside[axis];
                    }
                }
                demo
            })
            .collect();
        if kinds(&shifted).unexplained(ActionKind::Absolute) > UNEXPLAINED {
            return None;
        }
        let judge = self.judge(demos, QuaternionOrder::Xyzw, EefOrientation::HandBody);
        judge.goals(self.base.as_ref()).err()
    }
}

/// How the settings say that actions are to be read.
fn reading(
    settings: &Settings,
    controls: Option<&Controls>,
    base: Option<&Isometry3<f64>>,
) -> Result<ActionReading, Unproven> {
    let refuse = |why: &str| Err(Unproven::Settings(why.to_owned()));
    let mut reading = ActionReading {
        rotation: settings.action_rotation.unwrap_or_default(),
        gripper: settings.gripper_range.unwrap_or_default(),
        ..ActionReading::default()
    };
    let numbers = settings.action_gain.is_some() || settings.action_offset.is_some();
    let of_deltas = settings.states_scale() || settings.action_rotation == Some(ActionRotation::Reversed);
    if of_deltas && settings.action_kind == Some(ActionKind::Absolute) {
        return refuse(
            "action_scale, action_gain, action_offset and action_rotation are about deltas, and action_kind is \"absolute\"; remove one of them",
        );
    }
    let of_goals = settings.action_frame == Some(ActionFrame::Base);
    if of_goals && (of_deltas || settings.action_kind == Some(ActionKind::Delta)) {
        return refuse(
            "action_frame is about absolute actions, and other settings are about deltas; remove one of them",
        );
    }
    let all = settings.action_gain.iter().chain(&settings.action_offset).flatten();
    if all.into_iter().any(|value| !value.is_finite()) || settings.action_gain.is_some_and(|gain| gain.contains(&0.0)) {
        return refuse("action_gain and action_offset hold six finite numbers, and gains are not 0; correct them");
    }
    match (settings.action_scale, numbers) {
        (Some(ActionScale::Controller | ActionScale::Metres), true) => {
            return refuse(
                "action_gain and action_offset say how actions are scaled, and action_scale names another scale; remove one of them, or set action_scale = \"numbers\"",
            );
        }
        (Some(ActionScale::Numbers), false) => {
            return refuse(
                "action_scale = \"numbers\" needs action_gain or action_offset, six numbers each; give them",
            );
        }
        (Some(ActionScale::Metres), false) => match controls {
            Some(controls) => reading = reading.metres(&controls.osc),
            None => {
                return refuse(
                    "action_scale = \"metres\" needs the controller's output_max, which env_args does not declare; restore it",
                );
            }
        },
        (_, true) => {
            reading.scale = ActionScale::Numbers;
            reading.gain = settings.action_gain.unwrap_or(reading.gain);
            reading.offset = settings.action_offset.unwrap_or(reading.offset);
        }
        (Some(ActionScale::Controller) | None, false) => {}
    }
    if of_goals {
        match base {
            Some(base) => reading = reading.in_base(base),
            None => {
                return refuse(
                    "action_frame = \"base\" needs the pose of the robot's base, body robot0_base of the attribute model_file, which is not there; restore it",
                );
            }
        }
    }
    Ok(reading)
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

/// From the object vector, too, where `task` is given.
fn eef(demos: &[Sound<'_>], task: Option<RobosuiteTask>, kind: ActionKind, env: &EnvArgs) -> Eef {
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

fn kinds(demos: &[Sound<'_>]) -> Kinds {
    let mut kinds = Kinds::default();
    for demo in demos {
        kinds.add(residuals::motion(demo));
    }
    kinds
}

fn action_kind(kinds: &Kinds) -> Verdict<ActionKind> {
    let fit = |kind: ActionKind| (kind, Fit::whole(kinds.unexplained(kind), kinds.frames()));
    Verdict::new(MOTION, [fit(ActionKind::Delta), fit(ActionKind::Absolute)])
}
