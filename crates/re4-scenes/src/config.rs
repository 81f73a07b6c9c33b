//! Settings of the choice of scenes.

use re4_index::AngleMetric;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// The kind of scenes to choose.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum SceneKind {
    /// Poses of the block that are as far as possible from those of all demonstrations: the paper's Sparse Observation
    /// Experiment.
    SparseObservations,
}

/// Scenes in which rollouts start, instead of those of seeds.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct ScenesConfig {
    /// The kind of scenes to choose.
    pub kind: SceneKind,
    /// Number of poses of the block, the paper's K.
    #[serde(default = "poses")]
    pub poses: u32,
    /// Number of positions of the pusher at every pose, the paper's J.
    #[serde(default = "pushers")]
    pub pushers: u32,
    /// Number of grid points along each of x, y and theta.
    #[serde(default = "grid")]
    pub grid: u32,
    /// Padding of the grid around the positions of the demonstrations, in pixels. The paper uses 2 cm; if the window of 512 px
    /// is 0.512 m wide, that is 20 px.
    #[serde(default = "padding_position")]
    pub padding_position: f64,
    /// Padding of the grid around the angles of the demonstrations, in radians. If the padded range covers the full circle, the
    /// grid covers the circle once.
    #[serde(default = "padding_angle")]
    pub padding_angle: f64,
    /// Minimum distance between two chosen poses, in normalised coordinates, with the shortest angular difference. The paper
    /// gives no value. 0.2 is a fifth of the range of one dimension, about 76 px or 72 degrees for the human demonstrations
    /// of Push-T: large enough that two poses need different pushes, and small enough that 25 poses stay far from the
    /// demonstrations.
    #[serde(default = "separation")]
    pub separation: f64,
    /// How angles are compared in the distance to the demonstrations.
    #[serde(default)]
    pub angle: AngleMetric,
    /// Whether the whole block must be between the walls. The paper does not specify this. The first physics step pushes a
    /// block that reaches into a wall out of it, so the rollout would start from another pose than the chosen one.
    #[serde(default = "yes")]
    pub inside_walls: bool,
    /// Minimum distance between the edge of the pusher and the block, in pixels.
    #[serde(default = "clearance")]
    pub clearance: f64,
    /// Seed of the sampled positions of the pusher.
    #[serde(default)]
    pub seed: u32,
}

impl ScenesConfig {
    /// The paper's settings, and our own choices where the paper gives none.
    pub fn sparse_observations() -> Self {
        Self {
            kind: SceneKind::SparseObservations,
            poses: poses(),
            pushers: pushers(),
            grid: grid(),
            padding_position: padding_position(),
            padding_angle: padding_angle(),
            separation: separation(),
            angle: AngleMetric::default(),
            inside_walls: yes(),
            clearance: clearance(),
            seed: 0,
        }
    }
}

fn poses() -> u32 {
    25
}

fn pushers() -> u32 {
    3
}

fn grid() -> u32 {
    50
}

fn padding_position() -> f64 {
    20.0
}

fn padding_angle() -> f64 {
    0.15
}

fn separation() -> f64 {
    0.2
}

fn yes() -> bool {
    true
}

fn clearance() -> f64 {
    5.0
}
