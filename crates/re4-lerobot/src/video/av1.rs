//! AV1 by `rav1d`, the Rust port of dav1d. It has dav1d's C interface, so this module is the binding to it.
//!
//! With one thread, rav1d aborts the process on some damaged data, because its error path panics inside an `extern "C"` function. With
//! two frame threads it returns an error instead; the pixels are the same.

#![expect(unsafe_code, reason = "rav1d has a C interface")]

use std::mem::MaybeUninit;
use std::ptr::NonNull;
use std::slice;

use rav1d::include::dav1d::data::Dav1dData;
use rav1d::include::dav1d::dav1d::{Dav1dContext, Dav1dLogger, Dav1dSettings};
use rav1d::include::dav1d::headers::{
    DAV1D_PIXEL_LAYOUT_I400, DAV1D_PIXEL_LAYOUT_I420, DAV1D_PIXEL_LAYOUT_I422, DAV1D_PIXEL_LAYOUT_I444,
};
use rav1d::include::dav1d::picture::Dav1dPicture;
use rav1d::src::lib::{
    dav1d_close, dav1d_data_create, dav1d_data_unref, dav1d_default_settings, dav1d_get_picture, dav1d_open,
    dav1d_picture_unref, dav1d_send_data,
};

use super::decoder::{Decode, Decoded};
use super::planes::{Chroma, Color, Planes, chroma_size};

/// Maximum number of pixels of a frame: 8192 x 8192. A damaged header can claim any size.
const PIXELS: u32 = 8192 * 8192;

/// `EAGAIN` of Linux, negative: the decoder needs other calls first.
const AGAIN: i32 = -11;

/// How often the decoder may ask for time to decode what it has. A sample has few frames, and each call decodes at least one.
const WAITS: u32 = 64;

/// An open decoder.
pub(super) struct Av1 {
    context: Option<Dav1dContext>,
}

impl Av1 {
    /// Opens a decoder. `config` is the box `av1C`; the frames repeat what it says, so only unsupported encodings are taken from it.
    pub(super) fn open(config: &[u8]) -> Result<Self, String> {
        if let [_, _, flags, ..] = config
            && flags & 0x40 != 0
        {
            return Err("it has more than 8 bits per sample".to_owned());
        }
        let mut settings = MaybeUninit::<Dav1dSettings>::uninit();
        // SAFETY: the function writes the whole structure to the valid pointer.
        let mut settings = unsafe {
            dav1d_default_settings(NonNull::from(&mut settings).cast());
            settings.assume_init()
        };
        settings.n_threads = 2;
        settings.max_frame_delay = 2;
        settings.all_layers = 0;
        settings.frame_size_limit = PIXELS;
        // SAFETY: there is no callback that could be called.
        settings.logger = unsafe { Dav1dLogger::new(None, None) };
        let mut context = None;
        // SAFETY: both pointers are valid for the call.
        let result = unsafe { dav1d_open(Some(NonNull::from(&mut context)), Some(NonNull::from(&mut settings))) };
        match result.0 {
            0 => Ok(Self { context }),
            code => Err(format!("the AV1 decoder cannot be opened (error {code})")),
        }
    }

    /// The next frame if one is ready.
    fn next(&mut self) -> Result<Option<Decoded>, String> {
        let mut frame = Dav1dPicture::default();
        // SAFETY: the context is open, the pointer is valid for the call.
        let result = unsafe { dav1d_get_picture(self.context, Some(NonNull::from(&mut frame))) };
        match result.0 {
            0 => {}
            AGAIN => return Ok(None),
            code => return Err(format!("the AV1 decoder refuses its data (error {code})")),
        }
        let tag = u32::try_from(frame.m.timestamp).unwrap_or(u32::MAX);
        let planes = planes(&frame);
        // SAFETY: the frame came from the decoder and is not used afterwards; its planes have been copied.
        unsafe { dav1d_picture_unref(Some(NonNull::from(&mut frame))) };
        Ok(Some(Decoded { tag, planes: planes? }))
    }
}

/// Copies the planes of a frame.
fn planes(frame: &Dav1dPicture) -> Result<Planes, String> {
    let size = |side: i32| usize::try_from(side).unwrap_or(0);
    let (width, height) = (size(frame.p.w), size(frame.p.h));
    if frame.p.bpc != 8 {
        return Err(format!("it has {} bits per sample", frame.p.bpc));
    }
    let chroma = match frame.p.layout {
        DAV1D_PIXEL_LAYOUT_I400 => Chroma::Gray,
        DAV1D_PIXEL_LAYOUT_I420 => Chroma::Half,
        DAV1D_PIXEL_LAYOUT_I422 => Chroma::HalfWidth,
        DAV1D_PIXEL_LAYOUT_I444 => return Err("it has as many chroma as luma samples (4:4:4)".to_owned()),
        other => return Err(format!("its pixel layout is number {other}")),
    };
    let Some(header) = frame.seq_hdr else {
        return Err("the AV1 decoder returned a frame without its header".to_owned());
    };
    // SAFETY: a frame that has not been released keeps its sequence header alive.
    let (matrix, range) = unsafe { (header.as_ref().mtrx, header.as_ref().color_range) };
    let color = Color::of(matrix, range != 0)?;
    let copy = |plane: usize, width: usize, height: usize| -> Result<Vec<u8>, String> {
        let mut bytes = Vec::with_capacity(width * height);
        if width * height == 0 {
            return Ok(bytes);
        }
        let (Some(data), stride) = (frame.data[plane], frame.stride[plane.min(1)]) else {
            return Err("the AV1 decoder returned a frame without planes".to_owned());
        };
        for row in 0..height as isize {
            // SAFETY: the decoder allocated `height` rows of at least `width` bytes, `stride` bytes apart, for a frame of 8 bits.
            bytes.extend_from_slice(unsafe {
                slice::from_raw_parts(data.as_ptr().cast::<u8>().offset(row * stride), width)
            });
        }
        Ok(bytes)
    };
    let (across, down) = chroma_size(chroma, width, height);
    Ok(Planes {
        width,
        height,
        chroma,
        color,
        y: copy(0, width, height)?,
        u: copy(1, across, down)?,
        v: copy(2, across, down)?,
    })
}

/// Whether a coded frame has a sequence header, which every key frame at which decoding can start has (AV1 in ISO media, section 2.4).
fn has_sequence_header(mut sample: &[u8]) -> bool {
    while let Some((&header, rest)) = sample.split_first() {
        if (header >> 3) & 15 == 1 {
            return true;
        }
        let rest = if header & 4 != 0 {
            rest.get(1..).unwrap_or(&[])
        } else {
            rest
        };
        if header & 2 == 0 {
            return false;
        }
        // The size, 7 bits per byte, the lowest first.
        let end = rest.iter().take(8).position(|byte| byte & 0x80 == 0);
        let Some(end) = end else {
            return false;
        };
        let size = rest[..=end]
            .iter()
            .rev()
            .fold(0_usize, |size, byte| (size << 7) | usize::from(byte & 0x7f));
        let Some(next) = rest.get(end + 1..).and_then(|rest| rest.get(size..)) else {
            return false;
        };
        sample = next;
    }
    false
}

impl Decode for Av1 {
    fn can_start(&self, sample: &[u8]) -> bool {
        has_sequence_header(sample)
    }

    fn feed(&mut self, tag: u32, sample: &[u8], out: &mut Vec<Decoded>) -> Result<(), String> {
        let mut data = Dav1dData::default();
        // SAFETY: the pointer is valid; the function allocates as many bytes as it is asked for, or returns null.
        let bytes = unsafe { dav1d_data_create(Some(NonNull::from(&mut data)), sample.len()) };
        if bytes.is_null() {
            return Err("the AV1 decoder has no memory for a frame".to_owned());
        }
        // SAFETY: the allocation has the length of the sample, and nobody else has the pointer yet.
        unsafe { bytes.copy_from_nonoverlapping(sample.as_ptr(), sample.len()) };
        data.m.timestamp = i64::from(tag);
        let mut waits = WAITS;
        let outcome = loop {
            // SAFETY: the context is open; the data came from the decoder's own allocation.
            let result = unsafe { dav1d_send_data(self.context, Some(NonNull::from(&mut data))) };
            match result.0 {
                0 => break Ok(()),
                // It still has frames of the sample before, which it decodes in this call. They need not be shown.
                AGAIN => match self.next() {
                    Ok(Some(frame)) => out.push(frame),
                    Ok(None) if waits > 0 => waits -= 1,
                    Ok(None) => break Err("the AV1 decoder does not accept its data".to_owned()),
                    Err(why) => break Err(why),
                },
                code => break Err(format!("the AV1 decoder refuses its data (error {code})")),
            }
        };
        if outcome.is_err() && data.data.is_some() {
            // SAFETY: the data came from the decoder's own allocation and was not taken.
            unsafe { dav1d_data_unref(Some(NonNull::from(&mut data))) };
        }
        outcome?;
        out.extend(self.next()?);
        Ok(())
    }

    fn finish(&mut self, out: &mut Vec<Decoded>) -> Result<(), String> {
        // The first call without new data only makes the decoder finish what it holds back.
        let mut empty = 0;
        while empty < 2 {
            match self.next()? {
                Some(frame) => {
                    out.push(frame);
                    empty = 0;
                }
                None => empty += 1,
            }
        }
        Ok(())
    }
}

impl Drop for Av1 {
    fn drop(&mut self) {
        // SAFETY: the context is open or none, and is not used afterwards.
        unsafe { dav1d_close(Some(NonNull::from(&mut self.context))) };
    }
}

#[cfg(test)]
mod tests {
    use super::has_sequence_header;

    #[test]
    fn sequence_headers_are_found() {
        // A temporal delimiter (type 2) and a frame (type 6) of 130 bytes, with and without a sequence header (type 1) between them.
        let frame = [[0x32, 0x82, 0x01].as_slice(), &[0; 130]].concat();
        let with = [[0x12, 0, 0x0a, 2, 7, 7].as_slice(), &frame].concat();
        let after = [[0x12, 0].as_slice(), &frame, &[0x0a, 1, 7]].concat();
        let without = [[0x12, 0].as_slice(), &frame].concat();
        assert!(has_sequence_header(&with) && has_sequence_header(&after));
        assert!(!has_sequence_header(&without) && !has_sequence_header(&[]) && !has_sequence_header(&[0x32, 0x82]));
        assert!(!has_sequence_header(&[
            0x32, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff
        ]));
    }
}
