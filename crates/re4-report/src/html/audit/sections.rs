//! The sections of the page.

use maud::{Markup, html};
use re4_audit::{CheckRow, Severity};

use super::{Audit, Contacts, SEVERITIES};
use crate::html::shell::{self, choice, exact, plural, table};
use re4_stats::median;

/// The symbol of a severity. Its shape distinguishes severities for readers who cannot see the colours; the script renders it.
fn glyph(severity: Severity) -> Markup {
    html! {
        svg class={ "glyph sev-" (severity.as_str()) } viewBox="-7 -7 14 14" width="14" height="14" aria-hidden="true" {
            path data-glyph=(severity.as_str()) {}
        }
    }
}

fn words(code: &str) -> String {
    code.replace(['_', '-'], " ")
}

/// Formats a number with at most five significant digits.
fn number(value: f64) -> String {
    let rounded = format!("{value:.4e}").parse::<f64>().unwrap_or(value);
    let magnitude = rounded.abs();
    if rounded != 0.0 && !(1e-4..1e7).contains(&magnitude) {
        format!("{rounded:e}")
    } else {
        rounded.to_string()
    }
}

fn measured(value: Option<f64>, unit: &str) -> Markup {
    html! {
        @match value {
            Some(value) => span data-value=(exact(value)) { (number(value)) @if !unit.is_empty() { " " (unit) } },
            None => "–",
        }
    }
}

fn thousands(count: u64) -> String {
    let digits = count.to_string();
    let mut text = String::new();
    for (i, digit) in digits.chars().enumerate() {
        if i > 0 && (digits.len() - i).is_multiple_of(3) {
            text.push(',');
        }
        text.push(digit);
    }
    text
}

/// The header: what was audited, and the fractions of the modes.
pub(super) fn header(audit: &Audit) -> Markup {
    let frames: u64 = audit.demos.iter().map(|d| d.frames as u64).sum();
    let transit: u64 = audit.demos.iter().map(|d| d.transit_frames as u64).sum();
    let transfer: u64 = audit.demos.iter().map(|d| d.transfer_frames as u64).sum();
    let percent = |part: u64| {
        if frames == 0 {
            0.0
        } else {
            100.0 * part as f64 / frames as f64
        }
    };
    let clean = audit.demos.iter().filter(|d| d.errors + d.warnings == 0).count();
    let lead = html! {
        strong { (audit.task) } ": "
        strong data-fact="demos" data-value=(audit.demos.len()) { (plural(audit.demos.len(), "demonstration", "demonstrations")) }
        ", "
        strong data-fact="frames" data-value=(frames) { (thousands(frames)) " frames" }
        ". "
        span data-fact="clean" data-value=(clean) {
            @if audit.demos.is_empty() {}
            @else if clean == audit.demos.len() { "No demonstration has an error or a warning." }
            @else if clean == 0 { "Every demonstration has an error or a warning." }
            @else { (plural(clean, "demonstration has", "demonstrations have")) " neither an error nor a warning." }
        }
    };
    let modes = html! {
        div.split role="img" aria-label=(format!("{:.1} % of the frames are transit, {:.1} % are transfer", percent(transit), percent(transfer))) {
            @for (mode, part) in [("transit", transit), ("transfer", transfer)].into_iter().filter(|(_, part)| *part > 0) {
                div class={ "mode " (mode) } style=(format!("flex-grow: {part}")) {}
            }
        }
        ul.legend.modes {
            @for (mode, part) in [("transit", transit), ("transfer", transfer)] {
                li data-fact={ (mode) "_frames" } data-value=(part) {
                    span class={ "swatch " (mode) } {}
                    (mode) " " b { (format!("{:.1} %", percent(part))) } " · " (thousands(part)) " frames"
                }
            }
        }
        p.notice.gone #address-notice role="alert" {}
    };
    let without_script = "The timelines and plots need JavaScript; the tables of checks and conventions do not.";
    shell::header("audit", &audit.dataset, &lead, without_script, &modes)
}

/// Beginning of the derivation of a check that could not be made, before the reason.
const NOT_MADE: &str = "not made: ";

/// Checks that could not be made, by the reason, in the order of their first check.
fn by_reason<'a>(checks: &[&'a CheckRow]) -> Vec<(&'a str, Vec<String>)> {
    let mut reasons: Vec<(&str, Vec<String>)> = Vec::new();
    for check in checks {
        let why = check.derivation.strip_prefix(NOT_MADE).unwrap_or(&check.derivation);
        let name = words(&check.code);
        match reasons.iter_mut().find(|(known, _)| *known == why) {
            Some((_, names)) => names.push(name),
            None => reasons.push((why, vec![name])),
        }
    }
    reasons
}

/// The numbers of findings, by severity and by check, on buttons that filter the demonstrations.
pub(super) fn findings(audit: &Audit) -> Markup {
    let not_made = |check: &CheckRow| !audit.object && check.derivation.starts_with(NOT_MADE);
    let silent = audit
        .checks
        .iter()
        .filter(|check| check.findings == 0 && !not_made(check));
    let silent: Vec<&CheckRow> = silent.collect();
    let skipped: Vec<&CheckRow> = audit.checks.iter().filter(|check| not_made(check)).collect();
    html! {
        section #found aria-labelledby="found-title" {
            div.heading {
                h2 #found-title { "Findings" }
                button.link.gone #clear-filters type="button" { "Show all demonstrations" }
            }
            div.kinds {
                @for severity in SEVERITIES {
                    @let count = audit.findings.iter().filter(|f| f.severity == severity).count();
                    @let checks = sorted_checks(audit, severity);
                    div.card.kind {
                        button.severity type="button" aria-pressed="false" data-severity=(severity.as_str())
                            data-count=(count) disabled[count == 0] title={ "Show only demonstrations with a finding of severity " (severity.as_str()) } {
                            (glyph(severity))
                            b { (count) } " "
                            (if count == 1 { severity.as_str().to_owned() } else { format!("{}s", severity.as_str()) })
                        }
                        p.hint { (meaning(severity)) }
                        @if !checks.is_empty() {
                            div.chips {
                                @for check in checks {
                                    button.chip type="button" aria-pressed="false" data-code=(check.code) data-findings=(check.findings)
                                        data-episodes=(check.episodes) title=(check.meaning) {
                                        span { (words(&check.code)) }
                                        b { (check.findings) }
                                        small { " in " (check.episodes) }
                                    }
                                }
                            }
                        }
                    }
                }
            }
            p.hint {
                "Each button shows the number of findings and the number of affected demonstrations. Press it to list only those demonstrations. "
                @if !silent.is_empty() {
                    "Checks without findings: "
                    @for (i, check) in silent.iter().enumerate() {
                        @if i > 0 { ", " }
                        span title=(check.meaning) data-silent=(check.code) { (words(&check.code)) }
                    }
                    "."
                }
            }
            @for (why, checks) in by_reason(&skipped) {
                p.hint data-not-made=(why) { "Not checked, because " (why) ": " (checks.join(", ")) "." }
            }
        }
    }
}

fn meaning(severity: Severity) -> &'static str {
    match severity {
        Severity::Error => "The segmentation or the data is wrong in these frames.",
        Severity::Warning => "Probably not what the demonstrator intended, or harmful to a policy that uses it.",
        Severity::Note => "Worth knowing.",
    }
}

/// Returns the checks of a severity that have findings, the most frequent first.
fn sorted_checks(audit: &Audit, severity: Severity) -> Vec<&CheckRow> {
    let mut checks: Vec<&CheckRow> = audit
        .checks
        .iter()
        .filter(|check| check.severity == severity && check.findings > 0)
        .collect();
    checks.sort_by(|a, b| b.findings.cmp(&a.findings).then_with(|| a.code.cmp(&b.code)));
    checks
}

/// Returns the codes of the notes that more than half of the demonstrations have.
fn usual_notes(audit: &Audit) -> Vec<&str> {
    let is_usual =
        |check: &&CheckRow| check.severity == Severity::Note && 2 * check.episodes as usize > audit.demos.len();
    let mut codes: Vec<&str> = audit.checks.iter().filter(is_usual).map(|check| &*check.code).collect();
    codes.sort_unstable();
    codes
}

/// All timelines, and next to them the evidence of the selected demonstration.
pub(super) fn workbench(audit: &Audit) -> Markup {
    let usual = usual_notes(audit);
    html! {
        div.workbench {
            section #timelines aria-labelledby="timelines-title" {
                div.card.rows {
                    div.heading {
                        h2 #timelines-title { "Demonstrations" }
                        output #shown-count {}
                    }
                    div.controls {
                        label { span { "Sort by" } select #sort {
                            option value="worst" selected { "findings, most severe first" }
                            option value="number" { "number" }
                            option value="length" { "length" }
                            option value="fraction" { "fraction of transfer" }
                            option value="grasp" { "first grasp" }
                            (super::scores::orders(audit))
                        } }
                        button #reverse type="button" aria-pressed="false" title="Reverse the order" aria-label="Reverse the order" { "⇅" }
                        label.grow { span.hidden { "Filter by text" } input #filter-text type="search" placeholder="Name or finding" title="Show only demonstrations whose name or findings contain this text" autocomplete="off"; }
                        (choice("scale", "Scale of the timelines", &[("frames", "Frames"), ("fraction", "Percent")]))
                    }
                    div.plot #timeline-axis aria-hidden="true" {}
                    div #timeline-rows data-usual=(usual.join(" ")) tabindex="0" role="listbox" aria-label="Demonstrations; the up and down keys select one" aria-activedescendant="timeline-choice" {
                        canvas #timeline-canvas {}
                        div.hidden #timeline-choice role="option" aria-selected="true" {}
                        div #timeline-spacer {}
                    }
                    p.none.gone #no-rows { "No demonstration matches the filter." }
                    ul.legend {
                        li { span.swatch.transit {} "transit" }
                        li { span.swatch.transfer {} "transfer" }
                        @for severity in SEVERITIES { li { (glyph(severity)) (severity.as_str()) } }
                    }
                    @if !usual.is_empty() {
                        p.hint { "Not marked here, because more than half of the demonstrations have it: " (usual.join(", ")) ". Press its button above to show it." }
                    }
                    div #timeline-tip role="tooltip" {}
                }
            }
            section #evidence aria-labelledby="evidence-title" tabindex="-1" {
                div.card {
                    div.heading {
                        div {
                            h2 #evidence-title {}
                            p.detail #evidence-summary {}
                            p.detail #evidence-scores {}
                        }
                        div.pair {
                            button #previous-demo type="button" aria-label="Previous demonstration" title="Previous demonstration (↑)" { "‹" }
                            button #next-demo type="button" aria-label="Next demonstration" title="Next demonstration (↓)" { "›" }
                        }
                    }
                    ul #evidence-findings aria-label="Findings of this demonstration" {}
                    div #shots aria-label="Camera images at the findings" {}
                    div.controls {
                        label.check { input #keep-this type="checkbox" checked; span { "Keep this demonstration" } }
                        label { span { "Compare with" } select #compare {} }
                    }
                    div.row {
                        p.hint #readout aria-live="off" {}
                        button #whole type="button" disabled { "All frames" }
                    }
                    div #evidence-plots tabindex="0" role="group" aria-label="Evidence over frames; the left and right keys select a frame, Escape shows all frames" {}
                    p.hint {
                        "The background shows the mode. Drag across the plots to zoom in. "
                        @if audit.panels.is_empty() { "This audit has no evidence by frame." }
                        @else { "The curves show the artifact’s value of every frame, as 32-bit floats." }
                    }
                    h3.above { "Segments" }
                    div.scroll tabindex="0" role="region" aria-label="Segments of this demonstration" {
                        table.plain #segments {
                            thead { tr { th scope="col" { "Mode" } @for name in segment_columns(audit) { th.figure scope="col" { (name) } } } }
                            tbody {}
                        }
                    }
                }
            }
        }
    }
}

fn segment_columns(audit: &Audit) -> Vec<String> {
    let unit = &audit.length.unit;
    let mut columns = vec!["Frames".to_owned(), "Length".to_owned()];
    if !audit.object {
        columns.extend(["Opening, %".to_owned(), format!("Path, {unit}")]);
        return columns;
    }
    if audit.outline.is_none() {
        columns.extend(["Settled at".to_owned(), format!("Fingers, {unit}")]);
    }
    columns.push(format!("Residual, {unit}"));
    if audit.outline.is_none() {
        columns.push("Residual, °".to_owned());
    }
    columns.push(format!("Object moved, {unit}"));
    if audit.outline.is_none() {
        columns.extend([format!("Rise, {unit}"), "Grasp".to_owned()]);
    }
    columns
}

/// The grasps of all demonstrations, and the lengths of their segments.
pub(super) fn dataset(audit: &Audit) -> Markup {
    let planar = audit.outline.is_some();
    let views: &[(&str, &str)] = if planar {
        &[("xy", "In the block’s frame")]
    } else {
        &[("xy", "From above"), ("xz", "From the side"), ("yz", "From the front")]
    };
    html! {
        section #dataset aria-labelledby="dataset-title" {
            div.heading {
                h2 #dataset-title {
                    @if !audit.object { "No object" }
                    @else if planar { "Where contact begins" }
                    @else { "Where the object is grasped" }
                }
                ul.legend #grasp-legend {}
            }
            p.note {
                @if !audit.object {
                    "This dataset has no pose of an object, so the page cannot show where it is grasped. The table of checks lists what could not be checked, with the reasons."
                } @else if audit.grasps.is_empty() {
                    @if planar { "No contact begins in any demonstration of this audit, so there is nothing to show." }
                    @else { "No demonstration of this audit has a transfer segment, so there is nothing to show." }
                } @else if planar {
                    "The position of the pusher’s centre in the block’s frame, at each frame with contact that follows a frame without contact. The cross is the block’s origin. A pusher does not grasp, so there are no outcomes."
                } @else {
                    "The position of the end effector in the object’s frame, at the frame where the fingers have stopped closing; one mark per transfer segment. The cross is the object’s origin; lengths are in " (audit.length.unit) "."
                }
            }
            @if !audit.grasps.is_empty() {
                div.views.planar[planar] {
                    @for (axes, name) in views {
                        figure.card {
                            figcaption { h3 { (name) } p.grasp-words {} }
                            canvas.grasps data-axes=(axes) tabindex="0" role="img" aria-label={ (name) ": positions in the object’s frame. The left and right keys select one; click one to see its demonstration." } {}
                        }
                    }
                }
            }
            @if let Some(contacts) = &audit.contacts { (contact_words(*contacts)) }
            h2.above { "Segment lengths" }
            div.columns.even {
                @for (transfer, mode) in [(false, "transit"), (true, "transfer")] {
                    @let lengths = lengths(audit, transfer);
                    figure.card {
                        figcaption {
                            h3 { span class={ "swatch " (mode) } {} " " (mode) }
                            p data-fact={ (mode) "_segments" } data-value=(lengths.len()) {
                                (plural(lengths.len(), "segment", "segments"))
                                @if let Some(median) = median(&lengths) { ", median " (number(median)) " frames" }
                            }
                        }
                        div.plot.histogram data-mode=(mode) {}
                    }
                }
            }
            p.hint { "The triangles below the axis mark the segments of the selected demonstration." }
        }
    }
}

/// How well contact and motion of the object agree.
fn contact_words(contacts: Contacts) -> Markup {
    html! {
        h2.above { "Contact and motion of the block" }
        p.note {
            "There is contact and motion in "
            b data-contacts="both" data-value=(contacts.both) { (thousands(contacts.both)) }
            " steps, contact without motion in "
            b data-contacts="contact_alone" data-value=(contacts.contact_alone) { (thousands(contacts.contact_alone)) }
            ", motion without contact in "
            b data-contacts="motion_alone" data-value=(contacts.motion_alone) { (thousands(contacts.motion_alone)) }
            ", and neither in "
            b data-contacts="neither" data-value=(contacts.neither) { (thousands(contacts.neither)) }
            "."
            @if let Some(jaccard) = contacts.jaccard {
                " The Jaccard index of contact and motion is " b data-contacts="jaccard" data-value=(exact(jaccard)) { (format!("{jaccard:.3}")) } "."
            }
        }
    }
}

fn lengths(audit: &Audit, transfer: bool) -> Vec<f64> {
    let segments = audit.segments.iter().filter(|segment| segment.transfer == transfer);
    segments
        .map(|s| f64::from(s.end_frame) - f64::from(s.first_frame))
        .collect()
}

/// All checks with their thresholds.
pub(super) fn checks(audit: &Audit) -> Markup {
    let columns = [
        ("Check", false),
        ("Findings", true),
        ("Demos", true),
        ("Threshold", true),
        ("Origin", false),
        ("Measure and meaning", false),
    ];
    let rows = html! {
        @for check in &audit.checks {
            tr data-check=(check.code) {
                th scope="row" { span.name { (glyph(check.severity)) (words(&check.code)) } }
                td.figure { (check.findings) }
                td.figure { (check.episodes) }
                td.figure { (measured(check.threshold, &check.unit)) }
                td { (check.origin) }
                td.text { p { (check.measure) } p.soft { (check.meaning) } @if !check.derivation.is_empty() { p.soft { "Threshold: " (check.derivation) } } }
            }
        }
    };
    html! {
        section #checks aria-labelledby="checks-title" {
            h2 #checks-title { "Checks and thresholds" }
            p.note { "A threshold is derived from this dataset (data), set in the pipeline file (setting), or built in (default)." }
            (table("Checks", "card scroll", "plain wide", &columns, &rows))
        }
    }
}

/// The conventions of the dataset, with the evidence for them.
pub(super) fn conventions(audit: &Audit) -> Markup {
    let columns = [
        ("Convention", false),
        ("Value", false),
        ("Basis", false),
        ("Residual", true),
        ("Limit", true),
        ("Runner-up", true),
        ("Evidence", false),
    ];
    let rows = html! {
        @for convention in &audit.conventions {
            tr data-convention=(convention.convention) {
                th scope="row" { (words(&convention.convention)) }
                td { b { (convention.value) } }
                td { span.badge.good[convention.basis == "proven"] { (convention.basis) } }
                @for value in [convention.residual, convention.threshold, convention.runner_up] {
                    td.figure { (measured(value, &convention.unit)) }
                }
                td.text { p { (convention.evidence) } @if convention.frames > 0 { p.soft { "Checked on " (thousands(convention.frames as u64)) " frames." } } }
            }
        }
    };
    html! {
        @if !audit.conventions.is_empty() {
            section #conventions aria-labelledby="conventions-title" {
                h2 #conventions-title { "Conventions of the dataset" }
                p.note { "What the numbers of the dataset mean, and the evidence for it. The residual has to be below the limit; the runner-up is the residual of the next best value." }
                (table("Conventions", "card scroll", "plain wide", &columns, &rows))
            }
        }
    }
}

/// The footer: how the page was generated, and from which artifacts.
pub(super) fn footer(audit: &Audit) -> Markup {
    shell::footer(
        &html! { (audit.tool_version) " with " code { (audit.command) } },
        audit
            .artifacts
            .iter()
            .map(|(kind, key)| ("", kind.as_str(), key.as_str())),
    )
}
