//! Connected components of a mask.

use re4_geometry::Point2;

use crate::image::{SIDE, world};

/// Pixels with at least this fraction are connected to each other; pixels with less belong to a region only at its rim.
const INSIDE: f32 = 0.5;

/// A connected component of a mask.
pub(crate) struct Region {
    /// Area in image pixels: the sum of the fractions, including those at the rim.
    pub(crate) area: f64,
    /// Centroid, in world pixels, weighted by the fractions.
    pub(crate) centroid: Point2,
    /// The mask of this region only.
    pub(crate) mask: Vec<f32>,
}

/// The largest 8-connected region of `pixels` (those with a positive fraction), including the soft pixels at its rim; the first
/// one from the top if several are equally large. Returns `None` if no pixel has a fraction of at least `INSIDE`.
pub(crate) fn largest(fractions: &[f32], pixels: &[usize]) -> Option<Region> {
    let mut label = vec![0_u16; SIDE * SIDE];
    let mut stack = Vec::new();
    let mut best: Option<(usize, u16)> = None;
    let mut regions = 0;
    for &start in pixels {
        if fractions[start] < INSIDE || label[start] != 0 {
            continue;
        }
        regions += 1;
        let mut size = 0;
        label[start] = regions;
        stack.push(start);
        while let Some(at) = stack.pop() {
            size += 1;
            for next in neighbours(at) {
                if fractions[next] >= INSIDE && label[next] == 0 {
                    label[next] = regions;
                    stack.push(next);
                }
            }
        }
        if best.is_none_or(|(largest, _)| size > largest) {
            best = Some((size, regions));
        }
    }
    let (_, chosen) = best?;
    let rim = |at: usize| label[at] == 0 && neighbours(at).any(|next| label[next] == chosen);
    let mut mask = vec![0.0; SIDE * SIDE];
    let mut members = Vec::with_capacity(pixels.len());
    for &at in pixels.iter().filter(|&&at| label[at] == chosen || rim(at)) {
        mask[at] = fractions[at];
        members.push(at);
    }
    Some(Region {
        area: members.iter().map(|&at| f64::from(fractions[at])).sum(),
        centroid: centroid(fractions, &members),
        mask,
    })
}

/// Centroid of the given pixels of a mask, in world pixels; NaN if there are none.
pub(crate) fn centroid(fractions: &[f32], pixels: &[usize]) -> Point2 {
    let (mut area, mut moment) = (0.0, Point2::zeros());
    for &at in pixels {
        let weight = f64::from(fractions[at]);
        area += weight;
        moment += weight * position(at);
    }
    moment / area
}

/// World position of a pixel's centre.
fn position(at: usize) -> Point2 {
    Point2::new(world((at % SIDE) as f64), world((at / SIDE) as f64))
}

/// The pixel itself and its neighbours by edges and corners.
fn neighbours(at: usize) -> impl Iterator<Item = usize> {
    let (row, column) = (at / SIDE, at % SIDE);
    (row.saturating_sub(1)..=(row + 1).min(SIDE - 1))
        .flat_map(move |y| (column.saturating_sub(1)..=(column + 1).min(SIDE - 1)).map(move |x| y * SIDE + x))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn mask(rows: &[(usize, usize, f32)]) -> (Vec<f32>, Vec<usize>) {
        let mut fractions = vec![0.0; SIDE * SIDE];
        for &(row, column, value) in rows {
            fractions[row * SIDE + column] = value;
        }
        let pixels = (0..fractions.len()).filter(|&at| fractions[at] > 0.0).collect();
        (fractions, pixels)
    }

    #[test]
    fn the_largest_region_includes_its_soft_rim() {
        // Three pixels that touch by corners, a soft one next to them, two pixels far away, and an isolated soft one.
        let (fractions, pixels) = mask(&[
            (10, 10, 1.0),
            (11, 11, 0.5),
            (12, 10, 0.75),
            (12, 11, 0.25),
            (40, 40, 1.0),
            (40, 41, 1.0),
            (70, 70, 0.25),
        ]);
        let region = largest(&fractions, &pixels).unwrap();
        assert_eq!(region.area, 2.5);
        let expected = (position(10 * SIDE + 10)
            + 0.5 * position(11 * SIDE + 11)
            + 0.75 * position(12 * SIDE + 10)
            + 0.25 * position(12 * SIDE + 11))
            / 2.5;
        assert!((region.centroid - expected).norm() < 1e-9);
        assert_eq!(region.mask.iter().filter(|value| **value > 0.0).count(), 4);
    }

    #[test]
    fn ties_go_to_the_first_region_from_the_top() {
        let (fractions, pixels) = mask(&[(50, 3, 1.0), (5, 90, 1.0)]);
        assert_eq!(largest(&fractions, &pixels).unwrap().centroid, position(5 * SIDE + 90));
        let (fractions, pixels) = mask(&[(50, 3, 0.4)]);
        assert!(largest(&fractions, &pixels).is_none());
    }

    #[test]
    fn regions_do_not_wrap_around_the_border() {
        let (fractions, pixels) = mask(&[(20, SIDE - 1, 1.0), (21, 0, 1.0), (21, 1, 1.0)]);
        assert_eq!(largest(&fractions, &pixels).unwrap().area, 2.0);
    }
}
