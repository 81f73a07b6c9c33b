//! The learned pose encoder of robosuite's tasks: a residual network in burn, its losses, its training and its weights.
//!
//! Training sees images, end-effector poses, gripper widths and modes. No type here holds a recorded object pose.

mod backend;
pub mod batches;
pub mod checkpoint;
pub mod config;
mod error;
pub mod images;
pub mod loss;
mod predict;
pub mod resnet;
pub mod train;
pub mod weights;

pub use config::{Backend, EncoderConfig, LossConfig};
pub use error::EncoderError;
pub use predict::{PICTURE_BYTES, Prediction, Predictor, SIDE};
pub use weights::to_bytes;

/// Side of the part of an image that the encoder sees, in pixels.
pub const CROP: usize = 76;
