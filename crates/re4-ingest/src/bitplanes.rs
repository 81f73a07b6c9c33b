//! Fast decoder of images that are stored as bit-shuffled floats.
//!
//! The Push-T dataset stores the integers 0 to 255 as f32, bit-shuffled and compressed by Blosc with zstd. Undoing these steps
//! one by one moves each image through memory four times at four bytes per value. Here each Blosc block is decompressed to a
//! small buffer, and its bit planes are converted to bytes by boolean operations on 64 values at a time, without intermediate
//! floats. For anything unusual the function returns `None`, and the caller uses the general path, which also reports what is
//! wrong: this path never rejects a file.
//!
//! Format: c-blosc 1.21, `README_CHUNK_FORMAT.rst` (header, block starts, splits) and `blosc/bitshuffle-generic.c` (bit
//! `b` of element `8 j + k` of a block of `n` elements is bit `k` of byte `b n / 8 + j`).

use std::ops::{BitAnd, BitOr, Not, Range};

const HEADER: usize = 16;
const FORMAT_VERSION: u8 = 2;
const FLAG_COPIED: u8 = 0x02;
const FLAG_BITSHUFFLE: u8 = 0x04;
const FLAG_BYTESHUFFLE: u8 = 0x01;
const FLAG_UNSPLIT: u8 = 0x10;
const CODEC_SHIFT: u8 = 5;
const CODEC_ZSTD: u8 = 4;
/// Bytes of an f32.
const TYPE_SIZE: usize = 4;
/// Lowest bit plane that an integer below 256 can use: its top seven fraction bits are bits 16 to 22.
const FRACTION: usize = 16;
const SIGN: usize = 31;
/// Maximum size of a block; c-blosc makes blocks of at most a few MiB.
const LARGEST_BLOCK: usize = 16 << 20;
/// Words of 64 values handled at once, so that the compiler can use vector registers.
const LANES: usize = 4;
/// Values processed at once.
const GROUP: usize = LANES * 64;

/// Buffers of one thread, reused between chunks.
#[derive(Default)]
pub(crate) struct Scratch {
    zstd: zstd::bulk::Decompressor<'static>,
    block: Vec<u8>,
}

/// Decodes the first `out.len()` values of a Blosc buffer that contains `values` f32. Returns `None` if the buffer is not in the
/// expected format, or some value is not an integer from 0 to 255.
pub(crate) fn decode(encoded: &[u8], values: usize, out: &mut [u8], scratch: &mut Scratch) -> Option<()> {
    let field = |at: usize| {
        let bytes = encoded.get(at..at.checked_add(4)?)?;
        Some(u32::from_le_bytes(bytes.try_into().ok()?) as usize)
    };
    let header = encoded.get(..HEADER)?;
    let flags = header[2];
    let wanted = FLAG_BITSHUFFLE | FLAG_UNSPLIT | (CODEC_ZSTD << CODEC_SHIFT);
    let relevant = FLAG_BYTESHUFFLE | FLAG_COPIED | FLAG_BITSHUFFLE | FLAG_UNSPLIT | (0b111 << CODEC_SHIFT);
    if header[0] != FORMAT_VERSION || flags & relevant != wanted || usize::from(header[3]) != TYPE_SIZE {
        return None;
    }
    let (decoded_bytes, block_bytes, encoded_bytes) = (field(4)?, field(8)?, field(12)?);
    if decoded_bytes != values.checked_mul(TYPE_SIZE)? || encoded_bytes != encoded.len() || out.len() > values {
        return None;
    }
    if !(1..=LARGEST_BLOCK).contains(&block_bytes) {
        return None;
    }
    let mut written = 0;
    for number in 0..decoded_bytes.div_ceil(block_bytes) {
        if written == out.len() {
            break;
        }
        let bytes = block_bytes.min(decoded_bytes - number * block_bytes);
        // c-blosc does not shuffle a block if its elements do not fill whole bytes of the planes.
        if bytes % (8 * TYPE_SIZE) != 0 {
            return None;
        }
        let start = field(HEADER + number * 4)?;
        let length = field(start)?;
        let source = encoded.get(start + 4..(start + 4).checked_add(length)?)?;
        scratch.block.resize(bytes, 0);
        // c-blosc stores a block uncompressed if compression does not shrink it.
        let block = if length == bytes {
            source
        } else {
            let decompressed = scratch
                .zstd
                .decompress_to_buffer(source, scratch.block.as_mut_slice())
                .ok()?;
            if decompressed != bytes {
                return None;
            }
            scratch.block.as_slice()
        };
        let here = Range {
            start: written,
            end: out.len().min(written + bytes / TYPE_SIZE),
        };
        written = here.end;
        planes_to_bytes(block, out.get_mut(here)?)?;
    }
    (written == out.len()).then_some(())
}

/// Converts the 32 bit planes of a block to bytes; `out` may be shorter than the block.
fn planes_to_bytes(block: &[u8], out: &mut [u8]) -> Option<()> {
    let stride = block.len() / (8 * TYPE_SIZE);
    let planes: Vec<&[u8]> = block.chunks_exact(stride).collect();
    let always_empty = planes.get(..FRACTION)?.iter().chain(planes.get(SIGN));
    if planes.len() != 8 * TYPE_SIZE || !always_empty.copied().all(is_empty) {
        return None;
    }
    let planes: &[&[u8]; SIGN - FRACTION] = planes[FRACTION..SIGN].try_into().ok()?;
    let mut faulty = Word::ZERO;
    let (groups, rest) = out.as_chunks_mut::<GROUP>();
    for (number, group) in groups.iter_mut().enumerate() {
        let mut words = [Word::ZERO; SIGN - FRACTION];
        for (word, plane) in words.iter_mut().zip(planes) {
            *word = Word::from_bytes(&plane.as_chunks::<{ GROUP / 8 }>().0[number]);
        }
        let (bits, bad) = value_bits(&words);
        faulty = faulty | bad;
        interleave(bits, group);
    }
    if !rest.is_empty() {
        let mut words = [Word::ZERO; SIGN - FRACTION];
        for (word, plane) in words.iter_mut().zip(planes) {
            let mut bytes = [0; GROUP / 8];
            for (byte, from) in bytes.iter_mut().zip(&plane[groups.len() * (GROUP / 8)..]) {
                *byte = *from;
            }
            *word = Word::from_bytes(&bytes);
        }
        let (bits, bad) = value_bits(&words);
        faulty = faulty | bad;
        let mut group = [0; GROUP];
        interleave(bits, &mut group);
        rest.copy_from_slice(&group[..rest.len()]);
    }
    (faulty == Word::ZERO).then_some(())
}

fn is_empty(plane: &[u8]) -> bool {
    plane.iter().fold(0, |any, byte| any | byte) == 0
}

/// One bit of 256 values.
#[derive(Clone, Copy, PartialEq, Eq)]
struct Word([u64; LANES]);

impl Word {
    const ZERO: Self = Self([0; LANES]);

    #[inline]
    fn from_bytes(bytes: &[u8; GROUP / 8]) -> Self {
        let mut words = [0; LANES];
        for (word, bytes) in words.iter_mut().zip(bytes.as_chunks::<8>().0) {
            *word = u64::from_le_bytes(*bytes);
        }
        Self(words)
    }

    #[inline]
    fn zip(self, other: Self, operation: impl Fn(u64, u64) -> u64) -> Self {
        let mut words = self.0;
        for (word, other) in words.iter_mut().zip(other.0) {
            *word = operation(*word, other);
        }
        Self(words)
    }

    /// Swaps the bits of `low` under `mask << shift` with those of `high` under `mask`.
    #[inline]
    fn swap(low: &mut Self, high: &mut Self, shift: u32, mask: u64) {
        for (low, high) in low.0.iter_mut().zip(&mut high.0) {
            let swap = ((*low >> shift) ^ *high) & mask;
            *high ^= swap;
            *low ^= swap << shift;
        }
    }

    /// Swaps the bits under `mask << shift` with those under `mask`.
    #[inline]
    fn swap_within(&mut self, shift: u32, mask: u64) {
        for word in &mut self.0 {
            let swap = (*word ^ (*word >> shift)) & mask;
            *word ^= swap ^ (swap << shift);
        }
    }
}

impl BitAnd for Word {
    type Output = Self;

    #[inline]
    fn bitand(self, other: Self) -> Self {
        self.zip(other, |a, b| a & b)
    }
}

impl BitOr for Word {
    type Output = Self;

    #[inline]
    fn bitor(self, other: Self) -> Self {
        self.zip(other, |a, b| a | b)
    }
}

impl Not for Word {
    type Output = Self;

    #[inline]
    fn not(self) -> Self {
        self.zip(self, |a, _| !a)
    }
}

/// Returns the eight bits of each value, lowest first, and a mask of the values that are not integers from 0 to 255.
///
/// A float `2^e (1 + f)` with `0 <= e <= 7` has its bit `e` set, its bits below `e` are the first `e` fraction bits, and
/// it is an integer if the other fraction bits are zero. `planes` contains seven fraction bits and the eight bits of `e + 127`,
/// lowest first.
#[inline]
fn value_bits(planes: &[Word; SIGN - FRACTION]) -> ([Word; 8], Word) {
    let [f7, f6, f5, f4, f3, f2, f1, e0, e1, e2, e3, e4, e5, e6, e7] = *planes;
    // Fraction bit i, counted from the highest, has the weight 2^(e - 1 - i).
    let fraction = [f1, f2, f3, f4, f5, f6, f7];
    // e + 127 is 0111_1111 for e = 0 and 1000_0000 + (e - 1) above.
    let above = e7 & !(e3 | e4 | e5 | e6);
    let (n0, n1, n2) = (!e0, !e1, !e2);
    let low = [n1 & n0, n1 & e0, e1 & n0, e1 & e0];
    let (small, large) = (above & n2, above & e2);
    let exponent = [
        !e7 & e6 & e5 & e4 & e3 & e2 & low[3],
        small & low[0],
        small & low[1],
        small & low[2],
        small & low[3],
        large & low[0],
        large & low[1],
        large & low[2],
    ];
    let mut bits = exponent;
    for e in 1..8 {
        for i in 0..e {
            bits[e - 1 - i] = bits[e - 1 - i] | (exponent[e] & fraction[i]);
        }
    }
    let mut fractional = Word::ZERO;
    let mut below = Word::ZERO;
    for e in (0..7).rev() {
        below = below | fraction[e];
        fractional = fractional | (exponent[e] & below);
    }
    let known = exponent.into_iter().fold(Word::ZERO, |any, word| any | word);
    let any = [e0, e1, e2, e3, e4, e5, e6, e7]
        .into_iter()
        .fold(below, |any, word| any | word);
    (bits, fractional | (any & !known))
}

/// Transposes eight bit planes to 256 bytes: byte `i` has bit `b` from bit `i` of `planes[b]`.
///
/// In each lane the planes are an 8 x 8 matrix of bytes, which is transposed by swapping its blocks of 4, 2 and 1. Then each word
/// is an 8 x 8 matrix of bits, which is transposed the same way (Hacker's Delight, section 7-3).
#[inline]
fn interleave(mut planes: [Word; 8], out: &mut [u8; GROUP]) {
    for (distance, mask) in [
        (4, 0x0000_0000_FFFF_FFFF),
        (2, 0x0000_FFFF_0000_FFFF),
        (1, 0x00FF_00FF_00FF_00FF),
    ] {
        for pair in planes.chunks_exact_mut(2 * distance) {
            let (low, high) = pair.split_at_mut(distance);
            for (low, high) in low.iter_mut().zip(high) {
                Word::swap(low, high, 8 * distance as u32, mask);
            }
        }
    }
    for word in &mut planes {
        word.swap_within(7, 0x00AA_00AA_00AA_00AA);
        word.swap_within(14, 0x0000_CCCC_0000_CCCC);
        word.swap_within(28, 0x0000_0000_F0F0_F0F0);
    }
    for (lane, bytes) in out.as_chunks_mut::<64>().0.iter_mut().enumerate() {
        for (bytes, word) in bytes.as_chunks_mut::<8>().0.iter_mut().zip(&planes) {
            *bytes = word.0[lane].to_le_bytes();
        }
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use proptest::prelude::*;
    use zarrs::array::{Array, ArrayBytes, ArrayMetadata, ArrayToBytesCodecTraits, CodecOptions};
    use zarrs::storage::store::MemoryStore;

    use super::*;

    /// Floats as the original dataset stores them.
    fn encode(values: &[f32], cname: &str, shuffle: u8, blocksize: usize) -> Vec<u8> {
        let metadata = serde_json::json!({
            "zarr_format": 2, "shape": [values.len()], "chunks": [values.len()], "dtype": "<f4", "fill_value": 0.0,
            "filters": null, "order": "C",
            "compressor": { "id": "blosc", "cname": cname, "clevel": 5, "shuffle": shuffle, "blocksize": blocksize },
        });
        let metadata = ArrayMetadata::V2(serde_json::from_value(metadata).unwrap());
        let array = Array::new_with_metadata(Arc::new(MemoryStore::new()), "/a", metadata).unwrap();
        let bytes: Vec<u8> = values.iter().flat_map(|value| value.to_ne_bytes()).collect();
        let shape = array.chunk_shape(&[0]).unwrap();
        let options = CodecOptions::default();
        let encoded = array.codecs().encode(
            ArrayBytes::new_flen(bytes),
            &shape,
            array.data_type(),
            array.fill_value(),
            &options,
        );
        encoded.unwrap().into_owned()
    }

    fn decoded(encoded: &[u8], values: usize, wanted: usize) -> Option<Vec<u8>> {
        let mut out = vec![0xA5; wanted];
        decode(encoded, values, &mut out, &mut Scratch::default()).map(|()| out)
    }

    /// Values with runs, so that they are compressible and blosc does not store them uncompressed.
    fn bytes() -> impl Strategy<Value = Vec<u8>> {
        prop::collection::vec((any::<u8>(), 1..60usize), 8..200).prop_map(|runs| {
            let mut bytes: Vec<u8> = runs.iter().flat_map(|&(byte, count)| vec![byte; count]).collect();
            bytes.truncate(bytes.len() / 8 * 8);
            bytes
        })
    }

    #[test]
    fn every_byte_value_survives() {
        let bytes: Vec<u8> = (0..=255).flat_map(|byte| [byte; 8]).collect();
        let floats: Vec<f32> = bytes.iter().copied().map(f32::from).collect();
        assert_eq!(
            decoded(&encode(&floats, "zstd", 2, 0), floats.len(), floats.len()),
            Some(bytes)
        );
    }

    #[test]
    fn the_original_dataset_uses_this_path() {
        let path = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/fixtures/original/data/img/0.0.0.0");
        let values = 7 * 8 * 8 * 3;
        let bytes = decoded(&std::fs::read(path).unwrap(), values, values).unwrap();
        let formula = |i: usize| (7 * (i / 192) + 31 * (i / 24 % 8) + 5 * (i / 3 % 8) + 11 * (i % 3)) % 256;
        assert!(
            bytes
                .iter()
                .enumerate()
                .all(|(i, &byte)| usize::from(byte) == formula(i))
        );
    }

    #[test]
    fn other_encodings_are_left_to_the_general_path() {
        let floats = vec![7.0; 4096];
        for (cname, shuffle) in [("zstd", 0), ("zstd", 1), ("lz4", 2), ("blosclz", 2), ("zlib", 2)] {
            assert_eq!(
                decoded(&encode(&floats, cname, shuffle, 0), 4096, 4096),
                None,
                "{cname} {shuffle}"
            );
        }
        let encoded = encode(&floats, "zstd", 2, 0);
        assert!(decoded(&encoded, 4096, 4096).is_some());
        assert_eq!(decoded(&encoded, 4095, 4095), None);
        assert_eq!(decoded(&encoded, 4096, 4097), None);
        // An element count that does not fill whole bytes of the planes is stored without shuffling.
        assert_eq!(decoded(&encode(&vec![7.0; 4095], "zstd", 2, 0), 4095, 4095), None);
    }

    proptest! {
        #[test]
        fn integers_are_decoded_exactly(bytes in bytes(), blocksize in prop::sample::select(vec![0, 128, 512, 4096]), part in 0.0..1.0f64) {
            let floats: Vec<f32> = bytes.iter().copied().map(f32::from).collect();
            let encoded = encode(&floats, "zstd", 2, blocksize);
            let wanted = (part * bytes.len() as f64) as usize;
            // Blosc stores incompressible data without compression, which the general path reads.
            prop_assume!(encoded[2] & FLAG_COPIED == 0);
            if let Some(out) = decoded(&encoded, bytes.len(), bytes.len()) {
                prop_assert_eq!(&out, &bytes);
                prop_assert_eq!(decoded(&encoded, bytes.len(), wanted).unwrap(), &bytes[..wanted]);
            } else {
                // A last block whose elements do not fill whole bytes of the planes.
                prop_assert!(bytes.len() % 8 != 0 || blocksize != 0);
            }
        }

        #[test]
        fn other_values_are_rejected(
            bytes in bytes(),
            at in any::<prop::sample::Index>(),
            odd in prop_oneof![
                (0.0..256.0f32).prop_filter("whole", |value| value.fract() != 0.0),
                256.0..1e6f32,
                -300.0..-0.001f32,
                prop::sample::select(vec![f32::NAN, f32::INFINITY, f32::NEG_INFINITY, f32::MIN_POSITIVE, 1e-45, 256.0, 0.5, -1.0]),
            ],
        ) {
            let mut floats: Vec<f32> = bytes.iter().copied().map(f32::from).collect();
            let place = at.index(floats.len());
            floats[place] = odd;
            prop_assert_eq!(decoded(&encode(&floats, "zstd", 2, 0), floats.len(), floats.len()), None);
        }

        #[test]
        fn damage_never_panics(bytes in bytes(), at in 0..64usize, byte in any::<u8>(), cut in any::<prop::sample::Index>()) {
            let floats: Vec<f32> = bytes.iter().copied().map(f32::from).collect();
            let mut encoded = encode(&floats, "zstd", 2, 128);
            if let Some(place) = encoded.get_mut(at) {
                *place = byte;
            }
            let _ = decoded(&encoded, bytes.len(), bytes.len());
            encoded.truncate(cut.index(encoded.len()));
            let _ = decoded(&encoded, bytes.len(), bytes.len());
        }
    }
}
