//! The shell of all pages: style, script helpers, document, header, footer, tables, and the formatting of numbers.
//!
//! A page loads nothing: it contains its style, script and data, and a content security policy forbids everything else.

use base64::Engine as _;
use base64::prelude::BASE64_STANDARD;
use maud::{DOCTYPE, Markup, PreEscaped, html};
use serde_json::Value;
use sha2::{Digest as _, Sha256};

/// The style of all pages: the colours of the light and the dark scheme, fonts, cards, tables and controls.
const STYLE: &str = include_str!("base.css");

/// Script parts that all pages have. They run in one scope with the page's own parts.
const SCRIPT: [&str; 3] = [
    include_str!("script/packed.js"),
    include_str!("script/draw.js"),
    include_str!("script/frame.js"),
];

/// The parts of a document that are specific to one page.
pub(super) struct Document<'a> {
    /// Version of the program that makes the page.
    pub(super) tool_version: &'a str,
    /// Title of the browser window.
    pub(super) title: String,
    /// CSS rules in addition to those of all pages.
    pub(super) style: &'a str,
    /// Script parts, in order.
    pub(super) script: &'a [&'a str],
    /// Data that the script reads.
    pub(super) data: &'a Value,
    /// Content of the page.
    pub(super) body: Markup,
}

impl Document<'_> {
    /// Renders the complete HTML document.
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
                    // An empty icon, because browsers otherwise request one from the server.
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

/// Returns the content security policy: nothing may be loaded, and only the page's own script may run.
fn policy(script: &str) -> String {
    let hash = BASE64_STANDARD.encode(Sha256::digest(script.as_bytes()));
    format!(
        "default-src 'none'; script-src 'sha256-{hash}'; style-src 'unsafe-inline'; img-src data:; base-uri 'none'; form-action 'none'"
    )
}

/// Returns the JSON text in a form that is safe inside a script element.
fn safe_json(value: &Value) -> String {
    // Only "<" can end a script element or open a comment in it. In JSON, "<" occurs only in strings, where it can be escaped.
    value.to_string().replace('<', "\\u003c")
}

/// Formats a number for a reader, with three decimals; a dash if it is not finite.
pub(super) fn short(value: f64) -> String {
    if value.is_finite() {
        format!("{value:.3}")
    } else {
        "–".to_owned()
    }
}

/// Formats a number with all its digits, for programs that read the page.
pub(super) fn exact(value: f64) -> String {
    value.to_string()
}

/// Returns a count with its noun in singular or plural.
pub(super) fn plural(count: usize, one: &str, many: &str) -> String {
    format!("{count} {}", if count == 1 { one } else { many })
}

/// A column of a table: its heading, and whether it contains numbers, which are aligned to the right.
pub(super) type Column<'a> = (&'a str, bool);

/// A table that scrolls inside its own frame.
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

/// The header: the kind of page, its title and its introduction. `without_script`, if it is not empty, is shown if JavaScript is off.
pub(super) fn header(kind: &str, title: &str, lead: &Markup, without_script: &str, more: &Markup) -> Markup {
    html! {
        header.page {
            p.eyebrow { "re4-pipe · " (kind) }
            h1 { (title) }
            p.lead { (lead) }
            (more)
            @if !without_script.is_empty() { noscript { p.notice { (without_script) } } }
        }
    }
}

/// The footer: how the page was generated, and the artifacts that it shows, each as its name on the page, its kind and its key.
pub(super) fn footer<'a>(made: &Markup, artifacts: impl Iterator<Item = (&'a str, &'a str, &'a str)>) -> Markup {
    footer_with(made, "The same artifacts always give the same page.", artifacts)
}

/// As [`footer`], with a sentence about what is the same in every page of the same artifacts.
pub(super) fn footer_with<'a>(
    made: &Markup,
    constant: &str,
    artifacts: impl Iterator<Item = (&'a str, &'a str, &'a str)>,
) -> Markup {
    html! {
        footer.page {
            p { "Generated by re4-pipe " (made) ". " (constant) }
            ul {
                @for (name, kind, key) in artifacts {
                    li { @if !name.is_empty() { (name) " " } code { (kind) "/" (key.get(..16).unwrap_or(key)) } }
                }
            }
        }
    }
}

/// A group of radio buttons, given as values and labels. The first one is selected initially.
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
