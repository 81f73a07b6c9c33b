//! The measures of a rollout.

use re4_artifact::Word;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// A measure of a rollout, between 0 and 1. Robosuite tasks have only the success.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Measure {
    /// Push-T: maximum of `min(coverage / 0.95, 1)` over the steps of the episode.
    Score,
    /// Push-T: maximum of the coverage over the steps of the episode.
    Coverage,
    /// Push-T: maximum of the intersection over union of block and goal over the steps of the episode.
    Iou,
    /// Whether the task succeeded.
    Success,
}

impl Measure {
    /// All measures.
    pub const ALL: [Self; 4] = [Self::Score, Self::Coverage, Self::Iou, Self::Success];

    /// The name in suite files and tables.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Score => "score",
            Self::Coverage => "coverage",
            Self::Iou => "iou",
            Self::Success => "success",
        }
    }

    /// The name for readers.
    pub fn title(self) -> &'static str {
        match self {
            Self::Score => "mean score",
            Self::Coverage => "mean coverage",
            Self::Iou => "mean IoU",
            Self::Success => "success rate",
        }
    }

    /// Whether only rollouts of Push-T have the measure.
    pub fn is_planar(self) -> bool {
        self != Self::Success
    }
}

impl Word for Measure {
    const ALL: &'static [Self] = &Self::ALL;

    fn word(self) -> &'static str {
        self.as_str()
    }
}
