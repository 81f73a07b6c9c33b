//! The page of a training: reads the tables of a `poses` artifact and of its encoder, and the images of its demonstrations.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use anyhow::{Context as _, Result, ensure};
use nalgebra::{Isometry3, Point3};
use re4_artifact::episodes::{DemoRow, FrameRow, ImageRow, ModelRow, SpatialColumns};
use re4_artifact::{Artifact, Row as _, Stage, columns};
use re4_pose::spatial::GraspPhase;
use re4_pose::{LabelRow, PoseErrorRow, PoseRow, SpatialEstimate, TrainingRow};
use re4_robosuite::cameras::FixedCamera;
use re4_stats::{quantile, sorted};
use re4_task::Task;
use serde::Deserialize;

use super::{find_input, stated};
use crate::html::rollouts::space::FrameInImage;
use crate::html::training::{Confidence, Group, HELD_OUT, PhaseErrors, SIDE, Training, WorstFrame, page};
use crate::svg::training_plot;

/// Number of images per phase.
const IMAGES: usize = 12;

/// Phases of which images are shown, with their heading. After the release, nothing is trained.
const SHOWN: [(GraspPhase, &str); 2] = [
    (GraspPhase::BeforeGrasp, "Before the grasp"),
    (GraspPhase::Held, "While the object is held"),
];

/// Length of the axes that are shown for a pose, in metres.
const AXIS: f64 = 0.05;

/// Makes the page of a `poses` artifact of a robosuite task. The `encoder` and `episodes` artifacts are looked for beside it and in
/// `store`.
/// Returns the page and warnings for the user.
///
/// # Errors
/// If the artifact was not made by training an encoder, or a table cannot be read.
pub fn training_page(poses: &Artifact, store: &Path) -> Result<(String, Vec<String>)> {
    let encoder = encoder_of(poses, store)?;
    let manifest = poses.manifest();
    let config = &manifest.config["pose"]["encoder"];
    let camera: String = stated(poses, "config.pose.encoder", config, "camera")?;
    let epochs: Vec<TrainingRow> = encoder.read()?;
    let errors: Vec<PoseErrorRow> = poses.read()?;
    let episodes = find_input(poses, Stage::Ingest, store)?;
    let mut warnings = Vec::new();
    if episodes.is_none() {
        warnings.push(format!(
            "the page shows no images: the episodes artifact of {} is neither beside it nor in {}",
            poses.path().display(),
            store.display()
        ));
    }
    let chosen = worst_frames(&errors);
    let demos = episodes
        .as_ref()
        .map(Artifact::read::<DemoRow>)
        .transpose()?
        .unwrap_or_default();
    let wanted: BTreeSet<(u32, u32)> = chosen
        .iter()
        .flat_map(|(_, rows)| rows.iter().map(|row| (row.episode, row.frame)))
        .collect();
    let estimates = Estimates::read(poses, &encoder, &errors, &wanted)?;
    let found = episodes
        .as_ref()
        .map(|episodes| Found::read(episodes, &camera, &wanted, &demos))
        .transpose()?;
    let without_frames = match &found {
        Some(found) if found.cameras.is_empty() => Some(format!(
            "no model in the dataset has a fixed camera {camera} that can be evaluated"
        )),
        _ => None,
    };
    let worst = chosen.into_iter().map(|(title, rows)| Group {
        title: title.to_owned(),
        frames: rows
            .into_iter()
            .map(|row| worst_frame(row, &estimates, found.as_ref(), &demos))
            .collect(),
    });
    let task: Option<Task> = episodes
        .as_ref()
        .and_then(|episodes| serde_json::from_value(episodes.manifest().config["task"].clone()).ok());
    let demonstrations = |trained_on: bool| {
        let own = errors.iter().filter(|row| row.trained_on == trained_on);
        own.map(|row| row.episode).collect::<BTreeSet<_>>().len()
    };
    let of_encoder = Some(&encoder).filter(|encoder| encoder.key() != poses.key());
    let training = Training {
        tool_version: env!("CARGO_PKG_VERSION").to_owned(),
        task: task.map_or_else(|| "Pose encoder".to_owned(), |task| task.environment().to_owned()),
        artifacts: [Some(poses), of_encoder, episodes.as_ref()]
            .into_iter()
            .flatten()
            .map(|artifact| (artifact.manifest().artifact.clone(), artifact.key().to_string()))
            .collect(),
        demonstrations: [demonstrations(true), demonstrations(false)],
        steps: epochs.last().map_or(0, |epoch| epoch.steps),
        curves: curves(&epochs)?,
        confidence: calibration(&encoder)?.map(|calibration| calibration.shown(estimates.unsure)),
        errors: by_phase(&errors),
        worst: worst.collect(),
        without_frames,
        settings: config.clone(),
    };
    Ok((page(&training), warnings))
}

/// The `encoder` artifact whose estimates a `poses` artifact has. Older artifacts of poses have the encoder themselves.
fn encoder_of(poses: &Artifact, store: &Path) -> Result<Artifact> {
    if poses.has::<TrainingRow>() {
        return Ok(poses.clone());
    }
    let (path, stage) = (poses.path().display(), Stage::TrainEncoder);
    ensure!(
        poses.manifest().inputs.contains_key(stage.artifact()),
        "cannot report on {path}: no encoder was trained for it; name a poses artifact of a robosuite task"
    );
    find_input(poses, stage, store)?.with_context(|| {
        format!(
            "cannot report on {path}: its {} artifact is neither beside it nor in {}; run re4-pipe {stage}, or copy the artifact there",
            stage.artifact(),
            store.display()
        )
    })
}

/// The curves of the losses, as SVG.
fn curves(epochs: &[TrainingRow]) -> Result<String> {
    let curve = |value: fn(&TrainingRow) -> Option<f64>| epochs.iter().map(value).collect::<Vec<_>>();
    Ok(training_plot(&[
        ("L_abs", curve(|epoch| Some(epoch.absolute))),
        ("L_rel", curve(|epoch| Some(epoch.relative))),
        ("L_cross", curve(|epoch| Some(epoch.cross))),
        ("L_abs, held out", curve(|epoch| epoch.held_out_absolute)),
    ])?)
}

/// An image of the page, from its row in table `pose_errors`.
fn worst_frame(row: &PoseErrorRow, estimates: &Estimates, found: Option<&Found>, demos: &[DemoRow]) -> WorstFrame {
    let place = (row.episode, row.frame);
    let view = found.and_then(|found| found.cameras.get(&row.episode));
    let estimate = estimates.wanted.get(&place);
    let anchor = match row.phase {
        GraspPhase::Held => found.and_then(|found| found.eef.get(&place)),
        _ => estimates.anchors.get(&row.episode),
    };
    let demo = demos.iter().find(|demo| demo.episode == row.episode);
    WorstFrame {
        demo: demo.map_or_else(|| format!("episode {}", row.episode), |demo| demo.demo.clone()),
        frame: row.frame,
        translation: 1e3 * row.error.translation_at_grasp,
        rotation: row.error.rotation.to_degrees(),
        confidence: estimate.and_then(|estimate| estimate.confidence),
        png: found.and_then(|found| found.images.get(&place).cloned()),
        estimated: project(view, estimate.map(|estimate| &estimate.object)),
        anchored: project(view, anchor),
    }
}

/// What the page needs of a `poses` artifact besides the errors.
struct Estimates {
    /// The estimates of the images on the page.
    wanted: BTreeMap<(u32, u32), EstimateOf>,
    /// Numbers of unsure estimates and of all estimates, before the grasp of held-out demonstrations.
    unsure: [usize; 2],
    /// The anchors by demonstration; none in artifacts of older versions.
    anchors: BTreeMap<u32, Isometry3<f64>>,
}

impl Estimates {
    fn read(
        poses: &Artifact,
        encoder: &Artifact,
        errors: &[PoseErrorRow],
        wanted: &BTreeSet<(u32, u32)>,
    ) -> Result<Self> {
        let held_out: BTreeSet<(u32, u32)> = errors
            .iter()
            .filter(|row| !row.trained_on && row.phase == GraspPhase::BeforeGrasp)
            .map(|row| (row.episode, row.frame))
            .collect();
        let mut estimates = Self {
            wanted: BTreeMap::new(),
            unsure: [0, held_out.len()],
            anchors: BTreeMap::new(),
        };
        let table = poses.table(PoseRow::<SpatialEstimate>::table())?;
        for row in table.stream::<EstimateOf>()? {
            let row = row?;
            let place = (row.episode, row.frame);
            if held_out.contains(&place) {
                estimates.unsure[0] += usize::from(row.unsure == Some(true));
            }
            if wanted.contains(&place) {
                estimates.wanted.insert(place, row);
            }
        }
        if encoder.has::<LabelRow>() {
            let labels = encoder.read::<LabelRow>()?.into_iter();
            estimates.anchors = labels.map(|row| (row.episode, row.anchor)).collect();
        }
        Ok(estimates)
    }
}

columns! {
    /// The columns of table `poses` that the page needs.
    pub struct EstimateOf {
        /// Demonstration.
        pub episode: u32,
        /// Frame.
        pub frame: u32,
        /// Estimated pose, world frame.
        pub object: Isometry3<f64>,
        /// Confidence.
        pub confidence: Option<f64>,
        /// Whether it is unsure.
        pub unsure: Option<bool>,
    }
}

columns! {
    /// The columns of table `frames` that the page needs.
    pub struct EefOf {
        /// Demonstration.
        pub episode: u32,
        /// Frame.
        pub frame: u32,
        /// Pose of the end effector, world frame.
        pub eef: Isometry3<f64>,
    }
}

/// The file with the calibration.
#[derive(Deserialize)]
struct Calibration {
    scores: Vec<f64>,
    confidences: Vec<f64>,
    agrees_within: f64,
}

impl Calibration {
    fn shown(&self, unsure: [usize; 2]) -> Confidence {
        let steps = self.scores.iter().zip(&self.confidences);
        Confidence {
            steps: steps.map(|(score, own)| [1e3 * score, *own]).collect(),
            agrees_within: 1e3 * self.agrees_within,
            unsure,
        }
    }
}

/// Name of the file with the calibration.
const CONFIDENCE: &str = "confidence.json";

fn calibration(encoder: &Artifact) -> Result<Option<Calibration>> {
    if !encoder.manifest().files.contains_key(CONFIDENCE) {
        return Ok(None);
    }
    let path = encoder.path().join(CONFIDENCE);
    let cannot_read = || format!("cannot read {}", path.display());
    let text = std::fs::read_to_string(&path).with_context(cannot_read)?;
    serde_json::from_str(&text).map(Some).with_context(cannot_read)
}

/// What the page needs of the demonstrations.
struct Found {
    images: BTreeMap<(u32, u32), Vec<u8>>,
    eef: BTreeMap<(u32, u32), Isometry3<f64>>,
    /// The camera of each demonstration, if its model has one.
    cameras: BTreeMap<u32, FixedCamera>,
}

impl Found {
    fn read(episodes: &Artifact, camera: &str, wanted: &BTreeSet<(u32, u32)>, demos: &[DemoRow]) -> Result<Self> {
        let (mut images, mut eef) = (BTreeMap::new(), BTreeMap::new());
        for row in episodes.table(ImageRow::table())?.stream::<ImageRow>()? {
            let row = row?;
            let place = (row.episode, row.frame);
            if wanted.contains(&place) && row.camera.as_deref() == Some(camera) {
                images.insert(place, row.image);
            }
        }
        for row in episodes.table(FrameRow::<SpatialColumns>::table())?.stream::<EefOf>()? {
            let row = row?;
            if wanted.contains(&(row.episode, row.frame)) {
                eef.insert((row.episode, row.frame), row.eef);
            }
        }
        let models: Vec<ModelRow> = if episodes.has::<ModelRow>() {
            episodes.read()?
        } else {
            Vec::new()
        };
        let views: BTreeMap<u32, FixedCamera> = models
            .iter()
            .filter_map(|row| Some((row.model, FixedCamera::find(&row.mjcf, camera)?)))
            .collect();
        let of_demos = demos
            .iter()
            .filter_map(|demo| Some((demo.episode, *views.get(&demo.model?)?)));
        Ok(Self {
            images,
            eef,
            cameras: of_demos.collect(),
        })
    }
}

/// For each phase, one frame of each demonstration, the largest errors first: of held-out demonstrations, or of all if none is
/// held out. The frame is that at the 90 % quantile of the demonstration's errors: the very largest are those of the first frames,
/// in which the object still falls onto the table.
fn worst_frames(errors: &[PoseErrorRow]) -> Vec<(&'static str, Vec<&PoseErrorRow>)> {
    let any_held_out = errors.iter().any(|row| !row.trained_on);
    let by_error =
        |a: &&PoseErrorRow, b: &&PoseErrorRow| b.error.translation_at_grasp.total_cmp(&a.error.translation_at_grasp);
    let of_phase = |phase: GraspPhase| {
        let mut of_demos: BTreeMap<u32, Vec<&PoseErrorRow>> = BTreeMap::new();
        for row in errors
            .iter()
            .filter(|row| row.phase == phase && !(any_held_out && row.trained_on))
        {
            of_demos.entry(row.episode).or_default().push(row);
        }
        let mut rows: Vec<&PoseErrorRow> = of_demos
            .into_values()
            .filter_map(|mut own| {
                own.sort_by(by_error);
                own.get(own.len() / 10).copied()
            })
            .collect();
        rows.sort_by(by_error);
        rows.truncate(IMAGES);
        rows
    };
    SHOWN
        .into_iter()
        .map(|(phase, title)| (title, of_phase(phase)))
        .collect()
}

fn by_phase(errors: &[PoseErrorRow]) -> Vec<PhaseErrors> {
    let mut rows = Vec::new();
    for (set, trained_on) in [(HELD_OUT, false), ("trained on", true)] {
        for phase in GraspPhase::ALL {
            let own: Vec<&PoseErrorRow> = errors
                .iter()
                .filter(|row| row.trained_on == trained_on && row.phase == phase)
                .collect();
            if own.is_empty() {
                continue;
            }
            let quantiles = |value: fn(&PoseErrorRow) -> f64| {
                let values = sorted(own.iter().map(|row| value(row)));
                [0.5, 0.9].map(|probability| quantile(&values, probability).unwrap_or(f64::NAN))
            };
            rows.push(PhaseErrors {
                set,
                phase: phase.as_str(),
                frames: own.len(),
                quantiles: [
                    quantiles(|row| 1e3 * row.error.translation),
                    quantiles(|row| 1e3 * row.error.translation_at_grasp),
                    quantiles(|row| row.error.rotation.to_degrees()),
                ],
            });
        }
    }
    rows
}

fn project(view: Option<&FixedCamera>, pose: Option<&Isometry3<f64>>) -> FrameInImage {
    let ends = [[0.0; 3], [AXIS, 0.0, 0.0], [0.0, AXIS, 0.0], [0.0, 0.0, AXIS]];
    ends.map(|end| view?.pixel(&(pose? * Point3::from(end)), f64::from(SIDE)))
}
