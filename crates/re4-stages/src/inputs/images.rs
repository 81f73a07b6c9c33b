//! What stages that look at images of robosuite's tasks need of an `episodes` artifact.

use anyhow::{Context as _, Result};
use image::codecs::png::{CompressionType, FilterType, PngEncoder};
use image::{ExtendedColorType, ImageEncoder as _};
use re4_artifact::Artifact;
use re4_fault::ensure;
use re4_ingest::ImageRow;

/// Refuses demonstrations without images of a camera.
pub(crate) fn check_images(episodes: &Artifact, camera: &str) -> Result<()> {
    let manifest = episodes.manifest();
    let cameras: Vec<&str> = manifest.summary["cameras"]
        .as_array()
        .into_iter()
        .flatten()
        .filter_map(|camera| camera.as_str())
        .collect();
    let there = if cameras.is_empty() {
        "holds no images".to_owned()
    } else {
        format!("holds images of {} alone", cameras.join(", "))
    };
    ensure!(
        episodes.has::<ImageRow>() && cameras.contains(&camera),
        "cannot estimate poses: {} {there}, and the encoder reads those of the camera {camera}",
        episodes.path().display();
        "set ingest.render = [\"{camera}\"] where the dataset has none, or name a camera that it has as pose.encoder.camera"
    );
    Ok(())
}

/// An image as the bytes of a PNG file: 8-bit RGB, first row at the top.
///
/// # Errors
/// When there are more or fewer bytes than pixels of this size have.
pub(crate) fn encode_png(pixels: &[u8], width: u32, height: u32) -> Result<Vec<u8>> {
    let mut bytes = Vec::with_capacity(4096);
    PngEncoder::new_with_quality(&mut bytes, CompressionType::Fast, FilterType::Adaptive)
        .write_image(pixels, width, height, ExtendedColorType::Rgb8)
        .context("cannot encode an image as PNG")?;
    Ok(bytes)
}
