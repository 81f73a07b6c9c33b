//! Self-contained HTML pages: of rollouts in the plane and in space, and of audits.
//!
//! All have one shell. A page loads nothing: style, script and data are inside of it, and a content security policy forbids
//! the rest. Its bytes follow from what it shows alone.

pub mod audit;
mod pack;
pub mod rollouts;
mod shell;
