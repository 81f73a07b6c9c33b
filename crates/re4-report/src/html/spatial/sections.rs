//! The parts of the page.

use maud::{Markup, html};

use super::{SpatialReport, SpatialRollouts, Together};
use crate::html::common::{choice, exact, plural};
use crate::html::facts::differences;
use crate::html::sections::{fact_table, figure, mark, transport};

/// The page's first sentence names this many policies at most.
const MOST_NAMED: usize = 4;

/// What the grid and the table of seeds can be limited to.
const FILTERS: [(&str, &str); 4] = [
    ("all", "All"),
    ("failure", "Failures"),
    ("lost", "Grasp lost"),
    ("several", "Several demonstrations"),
];

/// The title, and what the page is about.
pub(super) fn header(report: &SpatialReport, together: &Together) -> Markup {
    let rollouts: usize = report.artifacts.iter().map(|artifact| artifact.rollouts.len()).sum();
    html! {
        header.page {
            p.eyebrow { "re4-pipe · rollouts" }
            h1 { (together.tasks.join(", ")) }
            p.lead {
                (plural(rollouts, "rollout", "rollouts")) " of "
                @if together.labels.len() > MOST_NAMED {
                    strong { (together.labels.len()) } " policies and protocols"
                } @else {
                    @for (i, label) in together.labels.iter().enumerate() {
                        @if i > 0 { @if i + 1 == together.labels.len() { " and " } @else { ", " } }
                        strong { (label) }
                    }
                }
                " in robosuite’s scene. Every action can be traced to the demonstration that it was taken from."
            }
            noscript { p.notice { "The plots and the viewer need JavaScript; the tables do not." } }
        }
    }
}

/// One row an artifact.
pub(super) fn scores(report: &SpatialReport, together: &Together) -> Markup {
    let differences = differences(&together.protocol);
    html! {
        section #scores aria-labelledby="scores-title" {
            h2 #scores-title { "Success" }
            p.note {
                "A rollout succeeds when the task’s own rule holds after any control step, which ends it. "
                "Intervals are Wilson’s, at 95 %. A second holds 20 control steps."
            }
            @if !differences.is_empty() {
                p.notice #protocol-differs data-differences=(differences.join(" ")) {
                    strong { "These rollouts were not made under one protocol." }
                    " They differ in " (differences.join(", ").replace('_', " ")) ". Compare rows with that in mind; "
                    a href="#protocol" { "the protocol" } " has the details."
                }
            }
            div.scroll tabindex="0" role="region" aria-label="Success table" {
                table.scores.spatial {
                    thead { tr {
                        th scope="col" { "Policy" }
                        th.figure scope="col" { "Success rate" }
                        th.figure scope="col" { "Succeeded" }
                        th.figure scope="col" { "Median steps" }
                        th.figure scope="col" { "Grasps lost" }
                        th scope="col" { "Demonstrations and simulator" }
                    } }
                    tbody { @for (i, artifact) in report.artifacts.iter().enumerate() { (score_row(i, artifact, &together.labels[i])) } }
                }
            }
        }
    }
}

fn score_row(number: usize, artifact: &SpatialRollouts, label: &str) -> Markup {
    let changed = if artifact.altered { " · settings changed" } else { "" };
    let median = artifact.median_steps;
    html! {
        tr data-artifact=(artifact.key) {
            th scope="row" {
                span.name { (mark(number)) (label) }
                span.detail { (artifact.world.task) " · " (artifact.variant) (changed) }
                span.detail { "seeds " (artifact.seeds) " · at most " (plural(artifact.max_steps as usize, "step", "steps")) }
            }
            (figure("success_rate", artifact.success_rate, None))
            td.figure data-metric="successes" data-value=(artifact.successes) {
                span.value { (artifact.successes) }
                span.interval { "of " (artifact.rollouts.len()) }
            }
            td.figure data-metric="median_steps" data-value=[median.map(exact)] {
                span.value { @if let Some(median) = median { (median) } @else { "–" } }
                span.interval { "where it succeeds" }
            }
            td.figure data-metric="losses" data-value=(artifact.losses) {
                span.value { (artifact.losses) }
                span.interval { "in all rollouts" }
            }
            td {
                span.detail { (artifact.demonstrations) }
                span.detail { (artifact.dataset) }
                span.detail { (artifact.simulator) }
            }
        }
    }
}

/// The place for the grid of rollouts, which the script draws.
pub(super) fn grid(together: &Together) -> Markup {
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
                @for (i, label) in together.labels.iter().enumerate() {
                    div.cells-of {
                        h3.name { (mark(i)) (label) " " span.count data-count-of=(i) {} }
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

/// The viewer; the script fills it.
pub(super) fn viewer(report: &SpatialReport, together: &Together) -> Markup {
    let nothing = report
        .artifacts
        .iter()
        .all(|artifact| artifact.rollouts.iter().all(|rollout| !rollout.shown));
    let mut decisions = report
        .artifacts
        .iter()
        .flat_map(|artifact| artifact.rollouts.iter().filter(|rollout| rollout.shown))
        .flat_map(|rollout| &rollout.decisions);
    let pictures = decisions.any(|decision| decision.picture.is_some());
    html! {
        section #viewer aria-labelledby="viewer-title" tabindex="-1" {
            div.heading {
                h2 #viewer-title { "Rollout viewer" }
                div.pick {
                    label { span { "Policy" } select #pick-artifact {
                        @for (i, label) in together.labels.iter().enumerate() { option value=(i) { (label) } }
                    } }
                    label { span #seed-noun { "Seed" } select #pick-seed {} }
                    div.pair {
                        button #previous-seed type="button" aria-label="Previous rollout" title="Previous rollout" { "‹" }
                        button #next-seed type="button" aria-label="Next rollout" title="Next rollout" { "›" }
                    }
                }
            }
            @if nothing { p.notice { "No rollout is embedded in this page." } }
            div.stage.spatial {
                div.demos-card { (transport()) }
                figure.card.scene {
                    figcaption {
                        h3 { "Scene" }
                        p #scene-caption {}
                    }
                    div #scene {}
                    ul.legend #legend {}
                }
                div.card.why {
                    div.row {
                        h3 #decision-title {}
                        span.badge #phase {}
                    }
                    p.reason #reason aria-live="polite" {}
                    dl.facts #facts {}
                    p.hint #demo-note {}
                    @if pictures { (picture()) }
                }
            }
        }
    }
}

/// The place for what the camera saw at a decision.
fn picture() -> Markup {
    html! {
        figure.camera #camera {
            figcaption {
                h3 { "What the camera saw" }
                p #camera-caption {}
            }
            div #camera-picture {}
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
                "A frame estimated from a picture is that of the gripper that would hold the object. "
                "It is a constant rigid motion away from the object’s own at best, which is not taken away here."
            }
        }
    }
}

/// The table of seeds, which the script fills.
pub(super) fn tables(together: &Together) -> Markup {
    let columns = [
        ("seed", "Seed"),
        ("success", "Success"),
        ("steps", "Steps"),
        ("decisions", "Decisions"),
        ("demos", "Demonstrations"),
        ("losses", "Grasps lost"),
        ("banned", "Not followed again"),
    ];
    html! {
        section #tables aria-labelledby="tables-title" {
            h2 #tables-title { "Figures" }
            details.card open {
                summary { "Rollouts of " span #seeds-of { (together.labels.first().map_or("", String::as_str)) } }
                div.scroll.tall tabindex="0" role="region" aria-label="Seeds" {
                    table.plain.sortable #seeds {
                        thead { tr {
                            @for (column, words) in columns {
                                th.figure scope="col" { button type="button" data-column=(column) { (words) } }
                            }
                        } }
                        tbody {}
                    }
                }
            }
        }
    }
}

/// Protocol and settings, fact by fact.
pub(super) fn protocol(together: &Together) -> Markup {
    html! {
        section #protocol aria-labelledby="protocol-title" {
            h2 #protocol-title { "Protocol" }
            p.note {
                @if together.labels.len() > 1 && differences(&together.protocol).is_empty() { "All rollouts were made under one protocol. " }
                "Success rates of different protocols, or with other demonstrations, must not be compared."
            }
            div.card { (fact_table("Protocol", &together.protocol, &together.labels)) }
            details.card {
                summary { "Settings of the policies" }
                (fact_table("Settings", &together.settings, &together.labels))
            }
        }
    }
}

/// Where the page is from.
pub(super) fn footer(report: &SpatialReport, together: &Together) -> Markup {
    html! {
        footer.page {
            p { "Made by re4-pipe " (report.tool_version) " from these artifacts; the same artifacts give the same page." }
            ul {
                @for (artifact, label) in report.artifacts.iter().zip(&together.labels) {
                    li { (label) " " code { "rollouts/" (artifact.key.get(..16).unwrap_or(&artifact.key)) } }
                }
            }
        }
    }
}
