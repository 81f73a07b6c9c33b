//! Scores of motions whose values are known in closed form, and properties that the literature claims.

use std::f64::consts::PI;

use nalgebra::Vector3;
use proptest::prelude::*;
use re4_episode::{Mode, Segment, segments};
use re4_scores::{
    Motion, envelope_distance, idle_share, information, log_dimensionless_jerk, path_efficiency, regrasps,
    spectral_arc_length,
};

/// A motion along these positions, in one transit segment.
fn along(eef: Vec<Vector3<f64>>, period: f64) -> Motion {
    let frames = eef.len();
    Motion {
        steps: eef.windows(2).map(|pair| (pair[1] - pair[0]).norm()).collect(),
        object: vec![Vector3::zeros(); frames],
        fingers: Vec::new(),
        states: vec![[0.0; 7]; frames],
        actions: vec![[0.0; 7]; frames],
        segments: vec![Segment {
            mode: Mode::Transit,
            frames: 0..frames,
        }],
        eef,
        period,
    }
}

/// A reach along x of one metre and one second, with the position as a function of time.
fn reach(frames: usize, duration: f64, size: f64, at: impl Fn(f64) -> f64) -> Motion {
    let time = |frame: usize| frame as f64 / (frames - 1) as f64;
    let eef = (0..frames)
        .map(|frame| Vector3::new(size * at(time(frame)), 0.0, 0.0))
        .collect();
    along(eef, duration / (frames - 1) as f64)
}

fn minimum_jerk(t: f64) -> f64 {
    t.powi(3) * (10.0 - 15.0 * t + 6.0 * t * t)
}

#[test]
fn a_minimum_jerk_reach_has_its_known_dimensionless_jerk() {
    let known = -(720.0_f64 / 1.875_f64.powi(2)).ln();
    for (duration, size) in [(1.0, 1.0), (2.5, 0.1)] {
        let value = log_dimensionless_jerk(&reach(4001, duration, size, minimum_jerk)).unwrap();
        assert!((value - known).abs() < 5e-3, "{value}, known {known}");
    }
}

#[test]
fn no_reach_is_smoother_than_the_minimum_jerk_reach() {
    let best = log_dimensionless_jerk(&reach(401, 1.0, 1.0, minimum_jerk)).unwrap();
    for wobble in [0.01, 0.05, 0.2] {
        let at = |t: f64| minimum_jerk(t) + wobble * (4.0 * PI * t).sin().powi(3);
        assert!(log_dimensionless_jerk(&reach(401, 1.0, 1.0, at)).unwrap() < best);
    }
}

/// The spectrum of a half sine of duration T is known: its amplitude, normalised, is |cos(pi f T)| / |1 - (2 f T)^2|.
#[test]
fn the_spectral_arc_length_of_a_half_sine_follows_from_its_spectrum() {
    let duration = 1.0;
    let frames = 2001;
    let value = spectral_arc_length(&reach(frames, duration, 1.0, |t| (1.0 - (PI * t).cos()) / 2.0)).unwrap();
    let amplitude = |f: f64| {
        let x = 2.0 * f * duration;
        if (x - 1.0).abs() < 1e-6 {
            PI / 4.0
        } else {
            ((PI * f * duration).cos() / (1.0 - x * x)).abs()
        }
    };
    // The frequencies of a transform of 2,000 samples that are padded to 32,768.
    let step = 2000.0 / 32_768.0;
    let samples: Vec<f64> = (0..=163).map(|at| amplitude(f64::from(at) * step)).collect();
    let last = samples.iter().rposition(|&value| value >= 0.05).unwrap();
    let width = 1.0 / last as f64;
    let known: f64 = -(0..last)
        .map(|at| width.hypot(samples[at + 1] - samples[at]))
        .sum::<f64>();
    assert!((value - known).abs() < 1e-3, "{value}, known {known}");
}

#[test]
fn pauses_and_tremor_lower_the_spectral_arc_length() {
    let smooth = spectral_arc_length(&reach(41, 2.0, 1.0, minimum_jerk)).unwrap();
    let two_parts = |t: f64| {
        let part = |t: f64| minimum_jerk(t.clamp(0.0, 1.0)) / 2.0;
        part(t / 0.35) + part((t - 0.65) / 0.35)
    };
    let paused = spectral_arc_length(&reach(41, 2.0, 1.0, two_parts)).unwrap();
    let tremor = spectral_arc_length(&reach(41, 2.0, 1.0, |t| minimum_jerk(t) + 0.02 * (12.0 * PI * t).sin())).unwrap();
    assert!(paused < smooth - 0.1, "{paused}, {smooth}");
    assert!(tremor < smooth - 0.1, "{tremor}, {smooth}");
}

#[test]
fn path_efficiency_is_one_on_a_line_and_two_over_pi_on_a_half_circle() {
    assert_eq!(path_efficiency(&reach(50, 1.0, 1.0, minimum_jerk)), Some(1.0));
    let circle = (0..=1000).map(|at| {
        let (sin, cos) = (PI * f64::from(at) / 1000.0).sin_cos();
        Vector3::new(cos, sin, 0.0)
    });
    let value = path_efficiency(&along(circle.collect(), 0.05)).unwrap();
    assert!((value - 2.0 / PI).abs() < 1e-5, "{value}");
    assert_eq!(path_efficiency(&along(vec![Vector3::zeros(); 5], 0.05)), None);
}

/// A path with a corner is straight in parts if the corner is at a change of the mode.
#[test]
fn path_efficiency_and_envelope_are_by_segment() {
    let corner = |at: usize| {
        if at <= 20 {
            Vector3::new(at as f64, 0.0, 0.0)
        } else {
            Vector3::new(20.0, at as f64 - 20.0, 0.0)
        }
    };
    let mut motion = along((0..41).map(corner).collect(), 0.05);
    let whole = (path_efficiency(&motion).unwrap(), envelope_distance(&motion).unwrap());
    motion.segments = segments(&[[Mode::Transit; 20].as_slice(), &[Mode::Transfer; 21]].concat());
    assert_eq!(path_efficiency(&motion), Some(1.0));
    assert!(envelope_distance(&motion).unwrap() < 1e-9);
    assert!((whole.0 - 0.5_f64.sqrt()).abs() < 1e-12);
    assert!(whole.1 > 0.1);
}

/// A cubic curve with constant speed is its own envelope; a square wave of height h about a line is h away from it on average.
#[test]
fn the_envelope_distance_of_known_paths() {
    let zigzag = (0..=4000).map(|at| {
        let x = f64::from(at / 2);
        // Steps along x of 1, and up and down by 2 h at every 50th.
        let side = if (at / 2 / 50) % 2 == 0 { 0.5 } else { -0.5 };
        Vector3::new(x, side, 0.0)
    });
    let value = envelope_distance(&along(zigzag.collect(), 0.05)).unwrap();
    let travelled = 2000.0 + 39.0;
    assert!((value - 0.5 * travelled / 2000.0).abs() < 0.03, "{value}");
    let curve = (0..=400).map(|at| {
        let s = f64::from(at) / 400.0;
        Vector3::new(s, 0.02 * s * s * (1.0 - s), 0.0)
    });
    assert!(envelope_distance(&along(curve.collect(), 0.05)).unwrap() < 1e-5);
}

#[test]
fn idle_steps_are_those_without_motion_of_arm_and_fingers() {
    let mut eef: Vec<_> = (0..=40)
        .map(|at| Vector3::new(f64::from(at) * 0.01, 0.0, 0.0))
        .collect();
    eef.extend(vec![*eef.last().unwrap(); 60]);
    let mut motion = along(eef, 0.05);
    assert_eq!(idle_share(&motion), Some(0.6));
    // The fingers move in 10 of these steps.
    motion.fingers = (0..100)
        .map(|step| if (50..60).contains(&step) { 0.01 } else { 0.0 })
        .collect();
    assert_eq!(idle_share(&motion), Some(0.5));
    assert_eq!(idle_share(&along(vec![Vector3::zeros(); 9], 0.05)), None);
}

#[test]
fn regrasps_are_the_transfers_after_the_first() {
    use Mode::{Transfer as G, Transit as T};
    let mut motion = along(vec![Vector3::zeros(); 6], 0.05);
    assert_eq!(regrasps(&motion), None);
    motion.fingers = vec![0.0; 5];
    for (modes, count) in [([T; 6], 0.0), ([T, T, G, G, T, T], 0.0), ([T, G, T, G, T, G], 2.0)] {
        motion.segments = segments(&modes);
        assert_eq!(regrasps(&motion), Some(count));
    }
}

/// Uniform pseudo-random numbers in (0, 1).
fn uniform() -> impl FnMut() -> f64 {
    let mut state = 0x9e37_79b9_7f4a_7c15_u64;
    move || {
        state ^= state << 13;
        state ^= state >> 7;
        state ^= state << 17;
        ((state >> 11) as f64 + 0.5) / (1_u64 << 53) as f64
    }
}

/// Pairs of a state and an action whose first numbers are normal with this correlation.
fn correlated(count: usize, correlation: f64) -> Vec<[[f32; 7]; 2]> {
    let mut random = uniform();
    let mut normal = move || (-2.0 * random().ln()).sqrt() * (2.0 * PI * random()).cos();
    let mut pair = move || {
        let (a, b) = (normal(), normal());
        let action = correlation * a + (1.0 - correlation * correlation).sqrt() * b;
        let one = |value: f64| std::array::from_fn(|at| if at == 0 { value as f32 } else { 0.0 });
        [one(a), one(action)]
    };
    (0..count).map(|_| pair()).collect()
}

/// The mutual information of two normal numbers with correlation r is -ln(1 - r^2) / 2.
#[test]
fn the_information_of_normal_numbers_is_the_known_one() {
    for correlation in [0.0, 0.6, 0.9] {
        let chunks = correlated(3000, correlation);
        let demos: Vec<&[[[f32; 7]; 2]]> = chunks.chunks(30).collect();
        let values = information(&demos);
        let mean = values.iter().map(|value| value.unwrap()).sum::<f64>() / values.len() as f64;
        let known = -(1.0 - correlation * correlation).ln() / 2.0;
        assert!((mean - known).abs() < 0.05, "{mean}, known {known}");
    }
}

/// The estimate by brute force, from the definition.
fn brute(demos: &[&[[[f32; 7]; 2]]]) -> Vec<f64> {
    let all: Vec<[f64; 14]> = demos
        .iter()
        .flat_map(|demo| demo.iter())
        .map(|chunk| std::array::from_fn(|at| f64::from(chunk[at / 7][at % 7])))
        .collect();
    let count = all.len() as f64;
    let scaled: Vec<[f64; 14]> = {
        let moments: Vec<(f64, f64)> = (0..14)
            .map(|at| {
                let mean = all.iter().map(|point| point[at]).sum::<f64>() / count;
                (
                    mean,
                    (all.iter().map(|point| (point[at] - mean).powi(2)).sum::<f64>() / count).sqrt(),
                )
            })
            .collect();
        let scale = |value: f64, (mean, deviation): (f64, f64)| {
            if deviation > 0.0 {
                (value - mean) / deviation
            } else {
                0.0
            }
        };
        all.iter()
            .map(|point| std::array::from_fn(|at| scale(point[at], moments[at])))
            .collect()
    };
    let apart = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
    // psi(n) = -gamma + 1 + 1/2 + ... + 1/(n-1)
    let psi = |n: usize| -0.577_215_664_901_532_9 + (1..n).map(|at| 1.0 / at as f64).sum::<f64>();
    let contribution = |own: usize| {
        let others = || (0..scaled.len()).filter(move |&other| other != own);
        let mut joint: Vec<f64> = others().map(|other| apart(&scaled[own], &scaled[other])).collect();
        joint.sort_by(f64::total_cmp);
        let of = |k: usize| {
            let radius = joint[k - 1];
            let nearer = |part: std::ops::Range<usize>| {
                others()
                    .filter(|&other| apart(&scaled[own][part.clone()], &scaled[other][part.clone()]) < radius)
                    .count()
            };
            psi(k) + psi(scaled.len()) - psi(nearer(0..7) + 1) - psi(nearer(7..14) + 1)
        };
        (of(5) + of(6) + of(7)) / 3.0
    };
    let mut first = 0;
    demos
        .iter()
        .map(|demo| {
            let mean = (first..first + demo.len()).map(contribution).sum::<f64>() / demo.len() as f64;
            first += demo.len();
            mean
        })
        .collect()
}

#[test]
fn the_information_is_that_of_the_definition() {
    let mut random = uniform();
    let chunks: Vec<[[f32; 7]; 2]> = (0..300)
        .map(|_| {
            let state: [f32; 7] = std::array::from_fn(|_| random() as f32);
            [
                state,
                std::array::from_fn(|at| state[at] * state[0] + 0.1 * random() as f32),
            ]
        })
        .collect();
    let demos: Vec<&[[[f32; 7]; 2]]> = chunks.chunks(17).collect();
    for (value, known) in information(&demos).into_iter().zip(brute(&demos)) {
        assert!((value.unwrap() - known).abs() < 1e-9, "{value:?}, known {known}");
    }
}

#[test]
fn demonstrations_whose_actions_follow_from_the_state_have_more_information() {
    let mut random = uniform();
    let mut demo = |noise: f64| -> Vec<[[f32; 7]; 2]> {
        (0..40)
            .map(|_| {
                let state: [f32; 7] = std::array::from_fn(|at| if at < 3 { random() as f32 } else { 0.0 });
                [
                    state,
                    std::array::from_fn(|at| state[at] + (noise * (random() - 0.5)) as f32),
                ]
            })
            .collect()
    };
    let demos: Vec<Vec<[[f32; 7]; 2]>> = (0..20)
        .map(|number| demo(if number < 10 { 0.02 } else { 1.0 }))
        .collect();
    let slices: Vec<&[[[f32; 7]; 2]]> = demos.iter().map(Vec::as_slice).collect();
    let values: Vec<f64> = information(&slices).into_iter().map(Option::unwrap).collect();
    let worst_good = values[..10].iter().copied().fold(f64::INFINITY, f64::min);
    let best_poor = values[10..].iter().copied().fold(f64::NEG_INFINITY, f64::max);
    assert!(worst_good > best_poor, "{values:?}");
}

#[test]
fn information_needs_enough_chunks() {
    let chunks = correlated(8, 0.5);
    assert_eq!(information(&[&chunks, &[]]), vec![None, None]);
    let chunks = correlated(30, 0.5);
    let values = information(&[&chunks, &[]]);
    assert!(values[0].is_some() && values[1].is_none());
}

/// A random smooth path with pauses.
fn path() -> impl Strategy<Value = Vec<Vector3<f64>>> {
    proptest::collection::vec((-1.0..1.0_f64, -1.0..1.0_f64, -1.0..1.0_f64), 12..80).prop_map(|steps| {
        let (mut velocity, mut position) = (Vector3::zeros(), Vector3::zeros());
        let next = |(x, y, z): (f64, f64, f64)| {
            velocity = 0.8 * velocity + Vector3::new(x, y, z) * 0.01;
            position += velocity;
            position
        };
        steps.into_iter().map(next).collect()
    })
}

fn close(a: Option<f64>, b: Option<f64>, tolerance: f64) -> bool {
    match (a, b) {
        (Some(a), Some(b)) => (a - b).abs() <= tolerance * (1.0 + a.abs()),
        (a, b) => a == b,
    }
}

proptest! {
    /// A change of the size of a movement changes none of the dimensionless scores, and scales the envelope distance.
    #[test]
    fn amplitude_does_not_matter(path in path(), scale in 0.01..100.0_f64) {
        let one = along(path.clone(), 0.05);
        let other = along(path.iter().map(|position| position * scale).collect(), 0.05);
        for score in [log_dimensionless_jerk, spectral_arc_length, path_efficiency, idle_share] {
            prop_assert!(close(score(&one), score(&other), 1e-6), "{:?} {:?}", score(&one), score(&other));
        }
        let expected = envelope_distance(&one).map(|distance| distance * scale);
        prop_assert!(close(envelope_distance(&other), expected, 1e-6));
    }

    /// The duration of a frame matters to none of the scores but the spectral arc length, whose cut-off is a frequency.
    #[test]
    fn pace_does_not_matter(path in path(), period in 0.01..1.0_f64) {
        let (one, other) = (along(path.clone(), 0.05), along(path, period));
        for score in [log_dimensionless_jerk, path_efficiency, idle_share, envelope_distance] {
            prop_assert!(close(score(&one), score(&other), 1e-9));
        }
    }

    /// A rigid motion of the world changes nothing.
    #[test]
    fn place_and_orientation_do_not_matter(path in path(), angle in 0.0..3.0_f64, x in -5.0..5.0_f64) {
        let motion = nalgebra::Isometry3::new(Vector3::new(x, 1.0, -2.0), Vector3::new(angle, 0.3, -angle));
        let one = along(path.clone(), 0.05);
        let moved = |position: &Vector3<f64>| motion.transform_point(&(*position).into()).coords;
        let other = along(path.iter().map(moved).collect(), 0.05);
        for score in [log_dimensionless_jerk, spectral_arc_length, path_efficiency, idle_share, envelope_distance] {
            prop_assert!(close(score(&one), score(&other), 1e-6), "{:?} {:?}", score(&one), score(&other));
        }
    }
}
