//! Helpers for tests with real files: owned demonstrations that can be changed.
#![allow(dead_code, reason = "each test uses a part of this")]
#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::print_stdout,
    reason = "test helpers may panic"
)]

use std::path::{Path, PathBuf};

use nalgebra::{Isometry3, Translation3};
use re4_robosuite::conventions::{DemoArrays, EefOrientation, QuaternionOrder, Rows};
use re4_robosuite::env_args::EnvArgs;
use re4_robosuite::kinematics::Model;

/// A file in the folder of the datasets, if it exists.
pub(crate) fn dataset(name: &str) -> Option<PathBuf> {
    let beside = || Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared/data");
    let path = std::env::var_os("RE4_DATA")
        .map_or_else(beside, PathBuf::from)
        .join(name);
    let exists = path.exists();
    if !exists {
        println!(
            "skipped: {} does not exist; set RE4_DATA to the folder of the datasets",
            path.display()
        );
    }
    exists.then_some(path)
}

/// The arrays and the model of a demonstration.
#[derive(Clone)]
pub(crate) struct Demo {
    pub(crate) name: String,
    pub(crate) eef_pos: Vec<[f64; 3]>,
    pub(crate) eef_quat: Vec<[f64; 4]>,
    pub(crate) object: Vec<f64>,
    pub(crate) object_columns: usize,
    pub(crate) gripper_qpos: Vec<[f64; 2]>,
    pub(crate) actions: Vec<[f64; 7]>,
    pub(crate) eef_vel_ang: Vec<[f64; 3]>,
    pub(crate) states: Vec<f64>,
    pub(crate) state_columns: usize,
    pub(crate) model: Model,
}

impl Demo {
    pub(crate) fn arrays(&self) -> DemoArrays<'_> {
        DemoArrays {
            name: &self.name,
            eef_pos: &self.eef_pos,
            eef_quat: &self.eef_quat,
            object: Rows::new(&self.object, self.object_columns),
            gripper_qpos: &self.gripper_qpos,
            actions: &self.actions,
            eef_vel_ang: (!self.eef_vel_ang.is_empty()).then_some(&self.eef_vel_ang),
            states: Rows::new(&self.states, self.state_columns),
            model: Some(&self.model),
        }
    }

    /// The arrays without states and model.
    pub(crate) fn arrays_alone(&self) -> DemoArrays<'_> {
        DemoArrays {
            states: None,
            model: None,
            ..self.arrays()
        }
    }

    pub(crate) fn frames(&self) -> usize {
        self.actions.len()
    }

    /// Poses of the grip site from the observations.
    pub(crate) fn sites(&self) -> Vec<Isometry3<f64>> {
        let poses = self.eef_pos.iter().zip(&self.eef_quat);
        poses
            .map(|(&[x, y, z], &quaternion)| {
                let hand = QuaternionOrder::Xyzw.rotation(quaternion).unwrap();
                Isometry3::from_parts(Translation3::new(x, y, z), EefOrientation::HandBody.site(hand))
            })
            .collect()
    }

    /// Keeps the first frames only.
    pub(crate) fn cut(&mut self, frames: usize) {
        self.eef_pos.truncate(frames);
        self.eef_quat.truncate(frames);
        self.object.truncate(frames * self.object_columns);
        self.gripper_qpos.truncate(frames);
        self.actions.truncate(frames);
        self.eef_vel_ang.truncate(frames);
        self.states.truncate(frames * self.state_columns);
    }
}

/// A file in robomimic's layout.
pub(crate) struct Source {
    file: hdf5::File,
    pub(crate) env: EnvArgs,
}

fn text(location: &hdf5::Location, attribute: &str) -> String {
    let attribute = location.attr(attribute).unwrap();
    attribute
        .read_scalar::<hdf5::types::VarLenUnicode>()
        .unwrap()
        .to_string()
}

pub(crate) fn text_attribute(file: &Path, group: &str, attribute: &str) -> String {
    text(&hdf5::File::open(file).unwrap().group(group).unwrap(), attribute)
}

impl Source {
    pub(crate) fn open(name: &str) -> Option<Self> {
        let file = hdf5::File::open(dataset(name)?).unwrap();
        let env = EnvArgs::parse(&text(&file.group("data").unwrap(), "env_args")).unwrap();
        Some(Self { file, env })
    }

    /// `demo_0`, `demo_1`, ... in numeric order.
    pub(crate) fn names(&self) -> Vec<String> {
        let mut names = self.file.group("data").unwrap().member_names().unwrap();
        names.sort_by_key(|name| name.rsplit('_').next().unwrap().parse::<u32>().unwrap());
        names
    }

    fn flat(&self, path: &str) -> (Vec<f64>, usize) {
        let dataset = self.file.dataset(path).unwrap();
        (dataset.read_raw::<f64>().unwrap(), dataset.shape()[1])
    }

    fn rows<const N: usize>(&self, path: &str) -> Vec<[f64; N]> {
        let (values, columns) = self.flat(path);
        assert_eq!(columns, N);
        values.chunks_exact(N).map(|row| row.try_into().unwrap()).collect()
    }

    pub(crate) fn actions(&self, name: &str) -> Vec<[f64; 7]> {
        self.rows(&format!("data/{name}/actions"))
    }

    pub(crate) fn demo(&self, name: &str) -> Demo {
        let path = |dataset: &str| format!("data/{name}/{dataset}");
        let (object, object_columns) = self.flat(&path("obs/object"));
        let (states, state_columns) = self.flat(&path("states"));
        let group = self.file.group(&format!("data/{name}")).unwrap();
        Demo {
            name: name.to_owned(),
            eef_pos: self.rows(&path("obs/robot0_eef_pos")),
            eef_quat: self.rows(&path("obs/robot0_eef_quat")),
            object,
            object_columns,
            gripper_qpos: self.rows(&path("obs/robot0_gripper_qpos")),
            actions: self.actions(name),
            eef_vel_ang: if self.file.link_exists(&path("obs/robot0_eef_vel_ang")) {
                self.rows(&path("obs/robot0_eef_vel_ang"))
            } else {
                Vec::new()
            },
            states,
            state_columns,
            model: Model::parse(&text(&group, "model_file")).unwrap(),
        }
    }

    pub(crate) fn demos(&self, count: usize) -> Vec<Demo> {
        self.names().iter().take(count).map(|name| self.demo(name)).collect()
    }
}

pub(crate) const TASKS: [&str; 3] = ["lift", "can", "square"];

pub(crate) fn scripted(task: &str, file: &str) -> Option<Source> {
    Source::open(&format!("robomimic-scripted/{task}/{file}"))
}

/// The quantile of values for a fraction, by the nearest-rank method.
pub(crate) fn quantile(values: &mut [f64], fraction: f64) -> f64 {
    values.sort_by(f64::total_cmp);
    let rank = (fraction * values.len() as f64).ceil() as usize;
    values[rank.max(1) - 1]
}

/// Demonstrations of a raw file, with observations that are computed from their states. The models are in the file or in separate
/// files next to it.
pub(crate) fn raw(folder: &str) -> Option<(EnvArgs, Vec<Demo>)> {
    let folder = dataset(&format!("robosuite/robosuite-{folder}"))?;
    let file = hdf5::File::open(folder.join("demo.hdf5")).unwrap();
    let data = file.group("data").unwrap();
    let attribute = |name: &str| text(&data, name);
    let env = EnvArgs::parse_raw(
        Some(&attribute("env")),
        Some(&attribute("env_info")),
        Some(&attribute("repository_version")),
    );
    let source = Source {
        file,
        env: env.unwrap(),
    };
    let demos = source.names().into_iter().map(|name| {
        let mut xml = text(&source.file.group(&format!("data/{name}")).unwrap(), "model_file");
        if !xml.starts_with('<') {
            xml = std::fs::read_to_string(folder.join("models").join(xml)).unwrap();
        }
        let model = Model::parse(&xml).unwrap();
        let (states, state_columns) = source.flat(&format!("data/{name}/states"));
        let observed = model.observe(states.chunks_exact(state_columns), None).unwrap();
        let actions = source.actions(&name);
        Demo {
            name,
            eef_pos: observed.iter().map(|o| o.site.translation.vector.into()).collect(),
            eef_quat: observed.iter().map(|o| o.hand.rotation.coords.into()).collect(),
            object: Vec::new(),
            object_columns: 0,
            gripper_qpos: observed.iter().map(|o| o.gripper_qpos.unwrap()).collect(),
            actions,
            eef_vel_ang: vec![[0.0; 3]; observed.len()],
            states,
            state_columns,
            model,
        }
    });
    let demos = demos.collect();
    Some((source.env, demos))
}
