//! Rendering images of a simulation in the same way as robosuite.

use std::ffi::c_int;
use std::sync::{Arc, PoisonError};

use crate::block::Block;
use crate::gl::{Context, MAKING};
use crate::library::Viewport;
use crate::shared_assets::{RenderContext, SharedAssets};
use crate::trim::{REFLECTION, trim};
use crate::{Data, Gl, Kind, Model, MujocoError, View};

/// Maximum number of geoms in a scene, as in robosuite.
const MAX_GEOMS: c_int = 1_000;

/// `mjFB_OFFSCREEN`.
const OFFSCREEN: c_int = 1;

/// `mjCAMERA_FIXED`: a camera of the model.
const FIXED: c_int = 2;

/// `mjCAT_ALL`.
const ALL: c_int = 7;

/// Number of groups of geoms and of sites (`mjNGROUP`).
const GROUPS: usize = 6;

/// `mjTEXTURE_2D`. All other kinds of textures have six sides.
const FLAT: c_int = 0;

/// Estimate of the memory that renderers of a model use, in bytes. With software rendering all of it is memory of the process.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Footprint {
    /// Memory of the model and of the data that all its renderers share.
    pub shared: u64,
    /// Additional memory per renderer.
    pub each: u64,
}

/// Bytes per triangle in a display list of Mesa: three corners of eight numbers with their indices, and unused space.
const TRIANGLE: u64 = 130;

/// Maximum memory (bytes) of a context of Mesa without its buffers. Most of it is for scenes that Mesa sorts before rendering.
const CONTEXT: u64 = 36 << 20;

/// Renders simulations of one model and of models with the same appearance, in the thread that made it.
///
/// The images are those of robosuite's off-screen renderer: geoms of group 0 (collision geoms) and sites are not shown, and all
/// other options have MuJoCo's default values. Renderers of models with the same appearance share meshes and textures, even in
/// different threads.
pub struct Renderer {
    model: Model,
    option: Block,
    perturb: Block,
    camera: Block,
    scene: Block,
    context: RenderContext,
    width: usize,
    height: usize,
    trimmed: bool,
    gl: Context,
    /// Dropped last, because `context` uses its textures and meshes.
    _shared: Arc<SharedAssets>,
}

impl Renderer {
    /// Makes a renderer for images of this size, in pixels.
    ///
    /// # Errors
    /// If there is no OpenGL library, or an OpenGL operation fails.
    pub fn new(model: &Model, width: usize, height: usize) -> Result<Self, MujocoError> {
        let shared = model.shared_assets()?;
        let (gl, mut context) = shared.context(model, width, height)?;
        let layout = model.library().version().layout();
        let functions = model.library().functions();
        let sizes = &layout.sizes;
        let [mut option, mut perturb, mut camera, mut scene] =
            [sizes.option, sizes.perturb, sizes.camera, sizes.scene].map(Block::new);
        // SAFETY: each structure has the size and the fields of this version, the OpenGL context is current, and `Drop` frees
        // the scene and the rendering context.
        unsafe {
            (functions.mjv_defaultOption)(option.pointer());
            option.set(layout.geomgroup, 0_u8);
            option.set(layout.sitegroup, [0_u8; GROUPS]);
            (functions.mjv_defaultPerturb)(perturb.pointer());
            (functions.mjv_defaultCamera)(camera.pointer());
            camera.set(layout.camera_type, FIXED);
            (functions.mjv_defaultScene)(scene.pointer());
            (functions.mjv_makeScene)(model.pointer(), scene.pointer(), MAX_GEOMS);
            (functions.mjr_setBuffer)(OFFSCREEN, context.structure.pointer());
        }
        let mut renderer = Self {
            model: model.clone(),
            option,
            perturb,
            camera,
            scene,
            context,
            width,
            height,
            trimmed: true,
            gl,
            _shared: shared,
        };
        // SAFETY: the field is an `int`.
        if unsafe { renderer.context.structure.get::<c_int>(layout.context_buffer) } != OFFSCREEN {
            return Err(MujocoError::Gl {
                gl: Gl::of_process()?,
                reason: "it has no off-screen buffers",
            });
        }
        Ok(renderer)
    }

    /// Estimates the memory of renderers for images of this size (pixels). The shadow map is by far the largest part of each
    /// renderer. There is none if no light casts shadows, as in robosuite's scenes.
    #[must_use]
    pub fn footprint(model: &Model, width: usize, height: usize) -> Footprint {
        // Four bytes per pixel, and a third more for mipmaps.
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
        // Colour and depth for every sample, and once more for the resolved image.
        let buffers = 8 * (samples + 1) * (width * height) as u64;
        Footprint {
            shared: model.bytes() + textures.sum::<u64>() + TRIANGLE * model.triangles(),
            each: map + buffers + CONTEXT,
        }
    }

    /// Sets whether meshes that are not visible in the image are removed before rendering, which is the default. It changes no
    /// pixel and takes half of the time or less.
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

    /// The view of the camera in the last image, or `None` before the first image.
    pub fn view(&mut self) -> Option<View> {
        // SAFETY: the scene is valid and was made for the model. Before the first image its cameras are zeros.
        unsafe { View::of_scene(self.scene.pointer(), &self.model) }
    }

    /// Renders the image of a camera of the model: rows from top to bottom, three bytes (red, green, blue) per pixel. Poses
    /// must be up to date ([`Data::forward`]).
    ///
    /// # Errors
    /// If the model has no such camera, or OpenGL does not work in this thread.
    ///
    /// # Panics
    /// If the simulation's model has another appearance ([`Model::has_same_appearance`]).
    pub fn render(&mut self, data: &mut Data, camera: &str) -> Result<Vec<u8>, MujocoError> {
        let mut pixels = vec![0; 3 * self.width * self.height];
        let id = self.model.id(Kind::Camera, camera)?;
        self.render_into(data, id, &mut pixels)?;
        Ok(pixels)
    }

    /// Does the same as [`Renderer::render`] for the camera with this index, and writes the image to a buffer.
    ///
    /// # Errors
    /// If OpenGL does not work in this thread.
    ///
    /// # Panics
    /// If the simulation's model has another appearance, the model has no camera with this index, or the length of the buffer
    /// differs from that of an image.
    pub fn render_into(&mut self, data: &mut Data, camera: usize, pixels: &mut [u8]) -> Result<(), MujocoError> {
        assert!(data.model().has_same_appearance(&self.model) && camera < self.model.cameras());
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
        // SAFETY: all structures are of this version and were made for this model, the context is current, and the buffer has
        // the size of the image.
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
            (functions.mjr_render)(viewport, self.scene.pointer(), self.context.structure.pointer());
            (functions.mjr_readPixels)(
                pixels.as_mut_ptr(),
                std::ptr::null_mut(),
                viewport,
                self.context.structure.pointer(),
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
        self.context.detach(library.version().layout());
        let _alone = MAKING.lock().unwrap_or_else(PoisonError::into_inner);
        // If the OpenGL context is not current, its data is freed together with it.
        // SAFETY: the renderer made the scene and the rendering context, and they are not used again.
        unsafe {
            (functions.mjv_freeScene)(self.scene.pointer());
            if current {
                (functions.mjr_freeContext)(self.context.structure.pointer());
            }
        }
    }
}

/// Reverses the order of the rows, because OpenGL's rows are from bottom to top.
fn flip(pixels: &mut [u8], row: usize) {
    let mut rows = pixels.chunks_exact_mut(row);
    while let (Some(top), Some(bottom)) = (rows.next(), rows.next_back()) {
        top.swap_with_slice(bottom);
    }
}
