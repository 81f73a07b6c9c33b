//! Aligning the block's outline with the mask, from a pose nearby: Gauss-Newton on the soft mask.

use nalgebra::{Matrix3, Vector3};
use re4_geometry::{Point2, Pose2};

use crate::image::{BlockLayer, SIDE, image, world};
use crate::outline::Outline;

/// Widths, in world pixels, over which the outline's mask falls from 1 to 0, one after the other, with the number of
/// steps: a wide ramp feels an outline that is pixels away, a narrow one is exact.
const RAMPS: [(f64, usize); 3] = [(21.0, 2), (11.0, 2), (5.0, 3)];

/// A step shorter than this, in px (and px at the block's rim for angles), ends the steps of a ramp.
const STILL: f64 = 0.02;

/// Scales the angle to px at the block's rim, so that all three unknowns have one unit.
const RIM: f64 = 60.0;

/// Pulls steps to zero where a view leaves a direction undetermined; in the unit of the squared gradient.
const DAMPING: f64 = 1e-3;

/// Turns `pose` and moves it until the outline fits what is seen of the block.
pub(crate) fn refine(layer: &BlockLayer, outline: &Outline, mut pose: Pose2) -> Pose2 {
    for (ramp, steps) in RAMPS {
        for _ in 0..steps {
            let step = step(layer, outline, pose, ramp);
            pose.x += step.x;
            pose.y += step.y;
            pose.theta += step.z / RIM;
            if step.norm() < STILL {
                break;
            }
        }
    }
    pose
}

fn step(layer: &BlockLayer, outline: &Outline, pose: Pose2, ramp: f64) -> Vector3<f64> {
    let (sine, cosine) = pose.theta.sin_cos();
    let mut normal = Matrix3::from_diagonal_element(DAMPING);
    let mut right = Vector3::zeros();
    for_each_pixel(outline, pose, ramp, |at, value, place| {
        let height = 0.5 - value / ramp;
        if !(0.0..=1.0).contains(&height) || layer.hidden[at] {
            return;
        }
        let g = outline.distance(place).gradient;
        // How the distance changes as the pose moves: against the gradient, and by the lever arm as it turns.
        let slope = Vector3::new(
            -(cosine * g.x - sine * g.y),
            -(sine * g.x + cosine * g.y),
            (g.x * place.y - g.y * place.x) / RIM,
        ) * (-1.0 / ramp);
        normal += slope * slope.transpose();
        right += slope * (f64::from(layer.share[at]) - height);
    });
    normal
        .cholesky()
        .map_or_else(Vector3::zeros, |normal| normal.solve(&right))
}

/// How well the outline at a pose agrees with an image.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Agreement {
    /// Intersection over union of outline and block-coloured pixels, where neither pusher nor mark hides them.
    pub(crate) iou: f64,
    /// Fraction of the outline's area that is seen: neither hidden nor outside of the image.
    pub(crate) seen: f64,
    /// Block-coloured area beyond the outline, as a fraction of the outline's area.
    pub(crate) beyond: f64,
}

/// Compares the outline at `pose` with the whole image.
pub(crate) fn agreement(layer: &BlockLayer, outline: &Outline, pose: Pose2) -> Agreement {
    // The softness of a pixel: about its own width.
    const RAMP: f64 = 6.0;
    let (mut both, mut either, mut seen) = (0.0, 0.0, 0.0);
    for_each_pixel(outline, pose, RAMP, |at, value, _| {
        let height = (0.5 - value / RAMP).clamp(0.0, 1.0);
        if layer.hidden[at] {
            return;
        }
        let share = f64::from(layer.share[at]);
        seen += height;
        both += share.min(height);
        either += share.max(height);
    });
    let unhidden = layer.pixels.iter().filter(|&&at| !layer.hidden[at]);
    let block: f64 = unhidden.map(|&at| f64::from(layer.share[at])).sum();
    let area = outline.pixels();
    Agreement {
        iou: if either > 0.0 { both / either } else { 0.0 },
        seen: (seen / area).min(1.0),
        beyond: ((block - both) / area).max(0.0),
    }
}

/// Calls `visit` for every pixel near the outline at `pose`, with its index, its signed distance and its place in the
/// block's frame.
fn for_each_pixel(outline: &Outline, pose: Pose2, margin: f64, mut visit: impl FnMut(usize, f64, Point2)) {
    let (mut low, mut high) = (Point2::repeat(f64::INFINITY), Point2::repeat(f64::NEG_INFINITY));
    for corner in outline.corners(pose) {
        low = low.inf(&corner);
        high = high.sup(&corner);
    }
    let range = |low: f64, high: f64| {
        let first = image(low - margin).floor().clamp(0.0, SIDE as f64) as usize;
        let last = image(high + margin).ceil().clamp(-1.0, (SIDE - 1) as f64);
        first..(last + 1.0) as usize
    };
    let (sine, cosine) = pose.theta.sin_cos();
    let columns = range(low.x, high.x);
    let (mut xs, mut ys, mut distances) = ([0.0; SIDE], [0.0; SIDE], [0.0; SIDE]);
    for row in range(low.y, high.y) {
        let y = world(row as f64) - pose.y;
        for (column, (px, py)) in columns.clone().zip(xs.iter_mut().zip(&mut ys)) {
            let x = world(column as f64) - pose.x;
            (*px, *py) = (cosine * x + sine * y, cosine * y - sine * x);
        }
        let count = columns.len();
        outline.distances(&xs[..count], &ys[..count], &mut distances[..count]);
        for (i, column) in columns.clone().enumerate() {
            visit(row * SIDE + column, distances[i], Point2::new(xs[i], ys[i]));
        }
    }
}
