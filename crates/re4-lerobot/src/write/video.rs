//! Images as H.264 videos.
//!
//! Every second frame is a key frame, as the official writer has it. Colours are converted by BT.601 with limited range, and the colour
//! of four pixels is averaged. Episodes are encoded one by one, in parts, so that few frames are in memory.

use std::io;

use muxide::api::{Muxer, MuxerBuilder, VideoCodec};
use rusty_h264_common::YuvFrame;
use rusty_h264_encoder::{Encoder, EncoderConfig};

use super::folder::Staging;
use super::{Data, Declaration, FeatureKind, NewEpisode, WriteError};
use crate::contained::contained;
use crate::images;
use crate::info::Version;

/// Frames from one key frame to the next.
const GROUP: usize = 2;

/// Frames that are encoded at once, a multiple of [`GROUP`].
const PART: usize = 64;

/// The quantiser of all frames. On images of Push-T it gives a mean signal-to-noise ratio of 39 dB.
const QUANTISER: u8 = 18;

/// Maximum length of a file with several episodes, in seconds. Readers of the format look frames up by times in single precision, whose
/// rounding exceeds their tolerance from 1024 s on.
const LONGEST: usize = 1000;

/// The place of an episode in a video: chunk and file, and its first and last time in seconds.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct VideoPlace {
    pub(super) file: [usize; 2],
    pub(super) times: [f64; 2],
}

/// The videos of all cameras.
pub(super) struct Videos {
    version: Version,
    fps: usize,
    chunk: usize,
    limit: u64,
    cameras: Vec<Camera>,
    /// Number of video files.
    files: usize,
}

struct Camera {
    /// Number of its feature.
    feature: usize,
    name: String,
    size: (usize, usize),
    open: Option<Open>,
    /// Number of the open file, or of the next one.
    number: usize,
}

/// A file that is being written. It is held in memory until it is complete.
struct Open {
    name: String,
    muxer: Muxer<Vec<u8>>,
    frames: usize,
    bytes: u64,
}

impl Videos {
    pub(super) fn new(declared: &Declaration) -> Self {
        let cameras = declared
            .features
            .iter()
            .enumerate()
            .filter_map(|(feature, of)| match of.kind {
                FeatureKind::Video(width, height) => Some(Camera {
                    feature,
                    name: of.name.clone(),
                    size: (width, height),
                    open: None,
                    number: 0,
                }),
                _ => None,
            });
        Self {
            version: declared.version,
            fps: declared.fps.max(1),
            chunk: declared.limits.chunk.max(1),
            limit: declared.limits.video_bytes,
            cameras: cameras.collect(),
            files: 0,
        }
    }

    /// Number of video files.
    pub(super) fn files(&self) -> usize {
        self.files
    }

    /// Encodes the images of an episode; returns its places, camera by camera.
    pub(super) fn add(
        &mut self,
        staging: &Staging,
        index: usize,
        episode: &NewEpisode,
    ) -> Result<Vec<VideoPlace>, WriteError> {
        let mut places = Vec::with_capacity(self.cameras.len());
        for camera in &mut self.cameras {
            let Some(Data::Images(images)) = episode.data.get(camera.feature) else {
                continue;
            };
            let full = camera.open.as_ref().is_some_and(|open| {
                open.frames + images.len() > LONGEST * self.fps
                    || open.bytes >= self.limit
                    || self.version == Version::V2
            });
            if full {
                camera.close(staging)?;
            }
            let file = [camera.number / self.chunk, camera.number % self.chunk];
            let (width, height) = camera.size;
            let open = match &mut camera.open {
                Some(open) => open,
                closed => {
                    self.files += 1;
                    let name = match self.version {
                        Version::V3 => {
                            format!("videos/{}/chunk-{:03}/file-{:03}.mp4", camera.name, file[0], file[1])
                        }
                        Version::V2 => format!(
                            "videos/chunk-{:03}/{}/episode_{index:06}.mp4",
                            index / self.chunk,
                            camera.name
                        ),
                    };
                    let builder = MuxerBuilder::new(Vec::new());
                    let muxer = builder
                        .video(VideoCodec::H264, width as u32, height as u32, self.fps as f64)
                        .build()
                        .map_err(|error| staging.failed("write", &name, io::Error::other(error.to_string())))?;
                    closed.insert(Open {
                        name,
                        muxer,
                        frames: 0,
                        bytes: 0,
                    })
                }
            };
            let first = open.frames;
            for part in images.chunks(PART) {
                open.add(part, (width, height), self.fps)
                    .map_err(|what| WriteError::Value {
                        path: staging.path().to_owned(),
                        episode: index,
                        feature: camera.name.clone(),
                        what,
                        fix: "export the images as PNG files, without --video",
                    })?;
            }
            let time = |frame: usize| frame as f64 / self.fps as f64;
            places.push(VideoPlace {
                file,
                times: [time(first), time(open.frames)],
            });
        }
        Ok(places)
    }

    /// Completes all files.
    pub(super) fn close(&mut self, staging: &Staging) -> Result<(), WriteError> {
        self.cameras.iter_mut().try_for_each(|camera| camera.close(staging))
    }
}

impl Camera {
    fn close(&mut self, staging: &Staging) -> Result<(), WriteError> {
        let Some(Open { name, mut muxer, .. }) = self.open.take() else {
            return Ok(());
        };
        self.number += 1;
        muxer
            .finish_in_place()
            .map_err(|error| staging.failed("write", &name, io::Error::other(error.to_string())))?;
        staging.write(&name, &muxer.into_writer())
    }
}

impl Open {
    /// Encodes some images and appends them.
    fn add(&mut self, images: &[Vec<u8>], (width, height): (usize, usize), fps: usize) -> Result<(), String> {
        let frame = |png: &Vec<u8>| {
            let (_, _, rgb) = images::decode(png).map_err(|(_, why)| why)?;
            Ok(yuv(&rgb, width, height))
        };
        let frames: Vec<YuvFrame> = images.iter().map(frame).collect::<Result<_, String>>()?;
        let mut config = EncoderConfig::new(width, height);
        config.gop_size = GROUP as u32;
        config.min_keyint = 1;
        config.scenecut = 0;
        config.bframes = 0;
        config.bitrate = 0;
        config.qp = QUANTISER;
        config.framerate = fps as f32;
        let units = contained(|| {
            let encoder = Encoder::new(config).map_err(|error| format!("{error:?}"))?;
            encoder.encode_all(&frames).map_err(|error| format!("{error:?}"))
        })
        .map_err(|why| format!("its images cannot be encoded ({why})"))?;
        if units.len() != frames.len() {
            return Err(format!(
                "{} images gave {} frames of a video",
                frames.len(),
                units.len()
            ));
        }
        for unit in units {
            let time = self.frames as f64 / fps as f64;
            self.bytes += unit.len() as u64;
            self.muxer
                .write_video(time, &unit, is_key(&unit))
                .map_err(|error| format!("frame {} cannot be added to the video ({error})", self.frames))?;
            self.frames += 1;
        }
        Ok(())
    }
}

/// Whether an access unit (with start codes) has a slice of a key frame.
fn is_key(unit: &[u8]) -> bool {
    unit.windows(4)
        .any(|bytes| bytes[..3] == [0, 0, 1] && bytes[3] & 0x1f == 5)
}

/// The image in luma and chroma, BT.601, limited range. Width and height are even.
fn yuv(rgb: &[u8], width: usize, height: usize) -> YuvFrame {
    let pixel = |x: usize, y: usize| {
        let at = 3 * (y * width + x);
        [rgb[at], rgb[at + 1], rgb[at + 2]].map(f64::from)
    };
    let limited = |value: f64| (value + 0.5).floor().clamp(0.0, 255.0) as u8;
    let mut frame = YuvFrame {
        width,
        height,
        y: Vec::with_capacity(width * height),
        u: Vec::with_capacity(width * height / 4),
        v: Vec::with_capacity(width * height / 4),
    };
    for y in 0..height {
        for x in 0..width {
            let [r, g, b] = pixel(x, y);
            frame
                .y
                .push(limited(16.0 + (65.481 * r + 128.553 * g + 24.966 * b) / 255.0));
        }
    }
    for y in (0..height).step_by(2) {
        for x in (0..width).step_by(2) {
            let four = [pixel(x, y), pixel(x + 1, y), pixel(x, y + 1), pixel(x + 1, y + 1)];
            let [r, g, b] = [0, 1, 2].map(|channel| four.iter().map(|pixel| pixel[channel]).sum::<f64>() / 4.0);
            frame
                .u
                .push(limited(128.0 + (-37.797 * r - 74.203 * g + 112.0 * b) / 255.0));
            frame
                .v
                .push(limited(128.0 + (112.0 * r - 93.786 * g - 18.214 * b) / 255.0));
        }
    }
    frame
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn grey_has_no_chroma_and_limited_range() {
        let frame = yuv(&[[0_u8; 3], [255; 3], [0; 3], [255; 3]].concat(), 2, 2);
        assert_eq!(
            (frame.y, frame.u, frame.v),
            (vec![16, 235, 16, 235], vec![128], vec![128])
        );
    }

    #[test]
    fn key_frames_are_found_after_parameter_sets() {
        assert!(is_key(&[0, 0, 0, 1, 0x67, 9, 0, 0, 1, 0x65, 1]));
        assert!(!is_key(&[0, 0, 0, 1, 0x41, 9, 0, 0, 5]));
    }
}
