//! Textures and meshes that all renderers of models with the same appearance share.
//!
//! Each renderer has its own OpenGL context, because a context belongs to one thread. Textures and display lists take far more
//! memory than the rest of a context, and OpenGL contexts can share them. Therefore the first renderer of a model uploads them
//! to a context that is not used for rendering. This renderer and all later ones share them with that context.

use std::ffi::{c_int, c_uint};
use std::ops::Range;
use std::sync::{Mutex, PoisonError, Weak};

use crate::block::Block;
use crate::gl::{Context, MAKING};
use crate::layout::Layout;
use crate::library::release_free_memory;
use crate::{Library, Model, MujocoError};

/// `mjFONTSCALE_150`. The images contain no text, so any valid value works.
const FONT_SCALE: c_int = 150;

/// Side length (pixels) of the buffers of the context that is not used for rendering.
const SIDE: c_int = 16;

/// The shared data of models with the same appearance. It lives as long as a renderer of one of them.
pub(crate) type Slot = Mutex<Weak<SharedAssets>>;

/// Textures and meshes of a model in the memory of OpenGL.
pub(crate) struct SharedAssets {
    library: Library,
    parts: Mutex<Parts>,
}

struct Parts {
    /// MuJoCo's rendering context (`mjrContext`), which contains the OpenGL names of textures and meshes.
    context: Block,
    /// Dropped last, because freeing `context` needs it.
    gl: Context,
}

// SAFETY: the OpenGL context is current in a thread only while the thread holds the lock or is the only owner.
unsafe impl Send for Parts {}

impl SharedAssets {
    /// Uploads the textures and meshes of a model.
    ///
    /// # Errors
    /// If there is no OpenGL library, or an OpenGL operation fails.
    pub(crate) fn new(model: &Model) -> Result<Self, MujocoError> {
        let library = model.library().clone();
        // Compiling a model frees a lot of memory, and so does uploading. Without this call the process would keep it.
        release_free_memory();
        let mut gl = Context::new(None)?;
        let made = {
            let _alone = MAKING.lock().unwrap_or_else(PoisonError::into_inner);
            let mut structure = model.structure();
            let layout = library.version().layout();
            // SAFETY: the fields are `int`s, the OpenGL context is current, and `Drop` frees MuJoCo's context.
            unsafe {
                structure.set::<c_int>(layout.shadowsize, 0);
                structure.set(layout.offwidth, SIDE);
                structure.set(layout.offheight, SIDE);
                make(&library, &mut structure)
            }
        };
        gl.release_current()?;
        release_free_memory();
        Ok(Self {
            library,
            parts: Mutex::new(Parts { context: made, gl }),
        })
    }

    /// Makes an OpenGL context that shares the textures and meshes and is current in this thread, and MuJoCo's rendering
    /// context of a model in it.
    ///
    /// # Errors
    /// If an OpenGL operation fails.
    pub(crate) fn context(
        &self,
        model: &Model,
        width: usize,
        height: usize,
    ) -> Result<(Context, RenderContext), MujocoError> {
        let mut parts = self.parts.lock().unwrap_or_else(PoisonError::into_inner);
        let mut gl = Context::new(Some(&parts.gl))?;
        gl.make_current()?;
        let layout = self.library.version().layout();
        let _alone = MAKING.lock().unwrap_or_else(PoisonError::into_inner);
        let mut structure = model.structure();
        // Uploading a texture also sets how texture coordinates are generated, and contexts do not share this state. Therefore
        // each texture is uploaded again, reduced to its first pixel.
        let mut sides = vec![1 as c_int; model.textures().len()];
        // SAFETY: the fields are `int`s and pointers to one `int` for every texture. The OpenGL context is current, and the caller
        // frees MuJoCo's context.
        let mut context = unsafe {
            structure.set(layout.tex_height, sides.as_mut_ptr());
            structure.set(layout.tex_width, sides.as_mut_ptr());
            structure.set::<c_int>(layout.nmesh, 0);
            if !model.casts_shadows() {
                // The shadow map takes as much memory as everything else, and would not be used.
                structure.set::<c_int>(layout.shadowsize, 0);
            }
            // The buffer has the size of the image, because clearing and resolving a larger one takes time.
            structure.set(layout.offwidth, width as c_int);
            structure.set(layout.offheight, height as c_int);
            make(&self.library, &mut structure)
        };
        let own = names(layout).map(|fields| {
            let shared = parts.context.bytes(fields.clone());
            let target = context.bytes(fields);
            let own = target.to_vec();
            target.copy_from_slice(shared);
            own
        });
        Ok((
            gl,
            RenderContext {
                structure: context,
                own,
            },
        ))
    }
}

/// MuJoCo's rendering context of a renderer, with the OpenGL names of the shared textures and meshes.
pub(crate) struct RenderContext {
    /// The structure `mjrContext`.
    pub(crate) structure: Block,
    /// The names of its own textures and meshes, which the shared names have replaced.
    own: [Vec<u8>; 3],
}

impl RenderContext {
    /// Restores its own names, so that freeing the context does not free the shared textures and meshes.
    pub(crate) fn detach(&mut self, layout: &Layout) {
        for (fields, own) in names(layout).into_iter().zip(&self.own) {
            self.structure.bytes(fields).copy_from_slice(own);
        }
    }
}

impl Drop for SharedAssets {
    fn drop(&mut self) {
        let parts = self.parts.get_mut().unwrap_or_else(PoisonError::into_inner);
        if parts.gl.make_current().is_err() {
            // OpenGL frees the textures and meshes together with its context.
            return;
        }
        let _alone = MAKING.lock().unwrap_or_else(PoisonError::into_inner);
        // SAFETY: the context was made here and is not used again, and its OpenGL context is current.
        unsafe { (self.library.functions().mjr_freeContext)(parts.context.pointer()) }
    }
}

/// Makes MuJoCo's rendering context of a model.
///
/// # Safety
/// The structure must be a valid `mjModel`, an OpenGL context must be current, and the caller must hold [`MAKING`].
unsafe fn make(library: &Library, structure: &mut Block) -> Block {
    let functions = library.functions();
    let mut context = Block::new(library.version().layout().sizes.context);
    // SAFETY: the block has the size of this version's `mjrContext`, and the caller guarantees the rest.
    unsafe {
        (functions.mjr_defaultContext)(context.pointer());
        (functions.mjr_makeContext)(structure.pointer(), context.pointer(), FONT_SCALE);
    }
    context
}

/// The offsets of the fields of MuJoCo's rendering context that contain the OpenGL names of textures and meshes.
fn names(layout: &Layout) -> [Range<usize>; 3] {
    [
        layout.context_texture..layout.context_base_plane,
        layout.context_base_mesh..layout.context_base_mesh + size_of::<c_uint>(),
        layout.context_range_mesh..layout.context_range_mesh + size_of::<c_int>(),
    ]
}
