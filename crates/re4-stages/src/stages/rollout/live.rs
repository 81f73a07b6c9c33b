//! Policies of `rollouts` artifacts, for programs that make the observations themselves.

use std::path::Path;
use std::sync::Arc;

use anyhow::{Context as _, Result};
use re4_artifact::{Artifact, Stage, Store};
use re4_encoder::{EncoderConfig, Predictor};
use re4_fault::{OrFault as _, bail, fault};
use re4_geometry::spatial::Symmetry;
use re4_policy::kinds::{Inputs, Kinds, PlanePolicy, SpacePolicy};
use re4_rollout::{Acting, Estimator, Opened, Plane, Recorded, Space};
use re4_sim::robosuite::{Profile, RobosuiteTask};
use re4_task::Task;
use serde::de::DeserializeOwned;
use serde_json::Value;

use super::estimators::{Encoder, LogPolar};
use crate::inputs::demos::demo_names;
use crate::inputs::estimators::{WEIGHTS, open_estimator, read_calibration};
use crate::inputs::simulators::profile;
use crate::pipeline::PoseSection;

/// What a user can do about a manifest that this version of the program does not understand.
const AGAIN: &str = "delete the artifact and roll out again";

type MakeEstimator<D> = Box<dyn Fn() -> Box<dyn Estimator<D> + Send> + Send + Sync>;

/// A policy with which rollouts were made, opened with its demonstrations.
pub struct LivePolicy<D: Recorded> {
    /// Name of the policy's kind, as in pipeline files.
    pub kind: String,
    opened: Box<dyn Opened<D>>,
    estimator: Option<MakeEstimator<D>>,
}

impl<D: Recorded> LivePolicy<D> {
    /// Starts the policy for an episode. `seed` seeds its random numbers, `first` is the first proprioception.
    pub fn start(&self, seed: u32, first: &D::Proprio) -> Box<dyn Acting<D>> {
        self.opened.start(seed, first)
    }

    /// Makes the estimator of object poses for an episode; `None` if the policy observes known poses.
    pub fn estimator(&self) -> Option<Box<dyn Estimator<D> + Send>> {
        self.estimator.as_ref().map(|make| make())
    }

    /// Whether the policy observes the object through images.
    pub fn observes_images(&self) -> bool {
        self.estimator.is_some()
    }
}

/// A policy by its domain.
pub enum AnyLivePolicy {
    /// A policy for Push-T.
    Plane(LivePolicy<Plane>),
    /// A policy for a robosuite task, and the task with its version of robosuite.
    Space(LivePolicy<Space>, RobosuiteTask, Profile),
}

/// Opens the policy of a `rollouts` artifact, with the artifacts that it was made from, which are beside it.
///
/// # Errors
/// If the folder is not a `rollouts` artifact, or one of the artifacts that it was made from is missing or damaged.
pub fn open_policy(rollouts: &Path) -> Result<AnyLivePolicy> {
    let artifact = Artifact::open(rollouts)?;
    let found = &artifact.manifest().artifact;
    if found != Stage::Rollout.artifact() {
        bail!(
            "cannot open a policy from {}: it is an artifact of kind {found}", rollouts.display();
            "give the folder of a rollouts artifact"
        );
    }
    let root = std::path::absolute(rollouts).ok();
    let root = root.as_deref().and_then(|path| path.parent()?.parent());
    let inputs = MadeFrom {
        store: Store::open(root.context("the artifact has no parent folder")?)?,
        rollouts: &artifact,
    };
    let planar = artifact.manifest().config["task"] == "pusht";
    if planar { inputs.plane() } else { inputs.space() }
}

/// A `rollouts` artifact and the store of what it was made from.
struct MadeFrom<'a> {
    store: Store,
    rollouts: &'a Artifact,
}

impl MadeFrom<'_> {
    /// The artifact of a stage from which the rollouts were made; `None` if they were made without it.
    fn made_from(&self, stage: Stage) -> Result<Option<Artifact>> {
        let name = stage.artifact();
        let Some(key) = self.rollouts.manifest().inputs.get(name) else {
            return Ok(None);
        };
        let found = self.store.lookup(stage, key)?;
        let missing = || {
            fault!(
                "cannot open the policy of {}: the artifact {} from which it was made is missing",
                self.rollouts.path().display(), self.store.folder(stage, key).display();
                "run the pipeline again, or copy the artifact beside the rollouts"
            )
        };
        found.or_fault(missing).map(Some)
    }

    /// The artifact of a stage without which no rollouts can be made.
    fn required(&self, stage: Stage) -> Result<Artifact> {
        let missing = || {
            fault!(
                "the manifest of {} names no {} artifact", self.rollouts.path().display(), stage.artifact();
                "{AGAIN}"
            )
        };
        self.made_from(stage)?.or_fault(missing)
    }

    /// An entry of the configuration of the rollouts.
    fn setting<T: DeserializeOwned>(&self, name: &str) -> Result<T> {
        serde_json::from_value(self.rollouts.manifest().config[name].clone()).or_fault(|| {
            fault!(
                "the manifest of {} has no setting {name} that this version understands", self.rollouts.path().display();
                "{AGAIN}"
            )
        })
    }

    /// The settings of the policy.
    fn policy<K: Kinds>(&self) -> Result<K> {
        let mut settings = self.rollouts.manifest().config["policy"].clone();
        let kind = settings.as_object_mut().and_then(|settings| settings.remove("kind"));
        let kind = kind.as_ref().and_then(Value::as_str).unwrap_or_default();
        K::read(kind, settings).or_fault(|| {
            fault!(
                "the manifest of {} has no policy that this version understands", self.rollouts.path().display();
                "{AGAIN}"
            )
        })
    }

    fn open<K: Kinds>(
        &self,
        policy: &K,
        task: Option<RobosuiteTask>,
        symmetry: Symmetry,
    ) -> Result<Box<dyn Opened<K::Domain>>> {
        let episodes = self.required(Stage::Ingest)?;
        let stages = policy.settings().inputs();
        let artifacts: Vec<Artifact> = stages
            .iter()
            .map(|stage| self.required(*stage))
            .collect::<Result<_>>()?;
        let inputs: Vec<(Stage, &Artifact)> = stages.iter().copied().zip(&artifacts).collect();
        Ok(policy.settings().open(&Inputs {
            artifacts: &inputs,
            episodes: &episodes,
            task,
            names: demo_names(&episodes)?,
            symmetry,
        })?)
    }

    fn plane(&self) -> Result<AnyLivePolicy> {
        let policy: PlanePolicy = self.policy()?;
        let estimator = match self.made_from(Stage::TrainPose)? {
            Some(poses) => {
                let estimator = Arc::new(open_estimator(&poses, &pose_section(&poses)?)?);
                let make = move || Box::new(LogPolar::new(&estimator)) as Box<dyn Estimator<Plane> + Send>;
                Some(Box::new(make) as MakeEstimator<Plane>)
            }
            None => None,
        };
        Ok(AnyLivePolicy::Plane(LivePolicy {
            kind: policy.kind().to_owned(),
            opened: self.open(&policy, None, Symmetry::None)?,
            estimator,
        }))
    }

    fn space(&self) -> Result<AnyLivePolicy> {
        let policy: SpacePolicy = self.policy()?;
        let task: Task = self.setting("task")?;
        let task = task
            .robosuite()
            .or_fault(|| fault!("no simulator for this task"; "{AGAIN}"))?;
        let encoder = match self.made_from(Stage::TrainEncoder)? {
            Some(encoder) => Some(encoder),
            // In older artifacts, the weights are with the poses.
            None => self.made_from(Stage::TrainPose)?,
        };
        let estimator = match encoder {
            Some(encoder) => {
                let config: EncoderConfig = pose_section(&encoder)?.encoder().into_owned();
                let predictor = Predictor::open(&encoder.path().join(WEIGHTS), &config)?;
                let calibration = read_calibration(encoder.path())?;
                let make = move || {
                    Box::new(Encoder::new(&predictor, calibration.as_ref())) as Box<dyn Estimator<Space> + Send>
                };
                Some(Box::new(make) as MakeEstimator<Space>)
            }
            None => None,
        };
        let live = LivePolicy {
            kind: policy.kind().to_owned(),
            opened: self.open(&policy, Some(task), self.setting("symmetry")?)?,
            estimator,
        };
        Ok(AnyLivePolicy::Space(
            live,
            task,
            profile(&self.required(Stage::Ingest)?)?,
        ))
    }
}

/// The settings with which a `poses` or `encoder` artifact was made.
fn pose_section(poses: &Artifact) -> Result<PoseSection> {
    serde_json::from_value(poses.manifest().config["pose"].clone()).or_fault(|| {
        fault!(
            "the manifest of {} has no setting pose that this version understands", poses.path().display();
            "delete the artifact and run the pipeline again"
        )
    })
}
