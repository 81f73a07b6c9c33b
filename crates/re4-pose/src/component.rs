//! Connected regions of a mask.

use re4_geometry::Point2;

use crate::image::{SIDE, world};

/// Shares of at least this are part of a region; lesser ones only at its rim.
const INSIDE: f32 = 0.5;

/// A region of a mask.
pub(crate) struct Region {
    /// Area in image pixels: the sum of the shares, those at the rim included.
    pub(crate) area: f64,
    /// Centroid, in world pixels, weighted by the shares.
    pub(crate) centroid: Point2,
    /// The mask with this region alone.
    pub(crate) mask: Vec<f32>,
}

/// The largest region of `pixels` (those with any share) that hang together by sides or corners, with the soft pixels at its
/// rim; the first from the top if several are as large. None when no pixel is inside of a region.
pub(crate) fn largest(share: &[f32], pixels: &[usize]) -> Option<Region> {
    let mut label = vec![0_u16; SIDE * SIDE];
    let mut waiting = Vec::new();
    let mut best: Option<(usize, u16)> = None;
    let mut regions = 0;
    for &start in pixels {
        if share[start] < INSIDE || label[start] != 0 {
            continue;
        }
        regions += 1;
        let mut size = 0;
        label[start] = regions;
        waiting.push(start);
        while let Some(at) = waiting.pop() {
            size += 1;
            for next in neighbours(at) {
                if share[next] >= INSIDE && label[next] == 0 {
                    label[next] = regions;
                    waiting.push(next);
                }
            }
        }
        if best.is_none_or(|(most, _)| size > most) {
            best = Some((size, regions));
        }
    }
    let (_, chosen) = best?;
    let rim = |at: usize| label[at] == 0 && neighbours(at).any(|next| label[next] == chosen);
    let mut mask = vec![0.0; SIDE * SIDE];
    let mut own = Vec::with_capacity(pixels.len());
    for &at in pixels.iter().filter(|&&at| label[at] == chosen || rim(at)) {
        mask[at] = share[at];
        own.push(at);
    }
    Some(Region {
        area: own.iter().map(|&at| f64::from(share[at])).sum(),
        centroid: centroid(share, &own),
        mask,
    })
}

/// Centroid of some pixels of a mask, in world pixels; not a number where there are none.
pub(crate) fn centroid(share: &[f32], pixels: &[usize]) -> Point2 {
    let (mut area, mut moment) = (0.0, Point2::zeros());
    for &at in pixels {
        let weight = f64::from(share[at]);
        area += weight;
        moment += weight * place(at);
    }
    moment / area
}

/// Centre of a pixel, in the world.
fn place(at: usize) -> Point2 {
    Point2::new(world((at % SIDE) as f64), world((at / SIDE) as f64))
}

/// The pixel itself and those that touch it.
fn neighbours(at: usize) -> impl Iterator<Item = usize> {
    let (row, column) = (at / SIDE, at % SIDE);
    (row.saturating_sub(1)..=(row + 1).min(SIDE - 1))
        .flat_map(move |y| (column.saturating_sub(1)..=(column + 1).min(SIDE - 1)).map(move |x| y * SIDE + x))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn mask(rows: &[(usize, usize, f32)]) -> (Vec<f32>, Vec<usize>) {
        let mut share = vec![0.0; SIDE * SIDE];
        for &(row, column, value) in rows {
            share[row * SIDE + column] = value;
        }
        let pixels = (0..share.len()).filter(|&at| share[at] > 0.0).collect();
        (share, pixels)
    }

    #[test]
    fn the_largest_region_is_taken_with_its_soft_rim() {
        // Three pixels that touch by corners, a soft one beside them, two pixels far away, a soft one alone.
        let (share, pixels) = mask(&[
            (10, 10, 1.0),
            (11, 11, 0.5),
            (12, 10, 0.75),
            (12, 11, 0.25),
            (40, 40, 1.0),
            (40, 41, 1.0),
            (70, 70, 0.25),
        ]);
        let region = largest(&share, &pixels).unwrap();
        assert_eq!(region.area, 2.5);
        let expected = (place(10 * SIDE + 10)
            + 0.5 * place(11 * SIDE + 11)
            + 0.75 * place(12 * SIDE + 10)
            + 0.25 * place(12 * SIDE + 11))
            / 2.5;
        assert!((region.centroid - expected).norm() < 1e-9);
        assert_eq!(region.mask.iter().filter(|value| **value > 0.0).count(), 4);
    }

    #[test]
    fn of_two_as_large_the_first_from_the_top_and_of_none_nothing() {
        let (share, pixels) = mask(&[(50, 3, 1.0), (5, 90, 1.0)]);
        assert_eq!(largest(&share, &pixels).unwrap().centroid, place(5 * SIDE + 90));
        let (share, pixels) = mask(&[(50, 3, 0.4)]);
        assert!(largest(&share, &pixels).is_none());
    }

    #[test]
    fn regions_do_not_hang_together_round_the_border() {
        let (share, pixels) = mask(&[(20, SIDE - 1, 1.0), (21, 0, 1.0), (21, 1, 1.0)]);
        assert_eq!(largest(&share, &pixels).unwrap().area, 2.0);
    }
}
