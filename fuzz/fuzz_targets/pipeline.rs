//! The reader of pipeline files.
#![no_main]

#[path = "../harness/memory.rs"]
mod memory;
#[path = "../harness/pipeline.rs"]
mod pipeline;

/// Memory limit: ten million seeds and their sorted copy, while the vector grows.
const LARGEST: usize = 100 << 20;

libfuzzer_sys::fuzz_target!(|input: &[u8]| {
    let _ = pipeline::run(input);
});
