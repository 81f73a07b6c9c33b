//! Decodes the bytes of a chunk's file to its elements.

use super::metadata::Shard;
use crate::compression::Compressor;

/// One encoding step between the bytes of elements and those of a file.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Codec {
    /// A compressor.
    Compressed(Compressor),
    /// A CRC-32C checksum, appended to the bytes.
    Crc32c,
}

/// The steps that encode elements to the bytes of a file.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Chain {
    /// Axis `i` of the stored data is axis `axes[i]` of the array; `None` for the identity.
    pub(super) axes: Option<Vec<usize>>,
    /// Whether elements are big-endian.
    pub(super) big_endian: bool,
    /// In the order of encoding.
    pub(super) codecs: Vec<Codec>,
}

impl Chain {
    /// The compressor, if it is the only codec and elements are in C order and little-endian.
    pub(super) fn plain(&self) -> Option<Compressor> {
        match self.codecs.as_slice() {
            [Codec::Compressed(compressor)] if self.axes.is_none() && !self.big_endian => Some(*compressor),
            _ => None,
        }
    }

    /// Decodes a chunk of a shape to elements in C order and native byte order.
    ///
    /// # Errors
    /// A description of what is wrong.
    pub(super) fn decode(&self, encoded: Vec<u8>, shape: &[u64], element_size: usize) -> Result<Vec<u8>, String> {
        let size = shape.iter().product::<u64>() as usize * element_size;
        let mut bytes = encoded;
        for (number, codec) in self.codecs.iter().enumerate().rev() {
            // The size before compression is known exactly, since only checksums add bytes and nothing may be compressed twice.
            let before = &self.codecs[..number];
            if before.iter().any(|codec| matches!(codec, Codec::Compressed(_))) {
                if *codec == Codec::Crc32c {
                    bytes = without_crc32c(bytes)?;
                    continue;
                }
                return Err("it is compressed twice".to_owned());
            }
            let expected = size + CRC32C * before.len();
            bytes = match codec {
                Codec::Compressed(compressor) => compressor.decode(&bytes, expected)?,
                Codec::Crc32c => without_crc32c(bytes)?,
            };
        }
        if bytes.len() != size {
            return Err(format!("it has {} bytes instead of {size}", bytes.len()));
        }
        if self.big_endian != cfg!(target_endian = "big") && element_size > 1 {
            bytes.chunks_exact_mut(element_size).for_each(<[u8]>::reverse);
        }
        Ok(match &self.axes {
            Some(axes) => in_order(&bytes, shape, axes, element_size),
            None => bytes,
        })
    }
}

/// Restores C order of elements that were stored with permuted axes.
fn in_order(bytes: &[u8], shape: &[u64], axes: &[usize], element_size: usize) -> Vec<u8> {
    let mut strides = vec![0; shape.len()];
    let mut stride = element_size;
    for &axis in axes.iter().rev() {
        strides[axis] = stride;
        stride *= shape[axis] as usize;
    }
    let mut ordered = Vec::with_capacity(bytes.len());
    let mut index = vec![0; shape.len()];
    let mut at = 0;
    while ordered.len() < bytes.len() {
        ordered.extend_from_slice(&bytes[at..at + element_size]);
        for axis in (0..shape.len()).rev() {
            index[axis] += 1;
            at += strides[axis];
            if index[axis] < shape[axis] {
                break;
            }
            at -= strides[axis] * shape[axis] as usize;
            index[axis] = 0;
        }
    }
    ordered
}

/// Length of a checksum in bytes.
const CRC32C: usize = 4;

fn without_crc32c(mut bytes: Vec<u8>) -> Result<Vec<u8>, String> {
    let Some((content, sum)) = bytes.split_last_chunk::<CRC32C>() else {
        return Err(format!("{} bytes are too few for a checksum", bytes.len()));
    };
    if crc32c(content) != u32::from_le_bytes(*sum) {
        return Err("its checksum does not match".to_owned());
    }
    bytes.truncate(bytes.len() - CRC32C);
    Ok(bytes)
}

/// CRC-32C (reflected), as defined in RFC 3720, appendix B.4.
fn crc32c(bytes: &[u8]) -> u32 {
    const TABLE: [u32; 256] = {
        let mut table = [0; 256];
        let mut byte = 0;
        while byte < 256 {
            let mut value = byte as u32;
            let mut bit = 0;
            while bit < 8 {
                value = if value & 1 == 1 {
                    value >> 1 ^ 0x82F6_3B78
                } else {
                    value >> 1
                };
                bit += 1;
            }
            table[byte] = value;
            byte += 1;
        }
        table
    };
    !bytes
        .iter()
        .fold(u32::MAX, |sum, &byte| TABLE[usize::from(sum as u8 ^ byte)] ^ sum >> 8)
}

/// Offset and length of a chunk in its shard; `None` if it is not stored.
pub(super) type Place = Option<(usize, usize)>;

impl Shard {
    /// Reads the index of a shard of a shape. Returns the places of its chunks in C order.
    ///
    /// # Errors
    /// A description of what is wrong.
    pub(super) fn places(&self, file: &[u8], shape: &[u64]) -> Result<Vec<Place>, String> {
        let count: u64 = shape
            .iter()
            .zip(&self.chunk)
            .map(|(outer, inner)| outer / inner)
            .product();
        let numbers = 2 * count;
        let length = numbers as usize * size_of::<u64>() + CRC32C * self.index.codecs.len();
        let Some(start) = file.len().checked_sub(length) else {
            return Err(format!("{} bytes are too few for a shard index", file.len()));
        };
        let index = if self.index_at_end {
            &file[start..]
        } else {
            &file[..length]
        };
        let index = self.index.decode(index.to_vec(), &[numbers], size_of::<u64>())?;
        let (numbers, _) = index.as_chunks::<{ size_of::<u64>() }>();
        numbers
            .chunks_exact(2)
            .map(|pair| {
                // By the specification, an absent chunk has the maximum value in both fields.
                let [offset, length] = [pair[0], pair[1]].map(u64::from_ne_bytes);
                if (offset, length) == (u64::MAX, u64::MAX) {
                    return Ok(None);
                }
                match offset.checked_add(length) {
                    Some(end) if end <= file.len() as u64 => Ok(Some((offset as usize, length as usize))),
                    _ => Err("a chunk of the shard extends past the end of the file".to_owned()),
                }
            })
            .collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// RFC 3720, appendix B.4.
    #[test]
    fn checksums_are_those_of_the_standard() {
        assert_eq!(crc32c(&[0; 32]), 0x8A91_36AA);
        assert_eq!(crc32c(&[0xFF; 32]), 0x62A8_AB43);
        assert_eq!(crc32c(b"123456789"), 0xE306_9283);
    }

    #[test]
    fn permuted_axes_are_restored() {
        // Element (i, j, k) of a 2 x 3 x 4 array is 100 i + 10 j + k.
        let shape = [2_u64, 3, 4];
        for axes in [[2, 1, 0], [0, 2, 1], [1, 2, 0], [0, 1, 2]] {
            let lengths: [u64; 3] = axes.map(|axis| shape[axis]);
            let mut stored = Vec::new();
            for a in 0..lengths[0] {
                for b in 0..lengths[1] {
                    for c in 0..lengths[2] {
                        let mut index = [0; 3];
                        for (axis, value) in axes.into_iter().zip([a, b, c]) {
                            index[axis] = value;
                        }
                        stored.extend((100 * index[0] + 10 * index[1] + index[2]).to_le_bytes());
                    }
                }
            }
            let ordered = in_order(&stored, &shape, &axes, 8);
            let values: Vec<u64> = ordered
                .as_chunks::<8>()
                .0
                .iter()
                .map(|bytes| u64::from_le_bytes(*bytes))
                .collect();
            let expected: Vec<u64> = (0..24).map(|n| 100 * (n / 12) + 10 * (n / 4 % 3) + n % 4).collect();
            assert_eq!(values, expected, "{axes:?}");
        }
    }

    #[test]
    fn checksums_are_verified_at_any_position() {
        let sum = |bytes: &[u8]| [bytes, &crc32c(bytes).to_le_bytes()].concat();
        let chain = |codecs: &[Codec]| Chain {
            axes: None,
            big_endian: true,
            codecs: codecs.to_vec(),
        };
        let zstd = |bytes: &[u8]| zstd::bulk::compress(bytes, 1).unwrap();
        let (crc, compressed) = (Codec::Crc32c, Codec::Compressed(Compressor::Zstd));
        let raw: Vec<u8> = vec![1, 2, 3, 4];
        for (codecs, encoded) in [
            (vec![crc], sum(&raw)),
            (vec![compressed, crc], sum(&zstd(&raw))),
            (vec![crc, compressed], zstd(&sum(&raw))),
            (vec![crc, compressed, crc], sum(&zstd(&sum(&raw)))),
        ] {
            let decoded = chain(&codecs).decode(encoded.clone(), &[2], 2).unwrap();
            assert_eq!(decoded, [2, 1, 4, 3], "{codecs:?}");
            let mut flipped = encoded;
            flipped[0] ^= 1;
            assert!(chain(&codecs).decode(flipped, &[2], 2).is_err(), "{codecs:?}");
        }
        let twice = chain(&[compressed, compressed]).decode(zstd(&zstd(&raw)), &[2], 2);
        assert_eq!(twice.unwrap_err(), "it is compressed twice");
        assert!(chain(&[crc]).decode(vec![1, 2], &[2], 2).is_err());
    }
}
