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
    /// If width, height or the number of bytes differs from that of a 96 x 96 RGB image.
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

/// How images were stored. Lossy compression tints the pixels around coloured shapes, which changes the segmentation by colour.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Storage {
    /// As rendered: PNG files, or arrays of bytes.
    #[default]
    Lossless,
    /// Decoded from a video, which stores colour with less resolution than brightness.
    Lossy,
}

/// Blue minus red in the block's outline (119, 136, 153); inside, (143, 163, 184), it is 41. Of the other colours, white, the
/// grey walls and the light green goal have no such excess; the pusher's blue has 160 and more.
const BLOCK_EXCESS: f32 = 34.0;

/// A larger excess of blue over red than this is the pusher's.
const PUSHER_EXCESS: i16 = 50;

/// Only the red contact marks have a larger excess of red over green than this.
const MARK_EXCESS: i16 = 6;

/// In lossy images, blue minus red of the pixels that show something of the block. White and the goal have up to 8 of it, because the
/// codec rounds colours.
const LOSSY_BLOCK: i16 = 8;

/// Same as [`PUSHER_EXCESS`] for lossy images, in which the block's excess varies by 6 to 10 (standard deviation).
const LOSSY_PUSHER: i16 = 55;

/// Same as [`MARK_EXCESS`] for lossy images.
const LOSSY_MARK: i16 = 20;

/// Brightness of the floor.
const WHITE: f32 = luma([255, 255, 255]);

/// Brightness of the goal.
const GOAL: f32 = luma([144, 238, 144]);

/// Brightness of the inside of the block.
const BLOCK: f32 = luma([143, 163, 184]);

/// How far, in pixels, an edge of the block can be from a pixel with its colour in a lossy image: videos store one colour for 2 x 2
/// pixels.
const EDGE: usize = 2;

/// Smaller fractions than this are noise of the codec.
const MINIMUM_FRACTION: f32 = 0.2;

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
    /// The layer of an image. `goal` is the fraction of each pixel that the goal covers.
    pub(crate) fn of(image: &PushtImage<'_>, storage: Storage, goal: &[f32]) -> Self {
        match storage {
            Storage::Lossless => Self::by_colour(image),
            Storage::Lossy => Self::by_brightness(image, goal),
        }
    }

    fn by_colour(image: &PushtImage<'_>) -> Self {
        let mut layer = Self::empty();
        for (i, &[red, green, blue]) in image.pixels().iter().enumerate() {
            let [red, green, blue] = [red, green, blue].map(i16::from);
            let excess = blue - red;
            if excess > PUSHER_EXCESS || red - green > MARK_EXCESS {
                layer.hide_around(i);
            } else if excess > 0 {
                layer.fractions[i] = (f32::from(excess) / BLOCK_EXCESS).min(1.0);
                layer.pixels.push(i);
            }
        }
        layer
    }

    /// Videos store colour at half the resolution, and brightness at the full one. The colour shows where the block is, and the
    /// brightness where its edges are.
    fn by_brightness(image: &PushtImage<'_>, goal: &[f32]) -> Self {
        let mut layer = Self::empty();
        let mut near = vec![false; SIDE * SIDE];
        for (i, &[red, green, blue]) in image.pixels().iter().enumerate() {
            let [red, green, blue] = [red, green, blue].map(i16::from);
            let excess = blue - red;
            if excess > LOSSY_PUSHER || red - green > LOSSY_MARK {
                layer.hide_around(i);
            } else if excess > LOSSY_BLOCK {
                for at in around(i, EDGE) {
                    near[at] = true;
                }
            }
        }
        for (i, &pixel) in image.pixels().iter().enumerate() {
            if !near[i] {
                continue;
            }
            let background = WHITE + goal[i] * (GOAL - WHITE);
            let fraction = (background - luma(pixel)) / (background - BLOCK);
            if fraction > MINIMUM_FRACTION {
                layer.fractions[i] = fraction.min(1.0);
                layer.pixels.push(i);
            }
        }
        layer
    }

    fn empty() -> Self {
        Self {
            fractions: vec![0.0; SIDE * SIDE],
            hidden: vec![false; SIDE * SIDE],
            pixels: Vec::with_capacity(512),
        }
    }

    /// Marks a pixel and its neighbours as hidden.
    fn hide_around(&mut self, at: usize) {
        for at in around(at, 1) {
            self.hidden[at] = true;
        }
    }
}

/// Brightness of a colour (BT.601), 0 to 255.
const fn luma([red, green, blue]: [u8; 3]) -> f32 {
    0.299 * red as f32 + 0.587 * green as f32 + 0.114 * blue as f32
}

/// The pixels at most `reach` columns and rows away from a pixel.
fn around(at: usize, reach: usize) -> impl Iterator<Item = usize> {
    let (row, column) = (at / SIDE, at % SIDE);
    let columns = column.saturating_sub(reach)..=(column + reach).min(SIDE - 1);
    (row.saturating_sub(reach)..=(row + reach).min(SIDE - 1))
        .flat_map(move |y| columns.clone().map(move |x| y * SIDE + x))
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
