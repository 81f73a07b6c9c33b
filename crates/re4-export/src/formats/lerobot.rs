//! `LeRobot` datasets.
//!
//! Features whose names start with `observation` or `action` are inputs and outputs of policies in lerobot. Everything else that an
//! artifact knows about a frame is therefore named `re4.*`, and about an episode `re4/*`.

use anyhow::Result;
use nalgebra::Isometry3;
use re4_episode::Mode;
use re4_fault::{Fault, bail, ensure};
use re4_geometry::{Point2, Pose2};
use re4_ingest::{DemoRow, SpatialColumns};
use re4_lerobot::Version;
use re4_lerobot::write::{Data, Declaration, Declared, EpisodeValue, FeatureKind, NewEpisode, Number, Writer};
use re4_pose::{Estimate, Flag, PoseRow, SpatialEstimate};
use re4_sim::{GOAL, SUCCESS_COVERAGE, coverage};
use re4_task::Task;
use serde_json::json;

use crate::images::Cameras;
use crate::inputs::{Inputs, Kind, Modes, matching};
use crate::plane::{self, PlaneFrame};
use crate::space::{self, SpaceFrame, seven};
use crate::take::Take;
use crate::{Exported, Format, Hooks, Images, Request};

/// A feature with its values in one episode.
type Column = (Declared, Data);

/// What is read besides the frames.
struct Beside {
    modes: Option<Modes>,
    cameras: Option<Cameras>,
    filter_keys: Option<Vec<String>>,
}

/// The dataset that is being written.
struct Output<'a> {
    inputs: &'a Inputs,
    request: &'a Request<'a>,
    hooks: Hooks<'a>,
    beside: Beside,
    writer: Option<Writer>,
    features: Vec<Declared>,
    done: usize,
    total: usize,
}

/// Writes the dataset.
pub(crate) fn write(inputs: &Inputs, request: &Request<'_>, hooks: Hooks<'_>) -> Result<Exported> {
    let planar = inputs.planar()?;
    let mut output = Output::new(inputs, request, hooks, planar)?;
    let single = !request.double;
    if planar {
        let mut poses = inputs.poses(|row: &PoseRow<Estimate>| row.episode)?;
        plane::read(inputs, |take| {
            let mut columns = planar_columns(&take, single);
            if let Some(poses) = &mut poses {
                let rows = matching(poses, take.number, take.frames.len(), "poses")?;
                columns.extend(planar_estimates(&rows));
            }
            output.add(&take, columns)
        })?;
    } else {
        let mut poses = inputs.poses(|row: &PoseRow<SpatialEstimate>| row.episode)?;
        let deltas = deltas(inputs);
        space::read(inputs, |take| {
            let mut columns = spatial_columns(&take, single, deltas);
            if let Some(poses) = &mut poses {
                let rows = matching(poses, take.number, take.frames.len(), "poses")?;
                let poses: Vec<f64> = rows.iter().flat_map(|row| seven(&row.estimate.object)).collect();
                columns.push(vector("re4.estimated_pose", &POSE, Data::Double(poses)));
            }
            output.add(&take, columns)
        })?;
    }
    output.finish()
}

impl<'a> Output<'a> {
    fn new(inputs: &'a Inputs, request: &'a Request<'a>, hooks: Hooks<'a>, planar: bool) -> Result<Self> {
        let demonstrations = inputs.kind == Kind::Episodes;
        let names = if demonstrations {
            inputs.demo_names()?
        } else {
            let seeds = plane::seeds(&inputs.artifact)?;
            seeds.into_iter().map(crate::take::seed_name).collect()
        };
        let total = names.iter().filter(|name| inputs.keeps(name, None)).count();
        (hooks.progress)(0, total);
        let wanted = demonstrations && request.images != Images::None;
        let cameras = if wanted { Cameras::open(&inputs.artifact)? } else { None };
        let mut filter_keys = None;
        if demonstrations && inputs.artifact.has::<DemoRow>() {
            let keys: Vec<String> = inputs
                .artifact
                .read::<DemoRow>()?
                .into_iter()
                .map(|row| row.filter_keys)
                .collect();
            filter_keys = Some(keys).filter(|keys| keys.iter().any(|keys| !keys.is_empty()));
        }
        Ok(Self {
            beside: Beside {
                modes: inputs.modes(planar)?,
                cameras,
                filter_keys,
            },
            inputs,
            request,
            hooks,
            writer: None,
            features: Vec::new(),
            done: 0,
            total,
        })
    }

    /// Writes an episode.
    fn add<F>(&mut self, take: &Take<F>, mut columns: Vec<Column>) -> Result<()> {
        ensure!(!(self.hooks.stop)(), "the export was stopped"; "run again");
        let frames = take.frames.len();
        if let Some(modes) = &mut self.beside.modes {
            let modes = modes.of(take.number, frames)?;
            let codes = modes.into_iter().map(|mode| i64::from(mode == Mode::Transfer));
            columns.push(scalar("re4.mode", Data::Integer(codes.collect())));
        }
        if let Some(rolled) = &take.rolled {
            let of = |value: fn(&crate::take::Followed) -> i64| rolled.followed.iter().map(value).collect();
            columns.push(scalar("re4.decision", Data::Integer(of(|at| i64::from(at.decision)))));
            let demo = |at: &crate::take::Followed| at.demo.map_or(-1, |(demo, _)| i64::from(demo));
            columns.push(scalar("re4.demonstration", Data::Integer(of(demo))));
            let frame = |at: &crate::take::Followed| at.demo.map_or(-1, |(_, frame)| i64::from(frame));
            columns.push(scalar("re4.demonstration_frame", Data::Integer(of(frame))));
        }
        if let Some(cameras) = &self.beside.cameras {
            let images = cameras.of(take.number)?;
            for ((camera, (width, height)), images) in cameras.sizes.iter().zip(images) {
                let declared = Declared {
                    name: image_name(self.inputs.task, camera),
                    kind: match self.request.images {
                        Images::H264 => FeatureKind::Video(*width, *height),
                        _ => FeatureKind::Image(*width, *height),
                    },
                };
                columns.push((declared, Data::Images(images)));
            }
        }
        let (declared, data): (Vec<Declared>, Vec<Data>) = columns.into_iter().unzip();
        let values = self.values(take);
        if self.writer.is_none() {
            let columns = values.iter().map(|(name, _)| (*name).to_owned()).collect();
            let writer = Writer::create(self.request.out, self.declaration(declared.clone(), columns));
            self.writer = Some(writer.map_err(|error| Fault::of(&error))?);
            self.features.clone_from(&declared);
        }
        let names = |of: &[Declared]| of.iter().map(|feature| feature.name.clone()).collect::<Vec<_>>();
        let (first, own) = (names(&self.features), names(&declared));
        if let Some(missing) = first
            .iter()
            .find(|name| !own.contains(name))
            .or(own.iter().find(|name| !first.contains(name)))
        {
            bail!(
                "cannot export {}: only some of its episodes have {missing}, and {} differs from the first one",
                self.inputs.artifact.path().display(), take.name;
                "choose episodes that are alike with --keep"
            );
        }
        let task = self.task();
        if let Some(writer) = &mut self.writer {
            let values = values.into_iter().map(|(_, value)| value).collect();
            let added = writer.add(&NewEpisode { task, data, values });
            added.map_err(|error| Fault::of(&error))?;
        }
        self.done += 1;
        (self.hooks.progress)(self.done, self.total);
        Ok(())
    }

    /// Values of the table of episodes.
    fn values<F>(&self, take: &Take<F>) -> Vec<(&'static str, EpisodeValue)> {
        let mut values = vec![("re4/name", EpisodeValue::Text(take.name.clone()))];
        if let Some(keys) = &self.beside.filter_keys {
            let own = keys.get(take.number as usize).cloned().unwrap_or_default();
            values.push(("re4/filter_keys", EpisodeValue::Text(own)));
        }
        if let Some(rolled) = &take.rolled {
            values.push(("re4/seed", EpisodeValue::Integer(i64::from(rolled.seed))));
            values.push(("re4/success", EpisodeValue::Truth(rolled.success)));
        }
        values
    }

    fn declaration(&self, features: Vec<Declared>, columns: Vec<String>) -> Declaration {
        let manifest = self.inputs.artifact.manifest();
        let rate = manifest.source["rate"]
            .as_f64()
            .filter(|rate| *rate >= 1.0 && rate.fract() == 0.0);
        let mut about = self.inputs.about(self.request);
        if self.beside.modes.is_some() {
            about.insert("modes".to_owned(), json!(Mode::ALL.map(Mode::as_str)));
        }
        if self.inputs.task != Task::PushT {
            let kind = if deltas(self.inputs) { "delta" } else { "absolute" };
            about.insert("actions".to_owned(), json!(kind));
        }
        Declaration {
            version: match self.request.format {
                Format::LerobotV2 => Version::V2,
                _ => Version::V3,
            },
            fps: rate.map_or(self.inputs.task.control_rate(), |rate| rate as usize),
            robot: if self.inputs.task == Task::PushT {
                "2d pointer"
            } else {
                "panda"
            }
            .to_owned(),
            features,
            columns,
            about,
            limits: self.request.limits,
        }
    }

    /// The task in words.
    fn task(&self) -> String {
        if let Some(task) = self.request.task {
            return task.to_owned();
        }
        match self.inputs.task.name() {
            // The words of the datasets that are already published.
            "pusht" => "Push the T-shaped blue block onto the T-shaped green target surface.".to_owned(),
            "lift" => "Lift the cube.".to_owned(),
            "can" => "Pick up the can and put it into its bin.".to_owned(),
            "square" => "Put the square nut onto the square peg.".to_owned(),
            "round" => "Put the round nut onto the round peg.".to_owned(),
            _ => {
                let environment = self.inputs.artifact.manifest().source["environment"].as_str();
                environment.unwrap_or(self.inputs.task.environment()).to_owned()
            }
        }
    }

    fn finish(self) -> Result<Exported> {
        let Some(writer) = self.writer else {
            bail!(
                "there is no episode to export in {}", self.inputs.artifact.path().display();
                "choose other episodes"
            );
        };
        let written = writer.finish(self.hooks.stop).map_err(|error| Fault::of(&error))?;
        let mut notes = Vec::new();
        if self.inputs.kind == Kind::Rollouts {
            notes.push("the rollouts have no images".to_owned());
            if self.inputs.task != Task::PushT {
                notes.push(
                    "the first step of each rollout is left out, because the pose before it is not recorded".to_owned(),
                );
            }
        }
        Ok(Exported {
            episodes: written.episodes,
            frames: written.frames,
            bytes: written.bytes,
            features: self.features.into_iter().map(|feature| feature.name).collect(),
            notes,
        })
    }
}

/// The feature of a camera.
fn image_name(task: Task, camera: &str) -> String {
    match task {
        // As in the published datasets.
        Task::PushT => "observation.image".to_owned(),
        _ => format!("observation.images.{camera}"),
    }
}

/// Whether the recorded actions are delta actions.
fn deltas(inputs: &Inputs) -> bool {
    inputs.kind == Kind::Episodes && inputs.artifact.manifest().summary["actions"] != "absolute"
}

/// Names of the elements of a pose in SE(3).
const POSE: [&str; 7] = ["x", "y", "z", "qx", "qy", "qz", "qw"];
const PLANAR_POSE: [&str; 3] = ["x", "y", "theta"];

fn scalar(name: &str, data: Data) -> Column {
    let number = number_of(&data);
    let kind = FeatureKind::Scalar(number);
    (
        Declared {
            name: name.to_owned(),
            kind,
        },
        data,
    )
}

fn vector(name: &str, names: &[&str], data: Data) -> Column {
    let names = names.iter().map(|name| (*name).to_owned()).collect();
    let kind = FeatureKind::Vector(number_of(&data), names);
    (
        Declared {
            name: name.to_owned(),
            kind,
        },
        data,
    )
}

fn number_of(data: &Data) -> Number {
    match data {
        Data::Single(_) => Number::Single,
        Data::Integer(_) => Number::Integer,
        Data::Truth(_) => Number::Truth,
        Data::Double(_) | Data::Images(_) => Number::Double,
    }
}

/// States and actions, in the precision that was asked for.
fn floats(values: Vec<f64>, single: bool) -> Data {
    if single {
        Data::Single(values.into_iter().map(|value| value as f32).collect())
    } else {
        Data::Double(values)
    }
}

fn planar_columns(take: &Take<PlaneFrame>, single: bool) -> Vec<Column> {
    let frames = &take.frames;
    let points = |of: fn(&PlaneFrame) -> Point2| frames.iter().flat_map(|frame| [of(frame).x, of(frame).y]).collect();
    let mut columns = vec![
        vector(
            "observation.state",
            &["agent_x", "agent_y"],
            floats(points(|frame| frame.eef), single),
        ),
        vector("action", &["x", "y"], floats(points(|frame| frame.action), single)),
    ];
    let objects: Option<Vec<Pose2>> = frames.iter().map(|frame| frame.object).collect();
    if let Some(objects) = &objects {
        let (scores, coverages): (Vec<f32>, Vec<f64>) = outcomes(frames, objects);
        columns.push(scalar("next.reward", Data::Single(scores)));
        let success = coverages.iter().map(|coverage| *coverage > SUCCESS_COVERAGE);
        columns.push(scalar("next.success", Data::Truth(success.collect())));
    }
    // The last frame has no next one, so that its values are those of the one before: two are true.
    let last = frames.len().saturating_sub(2);
    let rolled = take.rolled.is_some();
    let done = (0..frames.len()).map(|frame| {
        if rolled {
            frame + 1 == frames.len()
        } else {
            frame >= last
        }
    });
    columns.push(scalar("next.done", Data::Truth(done.collect())));
    if let Some(objects) = objects {
        let poses = objects.iter().flat_map(|pose| [pose.x, pose.y, pose.theta]).collect();
        columns.push(vector("re4.object_pose", &PLANAR_POSE, Data::Double(poses)));
    }
    let contacts: Option<Vec<f64>> = frames.iter().map(|frame| frame.contacts).collect();
    if let Some(contacts) = contacts.filter(|contacts| contacts.iter().all(|value| value.is_finite())) {
        columns.push(scalar("re4.contacts", Data::Double(contacts)));
    }
    columns
}

/// Score and coverage after each action: those of the rollout, else of the next frame; the last frame repeats its own.
fn outcomes(frames: &[PlaneFrame], objects: &[Pose2]) -> (Vec<f32>, Vec<f64>) {
    let after = |frame: usize| {
        let known = frames.get(frame).and_then(|frame| frame.after);
        known.unwrap_or_else(|| {
            let next = objects.get(frame + 1).or(objects.last()).copied().unwrap_or(GOAL);
            let coverage = coverage(next, GOAL);
            ((coverage / SUCCESS_COVERAGE).min(1.0), coverage)
        })
    };
    (0..frames.len())
        .map(after)
        .map(|(score, coverage)| (score as f32, coverage))
        .unzip()
}

fn planar_estimates(rows: &[PoseRow<Estimate>]) -> [Column; 3] {
    // Frames without a visible block have no pose. A dataset has no nulls, so theirs is zero, and they are not clear.
    let pose = |row: &PoseRow<Estimate>| row.estimate.pose.map_or([0.0; 3], |pose| [pose.x, pose.y, pose.theta]);
    let clear = rows.iter().map(|row| row.estimate.flag == Flag::Clear);
    let confidence = rows.iter().map(|row| row.estimate.confidence);
    [
        vector(
            "re4.estimated_pose",
            &PLANAR_POSE,
            Data::Double(rows.iter().flat_map(pose).collect()),
        ),
        scalar("re4.estimate_confidence", Data::Double(confidence.collect())),
        scalar("re4.estimate_clear", Data::Truth(clear.collect())),
    ]
}

/// robomimic's names of the end effector's pose and the fingers.
const ARM: [&str; 9] = [
    "robot0_eef_pos_0",
    "robot0_eef_pos_1",
    "robot0_eef_pos_2",
    "robot0_eef_quat_0",
    "robot0_eef_quat_1",
    "robot0_eef_quat_2",
    "robot0_eef_quat_3",
    "robot0_gripper_qpos_0",
    "robot0_gripper_qpos_1",
];
const DELTA: [&str; 7] = ["dx", "dy", "dz", "drx", "dry", "drz", "gripper"];
const GOAL_NAMES: [&str; 7] = ["x", "y", "z", "rx", "ry", "rz", "gripper"];

fn spatial_columns(take: &Take<SpaceFrame>, single: bool, deltas: bool) -> Vec<Column> {
    let all = || take.frames.iter().map(|frame| &frame.recorded);
    let state = |frame: &SpatialColumns| {
        let [x, y, z, qx, qy, qz, qw] = seven(&frame.eef);
        [x, y, z, qx, qy, qz, qw, frame.fingers[0], frame.fingers[1]]
    };
    let action = |frame: &SpatialColumns| {
        let [a, b, c, d, e, f] = if deltas { frame.delta.0 } else { frame.goal.0 };
        [a, b, c, d, e, f, frame.gripper]
    };
    let names = if deltas { DELTA } else { GOAL_NAMES };
    let mut columns = vec![
        vector(
            "observation.state",
            &ARM,
            floats(all().flat_map(state).collect(), single),
        ),
        vector("action", &names, floats(all().flat_map(action).collect(), single)),
    ];
    let rewards: Option<Vec<f64>> = all().map(|frame| frame.reward).collect();
    if let Some(rewards) = rewards {
        columns.push(scalar(
            "next.reward",
            Data::Single(rewards.iter().map(|&reward| reward as f32).collect()),
        ));
    }
    let success: Option<Vec<bool>> = take.frames.iter().map(|frame| frame.success).collect();
    if let Some(success) = success {
        columns.push(scalar("next.success", Data::Truth(success)));
    }
    let last = take.frames.len() - 1;
    columns.push(scalar(
        "next.done",
        Data::Truth((0..=last).map(|frame| frame == last).collect()),
    ));
    let objects: Option<Vec<Isometry3<f64>>> = all().map(|frame| frame.object).collect();
    if let Some(objects) = objects {
        let poses = objects.iter().flat_map(seven).collect();
        columns.push(vector("re4.object_pose", &POSE, Data::Double(poses)));
    }
    if deltas {
        let goals = all().flat_map(|frame| frame.goal.0).collect();
        columns.push(vector("re4.goal", &GOAL_NAMES[..6], Data::Double(goals)));
    }
    columns
}
