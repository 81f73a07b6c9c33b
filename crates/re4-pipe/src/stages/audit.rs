//! Audit: `episodes` and `modes` to the findings of an `audit`.

use anyhow::Result;
use re4_artifact::{Facts, Recipe, Stage};
use serde_json::json;

use super::{Built, Runner};

/// Raised whenever the same input gives other bytes.
const CODE_VERSION: u32 = 1;

impl Runner {
    /// The `audit` artifact.
    pub(crate) fn audit(&self, episodes: &Built, modes: &Built) -> Result<Built> {
        let recipe = Recipe::new(Stage::Audit, CODE_VERSION)
            .config(&self.pipeline.audit)?
            .input("episodes", episodes.artifact.key())
            .input("modes", modes.artifact.key());
        self.build(&recipe, |_writer| {
            Ok(Facts {
                summary: json!({}),
                warnings: Vec::new(),
            })
        })
    }
}
