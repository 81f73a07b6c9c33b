//! An `audit` artifact in words: a table of checks and the findings, or all of it as JSON.

use std::fmt::Write as _;

use anyhow::Result;
use re4_artifact::Row as _;
use re4_artifact::{Artifact, col_f64_or_null, col_text, col_u32};
use re4_audit::{AuditedEpisodeRow, CheckRow, FindingRow};
use serde_json::{Value, json};

/// Findings of one kind that are printed one by one.
const SHOWN: usize = 12;

/// What an artifact tells.
pub(crate) struct Told {
    summary: Value,
    checks: Vec<Check>,
    findings: Vec<Finding>,
}

struct Check {
    code: String,
    severity: String,
    meaning: String,
    measure: String,
    threshold: Option<f64>,
    unit: String,
    origin: String,
    derivation: String,
    findings: u32,
    episodes: u32,
}

struct Finding {
    severity: String,
    code: String,
    episode: u32,
    demo: String,
    first_frame: u32,
    end_frame: u32,
    value: Option<f64>,
    threshold: Option<f64>,
    unit: String,
    message: String,
}

/// Severities, worst first.
const SEVERITIES: [&str; 3] = ["error", "warning", "note"];

impl Told {
    /// Reads an `audit` artifact.
    pub(crate) fn read(artifact: &Artifact) -> Result<Self> {
        let rows = artifact.table(AuditedEpisodeRow::table())?.read_all()?;
        let demos: Vec<String> = words(col_text(&rows, "demo")?);
        let rows = artifact.table(CheckRow::table())?.read_all()?;
        let text = |name| Ok::<_, anyhow::Error>(words(col_text(&rows, name)?));
        let (codes, severities) = (text("code")?, text("severity")?);
        let (meanings, measures) = (text("meaning")?, text("measure")?);
        let (units, origins, derivations) = (text("unit")?, text("origin")?, text("derivation")?);
        let thresholds = col_f64_or_null(&rows, "threshold")?;
        let (found, episodes) = (col_u32(&rows, "findings")?, col_u32(&rows, "episodes")?);
        let checks = (0..rows.num_rows())
            .map(|i| Check {
                code: codes[i].clone(),
                severity: severities[i].clone(),
                meaning: meanings[i].clone(),
                measure: measures[i].clone(),
                threshold: thresholds[i],
                unit: units[i].clone(),
                origin: origins[i].clone(),
                derivation: derivations[i].clone(),
                findings: found[i],
                episodes: episodes[i],
            })
            .collect();
        let rows = artifact.table(FindingRow::table())?.read_all()?;
        let text = |name| Ok::<_, anyhow::Error>(words(col_text(&rows, name)?));
        let (codes, severities) = (text("code")?, text("severity")?);
        let (units, messages) = (text("unit")?, text("message")?);
        let (values, thresholds) = (col_f64_or_null(&rows, "value")?, col_f64_or_null(&rows, "threshold")?);
        let episodes = col_u32(&rows, "episode")?;
        let (first, end) = (col_u32(&rows, "first_frame")?, col_u32(&rows, "end_frame")?);
        let findings = (0..rows.num_rows())
            .map(|i| Finding {
                severity: severities[i].clone(),
                code: codes[i].clone(),
                episode: episodes[i],
                demo: demos.get(episodes[i] as usize).cloned().unwrap_or_default(),
                first_frame: first[i],
                end_frame: end[i],
                value: values[i],
                threshold: thresholds[i],
                unit: units[i].clone(),
                message: messages[i].clone(),
            })
            .collect();
        Ok(Self {
            summary: artifact.manifest().summary.clone(),
            checks,
            findings,
        })
    }

    /// Findings of a severity.
    pub(crate) fn count(&self, severity: &str) -> usize {
        self.findings
            .iter()
            .filter(|finding| finding.severity == severity)
            .count()
    }

    /// All of it, added to what is said of every artifact.
    pub(crate) fn to_json(&self, mut answer: Value) -> Value {
        let checks: Vec<Value> = self
            .checks
            .iter()
            .map(|c| {
                json!({
                    "code": c.code, "severity": c.severity, "findings": c.findings, "episodes": c.episodes,
                    "threshold": c.threshold, "unit": c.unit, "origin": c.origin, "derivation": c.derivation,
                    "measure": c.measure, "meaning": c.meaning,
                })
            })
            .collect();
        let findings: Vec<Value> = self
            .findings
            .iter()
            .map(|f| {
                json!({
                    "severity": f.severity, "code": f.code, "episode": f.episode, "demo": f.demo,
                    "first_frame": f.first_frame, "end_frame": f.end_frame,
                    "value": f.value, "threshold": f.threshold, "unit": f.unit, "message": f.message,
                })
            })
            .collect();
        answer["checks"] = json!(checks);
        answer["findings"] = json!(findings);
        answer
    }

    /// How many of each severity, in one line.
    pub(crate) fn headline(&self) -> String {
        let count = |severity| plural(self.count(severity), severity);
        let faulty = self.summary["episodes_with_errors"].as_u64().unwrap_or_default();
        format!(
            "{}{}, {}, {}",
            count("error"),
            if faulty > 0 {
                format!(" in {}", plural(faulty as usize, "demonstration"))
            } else {
                String::new()
            },
            count("warning"),
            count("note")
        )
    }

    /// The dataset, the checks that found something, and the findings, worst first.
    pub(crate) fn text(&self) -> Result<String> {
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
                1e2 * mode_of["share"].as_f64().unwrap_or_default(),
                plural(whole(&mode_of["segments"]) as usize, "segment"),
                median.map_or_else(String::new, |median| format!(", {median} frames in the median"))
            )?;
        }
        if let Some(outcomes) = summary["grasps"]["outcomes"].as_object().filter(|o| !o.is_empty()) {
            let outcomes: Vec<String> = outcomes.iter().map(|(name, count)| format!("{count} {name}")).collect();
            write!(text, "\n  grasps    {}", outcomes.join(", "))?;
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
        let found: Vec<&Check> = self.checks.iter().filter(|check| check.findings > 0).collect();
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
                    check.severity, check.code, check.findings, check.episodes
                )?;
            }
        }
        let quiet = self.checks.len() - found.len();
        let skipped = self
            .checks
            .iter()
            .filter(|check| check.derivation.starts_with("not made"))
            .count();
        write!(
            text,
            "\n  {} found nothing{}",
            plural(
                quiet - skipped.min(quiet),
                if found.is_empty() { "check" } else { "other check" }
            ),
            if skipped > 0 {
                format!(", {skipped} could not be made: too few values to derive a threshold from")
            } else {
                String::new()
            }
        )?;
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
        let found: Vec<&Finding> = self.findings.iter().filter(|finding| finding.code == code).collect();
        for (place, finding) in found.iter().take(SHOWN).enumerate() {
            // A demonstration that was left out has none.
            let frames = match finding.end_frame.checked_sub(1) {
                Some(last) => format!("{}-{last}", finding.first_frame),
                None => String::new(),
            };
            if place == 0 {
                write!(text, "\n\n  {} {code}", finding.severity)?;
            }
            write!(text, "\n    {:<11} {frames:>9}  {}", finding.demo, finding.message)?;
        }
        if found.len() > SHOWN {
            write!(
                text,
                "\n    ... {} more, see --json or the artifact",
                found.len() - SHOWN
            )?;
        }
        Ok(())
    }
}

fn words(column: Vec<Option<&str>>) -> Vec<String> {
    column
        .into_iter()
        .map(|word| word.unwrap_or_default().to_owned())
        .collect()
}

fn plural(count: usize, what: &str) -> String {
    format!("{count} {what}{}", if count == 1 { "" } else { "s" })
}

/// Four significant digits are enough to recognise a threshold; the artifact has all of them.
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
