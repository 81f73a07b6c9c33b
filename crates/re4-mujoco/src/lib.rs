//! MuJoCo's C library, found at run time.
//!
//! The library is not part of the program: it comes in MuJoCo's own wheel for Python, and its folder is named by the caller.
//! A program that never simulates robots never needs it. [`Library::open`] loads it once a process and checks its version:
//! the layout of MuJoCo's structures differs from version to version, and is known here for [`Version::ALL`].
//!
//! A [`Model`] is a compiled MJCF file and may be shared between threads; a [`Data`] is one simulation of it. The same calls
//! in the same order give the same bits. Units are MuJoCo's: metres, radians, seconds, newtons; quaternions are `w, x, y, z`.

#![expect(unsafe_code, reason = "this crate is the binding to a C library")]

mod block;
mod data;
mod error;
mod gl;
mod layout;
mod library;
mod model;
mod render;
mod stage;
mod trim;
mod view;

pub use data::Data;
pub use error::MujocoError;
pub use gl::Gl;
pub use layout::Version;
pub use library::Library;
pub use model::{Kind, Model};
pub use render::{Footprint, Renderer};
pub use view::View;
