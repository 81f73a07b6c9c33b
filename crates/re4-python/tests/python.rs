//! The wheel: it is packed from the programs that cargo built for the tests, installed into a clean environment without a compiler,
//! and tested there by pytest.
//!
//! `RE4_PYTHON` names the interpreter with the packages of `tests/requirements.txt`; without it, the tests report that they are
//! skipped. `RE4_WHEEL` names a wheel to test instead, such as the one that `scripts/build-wheel.sh` made.
#![allow(
    clippy::unwrap_used,
    clippy::print_stdout,
    reason = "helpers of tests fail by panicking, and print what is skipped"
)]

use std::path::{Path, PathBuf};
use std::process::{Command, Output};

fn crate_folder() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

/// The interpreter; if none is named, prints that the test is skipped.
fn python() -> Option<PathBuf> {
    let python = std::env::var_os("RE4_PYTHON").map(PathBuf::from);
    if python.is_none() {
        println!("skipped: RE4_PYTHON is not set; run scripts/setup-python.sh and set it to target/python/bin/python");
    }
    python
}

fn done(output: &Output) -> String {
    let text = String::from_utf8_lossy(&output.stdout).into_owned();
    assert!(
        output.status.success(),
        "{}\n{text}\n{}",
        output.status,
        String::from_utf8_lossy(&output.stderr)
    );
    text
}

fn run(command: &mut Command) -> String {
    done(&command.output().unwrap())
}

/// The wheel that the environment names, or one that is packed from the programs beside the program of this test.
fn wheel(python: &Path, folder: &Path) -> PathBuf {
    if let Some(named) = std::env::var_os("RE4_WHEEL") {
        return std::path::absolute(named).unwrap();
    }
    let beside = std::env::current_exe().unwrap();
    let built = beside.parent().unwrap();
    let files = [built.parent().unwrap().join("re4-pipe"), built.join("libre4_python.so")];
    // Debug information would make the wheel slow to pack and install.
    let stripped = files.map(|file| {
        assert!(
            file.is_file(),
            "{} is not built; test the whole workspace",
            file.display()
        );
        let target = folder.join(file.file_name().unwrap());
        run(Command::new("strip").arg("-o").arg(&target).arg(&file));
        target
    });
    let pack = Command::new(python)
        .arg(crate_folder().join("pack_wheel.py"))
        .args(stripped)
        .arg(folder.join("wheels"))
        .output()
        .unwrap();
    PathBuf::from(done(&pack).trim_end())
}

/// The folder with the packages that a clean environment needs, filled by `scripts/setup-python.sh`.
fn packages(python: &Path) -> PathBuf {
    python.parent().unwrap().parent().unwrap().join("wheels")
}

#[test]
fn the_wheel_works_in_a_clean_environment_without_a_compiler() {
    let Some(python) = python() else { return };
    let folder = tempfile::tempdir().unwrap();
    let wheel = wheel(&python, folder.path());
    let environment = folder.path().join("clean");
    run(Command::new(&python).args(["-m", "venv"]).arg(&environment));
    let own = environment.join("bin/python");
    // Only the clean environment is on the path, so there is no compiler.
    let clean = |program: &Path| {
        let mut command = Command::new(program);
        command.env_clear().env("PATH", environment.join("bin"));
        command
    };
    run(clean(&own)
        .args([
            "-m",
            "pip",
            "install",
            "--quiet",
            "--disable-pip-version-check",
            "--no-index",
            "--find-links",
        ])
        .arg(packages(&python))
        .arg(&wheel));
    let version = format!("re4-pipe {}\n", env!("CARGO_PKG_VERSION"));
    let command = environment.join("bin/re4-pipe");
    assert_eq!(run(clean(&command).arg("--version")), version);
    assert_eq!(run(clean(&own).args(["-m", "re4_pipe", "--version"])), version);
    let code = "import re4_pipe; print('re4-pipe', re4_pipe.__version__)";
    assert_eq!(run(clean(&own).args(["-c", code])), version);

    let repository = crate_folder().join("../..");
    let demo = clean(&command)
        .arg("run")
        .arg(repository.join("pipelines/demo.toml"))
        .args(["--seeds", "500..510", "--json", "--quiet"])
        .env("RE4_DATA", repository.join("data"))
        .current_dir(folder.path())
        .output()
        .unwrap();
    assert!(done(&demo).contains("\"score_scaled_mean\""));
    // Only libraries of C and C++, unless the wheel was packed from a build that uses the system's HDF5.
    if std::env::var_os("RE4_WHEEL").is_some() {
        let needed = run(Command::new("ldd").arg(&command));
        assert!(!needed.contains("hdf5") && !needed.contains("libz"), "{needed}");
    }
}

#[test]
fn the_tests_of_the_package_and_its_notebooks_pass() {
    let Some(python) = python() else { return };
    let folder = tempfile::tempdir().unwrap();
    let wheel = wheel(&python, folder.path());
    let installed = folder.path().join("installed");
    run(Command::new(&python)
        .args([
            "-m",
            "pip",
            "install",
            "--quiet",
            "--disable-pip-version-check",
            "--no-deps",
            "--target",
        ])
        .arg(&installed)
        .arg(&wheel));
    let mut pytest = Command::new(&python);
    pytest
        .args(["-m", "pytest", "-q", "-p", "no:cacheprovider"])
        .arg(crate_folder().join("tests"))
        .arg("--basetemp")
        .arg(folder.path().join("temporary"))
        .env("PYTHONPATH", &installed)
        .env("PYTHONDONTWRITEBYTECODE", "1");
    // The tests of the package set RE4_DATA to the samples.
    if let Some(data) = std::env::var_os("RE4_DATA") {
        pytest.env("RE4_TEST_DATA", data);
    }
    let report = run(&mut pytest);
    for line in report.lines().filter(|line| line.contains("skipped")) {
        println!("skipped: {line}");
    }

    // The notebooks that begin with the installation of the package.
    let repository = crate_folder().join("../..");
    for name in ["keep-list", "policy"] {
        run(Command::new(&python)
            .arg(repository.join("tests/run_notebook.py"))
            .arg(repository.join(format!("notebooks/{name}.ipynb")))
            .env("PYTHONPATH", &installed)
            .env("RE4_DATA", repository.join("data"))
            .env("RE4_WORK", folder.path()));
    }
}

#[test]
fn the_package_is_typed_and_formatted() {
    let Some(python) = python() else { return };
    for arguments in [&["check", "--quiet", "."][..], &["format", "--check", "--quiet", "."]] {
        run(Command::new(&python)
            .args(["-m", "ruff"])
            .args(arguments)
            .current_dir(crate_folder()));
    }
}
