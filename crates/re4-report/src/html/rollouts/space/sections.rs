//! The sections that only the page of robosuite's tasks has.

use maud::{Markup, html};

use super::Space;
use crate::html::rollouts::Rollouts;
use crate::html::rollouts::sections::{figure, named};
use crate::html::shell::{choice, exact};

/// The filters of the grid and of the table of rollouts.
const FILTERS: [(&str, &str); 4] = [
    ("all", "All"),
    ("failure", "Failures"),
    ("lost", "Grasp lost"),
    ("several", "Several demonstrations"),
];

/// The results of an artifact, and the demonstrations, dataset and simulator behind them.
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
            span.interval { "of the successes" }
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

/// The section with the grid of rollouts, which the script renders.
pub(super) fn grid(labels: &[String]) -> Markup {
    html! {
        section #plots aria-labelledby="plots-title" {
            div.heading {
                h2 #plots-title { "All rollouts" }
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
                    li { span.cell.success aria-hidden="true" { i style="--height: 35%" {} } "success; the height of the bar is the number of steps" }
                    li { span.cell.failure aria-hidden="true" { i style="--height: 100%" {} } "failure" }
                    li { span.cell.success.lost aria-hidden="true" { i style="--height: 60%" {} } "grasp lost at least once" }
                }
                p.hint { "Click a rollout, or use the arrow keys, to show it in the viewer." }
            }
        }
    }
}

/// The data of a decision, and the camera's image; the script fills both.
pub(super) fn evidence(images: bool) -> Markup {
    html! {
        dl.summary #summary {}
        p.hint #demo-note {}
        @if images { (image()) }
    }
}

/// The camera's image at a decision, which the script fills in.
fn image() -> Markup {
    html! {
        figure.camera #camera {
            figcaption {
                h3 { "Camera image at the decision" }
                p #camera-caption {}
            }
            div #camera-image {}
            ul.legend {
                li {
                    svg.plane.sample viewBox="0 0 24 18" aria-hidden="true" {
                        path.estimate.x d="M4 14H14" {} path.estimate.y d="M4 14L11 7" {} path.estimate.z d="M4 14V3" {}
                    }
                    "object frame that the policy observed: x, y, z"
                }
                li {
                    svg.plane.sample viewBox="0 0 24 18" aria-hidden="true" { path.simulated d="M4 14H14M4 14L11 7M4 14V3" {} }
                    "object frame in the simulator"
                }
            }
            p.hint #camera-note {
                "A frame that is estimated from an image is the frame of a gripper that would hold the object. "
                "Even without error, it differs from the object’s own frame by a constant rigid transform, which is not removed here."
            }
        }
    }
}
