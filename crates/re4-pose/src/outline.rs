//! The block's outline: which places of an image it covers at a pose.

use re4_geometry::{Point2, Pose2};

use crate::image::SCALE;

/// The shape of the block in its own frame, in world pixels: rectangles, drawn with an outline round each.
#[derive(Debug, Clone, PartialEq)]
pub struct Outline {
    rectangles: Vec<Rectangle>,
    stroke: f64,
    /// Area with the stroke, in image pixels.
    pixels: f64,
    /// Centroid with the stroke, in the block's frame.
    centroid: Point2,
}

/// An axis-parallel rectangle of the block's frame.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Rectangle {
    centre: Point2,
    half: Point2,
}

/// Signed distance to the outline, and how it changes with the place.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Distance {
    /// Distance in world pixels, negative inside.
    pub(crate) value: f64,
    /// Its gradient, in the block's frame.
    pub(crate) gradient: Point2,
}

impl Outline {
    /// The union of axis-parallel rectangles, given by their corners in the block's frame, with `stroke` px drawn beyond
    /// their edges.
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
        Self::measured(rectangles, stroke)
    }

    /// The area is counted on a grid of places a pixel apart.
    fn measured(rectangles: Vec<Rectangle>, stroke: f64) -> Self {
        let mut outline = Self {
            rectangles,
            stroke,
            pixels: 0.0,
            centroid: Point2::zeros(),
        };
        let reach = outline.reach().ceil() as i32;
        let places = (-reach..reach)
            .flat_map(|x| (-reach..reach).map(move |y| Point2::new(f64::from(x) + 0.5, f64::from(y) + 0.5)));
        let covered: Vec<Point2> = places.filter(|&place| outline.distance(place).value < 0.0).collect();
        outline.pixels = covered.len() as f64 / (SCALE * SCALE);
        outline.centroid = covered.iter().sum::<Point2>() / covered.len().max(1) as f64;
        outline
    }

    /// The same shape drawn without an outline, as the goal is.
    #[must_use]
    pub fn without_stroke(&self) -> Self {
        Self::measured(self.rectangles.clone(), 0.0)
    }

    /// Corners of the rectangles, in the world, for the block at `pose`.
    pub(crate) fn corners(&self, pose: Pose2) -> impl Iterator<Item = Point2> {
        self.rectangles.iter().flat_map(move |r| {
            [(-1.0, -1.0), (-1.0, 1.0), (1.0, -1.0), (1.0, 1.0)]
                .map(|(x, y)| pose.transform_point(r.centre + Point2::new(x * r.half.x, y * r.half.y)))
        })
    }

    /// Centroid with the stroke, in the block's frame, world pixels.
    pub(crate) fn centroid(&self) -> Point2 {
        self.centroid
    }

    /// Maximum distance of the shape from the origin of its frame, with its stroke.
    pub(crate) fn reach(&self) -> f64 {
        self.corners(Pose2::IDENTITY).map(|p| p.norm()).fold(0.0, f64::max) + self.stroke
    }

    /// Area with the stroke, in image pixels.
    pub(crate) fn pixels(&self) -> f64 {
        self.pixels
    }

    /// The values of [`Outline::distance`] alone, for places given by their coordinates: without a branch, so that a row of
    /// pixels is worked through several at a time.
    pub(crate) fn distances(&self, x: &[f64], y: &[f64], values: &mut [f64]) {
        values.fill(f64::INFINITY);
        for rectangle in &self.rectangles {
            rectangle.lesser_distances(x, y, values);
        }
        for value in values {
            *value -= self.stroke;
        }
    }

    /// Distance of a place in the block's frame.
    pub(crate) fn distance(&self, place: Point2) -> Distance {
        let mut nearest = Distance {
            value: f64::INFINITY,
            gradient: Point2::zeros(),
        };
        for rectangle in &self.rectangles {
            let distance = rectangle.distance(place);
            if distance.value < nearest.value {
                nearest = distance;
            }
        }
        nearest.value -= self.stroke;
        nearest
    }
}

impl Rectangle {
    /// Lowers each value to the distance of its place where that is less.
    fn lesser_distances(&self, x: &[f64], y: &[f64], values: &mut [f64]) {
        // Comparisons by hand compile to single instructions, which f64::min and max with their care for NaN do not.
        let greater = |a: f64, b: f64| if a > b { a } else { b };
        let lesser = |a: f64, b: f64| if a < b { a } else { b };
        for ((x, y), value) in x.iter().zip(y).zip(values) {
            let beyond_x = (x - self.centre.x).abs() - self.half.x;
            let beyond_y = (y - self.centre.y).abs() - self.half.y;
            let (outside_x, outside_y) = (greater(beyond_x, 0.0), greater(beyond_y, 0.0));
            let outside = (outside_x * outside_x + outside_y * outside_y).sqrt();
            *value = lesser(*value, outside + lesser(greater(beyond_x, beyond_y), 0.0));
        }
    }

    fn distance(&self, place: Point2) -> Distance {
        let from_centre = place - self.centre;
        let sign = Point2::new(1.0_f64.copysign(from_centre.x), 1.0_f64.copysign(from_centre.y));
        let beyond = from_centre.abs() - self.half;
        if beyond.x > 0.0 && beyond.y > 0.0 {
            let value = beyond.norm();
            return Distance {
                value,
                gradient: beyond.component_mul(&sign) / value,
            };
        }
        if beyond.x > beyond.y {
            Distance {
                value: beyond.x,
                gradient: Point2::new(sign.x, 0.0),
            }
        } else {
            Distance {
                value: beyond.y,
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

    /// The T of Push-T with an outline of 2 px.
    static TEE: LazyLock<Outline> = LazyLock::new(|| Outline::new(&re4_sim::tee_rectangles(), 2.0));

    /// Distance by the nearest of many points on the edges of the rectangles; negative inside.
    fn by_brute_force(place: Point2) -> f64 {
        let mut nearest = f64::INFINITY;
        let mut inside = false;
        for corners in re4_sim::tee_rectangles() {
            let [low, high] = [corners[0].inf(&corners[2]), corners[0].sup(&corners[2])];
            inside |= (0..2).all(|axis| (low[axis]..=high[axis]).contains(&place[axis]));
            for i in 0..4 {
                let (a, b) = (corners[i], corners[(i + 1) % 4]);
                for step in 0..=400 {
                    nearest = nearest.min((a + (b - a) * (f64::from(step) / 400.0) - place).norm());
                }
            }
        }
        if inside { -nearest - 2.0 } else { nearest - 2.0 }
    }

    proptest! {
        #[test]
        fn distances_are_those_of_brute_force(x in -120.0..120.0f64, y in -80.0..200.0f64) {
            let place = Point2::new(x, y);
            let found = TEE.distance(place);
            let expected = by_brute_force(place);
            // Inside, the line where bar and stem meet is no edge of the T, but may be the nearest of a rectangle.
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
        fn gradients_are_differences(x in -120.0..120.0f64, y in -80.0..200.0f64) {
            let at = |dx: f64, dy: f64| TEE.distance(Point2::new(x + dx, y + dy)).value;
            let step = 1e-6;
            let slope = Point2::new(at(step, 0.0) - at(-step, 0.0), at(0.0, step) - at(0.0, -step)) / (2.0 * step);
            // Where two edges are as near as each other there is a kink, which differences straddle.
            prop_assume!((slope.norm() - 1.0).abs() < 1e-3);
            prop_assert!((slope - TEE.distance(Point2::new(x, y)).gradient).norm() < 1e-3);
        }
    }

    #[test]
    fn area_and_centroid_are_those_of_the_union() {
        let tee = &TEE;
        // Bar of 124 x 34 about (0, 15), and what the stem of 34 x 94 adds below it: 34 x 90 about (0, 77).
        let (bar, stem) = (124.0 * 34.0, 34.0 * 90.0);
        let rounded = 4.0 * (4.0 - std::f64::consts::PI);
        assert!((tee.pixels() * SCALE * SCALE - (bar + stem)).abs() < rounded + 10.0);
        assert!(tee.centroid().x.abs() < 1e-9);
        assert!((tee.centroid().y - (bar * 15.0 + stem * 77.0) / (bar + stem)).abs() < 0.1);
        assert!((tee.without_stroke().pixels() * SCALE * SCALE - 6300.0).abs() < 1.0);
    }
}
