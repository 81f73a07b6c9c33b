//! robomimic's HDF5 files.

use std::collections::BTreeMap;
use std::fs::File;
use std::io;
use std::os::unix::fs::PermissionsExt as _;
use std::path::Path;

use anyhow::{Context as _, Result};
use nalgebra::Isometry3;
use re4_artifact::{ByEpisode, Row as _};
use re4_episode::Mode;
use re4_fault::{bail, ensure, fault};
use re4_ingest::{Convention, DemoRow, ModelRow, SpatialColumns, StateRow};
use re4_pose::{PoseRow, SpatialEstimate};
use re4_robosuite::hand_from_site;
use re4_task::ObjectLayout;
use serde_json::{Value, json};

use super::hdf5::{Attribute, Hdf5Writer, Members, Values};
use crate::images::Cameras;
use crate::inputs::{Inputs, Kind, Modes, matching};
use crate::space::{self, SpaceFrame, quaternion, seven};
use crate::take::Take;
use crate::{Exported, Format, Hooks, Images, Request};

/// Writes the file.
pub(crate) fn write(inputs: &Inputs, request: &Request<'_>, hooks: Hooks<'_>) -> Result<Exported> {
    inputs.require(Format::Robomimic, false)?;
    let out = request.out;
    let failed = |error: &io::Error| {
        let reason = error.raw_os_error().map_or_else(
            || error.to_string(),
            |code| io::Error::from_raw_os_error(code).to_string(),
        );
        fault!(
            "cannot write the file {}: {reason}", out.display();
            "give the path of a new file in a writable folder with enough space"
        )
    };
    ensure!(
        std::fs::symlink_metadata(out).is_err(),
        "cannot write the file {}: that path exists", out.display();
        "remove it, or give another path"
    );
    let folder = out.parent().filter(|folder| !folder.as_os_str().is_empty());
    let temporary = tempfile::Builder::new()
        .prefix(".re4-export-")
        .permissions(std::fs::Permissions::from_mode(0o666)) // less the bits of the umask
        .tempfile_in(folder.unwrap_or(Path::new(".")))
        .map_err(|error| failed(&error))?;
    let file = temporary.as_file().try_clone().map_err(|error| failed(&error))?;
    let output = Output::new(inputs, request, hooks, file)?;
    let mut exported = output.all().map_err(|error| match error.downcast::<io::Error>() {
        Ok(error) => failed(&error).into(),
        Err(error) => error,
    })?;
    temporary.persist_noclobber(out).map_err(|error| failed(&error.error))?;
    exported.bytes = super::size(out)?;
    Ok(exported)
}

/// Conventions that the values of a file follow.
struct Layout {
    object: Option<ObjectLayout>,
    /// robosuite's version.
    version: String,
    environment: String,
    /// Whether `actions` are delta actions.
    deltas: bool,
}

impl Layout {
    fn of(inputs: &Inputs) -> Result<Self> {
        let manifest = inputs.artifact.manifest();
        let rows: Vec<Convention> = if inputs.artifact.has::<Convention>() {
            inputs.artifact.read()?
        } else {
            Vec::new()
        };
        let stated = |name: &str| {
            rows.iter()
                .find(|row| &*row.convention == name)
                .map(|row| row.value.to_string())
        };
        let version = stated("robosuite_version").unwrap_or_else(|| "1.4.1".to_owned());
        let mut parts = version.split('.').map(|part| part.parse().unwrap_or(0));
        let number = (parts.next().unwrap_or(1), parts.next().unwrap_or(4));
        let named = stated("object_layout").and_then(|name| serde_json::from_value(Value::String(name)).ok());
        let of_task = || inputs.task.robosuite().map(|task| task.layout(number));
        let environment = manifest.source["environment"].as_str().map(str::to_owned);
        Ok(Self {
            object: named.or_else(of_task),
            environment: environment.unwrap_or_else(|| inputs.task.environment().to_owned()),
            deltas: inputs.kind == Kind::Episodes && manifest.summary["actions"] != "absolute",
            version,
        })
    }

    /// robosuite's controller in robomimic's datasets, with the kind of these actions.
    fn env_args(&self) -> String {
        let limits = |sign: f64| [0.05, 0.05, 0.05, 0.5, 0.5, 0.5].map(|limit: f64| sign * limit);
        let mut controller = json!({
            "type": "OSC_POSE", "input_max": 1, "input_min": -1, "output_max": limits(1.0), "output_min": limits(-1.0),
            "kp": 150, "damping": 1, "impedance_mode": "fixed", "kp_limits": [0, 300], "damping_limits": [0, 10],
            "position_limits": null, "orientation_limits": null, "uncouple_pos_ori": true, "control_delta": self.deltas,
            "interpolation": null, "ramp_ratio": 0.2,
        });
        if !self.version.starts_with("1.4") && !self.version.starts_with("1.3") {
            let kind = if self.deltas { "delta" } else { "absolute" };
            controller["input_type"] = json!(kind);
            controller["input_ref_frame"] = json!("world");
            controller = json!({ "type": "BASIC", "body_parts": { "right": controller } });
        }
        json!({
            "env_name": self.environment,
            "env_version": self.version,
            "type": 1,
            "env_kwargs": {
                "has_renderer": false, "has_offscreen_renderer": false, "ignore_done": true, "use_object_obs": true,
                "use_camera_obs": false, "control_freq": 20, "controller_configs": controller, "robots": ["Panda"],
                "camera_depths": false, "camera_heights": 84, "camera_widths": 84, "reward_shaping": false,
            },
        })
        .to_string()
    }

    /// A row of the observation `object`: the pose of the object, and its place relative to the hand.
    fn object_row(layout: ObjectLayout, hand: &Isometry3<f64>, object: &Isometry3<f64>) -> Vec<f64> {
        let difference = object.translation.vector - hand.translation.vector;
        let relative: Vec<f64> = match layout {
            ObjectLayout::LiftEefMinusCube => (-difference).iter().copied().collect(),
            ObjectLayout::LiftCubeMinusEef => difference.iter().copied().collect(),
            ObjectLayout::PoseFirst | ObjectLayout::RelativeFirst => {
                let mut relative = seven(&(hand.inverse() * object));
                // robosuite computes this quaternion from a matrix, with a positive real part.
                if relative[6] < 0.0 {
                    for part in &mut relative[3..] {
                        *part = -*part;
                    }
                }
                relative.to_vec()
            }
        };
        if layout.pose_start() == 0 {
            [&seven(object)[..], &relative].concat()
        } else {
            [&relative, &seven(object)[..]].concat()
        }
    }
}

/// The file that is being written.
struct Output<'a> {
    inputs: &'a Inputs,
    request: &'a Request<'a>,
    hooks: Hooks<'a>,
    file: Hdf5Writer,
    layout: Layout,
    demos: Vec<DemoRow>,
    states: Option<ByEpisode<StateRow>>,
    cameras: Option<Cameras>,
    modes: Option<Modes>,
    poses: Option<ByEpisode<PoseRow<SpatialEstimate>>>,
    written: Members,
    /// Names of demonstrations by filter key.
    filters: BTreeMap<String, Vec<String>>,
    frames: usize,
    datasets: Vec<String>,
    /// Whether rewards were not recorded and are written as zero.
    no_rewards: bool,
}

impl<'a> Output<'a> {
    fn new(inputs: &'a Inputs, request: &'a Request<'a>, hooks: Hooks<'a>, file: File) -> Result<Self> {
        let artifact = &inputs.artifact;
        let demonstrations = inputs.kind == Kind::Episodes;
        let states = demonstrations && artifact.has::<StateRow>();
        let images = demonstrations && request.images != Images::None;
        Ok(Self {
            inputs,
            request,
            hooks,
            file: Hdf5Writer::new(file)?,
            layout: Layout::of(inputs)?,
            demos: if demonstrations && artifact.has::<DemoRow>() {
                artifact.read()?
            } else {
                Vec::new()
            },
            states: states
                .then(|| ByEpisode::open(artifact, |row: &StateRow| row.episode))
                .transpose()?,
            cameras: if images { Cameras::open(artifact)? } else { None },
            modes: inputs.modes(false)?,
            poses: inputs.poses(|row: &PoseRow<SpatialEstimate>| row.episode)?,
            written: Members::new(),
            filters: BTreeMap::new(),
            frames: 0,
            datasets: Vec::new(),
            no_rewards: false,
        })
    }

    fn all(mut self) -> Result<Exported> {
        let inputs = self.inputs;
        let total = match inputs.kind {
            Kind::Episodes => inputs
                .demo_names()?
                .iter()
                .filter(|name| inputs.keeps(name, None))
                .count(),
            Kind::Rollouts => crate::plane::seeds(&inputs.artifact)?.len(),
        };
        (self.hooks.progress)(0, total);
        space::read(inputs, |take| {
            ensure!(!(self.hooks.stop)(), "the export was stopped"; "run again");
            self.add(&take)?;
            (self.hooks.progress)(self.written.len(), total);
            Ok(())
        })?;
        if self.written.is_empty() {
            bail!("there is no episode to export in {}", inputs.artifact.path().display(); "choose other episodes");
        }
        let (env_args, about) = (
            self.layout.env_args(),
            Value::Object(inputs.about(self.request)).to_string(),
        );
        let attributes = [
            ("total", Attribute::Integer(self.frames as i64)),
            ("env_args", Attribute::Text(&env_args)),
            ("re4", Attribute::Text(&about)),
        ];
        let mut root = Members::new();
        root.insert("data".to_owned(), self.file.group(&self.written, &attributes)?);
        if !self.filters.is_empty() {
            let mut mask = Members::new();
            for (key, names) in &self.filters {
                mask.insert(key.clone(), self.file.dataset(&Values::Names(names), &[names.len()])?);
            }
            root.insert("mask".to_owned(), self.file.group(&mask, &[])?);
        }
        let episodes = self.written.len();
        self.file.finish(&root)?;
        let mut notes = vec![
            "the controller in env_args is that of robomimic's datasets; the artifact does not have it".to_owned(),
        ];
        if self.no_rewards {
            notes.push("rewards were not recorded and are zero".to_owned());
        }
        Ok(Exported {
            episodes,
            frames: self.frames,
            bytes: 0,
            features: self.datasets,
            notes,
        })
    }

    /// Name of a demonstration in the file: robomimic requires `demo_` and a number.
    fn name(take: &Take<SpaceFrame>) -> String {
        let number = match &take.rolled {
            Some(rolled) => rolled.seed,
            None => match take.name.strip_prefix("demo_").map(str::parse::<u32>) {
                Some(Ok(number)) if take.name == format!("demo_{number}") => number,
                _ => take.number,
            },
        };
        format!("demo_{number}")
    }

    fn add(&mut self, take: &Take<SpaceFrame>) -> Result<()> {
        let frames = take.frames.len();
        let name = Self::name(take);
        ensure!(
            !self.written.contains_key(&name),
            "two demonstrations of {} would both be named {name}", self.inputs.artifact.path().display();
            "choose one of them with --keep"
        );
        let mut demo = Members::new();
        let mut obs = self.observations(take)?;
        let actions: Vec<f64> = take
            .frames
            .iter()
            .flat_map(|frame| self.action(&frame.recorded))
            .collect();
        demo.insert(
            "actions".to_owned(),
            self.file.dataset(&Values::F64(&actions), &[frames, 7])?,
        );
        if let Some(states) = &mut self.states {
            let rows = matching(states, take.number, frames, "states")?;
            let width = rows.first().map_or(0, |row| row.state.len());
            let flat: Vec<f64> = rows.into_iter().flat_map(|row| row.state).collect();
            ensure!(flat.len() == frames * width, "the states of {} differ in length", take.name; "ingest the dataset again");
            demo.insert(
                "states".to_owned(),
                self.file.dataset(&Values::F64(&flat), &[frames, width])?,
            );
        }
        let rewards: Option<Vec<f64>> = take.frames.iter().map(|frame| frame.recorded.reward).collect();
        self.no_rewards |= rewards.is_none();
        let rewards = rewards.unwrap_or_else(|| vec![0.0; frames]);
        demo.insert(
            "rewards".to_owned(),
            self.file.dataset(&Values::F64(&rewards), &[frames])?,
        );
        let done = |(at, frame): (usize, &SpaceFrame)| i64::from(frame.recorded.done.unwrap_or(at + 1 == frames));
        let dones: Vec<i64> = take.frames.iter().enumerate().map(done).collect();
        demo.insert("dones".to_owned(), self.file.dataset(&Values::I64(&dones), &[frames])?);
        if let Some(cameras) = &self.cameras {
            let images = cameras.of(take.number)?;
            for ((camera, (width, height)), images) in cameras.sizes.iter().zip(images) {
                let pixels = pixels(&images, (*width, *height), &take.name)?;
                let shape = [frames, *height, *width, 3];
                obs.insert(
                    format!("{camera}_image"),
                    self.file.dataset(&Values::U8(&pixels), &shape)?,
                );
            }
        }
        let extra = self.extra(take)?;
        if self.datasets.is_empty() {
            let within = |group: &str, members: &Members| members.keys().map(|name| format!("{group}{name}")).collect();
            let parts: [Vec<String>; 3] = [within("", &demo), within("obs/", &obs), within("re4/", &extra)];
            self.datasets = parts.concat();
        }
        demo.insert("obs".to_owned(), self.file.group(&obs, &[])?);
        if !extra.is_empty() {
            demo.insert("re4".to_owned(), self.file.group(&extra, &[])?);
        }
        let row = self.demos.get(take.number as usize).cloned();
        let model = row
            .as_ref()
            .and_then(|row| row.model)
            .map(|model| self.model(model))
            .transpose()?;
        let mut attributes = vec![("num_samples", Attribute::Integer(frames as i64))];
        if let Some(model) = &model {
            attributes.push(("model_file", Attribute::Text(model)));
        }
        if take.name != name {
            attributes.push(("re4_name", Attribute::Text(&take.name)));
        }
        for key in row.iter().flat_map(|row| row.filter_keys.split(',')).map(str::trim) {
            if !key.is_empty() {
                self.filters.entry(key.to_owned()).or_default().push(name.clone());
            }
        }
        let demo = self.file.group(&demo, &attributes)?;
        self.written.insert(name, demo);
        self.frames += frames;
        Ok(())
    }

    /// The action in the kind of the file.
    fn action(&self, frame: &SpatialColumns) -> [f64; 7] {
        let [a, b, c, d, e, f] = if self.layout.deltas {
            frame.delta.0
        } else {
            frame.goal.0
        };
        [a, b, c, d, e, f, frame.gripper]
    }

    /// Proprioception and, if its layout is known, the object.
    fn observations(&mut self, take: &Take<SpaceFrame>) -> Result<Members> {
        let frames = take.frames.len();
        // The orientation that robosuite observes: the recorded one, which may be that of another frame than the grip site. Rollouts
        // do not have it; it is that of the hand.
        let rolled = take.rolled.is_some();
        let hand = |frame: &SpaceFrame| {
            let site = frame.recorded.eef;
            let observed = if rolled {
                site.rotation * hand_from_site().inverse()
            } else {
                site.rotation
            };
            Isometry3::from_parts(site.translation, frame.recorded.raw_eef.unwrap_or(observed))
        };
        let all = || take.frames.iter();
        let position: Vec<f64> = all().flat_map(|frame| seven(&hand(frame))[..3].to_vec()).collect();
        let rotation: Vec<f64> = all().flat_map(|frame| quaternion(&hand(frame).rotation)).collect();
        let fingers: Vec<f64> = all().flat_map(|frame| frame.recorded.fingers).collect();
        let mut obs = Members::new();
        for (name, values, width) in [
            ("robot0_eef_pos", position, 3),
            ("robot0_eef_quat", rotation, 4),
            ("robot0_gripper_qpos", fingers, 2),
        ] {
            obs.insert(
                name.to_owned(),
                self.file.dataset(&Values::F64(&values), &[frames, width])?,
            );
        }
        let objects: Option<Vec<Isometry3<f64>>> = all().map(|frame| frame.recorded.object).collect();
        if let Some((layout, objects)) = self.layout.object.zip(objects) {
            let rows = all()
                .zip(&objects)
                .flat_map(|(frame, object)| Layout::object_row(layout, &hand(frame), object));
            let rows: Vec<f64> = rows.collect();
            obs.insert(
                "object".to_owned(),
                self.file.dataset(&Values::F64(&rows), &[frames, layout.columns()])?,
            );
        }
        Ok(obs)
    }

    /// Modes, estimated poses and decisions.
    fn extra(&mut self, take: &Take<SpaceFrame>) -> Result<Members> {
        let frames = take.frames.len();
        let mut extra = Members::new();
        if let Some(modes) = &mut self.modes {
            let modes = modes.of(take.number, frames)?;
            let codes: Vec<i64> = modes
                .into_iter()
                .map(|mode| i64::from(mode == Mode::Transfer))
                .collect();
            extra.insert("mode".to_owned(), self.file.dataset(&Values::I64(&codes), &[frames])?);
        }
        if let Some(poses) = &mut self.poses {
            let rows = matching(poses, take.number, frames, "poses")?;
            let poses: Vec<f64> = rows.iter().flat_map(|row| seven(&row.estimate.object)).collect();
            extra.insert(
                "estimated_pose".to_owned(),
                self.file.dataset(&Values::F64(&poses), &[frames, 7])?,
            );
        }
        if let Some(rolled) = &take.rolled {
            let demo: Vec<i64> = rolled
                .followed
                .iter()
                .map(|at| at.demo.map_or(-1, |(demo, _)| demo.into()))
                .collect();
            extra.insert(
                "demonstration".to_owned(),
                self.file.dataset(&Values::I64(&demo), &[frames])?,
            );
            let frame: Vec<i64> = rolled
                .followed
                .iter()
                .map(|at| at.demo.map_or(-1, |(_, frame)| frame.into()))
                .collect();
            extra.insert(
                "demonstration_frame".to_owned(),
                self.file.dataset(&Values::I64(&frame), &[frames])?,
            );
        }
        Ok(extra)
    }

    fn model(&self, number: u32) -> Result<String> {
        let table = self.inputs.artifact.table(ModelRow::table())?;
        // Models have running numbers, but in an artifact in parts each part begins with another number.
        let place = u64::from(number)..u64::from(number) + 1;
        if !self.inputs.artifact.in_parts() {
            let row = table.read_range::<ModelRow>(place)?.pop();
            return row.map(|row| row.mjcf).context("the table models is not complete");
        }
        for row in table.stream::<ModelRow>()? {
            let row = row?;
            if row.model == number {
                return Ok(row.mjcf);
            }
        }
        bail!("table models of {} has no row {number}", self.inputs.artifact.path().display(); "ingest the dataset again")
    }
}

/// The pixels of PNG images of one size, image by image.
fn pixels(images: &[Vec<u8>], (width, height): (usize, usize), name: &str) -> Result<Vec<u8>> {
    let mut pixels = Vec::with_capacity(images.len() * width * height * 3);
    for (frame, png) in images.iter().enumerate() {
        let image = image::load_from_memory_with_format(png, image::ImageFormat::Png);
        let image = image.map(image::DynamicImage::into_rgb8).map_err(|error| {
            fault!("the image of frame {frame} of {name} cannot be decoded ({error})"; "ingest the dataset again")
        })?;
        ensure!(
            (image.width() as usize, image.height() as usize) == (width, height),
            "the image of frame {frame} of {name} has {} x {} pixels, not {width} x {height}", image.width(), image.height();
            "leave the images out with --no-images"
        );
        pixels.extend(image.into_raw());
    }
    Ok(pixels)
}
