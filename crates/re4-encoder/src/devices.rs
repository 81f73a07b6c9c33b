//! What computes.

use burn::tensor::Device;

use crate::EncoderError;
use crate::config::Backend;

/// The device of a backend.
///
/// # Errors
/// When this program was built without it, or the machine lacks it.
pub(crate) fn device(backend: Backend) -> Result<Device, EncoderError> {
    match backend {
        Backend::Flex => Ok(Device::flex()),
        #[cfg(feature = "torch")]
        Backend::Torch => Ok(Device::libtorch()),
        #[cfg(not(feature = "torch"))]
        Backend::Torch => Err(EncoderError::NoBackend("torch")),
        Backend::Cuda => Err(EncoderError::NoBackend("cuda")),
    }
}
