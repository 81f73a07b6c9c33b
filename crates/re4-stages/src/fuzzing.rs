//! Readers of untrusted text without file access, for the fuzzers and the replay of their corpora.

use std::path::Path;

use re4_fault::Remedy as _;

use crate::notes::fault_of;

/// Parses and checks the text of a pipeline file with `--set` overrides, as `run` does before its first stage. Returns the
/// pipeline as JSON.
///
/// # Errors
/// The message that the program would print.
pub fn pipeline(text: &str, overrides: &[String]) -> Result<String, String> {
    let pipeline = crate::pipeline::parse(text, Path::new("pipeline.toml"), overrides);
    let written = pipeline.and_then(|pipeline| Ok(serde_json::to_string(&pipeline)?));
    written.map_err(|error| fault_of(&error).sentence())
}
