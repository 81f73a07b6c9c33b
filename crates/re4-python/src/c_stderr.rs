//! The variable that C code in this library uses as `stderr`; `build.rs` explains why it has one of its own.
#![expect(unsafe_code, reason = "a variable of C")]

use std::ptr;
use std::sync::atomic::{AtomicPtr, Ordering};

/// A pointer to C's standard error stream. It has the layout of a pointer, as which C code reads it.
#[unsafe(no_mangle)]
static re4_python_stderr: AtomicPtr<libc::FILE> = AtomicPtr::new(ptr::null_mut());

/// Sets the variable. To be called before anything else in this library.
pub(crate) fn set() {
    // SAFETY: the C library of the process has the variable `stderr`, whose type is a pointer to a stream.
    let stream = unsafe {
        let variable = libc::dlsym(libc::RTLD_DEFAULT, c"stderr".as_ptr()).cast::<*mut libc::FILE>();
        variable.as_ref().copied()
    };
    re4_python_stderr.store(stream.unwrap_or(ptr::null_mut()), Ordering::Relaxed);
}
