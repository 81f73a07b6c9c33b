//! MuJoCo's libraries and robosuite's assets, if they are installed, and the reference traces as simulations.
#![allow(
    dead_code,
    clippy::unwrap_used,
    clippy::panic,
    clippy::print_stdout,
    reason = "every test uses only a part; a test may panic"
)]

use std::path::{Path, PathBuf};
use std::sync::Mutex;

use re4_mujoco::Library;
use re4_robosuite::models::with_assets;
use re4_robosuite::physics::{without_contacts, without_visuals};
use re4_sim::Simulator as _;
use re4_sim::robosuite::{
    ArmAction, Fidelity, FirstTorques, Profile, Robosuite, RobosuiteAction, RobosuiteModel, RobosuiteScene,
    RobosuiteTask,
};

use crate::reference::{self, Reference};

/// The folder that scripts/setup-simulators.sh created: `RE4_SIMULATORS`, else data/simulators; `None` if it does not exist.
pub(crate) fn simulators() -> Option<PathBuf> {
    let folder = std::env::var_os("RE4_SIMULATORS").map_or_else(
        || Path::new(env!("CARGO_MANIFEST_DIR")).join("../../data/simulators"),
        PathBuf::from,
    );
    if !folder.is_dir() {
        println!("skipped: no {}; run scripts/setup-simulators.sh", folder.display());
        return None;
    }
    Some(folder)
}

/// The part of a trace's model that is simulated.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Form {
    /// The whole model.
    Whole,
    /// Without the parts that only rendering needs.
    Physics,
    /// As `Physics`, and objects that are put away do not collide.
    Apart,
}

pub(crate) struct Trace {
    pub(crate) name: String,
    pub(crate) task: RobosuiteTask,
    pub(crate) profile: Profile,
    pub(crate) file: Reference,
    pub(crate) actions: Vec<RobosuiteAction>,
}

impl Trace {
    pub(crate) fn read(name: &str) -> Self {
        let file = Reference::read(&format!("trace_{name}.bin.gz"));
        let numbers = file.f64s("actions");
        let actions = (0..numbers.shape[0])
            .map(|step| {
                let row = numbers.row(step);
                let arm = std::array::from_fn(|i| row[i]);
                RobosuiteAction {
                    arm: match file.text("control") {
                        "delta" => ArmAction::Delta(arm),
                        "absolute" => ArmAction::Absolute(arm),
                        other => panic!("control is {other}"),
                    },
                    gripper: row[6],
                }
            })
            .collect();
        Self {
            name: name.to_owned(),
            task: RobosuiteTask::of_environment(file.text("task")).unwrap(),
            profile: Profile::of(file.text("robosuite")).unwrap(),
            actions,
            file,
        }
    }

    pub(crate) fn all() -> impl Iterator<Item = Self> {
        reference::names("trace_").into_iter().map(|name| Self::read(&name))
    }

    pub(crate) fn library(&self, simulators: &Path) -> Library {
        library(simulators, self.profile)
    }

    /// The trace's MJCF with the paths of the assets in `simulators`.
    pub(crate) fn mjcf(&self, simulators: &Path) -> String {
        with_assets(self.file.text("xml"), &simulators.join("robosuite-1.4.1")).unwrap()
    }

    pub(crate) fn model(&self, simulators: &Path, form: Form) -> RobosuiteModel {
        static COMPILED: Mutex<Vec<(String, Form, RobosuiteModel)>> = Mutex::new(Vec::new());
        let mut compiled = COMPILED.lock().unwrap();
        if let Some((_, _, model)) = compiled.iter().find(|(name, of, _)| (name, *of) == (&self.name, form)) {
            return model.clone();
        }
        let whole = self.mjcf(simulators);
        let text = match form {
            Form::Whole => whole,
            Form::Physics => without_visuals(&whole).unwrap(),
            Form::Apart => without_contacts(&without_visuals(&whole).unwrap(), &self.task.unused_bodies()).unwrap(),
        };
        let model = RobosuiteModel::compile(&self.library(simulators), self.task, self.profile, &text).unwrap();
        compiled.push((self.name.clone(), form, model.clone()));
        model
    }

    pub(crate) fn scene(&self) -> RobosuiteScene {
        RobosuiteScene::Recorded(self.file.f64s("initial_state").numbers)
    }

    /// A simulation in the initial state of the trace, with the solver's warm start.
    pub(crate) fn start(&self, simulators: &Path, form: Form, fidelity: Fidelity) -> Robosuite {
        let model = self.model(simulators, form).with_fidelity(fidelity);
        let mut simulation = Robosuite::new(&model).unwrap();
        simulation.reset(&self.scene(), FirstTorques::Fresh).unwrap();
        simulation.set_solver_start(&self.file.f64s("qacc_warmstart").numbers);
        simulation
    }

    /// Number of whole policy steps before a part of the robot first touches something: in the step after them MuJoCo's list of
    /// contacts, under the recorded controls, first contains a body of the robot. It is the same in both versions. Newer traces
    /// have this number in their header.
    pub(crate) fn steps_before_contact(&self) -> usize {
        match (self.task.name, self.file.text("control")) {
            ("lift", "absolute") => 45,
            ("lift", _) => 49,
            ("can", _) => 40,
            ("square", _) => 38,
            _ => self.file.header["steps_before_contact"].as_u64().unwrap() as usize,
        }
    }

    /// Indices of the coordinates of the objects that the task has put away.
    pub(crate) fn coordinates_put_away(&self, model: &RobosuiteModel) -> Vec<usize> {
        let away = self.task.placement.iter().filter(|rule| !rule.used);
        away.map(|rule| model.mujoco().joint(&rule.joint()).unwrap().0)
            .flat_map(|at| at..at + 7)
            .collect()
    }

    /// Indices of the coordinates of objects that push each other from the first step, which magnifies differences in the last
    /// bits: Can places its three unused objects at one position. Square places only its round nut there.
    pub(crate) fn coordinates_in_contact_from_the_start(&self, simulation: &Robosuite) -> Vec<usize> {
        match self.task.unused_bodies().len() {
            0 | 1 => Vec::new(),
            _ => self.coordinates_put_away(simulation.model()),
        }
    }
}

pub(crate) fn library(simulators: &Path, profile: Profile) -> Library {
    let version = profile.mujoco();
    Library::open(&simulators.join(format!("mujoco-{version}")), version).unwrap()
}

/// Maximum absolute difference.
pub(crate) fn apart(ours: &[f64], theirs: &[f64]) -> f64 {
    assert_eq!(ours.len(), theirs.len());
    ours.iter()
        .zip(theirs)
        .map(|(a, b)| (a - b).abs())
        .fold(0.0, |maximum, value| {
            if value > maximum || value.is_nan() {
                value
            } else {
                maximum
            }
        })
}

/// Maximum absolute difference, except for some indices.
pub(crate) fn apart_without(ours: &[f64], theirs: &[f64], left_out: &[usize]) -> f64 {
    let rest = |numbers: &[f64]| -> Vec<f64> {
        let kept = numbers.iter().enumerate().filter(|(at, _)| !left_out.contains(at));
        kept.map(|(_, number)| *number).collect()
    };
    apart(&rest(ours), &rest(theirs))
}

/// Maximum absolute difference of two quaternions; `q` and `-q` are the same rotation.
pub(crate) fn apart_as_rotations(ours: &[f64], theirs: &[f64]) -> f64 {
    let negated: Vec<f64> = theirs.iter().map(|part| -part).collect();
    apart(ours, theirs).min(apart(ours, &negated))
}

pub(crate) fn bits(numbers: &[f64]) -> Vec<u64> {
    numbers.iter().map(|number| number.to_bits()).collect()
}
