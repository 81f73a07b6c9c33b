//! Finds the Chipmunk 7 library and passes it to the linker; in each folder the archive is preferred to the shared library.

use std::env;
use std::path::{Path, PathBuf};
use std::process::Command;

/// Names a folder that contains `libchipmunk.a` or `libchipmunk.so`; it is searched first.
const FOLDER_VARIABLE: &str = "CHIPMUNK_LIB_DIR";

fn main() {
    println!("cargo::rerun-if-changed=build.rs");
    println!("cargo::rerun-if-env-changed={FOLDER_VARIABLE}");

    // The archive is preferred to the shared library of the same folder: the program then runs on machines without the library,
    // and no other copy can be loaded at run time. Debian's archive links into position-independent executables, which Rust
    // builds.
    let kinds = [
        ("libchipmunk.a", "static"),
        ("libchipmunk.so", "dylib"),
        ("libchipmunk.dylib", "dylib"),
    ];
    let found = candidate_folders().into_iter().find_map(|folder| {
        let (_, kind) = kinds.iter().find(|(name, _)| folder.join(name).is_file())?;
        Some((folder, *kind))
    });
    let Some((folder, kind)) = found else {
        println!(
            "cargo::error=the Chipmunk 7 physics library is missing; install it (Debian, Ubuntu: \
             `apt-get install libchipmunk-dev`) or name the folder of libchipmunk.a in {FOLDER_VARIABLE}"
        );
        return;
    };
    println!("cargo::rustc-link-search=native={}", folder.display());
    println!("cargo::rustc-link-lib={kind}=chipmunk");
    println!("cargo::rustc-link-lib=dylib=m");
}

/// Folders to search, in order: the variable's, pkg-config's, the C compiler's, the usual ones.
fn candidate_folders() -> Vec<PathBuf> {
    let mut folders: Vec<PathBuf> = env::var_os(FOLDER_VARIABLE).map(PathBuf::from).into_iter().collect();
    // Debian's package has no chipmunk.pc, so pkg-config may find nothing.
    if let Some(output) = output_of("pkg-config", &["--variable=libdir", "chipmunk"]) {
        folders.push(PathBuf::from(output));
    }
    for name in ["libchipmunk.a", "libchipmunk.so"] {
        if let Some(output) = output_of("cc", &[&format!("-print-file-name={name}")]) {
            // The compiler answers with the bare file name if it does not find the file.
            folders.extend(
                Path::new(&output)
                    .parent()
                    .filter(|p| p.is_absolute())
                    .map(PathBuf::from),
            );
        }
    }
    let architecture = env::var("CARGO_CFG_TARGET_ARCH").unwrap_or_default();
    folders.push(PathBuf::from(format!("/usr/lib/{architecture}-linux-gnu")));
    folders.extend(["/usr/lib64", "/usr/lib", "/usr/local/lib", "/opt/homebrew/lib"].map(PathBuf::from));
    folders
}

fn output_of(program: &str, arguments: &[&str]) -> Option<String> {
    let output = Command::new(program).args(arguments).output().ok()?;
    let text = String::from_utf8(output.stdout).ok()?;
    let text = text.trim();
    (output.status.success() && !text.is_empty()).then(|| text.to_owned())
}
