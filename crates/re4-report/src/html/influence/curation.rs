//! The page of a curation: the judgement, the learning curve, and the demonstrations.

use maud::{Markup, html};
use re4_influence::{CuratedRow, JudgedRow, RoundRow};
use serde_json::json;

use super::{STYLE, plot};
use crate::html::comparison::probability;
use crate::html::shell::{self, Document, exact, short, table};

/// The content of the page.
#[derive(Debug, Clone, PartialEq)]
pub struct Curation {
    /// Version of the program that makes the page.
    pub tool_version: String,
    /// Key of the `curation` artifact.
    pub key: String,
    /// The demonstrations.
    pub rows: Vec<CuratedRow>,
    /// The sets that were rolled out.
    pub rounds: Vec<RoundRow>,
    /// The judgement.
    pub judged: Vec<JudgedRow>,
}

/// Makes the page of a curation.
#[must_use]
pub fn curation_page(page: &Curation) -> String {
    let kept = page.rows.iter().filter(|row| row.kept).count();
    let lead = html! {
        "Keeps " strong data-fact="kept" data-value=(kept) { (kept) " of " (page.rows.len()) } " demonstrations. "
        "They were chosen on other scenes than those that they are judged on."
    };
    let body = html! {
        (shell::header("curate", "Choice of demonstrations", &lead, "", &html! {}))
        main {
            (judged(page))
            (learning(page))
            (demonstrations(page))
        }
        (shell::footer(&html! { "with " code { "re4-pipe curate" } }, [("", "curation", page.key.as_str())].into_iter()))
    };
    Document {
        tool_version: &page.tool_version,
        title: "Choice of demonstrations".to_owned(),
        style: STYLE,
        script: &[],
        data: &json!({}),
        body,
    }
    .render()
}

fn judged(page: &Curation) -> Markup {
    let columns = [
        ("set", false),
        ("demonstrations", true),
        ("measure", false),
        ("mean", true),
        ("interval", true),
        ("curated minus this set", true),
        ("interval", true),
        ("p", true),
    ];
    let body = html! {
        @for row in &page.judged {
            tr data-set=(row.set) data-measure=(row.measure) data-value=(exact(row.value)) {
                th scope="row" { (row.set) }
                td.figure { (row.demos) }
                td { (row.measure) }
                td.figure { (short(row.value)) }
                td.figure { "[" (short(row.low)) ", " (short(row.high)) "]" }
                @if row.set == *"curated" { td {} td {} td {} } @else {
                    td.figure { (format!("{:+.3}", row.difference)) }
                    td.figure { (format!("[{:+.3}, {:+.3}]", row.difference_low, row.difference_high)) }
                    td.figure { (probability(row.p)) }
                }
            }
        }
    };
    html! {
        @if !page.judged.is_empty() {
            section {
                h2 { "On scenes that the choice was not made on" }
                p.note { "Differences are paired over equal seeds; 95 % intervals by bootstrap, p by the exact sign test." }
                div.card { (table("Judgement", "scroll", "plain", &columns, &body)) }
            }
        }
    }
}

fn learning(page: &Curation) -> Markup {
    let curve = |class: &'static str, joined: bool, admit: &dyn Fn(&RoundRow) -> bool| plot::Curve {
        class,
        joined,
        points: page
            .rounds
            .iter()
            .filter(|row| admit(row))
            .map(|row| [f64::from(row.kept), row.success])
            .collect(),
    };
    let curves = [
        curve("series-7", false, &|row| row.series == *"tried" && !row.taken),
        curve("series-0", true, &|row| row.series == *"tried" && row.taken),
        curve("series-5", true, &|row| row.series == *"ranked"),
        curve("series-1", true, &|row| row.series == *"random"),
    ];
    html! {
        section {
            h2 { "Success by the number of demonstrations" }
            p.note { "On the scenes that the choice was made on." }
            figure.card {
                ul.legend {
                    @for (class, words) in [("series-0", "taken"), ("series-7", "tried"), ("series-5", "best of the ranking"), ("series-1", "random")] {
                        li class=(class) { span.swatch {} (words) }
                    }
                }
                (plot::curves(&curves, "Success rate by the number of demonstrations; the artifact has the values"))
            }
        }
    }
}

fn demonstrations(page: &Curation) -> Markup {
    let mut rows: Vec<&CuratedRow> = page.rows.iter().collect();
    rows.sort_by(|a, b| {
        let round = |row: &CuratedRow| row.round.unwrap_or(u32::MAX);
        round(a)
            .cmp(&round(b))
            .then(b.expected.total_cmp(&a.expected))
            .then(a.demo.cmp(&b.demo))
    });
    let columns = [
        ("demonstration", false),
        ("", false),
        ("episodes that followed it", true),
        ("their mean cost", true),
        ("expected cost", true),
        ("findings", true),
    ];
    let body = html! {
        @for row in rows {
            tr data-demo=(row.demo) data-kept=(row.kept) {
                th scope="row" { (row.demo_name) }
                td { @match row.round { Some(round) => { span.worse { "dropped in round " (round) } }, None => "kept" } }
                td.figure { (row.episodes) }
                td.figure { (row.cost.map_or_else(|| "–".to_owned(), short)) }
                td.figure { (short(row.expected)) }
                td.figure { (row.findings) }
            }
        }
    };
    html! {
        section {
            h2 { "Demonstrations" }
            p.note { "The cost of an episode is 1 − score (1 − steps / (2 max_steps)): a success costs at most a half, a failure at least a half." }
            div.card { (table("Demonstrations", "scroll tall", "plain", &columns, &body)) }
        }
    }
}
