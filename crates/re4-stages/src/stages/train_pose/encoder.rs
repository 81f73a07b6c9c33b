//! The stage `train-encoder`: trains an encoder on `episodes` and `modes`, and makes `encoder`.
//!
//! Only the columns of `EefOf` (module `demos`), modes and images are read, so no recorded object pose affects the training.

use anyhow::{Context as _, Result};
use re4_artifact::{Artifact, ArtifactSummary, Key, Recipe, Stage, Writer};
use re4_encoder::batches::{Sample, Sampler};
use re4_encoder::images::ImageFile;
use re4_encoder::loss::Alternatives;
use re4_encoder::train::{BACKEND, Task, Trained, parts, steps_of, train};
use re4_encoder::{Calibration, EncoderConfig, EncoderError, IMAGE_BYTES, Predictor, is_blank};
use re4_fault::ensure;
use re4_geometry::spatial::Symmetry;
use re4_ingest::SourceFile;
use re4_policy::DemoNames;
use re4_pose::TrainingRow;
use re4_train::{Backend, Checkpoints, Epoch, Progress};
use serde_json::{Value, json};

use super::card;
use super::demos::{Demo, Frames, TrainingData, read_demos};
use super::estimate::BATCH;
use crate::inputs::demos::demo_names;
use crate::inputs::estimators::{CONFIDENCE, WEIGHTS};
use crate::inputs::sources::find_weights;
use crate::parts::Share;
use crate::runner::{Built, Runner};

/// Increase it whenever the same input gives different bytes.
const CODE_VERSION: u32 = 1;

impl Runner {
    /// Trains the encoder and makes the `encoder` artifact, or returns the existing one.
    pub(super) fn make_encoder(&self, episodes: &Built, modes: &Built) -> Result<Built> {
        let config = self.pipeline.pose()?.encoder.clone().unwrap_or_default();
        let (episodes, modes) = (&episodes.artifact, &modes.artifact);
        let weights = config.weights.as_deref().map(find_weights).transpose()?;
        let mut recipe = Recipe::new(Stage::TrainEncoder, CODE_VERSION)
            .config(&json!({ "pose": { "source": "encoder", "encoder": config } }))?
            .input("episodes", episodes.key())
            .input("modes", modes.key());
        let mut weights_file = None;
        if let Some(path) = &weights {
            let cannot_read = || format!("cannot read the weights {}", path.display());
            let opened = SourceFile::open(path)
                .map_err(|error| error.fault)
                .with_context(cannot_read)?;
            let file = weights_file.insert(opened);
            let hash = self
                .hash(|stop| file.hash(stop), "train-encoder")
                .with_context(cannot_read)?;
            recipe = recipe.source(hash.as_bytes(), json!({ "weights": config.weights }));
        }
        let key = recipe.key();
        self.build_trained(&recipe, "training_images_per_s", |writer, checkpoints| {
            self.fit_encoder(
                &config,
                weights_file.as_ref(),
                (episodes, modes),
                &key,
                checkpoints,
                writer,
            )
        })
    }

    fn fit_encoder(
        &self,
        config: &EncoderConfig,
        weights: Option<&SourceFile>,
        (episodes, modes): (&Artifact, &Artifact),
        key: &Key,
        checkpoints: &Checkpoints,
        writer: &Writer,
    ) -> Result<(ArtifactSummary, Option<f64>)> {
        if self.share != Share::Whole {
            // A process that makes parts has verified only those that it read.
            episodes.verify_bytes()?;
            modes.verify_bytes()?;
        }
        let demos = read_demos(config, episodes, modes)?;
        let names = demo_names(episodes)?;
        let mut data = TrainingData::of(&demos, config, &names);
        ensure!(
            !data.training.is_empty(),
            "cannot train on {}: no training demonstration has a transfer frame after a transit frame",
            episodes.path().display();
            "inspect its modes with re4-pipe audit"
        );
        // Checked before the images are unpacked, so that a missing backend is reported at once. Flex, the pure Rust backend,
        // runs in the program's own thread pool and needs no setting.
        config.backend.device(BACKEND)?;
        if config.backend != Backend::Flex {
            config.backend.set_threads(rayon::current_num_threads(), BACKEND)?;
        }
        let (images, blank) = self.unpack(config, episodes, &demos, &names, writer)?;
        data.leave_out(&blank, &demos, &names);
        ensure!(
            !data.training.is_empty(),
            "cannot train on {}: all training images before a grasp, or all that hold the object, have a single color",
            episodes.path().display();
            "record or render the images again"
        );
        let (training, held_out) = data.split();
        let symmetry = match (config.symmetry, self.pipeline.task.symmetry()) {
            (false, _) | (true, Symmetry::None) => Alternatives::NONE,
            (true, Symmetry::Fold { n, .. }) => Alternatives::Fold(n),
            (true, Symmetry::Full { .. }) => Alternatives::Axis,
        };
        let sampler = Sampler::new(training, config, symmetry);
        let task = Task {
            config,
            sampler: &sampler,
            images: &images,
            held_out: &held_out,
            weights: weights.map(SourceFile::path),
            symmetry,
        };
        let steps = u64::from(steps_of(config, &sampler));
        let bar = self.notes.progress(u64::from(config.epochs) * steps, "train-encoder");
        let mut begun = false;
        let trained = train(&task, checkpoints, |progress: &Progress| -> Result<()> {
            // By the first call the weights have been read, and they are not read again.
            if let Some(file) = weights.filter(|_| !std::mem::replace(&mut begun, true)) {
                file.unchanged().map_err(|error| error.fault).context("cannot train")?;
            }
            bar.set_position(progress.steps);
            let [sum, absolute, relative, cross] = parts(&progress.losses);
            bar.set_message(format!(
                "train-encoder, epoch {} of {}: {:.0} images/s, loss {sum:.4} (absolute {absolute:.4}, relative {relative:.4}, cross {cross:.4})",
                progress.epoch,
                config.epochs,
                progress.rate * config.batch as f64
            ));
            self.interrupt.check("train-encoder")
        })?;
        bar.finish_and_clear();
        writer.file(WEIGHTS, &re4_encoder::to_bytes(&trained.encoder)?)?;
        write_training(&trained.epochs, writer)?;
        writer.write_rows(std::mem::take(&mut data.labels))?;
        card::write_plot(&trained.epochs, writer)?;
        let predictor = Predictor::new(trained.encoder.clone(), config)?;
        let calibration = calibrate(&predictor, &held_out, &images)?;
        if let Some(calibration) = &calibration {
            writer.file(CONFIDENCE, &serde_json::to_vec_pretty(calibration)?)?;
        }
        let summary = summary(config, &trained, &demos, &sampler, weights.is_some());
        card::write(
            config,
            &summary,
            &trained.epochs,
            (episodes.key(), modes.key(), key),
            writer,
        )?;
        let warnings = data.warnings;
        Ok((ArtifactSummary { summary, warnings }, trained.rate))
    }

    /// Decodes the images of the encoder's camera, in the order of the frames, into a scratch file: training reads images in
    /// random order, which row groups of PNG files would make slow. Also returns the frames by demonstration whose images have a
    /// single color.
    fn unpack(
        &self,
        config: &EncoderConfig,
        episodes: &Artifact,
        demos: &[Demo],
        names: &DemoNames,
        writer: &Writer,
    ) -> Result<(ImageFile, Frames)> {
        let frames: usize = demos.iter().map(|demo| demo.eef.len()).sum();
        let bar = self.notes.progress(frames as u64, "images");
        let mut blank = Frames::new();
        let name = |demo| names.of(demo);
        let decoded = self.images_of(episodes, &config.camera, &name)?.map(|image| {
            let image = image?;
            bar.inc(1);
            if is_blank(&image.pixels) {
                blank.entry(image.episode).or_default().insert(image.frame);
            }
            anyhow::Ok(image.pixels)
        });
        let images = ImageFile::write(writer.scratch(), decoded)?;
        bar.finish_and_clear();
        ensure!(
            images.count() == frames as u64,
            "cannot train on {}: it has {} images of camera {:?} for {frames} frames",
            episodes.path().display(),
            images.count(),
            config.camera;
            "delete the artifact and ingest again"
        );
        Ok((images, blank))
    }
}

/// Calibrates the confidence on the frames before the grasp of held-out demonstrations. `None` if there are none, or the encoder
/// uses one crop.
fn calibrate(predictor: &Predictor, held_out: &[Sample], images: &ImageFile) -> Result<Option<Calibration>> {
    let mut frames = Vec::with_capacity(held_out.len());
    for chunk in held_out.chunks(BATCH) {
        let read = |sample: &Sample| {
            let mut image = vec![0; IMAGE_BYTES];
            images.read(sample.image, &mut image).map(|()| image)
        };
        let images = chunk.iter().map(read).collect::<Result<Vec<_>, EncoderError>>()?;
        let images: Vec<&[u8]> = images.iter().map(Vec::as_slice).collect();
        for (prediction, sample) in predictor.predict(&images)?.iter().zip(chunk) {
            let distance = (prediction.pose.translation.vector - sample.target.translation.vector).norm();
            frames.extend(prediction.disagreement.map(|score| [score, distance]));
        }
    }
    Ok(Calibration::fit(&frames))
}

fn write_training(epochs: &[Epoch], writer: &Writer) -> Result<()> {
    writer.write_rows(epochs.iter().map(|epoch| {
        let [loss, absolute, relative, cross] = parts(&epoch.losses);
        TrainingRow {
            epoch: epoch.epoch,
            steps: epoch.steps,
            learning_rate: epoch.learning_rate,
            loss,
            absolute,
            relative,
            cross,
            held_out_absolute: epoch.held_out,
        }
    }))?;
    Ok(())
}

fn summary(config: &EncoderConfig, trained: &Trained, demos: &[Demo], sampler: &Sampler, pretrained: bool) -> Value {
    let frames: usize = demos.iter().map(|demo| demo.eef.len()).sum();
    let last = trained.epochs.last();
    json!({
        "episodes": demos.len(),
        "frames": frames,
        "trained_on": demos.iter().filter(|demo| demo.trained_on).count(),
        "started_from": if pretrained { "weights of pose.encoder.weights" } else { "random weights" },
        "backend": config.backend,
        "epochs": trained.epochs.len(),
        "steps": last.map(|epoch| epoch.steps),
        "images_to_draw_from": sampler.images(),
        "demonstrations_with_a_near_anchor": sampler.with_neighbours(),
        "loss": last.map(|epoch| epoch.losses[0]),
    })
}
