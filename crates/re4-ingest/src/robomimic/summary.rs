//! Information about a file as a whole: warnings, and errors of converted actions.

use re4_stats::{nearest_rank, sorted};
use serde::Serialize;

use super::fault::Hdf5Fault;
use super::file::Access;
use super::reader::{DemoChoice, RobomimicReader};
use super::sources::Sources;
use crate::error::{Fault, IngestError};
use crate::warning::{Warning, WarningCode};

/// Datasets that are ingested, in addition to the images of cameras.
const TAKEN: [&str; 11] = [
    "actions",
    "action_dict",
    "actions_abs",
    "datagen_info",
    "dones",
    "obs/object",
    "obs/robot0_eef_pos",
    "obs/robot0_eef_quat",
    "obs/robot0_gripper_qpos",
    "rewards",
    "states",
];

/// Another file of the same demonstrations, with actions of the other kind (absolute or delta).
pub struct Comparison {
    reader: RobomimicReader,
}

impl Comparison {
    /// Opens the file.
    ///
    /// # Errors
    /// Same as [`RobomimicReader::open`].
    pub fn open(sources: &Sources, access: Access) -> Result<Self, IngestError> {
        RobomimicReader::open(sources, &DemoChoice::default(), access, None).map(|reader| Self { reader })
    }

    /// Checks that its files have not changed since they were opened.
    ///
    /// # Errors
    /// Names the first file that changed.
    pub(super) fn unchanged(&self) -> Result<(), IngestError> {
        self.reader.sources().unchanged()
    }

    /// Actions of the demonstration with this name and length; `None` if it does not exist.
    ///
    /// # Errors
    /// The actions cannot be read, or their length differs.
    pub fn actions(&self, demo: &str, frames: usize) -> Result<Option<Vec<[f64; 7]>>, IngestError> {
        let refuse = |fault: Hdf5Fault| Fault::from(fault).of(&self.reader.path);
        let actions = self.reader.actions(demo).map_err(refuse)?;
        match actions {
            Some(actions) if actions.len() != frames => Err(refuse(Hdf5Fault::Length {
                objects: vec![format!("data/{demo}/actions")],
                found: actions.len(),
                other: "the demonstration of that name in ingest.source".to_owned(),
                expected: frames,
            })),
            actions => Ok(actions),
        }
    }
}

/// Distribution of the differences between recorded absolute actions and those computed from delta actions, without the first
/// step of each demonstration.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct GoalErrors {
    /// Number of compared steps.
    pub steps: u64,
    /// Differences of positions in metres: median, 90 %, 99 %, maximum.
    pub position_m: [f64; 4],
    /// Angles between orientations in radians, in the same order.
    pub rotation_rad: [f64; 4],
}

impl GoalErrors {
    /// Computes the distribution; `None` if there are no steps.
    pub fn of(errors: &[(f64, f64)]) -> Option<Self> {
        let quantiles = |value: fn(&(f64, f64)) -> f64| {
            let values = sorted(errors.iter().map(value));
            [0.5, 0.9, 0.99, 1.0].map(|fraction| nearest_rank(&values, fraction).unwrap_or(f64::NAN))
        };
        (!errors.is_empty()).then(|| Self {
            steps: errors.len() as u64,
            position_m: quantiles(|error| error.0),
            rotation_rad: quantiles(|error| error.1),
        })
    }
}

impl RobomimicReader {
    /// A warning about datasets of the first demonstration that are not ingested; images of `cameras` are ingested.
    ///
    /// # Errors
    /// A group cannot be read.
    pub(super) fn skipped_warning(&self, cameras: &[String]) -> Result<Option<Warning>, IngestError> {
        let taken = |name: &str| {
            let camera = name.strip_prefix("obs/").and_then(|name| self.image_names.camera(name));
            TAKEN.contains(&name) || camera.is_some_and(|camera| cameras.iter().any(|taken| taken == camera))
        };
        let skipped = self.skipped(taken).map_err(|fault| Fault::from(fault).of(&self.path))?;
        let message = format!("not ingested: {}", skipped.join(", "));
        Ok((!skipped.is_empty()).then(|| Warning::new(WarningCode::SkippedDatasets, message, skipped.len())))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quantiles_are_observed_values() {
        let errors: Vec<(f64, f64)> = (1..=100).map(|i| (f64::from(i), 0.0)).collect();
        let found = GoalErrors::of(&errors).unwrap();
        assert_eq!(found.position_m, [50.0, 90.0, 99.0, 100.0]);
        assert_eq!(GoalErrors::of(&[]), None);
        assert_eq!(GoalErrors::of(&[(2.0, 1.0)]).unwrap().position_m, [2.0; 4]);
    }
}
