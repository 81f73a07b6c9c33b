//! Distance of the path from a smooth curve, by mode segment.

use nalgebra::{Matrix2, Vector3};

use crate::motion::{Motion, length};

/// Number of points of a segment's path, equally spaced along it.
const POINTS: usize = 64;

/// Trajectory-envelope distance by mode segment, after RINSE (Sojib and Begum 2026): each segment of the end effector's path is
/// compared with the cubic Bézier curve between its ends that fits it best, point by point at equal path lengths. Returns the area
/// between path and curves, divided by the distances between the ends of the segments, in the unit of the motion: 0 if every segment
/// is a line or a simple curve. A path of the same shape that is longer because it goes back and forth has a larger value. `None` if
/// no segment has ends that are apart.
///
/// The publication describes the idea, a smooth envelope for each phase of contact; the fit and the scale are ours.
pub fn envelope_distance(motion: &Motion) -> Option<f64> {
    let (mut area, mut covered) = (0.0, 0.0);
    for segment in &motion.segments {
        let path = motion.path(segment);
        let travelled = length(path);
        if travelled > 0.0 {
            area += travelled * deviation(&resample(path, POINTS));
            covered += path
                .first()
                .zip(path.last())
                .map_or(0.0, |(first, last)| (last - first).norm());
        }
    }
    (covered > 0.0).then(|| area / covered)
}

/// Points at equal distances along a path, with both ends. The path has a length above 0.
pub(crate) fn resample(path: &[Vector3<f64>], count: usize) -> Vec<Vector3<f64>> {
    let total = length(path);
    let mut points = Vec::with_capacity(count);
    let (mut at, mut before) = (0, 0.0);
    for number in 0..count {
        let wanted = total * number as f64 / (count - 1).max(1) as f64;
        let mut part = 0.0;
        while at + 1 < path.len() {
            part = (path[at + 1] - path[at]).norm();
            if before + part >= wanted || at + 2 == path.len() {
                break;
            }
            before += part;
            at += 1;
        }
        let fraction = if part > 0.0 {
            ((wanted - before) / part).clamp(0.0, 1.0)
        } else {
            0.0
        };
        let next = path.get(at + 1).unwrap_or(&path[at]);
        points.push(path[at] + (next - path[at]) * fraction);
    }
    points
}

/// Mean distance of points from the cubic Bézier curve with their ends that is nearest in the sense of least squares. Both are
/// compared at the same parameter, which is proportional to the path length.
fn deviation(points: &[Vector3<f64>]) -> f64 {
    let (Some(&first), Some(&last)) = (points.first(), points.last()) else {
        return 0.0;
    };
    let parameter = |number: usize| number as f64 / (points.len() - 1).max(1) as f64;
    let basis = |s: f64| {
        let r = 1.0 - s;
        [r * r * r, 3.0 * s * r * r, 3.0 * s * s * r, s * s * s]
    };
    let mut normal = Matrix2::zeros();
    let mut right = [Vector3::zeros(), Vector3::zeros()];
    for (number, point) in points.iter().enumerate() {
        let [b0, b1, b2, b3] = basis(parameter(number));
        let rest = point - first * b0 - last * b3;
        normal += Matrix2::new(b1 * b1, b1 * b2, b1 * b2, b2 * b2);
        right[0] += rest * b1;
        right[1] += rest * b2;
    }
    let Some(inverse) = normal.try_inverse() else {
        return 0.0;
    };
    let c1 = right[0] * inverse.m11 + right[1] * inverse.m12;
    let c2 = right[0] * inverse.m21 + right[1] * inverse.m22;
    let distances = points.iter().enumerate().map(|(number, point)| {
        let [b0, b1, b2, b3] = basis(parameter(number));
        (point - first * b0 - c1 * b1 - c2 * b2 - last * b3).norm()
    });
    distances.sum::<f64>() / points.len() as f64
}
