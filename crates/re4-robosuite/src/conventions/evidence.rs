//! Deciding a convention from the residuals of its hypotheses.

use re4_stats::{nearest_rank, sorted};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::Unproven;

/// Minimum factor by which the residuals of all other hypotheses must exceed the threshold, for residuals in metres or radians.
pub const MARGIN: f64 = 10.0;

/// Source of a convention.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Basis {
    /// The numbers in the file prove it.
    Data,
    /// A setting gives it, because the numbers do not decide.
    Setting,
    /// The declared version of robosuite implies it, because the numbers do not decide and there is no setting.
    Declared,
}

/// A hypothesis with its residuals.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Candidate {
    /// The hypothesis.
    pub value: String,
    /// 99th percentile of the residuals of the frames, or the only residual if the test has one for all frames.
    pub residual: f64,
    /// Median of the residuals of the frames, or the only residual if the test has one for all frames.
    pub median: f64,
}

/// A test and its result.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Evidence {
    /// Description of the test: what the residual measures.
    pub test: String,
    /// Unit of the residuals.
    pub unit: String,
    /// Maximum residual at which a hypothesis fits.
    pub threshold: f64,
    /// Minimum median residual at which a hypothesis clearly does not fit.
    pub rival_threshold: f64,
    /// All hypotheses, best first.
    pub candidates: Vec<Candidate>,
    /// Number of frames (or demonstrations, if the test says so) that provide evidence.
    pub frames: usize,
    /// Number of frames that the test needs.
    pub frames_needed: usize,
}

/// A convention with the evidence for it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Proof {
    /// Name of the convention, as in the settings.
    pub convention: String,
    /// Its value.
    pub value: String,
    /// Its source.
    pub basis: Basis,
    /// The evidence.
    pub evidence: Evidence,
    /// A warning for the user, although the convention is accepted.
    pub warning: Option<String>,
}

/// Description and thresholds of a test.
#[derive(Debug, Clone, Copy)]
pub(super) struct Test {
    /// Description: what the residual measures.
    pub(super) name: &'static str,
    /// Unit of the residuals.
    pub(super) unit: &'static str,
    /// Maximum residual at which a hypothesis fits.
    pub(super) threshold: f64,
    /// Minimum median residual at which a hypothesis clearly does not fit.
    pub(super) rival: f64,
    /// Number of frames that are needed.
    pub(super) frames: usize,
}

/// Residuals of a hypothesis.
#[derive(Debug, Clone, Copy)]
pub(super) struct Fit {
    /// 99th percentile.
    pub(super) high: f64,
    pub(super) median: f64,
    pub(super) frames: usize,
}

impl Fit {
    /// From one residual for all frames.
    pub(super) fn whole(residual: f64, frames: usize) -> Self {
        let residual = if residual.is_nan() { f64::INFINITY } else { residual };
        Self {
            high: residual,
            median: residual,
            frames,
        }
    }

    /// From the residuals of single frames.
    pub(super) fn of(residuals: Vec<f64>) -> Self {
        let residuals = sorted(residuals);
        let quantile = |fraction: f64| {
            nearest_rank(&residuals, fraction)
                .filter(|residual| !residual.is_nan())
                .unwrap_or(f64::INFINITY)
        };
        Self {
            high: quantile(0.99),
            median: quantile(0.5),
            frames: residuals.len(),
        }
    }
}

/// The hypotheses about a convention with their residuals under a test, best first.
pub(super) struct Verdict<V> {
    test: Test,
    fits: Vec<(V, Fit)>,
}

/// The name of a value, as in settings and reports.
pub(super) fn name<V: Serialize>(value: V) -> String {
    match serde_json::to_value(value) {
        Ok(serde_json::Value::String(name)) => name,
        _ => String::new(),
    }
}

/// The value of a convention that follows from what the file declares.
pub(super) struct Declared<V> {
    pub(super) value: V,
    /// A clause that names the declaration.
    pub(super) by: String,
    /// Whether a different proven value is refused unless a setting names it. If false, it causes a warning only.
    pub(super) strict: bool,
}

impl<V: Copy + PartialEq + Serialize> Verdict<V> {
    /// Collects the hypotheses. If several hypotheses have the same value for this convention, only the best of them counts.
    pub(super) fn new(test: Test, fits: impl IntoIterator<Item = (V, Fit)>) -> Self {
        let mut best: Vec<(V, Fit)> = Vec::new();
        for (value, fit) in fits {
            match best.iter_mut().find(|(other, _)| *other == value) {
                Some((_, old)) if fit.high < old.high => *old = fit,
                Some(_) => {}
                None => best.push((value, fit)),
            }
        }
        best.sort_by(|a, b| a.1.high.total_cmp(&b.1.high));
        Self { test, fits: best }
    }

    /// The value that fits, if all others clearly do not.
    pub(super) fn proven(&self) -> Option<V> {
        let (value, fit) = self.fits.first()?;
        let rivals = &self.fits[1..];
        let fits = fit.high <= self.test.threshold && fit.frames >= self.test.frames;
        let unique = !rivals.is_empty() && rivals.iter().all(|(_, rival)| self.clearly_not(rival));
        (fits && unique).then_some(*value)
    }

    /// Whether a hypothesis clearly does not fit. With too few frames this is not known, so the result is false.
    fn clearly_not(&self, fit: &Fit) -> bool {
        fit.median >= self.test.rival && fit.frames >= self.test.frames
    }

    /// The test and the residuals of all hypotheses.
    fn evidence(&self) -> Evidence {
        Evidence {
            test: self.test.name.to_owned(),
            unit: self.test.unit.to_owned(),
            threshold: self.test.threshold,
            rival_threshold: self.test.rival,
            candidates: self
                .fits
                .iter()
                .map(|(value, fit)| Candidate {
                    value: name(value),
                    residual: fit.high,
                    median: fit.median,
                })
                .collect(),
            frames: self.fits.first().map_or(0, |(_, fit)| fit.frames),
            frames_needed: self.test.frames,
        }
    }

    /// Formats the test and the residuals for an error message.
    fn residuals(&self) -> String {
        let each: Vec<String> = self
            .fits
            .iter()
            .map(|(value, fit)| format!("{} {:.2e}", name(value), fit.high))
            .collect();
        format!(
            "{}: {} {}, over {} frames",
            self.test.name,
            each.join(", "),
            self.test.unit,
            self.fits.first().map_or(0, |(_, fit)| fit.frames)
        )
    }

    /// Describes why no value is proven, as a clause for messages.
    fn why(&self) -> String {
        let Some((_, fit)) = self.fits.first() else {
            return "there is no data to test it with".to_owned();
        };
        if fit.frames < self.test.frames {
            format!(
                "only {} of the {} needed frames provide evidence",
                fit.frames, self.test.frames
            )
        } else if fit.high > self.test.threshold {
            format!("no hypothesis has a residual of at most {:e}", self.test.threshold)
        } else {
            format!(
                "another hypothesis is not clearly wrong, because its median residual is below {:e} or it has too few frames",
                self.test.rival
            )
        }
    }

    /// Does the same as [`Verdict::settle`], but uses the declared value if the data does not decide and there is no setting.
    pub(super) fn settle_or_declared(
        &self,
        convention: &'static str,
        setting: Option<V>,
        declared: &Declared<V>,
    ) -> Result<(V, Proof), Unproven> {
        if self.proven().is_some() || setting.is_some() {
            return self.settle(convention, setting, Some(declared));
        }
        let proof = Proof {
            convention: convention.to_owned(),
            value: name(declared.value),
            basis: Basis::Declared,
            evidence: self.evidence(),
            warning: None,
        };
        Ok((declared.value, proof))
    }

    /// Determines the value and its proof from the data, the setting and the declared value.
    pub(super) fn settle(
        &self,
        convention: &'static str,
        setting: Option<V>,
        declared: Option<&Declared<V>>,
    ) -> Result<(V, Proof), Unproven> {
        let assign = |value: V| format!("{convention} = \"{}\"", name(value));
        let proof = |value: V, basis: Basis, warning: Option<String>| Proof {
            convention: convention.to_owned(),
            value: name(value),
            basis,
            evidence: self.evidence(),
            warning,
        };
        let Some(proven) = self.proven() else {
            let Some(setting) = setting else {
                let options: Vec<String> = self.fits.iter().map(|(value, _)| assign(*value)).collect();
                return Err(Unproven::Undecided {
                    convention,
                    why: self.why(),
                    residuals: self.residuals(),
                    setting: options.join(" or "),
                });
            };
            // Even if no value is proven, the setting may be clearly wrong while another value is not.
            let find = |set: bool| {
                let mut fits = self.fits.iter().filter(move |(value, _)| (*value == setting) == set);
                fits.find(|(_, fit)| self.clearly_not(fit) == set)
            };
            if let (Some(_), Some((other, _))) = (find(true), find(false)) {
                return Err(Unproven::Setting {
                    convention,
                    setting: assign(setting),
                    proven: format!("more likely {}", name(other)),
                    residuals: self.residuals(),
                });
            }
            let warning = format!("taken from the setting {}: {}", assign(setting), self.why());
            return Ok((setting, proof(setting, Basis::Setting, Some(warning))));
        };
        if let Some(setting) = setting.filter(|setting| *setting != proven) {
            return Err(Unproven::Setting {
                convention,
                setting: assign(setting),
                proven: name(proven),
                residuals: self.residuals(),
            });
        }
        let mut warning = None;
        if let Some(declared) = declared.filter(|declared| declared.value != proven) {
            if declared.strict && setting.is_none() {
                return Err(Unproven::Declared {
                    convention,
                    proven: name(proven),
                    declared: name(declared.value),
                    declared_by: declared.by.clone(),
                    residuals: self.residuals(),
                });
            }
            let (proven, expected) = (name(proven), name(declared.value));
            warning = Some(format!(
                "{}, which means {expected}, but the data proves {proven}",
                declared.by
            ));
        }
        Ok((proven, proof(proven, Basis::Data, warning)))
    }
}
