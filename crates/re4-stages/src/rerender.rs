//! Renders rollouts of robosuite tasks. `rollouts` artifacts contain no images, so rollouts are simulated again from their first
//! states with their recorded actions, checked against the tables, and rendered by MuJoCo.

use std::cmp::Reverse;
use std::path::Path;

use anyhow::{Context as _, Result};
use nalgebra::Isometry3;
use re4_artifact::{Artifact, Stage};
use re4_fault::{OrFault as _, Remedy as _, bail, ensure, fault};
use re4_geometry::Pose2;
use re4_mujoco::{Data, Model, Renderer, View};
use re4_report::html::rollouts::space::{DecisionImage, FrameInImage, Space};
use re4_report::html::rollouts::{Rollout, Rollouts};
use re4_report::{find_input, spatial_rollouts, stated};
use re4_robosuite::models::split_appearance;
use re4_sim::Simulator as _;
use re4_sim::robosuite::{
    ArmAction, Fidelity, FirstTorques, Placement, Robosuite, RobosuiteAction, RobosuiteModel, RobosuiteScene,
    RobosuiteTask,
};

use crate::inputs::images::encode_png;
use crate::inputs::simulators::Scenes;
use crate::notes::fault_of;

/// The camera of the images: robosuite's, in front of the robot.
const CAMERA: &str = "agentview";
/// Maximum distance of the object between the new simulation and the table, per axis, in metres. A larger one means that the
/// images would show another rollout.
const TOLERANCE: f64 = 1e-6;
/// Number of rollouts with images on a page if poses come from images and the user gives no number.
const ROLLOUTS: usize = 8;
/// Maximum number of decisions with images per rollout.
const DECISIONS: usize = 48;
/// Side length of an image on a page, in pixels: the input size of the encoder.
const SIDE: u32 = 84;
/// Length of the axes that are rendered for a pose, in metres.
const AXIS: f64 = 0.05;

/// Rollouts that can be rendered in each of their states.
pub struct Rerendered {
    /// The rollouts.
    pub rollouts: Vec<Rollout<Space>>,
    /// Generalized coordinates (`qpos`) by rollout and state.
    coordinates: Vec<Vec<Vec<f64>>>,
    /// Simulation data of each rollout's model, including the visual geometry.
    sets: Vec<Data>,
    /// `None` if there are no rollouts.
    renderer: Option<Renderer>,
}

impl Rerendered {
    /// Simulates the rollouts of these seeds again, for square images with a side of `side` pixels. The `episodes` artifact is
    /// looked for beside the artifact and in `store`.
    ///
    /// # Errors
    /// If the artifact has no such rollout, an input of it cannot be found, the simulation deviates from the table, or rendering
    /// is not possible.
    pub fn new(artifact: &Artifact, seeds: &[u32], side: u32, store: &Path) -> Result<Self> {
        let config = &artifact.manifest().config;
        let task: RobosuiteTask = stated(artifact, "config", config, "task")?;
        let fidelity: Fidelity = stated(artifact, "config", config, "fidelity")?;
        let episodes = find_input(artifact, Stage::Ingest, store)?.or_fault(|| {
            fault!(
                "cannot render the rollouts of {}: the episodes artifact with their models is neither beside it nor in {}",
                artifact.path().display(),
                store.display();
                "name the artifacts folder with --artifacts"
            )
        })?;
        let scenes = Scenes::open(&episodes, task, fidelity)?;
        let with_visuals = scenes.rendered_mjcf(&episodes)?;
        let mut rerendered = Self {
            rollouts: spatial_rollouts(artifact, seeds)?,
            coordinates: Vec::new(),
            sets: Vec::new(),
            renderer: None,
        };
        for place in 0..rerendered.rollouts.len() {
            let rollout = &rerendered.rollouts[place];
            let placement = Placement::sample(task, rollout.core().seed);
            let model = scenes.compile(&placement.in_model(scenes.first_mjcf()?)?)?;
            rerendered.coordinates.push(again(artifact, &model, rollout)?);
            rerendered.set(&placement.in_model(&with_visuals)?, &scenes, side)?;
        }
        Ok(rerendered)
    }

    /// Adds the next rollout's model. Compiling a model with its visual geometry takes seconds, so only the first is compiled;
    /// the others differ from it only in the sizes of boxes, which are set in a copy.
    fn set(&mut self, mjcf: &str, scenes: &Scenes, side: u32) -> Result<()> {
        let model: Model = if let Some(renderer) = &self.renderer {
            let boxes = split_appearance(mjcf)?.boxes;
            let boxes = boxes.iter().map(|(name, size)| (name.as_str(), *size));
            renderer.model().with_boxes(boxes)?
        } else {
            let model = scenes.compile(mjcf)?.mujoco().clone();
            self.renderer = Some(Renderer::new(&model, side as usize, side as usize)?);
            model
        };
        self.sets.push(Data::new(&model)?);
        Ok(())
    }

    /// Renders a state of a rollout, both given by index. Returns RGB bytes, three per pixel, rows from top to bottom.
    ///
    /// # Errors
    /// If the renderer fails.
    pub fn render(&mut self, rollout: usize, state: usize) -> Result<Vec<u8>> {
        let data = &mut self.sets[rollout];
        let renderer = self.renderer.as_mut().context("there is no model to render")?;
        data.qpos_mut().copy_from_slice(&self.coordinates[rollout][state]);
        data.forward();
        Ok(renderer.render(data, CAMERA)?)
    }
}

/// Simulates a rollout again. Returns the generalized coordinates before each step and after the last.
fn again(artifact: &Artifact, model: &RobosuiteModel, rollout: &Rollout<Space>) -> Result<Vec<Vec<f64>>> {
    let mut simulation = Robosuite::new(model)?;
    let nq = model.mujoco().nq();
    let (seed, path) = (rollout.core().seed, artifact.path().display());
    let Some(start) = rollout.result.state.get(1..=nq) else {
        bail!(
            "cannot render seed {seed} of {path}: its first state has {} numbers, but the model has {nq} coordinates",
            rollout.result.state.len();
            "run the rollout again"
        );
    };
    simulation.reset(&RobosuiteScene::Placed(start.to_vec()), FirstTorques::AsRobosuite)?;
    let mut coordinates = vec![simulation.data().qpos().to_vec()];
    let disturbance = rollout.world.as_ref().and_then(|world| {
        let (moved, rotation) = (world.displacement?, world.rotation?);
        Some((world.disturbance_step? as usize, Pose2::new(moved.x, moved.y, rotation)))
    });
    for (number, step) in rollout.steps.iter().enumerate() {
        if let Some((_, motion)) = disturbance.filter(|(at, _)| *at == number) {
            simulation.displace_object(motion)?;
        }
        let after = simulation.step(&RobosuiteAction {
            arm: ArmAction::Absolute(step.action.0),
            gripper: step.gripper,
        })?;
        let away = (after.observation.object.translation.vector - step.object.translation.vector).amax();
        ensure!(
            away <= TOLERANCE,
            "cannot render seed {seed} of {path}: in the new simulation the object is {away:.1e} m away from its position in table steps after step {number}";
            "run the rollout again on this machine"
        );
        coordinates.push(simulation.data().qpos().to_vec());
    }
    Ok(coordinates)
}

/// Adds the camera images at decisions to up to `wanted` rollouts of a viewer, failed rollouts first. The choice is
/// deterministic, so the same page has the same images. `wanted = None` selects the default number.
///
/// # Errors
/// If `wanted` images cannot be rendered. If the default ones cannot, they are left out, and a warning is returned.
pub fn add_images(
    artifact: &Artifact,
    set: &mut Rollouts<Space>,
    wanted: Option<usize>,
    store: &Path,
) -> Result<Option<String>> {
    let usual = if set.variant == "image" { ROLLOUTS } else { 0 };
    let count = wanted.unwrap_or(usual);
    if count == 0 {
        return Ok(None);
    }
    let added = images(artifact, set, count, store).or_fault(
        || fault!("cannot show images of {}", artifact.path().display(); "leave --images out, or set it to 0"),
    );
    match added {
        Ok(()) => Ok(None),
        Err(error) if wanted.is_none() => Ok(Some(format!(
            "the page shows no images: {}",
            fault_of(&error).sentence()
        ))),
        Err(error) => Err(error),
    }
}

fn images(artifact: &Artifact, set: &mut Rollouts<Space>, count: usize, store: &Path) -> Result<()> {
    let mut chosen: Vec<&Rollout<Space>> = set.rollouts.iter().filter(|rollout| rollout.shown).collect();
    chosen.sort_by_key(|rollout| Reverse(!rollout.core().success));
    chosen.truncate(count);
    let seeds: Vec<u32> = chosen.iter().map(|rollout| rollout.core().seed).collect();
    let mut rerendered = Rerendered::new(artifact, &seeds, SIDE, store)?;
    for (place, rollout) in chosen.into_iter().enumerate() {
        for (number, decision) in (0..).zip(rollout.decisions.iter().take(DECISIONS)) {
            let pixels = rerendered.render(place, decision.core().step as usize)?;
            let view = rerendered.renderer.as_mut().and_then(Renderer::view);
            let project = |pose: Option<&Isometry3<f64>>| project(view.as_ref(), pose);
            let image = DecisionImage {
                camera: CAMERA,
                side: SIDE,
                png: encode_png(&pixels, SIDE, SIDE)?,
                observed: project(decision.core.query_object.as_ref()),
                simulated: project(Some(&rollout.object_before(decision.core().step as usize))),
            };
            set.scene.images.insert((rollout.core().seed, number), image);
        }
    }
    Ok(())
}

/// Pixel coordinates of a frame's origin and of the ends of its axes; `None` for points that are not visible and for no frame.
fn project(view: Option<&View>, pose: Option<&Isometry3<f64>>) -> FrameInImage {
    let ends = [[0.0; 3], [AXIS, 0.0, 0.0], [0.0, AXIS, 0.0], [0.0, 0.0, AXIS]];
    ends.map(|end| {
        let point = pose?.transform_point(&end.into());
        view?.pixel([point.x, point.y, point.z], SIDE as usize, SIDE as usize)
    })
}
