//! The values of the measures in the rollouts of a cell.

use std::collections::BTreeMap;

use re4_artifact::{Artifact, ArtifactError, Row as _, columns};
use re4_rollout::{PlaneResultRow, SpaceResultRow};

use crate::Measure;

columns! {
    /// The columns of a result of Push-T that are compared.
    pub struct PlaneOutcome {
        /// Seed or number of the scene.
        pub seed: u32,
        /// Whether the task succeeded.
        pub success: bool,
        /// Maximum score.
        pub score_max: f64,
        /// Maximum coverage.
        pub coverage_max: f64,
        /// Maximum IoU.
        pub iou_max: f64,
    }
}

columns! {
    /// The columns of a result of a robosuite task that are compared.
    pub struct SpaceOutcome {
        /// Seed of the scene.
        pub seed: u32,
        /// Whether the task succeeded.
        pub success: bool,
    }
}

/// The values of every measure, one per seed, in the order of the rollouts.
#[derive(Debug, Clone, PartialEq)]
pub struct Outcomes {
    seeds: Vec<u32>,
    values: BTreeMap<Measure, Vec<f64>>,
}

impl Outcomes {
    /// Outcomes of these seeds, or numbers of scenes. Each list of values has as many values as there are seeds.
    pub fn new(seeds: Vec<u32>, values: impl IntoIterator<Item = (Measure, Vec<f64>)>) -> Self {
        let values = values.into_iter().collect();
        Self { seeds, values }
    }

    /// Reads the table `results` of a `rollouts` artifact.
    ///
    /// # Errors
    /// If the table cannot be read.
    pub fn read(rollouts: &Artifact) -> Result<Self, ArtifactError> {
        let space = rollouts.table_named(SpaceResultRow::NAME)?.domain().as_deref() == Some("space");
        if space {
            let rows: Vec<SpaceOutcome> = rollouts.table(SpaceResultRow::table())?.read()?;
            let success = rows.iter().map(|row| number(row.success)).collect();
            return Ok(Self::new(
                rows.iter().map(|row| row.seed).collect(),
                [(Measure::Success, success)],
            ));
        }
        let rows: Vec<PlaneOutcome> = rollouts.table(PlaneResultRow::table())?.read()?;
        let all = |value: fn(&PlaneOutcome) -> f64| rows.iter().map(value).collect();
        Ok(Self::new(
            rows.iter().map(|row| row.seed).collect(),
            [
                (Measure::Score, all(|row| row.score_max)),
                (Measure::Coverage, all(|row| row.coverage_max)),
                (Measure::Iou, all(|row| row.iou_max)),
                (Measure::Success, all(|row| number(row.success))),
            ],
        ))
    }

    /// The seeds, or the numbers of scenes.
    pub fn seeds(&self) -> &[u32] {
        &self.seeds
    }

    /// The values of a measure; `None` if the rollouts do not have it.
    pub fn of(&self, measure: Measure) -> Option<&[f64]> {
        self.values.get(&measure).map(Vec::as_slice)
    }
}

fn number(success: bool) -> f64 {
    f64::from(u8::from(success))
}
