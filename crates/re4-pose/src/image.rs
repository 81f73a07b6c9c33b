//! Images of Push-T, and their segmentation by colour into block, goal and occluders.

use re4_fault::Remedy;
use thiserror::Error;

/// Width and height of the supported images, in image pixels.
pub const SIDE: usize = 96;

/// Side of the window that an image shows, in world pixels.
const WINDOW: f64 = 512.0;

/// World pixels per image pixel.
pub(crate) const SCALE: f64 = WINDOW / SIDE as f64;

/// The fixed pixel-to-world affine: the world coordinate of the centre of image column or row `d`.
///
/// The image samples the window at pixel centres, and the renderer maps a world coordinate to the window pixel `v` to which it
/// rounds. This explains both halves in the formula.
pub(crate) fn world(d: f64) -> f64 {
    (d + 0.5) * SCALE - 0.5
}

/// The inverse of [`world`].
pub(crate) fn image(v: f64) -> f64 {
    (v + 0.5) / SCALE - 0.5
}

/// An image that does not have the size or format of Push-T's.
#[derive(Debug, Clone, PartialEq, Eq, Error, Remedy)]
#[error("the image has {width} x {height} pixels and {bytes} bytes")]
#[remedy(
    "give {SIDE} x {SIDE} RGB images with 8 bits per channel ({} bytes): scale the images or record them again",
    SIDE * SIDE * 3
)]
pub struct ImageError {
    width: usize,
    height: usize,
    bytes: usize,
}

/// An image of 96 x 96 pixels, 8-bit RGB, row by row from the top.
#[derive(Clone, Copy)]
pub struct PushtImage<'a> {
    pixels: &'a [[u8; 3]],
}

impl<'a> PushtImage<'a> {
    /// A view of the bytes of an image.
    ///
    /// # Errors
    /// When width, height or the number of bytes differs from that of a 96 x 96 RGB image.
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

/// Blue minus red in the block's outline (119, 136, 153); inside, (143, 163, 184), it is 41. Of the other colours, white, the
/// grey walls and the light green goal have no such excess; the pusher's blue has 160 and more.
const BLOCK_EXCESS: f32 = 34.0;

/// A larger excess of blue over red than this is the pusher's.
const PUSHER_EXCESS: i16 = 50;

/// Only the red contact marks have a larger excess of red over green than this.
const MARK_EXCESS: i16 = 6;

/// Green minus red, and green minus blue, in the goal, (144, 238, 144).
const GOAL_EXCESS: f32 = 94.0;

/// The fraction of each image pixel that the block covers, and the pixels in which it is hidden.
pub(crate) struct BlockLayer {
    /// Fraction of each pixel that has the block's colour, 0 to 1.
    pub(crate) fractions: Vec<f32>,
    /// Indices of the pixels with a positive fraction, from the top.
    pub(crate) pixels: Vec<usize>,
    /// Whether each pixel shows the pusher or a contact mark, or is adjacent to such a pixel: its fraction is then unreliable.
    pub(crate) hidden: Vec<bool>,
}

impl BlockLayer {
    pub(crate) fn of(image: &PushtImage<'_>) -> Self {
        let mut fractions = vec![0.0; SIDE * SIDE];
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
                fractions[i] = (f32::from(excess) / BLOCK_EXCESS).min(1.0);
                pixels.push(i);
            }
        }
        Self {
            fractions,
            pixels,
            hidden,
        }
    }
}

/// The fraction of an image pixel that has the goal's colour, 0 to 1.
pub(crate) fn goal_fraction(pixel: [u8; 3]) -> f32 {
    let [red, green, blue] = pixel.map(i16::from);
    (f32::from(green - red.max(blue)) / GOAL_EXCESS).clamp(0.0, 1.0)
}

/// Whether a pixel has the block's colour if red and blue are swapped.
pub(crate) fn is_block_in_bgr([red, green, blue]: [u8; 3]) -> bool {
    let near = |value: u8, wanted: u8| value.abs_diff(wanted) <= 2;
    near(red, 184) && near(green, 163) && near(blue, 143)
}
