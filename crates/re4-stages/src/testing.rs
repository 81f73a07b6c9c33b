//! Runs stages with a mock encoder instead of a trained one, for tests of image variants.

use std::cell::Cell;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;

use anyhow::{Context as _, Result, bail};
use nalgebra::Isometry3;
use re4_artifact::{Artifact, Stage};
use re4_fault::Remedy as _;
use re4_rollout::{
    ArmAction, ArmState, Displacement, Env, Estimator, Image, ObservedPose, PolicyError, Space, SpaceFirst,
    drop_renderer,
};
use re4_sim::SimError;
use re4_sim::robosuite::{Placement, RobosuiteStep};

use crate::inputs::simulators::Scenes;
use crate::notes::Notes;
use crate::pipeline::Policy;
use crate::runner::{Built, Runner, Settings};
use crate::stages::{ImageObserver, MakeEstimator, RolloutArtifacts, scene_renderer};

/// The function of a mock encoder: image bytes and the true object pose in the image (which a real encoder never gets) to an
/// estimated pose, both in the world frame.
pub type Estimate = Arc<dyn Fn(&[u8], &Isometry3<f64>) -> Isometry3<f64> + Send + Sync>;

thread_local! {
    /// Object pose in the last image that was rendered in this thread.
    static RENDERED: Cell<Isometry3<f64>> = Cell::new(Isometry3::identity());
}

/// A pipeline whose stages up to `segment` have been run, and a `poses` artifact.
pub struct MockRun<'a> {
    /// The pipeline file.
    pub pipeline: &'a Path,
    /// Overrides, as for `--set`.
    pub overrides: &'a [String],
    /// The artifacts folder.
    pub artifacts: &'a Path,
    /// Folder of the `poses` artifact.
    pub poses: &'a Path,
}

/// A simulation that stores the object pose of each rendered image in [`RENDERED`], where the mock encoder reads it.
struct RecordingEnv<'a>(Box<dyn Env<Space> + 'a>);

impl Env<Space> for RecordingEnv<'_> {
    fn reset(&mut self, scene: &Placement) -> Result<SpaceFirst, SimError> {
        self.0.reset(scene)
    }

    fn step(&mut self, action: &ArmAction) -> Result<RobosuiteStep, SimError> {
        self.0.step(action)
    }

    fn proprio(&self) -> ArmState {
        self.0.proprio()
    }

    fn object(&self) -> Isometry3<f64> {
        self.0.object()
    }

    fn view(&self) -> Vec<f64> {
        self.0.view()
    }

    fn render(
        &mut self,
        view: &Vec<f64>,
        observed_from_world: Option<&Isometry3<f64>>,
        camera: &str,
        into: &mut Image,
    ) -> Result<(), PolicyError> {
        RENDERED.set(self.0.object());
        self.0.render(view, observed_from_world, camera, into)
    }

    fn displace(&mut self, displacement: &Displacement) -> Result<bool, SimError> {
        self.0.displace(displacement)
    }
}

struct MockEncoder(Estimate);

impl Estimator<Space> for MockEncoder {
    fn estimate(&mut self, image: &Image) -> Result<ObservedPose<Space>, PolicyError> {
        Ok(ObservedPose {
            pose: (self.0)(&image.pixels, &RENDERED.get()),
            confidence: None,
            flag: None,
        })
    }
}

impl MockRun<'_> {
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

    /// Builds the index of these poses. Returns the folder of the `index` artifact.
    ///
    /// # Errors
    /// The message that the program would print.
    pub fn index(&self) -> Result<PathBuf, String> {
        let build = || {
            let runner = self.runner()?;
            let episodes = runner.ingest()?;
            let modes = runner.segment(&episodes)?;
            runner.index_spatial(&episodes, &modes, Some(&self.poses()?))
        };
        build()
            .map(|built| built.artifact.path().to_owned())
            .map_err(sentence_of)
    }

    /// Rolls out with `estimate` as the encoder. Returns the folder of the `rollouts` artifact.
    ///
    /// # Errors
    /// The message that the program would print.
    pub fn roll_out(&self, estimate: &Estimate) -> Result<PathBuf, String> {
        let open = || -> Result<Box<MakeEstimator>> {
            let estimate = Arc::clone(estimate);
            Ok(Box::new(move || Box::new(MockEncoder(Arc::clone(&estimate)))))
        };
        let build = || {
            let runner = self.runner()?;
            let episodes = runner.ingest()?;
            let modes = runner.segment(&episodes)?;
            let poses = self.poses()?;
            let index = runner.index_spatial(&episodes, &modes, Some(&poses))?;
            let policy = runner.pipeline.policy()?;
            let Policy::Space(policy) = policy else {
                bail!("{} is a planar policy", policy.kind());
            };
            let observer = ImageObserver {
                open: &open,
                wrap: |env| Box::new(RecordingEnv(env)),
            };
            let artifacts = RolloutArtifacts {
                episodes: &episodes,
                encoder: None,
                poses: Some(&poses),
                scenes: None,
                inputs: &[index],
            };
            runner.rollout_with_observer(policy, &artifacts, Some(&observer))
        };
        build()
            .map(|built| built.artifact.path().to_owned())
            .map_err(sentence_of)
    }
}

/// The images that a policy would observe in these states (time, coordinates, velocities). `boxes` gives the half sizes of boxes
/// by name (the cube of Lift).
///
/// # Errors
/// The message that the program would print.
pub fn images(
    pipeline: &Path,
    artifacts: &Path,
    boxes: &[(String, [f64; 3])],
    states: &[Vec<f64>],
) -> Result<Vec<Vec<u8>>, String> {
    let render = || -> Result<Vec<Vec<u8>>> {
        let runner = runner(pipeline, &[], artifacts)?;
        let task = runner.pipeline.task.robosuite().context("no simulator for this task")?;
        let fidelity = runner.pipeline.rollout()?.fidelity;
        let episodes = runner.ingest()?.artifact;
        let scenes = Scenes::open(&episodes, task, fidelity)?;
        let camera = runner.pipeline.pose()?.encoder().camera.clone();
        let mut scene_camera = scene_renderer(&scenes, &episodes, &camera)?.scene_camera_of(boxes)?;
        let mut image = Image::default();
        let mut render_state = |state: &Vec<f64>| {
            scene_camera.render(&camera, state, &mut image)?;
            Ok(image.pixels.clone())
        };
        states.iter().map(&mut render_state).collect()
    };
    let images = render().map_err(sentence_of);
    drop_renderer();
    images
}

fn runner(pipeline: &Path, overrides: &[String], artifacts: &Path) -> Result<Runner> {
    Runner::new(&Settings {
        share: crate::Share::Whole,
        hashes: &[],
        pipeline,
        overrides: overrides.to_vec(),
        artifacts,
        jobs: None,
        notes: Notes::new(true),
    })
}

#[expect(clippy::needless_pass_by_value, reason = "used as the function of map_err")]
fn sentence_of(error: anyhow::Error) -> String {
    crate::notes::fault_of(&error).sentence()
}
