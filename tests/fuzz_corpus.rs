//! Replays the kept inputs of the fuzzers and the inputs that once crashed. None may stop the program.

#[path = "../fuzz/harness/artifact.rs"]
mod artifact;
#[path = "../fuzz/harness/edits.rs"]
mod edits;
#[path = "../fuzz/harness/hdf5.rs"]
mod hdf5;
#[path = "../fuzz/harness/pipeline.rs"]
mod pipeline;
#[path = "../fuzz/harness/zarr.rs"]
mod zarr;
#[path = "../fuzz/harness/zip.rs"]
mod zip;

use crate::support::repository;

/// Runs all kept inputs of a target. Some have to be accepted and some refused, because otherwise the corpus would cover little.
/// Every refusal has to be a sentence.
fn replay(target: &str, run: impl Fn(&[u8]) -> Result<(), String>) {
    let folder = repository().join("fuzz/corpus").join(target);
    let (mut accepted, mut refused, mut bytes) = (0, 0, 0);
    for (name, input) in zarr::files_below(&folder) {
        bytes += input.len();
        let outcome = std::panic::catch_unwind(std::panic::AssertUnwindSafe(|| run(&input)))
            .unwrap_or_else(|_| panic!("{target}: the input {} stops the program", name.display()));
        match outcome {
            Ok(()) => accepted += 1,
            Err(sentence) => {
                assert!(!sentence.is_empty(), "{target} {}", name.display());
                refused += 1;
            }
        }
    }
    println!("{target}: {accepted} inputs accepted, {refused} refused, {bytes} bytes");
    assert!(
        accepted > 0 && refused > 0,
        "{target}: {accepted} accepted, {refused} refused"
    );
}

#[test]
fn stores() {
    let zarr = zarr::Zarr::new(&repository());
    replay("zarr", |input| zarr.run(input));
}

#[test]
fn stores_in_zip_files() {
    let zip = zip::Zip::new();
    replay("zip", |input| zip.run(input));
}

#[test]
fn hdf5_files() {
    let hdf5 = hdf5::Hdf5::new(&repository());
    replay("hdf5", |input| hdf5.run(input));
}

#[test]
fn artifacts() {
    let sample = artifact::Sample::new();
    replay("artifact", |input| sample.run(input));
}

#[test]
fn pipelines() {
    replay("pipeline", pipeline::run);
}

/// Deeply nested tables, which are longer than the inputs of fuzzers. Tables are walked recursively, also by the TOML library.
#[test]
fn deeply_nested_pipelines() {
    let deep = 60_000;
    let demo = std::fs::read_to_string(repository().join("pipelines/demo.toml")).unwrap();
    let key = vec!["a"; deep].join(".");
    let refused = |text: &str, set: &[String]| re4_stages::fuzzing::pipeline(text, set).unwrap_err();
    assert_eq!(
        refused(&demo, &[format!("{key}=1")]),
        "cannot apply --set: the key has 60000 parts, and no setting has more than 16; write stage.key=value"
    );
    for text in [
        format!("{key} = 1"),
        format!("[{key}]"),
        format!("[[{key}]]"),
        format!("a = {}", "[".repeat(deep)),
        format!("a = {}", "{a=".repeat(deep)),
        "[[a]]\n[a.b]\n".repeat(deep),
    ] {
        assert!(!refused(&text, &[]).is_empty());
        let _ = re4_stages::fuzzing::pipeline(&demo, &[text]);
    }
    assert!(re4_stages::fuzzing::pipeline(&demo, &[]).is_ok());
}

#[test]
fn the_corpus_is_small() {
    let files = zarr::files_below(&repository().join("fuzz/corpus"));
    let bytes: usize = files.values().map(Vec::len).sum();
    assert!(
        files.len() < 2000 && bytes < 1 << 20,
        "{} files, {bytes} bytes",
        files.len()
    );
}
