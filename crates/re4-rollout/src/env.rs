//! Simulations in which policies are rolled out.

use nalgebra::Isometry3;
use re4_geometry::{Point2, Pose2};
use re4_sim::robosuite::{FirstTorques, Placement, Robosuite, RobosuiteModel, RobosuiteScene, RobosuiteStep};
use re4_sim::{Canvas, OBSERVATION_SIDE, PushT, PushTObservation, Shapes, SimError, Simulator as _, Step};

use crate::scene_renderer::{SceneCamera, SceneRenderer};
use crate::{
    ArmAction, ArmState, Displaced, Displacement, Domain, Plane, PlaneScene, PolicyError, Space, SpaceFirst,
    robosuite_action,
};

/// An RGB image with 8 bits per channel, stored row by row from the top.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Image {
    /// Width in pixels.
    pub width: usize,
    /// Height in pixels.
    pub height: usize,
    /// `height * width * 3` bytes.
    pub pixels: Vec<u8>,
}

/// A simulation of one task.
///
/// The harness calls [`Env::reset`] once at the beginning of an episode, then [`Env::step`] once per control step. Policies have
/// no access to the environment; they use [`Senses`](crate::Senses).
pub trait Env<D: Domain> {
    /// Starts an episode and returns the state after the reset.
    ///
    /// # Errors
    /// If the simulator rejects the scene.
    fn reset(&mut self, scene: &D::Scene) -> Result<D::First, SimError>;

    /// Executes one control step.
    ///
    /// # Errors
    /// If the simulator rejects the action.
    fn step(&mut self, action: &D::Action) -> Result<D::Outcome, SimError>;

    /// Returns the proprioception in the current state.
    fn proprio(&self) -> D::Proprio;

    /// Returns the true object pose in the world frame.
    fn object(&self) -> D::Pose;

    /// Returns what an image of the current state shows, to render it at a later time.
    fn view(&self) -> D::View;

    /// Renders a view into `into`, which is resized as needed. With `observed_from_world`, the camera is moved: it sees the scene
    /// as it appears in that frame.
    ///
    /// # Errors
    /// [`PolicyError::Unobservable`] if the camera does not exist or the image cannot be rendered.
    fn render(
        &mut self,
        view: &D::View,
        observed_from_world: Option<&D::Motion>,
        camera: &str,
        into: &mut Image,
    ) -> Result<(), PolicyError>;

    /// Moves the object or the pusher, which is at rest afterwards. Returns false and changes nothing if the result would not be a
    /// valid scene.
    ///
    /// # Errors
    /// If the simulator rejects the new state.
    fn displace(&mut self, displacement: &Displacement) -> Result<bool, SimError>;
}

/// The Push-T simulation. Its only camera is `image`, which renders 96 x 96 pixels.
pub struct PushTEnv {
    simulator: PushT,
    /// Canvas that is reused from step to step. It is created with the first image.
    canvas: Option<Canvas>,
}

impl PushTEnv {
    /// Creates a simulator, which must be reset before use.
    ///
    /// # Errors
    /// If the version of the physics library is not the expected one.
    pub fn new() -> Result<Self, SimError> {
        Ok(Self {
            simulator: PushT::new()?,
            canvas: None,
        })
    }
}

impl Env<Plane> for PushTEnv {
    fn reset(&mut self, scene: &PlaneScene) -> Result<Step<PushTObservation>, SimError> {
        self.simulator.set_goal(scene.goal);
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

    fn view(&self) -> Shapes {
        self.simulator.shapes()
    }

    fn render(
        &mut self,
        view: &Shapes,
        observed_from_world: Option<&Pose2>,
        camera: &str,
        into: &mut Image,
    ) -> Result<(), PolicyError> {
        if camera != "image" {
            return Err(PolicyError::no_camera(camera));
        }
        let canvas = self.canvas.get_or_insert_default();
        match observed_from_world {
            Some(motion) => canvas.render_shapes(&view.clone().moved(*motion)),
            None => canvas.render_shapes(view),
        }
        canvas.observation_into(&mut into.pixels);
        (into.width, into.height) = (OBSERVATION_SIDE, OBSERVATION_SIDE);
        Ok(())
    }

    fn displace(&mut self, displacement: &Displacement) -> Result<bool, SimError> {
        let motion = displacement.motion;
        Ok(match displacement.what {
            Displaced::Object => self.simulator.displace_block(motion),
            Displaced::Pusher => self.simulator.displace_agent(motion.translation()),
        })
    }
}

/// The simulation of a robosuite task. As in robosuite, poses after a step are those 2 ms before its end.
pub struct RobosuiteEnv<'a> {
    simulation: Robosuite,
    now: RobosuiteStep,
    scene_renderer: Option<&'a SceneRenderer>,
    scene: Option<Placement>,
    /// Renders the current scene. It is created when the first image of an episode is requested.
    scene_camera: Option<SceneCamera>,
}

impl<'a> RobosuiteEnv<'a> {
    /// Creates a simulation of a model. Images can be rendered only if `scene_renderer` is given.
    ///
    /// # Errors
    /// If memory cannot be allocated.
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
        // The renderer's model may depend on the scene (the size of Lift's cube), so the next image needs a new one.
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

    fn view(&self) -> Vec<f64> {
        self.simulation.state()
    }

    fn render(
        &mut self,
        view: &Vec<f64>,
        _: Option<&Isometry3<f64>>,
        camera: &str,
        into: &mut Image,
    ) -> Result<(), PolicyError> {
        let scene_renderer = self.scene_renderer.ok_or_else(|| PolicyError::no_camera(camera))?;
        let scene_camera = match &mut self.scene_camera {
            Some(scene_camera) => scene_camera,
            none => none.insert(scene_renderer.scene_camera(self.scene.as_ref())?),
        };
        scene_camera.render(camera, view, into)
    }

    fn displace(&mut self, displacement: &Displacement) -> Result<bool, SimError> {
        if displacement.what == Displaced::Pusher {
            return Ok(false);
        }
        let moved = self.simulation.displace_object(displacement.motion)?;
        if moved {
            self.now.observation = self.simulation.observation();
        }
        Ok(moved)
    }
}
