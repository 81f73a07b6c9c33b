//! Convex polygons: areas, intersections and distances.

use crate::planar::Point2;

fn cross(a: Point2, b: Point2) -> f64 {
    a.x * b.y - a.y * b.x
}

/// Area of a simple polygon by the shoelace formula; positive for both orientations.
pub fn polygon_area(polygon: &[Point2]) -> f64 {
    let n = polygon.len();
    if n < 3 {
        return 0.0;
    }
    // Coordinates relative to the first vertex avoid cancellation for polygons far from the origin.
    let origin = polygon[0];
    let twice: f64 = (1..n - 1)
        .map(|i| cross(polygon[i] - origin, polygon[i + 1] - origin))
        .sum();
    0.5 * twice.abs()
}

/// Intersection of a polygon with a convex polygon, by the Sutherland-Hodgman algorithm. Both may have either orientation.
///
/// The result is empty if they do not intersect.
pub fn clip_convex(subject: &[Point2], convex: &[Point2]) -> Vec<Point2> {
    let orientation: f64 = (0..convex.len())
        .map(|i| cross(convex[i], convex[(i + 1) % convex.len()]))
        .sum::<f64>()
        .signum();
    let mut output = subject.to_vec();
    for i in 0..convex.len() {
        if output.is_empty() {
            break;
        }
        let (a, b) = (convex[i], convex[(i + 1) % convex.len()]);
        let side = |p: Point2| orientation * cross(b - a, p - a);
        let input = std::mem::take(&mut output);
        for j in 0..input.len() {
            let (p, q) = (input[j], input[(j + 1) % input.len()]);
            let (sp, sq) = (side(p), side(q));
            if sp >= 0.0 {
                output.push(p);
            }
            if (sp > 0.0 && sq < 0.0) || (sp < 0.0 && sq > 0.0) {
                output.push(p + (q - p) * (sp / (sp - sq)));
            }
        }
    }
    output
}

fn distance_point_to_segment(p: Point2, a: Point2, b: Point2) -> f64 {
    let ab = b - a;
    let length_squared = ab.norm_squared();
    let t = if length_squared > 0.0 {
        ((p - a).dot(&ab) / length_squared).clamp(0.0, 1.0)
    } else {
        0.0
    };
    (p - (a + ab * t)).norm()
}

/// Whether a point is inside a convex polygon of either orientation, or on its boundary.
fn contains(convex: &[Point2], p: Point2) -> bool {
    let n = convex.len();
    let mut positive = false;
    let mut negative = false;
    for i in 0..n {
        let s = cross(convex[(i + 1) % n] - convex[i], p - convex[i]);
        positive |= s > 0.0;
        negative |= s < 0.0;
    }
    n >= 3 && !(positive && negative)
}

/// Distance from a point to a filled convex polygon; zero inside.
pub fn distance_point_to_convex(p: Point2, convex: &[Point2]) -> f64 {
    if contains(convex, p) {
        return 0.0;
    }
    let n = convex.len();
    (0..n)
        .map(|i| distance_point_to_segment(p, convex[i], convex[(i + 1) % n]))
        .fold(f64::INFINITY, f64::min)
}

/// Distance between two segments `a b` and `c d`; zero if they cross.
pub fn distance_segment_to_segment(a: Point2, b: Point2, c: Point2, d: Point2) -> f64 {
    let (ab, cd) = (b - a, d - c);
    let (c_side, d_side) = (cross(ab, c - a), cross(ab, d - a));
    let (a_side, b_side) = (cross(cd, a - c), cross(cd, b - c));
    if c_side * d_side < 0.0 && a_side * b_side < 0.0 {
        return 0.0;
    }
    distance_point_to_segment(a, c, d)
        .min(distance_point_to_segment(b, c, d))
        .min(distance_point_to_segment(c, a, b))
        .min(distance_point_to_segment(d, a, b))
}

/// Distance from the segment `a b` to a filled convex polygon; zero if they intersect.
pub fn distance_segment_to_convex(a: Point2, b: Point2, convex: &[Point2]) -> f64 {
    if contains(convex, a) || contains(convex, b) {
        return 0.0;
    }
    let n = convex.len();
    (0..n)
        .map(|i| distance_segment_to_segment(a, b, convex[i], convex[(i + 1) % n]))
        .fold(f64::INFINITY, f64::min)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn square(x: f64, y: f64, side: f64) -> Vec<Point2> {
        vec![
            Point2::new(x, y),
            Point2::new(x + side, y),
            Point2::new(x + side, y + side),
            Point2::new(x, y + side),
        ]
    }

    #[test]
    fn squares_are_clipped() {
        let overlap = clip_convex(&square(0.0, 0.0, 2.0), &square(1.0, 1.0, 2.0));
        assert!((polygon_area(&overlap) - 1.0).abs() < 1e-12);
        assert!(clip_convex(&square(0.0, 0.0, 1.0), &square(5.0, 5.0, 1.0)).is_empty());
        let mut reversed = square(1.0, 1.0, 2.0);
        reversed.reverse();
        assert!((polygon_area(&clip_convex(&square(0.0, 0.0, 2.0), &reversed)) - 1.0).abs() < 1e-12);
    }

    #[test]
    fn distances_to_a_square_are_exact() {
        let s = square(0.0, 0.0, 2.0);
        assert_eq!(distance_point_to_convex(Point2::new(1.0, 1.0), &s), 0.0);
        assert!((distance_point_to_convex(Point2::new(5.0, 6.0), &s) - 5.0).abs() < 1e-12);
        assert_eq!(
            distance_segment_to_convex(Point2::new(-1.0, 1.0), Point2::new(3.0, 1.0), &s),
            0.0
        );
        assert!((distance_segment_to_convex(Point2::new(-1.0, 3.0), Point2::new(3.0, 3.0), &s) - 1.0).abs() < 1e-12);
    }

    proptest! {
        #[test]
        fn segment_distance_is_the_minimum_over_its_points(
            ax in -5.0..5.0f64, ay in -5.0..5.0f64, bx in -5.0..5.0f64, by in -5.0..5.0f64,
        ) {
            let s = square(0.0, 0.0, 2.0);
            let (a, b) = (Point2::new(ax, ay), Point2::new(bx, by));
            let sampled = (0..=2000)
                .map(|i| distance_point_to_convex(a + (b - a) * (f64::from(i) / 2000.0), &s))
                .fold(f64::INFINITY, f64::min);
            let exact = distance_segment_to_convex(a, b, &s);
            prop_assert!(exact <= sampled + 1e-9);
            prop_assert!(sampled - exact <= (b - a).norm() / 2000.0 + 1e-9);
        }

        #[test]
        fn the_clipped_area_does_not_depend_on_the_order(dx in -3.0..3.0f64, dy in -3.0..3.0f64, t in 0.0..6.3f64) {
            let pose = crate::Pose2::new(dx, dy, t);
            let a = square(-1.0, -1.0, 2.0);
            let b: Vec<_> = square(-1.0, -0.5, 1.5).into_iter().map(|p| pose.transform_point(p)).collect();
            let ab = polygon_area(&clip_convex(&a, &b));
            let ba = polygon_area(&clip_convex(&b, &a));
            prop_assert!((ab - ba).abs() < 1e-9);
            prop_assert!(ab <= 2.25 + 1e-9);
        }
    }
}
