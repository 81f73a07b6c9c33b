//! The audit of demonstrations and of their segmentation: what looks wrong, where, by which measure against which
//! threshold. No input or output.
//!
//! Two looks at every demonstration: [`observe_spatial`] and [`observe_planar`] give what [`Thresholds::derive`] derives
//! thresholds from, [`audit_spatial`], [`audit_planar`] and [`audit_copies`] give the findings. Demonstrations can be let go of
//! between the two.

mod checks;
mod common;
mod config;
mod finding;
mod grasps;
mod planar;
mod runs;
mod spatial;
mod tables;
mod thresholds;

pub use checks::{Applies, Basis, CHECKS, Check, markdown};
pub use common::audit_copies;
pub use config::{AuditConfig, AuditError};
pub use finding::{Finding, Severity};
pub use grasps::{GraspLimits, GraspOutcome, JudgedGrasp};
pub use planar::{PlanarDemo, audit_planar, contact_and_motion, observe_planar};
pub use spatial::{SpatialAudit, SpatialDemo, audit_spatial, observe_spatial};
pub use tables::{AuditedEpisodeRow, CheckRow, FindingRow, GraspRow};
pub use thresholds::{Observation, Origin, Threshold, Thresholds};
