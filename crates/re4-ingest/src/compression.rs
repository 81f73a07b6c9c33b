//! Compressors of chunks.
//!
//! Compression libraries allocate as many bytes as a file declares, and gzip and zlib streams can expand without limit. A damaged
//! or malicious file could therefore exhaust memory. This module never decodes more bytes than the chunk has.

use std::io::{self, Read};

use flate2::read::{GzDecoder, ZlibDecoder};
use zarrs::array::codec::{blosc_decompress_bytes, blosc_validate};

/// A supported compressor.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Compressor {
    Blosc,
    Gzip,
    Lz4,
    Zlib,
    Zstd,
}

impl Compressor {
    /// The compressor with this name in an array's metadata.
    pub(crate) fn of(id: &str) -> Option<Self> {
        Some(match id {
            "blosc" => Self::Blosc,
            "gzip" => Self::Gzip,
            "lz4" => Self::Lz4,
            "zlib" => Self::Zlib,
            "zstd" => Self::Zstd,
            _ => return None,
        })
    }

    /// Decodes a file to the bytes of a chunk.
    ///
    /// # Errors
    /// A description of what is wrong: a corrupt stream, or a wrong number of bytes.
    pub(crate) fn decode(self, encoded: &[u8], expected: usize) -> Result<Vec<u8>, String> {
        let decoded = match self {
            Self::Blosc => return blosc(encoded, expected),
            Self::Lz4 => return lz4(encoded, expected),
            Self::Gzip => at_most(GzDecoder::new(encoded), expected),
            Self::Zlib => at_most(ZlibDecoder::new(encoded), expected),
            Self::Zstd => {
                zstd::stream::read::Decoder::with_buffer(encoded).and_then(|stream| at_most(stream, expected))
            }
        };
        match decoded {
            Ok(bytes) if bytes.len() > expected => Err(format!("it decodes to more than {expected} bytes")),
            Ok(bytes) if bytes.len() < expected => {
                Err(format!("it decodes to {} bytes instead of {expected}", bytes.len()))
            }
            Ok(bytes) => Ok(bytes),
            Err(error) => Err(error.to_string()),
        }
    }
}

/// Reads a stream up to one byte more than expected, so that an oversized stream is detected.
fn at_most(stream: impl Read, expected: usize) -> io::Result<Vec<u8>> {
    let mut bytes = Vec::new();
    stream.take(expected as u64 + 1).read_to_end(&mut bytes)?;
    Ok(bytes)
}

/// Decodes Blosc. The lengths in its header are compared with the file and the chunk before anything is allocated.
fn blosc(encoded: &[u8], expected: usize) -> Result<Vec<u8>, String> {
    let field = |at: usize| {
        encoded
            .get(at..)?
            .first_chunk()
            .map(|bytes| u32::from_le_bytes(*bytes) as usize)
    };
    match (field(4), field(12)) {
        (Some(_), Some(length)) if length != encoded.len() => {
            return Err(format!(
                "the file has {} bytes, but its header says {length}",
                encoded.len()
            ));
        }
        (Some(decoded), Some(_)) if decoded != expected => {
            return Err(format!("it decodes to {decoded} bytes instead of {expected}"));
        }
        (Some(_), Some(_)) => {}
        _ => {
            return Err(format!(
                "the file has {} bytes, too few for a Blosc header",
                encoded.len()
            ));
        }
    }
    if blosc_validate(encoded) != Some(expected) {
        return Err("its Blosc header is damaged".to_owned());
    }
    let decoded = blosc_decompress_bytes(encoded, expected, 1).map_err(|error| error.to_string())?;
    if decoded.len() != expected {
        return Err(format!("it decodes to {} bytes instead of {expected}", decoded.len()));
    }
    Ok(decoded)
}

/// Decodes an LZ4 block that follows its decoded length, as numcodecs writes it. Format: `lz4_Block_format.md` of lz4 1.10.
fn lz4(encoded: &[u8], expected: usize) -> Result<Vec<u8>, String> {
    let cut_off = || "the LZ4 block is truncated".to_owned();
    let (length, mut rest) = encoded.split_first_chunk().ok_or_else(cut_off)?;
    let length = u32::from_le_bytes(*length) as usize;
    if length != expected {
        return Err(format!("it decodes to {length} bytes instead of {expected}"));
    }
    let mut decoded: Vec<u8> = Vec::with_capacity(expected);
    // A length of 15 continues in the following bytes until one of them is not 255.
    let long = |nibble: u8, rest: &mut &[u8]| -> Option<usize> {
        let mut length = usize::from(nibble);
        if nibble == 15 {
            loop {
                let (&byte, after) = rest.split_first()?;
                *rest = after;
                length += usize::from(byte);
                if byte != u8::MAX {
                    break;
                }
            }
        }
        Some(length)
    };
    let too_long = || format!("it decodes to more than {expected} bytes");
    while let Some((&token, after)) = rest.split_first() {
        rest = after;
        let literals = long(token >> 4, &mut rest).ok_or_else(cut_off)?;
        let (copied, after) = rest.split_at_checked(literals).ok_or_else(cut_off)?;
        rest = after;
        if decoded.len() + literals > expected {
            return Err(too_long());
        }
        decoded.extend_from_slice(copied);
        // The last sequence has no match.
        if rest.is_empty() {
            break;
        }
        let (offset, after) = rest.split_first_chunk().ok_or_else(cut_off)?;
        rest = after;
        let start = decoded.len().checked_sub(usize::from(u16::from_le_bytes(*offset)));
        let start = start.filter(|&start| start < decoded.len());
        let start = start.ok_or("the LZ4 block refers to bytes before its start")?;
        // Matches have a minimum length of 4, which is not encoded.
        let matched = long(token & 15, &mut rest).ok_or_else(cut_off)? + 4;
        if decoded.len() + matched > expected {
            return Err(too_long());
        }
        // Copied byte by byte because a match may overlap its own output.
        for at in start..start + matched {
            decoded.push(decoded[at]);
        }
    }
    if decoded.len() != expected {
        return Err(format!("it decodes to {} bytes instead of {expected}", decoded.len()));
    }
    Ok(decoded)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::io::Write as _;

    fn encoded(compressor: Compressor, bytes: &[u8]) -> Vec<u8> {
        let level = flate2::Compression::new(1);
        match compressor {
            Compressor::Gzip => {
                let mut encoder = flate2::write::GzEncoder::new(Vec::new(), level);
                encoder.write_all(bytes).unwrap();
                encoder.finish().unwrap()
            }
            Compressor::Zlib => {
                let mut encoder = flate2::write::ZlibEncoder::new(Vec::new(), level);
                encoder.write_all(bytes).unwrap();
                encoder.finish().unwrap()
            }
            Compressor::Zstd => zstd::bulk::compress(bytes, 1).unwrap(),
            Compressor::Blosc | Compressor::Lz4 => unreachable!(),
        }
    }

    /// Written by numcodecs 0.16.6, `LZ4().encode`: 40 letters, 300 times "ab", and 600 times the same byte.
    #[test]
    fn lz4_blocks_are_read() {
        let text: Vec<u8> = (0..40)
            .map(|i| b'A' + i)
            .chain(b"ab".repeat(300))
            .chain([7; 600])
            .collect();
        let file: Vec<u8> = LZ4_FILE
            .split_whitespace()
            .map(|byte| u8::from_str_radix(byte, 16).unwrap())
            .collect();
        assert_eq!(Compressor::Lz4.decode(&file, text.len()).unwrap(), text);
        for cut in 0..file.len() {
            assert!(Compressor::Lz4.decode(&file[..cut], text.len()).is_err(), "{cut}");
        }
        for (place, bit) in (0..file.len()).flat_map(|place| (0..8).map(move |bit| (place, bit))) {
            let mut damaged = file.clone();
            damaged[place] ^= 1 << bit;
            if let Ok(decoded) = Compressor::Lz4.decode(&damaged, text.len()) {
                assert_eq!(decoded.len(), text.len());
            }
        }
        let claim = [&u32::MAX.to_le_bytes(), &file[4..]].concat();
        assert!(Compressor::Lz4.decode(&claim, text.len()).is_err());
    }

    const LZ4_FILE: &str = "d8 04 00 00 ff 1b 41 42 43 44 45 46 47 48 49 4a 4b 4c 4d 4e 4f 50 51 52 53 54 55 56 57 58 59 5a 5b 5c 5d 5e 5f 60 61 62 63 64 65 66 67 68 61 62 02 00 ff ff 45 1f 07 01 00 ff ff 41 50 07 07 07 07 07";

    #[test]
    fn decoding_stops_at_the_expected_size() {
        for compressor in [Compressor::Gzip, Compressor::Zlib, Compressor::Zstd] {
            let file = encoded(compressor, &vec![7; 1 << 20]);
            assert_eq!(compressor.decode(&file, 1 << 20).unwrap(), vec![7; 1 << 20]);
            assert_eq!(
                compressor.decode(&file, 1000).unwrap_err(),
                "it decodes to more than 1000 bytes"
            );
            assert_eq!(
                compressor.decode(&file, (1 << 20) + 1).unwrap_err(),
                "it decodes to 1048576 bytes instead of 1048577"
            );
            for cut in [0, 1, 10, file.len() / 2, file.len() - 1] {
                assert!(
                    compressor.decode(&file[..cut], 1 << 20).is_err(),
                    "{compressor:?} {cut}"
                );
            }
        }
    }

    /// The frame header, RFC 8878, section 3.1.1.1: a single segment whose content size has eight bytes.
    #[test]
    fn a_size_declared_by_a_zstd_frame_is_not_allocated() {
        let mut file = vec![0x28, 0xB5, 0x2F, 0xFD, 0xE0];
        file.extend(u64::MAX.to_le_bytes());
        file.extend([1, 0, 0]);
        assert!(Compressor::Zstd.decode(&file, 100).is_err());
    }
}
