//! Loading the library and its functions.

use std::ffi::{CStr, c_char, c_int, c_void};
use std::fs::File;
use std::io::Read as _;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use crate::{MujocoError, Version};

/// Name of the library's file in its folder.
const FILE: &str = "libmujoco.so";

/// `mjrRect`: left, bottom, width and height, in pixels.
#[derive(Debug, Clone, Copy)]
#[repr(C)]
pub(crate) struct Viewport {
    pub(crate) left: c_int,
    pub(crate) bottom: c_int,
    pub(crate) width: c_int,
    pub(crate) height: c_int,
}

macro_rules! functions {
    ($($name:ident: fn($($argument:ty),*) $(-> $result:ty)?;)*) => {
        /// The library's functions, as `mujoco.h` declares them. Models and data are untyped pointers.
        #[expect(non_snake_case, reason = "the names are the library's")]
        pub(crate) struct Functions {
            $(pub(crate) $name: unsafe extern "C" fn($($argument),*) $(-> $result)?,)*
        }

        impl Functions {
            /// # Safety
            /// The library must be a supported version of MuJoCo.
            unsafe fn load(library: &libloading::Library) -> Result<Self, libloading::Error> {
                Ok(Self {
                    $($name: unsafe { *library.get(concat!(stringify!($name), "\0").as_bytes())? },)*
                })
            }
        }
    };
}

functions! {
    mj_loadXML: fn(*const c_char, *const c_void, *mut c_char, c_int) -> *mut c_void;
    mj_freeLastXML: fn();
    mj_sizeModel: fn(*const c_void) -> c_int;
    mj_deleteModel: fn(*mut c_void);
    mj_makeData: fn(*const c_void) -> *mut c_void;
    mj_deleteData: fn(*mut c_void);
    mj_resetData: fn(*const c_void, *mut c_void);
    mj_forward: fn(*const c_void, *mut c_void);
    mj_step: fn(*const c_void, *mut c_void);
    mj_fwdPosition: fn(*const c_void, *mut c_void);
    mj_fwdVelocity: fn(*const c_void, *mut c_void);
    mj_fwdActuation: fn(*const c_void, *mut c_void);
    mj_fwdAcceleration: fn(*const c_void, *mut c_void);
    mj_fwdConstraint: fn(*const c_void, *mut c_void);
    mj_normalizeQuat: fn(*const c_void, *mut f64);
    mj_Euler: fn(*const c_void, *mut c_void);
    mj_jacSite: fn(*const c_void, *const c_void, *mut f64, *mut f64, c_int);
    mj_fullM: fn(*const c_void, *mut f64, *const f64);
    mj_name2id: fn(*const c_void, c_int, *const c_char) -> c_int;
    mjv_defaultCamera: fn(*mut c_void);
    mjv_defaultOption: fn(*mut c_void);
    mjv_defaultPerturb: fn(*mut c_void);
    mjv_defaultScene: fn(*mut c_void);
    mjv_makeScene: fn(*const c_void, *mut c_void, c_int);
    mjv_freeScene: fn(*mut c_void);
    mjv_updateScene: fn(*const c_void, *mut c_void, *const c_void, *const c_void, *mut c_void, c_int, *mut c_void);
    mjr_defaultContext: fn(*mut c_void);
    mjr_makeContext: fn(*const c_void, *mut c_void, c_int);
    mjr_freeContext: fn(*mut c_void);
    mjr_setBuffer: fn(c_int, *mut c_void);
    mjr_render: fn(Viewport, *mut c_void, *const c_void);
    mjr_readPixels: fn(*mut u8, *mut f32, Viewport, *const c_void);
}

pub(crate) struct Inner {
    pub(crate) functions: Functions,
    pub(crate) version: Version,
    /// Keeps the library loaded, so that the functions stay valid.
    _library: libloading::Library,
}

/// The loaded MuJoCo library. Cheap to clone.
#[derive(Clone)]
pub struct Library {
    pub(crate) inner: Arc<Inner>,
}

/// The libraries that this process has loaded, by path. Each is loaded only once.
static LOADED: Mutex<Vec<(PathBuf, Library)>> = Mutex::new(Vec::new());

/// The last warning of a library, for messages.
static WARNING: Mutex<String> = Mutex::new(String::new());

/// Allows only one thread at a time to compile a model, because compiling changes state of the whole process (the locale).
static COMPILING: Mutex<()> = Mutex::new(());

/// Checks that a file is a complete shared library. The system's loader would crash the process on a truncated file. The section
/// header table is at the end of the file, and the first 64 bytes of a 64-bit ELF file give its offset and size.
fn check_complete(path: &Path) -> Result<(), String> {
    const CUT: &str = "the file is truncated";
    let mut file = File::open(path).map_err(|error| error.to_string())?;
    let length = file.metadata().map_err(|error| error.to_string())?.len();
    let mut header = [0; 64];
    file.read_exact(&mut header).map_err(|_| CUT.to_owned())?;
    let offset = u64::from_le_bytes(std::array::from_fn(|i| header[0x28 + i]));
    let [size, count] = [0x3a, 0x3c].map(|at| u64::from(u16::from_le_bytes([header[at], header[at + 1]])));
    if header[..4] != *b"\x7fELF" {
        Err("the file is not a shared library".to_owned())
    } else if offset.saturating_add(size * count) > length {
        Err(CUT.to_owned())
    } else {
        Ok(())
    }
}

impl Library {
    /// Loads `libmujoco.so` from `folder`. If it is already loaded, returns the same library.
    ///
    /// # Errors
    /// If it does not exist, cannot be loaded, or is another version.
    pub fn open(folder: &Path, version: Version) -> Result<Self, MujocoError> {
        let path = folder.join(FILE);
        let mut loaded = LOADED.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some((_, library)) = loaded.iter().find(|(known, _)| *known == path) {
            let found = library.version();
            return if found == version {
                Ok(library.clone())
            } else {
                Err(MujocoError::Version {
                    path,
                    found: found.to_string(),
                    expected: version.to_string(),
                })
            };
        }
        if !path.is_file() {
            return Err(MujocoError::Missing { path });
        }
        check_complete(&path).map_err(|reason| MujocoError::Load {
            path: path.clone(),
            reason,
        })?;
        let library = Self::load(&path, version)?;
        loaded.push((path, library.clone()));
        Ok(library)
    }

    /// Loads a library, checks its version and installs handlers for warnings and errors.
    fn load(path: &Path, version: Version) -> Result<Self, MujocoError> {
        let refused = |error: &libloading::Error| MujocoError::Load {
            path: path.to_owned(),
            reason: error.to_string(),
        };
        // SAFETY: MuJoCo's library only runs initialisers of the C++ runtime and of its own plug-in table.
        let library = unsafe { libloading::Library::new(path) }.map_err(|error| refused(&error))?;
        // SAFETY: `mj_version` has this signature in every version.
        let number = unsafe {
            let function = library
                .get::<unsafe extern "C" fn() -> c_int>(b"mj_version\0")
                .map_err(|error| refused(&error))?;
            function()
        };
        if number != version.number() {
            let digits = format!("{number:03}");
            let dotted: Vec<String> = digits.chars().map(String::from).collect();
            return Err(MujocoError::Version {
                path: path.to_owned(),
                found: dotted.join("."),
                expected: version.to_string(),
            });
        }
        // SAFETY: the version was checked above.
        let functions = unsafe { Functions::load(&library) }.map_err(|error| refused(&error))?;
        // Without handlers MuJoCo prints messages and writes a file to the current folder. SAFETY: both variables are pointers
        // to functions with this signature (`mujoco.h`), and they are set before any other call.
        unsafe {
            let handler = library
                .get::<*mut Option<unsafe extern "C" fn(*const c_char)>>(b"mju_user_warning\0")
                .map_err(|error| refused(&error))?;
            **handler = Some(on_warning);
            let handler = library
                .get::<*mut Option<unsafe extern "C" fn(*const c_char)>>(b"mju_user_error\0")
                .map_err(|error| refused(&error))?;
            **handler = Some(on_error);
        }
        Ok(Self {
            inner: Arc::new(Inner {
                functions,
                version,
                _library: library,
            }),
        })
    }

    /// The version of the library.
    #[must_use]
    pub fn version(&self) -> Version {
        self.inner.version
    }

    pub(crate) fn functions(&self) -> &Functions {
        &self.inner.functions
    }

    /// Waits until no other thread compiles a model, and keeps other threads from doing so.
    pub(crate) fn compiling() -> MutexGuard<'static, ()> {
        COMPILING.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// Returns free memory to the system. The C library otherwise keeps it for later allocations.
pub(crate) fn release_free_memory() {
    #[cfg(target_env = "gnu")]
    {
        unsafe extern "C" {
            fn malloc_trim(pad: usize) -> c_int;
        }
        // SAFETY: the function does not affect memory that is in use.
        unsafe { malloc_trim(0) };
    }
}

/// The last warning of a library, for example that a simulation became unstable. Empty if there was none.
pub(crate) fn last_warning() -> String {
    WARNING.lock().unwrap_or_else(PoisonError::into_inner).clone()
}

/// The handler of warnings: stores the message.
unsafe extern "C" fn on_warning(message: *const c_char) {
    if !message.is_null() {
        // SAFETY: the library passes a null-terminated string.
        let text = unsafe { CStr::from_ptr(message) }.to_string_lossy().into_owned();
        *WARNING.lock().unwrap_or_else(PoisonError::into_inner) = text;
    }
}

/// The handler of fatal errors: prints the message and ends the process. The library cannot continue after such an error. Without
/// a handler it would write a file to the current folder and end the process itself.
#[expect(
    clippy::exit,
    clippy::print_stderr,
    reason = "the handler must not return, and has no caller to tell"
)]
unsafe extern "C" fn on_error(message: *const c_char) {
    let text = if message.is_null() {
        String::new()
    } else {
        // SAFETY: the library passes a null-terminated string.
        unsafe { CStr::from_ptr(message) }.to_string_lossy().into_owned()
    };
    eprintln!(
        "error: MuJoCo cannot continue: {text}; run with fewer jobs or report the model (no incomplete artifact was left)"
    );
    std::process::exit(2);
}
