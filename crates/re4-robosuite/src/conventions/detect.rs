//! Detection of all conventions of a file from some of its demonstrations.

use nalgebra::Isometry3;

use super::commands::{ActionTests, Controls};
use super::demo::ValidDemo;
use super::eef::{OBJECT, at_rest, eef, relations};
use super::evidence::{Basis, Declared, Fit, Test, Verdict};
use super::gripper;
use super::opening::initial_goal;
use super::reading::{ActionReading, InitialGoal};
use super::residuals::{self, Kinds};
use super::{
    ActionKind, Contradiction, Conventions, DemoArrays, EefOrientation, GripperSign, Proof, QuaternionOrder,
    RelativeLag, RobosuiteTask, Settings, Unproven,
};
use crate::env_args::EnvArgs;

/// Maximum fraction of the end effector's motion that actions of the right kind leave unexplained. Inertia and contacts cause it.
pub(super) const UNEXPLAINED: f64 = 0.6;
/// Minimum fraction that actions of the wrong kind leave unexplained.
pub(super) const NOT_EXPLAINED: f64 = 0.8;

const MOTION: Test = Test {
    name: "motion of the end effector over four frames that the actions leave unexplained, read as deltas and as goals",
    unit: "of the motion",
    threshold: UNEXPLAINED,
    rival: NOT_EXPLAINED,
    frames: 20,
};

/// A demonstration that cannot be used together with the others.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct RefusedDemo {
    /// Its index among the given demonstrations.
    pub place: usize,
    /// Its name.
    pub demo: String,
    /// What is wrong with it, as a clause without its name.
    pub why: String,
}

/// Conventions with their evidence.
#[derive(Debug, Clone, PartialEq)]
pub struct Detection {
    /// The conventions.
    pub conventions: Conventions,
    /// Their proofs, in a fixed order.
    pub proofs: Vec<Proof>,
    /// Demonstrations that were left out, in the given order.
    pub odd: Vec<RefusedDemo>,
}

impl Conventions {
    /// Proves the conventions of a file from some of its demonstrations (ten are enough).
    ///
    /// The proofs are in a fixed order. `env` gives the task and the declared values.
    ///
    /// # Errors
    /// * A convention is not proven. The error names the settings that would accept it.
    /// * A proven convention differs from the declared one.
    /// * The data contradicts a setting.
    /// * A demonstration has arrays of different lengths or numbers that are not finite.
    /// * There are at least three demonstrations, most of them prove everything, and the others contradict them. The error names
    ///   the others.
    pub fn detect(
        demos: &[DemoArrays<'_>],
        env: &EnvArgs,
        settings: &Settings,
    ) -> Result<(Self, Vec<Proof>), Unproven> {
        let file = File::new(demos, env, settings)?;
        let demos = demos
            .iter()
            .map(|demo| file.validate(demo))
            .collect::<Result<Vec<_>, _>>()?;
        file.prove(&demos).map_err(|error| {
            let places: Vec<usize> = (0..demos.len()).collect();
            file.prove_by_majority(&demos, &places)
                .map_or(error, |learned| Unproven::RefusedDemo(learned.odd))
        })
    }

    /// Does the same as [`Conventions::detect`], but leaves out demonstrations that cannot be used and demonstrations that
    /// contradict the majority.
    ///
    /// # Errors
    /// The same as [`Conventions::detect`], if the remaining demonstrations do not prove everything either.
    pub fn detect_excluding(
        demos: &[DemoArrays<'_>],
        env: &EnvArgs,
        settings: &Settings,
    ) -> Result<Detection, Unproven> {
        let file = File::new(demos, env, settings)?;
        let (mut valid, mut places, mut odd) = (Vec::new(), Vec::new(), Vec::new());
        for (place, demo) in demos.iter().enumerate() {
            match file.validate(demo) {
                Ok(demo) => {
                    valid.push(demo);
                    places.push(place);
                }
                Err(contradiction) => odd.push(RefusedDemo::of(place, &contradiction)),
            }
        }
        let mut learned = match file.prove(&valid) {
            Ok((conventions, proofs)) => Detection {
                conventions,
                proofs,
                odd: Vec::new(),
            },
            Err(error) => file.prove_by_majority(&valid, &places).ok_or(error)?,
        };
        learned.odd.extend(odd);
        learned.odd.sort_by_key(|odd| odd.place);
        Ok(learned)
    }
}

impl RefusedDemo {
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

/// The properties of a file that do not come from single demonstrations.
struct File<'a> {
    task: Option<RobosuiteTask>,
    env: &'a EnvArgs,
    settings: &'a Settings,
    controls: Option<Controls>,
    /// Pose of the robot's base in the world frame, if a model gives it.
    base: Option<Isometry3<f64>>,
    /// Conversion of actions that the settings ask for.
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
            reading: ActionReading::of(settings, controls.as_ref(), base.as_ref())?,
            controls,
            base,
        })
    }

    /// Validates a demonstration and converts its actions.
    fn validate<'d>(&self, demo: &DemoArrays<'d>) -> Result<ValidDemo<'d>, Contradiction> {
        ValidDemo::new(demo, self.task, &self.reading)
    }

    /// Proves the conventions from a majority of at least three demonstrations, and lists the others, which contradict it. Returns
    /// `None` if there is no such majority.
    fn prove_by_majority(&self, demos: &[ValidDemo<'_>], places: &[usize]) -> Option<Detection> {
        if demos.len() < 3 {
            return None;
        }
        let some = |chosen: &[usize]| -> Vec<ValidDemo<'_>> { chosen.iter().map(|at| demos[*at].clone()).collect() };
        // Each demonstration and each pair serves as a starting point: a single demonstration may be too short to prove anything,
        // two together rarely are.
        let single = (0..demos.len()).map(|at| vec![at]);
        let pairs = (0..demos.len()).flat_map(|a| (a + 1..demos.len()).map(move |b| vec![a, b]));
        let mut majority: Vec<usize> = Vec::new();
        for seed in single.chain(pairs) {
            let Ok((conventions, _)) = self.prove(&some(&seed)) else {
                continue;
            };
            let follow = |at: &usize| conventions.check_valid(&demos[*at]).is_ok();
            let following: Vec<usize> = (0..demos.len()).filter(follow).collect();
            if following.len() > majority.len() {
                majority = following;
            }
            if majority.len() + 1 >= demos.len() {
                break;
            }
        }
        if 2 * majority.len() <= demos.len() || majority.len() == demos.len() {
            return None;
        }
        let (conventions, proofs) = self.prove(&some(&majority)).ok()?;
        let proven = |names: &[&str]| {
            let mut rows = proofs.iter().filter(|proof| names.contains(&proof.convention.as_str()));
            rows.all(|proof| proof.basis != Basis::Declared)
        };
        let mut odd = Vec::new();
        for (at, demo) in demos.iter().enumerate().filter(|(at, _)| !majority.contains(at)) {
            let contradiction = conventions.check_valid(demo).err()?;
            // A convention that the majority takes from the declaration does not refute this demonstration.
            let dataset = match &contradiction {
                Contradiction::Whole { dataset, .. } => *dataset,
                _ => "",
            };
            let majority_proves = match dataset {
                "actions[:, 0:3]" => proven(&["action_scale", "action_frame"]),
                "actions[:, 3:6]" => proven(&["action_rotation"]),
                "actions[:, 6]" => proven(&["gripper_range"]),
                _ => true,
            };
            if !majority_proves {
                return None;
            }
            odd.push(RefusedDemo::of(places[at], &contradiction));
        }
        Some(Detection {
            conventions,
            proofs,
            odd,
        })
    }

    /// Proves all conventions from valid demonstrations.
    fn prove(&self, demos: &[ValidDemo<'_>]) -> Result<(Conventions, Vec<Proof>), Unproven> {
        let (env, settings, task) = (self.env, self.settings, self.task);
        let by_data = |proofs: &[Proof]| proofs.iter().all(|proof| proof.basis == Basis::Data);
        let mut proofs = Vec::new();
        let (kind, proof) = self.action_kind(demos)?;
        proofs.push(proof);
        let (gripper, range) = gripper::gripper_range(demos, settings)?;
        let (gripper_sign, proof) = gripper::gripper_sign(demos).settle(
            "gripper_sign",
            settings.gripper_sign,
            Some(&robosuite(env, GripperSign::PositiveCloses)),
        )?;
        proofs.push(proof);

        let has_object = |demo: &ValidDemo<'_>| demo.arrays.object.is_some();
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
            // The first two proofs are about the actions and the gripper, the next two about the end effector.
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
            // The proofs from index 4 on are about the object vector.
            conventions.object_proven = by_data(&proofs[4..]);
            conventions.object_layout = Some(layout);
            conventions.object_quaternion = Some(object_quaternion);
            conventions.relative_lag = of_layout()
                .filter(|(relation, _)| relation.object == object_quaternion)
                .min_by(|a, b| a.1.high.total_cmp(&b.1.high))
                .map_or(RelativeLag::Current, |(relation, _)| relation.lag);
        }
        // The tests of the actions come last, because they need the conventions of the end effector.
        proofs.push(range);
        let tests = self.action_tests(demos, eef_quaternion, eef_orientation);
        let (reading, rows) = match kind {
            ActionKind::Delta => tests.deltas()?,
            ActionKind::Absolute => tests.goals(self.base.as_ref())?,
        };
        conventions.actions = ActionReading { gripper, ..reading };
        proofs.extend(rows);
        let deltas = self.controls.as_ref().filter(|_| kind == ActionKind::Delta);
        let (initial, proof) = initial_goal(&conventions, demos, deltas, (settings.initial_goal, env.resets_panda()))?;
        conventions.initial_goal = initial;
        proofs.push(proof);
        Ok((conventions, proofs))
    }

    /// Determines whether actions are deltas or goals. If neither fits, the error names another frame or unit that does.
    fn action_kind(&self, demos: &[ValidDemo<'_>]) -> Result<(ActionKind, Proof), Unproven> {
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
        // The actions fit neither as deltas nor as goals in the world frame. They may be goals in another frame, or deltas in
        // another unit.
        if let Some(error) = self.goals_elsewhere(demos).or_else(|| self.other_deltas(demos)) {
            return Err(error);
        }
        outcome?;
        Err(Unproven::Actions {
            convention: "action_kind",
            what: format!(
                "the setting action_kind = \"{}\" leaves most of the end effector's motion unexplained",
                set.map(super::evidence::name).unwrap_or_default()
            ),
            evidence: format!(
                "{}: delta {:.2}, absolute {:.2}, over {} frames",
                MOTION.name,
                kinds.unexplained(ActionKind::Delta),
                kinds.unexplained(ActionKind::Absolute),
                kinds.frames()
            ),
            fix: "use a file with deltas of OSC_POSE or with its goals in the world frame as actions".to_owned(),
        })
    }

    /// The error for deltas that have another unit or are shifted. Returns `None` if they are neither.
    fn other_deltas(&self, demos: &[ValidDemo<'_>]) -> Option<Unproven> {
        if self.settings.action_kind == Some(ActionKind::Absolute) {
            return None;
        }
        let error = self
            .action_tests(demos, QuaternionOrder::Xyzw, EefOrientation::HandBody)
            .deltas()
            .err()?;
        matches!(&error, Unproven::Actions { .. }).then_some(error)
    }

    fn action_tests<'s, 'd>(
        &'s self,
        demos: &'s [ValidDemo<'d>],
        order: QuaternionOrder,
        orientation: EefOrientation,
    ) -> ActionTests<'s, 'd> {
        ActionTests {
            demos,
            controls: self.controls,
            settings: self.settings,
            env: self.env,
            reading: self.reading,
            order,
            orientation,
        }
    }

    /// The error for goals in another frame than the world. Returns `None` if shifted goals do not explain the motion either.
    fn goals_elsewhere(&self, demos: &[ValidDemo<'_>]) -> Option<Unproven> {
        let mean = |demo: &ValidDemo<'_>| {
            let rows = demo.actions.iter().zip(demo.arrays.eef_pos);
            let all = rows.map(|(action, now)| crate::actions::position(action) - nalgebra::Vector3::from(*now));
            all.sum::<nalgebra::Vector3<f64>>()
        };
        let frames: usize = demos.iter().map(|demo| demo.actions.len()).sum();
        let offset = demos.iter().map(mean).sum::<nalgebra::Vector3<f64>>() / frames.max(1) as f64;
        let shifted: Vec<ValidDemo<'_>> = demos
            .iter()
            .map(|demo| {
                let mut demo = demo.clone();
                for action in demo.actions.to_mut() {
                    for axis in 0..3 {
                        action[axis] -= offset[axis];
                    }
                }
                demo
            })
            .collect();
        if kinds(&shifted).unexplained(ActionKind::Absolute) > UNEXPLAINED {
            return None;
        }
        let tests = self.action_tests(demos, QuaternionOrder::Xyzw, EefOrientation::HandBody);
        tests.goals(self.base.as_ref()).err()
    }
}

/// A value that robosuite writes in the declared version.
fn robosuite<V>(env: &EnvArgs, value: V) -> Declared<V> {
    let version = env.env_version.as_deref().unwrap_or("of an undeclared version");
    Declared {
        value,
        by: format!("the file declares robosuite {version}"),
        strict: true,
    }
}

/// The kind of actions that `env_args` declares.
fn declared_kind(env: &EnvArgs) -> Option<Declared<ActionKind>> {
    let value = env.controller.as_ref()?.declared?;
    Some(Declared {
        value,
        by: "env_args declares the controller's input (control_delta or input_type)".to_owned(),
        strict: false,
    })
}

/// Sums over all demonstrations for distinguishing deltas from goals.
fn kinds(demos: &[ValidDemo<'_>]) -> Kinds {
    let mut kinds = Kinds::default();
    for demo in demos {
        kinds.add(residuals::motion(demo));
    }
    kinds
}

/// Tests both kinds of actions.
fn action_kind(kinds: &Kinds) -> Verdict<ActionKind> {
    let fit = |kind: ActionKind| (kind, Fit::whole(kinds.unexplained(kind), kinds.frames()));
    Verdict::new(MOTION, [fit(ActionKind::Delta), fit(ActionKind::Absolute)])
}
