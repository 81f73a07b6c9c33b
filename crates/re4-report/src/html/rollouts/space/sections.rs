//! What only the page of robosuite's tasks has.

use maud::{Markup, html};

use super::Space;
use crate::html::rollouts::Rollouts;
use crate::html::rollouts::sections::{figure, named};
use crate::html::shell::{choice, exact};

/// What the grid and the table of seeds can be limited to.
const FILTERS: [(&str, &str); 4] = [
    ("all", "All"),
    ("failure", "Failures"),
    ("lost", "Grasp lost"),
    ("several", "Several demonstrations"),
];

/// Figures of an artifact, and what it was made with.
pub(super) fn score_cells(artifact: &Rollouts<Space>) -> Markup {
    let scene = &artifact.scene;
    html! {
        (figure("success_rate", scene.success_rate, None))
        td.figure data-metric="successes" data-value=(scene.successes) {
            span.value { (scene.successes) }
            span.interval { "of " (artifact.rollouts.len()) }
        }
        td.figure data-metric="median_steps" data-value=[scene.median_steps.map(exact)] {
            span.value { @if let Some(median) = scene.median_steps { (median) } @else { "–" } }
            span.interval { "where it succeeds" }
        }
        td.figure data-metric="losses" data-value=(scene.losses) {
            span.value { (scene.losses) }
            span.interval { "in all rollouts" }
        }
        td {
            span.detail { (scene.demonstrations) }
            span.detail { (scene.dataset) }
            span.detail { (scene.simulator) }
        }
    }
}

/// The place for the grid of rollouts, which the script draws.
pub(super) fn grid(labels: &[String]) -> Markup {
    html! {
        section #plots aria-labelledby="plots-title" {
            div.heading {
                h2 #plots-title { "Every rollout" }
                div.choices {
                    (choice("filter", "Show", &FILTERS))
                    (choice("order", "Order", &[("seed", "By seed"), ("steps", "By steps")]))
                }
            }
            div.card {
                @for (i, label) in labels.iter().enumerate() {
                    div.cells-of {
                        h3.name { (named(i, label)) " " span.count data-count-of=(i) {} }
                        div.cells role="group" aria-label={ "Rollouts of " (label) } data-artifact=(i) {}
                    }
                }
                ul.legend.cell-legend {
                    li { span.cell.success aria-hidden="true" { i style="--share: 35%" {} } "succeeded; the bar is as high as the steps it took" }
                    li { span.cell.failure aria-hidden="true" { i style="--share: 100%" {} } "failed" }
                    li { span.cell.success.lost aria-hidden="true" { i style="--share: 60%" {} } "lost its grasp on the way" }
                }
                p.hint { "Click one, or use the arrow keys, to see it in the viewer." }
            }
        }
    }
}

/// The figures of a decision, and what the camera saw; the script fills both.
pub(super) fn evidence(images: bool) -> Markup {
    html! {
        dl.summary #summary {}
        p.hint #demo-note {}
        @if images { (image()) }
    }
}

/// The place for what the camera saw at a decision.
fn image() -> Markup {
    html! {
        figure.camera #camera {
            figcaption {
                h3 { "What the camera saw" }
                p #camera-caption {}
            }
            div #camera-image {}
            ul.legend {
                li {
                    svg.plane.sample viewBox="0 0 24 18" aria-hidden="true" {
                        path.told.x d="M4 14H14" {} path.told.y d="M4 14L11 7" {} path.told.z d="M4 14V3" {}
                    }
                    "frame that the policy was told: x, y, z"
                }
                li {
                    svg.plane.sample viewBox="0 0 24 18" aria-hidden="true" { path.simulated d="M4 14H14M4 14L11 7M4 14V3" {} }
                    "the object’s own frame in the simulator"
                }
            }
            p.hint #camera-note {
                "A frame estimated from an image is that of the gripper that would hold the object. "
                "It is a constant rigid motion away from the object’s own at best, which is not taken away here."
            }
        }
    }
}
