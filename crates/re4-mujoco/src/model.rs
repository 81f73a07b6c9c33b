//! Compiled models.

use std::ffi::{CStr, CString, c_char, c_int, c_void};
use std::io::Write as _;
use std::ptr::NonNull;
use std::sync::{Arc, PoisonError};

use crate::block::Block;
use crate::stage::{Place, Stage};
use crate::{Library, MujocoError, Version};

/// `mjGEOM_BOX`.
const BOX: c_int = 6;

/// Kinds of things that have names.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Kind {
    /// A body.
    Body,
    /// A joint.
    Joint,
    /// A geom.
    Geom,
    /// A site.
    Site,
    /// A camera.
    Camera,
    /// An actuator.
    Actuator,
}

impl Kind {
    /// Its number in `mjtObj`.
    fn number(self, version: Version) -> c_int {
        match self {
            Self::Body => 1,
            Self::Joint => 3,
            Self::Geom => 5,
            Self::Site => 6,
            Self::Camera => 7,
            // Flexible bodies came in between.
            Self::Actuator if version == Version::V2_3_7 => 18,
            Self::Actuator => 19,
        }
    }

    fn word(self) -> &'static str {
        match self {
            Self::Body => "body",
            Self::Joint => "joint",
            Self::Geom => "geom",
            Self::Site => "site",
            Self::Camera => "camera",
            Self::Actuator => "actuator",
        }
    }
}

/// A compiled model. Cheap to clone; never changed after it is made.
#[derive(Clone)]
pub struct Model {
    inner: Arc<Inner>,
}

struct Inner {
    library: Library,
    pointer: NonNull<c_void>,
    /// The same in models that look the same but for sizes of boxes.
    family: Arc<Place>,
    memory: Memory,
}

/// Whose the memory of a model is.
enum Memory {
    /// The library's.
    Compiled,
    /// Its structure and some arrays are its own, all others another model's.
    Resized(#[expect(dead_code, reason = "it is kept for as long as the model lives")] Box<Resized>),
}

struct Resized {
    /// Keeps all other arrays where they are.
    _base: Model,
    structure: Block,
    sizes: Vec<[f64; 3]>,
    radii: Vec<f64>,
    boxes: Vec<[f64; 6]>,
}

// SAFETY: the library only reads a model that it simulates or draws, and this crate never writes to one.
unsafe impl Send for Inner {}
// SAFETY: as above.
unsafe impl Sync for Inner {}

impl Drop for Inner {
    fn drop(&mut self) {
        if let Memory::Compiled = self.memory {
            // SAFETY: the pointer came from `mj_loadXML`, and every `Data` holds the model alive.
            unsafe { (self.library.functions().mj_deleteModel)(self.pointer.as_ptr()) }
        }
    }
}

impl Model {
    /// Compiles a model from MJCF text. Files that it names must be absolute.
    ///
    /// # Errors
    /// When the library refuses it, with the library's words.
    pub fn compile(library: &Library, mjcf: &str) -> Result<Self, MujocoError> {
        let temporary = |error: std::io::Error| MujocoError::Temporary {
            reason: error.to_string(),
        };
        let mut file = tempfile::Builder::new()
            .prefix("re4-model-")
            .suffix(".xml")
            .tempfile()
            .map_err(temporary)?;
        file.write_all(mjcf.as_bytes()).map_err(temporary)?;
        file.flush().map_err(temporary)?;
        let path =
            CString::new(file.path().as_os_str().as_encoded_bytes()).map_err(|error| MujocoError::Temporary {
                reason: error.to_string(),
            })?;
        let mut message = [0 as c_char; 1000];
        let _alone = Library::compiling();
        // SAFETY: the path ends in zero, no virtual file system is given, and the length of the message is its own.
        let pointer = unsafe {
            (library.functions().mj_loadXML)(
                path.as_ptr(),
                std::ptr::null(),
                message.as_mut_ptr(),
                message.len() as c_int,
            )
        };
        // SAFETY: it frees what the library keeps of the text, several times a model's memory; nobody asks for that.
        unsafe { (library.functions().mj_freeLastXML)() };
        let Some(pointer) = NonNull::new(pointer) else {
            // SAFETY: the library ends its message with zero, and the array started as zeros.
            let text = unsafe { CStr::from_ptr(message.as_ptr()) }.to_string_lossy();
            return Err(MujocoError::Model {
                reason: text.split_whitespace().collect::<Vec<_>>().join(" "),
            });
        };
        Ok(Self {
            inner: Arc::new(Inner {
                library: library.clone(),
                pointer,
                family: Arc::default(),
                memory: Memory::Compiled,
            }),
        })
    }

    /// The same model with other half sizes of named boxes, in metres: for images alone, since masses and inertias stay as
    /// they were. That takes moments and hardly any memory, where compiling takes seconds, and a
    /// [`Renderer`](crate::Renderer) of one model draws the other, too.
    ///
    /// # Errors
    /// When a name is not that of a box.
    pub fn with_boxes<'a>(&self, boxes: impl IntoIterator<Item = (&'a str, [f64; 3])>) -> Result<Self, MujocoError> {
        let layout = self.layout();
        let geoms = self.count(layout.ngeom);
        // SAFETY: the fields are arrays with a place for every geom, of an `int` and of three, one and six doubles.
        let (kinds, mut resized) = unsafe {
            let resized = Box::new(Resized {
                _base: self.clone(),
                structure: self.structure(),
                sizes: self.array(layout.model_geom_size, geoms).to_vec(),
                radii: self.array(layout.model_geom_rbound, geoms).to_vec(),
                boxes: self.array(layout.geom_aabb, geoms).to_vec(),
            });
            (self.array::<c_int>(layout.model_geom_type, geoms), resized)
        };
        for (name, size) in boxes {
            let id = self.id(Kind::Geom, name)?;
            if kinds[id] != BOX {
                return Err(MujocoError::NoSuch {
                    kind: "box",
                    name: name.to_owned(),
                });
            }
            let [x, y, z] = size;
            resized.sizes[id] = size;
            resized.radii[id] = (x * x + y * y + z * z).sqrt();
            resized.boxes[id] = [0.0, 0.0, 0.0, x, y, z];
        }
        let Resized {
            structure,
            sizes,
            radii,
            boxes,
            ..
        } = &mut *resized;
        // SAFETY: the fields are pointers to these arrays, which stay where they are as long as the structure.
        unsafe {
            structure.set(layout.model_geom_size, sizes.as_mut_ptr());
            structure.set(layout.model_geom_rbound, radii.as_mut_ptr());
            structure.set(layout.geom_aabb, boxes.as_mut_ptr());
        }
        Ok(Self {
            inner: Arc::new(Inner {
                library: self.library().clone(),
                pointer: NonNull::new(structure.pointer()).ok_or(MujocoError::Memory)?,
                family: Arc::clone(&self.inner.family),
                memory: Memory::Resized(resized),
            }),
        })
    }

    /// Whether both are the same but for [`Model::with_boxes`].
    #[must_use]
    pub fn looks_like(&self, other: &Self) -> bool {
        Arc::ptr_eq(&self.inner.family, &other.inner.family)
    }

    /// The library that compiled it.
    #[must_use]
    pub fn library(&self) -> &Library {
        &self.inner.library
    }

    pub(crate) fn pointer(&self) -> *const c_void {
        self.inner.pointer.as_ptr()
    }

    /// A copy of its structure, with pointers to the same arrays.
    pub(crate) fn structure(&self) -> Block {
        // SAFETY: the structure has this size in this version.
        unsafe { Block::copy(self.pointer(), self.layout().sizes.model) }
    }

    /// What its renderers share.
    ///
    /// # Errors
    /// When there is no OpenGL library, or it refuses to work.
    pub(crate) fn stage(&self) -> Result<Arc<Stage>, MujocoError> {
        let mut place = self.inner.family.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(stage) = place.upgrade() {
            return Ok(stage);
        }
        let stage = Arc::new(Stage::new(self)?);
        *place = Arc::downgrade(&stage);
        Ok(stage)
    }

    /// Whether a light of it casts shadows.
    pub(crate) fn casts_shadows(&self) -> bool {
        // SAFETY: the array has a byte for every light.
        let lights = unsafe { self.array::<u8>(self.layout().light_castshadow, self.count(self.layout().nlight)) };
        lights.iter().any(|&casts| casts != 0)
    }

    /// Bytes that it takes, without what it shares with the model whose boxes were resized.
    pub(crate) fn bytes(&self) -> u64 {
        // SAFETY: the model is whole.
        let bytes = unsafe { (self.library().functions().mj_sizeModel)(self.pointer()) };
        u64::try_from(bytes).unwrap_or(0)
    }

    /// Kind, rows and columns of every texture.
    pub(crate) fn textures(&self) -> Vec<(c_int, u64, u64)> {
        let layout = self.layout();
        let count = self.count(layout.ntex);
        // SAFETY: each of the arrays has an `int` for every texture.
        let [kinds, rows, columns] = [layout.tex_type, layout.tex_height, layout.tex_width]
            .map(|offset| unsafe { self.array::<c_int>(offset, count) });
        let number = |number: c_int| u64::try_from(number).unwrap_or(0);
        (0..count)
            .map(|id| (kinds[id], number(rows[id]), number(columns[id])))
            .collect()
    }

    /// Number of triangles of all meshes.
    pub(crate) fn triangles(&self) -> u64 {
        self.count(self.layout().nmeshface) as u64
    }

    /// Side of the map of shadows, and samples of a pixel.
    pub(crate) fn quality(&self) -> [u64; 2] {
        [self.layout().shadowsize, self.layout().offsamples].map(|offset| self.count(offset) as u64)
    }

    fn layout(&self) -> &'static crate::layout::Layout {
        self.inner.library.version().layout()
    }

    fn count(&self, offset: usize) -> usize {
        // SAFETY: the field is an `int` at this offset in this version.
        let value = unsafe { self.pointer().byte_add(offset).cast::<c_int>().read() };
        usize::try_from(value).unwrap_or(0)
    }

    /// # Safety
    /// The field at the offset is a pointer to at least `length` values of `T`.
    unsafe fn array<T>(&self, offset: usize, length: usize) -> &[T] {
        // SAFETY: by the caller; arrays live as long as the model, and nobody writes to them.
        unsafe {
            let start = self.pointer().byte_add(offset).cast::<*const T>().read();
            std::slice::from_raw_parts(start, length)
        }
    }

    /// Number of generalised coordinates.
    #[must_use]
    pub fn nq(&self) -> usize {
        self.count(self.layout().nq)
    }

    /// Number of degrees of freedom.
    #[must_use]
    pub fn nv(&self) -> usize {
        self.count(self.layout().nv)
    }

    /// Number of actuators.
    #[must_use]
    pub fn nu(&self) -> usize {
        self.count(self.layout().nu)
    }

    /// Number of activations of actuators.
    #[must_use]
    pub fn na(&self) -> usize {
        self.count(self.layout().na)
    }

    /// Number of bodies.
    #[must_use]
    pub fn bodies(&self) -> usize {
        self.count(self.layout().nbody)
    }

    /// Number of sites.
    #[must_use]
    pub fn sites(&self) -> usize {
        self.count(self.layout().nsite)
    }

    /// Number of cameras.
    #[must_use]
    pub fn cameras(&self) -> usize {
        self.count(self.layout().ncam)
    }

    /// Bounding box of a geom in its own frame: centre and half sizes.
    pub(crate) fn bounding_box(&self, geom: usize) -> [f64; 6] {
        // SAFETY: the array has six doubles for every geom.
        let boxes = unsafe { self.array::<[f64; 6]>(self.layout().geom_aabb, self.count(self.layout().ngeom)) };
        boxes[geom]
    }

    fn joints(&self) -> usize {
        self.count(self.layout().njnt)
    }

    /// Length of a simulation step, in seconds.
    #[must_use]
    pub fn timestep(&self) -> f64 {
        // SAFETY: the field is a double at this offset in this version.
        unsafe { self.pointer().byte_add(self.layout().timestep).cast::<f64>().read() }
    }

    /// Number of the thing of this name.
    ///
    /// # Errors
    /// When the model has none.
    pub fn id(&self, kind: Kind, name: &str) -> Result<usize, MujocoError> {
        let missing = || MujocoError::NoSuch {
            kind: kind.word(),
            name: name.to_owned(),
        };
        let text = CString::new(name).map_err(|_| missing())?;
        let number = kind.number(self.library().version());
        // SAFETY: the name ends in zero.
        let id = unsafe { (self.library().functions().mj_name2id)(self.pointer(), number, text.as_ptr()) };
        usize::try_from(id).map_err(|_| missing())
    }

    /// First coordinate and first degree of freedom of a joint.
    ///
    /// # Errors
    /// When the model has no joint of this name.
    pub fn joint(&self, name: &str) -> Result<(usize, usize), MujocoError> {
        let id = self.id(Kind::Joint, name)?;
        // SAFETY: both arrays have an `int` for every joint, and the id is that of one.
        let (coordinate, freedom) = unsafe {
            (
                self.array::<c_int>(self.layout().jnt_qposadr, self.joints())[id],
                self.array::<c_int>(self.layout().jnt_dofadr, self.joints())[id],
            )
        };
        Ok((coordinate.max(0) as usize, freedom.max(0) as usize))
    }

    /// Whether the joint of this name is a free one: seven coordinates, six degrees of freedom.
    ///
    /// # Errors
    /// When the model has no joint of this name.
    pub fn joint_is_free(&self, name: &str) -> Result<bool, MujocoError> {
        let id = self.id(Kind::Joint, name)?;
        // SAFETY: the array has an `int` for every joint, and the id is that of one. Free is 0 in `mjtJoint`.
        Ok(unsafe { self.array::<c_int>(self.layout().jnt_type, self.joints())[id] } == 0)
    }

    /// Minimum and maximum control of an actuator.
    #[must_use]
    pub fn control_range(&self, actuator: usize) -> [f64; 2] {
        // SAFETY: the array has two doubles for every actuator.
        let ranges = unsafe { self.array::<f64>(self.layout().actuator_ctrlrange, 2 * self.nu()) };
        [ranges[2 * actuator], ranges[2 * actuator + 1]]
    }
}
