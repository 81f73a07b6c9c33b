//! What the stages that train a network share: checkpoints beside the artifact that is being built, and the record of the rate.

use anyhow::Result;
use re4_artifact::{ArtifactSummary, Recipe, Writer};
use re4_train::Checkpoints;
use serde_json::Value;
use tracing::info;

use crate::runner::{Built, Runner};

/// Folder of checkpoints, below the artifacts folder.
const CHECKPOINTS: &str = "checkpoints";

impl Runner {
    /// Returns the artifact of a recipe, and makes it by a training if it does not exist. `make` also returns the rate of the
    /// training, which is recorded under the name `rate_name`. The checkpoints are removed once the artifact is published.
    pub(crate) fn build_trained(
        &self,
        recipe: &Recipe,
        rate_name: &str,
        make: impl FnOnce(&Writer, &Checkpoints) -> Result<(ArtifactSummary, Option<f64>)>,
    ) -> Result<Built> {
        let key = recipe.key();
        let folder = self.store.root().join(CHECKPOINTS).join(key.short());
        let mut checkpoints = None;
        let built = self.build(recipe, |writer| {
            info!(checkpoints = %folder.display(), resumed = folder.is_dir(), "training");
            let kept = checkpoints.insert(Checkpoints::open(&folder, *key.as_bytes())?);
            let (summary, rate) = make(writer, kept)?;
            // The rate differs between runs, so it is recorded outside of the artifact.
            if let Some(rate) = rate {
                self.measured(rate_name, Value::from(rate));
            }
            Ok(summary)
        })?;
        // If the artifact existed already, this run has no checkpoints, but a run that was killed after publishing has left some.
        if checkpoints.is_none() && folder.is_dir() {
            checkpoints = Some(Checkpoints::open(&folder, *key.as_bytes())?);
        }
        if let Some(checkpoints) = checkpoints {
            checkpoints.remove()?;
        }
        Ok(built)
    }
}
