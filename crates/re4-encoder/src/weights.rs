//! Weights (stand-in until merged).
use crate::EncoderError;
use crate::resnet::Encoder;
use burn::tensor::Device;
use std::path::Path;
/// x
pub fn load_torchvision(_e: Encoder, _path: &Path) -> Result<Encoder, EncoderError> {
    Err(EncoderError::NoBackend("x"))
}
/// x
pub fn load(_path: &Path, _device: &Device) -> Result<Encoder, EncoderError> {
    Err(EncoderError::NoBackend("x"))
}
/// x
pub fn to_bytes(_e: &Encoder) -> Result<Vec<u8>, EncoderError> {
    Ok(Vec::new())
}
