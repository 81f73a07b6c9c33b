//! Which parts of which artifacts a pipeline needs, and which of them exist.

use std::path::PathBuf;
use std::time::Instant;

use anyhow::{Context as _, Result};
use re4_artifact::{Row as _, Stage};
use re4_ingest::EpisodeRow;
use re4_task::Domain;
use serde_json::{Value, json};

use crate::parts::{DEMOS_IN_PART, Partly, Share, parts_of};
use crate::pipeline::PoseSource;
use crate::runner::{Built, Runner};

/// A stage of a pipeline and its artifact.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct PlannedStage {
    /// The stage.
    pub stage: Stage,
    /// Number of parts of its artifact; `None` if that depends on a dataset that is not ingested.
    pub parts: Option<u32>,
    /// Folder of its artifact; `None` if its key depends on artifacts that do not exist.
    pub artifact: Option<PathBuf>,
    /// Numbers of the parts that do not exist; `None` if that is not known because an earlier artifact does not exist.
    pub missing: Option<Vec<u32>>,
    /// Whether the artifact is complete.
    pub done: bool,
}

impl PlannedStage {
    /// What `re4-pipe status` prints with `--json`.
    pub fn to_json(&self) -> Value {
        let state = match (&self.missing, self.done) {
            (_, true) => "done".to_owned(),
            (None, _) => "waiting for earlier stages".to_owned(),
            (Some(missing), _) if missing.is_empty() => "all parts made, not merged".to_owned(),
            (Some(missing), _) => format!("{} parts missing", missing.len()),
        };
        json!({
            "stage": self.stage.as_str(),
            "artifact": self.artifact,
            "parts": self.parts,
            "missing": self.missing,
            "state": state,
        })
    }
}

/// An artifact that is not complete.
struct Incomplete {
    folder: PathBuf,
    parts: u32,
    missing: Vec<u32>,
    /// Number of demonstrations, if they are to be ingested in one part.
    demos: Option<u64>,
}

/// What is known of the demonstrations before the stages after ingest are looked at.
#[derive(Default)]
struct Ingested {
    /// Number of parts of `episodes`.
    parts: Option<u32>,
    /// Number of demonstrations, if `episodes` has one part. Some may still be left out.
    demos: Option<u64>,
}

impl Runner {
    /// The stages that a pipeline runs, in order: up to the rollouts, or to the audit if it has no table `[rollout]`.
    ///
    /// # Errors
    /// If the pipeline has no policy although it has rollouts.
    pub fn stages(&self) -> Result<Vec<Stage>> {
        let mut stages = vec![Stage::Ingest, Stage::Segment];
        let pipeline = &self.pipeline;
        let audit = [Stage::Observe, Stage::Audit];
        let audit = if pipeline.task.domain() == Domain::Space {
            &audit[..]
        } else {
            &audit[1..]
        };
        if pipeline.rollout.is_none() {
            stages.extend(audit);
            return Ok(stages);
        }
        let source = pipeline.pose()?.source;
        if source == PoseSource::Encoder {
            stages.push(Stage::TrainEncoder);
        }
        if source != PoseSource::Recorded {
            stages.push(Stage::TrainPose);
        } else if pipeline.task.domain() == Domain::Space && !pipeline.index()?.leave_out.is_empty() {
            stages.extend(audit);
        }
        stages.extend(pipeline.policy()?.inputs());
        if pipeline.scenes.is_some() {
            stages.push(Stage::Scenes);
        }
        stages.push(Stage::Rollout);
        Ok(stages)
    }

    /// Makes the artifact of a stage of the pipeline, with all that it needs, or this process's shard of it.
    ///
    /// # Errors
    /// As the method of the stage; [`Partly`] if the artifact is not complete afterwards.
    pub fn artifact_of(&self, stage: Stage) -> Result<Built> {
        let planar = self.pipeline.task.is_planar();
        match stage {
            Stage::Ingest => self.ingest(),
            Stage::Segment => self.segment(&self.ingest()?),
            Stage::Observe => {
                let episodes = self.ingest()?;
                let modes = self.segment(&episodes)?;
                self.observe(&episodes, &modes)
            }
            Stage::Audit => {
                let episodes = self.ingest()?;
                let modes = self.segment(&episodes)?;
                self.audit(&episodes, &modes)
            }
            Stage::TrainEncoder => {
                let episodes = self.ingest()?;
                let modes = self.segment(&episodes)?;
                self.train_encoder(&episodes, &modes)?.context("no encoder")
            }
            Stage::TrainPose if planar => self.train_pose(&self.ingest()?)?.context("no pose estimator"),
            Stage::TrainPose => {
                let episodes = self.ingest()?;
                let modes = self.segment(&episodes)?;
                self.train_spatial(&episodes, &modes)?.context("no pose estimator")
            }
            Stage::Index => {
                let episodes = self.ingest()?;
                let modes = self.segment(&episodes)?;
                if planar {
                    let poses = self.train_pose(&episodes)?;
                    self.index(&episodes, &modes, poses.as_ref())
                } else {
                    let poses = self.train_spatial(&episodes, &modes)?;
                    self.index_spatial(&episodes, &modes, poses.as_ref())
                }
            }
            Stage::Train => self.train(),
            Stage::Scenes => self.scenes(&self.ingest()?)?.context("no table [scenes]"),
            Stage::Rollout => Ok(self.roll_out()?.0),
            Stage::Replay | Stage::Compare | Stage::Influence | Stage::Curate => {
                anyhow::bail!("the stage {stage} is not made in parts")
            }
        }
    }

    /// What exists of the artifacts of the pipeline's stages. Nothing is made. The dataset is opened and hashed.
    ///
    /// # Errors
    /// If the pipeline or the dataset cannot be used.
    pub fn planned(&self) -> Result<Vec<PlannedStage>> {
        let mut planned = Vec::new();
        // Stages from the first one whose artifact is not complete are not looked at, because their keys are not known.
        let mut open = true;
        let mut ingested = Ingested::default();
        for stage in self.stages()? {
            // One process audits the demonstrations of one part, without this stage.
            if stage == Stage::Observe && ingested.parts == Some(1) {
                continue;
            }
            let looked = if open { Some(self.looking(stage)?) } else { None };
            if stage == Stage::Ingest {
                ingested.demos = match &looked {
                    Some(Ok(built)) => Some(built.artifact.table(EpisodeRow::table())?.rows()),
                    Some(Err(incomplete)) => incomplete.demos,
                    None => None,
                };
            }
            let of = match looked {
                Some(Ok(built)) => PlannedStage {
                    stage,
                    parts: Some(built.artifact.parts()),
                    artifact: Some(built.artifact.path().to_path_buf()),
                    missing: Some(Vec::new()),
                    done: true,
                },
                Some(Err(incomplete)) => {
                    open = false;
                    PlannedStage {
                        stage,
                        parts: Some(incomplete.parts),
                        artifact: Some(incomplete.folder),
                        missing: Some(incomplete.missing),
                        done: false,
                    }
                }
                None => PlannedStage {
                    stage,
                    parts: self.parts_expected(stage, &ingested)?,
                    artifact: None,
                    missing: None,
                    done: false,
                },
            };
            if stage == Stage::Ingest {
                ingested.parts = of.parts;
            }
            planned.push(of);
        }
        Ok(planned)
    }

    /// The artifact of a stage whose inputs exist, or what exists of it if it is not complete.
    fn looking(&self, stage: Stage) -> Result<Result<Built, Incomplete>> {
        let start = Instant::now();
        let found = self.sharing(Share::Look(stage)).artifact_of(stage);
        tracing::debug!(stage = stage.as_str(), wall = ?start.elapsed(), "looked for the artifact");
        match found {
            Ok(built) => Ok(Ok(built)),
            Err(error) => match error.downcast::<Partly>() {
                Ok(Partly::Missing {
                    artifact,
                    parts,
                    missing,
                    demos,
                    ..
                }) => Ok(Err(Incomplete {
                    folder: artifact,
                    parts,
                    missing,
                    demos,
                })),
                Ok(other) => Err(other.into()),
                Err(error) => Err(error),
            },
        }
    }

    /// Number of parts of an artifact whose inputs do not exist yet.
    fn parts_expected(&self, stage: Stage, ingested: &Ingested) -> Result<Option<u32>> {
        Ok(match stage {
            Stage::Segment | Stage::Observe => ingested.parts,
            Stage::Audit | Stage::TrainPose | Stage::Index if !self.pipeline.task.is_planar() => ingested.parts,
            // The index of Push-T is cut although the demonstrations are not.
            Stage::Index => ingested.demos.map(|demos| parts_of(demos as usize, DEMOS_IN_PART)),
            Stage::Rollout => self.parts_of_rollouts()?,
            _ => Some(1),
        })
    }
}
