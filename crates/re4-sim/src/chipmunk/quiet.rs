//! Suppresses Chipmunk's greeting on standard output.
//!
//! A debug build of Chipmunk, such as Debian's package, prints two lines to C's `stdout` when the first space of a process
//! is created. They would corrupt machine-readable output of the program.

use std::sync::Once;

use super::ffi;

static GREETING: Once = Once::new();

/// Creates and frees the first space of the process while C's `stdout` is redirected to `/dev/null`.
///
/// Runs once; other threads wait for it. Only the pointer that C code prints through is changed, for some microseconds:
/// Rust's standard output writes to the file descriptor and is not affected.
pub(super) fn greet_once() {
    GREETING.call_once(|| {
        silently(|| {
            // SAFETY: the space is made, not used, and freed once.
            unsafe { ffi::cpSpaceFree(ffi::cpSpaceNew()) }
        });
    });
}

#[cfg(all(target_os = "linux", target_env = "gnu"))]
fn silently(work: impl FnOnce()) {
    use std::ffi::{c_char, c_void};

    unsafe extern "C" {
        // glibc's `stdout` is a variable that programs may set (glibc manual, "Standard Streams").
        static mut stdout: *mut c_void;
        fn fopen(path: *const c_char, mode: *const c_char) -> *mut c_void;
    }

    // SAFETY: both arguments are zero-terminated strings. The stream is never closed, because another thread may have printed
    // from C in the meantime and still use it. This leaves one open file per process.
    let nowhere = unsafe { fopen(c"/dev/null".as_ptr(), c"we".as_ptr()) };
    if nowhere.is_null() {
        return work();
    }
    // SAFETY: the variable is a valid stream before, during and after this function; `Once` excludes other callers of this
    // function, and nothing else in this crate or in Rust's library reads or sets it.
    let usual = unsafe { std::ptr::replace(&raw mut stdout, nowhere) };
    work();
    // SAFETY: as above.
    unsafe { stdout = usual }
}

/// Other C libraries do not let programs set `stdout`: the two lines of a debug build then appear once.
#[cfg(not(all(target_os = "linux", target_env = "gnu")))]
fn silently(work: impl FnOnce()) {
    work();
}
