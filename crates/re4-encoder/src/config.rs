//! Settings of the encoder and its training.

use std::path::PathBuf;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// What computes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum Backend {
    /// Pure Rust on the processor; always there, and the same bits for any number of threads.
    Flex,
    /// `LibTorch` on the processor; built with `--features torch`.
    Torch,
    /// `LibTorch` on an NVIDIA graphics card; built with `--features torch`.
    Cuda,
}

impl Backend {
    /// Its name in pipeline files.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Flex => "flex",
            Self::Torch => "torch",
            Self::Cuda => "cuda",
        }
    }
}

/// The encoder and how it is trained (the paper's appendix "Prehensile Pose Estimation").
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct EncoderConfig {
    /// Camera whose images are read.
    pub camera: String,
    /// Channels after the first convolution: 64 is ResNet-18; fewer make all layers narrower by the same factor.
    pub width: usize,
    /// Weights to start from: ResNet-18's in torchvision's names, as `.pth` or `.safetensors`. Random ones where it is left
    /// out. Looked for as the source is.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub weights: Option<PathBuf>,
    /// What computes. Others than `flex` need a program built with them.
    pub backend: Backend,
    /// Epochs.
    pub epochs: u32,
    /// Steps of the optimiser an epoch; as many as draw as many images as there are where it is left out.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub steps: Option<u32>,
    /// Images a step, a multiple of 8: groups of two demonstrations with four images each.
    pub batch: usize,
    /// Learning rate of AdamW.
    pub learning_rate: f64,
    /// Whether the learning rate falls to zero along half a cosine; it is constant otherwise.
    pub cosine: bool,
    /// Weight decay of AdamW.
    pub weight_decay: f64,
    /// Weights of the losses.
    pub losses: LossConfig,
    /// Anchors of two demonstrations that are nearer than this belong to one place (L_cross), in metres.
    pub radius: f64,
    /// Fraction of the demonstrations that are not trained on and tell how good the encoder is.
    pub held_out: f64,
    /// Seed of weights, batches and crops.
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

/// Weights of the losses; 0 leaves one out.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct LossConfig {
    /// L_abs: the estimate is the end effector's pose while the object is held, and before that the demonstration's anchor.
    pub absolute: f64,
    /// L_rel: inside of a demonstration, the object moves as the end effector while held, and not at all before.
    pub relative: f64,
    /// L_cross: demonstrations whose anchors are near have the same estimate before the grasp.
    pub cross: f64,
    /// Of L_abs, the fraction of frames that hold the object; the others are before the grasp.
    pub absolute_held: f64,
    /// In L_rel, the weight of pairs that hold the object.
    pub relative_held: f64,
    /// In L_rel, the weight of pairs before the grasp.
    pub relative_before: f64,
    /// Weight of a metre of translation where a radian counts 1.
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
