//! The block's outline: the area of an image that it covers at a pose.

use re4_geometry::{Point2, Pose2};

use crate::image::{SCALE, SIDE, world};

/// The shape of the block in its own frame, in world pixels: a union of rectangles, each rendered with a stroke around it.
#[derive(Debug, Clone, PartialEq)]
pub struct Outline {
    rectangles: Vec<Rectangle>,
    stroke: f64,
    /// Area including the stroke, in image pixels.
    pixels: f64,
    /// Centroid including the stroke, in the block's frame.
    centroid: Point2,
}

/// An axis-aligned rectangle in the block's frame.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Rectangle {
    centre: Point2,
    half: Point2,
}

/// Signed distance of a point to the outline, with its gradient.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Distance {
    /// Distance in world pixels, negative inside.
    pub(crate) value: f64,
    /// Gradient of the distance, in the block's frame.
    pub(crate) gradient: Point2,
}

impl Outline {
    /// The union of axis-aligned rectangles, given by their corners in the block's frame, with a stroke that extends `stroke` px
    /// outside of their edges.
    pub fn new(rectangles: &[[Point2; 4]], stroke: f64) -> Self {
        let rectangles = rectangles
            .iter()
            .map(|corners| {
                let low = corners.iter().fold(corners[0], |low, corner| low.inf(corner));
                let high = corners.iter().fold(corners[0], |high, corner| high.sup(corner));
                Rectangle {
                    centre: 0.5 * (low + high),
                    half: 0.5 * (high - low),
                }
            })
            .collect();
        Self::with_area(rectangles, stroke)
    }

    /// Computes area and centroid by counting grid points that are one world pixel apart.
    fn with_area(rectangles: Vec<Rectangle>, stroke: f64) -> Self {
        let mut outline = Self {
            rectangles,
            stroke,
            pixels: 0.0,
            centroid: Point2::zeros(),
        };
        let reach = outline.reach().ceil() as i32;
        let points = (-reach..reach)
            .flat_map(|x| (-reach..reach).map(move |y| Point2::new(f64::from(x) + 0.5, f64::from(y) + 0.5)));
        let covered: Vec<Point2> = points.filter(|&point| outline.distance(point).value < 0.0).collect();
        outline.pixels = covered.len() as f64 / (SCALE * SCALE);
        outline.centroid = covered.iter().sum::<Point2>() / covered.len().max(1) as f64;
        outline
    }

    /// The same shape without the stroke, which is how the goal is rendered.
    #[must_use]
    pub fn without_stroke(&self) -> Self {
        Self::with_area(self.rectangles.clone(), 0.0)
    }

    /// Corners of the rectangles, in the world frame, for the block at `pose`.
    pub(crate) fn corners(&self, pose: Pose2) -> impl Iterator<Item = Point2> {
        self.rectangles.iter().flat_map(move |r| {
            [(-1.0, -1.0), (-1.0, 1.0), (1.0, -1.0), (1.0, 1.0)]
                .map(|(x, y)| pose.transform_point(r.centre + Point2::new(x * r.half.x, y * r.half.y)))
        })
    }

    /// Centroid including the stroke, in the block's frame, world pixels.
    pub(crate) fn centroid(&self) -> Point2 {
        self.centroid
    }

    /// Maximum distance of a point of the shape from the origin of its frame, including the stroke.
    pub(crate) fn reach(&self) -> f64 {
        self.corners(Pose2::IDENTITY).map(|p| p.norm()).fold(0.0, f64::max) + self.stroke
    }

    /// Area including the stroke, in image pixels.
    pub(crate) fn pixels(&self) -> f64 {
        self.pixels
    }

    /// The values of [`Outline::distance`] without gradients, for points given by their coordinates: without a branch, so that
    /// the compiler vectorises it over a row of pixels.
    pub(crate) fn distances(&self, x: &[f64], y: &[f64], values: &mut [f64]) {
        values.fill(f64::INFINITY);
        for rectangle in &self.rectangles {
            rectangle.lower_to_distances(x, y, values);
        }
        for value in values {
            *value -= self.stroke;
        }
    }

    /// For each of the 96 x 96 pixels of an image, row by row, the fraction that the shape covers at `pose`: 0 to 1, with an edge that is
    /// one pixel wide.
    pub(crate) fn mask(&self, pose: Pose2) -> Vec<f32> {
        let block_from_world = pose.inverse();
        let fraction = |at: usize| {
            let point = Point2::new(world((at % SIDE) as f64), world((at / SIDE) as f64));
            let distance = self.distance(block_from_world.transform_point(point)).value;
            (0.5 - distance / SCALE).clamp(0.0, 1.0) as f32
        };
        (0..SIDE * SIDE).map(fraction).collect()
    }

    /// Signed distance of a point in the block's frame.
    pub(crate) fn distance(&self, point: Point2) -> Distance {
        let mut nearest = Distance {
            value: f64::INFINITY,
            gradient: Point2::zeros(),
        };
        for rectangle in &self.rectangles {
            let distance = rectangle.distance(point);
            if distance.value < nearest.value {
                nearest = distance;
            }
        }
        nearest.value -= self.stroke;
        nearest
    }
}

impl Rectangle {
    /// Lowers each value to the rectangle's distance of its point, if that is smaller.
    fn lower_to_distances(&self, x: &[f64], y: &[f64], values: &mut [f64]) {
        // Plain comparisons compile to single instructions. `f64::min` and `f64::max` do not, because they treat NaN specially.
        let maximum = |a: f64, b: f64| if a > b { a } else { b };
        let minimum = |a: f64, b: f64| if a < b { a } else { b };
        for ((x, y), value) in x.iter().zip(y).zip(values) {
            let excess_x = (x - self.centre.x).abs() - self.half.x;
            let excess_y = (y - self.centre.y).abs() - self.half.y;
            let (outside_x, outside_y) = (maximum(excess_x, 0.0), maximum(excess_y, 0.0));
            let outside = (outside_x * outside_x + outside_y * outside_y).sqrt();
            *value = minimum(*value, outside + minimum(maximum(excess_x, excess_y), 0.0));
        }
    }

    fn distance(&self, point: Point2) -> Distance {
        let from_centre = point - self.centre;
        let sign = Point2::new(1.0_f64.copysign(from_centre.x), 1.0_f64.copysign(from_centre.y));
        let excess = from_centre.abs() - self.half;
        if excess.x > 0.0 && excess.y > 0.0 {
            let value = excess.norm();
            return Distance {
                value,
                gradient: excess.component_mul(&sign) / value,
            };
        }
        if excess.x > excess.y {
            Distance {
                value: excess.x,
                gradient: Point2::new(sign.x, 0.0),
            }
        } else {
            Distance {
                value: excess.y,
                gradient: Point2::new(0.0, sign.y),
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use std::sync::LazyLock;

    use proptest::prelude::*;

    use super::*;

    /// The T of Push-T with a stroke of 2 px.
    static TEE: LazyLock<Outline> = LazyLock::new(|| Outline::new(&re4_sim::tee_rectangles(), 2.0));

    /// Distance to the nearest of many points on the edges of the rectangles, minus the stroke; negative inside.
    fn by_brute_force(point: Point2) -> f64 {
        let mut nearest = f64::INFINITY;
        let mut inside = false;
        for corners in re4_sim::tee_rectangles() {
            let [low, high] = [corners[0].inf(&corners[2]), corners[0].sup(&corners[2])];
            inside |= (0..2).all(|axis| (low[axis]..=high[axis]).contains(&point[axis]));
            for i in 0..4 {
                let (a, b) = (corners[i], corners[(i + 1) % 4]);
                for step in 0..=400 {
                    nearest = nearest.min((a + (b - a) * (f64::from(step) / 400.0) - point).norm());
                }
            }
        }
        if inside { -nearest - 2.0 } else { nearest - 2.0 }
    }

    proptest! {
        #[test]
        fn distances_equal_brute_force(x in -120.0..120.0f64, y in -80.0..200.0f64) {
            let point = Point2::new(x, y);
            let found = TEE.distance(point);
            let expected = by_brute_force(point);
            // Inside, the line between bar and stem is not an edge of the T, but may be the nearest edge of a rectangle.
            if expected > -2.0 {
                prop_assert!((found.value - expected).abs() < 0.2, "{} and {expected}", found.value);
            } else {
                prop_assert!(found.value < -1.9);
            }
            let mut values = [0.0; 1];
            TEE.distances(&[x], &[y], &mut values);
            prop_assert!((values[0] - found.value).abs() < 1e-9);
        }

        #[test]
        fn gradients_equal_finite_differences(x in -120.0..120.0f64, y in -80.0..200.0f64) {
            let at = |dx: f64, dy: f64| TEE.distance(Point2::new(x + dx, y + dy)).value;
            let step = 1e-6;
            let slope = Point2::new(at(step, 0.0) - at(-step, 0.0), at(0.0, step) - at(0.0, -step)) / (2.0 * step);
            // The distance has a kink where two edges are equally near; finite differences across it are wrong.
            prop_assume!((slope.norm() - 1.0).abs() < 1e-3);
            prop_assert!((slope - TEE.distance(Point2::new(x, y)).gradient).norm() < 1e-3);
        }
    }

    #[test]
    fn area_and_centroid_equal_those_of_the_union() {
        let tee = &TEE;
        // Bar of 124 x 34 about (0, 15), and the part of the stem of 34 x 94 that is below it: 34 x 90 about (0, 77).
        let (bar, stem) = (124.0 * 34.0, 34.0 * 90.0);
        let rounded = 4.0 * (4.0 - std::f64::consts::PI);
        assert!((tee.pixels() * SCALE * SCALE - (bar + stem)).abs() < rounded + 10.0);
        assert!(tee.centroid().x.abs() < 1e-9);
        assert!((tee.centroid().y - (bar * 15.0 + stem * 77.0) / (bar + stem)).abs() < 0.1);
        assert!((tee.without_stroke().pixels() * SCALE * SCALE - 6300.0).abs() < 1.0);
    }
}
