//! A self-contained HTML page of the training of a pose encoder: the curves of the losses, the errors by phase, the calibration of
//! the confidence, and the images with the largest errors, with the estimated frame and the one that was trained on.
//!
//! The page needs no script. Its bytes depend only on [`Training`].

use base64::Engine as _;
use base64::prelude::BASE64_STANDARD;
use maud::{Markup, PreEscaped, html};
use serde_json::{Value, json};

use super::rollouts::space::FrameInImage;
use super::shell::{self, Document, exact, plural, table};

/// The content of the page.
#[derive(Debug, Clone, PartialEq)]
pub struct Training {
    /// Version of the program that makes the page.
    pub tool_version: String,
    /// robosuite's name of the environment.
    pub task: String,
    /// Kind and key of every artifact that the page was made from.
    pub artifacts: Vec<(String, String)>,
    /// Numbers of demonstrations that were trained on and held out.
    pub demonstrations: [usize; 2],
    /// Number of optimiser steps.
    pub steps: u32,
    /// The curves of the losses over the epochs, as SVG.
    pub curves: String,
    /// Errors by set and phase.
    pub errors: Vec<PhaseErrors>,
    /// The steps of the confidence's calibration, if it has one.
    pub confidence: Option<Confidence>,
    /// Groups of images with large errors.
    pub worst: Vec<Group>,
    /// Why the images show no frames, if they do not.
    pub without_frames: Option<String>,
    /// The encoder's settings.
    pub settings: Value,
}

/// Errors of the frames of a set in a phase.
#[derive(Debug, Clone, PartialEq)]
pub struct PhaseErrors {
    /// Name of the set: held out or trained on.
    pub set: &'static str,
    /// Name of the phase.
    pub phase: &'static str,
    /// Number of frames.
    pub frames: usize,
    /// Median and 90 % quantile of the translation error at the object's origin in mm, at the grasp point in mm, and of the
    /// rotation error in degrees.
    pub quantiles: [[f64; 2]; 3],
}

/// The calibration of the confidence, and how often estimates before the grasp of held-out demonstrations are unsure.
#[derive(Debug, Clone, PartialEq)]
pub struct Confidence {
    /// Largest disagreement of the crops in mm, and the confidence, of each step.
    pub steps: Vec<[f64; 2]>,
    /// Distance from the anchor up to which an estimate agrees, in mm.
    pub agrees_within: f64,
    /// Numbers of unsure estimates and of all estimates.
    pub unsure: [usize; 2],
}

/// Images of one kind.
#[derive(Debug, Clone, PartialEq)]
pub struct Group {
    /// Heading.
    pub title: String,
    /// The images, the one with the largest error first.
    pub frames: Vec<WorstFrame>,
}

/// An image with a large error.
#[derive(Debug, Clone, PartialEq)]
pub struct WorstFrame {
    /// Name of its demonstration.
    pub demo: String,
    /// Number of the frame in the demonstration.
    pub frame: u32,
    /// Translation error at the grasp point, in mm.
    pub translation: f64,
    /// Rotation error, in degrees.
    pub rotation: f64,
    /// Confidence of the estimate, if it has one.
    pub confidence: Option<f64>,
    /// The image as the bytes of a PNG file, if it was found.
    pub png: Option<Vec<u8>>,
    /// The estimated frame, in pixels.
    pub estimated: FrameInImage,
    /// The frame that the training takes as the truth, in pixels.
    pub anchored: FrameInImage,
}

/// Side of the images, in pixels.
pub const SIDE: u32 = 84;

const STYLE: &str = include_str!("page.css");

/// Makes the page.
#[must_use]
pub fn page(training: &Training) -> String {
    let body = html! {
        (header(training))
        main {
            (curves(training))
            (errors(training))
            (confidence(training.confidence.as_ref()))
            (worst(training))
            (settings(training))
        }
        (shell::footer(
            &html! { "with " code { "re4-pipe report" } },
            training.artifacts.iter().map(|(kind, key)| ("", kind.as_str(), key.as_str())),
        ))
    };
    Document {
        tool_version: &training.tool_version,
        title: format!("{}: training of the pose encoder", training.task),
        style: STYLE,
        script: &[],
        data: &json!({}),
        body,
    }
    .render()
}

fn millimetres(value: f64) -> String {
    format!("{value:.1} mm")
}

fn degrees(value: f64) -> String {
    format!("{value:.1}°")
}

fn header(training: &Training) -> Markup {
    let [trained_on, held_out] = training.demonstrations;
    let before = training
        .errors
        .iter()
        .find(|errors| errors.set == HELD_OUT && errors.phase == "before_grasp");
    let lead = html! {
        "Trained for " strong { (training.steps) " steps" } " on "
        strong data-fact="trained_on" data-value=(trained_on) { (plural(trained_on, "demonstration", "demonstrations")) } "; "
        (plural(held_out, "demonstration was", "demonstrations were")) " held out. "
        @if let Some(PhaseErrors { quantiles: [_, grasp, rotation], .. }) = before {
            "Median error of held-out frames before the grasp: "
            strong { (millimetres(grasp[0])) } " at the grasp point and " strong { (degrees(rotation[0])) } "."
        }
    };
    shell::header("train-pose", &training.task, &lead, "", &html! {})
}

fn curves(training: &Training) -> Markup {
    html! {
        section aria-labelledby="curves-title" {
            h2 #curves-title { "Losses" }
            p.note {
                "Means over the steps of each epoch, before the weights of the losses. The loss on held-out demonstrations does not "
                "influence the training."
            }
            div.card.plot role="img" aria-label="Losses by epoch" { (PreEscaped(&training.curves)) }
        }
    }
}

/// Name of the set that was not trained on.
pub const HELD_OUT: &str = "held out";

fn errors(training: &Training) -> Markup {
    let columns = [
        ("set", false),
        ("phase", false),
        ("frames", true),
        ("translation, p50 / p90", true),
        ("at the grasp point, p50 / p90", true),
        ("rotation, p50 / p90", true),
    ];
    let units: [fn(f64) -> String; 3] = [millimetres, millimetres, degrees];
    let rows = html! {
        @for errors in &training.errors {
            tr {
                th scope="row" { (errors.set) }
                td { (errors.phase.replace('_', " ")) }
                td.figure { (errors.frames) }
                @for (quantiles, unit) in errors.quantiles.iter().zip(units) {
                    td.figure data-value=(exact(quantiles[0])) { (unit(quantiles[0])) " / " (unit(quantiles[1])) }
                }
            }
        }
    };
    html! {
        section aria-labelledby="errors-title" {
            h2 #errors-title { "Errors by phase" }
            p.note {
                "Distance from the recorded object pose, which the training does not read, after removing one constant offset. "
                "Rotations within the object's symmetry are no error."
            }
            div.card { (table("Errors by phase", "scroll", "", &columns, &rows)) }
        }
    }
}

fn confidence(confidence: Option<&Confidence>) -> Markup {
    let Some(confidence) = confidence else {
        return html! {};
    };
    let columns = [("disagreement of the crops up to", true), ("confidence", true)];
    let rows = html! {
        @for [score, confidence] in &confidence.steps {
            tr { td.figure { (format!("{score:.2} mm")) } td.figure { (format!("{confidence:.2}")) } }
        }
    };
    let [unsure, all] = confidence.unsure;
    html! {
        section aria-labelledby="confidence-title" {
            h2 #confidence-title { "Confidence" }
            p.note {
                "The confidence is the fraction of held-out frames before the grasp, with a similar disagreement of the image's crops, "
                "whose estimates are within " (millimetres(confidence.agrees_within)) " of their demonstration's anchor. "
                (unsure) " of " (all) " such estimates are unsure (confidence below 0.5)."
            }
            div.card.narrow { (table("Calibration of the confidence", "scroll", "", &columns, &rows)) }
        }
    }
}

fn worst(training: &Training) -> Markup {
    html! {
        section aria-labelledby="worst-title" {
            h2 #worst-title { "Largest errors" }
            p.note {
                "One image per demonstration: the frame at the 90 % quantile of its errors. Coloured axes (x red, y green, z blue): the estimated frame. "
                "White and black axes: the frame that training takes as the truth, the end effector's pose at the grasp or, while "
                "the object is held, in this frame."
                @if let Some(reason) = &training.without_frames { " The frames are not shown: " (reason) "." }
            }
            @for group in &training.worst {
                h3.above { (group.title) }
                div.images { @for frame in &group.frames { (image(frame)) } }
            }
        }
    }
}

fn image(frame: &WorstFrame) -> Markup {
    let name = format!("{}, frame {}", frame.demo, frame.frame);
    html! {
        figure.card data-demo=(frame.demo) data-frame=(frame.frame) {
            svg viewBox=(format!("0 0 {SIDE} {SIDE}")) role="img" aria-label=(format!("Image of {name} with the estimated frame")) {
                @if let Some(png) = &frame.png {
                    image href={ "data:image/png;base64," (BASE64_STANDARD.encode(png)) } width=(SIDE) height=(SIDE) {}
                }
                @for class in ["anchored under", "anchored"] { (axes(&frame.anchored, |_| class.to_owned())) }
                (axes(&frame.estimated, |axis| format!("estimated {}", ["x", "y", "z"][axis])))
            }
            figcaption {
                b { (name) }
                p {
                    (millimetres(frame.translation)) ", " (degrees(frame.rotation))
                    @if let Some(confidence) = frame.confidence { ", confidence " (format!("{confidence:.2}")) }
                }
            }
        }
    }
}

fn axes(frame: &FrameInImage, class: impl Fn(usize) -> String) -> Markup {
    html! {
        @if let [Some([x, y]), ends @ ..] = frame {
            @for (axis, end) in ends.iter().enumerate() {
                @if let Some([to_x, to_y]) = end {
                    path class=(class(axis)) d=(format!("M{x:.2} {y:.2}L{to_x:.2} {to_y:.2}")) {}
                }
            }
        }
    }
}

fn settings(training: &Training) -> Markup {
    html! {
        details.card {
            summary { "Settings" }
            pre { (serde_json::to_string_pretty(&training.settings).unwrap_or_default()) }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn training() -> Training {
        Training {
            tool_version: "0.0.0".to_owned(),
            task: "Lift".to_owned(),
            artifacts: vec![("poses".to_owned(), "ab".repeat(32))],
            demonstrations: [9, 1],
            steps: 20,
            curves: "<svg></svg>".to_owned(),
            errors: vec![PhaseErrors {
                set: HELD_OUT,
                phase: "before_grasp",
                frames: 12,
                quantiles: [[2.04, 3.0], [1.96, 4.0], [5.5, 20.0]],
            }],
            confidence: Some(Confidence {
                steps: vec![[1.5, 1.0], [9.0, 0.25]],
                agrees_within: 12.0,
                unsure: [3, 40],
            }),
            worst: vec![Group {
                title: "Before the grasp".to_owned(),
                frames: vec![WorstFrame {
                    demo: "demo_<3".to_owned(),
                    frame: 7,
                    translation: 31.26,
                    rotation: 4.0,
                    confidence: Some(0.25),
                    png: Some(vec![1, 2, 3]),
                    estimated: [Some([1.0, 2.0]), Some([3.0, 4.0]), None, Some([5.0, 6.0])],
                    anchored: [None; 4],
                }],
            }],
            without_frames: None,
            settings: json!({ "width": 16 }),
        }
    }

    #[test]
    fn the_page_states_errors_confidence_and_worst_images() {
        let html = page(&training());
        for expected in [
            "2.0 mm / 3.0 mm",
            "<strong>2.0 mm</strong> at the grasp point",
            "5.5°",
            "3 of 40 such estimates",
            "demo_&lt;3, frame 7",
            "31.3 mm, 4.0°, confidence 0.25",
            "data:image/png;base64,AQID",
            "M1.00 2.00L3.00 4.00",
        ] {
            assert!(html.contains(expected), "{expected}");
        }
        assert_eq!(
            html.matches("class=\"estimated").count(),
            2,
            "an axis whose end is not visible is left out"
        );
        assert_eq!(html.matches("class=\"anchored").count(), 0);
        assert_eq!(html, page(&training()));
    }

    #[test]
    fn a_training_without_held_out_demonstrations_has_a_page() {
        let html = page(&Training {
            demonstrations: [1, 0],
            errors: Vec::new(),
            confidence: None,
            worst: Vec::new(),
            without_frames: Some("the model has no camera".to_owned()),
            ..training()
        });
        assert!(html.contains("1 demonstration</strong>") && html.contains("0 demonstrations were held out"));
        assert!(html.contains("The frames are not shown: the model has no camera."));
        assert!(!html.contains("Calibration"));
    }
}
