//! One array of a Zarr v2 store: metadata and codecs through zarrs, chunk files read here so that a missing or broken
//! one can be named.

use std::borrow::Cow;
use std::fs;
use std::io::{self, Read as _};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use rayon::prelude::*;

use zarrs::array::{Array, ArrayMetadata, ArrayMetadataV2, ArrayToBytesCodecTraits, ChunkShapeTraits, CodecOptions};
use zarrs::metadata::v2::{ArrayMetadataV2Order, DataTypeMetadataV2};
use zarrs::storage::store::MemoryStore;

use crate::compression::Compressor;
use crate::error::Fault;

/// Largest decoded chunk, and largest row of chunks converted to bytes: 128 MiB. It bounds the memory of every reader.
pub(crate) const CHUNK_LIMIT: u64 = 128 << 20;

/// How much larger than the chunk its file may be: compressors write a little more where there is nothing to be gained.
const FILE_SLACK: u64 = 1 << 20;

/// Element types that are read.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Element {
    F32,
    F64,
    U8,
    U16,
    U32,
    U64,
    I8,
    I16,
    I32,
    I64,
}

impl Element {
    fn from_dtype(dtype: &str) -> Option<Self> {
        Some(match dtype.trim_start_matches(['<', '>', '|']) {
            "f4" => Self::F32,
            "f8" => Self::F64,
            "u1" => Self::U8,
            "u2" => Self::U16,
            "u4" => Self::U32,
            "u8" => Self::U64,
            "i1" => Self::I8,
            "i2" => Self::I16,
            "i4" => Self::I32,
            "i8" => Self::I64,
            _ => return None,
        })
    }

    pub(crate) fn size(self) -> usize {
        match self {
            Self::U8 | Self::I8 => 1,
            Self::U16 | Self::I16 => 2,
            Self::F32 | Self::U32 | Self::I32 => 4,
            Self::F64 | Self::U64 | Self::I64 => 8,
        }
    }

    pub(crate) fn is_float(self) -> bool {
        matches!(self, Self::F32 | Self::F64)
    }
}

/// An opened array. Nothing but its metadata has been read.
pub(crate) struct ZarrArray {
    name: String,
    folder: PathBuf,
    array: Array<MemoryStore>,
    dtype: String,
    element: Option<Element>,
    shape: Vec<u64>,
    chunk: Vec<u64>,
    blosc: bool,
    /// Undone here, before the library sees a chunk.
    compressor: Option<Compressor>,
}

impl ZarrArray {
    /// Opens `name` (such as `data/state`) below the folder of a store; `None` if it has no `.zarray`.
    pub(crate) fn open(store: &Path, name: &str) -> Result<Option<Self>, Fault> {
        let folder = store.join(name);
        let metadata_path = folder.join(".zarray");
        let text = match fs::read(&metadata_path) {
            Ok(text) => text,
            Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(None),
            Err(error) => return Err(Fault::io("read", metadata_path, error)),
        };
        let metadata_fault = |why: String| Fault::ArrayMetadata {
            array: name.to_owned(),
            why,
        };
        let encoding_fault = |why: String| Fault::Encoding {
            array: name.to_owned(),
            why,
        };
        let mut metadata: ArrayMetadataV2 =
            serde_json::from_slice(&text).map_err(|error| metadata_fault(error.to_string()))?;
        if metadata.order != ArrayMetadataV2Order::C {
            return Err(encoding_fault("its order is F".to_owned()));
        }
        if let Some(filter) = metadata.filters.as_ref().and_then(|filters| filters.first()) {
            return Err(encoding_fault(format!("it has the filter {}", filter.id())));
        }
        if metadata.shape.is_empty() {
            return Err(metadata_fault("it has no dimensions".to_owned()));
        }
        if metadata.chunks.len() != metadata.shape.len() {
            return Err(metadata_fault(format!(
                "{} chunk lengths for {} dimensions",
                metadata.chunks.len(),
                metadata.shape.len()
            )));
        }
        let dtype = match &metadata.dtype {
            DataTypeMetadataV2::Simple(dtype) => dtype.clone(),
            structured @ DataTypeMetadataV2::Structured(_) => structured.to_string(),
        };
        let element = Element::from_dtype(&dtype);
        let shape = metadata.shape.clone();
        let chunk: Vec<u64> = metadata.chunks.iter().map(|length| length.get()).collect();
        let blosc = metadata
            .compressor
            .as_ref()
            .is_some_and(|compressor| compressor.id() == "blosc");
        let understood = |metadata: &ArrayMetadataV2| {
            Array::new_with_metadata(
                Arc::new(MemoryStore::new()),
                &format!("/{name}"),
                ArrayMetadata::V2(metadata.clone()),
            )
        };
        let compressor = metadata.compressor.as_ref().and_then(|c| Compressor::of(c.id()));
        let mut array = understood(&metadata);
        if array.is_ok() && compressor.is_some() {
            metadata.compressor = None;
            array = understood(&metadata);
        }
        let array = array.map_err(|error| {
            // A type unknown to the library is reported as the wrong type by whoever asks for a type.
            if element.is_none() {
                Fault::WrongDtype {
                    array: name.to_owned(),
                    found: dtype.clone(),
                    expected: "a number type",
                }
            } else {
                encoding_fault(error.to_string())
            }
        })?;
        let opened = Self {
            name: name.to_owned(),
            folder,
            array,
            dtype,
            element,
            shape,
            chunk,
            blosc,
            compressor,
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

    /// Opens an array that must be there.
    pub(crate) fn open_required(store: &Path, name: &str) -> Result<Self, Fault> {
        Self::open(store, name)?.ok_or_else(|| Fault::MissingArray { array: name.to_owned() })
    }

    pub(crate) fn name(&self) -> &str {
        &self.name
    }

    pub(crate) fn shape(&self) -> &[u64] {
        &self.shape
    }

    /// Length of the first axis.
    pub(crate) fn len(&self) -> u64 {
        self.shape.first().copied().unwrap_or(0)
    }

    /// The element type, if it is one that `accept` takes.
    pub(crate) fn element(&self, accept: impl Fn(Element) -> bool, expected: &'static str) -> Result<Element, Fault> {
        self.element
            .filter(|&element| accept(element))
            .ok_or_else(|| Fault::WrongDtype {
                array: self.name.clone(),
                found: self.dtype.clone(),
                expected,
            })
    }

    /// Whether elements lie in the byte order that the fast path of pictures understands.
    pub(crate) fn is_little_endian_blosc(&self) -> bool {
        self.blosc && self.dtype.starts_with('<')
    }

    /// Size of a decoded chunk; `None` if it overflows.
    pub(crate) fn chunk_bytes(&self) -> Option<u64> {
        let size = self.element.map_or(1, Element::size) as u64;
        self.chunk
            .iter()
            .try_fold(size, |product, &length| product.checked_mul(length))
    }

    /// Length of the chunks along the first axis.
    pub(crate) fn chunk_length(&self) -> u64 {
        self.chunk.first().copied().unwrap_or(1)
    }

    /// Number of rows of chunks: groups of chunks that hold the same rows of the array.
    pub(crate) fn chunk_rows(&self) -> u64 {
        self.len().div_ceil(self.chunk_length())
    }

    /// Rows of the array in a row of chunks.
    pub(crate) fn rows_of(&self, chunk_row: u64) -> std::ops::Range<u64> {
        let start = chunk_row * self.chunk_length();
        start..self.len().min(start.saturating_add(self.chunk_length()))
    }

    /// Whether one chunk holds whole rows of the array.
    pub(crate) fn chunks_hold_whole_rows(&self) -> bool {
        self.chunk
            .iter()
            .zip(&self.shape)
            .skip(1)
            .all(|(chunk, length)| chunk == length)
    }

    /// Indices of all chunks in a row of chunks, in C order. Lazy: broken metadata can ask for any number of them.
    pub(crate) fn chunks_of(&self, chunk_row: u64) -> impl Iterator<Item = Vec<u64>> + '_ {
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
            let mut rest = number;
            let mut index: Vec<u64> = grid
                .iter()
                .rev()
                .map(|&length| {
                    let i = rest % length;
                    rest /= length;
                    i
                })
                .collect();
            index.push(chunk_row);
            index.reverse();
            index
        })
    }

    /// Name of a chunk's file below the array's folder.
    pub(crate) fn chunk_name(&self, index: &[u64]) -> String {
        let key = self.array.chunk_key(index).as_str().to_owned();
        key.strip_prefix(&format!("{}/", self.name))
            .map_or(key.clone(), ToOwned::to_owned)
    }

    /// Refuses a chunk that has no file.
    pub(crate) fn check_chunk_exists(&self, index: &[u64]) -> Result<(), Fault> {
        let chunk = self.chunk_name(index);
        if self.folder.join(&chunk).is_file() {
            Ok(())
        } else {
            Err(Fault::MissingChunk {
                array: self.name.clone(),
                chunk,
            })
        }
    }

    /// The bytes of a chunk's file.
    pub(crate) fn read_chunk(&self, index: &[u64]) -> Result<Vec<u8>, Fault> {
        let chunk = self.chunk_name(index);
        let path = self.folder.join(&chunk);
        let refused = |error: io::Error| match error.kind() {
            // By the Zarr specification an absent chunk reads as the fill value; in a recording it is lost data.
            io::ErrorKind::NotFound => Fault::MissingChunk {
                array: self.name.clone(),
                chunk: chunk.clone(),
            },
            _ => Fault::io("read", &path, error),
        };
        let mut bytes = Vec::new();
        let limit = CHUNK_LIMIT + FILE_SLACK;
        fs::File::open(&path)
            .and_then(|file| file.take(limit + 1).read_to_end(&mut bytes))
            .map_err(refused)?;
        if bytes.len() as u64 > limit {
            return Err(self.undecodable(index, format!("the file has more than {} MiB", limit >> 20)));
        }
        Ok(bytes)
    }

    /// Names a chunk that cannot be decoded.
    pub(crate) fn undecodable(&self, index: &[u64], why: impl Into<String>) -> Fault {
        Fault::UndecodableChunk {
            array: self.name.clone(),
            chunk: self.chunk_name(index),
            why: why.into(),
        }
    }

    /// Decodes a chunk to elements in the machine's byte order; padding of chunks at the edge is included.
    pub(crate) fn decode_chunk(&self, index: &[u64], encoded: Vec<u8>) -> Result<Vec<u8>, Fault> {
        let expected = self.chunk_bytes().unwrap_or(0) as usize;
        if self.blosc {
            check_blosc_header(&encoded, expected).map_err(|why| self.undecodable(index, why))?;
        }
        let encoded = match self.compressor {
            Some(compressor) => compressor
                .decode(&encoded, expected)
                .map_err(|why| self.undecodable(index, why))?,
            None => encoded,
        };
        let shape = self
            .array
            .chunk_shape(index)
            .map_err(|error| self.undecodable(index, error.to_string()))?;
        debug_assert_eq!(shape.num_elements_u64(), self.chunk.iter().product::<u64>());
        let bytes = self
            .array
            .codecs()
            .decode(
                Cow::Owned(encoded),
                &shape,
                self.array.data_type(),
                self.array.fill_value(),
                &CodecOptions::default(),
            )
            .and_then(|bytes| bytes.into_fixed().map_err(Into::into))
            .map_err(|error| self.undecodable(index, error.to_string()))?
            .into_owned();
        if bytes.len() != expected {
            return Err(self.undecodable(index, format!("{} bytes decoded instead of {expected}", bytes.len())));
        }
        Ok(bytes)
    }

    /// Copies the part of a decoded chunk that lies in the array into the row-major buffer of its row of chunks,
    /// run by run. `copy` gets the bytes of a run and the place of its first element in the buffer.
    pub(crate) fn scatter(
        &self,
        index: &[u64],
        decoded: &[u8],
        element_size: usize,
        mut copy: impl FnMut(&[u8], usize) -> Result<(), Fault>,
    ) -> Result<(), Fault> {
        let usize_of = |values: &[u64]| values.iter().map(|&value| value as usize).collect::<Vec<_>>();
        let (shape, chunk) = (usize_of(&self.shape), usize_of(&self.chunk));
        let start: Vec<usize> = index
            .iter()
            .zip(&chunk)
            .enumerate()
            .map(|(d, (&i, &c))| if d == 0 { 0 } else { i as usize * c })
            .collect();
        let extent: Vec<usize> = index
            .iter()
            .zip(shape.iter().zip(&chunk))
            .map(|(&i, (&length, &c))| c.min(length.saturating_sub(i as usize * c)))
            .collect();
        // Axes after `split` are whole in the chunk, so a run covers the extent along `split` and everything after it.
        let split = (0..shape.len())
            .rev()
            .find(|&d| d == 0 || chunk[d] != shape[d])
            .unwrap_or(0);
        let inner: usize = shape[split + 1..].iter().product();
        let run = extent[split] * inner;
        let outer = &extent[..split];
        for number in 0..outer.iter().product::<usize>() {
            let mut rest = number;
            let mut position = vec![0; split + 1];
            for d in (0..split).rev() {
                position[d] = rest % outer[d];
                rest /= outer[d];
            }
            let (mut from, mut to) = (0, 0);
            for d in 0..=split {
                from = from * chunk[d] + position[d];
                to = to * shape[d] + start[d] + position[d];
            }
            let (from, to) = (from * inner * element_size, to * inner);
            copy(&decoded[from..from + run * element_size], to)?;
        }
        Ok(())
    }

    /// Reads the whole array as rows in C order; `convert` turns one element's bytes (machine order) into a number.
    fn read<T: Copy + Default + Send>(
        &self,
        element: Element,
        convert: impl Fn(&[u8]) -> T + Sync,
    ) -> Result<Vec<T>, Fault> {
        // Chunks are looked for before memory is reserved: a shape in broken metadata can be any number.
        for chunk_row in 0..self.chunk_rows() {
            for index in self.chunks_of(chunk_row) {
                self.check_chunk_exists(&index)?;
            }
        }
        let width: usize = self.shape[1..].iter().map(|&length| length as usize).product();
        let rows: Vec<Vec<T>> = (0..self.chunk_rows())
            .into_par_iter()
            .map(|chunk_row| {
                let rows = self.rows_of(chunk_row);
                let mut values = vec![T::default(); (rows.end - rows.start) as usize * width];
                for index in self.chunks_of(chunk_row) {
                    let decoded = self.decode_chunk(&index, self.read_chunk(&index)?)?;
                    self.scatter(&index, &decoded, element.size(), |run, at| {
                        for (value, bytes) in values[at..].iter_mut().zip(run.chunks_exact(element.size())) {
                            *value = convert(bytes);
                        }
                        Ok(())
                    })?;
                }
                Ok(values)
            })
            // In order, so that the first of several errors is told for any number of threads.
            .collect::<Vec<_>>()
            .into_iter()
            .collect::<Result<_, Fault>>()?;
        Ok(rows.concat())
    }

    /// The whole array as f64, which holds every f32, f64 and integer below 2^53 exactly.
    pub(crate) fn read_floats(&self, element: Element) -> Result<Vec<f64>, Fault> {
        self.read(element, |bytes| match element {
            Element::F32 => f32::from_ne_bytes(array(bytes)).into(),
            Element::F64 => f64::from_ne_bytes(array(bytes)),
            _ => integer(element, bytes) as f64,
        })
    }

    /// The whole array as integers; `element` is an integer type.
    pub(crate) fn read_integers(&self, element: Element) -> Result<Vec<i128>, Fault> {
        self.read(element, |bytes| integer(element, bytes))
    }
}

/// One element as an integer.
fn integer(element: Element, bytes: &[u8]) -> i128 {
    match element {
        Element::U8 => u8::from_ne_bytes(array(bytes)).into(),
        Element::U16 => u16::from_ne_bytes(array(bytes)).into(),
        Element::U32 => u32::from_ne_bytes(array(bytes)).into(),
        Element::U64 => u64::from_ne_bytes(array(bytes)).into(),
        Element::I8 => i8::from_ne_bytes(array(bytes)).into(),
        Element::I16 => i16::from_ne_bytes(array(bytes)).into(),
        Element::I32 => i32::from_ne_bytes(array(bytes)).into(),
        Element::I64 => i64::from_ne_bytes(array(bytes)).into(),
        Element::F32 => f32::from_ne_bytes(array(bytes)) as i128,
        Element::F64 => f64::from_ne_bytes(array(bytes)) as i128,
    }
}

/// The bytes of one element; a slice of the wrong length, which `chunks_exact` never gives, would read as zero.
fn array<const N: usize>(bytes: &[u8]) -> [u8; N] {
    bytes.try_into().unwrap_or([0; N])
}

/// Refuses a Blosc buffer whose own sizes disagree with the file or the chunk, before anything is allocated for it.
fn check_blosc_header(encoded: &[u8], expected: usize) -> Result<(), String> {
    let field = |at: usize| {
        encoded
            .get(at..at + 4)
            .map(|bytes| u32::from_le_bytes(array(bytes)) as usize)
    };
    match (field(4), field(12)) {
        (Some(_), Some(length)) if length != encoded.len() => Err(format!(
            "the file has {} bytes and its header says {length}",
            encoded.len()
        )),
        (Some(decoded), Some(_)) if decoded != expected => {
            Err(format!("it decodes to {decoded} bytes instead of {expected}"))
        }
        (Some(_), Some(_)) => Ok(()),
        _ => Err(format!(
            "the file has {} bytes, too few for a Blosc header",
            encoded.len()
        )),
    }
}
