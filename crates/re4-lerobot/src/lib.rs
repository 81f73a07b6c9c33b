//! Reader of LeRobot datasets, v2.0, v2.1 and v3.0, with their images and videos, and a writer ([`write`]).
//!
//! [`Dataset::open`] reads the metadata, the schema of every table and the index of every video, and compares all counts: episodes,
//! frames, rows, video frames, files. It returns all faults at once, each with its file, its column or key, and a remedy. Then
//! [`Dataset::read`] reads the numbers of one episode after the other, and [`Dataset::images`] the images of a camera in blocks.
//!
//! The reader is strict about counts and lenient about types: a number may be stored in any numeric type, a scalar as a list of one,
//! and statements in `meta/info.json` that only repeat what the files contain (shapes of images, codecs) are not used. What deviates
//! without making the data ambiguous is in [`Dataset::notes`].
//!
//! Videos in AV1 and H.264 are decoded by libraries in Rust, behind one trait in `video`. Panics of decoders become errors. An abort,
//! or a decoder that reserves much memory for a damaged file, cannot be prevented inside a process; programs that read files of unknown
//! origin run this crate in a process of its own with a memory limit.

mod column;
mod contained;
mod dataset;
mod fault;
mod files;
mod frames;
mod images;
mod info;
mod inspect;
mod layout;
mod meta;
mod table;
mod template;
mod video;
pub mod write;

pub use column::{Column, Values};
pub use dataset::{Cameras, Dataset, Episode};
pub use fault::{Fault, Faults, Kind, LerobotError};
pub use frames::Frames;
pub use images::ImageBlock;
pub use info::{Content, Feature, Info, Version};
pub use inspect::{CameraSummary, Coding, Summary};
pub use video::{Chroma, Codec, Color, Matrix, Planes, Stop, Video};
