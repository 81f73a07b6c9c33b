//! The reader of Push-T stores.
#![no_main]

#[path = "../harness/edits.rs"]
mod edits;
#[path = "../harness/memory.rs"]
mod memory;
#[path = "../harness/zarr.rs"]
mod zarr;

use std::path::Path;
use std::sync::LazyLock;

/// Memory limit: chunks of arrays may have 128 MiB, and their converted numbers twice as much.
const LARGEST: usize = 300 << 20;

libfuzzer_sys::fuzz_target!(|input: &[u8]| {
    static ZARR: LazyLock<zarr::Zarr> =
        LazyLock::new(|| zarr::Zarr::new(&Path::new(env!("CARGO_MANIFEST_DIR")).join("..")));
    let _ = ZARR.run(input);
});
