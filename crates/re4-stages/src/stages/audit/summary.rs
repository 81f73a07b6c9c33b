//! The summary of an `audit` artifact: statistics of the whole dataset.

use std::collections::BTreeMap;

use nalgebra::{Matrix4, Quaternion, SymmetricEigen, UnitQuaternion};
use re4_audit::{AuditedEpisodeRow, GraspRow, RuleAgreementRow, Severity, Thresholds};
use re4_episode::Mode;
use re4_stats::{median, quantile, sorted};
use serde_json::{Map, Value, json};

use super::{Audited, by_code};

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

fn frames_in(row: &AuditedEpisodeRow, mode: Mode) -> usize {
    match mode {
        Mode::Transit => row.transit_frames,
        Mode::Transfer => row.transfer_frames,
    }
}

pub(super) fn summary(audited: &Audited) -> Value {
    let found = |severity| audited.findings.iter().filter(|f| f.severity == severity).count();
    let mut faulty: Vec<u32> = audited
        .findings
        .iter()
        .filter(|f| f.severity == Severity::Error)
        .map(|f| f.episode)
        .collect();
    faulty.dedup();
    let frames: usize = audited.listed.iter().map(|l| l.row.frames).sum();
    let mut modes = Map::new();
    for mode in Mode::ALL {
        let own: usize = audited.listed.iter().map(|l| frames_in(&l.row, mode)).sum();
        let lengths: Vec<f64> = audited
            .listed
            .iter()
            .flat_map(|l| &l.segments)
            .filter(|s| s.mode == mode)
            .map(|s| s.frames.len() as f64)
            .collect();
        modes.insert(
            mode.as_str().to_owned(),
            json!({
                "frames": own,
                "fraction": if frames > 0 { own as f64 / frames as f64 } else { 0.0 },
                "segments": lengths.len(),
                "segment_frames": quartiles(&lengths),
            }),
        );
    }
    let codes: BTreeMap<&str, u32> = by_code(&audited.findings)
        .into_iter()
        .map(|(code, (found, _))| (code, found))
        .collect();
    // Demonstrations that were left out have no frames and are not part of the statistics.
    let kept = audited.listed.iter().filter(|l| l.row.frames > 0);
    let lengths: Vec<f64> = kept.map(|l| l.row.frames as f64).collect();
    let mut answer = json!({
        "episodes": audited.listed.len(),
        "frames": frames,
        "findings": audited.findings.len(),
        "errors": found(Severity::Error),
        "warnings": found(Severity::Warning),
        "notes": found(Severity::Note),
        "episodes_with_errors": faulty.len(),
        "by_code": codes,
        "episode_frames": quartiles(&lengths),
        "modes": modes,
    });
    if let Some(arm) = &audited.arm {
        answer["arm"] = arm.clone();
    } else if let Some(contacts) = audited.contacts {
        answer["contacts"] = contacts.to_json();
    } else {
        answer["grasps"] = grasps(&audited.grasps);
        answer["rules"] = rules(&audited.agreements);
    }
    answer["not_made"] = not_made(&audited.thresholds);
    answer
}

/// The checks that could not be made, with the reasons.
fn not_made(thresholds: &Thresholds) -> Value {
    let skipped = thresholds.iter().filter(|(_, threshold)| !threshold.made);
    skipped
        .map(|(check, threshold)| (check.code.to_owned(), json!(threshold.derivation)))
        .collect::<Map<_, _>>()
        .into()
}

/// How far the modes by each rule agree with those of the artifact: the mean over demonstrations, and the minimum
/// over demonstrations.
fn rules(rows: &[RuleAgreementRow]) -> Value {
    let mut by_rule: BTreeMap<&str, (bool, Vec<f64>)> = BTreeMap::new();
    for row in rows {
        let entry = by_rule.entry(&*row.rule).or_default();
        entry.0 = row.configured;
        entry.1.push(row.agreement);
    }
    let described = by_rule.into_iter().map(|(rule, (configured, agreements))| {
        let mean = agreements.iter().sum::<f64>() / agreements.len().max(1) as f64;
        let least = agreements.iter().copied().reduce(f64::min);
        let row = json!({ "configured": configured, "agreement": mean, "least": least });
        (rule.to_owned(), row)
    });
    Value::Object(described.collect())
}

/// Minimum, quartiles and maximum; null if there are no values.
fn quartiles(values: &[f64]) -> Value {
    let values = sorted(values.iter().copied());
    let at = |fraction| quantile(&values, fraction);
    json!({ "min": at(0.0), "q1": at(0.25), "median": at(0.5), "q3": at(0.75), "max": at(1.0) })
}

/// Statistics of grasps: the outcomes, and the grasp poses in the object's frame of those that held the object.
fn grasps(grasps: &[GraspRow]) -> Value {
    let mut outcomes: BTreeMap<&str, u32> = BTreeMap::new();
    for grasp in grasps {
        *outcomes.entry(&*grasp.outcome).or_default() += 1;
    }
    let held: Vec<&GraspRow> = grasps.iter().filter(|grasp| grasp.is_held()).collect();
    let axis = |axis: usize| -> Vec<f64> { held.iter().map(|g| g.grasp.translation.vector[axis]).collect() };
    let column = |value: fn(&GraspRow) -> f64| held.iter().map(|g| value(g)).collect::<Vec<f64>>();
    let attitudes: Vec<_> = held.iter().map(|g| g.grasp.rotation).collect();
    json!({
        "outcomes": outcomes,
        "held": {
            "x_m": quartiles(&axis(0)),
            "y_m": quartiles(&axis(1)),
            "z_m": quartiles(&axis(2)),
            "angle_from_mean_rad": quartiles(&angles_from_mean(&attitudes)),
            "finger_separation_m": quartiles(&column(|g| g.finger_separation)),
            "rigidity_residual_m": quartiles(&column(|g| g.rigidity_residual)),
            "median_rise_m": median(&column(|g| g.object_rise)),
        },
    })
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
