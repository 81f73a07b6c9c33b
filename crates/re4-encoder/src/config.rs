//! Settings of the encoder and its training.

use std::path::PathBuf;

use re4_train::Backend;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Settings that the others start from.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum Preset {
    /// The paper's appendix "Prehensile Pose Estimation": a ResNet-18 with average pooling and squared distances.
    Paper,
    /// A small network of keypoints with robust distances, which knows the object's symmetry.
    Re4,
}

/// The network.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum Network {
    /// ResNet-18 with average pooling.
    Resnet18,
    /// Convolutions that keep the resolution, a spatial softmax per map, and a small head on the positions of these keypoints.
    Keypoints,
}

/// A frame of a grasp.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum GraspFrame {
    /// The grasp frame: the first frame after the command that closes the gripper.
    Command,
    /// The first frame after that in which the fingers have come to rest on the object.
    Settled,
}

/// The encoder and its training. Settings that are left out have the values of the preset.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct EncoderConfig {
    /// Settings that the others start from: `re4` or `paper`.
    pub preset: Preset,
    /// Name of the camera whose images are the input.
    pub camera: String,
    /// The network.
    pub network: Network,
    /// Channels after the first convolution. `resnet18`: 64 for ResNet-18, a smaller number makes all layers narrower by the same
    /// factor. `keypoints`: a multiple of 16; there are twice as many keypoints.
    pub width: usize,
    /// Initial weights of `resnet18`, with torchvision's names, as `.pth` or `.safetensors`. If omitted, the initial weights
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
    /// How many of the four images of a demonstration show the object held, at most 2; the others are from before the grasp.
    pub held_images: usize,
    /// Learning rate of AdamW.
    pub learning_rate: f64,
    /// Whether the learning rate warms up linearly over the first twentieth of the steps and decays to zero along half a cosine
    /// period; otherwise it is constant.
    pub cosine: bool,
    /// Weight decay of AdamW.
    pub weight_decay: f64,
    /// The frame whose end-effector pose is the anchor. When the fingers have closed, they have pushed the object, so the
    /// pose in that frame is not where the images before the grasp show it.
    pub anchor: GraspFrame,
    /// The first frame that is trained on as holding the object. After the command, the fingers do not hold it yet.
    pub held_from: GraspFrame,
    /// Whether the losses know the object's symmetry, from the task's record, and that a two-finger gripper is the same after a
    /// rotation by 180 degrees.
    pub symmetry: bool,
    /// Whether an object without a symmetry by 180 degrees gets one orientation: after the training, the alternative of every
    /// demonstration is chosen so that similar images have similar rotations, and the rotation is trained again. Otherwise the
    /// estimate can change by 180 degrees where demonstrators changed sides. Applies to `keypoints` with `symmetry`.
    pub one_orientation: bool,
    /// Standard deviation of the random changes of an image's brightness and contrast in training, as a fraction.
    pub brightness: f64,
    /// Crops per image when a pose is estimated: 1, the centre crop, or 5, also those of the corners.
    pub crops: usize,
    /// Weights of the losses.
    pub losses: LossConfig,
    /// Maximum distance between the anchors of two demonstrations that L_cross treats as the same pose, in metres.
    pub radius: f64,
    /// Fraction of the demonstrations in the held-out set, which is not trained on and is used to evaluate the encoder.
    pub held_out: f64,
    /// Seed of initial weights, batches and crops.
    pub seed: u64,
}

impl EncoderConfig {
    /// The settings of a preset.
    pub fn preset(preset: Preset) -> Self {
        match preset {
            Preset::Paper => Self::paper(),
            Preset::Re4 => Self::re4(),
        }
    }

    fn paper() -> Self {
        Self {
            preset: Preset::Paper,
            camera: "agentview".to_owned(),
            network: Network::Resnet18,
            width: 64,
            weights: None,
            backend: Backend::Flex,
            epochs: 20,
            steps: None,
            batch: 64,
            held_images: 2,
            learning_rate: 3e-4,
            cosine: false,
            weight_decay: 1e-4,
            anchor: GraspFrame::Command,
            held_from: GraspFrame::Command,
            symmetry: false,
            one_orientation: false,
            brightness: 0.0,
            crops: 1,
            losses: LossConfig::paper(),
            radius: 0.02,
            held_out: 0.1,
            seed: 0,
        }
    }

    /// docs/results/encoder.md gives the effect of each difference from the paper's settings.
    fn re4() -> Self {
        Self {
            preset: Preset::Re4,
            network: Network::Keypoints,
            width: 16,
            steps: Some(100),
            held_images: 1,
            learning_rate: 5e-3,
            cosine: true,
            weight_decay: 0.1,
            held_from: GraspFrame::Settled,
            symmetry: true,
            one_orientation: true,
            crops: 5,
            losses: LossConfig::robust(),
            ..Self::paper()
        }
    }
}

impl Default for EncoderConfig {
    fn default() -> Self {
        Self::re4()
    }
}

/// How the losses measure the distance between two poses.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum PoseDistance {
    /// The squared translation distance and the rotation angle.
    Squared,
    /// The translation distance, which outliers affect less and whose gradient does not vanish near the target, and the squared
    /// chordal distance of the rotations.
    Robust,
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
    /// How the distance between two poses is measured.
    pub distance: PoseDistance,
    /// Weight of the translation distance: of its square in m^2 (`squared`), or of the distance in m (`robust`).
    pub translation: f64,
    /// Weight of the rotation distance: of the angle in rad (`squared`), or of the squared chordal distance (`robust`).
    pub rotation: f64,
}

impl LossConfig {
    fn paper() -> Self {
        Self {
            absolute: 1.0,
            relative: 0.8,
            cross: 0.5,
            absolute_held: 0.3,
            relative_held: 0.3,
            relative_before: 0.5,
            distance: PoseDistance::Squared,
            translation: 10.0,
            rotation: 1.0,
        }
    }

    fn robust() -> Self {
        Self {
            relative: 2.0,
            cross: 0.0,
            distance: PoseDistance::Robust,
            translation: 100.0,
            rotation: 1.0,
            ..Self::paper()
        }
    }
}

impl Default for LossConfig {
    fn default() -> Self {
        Self::robust()
    }
}
