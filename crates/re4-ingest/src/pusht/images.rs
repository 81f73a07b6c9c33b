//! Streaming of images: blocks of consecutive frames in order, decoded ahead in parallel within a fixed memory budget.

use std::cell::RefCell;
use std::collections::VecDeque;
use std::ops::Range;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::AtomicU64;
use std::sync::mpsc::{Receiver, RecvTimeoutError, TryRecvError, sync_channel};
use std::time::Duration;

use rayon::prelude::*;

use crate::bitplanes::{self, Scratch};
use crate::error::{Fault, IngestError};
use crate::source::Stop;
use crate::zarr::{Absent, CHUNK_LIMIT, Element, Lost, ZarrArray};

/// Maximum number of bytes used by blocks that are being decoded, unless a single block needs more. A block needs at most
/// three times 128 MiB: its chunk file, the decoded chunk, and its images.
pub const IMAGE_BUDGET: u64 = 256 << 20;

thread_local! {
    static SCRATCH: RefCell<Scratch> = RefCell::default();
}

/// Consecutive images.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ImageBlock {
    /// Frames of the block, as rows of the dataset's arrays, independent of the selection.
    pub frames: Range<usize>,
    /// `frames.len()` RGB images of `height * width * 3` bytes, row by row from the top.
    pub bytes: Vec<u8>,
}

/// `data/img`, opened and checked.
pub(crate) struct ImageSource {
    dataset: PathBuf,
    pub(crate) array: ZarrArray,
    element: Element,
}

/// Callback for a value that is not a byte. It receives the index of the value in its row of chunks, the value, and whether all
/// values next to it are in 0 to 1. An error ends the decoding.
type Bad<'a> = &'a mut dyn FnMut(usize, f64, bool) -> Result<(), Fault>;

impl ImageSource {
    /// Checks type, shape and chunk sizes.
    pub(crate) fn new(dataset: PathBuf, array: ZarrArray) -> Result<Self, Fault> {
        let element = array.element(|_| true, "a number type")?;
        match *array.shape() {
            [_, height, width, 3] if height > 0 && width > 0 => {}
            [_, 3, height, width] if height > 3 && width > 3 => {
                return Err(Fault::Convention {
                    what: format!("array data/img has shape {:?}, which is channels-first", array.shape()),
                    fix: "transpose it to (N, height, width, 3), or ingest without images".to_owned(),
                });
            }
            _ => {
                return Err(Fault::WrongShape {
                    array: array.name().to_owned(),
                    found: array.shape().to_vec(),
                    expected: "(N, height, width, 3)",
                });
            }
        }
        let row_bytes = array.shape()[1..]
            .iter()
            .try_fold(array.chunk_length().min(array.len()), |product, &length| {
                product.checked_mul(length)
            });
        if row_bytes.is_none_or(|bytes| bytes > CHUNK_LIMIT) {
            return Err(Fault::ChunkTooLarge {
                array: array.name().to_owned(),
                bytes: row_bytes.unwrap_or(u64::MAX),
                limit: CHUNK_LIMIT,
            });
        }
        Ok(Self {
            dataset,
            array,
            element,
        })
    }

    /// Height, width and channels.
    pub(crate) fn shape(&self) -> [usize; 3] {
        std::array::from_fn(|axis| self.array.shape()[axis + 1] as usize)
    }

    /// The error for a fault; reports a change of the dataset instead if there was one.
    fn explain(&self, fault: Fault) -> IngestError {
        self.array.store().explain(fault).of(&self.dataset)
    }

    fn frame_bytes(&self) -> usize {
        self.shape().iter().product()
    }

    /// Bytes used while one row of chunks is decoded.
    fn cost(&self) -> u64 {
        let images = self.array.chunk_length().min(self.array.len()) * self.frame_bytes() as u64;
        images + 2 * self.array.chunk_bytes().unwrap_or(CHUNK_LIMIT)
    }

    /// Decodes all images of a row of chunks.
    fn decode(&self, chunk_row: u64, stop: Stop<'_>) -> Result<Vec<u8>, Fault> {
        let first = self.array.rows_of(chunk_row).start;
        self.decode_with(chunk_row, stop, &mut |at, value, in_unit_range| {
            Err(self.not_a_byte(first, at, value, in_unit_range))
        })
    }

    fn decode_with(&self, chunk_row: u64, stop: Stop<'_>, bad: Bad<'_>) -> Result<Vec<u8>, Fault> {
        let rows = self.array.rows_of(chunk_row);
        let mut bytes = vec![0; (rows.end - rows.start) as usize * self.frame_bytes()];
        let size = self.element.size();
        for index in self.array.chunks_of(chunk_row) {
            let encoded = self.array.read_chunk(&index, stop)?;
            if let Some(encoded) = &encoded
                && self.element == Element::F32
                && self.array.is_little_endian_blosc()
                && self.array.chunks_hold_whole_rows()
                && SCRATCH.with_borrow_mut(|scratch| {
                    let values = self.array.chunk_bytes().unwrap_or(0) as usize / size;
                    bitplanes::decode(encoded, values, &mut bytes, scratch).is_some()
                })
            {
                continue;
            }
            // The general path, which also finds the value that the fast path rejected.
            let decoded = self
                .array
                .decode_chunk(&index, encoded, Absent::IsLost, &AtomicU64::new(0))?;
            self.array.scatter(&index, &decoded, size, |run, at| {
                let target = &mut bytes[at..at + run.len() / size];
                let whole = match self.element {
                    Element::U8 => {
                        target.copy_from_slice(run);
                        true
                    }
                    Element::F32 => floats_to_bytes(run.as_chunks::<4>().0, target),
                    _ => false,
                };
                if whole {
                    return Ok(());
                }
                let values = || run.chunks_exact(size).map(|bytes| self.element.float(bytes));
                let mut in_unit_range = None;
                for (offset, (value, byte)) in values().zip(target).enumerate() {
                    *byte = value as u8;
                    if f64::from(*byte) != value {
                        let unit =
                            *in_unit_range.get_or_insert_with(|| values().all(|value| (0.0..=1.0).contains(&value)));
                        bad(at + offset, value, unit)?;
                    }
                }
                Ok(())
            })?;
        }
        Ok(bytes)
    }

    /// The fault of a value that is not a byte.
    fn not_a_byte(&self, first_frame: u64, at: usize, value: f64, in_unit_range: bool) -> Fault {
        let [_, width, channels] = self.shape();
        let (frame, pixel) = (first_frame + (at / self.frame_bytes()) as u64, at % self.frame_bytes());
        if in_unit_range {
            return Fault::ScaledImages { frame, value };
        }
        Fault::NotAByte {
            frame,
            row: pixel / (width * channels),
            column: pixel / channels % width,
            channel: pixel % channels,
            value,
        }
    }

    /// Checks the images of some runs of frames. Returns the first invalid value of every image, and chunks that cannot be
    /// decoded.
    ///
    /// # Errors
    /// All images are invalid in the same way (scaled to 0..1), a file changed, or `stop` returned true.
    pub(crate) fn judge(&self, runs: &[Range<u64>], stop: Stop<'_>) -> Result<Vec<Lost>, Fault> {
        let mut lost: Vec<Lost> = self.array.missing(runs, Absent::IsLost).into_iter().collect();
        let is_missing = |row: u64| lost.iter().flat_map(|lost| &lost.rows).any(|rows| rows.contains(&row));
        let chunk_rows: Vec<u64> = self
            .array
            .chunk_rows_of(runs)
            .into_iter()
            .filter(|chunk_row| !is_missing(self.array.rows_of(*chunk_row).start))
            .collect();
        // The same memory budget as for images that are read.
        let at_once = (IMAGE_BUDGET / self.cost().max(1)).clamp(1, rayon::current_num_threads() as u64) as usize;
        for batch in chunk_rows.chunks(at_once) {
            if stop() {
                return Err(Fault::Stopped);
            }
            let judged: Vec<Result<Vec<Lost>, Fault>> = batch
                .par_iter()
                .map(|&chunk_row| self.judge_chunk_row(chunk_row, stop))
                .collect();
            for faults in judged {
                lost.append(&mut faults?);
            }
        }
        Ok(lost)
    }

    fn judge_chunk_row(&self, chunk_row: u64, stop: Stop<'_>) -> Result<Vec<Lost>, Fault> {
        let rows = self.array.rows_of(chunk_row);
        let mut lost = Vec::new();
        let mut last = None;
        let decoded = self.decode_with(chunk_row, stop, &mut |at, value, in_unit_range| {
            let frame = rows.start + (at / self.frame_bytes()) as u64;
            match self.not_a_byte(rows.start, at, value, in_unit_range) {
                scaled @ Fault::ScaledImages { .. } => Err(scaled),
                _ if last == Some(frame) => Ok(()),
                fault => {
                    last = Some(frame);
                    lost.push(Lost::of(frame..frame + 1, fault));
                    Ok(())
                }
            }
        });
        match decoded {
            Ok(_) => Ok(lost),
            Err(fault @ (Fault::UndecodableChunk { .. } | Fault::MissingChunk { .. })) => {
                Ok(vec![Lost::of(rows, fault)])
            }
            Err(fault) => Err(fault),
        }
    }
}

/// Converts floats in native byte order. Returns whether all were integers from 0 to 255.
fn floats_to_bytes(floats: &[[u8; 4]], target: &mut [u8]) -> bool {
    let mut exact = true;
    for (byte, float) in target.iter_mut().zip(floats) {
        let value = f32::from_ne_bytes(*float);
        *byte = value as u8;
        exact &= f32::from(*byte) == value;
    }
    exact
}

/// Result of one task: the images of a row of chunks.
type Decoded = Result<Vec<u8>, Fault>;

/// A row of chunks and the runs of selected frames in it.
struct Job {
    chunk_row: u64,
    runs: Vec<Range<usize>>,
}

/// Iterator over blocks of images in the order of frames; see [`super::PushtReader::image_blocks`].
pub struct ImageBlocks {
    source: Arc<ImageSource>,
    /// Frames of each episode.
    episodes: Vec<Range<u64>>,
    waiting: VecDeque<Job>,
    running: VecDeque<(Job, Receiver<Decoded>)>,
    ready: VecDeque<ImageBlock>,
    in_flight: usize,
    failed: bool,
}

impl ImageBlocks {
    /// Prepares the decoding of `runs`, which are ascending, disjoint runs of frames.
    pub(crate) fn new(source: Arc<ImageSource>, runs: &[Range<usize>]) -> Result<Self, IngestError> {
        let mut waiting: VecDeque<Job> = VecDeque::new();
        for run in runs {
            let mut start = run.start;
            while start < run.end {
                let chunk_row = start as u64 / source.array.chunk_length();
                let end = run.end.min(source.array.rows_of(chunk_row).end as usize);
                match waiting.back_mut().filter(|job| job.chunk_row == chunk_row) {
                    // A run that continues the previous one belongs to the same block.
                    Some(Job { runs, .. }) => match runs.last_mut().filter(|last| last.end == start) {
                        Some(last) => last.end = end,
                        None => runs.push(start..end),
                    },
                    None => waiting.push_back(Job {
                        chunk_row,
                        runs: std::iter::once(start..end).collect(),
                    }),
                }
                start = end;
            }
        }
        // Missing files are searched for first, so that they are reported before, not after, minutes of work.
        let episodes: Vec<Range<u64>> = runs.iter().map(|run| run.start as u64..run.end as u64).collect();
        if let Some(lost) = source.array.missing(&episodes, Absent::IsLost) {
            return Err(source.explain(lost.fault));
        }
        let in_flight =
            (IMAGE_BUDGET / source.cost().max(1)).clamp(1, 2 * rayon::current_num_threads() as u64) as usize;
        Ok(Self {
            source,
            episodes,
            waiting,
            running: VecDeque::new(),
            ready: VecDeque::new(),
            in_flight,
            failed: false,
        })
    }

    /// Combines the faults of all images if the first one concerns a single episode, so that the user sees them at once.
    fn all_of(&self, first: Fault) -> Fault {
        if !matches!(first, Fault::NotAByte { .. } | Fault::UndecodableChunk { .. }) {
            return first;
        }
        let lost = match self.source.judge(&self.episodes, &|| false) {
            Ok(lost) => lost,
            Err(fault) => return fault,
        };
        let mut bad = 0;
        let mut reported = vec![false; lost.len()];
        for episode in &self.episodes {
            let overlaps = |lost: &Lost| {
                lost.rows
                    .iter()
                    .any(|rows| rows.start < episode.end && episode.start < rows.end)
            };
            if let Some(number) = lost.iter().position(overlaps) {
                bad += 1;
                reported[number] = true;
            }
        }
        let mut faults: Vec<Fault> = lost
            .into_iter()
            .zip(reported)
            .filter_map(|(lost, reported)| reported.then_some(lost.fault))
            .collect();
        match faults.len() {
            0 => first,
            1 => faults.pop().unwrap_or(first),
            _ => Fault::of_episodes(&faults, bad, self.episodes.len(), false),
        }
    }

    fn start_jobs(&mut self) {
        while self.running.len() < self.in_flight {
            let Some(job) = self.waiting.pop_front() else { break };
            let (sender, receiver) = sync_channel(1);
            let (source, chunk_row) = (Arc::clone(&self.source), job.chunk_row);
            rayon::spawn(move || {
                // The receiver is gone if the caller stopped early, and the block is then not needed.
                let _ = sender.send(source.decode(chunk_row, &|| false));
            });
            self.running.push_back((job, receiver));
        }
    }

    fn advance(&mut self) -> Result<(), Fault> {
        let Some((job, receiver)) = self.running.pop_front() else {
            return Ok(());
        };
        let lost = || self.source.array.undecodable(&[job.chunk_row], "the decoder stopped");
        let bytes = wait(&receiver).unwrap_or_else(|| Err(lost()))?;
        let start = self.source.array.rows_of(job.chunk_row).start as usize;
        let frame_bytes = self.source.frame_bytes();
        let whole = job
            .runs
            .first()
            .is_some_and(|run| run.len() * frame_bytes == bytes.len());
        match <[Range<usize>; 1]>::try_from(job.runs) {
            Ok([frames]) if whole => self.ready.push_back(ImageBlock { frames, bytes }),
            runs => {
                let runs = runs.map_or_else(|runs| runs, |[run]| vec![run]);
                self.ready.extend(runs.into_iter().map(|frames| {
                    let place = (frames.start - start) * frame_bytes..(frames.end - start) * frame_bytes;
                    ImageBlock {
                        bytes: bytes[place].to_vec(),
                        frames,
                    }
                }));
            }
        }
        Ok(())
    }
}

/// Waits for a task. A thread of the pool works on other tasks meanwhile, since it may be the only one. Returns `None` if the
/// task ended without a result.
fn wait(receiver: &Receiver<Decoded>) -> Option<Decoded> {
    loop {
        match receiver.try_recv() {
            Ok(decoded) => return Some(decoded),
            Err(TryRecvError::Disconnected) => return None,
            Err(TryRecvError::Empty) => {}
        }
        match rayon::yield_now() {
            Some(rayon::Yield::Executed) => {}
            Some(rayon::Yield::Idle) => match receiver.recv_timeout(Duration::from_millis(1)) {
                Ok(decoded) => return Some(decoded),
                Err(RecvTimeoutError::Disconnected) => return None,
                Err(RecvTimeoutError::Timeout) => {}
            },
            None => return receiver.recv().ok(),
        }
    }
}

impl Iterator for ImageBlocks {
    type Item = Result<ImageBlock, IngestError>;

    fn next(&mut self) -> Option<Self::Item> {
        if self.failed {
            return None;
        }
        while self.ready.is_empty() {
            self.start_jobs();
            if self.running.is_empty() {
                return None;
            }
            if let Err(fault) = self.advance() {
                self.failed = true;
                return Some(Err(self.source.explain(self.all_of(fault))));
            }
            self.start_jobs();
        }
        self.ready.pop_front().map(Ok)
    }
}
