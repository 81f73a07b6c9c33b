//! The reader of artifacts.
#![no_main]

#[path = "../harness/artifact.rs"]
mod artifact;
#[path = "../harness/edits.rs"]
mod edits;
#[path = "../harness/memory.rs"]
mod memory;

use std::sync::LazyLock;

/// The Parquet library reserves as many bytes as the header of a page says, up to 2 GiB, before it decodes the page; what is
/// not written to takes no memory, and what is counts towards the fuzzer's own limit.
const LARGEST: usize = 1 << 31;

libfuzzer_sys::fuzz_target!(|input: &[u8]| {
    static ARTIFACT: LazyLock<artifact::Sample> = LazyLock::new(artifact::Sample::new);
    let _ = ARTIFACT.run(input);
});
