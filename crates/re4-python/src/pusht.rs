//! Push-T for arrays of actions.

use std::sync::{Mutex, MutexGuard, PoisonError};

use numpy::{PyArray1, PyArray2, PyArray4, PyArrayMethods as _, PyReadonlyArray1, PyReadonlyArray2};
use pyo3::prelude::*;
use rayon::prelude::*;
use re4_fault::{Fault, Remedy as _, bail};
use re4_geometry::{Point2, Pose2};
use re4_sim::{
    Canvas, OBSERVATION_SIDE, PushT, PushTObservation, ResetOrder, Scene, SimError, Simulator as _, Step,
    tee_rectangles,
};

use crate::arrays::{rows, table};
use crate::errors::raised;
use crate::threads::Threads;

/// Simulations of Push-T that are stepped together.
#[pyclass(module = "re4_pipe._native", frozen)]
pub(crate) struct PushTSims {
    /// A simulation can be sent to another thread, but not shared.
    inner: Mutex<Inner>,
    threads: Threads,
}

struct Inner {
    sims: Vec<PushT>,
    /// Result of the last reset or step of each simulation.
    now: Vec<Step<PushTObservation>>,
    canvas: Option<Canvas>,
}

impl PushTSims {
    fn inner(&self) -> MutexGuard<'_, Inner> {
        self.inner.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// What a step returns: state, velocity of the agent, block pose with its angle not wrapped, coverage, contacts, success.
type Outcome<'py> = (
    Bound<'py, PyArray2<f64>>,
    Bound<'py, PyArray2<f64>>,
    Bound<'py, PyArray2<f64>>,
    Bound<'py, PyArray1<f64>>,
    Bound<'py, PyArray1<i64>>,
    Bound<'py, PyArray1<bool>>,
);

/// A simulation to step, with its number, its last result, its action, and whether it is stepped.
type Job<'a> = (
    usize,
    (
        (&'a mut PushT, &'a mut Step<PushTObservation>),
        (&'a [f64; 2], &'a bool),
    ),
);

/// The error of one simulation, with its number if there are several.
fn of(number: usize, count: usize, error: &SimError) -> anyhow::Error {
    let fault = Fault::of(error);
    if count == 1 {
        return fault.into();
    }
    let remedy = fault.remedy().map(std::borrow::Cow::into_owned);
    Fault::new(format!("environment {number}: {fault}"), remedy).into()
}

#[pymethods]
impl PushTSims {
    /// `count` simulations in gym-pusht's state before its first reset, stepped by `threads` threads (0: one per processor).
    #[new]
    fn new(count: usize, threads: usize) -> PyResult<Self> {
        let sims: Vec<PushT> = (0..count)
            .map(|_| PushT::new())
            .collect::<Result<_, _>>()
            .map_err(|error| raised(Fault::of(&error)))?;
        Ok(Self {
            inner: Mutex::new(Inner {
                now: sims.iter().map(PushT::outcome).collect(),
                sims,
                canvas: None,
            }),
            threads: Threads::new(threads),
        })
    }

    /// Sets the goal pose of all simulations: px, px, rad.
    fn set_goal(&self, goal: [f64; 3]) {
        let [x, y, theta] = goal;
        let Inner { sims, now, .. } = &mut *self.inner();
        for (sim, now) in sims.iter_mut().zip(now) {
            sim.set_goal(Pose2::new(x, y, theta));
            *now = sim.outcome();
        }
    }

    /// Resets the simulations `which` to `states` (agent x, y, block x, y, angle). `legacy`: the order in which gym-pusht sets
    /// position and angle.
    fn reset(
        &self,
        py: Python<'_>,
        which: PyReadonlyArray1<'_, i64>,
        states: PyReadonlyArray2<'_, f64>,
        legacy: bool,
    ) -> PyResult<()> {
        let states = rows::<5>(&states, "states")?;
        let which = which.as_slice()?;
        let order = if legacy {
            ResetOrder::Legacy
        } else {
            ResetOrder::PoseIsPose
        };
        py.detach(|| {
            let Inner { sims, now, .. } = &mut *self.inner();
            let count = sims.len();
            for (number, &[x, y, block_x, block_y, theta]) in which.iter().zip(states) {
                let number = *number as usize;
                let (Some(sim), Some(now)) = (sims.get_mut(number), now.get_mut(number)) else {
                    bail!("there is no environment {number}"; "give a number below {count}");
                };
                let scene = Scene {
                    agent: Point2::new(x, y),
                    block: Pose2::new(block_x, block_y, theta),
                };
                sim.reset(&scene, order).map_err(|error| of(number, count, &error))?;
                *now = sim.outcome();
            }
            Ok(())
        })
        .map_err(|error: anyhow::Error| raised(error))
    }

    /// Executes one control step of every simulation whose entry in `active` is true. `actions`: targets of the agents, px.
    fn step(
        &self,
        py: Python<'_>,
        actions: PyReadonlyArray2<'_, f64>,
        active: PyReadonlyArray1<'_, bool>,
    ) -> PyResult<()> {
        let (actions, active) = (rows::<2>(&actions, "actions")?, active.as_slice()?);
        // A step takes some 15 us, so a thread gets several simulations.
        py.detach(|| {
            let Inner { sims, now, .. } = &mut *self.inner();
            let count = sims.len();
            let one = |(number, ((sim, now), (action, active))): Job<'_>| -> anyhow::Result<()> {
                if *active {
                    let stepped = sim.step(&Point2::new(action[0], action[1]));
                    *now = stepped.map_err(|error| of(number, count, &error))?;
                }
                Ok(())
            };
            if self.threads.count() == 1 {
                let jobs = sims.iter_mut().zip(now).zip(actions.iter().zip(active));
                return jobs.enumerate().try_for_each(one);
            }
            self.threads.run(|| {
                let jobs = sims.par_iter_mut().zip(now).zip(actions.par_iter().zip(active));
                jobs.enumerate().with_min_len(8).try_for_each(one)
            })
        })
        .map_err(raised)
    }

    /// The results of the last reset or step, one row per simulation: state (agent x, y, block x, y, angle in [0, 2 pi)), velocity
    /// of the agent, block pose with its angle not wrapped, coverage, contacts, success.
    fn outcome<'py>(&self, py: Python<'py>) -> PyResult<Outcome<'py>> {
        let Inner { sims, now, .. } = &*self.inner();
        let observed = || now.iter().map(|now| &now.observation);
        let state = observed().map(|o| [o.agent.x, o.agent.y, o.block.x, o.block.y, o.block.theta]);
        let block = sims.iter().map(|sim| {
            let pose = sim.block_pose();
            [pose.x, pose.y, pose.theta]
        });
        Ok((
            table(py, state)?,
            table(py, observed().map(|o| [o.agent_velocity.x, o.agent_velocity.y]))?,
            table(py, block)?,
            PyArray1::from_iter(py, now.iter().map(|now| now.coverage)),
            PyArray1::from_iter(py, now.iter().map(|now| i64::from(now.contacts))),
            PyArray1::from_iter(py, now.iter().map(|now| now.success)),
        ))
    }

    /// The corners of the blocks: 16 numbers per simulation, x and y of 8 corners, px. The order of operations is gym-pusht's.
    fn corners<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f64>>> {
        let inner = self.inner();
        let corners = inner.sims.iter().map(|sim| {
            let block = sim.block_pose();
            let (sine, cosine) = block.theta.sin_cos();
            let mut numbers = [0.0; 16];
            for (pair, p) in numbers.chunks_exact_mut(2).zip(tee_rectangles().iter().flatten()) {
                pair[0] = (p.x * cosine - p.y * sine) + block.x;
                pair[1] = (p.x * sine + p.y * cosine) + block.y;
            }
            numbers
        });
        table(py, corners)
    }

    /// Images of the simulations, RGB with 8 bits: 96 x 96 pixels as policies observe them, or the whole canvas of 512 x 512.
    fn images<'py>(&self, py: Python<'py>, whole: bool) -> PyResult<Bound<'py, PyArray4<u8>>> {
        let side = if whole { Canvas::SIDE } else { OBSERVATION_SIDE };
        let (bytes, count) = py.detach(|| {
            let Inner { sims, canvas, .. } = &mut *self.inner();
            let canvas = canvas.get_or_insert_default();
            let mut bytes = Vec::with_capacity(sims.len() * side * side * 3);
            let mut observation = Vec::new();
            for sim in &*sims {
                sim.render_into(canvas);
                if whole {
                    bytes.extend_from_slice(canvas.bytes());
                } else {
                    canvas.observation_into(&mut observation);
                    bytes.extend_from_slice(&observation);
                }
            }
            (bytes, sims.len())
        });
        PyArray1::from_vec(py, bytes).reshape([count, side, side, 3])
    }
}
