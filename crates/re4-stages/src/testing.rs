//! Stages with an invented encoder in the place of a trained one: what tests of image variants call.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;

use anyhow::{Context as _, Result};
use nalgebra::Isometry3;
use re4_artifact::{Artifact, Stage};
use re4_policy::PolicyError;
use re4_policy::spatial::{MakeObserver, Observer};
use re4_sim::robosuite::Robosuite;

use crate::inputs::simulators::Scenes;
use crate::notes::Notes;
use crate::runner::{Built, Runner, Settings};
use crate::stages::{Lens, Studio, put_renderer_away, unseen};

/// What an invented encoder says: of a picture, and, as no real one can, of the simulation that the picture is of.
pub type Estimate = Arc<dyn Fn(&[u8], &Robosuite) -> Isometry3<f64> + Send + Sync>;

/// A pipeline whose stages up to `segment` were run, and a `poses` artifact.
pub struct Invented<'a> {
    /// The pipeline file.
    pub pipeline: &'a Path,
    /// As `--set` has them.
    pub overrides: &'a [String],
    /// The artifacts folder.
    pub artifacts: &'a Path,
    /// Folder of the `poses` artifact.
    pub poses: &'a Path,
}

struct InventedEye {
    lens: Lens,
    estimate: Estimate,
}

impl Observer for InventedEye {
    fn object(&mut self, simulation: &Robosuite) -> Result<Isometry3<f64>, PolicyError> {
        let picture = self.lens.draw(&simulation.state()).map_err(unseen)?;
        Ok((self.estimate)(picture, simulation))
    }
}

impl Invented<'_> {
    fn runner(&self) -> Result<Runner> {
        runner(self.pipeline, self.overrides, self.artifacts)
    }

    fn poses(&self) -> Result<Built> {
        Ok(Built {
            stage: Stage::TrainPose,
            artifact: Artifact::open(self.poses)?,
            skipped: true,
            wall: Duration::ZERO,
        })
    }

    /// The folder of the `index` artifact over these poses.
    ///
    /// # Errors
    /// The sentence that the program would print.
    pub fn index(&self) -> Result<PathBuf, String> {
        let made = || {
            let runner = self.runner()?;
            let episodes = runner.ingest()?;
            let modes = runner.segment(&episodes)?;
            runner.index_spatial(&episodes, &modes, Some(&self.poses()?))
        };
        made().map(|built| built.artifact.path().to_owned()).map_err(told)
    }

    /// The folder of the `rollouts` artifact, with pictures that `estimate` is shown.
    ///
    /// # Errors
    /// The sentence that the program would print.
    pub fn roll_out(&self, estimate: &Estimate) -> Result<PathBuf, String> {
        let open = |studio: Studio| -> Result<Box<MakeObserver<'static>>> {
            let estimate = Arc::clone(estimate);
            Ok(Box::new(move |start| {
                Ok(Box::new(InventedEye {
                    lens: studio.lens(start.seed).map_err(unseen)?,
                    estimate: Arc::clone(&estimate),
                }))
            }))
        };
        let made = || {
            let runner = self.runner()?;
            let episodes = runner.ingest()?;
            let modes = runner.segment(&episodes)?;
            let poses = self.poses()?;
            let index = runner.index_spatial(&episodes, &modes, Some(&poses))?;
            runner.rollout_watching(&episodes, Some((&poses, &open)), &index)
        };
        made().map(|built| built.artifact.path().to_owned()).map_err(told)
    }
}

/// The pictures that a policy would see in these states (time, coordinates, velocities), with a cube of these half sizes where
/// the task is Lift.
///
/// # Errors
/// The sentence that the program would print.
pub fn pictures(
    pipeline: &Path,
    artifacts: &Path,
    boxes: &[(String, [f64; 3])],
    states: &[Vec<f64>],
) -> Result<Vec<Vec<u8>>, String> {
    let drawn = || -> Result<Vec<Vec<u8>>> {
        let runner = runner(pipeline, &[], artifacts)?;
        let task = runner.pipeline.task.robosuite().context("no simulator for this task")?;
        let fidelity = runner.pipeline.spatial_rollout()?.fidelity;
        let episodes = runner.ingest()?.artifact;
        let scenes = Scenes::open(&episodes, task, fidelity)?;
        let studio = Studio::open(&scenes, &episodes, task, &runner.pipeline.pose()?.encoder().camera)?;
        let mut lens = studio.lens_of(boxes)?;
        states.iter().map(|state| Ok(lens.draw(state)?.to_vec())).collect()
    };
    let pictures = drawn().map_err(told);
    put_renderer_away();
    pictures
}

fn runner(pipeline: &Path, overrides: &[String], artifacts: &Path) -> Result<Runner> {
    Runner::new(&Settings {
        pipeline,
        overrides: overrides.to_vec(),
        artifacts,
        jobs: None,
        notes: Notes::new(true),
    })
}

#[expect(clippy::needless_pass_by_value, reason = "errors are mapped by it")]
fn told(error: anyhow::Error) -> String {
    crate::notes::sentence(&error)
}
