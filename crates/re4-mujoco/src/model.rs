//! Compiled models.

use std::ffi::{CStr, CString, c_char, c_int, c_void};
use std::io::Write as _;
use std::ptr::NonNull;
use std::sync::{Arc, PoisonError};

use crate::block::Block;
use crate::shared_assets::{SharedAssets, Slot};
use crate::{Library, MujocoError, Version};

/// `mjGEOM_BOX`.
const BOX: c_int = 6;

/// Kinds of named elements.
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
    /// The value in `mjtObj`.
    fn number(self, version: Version) -> c_int {
        match self {
            Self::Body => 1,
            Self::Joint => 3,
            Self::Geom => 5,
            Self::Site => 6,
            Self::Camera => 7,
            // Version 3 inserted flexible bodies before actuators.
            Self::Actuator if version == Version::V2_3_7 => 18,
            Self::Actuator => 19,
        }
    }

    fn name(self) -> &'static str {
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

/// A compiled model. It is immutable and cheap to clone.
#[derive(Clone)]
pub struct Model {
    inner: Arc<Inner>,
}

struct Inner {
    library: Library,
    pointer: NonNull<c_void>,
    /// The data that renderers share. Models that differ only in box sizes have the same one.
    family: Arc<Slot>,
    memory: Memory,
}

/// Owner of a model's memory.
enum Memory {
    /// The library allocated it.
    Compiled,
    /// This program allocated the structure and some arrays. All other arrays belong to another model.
    Resized(#[expect(dead_code, reason = "it must live as long as the model")] Box<Resized>),
}

struct Resized {
    /// Keeps all other arrays alive.
    _base: Model,
    structure: Block,
    sizes: Vec<[f64; 3]>,
    radii: Vec<f64>,
    boxes: Vec<[f64; 6]>,
}

// SAFETY: simulating and rendering only read the model, and this crate never writes to one.
unsafe impl Send for Inner {}
// SAFETY: as above.
unsafe impl Sync for Inner {}

impl Drop for Inner {
    fn drop(&mut self) {
        if let Memory::Compiled = self.memory {
            // SAFETY: the pointer came from `mj_loadXML`, and every `Data` keeps the model alive.
            unsafe { (self.library.functions().mj_deleteModel)(self.pointer.as_ptr()) }
        }
    }
}

impl Model {
    /// Compiles a model from MJCF text. Paths of files in it must be absolute.
    ///
    /// # Errors
    /// If the library refuses the model, with the library's message, or the temporary file cannot be written.
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
        // SAFETY: the path is null-terminated, no virtual file system is given, and the length is that of the message buffer.
        let pointer = unsafe {
            (library.functions().mj_loadXML)(
                path.as_ptr(),
                std::ptr::null(),
                message.as_mut_ptr(),
                message.len() as c_int,
            )
        };
        // The library keeps a copy of the parsed text, which takes several times a model's memory and is not used.
        // SAFETY: the function only frees that copy.
        unsafe { (library.functions().mj_freeLastXML)() };
        let Some(pointer) = NonNull::new(pointer) else {
            // SAFETY: the library null-terminates its message, and the array was initialised with zeros.
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

    /// A copy of the model with other half sizes (metres) of named boxes. It is only suitable for images, because masses and
    /// inertias are not changed. It is much faster than compiling a model, which takes seconds, and needs little memory. A
    /// [`Renderer`](crate::Renderer) of one model can also render the other.
    ///
    /// # Errors
    /// If a name is not that of a box.
    pub fn with_boxes<'a>(&self, boxes: impl IntoIterator<Item = (&'a str, [f64; 3])>) -> Result<Self, MujocoError> {
        let layout = self.layout();
        let geoms = self.count(layout.ngeom);
        // SAFETY: the fields are arrays with one entry per geom, which consists of an `int`, or of three, one or six doubles.
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
        // SAFETY: the fields are pointers to these arrays, which live as long as the structure and do not move.
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

    /// Whether both models are the same apart from [`Model::with_boxes`].
    #[must_use]
    pub fn has_same_appearance(&self, other: &Self) -> bool {
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

    /// A copy of its `mjModel` structure, with pointers to the same arrays.
    pub(crate) fn structure(&self) -> Block {
        // SAFETY: `mjModel` has this size in this version.
        unsafe { Block::copy(self.pointer(), self.layout().sizes.model) }
    }

    /// The textures and meshes that its renderers share. The first call uploads them.
    ///
    /// # Errors
    /// If there is no OpenGL library, or an OpenGL operation fails.
    pub(crate) fn shared_assets(&self) -> Result<Arc<SharedAssets>, MujocoError> {
        let mut slot = self.inner.family.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(shared) = slot.upgrade() {
            return Ok(shared);
        }
        let shared = Arc::new(SharedAssets::new(self)?);
        *slot = Arc::downgrade(&shared);
        Ok(shared)
    }

    /// Whether any of its lights casts shadows.
    pub(crate) fn casts_shadows(&self) -> bool {
        // SAFETY: the array has a byte for every light.
        let lights = unsafe { self.array::<u8>(self.layout().light_castshadow, self.count(self.layout().nlight)) };
        lights.iter().any(|&casts| casts != 0)
    }

    /// The size of the model in bytes, as MuJoCo computes it.
    pub(crate) fn bytes(&self) -> u64 {
        // SAFETY: the pointer is that of a valid model.
        let bytes = unsafe { (self.library().functions().mj_sizeModel)(self.pointer()) };
        u64::try_from(bytes).unwrap_or(0)
    }

    /// Kind (`mjtTexture`), rows and columns of every texture.
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

    /// Side length of the shadow map, and the number of samples per pixel.
    pub(crate) fn quality(&self) -> [u64; 2] {
        [self.layout().shadowsize, self.layout().offsamples].map(|offset| self.count(offset) as u64)
    }

    fn layout(&self) -> &'static crate::layout::Layout {
        self.inner.library.version().layout()
    }

    /// The value of an integer field.
    fn count(&self, offset: usize) -> usize {
        // SAFETY: the field is an `int` at this offset in this version.
        let value = unsafe { self.pointer().byte_add(offset).cast::<c_int>().read() };
        usize::try_from(value).unwrap_or(0)
    }

    /// The array that the field at this offset points to.
    ///
    /// # Safety
    /// The field must be a pointer to at least `length` values of type `T`.
    unsafe fn array<T>(&self, offset: usize, length: usize) -> &[T] {
        // SAFETY: the caller guarantees the field. Arrays live as long as the model and are never written to.
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

    /// Number of activation states of actuators.
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

    /// Index of the element with this name.
    ///
    /// # Errors
    /// If the model has no such element.
    pub fn id(&self, kind: Kind, name: &str) -> Result<usize, MujocoError> {
        let missing = || MujocoError::NoSuch {
            kind: kind.name(),
            name: name.to_owned(),
        };
        let text = CString::new(name).map_err(|_| missing())?;
        let number = kind.number(self.library().version());
        // SAFETY: the name is null-terminated.
        let id = unsafe { (self.library().functions().mj_name2id)(self.pointer(), number, text.as_ptr()) };
        usize::try_from(id).map_err(|_| missing())
    }

    /// Indices of a joint's first generalised coordinate and first degree of freedom.
    ///
    /// # Errors
    /// If the model has no joint with this name.
    pub fn joint(&self, name: &str) -> Result<(usize, usize), MujocoError> {
        let id = self.id(Kind::Joint, name)?;
        // SAFETY: both arrays have an `int` for every joint, and the index is that of a joint.
        let (coordinate, freedom) = unsafe {
            (
                self.array::<c_int>(self.layout().jnt_qposadr, self.joints())[id],
                self.array::<c_int>(self.layout().jnt_dofadr, self.joints())[id],
            )
        };
        Ok((coordinate.max(0) as usize, freedom.max(0) as usize))
    }

    /// Whether the joint with this name is a free joint, which has seven coordinates and six degrees of freedom.
    ///
    /// # Errors
    /// If the model has no joint with this name.
    pub fn joint_is_free(&self, name: &str) -> Result<bool, MujocoError> {
        let id = self.id(Kind::Joint, name)?;
        // `mjJNT_FREE` is 0.
        // SAFETY: the array has an `int` for every joint, and the index is that of a joint.
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
