//! OpenGL contexts for off-screen rendering, with `OSMesa` or with EGL without a surface. Both are loaded at run time. Without a
//! graphics card both use Mesa's software renderer.

use std::cell::Cell;
use std::ffi::{c_int, c_uint, c_void};
use std::fmt;
use std::marker::PhantomData;
use std::ptr::null_mut;
use std::sync::{Mutex, OnceLock, PoisonError};

use libloading::os::unix::{Library, RTLD_GLOBAL, RTLD_NOW};

use crate::MujocoError;

/// Environment variable that chooses one of the two libraries.
const VARIABLE: &str = "RE4_GL";

/// Libraries for off-screen rendering.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Gl {
    /// Mesa's off-screen library (Debian package `libosmesa6`). It always renders in software.
    OsMesa,
    /// EGL on a device without a display (Debian packages `libegl1` and `libgl1-mesa-dri`).
    Egl,
}

impl fmt::Display for Gl {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::OsMesa => "osmesa",
            Self::Egl => "egl",
        })
    }
}

impl Gl {
    /// The library that this process renders with: the one that the environment variable `RE4_GL` names, else the first one
    /// that can be loaded, in the order `OSMesa`, EGL. The first call loads it, and it stays loaded.
    ///
    /// # Errors
    /// If no library can be loaded, or the variable has another value.
    pub fn of_process() -> Result<Self, MujocoError> {
        Ok(loaded()?.kind())
    }
}

/// The functions of the loaded library.
enum Loaded {
    OsMesa(OsMesa),
    Egl(Egl),
}

impl Loaded {
    fn kind(&self) -> Gl {
        match self {
            Self::OsMesa(_) => Gl::OsMesa,
            Self::Egl(_) => Gl::Egl,
        }
    }

    /// Releases the current context of this thread. Returns whether that succeeded.
    ///
    /// # Safety
    /// A context of the library must be current in this thread.
    unsafe fn make_none_current(&self) -> bool {
        // SAFETY: the caller guarantees the context, and null means no context.
        unsafe {
            match self {
                // 0x1406 is GL_FLOAT.
                Self::OsMesa(library) => (library.make_current)(null_mut(), null_mut(), 0x1406, 0, 0) != 0,
                Self::Egl(library) => (library.make_current)(library.display, null_mut(), null_mut(), null_mut()) != 0,
            }
        }
    }
}

/// Allows only one thread at a time to make or free contexts, because MuJoCo then fills its global table of OpenGL functions.
pub(crate) static MAKING: Mutex<()> = Mutex::new(());

/// The library of this process. The first call loads it.
fn loaded() -> Result<&'static Loaded, MujocoError> {
    static LOADED: OnceLock<Result<Loaded, MujocoError>> = OnceLock::new();
    LOADED.get_or_init(load).as_ref().map_err(Clone::clone)
}

/// Loads the library that the environment variable names, or the first one that is available.
fn load() -> Result<Loaded, MujocoError> {
    let chosen = match std::env::var(VARIABLE).ok().as_deref() {
        None | Some("") => None,
        Some("osmesa") => Some(Gl::OsMesa),
        Some("egl") => Some(Gl::Egl),
        Some(found) => {
            return Err(MujocoError::GlName {
                found: found.to_owned(),
            });
        }
    };
    let mut refused = Vec::new();
    for gl in [Gl::OsMesa, Gl::Egl] {
        if chosen.is_some_and(|chosen| chosen != gl) {
            continue;
        }
        let result = match gl {
            Gl::OsMesa => OsMesa::load().map(Loaded::OsMesa),
            Gl::Egl => Egl::load().map(Loaded::Egl),
        };
        match result {
            Ok(loaded) => return Ok(loaded),
            Err(reason) => refused.push(format!("{gl} failed ({reason})")),
        }
    }
    Err(MujocoError::NoGl {
        reason: refused.join(", "),
    })
}

/// Loads the first of these files that can be loaded. Its symbols are global, because MuJoCo looks them up in the whole process.
fn open(names: &[&str]) -> Result<Library, String> {
    let mut reason = String::new();
    for name in names {
        // SAFETY: initialisers of OpenGL libraries only fill their own tables.
        match unsafe { Library::open(Some(name), RTLD_NOW | RTLD_GLOBAL) } {
            Ok(library) => return Ok(library),
            Err(error) => reason = error.to_string(),
        }
    }
    Err(reason)
}

/// Looks up functions in a library that is never unloaded.
macro_rules! take {
    ($library:expr, $kind:ident { $($field:ident: $symbol:literal),* $(,)? }) => {
        $kind {
            // SAFETY: the signatures are those of the libraries' headers.
            $($field: unsafe {
                *$library.get(concat!($symbol, "\0").as_bytes()).map_err(|error| error.to_string())?
            },)*
        }
    };
}

struct OsMesa {
    create: unsafe extern "C" fn(c_uint, c_int, c_int, c_int, *mut c_void) -> *mut c_void,
    make_current: unsafe extern "C" fn(*mut c_void, *mut c_void, c_uint, c_int, c_int) -> u8,
    destroy: unsafe extern "C" fn(*mut c_void),
}

impl OsMesa {
    fn load() -> Result<Self, String> {
        let library = open(&["libOSMesa.so.8", "libOSMesa.so.6", "libOSMesa.so"])?;
        let functions = take!(
            library,
            OsMesa {
                create: "OSMesaCreateContextExt",
                make_current: "OSMesaMakeCurrent",
                destroy: "OSMesaDestroyContext",
            }
        );
        // The library must never be unloaded, because the functions are copied.
        std::mem::forget(library);
        Ok(functions)
    }
}

struct Egl {
    display: *mut c_void,
    choose_config: unsafe extern "C" fn(*mut c_void, *const c_int, *mut *mut c_void, c_int, *mut c_int) -> c_uint,
    bind_api: unsafe extern "C" fn(c_uint) -> c_uint,
    create: unsafe extern "C" fn(*mut c_void, *mut c_void, *mut c_void, *const c_int) -> *mut c_void,
    make_current: unsafe extern "C" fn(*mut c_void, *mut c_void, *mut c_void, *mut c_void) -> c_uint,
    destroy: unsafe extern "C" fn(*mut c_void, *mut c_void) -> c_uint,
}

// SAFETY: EGL's functions and its display may be used from any thread.
unsafe impl Send for Egl {}
// SAFETY: as above.
unsafe impl Sync for Egl {}

/// Constants of EGL (`egl.h`, `eglext.h`).
mod egl {
    use std::ffi::{c_int, c_uint};

    pub(super) const PLATFORM_DEVICE: c_uint = 0x313F;
    pub(super) const PLATFORM_SURFACELESS: c_uint = 0x31DD;
    pub(super) const OPENGL_API: c_uint = 0x30A2;
    /// 8 bits per colour, 24 bits of depth, 8 bits of stencil, full OpenGL.
    pub(super) const CONFIG: [c_int; 17] = [
        0x3024, 8, 0x3023, 8, 0x3022, 8, 0x3021, 8, 0x3025, 24, 0x3026, 8, 0x3033, 1, 0x3040, 8, 0x3038,
    ];
}

impl Egl {
    fn load() -> Result<Self, String> {
        type Display = unsafe extern "C" fn(c_uint, *mut c_void, *const c_int) -> *mut c_void;
        type Devices = unsafe extern "C" fn(c_int, *mut *mut c_void, *mut c_int) -> c_uint;
        struct Start {
            proc_address: unsafe extern "C" fn(*const u8) -> *mut c_void,
            initialize: unsafe extern "C" fn(*mut c_void, *mut c_int, *mut c_int) -> c_uint,
        }
        let library = open(&["libEGL.so.1", "libEGL.so"])?;
        let start = take!(
            library,
            Start {
                proc_address: "eglGetProcAddress",
                initialize: "eglInitialize",
            }
        );
        let mut loaded = take!(
            library,
            EglFunctions {
                choose_config: "eglChooseConfig",
                bind_api: "eglBindAPI",
                create: "eglCreateContext",
                make_current: "eglMakeCurrent",
                destroy: "eglDestroyContext",
            }
        )
        .with_display(null_mut());
        // SAFETY: both names are null-terminated. The functions have these signatures (`EGL_EXT_platform_base`,
        // `EGL_EXT_device_enumeration`), and null means that they do not exist.
        let (display_of, devices_of) = unsafe {
            let display = (start.proc_address)(c"eglGetPlatformDisplayEXT".as_ptr().cast());
            let devices = (start.proc_address)(c"eglQueryDevicesEXT".as_ptr().cast());
            (
                std::mem::transmute::<*mut c_void, Option<Display>>(display),
                std::mem::transmute::<*mut c_void, Option<Devices>>(devices),
            )
        };
        let Some(display_of) = display_of else {
            return Err("it does not support displays without a screen".to_owned());
        };
        let mut candidates = Vec::new();
        if let Some(devices_of) = devices_of {
            let (mut devices, mut count) = ([null_mut(); 16], 0);
            // SAFETY: the array has the given length.
            if unsafe { devices_of(16, devices.as_mut_ptr(), &raw mut count) } != 0 {
                let found = devices.into_iter().take(usize::try_from(count).unwrap_or(0));
                candidates.extend(found.map(|device| (egl::PLATFORM_DEVICE, device)));
            }
        }
        candidates.push((egl::PLATFORM_SURFACELESS, null_mut()));
        for (platform, device) in candidates {
            // SAFETY: the device is from the library or null, and no attributes are given.
            let display = unsafe { display_of(platform, device, std::ptr::null()) };
            // SAFETY: the display is valid, and null means that the version is not requested.
            if !display.is_null() && unsafe { (start.initialize)(display, null_mut(), null_mut()) } != 0 {
                loaded.display = display;
                std::mem::forget(library);
                return Ok(loaded);
            }
        }
        Err("no device can be opened".to_owned())
    }
}

/// [`Egl`] before its display is known.
struct EglFunctions {
    choose_config: unsafe extern "C" fn(*mut c_void, *const c_int, *mut *mut c_void, c_int, *mut c_int) -> c_uint,
    bind_api: unsafe extern "C" fn(c_uint) -> c_uint,
    create: unsafe extern "C" fn(*mut c_void, *mut c_void, *mut c_void, *const c_int) -> *mut c_void,
    make_current: unsafe extern "C" fn(*mut c_void, *mut c_void, *mut c_void, *mut c_void) -> c_uint,
    destroy: unsafe extern "C" fn(*mut c_void, *mut c_void) -> c_uint,
}

impl EglFunctions {
    fn with_display(self, display: *mut c_void) -> Egl {
        Egl {
            display,
            choose_config: self.choose_config,
            bind_api: self.bind_api,
            create: self.create,
            make_current: self.make_current,
            destroy: self.destroy,
        }
    }
}

thread_local! {
    /// The context that is current in this thread.
    static CURRENT: Cell<*mut c_void> = const { Cell::new(null_mut()) };
}

/// Side length (pixels) of the buffer that `OSMesa` requires. It can be small, because images are rendered to MuJoCo's own buffer.
const SIDE: usize = 16;

/// An OpenGL context. It belongs to the thread that made it, until [`Context::release_current`] releases it for another thread.
pub(crate) struct Context {
    loaded: &'static Loaded,
    pointer: *mut c_void,
    /// The default buffer of `OSMesa`, with four floats per pixel. Empty for EGL.
    buffer: Vec<[f32; 4]>,
    /// Keeps the type from being `Send`.
    not_send: PhantomData<*const ()>,
}

impl Context {
    /// Makes a context that is current in this thread. It can share textures and display lists with another context, which need
    /// not be current.
    ///
    /// # Errors
    /// If no library can be loaded, or the library cannot make a context.
    pub(crate) fn new(shares: Option<&Self>) -> Result<Self, MujocoError> {
        let loaded = loaded()?;
        let refused = |reason| MujocoError::Gl {
            gl: loaded.kind(),
            reason,
        };
        let shares = shares.map_or(null_mut(), |other| other.pointer);
        let _alone = MAKING.lock().unwrap_or_else(PoisonError::into_inner);
        let pointer = match loaded {
            // 0x1908 is GL_RGBA. The context has 24 bits of depth, 8 bits of stencil and no accumulation buffer.
            // SAFETY: the other context is from this library or null.
            Loaded::OsMesa(library) => unsafe { (library.create)(0x1908, 24, 8, 0, shares) },
            Loaded::Egl(library) => {
                let (mut config, mut count) = (null_mut(), 0);
                // SAFETY: the attributes are terminated by EGL_NONE (0x3038), and there is room for one configuration.
                let chosen = unsafe {
                    (library.bind_api)(egl::OPENGL_API) != 0
                        && (library.choose_config)(
                            library.display,
                            egl::CONFIG.as_ptr(),
                            &raw mut config,
                            1,
                            &raw mut count,
                        ) != 0
                };
                if !chosen || count < 1 {
                    return Err(refused("it has no configuration with depth and stencil buffers"));
                }
                // SAFETY: the display and the configuration are from the library, and so is the other context unless it is null.
                unsafe { (library.create)(library.display, config, shares, std::ptr::null()) }
            }
        };
        if pointer.is_null() {
            return Err(refused("it cannot make a context"));
        }
        let buffer = match loaded {
            Loaded::OsMesa(_) => vec![[0.0; 4]; SIDE * SIDE],
            Loaded::Egl(_) => Vec::new(),
        };
        let mut context = Self {
            loaded,
            pointer,
            buffer,
            not_send: PhantomData,
        };
        context.make_current()?;
        Ok(context)
    }

    /// Makes it the current context of this thread.
    ///
    /// # Errors
    /// If the library refuses.
    pub(crate) fn make_current(&mut self) -> Result<(), MujocoError> {
        if CURRENT.get() == self.pointer {
            return Ok(());
        }
        let done = match self.loaded {
            // 0x1406 is GL_FLOAT.
            // SAFETY: the buffer has this size and lives as long as the context.
            Loaded::OsMesa(library) => unsafe {
                let side = SIDE as c_int;
                (library.make_current)(self.pointer, self.buffer.as_mut_ptr().cast(), 0x1406, side, side) != 0
            },
            // SAFETY: the display and the context are valid, and no surface is needed.
            Loaded::Egl(library) => unsafe {
                (library.bind_api)(egl::OPENGL_API);
                (library.make_current)(library.display, null_mut(), null_mut(), self.pointer) != 0
            },
        };
        if !done {
            return Err(MujocoError::Gl {
                gl: self.loaded.kind(),
                reason: "its context cannot be used in this thread",
            });
        }
        CURRENT.set(self.pointer);
        Ok(())
    }

    /// Releases it, so that other threads can make it current. This thread then has no current context.
    ///
    /// # Errors
    /// If the library refuses.
    pub(crate) fn release_current(&mut self) -> Result<(), MujocoError> {
        if CURRENT.get() != self.pointer {
            return Ok(());
        }
        // SAFETY: this context is current, as checked above.
        if !unsafe { self.loaded.make_none_current() } {
            return Err(MujocoError::Gl {
                gl: self.loaded.kind(),
                reason: "its context cannot be handed to another thread",
            });
        }
        CURRENT.set(null_mut());
        Ok(())
    }
}

impl Drop for Context {
    fn drop(&mut self) {
        let _alone = MAKING.lock().unwrap_or_else(PoisonError::into_inner);
        // SAFETY: the context belongs to this thread and is not used again. If it is current, it is released first.
        unsafe {
            if CURRENT.get() == self.pointer {
                self.loaded.make_none_current();
            }
            match self.loaded {
                Loaded::OsMesa(library) => (library.destroy)(self.pointer),
                Loaded::Egl(library) => {
                    (library.destroy)(library.display, self.pointer);
                }
            }
        }
        if CURRENT.get() == self.pointer {
            CURRENT.set(null_mut());
        }
    }
}
