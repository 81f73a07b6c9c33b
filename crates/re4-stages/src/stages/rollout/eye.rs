//! What a policy sees of a robosuite simulation: pictures as `ingest` draws them, and what the encoder says of them.

use std::cell::RefCell;

use anyhow::{Context as _, Result};
use nalgebra::Isometry3;
use re4_artifact::Artifact;
use re4_encoder::{PICTURE_BYTES, Predictor, SIDE};
use re4_mujoco::{Data, Gl, Kind, Model, Renderer};
use re4_policy::PolicyError;
use re4_policy::spatial::Observer;
use re4_robosuite::models::looks;
use re4_sim::robosuite::{Placement, Robosuite, RobosuiteTask};
use serde_json::{Value, json};

use crate::inputs::simulators::{Scenes, set_state};

/// Raised whenever the same states give other pictures.
const DRAWING_VERSION: u32 = 1;

thread_local! {
    /// A renderer works in the thread that made it alone, and takes longer to make than to draw a picture. It goes with the
    /// thread.
    static RENDERER: RefCell<Option<Renderer>> = const { RefCell::new(None) };
}

/// What the key of an artifact says of pictures drawn in rollouts.
pub(super) fn settings(camera: &str) -> Result<Value> {
    Ok(json!({
        "assets": "robosuite-1.4.1",
        "camera": camera,
        "gl": Gl::of_process().context("cannot draw what the policy sees")?.to_string(),
        "side": SIDE,
        "version": DRAWING_VERSION,
    }))
}

/// The scene of the rollouts with all that is drawn of it.
pub(crate) struct Studio {
    task: RobosuiteTask,
    mjcf: String,
    model: Model,
    camera: usize,
}

impl Studio {
    /// The scene of these demonstrations, seen by a camera.
    ///
    /// # Errors
    /// When an asset is missing, or the model has no such camera.
    pub(crate) fn open(scenes: &Scenes, episodes: &Artifact, task: RobosuiteTask, camera: &str) -> Result<Self> {
        let mjcf = scenes.drawn_mjcf(episodes)?;
        let model = scenes.compile(&mjcf)?.mujoco().clone();
        let camera = model
            .id(Kind::Camera, camera)
            .with_context(|| format!("cannot draw what the policy sees of {}", episodes.path().display()))?;
        Ok(Self {
            task,
            mjcf,
            model,
            camera,
        })
    }

    /// The camera in the scene of a seed, where boxes may have sizes of their own.
    pub(crate) fn lens(&self, seed: u32) -> Result<Lens> {
        if !self.task.draws_models() {
            return self.lens_of(&[]);
        }
        let mjcf = Placement::draw(self.task, seed).in_model(&self.mjcf)?.into_owned();
        self.lens_of(&looks(&mjcf)?.boxes)
    }

    /// The camera in a scene with boxes of these half sizes.
    pub(crate) fn lens_of(&self, boxes: &[(String, [f64; 3])]) -> Result<Lens> {
        let model = if boxes.is_empty() {
            self.model.clone()
        } else {
            let boxes = boxes.iter().map(|(name, size)| (name.as_str(), *size));
            self.model.with_boxes(boxes)?
        };
        Ok(Lens {
            data: Data::new(&model)?,
            camera: self.camera,
            pixels: vec![0; PICTURE_BYTES],
        })
    }
}

/// A camera in a scene.
pub(crate) struct Lens {
    data: Data,
    camera: usize,
    pixels: Vec<u8>,
}

impl Lens {
    /// The picture of a state (time, coordinates, velocities): 84 x 84 pixels, RGB, first row at the top; the one that `ingest`
    /// draws of the same state.
    pub(crate) fn draw(&mut self, state: &[f64]) -> Result<&[u8]> {
        set_state(&mut self.data, state)?;
        RENDERER.with_borrow_mut(|kept| -> Result<()> {
            let renderer = match kept {
                Some(renderer) if renderer.model().looks_like(self.data.model()) => renderer,
                other => {
                    // The memory of the last one first.
                    *other = None;
                    other.insert(Renderer::new(self.data.model(), SIDE, SIDE)?)
                }
            };
            Ok(renderer.draw_into(&mut self.data, self.camera, &mut self.pixels)?)
        })?;
        Ok(&self.pixels)
    }
}

/// Frees the renderer of this thread.
pub(crate) fn put_renderer_away() {
    drop(RENDERER.take());
}

/// A camera with an encoder behind it. Of the simulation it reads what it takes to draw it.
pub(super) struct Eye {
    pub(super) lens: Lens,
    pub(super) predictor: Predictor,
}

impl Observer for Eye {
    fn object(&mut self, simulation: &Robosuite) -> Result<Isometry3<f64>, PolicyError> {
        let picture = self.lens.draw(&simulation.state()).map_err(unseen)?;
        let mut predictions = self.predictor.predict(&[picture]).map_err(unseen)?;
        let seen = predictions.pop();
        Ok(seen
            .ok_or_else(|| unseen(anyhow::anyhow!("the encoder says nothing of a picture")))?
            .pose)
    }
}

/// A policy's error from one of drawing or estimating.
pub(crate) fn unseen(error: impl Into<anyhow::Error>) -> PolicyError {
    let reason = format!("{:#}", error.into());
    PolicyError::Look { reason }
}
