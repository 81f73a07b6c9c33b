//! Filled polygons, discs and lines with the same pixels as pygame 2.6.1, clipped to the canvas.

use re4_geometry::Point2;

use super::{Canvas, SIDE};

/// A pixel inside or outside of the canvas; y points down.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Pixel {
    pub(super) x: i64,
    pub(super) y: i64,
}

impl Pixel {
    pub(super) const fn new(x: i64, y: i64) -> Self {
        Self { x, y }
    }
}

/// Coordinates are clamped to this value: it is far outside of the canvas, and products of such coordinates do not overflow.
const FAR: f64 = 1e6;

/// The nearest pixel; halves are rounded to even, as in Python. NaN is mapped far outside.
pub(super) fn pixel(point: Point2) -> Pixel {
    let nearest = |v: f64| {
        if v.is_nan() {
            FAR
        } else {
            v.round_ties_even().clamp(-FAR, FAR)
        }
    };
    Pixel::new(nearest(point.x) as i64, nearest(point.y) as i64)
}

pub(super) fn pixels(points: &[Point2; 4]) -> [Pixel; 4] {
    points.map(pixel)
}

const LAST: i64 = SIDE as i64 - 1;

/// The start of a thick line inside the canvas: `from` itself, or the point where the line crosses the border, which is one
/// pixel past the last row and column.
///
/// Returns `None` for a line that does not meet the canvas.
fn entry(from: Pixel, to: Pixel) -> Option<Pixel> {
    const BORDER: i64 = SIDE as i64;
    let missed = |a: i64, b: i64| (a < 0 && b < 0) || (a > BORDER && b > BORDER);
    if missed(from.x, to.x) || missed(from.y, to.y) {
        return None;
    }
    let inside = |v: f64| (0.0..=BORDER as f64).contains(&v);
    let (dx, dy) = (to.x - from.x, to.y - from.y);
    let (mut at, mut exact) = (from, (from.x as f64, from.y as f64));
    if !inside(exact.0) && dx != 0 {
        at.x = from.x.clamp(0, BORDER);
        let across = ((at.x - from.x) * dy) as f64 / dx as f64;
        // Halves of the distance across are rounded away from zero, in both directions.
        at.y = from.y + across.round() as i64;
        exact = (at.x as f64, from.y as f64 + across);
    }
    if !inside(exact.1) && dy != 0 {
        at.y = if exact.1 < 0.0 { 0 } else { BORDER };
        let across = ((at.y - from.y) * dx) as f64 / dy as f64;
        at.x = from.x + across.round() as i64;
        exact = (from.x as f64 + across, at.y as f64);
    }
    // A line that passes near a corner of the canvas may miss it.
    (inside(exact.0) && inside(exact.1)).then_some(at)
}

impl Canvas {
    fn at(&mut self, x: i64, y: i64) -> Option<&mut [u8; 3]> {
        let inside = (0..=LAST).contains(&x) && (0..=LAST).contains(&y);
        inside.then(|| &mut self.pixels[y as usize * SIDE + x as usize])
    }

    /// Colours the pixels from `a` to `b`, both included, in either order.
    fn span(&mut self, a: i64, b: i64, y: i64, colour: [u8; 3]) {
        let (first, last) = (a.min(b).max(0), a.max(b).min(LAST));
        if first <= last && (0..=LAST).contains(&y) {
            let row = y as usize * SIDE;
            self.pixels[row + first as usize..=row + last as usize].fill(colour);
        }
    }

    /// Fills a quadrilateral, scan line by scan line, between pairs of crossings of its edges.
    ///
    /// An edge includes its upper end but not its lower one, except on the lowest scan line. Crossings are truncated to
    /// whole pixels. A horizontal edge between the uppermost and the lowest scan line is filled separately.
    pub(super) fn fill(&mut self, corners: &[Pixel; 4], colour: [u8; 3]) {
        let edges = std::array::from_fn::<_, 4, _>(|i| {
            let (p, q) = (corners[i], corners[(i + 1) % 4]);
            if p.y <= q.y { (p, q) } else { (q, p) }
        });
        let top = corners.iter().fold(i64::MAX, |minimum, p| minimum.min(p.y));
        let bottom = corners.iter().fold(i64::MIN, |maximum, p| maximum.max(p.y));
        if top == bottom {
            let left = corners.iter().fold(i64::MAX, |minimum, p| minimum.min(p.x));
            let right = corners.iter().fold(i64::MIN, |maximum, p| maximum.max(p.x));
            return self.span(left, right, top, colour);
        }
        for y in top.max(0)..=bottom.min(LAST) {
            let mut crossings = [0; 4];
            let mut count = 0;
            for (upper, lower) in edges {
                if upper.y < lower.y && upper.y <= y && (y < lower.y || (y == bottom && lower.y == bottom)) {
                    let height = lower.y - upper.y;
                    // One fraction, truncated towards zero, which is to the left within the canvas.
                    crossings[count] = ((y - upper.y) * (lower.x - upper.x) + upper.x * height) / height;
                    count += 1;
                }
            }
            crossings[..count].sort_unstable();
            for pair in crossings[..count].chunks_exact(2) {
                self.span(pair[0], pair[1], y, colour);
            }
        }
        for (a, b) in edges {
            if a.y == b.y && top < a.y && a.y < bottom {
                self.span(a.x, b.x, a.y, colour);
            }
        }
    }

    /// A disc by the midpoint algorithm. Its width is even: it extends one pixel less to the right and down.
    pub(super) fn disc(&mut self, centre: Pixel, radius: i64, colour: [u8; 3]) {
        let (mut x, mut y, mut error) = (0, radius, 1 - radius);
        while x < y {
            if error >= 0 {
                y -= 1;
                error -= 2 * y;
            }
            x += 1;
            error += 2 * x + 1;
            for (half_width, row) in [(x, y), (y, x)] {
                let (left, right) = (centre.x - half_width, centre.x + half_width - 1);
                self.span(left, right, centre.y - row, colour);
                self.span(left, right, centre.y + row - 1, colour);
            }
        }
    }

    /// A line by Bresenham's algorithm, restarted where it enters the canvas. It is `width` (even) pixels wide, along x if it is
    /// steep, else along y.
    pub(super) fn thick_line(&mut self, from: Pixel, to: Pixel, width: i64, colour: [u8; 3]) {
        let (dx, dy) = ((to.x - from.x).abs(), (to.y - from.y).abs());
        let (step_x, step_y) = ((to.x - from.x).signum(), (to.y - from.y).signum());
        let half = width / 2;
        let steep = dx <= dy;
        let mut error = (if dx > dy { dx } else { -dy }) / 2;
        let Some(mut at) = entry(from, to) else {
            return;
        };
        // One step per remaining pixel along the line's longer direction.
        let steps = if steep {
            (to.y - at.y).abs()
        } else {
            (to.x - at.x).abs()
        };
        for _ in 0..=steps {
            if steep {
                self.span(at.x - half + 1, at.x + half, at.y, colour);
            } else {
                for y in at.y - half + 1..=at.y + half {
                    self.span(at.x, at.x, y, colour);
                }
            }
            let before = error;
            if before > -dx {
                error -= dy;
                at.x += step_x;
            }
            if before < dy {
                error += dx;
                at.y += step_y;
            }
        }
    }

    /// An anti-aliased line: at each step along its longer direction, two pixels get the colour, weighted by their distances from
    /// the line.
    ///
    /// The distances are single-precision sums that start one pixel outside of the canvas, as in pygame: the point where a sum
    /// passes a power of two determines its last bits, and so to which of two values a blend is truncated.
    pub(super) fn smooth_line(&mut self, a: Pixel, b: Pixel, colour: [u8; 3]) {
        let steep = (b.x - a.x).abs() < (b.y - a.y).abs();
        let along_first = |p: Pixel| if steep { (p.y, p.x) } else { (p.x, p.y) };
        let ((from, from_across), (to, to_across)) = {
            let (p, q) = (along_first(a), along_first(b));
            if q.0 < p.0 { (q, p) } else { (p, q) }
        };
        let mut blend = |along: i64, across: i64, weight: f32| {
            let (x, y) = if steep { (across, along) } else { (along, across) };
            if let Some(pixel) = self.at(x, y) {
                for (old, new) in pixel.iter_mut().zip(colour) {
                    *old = (weight * f32::from(new) + (1.0 - weight) * f32::from(*old)) as u8;
                }
            }
        };
        blend(from, from_across, 1.0);
        if from == to {
            return;
        }
        let slope = (to_across - from_across) as f32 / (to - from) as f32;
        let mut across = (from_across + 1) as f32;
        let mut first = from + 1;
        // A line that comes from outside of the canvas starts one pixel before the border, counted as above.
        let border = if slope < 0.0 { SIDE as f32 + 1.0 } else { 0.0 };
        if (slope < 0.0 && across > border) || (slope > 0.0 && across < border) {
            let start = from as f32 + (border - across) / slope;
            let whole = start.trunc();
            across = border + slope * (whole - start);
            first = whole as i64 + 1;
        }
        for along in first..to {
            across += slope;
            let lower = across.floor();
            let fraction = across - lower;
            blend(along, lower as i64 - 1, 1.0 - fraction);
            blend(along, lower as i64, fraction);
        }
        blend(to, to_across, 1.0);
    }
}
