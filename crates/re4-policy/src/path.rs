//! From a recorded path of the pusher to legs that the controller can carry out.

use re4_geometry::Point2;

/// Part of a path: reach `goal` in `steps` control steps and pass it with `velocity` (pixels a second).
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Leg {
    /// Where the leg ends.
    pub goal: Point2,
    /// Velocity at its end.
    pub velocity: Point2,
    /// Control steps it takes.
    pub steps: usize,
}

/// Control steps a second.
const CONTROL_RATE: f64 = 10.0;

/// Cuts a path into legs between its corners, with at most `speed` pixels a control step. The last leg ends at rest.
///
/// Corners are kept within `tolerance` pixels: a push ends where the demonstration's pusher turned back, so the tip of
/// its path must not be cut off.
pub(crate) fn legs(path: &[Point2], speed: f64, tolerance: f64) -> Vec<Leg> {
    let knots = simplify(path, tolerance);
    let mut legs = Vec::new();
    for (i, pair) in knots.windows(2).enumerate() {
        let along = pair[1] - pair[0];
        let length = along.norm();
        let steps = (length / speed).ceil().max(1.0) as usize;
        let velocity = match knots.get(i + 2) {
            Some(next) if length > 0.0 && (next - pair[1]).norm() > 0.0 => {
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
    // Coming to rest takes two steps: position and velocity are two conditions.
    if let Some(last) = legs.last_mut() {
        last.steps = last.steps.max(2);
    }
    legs
}

/// Ramer, Douglas and Peucker's simplification.
fn simplify(path: &[Point2], tolerance: f64) -> Vec<Point2> {
    let (Some(&first), Some(&last)) = (path.first(), path.last()) else {
        return Vec::new();
    };
    if path.len() < 3 {
        return path.to_vec();
    }
    let chord = last - first;
    let squared = chord.norm_squared();
    let away = |p: Point2| {
        let t = if squared > 0.0 {
            ((p - first).dot(&chord) / squared).clamp(0.0, 1.0)
        } else {
            0.0
        };
        (p - first - chord * t).norm()
    };
    let farthest = (1..path.len() - 1)
        .map(|i| (i, away(path[i])))
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
