//! The sections of the page.

use maud::{Markup, html};
use re4_stats::Interval;

use super::summary::{Row, Summary};
use super::{Scene, Words};
use crate::html::shell::{self, exact, plural, short, table};

/// Number of distinct marks. Further artifacts use the same marks again.
const MARKS: usize = 8;

/// Maximum number of artifacts that the first sentence of the page names.
const MAX_NAMED: usize = 4;

/// The mark of an artifact, and its label.
pub(super) fn named(artifact: usize, label: &str) -> Markup {
    html! {
        svg class={ "mark series-" (artifact % MARKS) } viewBox="-6 -6 12 12" width="12" height="12" aria-hidden="true" {
            path data-mark=(artifact % MARKS) {}
        }
        (label)
    }
}

/// The header: the title, and the policies that the page shows.
pub(super) fn header<S: Scene>(summary: &Summary<S>) -> Markup {
    let Summary { report, labels, .. } = summary;
    let rollouts: usize = report.artifacts.iter().map(|artifact| artifact.rollouts.len()).sum();
    let lead = html! {
        (plural(rollouts, "rollout", "rollouts")) " of "
        @if labels.len() > MAX_NAMED {
            strong { (labels.len()) } " policies and protocols"
        } @else {
            @for (i, label) in labels.iter().enumerate() {
                @if i > 0 { @if i + 1 == labels.len() { " and " } @else { ", " } }
                strong { (label) }
            }
        }
        (S::WORDS.of) ". Every action can be traced to the demonstration that it comes from."
    };
    let without_script = "The plots and the viewer need JavaScript; the tables do not.";
    shell::header(
        "rollouts",
        &S::title(&report.artifacts),
        &lead,
        without_script,
        &html! {},
    )
}

/// The score table, with one row per artifact, and the differences between their protocols.
pub(super) fn scores<S: Scene>(summary: &Summary<S>) -> Markup {
    let Words {
        scores: [title, name, class],
        note,
        score_columns,
        ..
    } = S::WORDS;
    let differences = summary.differences();
    let rows = html! {
        @for (i, artifact) in summary.report.artifacts.iter().enumerate() {
            tr data-artifact=(artifact.key) {
                th scope="row" {
                    span.name { (named(i, &summary.labels[i])) }
                    @for line in S::details(artifact) { span.detail { (line) } }
                }
                (S::score_cells(artifact))
            }
        }
    };
    html! {
        section #scores aria-labelledby="scores-title" {
            h2 #scores-title { (title) }
            p.note { (note) }
            @if !differences.is_empty() {
                p.notice #protocol-differs data-differences=(differences.join(" ")) {
                    strong { "These rollouts were not made under the same protocol." }
                    " They differ in " (differences.join(", ").replace('_', " ")) ". Take this into account when you compare rows; see "
                    a href="#protocol" { "the protocol" } " for details."
                }
            }
            (table(name, "scroll", class, score_columns, &rows))
            (summary.tables[0])
        }
    }
}

/// A result with its interval, as text and as a bar from 0 to 1. A tick on the bar marks the paper's result.
pub(super) fn figure(metric: &str, interval: Interval, paper: Option<f64>) -> Markup {
    let at = |value: f64| format!("{:.2}", 100.0 * value.clamp(0.0, 1.0));
    let Interval { value, low, high } = interval;
    html! {
        td.figure data-metric=(metric) data-value=(exact(value)) data-low=(exact(low)) data-high=(exact(high)) {
            span.value { (short(value)) }
            span.interval { "[" (short(low)) ", " (short(high)) "]" }
            @if value.is_finite() {
                svg.bar viewBox="0 0 100 8" preserveAspectRatio="none" aria-hidden="true" {
                    line.track x1="0" x2="100" y1="4" y2="4" {}
                    line.span x1=(at(low)) x2=(at(high)) y1="4" y2="4" {}
                    @if let Some(paper) = paper { line.tick x1=(at(paper)) x2=(at(paper)) y1="0" y2="8" {} }
                    line.dot x1=(at(value)) x2=(at(value)) y1="4" y2="4" {}
                }
            }
        }
    }
}

/// The viewer of rollouts; the script fills it.
pub(super) fn viewer<S: Scene>(summary: &Summary<S>) -> Markup {
    html! {
        section #viewer aria-labelledby="viewer-title" tabindex="-1" {
            div.heading {
                h2 #viewer-title { "Rollout viewer" }
                div.pick {
                    label { span { "Policy" } select #pick-artifact {
                        @for (i, label) in summary.labels.iter().enumerate() { option value=(i) { (label) } }
                    } }
                    label { span #seed-noun { "Seed" } select #pick-seed {} }
                    div.pair {
                        button #previous-seed type="button" aria-label="Previous rollout" title="Previous rollout" { "‹" }
                        button #next-seed type="button" aria-label="Next rollout" title="Next rollout" { "›" }
                    }
                }
            }
            @if summary.report.artifacts.iter().all(|artifact| artifact.shown().next().is_none()) {
                p.notice { "This page contains no rollouts for the viewer." }
            }
            div class=(S::WORDS.stage) {
                figure.card.scene {
                    figcaption {
                        h3 { "Scene" }
                        p #scene-caption {}
                    }
                    div #scene {}
                    ul.legend #legend {}
                }
                (transport())
                div.card.why {
                    div.row {
                        h3 #decision-title {}
                        span.badge #phase {}
                    }
                    p.reason #reason aria-live="polite" {}
                    (S::evidence(summary.report))
                }
            }
        }
    }
}

/// The controls for playing and stepping, and the timeline.
fn transport() -> Markup {
    let button = |id: &str, name: &str, keys: &str, sign: &str| {
        html! { button id=(id) type="button" aria-label=(name) title={ (name) " (" (keys) ")" } { (sign) } }
    };
    html! {
        div.card.transport {
            div.row {
                div.buttons {
                    (button("previous-decision", "Previous decision", "↑ or [", "⇤"))
                    (button("previous-step", "Previous step", "←", "←"))
                    button.primary #play type="button" title="Play or pause (k)" { "Play" }
                    (button("next-step", "Next step", "→", "→"))
                    (button("next-decision", "Next decision", "↓ or ]", "⇥"))
                }
                label.speed { span { "Speed" } select #speed {
                    option value="0.5" { "½×" }
                    option value="1" selected { "1×" }
                    option value="2" { "2×" }
                    option value="5" { "5×" }
                } }
            }
            output #step-text {}
            label.hidden for="scrubber" { "Control step" }
            input #scrubber type="range" min="0" max="0" value="0" step="1";
            div.plot #timeline {}
            p.hint.keys {
                span { kbd { "←" } kbd { "→" } " step" }
                span { kbd { "↑" } kbd { "↓" } " decision" }
                span { kbd { "k" } " play" }
                span { kbd { "Home" } kbd { "End" } }
            }
        }
    }
}

/// The table of rollouts, which the script fills, and further tables.
pub(super) fn tables<S: Scene>(summary: &Summary<S>) -> Markup {
    html! {
        section #tables aria-labelledby="tables-title" {
            h2 #tables-title { "Results per rollout" }
            details.card open {
                summary { "Rollouts of " span #seeds-of { (summary.labels.first().map_or("", String::as_str)) } }
                div.scroll.tall tabindex="0" role="region" aria-label="Seeds" {
                    table.plain.sortable #seeds {
                        thead { tr {
                            @for (column, words, precise) in S::WORDS.columns {
                                th.figure scope="col" { button type="button" data-column=(column) data-precise[*precise] { (words) } }
                            }
                        } }
                        tbody {}
                    }
                }
            }
            (summary.tables[1])
        }
    }
}

/// The protocol and the settings, one entry per row.
pub(super) fn protocol<S: Scene>(summary: &Summary<S>) -> Markup {
    html! {
        section #protocol aria-labelledby="protocol-title" {
            h2 #protocol-title { "Protocol" }
            p.note {
                @if summary.labels.len() > 1 && summary.differences().is_empty() { "All rollouts were made under the same protocol. " }
                (S::WORDS.comparison)
            }
            div.card { (fact_table("Protocol", &summary.protocol, &summary.labels)) }
            details.card {
                summary { "Settings of the policies" }
                (fact_table("Settings", &summary.settings, &summary.labels))
            }
        }
    }
}

fn fact_table(name: &str, rows: &[Row], labels: &[String]) -> Markup {
    html! {
        div.scroll tabindex="0" role="region" aria-label=(name) {
            table.plain.summary {
                thead { tr {
                    th scope="col" { (name) }
                    @for (i, label) in labels.iter().enumerate() { th scope="col" { span.name { (named(i, label)) } } }
                } }
                tbody {
                    @for row in rows {
                        tr.differs[row.differs()] data-fact=(row.name) {
                            th scope="row" { (row.name.replace('_', " ")) @if row.differs() { span.badge { "differs" } } }
                            @if row.differs() {
                                @for value in &row.values { td { (stated(value)) } }
                            } @else if let Some(value) = row.values.first() {
                                td colspan=(row.values.len()) { (stated(value)) }
                            }
                        }
                    }
                }
            }
        }
    }
}

fn stated(value: &str) -> &str {
    if value.is_empty() { "–" } else { value }
}

/// The footer: how the page was generated, and from which artifacts.
pub(super) fn footer<S: Scene>(summary: &Summary<S>) -> Markup {
    let artifacts = summary.report.artifacts.iter().zip(&summary.labels);
    shell::footer(
        &html! { (summary.report.tool_version) " from these artifacts" },
        artifacts.map(|(artifact, label)| (label.as_str(), "rollouts", artifact.key.as_str())),
    )
}
