//! The options that all commands have.

use super::{
    AuditArguments, Command, Common, CompareArguments, CurateArguments, DoctorArguments, ExportArguments,
    FetchArguments, InfluenceArguments, InspectArguments, MergeArguments, PlanArguments, ReferenceArguments,
    ReplayArguments, ReportArguments, SchemasArguments, StatusArguments, TrainArguments, VerifyArguments,
    VideoArguments,
};

impl Command {
    /// The options that all commands have, except for the worker, which only the program itself starts.
    pub(crate) fn common(&mut self) -> Option<&mut Common> {
        match self {
            Self::Ingest(stage)
            | Self::Segment(stage)
            | Self::Observe(stage)
            | Self::TrainEncoder(stage)
            | Self::TrainPose(stage)
            | Self::Train(TrainArguments { stage, .. })
            | Self::Index(stage)
            | Self::Scenes(stage)
            | Self::Audit(AuditArguments { stage, .. })
            | Self::Replay(ReplayArguments { stage, .. }) => Some(&mut stage.common),
            Self::Rollout(rollout) | Self::Run(rollout) => Some(&mut rollout.stage.common),
            Self::Influence(InfluenceArguments { stage, .. }) | Self::Curate(CurateArguments { stage, .. }) => {
                Some(&mut stage.common)
            }
            Self::Merge(MergeArguments { stage, .. }) | Self::Plan(PlanArguments { stage, .. }) => {
                Some(&mut stage.common)
            }
            Self::Status(StatusArguments { common, .. })
            | Self::Compare(CompareArguments { common, .. })
            | Self::Video(VideoArguments { common, .. })
            | Self::Verify(VerifyArguments { common, .. })
            | Self::Inspect(InspectArguments { common, .. })
            | Self::Report(ReportArguments { common, .. })
            | Self::Export(ExportArguments { common, .. })
            | Self::Fetch(FetchArguments { common, .. })
            | Self::Doctor(DoctorArguments { common, .. })
            | Self::Schemas(SchemasArguments { common, .. })
            | Self::Reference(ReferenceArguments { common, .. }) => Some(common),
            #[cfg(feature = "query")]
            Self::Query(super::QueryArguments { common, .. }) => Some(common),
            Self::IngestWorker => None,
        }
    }
}
