//! Interprets the rows of a file: proves conventions on its first demonstrations, checks every demonstration against them, and
//! computes the columns of the tables.

use std::borrow::Cow;
use std::path::Path;
use std::sync::{Arc, Mutex, PoisonError};

use nalgebra::{Isometry3, Quaternion, Translation3, UnitQuaternion};
use rayon::prelude::*;
use re4_artifact::SixAxis;
use re4_robosuite::actions::{Action, ActionError, Osc, distance};
use re4_robosuite::conventions::{
    ActionKind, Conventions, DemoArrays, Detection, EefOrientation, GripperRange, GripperSign, InitialGoal,
    QuaternionOrder, RobosuiteTask, Rows, Settings, Unproven,
};
use re4_robosuite::env_args::EnvArgs;
use re4_robosuite::kinematics::{Model, PANDA_RESET};

use super::demo::Demo;
use super::fault::Hdf5Fault;
use super::from_states::{FromStates, Poses};
use super::reader::RobomimicReader;
use super::relatives::{Checked, Relative, check_base, check_task, refuse_two_arms};
use super::stated::{convention, stated};
use crate::demos::Matrix;
use crate::error::{Fault, IngestError};
use crate::left_out::refusal;
use crate::tables::{Convention, LeftOut, SpatialColumns};

/// Number of demonstrations on which conventions are proven.
pub(super) const PROVEN_ON: usize = 10;

/// Settings about how to read a file.
#[derive(Debug, Clone, PartialEq)]
pub struct Reading {
    /// The task; `None` for any environment with one arm.
    pub task: Option<RobosuiteTask>,
    /// Body of the manipulated object, if the task does not define it.
    pub object: Option<String>,
    /// JSON text that replaces the attribute `env_args`.
    pub env_args: Option<String>,
    /// Conventions that are set explicitly.
    pub conventions: Settings,
}

/// A demonstration interpreted by the conventions.
#[derive(Debug, Clone, PartialEq)]
pub struct Interpreted {
    /// Its frames.
    pub frames: Vec<SpatialColumns>,
    /// Differences (metres, radians) between the recorded absolute actions and those computed from the recorded delta actions,
    /// from the second step on; `None` if only one kind is recorded.
    pub goal_errors: Option<Vec<(f64, f64)>>,
    /// Why the demonstration contradicts the conventions, if it does but can be read.
    pub contradiction: Option<String>,
}

/// Conventions of a file, and what is needed to apply them.
pub struct Interpreter {
    env: EnvArgs,
    conventions: Conventions,
    rows: Vec<Convention>,
    warnings: Vec<String>,
    osc: Osc,
    initial: Option<Isometry3<f64>>,
    from_states: FromStates,
    /// What the file has beyond robomimic's layout.
    relative: Relative,
    /// The last model that was parsed, since consecutive demonstrations of one scene have the same model.
    model: Mutex<Option<(Arc<str>, Arc<Model>)>>,
}

impl Interpreter {
    /// Proves the conventions of a file on the first usable demonstrations. Also returns the demonstrations found unusable
    /// meanwhile: those that cannot be read, and those that contradict what most of the others prove.
    ///
    /// # Errors
    /// The file is of another task or has two arms, or required data is missing; a convention is neither proven nor set; no
    /// demonstration can be used.
    pub fn learn(reader: &RobomimicReader, reading: &Reading) -> Result<(Self, Vec<LeftOut>), IngestError> {
        Self::learn_from(std::slice::from_ref(reader), reading)
    }

    /// Like [`Self::learn`], for the first demonstrations of several files of one dataset. The first file states how they were
    /// recorded.
    pub(super) fn learn_from(
        readers: &[RobomimicReader],
        reading: &Reading,
    ) -> Result<(Self, Vec<LeftOut>), IngestError> {
        let Some(reader) = readers.first() else {
            return Err(Fault::from(Hdf5Fault::NoData).of(Path::new("")));
        };
        Self::learn_checked(reader, readers, reading).map_err(|fault| Fault::from(fault).of(&reader.path))
    }

    fn learn_checked(
        reader: &RobomimicReader,
        readers: &[RobomimicReader],
        reading: &Reading,
    ) -> Result<(Self, Vec<LeftOut>), Hdf5Fault> {
        let env = reader.environment(reading.env_args.as_deref())?;
        refuse_two_arms(reader, &env)?;
        check_task(&env, reading.task)?;
        let mut relative = Relative::of(reader, reading, &env)?;
        let (mut first, from_states, mut left_out) = Prepared::gather(readers, reading, &env, &relative)?;
        relative.learn_frame(&mut first, &env, &reading.conventions)?;
        let (env, settings) = relative.adapted(env, &reading.conventions);
        let complete: Vec<DemoArrays<'_>> = first
            .iter()
            .map(|first| arrays(&first.demo, &first.poses, first.model.as_deref()))
            .collect();
        let unproven = |error: Unproven| {
            Hdf5Fault::Other(match error {
                Unproven::RefusedDemo(_) | Unproven::Demo(_) => format!("{error}; {LEAVE_OUT}"),
                error => format!("{error} (settings are keys of [ingest.conventions])"),
            })
        };
        let learned = Conventions::detect_excluding(&complete, &env, &settings);
        let Detection {
            conventions,
            proofs,
            odd,
        } = learned.map_err(unproven)?;
        left_out.extend(odd.into_iter().map(|odd| LeftOut {
            why: format!("{}: {}; {LEAVE_OUT}", odd.demo, odd.why),
            demo: odd.demo,
        }));
        let osc = Osc::from_env(&env).map_err(|error| {
            Hdf5Fault::Other(format!(
                "{error}; restore what attribute env_args lacks, or give it as ingest.env_args"
            ))
        })?;
        // If the controller's first goal is the pose after a reset, it is computed from the model.
        let models = first.iter().filter_map(|first| first.model.as_deref());
        let initial = match conventions.initial_goal {
            InitialGoal::ResetPose => models.into_iter().find_map(|model| model.site_at(&PANDA_RESET).ok()),
            InitialGoal::FirstPose => None,
        };
        let mut rows: Vec<Convention> = proofs.iter().map(convention).collect();
        rows.extend(stated(reader.layout(), reading, &env, &from_states, &relative));
        let mut warnings: Vec<String> = proofs.into_iter().filter_map(|proof| proof.warning).collect();
        if let (Some(distribution @ 1..), Some(own)) = (RobosuiteTask::distribution(&env.env_name), conventions.task) {
            let own = own.environment;
            warnings.push(format!(
                "environment {} is {own} with initial distribution {distribution} of MimicGen; rollouts start from the placement of {own} itself",
                env.env_name
            ));
        }
        let mut interpreter = Self {
            env,
            conventions,
            rows,
            warnings,
            osc,
            initial,
            from_states,
            relative,
            model: Mutex::default(),
        };
        let odd = |first: &Prepared| left_out.iter().any(|left| left.demo == first.demo.name);
        first.retain(|first| !odd(first));
        interpreter.prove_relative(&first)?;
        Ok((interpreter, left_out))
    }

    /// Proves what the file has beyond robomimic's layout.
    fn prove_relative(&mut self, first: &[Prepared]) -> Result<(), Hdf5Fault> {
        let seen = first
            .iter()
            .map(|first| self.seen(&first.demo, &first.poses))
            .collect::<Result<Vec<_>, _>>()?;
        let views: Vec<Checked<'_>> = first
            .iter()
            .zip(&seen)
            .map(|(first, seen)| self.checked(&first.demo, seen))
            .collect();
        let mut relative = self.relative.clone();
        relative.prove(first, &views)?;
        self.rows.extend(relative.rows().iter().cloned());
        self.warnings.extend(relative.warnings().iter().cloned());
        self.relative = relative;
        Ok(())
    }

    /// What the file has beyond robomimic's layout.
    pub(super) fn relative(&self) -> &Relative {
        &self.relative
    }

    /// Metadata on how the file was recorded.
    pub fn env(&self) -> &EnvArgs {
        &self.env
    }

    /// Kind of the recorded actions.
    pub fn action_kind(&self) -> ActionKind {
        self.conventions.action_kind
    }

    /// The conventions, each with its evidence.
    pub fn conventions(&self) -> &[Convention] {
        &self.rows
    }

    /// Remarks on the conventions that the user should know.
    pub fn warnings(&self) -> &[String] {
        &self.warnings
    }

    /// Computes the frames of a demonstration, whose arrays are moved out of it. `other` are actions of the other kind (absolute
    /// or delta), recorded in another file. The frames of a demonstration that contradicts the conventions are those that the
    /// conventions of the file give.
    ///
    /// # Errors
    /// The demonstration cannot be read.
    pub fn interpret(
        &self,
        reader: &RobomimicReader,
        demo: &mut Demo,
        other: Option<&[Action]>,
    ) -> Result<Interpreted, IngestError> {
        self.interpret_checked(demo, other)
            .map_err(|fault| Fault::from(fault).of(&reader.path))
    }

    fn interpret_checked(&self, demo: &mut Demo, other: Option<&[Action]>) -> Result<Interpreted, Hdf5Fault> {
        check_object_columns(demo, self.conventions.task)?;
        let model = match self.from_states {
            FromStates::Nothing | FromStates::Datagen(_) if !self.relative.needs_models() => None,
            _ => self.model(demo)?,
        };
        check_base(demo, model.as_deref())?;
        self.relative.convert(demo, model.as_deref())?;
        let poses = self.from_states.complete(demo, model.as_deref())?;
        let plain = arrays(demo, &poses, None);
        let contradiction = match self.conventions.check(&plain) {
            Ok(_) => None,
            Err(contradiction) => {
                let why = contradiction.to_string().replace(
                    "allow_actions_beyond_range accepts it",
                    "ingest.conventions.allow_actions_beyond_range = true accepts it",
                );
                let why = format!("{why}; {LEAVE_OUT}");
                if !contradiction.is_readable() {
                    return Err(Hdf5Fault::Other(why));
                }
                Some(why)
            }
        };
        let seen = self.seen(demo, &poses)?;
        let differs = self.relative.check(demo, &seen.sites, &self.checked(demo, &seen)).err();
        let differs = differs.map(|why| format!("{}: {why}; {LEAVE_OUT}", demo.name));
        let contradiction = contradiction.or(differs);
        let Seen { sites, object, actions } = seen;
        let (delta, goal, goal_errors) = self.both_kinds(demo, &actions, &sites, other)?;
        let opens = self.conventions.gripper_sign == GripperSign::PositiveOpens;
        let other_command = opens || self.conventions.actions.gripper == GripperRange::ZeroOne;
        let other_frame = self.conventions.eef_orientation == EefOrientation::HandBody;
        let frame = |t: usize| {
            let recorded = self.recorded_rotation(poses.eef_quaternion[t]);
            let rotation = self.conventions.eef_orientation.site(recorded);
            let command = actions[t][6];
            let [x, y, z, quaternion @ ..] = object[t];
            SpatialColumns {
                eef: Isometry3::from_parts(Translation3::from(poses.eef_position[t]), rotation),
                object: Some(Isometry3::from_parts(Translation3::new(x, y, z), unchecked(quaternion))),
                fingers: poses.fingers[t],
                delta: arm(&delta[t]),
                goal: arm(&goal[t]),
                // Subtracted rather than negated, so that a zero remains a positive zero.
                gripper: if opens { 0.0 - command } else { command },
                reward: demo.rewards.as_ref().map(|rewards| rewards[t]),
                done: demo.dones.as_ref().map(|dones| dones[t]),
                raw_eef: other_frame.then_some(recorded),
                raw_gripper: other_command.then_some(demo.actions[t][6]),
            }
        };
        let frames = (0..demo.frames).map(frame).collect();
        Ok(Interpreted {
            frames,
            goal_errors,
            contradiction,
        })
    }

    /// Poses of the grip site and the object, and the actions, by the conventions.
    fn seen<'a>(&self, demo: &'a Demo, poses: &'a Poses) -> Result<Seen<'a>, Hdf5Fault> {
        let unknown = |what: &str| Hdf5Fault::Other(format!("{}: {what}", demo.name));
        let sites = poses
            .eef_position
            .iter()
            .zip(&poses.eef_quaternion)
            .map(|(position, quaternion)| self.conventions.site_pose(*position, *quaternion))
            .collect::<Option<Vec<_>>>()
            .ok_or_else(|| unknown("obs/robot0_eef_quat contains a quaternion of zero norm; repair that row"))?;
        let object = match &poses.object {
            Some(object) => Cow::Borrowed(object.as_slice()),
            None => Cow::Owned(self.objects(demo).ok_or_else(|| no_object(demo))?),
        };
        let actions = if self.conventions.actions.is_plain() {
            Cow::Borrowed(demo.actions.as_slice())
        } else {
            let read = demo.actions.iter().map(|action| self.conventions.actions.read(action));
            read.collect()
        };
        Ok(Seen { sites, object, actions })
    }

    /// The same for comparing it with `datagen_info`.
    fn checked<'a>(&'a self, demo: &'a Demo, seen: &'a Seen<'_>) -> Checked<'a> {
        let own = !matches!(self.from_states, FromStates::Datagen(_));
        Checked {
            datagen: demo.datagen.as_ref(),
            sites: &seen.sites,
            object: own.then_some(&*seen.object),
            deltas: (self.conventions.action_kind == ActionKind::Delta).then_some(&*seen.actions),
            recorded: &demo.actions,
            osc: &self.osc,
        }
    }

    /// A recorded quaternion without normalization; its norm has been checked to be near 1.
    fn recorded_rotation(&self, mut quaternion: [f64; 4]) -> UnitQuaternion<f64> {
        if self.conventions.eef_quaternion == QuaternionOrder::Wxyz {
            quaternion.rotate_left(1);
        }
        unchecked(quaternion)
    }

    /// Delta actions, absolute actions, and the differences between recorded and computed goals if both kinds are recorded.
    fn both_kinds(
        &self,
        demo: &Demo,
        actions: &[Action],
        sites: &[Isometry3<f64>],
        other: Option<&[Action]>,
    ) -> Result<BothKinds, Hdf5Fault> {
        let initial = self.initial.as_ref();
        let refuse = |error: ActionError| Hdf5Fault::Other(format!("{}: {error}", demo.name));
        let pairs = |goals: &[Action], known: &[Action]| -> Vec<(f64, f64)> {
            let pairs = goals.iter().zip(known).skip(1);
            pairs.map(|(goal, known)| distance(goal, known)).collect()
        };
        match self.conventions.action_kind {
            ActionKind::Delta => {
                let goal = self.osc.to_absolute(actions, sites, initial).map_err(refuse)?;
                let beside = demo.other_goals.as_ref().map(|goals| {
                    let join = |(goal, action): (&[f64; 6], &Action)| {
                        let [x, y, z, rx, ry, rz] = *goal;
                        [x, y, z, rx, ry, rz, action[6]]
                    };
                    goals.iter().zip(actions).map(join).collect::<Vec<Action>>()
                });
                let known = other.map(<[Action]>::to_vec).or(beside);
                let errors = known.map(|known| pairs(&goal, &known));
                Ok((actions.to_vec(), goal, errors))
            }
            ActionKind::Absolute => {
                let delta = self.osc.to_delta(actions, sites, initial).map_err(refuse)?;
                let goals = other
                    .map(|deltas| self.osc.to_absolute(deltas, sites, initial))
                    .transpose();
                let errors = goals.map_err(refuse)?.map(|goals| pairs(&goals, actions));
                Ok((delta, actions.to_vec(), errors))
            }
        }
    }

    /// Object poses from `obs/object`, bit for bit.
    fn objects(&self, demo: &Demo) -> Option<Vec<[f64; 7]>> {
        let matrix = demo.object.as_ref()?;
        let start = self.conventions.object_layout?.pose_start();
        let order = self.conventions.object_quaternion?;
        let pose = |row: &[f64]| {
            let mut pose: [f64; 7] = row.get(start..start + 7)?.try_into().ok()?;
            if order == QuaternionOrder::Wxyz {
                pose[3..].rotate_left(1);
            }
            Some(pose)
        };
        matrix.values.chunks_exact(matrix.columns).map(pose).collect()
    }

    fn model(&self, demo: &Demo) -> Result<Option<Arc<Model>>, Hdf5Fault> {
        let Some(text) = &demo.model else { return Ok(None) };
        let mut last = self.model.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some((known, model)) = &*last
            && known == text
        {
            return Ok(Some(Arc::clone(model)));
        }
        let model = parse_model(demo)?;
        *last = model.clone().map(|model| (Arc::clone(text), model));
        Ok(model)
    }
}

/// Poses of the grip site (world frame), rows of object poses (position, quaternion x, y, z, w), and controller commands or goals in
/// the world frame.
struct Seen<'a> {
    sites: Vec<Isometry3<f64>>,
    object: Cow<'a, [[f64; 7]]>,
    actions: Cow<'a, [Action]>,
}

/// Delta actions, absolute actions, and differences between recorded and computed goals.
type BothKinds = (Vec<Action>, Vec<Action>, Option<Vec<(f64, f64)>>);

/// An action without the gripper command.
fn arm(&[a, b, c, d, e, f, _]: &Action) -> SixAxis {
    SixAxis([a, b, c, d, e, f])
}

/// A quaternion in the order x, y, z, w, without normalization.
fn unchecked(parts: [f64; 4]) -> UnitQuaternion<f64> {
    UnitQuaternion::new_unchecked(Quaternion::from(parts))
}

/// The remedy for a demonstration that cannot be used.
pub(super) const LEAVE_OUT: &str = "repair that demonstration, or leave it out with a filter key or ingest.select";

/// A demonstration on which conventions are proven.
pub(super) struct Prepared {
    pub(super) demo: Demo,
    pub(super) model: Option<Arc<Model>>,
    pub(super) poses: Poses,
}

impl Prepared {
    /// Collects the first usable demonstrations, what is computed from states, and the demonstrations that cannot be used.
    fn gather(
        readers: &[RobomimicReader],
        reading: &Reading,
        env: &EnvArgs,
        relative: &Relative,
    ) -> Result<(Vec<Self>, FromStates, Vec<LeftOut>), Hdf5Fault> {
        let (mut prepared, mut left_out): (Vec<Self>, Vec<LeftOut>) = (Vec::new(), Vec::new());
        let mut from: Option<FromStates> = None;
        let of = |reader| std::iter::repeat(reader).zip(RobomimicReader::demos(reader));
        let all: usize = readers.iter().map(|reader| reader.demos().len()).sum();
        let mut names = readers.iter().flat_map(of);
        loop {
            let batch: Vec<_> = names.by_ref().take(PROVEN_ON - prepared.len()).collect();
            let Some((reader, _)) = batch.first() else { break };
            let mut read: Vec<Result<Demo, Hdf5Fault>> = Vec::new();
            for (reader, name) in &batch {
                read.push(reader.read(name));
                if let Some(Err(fault)) =
                    read.pop_if(|read| read.as_ref().is_err_and(|fault| reader.file.is_fatal(fault)))
                {
                    return Err(fault);
                }
            }
            let models = parse_models(&read);
            let some = models.iter().find_map(|model| model.as_ref().ok()?.as_deref());
            let from_states = match from {
                Some(known) => known,
                // If nothing could be read, the faults are reported below.
                None if read.iter().all(Result::is_err) => FromStates::Nothing,
                None => FromStates::of(reader, reading, env, relative, (some, &read))?,
            };
            let demos = read.into_iter().zip(models).zip(&batch);
            for ((demo, model), (reader, name)) in demos {
                let ready = demo.and_then(|mut demo| {
                    let model = model?;
                    check_object_columns(&demo, reading.task)?;
                    check_base(&demo, model.as_deref())?;
                    if from_states == FromStates::Nothing && demo.object.is_none() {
                        return Err(no_object(&demo));
                    }
                    let poses = from_states.complete(&mut demo, model.as_deref())?;
                    demo.name.insert_str(0, &reader.prefix);
                    Ok(Self { demo, model, poses })
                });
                match ready {
                    Ok(ready) => prepared.push(ready),
                    Err(fault) if reader.file.is_fatal(&fault) => return Err(fault),
                    Err(fault) => left_out.push(LeftOut {
                        demo: [reader.prefix.as_str(), &name.name].concat(),
                        why: fault.to_string(),
                    }),
                }
            }
            from = (!prepared.is_empty()).then_some(from_states);
            if prepared.is_empty() && left_out.len() == all {
                return Err(Hdf5Fault::Other(refusal(&left_out, left_out.len())));
            }
        }
        Ok((prepared, from.unwrap_or(FromStates::Nothing), left_out))
    }
}

/// Parses the models of some demonstrations, each distinct text once; `None` for a demonstration that could not be read.
fn parse_models(demos: &[Result<Demo, Hdf5Fault>]) -> Vec<Result<Option<Arc<Model>>, Hdf5Fault>> {
    let text = |place: usize| demos[place].as_ref().ok().and_then(|demo| demo.model.clone());
    let first = |place: usize| (0..=place).find(|other| text(*other) == text(place)).unwrap_or(place);
    let parsed: Vec<_> = demos
        .par_iter()
        .enumerate()
        .map(|(place, demo)| match demo {
            Ok(demo) if first(place) == place => parse_model(demo),
            _ => Ok(None),
        })
        .collect();
    (0..demos.len())
        .map(|place| match (&parsed[first(place)], &demos[place]) {
            (Ok(model), _) => Ok(model.clone()),
            // Parsed again, because the fault contains the name of the demonstration.
            (Err(_), Ok(demo)) => parse_model(demo),
            (Err(_), Err(_)) => Ok(None),
        })
        .collect()
}

fn parse_model(demo: &Demo) -> Result<Option<Arc<Model>>, Hdf5Fault> {
    let parse = |text: &Arc<str>| {
        Model::parse(text).map(Arc::new).map_err(|error| Hdf5Fault::Attribute {
            object: format!("/data/{}", demo.name),
            attribute: "model_file",
            why: format!("cannot be used to compute poses: {error}"),
            fix: "restore it, or leave the demonstration out with a filter key or ingest.select".to_owned(),
        })
    };
    demo.model.as_ref().map(parse).transpose()
}

fn no_object(demo: &Demo) -> Hdf5Fault {
    Hdf5Fault::Missing {
        objects: vec![format!("data/{}/obs/object", demo.name)],
        fix: "restore it, take the object's pose from the states with task = \"robosuite\" and ingest.object, or audit the file without an object with task = \"arm\"",
    }
}

fn check_object_columns(demo: &Demo, task: Option<RobosuiteTask>) -> Result<(), Hdf5Fault> {
    match (&demo.object, task.map(|task| task.object_columns())) {
        (Some(object), Some(columns)) if object.columns != columns => Err(Hdf5Fault::Shape {
            object: format!("data/{}/obs/object", demo.name),
            found: vec![object.rows(), object.columns],
            expected: format!("(N, {columns})"),
            fix: "restore its columns, or give a file of the pipeline's task",
        }),
        _ => Ok(()),
    }
}

fn arrays<'a>(demo: &'a Demo, poses: &'a Poses, model: Option<&'a Model>) -> DemoArrays<'a> {
    let rows = |matrix: &'a Matrix| Rows::new(&matrix.values, matrix.columns);
    DemoArrays {
        name: &demo.name,
        eef_pos: &poses.eef_position,
        eef_quat: &poses.eef_quaternion,
        object: demo.object.as_ref().and_then(rows),
        gripper_qpos: &poses.fingers,
        actions: &demo.actions,
        eef_vel_ang: demo.angular_velocity.as_deref(),
        states: demo.states.as_ref().and_then(rows),
        model,
    }
}
