//! The summary of an `audit` artifact: statistics of the whole dataset.

use std::collections::BTreeMap;

use nalgebra::{Matrix4, Quaternion, SymmetricEigen, UnitQuaternion};
use re4_audit::{AuditedEpisodeRow, GraspRow, RuleAgreementRow, Severity, Thresholds};
use re4_episode::Mode;
use re4_stats::{median, quantile, sorted};
use serde_json::{Map, Value, json};

/// Numbers of Push-T steps by whether the pusher touches the block and whether the block moves.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Contacts {
    both: u64,
    contact_only: u64,
    motion_only: u64,
    neither: u64,
}

impl FromIterator<(bool, bool)> for Contacts {
    fn from_iter<T: IntoIterator<Item = (bool, bool)>>(steps: T) -> Self {
        let mut counts = Self::default();
        for step in steps {
            match step {
                (true, true) => counts.both += 1,
                (true, false) => counts.contact_only += 1,
                (false, true) => counts.motion_only += 1,
                (false, false) => counts.neither += 1,
            }
        }
        counts
    }
}

impl Contacts {
    fn to_json(self) -> Value {
        let either = self.both + self.contact_only + self.motion_only;
        let jaccard = (either > 0).then(|| self.both as f64 / either as f64);
        json!({
            "contact_and_motion": self.both,
            "contact_alone": self.contact_only,
            "motion_alone": self.motion_only,
            "neither": self.neither,
            "jaccard": jaccard,
        })
    }
}

/// The counts of a check's findings.
#[derive(Default)]
struct Found {
    findings: u32,
    last: Option<u32>,
    episodes: u32,
}

/// Frames and segments of a mode.
#[derive(Default)]
struct InMode {
    frames: usize,
    segments: Vec<f64>,
}

/// The grasps that held the object.
#[derive(Default)]
struct Held {
    position: [Vec<f64>; 3],
    rotation: Vec<UnitQuaternion<f64>>,
    separation: Vec<f64>,
    residual: Vec<f64>,
    rise: Vec<f64>,
}

/// The agreement of a rule's modes with those of the pipeline.
struct Agreement {
    configured: bool,
    sum: f64,
    count: usize,
    least: f64,
}

/// The statistics of the rows of all tables. Rows are added in the order of the tables; a few numbers are kept of each.
#[derive(Default)]
pub(super) struct Tally {
    episodes: usize,
    lengths: Vec<f64>,
    modes: BTreeMap<&'static str, InMode>,
    findings: u32,
    errors: u32,
    warnings: u32,
    notes: u32,
    last_faulty: Option<u32>,
    faulty: u32,
    by_code: BTreeMap<String, Found>,
    outcomes: BTreeMap<String, u32>,
    held: Held,
    rules: BTreeMap<String, Agreement>,
}

impl Tally {
    pub(super) fn add_episode(&mut self, row: &AuditedEpisodeRow) {
        self.episodes += 1;
        // Demonstrations that were left out have no frames and are not part of the statistics.
        self.lengths.extend((row.frames > 0).then_some(row.frames as f64));
        self.mode(Mode::Transit).frames += row.transit_frames;
        self.mode(Mode::Transfer).frames += row.transfer_frames;
    }

    pub(super) fn add_segment(&mut self, mode: Mode, frames: usize) {
        self.mode(mode).segments.push(frames as f64);
    }

    fn mode(&mut self, mode: Mode) -> &mut InMode {
        self.modes.entry(mode.as_str()).or_default()
    }

    pub(super) fn add_finding(&mut self, code: &str, severity: Severity, episode: u32) {
        self.findings += 1;
        *match severity {
            Severity::Error => &mut self.errors,
            Severity::Warning => &mut self.warnings,
            Severity::Note => &mut self.notes,
        } += 1;
        // Findings are sorted by demonstration, so a change of demonstration means a new one.
        if severity == Severity::Error && self.last_faulty.replace(episode) != Some(episode) {
            self.faulty += 1;
        }
        if !self.by_code.contains_key(code) {
            self.by_code.insert(code.to_owned(), Found::default());
        }
        if let Some(found) = self.by_code.get_mut(code) {
            found.findings += 1;
            found.episodes += u32::from(found.last.replace(episode) != Some(episode));
        }
    }

    pub(super) fn add_grasp(&mut self, row: &GraspRow) {
        *self.outcomes.entry(row.outcome.to_string()).or_default() += 1;
        if row.is_held() {
            for (values, value) in self.held.position.iter_mut().zip(&row.grasp.translation.vector) {
                values.push(*value);
            }
            self.held.rotation.push(row.grasp.rotation);
            self.held.separation.push(row.finger_separation);
            self.held.residual.push(row.rigidity_residual);
            self.held.rise.push(row.object_rise);
        }
    }

    pub(super) fn add_agreement(&mut self, row: &RuleAgreementRow) {
        let entry = self.rules.entry(row.rule.to_string()).or_insert(Agreement {
            configured: false,
            sum: 0.0,
            count: 0,
            least: f64::INFINITY,
        });
        entry.configured = row.configured;
        entry.sum += row.agreement;
        entry.count += 1;
        entry.least = entry.least.min(row.agreement);
    }

    /// The number of findings of a check, and the number of demonstrations with such a finding.
    pub(super) fn found(&self, code: &str) -> (u32, u32) {
        self.by_code
            .get(code)
            .map_or((0, 0), |found| (found.findings, found.episodes))
    }

    /// The summary. `domain` are the statistics that only datasets of a domain have.
    pub(super) fn summary(&self, thresholds: &Thresholds, domain: OfDomain) -> Value {
        let frames: f64 = self.lengths.iter().sum();
        let modes = Mode::ALL.into_iter().map(|mode| {
            let none = InMode::default();
            let of = self.modes.get(mode.as_str()).unwrap_or(&none);
            let of = json!({
                "frames": of.frames,
                "fraction": if frames > 0.0 { of.frames as f64 / frames } else { 0.0 },
                "segments": of.segments.len(),
                "segment_frames": quartiles(&of.segments),
            });
            (mode.as_str().to_owned(), of)
        });
        let codes: BTreeMap<&str, u32> = self
            .by_code
            .iter()
            .map(|(code, found)| (&**code, found.findings))
            .collect();
        let mut answer = json!({
            "episodes": self.episodes,
            "frames": frames as u64,
            "findings": self.findings,
            "errors": self.errors,
            "warnings": self.warnings,
            "notes": self.notes,
            "episodes_with_errors": self.faulty,
            "by_code": codes,
            "episode_frames": quartiles(&self.lengths),
            "modes": modes.collect::<Map<_, _>>(),
        });
        match domain {
            OfDomain::Arm(arm) => answer["arm"] = arm,
            OfDomain::Plane(contacts) => answer["contacts"] = contacts.to_json(),
            OfDomain::Space => {
                answer["grasps"] = self.grasps();
                answer["rules"] = self.agreements();
            }
        }
        answer["not_made"] = not_made(thresholds);
        answer
    }

    /// Statistics of grasps: the outcomes, and the grasp poses in the object's frame of those that held the object.
    fn grasps(&self) -> Value {
        let held = &self.held;
        let [x, y, z] = held.position.each_ref().map(|axis| quartiles(axis));
        json!({
            "outcomes": self.outcomes,
            "held": {
                "x_m": x,
                "y_m": y,
                "z_m": z,
                "angle_from_mean_rad": quartiles(&angles_from_mean(&held.rotation)),
                "finger_separation_m": quartiles(&held.separation),
                "rigidity_residual_m": quartiles(&held.residual),
                "median_rise_m": median(&held.rise),
            },
        })
    }

    /// How far the modes by each rule agree with those of the artifact: the mean over demonstrations, and the minimum over
    /// demonstrations.
    fn agreements(&self) -> Value {
        let described = self.rules.iter().map(|(rule, of)| {
            let row = json!({ "configured": of.configured, "agreement": of.sum / of.count as f64, "least": of.least });
            (rule.clone(), row)
        });
        Value::Object(described.collect())
    }
}

/// What is known only about datasets of one domain.
pub(super) enum OfDomain {
    Plane(Contacts),
    Space,
    /// What is known about a dataset of an arm without an object.
    Arm(Value),
}

/// The checks that could not be made, with the reasons.
fn not_made(thresholds: &Thresholds) -> Value {
    let skipped = thresholds.iter().filter(|(_, threshold)| !threshold.made);
    skipped
        .map(|(check, threshold)| (check.code.to_owned(), json!(threshold.derivation)))
        .collect::<Map<_, _>>()
        .into()
}

/// Minimum, quartiles and maximum; null if there are no values.
fn quartiles(values: &[f64]) -> Value {
    let values = sorted(values.iter().copied());
    let at = |fraction| quantile(&values, fraction);
    json!({ "min": at(0.0), "q1": at(0.25), "median": at(0.5), "q3": at(0.75), "max": at(1.0) })
}

/// Angles in rad between orientations and their mean. The mean is the eigenvector of the sum of q qᵀ with the largest eigenvalue,
/// which does not depend on the signs of the quaternions.
fn angles_from_mean(attitudes: &[UnitQuaternion<f64>]) -> Vec<f64> {
    let sum = attitudes
        .iter()
        .fold(Matrix4::zeros(), |sum, q| sum + q.coords * q.coords.transpose());
    let eigen = SymmetricEigen::new(sum);
    let mean = UnitQuaternion::new_normalize(Quaternion::from_vector(
        eigen.eigenvectors.column(eigen.eigenvalues.imax()).into_owned(),
    ));
    attitudes.iter().map(|attitude| attitude.angle_to(&mean)).collect()
}
