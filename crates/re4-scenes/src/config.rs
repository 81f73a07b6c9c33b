//! Settings, and what each of them decides.

use re4_index::AngleMetric;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Which scenes are wanted.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum SceneKind {
    /// Poses of the block as far as can be from those of all demonstrations: the paper's Sparse Observation Experiment.
    SparseObservations,
}

/// Scenes that rollouts start from, in place of those of seeds.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct ScenesConfig {
    /// Which scenes are wanted.
    pub kind: SceneKind,
    /// Poses of the block, the paper's K.
    #[serde(default = "poses")]
    pub poses: u32,
    /// Positions of the pusher at every pose, the paper's J.
    #[serde(default = "pushers")]
    pub pushers: u32,
    /// Places of the grid along each of x, y and theta.
    #[serde(default = "grid")]
    pub grid: u32,
    /// How far the grid reaches beyond the positions of the demonstrations, in pixels. The paper says 2 cm; with the window
    /// of 512 px read as 0.512 m, that is 20 px.
    #[serde(default = "padding_position")]
    pub padding_position: f64,
    /// How far it reaches beyond their angles, in radians. Where the angles then go all the way round, the circle is swept
    /// once.
    #[serde(default = "padding_angle")]
    pub padding_angle: f64,
    /// Minimum distance between two chosen poses, in normalised coordinates, the angle taken the short way round. The paper
    /// names no figure. 0.2 is a fifth of the range of one dimension, some 76 px or 72 degrees for the human demonstrations
    /// of Push-T: far enough for two poses to ask for different pushes, and near enough for 25 poses to stay far from the
    /// demonstrations.
    #[serde(default = "separation")]
    pub separation: f64,
    /// How angles enter the distance to the demonstrations.
    #[serde(default)]
    pub angle: AngleMetric,
    /// Whether the whole block has to lie between the walls. The paper does not say; a block that reaches into a wall is
    /// pushed out of it by the first physics step, so that the rollout would start from another pose than the chosen one.
    #[serde(default = "yes")]
    pub inside_walls: bool,
    /// Minimum distance, in pixels, between the edge of the pusher and the block.
    #[serde(default = "clearance")]
    pub clearance: f64,
    /// Seed of the pusher's positions.
    #[serde(default)]
    pub seed: u32,
}

impl ScenesConfig {
    /// The paper's figures, and our choices where it has none.
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
