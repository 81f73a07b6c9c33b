//! Where MuJoCo's libraries and robosuite's assets are.

use std::path::PathBuf;

use anyhow::Result;
use re4_mujoco::{Library, Version};

/// Names the folder.
const VARIABLE: &str = "RE4_SIMULATORS";

/// The folder that `scripts/setup-simulators.sh` makes: `RE4_SIMULATORS` where it is set, else `data/simulators`.
pub(crate) fn folder() -> PathBuf {
    std::env::var_os(VARIABLE)
        .filter(|value| !value.is_empty())
        .map_or_else(|| PathBuf::from("data/simulators"), PathBuf::from)
}

/// MuJoCo's library of this version.
pub(crate) fn mujoco(version: Version) -> Result<Library> {
    Ok(Library::open(&folder().join(format!("mujoco-{version}")), version)?)
}

/// What stands for robosuite's package: the meshes and textures that models name.
pub(crate) fn assets() -> PathBuf {
    folder().join("robosuite-1.4.1")
}
