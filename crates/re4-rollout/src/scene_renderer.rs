//! Renders images of the robosuite tasks in the same way as `ingest`.

use std::cell::RefCell;

use re4_mujoco::{Data, Kind, Model, MujocoError, Renderer};
use re4_robosuite::models::split_appearance;
use re4_sim::robosuite::Placement;

use crate::{Image, PolicyError};

thread_local! {
    /// The renderer of the current thread. A renderer can only be used on the thread that created it, and creating one takes
    /// longer than rendering an image. It is freed when the thread ends.
    static RENDERER: RefCell<Option<Renderer>> = const { RefCell::new(None) };
}

/// Sets a flattened state (time, qpos, qvel) in a simulation and computes the quantities that rendering needs.
///
/// # Errors
/// A message, if the length of the state does not match the model.
pub fn set_state(data: &mut Data, state: &[f64]) -> Result<(), String> {
    let (nq, nv) = (data.model().nq(), data.model().nv());
    if state.len() != 1 + nq + nv {
        return Err(format!(
            "the state has {} numbers, and the model needs {} (the time, {nq} coordinates and {nv} velocities)",
            state.len(),
            1 + nq + nv
        ));
    }
    data.set_time(state[0]);
    data.qpos_mut().copy_from_slice(&state[1..=nq]);
    data.qvel_mut().copy_from_slice(&state[1 + nq..]);
    data.forward();
    Ok(())
}

/// A scene of a robosuite task with all visual elements.
pub struct SceneRenderer {
    mjcf: String,
    model: Model,
    side: usize,
}

impl SceneRenderer {
    /// Creates a renderer of a scene from its MJCF and the model compiled from it. Images have `side` x `side` pixels.
    pub fn new(mjcf: String, model: Model, side: usize) -> Self {
        Self { mjcf, model, side }
    }

    /// Checks that the scene has a camera of this name.
    ///
    /// # Errors
    /// If it does not.
    pub fn camera(&self, name: &str) -> Result<(), MujocoError> {
        self.model.id(Kind::Camera, name).map(drop)
    }

    /// Creates a [`SceneCamera`] for a sampled scene. In some tasks the sampled scene also defines the sizes of boxes. `None`
    /// uses the sizes of the model.
    ///
    /// # Errors
    /// If memory cannot be allocated or the MJCF cannot be parsed.
    pub fn scene_camera(&self, scene: Option<&Placement>) -> Result<SceneCamera, PolicyError> {
        match scene {
            Some(scene) if scene.task.samples_models() => {
                let mjcf = scene.in_model(&self.mjcf).map_err(PolicyError::unobservable)?;
                self.scene_camera_of(&split_appearance(&mjcf).map_err(PolicyError::unobservable)?.boxes)
            }
            _ => self.scene_camera_of(&[]),
        }
    }

    /// Creates a [`SceneCamera`] for the scene with other half sizes (metres) of the named boxes.
    ///
    /// # Errors
    /// If a name is not that of a box, or memory cannot be allocated.
    pub fn scene_camera_of(&self, boxes: &[(String, [f64; 3])]) -> Result<SceneCamera, PolicyError> {
        let model = if boxes.is_empty() {
            self.model.clone()
        } else {
            let boxes = boxes.iter().map(|(name, size)| (name.as_str(), *size));
            self.model.with_boxes(boxes).map_err(PolicyError::unobservable)?
        };
        Ok(SceneCamera {
            data: Data::new(&model).map_err(PolicyError::unobservable)?,
            side: self.side,
        })
    }
}

/// Renders states of one scene.
pub struct SceneCamera {
    data: Data,
    side: usize,
}

impl SceneCamera {
    /// Renders the image of a camera in a state (time, qpos, qvel). The image is identical to the one that `ingest` renders of
    /// the same state.
    ///
    /// # Errors
    /// [`PolicyError::Unobservable`] if the state does not match the scene, the camera does not exist, or rendering is not possible on
    /// this machine.
    pub fn render(&mut self, camera: &str, state: &[f64], into: &mut Image) -> Result<(), PolicyError> {
        set_state(&mut self.data, state).map_err(PolicyError::unobservable)?;
        into.pixels.resize(self.side * self.side * 3, 0);
        (into.width, into.height) = (self.side, self.side);
        let rendered = RENDERER.with_borrow_mut(|cached| -> Result<(), MujocoError> {
            let camera = self.data.model().id(Kind::Camera, camera)?;
            let renderer = match cached {
                Some(renderer) if renderer.model().has_same_appearance(self.data.model()) => renderer,
                other => {
                    // Free the memory of the old renderer before the new one is created.
                    *other = None;
                    other.insert(Renderer::new(self.data.model(), self.side, self.side)?)
                }
            };
            renderer.render_into(&mut self.data, camera, &mut into.pixels)
        });
        rendered.map_err(PolicyError::unobservable)
    }
}

/// Frees the renderer of the current thread.
pub fn drop_renderer() {
    drop(RENDERER.take());
}
