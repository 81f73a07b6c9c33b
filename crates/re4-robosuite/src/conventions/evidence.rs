//! From residuals to a verdict.

use re4_stats::{nearest_rank, sorted};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::Unproven;

/// Where residuals are metres or radians, other hypotheses must miss the threshold by at least this factor.
pub const MARGIN: f64 = 10.0;

/// What a convention rests on.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Basis {
    /// The numbers of the file.
    Data,
    /// A setting, where the numbers cannot tell.
    Setting,
    /// What robosuite of the declared version does, where the numbers cannot tell and nothing is set.
    Declared,
}

/// A hypothesis and how well it fits.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Candidate {
    /// The hypothesis.
    pub value: String,
    /// Residual that 99 % of the frames do not exceed, or the residual over all frames.
    pub residual: f64,
    /// Residual that half of the frames do not exceed, or the residual over all frames.
    pub median: f64,
}

/// Which test was made and what came out.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Evidence {
    /// The test, in words.
    pub test: String,
    /// Unit of the residuals.
    pub unit: String,
    /// The maximum residual with which a hypothesis fits.
    pub threshold: f64,
    /// The minimum median residual with which a hypothesis clearly does not fit.
    pub rival_threshold: f64,
    /// All hypotheses, best first.
    pub candidates: Vec<Candidate>,
    /// Frames (or demos, where the test says so) that had something to tell.
    pub frames: usize,
    /// How many are needed.
    pub frames_needed: usize,
}

/// A convention with the evidence for it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Proof {
    /// Name of the convention, as in the settings.
    pub convention: String,
    /// Its value.
    pub value: String,
    /// What it rests on.
    pub basis: Basis,
    /// The evidence.
    pub evidence: Evidence,
    /// What a user should know although the convention is settled.
    pub warning: Option<String>,
}

/// What a test asks for.
#[derive(Debug, Clone, Copy)]
pub(super) struct Test {
    pub(super) name: &'static str,
    pub(super) unit: &'static str,
    pub(super) threshold: f64,
    pub(super) rival: f64,
    pub(super) frames: usize,
}

/// Residuals of a hypothesis.
#[derive(Debug, Clone, Copy)]
pub(super) struct Fit {
    pub(super) high: f64,
    pub(super) median: f64,
    pub(super) frames: usize,
}

impl Fit {
    /// One residual over all frames.
    pub(super) fn whole(residual: f64, frames: usize) -> Self {
        let residual = if residual.is_nan() { f64::INFINITY } else { residual };
        Self {
            high: residual,
            median: residual,
            frames,
        }
    }

    /// Residuals of single frames.
    pub(super) fn of(residuals: Vec<f64>) -> Self {
        let residuals = sorted(residuals);
        let quantile = |share: f64| {
            nearest_rank(&residuals, share)
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

/// A convention's hypotheses under a test, best first.
pub(super) struct Verdict<V> {
    test: Test,
    fits: Vec<(V, Fit)>,
}

/// The name of a value in settings and reports.
pub(super) fn name<V: Serialize>(value: V) -> String {
    match serde_json::to_value(value) {
        Ok(serde_json::Value::String(name)) => name,
        _ => String::new(),
    }
}

/// What a file's declarations entail for a convention.
pub(super) struct Declared<V> {
    pub(super) value: V,
    /// A clause that names the declaration.
    pub(super) by: String,
    /// Whether another proven value needs a setting; otherwise it is a warning.
    pub(super) strict: bool,
}

impl<V: Copy + PartialEq + Serialize> Verdict<V> {
    /// Of hypotheses that say more than this convention, the best for each value counts.
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

    /// The value that fits while the others clearly do not.
    pub(super) fn proven(&self) -> Option<V> {
        let (value, fit) = self.fits.first()?;
        let rivals = &self.fits[1..];
        let fits = fit.high <= self.test.threshold && fit.frames >= self.test.frames;
        let alone = !rivals.is_empty() && rivals.iter().all(|(_, rival)| self.clearly_not(rival));
        (fits && alone).then_some(*value)
    }

    /// A rival without enough frames has told nothing.
    fn clearly_not(&self, fit: &Fit) -> bool {
        fit.median >= self.test.rival && fit.frames >= self.test.frames
    }

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

    fn why(&self) -> String {
        let Some((_, fit)) = self.fits.first() else {
            return "there is nothing to test it on".to_owned();
        };
        if fit.frames < self.test.frames {
            format!(
                "only {} of {} needed frames tell anything",
                fit.frames, self.test.frames
            )
        } else if fit.high > self.test.threshold {
            format!("no hypothesis fits within {:e}", self.test.threshold)
        } else {
            format!("another hypothesis is not clearly off, by {:e}", self.test.rival)
        }
    }

    /// As [`Verdict::settle`], but where the data tells nothing and there is no setting, what is declared is taken.
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

    /// The value and its proof, from the data, the setting and what the file declares.
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
            // Where nothing fits, the setting may still be the one value that is clearly off.
            let off = |wanted: bool| {
                let mut fits = self.fits.iter().filter(move |(value, _)| (*value == setting) == wanted);
                fits.find(|(_, fit)| self.clearly_not(fit) == wanted)
            };
            if let (Some(_), Some((other, _))) = (off(true), off(false)) {
                return Err(Unproven::Setting {
                    convention,
                    setting: assign(setting),
                    proven: format!("rather {}", name(other)),
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
