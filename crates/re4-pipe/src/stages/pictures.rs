//! What stages that look at pictures of robosuite's tasks need of an `episodes` artifact.

use anyhow::{Result, ensure};
use re4_artifact::{Artifact, tables};

/// Refuses demonstrations without pictures of a camera.
pub(super) fn check_pictures(episodes: &Artifact, camera: &str) -> Result<()> {
    let manifest = episodes.manifest();
    let cameras: Vec<&str> = manifest.summary["cameras"]
        .as_array()
        .into_iter()
        .flatten()
        .filter_map(|camera| camera.as_str())
        .collect();
    let there = if cameras.is_empty() {
        "holds no pictures".to_owned()
    } else {
        format!("holds pictures of {} alone", cameras.join(", "))
    };
    ensure!(
        manifest.tables.contains_key(tables::CAMERA_IMAGES.name) && cameras.contains(&camera),
        "cannot estimate poses: {} {there}, and the encoder reads those of the camera {camera}; set ingest.render = [\"{camera}\"] where the dataset has none, or name a camera that it has as pose.encoder.camera",
        episodes.path().display()
    );
    Ok(())
}
