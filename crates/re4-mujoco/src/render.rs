//! Images of a simulation, as robosuite draws them.

use std::ffi::c_int;
use std::sync::{Arc, PoisonError};

use crate::block::Block;
use crate::gl::{Context, MAKING};
use crate::library::Viewport;
use crate::stage::{Drawn, Stage};
use crate::trim::{REFLECTION, trim};
use crate::{Data, Gl, Kind, Model, MujocoError, View};

/// Things that a scene may hold, as robosuite has it.
const MAX_GEOMS: c_int = 1_000;

/// `mjFB_OFFSCREEN`.
const OFFSCREEN: c_int = 1;

/// `mjCAMERA_FIXED`: one of the model's.
const FIXED: c_int = 2;

/// `mjCAT_ALL`.
const ALL: c_int = 7;

/// Groups of geoms and of sites (`mjNGROUP`).
const GROUPS: usize = 6;

/// `mjTEXTURE_2D`; all other kinds have six sides.
const FLAT: c_int = 0;

/// Memory that renderers of a model take, in bytes: where OpenGL draws in software all of it is the process's own.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Footprint {
    /// The model, and what all its renderers share.
    pub shared: u64,
    /// What each of them takes beside that.
    pub each: u64,
}

/// A triangle in a display list of Mesa: three corners of eight numbers and their indices, and what is set aside in vain.
const TRIANGLE: u64 = 130;

/// What each context of Mesa takes at most, its buffers left out: scenes that it sorts before it draws them, above all.
const CONTEXT: u64 = 36 << 20;

/// Draws simulations of one model, and of those that look like it, in the thread that made it.
///
/// Images are those of robosuite's off-screen renderer: geoms of group 0 (what collides) and sites are left out, everything
/// else is as MuJoCo has it by default. Renderers of models that look alike share meshes and textures, in whatever thread they
/// are.
pub struct Renderer {
    model: Model,
    option: Block,
    perturb: Block,
    camera: Block,
    scene: Block,
    drawn: Drawn,
    width: usize,
    height: usize,
    trimmed: bool,
    gl: Context,
    /// Dropped last.
    _stage: Arc<Stage>,
}

impl Renderer {
    /// A renderer of images of this size, in pixels.
    ///
    /// # Errors
    /// When there is no OpenGL library, or it refuses to work.
    pub fn new(model: &Model, width: usize, height: usize) -> Result<Self, MujocoError> {
        let stage = model.stage()?;
        let (gl, mut drawn) = stage.context(model, width, height)?;
        let layout = model.library().version().layout();
        let functions = model.library().functions();
        let sizes = &layout.sizes;
        let [mut option, mut perturb, mut camera, mut scene] =
            [sizes.option, sizes.perturb, sizes.camera, sizes.scene].map(Block::new);
        // SAFETY: each structure has the size and the fields of this version, the OpenGL context is current, and the scene and
        // the drawing context are freed when the renderer is dropped.
        unsafe {
            (functions.mjv_defaultOption)(option.pointer());
            option.set(layout.geomgroup, 0_u8);
            option.set(layout.sitegroup, [0_u8; GROUPS]);
            (functions.mjv_defaultPerturb)(perturb.pointer());
            (functions.mjv_defaultCamera)(camera.pointer());
            camera.set(layout.camera_type, FIXED);
            (functions.mjv_defaultScene)(scene.pointer());
            (functions.mjv_makeScene)(model.pointer(), scene.pointer(), MAX_GEOMS);
            (functions.mjr_setBuffer)(OFFSCREEN, drawn.context.pointer());
        }
        let mut renderer = Self {
            model: model.clone(),
            option,
            perturb,
            camera,
            scene,
            drawn,
            width,
            height,
            trimmed: true,
            gl,
            _stage: stage,
        };
        // SAFETY: the field is an `int`.
        if unsafe { renderer.drawn.context.get::<c_int>(layout.context_buffer) } != OFFSCREEN {
            return Err(MujocoError::Gl {
                gl: Gl::of_process()?,
                reason: "it has no buffers to draw to without a screen",
            });
        }
        Ok(renderer)
    }

    /// About how much memory renderers of images of this size take. Shadows take by far the most of what each renderer has
    /// for itself; where no light casts any, as in robosuite's scenes, there is no map of them.
    #[must_use]
    pub fn footprint(model: &Model, width: usize, height: usize) -> Footprint {
        // Four bytes a pixel, and a third for smaller copies.
        let textures = model.textures().into_iter().map(|(kind, rows, columns)| {
            let pixels = if kind == FLAT {
                rows * columns
            } else {
                6 * columns * columns
            };
            pixels * 16 / 3
        });
        let [shadow, samples] = model.quality();
        let map = if model.casts_shadows() { 4 * shadow * shadow } else { 0 };
        // Colour and depth of every sample, and once more without samples.
        let buffers = 8 * (samples + 1) * (width * height) as u64;
        Footprint {
            shared: model.bytes() + textures.sum::<u64>() + TRIANGLE * model.triangles(),
            each: map + buffers + CONTEXT,
        }
    }

    /// Whether what cannot be seen in an image is left out before it is drawn, which changes no pixel and takes half of the
    /// time or less; so it is unless told otherwise.
    pub fn set_trimmed(&mut self, trimmed: bool) {
        self.trimmed = trimmed;
    }

    /// The model that it was made for.
    #[must_use]
    pub fn model(&self) -> &Model {
        &self.model
    }

    /// Width and height of its images, in pixels.
    #[must_use]
    pub fn size(&self) -> (usize, usize) {
        (self.width, self.height)
    }

    /// What the camera of the last image saw; none before the first one.
    pub fn view(&mut self) -> Option<View> {
        // SAFETY: the scene was made for the model and is whole; before the first image its eyes are zeros.
        unsafe { View::of_scene(self.scene.pointer(), &self.model) }
    }

    /// Draws what a camera of the model sees: rows from top to bottom, three bytes (red, green, blue) a pixel. Poses must be up
    /// to date ([`Data::forward`]).
    ///
    /// # Errors
    /// When the model has no such camera, or OpenGL does not work in this thread.
    ///
    /// # Panics
    /// When the simulation is of a model that looks otherwise ([`Model::looks_like`]).
    pub fn draw(&mut self, data: &mut Data, camera: &str) -> Result<Vec<u8>, MujocoError> {
        let mut pixels = vec![0; 3 * self.width * self.height];
        let id = self.model.id(Kind::Camera, camera)?;
        self.draw_into(data, id, &mut pixels)?;
        Ok(pixels)
    }

    /// [`Renderer::draw`] for a camera of this number, into a buffer.
    ///
    /// # Errors
    /// When OpenGL does not work in this thread.
    ///
    /// # Panics
    /// When the simulation is of a model that looks otherwise, the model has no camera of this number, or the buffer has
    /// another length than an image.
    pub fn draw_into(&mut self, data: &mut Data, camera: usize, pixels: &mut [u8]) -> Result<(), MujocoError> {
        assert!(data.model().looks_like(&self.model) && camera < self.model.cameras());
        assert!(pixels.len() == 3 * self.width * self.height);
        self.gl.make_current()?;
        let model = data.model().clone();
        let library = model.library();
        let functions = library.functions();
        let viewport = Viewport {
            left: 0,
            bottom: 0,
            width: self.width as c_int,
            height: self.height as c_int,
        };
        // SAFETY: all structures are those of this version and were made for this model, the context is current, and the
        // buffer has the size of the image.
        unsafe {
            self.camera.set(library.version().layout().fixedcamid, camera as c_int);
            (functions.mjv_updateScene)(
                model.pointer(),
                data.pointer(),
                self.option.pointer(),
                self.perturb.pointer(),
                self.camera.pointer(),
                ALL,
                self.scene.pointer(),
            );
            self.scene
                .set(library.version().layout().scene_flags + REFLECTION, 1_u8);
            if self.trimmed {
                trim(self.scene.pointer(), &model, self.width as f64 / self.height as f64);
            }
            (functions.mjr_render)(viewport, self.scene.pointer(), self.drawn.context.pointer());
            (functions.mjr_readPixels)(
                pixels.as_mut_ptr(),
                std::ptr::null_mut(),
                viewport,
                self.drawn.context.pointer(),
            );
        }
        flip(pixels, 3 * self.width);
        Ok(())
    }
}

impl Drop for Renderer {
    fn drop(&mut self) {
        let library = self.model.library().clone();
        let functions = library.functions();
        let current = self.gl.make_current().is_ok();
        self.drawn.part(library.version().layout());
        let _alone = MAKING.lock().unwrap_or_else(PoisonError::into_inner);
        // SAFETY: both were made by the renderer and are not used again. What lies in OpenGL's memory goes with its context,
        // should that not be current.
        unsafe {
            (functions.mjv_freeScene)(self.scene.pointer());
            if current {
                (functions.mjr_freeContext)(self.drawn.context.pointer());
            }
        }
    }
}

/// OpenGL's rows go from bottom to top.
fn flip(pixels: &mut [u8], row: usize) {
    let mut rows = pixels.chunks_exact_mut(row);
    while let (Some(top), Some(bottom)) = (rows.next(), rows.next_back()) {
        top.swap_with_slice(bottom);
    }
}
