//! Train-pose for robosuite's tasks: the encoder.

use anyhow::{Result, bail};

use super::super::{Built, Runner};

/// File of a `poses` artifact that holds the encoder's weights.
pub(in super::super) const WEIGHTS: &str = "encoder.safetensors";

impl Runner {
    /// The `poses` artifact of a robosuite task.
    pub(crate) fn train_encoder(&self, _episodes: &Built, _modes: &Built) -> Result<Built> {
        bail!("the pose encoder cannot be trained yet")
    }
}
