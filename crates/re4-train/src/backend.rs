//! Backends: from the name in a pipeline file to a device of burn.

use burn::tensor::Device;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::TrainError;

/// The backend that runs the network.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum Backend {
    /// Pure Rust on the CPU; always available, with bit-identical results for any number of threads.
    Flex,
    /// `LibTorch` on the CPU; requires a build with `--features torch`.
    Torch,
    /// `LibTorch` on an NVIDIA GPU; requires a build with `--features torch`.
    Cuda,
}

impl Backend {
    /// The backend's name in pipeline files.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Flex => "flex",
            Self::Torch => "torch",
            Self::Cuda => "cuda",
        }
    }

    /// The backend's device, without gradients. `setting` is the setting that names the backend, for messages.
    ///
    /// # Errors
    /// If this program was built without the backend, or the machine has no such device.
    pub fn device(self, setting: &'static str) -> Result<Device, TrainError> {
        match self {
            Self::Flex => Ok(Device::flex()),
            Self::Torch => torch::processor(setting),
            Self::Cuda => torch::graphics_card(setting),
        }
    }

    /// Sets the number of threads of the whole program. This takes effect once, before the first computation. `setting` is the
    /// setting that names the backend, for messages.
    ///
    /// # Errors
    /// If this program was built without the backend, or its threads have already started.
    pub fn set_threads(self, threads: usize, setting: &'static str) -> Result<(), TrainError> {
        match self {
            Self::Flex => rayon::ThreadPoolBuilder::new()
                .num_threads(threads)
                .build_global()
                .map_err(|error| TrainError::Threads(error.to_string())),
            Self::Torch | Self::Cuda => torch::set_threads(self, threads, setting),
        }
    }
}

#[cfg(feature = "torch")]
#[expect(
    deprecated,
    reason = "burn plans to remove LibTorch; it is the fastest backend on a CPU, and the only one for a GPU that \
              needs no download at build time"
)]
mod torch {
    use super::{Backend, Device, TrainError};

    #[expect(clippy::unnecessary_wraps, reason = "without the feature it can fail")]
    pub(super) fn processor(_: &'static str) -> Result<Device, TrainError> {
        Ok(Device::libtorch())
    }

    /// Checks for a GPU first, because `LibTorch` aborts the program if there is none.
    pub(super) fn graphics_card(setting: &'static str) -> Result<Device, TrainError> {
        if tch::Cuda::is_available() {
            Ok(Device::libtorch_cuda(0))
        } else {
            Err(TrainError::NoGraphicsCard { setting })
        }
    }

    pub(super) fn set_threads(_: Backend, threads: usize, _: &'static str) -> Result<(), TrainError> {
        let threads = i32::try_from(threads).map_err(|error| TrainError::Threads(error.to_string()))?;
        tch::set_num_threads(threads);
        Ok(())
    }
}

#[cfg(not(feature = "torch"))]
mod torch {
    use super::{Backend, Device, TrainError};

    fn missing(backend: Backend, setting: &'static str) -> TrainError {
        TrainError::NoBackend {
            setting,
            backend: backend.as_str(),
        }
    }

    pub(super) fn processor(setting: &'static str) -> Result<Device, TrainError> {
        Err(missing(Backend::Torch, setting))
    }

    pub(super) fn graphics_card(setting: &'static str) -> Result<Device, TrainError> {
        Err(missing(Backend::Cuda, setting))
    }

    pub(super) fn set_threads(backend: Backend, _: usize, setting: &'static str) -> Result<(), TrainError> {
        Err(missing(backend, setting))
    }
}
