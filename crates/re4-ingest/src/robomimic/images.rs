//! Pictures of cameras, streamed: a few rows of chunks at a time, each decoded once.

use std::ops::Range;
use std::sync::mpsc::sync_channel;

use super::fault::Hdf5Fault;
use super::file::{Element, File, Located};
use super::reader::RobomimicReader;
use crate::error::{Fault, IngestError};

/// Bytes of pictures in a block, unless one row of chunks has more.
const BLOCK: usize = 8 << 20;

/// Most bytes of pictures that one row of chunks may hold.
const BLOCK_LIMIT: usize = 128 << 20;

/// Ending of the datasets that hold pictures.
const ENDING: &str = "_image";

/// Consecutive pictures of a camera, within one demonstration.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct CameraBlock {
    /// Place of the demonstration among those asked for.
    pub episode: usize,
    /// Frames of the demonstration.
    pub frames: Range<usize>,
    /// Rows of pixels.
    pub height: usize,
    /// Pixels of a row.
    pub width: usize,
    /// Red, green and blue, pixel by pixel, first row at the top, picture by picture.
    pub bytes: Vec<u8>,
}

impl RobomimicReader {
    /// Cameras of the first demonstration, in alphabetical order; those that are `asked` for, where any are.
    ///
    /// # Errors
    /// A camera that is not there.
    pub fn cameras(&self, asked: Option<&[String]>) -> Result<Vec<String>, IngestError> {
        let there = self
            .cameras_of_first()
            .map_err(|fault| Fault::from(fault).of(&self.path))?;
        let Some(asked) = asked else { return Ok(there) };
        if let Some(camera) = asked.iter().find(|camera| !there.contains(camera)) {
            let has = if there.is_empty() {
                "it has none".to_owned()
            } else {
                format!("it has {}", there.join(", "))
            };
            let fault = Hdf5Fault::Other(format!(
                "there is no camera {camera:?} (no dataset obs/{camera}{ENDING}); {has}, so correct ingest.cameras"
            ));
            return Err(Fault::from(fault).of(&self.path));
        }
        Ok(there.into_iter().filter(|camera| asked.contains(camera)).collect())
    }

    fn cameras_of_first(&self) -> Result<Vec<String>, Hdf5Fault> {
        let Some(demo) = self.demos().first() else {
            return Ok(Vec::new());
        };
        let observations = self.file.members_or_none(&format!("data/{}/obs", demo.name))?;
        Ok(observations
            .iter()
            .filter_map(|name| name.strip_suffix(ENDING))
            .map(str::to_owned)
            .collect())
    }

    /// Hands on all pictures of a camera, in the order of demonstrations and frames; `frames` are the lengths of the
    /// demonstrations.
    ///
    /// # Errors
    /// A dataset that is missing, damaged, or holds something else than one picture of height x width x 3 bytes a frame;
    /// whatever `take` refuses.
    pub fn for_each_block<E: From<IngestError>>(
        &self,
        camera: &str,
        frames: &[usize],
        mut take: impl FnMut(CameraBlock) -> Result<(), E>,
    ) -> Result<(), E> {
        std::thread::scope(|scope| {
            // One block ahead: one is decoded while another one is encoded.
            let (sender, receiver) = sync_channel(1);
            scope.spawn(move || {
                let sent = self.send_blocks(camera, frames, |block| sender.send(Ok(block)).is_ok());
                if let Err(fault) = sent {
                    let _ = sender.send(Err(Fault::from(fault).of(&self.path)));
                }
            });
            while let Ok(block) = receiver.recv() {
                take(block?)?;
            }
            Ok(())
        })
    }

    fn send_blocks(
        &self,
        camera: &str,
        frames: &[usize],
        mut send: impl FnMut(CameraBlock) -> bool,
    ) -> Result<(), Hdf5Fault> {
        for (episode, (demo, &frames)) in self.demos().iter().zip(frames).enumerate() {
            let located = self.file.locate(&format!("data/{}/obs/{camera}{ENDING}", demo.name))?;
            let [height, width] = picture_shape(&located, frames)?;
            let rows = rows_at_once(&located, height * width * 3)?;
            let mut first = 0;
            while first < frames {
                let end = frames.min(first + rows);
                let bytes = self.file.read_bytes(&located, first..end)?;
                let block = CameraBlock {
                    episode,
                    frames: first..end,
                    height,
                    width,
                    bytes,
                };
                if !send(block) {
                    return Ok(());
                }
                first = end;
            }
        }
        Ok(())
    }
}

/// Height and width of the pictures.
fn picture_shape(located: &Located, frames: usize) -> Result<[usize; 2], Hdf5Fault> {
    let most = 1 << 14;
    match (located.element, &located.shape[..]) {
        (Element::U8, &[rows, height, width, 3]) if height.min(width) > 0 && height.max(width) <= most => {
            if rows == frames {
                return Ok([height, width]);
            }
            Err(Hdf5Fault::Length {
                object: located.name.clone(),
                found: rows,
                other: "actions".to_owned(),
                expected: frames,
            })
        }
        (Element::U8, _) => Err(Hdf5Fault::Shape {
            object: located.name.clone(),
            found: located.shape.clone(),
            expected: "(N, height, width, 3)".to_owned(),
            mend: "leave that camera out with ingest.cameras, or all pictures with ingest.images = false",
        }),
        _ => Err(Hdf5Fault::Dtype {
            object: located.name.clone(),
            found: "other numbers than bytes".to_owned(),
            expected: "uint8 from 0 to 255",
        }),
    }
}

/// As many whole rows of chunks as fit into a block, at least one.
fn rows_at_once(located: &Located, picture: usize) -> Result<usize, Hdf5Fault> {
    let chunk = File::chunk_rows(located).max(1);
    let rows = located.shape.first().copied().unwrap_or(chunk).min(chunk);
    if rows.saturating_mul(picture) > BLOCK_LIMIT {
        return Err(Hdf5Fault::Shape {
            object: located.name.clone(),
            found: located.shape.clone(),
            expected: format!("chunks of at most {} MiB of pictures", BLOCK_LIMIT >> 20),
            mend: "rewrite it with fewer frames in a chunk",
        });
    }
    let chunks = (BLOCK / (chunk.saturating_mul(picture)).max(1)).max(1);
    Ok(chunks * chunk)
}
