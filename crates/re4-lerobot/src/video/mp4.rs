//! The table of samples of an MP4 file (ISO/IEC 14496-12): where each coded frame is, when it is shown and whether decoding can start
//! there.
//!
//! Only the boxes that this needs are read, and every count is compared with the others: a damaged table is an error, never a
//! shorter video. The coded frames themselves are read one by one when they are decoded, so the size of a file does not matter.

use std::fs::File;
use std::os::unix::fs::FileExt as _;

/// Maximum size of the box `moov`, which holds the tables: 8 bytes per frame and more. 256 MiB are far more than 10 million frames.
const MOOV_LIMIT: u64 = 256 << 20;

/// Maximum number of frames of a file: 92 hours at 30 frames per second. A damaged table can claim any number.
const FRAME_LIMIT: usize = 10_000_000;

/// The codec of a track, by the name of its sample entry.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Codec {
    /// `av01`
    Av1,
    /// `avc1` or `avc3`
    H264,
}

impl Codec {
    /// Its common name.
    pub fn name(self) -> &'static str {
        match self {
            Self::Av1 => "AV1",
            Self::H264 => "H.264",
        }
    }
}

/// A coded frame. In these videos, each sample of the file codes one frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Sample {
    /// Place in the file, in bytes.
    pub(super) offset: u64,
    /// Number of bytes.
    pub(super) size: u32,
    /// Whether decoding can start here.
    pub(super) key: bool,
    /// When it is shown, in units of the timescale, from the start of the presentation.
    pub(super) shown: i64,
}

/// The video track of a file.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Track {
    /// Its codec.
    pub(super) codec: Codec,
    /// Contents of the box `av1C` or `avcC`.
    pub(super) config: Vec<u8>,
    /// Pixels of a row.
    pub(super) width: u16,
    /// Rows of pixels.
    pub(super) height: u16,
    /// Units of time per second.
    pub(super) timescale: u32,
    /// The coded frames in the order in which they are decoded.
    pub(super) samples: Vec<Sample>,
}

/// Why a file cannot be used.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) enum Unusable {
    /// It is damaged, or not an MP4 file.
    Damaged(String),
    /// It is valid, but not supported.
    Unsupported(String),
}

type Result<T> = std::result::Result<T, Unusable>;

fn damaged<T>(why: impl Into<String>) -> Result<T> {
    Err(Unusable::Damaged(why.into()))
}

fn unsupported<T>(what: impl Into<String>) -> Result<T> {
    Err(Unusable::Unsupported(what.into()))
}

/// A name of four letters in text.
fn letters(name: [u8; 4]) -> String {
    name.iter()
        .map(|&byte| byte as char)
        .filter(char::is_ascii_graphic)
        .collect()
}

/// Bytes that are read from the front.
#[derive(Clone, Copy)]
struct Bytes<'a>(&'a [u8]);

impl<'a> Bytes<'a> {
    fn take(&mut self, count: usize) -> Result<&'a [u8]> {
        match self.0.split_at_checked(count) {
            Some((front, rest)) => {
                self.0 = rest;
                Ok(front)
            }
            None => damaged("a box of the MP4 file ends too early"),
        }
    }

    fn array<const N: usize>(&mut self) -> Result<[u8; N]> {
        let mut array = [0; N];
        array.copy_from_slice(self.take(N)?);
        Ok(array)
    }

    fn u16(&mut self) -> Result<u16> {
        Ok(u16::from_be_bytes(self.array()?))
    }

    fn u32(&mut self) -> Result<u32> {
        Ok(u32::from_be_bytes(self.array()?))
    }

    fn u64(&mut self) -> Result<u64> {
        Ok(u64::from_be_bytes(self.array()?))
    }

    /// The next box: its name and contents.
    fn next_box(&mut self) -> Result<Option<([u8; 4], Bytes<'a>)>> {
        if self.0.is_empty() {
            return Ok(None);
        }
        let before = self.0.len();
        let size = u64::from(self.u32()?);
        let name = self.array()?;
        let size = match size {
            0 => before as u64,
            1 => self.u64()?,
            size => size,
        };
        let header = (before - self.0.len()) as u64;
        let Some(contents) = size.checked_sub(header).and_then(|size| usize::try_from(size).ok()) else {
            return damaged(format!("box {} has an impossible size", letters(name)));
        };
        Ok(Some((name, Bytes(self.take(contents)?))))
    }

    /// The first child box of a name.
    fn find(mut self, name: [u8; 4]) -> Result<Option<Bytes<'a>>> {
        while let Some((found, contents)) = self.next_box()? {
            if found == name {
                return Ok(Some(contents));
            }
        }
        Ok(None)
    }

    /// The first child box of a name, which must exist.
    fn require(self, name: [u8; 4]) -> Result<Bytes<'a>> {
        match self.find(name)? {
            Some(contents) => Ok(contents),
            None => damaged(format!("box {} is missing", letters(name))),
        }
    }

    /// Version and flags of a box that has them.
    fn version(&mut self) -> Result<u8> {
        Ok(self.array::<4>()?[0])
    }

    /// Number of entries of `width` bytes that follow, which must be there.
    fn entries(&mut self, width: usize) -> Result<usize> {
        let count = self.u32()? as usize;
        match count.checked_mul(width) {
            Some(bytes) if bytes <= self.0.len() => Ok(count),
            _ => damaged("a table of the MP4 file is cut off"),
        }
    }
}

/// Reads the track of a file.
pub(super) fn read(file: &File) -> Result<Track> {
    let failed = |error: std::io::Error| Unusable::Damaged(format!("it cannot be read ({error})"));
    let length = file.metadata().map_err(failed)?.len();
    let mut at = 0_u64;
    let mut moov: Option<Vec<u8>> = None;
    while at < length {
        let mut header = [0; 16];
        let there = (length - at).min(16) as usize;
        file.read_exact_at(&mut header[..there], at).map_err(failed)?;
        if there < 8 {
            return damaged("it ends inside the header of a box");
        }
        let mut fields = Bytes(&header);
        let (short, name) = (fields.u32()?, fields.array::<4>()?);
        let size = match short {
            0 => length - at,
            1 if there == 16 => fields.u64()?,
            size => u64::from(size),
        };
        let own = if short == 1 { 16 } else { 8 };
        if size < own || at.checked_add(size).is_none_or(|end| end > length) {
            let what = if at == 0 {
                "it is not an MP4 file"
            } else {
                "it is cut off"
            };
            return damaged(format!(
                "{what} (box {:?} of {size} bytes at byte {at} of {length})",
                letters(name)
            ));
        }
        match &name {
            b"moov" if size > MOOV_LIMIT => return unsupported(format!("its index has {size} bytes")),
            b"moov" if moov.is_some() => return damaged("it has two boxes moov"),
            b"moov" => {
                let mut bytes = vec![0; (size - own) as usize];
                file.read_exact_at(&mut bytes, at + own).map_err(failed)?;
                moov = Some(bytes);
            }
            b"moof" => return unsupported("it is a fragmented MP4 file"),
            _ => {}
        }
        at += size;
    }
    match moov {
        Some(moov) => track(Bytes(&moov), length),
        None => damaged("box moov is missing; the file is cut off or not an MP4 file"),
    }
}

/// The only video track of a file.
fn track(moov: Bytes<'_>, length: u64) -> Result<Track> {
    let mut mvhd = moov.require(*b"mvhd")?;
    let long = mvhd.version()? == 1;
    mvhd.take(if long { 16 } else { 8 })?;
    let movie_timescale = mvhd.u32()?;
    let mut found = None;
    let mut boxes = moov;
    while let Some((name, trak)) = boxes.next_box()? {
        if name != *b"trak" {
            continue;
        }
        let mdia = trak.require(*b"mdia")?;
        let mut hdlr = mdia.require(*b"hdlr")?;
        hdlr.take(8)?;
        if hdlr.array::<4>()? != *b"vide" {
            continue;
        }
        if found.replace((trak, mdia)).is_some() {
            return unsupported("it has several video tracks");
        }
    }
    let Some((trak, mdia)) = found else {
        return damaged("it has no video track");
    };
    let mut mdhd = mdia.require(*b"mdhd")?;
    let long = mdhd.version()? == 1;
    mdhd.take(if long { 16 } else { 8 })?;
    let timescale = mdhd.u32()?;
    if timescale == 0 || movie_timescale == 0 {
        return damaged("its timescale is 0");
    }
    let stbl = mdia.require(*b"minf")?.require(*b"stbl")?;
    let (codec, config, width, height) = entry(stbl.require(*b"stsd")?)?;
    let mut samples = samples(stbl, length)?;
    let edits = match trak.find(*b"edts")? {
        Some(edts) => edts.find(*b"elst")?,
        None => None,
    };
    shift(&mut samples, edits, timescale, movie_timescale)?;
    Ok(Track {
        codec,
        config: config.to_vec(),
        width,
        height,
        timescale,
        samples,
    })
}

/// Codec, its configuration, width and height.
fn entry(mut stsd: Bytes<'_>) -> Result<(Codec, &[u8], u16, u16)> {
    stsd.version()?;
    if stsd.u32()? != 1 {
        return unsupported("its video track changes its encoding");
    }
    let Some((name, mut entry)) = stsd.next_box()? else {
        return damaged("box stsd is empty");
    };
    let (codec, config) = match &name {
        b"av01" => (Codec::Av1, *b"av1C"),
        b"avc1" | b"avc3" => (Codec::H264, *b"avcC"),
        _ => {
            let known = match &name {
                b"hvc1" | b"hev1" => " (HEVC)",
                b"vp09" => " (VP9)",
                b"vp08" => " (VP8)",
                b"mp4v" => " (MPEG-4 Part 2)",
                b"encv" => " (encrypted)",
                _ => "",
            };
            return unsupported(format!("its codec is {}{known}", letters(name)));
        }
    };
    entry.take(24)?;
    let (width, height) = (entry.u16()?, entry.u16()?);
    entry.take(50)?;
    Ok((codec, entry.require(config)?.0, width, height))
}

/// All samples, with the times of the media.
fn samples(stbl: Bytes<'_>, length: u64) -> Result<Vec<Sample>> {
    let sizes = sizes(stbl.require(*b"stsz")?, length)?;
    let offsets = offsets(stbl, &sizes, length)?;
    let times = times(stbl, sizes.len())?;
    let mut keys = vec![stbl.find(*b"stss")?.is_none(); sizes.len()];
    if let Some(mut stss) = stbl.find(*b"stss")? {
        stss.version()?;
        let mut before = 0;
        for _ in 0..stss.entries(4)? {
            let number = stss.u32()? as usize;
            let place = number.checked_sub(1).filter(|_| number > before);
            match place.and_then(|place| keys.get_mut(place)) {
                Some(key) => *key = true,
                None => return damaged("its table of key frames (stss) is invalid"),
            }
            before = number;
        }
    }
    if keys.first() == Some(&false) {
        return damaged("its first frame is not a key frame");
    }
    let all = sizes.into_iter().zip(offsets).zip(times).zip(keys);
    let sample = |(((size, offset), shown), key)| Sample {
        offset,
        size,
        key,
        shown,
    };
    Ok(all.map(sample).collect())
}

/// Bytes of each sample.
fn sizes(mut stsz: Bytes<'_>, length: u64) -> Result<Vec<u32>> {
    stsz.version()?;
    let (constant, mut count) = (stsz.u32()?, stsz.u32()? as usize);
    if constant == 0 && stsz.0.len() / 4 < count {
        return damaged("its table of sizes (stsz) is cut off");
    }
    // A sample has at least one byte, so a count beyond this is a lie that would only cost memory.
    if count as u64 > length || count > FRAME_LIMIT {
        return damaged(format!(
            "its table of sizes (stsz) claims {count} frames in {length} bytes"
        ));
    }
    let mut sizes = Vec::with_capacity(count);
    while count > 0 {
        let size = if constant == 0 { stsz.u32()? } else { constant };
        if size == 0 {
            return damaged(format!("frame {} has no data", sizes.len()));
        }
        sizes.push(size);
        count -= 1;
    }
    Ok(sizes)
}

/// Place of each sample in the file.
fn offsets(stbl: Bytes<'_>, sizes: &[u32], length: u64) -> Result<Vec<u64>> {
    let (mut chunks, wide) = match (stbl.find(*b"stco")?, stbl.find(*b"co64")?) {
        (Some(stco), None) => (stco, false),
        (None, Some(co64)) => (co64, true),
        _ => return damaged("it needs one table of chunks (stco or co64)"),
    };
    chunks.version()?;
    let count = chunks.entries(if wide { 8 } else { 4 })?;
    let mut stsc = stbl.require(*b"stsc")?;
    stsc.version()?;
    let runs = stsc.entries(12)?;
    let mut run = |left: &mut usize| -> Result<Option<(usize, usize)>> {
        if *left == 0 {
            return Ok(None);
        }
        *left -= 1;
        let (first, each) = (stsc.u32()? as usize, stsc.u32()? as usize);
        stsc.u32()?;
        Ok(Some((first, each)))
    };
    let mut left = runs;
    let mut current = run(&mut left)?;
    let mut next = run(&mut left)?;
    if count > 0 && current.is_none_or(|(first, _)| first != 1) {
        return damaged("its table of chunks (stsc) does not start at chunk 1");
    }
    let mut offsets = Vec::with_capacity(sizes.len());
    for chunk in 1..=count {
        if let Some((first, _)) = next
            && first == chunk
        {
            current = next;
            next = run(&mut left)?;
        }
        let mut at = if wide { chunks.u64()? } else { u64::from(chunks.u32()?) };
        for _ in 0..current.map_or(0, |(_, each)| each) {
            let Some(&size) = sizes.get(offsets.len()) else {
                return damaged("its tables (stsc, stsz) disagree on the number of frames");
            };
            offsets.push(at);
            at = match at.checked_add(u64::from(size)) {
                Some(end) if end <= length => end,
                _ => return damaged(format!("frame {} lies beyond the end of the file", offsets.len() - 1)),
            };
        }
    }
    if offsets.len() != sizes.len() || next.is_some() {
        return damaged("its tables (stsc, stco, stsz) disagree on the number of frames");
    }
    Ok(offsets)
}

/// When each sample is shown, in the time of the media.
fn times(stbl: Bytes<'_>, count: usize) -> Result<Vec<i64>> {
    let mut stts = stbl.require(*b"stts")?;
    stts.version()?;
    let mut times = Vec::with_capacity(count);
    let mut now = 0_i64;
    for _ in 0..stts.entries(8)? {
        let (run, step) = (stts.u32()? as usize, i64::from(stts.u32()?));
        if run > count - times.len() {
            return damaged("its tables (stts, stsz) disagree on the number of frames");
        }
        for _ in 0..run {
            times.push(now);
            now += step;
        }
    }
    if times.len() != count {
        return damaged("its tables (stts, stsz) disagree on the number of frames");
    }
    if let Some(mut ctts) = stbl.find(*b"ctts")? {
        ctts.version()?;
        let mut at = 0;
        for _ in 0..ctts.entries(8)? {
            let run = ctts.u32()? as usize;
            // Version 0 has unsigned offsets, but writers store negative ones there, too; positive ones never need the sign.
            let offset = i64::from(ctts.u32()?.cast_signed());
            let Some(shown) = times.get_mut(at..).and_then(|rest| rest.get_mut(..run)) else {
                return damaged("its tables (ctts, stsz) disagree on the number of frames");
            };
            for time in shown {
                *time += offset;
            }
            at += run;
        }
        if at != count {
            return damaged("its tables (ctts, stsz) disagree on the number of frames");
        }
    }
    Ok(times)
}

/// Converts the time of the media to that of the presentation. Without an edit list, the first frame is shown at 0.
fn shift(samples: &mut [Sample], edits: Option<Bytes<'_>>, timescale: u32, movie_timescale: u32) -> Result<()> {
    let first = samples.iter().map(|sample| sample.shown).min().unwrap_or(0);
    let last = samples.iter().map(|sample| sample.shown).max().unwrap_or(0);
    let (mut start, mut empty, mut seen) = (first, 0_i64, false);
    if let Some(mut elst) = edits {
        let long = elst.version()? == 1;
        for _ in 0..elst.entries(if long { 20 } else { 12 })? {
            let (duration, media) = if long {
                (elst.u64()?, elst.u64()?.cast_signed())
            } else {
                (u64::from(elst.u32()?), i64::from(elst.u32()?.cast_signed()))
            };
            elst.u32()?;
            let ticks = u128::from(duration) * u128::from(timescale) / u128::from(movie_timescale);
            let ticks = i64::try_from(ticks).ok().filter(|&ticks| ticks < i64::MAX / 4);
            let Some(ticks) = ticks else {
                return damaged("its edit list is invalid");
            };
            if media < 0 && !seen {
                empty += ticks;
                continue;
            }
            // One unit of the movie's time is the rounding of the duration.
            let unit = i64::from(timescale / movie_timescale) + 1;
            let cut = media > first || (ticks > 0 && last >= media.saturating_add(ticks + unit));
            if seen || media < 0 || cut {
                return unsupported("its edit list cuts frames out");
            }
            (start, seen) = (media, true);
        }
    }
    for sample in samples {
        sample.shown = sample.shown.saturating_sub(start).saturating_add(empty);
    }
    Ok(())
}
