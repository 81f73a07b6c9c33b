//! Simulations that policies are rolled out in.

use nalgebra::Isometry3;
use re4_geometry::{Point2, Pose2};
use re4_sim::robosuite::{FirstTorques, Placement, Robosuite, RobosuiteModel, RobosuiteScene, RobosuiteStep};
use re4_sim::{Canvas, OBSERVATION_SIDE, PushT, PushTObservation, SimError, Simulator as _, Step};

use crate::scene_renderer::{SceneCamera, SceneRenderer};
use crate::{ArmAction, ArmState, Domain, Plane, PlaneScene, PolicyError, Space, SpaceFirst, robosuite_action};

/// An image: RGB, 8 bits a channel, row by row from the top.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Image {
    /// Width in pixels.
    pub width: usize,
    /// Height in pixels.
    pub height: usize,
    /// `height * width * 3` bytes.
    pub pixels: Vec<u8>,
}

/// A simulation of a task.
pub trait Env<D: Domain> {
    /// Starts an episode.
    ///
    /// # Errors
    /// When the simulator refuses the scene.
    fn reset(&mut self, scene: &D::Scene) -> Result<D::First, SimError>;

    /// Takes one control step.
    ///
    /// # Errors
    /// When the simulator refuses the action.
    fn step(&mut self, action: &D::Action) -> Result<D::Outcome, SimError>;

    /// What is felt now.
    fn proprio(&self) -> D::Proprio;

    /// The object's true pose.
    fn object(&self) -> D::Pose;

    /// Renders the present state.
    ///
    /// # Errors
    /// [`PolicyError::Look`] when there is no such camera, or it cannot be rendered.
    fn render(&mut self, camera: &str, into: &mut Image) -> Result<(), PolicyError>;
}

/// Push-T, whose only camera is `image`: 96 x 96.
pub struct PushTEnv {
    simulator: PushT,
    /// Drawn on from step to step, where there are images.
    canvas: Option<Canvas>,
}

impl PushTEnv {
    /// A simulator before its first reset.
    ///
    /// # Errors
    /// When the physics library is of another version.
    pub fn new() -> Result<Self, SimError> {
        Ok(Self {
            simulator: PushT::new()?,
            canvas: None,
        })
    }
}

impl Env<Plane> for PushTEnv {
    fn reset(&mut self, scene: &PlaneScene) -> Result<Step<PushTObservation>, SimError> {
        self.simulator.reset(&scene.state, scene.order)?;
        Ok(self.simulator.outcome())
    }

    fn step(&mut self, action: &Point2) -> Result<Step<PushTObservation>, SimError> {
        self.simulator.step(action)
    }

    fn proprio(&self) -> Point2 {
        self.simulator.observation().agent
    }

    fn object(&self) -> Pose2 {
        self.simulator.observation().block
    }

    fn render(&mut self, camera: &str, into: &mut Image) -> Result<(), PolicyError> {
        if camera != "image" {
            return Err(PolicyError::no_camera(camera));
        }
        let canvas = self.canvas.get_or_insert_default();
        self.simulator.render_into(canvas);
        canvas.observation_into(&mut into.pixels);
        (into.width, into.height) = (OBSERVATION_SIDE, OBSERVATION_SIDE);
        Ok(())
    }
}

/// A robosuite task.
pub struct RobosuiteEnv<'a> {
    simulation: Robosuite,
    now: RobosuiteStep,
    scene_renderer: Option<&'a SceneRenderer>,
    scene: Option<Placement>,
    scene_camera: Option<SceneCamera>,
}

impl<'a> RobosuiteEnv<'a> {
    /// A simulation of a model. It can be rendered where there is a scene_renderer.
    ///
    /// # Errors
    /// When there is no memory.
    pub fn new(model: &RobosuiteModel, scene_renderer: Option<&'a SceneRenderer>) -> Result<Self, SimError> {
        let simulation = Robosuite::new(model)?;
        let now = RobosuiteStep {
            observation: simulation.observation(),
            success: false,
        };
        Ok(Self {
            simulation,
            now,
            scene_renderer,
            scene: None,
            scene_camera: None,
        })
    }
}

impl Env<Space> for RobosuiteEnv<'_> {
    fn reset(&mut self, scene: &Placement) -> Result<SpaceFirst, SimError> {
        let placed = RobosuiteScene::Placed(scene.coordinates());
        let observation = self.simulation.reset(&placed, FirstTorques::AsRobosuite)?;
        self.now = RobosuiteStep {
            observation,
            success: false,
        };
        (self.scene, self.scene_camera) = (Some(scene.clone()), None);
        Ok(SpaceFirst {
            observation,
            state: self.simulation.state(),
        })
    }

    fn step(&mut self, action: &ArmAction) -> Result<RobosuiteStep, SimError> {
        self.now = self.simulation.step(&robosuite_action(action))?;
        Ok(self.now)
    }

    fn proprio(&self) -> ArmState {
        ArmState::from(&self.now.observation)
    }

    fn object(&self) -> Isometry3<f64> {
        self.now.observation.object
    }

    fn render(&mut self, camera: &str, into: &mut Image) -> Result<(), PolicyError> {
        let scene_renderer = self.scene_renderer.ok_or_else(|| PolicyError::no_camera(camera))?;
        let scene_camera = match &mut self.scene_camera {
            Some(scene_camera) => scene_camera,
            none => none.insert(scene_renderer.scene_camera(self.scene.as_ref())?),
        };
        scene_camera.draw(camera, &self.simulation.state(), into)
    }
}
