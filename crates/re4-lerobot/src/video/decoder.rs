//! What a video decoder does, independent of the codec and of the library.

use super::av1::Av1;
use super::h264::H264;
use super::mp4::{Codec, Track};
use super::planes::Planes;

/// A frame that left the decoder.
pub(super) struct Decoded {
    /// The tag of the sample that coded it.
    pub(super) tag: u32,
    /// The frame.
    pub(super) planes: Planes,
}

/// A decoder. Errors are reasons in words; after an error the decoder must be dropped.
pub(super) trait Decode {
    /// Whether decoding can start at a coded frame. Tables of key frames are not always right: for H.264 they may list frames after
    /// which others still refer to earlier ones.
    fn can_start(&self, sample: &[u8]) -> bool;

    /// Takes the next coded frame and appends the frames that are ready, in the order in which they are shown.
    fn feed(&mut self, tag: u32, sample: &[u8], out: &mut Vec<Decoded>) -> Result<(), String>;

    /// Appends the frames that were held back.
    fn finish(&mut self, out: &mut Vec<Decoded>) -> Result<(), String>;
}

/// Opens the decoder of a track.
pub(super) fn open(track: &Track) -> Result<Box<dyn Decode>, String> {
    Ok(match track.codec {
        Codec::Av1 => Box::new(Av1::open(&track.config)?),
        Codec::H264 => Box::new(H264::open(&track.config)?),
    })
}
