//! The reader of Push-T stores in zip files.
#![no_main]

#[path = "../harness/edits.rs"]
mod edits;
#[path = "../harness/memory.rs"]
mod memory;
#[allow(dead_code, reason = "only its reader of datasets is used")]
#[path = "../harness/zarr.rs"]
mod zarr;
#[path = "../harness/zip.rs"]
mod zip;

use std::sync::LazyLock;

/// Memory limit: chunks of arrays may have 128 MiB, and their converted numbers twice as much.
const LARGEST: usize = 300 << 20;

libfuzzer_sys::fuzz_target!(|input: &[u8]| {
    static ZIP: LazyLock<zip::Zip> = LazyLock::new(zip::Zip::new);
    let _ = ZIP.run(input);
});
