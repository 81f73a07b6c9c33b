//! Comparison of the offsets and sizes of MuJoCo's structures with its own headers.
#![allow(clippy::unwrap_used, clippy::print_stdout, reason = "tests may panic")]

use std::fmt::Write as _;
use std::fs;
use std::path::PathBuf;
use std::process::Command;

use re4_mujoco::Version;

/// The structures that the names of offsets begin with.
const TYPES: [(&str, &str); 8] = [
    ("m", "mjModel"),
    ("d", "mjData"),
    ("option", "mjvOption"),
    ("camera", "mjvCamera"),
    ("scene", "mjvScene"),
    ("geom", "mjvGeom"),
    ("eye", "mjvGLCamera"),
    ("context", "mjrContext"),
];

/// The folder with the headers of a version, if `scripts/setup-simulators.sh` has installed them.
fn headers(version: Version) -> Option<PathBuf> {
    let beside = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../../data/simulators");
    let folder = std::env::var_os("RE4_SIMULATORS").map_or(beside, PathBuf::from);
    let headers = folder.join(format!("mujoco-{version}/include"));
    if !headers.join("mujoco/mujoco.h").is_file() {
        println!(
            "skipped: no headers at {}; run scripts/setup-simulators.sh",
            headers.display()
        );
        return None;
    }
    Some(headers)
}

/// A C program that prints the offsets and sizes in the headers, one per line.
fn program(version: Version) -> String {
    let mut text = "#include <stdio.h>\n#include <stddef.h>\n#include <mujoco/mujoco.h>\nint main(void) {\n".to_owned();
    for (name, _) in version.offsets() {
        let (owner, field) = name.split_once('.').unwrap();
        let (_, kind) = TYPES.iter().find(|(short, _)| *short == owner).unwrap();
        writeln!(text, "  printf(\"{name} %zu\\n\", offsetof({kind}, {field}));").unwrap();
    }
    for (name, _) in version.sizes() {
        writeln!(text, "  printf(\"{name} %zu\\n\", sizeof({name}));").unwrap();
    }
    text + "  return 0;\n}\n"
}

#[test]
fn offsets_and_sizes_match_the_headers() {
    if Command::new("cc").arg("--version").output().is_err() {
        println!("skipped: no C compiler cc");
        return;
    }
    for version in Version::ALL {
        let Some(headers) = headers(version) else { continue };
        let folder = tempfile::tempdir().unwrap();
        let (source, binary) = (folder.path().join("layout.c"), folder.path().join("layout"));
        fs::write(&source, program(version)).unwrap();
        let compiled = Command::new("cc")
            .arg("-I")
            .args([&headers, &source])
            .arg("-o")
            .arg(&binary)
            .output()
            .unwrap();
        assert!(
            compiled.status.success(),
            "{}",
            String::from_utf8_lossy(&compiled.stderr)
        );
        let printed = Command::new(&binary).output().unwrap();
        let found = String::from_utf8(printed.stdout).unwrap();
        let numbers = version.offsets().into_iter().chain(version.sizes());
        let known: Vec<String> = numbers.map(|(name, number)| format!("{name} {number}")).collect();
        assert_eq!(found.lines().collect::<Vec<_>>(), known, "MuJoCo {version}");
        assert!(known.len() > 50);
    }
}
