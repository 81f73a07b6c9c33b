//! The stage `train`: trains the network of a learned policy on `episodes` and `index`, and writes its weights to `policy`.

use std::fmt::Write as _;

use anyhow::Result;
use re4_artifact::{Artifact, ArtifactSummary, Key, Recipe, Stage, Writer, table};
use re4_fault::ensure;
use re4_generative::train::{BACKEND, Task, Trained, steps_of, train};
use re4_generative::{Demo, Windows, weights};
use re4_geometry::spatial::Symmetry;
use re4_policy::kinds::{Inputs, Kinds as _, PolicyCard, Training};
use re4_report::training_plot;
use re4_rollout::Recorded;
use re4_train::{Backend, Checkpoints, Epoch, Progress};
use serde_json::{Value, json};

use crate::inputs::demos::demo_names;
use crate::pipeline::Policy;
use crate::runner::{Built, Runner};

/// Increase it whenever the same input gives different bytes.
const CODE_VERSION: u32 = 1;

/// File name of the plot.
const PLOT: &str = "training.svg";

/// File name of the model card.
const CARD: &str = "model_card.md";

table! {
    /// One row per part of the training of a learned policy: its mean loss, and the loss on held-out demonstrations, which does
    /// not influence the training.
    #[table("policy_training", version = 1)]
    pub struct PolicyTrainingRow {
        /// Number of the part, from 1.
        pub epoch: u32,
        /// Number of optimiser steps up to the end of the part.
        pub steps: u32,
        /// Learning rate of the part's last step.
        pub learning_rate: f64,
        /// Mean squared error of the predicted noise (diffusion) or velocity (flow), over all numbers of normalised actions.
        pub loss: f64,
        /// The same of the moving average of the weights on held-out demonstrations; null if there are none.
        pub held_out: Option<f64>,
    }
}

impl Runner {
    /// Runs all stages up to the `policy` artifact of the pipeline's policy.
    ///
    /// # Errors
    /// If the policy needs no training, an input cannot be read, a setting does not fit the input, or the run is interrupted.
    pub fn train(&self) -> Result<Built> {
        let policy = self.pipeline.policy()?;
        ensure!(
            policy.inputs().contains(&Stage::Train),
            "nothing to train: the policy {:?} replays demonstrations", policy.kind();
            "choose a policy that is trained, such as --set policy.kind=diffusion"
        );
        let episodes = self.ingest()?;
        let modes = self.segment(&episodes)?;
        let index = if self.pipeline.task.is_planar() {
            let poses = self.train_pose(&episodes)?;
            self.index(&episodes, &modes, poses.as_ref())?
        } else {
            let poses = self.train_spatial(&episodes, &modes)?;
            self.index_spatial(&episodes, &modes, poses.as_ref())?
        };
        self.train_policy(policy, &episodes, &index)
    }

    /// Makes the `policy` artifact, or returns the existing one.
    pub(crate) fn train_policy(&self, policy: &Policy, episodes: &Built, index: &Built) -> Result<Built> {
        match policy {
            Policy::Plane(kind) => self.fit_policy(kind.settings().training(), episodes, index),
            Policy::Space(kind) => self.fit_policy(kind.settings().training(), episodes, index),
        }
    }

    fn fit_policy<D: Recorded>(
        &self,
        training: Option<Training<'_, D>>,
        episodes: &Built,
        index: &Built,
    ) -> Result<Built> {
        let Some(training) = training else {
            anyhow::bail!("the policy needs no training");
        };
        let recipe = Recipe::new(Stage::Train, CODE_VERSION)
            .config(&json!({
                "method": training.method,
                "observation": training.codec.name(),
                "training": training.config,
            }))?
            .input("episodes", episodes.artifact.key())
            .input("index", index.artifact.key());
        let key = recipe.key();
        self.build_trained(&recipe, "training_chunks_per_s", |writer, checkpoints| {
            self.fit_network(
                &training,
                (&episodes.artifact, &index.artifact),
                &key,
                checkpoints,
                writer,
            )
        })
    }

    fn fit_network<D: Recorded>(
        &self,
        training: &Training<'_, D>,
        (episodes, index): (&Artifact, &Artifact),
        key: &Key,
        checkpoints: &Checkpoints,
        writer: &Writer,
    ) -> Result<(ArtifactSummary, Option<f64>)> {
        let config = training.config;
        // Flex, the pure Rust backend, runs in the program's own thread pool and needs no setting.
        config.backend.device(BACKEND)?;
        if config.backend != Backend::Flex {
            config.backend.set_threads(rayon::current_num_threads(), BACKEND)?;
        }
        let demos = training.codec.read(&Inputs {
            artifacts: &[(Stage::Index, index)],
            episodes,
            task: self.pipeline.task.robosuite(),
            names: demo_names(episodes)?,
            symmetry: Symmetry::None,
        })?;
        // The statistics are those of all demonstrations, as in Diffusion Policy.
        let card = PolicyCard::fit(training, &demos);
        let (trained_on, held_out) = split(demos, config.held_out);
        let windows = |demos: &[Demo]| Windows::new(demos, config, &card.observations, &card.actions);
        let (own, other) = (windows(&trained_on)?, Some(&held_out).filter(|demos| !demos.is_empty()));
        let other = other.map(|demos| windows(demos)).transpose()?;
        let task = Task {
            config,
            method: training.method,
            windows: &own,
            held_out: other.as_ref(),
            shape: training
                .method
                .shape(config, card.actions.dimensions(), card.observations.dimensions()),
        };
        let bar = self.notes.progress(u64::from(steps_of(config)), "train");
        let Trained { network, fitted } = train(&task, checkpoints, |progress: &Progress| -> Result<()> {
            bar.set_position(progress.steps);
            bar.set_message(format!(
                "train: {:.0} chunks/s, loss {:.5}",
                progress.rate * config.batch as f64,
                progress.losses.first().copied().unwrap_or(f64::NAN),
            ));
            self.interrupt.check("train")
        })?;
        bar.finish_and_clear();
        let bytes = weights::to_bytes(&network)?;
        writer.file(PolicyCard::WEIGHTS, &bytes)?;
        writer.file(PolicyCard::FILE, &serde_json::to_vec_pretty(&card)?)?;
        writer.write_rows(fitted.epochs.iter().map(row))?;
        let curve = |value: fn(&Epoch) -> Option<f64>| fitted.epochs.iter().map(value).collect::<Vec<_>>();
        let svg = training_plot(&[
            ("loss", curve(|epoch| epoch.losses.first().copied())),
            ("loss, held out", curve(|epoch| epoch.held_out)),
        ])?;
        writer.file(PLOT, svg.as_bytes())?;
        let last = fitted.epochs.last();
        let summary = json!({
            "demonstrations": trained_on.len(),
            "held_out": held_out.len(),
            "chunks": own.count(),
            "steps": last.map(|epoch| epoch.steps),
            "passes_over_the_data": f64::from(steps_of(config)) * config.batch as f64 / own.count() as f64,
            "parameters": parameters(&bytes),
            "weights_bytes": bytes.len(),
            "loss": last.and_then(|epoch| epoch.losses.first()),
            "held_out_loss": last.and_then(|epoch| epoch.held_out),
        });
        writer.file(
            CARD,
            model_card(&card, &summary, [episodes.key(), index.key(), key])?.as_bytes(),
        )?;
        let rate = fitted.rate.map(|rate| rate * config.batch as f64);
        let warnings = Vec::new();
        Ok((ArtifactSummary { summary, warnings }, rate))
    }
}

/// Number of parameters of a weights file, of four bytes each. The header, whose length its first eight bytes give, is not counted.
fn parameters(bytes: &[u8]) -> usize {
    let header = bytes.first_chunk::<8>().map_or(0, |length| u64::from_le_bytes(*length));
    bytes.len().saturating_sub(8 + header as usize) / 4
}

/// Demonstrations to train on, and those that are held out: every n-th, starting with the first.
fn split(demos: Vec<Demo>, fraction: f64) -> (Vec<Demo>, Vec<Demo>) {
    if fraction <= 0.0 {
        return (demos, Vec::new());
    }
    let every = (1.0 / fraction).round().max(2.0) as usize;
    let (mut own, mut other) = (Vec::new(), Vec::new());
    for (at, demo) in demos.into_iter().enumerate() {
        if at.is_multiple_of(every) { &mut other } else { &mut own }.push(demo);
    }
    (own, other)
}

fn row(epoch: &Epoch) -> PolicyTrainingRow {
    PolicyTrainingRow {
        epoch: epoch.epoch,
        steps: epoch.steps,
        learning_rate: epoch.learning_rate,
        loss: epoch.losses.first().copied().unwrap_or(f64::NAN),
        held_out: epoch.held_out,
    }
}

/// The model card. It contains nothing that differs between runs, such as the training rate.
fn model_card(card: &PolicyCard, summary: &Value, [episodes, index, own]: [&Key; 3]) -> Result<String> {
    let mut text = String::from("# Learned policy\n\n");
    text.push_str(
        "Generates chunks of actions from the last observations. The weights are the moving average after the last step; no \
         checkpoint was selected by its score.\n\n",
    );
    writeln!(text, "- artifact: `{own}`")?;
    writeln!(text, "- trained on episodes: `{episodes}`, index: `{index}`")?;
    writeln!(text, "- observation: {}", card.observation)?;
    writeln!(
        text,
        "- weights: `{}`; training curve: `{PLOT}`, table `policy_training`",
        PolicyCard::WEIGHTS
    )?;
    writeln!(
        text,
        "- training rate: `runs/train-{}.json` in the artifacts folder\n",
        own.short()
    )?;
    writeln!(
        text,
        "## Settings\n\n```json\n{}\n```\n",
        serde_json::to_string_pretty(&json!({ "method": card.method, "training": card.training }))?
    )?;
    writeln!(
        text,
        "## Result\n\n```json\n{}\n```",
        serde_json::to_string_pretty(summary)?
    )?;
    Ok(text)
}
