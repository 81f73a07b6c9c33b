//! Images of Push-T, and what their colours tell: where the block is, where the goal is, and what hides them.

use re4_fault::Remedy;
use thiserror::Error;

/// Width and height of the images that are understood, in image pixels.
pub const SIDE: usize = 96;

/// Side of the window that an image shows, in pixels of the world.
const WINDOW: f64 = 512.0;

/// World pixels to one image pixel.
pub(crate) const SCALE: f64 = WINDOW / SIDE as f64;

/// The fixed pixel-to-world affine: the world coordinate at the centre of image column or row `d`.
///
/// The image is the window sampled at pixel centres, and pixel `v` of the window is drawn where a world coordinate
/// rounds to `v`; hence the two halves.
pub(crate) fn world(d: f64) -> f64 {
    (d + 0.5) * SCALE - 0.5
}

/// The inverse of [`world`].
pub(crate) fn image(v: f64) -> f64 {
    (v + 0.5) / SCALE - 0.5
}

/// An image that cannot be one of Push-T.
#[derive(Debug, Clone, PartialEq, Eq, Error, Remedy)]
#[error("the image has {width} x {height} pixels and {bytes} bytes")]
#[remedy(
    "poses are estimated from {SIDE} x {SIDE} RGB images of 8 bits a channel ({} bytes), so scale it to that size or record it again",
    SIDE * SIDE * 3
)]
pub struct ImageError {
    width: usize,
    height: usize,
    bytes: usize,
}

/// An image of 96 x 96 pixels, RGB, 8 bits each, row by row from the top.
#[derive(Clone, Copy)]
pub struct PushtImage<'a> {
    pixels: &'a [[u8; 3]],
}

impl<'a> PushtImage<'a> {
    /// A view of the bytes of an image.
    ///
    /// # Errors
    /// When width, height or the number of bytes is another.
    pub fn new(bytes: &'a [u8], width: usize, height: usize) -> Result<Self, ImageError> {
        let (pixels, rest) = bytes.as_chunks::<3>();
        if (width, height) != (SIDE, SIDE) || pixels.len() != SIDE * SIDE || !rest.is_empty() {
            return Err(ImageError {
                width,
                height,
                bytes: bytes.len(),
            });
        }
        Ok(Self { pixels })
    }

    pub(crate) fn pixels(&self) -> &'a [[u8; 3]] {
        self.pixels
    }
}

/// Blue over red, in the block's outline (119, 136, 153) and in its inside (143, 163, 184). Of the other colours, white,
/// grey walls and the light green goal have none; the pusher's blue has 160 and more.
const BLOCK_EXCESS: f32 = 34.0;

/// More blue over red than this is the pusher's.
const PUSHER_EXCESS: i16 = 50;

/// Only the red marks of contacts have more red than green.
const MARK_EXCESS: i16 = 6;

/// Green over red and blue in the goal, (144, 238, 144).
const GOAL_EXCESS: f32 = 94.0;

/// How much of each image pixel the block covers, and where that cannot be seen.
pub(crate) struct BlockLayer {
    /// Fraction of the pixel that has the block's colour, 0 to 1.
    pub(crate) share: Vec<f32>,
    /// Pixels with any of the block's colour, from the top.
    pub(crate) pixels: Vec<usize>,
    /// Whether the pixel shows the pusher or a contact mark, or touches one that does: there the fraction is not to be trusted.
    pub(crate) hidden: Vec<bool>,
}

impl BlockLayer {
    pub(crate) fn of(image: &PushtImage<'_>) -> Self {
        let mut share = vec![0.0; SIDE * SIDE];
        let mut hidden = vec![false; SIDE * SIDE];
        let mut pixels = Vec::with_capacity(512);
        for (i, &[red, green, blue]) in image.pixels().iter().enumerate() {
            let [red, green, blue] = [red, green, blue].map(i16::from);
            let excess = blue - red;
            if excess > PUSHER_EXCESS || red - green > MARK_EXCESS {
                let (row, column) = (i / SIDE, i % SIDE);
                for y in row.saturating_sub(1)..=(row + 1).min(SIDE - 1) {
                    for x in column.saturating_sub(1)..=(column + 1).min(SIDE - 1) {
                        hidden[y * SIDE + x] = true;
                    }
                }
            } else if excess > 0 {
                share[i] = (f32::from(excess) / BLOCK_EXCESS).min(1.0);
                pixels.push(i);
            }
        }
        Self { share, pixels, hidden }
    }
}

/// How much of each image pixel has the goal's colour, 0 to 1.
pub(crate) fn goal_fraction(pixel: [u8; 3]) -> f32 {
    let [red, green, blue] = pixel.map(i16::from);
    (f32::from(green - red.max(blue)) / GOAL_EXCESS).clamp(0.0, 1.0)
}

/// Whether a pixel would have the block's colour if red and blue changed places.
pub(crate) fn is_block_in_bgr([red, green, blue]: [u8; 3]) -> bool {
    let near = |value: u8, wanted: u8| value.abs_diff(wanted) <= 2;
    near(red, 184) && near(green, 163) && near(blue, 143)
}
