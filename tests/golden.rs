//! The demo pipeline on the bundled sample always gives the same bytes.
//!
//! The snapshot contains the BLAKE3 hash of every table. It changes only if a preset, a stage or the sample is changed on
//! purpose. On another machine it may differ, because the system's math library computes the last bits of sines and cosines.
//! Accept an intended change with `INSTA_UPDATE=always cargo test -p re4-pipe golden::`.

use std::fmt::Write as _;
use std::process::Command;

use crate::support::{Answer, PROGRAM, folders_in, repository};
use re4_artifact::Artifact;
use tempfile::TempDir;

/// Runs the demo as a user does, in the top folder of the repository. Returns its score table and the hashes of its tables.
fn demo(pipeline: &str, jobs: &str) -> String {
    let folder = TempDir::new().unwrap();
    let output = Command::new(PROGRAM)
        .current_dir(repository())
        .env_remove("RE4_DATA")
        .args(["run", pipeline, "--quiet", "--jobs", jobs, "--artifacts"])
        .arg(folder.path())
        .output()
        .unwrap();
    let mut text = Answer::new(&output, folder.path()).done().stdout;
    for kind in folders_in(folder.path()) {
        for path in folders_in(&kind) {
            let Ok(artifact) = Artifact::open(&path) else { continue };
            let manifest = artifact.manifest();
            writeln!(text, "{} {}", manifest.artifact, manifest.key).unwrap();
            for (name, summary) in &manifest.tables {
                writeln!(
                    text,
                    "  {name} {} rows, {} bytes, {}",
                    summary.rows, summary.bytes, summary.blake3
                )
                .unwrap();
            }
        }
    }
    text
}

#[test]
fn the_demo_gives_the_same_bytes_in_every_run() {
    let one = demo("pipelines/demo.toml", "1");
    for jobs in ["2", "4"] {
        assert_eq!(demo("pipelines/demo.toml", jobs), one, "--jobs {jobs}");
    }
    insta::assert_snapshot!(one);
}

#[test]
fn the_demo_from_images_gives_the_same_bytes_in_every_run() {
    let one = demo("pipelines/demo-image.toml", "1");
    assert_eq!(demo("pipelines/demo-image.toml", "2"), one);
    insta::assert_snapshot!(one);
}
