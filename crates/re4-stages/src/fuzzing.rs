//! Readers of foreign text, without the file system: what fuzzers and the replay of their corpora call.

use std::path::Path;

use re4_fault::Remedy as _;

use crate::notes::fault_of;

/// Reads a pipeline from its text, with `--set` overrides, and checks its limits: all that `run` does before its first stage.
/// The answer is the pipeline as JSON.
///
/// # Errors
/// The sentence that the program would print.
pub fn pipeline(text: &str, overrides: &[String]) -> Result<String, String> {
    let pipeline = crate::pipeline::parse(text, Path::new("pipeline.toml"), overrides);
    let written = pipeline.and_then(|pipeline| Ok(serde_json::to_string(&pipeline)?));
    written.map_err(|error| fault_of(&error).sentence())
}
