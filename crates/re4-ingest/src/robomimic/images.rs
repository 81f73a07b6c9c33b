//! Pictures of cameras, streamed: a few rows of chunks at a time, each decoded once.

use std::collections::BTreeSet;
use std::ops::Range;
use std::sync::mpsc::sync_channel;

use super::demo::Demo;
use super::fault::Hdf5Fault;
use super::file::{Element, File, Located};
use super::reader::RobomimicReader;
use crate::error::{Fault, IngestError};
use crate::left_out::LeftOut;

/// Bytes of pictures in a block, unless one row of chunks has more.
const BLOCK: usize = 8 << 20;

/// Most bytes of pictures that one row of chunks may hold.
const BLOCK_LIMIT: usize = 128 << 20;

/// Ending of the datasets that hold pictures.
const ENDING: &str = "_image";

/// Consecutive pictures of a camera, within one demonstration.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct CameraBlock {
    /// Place of the demonstration among those that were given.
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
    /// Cameras of the demonstrations, in alphabetical order; those that are `asked` for, where any are.
    ///
    /// # Errors
    /// A camera that is not there.
    pub fn cameras(&self, asked: Option<&[String]>) -> Result<Vec<String>, IngestError> {
        let there = self
            .cameras_of_all()
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

    fn cameras_of_all(&self) -> Result<Vec<String>, Hdf5Fault> {
        let mut cameras = BTreeSet::new();
        for demo in self.demos() {
            let observations = match self.file.members_or_none(&format!("data/{}/obs", demo.name)) {
                Err(fault @ Hdf5Fault::NeedsLibrary) => return Err(fault),
                // It is told when the demonstration is read.
                Err(_) => continue,
                Ok(observations) => observations,
            };
            let names = observations.iter().filter_map(|name| name.strip_suffix(ENDING));
            cameras.extend(names.map(str::to_owned));
        }
        Ok(cameras.into_iter().collect())
    }

    /// Whether a demonstration of so many frames has images of these cameras. They are not read.
    ///
    /// # Errors
    /// What is wrong with them, as of a demonstration that cannot be used; a file that cannot be read without the library.
    pub fn check_cameras(&self, demo: &Demo, cameras: &[String]) -> Result<Result<(), LeftOut>, IngestError> {
        let mut faults = Vec::new();
        for camera in cameras {
            let path = format!("data/{}/obs/{camera}{ENDING}", demo.name);
            let checked = self.file.exists(&path).and_then(|there| {
                if !there {
                    return Err(Hdf5Fault::Missing {
                        objects: vec![path.clone()],
                        mend: "restore it, leave that camera out with ingest.cameras, or leave the demonstration out by a filter key or ingest.select",
                    });
                }
                let located = self.file.locate(&path)?;
                let [height, width] = picture_shape(&located, demo.frames)?;
                rows_at_once(&located, height * width * 3)
            });
            faults.extend(checked.err());
        }
        match Hdf5Fault::all(faults) {
            None => Ok(Ok(())),
            Some(fault) if self.file.ends_with(&fault) => Err(Fault::from(fault).of(&self.path)),
            Some(fault) => Ok(Err(LeftOut {
                demo: demo.name.clone(),
                why: fault.to_string(),
            })),
        }
    }

    /// Hands on all images of a camera, in the order of demonstrations and frames; `demos` are names and lengths of
    /// demonstrations. One whose images cannot be decoded is handed on as left out, and the next one follows.
    ///
    /// # Errors
    /// A file that cannot be read without the HDF5 library, or whatever `take` refuses.
    pub fn for_each_block<E: From<IngestError>>(
        &self,
        camera: &str,
        demos: &[(String, usize)],
        mut take: impl FnMut(Result<CameraBlock, LeftOut>) -> Result<(), E>,
    ) -> Result<(), E> {
        std::thread::scope(|scope| {
            // One block ahead: one is decoded while another one is encoded.
            let (sender, receiver) = sync_channel(1);
            scope.spawn(move || {
                for (episode, (demo, frames)) in demos.iter().enumerate() {
                    let mut heard = true;
                    let sent = self.send_blocks(camera, episode, (demo, *frames), |block| {
                        heard = sender.send(Ok(Ok(block))).is_ok();
                        heard
                    });
                    let last = match sent {
                        Ok(()) => !heard,
                        Err(fault) if self.file.ends_with(&fault) => {
                            let _ = sender.send(Err(Fault::from(fault).of(&self.path)));
                            true
                        }
                        Err(fault) => {
                            let left = LeftOut {
                                demo: demo.clone(),
                                why: fault.to_string(),
                            };
                            sender.send(Ok(Err(left))).is_err()
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

    fn send_blocks(
        &self,
        camera: &str,
        episode: usize,
        (demo, frames): (&str, usize),
        mut send: impl FnMut(CameraBlock) -> bool,
    ) -> Result<(), Hdf5Fault> {
        let located = self.file.locate(&format!("data/{demo}/obs/{camera}{ENDING}"))?;
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
                break;
            }
            first = end;
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
