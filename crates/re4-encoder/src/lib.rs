//! The learned pose encoder for robosuite's tasks: its networks in burn, losses, training, checkpoints and weights.
//!
//! Training uses images, end-effector poses, gripper widths and modes. No type in this crate contains a recorded object pose, so
//! ground truth cannot reach the training.

pub mod batches;
mod confidence;
pub mod config;
mod conv;
mod error;
pub mod images;
mod keypoints;
pub mod loss;
pub mod network;
mod orientation;
mod predict;
pub mod resnet;
pub mod train;
mod trunk;
pub mod weights;

pub use confidence::Calibration;
pub use config::{EncoderConfig, GraspFrame, LossConfig, Network, PoseDistance, Preset};
pub use error::EncoderError;
pub use predict::{IMAGE_BYTES, Prediction, Predictor, SIDE, is_blank};
pub use weights::to_bytes;

/// Side of the crop that is the encoder's input, in pixels.
pub const CROP: usize = 76;

/// The number of channels of a keypoint network is a multiple of this.
pub const KEYPOINT_CHANNELS: usize = conv::CHANNELS;
