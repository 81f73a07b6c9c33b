//! What the `poses` artifact of an encoder says of itself: a model card and a plot of its training.

use std::fmt::Write as _;

use anyhow::Result;
use re4_artifact::{Key, Writer};
use re4_encoder::EncoderConfig;
use re4_encoder::train::Epoch;
use re4_report::training_plot;
use serde_json::Value;

/// File of the plot.
const PLOT: &str = "training.svg";

/// File of the card.
const CARD: &str = "model_card.md";

/// Loss by epoch.
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

/// The card. What differs from run to run, such as the rate, is not in it: it stands in the store's folder of runs.
pub(super) fn write(
    config: &EncoderConfig,
    summary: &Value,
    epochs: &[Epoch],
    (episodes, modes, own): (&Key, &Key, &Key),
    writer: &Writer,
) -> Result<()> {
    let mut text = String::from("# Pose encoder\n\n");
    text.push_str(
        "Estimates the pose of the manipulated object from one image, as that of the gripper that holds it. Trained on \
         images, end-effector poses and modes of demonstrations alone; no recorded object pose was read before the \
         evaluation below.\n\n",
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
        "- architecture: ResNet-18 of width {}, 84 x 84 cropped to 76 x 76, 256 numbers of embedding, 9 of pose (translation in units of 0.1 m, two columns of the rotation)",
        config.width
    )?;
    writeln!(
        text,
        "- weights: `{}`, names as torchvision's; curves: `{PLOT}`, table `training`",
        crate::inputs::estimators::WEIGHTS
    )?;
    writeln!(
        text,
        "- training rate: in the store, `runs/train-pose-{}.json`\n",
        own.short()
    )?;
    writeln!(
        text,
        "## Settings\n\n```json\n{}\n```\n",
        serde_json::to_string_pretty(config)?
    )?;
    text.push_str("## Course\n\n| epoch | learning rate | loss | L_abs | L_rel | L_cross | L_abs held out |\n|---|---|---|---|---|---|---|\n");
    for epoch in epochs {
        let [sum, absolute, relative, cross] = epoch.losses;
        let held_out = epoch.held_out.map_or_else(String::new, |loss| format!("{loss:.4}"));
        writeln!(
            text,
            "| {} | {:.2e} | {sum:.4} | {absolute:.4} | {relative:.4} | {cross:.4} | {held_out} |",
            epoch.epoch, epoch.learning_rate
        )?;
    }
    writeln!(
        text,
        "\n## Evaluation\n\n```json\n{}\n```",
        serde_json::to_string_pretty(&summary["evaluation"])?
    )?;
    writer.file(CARD, text.as_bytes())?;
    Ok(())
}
