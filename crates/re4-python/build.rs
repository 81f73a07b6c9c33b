//! Lets the archive of Chipmunk be linked into a library.
//!
//! Debian compiles the archive for programs, not for libraries. In a library, only its one use of an external variable cannot be
//! linked: `stderr`, to which it prints before it aborts. The linker therefore resolves `stderr` in all C code of this library to
//! a variable of its own (`src/c_stderr.rs`), which has the same value.

fn main() {
    println!("cargo::rerun-if-changed=build.rs");
    println!("cargo::rustc-link-arg-cdylib=-Wl,--defsym=stderr=re4_python_stderr");
}
