//! The stage `scenes`: makes `scenes`, from which rollouts start, from `episodes`.

use anyhow::Result;
use re4_artifact::{Artifact, ArtifactSummary, Recipe, Stage};
use re4_scenes::{ObjectFrame, SceneRow, ScenesConfig, SparseScene, sparse_scenes};
use serde_json::json;

use crate::inputs::episodes::read_episodes;
use crate::runner::{Built, Runner};

/// Increase it whenever the same input gives different bytes.
const CODE_VERSION: u32 = 2;

impl Runner {
    /// Makes the `scenes` artifact, or returns the existing one; `None` if the pipeline has no table `[scenes]`.
    ///
    /// # Errors
    /// If an input cannot be read, a setting does not fit the input, or the run is interrupted.
    pub fn scenes(&self, episodes: &Built) -> Result<Option<Built>> {
        let config = self.pipeline.scenes.as_ref();
        config.map(|config| self.choose_scenes(config, episodes)).transpose()
    }

    fn choose_scenes(&self, config: &ScenesConfig, episodes: &Built) -> Result<Built> {
        let recipe = Recipe::new(Stage::Scenes, CODE_VERSION)
            .config(config)?
            .input("episodes", episodes.artifact.key());
        self.build(&recipe, |writer| {
            let frames = object_frames(&episodes.artifact)?;
            let columns = u64::from(config.grid).pow(2);
            let bar = self.notes.progress(columns, "columns of the grid");
            let going = || {
                bar.inc(1);
                !self.interrupt.requested()
            };
            let scenes = sparse_scenes(&frames, config, &going)?;
            bar.finish_and_clear();
            writer.write_rows((0..).zip(&scenes).map(|(scene, &chosen)| SceneRow { scene, chosen }))?;
            let rho = |scene: Option<&SparseScene>| scene.map(|s| s.rho);
            Ok(ArtifactSummary {
                summary: json!({
                    "scenes": scenes.len(),
                    "poses": config.poses,
                    "rho_maximum": rho(scenes.first()),
                    "rho_minimum": rho(scenes.last()),
                }),
                warnings: Vec::new(),
            })
        })
    }
}

/// The recorded poses of the block in all frames. Image variants read them here, too: they determine where policies are
/// evaluated, so that all variants start from the same scenes, and nothing is trained on them.
fn object_frames(episodes: &Artifact) -> Result<Vec<ObjectFrame>> {
    let episodes = read_episodes(episodes)?;
    let frames = (0..).zip(&episodes).flat_map(|(episode, demonstration)| {
        (0..).zip(&demonstration.frames).map(move |(frame, row)| ObjectFrame {
            episode,
            frame,
            object: row.object,
        })
    });
    Ok(frames.collect())
}
