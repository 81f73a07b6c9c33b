//! Reader of one array of a Zarr store of format 2 or 3. It reads chunks individually, so that errors name the missing or broken
//! one.

mod codecs;
mod element;
mod metadata;

use std::ops::Range;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};

use rayon::prelude::*;

use crate::compression::Compressor;
use crate::error::Fault;
use crate::source::Stop;
use crate::store::Store;
pub(crate) use element::Element;
use metadata::Layout;

/// Maximum size of a decoded chunk, and of a row of chunks converted to bytes: 128 MiB. It bounds the memory of every reader.
pub(crate) const CHUNK_LIMIT: u64 = 128 << 20;

/// Maximum number of bytes by which a chunk's file may exceed the chunk's content.
const FILE_SLACK: u64 = 1 << 20;

/// Maximum number of missing chunks that are counted individually.
const MAX_MISSING: u64 = 10_000;

/// Rows of chunks decoded at once, before their content is assembled.
const BATCH: usize = 256;

/// Maximum size of an array's metadata, which in format 3 includes its attributes.
const METADATA_LIMIT: u64 = 64 << 20;

/// How to interpret a chunk that is not stored. By the Zarr specification all its elements have the fill value. Writers may omit
/// chunks that contain only the fill value, but a copy that lost a file looks the same.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Absent {
    /// The fill value, which is a plausible recorded value. If other chunks of the array that contain only the fill value are
    /// stored, the writer does not omit such chunks, and the chunk counts as lost.
    IsFill,
    /// Lost data: no recording has the fill value in a whole chunk.
    IsLost,
}

/// Rows of an array, and those that could not be read.
pub(crate) struct Rows<T> {
    /// The requested rows, in C order; lost rows are zero.
    pub(crate) values: Vec<T>,
    /// The lost rows, in order.
    pub(crate) lost: Vec<Lost>,
    /// Number of chunks that are not stored and were read as fill values.
    pub(crate) absent: u64,
}

/// Rows that cannot be read for one reason.
pub(crate) struct Lost {
    /// Rows of the array.
    pub(crate) rows: Vec<Range<u64>>,
    /// The reason.
    pub(crate) fault: Fault,
}

impl Lost {
    /// A run of rows.
    pub(crate) fn of(rows: Range<u64>, fault: Fault) -> Self {
        Self {
            rows: std::iter::once(rows).collect(),
            fault,
        }
    }
}

/// An opened array. Only its metadata has been read.
pub(crate) struct ZarrArray {
    name: String,
    store: Arc<Store>,
    layout: Layout,
    shape: Vec<u64>,
    chunk: Vec<u64>,
}

impl ZarrArray {
    /// Opens `name` (such as `data/state`) of a store; `None` if it has no metadata. If both formats have metadata, format 3
    /// takes precedence, as in zarr-python.
    pub(crate) fn open(store: &Arc<Store>, name: &str, stop: Stop<'_>) -> Result<Option<Self>, Fault> {
        let file = |end: &str| format!("{name}/{end}");
        let read = |file: &str| -> Result<Option<Vec<u8>>, Fault> {
            if store.length(file).is_some_and(|length| length > METADATA_LIMIT) {
                return Err(Fault::ArrayMetadata {
                    array: name.to_owned(),
                    file: file.to_owned(),
                    why: format!("it is larger than {} MiB", METADATA_LIMIT >> 20),
                });
            }
            store.read(file, stop)
        };
        let new = file("zarr.json");
        let from_new = match read(&new)? {
            Some(text) => Layout::of_format_3(&text).map_err(|error| error.of(name, &new))?,
            None => None,
        };
        let old = file(".zarray");
        let layout = match (from_new, read(&old)?) {
            (Some(layout), _) => layout,
            (None, Some(text)) => {
                let nested = || {
                    let is_chunk = |file: &&str| file.starts_with(|c: char| c.is_ascii_digit());
                    let chunks: Vec<&str> = store.names_below(name).filter(is_chunk).collect();
                    !chunks.is_empty() && chunks.iter().all(|file| file.contains('/') && !file.contains('.'))
                };
                Layout::of_format_2(&text, nested).map_err(|error| error.of(name, &old))?
            }
            (None, None) => return Ok(None),
        };
        let opened = Self {
            name: name.to_owned(),
            store: Arc::clone(store),
            shape: layout.shape.clone(),
            chunk: layout.chunk.clone(),
            layout,
        };
        let bytes = opened.chunk_bytes();
        if bytes.is_none_or(|bytes| bytes > CHUNK_LIMIT) {
            return Err(Fault::ChunkTooLarge {
                array: name.to_owned(),
                bytes: bytes.unwrap_or(u64::MAX),
                limit: CHUNK_LIMIT,
            });
        }
        Ok(Some(opened))
    }

    pub(crate) fn name(&self) -> &str {
        &self.name
    }

    pub(crate) fn store(&self) -> &Store {
        &self.store
    }

    pub(crate) fn shape(&self) -> &[u64] {
        &self.shape
    }

    /// Length of the first axis.
    pub(crate) fn len(&self) -> u64 {
        self.shape.first().copied().unwrap_or(0)
    }

    /// The element type, if `accept` returns true for it.
    pub(crate) fn element(&self, accept: impl Fn(Element) -> bool, expected: &'static str) -> Result<Element, Fault> {
        self.layout
            .element
            .filter(|&element| accept(element))
            .ok_or_else(|| Fault::WrongDtype {
                array: self.name.clone(),
                found: self.layout.dtype.clone(),
                expected,
            })
    }

    /// Whether the fast path for images can read the files: Blosc-compressed elements in C order and little-endian.
    pub(crate) fn is_little_endian_blosc(&self) -> bool {
        self.layout.shard.is_none() && self.layout.chain.plain() == Some(Compressor::Blosc)
    }

    /// Size of a decoded chunk; `None` if it overflows.
    pub(crate) fn chunk_bytes(&self) -> Option<u64> {
        let size = self.layout.element.map_or(1, Element::size) as u64;
        self.chunk
            .iter()
            .try_fold(size, |product, &length| product.checked_mul(length))
    }

    /// Length of the chunks along the first axis.
    pub(crate) fn chunk_length(&self) -> u64 {
        self.chunk.first().copied().unwrap_or(1)
    }

    /// Rows of the array in a row of chunks, which is the group of chunks that contain the same rows of the array.
    pub(crate) fn rows_of(&self, chunk_row: u64) -> Range<u64> {
        let start = chunk_row * self.chunk_length();
        start..self.len().min(start.saturating_add(self.chunk_length()))
    }

    /// Whether every chunk contains whole rows of the array.
    pub(crate) fn chunks_hold_whole_rows(&self) -> bool {
        self.chunk
            .iter()
            .zip(&self.shape)
            .skip(1)
            .all(|(chunk, length)| chunk == length)
    }

    /// Indices of all chunks in a row of chunks, in C order. It is lazy because broken metadata can declare any number of chunks.
    pub(crate) fn chunks_of(&self, chunk_row: u64) -> impl Iterator<Item = Vec<u64>> + Clone + '_ {
        let grid: Vec<u64> = self
            .shape
            .iter()
            .zip(&self.chunk)
            .skip(1)
            .map(|(length, chunk)| length.div_ceil(*chunk))
            .collect();
        let count = grid
            .iter()
            .fold(1u64, |product, &length| product.saturating_mul(length));
        (0..count).map(move |number| {
            let mut index = vec![chunk_row];
            index.extend(position(number, &grid));
            index
        })
    }

    /// Name of a chunk's file below the array's folder.
    pub(crate) fn chunk_name(&self, index: &[u64]) -> String {
        self.layout.keys.name(index)
    }

    fn chunk_file(&self, index: &[u64]) -> String {
        format!("{}/{}", self.name, self.chunk_name(index))
    }

    /// Rows of chunks that overlap the given runs of rows, ascending and without duplicates.
    pub(crate) fn chunk_rows_of(&self, runs: &[Range<u64>]) -> Vec<u64> {
        let mut rows: Vec<u64> = runs
            .iter()
            .filter(|run| !run.is_empty())
            .flat_map(|run| run.start / self.chunk_length()..=(run.end - 1) / self.chunk_length())
            .collect();
        rows.dedup();
        rows
    }

    /// Whether all chunks of a row of chunks have files.
    fn is_stored(&self, chunk_row: u64) -> bool {
        self.chunks_of(chunk_row)
            .all(|index| self.store.length(&self.chunk_file(&index)).is_some())
    }

    /// Of the rows of chunks that overlap the given runs of rows, those without a file. `None` if there are none, or if they are
    /// read as the fill value.
    pub(crate) fn missing(&self, runs: &[Range<u64>], absent: Absent) -> Option<Lost> {
        if absent == Absent::IsFill && self.fill().is_some() {
            return None;
        }
        let mut first = None;
        let mut chunks = 0;
        let mut rows: Vec<Range<u64>> = Vec::new();
        for chunk_row in self.chunk_rows_of(runs) {
            // Broken metadata can declare any number of chunks; the search ends after this many.
            let enough = chunks > MAX_MISSING;
            if !enough && self.is_stored(chunk_row) {
                continue;
            }
            let here = self.rows_of(chunk_row);
            match rows.last_mut().filter(|last| last.end == here.start) {
                Some(last) => last.end = here.end,
                None => rows.push(here),
            }
            if enough {
                continue;
            }
            let lacks = |index: &Vec<u64>| self.store.length(&self.chunk_file(index)).is_none();
            let looked_at = self.chunks_of(chunk_row).take(MAX_MISSING as usize);
            chunks += looked_at.filter(lacks).count() as u64;
            first = first.or_else(|| self.chunks_of(chunk_row).find(lacks));
        }
        Some(Lost {
            rows,
            fault: self.missing_chunk(&self.chunk_name(&first?), chunks, None),
        })
    }

    fn missing_chunk(&self, chunk: &str, count: u64, inside: Option<usize>) -> Fault {
        Fault::MissingChunk {
            array: self.name.clone(),
            chunk: chunk.to_owned(),
            more: count.saturating_sub(1),
            inside,
            fill: self.fill().map(|_| self.layout.fill.to_string()),
            fills_are_stored: false,
        }
    }

    /// The fill value as the bytes of one element; `None` if the metadata has none.
    fn fill(&self) -> Option<Vec<u8>> {
        self.layout.element?.bytes_of(&self.layout.fill)
    }

    /// The bytes of a chunk's file; `None` if the file does not exist.
    pub(crate) fn read_chunk(&self, index: &[u64], stop: Stop<'_>) -> Result<Option<Vec<u8>>, Fault> {
        let limit = CHUNK_LIMIT + FILE_SLACK;
        let file = self.chunk_file(index);
        if self.store.length(&file).is_some_and(|length| length > limit) {
            return Err(self.undecodable(index, format!("the file is larger than {} MiB", limit >> 20)));
        }
        self.store.read(&file, stop)
    }

    /// The fault of a chunk that cannot be decoded.
    pub(crate) fn undecodable(&self, index: &[u64], why: impl Into<String>) -> Fault {
        Fault::UndecodableChunk {
            array: self.name.clone(),
            chunk: self.chunk_name(index),
            why: why.into(),
        }
    }

    /// Decodes a chunk's file to elements in native byte order, including the padding of chunks at the edge. `None` is a
    /// chunk without a file. `count` is incremented for every chunk that is not stored and is read as fill values.
    pub(crate) fn decode_chunk(
        &self,
        index: &[u64],
        encoded: Option<Vec<u8>>,
        absent: Absent,
        count: &AtomicU64,
    ) -> Result<Vec<u8>, Fault> {
        let size = self.layout.element.map_or(1, Element::size);
        let filled = |inside: Option<usize>, elements: usize| {
            let fill = self.fill().filter(|_| absent == Absent::IsFill);
            count.fetch_add(1, Ordering::Relaxed);
            fill.map(|fill| fill.repeat(elements))
                .ok_or_else(|| self.missing_chunk(&self.chunk_name(index), 1, inside))
        };
        let elements = |shape: &[u64]| shape.iter().product::<u64>() as usize;
        let Some(encoded) = encoded else {
            return filled(None, elements(&self.chunk));
        };
        let undecodable = |why: String| self.undecodable(index, why);
        let Some(shard) = &self.layout.shard else {
            return self
                .layout
                .chain
                .decode(encoded, &self.chunk, size)
                .map_err(undecodable);
        };
        let places = shard.places(&encoded, &self.chunk).map_err(undecodable)?;
        let grid: Vec<u64> = self
            .chunk
            .iter()
            .zip(&shard.chunk)
            .map(|(outer, inner)| outer / inner)
            .collect();
        let mut whole = vec![0; elements(&self.chunk) * size];
        for (number, place) in places.into_iter().enumerate() {
            let at = position(number as u64, &grid);
            // Chunks of a shard past the end of the array are padding, and writers do not store them.
            let starts = at.iter().zip(&shard.chunk).map(|(i, length)| i * length);
            let is_padding = starts
                .zip(index.iter().zip(&self.chunk))
                .zip(&self.shape)
                .any(|((start, (i, outer)), length)| i * outer + start >= *length);
            if is_padding {
                continue;
            }
            let decoded = match place {
                Some((start, length)) => {
                    let part = encoded[start..start + length].to_vec();
                    self.layout
                        .chain
                        .decode(part, &shard.chunk, size)
                        .map_err(undecodable)?
                }
                None => filled(Some(number), elements(&shard.chunk))?,
            };
            scatter(&self.chunk, &shard.chunk, &at, &decoded, size, |run, to| {
                let to = to * size;
                whole[to..to + run.len()].copy_from_slice(run);
                Ok(())
            })?;
        }
        Ok(whole)
    }

    /// Copies the part of a decoded chunk that is inside the array to the row-major buffer of its row of chunks,
    /// run by run. `copy` receives the bytes of a run and the index of its first element in the buffer.
    pub(crate) fn scatter(
        &self,
        index: &[u64],
        decoded: &[u8],
        element_size: usize,
        copy: impl FnMut(&[u8], usize) -> Result<(), Fault>,
    ) -> Result<(), Fault> {
        let rows = self.rows_of(index.first().copied().unwrap_or(0));
        let mut shape = self.shape.clone();
        let mut at = index.to_vec();
        if let (Some(length), Some(first)) = (shape.first_mut(), at.first_mut()) {
            *length = rows.end - rows.start;
            *first = 0;
        }
        scatter(&shape, &self.chunk, &at, decoded, element_size, copy)
    }

    /// Reads runs of rows, which must be ascending and not overlap, in C order. `convert` converts the bytes of one element
    /// (native byte order) to a number.
    ///
    /// # Errors
    /// A file changed or cannot be read because of an operating system error, or `stop` returned true. Missing and broken chunks
    /// are part of the result, not errors.
    fn read<T: Copy + Default + Send>(
        &self,
        element: Element,
        runs: &[Range<u64>],
        absent: Absent,
        stop: Stop<'_>,
        convert: impl Fn(&[u8]) -> T + Sync,
    ) -> Result<Rows<T>, Fault> {
        let width: usize = self.shape[1..].iter().map(|&length| length as usize).product();
        let missing = self.missing(runs, absent);
        let is_missing = |chunk_row: u64| {
            let row = self.rows_of(chunk_row).start;
            missing.iter().any(|lost| {
                let next = lost.rows.partition_point(|rows| rows.end <= row);
                lost.rows.get(next).is_some_and(|rows| rows.contains(&row))
            })
        };
        let absent_chunks = AtomicU64::new(0);
        let fills_are_stored = AtomicBool::new(false);
        let fill = self.fill().filter(|_| absent == Absent::IsFill);
        let decode = |chunk_row: u64| -> Result<Vec<T>, Fault> {
            let rows = self.rows_of(chunk_row);
            let mut values = vec![T::default(); (rows.end - rows.start) as usize * width];
            for index in self.chunks_of(chunk_row) {
                let encoded = self.read_chunk(&index, stop)?;
                let stored = encoded.is_some();
                let decoded = self.decode_chunk(&index, encoded, absent, &absent_chunks)?;
                // Evidence that the writer stores chunks that contain only the fill value, so that absent chunks are lost data.
                if let Some(fill) = fill.as_deref().filter(|_| stored)
                    && decoded.chunks_exact(element.size()).all(|bytes| bytes == fill)
                {
                    fills_are_stored.store(true, Ordering::Relaxed);
                }
                self.scatter(&index, &decoded, element.size(), |run, at| {
                    for (value, bytes) in values[at..].iter_mut().zip(run.chunks_exact(element.size())) {
                        *value = convert(bytes);
                    }
                    Ok(())
                })?;
            }
            Ok(values)
        };
        let chunk_rows = self.chunk_rows_of(runs);
        let whole_runs = runs;
        let mut values = Vec::with_capacity(runs.iter().map(|run| (run.end - run.start) as usize * width).sum());
        let mut broken = Vec::new();
        let mut runs = runs.iter().filter(|run| !run.is_empty()).cloned().peekable();
        for batch in chunk_rows.chunks(BATCH) {
            // Collected in order, so that the reported faults do not depend on the number of threads.
            let decoded: Vec<Option<Result<Vec<T>, Fault>>> = batch
                .par_iter()
                .map(|&chunk_row| (!is_missing(chunk_row)).then(|| decode(chunk_row)))
                .collect();
            for (&chunk_row, decoded) in batch.iter().zip(decoded) {
                let here = self.rows_of(chunk_row);
                let decoded = match decoded.transpose() {
                    Ok(decoded) => decoded,
                    Err(fault @ (Fault::MissingChunk { .. } | Fault::UndecodableChunk { .. })) => {
                        broken.push(Lost::of(here.clone(), fault));
                        None
                    }
                    Err(fault) => return Err(fault),
                };
                while let Some(run) = runs.peek_mut().filter(|run| run.start < here.end) {
                    let end = run.end.min(here.end);
                    let place = |row: u64| (row - here.start) as usize * width;
                    match &decoded {
                        Some(decoded) => values.extend_from_slice(&decoded[place(run.start)..place(end)]),
                        None => values.resize(values.len() + (end - run.start) as usize * width, T::default()),
                    }
                    if end < run.end {
                        run.start = end;
                        break;
                    }
                    runs.next();
                }
            }
        }
        let mut lost: Vec<Lost> = missing.into_iter().collect();
        // Chunks that were read as fill values are lost after all: the writer stores such chunks.
        if fills_are_stored.into_inner()
            && let Some(mut missing) = self.missing(whole_runs, Absent::IsLost)
        {
            if let Fault::MissingChunk { fills_are_stored, .. } = &mut missing.fault {
                *fills_are_stored = true;
            }
            lost.push(missing);
        }
        lost.append(&mut broken);
        Ok(Rows {
            values,
            lost,
            absent: absent_chunks.into_inner(),
        })
    }

    /// Reads runs of rows as f64, which represents every f32, f64 and integer below 2^53 exactly.
    pub(crate) fn read_floats(
        &self,
        element: Element,
        runs: &[Range<u64>],
        absent: Absent,
        stop: Stop<'_>,
    ) -> Result<Rows<f64>, Fault> {
        self.read(element, runs, absent, stop, |bytes| element.float(bytes))
    }

    /// Reads the whole array as integers; `None` is a number that is not an integer.
    pub(crate) fn read_integers(&self, element: Element, stop: Stop<'_>) -> Result<Rows<Option<i128>>, Fault> {
        let all = 0..self.len();
        let whole = |bytes: &[u8]| element.integer(bytes);
        self.read(element, std::slice::from_ref(&all), Absent::IsLost, stop, whole)
    }
}

/// Multi-index of the cell with this number of a grid in C order.
fn position(number: u64, grid: &[u64]) -> Vec<u64> {
    let mut rest = number;
    let mut at: Vec<u64> = grid
        .iter()
        .rev()
        .map(|&length| {
            let i = rest % length;
            rest /= length;
            i
        })
        .collect();
    at.reverse();
    at
}

/// Copies the part of a chunk that is inside an array of `shape`, run by run. `at` is the chunk's index in the grid of chunks.
/// `copy` receives the bytes of a run and the index of its first element in the array.
fn scatter(
    shape: &[u64],
    chunk: &[u64],
    at: &[u64],
    decoded: &[u8],
    element_size: usize,
    mut copy: impl FnMut(&[u8], usize) -> Result<(), Fault>,
) -> Result<(), Fault> {
    let usize_of = |values: &[u64]| values.iter().map(|&value| value as usize).collect::<Vec<_>>();
    let (shape, chunk) = (usize_of(shape), usize_of(chunk));
    let start: Vec<usize> = at.iter().zip(&chunk).map(|(&i, &length)| i as usize * length).collect();
    let extent: Vec<usize> = start
        .iter()
        .zip(shape.iter().zip(&chunk))
        .map(|(&start, (&length, &chunk))| chunk.min(length.saturating_sub(start)))
        .collect();
    // The chunk spans all axes after `split` completely, so a run covers the extent along `split` and everything after it.
    let split = (0..shape.len())
        .rev()
        .find(|&axis| axis == 0 || chunk[axis] != shape[axis])
        .unwrap_or(0);
    let inner: usize = shape[split + 1..].iter().product();
    let run = extent[split] * inner;
    let outer = &extent[..split];
    for number in 0..outer.iter().product::<usize>() {
        let mut rest = number;
        let mut place = vec![0; split + 1];
        for axis in (0..split).rev() {
            place[axis] = rest % outer[axis];
            rest /= outer[axis];
        }
        let (mut from, mut to) = (0, 0);
        for axis in 0..=split {
            from = from * chunk[axis] + place[axis];
            to = to * shape[axis] + start[axis] + place[axis];
        }
        let (from, to) = (from * inner * element_size, to * inner);
        copy(&decoded[from..from + run * element_size], to)?;
    }
    Ok(())
}
