//! Overlays lines on an image, scales it down, and reduces its colours to a palette.

use std::collections::{BTreeMap, HashMap, HashSet};

use re4_geometry::Point2;

/// Returns the indices of the pixels, in a square of `side` pixels, that are within `radius` of a polyline, in increasing order
/// and without duplicates.
///
/// Points that are not finite are skipped, together with the lines to and from them.
pub(super) fn line_pixels(path: &[Point2], radius: f64, side: usize) -> Vec<usize> {
    let mut pixels = Vec::new();
    let range = |a: f64, b: f64| {
        let clamp = |v: f64| v.clamp(0.0, side as f64) as usize;
        clamp((a.min(b) - radius).floor())..clamp((a.max(b) + radius).ceil() + 1.0)
    };
    for pair in path.windows(2) {
        let (a, b) = (pair[0], pair[1]);
        if ![a.x, a.y, b.x, b.y].iter().all(|v| v.is_finite()) {
            continue;
        }
        let line = b - a;
        let squared = line.dot(&line).max(f64::MIN_POSITIVE);
        for y in range(a.y, b.y) {
            for x in range(a.x, b.x) {
                let to = Point2::new(x as f64, y as f64) - a;
                let along = (to.dot(&line) / squared).clamp(0.0, 1.0);
                if (to - line * along).norm() <= radius {
                    pixels.push(y * side + x);
                }
            }
        }
    }
    pixels.sort_unstable();
    pixels.dedup();
    pixels
}

/// Scales square RGB images down. Every pixel is the mean of the area that it covers, computed in integers.
pub(super) struct Shrink {
    from: usize,
    /// For each pixel of the small side, the first pixel of the large side that it covers, and the weights of that and the
    /// following pixels. Weights add up to `from`.
    taps: Vec<(usize, Vec<u32>)>,
    narrow: Vec<u32>,
}

impl Shrink {
    /// Prepares scaling from squares of `from` pixels to squares of `to` pixels, where `to` is at most `from`.
    pub(super) fn new(from: usize, to: usize) -> Self {
        // With the side divided into from * to units, a large pixel is `to` units wide, and a small one `from` units.
        let overlap = |small: usize, large: usize| {
            let (start, end) = (
                (small * from).max(large * to),
                ((small + 1) * from).min((large + 1) * to),
            );
            (end - start) as u32
        };
        let taps = (0..to)
            .map(|small| {
                let (first, end) = (small * from / to, ((small + 1) * from).div_ceil(to));
                (first, (first..end).map(|large| overlap(small, large)).collect())
            })
            .collect();
        Self {
            from,
            taps,
            narrow: Vec::new(),
        }
    }

    /// Replaces `small` by the scaled `image`.
    pub(super) fn apply(&mut self, image: &[u8], small: &mut Vec<u8>) {
        small.clear();
        if self.taps.len() == self.from {
            return small.extend_from_slice(image);
        }
        let whole = (self.from * self.from) as u32;
        for (first_row, row_weights) in &self.taps {
            // Sums over the rows, then over the columns. A sum is at most 255 * from * from, which fits into 32 bits for from <=
            // 4096.
            self.narrow.clear();
            self.narrow.resize(3 * self.from, 0);
            for (row, weight) in image.chunks_exact(3 * self.from).skip(*first_row).zip(row_weights) {
                for (sum, value) in self.narrow.iter_mut().zip(row) {
                    *sum += weight * u32::from(*value);
                }
            }
            for (first, weights) in &self.taps {
                for channel in 0..3 {
                    let values = self.narrow[3 * first + channel..].iter().step_by(3);
                    let sum: u32 = values.zip(weights).map(|(value, weight)| value * weight).sum();
                    small.push(((sum + whole / 2) / whole) as u8);
                }
            }
        }
    }
}

/// Returns at most `count` colours that represent RGB pixels (median cut).
///
/// The box of colours with the largest product of its number of pixels and the square of its longest side is repeatedly cut in
/// two, at the median of that side. The result has the mean colour of each box.
pub(super) fn median_cut(pixels: &[u8], count: usize) -> Vec<[u8; 3]> {
    let mut counted: BTreeMap<[u8; 3], u64> = BTreeMap::new();
    for pixel in pixels.as_chunks::<3>().0 {
        *counted.entry(*pixel).or_default() += 1;
    }
    let mut boxes: Vec<Vec<([u8; 3], u64)>> = vec![counted.into_iter().collect()];
    boxes.retain(|colours| !colours.is_empty());
    while boxes.len() < count {
        // The length of the longest side of a box, and its channel.
        let longest = |colours: &[([u8; 3], u64)]| {
            let side = |channel: usize| {
                let values = || colours.iter().map(|(colour, _)| colour[channel]);
                values().max().unwrap_or(0) - values().min().unwrap_or(0)
            };
            (0..3).map(|channel| (side(channel), channel)).max().unwrap_or((0, 0))
        };
        let weight = |colours: &[([u8; 3], u64)]| colours.iter().map(|(_, pixels)| pixels).sum::<u64>();
        let priority = |colours: &[([u8; 3], u64)]| weight(colours) * u64::from(longest(colours).0).pow(2);
        let Some((place, _)) = boxes.iter().enumerate().max_by_key(|(_, colours)| priority(colours)) else {
            break;
        };
        let mut colours = boxes.swap_remove(place);
        let (side, channel) = longest(&colours);
        if side == 0 {
            boxes.push(colours);
            break;
        }
        colours.sort_by_key(|(colour, _)| (colour[channel], *colour));
        let half = weight(&colours) / 2;
        let mut before = 0;
        let middle = colours.iter().position(|(_, pixels)| {
            before += pixels;
            before > half
        });
        // The clamp leaves at least one colour in each part.
        let rest = colours.split_off(middle.unwrap_or(0).clamp(1, colours.len() - 1));
        boxes.extend([colours, rest]);
    }
    let mean = |colours: &Vec<([u8; 3], u64)>| {
        let whole: u64 = colours.iter().map(|(_, pixels)| pixels).sum();
        [0, 1, 2].map(|channel| {
            let sum: u64 = colours
                .iter()
                .map(|(colour, pixels)| u64::from(colour[channel]) * pixels)
                .sum();
            ((sum + whole / 2) / whole) as u8
        })
    };
    boxes.iter().map(mean).collect()
}

/// A palette of at most 255 colours, followed by the transparent colour.
pub(super) struct Palette {
    colours: Vec<[u8; 3]>,
    nearest: HashMap<[u8; 3], u8>,
}

/// Maximum number of colours before the transparent one.
const MAX_COLOURS: usize = 255;

impl Palette {
    /// Makes a palette of the colours in `exact` and `shapes`, and of blends of every two colours in `shapes` in steps of a
    /// quarter, which occur at the antialiased edges of shapes.
    pub(super) fn new(exact: &[[u8; 3]], shapes: &[[u8; 3]]) -> Self {
        let mut colours: Vec<[u8; 3]> = exact.iter().chain(shapes).copied().collect();
        for (i, a) in shapes.iter().enumerate() {
            for b in &shapes[i + 1..] {
                for quarters in 1..4 {
                    let mix = |c: usize| (u32::from(a[c]) * (4 - quarters) + u32::from(b[c]) * quarters + 2) / 4;
                    colours.push([0, 1, 2].map(|channel| mix(channel) as u8));
                }
            }
        }
        let mut seen = HashSet::new();
        colours.retain(|colour| seen.insert(*colour));
        colours.truncate(MAX_COLOURS);
        Self {
            colours,
            nearest: HashMap::new(),
        }
    }

    /// Returns red, green and blue of all palette entries.
    pub(super) fn bytes(&self) -> Vec<u8> {
        let mut bytes = self.colours.as_flattened().to_vec();
        bytes.extend([0; 3]);
        bytes
    }

    /// Returns the index of the transparent colour.
    pub(super) fn transparent(&self) -> u8 {
        self.colours.len() as u8
    }

    /// Returns the index of the nearest colour; of several, the first one.
    pub(super) fn of(&mut self, colour: [u8; 3]) -> u8 {
        let colours = &self.colours;
        *self.nearest.entry(colour).or_insert_with(|| {
            let distance = |other: &[u8; 3]| -> u32 {
                let part = |c: usize| u32::from(colour[c].abs_diff(other[c])).pow(2);
                part(0) + part(1) + part(2)
            };
            let minimum = colours.iter().enumerate().min_by_key(|(_, other)| distance(other));
            minimum.map_or(0, |(place, _)| place as u8)
        })
    }

    /// Appends the palette indices of RGB pixels.
    pub(super) fn index(&mut self, pixels: &[u8], indices: &mut Vec<u8>) {
        let (mut colour, mut index) = ([0; 3], self.of([0; 3]));
        indices.extend(pixels.as_chunks::<3>().0.iter().map(|pixel| {
            // Most pixels have the colour of the previous one, so that the map is rarely needed.
            if *pixel != colour {
                (colour, index) = (*pixel, self.of(*pixel));
            }
            index
        }));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_have_the_requested_width_and_end_at_the_border() {
        let at = |x: f64, y: f64| Point2::new(x, y);
        let pixels = line_pixels(&[at(2.0, 4.0), at(6.0, 4.0)], 1.0, 10);
        let expected: Vec<usize> = [(2..=6, 3), (1..=7, 4), (2..=6, 5)]
            .into_iter()
            .flat_map(|(columns, row)| columns.map(move |column| row * 10 + column))
            .collect();
        assert_eq!(pixels, expected);
        assert_eq!(line_pixels(&[at(-50.0, 0.0), at(50.0, 0.0)], 0.5, 4), [0, 1, 2, 3]);
        assert!(line_pixels(&[at(-9.0, 0.0), at(-5.0, 9.0)], 1.0, 4).is_empty());
        assert!(line_pixels(&[at(f64::NAN, 0.0), at(1.0, 1.0)], 1.0, 4).is_empty());
        assert!(line_pixels(&[at(1.0, 1.0)], 1.0, 4).is_empty());
        // A line between equal points is a dot.
        assert_eq!(line_pixels(&[at(1.0, 1.0), at(1.0, 1.0)], 0.9, 4), [5]);
    }

    #[test]
    fn shrinking_takes_means_of_areas() {
        let image: Vec<u8> = (0..16).flat_map(|i| [i * 4, 0, 255]).collect();
        let mut small = Vec::new();
        Shrink::new(4, 4).apply(&image, &mut small);
        assert_eq!(small, image);
        Shrink::new(4, 2).apply(&image, &mut small);
        assert_eq!(small, [10, 0, 255, 18, 0, 255, 42, 0, 255, 50, 0, 255]);
        // From four pixels to three: each covers one and a third; the first red is (0 + 1/3 * 4 + 1/3 * 16 + 1/9 * 20) / (16/9) =
        // 5.
        Shrink::new(4, 3).apply(&image, &mut small);
        assert_eq!((small.len(), small[0], small[2]), (27, 5, 255));
    }

    #[test]
    fn few_colours_are_kept_and_many_are_merged() {
        let few = [[9, 9, 9], [200, 0, 0], [0, 0, 250], [9, 9, 9]];
        let mut kept = median_cut(few.as_flattened(), 8);
        kept.sort_unstable();
        assert_eq!(kept, [[0, 0, 250], [9, 9, 9], [200, 0, 0]]);
        let many: Vec<u8> = (0..=255).flat_map(|i| [i, i, 255 - i]).collect();
        let merged = median_cut(&many, 16);
        assert_eq!(merged.len(), 16);
        for pixel in many.as_chunks::<3>().0 {
            let near = |colour: &&[u8; 3]| colour.iter().zip(pixel).all(|(a, b)| a.abs_diff(*b) <= 16);
            assert!(merged.iter().any(|colour| near(&colour)), "{pixel:?}");
        }
        assert!(median_cut(&[], 4).is_empty());
    }

    #[test]
    fn palette_colours_are_exact_and_others_are_approximated() {
        let (white, black, red) = ([255; 3], [0; 3], [255, 0, 0]);
        let mut palette = Palette::new(&[red], &[white, black]);
        for colour in [white, black, red, [128; 3], [191; 3]] {
            let place = usize::from(palette.of(colour));
            assert_eq!(palette.bytes()[3 * place..3 * place + 3], colour);
        }
        let mut places = Vec::new();
        palette.index(&[255, 255, 255, 255, 255, 254, 0, 0, 0], &mut places);
        assert_eq!(places[0], places[1]);
        assert_ne!(places[0], places[2]);
        assert_eq!(usize::from(palette.transparent()), palette.bytes().len() / 3 - 1);
    }
}
