//! The images of demonstrations.

use anyhow::Result;
use re4_artifact::{Artifact, Row as _, Table};
use re4_fault::{bail, ensure};
use re4_ingest::{EpisodeRow, ImageRow};
use re4_lerobot::write::png_size;

/// The images of an artifact, by camera.
pub(crate) struct Cameras {
    table: Table,
    /// Names of the cameras and their image sizes (width, height), in the order of the table.
    pub(crate) sizes: Vec<(String, (usize, usize))>,
    /// The first frame of each demonstration, and the number of all frames.
    starts: Vec<u64>,
    /// The first frame of each part of the artifact, and the number of all frames. The images of a part are sorted by camera.
    parts: Vec<u64>,
}

impl Cameras {
    /// Opens the table of images; `None` if there is none.
    pub(crate) fn open(episodes: &Artifact) -> Result<Option<Self>> {
        if !episodes.has::<ImageRow>() {
            return Ok(None);
        }
        let table = episodes.table(ImageRow::table())?;
        let mut starts = vec![0_u64];
        for row in episodes.read::<EpisodeRow>()? {
            starts.push(starts.last().copied().unwrap_or(0) + row.frames as u64);
        }
        let frames = starts.last().copied().unwrap_or(0);
        let mut cameras = Vec::new();
        let count = table.rows().checked_div(frames).unwrap_or(0);
        let mut parts = vec![0];
        parts.extend(
            table
                .file_ends()
                .into_iter()
                .map(|end| end.checked_div(count).unwrap_or(0)),
        );
        ensure!(
            count * frames == table.rows(),
            "the table images of {} has {} rows, which is no multiple of its {frames} frames",
            episodes.path().display(), table.rows();
            "ingest the dataset again, or leave the images out with --no-images"
        );
        for camera in 0..count {
            let at = camera * parts.get(1).copied().unwrap_or(frames);
            for row in table.read_range::<ImageRow>(at..at + 1)? {
                let name = row.camera.map_or_else(|| "img".to_owned(), |name| name.to_string());
                let Some(size) = png_size(&row.image) else {
                    bail!(
                        "the first image of camera {name} in {} is not a PNG file", episodes.path().display();
                        "ingest the dataset again"
                    );
                };
                cameras.push((name, size));
            }
        }
        Ok(Some(Self {
            table,
            sizes: cameras,
            starts,
            parts,
        }))
    }

    /// The images of a demonstration from each camera.
    pub(crate) fn of(&self, number: u32) -> Result<Vec<Vec<Vec<u8>>>> {
        let place = self
            .starts
            .get(number as usize)
            .zip(self.starts.get(number as usize + 1));
        let Some((&first, &end)) = place else {
            bail!("there are no images of demonstration {number}"; "ingest the dataset again");
        };
        let part = self.parts.partition_point(|start| *start <= first).max(1) - 1;
        let (before, frames) = match self.parts[part..] {
            [start, end, ..] => (start, end - start),
            _ => (0, 0),
        };
        let mut all = Vec::with_capacity(self.sizes.len());
        for (camera, (name, _)) in (0..).zip(&self.sizes) {
            let offset = before * self.sizes.len() as u64 + camera * frames;
            let rows = self
                .table
                .read_range::<ImageRow>(offset + first - before..offset + end - before)?;
            let mut images = Vec::with_capacity(rows.len());
            for (frame, row) in (0..).zip(rows) {
                let here = row.camera.as_deref().unwrap_or("img") == name;
                ensure!(
                    here && row.episode == number && row.frame == frame,
                    "table images of {} is not sorted by camera, demonstration and frame", self.table.path().display();
                    "ingest the dataset again, or leave the images out with --no-images"
                );
                images.push(row.image);
            }
            all.push(images);
        }
        Ok(all)
    }
}
