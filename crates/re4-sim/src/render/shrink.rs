//! Shrinks the canvas to the observation as `OpenCV` does: bilinear, in fixed-point arithmetic.

use super::SIDE;

/// Width and height of the observation, in pixels.
pub const OBSERVATION_SIDE: usize = 96;

/// 512 / 96 = 16 / 3: every three pixels of the observation, the sampling positions repeat 16 canvas pixels further.
const PERIOD: usize = 3;
const STRIDE: usize = 16;

/// Pixel `d` of the observation is sampled at `(d + 1/2) 16/3 - 1/2`: between this canvas pixel of the period and the next, with
/// these weights in units of 1/2048.
const SAMPLES: [(usize, [i32; 2]); PERIOD] = [(2, [1707, 341]), (7, [1024, 1024]), (12, [341, 1707])];

fn sample(d: usize) -> (usize, [i32; 2]) {
    let (offset, weights) = SAMPLES[d % PERIOD];
    (d / PERIOD * STRIDE + offset, weights)
}

/// Writes the observation of a canvas's pixels.
pub(super) fn shrink(pixels: &[[u8; 3]], observation: &mut Vec<u8>) {
    observation.clear();
    observation.reserve(OBSERVATION_SIDE * OBSERVATION_SIDE * 3);
    for row in 0..OBSERVATION_SIDE {
        let (y, [upper, lower]) = sample(row);
        let rows = &pixels[y * SIDE..(y + 2) * SIDE];
        for column in 0..OBSERVATION_SIDE {
            let (x, [left, right]) = sample(column);
            observation.extend((0..3).map(|channel| {
                let across = |at: usize| left * i32::from(rows[at][channel]) + right * i32::from(rows[at + 1][channel]);
                // Weights have 11 bits per axis. As in OpenCV, sums lose 4 and then 16 bits, and the last two bits are rounded.
                let part = |weight: i32, sum: i32| (weight * (sum >> 4)) >> 16;
                let sum = part(upper, across(x)) + part(lower, across(x + SIDE));
                ((sum + 2) >> 2) as u8
            }));
        }
    }
}
