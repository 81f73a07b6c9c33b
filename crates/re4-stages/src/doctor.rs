//! Reports what is installed and what is missing, with the command that installs it.

use std::fmt;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use re4_fault::Remedy as _;
use re4_mujoco::{Gl, Library, Version};
use serde::Serialize;

use crate::inputs::simulators::{assets_folder, mujoco_folder, simulators_folder};
use crate::inputs::sources::{data_folders, find_source, find_weights};
use crate::notes::fault_of;
use crate::pipeline::{Pipeline, PoseSource};

/// Whether a component was found.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum State {
    /// Found and usable.
    Found,
    /// Not found. Only some tasks or commands need it.
    Absent,
    /// Not found. The pipeline, or every command, needs it.
    Missing,
}

impl fmt::Display for State {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(match self {
            Self::Found => "found",
            Self::Absent => "absent",
            Self::Missing => "MISSING",
        })
    }
}

/// The result for one component.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Finding {
    /// Group of the component: `program`, `datasets`, `simulators`, `python`, `pipeline`.
    pub group: &'static str,
    /// Name of the component.
    pub name: String,
    /// Whether it was found.
    pub state: State,
    /// Its path or version, or the reason why it cannot be used.
    pub detail: String,
    /// What needs it. Empty if every command needs it.
    pub needed_by: String,
    /// The command that installs it.
    pub fix: Option<String>,
}

/// Looks for all components that the commands use. A component that a stage of `pipeline` needs is [`State::Missing`] if it is not
/// found.
pub fn doctor(pipeline: Option<&Pipeline>, artifacts: &Path) -> Vec<Finding> {
    let mut found = program(artifacts);
    found.extend(datasets());
    found.extend(simulators(pipeline));
    found.extend(python());
    found.extend(pipeline.map(of_pipeline).unwrap_or_default());
    found
}

/// A part of the program.
fn part(name: &str, detail: impl Into<String>) -> Finding {
    Finding {
        group: "program",
        name: name.to_owned(),
        state: State::Found,
        detail: detail.into(),
        needed_by: String::new(),
        fix: None,
    }
}

/// The program itself and the artifacts folder.
fn program(artifacts: &Path) -> Vec<Finding> {
    let target = format!("{} {}", std::env::consts::OS, std::env::consts::ARCH);
    let threads = rayon::current_num_threads();
    let backends = if cfg!(feature = "torch") {
        "flex (pure Rust, CPU), torch (libtorch: CPU and CUDA)"
    } else {
        "flex (pure Rust, CPU)"
    };
    let mut found = vec![
        part(
            "re4-pipe",
            format!("{}, {target}, {threads} threads", env!("CARGO_PKG_VERSION")),
        ),
        part("HDF5", format!("{}, linked", re4_ingest::hdf5_version())),
        part("encoder backends", backends),
    ];
    if !cfg!(feature = "torch") {
        found.push(Finding {
            state: State::Absent,
            needed_by: "pose.encoder.backend = \"torch\" or \"cuda\"".to_owned(),
            fix: Some("cargo build --release -p re4-pipe --features torch".to_owned()),
            ..part("encoder backend torch", "not built in")
        });
    }
    // Missing folders are created in the nearest ancestor that exists.
    let absolute = std::path::absolute(artifacts).unwrap_or_else(|_| artifacts.to_owned());
    let existing = absolute.ancestors().find(|path| path.exists());
    let writable = existing.is_some_and(|folder| folder.is_dir() && tempfile::tempfile_in(folder).is_ok());
    found.push(if writable {
        part("artifacts folder", format!("{}, writable", artifacts.display()))
    } else {
        Finding {
            state: State::Missing,
            fix: Some("give a writable folder with --artifacts".to_owned()),
            ..part(
                "artifacts folder",
                format!("{} cannot be written to", artifacts.display()),
            )
        }
    });
    found
}

/// The datasets and weights that `re4-pipe fetch` can download.
fn datasets() -> Vec<Finding> {
    let folders = data_folders();
    let listed: Vec<String> = folders.iter().map(|folder| folder.display().to_string()).collect();
    re4_fetch::catalogue()
        .unwrap_or_default()
        .into_iter()
        .map(|dataset| {
            let path = folders
                .iter()
                .map(|folder| folder.join(&dataset.provides))
                .find(|path| path.exists());
            Finding {
                group: "datasets",
                state: if path.is_some() { State::Found } else { State::Absent },
                detail: path.map_or_else(
                    || format!("{} is not in {}", dataset.provides, listed.join(" or ")),
                    |path| path.display().to_string(),
                ),
                needed_by: dataset.description,
                fix: Some(format!("re4-pipe fetch {}", dataset.name)),
                name: dataset.name,
            }
        })
        .collect()
}

/// MuJoCo, robosuite's meshes, and the rendering library.
fn simulators(pipeline: Option<&Pipeline>) -> Vec<Finding> {
    const SETUP: &str = "scripts/setup-simulators.sh";
    let simulated = pipeline.is_some_and(Pipeline::needs_simulator);
    let absent = |needed: bool| if needed { State::Missing } else { State::Absent };
    let mut found = Vec::new();
    let opened: Vec<_> = Version::ALL
        .into_iter()
        .map(|version| (version, Library::open(&mujoco_folder(version), version)))
        .collect();
    // A dataset needs one of the two versions. Which one, is known only after its file is read.
    let any = opened.iter().any(|(_, library)| library.is_ok());
    for (version, library) in opened {
        let robosuite = match version {
            Version::V2_3_7 => "1.4",
            Version::V3_2_7 => "1.5",
        };
        found.push(Finding {
            group: "simulators",
            name: format!("MuJoCo {version}"),
            state: if library.is_ok() {
                State::Found
            } else {
                absent(simulated && !any)
            },
            detail: match &library {
                Ok(_) => mujoco_folder(version).display().to_string(),
                Err(error) => error.to_string(),
            },
            needed_by: format!("rollouts, replays and rendering of files that robosuite {robosuite} recorded"),
            fix: Some(SETUP.to_owned()),
        });
    }
    let assets = assets_folder();
    found.push(Finding {
        group: "simulators",
        name: "robosuite's meshes".to_owned(),
        state: if assets.is_dir() {
            State::Found
        } else {
            absent(simulated)
        },
        detail: if assets.is_dir() {
            simulators_folder().join("robosuite-1.4.1").display().to_string()
        } else {
            format!("there is no folder {}", assets.display())
        },
        needed_by: "rollouts, replays and rendering of robosuite tasks".to_owned(),
        fix: Some(SETUP.to_owned()),
    });
    let gl = Gl::of_process();
    found.push(Finding {
        group: "simulators",
        name: "OSMesa or EGL".to_owned(),
        state: if gl.is_ok() {
            State::Found
        } else {
            absent(pipeline.is_some_and(Pipeline::needs_renderer))
        },
        detail: match &gl {
            Ok(gl) => format!("{gl} was loaded"),
            Err(error) => error.to_string(),
        },
        needed_by: "images of robosuite's scenes: ingest.render, rollouts from images, videos".to_owned(),
        fix: gl
            .err()
            .and_then(|error| error.remedy().map(std::borrow::Cow::into_owned))
            .or_else(|| Some("sudo apt-get install libosmesa6".to_owned())),
    });
    found
}

/// Python and the packages that the notebooks import.
fn python() -> Vec<Finding> {
    const PACKAGES: &str = "polars, pyarrow, matplotlib, numpy";
    let program = std::env::var_os("RE4_PYTHON")
        .filter(|value| !value.is_empty())
        .map_or_else(|| PathBuf::from("python3"), PathBuf::from);
    let answer = |code: &str| {
        let output = Command::new(&program).args(["-c", code]).stdin(Stdio::null()).output();
        let output = output.ok().filter(|output| output.status.success())?;
        Some(String::from_utf8_lossy(&output.stdout).trim().to_owned())
    };
    // Finding a package's files is enough, and much faster than importing it.
    let script = format!(
        "import sys, importlib.util as u\nprint(sys.version.split()[0])\n\
         print(' '.join(p for p in '{PACKAGES}'.split(', ') if u.find_spec(p) is None))"
    );
    let finding = |name: &str, state, detail: String, fix: &str| Finding {
        group: "python",
        name: name.to_owned(),
        state,
        detail,
        needed_by: "the notebooks; no command of re4-pipe runs Python".to_owned(),
        fix: Some(fix.to_owned()),
    };
    let Some(said) = answer(&script) else {
        let detail = format!("{} does not run", program.display());
        return vec![finding(
            "Python",
            State::Absent,
            detail,
            "sudo apt-get install python3 python3-venv, or set RE4_PYTHON to an interpreter",
        )];
    };
    let mut lines = said.lines();
    let version = lines.next().unwrap_or_default();
    let lacking = lines.next().unwrap_or_default().replace(' ', ", ");
    let python = finding("Python", State::Found, format!("{version}, {}", program.display()), "");
    let packages = if lacking.is_empty() {
        finding("Python packages", State::Found, PACKAGES.to_owned(), "")
    } else {
        let fix = format!("{} -m pip install -r notebooks/requirements.txt", program.display());
        finding("Python packages", State::Absent, format!("missing: {lacking}"), &fix)
    };
    vec![python, packages]
}

/// The raw dataset and the weights that a pipeline names.
fn of_pipeline(pipeline: &Pipeline) -> Vec<Finding> {
    let finding = |name: &str, needed_by: &str, path: anyhow::Result<PathBuf>| {
        let (state, detail, fix) = match path {
            Ok(path) => (State::Found, path.display().to_string(), None),
            Err(error) => {
                let fault = fault_of(&error);
                let fix = fault.remedy().map(std::borrow::Cow::into_owned);
                (State::Missing, fault.to_string(), fix)
            }
        };
        Finding {
            group: "pipeline",
            name: name.to_owned(),
            state,
            detail,
            needed_by: needed_by.to_owned(),
            fix,
        }
    };
    let existing = |path: PathBuf| {
        re4_fault::ensure!(
            path.exists(),
            "cannot ingest {}: there is no such file", path.display();
            "give the path of the dataset as ingest.source"
        );
        Ok(path)
    };
    let sources = pipeline.ingest.source.paths().iter();
    let mut found: Vec<Finding> = sources
        .map(|source| finding("ingest.source", "ingest", find_source(source).and_then(existing)))
        .collect();
    if let Some(pose) = pipeline.pose.as_ref().filter(|pose| pose.source == PoseSource::Encoder)
        && let Some(weights) = &pose.encoder().weights
    {
        found.push(finding("pose.encoder.weights", "train-encoder", find_weights(weights)));
    }
    found
}

#[cfg(test)]
mod tests {
    use super::{State, doctor};

    #[test]
    fn everything_absent_comes_with_a_command() {
        let folder = tempfile::tempdir().unwrap();
        let found = doctor(None, &folder.path().join("artifacts"));
        for finding in &found {
            assert!(!finding.name.is_empty() && !finding.detail.is_empty(), "{finding:?}");
            if finding.state != State::Found {
                assert!(finding.fix.as_ref().is_some_and(|fix| !fix.is_empty()), "{finding:?}");
            }
        }
        let missing: Vec<_> = found.iter().filter(|finding| finding.state == State::Missing).collect();
        assert!(missing.is_empty(), "nothing is needed without a pipeline: {missing:?}");
        for group in ["program", "datasets", "simulators", "python"] {
            assert!(found.iter().any(|finding| finding.group == group), "{group}");
        }
    }

    #[test]
    fn an_artifacts_folder_that_cannot_be_written_to_is_missing() {
        let file = tempfile::NamedTempFile::new().unwrap();
        let found = doctor(None, &file.path().join("artifacts"));
        let folder = found.iter().find(|finding| finding.name == "artifacts folder").unwrap();
        assert_eq!(folder.state, State::Missing);
    }
}
