//! The model card and the training plot in the `encoder` artifact.

use std::fmt::Write as _;

use anyhow::Result;
use re4_artifact::{Key, Writer};
use re4_encoder::train::parts;
use re4_encoder::{EncoderConfig, Network};
use re4_report::training_plot;
use re4_train::Epoch;
use serde_json::Value;

/// File name of the plot.
const PLOT: &str = "training.svg";

/// File name of the model card.
const CARD: &str = "model_card.md";

/// Writes the plot of the losses by epoch.
pub(super) fn write_plot(epochs: &[Epoch], writer: &Writer) -> Result<()> {
    let curve = |value: fn(&Epoch) -> Option<f64>| epochs.iter().map(value).collect::<Vec<_>>();
    let svg = training_plot(&[
        ("L_abs", curve(|epoch| Some(epoch.losses[1]))),
        ("L_rel", curve(|epoch| Some(epoch.losses[2]))),
        ("L_cross", curve(|epoch| Some(epoch.losses[3]))),
        ("L_abs, held out", curve(|epoch| epoch.held_out)),
    ])?;
    writer.file(PLOT, svg.as_bytes())?;
    Ok(())
}

/// Writes the model card. It contains nothing that differs between runs, such as the training rate, because its hash is part of
/// the artifact; such figures are in the store's folder of runs.
pub(super) fn write(
    config: &EncoderConfig,
    summary: &Value,
    epochs: &[Epoch],
    (episodes, modes, own): (&Key, &Key, &Key),
    writer: &Writer,
) -> Result<()> {
    let mut text = String::from("# Pose encoder\n\n");
    text.push_str(
        "Estimates the pose of the manipulated object from one image, as the pose of the gripper when it holds the object. \
         Trained only on images, end-effector poses and modes of demonstrations; no recorded object pose was read. The errors of \
         the estimates are in the `poses` artifact that was made with this encoder.\n\n",
    );
    writeln!(text, "- artifact: `{own}`")?;
    writeln!(text, "- trained on episodes: `{episodes}`")?;
    writeln!(text, "- trained on modes: `{modes}`")?;
    writeln!(
        text,
        "- started from: {}",
        summary["started_from"].as_str().unwrap_or_default()
    )?;
    writeln!(
        text,
        "- architecture: {} of width {}, input 84 x 84 cropped to 76 x 76, pose of 9 numbers (translation in units of 0.1 m, two columns of the rotation matrix)",
        match config.network {
            Network::Resnet18 => "ResNet-18 with an embedding of 256 numbers",
            Network::Keypoints => "keypoint network",
        },
        config.width
    )?;
    writeln!(
        text,
        "- weights: `{}`, with torchvision's names; training curves: `{PLOT}`, table `training`",
        crate::inputs::estimators::WEIGHTS
    )?;
    writeln!(
        text,
        "- training rate: `runs/train-encoder-{}.json` in the artifacts folder\n",
        own.short()
    )?;
    writeln!(
        text,
        "## Settings\n\n```json\n{}\n```\n",
        serde_json::to_string_pretty(config)?
    )?;
    text.push_str("## Training\n\n| epoch | learning rate | loss | L_abs | L_rel | L_cross | L_abs held out |\n|---|---|---|---|---|---|---|\n");
    for epoch in epochs {
        let [sum, absolute, relative, cross] = parts(&epoch.losses);
        let held_out = epoch.held_out.map_or_else(String::new, |loss| format!("{loss:.4}"));
        writeln!(
            text,
            "| {} | {:.2e} | {sum:.4} | {absolute:.4} | {relative:.4} | {cross:.4} | {held_out} |",
            epoch.epoch, epoch.learning_rate
        )?;
    }
    writer.file(CARD, text.as_bytes())?;
    Ok(())
}
