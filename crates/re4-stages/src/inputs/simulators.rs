//! Opens the robosuite simulator for the demonstrations of an `episodes` artifact.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};

use anyhow::{Context as _, Result};
use re4_artifact::Artifact;
use re4_fault::{bail, ensure};
use re4_ingest::{DemoRow, ModelRow};
use re4_mujoco::{Gl, Library, Version};
use re4_robosuite::models::with_assets;
use re4_robosuite::physics::{without_contacts, without_visuals};
use re4_sim::robosuite::{Fidelity, Placement, Profile, RobosuiteModel, RobosuiteTask};
use tracing::{debug, info};

use crate::runner::Runner;

/// The folder with MuJoCo's libraries and robosuite's assets: `RE4_SIMULATORS` if it is set, `data/simulators` otherwise.
pub(crate) fn simulators_folder() -> PathBuf {
    std::env::var_os("RE4_SIMULATORS")
        .filter(|value| !value.is_empty())
        .map_or_else(|| PathBuf::from("data/simulators"), PathBuf::from)
}

/// The folder with the meshes and textures that models refer to. robosuite 1.5 models use those of 1.4.1, too.
pub(crate) fn assets_folder() -> PathBuf {
    let folder = simulators_folder().join("robosuite-1.4.1");
    // Asset paths in models have to be absolute.
    std::path::absolute(&folder).unwrap_or(folder)
}

/// Folder with one version of MuJoCo's library.
pub(crate) fn mujoco_folder(version: Version) -> PathBuf {
    simulators_folder().join(format!("mujoco-{version}"))
}

impl Runner {
    /// Returns an error if nothing that simulates the pipeline's robosuite task is installed, before a stage has run for
    /// minutes. Any version of MuJoCo is accepted, because the required one is known only after ingest. `what` is the operation
    /// that the message names, such as "roll out".
    ///
    /// # Errors
    /// If no version of MuJoCo or no meshes are installed, or if images are needed and no OpenGL library is installed.
    pub fn require_simulator(&self, what: &str) -> Result<()> {
        let pipeline = &self.pipeline;
        if pipeline.task.is_planar() {
            return Ok(());
        }
        let task = pipeline.task.name();
        require_folders(|| format!("cannot {what} {task}"))?;
        if pipeline.needs_renderer() {
            Gl::of_process().with_context(|| format!("cannot {what} {task}, which needs images"))?;
        }
        Ok(())
    }
}

/// Returns an error if no version of MuJoCo or no meshes are installed. `cannot` is the beginning of its sentence.
fn require_folders(cannot: impl Fn() -> String) -> Result<()> {
    const REMEDY: &str = "run scripts/setup-simulators.sh, or set RE4_SIMULATORS to the folder that it filled; re4-pipe doctor lists what is missing";
    let (folder, assets) = (simulators_folder(), assets_folder());
    ensure!(
        Version::ALL.into_iter().any(|version| mujoco_folder(version).is_dir()),
        "{}: MuJoCo is not in {}", cannot(), folder.display();
        "{REMEDY}"
    );
    ensure!(
        assets.is_dir(),
        "{}: robosuite's meshes are not in {}", cannot(), assets.display();
        "{REMEDY}"
    );
    Ok(())
}

/// Loads the MuJoCo version that belongs to a version of robosuite.
pub(crate) fn library(profile: Profile) -> Result<Library> {
    let version = profile.mujoco();
    let folder = mujoco_folder(version);
    let library = Library::open(&folder, version)?;
    info!(%version, folder = %folder.display(), "MuJoCo loaded");
    Ok(library)
}

/// The scenes of the demonstrations in an `episodes` artifact. Each distinct model is compiled once, when it is first used.
pub(crate) struct Scenes {
    task: RobosuiteTask,
    profile: Profile,
    library: Library,
    fidelity: Fidelity,
    /// MJCF by model number, with this machine's asset paths and without visual assets, which physics does not need.
    mjcf: BTreeMap<u32, String>,
    /// Model number by demonstration.
    of_demo: Vec<Option<u32>>,
    /// Compiled models by model number, each with its own lock.
    compiled: Mutex<BTreeMap<u32, Arc<Mutex<Option<RobosuiteModel>>>>>,
}

/// The version of robosuite with which the demonstrations of an artifact were recorded.
///
/// # Errors
/// If the artifact does not name the version, or the version is not supported.
pub(crate) fn profile(episodes: &Artifact) -> Result<Profile> {
    let named = episodes.manifest().source["robosuite_version"].as_str();
    let Some(named) = named else {
        bail!(
            "cannot simulate the demonstrations of {}: the source file does not name the robosuite version that recorded it",
            episodes.path().display();
            "set ingest.env_args to the file's env_args with env_version added"
        );
    };
    Profile::of(named).with_context(|| {
        format!(
            "cannot simulate the demonstrations of {}: they were recorded with robosuite {named}, but only 1.4 and 1.5 are supported",
            episodes.path().display()
        )
    })
}

/// Loads the simulator that the demonstrations of an artifact need. Cheap, so that it can be called before a stage that takes
/// minutes.
///
/// # Errors
/// If the artifact names no known version of robosuite or has no models, or MuJoCo's library is missing.
pub(crate) fn simulator_of(episodes: &Artifact) -> Result<(Profile, Library)> {
    let profile = profile(episodes)?;
    let library = library(profile)?;
    ensure!(
        episodes.has::<ModelRow>(),
        "cannot simulate the demonstrations of {}: they have no model_file", episodes.path().display();
        "ingest a file whose demonstrations have that attribute"
    );
    Ok((profile, library))
}

/// The MJCF of a demonstration's `model_file` for physics, with the assets in `folder`.
fn physics_of(model_file: &str, task: RobosuiteTask, fidelity: Fidelity, folder: &Path) -> Result<String> {
    // Removed first, so that physics does not require the textures and visual meshes to be installed.
    let mut text = without_visuals(model_file)
        .map_err(|error| anyhow::anyhow!("its model_file is not readable as XML: {error}"))?;
    if fidelity == Fidelity::Fast {
        text = without_contacts(&text, &task.unused_bodies()).map_err(anyhow::Error::msg)?;
    }
    Ok(with_assets(&text, folder)?)
}

/// A scene of a robosuite task, for simulations outside of rollouts.
pub struct TaskScene {
    task: RobosuiteTask,
    profile: Profile,
    library: Library,
    fidelity: Fidelity,
    mjcf: String,
    /// The compiled model, unless the model of every seed is another one.
    shared: Option<RobosuiteModel>,
}

impl TaskScene {
    /// Opens the scene of a `model_file` that this version of robosuite wrote.
    ///
    /// # Errors
    /// If MuJoCo's library or a mesh is missing, or the model is not one of the task.
    pub fn open(task: RobosuiteTask, profile: Profile, model_file: &str, fidelity: Fidelity) -> Result<Self> {
        let place = || format!("cannot simulate {}", task.name);
        require_folders(place)?;
        let mut scene = Self {
            task,
            profile,
            library: library(profile).with_context(place)?,
            fidelity,
            mjcf: physics_of(model_file, task, fidelity, &assets_folder()).with_context(place)?,
            shared: None,
        };
        if !task.samples_models() {
            scene.shared = Some(scene.compile(&scene.mjcf)?);
        }
        Ok(scene)
    }

    /// The model in which a placement starts. If the size of a box depends on the seed (Lift's cube), this compiles a model.
    ///
    /// # Errors
    /// If MuJoCo cannot compile it.
    pub fn model(&self, placement: &Placement) -> Result<RobosuiteModel> {
        match &self.shared {
            Some(model) => Ok(model.clone()),
            None => self.compile(&placement.in_model(&self.mjcf)?),
        }
    }

    fn compile(&self, mjcf: &str) -> Result<RobosuiteModel> {
        let model = RobosuiteModel::compile(&self.library, self.task, self.profile, mjcf)?;
        Ok(model.with_fidelity(self.fidelity))
    }
}

impl Scenes {
    /// Opens the scenes of this artifact.
    ///
    /// # Errors
    /// If MuJoCo's library or an asset is missing, or the artifact has no models.
    pub(crate) fn open(episodes: &Artifact, task: RobosuiteTask, fidelity: Fidelity) -> Result<Self> {
        let (profile, library) = simulator_of(episodes)?;
        let demos = episodes.read::<DemoRow>()?;
        let folder = assets_folder();
        let mut mjcf = BTreeMap::new();
        let users: BTreeMap<u32, &str> = demos
            .iter()
            .rev()
            .filter_map(|demo| Some((demo.model?, demo.demo.as_str())))
            .collect();
        for ModelRow { model, mjcf: text } in episodes.read()? {
            let demo = users.get(&model).copied().unwrap_or("a demonstration");
            let place = || format!("cannot simulate {demo} of {}", episodes.path().display());
            mjcf.insert(model, physics_of(&text, task, fidelity, &folder).with_context(place)?);
        }
        Ok(Self {
            task,
            profile,
            library,
            fidelity,
            mjcf,
            of_demo: demos.iter().map(|demo| demo.model).collect(),
            compiled: Mutex::default(),
        })
    }

    /// The version of robosuite that is reproduced.
    pub(crate) fn profile(&self) -> Profile {
        self.profile
    }

    /// MJCF of the first demonstration that has a model.
    ///
    /// # Errors
    /// If no demonstration has a model.
    pub(crate) fn first_mjcf(&self) -> Result<&str> {
        let first = self.of_demo.iter().flatten().next();
        let text = first.and_then(|number| self.mjcf.get(number));
        text.map(String::as_str).context("no demonstration has a model")
    }

    /// The MJCF of the same demonstration for rendering: with visual assets and with all contacts.
    ///
    /// # Errors
    /// If no demonstration has a model, or an asset is missing.
    pub(crate) fn rendered_mjcf(&self, episodes: &Artifact) -> Result<String> {
        let first = self.of_demo.iter().flatten().next();
        let number = *first.context("no demonstration has a model")?;
        let models = episodes.read::<ModelRow>()?;
        let text = models
            .iter()
            .find(|row| row.model == number)
            .map_or("", |row| &row.mjcf);
        with_assets(text, &assets_folder())
            .with_context(|| format!("cannot render the models of {}", episodes.path().display()))
    }

    /// Compiles a scene from MJCF that is not taken unchanged from a demonstration.
    ///
    /// # Errors
    /// If MuJoCo cannot compile it.
    pub(crate) fn compile(&self, mjcf: &str) -> Result<RobosuiteModel, re4_sim::SimError> {
        let model = RobosuiteModel::compile(&self.library, self.task, self.profile, mjcf)?;
        Ok(model.with_fidelity(self.fidelity))
    }

    /// The scene of a demonstration, by its number in the artifact. Compiles its model unless that has been done.
    ///
    /// # Errors
    /// If the demonstration has no model, or MuJoCo cannot compile it.
    pub(crate) fn of(&self, demo: u32) -> Result<RobosuiteModel> {
        let number = self
            .of_demo
            .get(demo as usize)
            .copied()
            .flatten()
            .context("it has no model_file")?;
        let slot = Arc::clone(
            self.compiled
                .lock()
                .unwrap_or_else(PoisonError::into_inner)
                .entry(number)
                .or_default(),
        );
        // Compiling takes seconds. The lock per model lets other models compile meanwhile, and makes threads that need the same
        // model wait for it.
        let mut slot = slot.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(model) = &*slot {
            return Ok(model.clone());
        }
        let mjcf = self
            .mjcf
            .get(&number)
            .with_context(|| format!("table models has no row {number}"))?;
        let model = self.compile(mjcf)?;
        debug!(number, demo, "model compiled");
        *slot = Some(model.clone());
        Ok(model)
    }
}
