//! The audit of demonstrations and of their segmentation: what looks wrong, where, by which measure against which
//! threshold. No input or output.

mod config;
mod finding;

pub use config::AuditConfig;
pub use finding::{Finding, Severity};
