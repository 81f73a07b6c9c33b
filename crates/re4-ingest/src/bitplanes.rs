//! Pictures stored as bit-shuffled floats, decoded straight to bytes.
//!
//! The Push-T dataset stores whole numbers 0..255 as f32, bit-shuffled and compressed by Blosc with zstd. Undoing that
//! step by step moves each picture through memory four times at four bytes a value. Here each Blosc block is
//! decompressed into a small buffer, and its bit planes are turned into bytes by boolean algebra, 64 values at a time,
//! without ever being a float. Anything unusual makes the function give up with `None`, and the caller takes the
//! general path, which also names what is wrong: this path never decides that a file is bad.
//!
//! Format: c-blosc 1.21, `README_CHUNK_FORMAT.rst` (header, block starts, splits) and `blosc/bitshuffle-generic.c` (bit
//! `b` of element `8 j + k` of a block of `n` elements is bit `k` of byte `b n / 8 + j`).

use std::ops::Range;

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
/// Lowest bit plane that a whole number below 256 can use: its top seven fraction bits are bits 16 to 22.
const FRACTION: usize = 16;
const EXPONENT: usize = 23;
const SIGN: usize = 31;
/// Largest block that gets a buffer; c-blosc makes blocks of at most a few MiB.
const LARGEST_BLOCK: usize = 16 << 20;
/// Words of 64 values handled at once, so that the compiler can use vector registers.
const LANES: usize = 4;
type Word = [u64; LANES];

/// Buffers of one thread, kept between chunks.
#[derive(Default)]
pub(crate) struct Scratch {
    zstd: zstd::bulk::Decompressor<'static>,
    block: Vec<u8>,
}

/// Decodes the first `out.len()` values of a Blosc buffer that holds `values` f32; `None` if the buffer is not of the
/// expected kind, or some value is not a whole number from 0 to 255.
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
        // c-blosc leaves a block unshuffled if its elements do not fill whole bytes of the planes.
        if bytes % (8 * TYPE_SIZE) != 0 {
            return None;
        }
        let start = field(HEADER + number * 4)?;
        let length = field(start)?;
        let source = encoded.get(start + 4..(start + 4).checked_add(length)?)?;
        scratch.block.resize(bytes, 0);
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

/// Turns the 32 bit planes of a block into bytes; `out` may be shorter than the block.
fn planes_to_bytes(block: &[u8], out: &mut [u8]) -> Option<()> {
    let stride = block.len() / (8 * TYPE_SIZE);
    let planes: Vec<&[u8]> = block.chunks_exact(stride).collect();
    let empty = |plane: &[u8]| {
        let (words, rest) = plane.as_chunks::<64>();
        words
            .iter()
            .all(|word| word.iter().fold(0, |any, byte| any | byte) == 0)
            && rest.iter().all(|&byte| byte == 0)
    };
    if planes.len() != 8 * TYPE_SIZE || !planes[..FRACTION].iter().all(|plane| empty(plane)) || !empty(planes[SIGN]) {
        return None;
    }
    let mut faulty = [0; LANES];
    let group = LANES * 8;
    for (number, out) in out.chunks_mut(LANES * 64).enumerate() {
        let mut words = [[0; LANES]; SIGN - FRACTION];
        for (word, plane) in words.iter_mut().zip(&planes[FRACTION..SIGN]) {
            *word = load(&plane[number * group..stride.min((number + 1) * group)]);
        }
        let (fraction, exponent) = words.split_at(EXPONENT - FRACTION);
        let (bits, bad) = value_bits(fraction, exponent);
        faulty = or(faulty, bad);
        for lane in 0..LANES {
            let bytes = interleave(bits.map(|bit| bit[lane]));
            let Some(target) = out.get_mut(lane * 64..) else { break };
            let length = target.len().min(64);
            target[..length].copy_from_slice(&bytes[..length]);
        }
    }
    (faulty == [0; LANES]).then_some(())
}

/// Little-endian words of up to 32 bytes, the missing ones zero.
fn load(bytes: &[u8]) -> Word {
    let mut padded = [0; LANES * 8];
    if let Ok(whole) = <&[u8; LANES * 8]>::try_from(bytes) {
        padded = *whole;
    } else {
        padded[..bytes.len()].copy_from_slice(bytes);
    }
    let (words, _) = padded.as_chunks::<8>();
    std::array::from_fn(|lane| u64::from_le_bytes(words[lane]))
}

fn and(a: Word, b: Word) -> Word {
    std::array::from_fn(|lane| a[lane] & b[lane])
}

fn or(a: Word, b: Word) -> Word {
    std::array::from_fn(|lane| a[lane] | b[lane])
}

fn not(a: Word) -> Word {
    a.map(|word| !word)
}

/// The eight bits of each value, and where a value is not a whole number from 0 to 255.
///
/// A float `2^e (1 + f)` with `0 <= e <= 7` has its bit `e` set, its bits below `e` are the first `e` fraction bits, and
/// it is whole if the other fraction bits are zero. `fraction` holds planes from the lowest of seven to the highest,
/// `exponent` the eight planes of `e + 127`.
fn value_bits(fraction: &[Word], exponent: &[Word]) -> ([Word; 8], Word) {
    let high = exponent[7];
    let low_of = |e: usize| {
        // e + 127 is 0111_1111 for e = 0 and 1000_0000 + (e - 1) above.
        (0..3).map(move |bit| {
            if (e - 1) >> bit & 1 == 1 {
                exponent[bit]
            } else {
                not(exponent[bit])
            }
        })
    };
    let middle_empty = not(exponent[3..7].iter().copied().fold([0; LANES], or));
    let is_exponent: [Word; 8] = std::array::from_fn(|e| {
        if e == 0 {
            exponent[..7].iter().copied().fold(not(high), and)
        } else {
            low_of(e).fold(and(high, middle_empty), and)
        }
    });
    let mut bits = [[0; LANES]; 8];
    let mut fractional = [0; LANES];
    let mut known = [0; LANES];
    for (e, &here) in is_exponent.iter().enumerate() {
        known = or(known, here);
        bits[e] = or(bits[e], here);
        for (place, &plane) in fraction.iter().rev().enumerate() {
            // Fraction bit `place` has the weight 2^(e - 1 - place).
            if place < e {
                bits[e - 1 - place] = or(bits[e - 1 - place], and(here, plane));
            } else {
                fractional = or(fractional, and(here, plane));
            }
        }
    }
    let any = fraction.iter().chain(exponent).copied().fold([0; LANES], or);
    (bits, or(fractional, and(any, not(known))))
}

/// 64 bytes from their eight bit planes: byte `i` has bit `b` from bit `i` of `planes[b]`.
fn interleave(planes: [u64; 8]) -> [u8; 64] {
    let planes = planes.map(u64::to_le_bytes);
    let mut bytes = [0; 64];
    let (groups, _) = bytes.as_chunks_mut::<8>();
    for (at, group) in groups.iter_mut().enumerate() {
        let mut square = u64::from_le_bytes(std::array::from_fn(|bit| planes[bit][at]));
        // Transposes an 8 x 8 matrix of bits by swapping its blocks of 1, 2 and 4 (Hacker's Delight, section 7-3).
        for (shift, mask) in [
            (7, 0x00AA_00AA_00AA_00AA),
            (14, 0x0000_CCCC_0000_CCCC),
            (28, 0x0000_0000_F0F0_F0F0),
        ] {
            let swap = (square ^ (square >> shift)) & mask;
            square ^= swap ^ (swap << shift);
        }
        *group = square.to_le_bytes();
    }
    bytes
}
