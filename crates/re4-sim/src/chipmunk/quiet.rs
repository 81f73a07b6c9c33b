//! Keeps Chipmunk's greeting off standard output.
//!
//! A debug build of Chipmunk, which Debian's package is, prints two lines to C's `stdout` when the first space of a process
//! is made. On standard output they would spoil what a program writes there for other programs.

use std::sync::Once;

use super::ffi;

static GREETING: Once = Once::new();

/// Makes and frees one space, the first of the process, while C's `stdout` leads nowhere.
///
/// Runs once; other threads wait for it. Only the pointer that C code prints through is changed, for some microseconds:
/// Rust's own standard output writes to the file descriptor and loses nothing.
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

    // SAFETY: both arguments are strings that end in zero. The stream is never closed: a thread that printed from C in the
    // meantime could still hold it. That is one open file for the whole process.
    let nowhere = unsafe { fopen(c"/dev/null".as_ptr(), c"we".as_ptr()) };
    if nowhere.is_null() {
        return work();
    }
    // SAFETY: the variable holds a valid stream before, meanwhile and after; `Once` keeps other callers of this function
    // out, and nothing else in this crate or in Rust's library reads or sets it.
    let usual = unsafe { std::ptr::replace(&raw mut stdout, nowhere) };
    work();
    // SAFETY: as above.
    unsafe { stdout = usual }
}

/// Other C libraries do not let programs set `stdout`: there, the two lines of a debug build appear once.
#[cfg(not(all(target_os = "linux", target_env = "gnu")))]
fn silently(work: impl FnOnce()) {
    work();
}
