//! Reads an `audit` artifact and formats it as text (a table of checks, and the findings) or as JSON.

use std::fmt::Write as _;

use anyhow::Result;
use re4_artifact::Artifact;
use re4_audit::{AuditedEpisodeRow, CheckRow, FindingRow, Severity};
use serde_json::{Value, json};

use crate::html::audit::SEVERITIES;

/// Maximum number of findings of one check that are printed.
const SHOWN: usize = 12;

/// The content of an `audit` artifact.
#[derive(Debug)]
pub struct Findings {
    summary: Value,
    demos: Vec<AuditedEpisodeRow>,
    checks: Vec<CheckRow>,
    found: Vec<FindingRow>,
}

impl Findings {
    /// Reads an `audit` artifact.
    ///
    /// # Errors
    /// If its tables cannot be read.
    pub fn read(artifact: &Artifact) -> Result<Self> {
        Ok(Self {
            summary: artifact.manifest().summary.clone(),
            demos: artifact.read()?,
            checks: artifact.read()?,
            found: artifact.read()?,
        })
    }

    /// Returns the name of a finding's demonstration.
    fn demo(&self, finding: &FindingRow) -> &str {
        self.demos.get(finding.episode as usize).map_or("", |demo| &demo.demo)
    }

    /// Returns the number of findings of a severity.
    pub fn count(&self, severity: Severity) -> usize {
        self.found.iter().filter(|finding| finding.severity == severity).count()
    }

    /// Adds all checks and findings to `answer`, the JSON description that every artifact has.
    pub fn to_json(&self, mut answer: Value) -> Value {
        let checks: Vec<Value> = self
            .checks
            .iter()
            .map(|c| {
                json!({
                    "code": c.code.to_string(), "severity": c.severity.as_str(), "findings": c.findings, "episodes": c.episodes,
                    "threshold": c.threshold, "unit": c.unit.to_string(), "origin": c.origin.to_string(), "derivation": c.derivation,
                    "measure": c.measure, "meaning": c.meaning,
                })
            })
            .collect();
        let findings: Vec<Value> = self
            .found
            .iter()
            .map(|f| {
                json!({
                    "severity": f.severity.as_str(), "code": f.code.to_string(), "episode": f.episode, "demo": self.demo(f),
                    "first_frame": f.frames.start, "end_frame": f.frames.end,
                    "value": f.value, "threshold": f.threshold, "unit": f.unit.to_string(), "message": f.message,
                    "other_demo": f.other_demo,
                })
            })
            .collect();
        answer["checks"] = json!(checks);
        answer["findings"] = json!(findings);
        answer
    }

    /// Returns the number of findings of each severity, in one line.
    pub fn headline(&self) -> String {
        let count = |severity: Severity| plural(self.count(severity), severity.as_str());
        let faulty = self.summary["episodes_with_errors"].as_u64().unwrap_or_default();
        format!(
            "{}{}, {}, {}",
            count(Severity::Error),
            if faulty > 0 {
                format!(" in {}", plural(faulty as usize, "demonstration"))
            } else {
                String::new()
            },
            count(Severity::Warning),
            count(Severity::Note)
        )
    }

    /// Describes the dataset, the checks that have findings, and the findings, the most severe first.
    ///
    /// # Errors
    /// Only if writing to a string fails, which does not happen.
    pub fn text(&self) -> Result<String> {
        let summary = &self.summary;
        let whole = |value: &Value| value.as_u64().unwrap_or_default();
        let mut text = format!(
            "{}, {} frames: {}",
            plural(whole(&summary["episodes"]) as usize, "demonstration"),
            whole(&summary["frames"]),
            self.headline()
        );
        for mode in ["transit", "transfer"] {
            let mode_of = &summary["modes"][mode];
            let median = mode_of["segment_frames"]["median"].as_f64();
            write!(
                text,
                "\n  {mode:<9} {:>5.1} % of the frames, {}{}",
                1e2 * mode_of["fraction"]
                    .as_f64()
                    .or_else(|| mode_of["share"].as_f64())
                    .unwrap_or_default(),
                plural(whole(&mode_of["segments"]) as usize, "segment"),
                median.map_or_else(String::new, |median| format!(", median length {median} frames"))
            )?;
        }
        if let Some(outcomes) = summary["grasps"]["outcomes"].as_object().filter(|o| !o.is_empty()) {
            let outcomes: Vec<String> = outcomes.iter().map(|(name, count)| format!("{count} {name}")).collect();
            write!(text, "\n  grasps    {}", outcomes.join(", "))?;
        }
        let rules = summary["rules"].as_object().into_iter().flatten();
        let agreements: Vec<String> = rules
            .filter(|(_, row)| row["configured"] == false)
            .map(|(rule, row)| format!("{:.1} % by {rule}", 1e2 * row["agreement"].as_f64().unwrap_or_default()))
            .collect();
        if !agreements.is_empty() {
            write!(
                text,
                "\n  frames with the same mode by other rules: {}",
                agreements.join(", ")
            )?;
        }
        if let Some(overlap) = summary["contacts"]["jaccard"].as_f64() {
            write!(
                text,
                "\n  contact and motion of the block agree with a Jaccard index of {overlap:.3}"
            )?;
        }
        self.write_checks(&mut text)?;
        self.write_findings(&mut text)?;
        Ok(text)
    }

    fn write_checks(&self, text: &mut String) -> Result<()> {
        let found: Vec<&CheckRow> = self.checks.iter().filter(|check| check.findings > 0).collect();
        if !found.is_empty() {
            write!(
                text,
                "\n\n  {:<8} {:<25} {:>8} {:>6}  threshold",
                "severity", "check", "findings", "demos"
            )?;
        }
        for severity in SEVERITIES {
            for check in found.iter().filter(|check| check.severity == severity) {
                let threshold = check.threshold.map_or_else(
                    || "-".to_owned(),
                    |value| format!("{} ({})", with_unit(value, &check.unit), check.origin),
                );
                write!(
                    text,
                    "\n  {:<8} {:<25} {:>8} {:>6}  {threshold}",
                    check.severity.as_str(),
                    &*check.code,
                    check.findings,
                    check.episodes
                )?;
            }
        }
        let quiet = self.checks.len() - found.len();
        let skipped: Vec<(&CheckRow, &str)> = self
            .checks
            .iter()
            .filter_map(|check| Some((check, check.derivation.strip_prefix("not made: ")?)))
            .collect();
        write!(
            text,
            "\n  {} found nothing",
            plural(
                quiet - skipped.len().min(quiet),
                if found.is_empty() { "check" } else { "other check" }
            )
        )?;
        if !skipped.is_empty() {
            write!(text, "\n\n  {} could not be made:", plural(skipped.len(), "check"))?;
        }
        let mut reasons: Vec<(&str, Vec<&str>)> = Vec::new();
        for (check, why) in skipped {
            match reasons.iter_mut().find(|(known, _)| *known == why) {
                Some((_, codes)) => codes.push(&check.code),
                None => reasons.push((why, vec![&check.code])),
            }
        }
        for (why, codes) in reasons {
            write!(text, "\n    {why}: {}", codes.join(", "))?;
        }
        Ok(())
    }

    fn write_findings(&self, text: &mut String) -> Result<()> {
        for severity in SEVERITIES {
            for check in self.checks.iter().filter(|check| check.severity == severity) {
                self.write_findings_of(&check.code, text)?;
            }
        }
        Ok(())
    }

    fn write_findings_of(&self, code: &str, text: &mut String) -> Result<()> {
        let found: Vec<&FindingRow> = self.found.iter().filter(|finding| finding.code == code).collect();
        for (place, finding) in found.iter().take(SHOWN).enumerate() {
            // A demonstration that was left out has no frames.
            let frames = match finding.frames.end.checked_sub(1) {
                Some(last) => format!("{}-{last}", finding.frames.start),
                None => String::new(),
            };
            if place == 0 {
                write!(text, "\n\n  {} {code}", finding.severity.as_str())?;
            }
            write!(
                text,
                "\n    {:<11} {frames:>9}  {}",
                self.demo(finding),
                finding.message
            )?;
        }
        if found.len() > SHOWN {
            write!(
                text,
                "\n    ... {} more; see --json or the artifact",
                found.len() - SHOWN
            )?;
        }
        Ok(())
    }
}

fn plural(count: usize, what: &str) -> String {
    format!("{count} {what}{}", if count == 1 { "" } else { "s" })
}

/// Formats a threshold with four significant digits, which are enough to recognise it; the artifact has all digits.
fn with_unit(value: f64, unit: &str) -> String {
    let digits = if value == 0.0 {
        0
    } else {
        (3 - value.abs().log10().floor() as i32).clamp(0, 8)
    };
    let mut number = format!("{value:.*}", digits as usize);
    if number.contains('.') {
        number.truncate(number.trim_end_matches('0').trim_end_matches('.').len());
    }
    if unit.is_empty() {
        number
    } else {
        format!("{number} {unit}")
    }
}
