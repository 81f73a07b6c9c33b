//! The sections that only the page of Push-T has.

use maud::{Markup, html};
use re4_stats::Interval;

use super::paper::{self, Demonstrations};
use super::{Curve, Plane, Starts, Taken};
use crate::html::rollouts::Rollouts;
use crate::html::rollouts::sections::{figure, named};
use crate::html::shell::{choice, exact, short, table};

/// The results of an artifact, and the corresponding result of the paper.
pub(super) fn score_cells(artifact: &Rollouts<Plane>) -> Markup {
    let printed = paper_counterpart(artifact);
    let metrics = &artifact.scene.metrics;
    html! {
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
                None => { span.value { "–" } span.interval { "not reported" } }
            }
        }
    }
}

/// Returns the paper's result for the same experiment. The experiment is the same if it has the paper's dataset, scenes from seeds,
/// the paper's number of steps, the conditions of the task and an unchanged preset.
fn paper_counterpart(artifact: &Rollouts<Plane>) -> Option<(&'static str, f64)> {
    let experiment = (artifact.scene.in_dataset, artifact.scene.starts, artifact.max_steps);
    if experiment != (Some(paper::DEMONSTRATIONS), Starts::Seeds, paper::MAX_STEPS) {
        return None;
    }
    if artifact.altered || !artifact.conditions().is_empty() {
        return None;
    }
    let demonstrations = match artifact.scene.taken {
        Taken::All => Demonstrations::All,
        Taken::First(50) => Demonstrations::First50,
        _ => return None,
    };
    paper::counterpart(&artifact.preset, &artifact.variant, demonstrations)
}

/// The table of all results that the paper reports.
pub(super) fn paper_table() -> Markup {
    let cell = |value: Option<f64>| {
        html! { td.figure { @match value { Some(value) => span data-paper=(exact(value)) { (short(value)) }, None => "–" } } }
    };
    html! {
        details.card {
            summary { "Results of the RE4 paper for Push-T" }
            div.scroll tabindex="0" role="region" aria-label="Results of the paper" {
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
            p.note { (paper::SOURCE) ". Mean over 100 seeds of the maximum coverage of each episode." }
        }
    }
}

/// The section of plots, which the script renders.
pub(super) fn plots(labels: &[String]) -> Markup {
    html! {
        section #plots aria-labelledby="plots-title" {
            div.heading {
                h2 #plots-title { "All rollouts" }
                ul.legend { @for (i, label) in labels.iter().enumerate() { li { (named(i, label)) } } }
            }
            div.columns {
                figure.card {
                    figcaption {
                        h3 { "Result of each rollout" }
                        div.choices {
                            (choice("measure", "Measure", &[("score", "Score"), ("coverage", "Coverage"), ("iou", "IoU")]))
                            (choice("order", "Order", &[("rank", "By value"), ("seed", "By seed")]))
                        }
                    }
                    div.plot #seed-plot {}
                    p.hint { "A filled mark is a success. Click a mark, or use the arrow keys in the plot, to show the rollout in the viewer." }
                }
                figure.card {
                    figcaption {
                        h3 { "Result by step budget" }
                        div.choices { (choice("budget-measure", "Measure", &[("score", "Score"), ("coverage", "Coverage")])) }
                    }
                    div.plot #budget-plot {}
                    p.hint { "Mean over rollouts of the running maximum. A rollout that has ended keeps its maximum. Bars are 95 % intervals." }
                }
            }
        }
    }
}

/// The recorded chunk, and the data of a decision; the script fills both.
pub(super) fn evidence() -> Markup {
    html! {
        div.evidence {
            figure.demo {
                div #demo {}
                figcaption #demo-note {}
            }
            dl.summary #summary {}
        }
    }
}

/// The table of results by step budget.
pub(super) fn budgets(labels: &[String], curves: &[Curve]) -> Markup {
    let columns = [
        ("Policy", false),
        ("Steps", true),
        ("Scaled score", true),
        ("Raw coverage", true),
    ];
    let rows = html! { @for (i, curve) in curves.iter().enumerate() { (budget_rows(i, &labels[i], curve)) } };
    html! {
        details.card #budgets {
            summary { "Mean of the running maximum by step budget" }
            (table("Step budgets", "scroll", "plain", &columns, &rows))
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
                th scope="row" { span.name { (named(number, label)) } }
                td.figure { (budget) }
                (cell("score", curve.score[i]))
                (cell("coverage", curve.coverage[i]))
            }
        }
    }
}
