//! What all renderers of models that look alike share: textures and meshes, in OpenGL's memory once a process.
//!
//! Each renderer has an OpenGL context of its own, because a context belongs to one thread. Textures and display lists take
//! far more memory than anything else of a context, and OpenGL lets contexts share them. So the first renderer of a model
//! uploads them to a context in which nothing is drawn; it and all others share with that context.

use std::ffi::{c_int, c_uint};
use std::ops::Range;
use std::sync::{Mutex, PoisonError, Weak};

use crate::block::Block;
use crate::gl::{Context, MAKING};
use crate::layout::Layout;
use crate::library::give_back_free_memory;
use crate::{Library, Model, MujocoError};

/// `mjFONTSCALE_150`; nothing is written in the images.
const FONT_SCALE: c_int = 150;

/// Side of the buffers of the context in which nothing is drawn.
const SIDE: c_int = 16;

/// The stage of the models of a family, while a renderer of one of them lives.
pub(crate) type Place = Mutex<Weak<Stage>>;

/// Textures and meshes of a model in OpenGL's memory.
pub(crate) struct Stage {
    library: Library,
    parts: Mutex<Parts>,
}

struct Parts {
    /// MuJoCo's drawing context, which has their names.
    context: Block,
    /// Dropped last.
    gl: Context,
}

// SAFETY: the OpenGL context is current in a thread only while that holds the lock, or owns the stage alone.
unsafe impl Send for Parts {}

impl Stage {
    /// Uploads what a model shows.
    pub(crate) fn new(model: &Model) -> Result<Self, MujocoError> {
        let library = model.library().clone();
        // Compiling leaves much free memory behind, and so does uploading.
        give_back_free_memory();
        let mut gl = Context::new(None)?;
        let made = {
            let _alone = MAKING.lock().unwrap_or_else(PoisonError::into_inner);
            let mut structure = model.structure();
            let layout = library.version().layout();
            // SAFETY: the fields are `int`s; the OpenGL context is current, and MuJoCo's is freed with the stage.
            unsafe {
                structure.set::<c_int>(layout.shadowsize, 0);
                structure.set(layout.offwidth, SIDE);
                structure.set(layout.offheight, SIDE);
                make(&library, &mut structure)
            }
        };
        gl.release_current()?;
        give_back_free_memory();
        Ok(Self {
            library,
            parts: Mutex::new(Parts { context: made, gl }),
        })
    }

    /// An OpenGL context that shares with it, current in this thread, and MuJoCo's drawing context of a model in it.
    pub(crate) fn context(&self, model: &Model, width: usize, height: usize) -> Result<(Context, Drawn), MujocoError> {
        let mut parts = self.parts.lock().unwrap_or_else(PoisonError::into_inner);
        let mut gl = Context::new(Some(&parts.gl))?;
        gl.make_current()?;
        let layout = self.library.version().layout();
        let _alone = MAKING.lock().unwrap_or_else(PoisonError::into_inner);
        let mut structure = model.structure();
        // Uploading a texture also sets how its coordinates follow from places on a thing, which is not shared. So each texture
        // is uploaded once more, as its first pixel.
        let mut sides = vec![1 as c_int; model.textures().len()];
        // SAFETY: the fields are `int`s, and pointers to one for every texture; the OpenGL context is current, and the caller
        // frees MuJoCo's.
        let mut context = unsafe {
            structure.set(layout.tex_height, sides.as_mut_ptr());
            structure.set(layout.tex_width, sides.as_mut_ptr());
            structure.set::<c_int>(layout.nmesh, 0);
            if !model.casts_shadows() {
                // Its map takes as much memory as all else, and nothing would be drawn to it.
                structure.set::<c_int>(layout.shadowsize, 0);
            }
            // A buffer no larger than the image: clearing and resolving it takes time.
            structure.set(layout.offwidth, width as c_int);
            structure.set(layout.offheight, height as c_int);
            make(&self.library, &mut structure)
        };
        let own = names(layout).map(|fields| {
            let shared = parts.context.bytes(fields.clone());
            let place = context.bytes(fields);
            let own = place.to_vec();
            place.copy_from_slice(shared);
            own
        });
        Ok((gl, Drawn { context, own }))
    }
}

/// MuJoCo's drawing context of a renderer, with the names of the textures and meshes that are shared.
pub(crate) struct Drawn {
    pub(crate) context: Block,
    /// Names of those that came with it.
    own: [Vec<u8>; 3],
}

impl Drawn {
    /// Puts its own names back, so that what is shared is not freed with it.
    pub(crate) fn part(&mut self, layout: &Layout) {
        for (fields, own) in names(layout).into_iter().zip(&self.own) {
            self.context.bytes(fields).copy_from_slice(own);
        }
    }
}

impl Drop for Stage {
    fn drop(&mut self) {
        let parts = self.parts.get_mut().unwrap_or_else(PoisonError::into_inner);
        if parts.gl.make_current().is_err() {
            // What lies in OpenGL's memory goes with its context.
            return;
        }
        let _alone = MAKING.lock().unwrap_or_else(PoisonError::into_inner);
        // SAFETY: it was made here and is not used again, and its OpenGL context is current.
        unsafe { (self.library.functions().mjr_freeContext)(parts.context.pointer()) }
    }
}

/// MuJoCo's drawing context of a model.
///
/// # Safety
/// The structure is that of a whole model, an OpenGL context is current, and nobody else makes one.
unsafe fn make(library: &Library, structure: &mut Block) -> Block {
    let functions = library.functions();
    let mut context = Block::new(library.version().layout().sizes.context);
    // SAFETY: the structure has the size of this version, and by the caller.
    unsafe {
        (functions.mjr_defaultContext)(context.pointer());
        (functions.mjr_makeContext)(structure.pointer(), context.pointer(), FONT_SCALE);
    }
    context
}

/// Fields of MuJoCo's drawing context that name textures and meshes.
fn names(layout: &Layout) -> [Range<usize>; 3] {
    [
        layout.context_texture..layout.context_base_plane,
        layout.context_base_mesh..layout.context_base_mesh + size_of::<c_uint>(),
        layout.context_range_mesh..layout.context_range_mesh + size_of::<c_int>(),
    ]
}
