//! A binding to MuJoCo's C library, which is loaded at run time.
//!
//! The library is not part of the program. It comes with MuJoCo's Python wheel, and the caller gives its folder. A program that
//! simulates no robots does not need it. [`Library::open`] loads the library once per process and checks its version, because the
//! layout of MuJoCo's structures differs between versions. The versions in [`Version::ALL`] are supported.
//!
//! A [`Model`] is a compiled MJCF file that threads can share. A [`Data`] is one simulation of a model. The same calls in the same
//! order give bit-exact results. Units are MuJoCo's: metres, radians, seconds, newtons. Quaternions are `w, x, y, z`.

#![expect(unsafe_code, reason = "this crate is the binding to a C library")]

mod block;
mod data;
mod error;
mod gl;
mod layout;
mod library;
mod model;
mod render;
mod shared_assets;
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
