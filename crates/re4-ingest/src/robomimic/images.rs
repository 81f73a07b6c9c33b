//! Streaming of camera images: a few rows of chunks at a time, each decoded once.

use std::collections::BTreeSet;
use std::sync::mpsc::sync_channel;

use super::fault::Hdf5Fault;
use super::file::{Element, File, Located};
use super::reader::RobomimicReader;
use crate::demos::{DemoName, ImageBlock};
use crate::error::{Fault, IngestError};
use crate::tables::LeftOut;

/// Size of a block of images in bytes, unless a single row of chunks is larger.
const BLOCK: usize = 8 << 20;

/// Maximum size of the images in one row of chunks, in bytes.
const BLOCK_LIMIT: usize = 128 << 20;

impl RobomimicReader {
    /// Cameras of the demonstrations, in alphabetical order; only those in `asked`, if given.
    ///
    /// # Errors
    /// A requested camera does not exist.
    pub fn cameras(&self, asked: Option<&[String]>) -> Result<Vec<String>, IngestError> {
        let there = self
            .cameras_of_all()
            .map_err(|fault| Fault::from(fault).of(&self.path))?;
        let Some(asked) = asked else { return Ok(there) };
        if let Some(camera) = asked.iter().find(|camera| !there.contains(camera)) {
            let has = if there.is_empty() {
                "the file has no cameras".to_owned()
            } else {
                format!("the file has {}", there.join(", "))
            };
            let fault = Hdf5Fault::Other(format!(
                "there is no camera {camera:?} (no dataset obs/{}); {has}, so correct ingest.cameras",
                self.image_names.dataset(camera)
            ));
            return Err(Fault::from(fault).of(&self.path));
        }
        Ok(there.into_iter().filter(|camera| asked.contains(camera)).collect())
    }

    fn cameras_of_all(&self) -> Result<Vec<String>, Hdf5Fault> {
        let mut observations = self.surveyed.observations.clone();
        // In cautious mode, only the first demonstration was surveyed.
        for demo in self.demos().iter().filter(|_| self.file.is_cautious()) {
            match self.file.members_or_none(&format!("data/{}/obs", demo.name)) {
                Err(fault @ Hdf5Fault::NeedsLibrary) => return Err(fault),
                // The fault is reported when the demonstration is read.
                Err(_) => {}
                Ok(more) => observations.extend(more),
            }
        }
        let cameras: BTreeSet<&str> = observations
            .iter()
            .filter_map(|name| self.image_names.camera(name))
            .collect();
        Ok(cameras.into_iter().map(str::to_owned).collect())
    }

    /// Checks, without reading them, that a demonstration has valid images of these cameras for all its frames.
    ///
    /// # Errors
    /// The file needs the HDF5 library but was opened without it. Faults of the images are returned as a [`LeftOut`].
    pub(super) fn check_cameras(
        &self,
        demo: &str,
        frames: usize,
        cameras: &[String],
    ) -> Result<Result<(), LeftOut>, IngestError> {
        let mut faults = Vec::new();
        for camera in cameras {
            let path = self.image_path(demo, camera);
            let checked = self.file.exists(&path).and_then(|there| {
                if !there {
                    return Err(Hdf5Fault::Missing {
                        objects: vec![path.clone()],
                        fix: "restore it, leave that camera out with ingest.cameras, or leave the demonstration out with a filter key or ingest.select",
                    });
                }
                let located = self.file.locate(&path)?;
                let [height, width] = image_shape(&located, frames)?;
                rows_at_once(&located, height * width * 3)
            });
            faults.extend(checked.err());
        }
        self.left_out(demo, Hdf5Fault::all(faults).map_or(Ok(()), Err))
    }

    /// Passes all images of a camera to `take`, in the order of demonstrations and frames. `demos` lists the demonstrations with
    /// their numbers of frames. A demonstration with images that cannot be decoded is passed on as left out, and reading
    /// continues. If the images are `late`, there is one more row than frames, and the last row belongs to no frame.
    ///
    /// # Errors
    /// The file needs the HDF5 library but was opened without it, or `take` returns an error.
    pub(super) fn for_each_block<E: From<IngestError>>(
        &self,
        camera: &str,
        demos: &[(DemoName, usize)],
        late: bool,
        mut take: impl FnMut(Result<ImageBlock, LeftOut>) -> Result<(), E>,
    ) -> Result<(), E> {
        std::thread::scope(|scope| {
            // One block is decoded ahead while the caller encodes another one.
            let (sender, receiver) = sync_channel(1);
            scope.spawn(move || {
                for (episode, (demo, frames)) in (0..).zip(demos) {
                    let mut received = true;
                    let sent = self.send_blocks(camera, episode, (&demo.name, *frames), late, |block| {
                        received = sender.send(Ok(Ok(block))).is_ok();
                        received
                    });
                    let last = match sent {
                        Ok(()) => !received,
                        Err(fault) => {
                            let left = self.left_out(&demo.name, Err(fault));
                            let ends = left.is_err();
                            sender.send(left).is_err() || ends
                        }
                    };
                    if last {
                        break;
                    }
                }
            });
            while let Ok(block) = receiver.recv() {
                take(block?)?;
            }
            Ok(())
        })
    }

    fn image_path(&self, demo: &str, camera: &str) -> String {
        format!("data/{demo}/obs/{}", self.image_names.dataset(camera))
    }

    fn send_blocks(
        &self,
        camera: &str,
        episode: u32,
        (demo, frames): (&str, usize),
        late: bool,
        mut send: impl FnMut(ImageBlock) -> bool,
    ) -> Result<(), Hdf5Fault> {
        let located = self.file.locate(&self.image_path(demo, camera))?;
        let [height, width] = image_shape(&located, frames + usize::from(late))?;
        let rows = rows_at_once(&located, height * width * 3)?;
        for first in (0..frames).step_by(rows) {
            let end = frames.min(first + rows);
            let mut bytes = self.file.read_bytes(&located, first..end)?;
            if self.image_names.upside_down() {
                bytes
                    .chunks_exact_mut(height * width * 3)
                    .for_each(|image| flip(image, width * 3));
            }
            let block = ImageBlock {
                places: (first..end).map(|frame| (episode, frame as u32)).collect(),
                height,
                width,
                bytes,
            };
            if !send(block) {
                break;
            }
        }
        Ok(())
    }
}

/// Turns an image upside down; `row` is the number of bytes of a row.
fn flip(image: &mut [u8], row: usize) {
    let rows = image.len() / row;
    let (upper, lower) = image.split_at_mut(rows / 2 * row);
    let lower = lower.rchunks_exact_mut(row);
    upper
        .chunks_exact_mut(row)
        .zip(lower)
        .for_each(|(above, below)| above.swap_with_slice(below));
}

/// Height and width of the images. Checks type and shape.
fn image_shape(located: &Located, frames: usize) -> Result<[usize; 2], Hdf5Fault> {
    let max_side = 1 << 14;
    match (located.element, &located.shape[..]) {
        (Element::U8, &[rows, height, width, 3]) if height.min(width) > 0 && height.max(width) <= max_side => {
            if rows == frames {
                return Ok([height, width]);
            }
            Err(Hdf5Fault::Length {
                objects: vec![located.name.clone()],
                found: rows,
                other: "actions".to_owned(),
                expected: frames,
            })
        }
        (Element::U8, _) => Err(Hdf5Fault::Shape {
            object: located.name.clone(),
            found: located.shape.clone(),
            expected: "(N, height, width, 3)".to_owned(),
            fix: "leave that camera out with ingest.cameras, or all images with ingest.images = false",
        }),
        _ => Err(Hdf5Fault::Dtype {
            object: located.name.clone(),
            found: "numbers other than bytes".to_owned(),
            expected: "uint8 from 0 to 255",
        }),
    }
}

/// Number of rows of a block: as many whole chunks as fit, at least one.
fn rows_at_once(located: &Located, image: usize) -> Result<usize, Hdf5Fault> {
    let chunk = File::chunk_rows(located).max(1);
    let rows = located.shape.first().copied().unwrap_or(chunk).min(chunk);
    if rows.saturating_mul(image) > BLOCK_LIMIT {
        return Err(Hdf5Fault::Shape {
            object: located.name.clone(),
            found: located.shape.clone(),
            expected: format!("chunks of at most {} MiB of images", BLOCK_LIMIT >> 20),
            fix: "rewrite it with fewer frames in a chunk",
        });
    }
    let chunks = (BLOCK / (chunk.saturating_mul(image)).max(1)).max(1);
    Ok(chunks * chunk)
}

#[cfg(test)]
mod tests {
    use super::flip;

    #[test]
    fn flipping_reverses_the_rows() {
        for rows in 0..6_u8 {
            let image: Vec<u8> = (0..rows * 6).collect();
            let mut flipped = image.clone();
            flip(&mut flipped, 6);
            let expected: Vec<u8> = image.chunks(6).rev().flatten().copied().collect();
            assert_eq!(flipped, expected);
        }
    }
}
