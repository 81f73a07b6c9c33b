//! robosuite's tasks for arrays of actions.

use std::borrow::Cow;
use std::sync::{Mutex, MutexGuard, PoisonError};

use numpy::{PyArray1, PyArray2, PyReadonlyArray1, PyReadonlyArray2};
use pyo3::prelude::*;
use pyo3::types::PyDict;
use rayon::prelude::*;
use re4_fault::{Fault, OrFault as _, Remedy as _, fault};
use re4_sim::Simulator as _;
use re4_sim::robosuite::{
    ArmAction, Fidelity, FirstTorques, Placement, Profile, Robosuite, RobosuiteAction, RobosuiteObservation,
    RobosuiteScene, RobosuiteTask,
};
use re4_stages::TaskScene;

use crate::arrays::{rows, table};
use crate::errors::raised;
use crate::threads::Threads;

/// The task and version of robosuite with these names.
pub(crate) fn named(task: &str, version: &str) -> anyhow::Result<(RobosuiteTask, Profile)> {
    let found = RobosuiteTask::named(task).or_fault(|| {
        let known: Vec<_> = RobosuiteTask::all().map(|task| task.name).collect();
        fault!("there is no simulator of the task {task:?}"; "give one of {}", known.join(", "))
    })?;
    let profile = Profile::of(version)
        .or_fault(|| fault!("robosuite {version} is not simulated"; "give a model of robosuite 1.4 or 1.5"))?;
    Ok((found, profile))
}

/// What is known of a task: robosuite's name of the environment, control steps per second, number of columns of the observation
/// `object` and the first column of the object pose in it, and its symmetry as JSON.
#[pyfunction]
pub(crate) fn task_record<'py>(py: Python<'py>, task: &str, version: &str) -> PyResult<Bound<'py, PyDict>> {
    let (task, profile) = named(task, version).map_err(raised)?;
    let layout = task.layout(profile.version());
    let record = PyDict::new(py);
    record.set_item("environment", task.environment)?;
    record.set_item("control_rate", task.control_rate)?;
    record.set_item("object_columns", layout.columns())?;
    record.set_item("object_pose_start", layout.pose_start())?;
    record.set_item("symmetry", serde_json::to_string(&task.symmetry).map_err(raised)?)?;
    Ok(record)
}

/// One simulation. It is created by its first reset, because the model may depend on the seed.
#[derive(Default)]
struct Slot {
    sim: Option<Robosuite>,
    now: Option<(RobosuiteObservation, bool)>,
}

/// Simulations of one task that are stepped together.
#[pyclass(module = "re4_pipe._native", frozen)]
pub(crate) struct RobosuiteSims {
    scene: TaskScene,
    task: RobosuiteTask,
    profile: Profile,
    /// A simulation can be sent to another thread, but not shared.
    slots: Mutex<Vec<Slot>>,
    threads: Threads,
}

impl RobosuiteSims {
    fn slots(&self) -> MutexGuard<'_, Vec<Slot>> {
        self.slots.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// What a step returns: position of the grip site, quaternion of the hand (x, y, z, w), joint positions of the fingers, the
/// observation `object`, success.
type Outcome<'py> = (
    Bound<'py, PyArray2<f64>>,
    Bound<'py, PyArray2<f64>>,
    Bound<'py, PyArray2<f64>>,
    Bound<'py, PyArray2<f64>>,
    Bound<'py, PyArray1<bool>>,
);

#[pymethods]
impl RobosuiteSims {
    /// `count` simulations of a task from a demonstration's `model_file`. `version`: the version of robosuite that wrote it.
    #[new]
    #[allow(clippy::too_many_arguments, reason = "they are the arguments of a Python class")]
    fn new(
        py: Python<'_>,
        task: &str,
        version: &str,
        model_file: &str,
        fast: bool,
        count: usize,
        threads: usize,
    ) -> PyResult<Self> {
        let fidelity = if fast { Fidelity::Fast } else { Fidelity::Robosuite };
        let opened = py.detach(|| {
            let (task, profile) = named(task, version)?;
            Ok((TaskScene::open(task, profile, model_file, fidelity)?, task, profile))
        });
        let (scene, task, profile) = opened.map_err(|error: anyhow::Error| raised(error))?;
        Ok(Self {
            scene,
            task,
            profile,
            slots: Mutex::new((0..count).map(|_| Slot::default()).collect()),
            threads: Threads::new(threads),
        })
    }

    /// Resets the simulations `which` to the scenes that robosuite samples with `seeds`.
    fn reset(
        &self,
        py: Python<'_>,
        which: PyReadonlyArray1<'_, i64>,
        seeds: PyReadonlyArray1<'_, i64>,
    ) -> PyResult<()> {
        let (which, seeds) = (which.as_slice()?, seeds.as_slice()?);
        let (scene, task) = (&self.scene, self.task);
        py.detach(|| {
            let slots = &mut *self.slots();
            let mut wanted: Vec<Option<u32>> = vec![None; slots.len()];
            for (number, seed) in which.iter().zip(seeds) {
                let wanted = wanted.get_mut(*number as usize);
                *wanted.or_fault(|| fault!("there is no environment {number}"; "give a smaller number"))? =
                    Some(*seed as u32);
            }
            self.threads.run(|| {
                let jobs = slots.par_iter_mut().zip(wanted);
                jobs.try_for_each(|(slot, seed)| match seed {
                    Some(seed) => slot.reset(scene, &Placement::sample(task, seed)),
                    None => Ok(()),
                })
            })
        })
        .map_err(raised)
    }

    /// Executes one control step of every simulation whose entry in `active` is true. `actions` have seven numbers: the command of
    /// the arm, absolute (position in m, rotation vector in rad) or delta (in units of 0.05 m and 0.5 rad), and of the gripper.
    fn step(
        &self,
        py: Python<'_>,
        actions: PyReadonlyArray2<'_, f64>,
        active: PyReadonlyArray1<'_, bool>,
        absolute: bool,
    ) -> PyResult<()> {
        let (actions, active) = (rows::<7>(&actions, "actions")?, active.as_slice()?);
        py.detach(|| {
            let slots = &mut *self.slots();
            let count = slots.len();
            self.threads.run(|| {
                let jobs = slots.par_iter_mut().zip(actions).zip(active).enumerate();
                jobs.try_for_each(|(number, ((slot, action), active))| {
                    if !active {
                        return Ok(());
                    }
                    let [x, y, z, a, b, c, gripper] = *action;
                    let arm = [x, y, z, a, b, c];
                    let arm = if absolute {
                        ArmAction::Absolute(arm)
                    } else {
                        ArmAction::Delta(arm)
                    };
                    let fault = match slot.step(&RobosuiteAction { arm, gripper }) {
                        Ok(()) => return Ok(()),
                        Err(fault) if count == 1 => fault,
                        Err(fault) => {
                            let remedy = fault.remedy().map(Cow::into_owned);
                            Fault::new(format!("environment {number}: {fault}"), remedy)
                        }
                    };
                    Err(fault.into())
                })
            })
        })
        .map_err(raised)
    }

    /// The results of the last reset or step, one row per simulation.
    fn outcome<'py>(&self, py: Python<'py>) -> PyResult<Outcome<'py>> {
        let slots = self.slots();
        let now: Vec<&(RobosuiteObservation, bool)> = slots
            .iter()
            .map(|slot| slot.now.as_ref().or_fault(not_reset))
            .collect::<Result<_, _>>()
            .map_err(raised)?;
        let observed = || now.iter().map(|(observation, _)| observation);
        let columns = self.task.layout(self.profile.version()).columns();
        let objects: Vec<Vec<f64>> = observed().map(|o| o.object_state(self.task, self.profile)).collect();
        debug_assert!(objects.iter().all(|object| object.len() == columns));
        let eef = observed().map(|o| {
            let t = o.grip_site.translation;
            [t.x, t.y, t.z]
        });
        Ok((
            table(py, eef)?,
            table(py, observed().map(|o| o.hand.coords.into()))?,
            table(py, observed().map(|o| o.fingers))?,
            PyArray2::from_vec2(py, &objects)?,
            PyArray1::from_iter(py, now.iter().map(|(_, success)| *success)),
        ))
    }

    /// The flattened state of a simulation: time, coordinates, velocities.
    fn state<'py>(&self, py: Python<'py>, number: usize) -> PyResult<Bound<'py, PyArray1<f64>>> {
        let slots = self.slots();
        let sim = slots.get(number).and_then(|slot| slot.sim.as_ref());
        let sim = sim.or_fault(not_reset).map_err(raised)?;
        Ok(PyArray1::from_vec(py, sim.state()))
    }
}

fn not_reset() -> Fault {
    fault!("the environment has no state yet"; "call reset first")
}

impl Slot {
    fn reset(&mut self, scene: &TaskScene, placement: &Placement) -> anyhow::Result<()> {
        let sim = match &mut self.sim {
            // The model of the seed is that of the simulation.
            Some(sim) if !placement.task.samples_models() => sim,
            other => other.insert(Robosuite::new(&scene.model(placement)?)?),
        };
        let placed = RobosuiteScene::Placed(placement.coordinates());
        let observation = sim.reset(&placed, FirstTorques::AsRobosuite)?;
        self.now = Some((observation, sim.success()));
        Ok(())
    }

    fn step(&mut self, action: &RobosuiteAction) -> Result<(), Fault> {
        let sim = self.sim.as_mut().ok_or_else(not_reset)?;
        let step = sim.step(action).map_err(|error| Fault::of(&error))?;
        self.now = Some((step.observation, step.success));
        Ok(())
    }
}
