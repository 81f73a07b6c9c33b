//! Checks for and encodes images of `episodes` artifacts.

use anyhow::{Context as _, Result};
use image::codecs::png::{CompressionType, FilterType, PngEncoder};
use image::{ExtendedColorType, ImageEncoder as _};
use re4_artifact::Artifact;
use re4_fault::ensure;
use re4_ingest::ImageRow;

/// Returns an error if an `episodes` artifact has no images of a camera.
pub(crate) fn check_images(episodes: &Artifact, camera: &str) -> Result<()> {
    let manifest = episodes.manifest();
    let cameras: Vec<&str> = manifest.summary["cameras"]
        .as_array()
        .into_iter()
        .flatten()
        .filter_map(|camera| camera.as_str())
        .collect();
    let found = if cameras.is_empty() {
        "has no images".to_owned()
    } else {
        format!("has only images of {}", cameras.join(", "))
    };
    ensure!(
        episodes.has::<ImageRow>() && cameras.contains(&camera),
        "cannot estimate poses: {} {found}, but the encoder needs images of camera {camera}",
        episodes.path().display();
        "set ingest.render = [\"{camera}\"] if the dataset has no images, or set pose.encoder.camera to one of its cameras"
    );
    Ok(())
}

/// Encodes an image as a PNG file. `pixels` are 8-bit RGB, rows from top to bottom.
///
/// # Errors
/// If `pixels` does not have `3 * width * height` bytes.
pub(crate) fn encode_png(pixels: &[u8], width: u32, height: u32) -> Result<Vec<u8>> {
    let mut bytes = Vec::with_capacity(4096);
    PngEncoder::new_with_quality(&mut bytes, CompressionType::Fast, FilterType::Adaptive)
        .write_image(pixels, width, height, ExtendedColorType::Rgb8)
        .context("cannot encode an image as PNG")?;
    Ok(bytes)
}
