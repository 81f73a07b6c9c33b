//! What computes: from its name in a pipeline file to a device of burn.

use burn::tensor::Device;

use crate::EncoderError;
use crate::config::Backend;

impl Backend {
    /// Its device, without gradients.
    ///
    /// # Errors
    /// When this program was built without it, or the machine has no such device.
    pub fn device(self) -> Result<Device, EncoderError> {
        match self {
            Self::Flex => Ok(Device::flex()),
            Self::Torch => torch::processor(),
            Self::Cuda => torch::graphics_card(),
        }
    }

    /// Sets how many threads compute, for the whole program. Takes effect once, before the first computation.
    ///
    /// # Errors
    /// When this program was built without the backend, or its threads are running already.
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
    reason = "burn means to drop LibTorch; on a processor it is the fastest there is, and on a graphics card the only one that \
              needs no download while building"
)]
mod torch {
    use super::{Backend, Device, EncoderError};

    pub(super) fn processor() -> Result<Device, EncoderError> {
        Ok(Device::libtorch())
    }

    /// Asked beforehand: `LibTorch` would stop the program where there is none.
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
