//! Compares the SE(3) index with the linear scan, and the linear scan with an independent implementation of the definition.
#![allow(clippy::unwrap_used, reason = "a panic is how a test fails")]

mod common;

use std::collections::BTreeSet;
use std::f64::consts::{FRAC_PI_2, PI};

use common::Random;
use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};
use proptest::prelude::*;
use re4_episode::Mode;
use re4_fault::Remedy as _;
use re4_geometry::spatial::Symmetry;
use re4_index::{
    IndexError, IndexedSpatialFrame, SpatialIndex, SpatialMetric, SpatialQuery, SpatialRetrieved, Stage2,
    retrieve_spatial_linear,
};

const STAGES: [Stage2; 2] = [Stage2::Object, Stage2::State];

#[derive(Clone, Copy, Debug)]
enum Shape {
    /// Few positions, and rotations by multiples of 90 degrees, which give many duplicates, ties and rotations by 180 degrees.
    Grid,
    /// Uniform random poses.
    Scattered,
    /// The object rests, then moves with the end effector, as in a demonstration.
    Carried,
    /// Copies of a few episodes.
    Copies,
}

fn rotation(random: &mut Random) -> UnitQuaternion<f64> {
    let vector = Vector3::from_fn(|_, _| random.range(-1.0, 1.0));
    let q = UnitQuaternion::from_scaled_axis(vector.normalize() * random.range(0.0, PI));
    antipode(random, q)
}

/// The same rotation, represented by one of its two quaternions at random.
fn antipode(random: &mut Random, q: UnitQuaternion<f64>) -> UnitQuaternion<f64> {
    if random.below(2) == 0 {
        q
    } else {
        UnitQuaternion::new_unchecked(-q.into_inner())
    }
}

fn grid_pose(random: &mut Random) -> Isometry3<f64> {
    let mut q = UnitQuaternion::identity();
    for axis in [Vector3::x_axis(), Vector3::y_axis(), Vector3::z_axis()] {
        q = UnitQuaternion::from_axis_angle(&axis, random.below(4) as f64 * FRAC_PI_2) * q;
    }
    let t = Translation3::new(random.below(3) as f64 * 0.25, random.below(2) as f64 * 0.25, 0.5);
    Isometry3::from_parts(t, antipode(random, q))
}

fn any_pose(random: &mut Random) -> Isometry3<f64> {
    let t = Vector3::from_fn(|_, _| random.range(-0.4, 0.4));
    Isometry3::from_parts(t.into(), rotation(random))
}

/// Perturbs a pose by up to `length` metres and `angle` rad along each axis.
fn perturb(random: &mut Random, pose: &Isometry3<f64>, length: f64, angle: f64) -> Isometry3<f64> {
    let t = Vector3::from_fn(|_, _| random.range(-length, length));
    let r = Vector3::from_fn(|_, _| random.range(-angle, angle));
    let rotation = UnitQuaternion::from_scaled_axis(r) * pose.rotation;
    Isometry3::from_parts((pose.translation.vector + t).into(), antipode(random, rotation))
}

/// Mode, end effector and object.
type State = (Mode, Isometry3<f64>, Isometry3<f64>);

fn demonstrations(random: &mut Random, shape: Shape, episodes: usize, longest: usize) -> Vec<IndexedSpatialFrame> {
    let mut made: Vec<Vec<State>> = Vec::new();
    for _ in 0..episodes {
        if matches!(shape, Shape::Copies) && made.len() >= 3 {
            made.push(made[random.below(3)].clone());
            continue;
        }
        let (mut eef, mut object) = (any_pose(random), any_pose(random));
        let count = random.below(longest) + 1;
        let frames = (0..count).map(|i| match shape {
            Shape::Grid | Shape::Copies => (random.pick(&Mode::ALL), grid_pose(random), grid_pose(random)),
            Shape::Scattered => (random.pick(&Mode::ALL), any_pose(random), any_pose(random)),
            Shape::Carried => {
                let object_from_eef = object.inv_mul(&eef);
                eef = perturb(random, &eef, 0.02, 0.05);
                if 2 * i > count {
                    object = eef * object_from_eef.inverse();
                    (Mode::Transfer, eef, object)
                } else {
                    (Mode::Transit, eef, perturb(random, &object, 1e-6, 1e-6))
                }
            }
        });
        made.push(frames.collect());
    }
    // The episode numbers have gaps because they identify demonstrations and are not positions.
    (0..)
        .step_by(3)
        .zip(made)
        .flat_map(|(episode, frames)| {
            (0..)
                .zip(frames)
                .map(move |(frame, (mode, eef, object))| IndexedSpatialFrame {
                    episode,
                    frame,
                    mode,
                    eef,
                    object,
                })
        })
        .collect()
}

fn any_query(random: &mut Random, frames: &[IndexedSpatialFrame]) -> SpatialQuery {
    let near = random.pick(frames);
    let mode = random.pick(&Mode::ALL);
    let (eef, object) = match random.below(5) {
        0 => (near.eef, near.object),
        1 => {
            let rotation = antipode(random, near.object.rotation);
            (near.eef, Isometry3::from_parts(near.object.translation, rotation))
        }
        2 => (grid_pose(random), grid_pose(random)),
        3 => (any_pose(random), any_pose(random)),
        _ => (
            perturb(random, &near.eef, 0.03, 0.3),
            perturb(random, &near.object, 0.03, 0.3),
        ),
    };
    SpatialQuery { mode, eef, object }
}

fn any_metric(random: &mut Random) -> SpatialMetric {
    let axis = random.pick(&[[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.3, -0.4, 0.5]]);
    let symmetry = match random.below(4) {
        0 => Symmetry::None,
        1 => Symmetry::Full { axis },
        _ => Symmetry::Fold {
            axis,
            n: random.pick(&[2, 3, 4, 17]),
        },
    };
    SpatialMetric {
        translation_scale: random.pick(&[0.1, 1.0, 0.003]),
        rotation_scale: random.pick(&[1.0, 0.2]),
        object_weight: random.pick(&[1.0, 1.0, 0.3, 0.0]),
        eef_weight: random.pick(&[1.0, 1.0, 2.5, 0.0]),
        symmetry,
    }
}

/// The answer with its distances as bit patterns, so that the comparison is bit-exact.
fn bits(answer: Option<SpatialRetrieved>) -> Option<(u32, u32, [u64; 4])> {
    answer.map(|a| {
        let d = a.distances;
        let distances = [d.d_q, d.d_o, d.d_e, d.symmetry_rotation];
        (a.episode, a.frame, distances.map(f64::to_bits))
    })
}

fn banned(random: &mut Random, frames: &[IndexedSpatialFrame]) -> BTreeSet<u32> {
    let one = frames[random.below(frames.len())].episode;
    match random.below(4) {
        0 => frames.iter().map(|f| f.episode).collect(),
        1 => frames.iter().map(|f| f.episode).filter(|&e| e != one).collect(),
        2 => [one, 1].into(),
        _ => BTreeSet::new(),
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(400))]

    #[test]
    fn index_and_linear_scan_agree(seed in any::<u64>(), shape in 0..4usize, size in 0..5usize) {
        let mut random = Random::new(seed);
        let shape = [Shape::Grid, Shape::Scattered, Shape::Carried, Shape::Copies][shape];
        let (episodes, longest) = [(1, 1), (1, 40), (40, 1), (9, 30), (30, 12)][size];
        let frames = demonstrations(&mut random, shape, episodes, longest);
        let metric = any_metric(&mut random);
        let index = SpatialIndex::build(frames.clone(), metric).unwrap();
        for _ in 0..40 {
            let query = any_query(&mut random, &frames);
            let stage2 = random.pick(&STAGES);
            let banned = banned(&mut random, &frames);
            let slow = retrieve_spatial_linear(&frames, &metric, &query, stage2, &banned).unwrap();
            let fast = index.retrieve(&query, stage2, &banned).unwrap();
            prop_assert_eq!(bits(fast), bits(slow), "{:?} {:?} {:?}", query, metric, banned);
            prop_assert_eq!(bits(index.retrieve_scanning(&query, stage2, &banned).unwrap()), bits(slow));
            prop_assert_eq!(slow.is_some(), frames.iter().any(|f| f.mode == query.mode));
            if let Some(found) = slow {
                let frame = frames.iter().find(|f| (f.episode, f.frame) == (found.episode, found.frame)).unwrap();
                let again = index.distances(&query, &frame.eef, &frame.object).unwrap();
                prop_assert_eq!(again, found.distances);
            }
        }
    }
}

/// Angle of the rotation between two poses, computed from rotation matrices.
fn matrix_angle(a: &Isometry3<f64>, b: &Isometry3<f64>) -> f64 {
    let relative = a.rotation.to_rotation_matrix().inverse() * b.rotation.to_rotation_matrix();
    (0.5 * (relative.matrix().trace() - 1.0)).clamp(-1.0, 1.0).acos()
}

/// Implements Retrieve as the paper defines it, with rotation matrices and sorted lists. It tries every rotation of a discrete
/// symmetry.
fn by_definition(
    frames: &[IndexedSpatialFrame],
    metric: &SpatialMetric,
    query: &SpatialQuery,
    stage2: Stage2,
    banned: &BTreeSet<u32>,
) -> Option<(u32, u32, f64, f64)> {
    let distance = |a: &Isometry3<f64>, b: &Isometry3<f64>| {
        (a.translation.vector - b.translation.vector).norm() / metric.translation_scale
            + matrix_angle(a, b) / metric.rotation_scale
    };
    let rotations = match metric.symmetry {
        Symmetry::Fold { axis, n } => (0..n)
            .map(|k| {
                let axis = Vector3::from(axis).normalize();
                UnitQuaternion::from_scaled_axis(axis * (std::f64::consts::TAU * f64::from(k) / f64::from(n)))
            })
            .collect(),
        _ => vec![UnitQuaternion::identity()],
    };
    let measured = |f: &IndexedSpatialFrame| {
        let equivalent = rotations.iter().map(|rotation| query.object * rotation);
        let nearest = equivalent
            .map(|object| (matrix_angle(&object, &f.object), object))
            .reduce(|best, next| if next.0 < best.0 - 1e-9 { next } else { best })
            .unwrap()
            .1;
        let d_o = distance(&nearest, &f.object);
        let d_e = distance(&(nearest.inverse() * query.eef), &(f.object.inverse() * f.eef));
        (metric.object_weight * d_o + metric.eef_weight * d_e, d_o)
    };
    let episodes: BTreeSet<u32> = frames.iter().map(|f| f.episode).collect();
    let mut winners: Vec<(bool, u32, u32, f64, f64)> = episodes
        .into_iter()
        .filter_map(|episode| {
            let mut all: Vec<_> = frames
                .iter()
                .filter(|f| f.episode == episode && f.mode == query.mode)
                .map(|f| (f.frame, measured(f)))
                .collect();
            all.sort_by(|a, b| a.1.0.total_cmp(&b.1.0));
            let (frame, (d_q, d_o)) = *all.first()?;
            Some((banned.contains(&episode), episode, frame, d_q, d_o))
        })
        .collect();
    let key = |w: &(bool, u32, u32, f64, f64)| if stage2 == Stage2::Object { w.4 } else { w.3 };
    winners.sort_by(|a, b| a.0.cmp(&b.0).then(key(a).total_cmp(&key(b))));
    winners.first().map(|w| (w.1, w.2, w.3, w.4))
}

#[test]
fn the_linear_scan_matches_the_definition() {
    let mut random = Random::new(11);
    let mut compared = 0;
    for set in 0..300 {
        let shape = [Shape::Scattered, Shape::Carried][set % 2];
        let frames = demonstrations(&mut random, shape, 8, 14);
        let mut metric = any_metric(&mut random);
        if matches!(metric.symmetry, Symmetry::Full { .. }) || metric.object_weight == 0.0 || metric.eef_weight == 0.0 {
            metric = SpatialMetric::default();
        }
        for _ in 0..20 {
            // The perturbation avoids ties, which the two implementations may resolve differently because of rounding. The
            // property test above covers ties.
            let mut query = any_query(&mut random, &frames);
            query.object = perturb(&mut random, &query.object, 0.02, 0.2);
            query.eef = perturb(&mut random, &query.eef, 0.02, 0.2);
            let (stage2, banned) = (random.pick(&STAGES), banned(&mut random, &frames));
            let found = retrieve_spatial_linear(&frames, &metric, &query, stage2, &banned).unwrap();
            let defined = by_definition(&frames, &metric, &query, stage2, &banned);
            assert_eq!(
                found.map(|f| (f.episode, f.frame)),
                defined.map(|d| (d.0, d.1)),
                "{query:?} {metric:?}"
            );
            if let (Some(f), Some((_, _, d_q, d_o))) = (found, defined) {
                assert!((f.distances.d_q - d_q).abs() < 1e-6 * (1.0 + d_q), "{f:?} {d_q}");
                assert!((f.distances.d_o - d_o).abs() < 1e-6 * (1.0 + d_o), "{f:?} {d_o}");
                compared += 1;
            }
        }
    }
    assert!(compared > 4000, "{compared}");
}

#[test]
fn rotating_a_can_about_its_axis_changes_no_distance() {
    let mut random = Random::new(12);
    let frames = demonstrations(&mut random, Shape::Carried, 12, 30);
    let metric = SpatialMetric {
        symmetry: Symmetry::Full { axis: [0.0, 0.0, 1.0] },
        ..SpatialMetric::default()
    };
    for _ in 0..300 {
        let query = any_query(&mut random, &frames);
        let frame = random.pick(&frames);
        let index = SpatialIndex::build(vec![frame], metric).unwrap();
        let plain = index.distances(&query, &frame.eef, &frame.object).unwrap();
        let yaw = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), random.range(-PI, PI));
        let rotated = SpatialQuery {
            object: query.object * yaw,
            ..query
        };
        let other = index.distances(&rotated, &frame.eef, &(frame.object * yaw)).unwrap();
        // The query's can and the frame's can both have a different yaw, which must change neither term.
        assert!((plain.d_o - other.d_o).abs() < 1e-9);
        assert!((plain.d_e - other.d_e).abs() < 1e-6, "{plain:?} {other:?}");
    }
}

#[test]
fn few_demonstrations_are_evaluated() {
    let mut random = Random::new(13);
    let frames = demonstrations(&mut random, Shape::Carried, 200, 150);
    let index = SpatialIndex::build(frames.clone(), SpatialMetric::default()).unwrap();
    let mut evaluated = 0;
    for _ in 0..100 {
        let query = any_query(&mut random, &frames);
        let (_, statistics) = index
            .retrieve_counted(&query, Stage2::Object, &BTreeSet::new())
            .unwrap();
        evaluated += statistics.demos_evaluated;
    }
    assert!(evaluated < 100 * 100, "{evaluated} of {}", 100 * 200);
}

#[test]
fn errors_name_the_invalid_value() {
    let pose = Isometry3::identity();
    let frame = |episode, number, eef| IndexedSpatialFrame {
        episode,
        frame: number,
        mode: Mode::Transit,
        eef,
        object: pose,
    };
    let build = |frames, metric| SpatialIndex::build(frames, metric).map(|_| ()).unwrap_err();
    let metric = SpatialMetric::default();
    assert_eq!(build(vec![], metric), IndexError::Empty);
    let twice = vec![frame(4, 7, pose), frame(4, 6, pose), frame(4, 7, pose)];
    assert_eq!(build(twice, metric), IndexError::Duplicate { episode: 4, frame: 7 });
    for bad in [f64::NAN, f64::INFINITY, 1e120] {
        let invalid = Isometry3::translation(0.0, bad, 0.0);
        let refused = build(vec![frame(4, 7, invalid)], metric);
        assert_eq!(refused, IndexError::NotFinite { episode: 4, frame: 7 });
        let index = SpatialIndex::build(vec![frame(4, 7, pose)], metric).unwrap();
        let query = SpatialQuery {
            mode: Mode::Transit,
            eef: pose,
            object: invalid,
        };
        let refused = index.retrieve(&query, Stage2::Object, &BTreeSet::new()).unwrap_err();
        assert_eq!(refused, IndexError::QueryNotFinite);
        for name in ["translation scale", "rotation scale"] {
            let (translation_scale, rotation_scale) = if name == "rotation scale" {
                (1.0, bad)
            } else {
                (bad, 1.0)
            };
            let refused = build(
                vec![frame(0, 0, pose)],
                SpatialMetric {
                    translation_scale,
                    rotation_scale,
                    ..metric
                },
            );
            assert!(refused.sentence().contains(name), "{refused}");
        }
        let refused = build(
            vec![frame(0, 0, pose)],
            SpatialMetric {
                eef_weight: bad,
                ..metric
            },
        );
        assert!(refused.sentence().contains("weight of the end effector"), "{refused}");
    }
    for scale in [0.0, -1.0] {
        let refused = build(
            vec![frame(0, 0, pose)],
            SpatialMetric {
                rotation_scale: scale,
                ..metric
            },
        );
        assert!(refused.sentence().contains("above 0"), "{refused}");
    }
    let no_rotations = Symmetry::Fold {
        axis: [0.0, 0.0, 1.0],
        n: 0,
    };
    let refused = build(
        vec![frame(0, 0, pose)],
        SpatialMetric {
            symmetry: no_rotations,
            ..metric
        },
    );
    assert!(refused.to_string().contains("n = 0"), "{refused}");
    let index = SpatialIndex::build(vec![frame(4, 7, pose)], metric).unwrap();
    let query = SpatialQuery {
        mode: Mode::Transfer,
        eef: pose,
        object: pose,
    };
    assert_eq!(index.retrieve(&query, Stage2::Object, &BTreeSet::new()).unwrap(), None);
}
