//! The reader of artifacts.
#![no_main]

#[path = "../harness/artifact.rs"]
mod artifact;
#[path = "../harness/edits.rs"]
mod edits;
#[path = "../harness/memory.rs"]
mod memory;

use std::sync::LazyLock;

/// Memory limit: the artifacts are small.
const LARGEST: usize = 100 << 20;

libfuzzer_sys::fuzz_target!(|input: &[u8]| {
    static ARTIFACT: LazyLock<artifact::Sample> = LazyLock::new(artifact::Sample::new);
    let _ = ARTIFACT.run(input);
});
