//! Smoothness of the end effector's speed.

use nalgebra::Vector3;
use rustfft::FftPlanner;
use rustfft::num_complex::Complex;

use crate::motion::Motion;

/// Highest frequency of the spectral arc length, in Hz (Balasubramanian et al. 2015).
const CUT_OFF: f64 = 10.0;

/// Amplitude, as a fraction of that at frequency 0, below which the rest of the spectrum is ignored (the same).
const AMPLITUDE: f64 = 0.05;

/// The transform has this many times the samples of the movement, rounded up to a power of two (the same: 4 doublings).
const PADDING: usize = 16;

/// Log dimensionless jerk of the end effector's velocity v over the duration T (Balasubramanian et al. 2012, 2015):
///
/// ```text
/// -ln( T^3 / max |v|^2 * integral of |d^2 v / dt^2|^2 dt )
/// ```
///
/// Higher is smoother. It does not change when the movement is scaled in time or in size. A minimum-jerk movement has
/// -ln(720 / 1.875^2) = -5.32. `None` with fewer than 4 frames, or without motion.
pub fn log_dimensionless_jerk(motion: &Motion) -> Option<f64> {
    let dt = motion.period;
    let derive = |values: &[Vector3<f64>]| -> Vec<Vector3<f64>> {
        let pairs = values.iter().zip(values.iter().skip(1));
        pairs.map(|(now, next)| (next - now) / dt).collect()
    };
    let velocity = derive(&motion.eef);
    let jerk = derive(&derive(&velocity));
    let peak = velocity.iter().map(Vector3::norm_squared).fold(0.0, f64::max);
    let squared: f64 = jerk.iter().map(|jerk| jerk.norm_squared() * dt).sum();
    let duration = velocity.len() as f64 * dt;
    let dimensionless = duration.powi(3) / peak * squared;
    (dimensionless.is_finite() && dimensionless > 0.0).then(|| -dimensionless.ln())
}

/// Spectral arc length of the end effector's speed (SPARC; Balasubramanian et al. 2012, 2015): minus the length of the curve of the
/// normalised amplitude spectrum, from frequency 0 to the last frequency up to 10 Hz at which the amplitude is at least 5 %. The
/// frequency axis is divided by that frequency.
///
/// Higher is smoother. It does not change when the movement is scaled in size. `None` without motion.
pub fn spectral_arc_length(motion: &Motion) -> Option<f64> {
    let pairs = motion.eef.iter().zip(motion.eef.iter().skip(1));
    let speeds: Vec<f64> = pairs.map(|(now, next)| (next - now).norm()).collect();
    let samples = (speeds.len() * PADDING).next_power_of_two();
    let mut spectrum: Vec<Complex<f64>> = speeds.iter().map(|&speed| Complex::new(speed, 0.0)).collect();
    spectrum.resize(samples, Complex::default());
    FftPlanner::new().plan_fft_forward(samples).process(&mut spectrum);
    let whole = spectrum.first()?.norm();
    if whole.partial_cmp(&0.0) != Some(std::cmp::Ordering::Greater) {
        return None;
    }
    let resolution = 1.0 / (samples as f64 * motion.period);
    let highest = (((CUT_OFF / resolution) + 1e-9) as usize).min(samples / 2);
    let amplitudes: Vec<f64> = spectrum
        .iter()
        .take(highest + 1)
        .map(|bin| bin.norm() / whole)
        .collect();
    let last = amplitudes.iter().rposition(|&amplitude| amplitude >= AMPLITUDE)?;
    if last == 0 {
        return None;
    }
    let width = 1.0 / last as f64;
    let bins = amplitudes.iter().zip(amplitudes.iter().skip(1)).take(last);
    Some(-bins.map(|(now, next)| width.hypot(next - now)).sum::<f64>())
}
