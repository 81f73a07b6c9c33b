//! Policies that act on observations given from Python.

use std::path::PathBuf;
use std::sync::{Arc, Mutex, PoisonError};

use nalgebra::Isometry3;
use numpy::PyReadonlyArray3;
use pyo3::prelude::*;
use pyo3::types::PyDict;
use re4_fault::{OrFault as _, bail, fault};
use re4_geometry::{Point2, Pose2};
use re4_robosuite::hand_from_site;
use re4_rollout::{
    Acted, Acting, ArmState, Domain, Estimator, Explanation, Given, Image, Plane, PlaneScene, Recorded, Space,
};
use re4_sim::robosuite::{Profile, RobosuiteTask};
use re4_sim::{ResetOrder, Scene};
use re4_stages::{AnyLivePolicy, LivePolicy, open_policy};

use crate::arrays::pose;
use crate::errors::raised;

/// A policy of a `rollouts` artifact, with its current episode.
#[pyclass(module = "re4_pipe._native", frozen)]
pub(crate) struct Policy {
    opened: Arc<Opened>,
    episode: Mutex<Episode>,
}

/// A policy by its domain.
enum Opened {
    Plane(LivePolicy<Plane>),
    Space(LivePolicy<Space>, RobosuiteTask, Profile),
}

/// The state of an episode. The policy is started by its first observation.
enum Episode {
    Plane(State<Plane>),
    Space(State<Space>),
}

struct State<D: Domain> {
    seed: u32,
    observed_from_world: Option<D::Motion>,
    running: Option<Box<dyn Acting<D>>>,
    estimator: Option<Box<dyn Estimator<D> + Send>>,
}

impl<D: Domain> State<D> {
    fn new(seed: u32, observed_from_world: Option<D::Motion>) -> Self {
        Self {
            seed,
            observed_from_world,
            running: None,
            estimator: None,
        }
    }

    /// The next action, in the world frame, with the decision in the frame of the demonstrations.
    fn act(
        &mut self,
        policy: &LivePolicy<D>,
        proprio: D::Proprio,
        object: Option<D::Pose>,
        image: Option<&Image>,
    ) -> anyhow::Result<Acted<D>>
    where
        D: Recorded,
    {
        let proprio = match &self.observed_from_world {
            Some(motion) => D::proprio_in(motion, &proprio),
            None => proprio,
        };
        let object = match &self.observed_from_world {
            Some(motion) => object.map(|pose| D::pose_in(motion, &pose)),
            None => object,
        };
        let running = match &mut self.running {
            Some(running) => running,
            none => {
                self.estimator = policy.estimator();
                none.insert(policy.start(self.seed, &proprio))
            }
        };
        let acted = match &mut self.estimator {
            Some(estimator) => running.act(&mut Given::seen(proprio, image, estimator.as_mut()))?,
            None => running.act(&mut Given::known(proprio, object))?,
        };
        Ok(match &self.observed_from_world {
            Some(motion) => Acted {
                action: D::action_in_world(&D::inverse(motion), &acted.action),
                ..acted
            },
            None => acted,
        })
    }
}

/// What of a decision does not depend on the domain.
fn decision<'py, D: Domain>(py: Python<'py>, decision: &Explanation<D>) -> PyResult<Bound<'py, PyDict>> {
    let dict = PyDict::new(py);
    dict.set_item("step", decision.step)?;
    dict.set_item("kind", decision.kind)?;
    dict.set_item("demo", decision.demo.map(|(demo, ..)| demo))?;
    dict.set_item("demo_frame", decision.demo.map(|(_, frame, _)| frame))?;
    dict.set_item("demo_end", decision.demo.map(|(.., end)| end))?;
    dict.set_item("reason", &decision.reason)?;
    Ok(dict)
}

/// The action, the name of its phase, and the decision that was made at this step.
type Answer<'py> = (Vec<f64>, &'static str, Option<Bound<'py, PyDict>>);

fn answer<'py, D: Domain>(
    py: Python<'py>,
    acted: &Acted<D>,
    action: impl Fn(&D::Action) -> Vec<f64>,
) -> PyResult<Answer<'py>> {
    let explained = acted.decision.as_ref().map(|explained| decision(py, explained));
    Ok((action(&acted.action), acted.phase.as_str(), explained.transpose()?))
}

/// Copies an image, height x width x 3.
fn image(array: Option<PyReadonlyArray3<'_, u8>>) -> PyResult<Option<Image>> {
    let Some(array) = array else { return Ok(None) };
    let [height, width] = [0, 1].map(|axis| array.as_array().shape()[axis]);
    Ok(Some(Image {
        width,
        height,
        pixels: array.as_slice()?.to_vec(),
    }))
}

#[pymethods]
impl Policy {
    /// Opens the policy of the `rollouts` artifact in `folder`, with the artifacts that it was made from, which are beside it.
    #[new]
    fn new(py: Python<'_>, folder: PathBuf) -> PyResult<Self> {
        let opened = py.detach(|| open_policy(&folder)).map_err(raised)?;
        let (opened, episode) = match opened {
            AnyLivePolicy::Plane(policy) => (Opened::Plane(policy), Episode::Plane(State::new(0, None))),
            AnyLivePolicy::Space(policy, task, profile) => (
                Opened::Space(policy, task, profile),
                Episode::Space(State::new(0, None)),
            ),
        };
        Ok(Self {
            opened: Arc::new(opened),
            episode: Mutex::new(episode),
        })
    }

    /// The same policy with an episode of its own. The demonstrations are shared.
    fn copy(&self) -> Self {
        let episode = match &*self.opened {
            Opened::Plane(_) => Episode::Plane(State::new(0, None)),
            Opened::Space(..) => Episode::Space(State::new(0, None)),
        };
        Self {
            opened: Arc::clone(&self.opened),
            episode: Mutex::new(episode),
        }
    }

    /// Name of the kind of policy.
    #[getter]
    fn kind(&self) -> String {
        match &*self.opened {
            Opened::Plane(policy) => policy.kind.clone(),
            Opened::Space(policy, ..) => policy.kind.clone(),
        }
    }

    /// Name of the task.
    #[getter]
    fn task(&self) -> &'static str {
        match &*self.opened {
            Opened::Plane(_) => "pusht",
            Opened::Space(_, task, _) => task.name,
        }
    }

    /// Version of robosuite whose conventions the demonstrations have, as major and minor number; `None` for Push-T.
    #[getter]
    fn robosuite(&self) -> Option<(u32, u32)> {
        match &*self.opened {
            Opened::Plane(_) => None,
            Opened::Space(_, _, profile) => Some(profile.version()),
        }
    }

    /// Whether the policy observes the object through images.
    #[getter]
    fn observes_images(&self) -> bool {
        match &*self.opened {
            Opened::Plane(policy) => policy.observes_images(),
            Opened::Space(policy, ..) => policy.observes_images(),
        }
    }

    /// Begins an episode. `seed` seeds the random numbers of the policy. `goal`: another goal pose of Push-T than the task's.
    fn reset(&self, seed: u32, goal: Option<[f64; 3]>) -> PyResult<()> {
        let mut episode = self.episode.lock().unwrap_or_else(PoisonError::into_inner);
        let started = match (&*self.opened, goal) {
            (Opened::Plane(policy), Some(_)) if policy.observes_images() => Err(fault!(
                "a policy from images observes the goal where its camera stands";
                "reset it without a goal"
            )),
            (Opened::Plane(_), Some([x, y, theta])) => {
                let goal = Pose2::new(x, y, theta);
                // Only the goal of the scene is read.
                let state = Scene {
                    agent: Point2::new(0.0, 0.0),
                    block: goal,
                };
                let order = ResetOrder::default();
                let motion = Plane::observed_from_world(&PlaneScene { state, order, goal });
                Ok(Episode::Plane(State::new(seed, motion)))
            }
            (Opened::Plane(_), None) => Ok(Episode::Plane(State::new(seed, None))),
            (Opened::Space(..), None) => Ok(Episode::Space(State::new(seed, None))),
            (Opened::Space(..), Some(_)) => {
                Err(fault!("the goals of robosuite's tasks are fixed"; "reset without a goal"))
            }
        };
        *episode = started.map_err(raised)?;
        Ok(())
    }

    /// Push-T: the next target of the agent. `agent`: position in px; `block`: pose in px and rad, or an image.
    fn act_plane<'py>(
        &self,
        py: Python<'py>,
        agent: [f64; 2],
        block: Option<[f64; 3]>,
        pixels: Option<PyReadonlyArray3<'_, u8>>,
    ) -> PyResult<Answer<'py>> {
        let pixels = image(pixels)?;
        let acted = py.detach(|| {
            let mut episode = self.episode.lock().unwrap_or_else(PoisonError::into_inner);
            let (Opened::Plane(policy), Episode::Plane(state)) = (&*self.opened, &mut *episode) else {
                bail!("the policy is not one of Push-T"; "give the observations of its task");
            };
            let block = block.map(|[x, y, theta]| Pose2::new(x, y, theta));
            state.act(policy, Point2::new(agent[0], agent[1]), block, pixels.as_ref())
        });
        answer(py, &acted.map_err(raised)?, |target| vec![target.x, target.y])
    }

    /// robosuite: the next goal of the grip site (position in m, rotation vector in rad) and the command of the gripper. `eef`:
    /// position of the grip site and quaternion of the hand; `fingers`: joint positions in m; `object`: pose, or an image.
    fn act_space<'py>(
        &self,
        py: Python<'py>,
        eef: [f64; 7],
        fingers: [f64; 2],
        object: Option<[f64; 7]>,
        pixels: Option<PyReadonlyArray3<'_, u8>>,
    ) -> PyResult<Answer<'py>> {
        let pixels = image(pixels)?;
        let acted = py.detach(|| {
            let mut episode = self.episode.lock().unwrap_or_else(PoisonError::into_inner);
            let (Opened::Space(policy, ..), Episode::Space(state)) = (&*self.opened, &mut *episode) else {
                bail!("the policy is not one of a robosuite task"; "give the observations of its task");
            };
            let hand = finite(&eef, "robot0_eef_pos and robot0_eef_quat")?;
            let arm = ArmState {
                eef: Isometry3::from_parts(hand.translation, hand.rotation * hand_from_site()),
                fingers,
            };
            let object = object.map(|object| finite(&object, "the object pose")).transpose()?;
            state.act(policy, arm, object, pixels.as_ref())
        });
        answer(py, &acted.map_err(raised)?, |action| {
            let (t, r) = (action.goal.translation.vector, action.goal.rotation.scaled_axis());
            vec![t.x, t.y, t.z, r.x, r.y, r.z, action.gripper]
        })
    }
}

/// A pose whose numbers are finite and whose quaternion has a direction.
fn finite(numbers: &[f64; 7], name: &str) -> anyhow::Result<Isometry3<f64>> {
    let pose = pose(numbers);
    let valid = numbers.iter().all(|number| number.is_finite()) && pose.rotation.coords.iter().all(|q| q.is_finite());
    valid.then_some(pose).or_fault(
        || fault!("{name} of the observation is no pose"; "give finite numbers and a quaternion of unit length"),
    )
}
