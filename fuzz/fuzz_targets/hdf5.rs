//! The reader of HDF5 files that does not use the HDF5 library.
#![no_main]

#[path = "../harness/edits.rs"]
mod edits;
#[path = "../harness/hdf5.rs"]
mod hdf5;
#[path = "../harness/memory.rs"]
mod memory;
#[allow(dead_code, reason = "only the selection of demonstrations is used")]
#[path = "../harness/zarr.rs"]
mod zarr;

use std::path::Path;
use std::sync::LazyLock;

/// Memory limit: no structure of a file may be larger than the file.
const LARGEST: usize = 64 << 20;

libfuzzer_sys::fuzz_target!(|input: &[u8]| {
    static HDF5: LazyLock<hdf5::Hdf5> =
        LazyLock::new(|| hdf5::Hdf5::new(&Path::new(env!("CARGO_MANIFEST_DIR")).join("..")));
    let _ = HDF5.run(input);
});
