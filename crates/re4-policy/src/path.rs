//! Converts a path of the pusher to legs that the controller can execute.

use re4_geometry::Point2;

/// Part of a path: the pusher reaches `goal` in `steps` control steps and passes it with `velocity`. World frame, pixels.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Leg {
    /// End position of the leg.
    pub goal: Point2,
    /// Velocity at the end, in pixels per second.
    pub velocity: Point2,
    /// Number of control steps.
    pub steps: usize,
}

/// Control steps per second.
const CONTROL_RATE: f64 = 10.0;

/// Splits a path into legs between its corners, with at most `speed` pixels per control step. The last leg ends at rest.
///
/// The legs deviate from the path by at most `tolerance` pixels. A push ends where the pusher of the demonstration reverses, so
/// cutting off the tip of the path would shorten the push.
pub(crate) fn legs(path: &[Point2], speed: f64, tolerance: f64) -> Vec<Leg> {
    let knots = simplify(path, tolerance);
    let mut legs = Vec::new();
    for (i, pair) in knots.windows(2).enumerate() {
        let along = pair[1] - pair[0];
        let length = along.norm();
        let steps = (length / speed).ceil().max(1.0) as usize;
        let velocity = match knots.get(i + 2) {
            Some(next) if length > 0.0 && (next - pair[1]).norm() > 0.0 => {
                // Pass the corner along the mean direction of both legs at the speed of the slower one, and slow down at sharp
                // corners.
                let (a, b) = (along / length, (next - pair[1]).normalize());
                let straightness = a.dot(&b).max(0.0);
                let pace = (length / steps as f64).min((next - pair[1]).norm()) * CONTROL_RATE;
                (a + b) * (0.5 * pace * straightness * straightness)
            }
            _ => Point2::zeros(),
        };
        legs.push(Leg {
            goal: pair[1],
            velocity,
            steps,
        });
    }
    // Position and velocity at the end are two conditions, which take two control steps to satisfy.
    if let Some(last) = legs.last_mut() {
        last.steps = last.steps.max(2);
    }
    legs
}

/// Simplifies a polyline by the Ramer-Douglas-Peucker algorithm.
fn simplify(path: &[Point2], tolerance: f64) -> Vec<Point2> {
    let (Some(&first), Some(&last)) = (path.first(), path.last()) else {
        return Vec::new();
    };
    if path.len() < 3 {
        return path.to_vec();
    }
    let chord = last - first;
    let squared = chord.norm_squared();
    let distance_to_chord = |p: Point2| {
        let t = if squared > 0.0 {
            ((p - first).dot(&chord) / squared).clamp(0.0, 1.0)
        } else {
            0.0
        };
        (p - first - chord * t).norm()
    };
    let farthest = (1..path.len() - 1)
        .map(|i| (i, distance_to_chord(path[i])))
        .fold(
            (0, 0.0),
            |best, candidate| {
                if candidate.1 > best.1 { candidate } else { best }
            },
        );
    if farthest.1 <= tolerance {
        return vec![first, last];
    }
    let mut knots = simplify(&path[..=farthest.0], tolerance);
    knots.pop();
    knots.extend(simplify(&path[farthest.0..], tolerance));
    knots
}
