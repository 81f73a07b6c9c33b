//! Backends: from the name in a pipeline file to a device of burn.

use burn::tensor::Device;

use crate::EncoderError;
use crate::config::Backend;

impl Backend {
    /// The backend's device, without gradients.
    ///
    /// # Errors
    /// If this program was built without the backend, or the machine has no such device.
    pub fn device(self) -> Result<Device, EncoderError> {
        match self {
            Self::Flex => Ok(Device::flex()),
            Self::Torch => torch::processor(),
            Self::Cuda => torch::graphics_card(),
        }
    }

    /// Sets the number of threads of the whole program. This takes effect once, before the first computation.
    ///
    /// # Errors
    /// If this program was built without the backend, or its threads have already started.
    pub fn set_threads(self, threads: usize) -> Result<(), EncoderError> {
        match self {
            Self::Flex => rayon::ThreadPoolBuilder::new()
                .num_threads(threads)
                .build_global()
                .map_err(|error| EncoderError::Threads(error.to_string())),
            Self::Torch | Self::Cuda => torch::set_threads(self, threads),
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
    use super::{Backend, Device, EncoderError};

    pub(super) fn processor() -> Result<Device, EncoderError> {
        Ok(Device::libtorch())
    }

    /// Checks for a GPU first, because `LibTorch` aborts the program if there is none.
    pub(super) fn graphics_card() -> Result<Device, EncoderError> {
        if tch::Cuda::is_available() {
            Ok(Device::libtorch_cuda(0))
        } else {
            Err(EncoderError::NoGraphicsCard)
        }
    }

    pub(super) fn set_threads(_: Backend, threads: usize) -> Result<(), EncoderError> {
        let threads = i32::try_from(threads).map_err(|error| EncoderError::Threads(error.to_string()))?;
        tch::set_num_threads(threads);
        Ok(())
    }
}

#[cfg(not(feature = "torch"))]
mod torch {
    use super::{Backend, Device, EncoderError};

    pub(super) fn processor() -> Result<Device, EncoderError> {
        Err(EncoderError::NoBackend(Backend::Torch.as_str()))
    }

    pub(super) fn graphics_card() -> Result<Device, EncoderError> {
        Err(EncoderError::NoBackend(Backend::Cuda.as_str()))
    }

    pub(super) fn set_threads(backend: Backend, _: usize) -> Result<(), EncoderError> {
        Err(EncoderError::NoBackend(backend.as_str()))
    }
}
