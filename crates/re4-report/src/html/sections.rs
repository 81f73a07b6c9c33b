//! The parts of the page.

use maud::{Markup, html};

use super::common::{choice, exact, plural, short};
use super::facts::{Curve, Facts, Row};
use super::paper::{self, Demonstrations};
use super::{Report, Rollouts, Starts, Taken};
use re4_stats::Interval;

/// Distinct marks for this many artifacts; further ones repeat them.
const MARKS: usize = 8;

/// The page's first sentence names this many artifacts at most.
const MOST_NAMED: usize = 4;

pub(super) fn mark(artifact: usize) -> Markup {
    html! {
        svg class={ "mark series-" (artifact % MARKS) } viewBox="-6 -6 12 12" width="12" height="12" aria-hidden="true" {
            path data-mark=(artifact % MARKS) {}
        }
    }
}

/// The title, and what the page is about.
pub(super) fn header(report: &Report, facts: &Facts) -> Markup {
    let rollouts: usize = report.artifacts.iter().map(|artifact| artifact.rollouts.len()).sum();
    html! {
        header.page {
            p.eyebrow { "re4-pipe · rollouts" }
            h1 { "Push-T" }
            p.lead {
                (plural(rollouts, "rollout", "rollouts")) " of "
                @if facts.labels.len() > MOST_NAMED {
                    strong { (facts.labels.len()) } " policies and protocols"
                } @else {
                    @for (i, label) in facts.labels.iter().enumerate() {
                        @if i > 0 { @if i + 1 == facts.labels.len() { " and " } @else { ", " } }
                        strong { (label) }
                    }
                }
                ". Every action can be traced to the demonstration that it was taken from."
            }
            noscript { p.notice { "The plots and the viewer need JavaScript; the tables do not." } }
        }
    }
}

/// The score table, and the paper's.
pub(super) fn scores(report: &Report, facts: &Facts) -> Markup {
    let differences = facts.differences();
    html! {
        section #scores aria-labelledby="scores-title" {
            h2 #scores-title { "Scores" }
            p.note {
                "Mean over rollouts of the greatest value within a rollout, with 95 % intervals. "
                "Scaled score is min(coverage / 0.95, 1). The paper’s measure is its “maximum coverage per episode”, without intervals; "
                "it is set beside the scaled score, which is what the field reports, and marked there in blue."
            }
            @if !differences.is_empty() {
                p.notice #protocol-differs data-differences=(differences.join(" ")) {
                    strong { "These rollouts were not made under one protocol." }
                    " They differ in " (differences.join(", ").replace('_', " ")) ". Compare rows with that in mind; "
                    a href="#protocol" { "the protocol" } " has the details."
                }
            }
            div.scroll tabindex="0" role="region" aria-label="Score table" {
                table.scores {
                    thead { tr {
                        th scope="col" { "Policy" }
                        th.figure scope="col" { "Scaled score" }
                        th.figure scope="col" { "Raw coverage" }
                        th.figure scope="col" { "IoU" }
                        th.figure scope="col" { "Success rate" }
                        th.figure scope="col" { "The paper" }
                    } }
                    tbody {
                        @for (i, artifact) in report.artifacts.iter().enumerate() {
                            (score_row(i, artifact, &facts.labels[i]))
                        }
                    }
                }
            }
            (paper_table())
        }
    }
}

fn score_row(number: usize, artifact: &Rollouts, label: &str) -> Markup {
    let printed = paper_counterpart(artifact);
    let metrics = &artifact.metrics;
    html! {
        tr data-artifact=(artifact.key) {
            th scope="row" {
                span.name { (mark(number)) (label) }
                @for line in details(artifact) { span.detail { (line) } }
            }
            (figure("score_scaled_mean", metrics.score_scaled_mean, printed.map(|(_, value)| value)))
            (figure("coverage_raw_mean", metrics.coverage_raw_mean, None))
            (figure("iou_mean", metrics.iou_mean, None))
            (figure("success_rate", metrics.success_rate, None))
            td.figure.paper {
                @match printed {
                    Some((method, value)) => {
                        span.value data-paper=(exact(value)) { (short(value)) }
                        span.interval { (method) ", " (artifact.variant) }
                    }
                    None => { span.value { "–" } span.interval { "has no such figure" } }
                }
            }
        }
    }
}

fn details(artifact: &Rollouts) -> [String; 2] {
    let demos = match (artifact.demonstrations_taken, artifact.demonstrations) {
        (Taken::All, Some(count)) => format!("all {count} demonstrations"),
        (Taken::First(count), _) => format!("first {count} demonstrations"),
        (Taken::Other, Some(count)) => format!("{count} chosen demonstrations"),
        (_, None) => "demonstrations not counted".to_owned(),
    };
    let steps = plural(artifact.max_steps as usize, "step", "steps");
    let changed = if artifact.altered { " · settings changed" } else { "" };
    [
        format!("{} · {demos}{changed}", artifact.variant),
        format!("{} · {steps}", artifact.scenes),
    ]
}

/// The paper's figure for the same experiment: its dataset, scenes from seeds, its number of steps, a preset as it is.
fn paper_counterpart(artifact: &Rollouts) -> Option<(&'static str, f64)> {
    let experiment = (artifact.dataset_demonstrations, artifact.starts, artifact.max_steps);
    if experiment != (Some(paper::DEMONSTRATIONS), Starts::Seeds, paper::MAX_STEPS) {
        return None;
    }
    if artifact.altered {
        return None;
    }
    let demonstrations = match artifact.demonstrations_taken {
        Taken::All => Demonstrations::All,
        Taken::First(50) => Demonstrations::First50,
        _ => return None,
    };
    paper::counterpart(&artifact.preset, &artifact.variant, demonstrations)
}

/// A figure with its interval, in digits and as a bar from 0 to 1 on which a tick marks the paper's figure.
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

fn paper_table() -> Markup {
    let cell = |value: Option<f64>| {
        html! { td.figure { @match value { Some(value) => span data-paper=(exact(value)) { (short(value)) }, None => "–" } } }
    };
    html! {
        details.card {
            summary { "What the paper reports for Push-T" }
            div.scroll tabindex="0" role="region" aria-label="Figures of the paper" {
                table.plain {
                    thead {
                        tr {
                            th rowspan="2" scope="col" { "Method" }
                            th.figure colspan="2" scope="colgroup" { "All 206 demonstrations" }
                            th.figure colspan="2" scope="colgroup" { "First 50" }
                        }
                        tr { @for _ in 0..2 { th.figure scope="col" { "State" } th.figure scope="col" { "Image" } } }
                    }
                    tbody {
                        @for row in paper::ROWS {
                            tr {
                                th scope="row" { (row.method) }
                                @for value in row.all { (cell(value)) }
                                @for value in row.first_50 { (cell(value)) }
                            }
                        }
                    }
                }
            }
            p.note { (paper::SOURCE) ". Mean over 100 seeds of each episode’s greatest coverage." }
        }
    }
}

/// Places for the plots, which the script draws, and the figures behind the budget curve.
pub(super) fn plots(facts: &Facts) -> Markup {
    html! {
        section #plots aria-labelledby="plots-title" {
            div.heading {
                h2 #plots-title { "Every rollout" }
                ul.legend { @for (i, label) in facts.labels.iter().enumerate() { li { (mark(i)) (label) } } }
            }
            div.columns {
                figure.card {
                    figcaption {
                        h3 { "One mark a rollout" }
                        div.choices {
                            (choice("measure", "Measure", &[("score", "Score"), ("coverage", "Coverage"), ("iou", "IoU")]))
                            (choice("order", "Order", &[("rank", "By value"), ("seed", "By seed")]))
                        }
                    }
                    div.plot #seed-plot {}
                    p.hint { "Filled marks succeeded. Click one, or use the arrow keys in the plot, to see it in the viewer." }
                }
                figure.card {
                    figcaption {
                        h3 { "What fewer steps would reach" }
                        div.choices { (choice("budget-measure", "Measure", &[("score", "Score"), ("coverage", "Coverage")])) }
                    }
                    div.plot #budget-plot {}
                    p.hint { "Mean of the running maximum; a rollout that succeeded keeps its own. Bars are 95 % intervals." }
                }
            }
        }
    }
}

/// The viewer; the script fills it.
pub(super) fn viewer(report: &Report, facts: &Facts) -> Markup {
    html! {
        section #viewer aria-labelledby="viewer-title" tabindex="-1" {
            div.heading {
                h2 #viewer-title { "Rollout viewer" }
                div.pick {
                    label { span { "Policy" } select #pick-artifact {
                        @for (i, label) in facts.labels.iter().enumerate() { option value=(i) { (label) } }
                    } }
                    label { span #seed-noun { "Seed" } select #pick-seed {} }
                    div.pair {
                        button #previous-seed type="button" aria-label="Previous rollout" title="Previous rollout" { "‹" }
                        button #next-seed type="button" aria-label="Next rollout" title="Next rollout" { "›" }
                    }
                }
            }
            @if report.artifacts.iter().all(|artifact| artifact.rollouts.iter().all(|rollout| !rollout.shown)) {
                p.notice { "No rollout is embedded in this page." }
            }
            div.stage {
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
                    div.evidence {
                        figure.demo {
                            div #demo {}
                            figcaption #demo-note {}
                        }
                        dl.facts #facts {}
                    }
                }
            }
        }
    }
}

pub(super) fn transport() -> Markup {
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

/// The table of seeds, which the script fills, and the figures of the budget curve.
pub(super) fn seeds(facts: &Facts) -> Markup {
    html! {
        section #tables aria-labelledby="tables-title" {
            h2 #tables-title { "Figures" }
            details.card open {
                summary { "Rollouts of " span #seeds-of {} }
                div.scroll.tall tabindex="0" role="region" aria-label="Seeds" {
                    table.plain.sortable #seeds {
                        thead { tr {
                            @for (column, words) in [
                                ("seed", "Seed"), ("score", "Scaled score"), ("coverage", "Raw coverage"), ("iou", "IoU"),
                                ("coverage_final", "Last coverage"), ("steps", "Steps"), ("decisions", "Decisions"), ("success", "Success"),
                            ] {
                                th.figure scope="col" { button type="button" data-column=(column) { (words) } }
                            }
                        } }
                        tbody {}
                    }
                }
            }
            details.card {
                summary { "Mean of the running maximum by step budget" }
                div.scroll tabindex="0" role="region" aria-label="Step budgets" {
                    table.plain #budgets {
                        thead { tr {
                            th scope="col" { "Policy" }
                            th.figure scope="col" { "Steps" }
                            th.figure scope="col" { "Scaled score" }
                            th.figure scope="col" { "Raw coverage" }
                        } }
                        tbody { @for (i, curve) in facts.curves.iter().enumerate() { (budget_rows(i, &facts.labels[i], curve)) } }
                    }
                }
            }
        }
    }
}

fn budget_rows(number: usize, label: &str, curve: &Curve) -> Markup {
    let cell = |name: &str, Interval { value, low, high }: Interval| {
        html! {
            td.figure data-budget-metric=(name) data-value=(exact(value)) data-low=(exact(low)) data-high=(exact(high)) {
                (short(value)) " " span.interval { "[" (short(low)) ", " (short(high)) "]" }
            }
        }
    };
    html! {
        @for (i, budget) in curve.budgets.iter().enumerate() {
            tr data-series=(number) data-budget=(budget) {
                th scope="row" { span.name { (mark(number)) (label) } }
                td.figure { (budget) }
                (cell("score", curve.score[i]))
                (cell("coverage", curve.coverage[i]))
            }
        }
    }
}

/// Protocol and settings, fact by fact.
pub(super) fn protocol(report: &Report, facts: &Facts) -> Markup {
    html! {
        section #protocol aria-labelledby="protocol-title" {
            h2 #protocol-title { "Protocol" }
            p.note {
                @if report.artifacts.len() > 1 && facts.differences().is_empty() { "All rollouts were made under one protocol. " }
                "Scores of different protocols must not be compared."
            }
            div.card { (fact_table("Protocol", &facts.protocol, &facts.labels)) }
            details.card {
                summary { "Settings of the policies" }
                (fact_table("Settings", &facts.settings, &facts.labels))
            }
        }
    }
}

pub(super) fn fact_table(name: &str, rows: &[Row], labels: &[String]) -> Markup {
    html! {
        div.scroll tabindex="0" role="region" aria-label=(name) {
            table.plain.facts {
                thead { tr {
                    th scope="col" { (name) }
                    @for (i, label) in labels.iter().enumerate() { th scope="col" { span.name { (mark(i)) (label) } } }
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

/// Where the page is from.
pub(super) fn footer(report: &Report, facts: &Facts) -> Markup {
    html! {
        footer.page {
            p { "Made by re4-pipe " (report.tool_version) " from these artifacts; the same artifacts give the same page." }
            ul {
                @for (artifact, label) in report.artifacts.iter().zip(&facts.labels) {
                    li { (label) " " code { "rollouts/" (artifact.key.get(..16).unwrap_or(&artifact.key)) } }
                }
            }
        }
    }
}
