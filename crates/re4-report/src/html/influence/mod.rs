//! Self-contained HTML pages of the influence of demonstrations and of a curation. They need no script.

mod curation;
mod plot;

use std::collections::BTreeMap;

use maud::{Markup, html};
use re4_artifact::Word as _;
use re4_influence::{InfluenceRow, JudgedEpisodeRow, PairRow, Scenes};
use serde_json::json;

use super::shell::{self, Document, exact, plural, table};

pub use curation::{Curation, curation_page};

/// The content of the page of the influence.
#[derive(Debug, Clone, PartialEq)]
pub struct Influence {
    /// Version of the program that makes the page.
    pub tool_version: String,
    /// Key of the `influence` artifact.
    pub key: String,
    /// Effects of the demonstrations.
    pub rows: Vec<InfluenceRow>,
    /// The episodes with all demonstrations.
    pub episodes: Vec<JudgedEpisodeRow>,
    /// The episodes that were rolled out again.
    pub pairs: Vec<PairRow>,
}

const STYLE: &str = include_str!("page.css");

/// Makes the page of the influence.
#[must_use]
pub fn influence_page(page: &Influence) -> String {
    let kinds = [Scenes::Given, Scenes::Starts];
    let kinds = kinds
        .into_iter()
        .filter(|kind| page.episodes.iter().any(|row| row.scenes == *kind));
    let body = html! {
        (header(page))
        main {
            @for kind in kinds {
                (demonstrations(page, kind))
                (coverage(page, kind))
                (failures(page, kind))
            }
        }
        (shell::footer(&html! { "with " code { "re4-pipe influence" } }, [("", "influence", page.key.as_str())].into_iter()))
    };
    Document {
        tool_version: &page.tool_version,
        title: "Influence of demonstrations".to_owned(),
        style: STYLE,
        script: &[],
        data: &json!({}),
        body,
    }
    .render()
}

fn title(kind: Scenes) -> &'static str {
    match kind {
        Scenes::Given => "Scenes of the pipeline",
        Scenes::Starts => "Perturbed starts of the demonstrations",
    }
}

fn header(page: &Influence) -> Markup {
    let demos = page
        .rows
        .iter()
        .map(|row| row.demo)
        .max()
        .map_or(0, |last| last as usize + 1);
    let judged: std::collections::BTreeSet<u32> = page
        .rows
        .iter()
        .filter(|row| row.depending > 0)
        .map(|row| row.demo)
        .collect();
    let lead = html! {
        "What changes if one of " strong data-fact="demonstrations" data-value=(demos) { (demos) } " demonstrations is left out, with the scales of all of them: "
        strong { (plural(page.episodes.len(), "episode", "episodes")) } " with all demonstrations, and "
        strong { (page.pairs.len()) } " again without the one demonstration on which they depend. All others stay as they are. "
        strong data-fact="never" data-value=(demos - judged.len()) { (demos - judged.len()) " demonstrations" } " were never judged."
    };
    shell::header("influence", "Influence of demonstrations", &lead, "", &html! {})
}

/// The table of demonstrations: those that harm first, then those that carry the policy, then those that were never judged.
fn demonstrations(page: &Influence, kind: Scenes) -> Markup {
    let key = |row: &InfluenceRow| (row.success_change, row.score_change);
    let mut rows: Vec<&InfluenceRow> = page.rows.iter().filter(|row| row.scenes == kind).collect();
    rows.sort_by(|a, b| {
        let (one, other) = (key(a), key(b));
        other
            .0
            .total_cmp(&one.0)
            .then(other.1.total_cmp(&one.1))
            .then(a.demo.cmp(&b.demo))
    });
    let (judged, never): (Vec<_>, Vec<_>) = rows.into_iter().partition(|row| row.depending > 0);
    let columns = [
        ("demonstration", false),
        ("followed", true),
        ("failed after it", true),
        ("depend on it", true),
        ("success without it", true),
        ("interval", true),
        ("score without it", true),
        ("steps without it", true),
        ("repaired", true),
        ("broken", true),
    ];
    let body = html! {
        @for row in &judged {
            tr data-demo=(row.demo) data-value=(exact(row.success_change)) {
                th scope="row" { (name(row.demo_name.as_ref(), row.demo)) }
                td.figure { (row.followed) }
                td.figure { (row.failures) }
                td.figure { (row.depending) }
                td.figure.better[row.success_change > 0.0].worse[row.success_change < 0.0] { (signed(row.success_change)) }
                td.figure { "[" (signed(row.success_low)) ", " (signed(row.success_high)) "]" }
                td.figure { (signed(row.score_change)) }
                td.figure { (format!("{:+.2}", row.steps_change)) }
                td.figure { (row.repaired) }
                td.figure { (row.broken) }
            }
        }
    };
    html! {
        section {
            h2 { (title(kind)) }
            p.note {
                "Changes are without minus with the demonstration: above 0 it harms, below 0 it carries the policy. They are exact for these "
                "scenes; the intervals (bootstrap over scenes, 95 %) say what other scenes would give."
            }
            div.card { (table("Demonstrations", "scroll tall", "plain", &columns, &body)) }
            @if !never.is_empty() {
                details.card {
                    summary { (plural(never.len(), "demonstration was", "demonstrations were")) " never judged" }
                    p.names { @for row in &never { span { (name(row.demo_name.as_ref(), row.demo)) " " } } }
                }
            }
        }
    }
}

fn coverage(page: &Influence, kind: Scenes) -> Markup {
    let rows = page.rows.iter().filter(|row| row.scenes == kind);
    let demos = rows.map(|row| plot::Mark {
        at: [row.start_x, row.start_y],
        class: if row.depending == 0 {
            "never"
        } else if row.success_change > 0.0 {
            "harms"
        } else if row.success_change < 0.0 {
            "carries"
        } else {
            "neutral"
        },
        title: format!(
            "{}: success {:+.4} without it",
            name(row.demo_name.as_ref(), row.demo),
            row.success_change
        ),
    });
    let episodes = page
        .episodes
        .iter()
        .filter(|row| row.scenes == kind)
        .map(|row| plot::Mark {
            at: [row.start_x, row.start_y],
            class: if row.success { "solved" } else { "failed" },
            title: format!(
                "scene {}: {}",
                row.seed,
                if row.success { "success" } else { "failure" }
            ),
        });
    html! {
        section {
            h2 { "Coverage of the start states" }
            p.note { "Where the object is at the start: of each demonstration (circles) and of each scene (crosses), seen from above." }
            figure.card {
                ul.legend {
                    @for (class, words) in [("harms", "harms"), ("carries", "carries"), ("neutral", "no change of the success"), ("never", "never judged"), ("solved", "scene solved"), ("failed", "scene failed")] {
                        li class=(class) { span.swatch {} (words) }
                    }
                }
                (plot::scatter(&demos.collect::<Vec<_>>(), &episodes.collect::<Vec<_>>()))
            }
        }
    }
}

/// The scenes that fail, each with the demonstrations to blame.
fn failures(page: &Influence, kind: Scenes) -> Markup {
    let failed: Vec<&JudgedEpisodeRow> = page
        .episodes
        .iter()
        .filter(|row| row.scenes == kind && !row.success)
        .collect();
    let mut blamed: BTreeMap<u32, Vec<&PairRow>> = BTreeMap::new();
    for pair in page
        .pairs
        .iter()
        .filter(|pair| pair.scenes == kind && !pair.success && pair.success_without)
    {
        blamed.entry(pair.seed).or_default().push(pair);
    }
    let columns = [
        ("scene", true),
        ("score", true),
        ("depends on", true),
        ("succeeds without", false),
    ];
    let body = html! {
        @for row in &failed {
            tr data-scene=(row.seed) data-kind=(row.scenes.word()) {
                td.figure { (row.seed) }
                td.figure { (shell::short(row.score)) }
                td.figure { (row.depending) }
                td { @match blamed.get(&row.seed) {
                    Some(pairs) => { @for pair in pairs { span.blamed { (name(pair.demo_name.as_ref(), pair.demo)) } " " } },
                    None => span.faint { "no single demonstration" },
                } }
            }
        }
    };
    html! {
        @if !failed.is_empty() {
            section {
                h2 { (plural(failed.len(), "failure", "failures")) }
                p.note { "A failed scene names the demonstrations without which it succeeds." }
                div.card { (table("Failures", "scroll tall", "plain", &columns, &body)) }
            }
        }
    }
}

fn name(name: Option<&String>, demo: u32) -> String {
    name.cloned().unwrap_or_else(|| format!("demonstration {demo}"))
}

/// A change with its sign, four decimals.
fn signed(value: f64) -> String {
    if value == 0.0 {
        "0".to_owned()
    } else {
        format!("{value:+.4}")
    }
}
