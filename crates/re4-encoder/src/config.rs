//! Settings of the encoder and its training.

use std::path::PathBuf;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// The backend that runs the network.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum Backend {
    /// Pure Rust on the CPU; always available, with bit-identical results for any number of threads.
    Flex,
    /// `LibTorch` on the CPU; requires a build with `--features torch`.
    Torch,
    /// `LibTorch` on an NVIDIA GPU; requires a build with `--features torch`.
    Cuda,
}

impl Backend {
    /// The backend's name in pipeline files.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Flex => "flex",
            Self::Torch => "torch",
            Self::Cuda => "cuda",
        }
    }
}

/// The encoder and its training (the paper's appendix "Prehensile Pose Estimation").
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct EncoderConfig {
    /// Name of the camera whose images are the input.
    pub camera: String,
    /// Channels after the first convolution: 64 for ResNet-18; a smaller number makes all layers narrower by the same factor.
    pub width: usize,
    /// Initial weights: those of ResNet-18 with torchvision's names, as `.pth` or `.safetensors`. If omitted, the initial weights
    /// are random. The path is looked up as for `ingest.source`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub weights: Option<PathBuf>,
    /// The backend. Backends other than `flex` require a program built with them.
    pub backend: Backend,
    /// Number of epochs.
    pub epochs: u32,
    /// Optimiser steps per epoch; if omitted, the number of training images divided by the batch size.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub steps: Option<u32>,
    /// Images per step, a multiple of 8: groups of two demonstrations with four images each.
    pub batch: usize,
    /// Learning rate of AdamW.
    pub learning_rate: f64,
    /// Whether the learning rate warms up linearly over the first twentieth of the steps and decays to zero along half a cosine
    /// period; otherwise it is constant.
    pub cosine: bool,
    /// Weight decay of AdamW.
    pub weight_decay: f64,
    /// Weights of the losses.
    pub losses: LossConfig,
    /// Maximum distance between the anchors of two demonstrations that L_cross treats as the same pose, in metres.
    pub radius: f64,
    /// Fraction of the demonstrations in the held-out set, which is not trained on and is used to evaluate the encoder.
    pub held_out: f64,
    /// Seed of initial weights, batches and crops.
    pub seed: u64,
}

impl Default for EncoderConfig {
    fn default() -> Self {
        Self {
            camera: "agentview".to_owned(),
            width: 64,
            weights: None,
            backend: Backend::Flex,
            epochs: 20,
            steps: None,
            batch: 64,
            learning_rate: 3e-4,
            cosine: false,
            weight_decay: 1e-4,
            losses: LossConfig::default(),
            radius: 0.02,
            held_out: 0.1,
            seed: 0,
        }
    }
}

/// Weights of the losses; a weight of 0 disables a loss.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct LossConfig {
    /// L_abs: the estimate equals the end effector's pose while the object is held, and the demonstration's anchor before that.
    pub absolute: f64,
    /// L_rel: within a demonstration, the object moves like the end effector while held, and does not move before the grasp.
    pub relative: f64,
    /// L_cross: demonstrations with nearby anchors have equal estimates before the grasp.
    pub cross: f64,
    /// In L_abs, the fraction of the weight on frames in which the object is held; the rest is on frames before the grasp.
    pub absolute_held: f64,
    /// In L_rel, the weight of pairs of frames in which the object is held.
    pub relative_held: f64,
    /// In L_rel, the weight of pairs of frames before the grasp.
    pub relative_before: f64,
    /// Weight of the squared translation distance in m^2, relative to the rotation angle in rad.
    pub translation: f64,
}

impl Default for LossConfig {
    fn default() -> Self {
        Self {
            absolute: 1.0,
            relative: 0.8,
            cross: 0.5,
            absolute_held: 0.3,
            relative_held: 0.3,
            relative_before: 0.5,
            translation: 10.0,
        }
    }
}
