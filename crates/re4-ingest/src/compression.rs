//! Compressors whose files say nothing of their decoded length, or nothing that may be believed: gzip, zlib and zstd.
//!
//! The library that decodes chunks reserves as many bytes as a zstd frame claims to hold, and lets gzip and zlib grow without
//! end: a few damaged bytes, or a few hundred written with intent, would end the program. Here no more is decoded than the
//! chunk may hold. Blosc states its lengths in a header, which is checked before.

use std::io::{self, Read};

use flate2::read::{GzDecoder, ZlibDecoder};

/// A compressor that is undone here.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Compressor {
    Gzip,
    Zlib,
    Zstd,
}

impl Compressor {
    /// The compressor of this name in `.zarray`; `None` for those that are left to the library.
    pub(crate) fn of(id: &str) -> Option<Self> {
        Some(match id {
            "gzip" => Self::Gzip,
            "zlib" => Self::Zlib,
            "zstd" => Self::Zstd,
            _ => return None,
        })
    }

    /// Decodes a file to the bytes of a chunk.
    ///
    /// # Errors
    /// Why not, in words: a broken stream, or another number of bytes.
    pub(crate) fn decode(self, encoded: &[u8], expected: usize) -> Result<Vec<u8>, String> {
        let decoded = match self {
            Self::Gzip => at_most(GzDecoder::new(encoded), expected),
            Self::Zlib => at_most(ZlibDecoder::new(encoded), expected),
            Self::Zstd => {
                zstd::stream::read::Decoder::with_buffer(encoded).and_then(|stream| at_most(stream, expected))
            }
        };
        match decoded {
            Ok(bytes) if bytes.len() > expected => Err(format!("it decodes to more than {expected} bytes")),
            Ok(bytes) if bytes.len() < expected => Err(format!("{} bytes decoded instead of {expected}", bytes.len())),
            Ok(bytes) => Ok(bytes),
            Err(error) => Err(error.to_string()),
        }
    }
}

/// All bytes of a stream, or one more than expected.
fn at_most(stream: impl Read, expected: usize) -> io::Result<Vec<u8>> {
    let mut bytes = Vec::new();
    stream.take(expected as u64 + 1).read_to_end(&mut bytes)?;
    Ok(bytes)
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
        }
    }

    #[test]
    fn no_more_is_decoded_than_expected() {
        for compressor in [Compressor::Gzip, Compressor::Zlib, Compressor::Zstd] {
            let file = encoded(compressor, &vec![7; 1 << 20]);
            assert_eq!(compressor.decode(&file, 1 << 20).unwrap(), vec![7; 1 << 20]);
            assert_eq!(
                compressor.decode(&file, 1000).unwrap_err(),
                "it decodes to more than 1000 bytes"
            );
            assert_eq!(
                compressor.decode(&file, (1 << 20) + 1).unwrap_err(),
                "1048576 bytes decoded instead of 1048577"
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
    fn a_length_that_a_zstd_frame_claims_is_not_reserved() {
        let mut file = vec![0x28, 0xB5, 0x2F, 0xFD, 0xE0];
        file.extend(u64::MAX.to_le_bytes());
        file.extend([1, 0, 0]);
        assert!(Compressor::Zstd.decode(&file, 100).is_err());
    }
}
