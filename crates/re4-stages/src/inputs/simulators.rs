//! robosuite's simulator for the demonstrations of an `episodes` artifact.

use std::collections::BTreeMap;
use std::path::PathBuf;
use std::sync::{Arc, Mutex, PoisonError};

use anyhow::{Context as _, Result};
use re4_artifact::Artifact;
use re4_fault::{bail, ensure};
use re4_ingest::{DemoRow, ModelRow};
use re4_mujoco::{Gl, Library, Version};
use re4_robosuite::models::with_assets;
use re4_robosuite::physics::{without_contacts, without_images};
use re4_sim::robosuite::{Fidelity, Profile, RobosuiteModel, RobosuiteTask};
use tracing::{debug, info};

use crate::runner::Runner;

/// The folder with MuJoCo's libraries and robosuite's assets: `RE4_SIMULATORS` where it is set, then `data/simulators`.
pub(crate) fn simulators_folder() -> PathBuf {
    std::env::var_os("RE4_SIMULATORS")
        .filter(|value| !value.is_empty())
        .map_or_else(|| PathBuf::from("data/simulators"), PathBuf::from)
}

/// Folder with the meshes and textures that models name. Those of robosuite 1.4.1 serve 1.5 as well.
pub(crate) fn assets_folder() -> PathBuf {
    let folder = simulators_folder().join("robosuite-1.4.1");
    // Paths in models have to be absolute.
    std::path::absolute(&folder).unwrap_or(folder)
}

/// Folder with one version of MuJoCo's library.
pub(crate) fn mujoco_folder(version: Version) -> PathBuf {
    simulators_folder().join(format!("mujoco-{version}"))
}

impl Runner {
    /// Refuses a robosuite task at once if nothing that simulates it is installed, before a stage has run for minutes. Which
    /// version of MuJoCo is needed is known only after ingest. `what` says what cannot be done: "roll out".
    ///
    /// # Errors
    /// When no version of MuJoCo or no meshes are installed, or nothing that renders although images are needed.
    pub fn require_simulator(&self, what: &str) -> Result<()> {
        const REMEDY: &str = "run scripts/setup-simulators.sh, or set RE4_SIMULATORS to the folder that it filled; re4-pipe doctor lists what is missing";
        let pipeline = &self.pipeline;
        if pipeline.task.is_planar() {
            return Ok(());
        }
        let task = pipeline.task.name();
        let (folder, assets) = (simulators_folder(), assets_folder());
        ensure!(
            Version::ALL.into_iter().any(|version| mujoco_folder(version).is_dir()),
            "cannot {what} {}: MuJoCo is not in {}", task, folder.display();
            "{REMEDY}"
        );
        ensure!(
            assets.is_dir(),
            "cannot {what} {}: robosuite's meshes are not in {}", task, assets.display();
            "{REMEDY}"
        );
        if pipeline.needs_renderer() {
            Gl::of_process().with_context(|| format!("cannot {what} {}, which needs images", task))?;
        }
        Ok(())
    }
}

/// The MuJoCo that goes with a version of robosuite.
pub(crate) fn library(profile: Profile) -> Result<Library> {
    let version = profile.mujoco();
    let folder = mujoco_folder(version);
    let library = Library::open(&folder, version)?;
    info!(%version, folder = %folder.display(), "MuJoCo loaded");
    Ok(library)
}

/// Compiles the scenes of the demonstrations in an `episodes` artifact, each once.
pub(crate) struct Scenes {
    task: RobosuiteTask,
    profile: Profile,
    library: Library,
    fidelity: Fidelity,
    /// MJCF by number, with paths of this machine and without what is only drawn.
    mjcf: Vec<String>,
    /// Model of every demonstration.
    of_demo: Vec<Option<u32>>,
    compiled: Mutex<BTreeMap<u32, Arc<Mutex<Option<RobosuiteModel>>>>>,
}

/// The version of robosuite that the demonstrations of an artifact come from.
///
/// # Errors
/// When the artifact does not name it, or it is one that is not known.
pub(crate) fn profile(episodes: &Artifact) -> Result<Profile> {
    let named = episodes.manifest().source["robosuite_version"].as_str();
    let Some(named) = named else {
        bail!(
            "cannot simulate the demonstrations of {}: the file that they come from does not say which robosuite recorded it",
            episodes.path().display();
            "give its env_args, with env_version, as ingest.env_args"
        );
    };
    Profile::of(named).with_context(|| {
        format!(
            "cannot simulate the demonstrations of {}: they were recorded with robosuite {named}, and the versions known here are 1.4 and 1.5",
            episodes.path().display()
        )
    })
}

impl Scenes {
    /// Those of this artifact.
    ///
    /// # Errors
    /// When MuJoCo's library or an asset is missing, or the artifact has no models.
    pub(crate) fn open(episodes: &Artifact, task: RobosuiteTask, fidelity: Fidelity) -> Result<Self> {
        let profile = profile(episodes)?;
        let library = library(profile)?;
        let demos = episodes.read::<DemoRow>()?;
        ensure!(
            episodes.has::<ModelRow>(),
            "cannot simulate the demonstrations of {}: they have no model_file", episodes.path().display();
            "ingest a file whose demonstrations have that attribute"
        );
        let folder = assets_folder();
        let mut mjcf = Vec::new();
        for ModelRow { model, mjcf: text } in episodes.read()? {
            let user = demos.iter().find(|demo| demo.model == Some(model));
            let demo = user.map_or("a demonstration", |demo| &demo.demo);
            let place = || format!("cannot simulate {demo} of {}", episodes.path().display());
            // Files that are only drawn need not be here.
            let mut text = without_images(&text)
                .map_err(|error| anyhow::anyhow!("its model_file is not readable as XML: {error}"))
                .with_context(place)?;
            if fidelity == Fidelity::Fast {
                text = without_contacts(&text, &task.put_away()).map_err(anyhow::Error::msg)?;
            }
            let text = with_assets(&text, &folder).with_context(place)?;
            mjcf.push(text);
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

    /// The version of robosuite whose behaviour is reproduced.
    pub(crate) fn profile(&self) -> Profile {
        self.profile
    }

    /// MJCF of the first demonstration that has a model.
    ///
    /// # Errors
    /// When none has one.
    pub(crate) fn first_mjcf(&self) -> Result<&str> {
        let first = self.of_demo.iter().flatten().next();
        let text = first.and_then(|number| self.mjcf.get(*number as usize));
        Ok(text.context("no demonstration has a model")?)
    }

    /// The same MJCF with what is only drawn, and everything touching.
    ///
    /// # Errors
    /// When no demonstration has a model, or an asset is missing.
    pub(crate) fn rendered_mjcf(&self, episodes: &Artifact) -> Result<String> {
        let first = self.of_demo.iter().flatten().next();
        let number = *first.context("no demonstration has a model")?;
        let models = episodes.read::<ModelRow>()?;
        let text = models.get(number as usize).map_or("", |row| &row.mjcf);
        with_assets(text, &assets_folder())
            .with_context(|| format!("cannot draw the models of {}", episodes.path().display()))
    }

    /// A scene from MJCF that is not a demonstration's own.
    ///
    /// # Errors
    /// When MuJoCo cannot compile it.
    pub(crate) fn compile(&self, mjcf: &str) -> Result<RobosuiteModel, re4_sim::SimError> {
        let model = RobosuiteModel::compile(&self.library, self.task, self.profile, mjcf)?;
        Ok(model.with_fidelity(self.fidelity))
    }

    /// The scene of a demonstration, by its number in the artifact.
    ///
    /// # Errors
    /// When it has no model, or MuJoCo cannot compile it.
    pub(crate) fn of(&self, demo: u32) -> Result<RobosuiteModel> {
        let number = self
            .of_demo
            .get(demo as usize)
            .copied()
            .flatten()
            .context("it has no model_file")?;
        let place = Arc::clone(
            self.compiled
                .lock()
                .unwrap_or_else(PoisonError::into_inner)
                .entry(number)
                .or_default(),
        );
        // One thread compiles, others that need the same model wait for it.
        let mut place = place.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(model) = &*place {
            return Ok(model.clone());
        }
        let mjcf = self.mjcf.get(number as usize).context("table models ends too early")?;
        let model = self.compile(mjcf)?;
        debug!(number, demo, "model compiled");
        *place = Some(model.clone());
        Ok(model)
    }
}
