//! Self-contained HTML pages of planar and spatial rollouts, of audits, of trainings, and of comparisons.
//!
//! All pages have the same shell. A page loads nothing: it contains its style, script and data, and a content security policy
//! forbids everything else. The bytes of a page depend only on the data that it shows.

pub mod audit;
pub mod comparison;
pub mod influence;
mod pack;
pub mod rollouts;
mod shell;
pub mod training;
