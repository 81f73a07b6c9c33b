//! The sections about the quality of demonstrations: scores, the keep-list, and what was left out.

use maud::{Markup, html};
use re4_scores::{Better, KINDS, Kind, correlation};

use super::Audit;
use crate::html::shell::{exact, plural, table};

/// What each score measures, for the table of correlations.
fn better(kind: &Kind) -> &'static str {
    match kind.better {
        Better::Higher => "higher is better",
        Better::Lower => "lower is better",
        Better::Neither => "neither is better",
    }
}

/// The scores that any demonstration has.
fn known(audit: &Audit) -> Vec<&'static Kind> {
    let has = |kind: &&Kind| audit.scores.iter().any(|row| (kind.value)(&row.scores).is_some());
    KINDS.iter().filter(has).collect()
}

/// Orders of the timelines by score.
pub(super) fn orders(audit: &Audit) -> Markup {
    html! {
        @if !audit.scores.is_empty() {
            option value="score quality" { "quality, worst first" }
            @for kind in known(audit) { option value={ "score " (kind.column) } { (kind.title) } }
        }
    }
}

/// The demonstrations that could not be used, and why.
pub(super) fn left_out(audit: &Audit) -> Markup {
    let found: Vec<_> = audit
        .findings
        .iter()
        .filter(|finding| &*finding.code == "left_out")
        .collect();
    let name = |episode: u32| {
        let at = audit.demos.binary_search_by_key(&episode, |demo| demo.episode);
        at.map_or("", |at| audit.demos[at].demo.as_str())
    };
    let rows = html! {
        @for finding in &found {
            tr data-left-out=(name(finding.episode)) { th scope="row" { (name(finding.episode)) } td.text { (finding.message) } }
        }
    };
    html! {
        @if !found.is_empty() {
            section #left-out aria-labelledby="left-out-title" {
                h2 #left-out-title { "Left out" }
                p.note { (plural(found.len(), "demonstration", "demonstrations")) " could not be read, or contradict the others. The rest of the page does not include them." }
                (table("Left out", "card scroll", "plain wide", &[("Demonstration", false), ("Why", false)], &rows))
            }
        }
    }
}

/// The list of demonstrations to keep, which can be edited.
pub(super) fn keep_list(audit: &Audit) -> Markup {
    html! {
        @if !audit.demos.is_empty() {
            section #keep aria-labelledby="keep-title" {
                div.heading { h2 #keep-title { "Keep-list" } output #keep-count {} }
                p.note { "Choose the demonstrations to keep: here, with the box at the selected demonstration, or by the filters above. The page is not changed; save the list before you close it." }
                div.card {
                    div.controls {
                        button #keep-all type="button" { "Keep all" }
                        button #drop-listed type="button" title="Drop the demonstrations that the filters list" { "Drop the listed" }
                        button #keep-listed type="button" title="Drop all others" { "Keep only the listed" }
                        @if !audit.scores.is_empty() {
                            label { span { "Drop the worst" } input #drop-count type="number" min="0" max=(audit.demos.len()) value=(audit.demos.len() / 3); }
                            label { span { "by" } select #drop-by {
                                option value="quality" { "quality" }
                                @for kind in known(audit) { @if kind.better != Better::Neither { option value=(kind.column) { (kind.title) } } }
                            } }
                            button #drop-worst type="button" { "Drop" }
                        }
                    }
                    div.columns.even {
                        label.block { span { "Kept, one name per line" } textarea #keep-text rows="9" spellcheck="false" {} }
                        label.block { span { "For the pipeline file" } textarea #keep-toml rows="9" readonly spellcheck="false" {} }
                    }
                    p.notice.gone #keep-notice role="alert" {}
                    div.controls {
                        a.button #save-names download="keep-list.txt" { "Save the list" }
                        a.button #save-toml download="keep-list.toml" { "Save the setting" }
                    }
                }
            }
        }
    }
}

/// The scores: a plot, and the correlations of their ranks.
pub(super) fn scores(audit: &Audit) -> Markup {
    let kinds = known(audit);
    let axis = |name: &str, chosen: &str| {
        html! {
            select id=(name) {
                option value="quality" selected[chosen == "quality"] { "quality" }
                @for kind in &kinds { option value=(kind.column) selected[chosen == kind.column] { (kind.title) } }
            }
        }
    };
    html! {
        @if !audit.scores.is_empty() {
            section #scores aria-labelledby="scores-title" {
                h2 #scores-title { "Scores" }
                p.note { "One mark per demonstration; a hollow one is not on the keep-list. Quality is the mean, over all scores but novelty, of the fraction of the other demonstrations that rank lower." }
                div.columns.even {
                    figure.card {
                        div.controls {
                            label { span { "Across" } (axis("score-x", "duration")) }
                            label { span { "Up" } (axis("score-y", "log_dimensionless_jerk")) }
                        }
                        div.plot #score-plot {}
                        p.hint #score-words {}
                    }
                    figure.card {
                        figcaption { h3 { "Correlation of the ranks" } p { "Spearman’s coefficient; rank 1 is the best" } }
                        (correlations(audit, &kinds))
                    }
                }
            }
        }
    }
}

fn correlations(audit: &Audit, kinds: &[&Kind]) -> Markup {
    let ranks: Vec<Vec<Option<f64>>> = kinds
        .iter()
        .map(|kind| audit.scores.iter().map(|row| (kind.rank)(&row.rank)).collect())
        .collect();
    html! {
        div.scroll tabindex="0" role="region" aria-label="Correlations of the scores" {
            table.plain.correlations {
                thead { tr { th scope="col" {} @for at in 0..kinds.len() { th.figure scope="col" { (at + 1) } } } }
                tbody {
                    @for (at, kind) in kinds.iter().enumerate() {
                        tr {
                            th scope="row" title=(better(kind)) { (at + 1) " " (kind.title) }
                            @for other in &ranks {
                                @match correlation(&ranks[at], other) {
                                    Some(value) => td.figure data-value=(exact(value)) style=(shade(value)) { (format!("{value:.2}").replace('-', "−")) },
                                    None => td.figure { "–" },
                                }
                            }
                        }
                    }
                }
            }
        }
    }
}

/// The background of a correlation: the stronger, the more colour.
fn shade(value: f64) -> String {
    let colour = if value < 0.0 { "--error" } else { "--transfer" };
    format!(
        "background: color-mix(in srgb, var({colour}) {:.0}%, transparent)",
        45.0 * value.abs()
    )
}
