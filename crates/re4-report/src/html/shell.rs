//! The shell of all pages: look, helpers of the script, document, header, footer, tables, numbers in words.
//!
//! A page loads nothing: style, script and data are inside of it, and a content security policy forbids the rest.

use base64::Engine as _;
use base64::prelude::BASE64_STANDARD;
use maud::{DOCTYPE, Markup, PreEscaped, html};
use serde_json::Value;
use sha2::{Digest as _, Sha256};

/// The look of all pages: colours of both schemes, type, cards, tables, controls.
const STYLE: &str = include_str!("base.css");

/// Parts of the script that all pages have, in one scope with their own.
const SCRIPT: [&str; 3] = [
    include_str!("script/packed.js"),
    include_str!("script/draw.js"),
    include_str!("script/frame.js"),
];

/// What a page has of its own.
pub(super) struct Document<'a> {
    /// Version of the program that makes it.
    pub(super) tool_version: &'a str,
    /// Title of the browser's window.
    pub(super) title: String,
    /// Rules beside those of all pages.
    pub(super) style: &'a str,
    /// Its script, part by part.
    pub(super) script: &'a [&'a str],
    /// Data of the script.
    pub(super) data: &'a Value,
    /// Its content.
    pub(super) body: Markup,
}

impl Document<'_> {
    /// The document.
    pub(super) fn render(self) -> String {
        let script = format!(
            "(() => {{\n\"use strict\";\n{}{}}})();\n",
            SCRIPT.concat(),
            self.script.concat()
        );
        html! {
            (DOCTYPE)
            html lang="en" {
                head {
                    meta charset="utf-8";
                    meta http-equiv="Content-Security-Policy" content=(policy(&script));
                    meta name="viewport" content="width=device-width, initial-scale=1";
                    meta name="color-scheme" content="light dark";
                    meta name="generator" content={ "re4-pipe " (self.tool_version) };
                    title { (self.title) }
                    // Without it browsers ask the server for an icon.
                    link rel="icon" href="data:,";
                    style { (PreEscaped(STYLE)) (PreEscaped(self.style)) }
                }
                body {
                    (self.body)
                    script #report-data type="application/json" { (PreEscaped(safe_json(self.data))) }
                    script { (PreEscaped(script)) }
                }
            }
        }
        .into_string()
    }
}

/// Nothing is loaded and nothing runs but the page's own script.
fn policy(script: &str) -> String {
    let hash = BASE64_STANDARD.encode(Sha256::digest(script.as_bytes()));
    format!(
        "default-src 'none'; script-src 'sha256-{hash}'; style-src 'unsafe-inline'; img-src data:; base-uri 'none'; form-action 'none'"
    )
}

/// The JSON, safe inside of a script element.
fn safe_json(value: &Value) -> String {
    // Inside of a script element only "<" can end it or open a comment; in JSON it occurs in texts alone.
    value.to_string().replace('<', "\\u003c")
}

/// How a page shows a number.
pub(super) fn short(value: f64) -> String {
    if value.is_finite() {
        format!("{value:.3}")
    } else {
        "–".to_owned()
    }
}

/// All digits, for programs.
pub(super) fn exact(value: f64) -> String {
    value.to_string()
}

/// A count with its noun.
pub(super) fn plural(count: usize, one: &str, many: &str) -> String {
    format!("{count} {}", if count == 1 { one } else { many })
}

/// A column of a table: its words, and whether it holds figures, which are set to the right.
pub(super) type Column<'a> = (&'a str, bool);

/// A table that scrolls within its own frame.
pub(super) fn table(name: &str, frame: &str, class: &str, columns: &[Column<'_>], rows: &Markup) -> Markup {
    html! {
        div class=(frame) tabindex="0" role="region" aria-label=(name) {
            table class=(class) {
                thead { tr { @for (words, figures) in columns { @if *figures { th.figure scope="col" { (words) } } @else { th scope="col" { (words) } } } } }
                tbody { (rows) }
            }
        }
    }
}

/// The title, and what the page is about.
pub(super) fn header(kind: &str, title: &str, lead: &Markup, without_script: &str, more: &Markup) -> Markup {
    html! {
        header.page {
            p.eyebrow { "re4-pipe · " (kind) }
            h1 { (title) }
            p.lead { (lead) }
            (more)
            noscript { p.notice { (without_script) } }
        }
    }
}

/// Where the page is from: how it was made, and names, kinds and keys of artifacts.
pub(super) fn footer<'a>(made: &Markup, artifacts: impl Iterator<Item = (&'a str, &'a str, &'a str)>) -> Markup {
    html! {
        footer.page {
            p { "Made by re4-pipe " (made) "; the same artifacts give the same page." }
            ul {
                @for (name, kind, key) in artifacts {
                    li { @if !name.is_empty() { (name) " " } code { (kind) "/" (key.get(..16).unwrap_or(key)) } }
                }
            }
        }
    }
}

/// Buttons of which one is chosen, the first to begin with: values and words.
pub(super) fn choice(name: &str, label: &str, options: &[(&str, &str)]) -> Markup {
    html! {
        fieldset.choice {
            legend.hidden { (label) }
            @for (i, (value, words)) in options.iter().enumerate() {
                label { input type="radio" name=(name) value=(value) checked[i == 0]; span { (words) } }
            }
        }
    }
}
