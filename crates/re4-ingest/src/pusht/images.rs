//! Pictures, streamed: blocks of consecutive frames in order, decoded ahead in parallel within a fixed budget.

use std::cell::RefCell;
use std::collections::VecDeque;
use std::ops::Range;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::mpsc::{Receiver, RecvTimeoutError, TryRecvError, sync_channel};
use std::time::Duration;

use crate::bitplanes::{self, Scratch};
use crate::error::{Fault, IngestError};
use crate::store::Store;
use crate::zarr::{CHUNK_LIMIT, Element, ZarrArray};

/// Bytes that blocks in the making may hold together, unless a single block needs more (a block needs at most three
/// times 128 MiB: its chunk file, the decoded chunk, its pictures).
pub const IMAGE_BUDGET: u64 = 256 << 20;

thread_local! {
    static SCRATCH: RefCell<Scratch> = RefCell::default();
}

/// Consecutive pictures.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ImageBlock {
    /// Frames of the block: rows of the dataset's arrays, whatever the selection.
    pub frames: Range<usize>,
    /// `frames.len()` pictures of `height * width * 3` bytes, row by row from the top, red, green, blue.
    pub bytes: Vec<u8>,
}

/// `data/img`, opened and checked.
pub(crate) struct ImageSource {
    dataset: PathBuf,
    pub(crate) array: ZarrArray,
    element: Element,
    /// Keeps an unpacked zip on disk while blocks are being read.
    _store: Arc<Store>,
}

impl ImageSource {
    /// Checks type, shape and chunk sizes.
    pub(crate) fn new(dataset: PathBuf, array: ZarrArray, store: Arc<Store>) -> Result<Self, Fault> {
        let element = array.element(|e| matches!(e, Element::F32 | Element::U8), "float32 or uint8")?;
        if !matches!(array.shape(), [_, height, width, 3] if *height > 0 && *width > 0) {
            return Err(Fault::WrongShape {
                array: array.name().to_owned(),
                found: array.shape().to_vec(),
                expected: "(N, height, width, 3)",
            });
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
            _store: store,
        })
    }

    /// Height, width and channels.
    pub(crate) fn shape(&self) -> [usize; 3] {
        std::array::from_fn(|axis| self.array.shape()[axis + 1] as usize)
    }

    fn frame_bytes(&self) -> usize {
        self.shape().iter().product()
    }

    /// Bytes held while one row of chunks is being decoded.
    fn cost(&self) -> u64 {
        let pictures = self.array.chunk_length().min(self.array.len()) * self.frame_bytes() as u64;
        pictures + 2 * self.array.chunk_bytes().unwrap_or(CHUNK_LIMIT)
    }

    /// All pictures of a row of chunks.
    fn decode(&self, chunk_row: u64) -> Result<Vec<u8>, Fault> {
        let rows = self.array.rows_of(chunk_row);
        let mut bytes = vec![0; (rows.end - rows.start) as usize * self.frame_bytes()];
        for index in self.array.chunks_of(chunk_row) {
            let encoded = self.array.read_chunk(&index)?;
            if self.element == Element::F32
                && self.array.is_little_endian_blosc()
                && self.array.chunks_hold_whole_rows()
                && SCRATCH.with_borrow_mut(|scratch| {
                    let values = self.array.chunk_bytes().unwrap_or(0) as usize / Element::F32.size();
                    bitplanes::decode(&encoded, values, &mut bytes, scratch).is_some()
                })
            {
                continue;
            }
            let decoded = self.array.decode_chunk(&index, encoded)?;
            self.array.scatter(&index, &decoded, self.element.size(), |run, at| {
                if self.element == Element::U8 {
                    bytes[at..at + run.len()].copy_from_slice(run);
                    return Ok(());
                }
                let (floats, _) = run.as_chunks::<4>();
                let target = &mut bytes[at..at + floats.len()];
                match floats_to_bytes(floats, target) {
                    None => Ok(()),
                    Some(offset) => Err(self.not_a_byte(rows.start, at + offset, floats, offset)),
                }
            })?;
        }
        Ok(bytes)
    }

    /// Names the value that is no byte.
    fn not_a_byte(&self, first_frame: u64, at: usize, floats: &[[u8; 4]], offset: usize) -> Fault {
        let value = f32::from_ne_bytes(floats[offset]);
        let [_, width, channels] = self.shape();
        let (frame, pixel) = (first_frame + (at / self.frame_bytes()) as u64, at % self.frame_bytes());
        let in_unit_range = |float: &[u8; 4]| (0.0..=1.0).contains(&f32::from_ne_bytes(*float));
        if floats.iter().all(in_unit_range) {
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
}

/// Converts floats in the machine's byte order; the place of the first that is not a whole number from 0 to 255.
fn floats_to_bytes(floats: &[[u8; 4]], target: &mut [u8]) -> Option<usize> {
    let mut exact = true;
    for (byte, float) in target.iter_mut().zip(floats) {
        let value = f32::from_ne_bytes(*float);
        *byte = value as u8;
        exact &= f32::from(*byte) == value;
    }
    if exact {
        return None;
    }
    floats.iter().position(|float| {
        let value = f32::from_ne_bytes(*float);
        f32::from(value as u8) != value
    })
}

/// What one task delivers: the pictures of a row of chunks.
type Decoded = Result<Vec<u8>, Fault>;

/// A row of chunks and the runs of selected frames in it.
struct Job {
    chunk_row: u64,
    runs: Vec<Range<usize>>,
}

/// Blocks of pictures in the order of frames; see [`super::PushtReader::image_blocks`].
pub struct ImageBlocks {
    source: Arc<ImageSource>,
    waiting: VecDeque<Job>,
    running: VecDeque<(Job, Receiver<Decoded>)>,
    ready: VecDeque<ImageBlock>,
    in_flight: usize,
    failed: bool,
}

impl ImageBlocks {
    /// `runs` are ascending, disjoint runs of frames.
    pub(crate) fn new(source: Arc<ImageSource>, runs: &[Range<usize>]) -> Result<Self, IngestError> {
        let mut waiting: VecDeque<Job> = VecDeque::new();
        for run in runs {
            let mut start = run.start;
            while start < run.end {
                let chunk_row = start as u64 / source.array.chunk_length();
                let end = run.end.min(source.array.rows_of(chunk_row).end as usize);
                match waiting.back_mut().filter(|job| job.chunk_row == chunk_row) {
                    // A run that goes on where the last one stopped belongs to the same block.
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
        // Everything is looked for first: a lost file is reported before minutes of work, not after.
        for job in &waiting {
            for index in source.array.chunks_of(job.chunk_row) {
                source
                    .array
                    .check_chunk_exists(&index)
                    .map_err(|fault| fault.of(&source.dataset))?;
            }
        }
        let in_flight =
            (IMAGE_BUDGET / source.cost().max(1)).clamp(1, 2 * rayon::current_num_threads() as u64) as usize;
        Ok(Self {
            source,
            waiting,
            running: VecDeque::new(),
            ready: VecDeque::new(),
            in_flight,
            failed: false,
        })
    }

    fn start_jobs(&mut self) {
        while self.running.len() < self.in_flight {
            let Some(job) = self.waiting.pop_front() else { break };
            let (sender, receiver) = sync_channel(1);
            let (source, chunk_row) = (Arc::clone(&self.source), job.chunk_row);
            rayon::spawn(move || {
                // The receiver is gone if the caller stopped early; then nobody needs the block.
                let _ = sender.send(source.decode(chunk_row));
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

/// Waits for a task; a thread of the pool works on other tasks meanwhile, since it may be the only one. `None` if the
/// task ended without an answer.
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
                return Some(Err(fault.of(&self.source.dataset)));
            }
            self.start_jobs();
        }
        self.ready.pop_front().map(Ok)
    }
}
