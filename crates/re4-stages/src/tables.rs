//! The tables of all artifacts.

use re4_artifact::{Artifact, ArtifactError, Row as _, Stage, TableSpec};
use re4_audit::{
    AuditedEpisodeRow, CheckRow, CopyRow, FindingRow, GraspRow, MeasuredRow, ObservationRow, RuleAgreementRow,
    ThresholdRow, UsualRow,
};
use re4_compare::{CellRow, CurveRow, DifferenceRow};
use re4_index::{IndexRow, PlanarState, ScaleRow, SpatialState};
use re4_influence::{CuratedRow, InfluenceRow, JudgedEpisodeRow, JudgedRow, PairRow, RoundRow};
use re4_ingest::{
    ArmColumns, Convention, DemoRow, EpisodeRow, FrameRow, ImageRow, LeftOut, LeftOutFrameRow, ModelRow, PlanarColumns,
    SignalRow, SpatialColumns, StateRow,
};
use re4_policy::{Chunk, kinds};
use re4_pose::{AnchorRow, Estimate, LabelRow, PoseErrorRow, PoseRow, SpatialEstimate, TrainingRow};
use re4_scenes::SceneRow;
use re4_scores::{PathRow, ReferenceRow, ScoreRow, SketchRow};
use re4_segment::{
    ArmEvidence, ArmSegment, Evidence, ModeRow, SegmentRow, SegmentSummary, SpatialEvidence, SpatialSegment,
};

use crate::stages::{
    BudgetRow, DivergenceRow, PlanarDivergenceRow, PlanarReplay, PolicyTrainingRow, ReplayRow, SpatialDivergence,
    SpatialReplay,
};

/// The tables that a stage's artifact may contain. An artifact may lack some of them, such as images if none were ingested.
pub fn of(stage: Stage) -> Vec<&'static TableSpec> {
    match stage {
        Stage::Ingest => vec![
            EpisodeRow::table(),
            FrameRow::<PlanarColumns>::table(),
            FrameRow::<SpatialColumns>::table(),
            FrameRow::<ArmColumns>::table(),
            SignalRow::table(),
            ImageRow::table(),
            DemoRow::table(),
            Convention::table(),
            LeftOut::table(),
            LeftOutFrameRow::<SpatialColumns>::table(),
            StateRow::table(),
            ModelRow::table(),
        ],
        Stage::Segment => vec![
            ModeRow::<Evidence>::table(),
            ModeRow::<SpatialEvidence>::table(),
            ModeRow::<ArmEvidence>::table(),
            SegmentRow::<SegmentSummary>::table(),
            SegmentRow::<SpatialSegment>::table(),
            SegmentRow::<ArmSegment>::table(),
        ],
        Stage::Observe => vec![
            ObservationRow::table(),
            MeasuredRow::table(),
            SketchRow::table(),
            PathRow::table(),
            ThresholdRow::table(),
            UsualRow::table(),
            CopyRow::table(),
            ReferenceRow::table(),
        ],
        Stage::Audit => vec![
            FindingRow::table(),
            CheckRow::table(),
            AuditedEpisodeRow::table(),
            GraspRow::table(),
            ScoreRow::table(),
            RuleAgreementRow::table(),
        ],
        Stage::Index => vec![
            IndexRow::<PlanarState>::table(),
            IndexRow::<SpatialState>::table(),
            ScaleRow::table(),
            Chunk::table(),
        ],
        Stage::Train => vec![PolicyTrainingRow::table()],
        Stage::Scenes => vec![SceneRow::table()],
        Stage::Rollout => [
            re4_rollout::tables().to_vec(),
            kinds::tables(),
            vec![BudgetRow::table()],
        ]
        .concat(),
        Stage::Replay => vec![
            ReplayRow::<PlanarReplay>::table(),
            ReplayRow::<SpatialReplay>::table(),
            PlanarDivergenceRow::table(),
            DivergenceRow::<SpatialDivergence>::table(),
        ],
        Stage::Compare => vec![CellRow::table(), DifferenceRow::table(), CurveRow::table()],
        Stage::Influence => vec![InfluenceRow::table(), JudgedEpisodeRow::table(), PairRow::table()],
        Stage::Curate => vec![CuratedRow::table(), RoundRow::table(), JudgedRow::table()],
        Stage::TrainEncoder => vec![TrainingRow::table(), LabelRow::table()],
        Stage::TrainPose => vec![
            PoseRow::<Estimate>::table(),
            PoseRow::<SpatialEstimate>::table(),
            AnchorRow::table(),
            PoseErrorRow::table(),
        ],
    }
}

/// All tables, each with the stage that writes it.
pub fn all() -> impl Iterator<Item = (Stage, &'static TableSpec)> {
    Stage::ALL
        .into_iter()
        .flat_map(|stage| of(stage).into_iter().map(move |spec| (stage, spec)))
}

/// The description of an artifact's table, by its name in the artifact. If both domains have a table of that name, the domain in
/// the file's metadata decides.
pub fn described(artifact: &Artifact, name: &str) -> Option<&'static TableSpec> {
    let (named, former): (Vec<_>, Vec<_>) = all()
        .map(|(_, spec)| spec)
        .filter(|spec| spec.name == name || spec.formerly == name)
        .partition(|spec| spec.name == name);
    let domain = artifact.table_named(name).ok()?.domain();
    let of_domain = |spec: &&&TableSpec| domain.as_deref().is_none_or(|domain| spec.domain == domain);
    // Files without a domain are older than the shared names. Spatial tables had other names then, so such a file is planar.
    let first = named.iter().filter(of_domain).min_by_key(|spec| spec.domain);
    first.or(former.iter().find(|spec| artifact.has_table(spec))).copied()
}

/// Refuses an artifact that contains a table with a newer version than this build supports.
///
/// # Errors
/// [`ArtifactError::NewerTable`].
pub fn refuse_newer(artifact: &Artifact) -> Result<(), ArtifactError> {
    for (name, summary) in &artifact.manifest().tables {
        let versions = all()
            .filter(|(_, spec)| spec.name == name)
            .map(|(_, spec)| spec.version);
        if let Some(supported) = versions.max().filter(|newest| summary.schema_version > *newest) {
            return Err(ArtifactError::NewerTable {
                folder: artifact.path().to_path_buf(),
                table: name.clone(),
                found: summary.schema_version,
                supported,
            });
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use re4_artifact::{ArtifactSummary, ColumnSpec, Recipe, Store, verify};
    use std::collections::{BTreeMap, BTreeSet};

    #[test]
    fn tables_of_older_artifacts_are_described_by_their_former_names() {
        let folder = tempfile::tempdir().unwrap();
        let store = Store::open(folder.path()).unwrap();
        let mut count = 0;
        for (stage, spec) in
            all().filter(|(_, spec)| !spec.formerly.is_empty() && !matches!(spec.domain, "plane" | "arm"))
        {
            // Two tables may have been one table before.
            let was = all().filter(|(_, other)| (other.formerly, other.domain) == (spec.formerly, spec.domain));
            let columns = was.flat_map(|(_, part)| part.columns_at(1).map(|column| (part.name_at(column, 1), column)));
            let columns: BTreeMap<&str, ColumnSpec> = columns
                .map(|(name, column)| {
                    let formerly = "";
                    (
                        name,
                        ColumnSpec {
                            name,
                            formerly,
                            ..*column
                        },
                    )
                })
                .collect();
            let old: &'static TableSpec = Box::leak(Box::new(TableSpec {
                name: spec.formerly,
                version: 1,
                domain: "",
                formerly: "",
                description: spec.description,
                columns: columns.into_values().collect::<Vec<_>>().leak(),
            }));
            let recipe = Recipe::new(stage, 1).config(&spec.title()).unwrap();
            let writer = store.begin(&recipe).unwrap();
            writer.table(old).unwrap().finish().unwrap();
            let artifact = writer.publish(ArtifactSummary::default()).unwrap();
            let found = described(&artifact, spec.formerly).unwrap();
            assert_eq!((found.formerly, found.domain), (spec.formerly, spec.domain));
            artifact.table(spec).unwrap();
            verify(artifact.path(), &described).unwrap();
            count += 1;
        }
        assert_eq!(count, 12);
    }

    #[test]
    fn table_declarations_are_consistent() {
        let mut names = BTreeSet::new();
        for (_, table) in all() {
            assert!(names.insert((table.name, table.domain)), "{} twice", table.name);
            let columns: BTreeSet<_> = table.columns.iter().map(|c| c.name).collect();
            assert_eq!(columns.len(), table.columns.len(), "{} repeats a column", table.name);
            assert!(table.description.ends_with('.'), "{}", table.name);
            for column in table.columns {
                assert!(column.description.ends_with('.'), "{}.{}", table.name, column.name);
                assert!(
                    (1..=table.version).contains(&column.since),
                    "{}.{}",
                    table.name,
                    column.name
                );
                assert!(
                    column.since == 1 || column.nullable,
                    "{}.{} was added in a later version and has to be nullable, so that older tables can be read",
                    table.name,
                    column.name
                );
            }
        }
        assert_eq!(names.len(), 74);
    }
}
