//! The log-polar transform: a rotation of the mask about its centroid becomes a shift along the angle (paper, appendix
//! "Push-T", Pose Estimation).

use std::f64::consts::TAU;
use std::sync::Arc;

use re4_geometry::Point2;
use rustfft::num_complex::Complex;
use rustfft::{Fft, FftPlanner};

use crate::image::{SCALE, SIDE, image};

/// Number of bins along the angle, over the full circle.
const ANGLES: usize = 128;

/// Number of bins along the logarithm of the radius; even, because two radii are transformed together.
const RADII: usize = 12;

/// Minimum and maximum radius, in world pixels. The farthest point of the block is 84 px from its centroid.
const RADIUS: [f64; 2] = [8.0, 92.0];

/// The log-polar representation of a mask about its centroid, Fourier-transformed along the angle. Two radii are transformed
/// together, as real and imaginary part.
#[derive(Clone)]
pub(crate) struct Signature(Vec<Complex<f64>>);

/// Computes signatures of masks and the rotation between two of them (log-polar registration).
#[derive(Clone)]
pub(crate) struct LogPolar {
    forward: Arc<dyn Fft<f64>>,
    backward: Arc<dyn Fft<f64>>,
    /// Sampling offsets from the centroid, in image pixels: radius by radius, angle by angle.
    offsets: Arc<Vec<Point2>>,
}

impl LogPolar {
    pub(crate) fn new() -> Self {
        let mut planner = FftPlanner::new();
        let [minimum, maximum] = RADIUS;
        let offsets = (0..RADII)
            .flat_map(|i| {
                let radius = minimum * (maximum / minimum).powf(i as f64 / (RADII - 1) as f64) / SCALE;
                (0..ANGLES).map(move |j| {
                    let (sine, cosine) = (TAU * j as f64 / ANGLES as f64).sin_cos();
                    Point2::new(radius * cosine, radius * sine)
                })
            })
            .collect();
        Self {
            forward: planner.plan_fft_forward(ANGLES),
            backward: planner.plan_fft_inverse(ANGLES),
            offsets: Arc::new(offsets),
        }
    }

    /// The signature of a mask about `centroid` (world pixels).
    pub(crate) fn signature(&self, mask: &[f32], centroid: Point2) -> Signature {
        let centre = Point2::new(image(centroid.x), image(centroid.y));
        let sample = |offset: &Point2| bilinear(mask, centre + offset);
        let mut spectra = Vec::with_capacity(RADII / 2 * ANGLES);
        for pair in self.offsets.chunks_exact(2 * ANGLES) {
            let (one, other) = pair.split_at(ANGLES);
            spectra.extend(one.iter().zip(other).map(|(a, b)| Complex::new(sample(a), sample(b))));
        }
        self.forward.process(&mut spectra);
        Signature(spectra)
    }

    /// The rotation from `anchor` to `mask`, in radians: the peak of their circular cross-correlation along the angle, summed over
    /// the radii, with sub-bin precision by a parabola through the highest bin and its neighbours.
    pub(crate) fn rotation(&self, anchor: &Signature, mask: &Signature) -> f64 {
        // Each transform has two real rows as a + ib; the real part of its correlation is the sum of the correlations of the rows.
        let mut product = vec![Complex::new(0.0, 0.0); ANGLES];
        for (a, m) in anchor.0.chunks_exact(ANGLES).zip(mask.0.chunks_exact(ANGLES)) {
            for ((sum, a), m) in product.iter_mut().zip(a).zip(m) {
                *sum += m * a.conj();
            }
        }
        self.backward.process(&mut product);
        let correlation: Vec<f64> = product.iter().map(|c| c.re).collect();
        let at = |bin: usize| correlation[bin % ANGLES];
        let peak = (0..ANGLES).fold(0, |best, bin| if at(bin) > at(best) { bin } else { best });
        let (before, top, after) = (at(peak + ANGLES - 1), at(peak), at(peak + 1));
        let curvature = before - 2.0 * top + after;
        let offset = if curvature < 0.0 {
            (0.5 * (before - after) / curvature).clamp(-0.5, 0.5)
        } else {
            0.0
        };
        TAU * (peak as f64 + offset) / ANGLES as f64
    }
}

/// The mask at a point of the image by bilinear interpolation; zero outside of the image.
fn bilinear(mask: &[f32], point: Point2) -> f64 {
    // The last row and column have no neighbours to interpolate with. The block never reaches them, because the walls are there.
    let inside = |v: f64| (0.0..(SIDE - 1) as f64).contains(&v);
    if !inside(point.x) || !inside(point.y) {
        return 0.0;
    }
    let (column, row) = (point.x as usize, point.y as usize);
    let (right, lower) = (point.x - column as f64, point.y - row as f64);
    let at = row * SIDE + column;
    let value = |at: usize| f64::from(mask[at]);
    let upper_row = value(at) + right * (value(at + 1) - value(at));
    let lower_row = value(at + SIDE) + right * (value(at + SIDE + 1) - value(at + SIDE));
    upper_row + lower * (lower_row - upper_row)
}

#[cfg(test)]
mod tests {
    use std::f64::consts::PI;

    use re4_geometry::{Pose2, periodic_distance};

    use super::*;
    use crate::image::world;
    use crate::outline::Outline;

    /// A soft mask of the T with its centroid in the centre of the image.
    fn mask(angle: f64) -> Vec<f32> {
        let outline = Outline::new(&re4_sim::tee_rectangles(), 0.0);
        let centre = Point2::new(256.0, 256.0);
        let rotation = Pose2::new(0.0, 0.0, angle);
        let position = |at: usize| Point2::new(world((at % SIDE) as f64), world((at / SIDE) as f64)) - centre;
        (0..SIDE * SIDE)
            .map(|at| {
                outline
                    .distance(rotation.inverse_transform_point(position(at)) + outline.centroid())
                    .value
            })
            .map(|distance| (0.5 - distance / 5.0).clamp(0.0, 1.0) as f32)
            .collect()
    }

    #[test]
    fn rotations_are_found_between_bins_too() {
        let log_polar = LogPolar::new();
        let centre = Point2::new(256.0, 256.0);
        let anchor = log_polar.signature(&mask(PI / 4.0), centre);
        let mut worst: f64 = 0.0;
        for i in 0..360 {
            let wanted = f64::from(i).to_radians();
            let found = log_polar.rotation(&anchor, &log_polar.signature(&mask(PI / 4.0 + wanted), centre));
            worst = worst.max(periodic_distance(found, wanted, TAU));
        }
        // A bin is 2.8 degrees wide.
        assert!(worst.to_degrees() < 0.6, "{} degrees", worst.to_degrees());
    }

    #[test]
    fn the_mask_is_zero_outside_of_the_image() {
        let full = vec![1.0; SIDE * SIDE];
        assert_eq!(bilinear(&full, Point2::new(40.3, 50.7)), 1.0);
        for (x, y) in [(-0.1, 3.0), (3.0, -0.1), (95.0, 3.0), (3.0, 95.2), (f64::NAN, 3.0)] {
            assert_eq!(bilinear(&full, Point2::new(x, y)), 0.0);
        }
    }
}
