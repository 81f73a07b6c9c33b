//! Images of robosuite's tasks, as `ingest` draws them.

use std::cell::RefCell;

use re4_mujoco::{Data, Kind, Model, MujocoError, Renderer};
use re4_robosuite::models::looks;
use re4_sim::robosuite::Placement;

use crate::{Image, PolicyError};

thread_local! {
    /// A renderer works in the thread that made it alone, and takes longer to make than to draw an image. It goes with the
    /// thread.
    static RENDERER: RefCell<Option<Renderer>> = const { RefCell::new(None) };
}

/// Puts a flattened state (time, coordinates, velocities) into a simulation and computes what an image of it depends on.
///
/// # Errors
/// When the state has another length than the model's.
pub fn set_state(data: &mut Data, state: &[f64]) -> Result<(), String> {
    let (nq, nv) = (data.model().nq(), data.model().nv());
    if state.len() != 1 + nq + nv {
        return Err(format!(
            "cannot draw a state of {} numbers: the model has the time, {nq} coordinates and {nv} velocities",
            state.len()
        ));
    }
    data.set_time(state[0]);
    data.qpos_mut().copy_from_slice(&state[1..=nq]);
    data.qvel_mut().copy_from_slice(&state[1 + nq..]);
    data.forward();
    Ok(())
}

/// A scene with all that is drawn of it.
pub struct SceneRenderer {
    mjcf: String,
    model: Model,
    side: usize,
}

impl SceneRenderer {
    /// A scene, by its MJCF and the model compiled from it, of which images of `side` x `side` pixels are rendered.
    pub fn new(mjcf: String, model: Model, side: usize) -> Self {
        Self { mjcf, model, side }
    }

    /// Says whether the scene has a camera.
    ///
    /// # Errors
    /// When it does not.
    pub fn camera(&self, name: &str) -> Result<(), MujocoError> {
        self.model.id(Kind::Camera, name).map(drop)
    }

    /// What renders the scene as it was drawn for a seed, with boxes that may have sizes of their own.
    ///
    /// # Errors
    /// When there is no memory, or the MJCF cannot be read.
    pub fn scene_camera(&self, scene: Option<&Placement>) -> Result<SceneCamera, PolicyError> {
        match scene {
            Some(scene) if scene.task.draws_models() => {
                let mjcf = scene.in_model(&self.mjcf).map_err(PolicyError::look)?;
                self.scene_camera_of(&looks(&mjcf).map_err(PolicyError::look)?.boxes)
            }
            _ => self.scene_camera_of(&[]),
        }
    }

    /// What renders the scene with boxes of these half sizes.
    ///
    /// # Errors
    /// When there is no memory.
    pub fn scene_camera_of(&self, boxes: &[(String, [f64; 3])]) -> Result<SceneCamera, PolicyError> {
        let model = if boxes.is_empty() {
            self.model.clone()
        } else {
            let boxes = boxes.iter().map(|(name, size)| (name.as_str(), *size));
            self.model.with_boxes(boxes).map_err(PolicyError::look)?
        };
        Ok(SceneCamera {
            data: Data::new(&model).map_err(PolicyError::look)?,
            side: self.side,
        })
    }
}

/// Renders the states of a scene.
pub struct SceneCamera {
    data: Data,
    side: usize,
}

impl SceneCamera {
    /// Renders what a camera shows of a state (time, coordinates, velocities): the image that `ingest` draws of the same state.
    ///
    /// # Errors
    /// [`PolicyError::Look`] when the state is not one of the scene, there is no such camera, or nothing can be rendered here.
    pub fn draw(&mut self, camera: &str, state: &[f64], into: &mut Image) -> Result<(), PolicyError> {
        set_state(&mut self.data, state).map_err(PolicyError::look)?;
        into.pixels.resize(self.side * self.side * 3, 0);
        (into.width, into.height) = (self.side, self.side);
        let drawn = RENDERER.with_borrow_mut(|kept| -> Result<(), MujocoError> {
            let camera = self.data.model().id(Kind::Camera, camera)?;
            let renderer = match kept {
                Some(renderer) if renderer.model().looks_like(self.data.model()) => renderer,
                other => {
                    // The memory of the last one first.
                    *other = None;
                    other.insert(Renderer::new(self.data.model(), self.side, self.side)?)
                }
            };
            renderer.draw_into(&mut self.data, camera, &mut into.pixels)
        });
        drawn.map_err(PolicyError::look)
    }
}

/// Frees the renderer of this thread.
pub fn drop_renderer() {
    drop(RENDERER.take());
}
