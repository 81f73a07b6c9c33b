//! The frames of a video: tiles in rows. A frame stores only the pixels that changed.

use std::borrow::Cow;
use std::io::Write;

use gif::{DisposalMethod, Encoder, EncodingError, Frame, Repeat};

use super::{LAST_CS, SHORTEST_CS, VIDEO_SIZES, VIDEO_SPEEDS, VIDEO_TILES, VideoError, VideoSettings, VideoSummary};

/// Paints a tile, given its index and a state, and returns its pixels as palette indices, row by row.
pub(super) type PaintTile<'a> = dyn FnMut(usize, usize) -> Result<Vec<u8>, VideoError> + 'a;

/// A video of tiles that start at the same time. Tiles that end earlier stay in their last state.
pub(super) struct Reel {
    /// Index of the last state of each tile.
    lasts: Vec<usize>,
    columns: usize,
    side: usize,
    tile_height: usize,
    /// The states that are shown, each with its duration in hundredths of a second.
    times: Vec<(usize, u16)>,
}

impl Reel {
    /// Lays out tiles with a strip of height `strip` below their images. A control step lasts `step` hundredths of a second.
    pub(super) fn new(lasts: &[usize], settings: VideoSettings, strip: u32, step: f64) -> Self {
        let last = lasts.iter().copied().max().unwrap_or(0);
        Self {
            lasts: lasts.to_vec(),
            columns: (1..=VIDEO_TILES).find(|c| c * c >= lasts.len()).unwrap_or(1),
            side: settings.size as usize,
            tile_height: (settings.size + strip) as usize,
            times: shown(last, settings.speed, step),
        }
    }

    /// Writes the video. `going` is called before every frame; if it returns false, writing stops.
    pub(super) fn write(
        &self,
        out: impl Write,
        palette: &[u8],
        transparent: u8,
        paint: &mut PaintTile<'_>,
        going: &mut dyn FnMut() -> bool,
    ) -> Result<VideoSummary, VideoError> {
        let rows = self.lasts.len().div_ceil(self.columns);
        let (width, height) = (self.columns * self.side, rows * self.tile_height);
        let mut encoder = Encoder::new(out, width as u16, height as u16, palette)?;
        encoder.set_repeat(Repeat::Infinite)?;
        let mut page = Page::new(width, height);
        let mut painted = vec![None; self.lasts.len()];
        for (i, &(state, delay)) in self.times.iter().enumerate() {
            if !going() {
                return Err(VideoError::Interrupted);
            }
            for (number, &last) in self.lasts.iter().enumerate() {
                let at = state.min(last);
                if painted[number].replace(at) == Some(at) {
                    continue;
                }
                let corner = (
                    number % self.columns * self.side,
                    number / self.columns * self.tile_height,
                );
                page.put(&paint(number, at)?, self.side, corner);
            }
            encoder.write_frame(&page.changes(transparent, delay, i == 0))?;
        }
        encoder.into_inner()?.flush().map_err(EncodingError::from)?;
        Ok(VideoSummary {
            width: width as u32,
            height: height as u32,
            frames: self.times.len() as u32,
            duration_cs: self.times.iter().map(|(_, delay)| u32::from(*delay)).sum(),
        })
    }
}

/// Checks the settings, and the rollouts, which are given as seed and number of states.
pub(super) fn check_settings(
    rollouts: impl ExactSizeIterator<Item = (u32, usize)>,
    settings: VideoSettings,
) -> Result<(), VideoError> {
    let refuse = |text: String| Err(VideoError::Settings(text));
    let count = rollouts.len();
    if count == 0 || count > VIDEO_TILES {
        return refuse(format!("a video can show 1 to {VIDEO_TILES} rollouts, not {count}"));
    }
    for (seed, states) in rollouts {
        if states == 0 {
            return refuse(format!("the rollout of seed {seed} has no states to show"));
        }
    }
    if !VIDEO_SIZES.contains(&settings.size) {
        let (minimum, maximum) = (VIDEO_SIZES.start(), VIDEO_SIZES.end());
        return refuse(format!(
            "the size of a video has to be {minimum} to {maximum} px, not {}",
            settings.size
        ));
    }
    if !VIDEO_SPEEDS.contains(&settings.speed) {
        let (minimum, maximum) = (VIDEO_SPEEDS.start(), VIDEO_SPEEDS.end());
        return refuse(format!(
            "the speed of a video has to be {minimum} to {maximum}, not {}",
            settings.speed
        ));
    }
    Ok(())
}

/// Returns the states to show, each with its duration in hundredths of a second. A control step lasts `step` hundredths.
///
/// Durations are differences of rounded times, so that rounding errors do not add up and the video lasts as long as the rollout.
pub(super) fn shown(last: usize, speed: f64, step: f64) -> Vec<(usize, u16)> {
    let stride = (SHORTEST_CS * speed / step).ceil().max(1.0) as usize;
    let time = |state: usize| (step * state as f64 / speed).round() as u64;
    let mut times: Vec<(usize, u16)> = (0..last)
        .step_by(stride)
        .map(|state| (state, (time((state + stride).min(last)) - time(state)) as u16))
        .collect();
    times.push((last, LAST_CS));
    times
}

/// The current and the previous frame of the video.
struct Page {
    width: usize,
    now: Vec<u8>,
    before: Vec<u8>,
}

impl Page {
    fn new(width: usize, height: usize) -> Self {
        Self {
            width,
            now: vec![0; width * height],
            before: vec![0; width * height],
        }
    }

    fn put(&mut self, tile: &[u8], side: usize, (left, top): (usize, usize)) {
        for (row, pixels) in tile.chunks_exact(side).enumerate() {
            let start = (top + row) * self.width + left;
            self.now[start..start + side].copy_from_slice(pixels);
        }
    }

    /// Returns the smallest rectangle that contains all changes; unchanged pixels in it are transparent. The first frame contains
    /// the whole page.
    fn changes(&mut self, transparent: u8, delay: u16, first: bool) -> Frame<'static> {
        let rows = || {
            self.now
                .chunks_exact(self.width)
                .zip(self.before.chunks_exact(self.width))
        };
        let (mut left, mut right, mut top, mut bottom) = (self.width, 0, usize::MAX, 0);
        for (y, (now, before)) in rows().enumerate() {
            let differs = |(a, b): (&u8, &u8)| first || a != b;
            if let Some(x) = now.iter().zip(before).position(differs) {
                left = left.min(x);
                right = right.max(now.iter().zip(before).rposition(differs).unwrap_or(x));
                (top, bottom) = (top.min(y), y);
            }
        }
        if top == usize::MAX {
            // Nothing has changed, but a GIF frame needs at least one pixel.
            (left, right, top, bottom) = (0, 0, 0, 0);
        }
        let buffer: Vec<u8> = rows()
            .skip(top)
            .take(bottom + 1 - top)
            .flat_map(|(now, before)| now[left..=right].iter().zip(&before[left..=right]))
            .map(|(now, before)| if first || now != before { *now } else { transparent })
            .collect();
        self.before.copy_from_slice(&self.now);
        Frame {
            delay,
            dispose: DisposalMethod::Keep,
            transparent: Some(transparent),
            left: left as u16,
            top: top as u16,
            width: (right + 1 - left) as u16,
            height: (bottom + 1 - top) as u16,
            buffer: Cow::Owned(buffer),
            ..Frame::default()
        }
    }
}
