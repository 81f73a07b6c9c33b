//! H.264 by `rust_h264`.

use rust_h264::decoder::{ChromaFormat, Frame, OrderedDecoder};
use rust_h264::nal::{NalUnitType, parse_avcc, parse_avcc_config, parse_sps_info};

use super::decoder::{Decode, Decoded};
use super::planes::{Chroma, Color, Planes};

/// Maximum number of pixels of a frame: 8192 x 8192. A damaged header can claim any size.
const PIXELS: u64 = 8192 * 8192;

/// An open decoder. It decodes on one thread: the decoder of the crate with several threads replaces damaged frames by gray ones.
pub(super) struct H264 {
    decoder: OrderedDecoder<u32>,
    /// Bytes of the lengths in the samples.
    length_size: usize,
    color: Color,
}

impl H264 {
    /// Opens a decoder with the parameter sets in the box `avcC`.
    pub(super) fn open(config: &[u8]) -> Result<Self, String> {
        let config = parse_avcc_config(config)?;
        let mut decoder = OrderedDecoder::new();
        let mut color = None;
        for nal in config.sps_nals.iter().chain(&config.pps_nals) {
            if nal.nal_unit_type == NalUnitType::Sps {
                let info = parse_sps_info(nal).map_err(|error| format!("its parameter set is invalid: {error}"))?;
                if u64::from(info.coded_width) * u64::from(info.coded_height) > PIXELS {
                    return Err(format!("its frames have {} x {} pixels", info.width, info.height));
                }
                if info.bit_depth_luma != 8 || info.bit_depth_chroma != 8 {
                    return Err(format!(
                        "it has {} bits per sample",
                        info.bit_depth_luma.max(info.bit_depth_chroma)
                    ));
                }
                color = Some(Color::of(u32::from(info.matrix), info.full_range)?);
            }
            decoder
                .decode_nal_with_meta(nal, 0)
                .map_err(|error| format!("its parameter set is invalid: {error}"))?;
        }
        Ok(Self {
            decoder,
            length_size: config.length_size,
            color: color.ok_or("its box avcC has no parameter set")?,
        })
    }

    fn planes(&self, frame: Frame) -> Result<Planes, String> {
        if frame.bit_depth != 8 {
            return Err(format!("it has {} bits per sample", frame.bit_depth));
        }
        Ok(Planes {
            width: frame.width as usize,
            height: frame.height as usize,
            chroma: match frame.chroma_format {
                ChromaFormat::Yuv420 => Chroma::Half,
                ChromaFormat::Yuv422 => Chroma::HalfWidth,
            },
            color: self.color,
            y: frame.y,
            u: frame.u,
            v: frame.v,
        })
    }

    fn collect(&self, frames: Vec<(Frame, u32)>, out: &mut Vec<Decoded>) -> Result<(), String> {
        for (frame, tag) in frames {
            let planes = self.planes(frame)?;
            out.push(Decoded { tag, planes });
        }
        Ok(())
    }
}

/// Whether lengths and contents of the units in a sample fill it exactly. The crate's parser ignores a cut-off rest.
fn is_whole(mut sample: &[u8], length_size: usize) -> bool {
    while let Some((length, rest)) = sample.split_at_checked(length_size) {
        let length = length
            .iter()
            .fold(0_usize, |value, &byte| (value << 8) | usize::from(byte));
        let Some(rest) = rest.get(length..) else {
            return false;
        };
        sample = rest;
    }
    sample.is_empty()
}

impl Decode for H264 {
    fn can_start(&self, sample: &[u8]) -> bool {
        let units = parse_avcc(sample, self.length_size);
        units.iter().any(|nal| nal.nal_unit_type == NalUnitType::SliceIdr)
    }

    fn feed(&mut self, tag: u32, sample: &[u8], out: &mut Vec<Decoded>) -> Result<(), String> {
        if !is_whole(sample, self.length_size) {
            return Err("the units of a frame do not fill it".to_owned());
        }
        for nal in parse_avcc(sample, self.length_size) {
            let frames = self.decoder.decode_nal_with_meta(&nal, tag);
            let frames = frames.map_err(|error| format!("the H.264 decoder refuses its data: {error}"))?;
            self.collect(frames, out)?;
        }
        Ok(())
    }

    fn finish(&mut self, out: &mut Vec<Decoded>) -> Result<(), String> {
        let frames = self.decoder.flush_with_meta();
        self.collect(frames, out)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn units_must_fill_a_sample() {
        assert!(is_whole(&[], 4));
        assert!(is_whole(&[0, 0, 0, 1, 9, 0, 0, 0, 2, 1, 1], 4));
        assert!(!is_whole(&[0, 0, 0, 2, 9], 4));
        assert!(!is_whole(&[0, 0, 0, 1, 9, 0], 4));
    }
}
