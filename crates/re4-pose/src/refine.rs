//! Aligns the block's outline with the segmented image from an initial pose: Gauss-Newton on a soft mask.

use nalgebra::{Matrix3, Vector3};
use re4_geometry::{Point2, Pose2};

use crate::image::{BlockLayer, SIDE, image, world};
use crate::outline::Outline;

/// Widths of the ramp over which the outline's mask falls from 1 to 0, in world pixels, with the number of steps, in order. A
/// wide ramp converges from several pixels away, a narrow one is accurate.
const RAMPS: [(f64, usize); 3] = [(21.0, 2), (11.0, 2), (5.0, 3)];

/// A shorter step than this, in px (at radius `RIM` for angles), ends the iterations of a ramp.
const CONVERGED: f64 = 0.02;

/// Radius in px by which angles are multiplied, so that all three unknowns have the same unit: about that of the block's rim.
const RIM: f64 = 60.0;

/// Levenberg damping for directions that the visible pixels do not determine; in the unit of the squared gradient.
const DAMPING: f64 = 1e-3;

/// Moves `pose` until the outline fits the visible part of the block.
pub(crate) fn refine(layer: &BlockLayer, outline: &Outline, mut pose: Pose2) -> Pose2 {
    for (ramp, steps) in RAMPS {
        for _ in 0..steps {
            let step = step(layer, outline, pose, ramp);
            pose.x += step.x;
            pose.y += step.y;
            pose.theta += step.z / RIM;
            if step.norm() < CONVERGED {
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
    for_each_pixel(outline, pose, ramp, |at, value, point| {
        let height = 0.5 - value / ramp;
        if !(0.0..=1.0).contains(&height) || layer.hidden[at] {
            return;
        }
        let g = outline.distance(point).gradient;
        // Derivative of the mask with respect to the pose: a translation moves the outline along its gradient, a rotation by the
        // lever arm.
        let slope = Vector3::new(
            -(cosine * g.x - sine * g.y),
            -(sine * g.x + cosine * g.y),
            (g.x * point.y - g.y * point.x) / RIM,
        ) * (-1.0 / ramp);
        normal += slope * slope.transpose();
        right += slope * (f64::from(layer.fractions[at]) - height);
    });
    normal
        .cholesky()
        .map_or_else(Vector3::zeros, |normal| normal.solve(&right))
}

/// Agreement of the outline at a pose with an image.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Agreement {
    /// Intersection over union of the outline and the block-coloured pixels, where neither pusher nor contact mark hides them.
    pub(crate) iou: f64,
    /// Visible fraction of the outline's area: neither hidden nor outside of the image.
    pub(crate) visible: f64,
    /// Block-coloured area outside of the outline, as a fraction of the outline's area.
    pub(crate) outside: f64,
}

/// Compares the outline at `pose` with the whole image.
pub(crate) fn agreement(layer: &BlockLayer, outline: &Outline, pose: Pose2) -> Agreement {
    // The width of the outline's soft edge: about that of an image pixel.
    const RAMP: f64 = 6.0;
    let (mut intersection, mut union_area, mut visible) = (0.0, 0.0, 0.0);
    for_each_pixel(outline, pose, RAMP, |at, value, _| {
        let height = (0.5 - value / RAMP).clamp(0.0, 1.0);
        if layer.hidden[at] {
            return;
        }
        let fraction = f64::from(layer.fractions[at]);
        visible += height;
        intersection += fraction.min(height);
        union_area += fraction.max(height);
    });
    let unhidden = layer.pixels.iter().filter(|&&at| !layer.hidden[at]);
    let block: f64 = unhidden.map(|&at| f64::from(layer.fractions[at])).sum();
    let area = outline.pixels();
    Agreement {
        iou: if union_area > 0.0 {
            intersection / union_area
        } else {
            0.0
        },
        visible: (visible / area).min(1.0),
        outside: ((block - intersection) / area).max(0.0),
    }
}

/// Calls `visit` for every pixel near the outline at `pose`, with the pixel's index, its signed distance and its position in the
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
