//! Networks that generate chunks of actions from observations: diffusion (DDPM, DDIM) and flow matching, in burn.
//!
//! * [`config`] contains the settings of the method, the network and the training.
//! * [`windows`] cuts demonstrations into pairs of an observation history and a chunk of actions.
//! * [`network`] contains the conditional 1-D U-Net of Diffusion Policy and an MLP with the same interface.
//! * [`diffusion`] contains the noise schedule and the two samplers, [`flow`] the flow's targets and its integration.
//! * [`train`] trains a network, [`Generator`] generates chunks with the trained one, and [`weights`] reads and writes its weights.
//!
//! Observations and actions are vectors of numbers; their meaning belongs to the caller. Tensors of chunks have the shape
//! `[batch, time, channels]`.

pub mod config;
pub mod diffusion;
mod error;
pub mod flow;
mod generator;
pub mod layers;
pub mod network;
pub mod normalize;
pub mod train;
pub mod weights;
pub mod windows;

pub use config::{GenerativeConfig, Method, NetworkSize};
pub use error::GenerativeError;
pub use generator::{Generator, Request, Sampler};
pub use normalize::{Kind, Normalizer};
pub use windows::{Demo, Windows};
