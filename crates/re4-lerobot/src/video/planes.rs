//! Decoded frames, and their conversion to RGB.

use std::fmt;

/// How many chroma samples there are per luma sample.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Chroma {
    /// None: a gray image.
    Gray,
    /// One per 2 x 2.
    Half,
    /// One per 2 x 1.
    HalfWidth,
}

/// The matrix between YCbCr and RGB.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Matrix {
    /// ITU-R BT.601, also for streams that do not state a matrix.
    Bt601,
    /// ITU-R BT.709.
    Bt709,
}

/// How the planes of a stream are converted to RGB. The chroma sample of a pixel is the nearest one.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct Color {
    /// The matrix.
    pub matrix: Matrix,
    /// Whether values use all of 0 to 255; otherwise black is 16 and white 235.
    pub full_range: bool,
}

/// A decoded frame with 8 bits per sample. Rows follow each other without padding.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Planes {
    /// Pixels of a row.
    pub width: usize,
    /// Rows of pixels.
    pub height: usize,
    /// The size of the chroma planes.
    pub chroma: Chroma,
    /// How to convert it to RGB.
    pub color: Color,
    /// Luma.
    pub y: Vec<u8>,
    /// Blue difference; empty for a gray image.
    pub u: Vec<u8>,
    /// Red difference; empty for a gray image.
    pub v: Vec<u8>,
}

/// In words, with the choice of the chroma sample.
impl fmt::Display for Color {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let matrix = match self.matrix {
            Matrix::Bt601 => "BT.601",
            Matrix::Bt709 => "BT.709",
        };
        let range = if self.full_range { "full" } else { "limited" };
        write!(f, "{matrix}, {range} range, nearest chroma")
    }
}

impl Color {
    /// The color of a stream by its matrix coefficients (ISO/IEC 23091-2, table 4).
    ///
    /// # Errors
    /// Describes a matrix that is not supported.
    pub(super) fn of(matrix_coefficients: u32, full_range: bool) -> Result<Self, String> {
        let matrix = match matrix_coefficients {
            // 2 is "unspecified", which is what LeRobot's encoders write; 5 and 6 are both BT.601.
            2 | 5 | 6 => Matrix::Bt601,
            1 => Matrix::Bt709,
            other => return Err(format!("its matrix coefficients are number {other}")),
        };
        Ok(Self { matrix, full_range })
    }

    /// Kr and Kb.
    fn weights(self) -> (f64, f64) {
        match self.matrix {
            Matrix::Bt601 => (0.299, 0.114),
            Matrix::Bt709 => (0.2126, 0.0722),
        }
    }
}

/// Rows and columns of a chroma plane.
pub(super) fn chroma_size(chroma: Chroma, width: usize, height: usize) -> (usize, usize) {
    match chroma {
        Chroma::Gray => (0, 0),
        Chroma::Half => (width.div_ceil(2), height.div_ceil(2)),
        Chroma::HalfWidth => (width.div_ceil(2), height),
    }
}

/// Bits after the binary point of the coefficients of the conversion.
const BITS: u32 = 16;

impl Planes {
    /// Whether the planes have the sizes that width, height and chroma demand.
    pub(super) fn is_whole(&self) -> bool {
        let (width, height) = chroma_size(self.chroma, self.width, self.height);
        self.y.len() == self.width * self.height && self.u.len() == width * height && self.v.len() == width * height
    }

    /// Appends the RGB bytes, pixel by pixel, top row first. Integer arithmetic: the same bytes on every machine.
    pub fn append_rgb(&self, rgb: &mut Vec<u8>) {
        let (kr, kb) = self.color.weights();
        let kg = 1.0 - kr - kb;
        let (black, luma, chroma) = if self.color.full_range {
            (0, 1.0, 1.0)
        } else {
            (16, 255.0 / 219.0, 255.0 / 224.0)
        };
        let fixed = |value: f64| (value * f64::from(1 << BITS)).round() as i32;
        let luma = fixed(luma);
        let red = fixed(2.0 * (1.0 - kr) * chroma);
        let blue = fixed(2.0 * (1.0 - kb) * chroma);
        let green_u = fixed(2.0 * (1.0 - kb) * kb / kg * chroma);
        let green_v = fixed(2.0 * (1.0 - kr) * kr / kg * chroma);
        let byte = |value: i32| (value >> BITS).clamp(0, 255) as u8;
        let half = 1 << (BITS - 1);
        let start = rgb.len();
        rgb.resize(start + 3 * self.y.len(), 0);
        let width = self.width.max(1);
        let (across, _) = chroma_size(self.chroma, self.width, self.height);
        let gray = vec![128_u8; width.div_ceil(2)];
        let rows = self.y.chunks_exact(width).zip(rgb[start..].chunks_exact_mut(3 * width));
        for (row, (ys, pixels)) in rows.enumerate() {
            let from = match self.chroma {
                Chroma::Gray => 0,
                Chroma::Half => row / 2 * across,
                Chroma::HalfWidth => row * across,
            };
            let of = |plane| self.chroma_row(plane, from, across).unwrap_or(gray.as_slice());
            let pairs = ys.chunks(2).zip(pixels.chunks_mut(6));
            for ((ys, pixels), (&u, &v)) in pairs.zip(of(self.u.as_slice()).iter().zip(of(self.v.as_slice()))) {
                let (u, v) = (i32::from(u) - 128, i32::from(v) - 128);
                let (to_red, to_green, to_blue) = (red * v, green_u * u + green_v * v, blue * u);
                for (&y, pixel) in ys.iter().zip(pixels.chunks_exact_mut(3)) {
                    let y = (i32::from(y) - black) * luma + half;
                    pixel.copy_from_slice(&[byte(y + to_red), byte(y - to_green), byte(y + to_blue)]);
                }
            }
        }
    }

    /// A row of a chroma plane; `None` for a gray image.
    fn chroma_row<'a>(&self, plane: &'a [u8], from: usize, across: usize) -> Option<&'a [u8]> {
        match self.chroma {
            Chroma::Gray => None,
            Chroma::Half | Chroma::HalfWidth => plane.get(from..from + across),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn plain(y: u8, u: u8, v: u8, color: Color) -> Planes {
        Planes {
            width: 3,
            height: 3,
            chroma: Chroma::Half,
            color,
            y: vec![y; 9],
            u: vec![u; 4],
            v: vec![v; 4],
        }
    }

    /// The definition in floating point.
    fn reference(y: u8, u: u8, v: u8, color: Color) -> [f64; 3] {
        let (kr, kb) = color.weights();
        let (y, u, v) = (f64::from(y), f64::from(u) - 128.0, f64::from(v) - 128.0);
        let (y, u, v) = if color.full_range {
            (y / 255.0, u / 255.0, v / 255.0)
        } else {
            ((y - 16.0) / 219.0, u / 224.0, v / 224.0)
        };
        let (r, b) = (y + 2.0 * (1.0 - kr) * v, y + 2.0 * (1.0 - kb) * u);
        [r, (y - kr * r - kb * b) / (1.0 - kr - kb), b].map(|value| 255.0 * value.clamp(0.0, 1.0))
    }

    #[test]
    fn rgb_follows_the_definition() {
        for color in [(2, false), (6, true), (1, false), (1, true)].map(|(m, full)| Color::of(m, full).unwrap()) {
            for y in (0..=255).step_by(15) {
                for u in (0..=255).step_by(17) {
                    for v in (0..=255).step_by(51) {
                        let planes = plain(y, u, v, color);
                        assert!(planes.is_whole());
                        let mut rgb = Vec::new();
                        planes.append_rgb(&mut rgb);
                        assert_eq!(rgb.len(), 27);
                        for (found, expected) in rgb.iter().zip(reference(y, u, v, color).into_iter().cycle()) {
                            let off = (f64::from(*found) - expected).abs();
                            assert!(off <= 0.51, "{y} {u} {v} {color:?}: {found} for {expected}");
                        }
                    }
                }
            }
        }
        assert!(Color::of(0, false).is_err() && Color::of(9, true).is_err());
    }

    #[test]
    fn each_pixel_takes_the_nearest_chroma() {
        let color = Color::of(2, false).unwrap();
        let mut planes = plain(128, 128, 128, color);
        planes.u = vec![128, 200, 128, 128];
        let mut rgb = Vec::new();
        planes.append_rgb(&mut rgb);
        let gray = |pixel: &[u8]| pixel[0] == pixel[2];
        let tinted: Vec<usize> = (0..9).filter(|&i| !gray(&rgb[3 * i..3 * i + 3])).collect();
        assert_eq!(tinted, [2, 5]);
    }
}
