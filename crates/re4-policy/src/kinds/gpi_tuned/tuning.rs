//! The authors' constants for each task. They were found by a search per task on 31 seeds and are copied with all their digits.

use nalgebra::Vector3;

/// The rules that differ between the tasks.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Rule {
    /// Phases pick and lift; no gating; displacements of the end effector.
    Lift,
    /// Phases pick, lift and transport.
    Can,
    /// Phases pick, lift, transport, pre-insert and insert.
    Square,
}

/// Weights of the blocks of a feature vector, in the order of the vector.
pub(super) const BLOCKS: [(&str, usize); 10] = [
    ("relative_pos", 3),
    ("relative_quat", 4),
    ("gripper_qpos", 2),
    ("object_frame_relative_pos", 3),
    ("object_z", 1),
    ("object_pos", 3),
    ("eef_pos", 3),
    ("eef_quat", 4),
    ("object_to_target_pos", 3),
    ("object_quat", 4),
];

/// Constants of the re-ranking of candidates by their progress.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Rerank {
    /// Number of nearest frames that are re-ranked.
    pub(super) candidates: usize,
    /// Number of frames within which progress is measured.
    pub(super) ahead: usize,
    /// Weight of the gain in orientation.
    pub(super) orientation: f64,
    /// Weight of the nearness of the demonstration's end.
    pub(super) ending: f64,
    /// Whether frames are penalised after which the gripper is far from the object or the object is high.
    pub(super) penalties: bool,
    /// A frame is accepted up to `factor * d + offset`, where d is the distance of the choice before the re-ranking.
    pub(super) factor: f64,
    pub(super) offset: f64,
}

/// Constants of a task.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Tuning {
    pub(super) name: &'static str,
    pub(super) rule: Rule,
    /// Number of actions of a plan.
    pub(super) horizon: u32,
    /// Number of principal components.
    pub(super) components: usize,
    /// Weights of the blocks of features.
    pub(super) weights: [f64; 10],
    /// Goal position of the object in metres. Without one, the median of the demonstrations' last object positions.
    pub(super) target: Option<[f64; 3]>,
    /// Start values of the thresholds: height above the table (m), distance from gripper to object (m), finger position (m).
    pub(super) lift_delta: f64,
    pub(super) contact: f64,
    pub(super) close: f64,
    pub(super) rerank: Option<Rerank>,
    /// Number of frames ahead at which the correction of an action looks, and its gain.
    pub(super) flow_ahead: usize,
    pub(super) flow_gain: f64,
}

pub(super) const LIFT: Tuning = Tuning {
    name: "lift",
    rule: Rule::Lift,
    horizon: 1,
    components: 5,
    weights: [1.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0],
    target: Some([0.0; 3]),
    lift_delta: 0.03,
    contact: 0.085,
    close: 0.03,
    rerank: None,
    flow_ahead: 0,
    flow_gain: 0.0,
};

pub(super) const CAN: Tuning = Tuning {
    name: "can",
    rule: Rule::Can,
    horizon: 3,
    components: 16,
    weights: [1.0, 0.0, 1.0, 1.0, 1.0, 1.0, 1.0, 0.0, 1.0, 0.0],
    target: None,
    lift_delta: 0.028_037,
    contact: 0.053_387,
    close: 0.035_858,
    rerank: Some(Rerank {
        candidates: 32,
        ahead: 32,
        orientation: 0.0,
        ending: 0.25,
        penalties: true,
        factor: 1.6,
        offset: 0.04,
    }),
    flow_ahead: 8,
    flow_gain: 0.5,
};

pub(super) const SQUARE: Tuning = Tuning {
    name: "square",
    rule: Rule::Square,
    horizon: 8,
    components: 26,
    weights: [1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 0.2, 1.0, 1.0],
    target: Some([0.23, 0.10, 0.85]),
    lift_delta: 0.03,
    contact: 0.085,
    close: 0.03,
    rerank: Some(Rerank {
        candidates: 48,
        ahead: 24,
        orientation: 0.25,
        ending: 0.513_053,
        penalties: false,
        factor: 2.270_861,
        offset: 0.055_830,
    }),
    flow_ahead: 5,
    flow_gain: 0.496_402,
};

/// Finger position in metres above which the gripper counts as open.
pub(super) const OPEN: f64 = 0.035;

/// Limits the length of a vector.
pub(super) fn cap(vector: Vector3<f64>, length: f64) -> Vector3<f64> {
    let norm = vector.norm();
    if norm > length {
        vector * (length / norm)
    } else {
        vector
    }
}
