//! The sections of the page, except the curves.

use maud::{Markup, html};
use re4_compare::{CellRow, DifferenceRow, Measure};
use re4_stats::RESAMPLES;

use super::format::{date, probability, signed, size, span, time};
use super::{Cell, Comparison, Cost, Times, Training};
use crate::html::shell::{self, exact, plural, short, table as framed};

pub(super) fn header(page: &Comparison) -> Markup {
    let ran = page.cells.iter().filter(|cell| cell.first().error.is_none());
    let (all, ran) = (page.cells.len(), ran.count());
    let lead = html! {
        @if !page.about.is_empty() { (page.about) " " }
        strong data-fact="ran" data-value=(ran) { (ran) " of " (plural(all, "cell", "cells")) } " ran"
        @if let Some(baseline) = &page.baseline { "; differences are from " strong { (baseline) } } "."
    };
    shell::header(
        "compare",
        &page.title,
        &lead,
        "",
        &html! {
            @for warning in &page.warnings { p.notice.warning { "Warning: " (warning) "." } }
        },
    )
}

/// The table of all cells: our figure, its interval, and the printed figure.
pub(super) fn table(page: &Comparison) -> Markup {
    let printed = page.columns.iter().any(|column| !column.printed.is_empty());
    html! {
        section aria-labelledby="table-title" {
            h2 #table-title { "Scores" }
            p.note {
                "Mean over the rollouts with its 95 % interval."
                @if printed {
                    " The vertical mark and the figure below it are printed in "
                    @if page.printed_in.is_empty() { "the source that the suite names" } @else { (page.printed_in) } "."
                }
            }
            div.scroll tabindex="0" role="region" aria-label="Scores" {
                table.cells {
                    thead { tr {
                        th scope="col" { "policy" }
                        @for column in &page.columns {
                            th scope="col" {
                                (column.name)
                                @if let Some(measure) = page.printed_measure(&column.name) { span.measure { (measure.title()) } }
                            }
                        }
                    } }
                    tbody { @for row in &page.rows { (table_row(page, row)) } }
                }
            }
        }
    }
}

fn table_row(page: &Comparison, row: &str) -> Markup {
    html! {
        tr.baseline[page.is_baseline(row)] {
            th scope="row" { (row) @if page.is_baseline(row) { span.measure { "baseline" } } }
            @for column in &page.columns {
                @let printed = column.printed.get(row).copied();
                td data-row=(row) data-column=(column.name) {
                    @match page.cell(row, &column.name) {
                        Some(cell) => {
                            @if cell.first().error.is_some() { span.badge.failed { "cannot run" } }
                            @else { (figure(cell.first(), printed)) }
                        }
                        None => span.left-out title="left out" { "–" },
                    }
                    @if let Some(printed) = printed {
                        span.printed data-printed=(exact(printed)) { "printed " (short(printed)) }
                    }
                }
            }
        }
    }
}

/// A figure with its interval as text and as a bar from 0 to 1, on which a mark shows the printed figure.
fn figure(score: &CellRow, printed: Option<f64>) -> Markup {
    let [value, low, high] = [score.value, score.low, score.high].map(|number| number.unwrap_or(f64::NAN));
    let at = |value: f64| format!("{:.1}", 100.0 * value.clamp(0.0, 1.0));
    html! {
        span.value data-value=(exact(value)) data-low=(exact(low)) data-high=(exact(high)) { (short(value)) }
        span.interval { "[" (short(low)) ", " (short(high)) "]" }
        svg.bar viewBox="0 0 100 8" preserveAspectRatio="none" aria-hidden="true" {
            line.track x1="0" x2="100" y1="4" y2="4" {}
            line.span x1=(at(low)) x2=(at(high)) y1="4" y2="4" {}
            line.dot x1=(at(value)) x2=(at(value)) y1="4" y2="4" {}
            @if let Some(printed) = printed { line.tick x1=(at(printed)) x2=(at(printed)) y1="-2" y2="10" {} }
        }
    }
}

/// The cells that cannot run, each with its sentence.
pub(super) fn failures(page: &Comparison) -> Markup {
    let failed = page
        .cells
        .iter()
        .filter_map(|cell| Some((cell.first(), cell.first().error.as_ref()?)));
    let mut sentences: Vec<(&str, Vec<String>)> = Vec::new();
    for (score, sentence) in failed {
        let name = format!("{}, {}", score.row, score.column);
        match sentences.iter_mut().find(|(known, _)| known == sentence) {
            Some((_, names)) => names.push(name),
            None => sentences.push((sentence, vec![name])),
        }
    }
    html! {
        @if !sentences.is_empty() {
            section aria-labelledby="failed-title" {
                h2 #failed-title { "Cells that cannot run" }
                p.note { "The other cells ran. The next run tries these again." }
                div.card { ul.failures {
                    @for (sentence, names) in &sentences {
                        li { p { (sentence) } p.names { (names.join(" · ")) } }
                    }
                } }
            }
        }
    }
}

/// Paired differences of the printed measures, column by column.
pub(super) fn differences(page: &Comparison) -> Markup {
    let Some(baseline) = page.baseline.as_ref().filter(|_| !page.differences.is_empty()) else {
        return html! {};
    };
    let printed = |row: &&DifferenceRow| page.printed_measure(&row.column) == Some(row.measure);
    let (first, others): (Vec<_>, Vec<_>) = page.differences.iter().partition(printed);
    html! {
        section aria-labelledby="differences-title" {
            h2 #differences-title { "Differences from " (baseline) }
            p.note {
                "Both policies start from the same seeds, so each seed is a pair. Intervals: percentile bootstrap over pairs, 95 %, "
                (RESAMPLES / 1000) ",000 resamples, seed 0. p: exact sign test of the seeds on which the policies differ; for success this is "
                "the exact McNemar test; it asks on which side more seeds are, not how large their differences are. p is not corrected for the "
                "number of comparisons. Colored: the interval excludes 0 and p < 0.05."
            }
            div.card { (difference_table("Paired differences", &first)) }
            @if !others.is_empty() {
                details.card { summary { "Differences of the other measures" } (difference_table("Other differences", &others)) }
            }
        }
    }
}

fn difference_table(name: &str, rows: &[&DifferenceRow]) -> Markup {
    // The axis of all intervals contains 0.
    let ends = || {
        rows.iter()
            .flat_map(|row| [row.low, row.high])
            .filter(|end| end.is_finite())
    };
    let axis = [ends().fold(-0.02, f64::min), ends().fold(0.02, f64::max)];
    let columns = [
        ("column", false),
        ("policy", false),
        ("measure", false),
        ("difference", true),
        ("interval", true),
        ("", false),
        ("better", true),
        ("worse", true),
        ("equal", true),
        ("p", true),
    ];
    let body = html! {
        @for (number, row) in rows.iter().enumerate() {
            @let new = number == 0 || rows.get(number.wrapping_sub(1)).is_some_and(|last| last.column != row.column);
            @let clear = row.p < 0.05 && (row.low > 0.0 || row.high < 0.0);
            tr.group[new] data-difference=(row.row) data-column=(row.column) data-measure=(row.measure.as_str()) data-value=(exact(row.difference)) data-p=(exact(row.p)) {
                td { @if new { (row.column) } }
                th scope="row" { (row.row) }
                td { (row.measure.title()) }
                td.figure.difference.ahead[clear && row.difference > 0.0].behind[clear && row.difference < 0.0] { (signed(row.difference)) }
                td.figure.interval { "[" (signed(row.low)) ", " (signed(row.high)) "]" }
                td { (whisker(row, axis)) }
                td.figure { (row.better) }
                td.figure { (row.worse) }
                td.figure { (row.equal) }
                td.figure { (probability(row.p)) }
            }
        }
    };
    framed(name, "scroll", "differences", &columns, &body)
}

/// The interval of a difference on an axis with a mark at 0.
fn whisker(row: &DifferenceRow, [low, high]: [f64; 2]) -> Markup {
    let at = |value: f64| format!("{:.1}", 6.0 + 148.0 * (value.clamp(low, high) - low) / (high - low));
    html! {
        svg.whiskers viewBox="0 0 160 14" aria-hidden="true" {
            line.zero x1=(at(0.0)) x2=(at(0.0)) y1="0" y2="14" {}
            line.range x1=(at(row.low)) x2=(at(row.high)) y1="7" y2="7" {}
            circle cx=(at(row.difference)) cy="7" r="3.2" {}
        }
    }
}

/// Training, time per action, and size of every cell that ran.
pub(super) fn costs(page: &Comparison) -> Markup {
    let columns = [
        ("column", false),
        ("policy", false),
        ("training", true),
        ("action, p50", true),
        ("p99", true),
        ("decision, p50", true),
        ("p99", true),
        ("carried", true),
        ("threads", true),
        ("measured", true),
    ];
    let ran: Vec<&Cell> = page.cells.iter().filter(|cell| cell.first().error.is_none()).collect();
    let body = html! {
        @for (number, cell) in ran.iter().enumerate() {
            @let new = number == 0 || ran.get(number.wrapping_sub(1)).is_some_and(|last| last.first().column != cell.first().column);
            tr.group[new] data-cost=(cell.first().row) data-column=(cell.first().column) {
                td { @if new { (cell.first().column) } }
                th scope="row" { (cell.first().row) }
                (cost(cell.cost.as_ref()))
                td.figure { @if let Some(bytes) = cell.first().carried { (size(bytes)) } @else { "–" } }
                td.figure { @if let Some(threads) = cell.cost.as_ref().and_then(|cost| cost.threads) { (threads) } @else { "–" } }
                td.figure { @if let Some(finished) = cell.cost.as_ref().and_then(|cost| cost.finished) { (date(finished)) } @else { "–" } }
            }
        }
    };
    let unrecorded = ran
        .iter()
        .any(|cell| cell.cost.as_ref().is_none_or(Cost::lacks_a_record));
    html! {
        @if !ran.is_empty() {
            section aria-labelledby="costs-title" {
                h2 #costs-title { "Costs" }
                p.note {
                    "Training: wall time of the stages that train or calibrate. Action: wall time of a call of the policy, including "
                    "the images and pose estimates that it requests, over all control steps of all rollouts; decision: the calls "
                    "in which it made a decision. Quantiles are exact to 0.4 %. Threads: rollouts that ran at the same time, which "
                    "slows each of them down. Carried: size of the artifacts and files that the policy opens."
                }
                @if unrecorded {
                    p.notice.unrecorded { "Some times have no record: the artifacts were copied here without the folder runs, or an earlier version of the program made them." }
                }
                div.card { (framed("Costs", "scroll", "costs", &columns, &body)) }
            }
        }
    }
}

impl Cost {
    fn lacks_a_record(&self) -> bool {
        self.actions.is_none() || self.training == Training::Unrecorded
    }
}

fn cost(cost: Option<&Cost>) -> Markup {
    let training = match cost.map(|cost| cost.training) {
        Some(Training::Nothing) => "none".to_owned(),
        Some(Training::Took(seconds)) => span(seconds),
        Some(Training::Unrecorded) | None => "–".to_owned(),
    };
    let quantiles = |times: Option<Times>| times.map_or([None; 2], |times| [Some(times.p50), Some(times.p99)]);
    let [actions, decisions] =
        [cost.and_then(|cost| cost.actions), cost.and_then(|cost| cost.decisions)].map(quantiles);
    html! {
        td.figure { (training) }
        @for value in actions.into_iter().chain(decisions) {
            td.figure { @if let Some(value) = value { (time(value)) } @else { "–" } }
        }
    }
}

/// A table for every measure, folded.
pub(super) fn measures(page: &Comparison) -> Markup {
    let measures = page.measures();
    html! {
        @if measures.len() > 1 {
            section aria-labelledby="measures-title" {
                h2 #measures-title { "All measures" }
                @for measure in measures { (measure_table(page, measure)) }
            }
        }
    }
}

fn measure_table(page: &Comparison, measure: Measure) -> Markup {
    let of = |row: &str, column: &str| page.cell(row, column)?.score(measure);
    let has = |column: &&str| page.rows.iter().any(|row| of(row, column).is_some());
    let names: Vec<&str> = page
        .columns
        .iter()
        .map(|column| column.name.as_str())
        .filter(has)
        .collect();
    let columns: Vec<(&str, bool)> = [("policy", false)]
        .into_iter()
        .chain(names.iter().map(|name| (*name, true)))
        .collect();
    let body = html! {
        @for row in &page.rows {
            tr {
                th scope="row" { (row) }
                @for column in &names {
                    td.figure {
                        @match of(row, column) {
                            Some(CellRow { value: Some(value), low: Some(low), high: Some(high), .. }) => {
                                b { (short(*value)) } " " span.interval { "[" (short(*low)) ", " (short(*high)) "]" }
                            }
                            _ => "–",
                        }
                    }
                }
            }
        }
    };
    html! {
        details.card {
            summary { (measure.title()) }
            (framed(measure.title(), "scroll", "plain", &columns, &body))
        }
    }
}

/// The pipelines, seeds and overrides of all cells.
pub(super) fn protocol(page: &Comparison) -> Markup {
    let columns = [
        ("column", false),
        ("policy", false),
        ("kind", false),
        ("pipeline", false),
        ("rollouts", true),
        ("steps", true),
        ("seeds", false),
        ("overrides", false),
    ];
    let body = html! {
        @for (number, cell) in page.cells.iter().enumerate() {
            @let score = cell.first();
            @let new = number == 0 || page.cells.get(number.wrapping_sub(1)).is_some_and(|last| last.first().column != score.column);
            tr.group[new] {
                td { @if new { (score.column) } }
                th scope="row" { (score.row) }
                td { @if let Some(policy) = &score.policy { code { (policy) } } @else { "–" } }
                td { code { (score.pipeline) } }
                td.figure { @if let Some(rollouts) = score.rollouts { (rollouts) } @else { "–" } }
                td.figure { @if let Some(steps) = score.max_steps { (steps) } @else { "–" } }
                td { @if let Some(seeds) = &score.seeds { (seeds) } @else { "–" } }
                td.overrides { @for setting in &cell.overrides { code { (setting) } " " } }
            }
        }
    };
    html! {
        section aria-labelledby="protocol-title" {
            h2 #protocol-title { "Protocol" }
            p.note {
                "Score, coverage and IoU are the maximum over the steps of an episode; score = min(coverage / 0.95, 1). Ranges of "
                "seeds exclude their end. A cell is repeated by " code { "re4-pipe run PIPELINE --set OVERRIDE ..." } "."
            }
            details.card { summary { "Pipelines, seeds and overrides of all cells" } (framed("Protocol", "scroll", "plain", &columns, &body)) }
        }
    }
}
