//! The images that an encoder reads.

use anyhow::Result;
use image::ImageFormat;
use rayon::prelude::*;
use re4_artifact::{Artifact, Row as _, col_binary, col_text, col_u32};
use re4_encoder::IMAGE_BYTES;
use re4_fault::{OrFault as _, ensure, fault};
use re4_ingest::ImageRow;

use crate::runner::Runner;

/// A decoded image.
pub(super) struct Decoded {
    pub(super) episode: u32,
    pub(super) frame: u32,
    /// RGB, first row at the top.
    pub(super) pixels: Vec<u8>,
}

impl Runner {
    /// The images of a camera in an `episodes` artifact or in a part of one, in the order of the frames. A batch of rows is in memory at
    /// a time. `name` returns the name of a demonstration, for messages.
    pub(super) fn images_of<'a>(
        &'a self,
        episodes: &'a Artifact,
        camera: &'a str,
        name: &'a (dyn Fn(u32) -> String + Sync),
    ) -> Result<impl Iterator<Item = Result<Decoded>> + use<'a>> {
        let batches = episodes.table(ImageRow::table())?.batches()?;
        Ok(batches.flat_map(move |batch| {
            let decode = || -> Result<Vec<Result<Decoded>>> {
                self.interrupt.check("the run")?;
                let rows = batch?;
                let (cameras, images) = (col_text(&rows, "camera")?, col_binary(&rows, "image")?);
                let (episode, frame) = (col_u32(&rows, "episode")?, col_u32(&rows, "frame")?);
                let own: Vec<usize> = (0..cameras.len()).filter(|&row| cameras[row] == Some(camera)).collect();
                let decoded = own.par_iter().map(|&row| {
                    let place = || {
                        format!(
                            "cannot use the images of {}: that of {}, frame {}",
                            episodes.path().display(),
                            name(episode[row]),
                            frame[row]
                        )
                    };
                    let image = image::load_from_memory_with_format(images.value(row), ImageFormat::Png)
                        .or_fault(|| fault!("{} is not a PNG image", place(); "delete the artifact and ingest again"))?
                        .into_rgb8();
                    let (width, height) = image.dimensions();
                    ensure!(
                        image.as_raw().len() == IMAGE_BYTES && width == height,
                        "{} has {width} x {height} pixels, but the encoder needs 84 x 84", place();
                        "render images with ingest.render"
                    );
                    Ok(Decoded {
                        episode: episode[row],
                        frame: frame[row],
                        pixels: image.into_raw(),
                    })
                });
                Ok(decoded.collect())
            };
            decode().unwrap_or_else(|error| vec![Err(error)])
        }))
    }
}
