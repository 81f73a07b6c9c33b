//! The learned pose encoder of robosuite's tasks: a residual network in burn, its losses, its training and its weights.
//!
//! Training sees pictures, end-effector poses, gripper widths and modes. No type here holds a recorded object pose.

mod backend;
pub mod config;
mod error;
mod predict;
pub mod resnet;
pub mod weights;

pub use config::{Backend, EncoderConfig, LossConfig};
pub use error::EncoderError;
pub use predict::{PICTURE_BYTES, Prediction, Predictor, SIDE};
