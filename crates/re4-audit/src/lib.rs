//! The audit of demonstrations and of their segmentation. A finding states what looks wrong, in which frames, and which
//! measured value was compared with which threshold. The crate does no input or output.
//!
//! An audit makes two passes over the demonstrations. In the first pass, [`observe_spatial`] and [`observe_planar`] measure the
//! values from which [`Thresholds::derive`] derives thresholds. In the second pass, [`audit_spatial`] and [`audit_planar`] return
//! the findings of one demonstration each; [`audit_copies`] compares demonstrations and needs only the results of the first
//! pass. Demonstrations can be dropped from memory between the passes. [`Survey`], [`Neighbours`] and [`Copies`] do the same with
//! observations that are read one at a time.

mod actions;
mod arm;
mod arm_facts;
mod checks;
mod common;
mod config;
mod copies;
mod finding;
mod grasps;
mod list;
mod motion;
mod object;
mod observed;
mod planar;
mod rows;
mod runs;
mod spatial;
mod tables;
mod thresholds;

pub use actions::ActionFit;
pub use arm::{ArmDemo, audit_arm, observe_arm};
pub use arm_facts::{ArmFacts, ArmSurvey};
pub use checks::{Applies, Basis, Check, Need, markdown};
pub use config::{AuditConfig, AuditError};
pub use copies::{Copies, Neighbours, Path, audit_copies};
pub use finding::{Finding, Severity};
pub use grasps::{FingerUnit, GraspLimits, GraspOutcome, JudgedGrasp};
pub use list::CHECKS;
pub use observed::{CopyRow, MeasuredRow, ObservationRow, ThresholdRow, UsualRow};
pub use planar::{PlanarDemo, audit_planar, contact_and_motion, observe_planar};
pub use spatial::{SpatialAudit, SpatialDemo, audit_spatial, observe_spatial};
pub use tables::{AuditedEpisodeRow, CheckRow, FindingRow, GraspRow, RuleAgreementRow};
pub use thresholds::{Dataset, Observation, Origin, Survey, Threshold, Thresholds, Usual};
