//! A video file: its frames by number, decoded in order or one by one.

mod av1;
mod decoder;
mod h264;
mod mp4;
mod planes;

use std::fs::File;
use std::ops::Range;
use std::os::unix::fs::FileExt as _;
use std::path::Path;

use self::decoder::Decoded;
use self::mp4::{Sample, Track, Unusable};
use crate::contained::contained;
use crate::fault::{Fault, Kind};

pub use self::mp4::Codec;
pub use self::planes::{Chroma, Color, Matrix, Planes};

/// Called between frames; `true` asks for a stop.
pub type Stop<'a> = &'a (dyn Fn() -> bool + Sync);

/// Remedy for videos in an encoding that cannot be decoded.
const ENCODE_AGAIN: &str = "encode it again: ffmpeg -i OLD -c:v libx264 -pix_fmt yuv420p NEW";

/// An opened video file. Frames are numbered in the order in which they are shown.
pub struct Video {
    file: File,
    name: String,
    track: Track,
    /// For each frame, its sample in the order of decoding.
    sample_of: Vec<u32>,
    /// For each sample, its frame.
    frame_of: Vec<u32>,
}

impl Video {
    /// Opens a file and reads its table of frames. `name` is the name of the file in faults.
    ///
    /// # Errors
    /// The file is missing, damaged, or encoded in a way that is not supported.
    pub fn open(path: &Path, name: &str) -> Result<Self, Fault> {
        let file = File::open(path).map_err(|error| Fault::io(name, "opened", &error))?;
        let track = mp4::read(&file).map_err(|why| match why {
            Unusable::Damaged(why) => Fault::damaged(name, why),
            Unusable::Unsupported(what) => Fault::of_file(Kind::Unsupported, name, what, ENCODE_AGAIN),
        })?;
        let mut sample_of: Vec<u32> = (0..track.samples.len() as u32).collect();
        sample_of.sort_by_key(|&sample| track.samples[sample as usize].shown);
        let mut frame_of = vec![0; sample_of.len()];
        for (frame, &sample) in sample_of.iter().enumerate() {
            frame_of[sample as usize] = frame as u32;
        }
        let video = Self {
            file,
            name: name.to_owned(),
            track,
            sample_of,
            frame_of,
        };
        let same = video
            .times()
            .zip(video.times().skip(1))
            .position(|(time, next)| time >= next);
        if let Some(frame) = same {
            let why = format!("frames {frame} and {} have the same time", frame + 1);
            return Err(Fault::damaged(name, why));
        }
        Ok(video)
    }

    /// Name of the file in faults.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Number of frames.
    pub fn frames(&self) -> usize {
        self.sample_of.len()
    }

    /// Its codec.
    pub fn codec(&self) -> Codec {
        self.track.codec
    }

    /// Width and height in pixels, as the file states them.
    pub fn size(&self) -> (usize, usize) {
        (usize::from(self.track.width), usize::from(self.track.height))
    }

    /// Number of frames at which decoding can start.
    pub fn key_frames(&self) -> usize {
        self.track.samples.iter().filter(|sample| sample.key).count()
    }

    /// When a frame is shown, in seconds from the start of the file.
    pub fn time(&self, frame: usize) -> Option<f64> {
        let sample = *self.sample_of.get(frame)? as usize;
        Some(self.track.samples[sample].shown as f64 / f64::from(self.track.timescale))
    }

    /// When each frame is shown.
    pub fn times(&self) -> impl Iterator<Item = f64> {
        (0..self.frames()).filter_map(|frame| self.time(frame))
    }

    /// Decodes consecutive frames and passes each to `take`. Decoding starts at the key frame before; only frames that the decoder
    /// needs for others are in memory.
    ///
    /// # Errors
    /// The file is damaged, or `take` returns an error.
    pub fn decode<E: From<Fault>>(
        &self,
        frames: Range<usize>,
        stop: Stop<'_>,
        mut take: impl FnMut(usize, Planes) -> Result<(), E>,
    ) -> Result<(), E> {
        let Some(wanted) = self.sample_of.get(frames.clone()) else {
            let what = format!("it has {} frames, but frames {frames:?} are requested", self.frames());
            return Err(Fault::of_file(Kind::Count, &self.name, what, "request frames that exist").into());
        };
        if wanted.is_empty() {
            return Ok(());
        }
        let (first, last) = wanted.iter().fold((u32::MAX, 0), |(low, high), &sample| {
            (low.min(sample), high.max(sample))
        });
        let samples = &self.track.samples;
        let damaged = |why: String| Fault::damaged(&self.name, why);
        let mut decoder = contained(|| decoder::open(&self.track))
            .map_err(|what| Fault::of_file(Kind::Unsupported, &self.name, what, ENCODE_AGAIN))?;
        let (mut bytes, mut ready) = (Vec::new(), Vec::new());
        let mut key = first as usize;
        while key > 0 {
            if samples[key].key {
                self.read(samples[key], &mut bytes)?;
                if contained(|| Ok(decoder.can_start(&bytes))) == Ok(true) {
                    break;
                }
            }
            key -= 1;
        }
        let mut next = frames.start;
        for (number, &sample) in samples.iter().enumerate().take(last as usize + 1).skip(key) {
            if stop() {
                return Err(Fault::stopped().into());
            }
            self.read(sample, &mut bytes)?;
            contained(|| decoder.feed(number as u32, &bytes, &mut ready))
                .map_err(|why| damaged(format!("frame {}: {why}", self.frame_of[number])))?;
            self.pass(&mut ready, &frames, &mut next, &mut take)?;
        }
        contained(|| decoder.finish(&mut ready)).map_err(|why| damaged(format!("after frame {next}: {why}")))?;
        self.pass(&mut ready, &frames, &mut next, &mut take)?;
        if next < frames.end {
            return Err(damaged(format!("frame {next} cannot be decoded")).into());
        }
        Ok(())
    }

    /// Reads a coded frame.
    fn read(&self, sample: Sample, bytes: &mut Vec<u8>) -> Result<(), Fault> {
        bytes.resize(sample.size as usize, 0);
        self.file
            .read_exact_at(bytes, sample.offset)
            .map_err(|error| Fault::io(&self.name, "read", &error))
    }

    /// Passes on the frames that are wanted. Every one must come in its place.
    fn pass<E: From<Fault>>(
        &self,
        ready: &mut Vec<Decoded>,
        frames: &Range<usize>,
        next: &mut usize,
        take: &mut impl FnMut(usize, Planes) -> Result<(), E>,
    ) -> Result<(), E> {
        for Decoded { tag, planes } in ready.drain(..) {
            let frame = self.frame_of.get(tag as usize).map(|&frame| frame as usize);
            let Some(frame) = frame.filter(|frame| frames.contains(frame)) else {
                continue;
            };
            let (width, height) = self.size();
            let why = if frame != *next {
                format!("frame {next} cannot be decoded")
            } else if (planes.width, planes.height) != (width, height) || !planes.is_whole() {
                let (w, h) = (planes.width, planes.height);
                format!("frame {frame} has {w} x {h} pixels, the file states {width} x {height}")
            } else {
                take(frame, planes)?;
                *next += 1;
                continue;
            };
            return Err(Fault::damaged(&self.name, why).into());
        }
        Ok(())
    }

    /// Decodes one frame, from the key frame before it.
    ///
    /// # Errors
    /// The file is damaged, or has no such frame.
    pub fn frame(&self, frame: usize) -> Result<Planes, Fault> {
        let mut found = None;
        self.decode(frame..frame.saturating_add(1), &|| false, |_, planes| {
            found = Some(planes);
            Ok::<(), Fault>(())
        })?;
        found.ok_or_else(|| Fault::damaged(&self.name, format!("frame {frame} cannot be decoded")))
    }
}
