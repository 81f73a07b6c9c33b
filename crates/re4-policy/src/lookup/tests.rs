//! Tests of the parts that the retrieval baselines share, against brute force.

use std::f64::consts::TAU;

use nalgebra::{Isometry3, UnitQuaternion, Vector3};
use proptest::prelude::*;
use re4_geometry::spatial::rotation_angle;
use re4_geometry::{Point2, Pose2};
use re4_index::{AngleMetric, Normalization, Range};
use re4_rollout::{ArmAction, ArmState, Plane, Space};

use super::*;

/// Ranges of 0 to 512 px and of 0 to 2π.
pub(crate) fn scales() -> Normalization {
    let range = |maximum| Range { minimum: 0.0, maximum };
    Normalization {
        ranges: [range(512.0), range(512.0), range(512.0), range(512.0), range(TAU)],
        angle: AngleMetric::Periodic,
    }
}

/// Frames of demonstrations, from lists of pusher, block and action.
pub(crate) fn memory(demos: &[Vec<(Point2, Pose2, Point2)>]) -> Memory<Plane> {
    let scales = scales();
    let mut entries = Vec::new();
    for (demo, frames) in (0..).zip(demos) {
        for (frame, (proprio, object, action)) in (0..).zip(frames) {
            entries.push(Entry {
                demo,
                frame,
                retrievable: true,
                proprio: *proprio,
                object: *object,
                action: *action,
                state: Plane::state(&scales, proprio, object),
            });
        }
    }
    Memory { entries, scales }
}

fn entry(proprio: Point2, object: Pose2, action: Point2) -> Entry<Plane> {
    memory(&[vec![(proprio, object, action)]]).entries[0]
}

fn field(frame: ActionFrame, progression: f64, attraction: f64) -> Field {
    Field {
        frame,
        progression,
        attraction,
    }
}

fn point() -> impl Strategy<Value = Point2> {
    (0.0..512.0f64, 0.0..512.0f64).prop_map(|(x, y)| Point2::new(x, y))
}

fn pose() -> impl Strategy<Value = Pose2> {
    (point(), 0.0..TAU).prop_map(|(p, theta)| Pose2::new(p.x, p.y, theta))
}

fn rotation() -> impl Strategy<Value = UnitQuaternion<f64>> {
    prop::array::uniform3(-2.0..2.0f64).prop_map(rotation_from)
}

fn rotation_from(vector: [f64; 3]) -> UnitQuaternion<f64> {
    UnitQuaternion::from_scaled_axis(Vector3::from(vector))
}

fn pose3() -> impl Strategy<Value = Isometry3<f64>> {
    (prop::array::uniform3(-1.0..1.0f64), rotation())
        .prop_map(|(p, rotation)| Isometry3::from_parts(Vector3::from(p).into(), rotation))
}

proptest! {
    #[test]
    fn the_nearest_are_those_of_a_full_sort(
        distances in prop::collection::vec(prop::option::of(0..20u32), 0..60),
        count in 1..9usize,
    ) {
        let distances: Vec<Option<f64>> = distances.into_iter().map(|d| d.map(f64::from)).collect();
        let mut all: Vec<(f64, usize)> =
            distances.iter().enumerate().filter_map(|(at, d)| Some(((*d)?, at))).collect();
        all.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        all.truncate(count);
        prop_assert_eq!(nearest(distances.iter().copied(), count), all);
    }

    #[test]
    fn the_distance_of_push_t_is_that_of_its_formula(a in (point(), pose()), b in (point(), pose())) {
        let scales = scales();
        let (of_a, of_b) = (Plane::state(&scales, &a.0, &a.1), Plane::state(&scales, &b.0, &b.1));
        let unit = |v: f64| v / 256.0;
        // Over all aliases of the angle.
        let angle = (-2..=2).map(|turns| (a.1.theta - b.1.theta + f64::from(turns) * TAU).abs() / (TAU / 2.0));
        let angle = angle.fold(f64::INFINITY, f64::min);
        let oracle = unit(a.0.x - b.0.x).powi(2) + unit(a.0.y - b.0.y).powi(2)
            + unit(a.1.x - b.1.x).powi(2) + unit(a.1.y - b.1.y).powi(2) + angle * angle;
        prop_assert!((Plane::squared(&scales, &of_a, &of_b) - oracle).abs() < 1e-9);
        // The features have nearly the same distance if the states are close.
        let (x, y) = (Plane::features(&scales, &of_a), Plane::features(&scales, &of_b));
        prop_assert!(squared(&x, &y) <= oracle + 1e-9);
        prop_assert!(squared(&x, &y) >= oracle - (1.0 - 4.0 / (TAU / 2.0).powi(2)) * angle * angle - 1e-9);
    }

    #[test]
    fn with_unit_weights_the_field_leads_to_the_recorded_action(
        frames in prop::collection::vec((point(), pose(), point()), 1..4),
        here in (point(), pose()),
        object_frame in any::<bool>(),
    ) {
        let frame = if object_frame { ActionFrame::Object } else { ActionFrame::World };
        let entries: Vec<Entry<Plane>> = frames.iter().map(|(p, o, a)| entry(*p, *o, *a)).collect();
        let weight = 1.0 / entries.len() as f64;
        let neighbors: Vec<_> = entries.iter().map(|entry| (weight, entry)).collect();
        let flow = Plane::flow(&neighbors, &here.0, &here.1, &field(frame, 1.0, 1.0));
        let mean = Plane::mean(&neighbors, &here.1, frame);
        prop_assert!((flow - mean).norm() < 1e-6);
    }

    /// With actions in the frame of the object, a motion of the block and the pusher moves the action in the same way. With
    /// world actions it does not.
    #[test]
    fn the_field_commutes_with_motions_of_the_scene(
        frames in prop::collection::vec((point(), pose(), point()), 1..4),
        here in (point(), pose()),
        motion in pose(),
        weights in (0.0..2.0f64, 0.0..2.0f64),
    ) {
        let entries: Vec<Entry<Plane>> = frames.iter().map(|(p, o, a)| entry(*p, *o, *a)).collect();
        let weight = 1.0 / entries.len() as f64;
        let neighbors: Vec<_> = entries.iter().map(|entry| (weight, entry)).collect();
        let field = field(ActionFrame::Object, weights.0, weights.1);
        let still = Plane::flow(&neighbors, &here.0, &here.1, &field);
        let moved = Plane::flow(&neighbors, &motion.transform_point(here.0), &motion.compose(here.1), &field);
        prop_assert!((moved - motion.transform_point(still)).norm() < 1e-6);
        let world = Plane::mean(&neighbors, &motion.compose(here.1), ActionFrame::World);
        prop_assert!((world - Plane::mean(&neighbors, &here.1, ActionFrame::World)).norm() < 1e-9);
    }

    #[test]
    fn the_field_in_se3_commutes_with_motions_of_the_scene(
        parts in prop::collection::vec((pose3(), pose3(), pose3()), 1..4),
        here in (pose3(), pose3()),
        motion in pose3(),
        weights in (0.0..2.0f64, 0.0..2.0f64),
    ) {
        let entries: Vec<Entry<Space>> = parts.iter().map(|(e, o, g)| space_entry(e, o, g)).collect();
        let weight = 1.0 / entries.len() as f64;
        let neighbors: Vec<_> = entries.iter().map(|entry| (weight, entry)).collect();
        let field = field(ActionFrame::Object, weights.0, weights.1);
        let arm = |eef| ArmState { eef, fingers: [0.04, -0.04] };
        let still = Space::flow(&neighbors, &arm(here.0), &here.1, &field).goal;
        let moved = Space::flow(&neighbors, &arm(motion * here.0), &(motion * here.1), &field).goal;
        prop_assert!((moved.translation.vector - (motion * still).translation.vector).norm() < 1e-9);
        prop_assert!(rotation_angle(&moved.rotation, &(motion * still).rotation) < 1e-7);
        let mean = Space::mean(&neighbors, &here.1, ActionFrame::Object).goal;
        let of_moved = Space::mean(&neighbors, &(motion * here.1), ActionFrame::Object).goal;
        prop_assert!((of_moved.translation.vector - (motion * mean).translation.vector).norm() < 1e-9);
        prop_assert!(rotation_angle(&of_moved.rotation, &(motion * mean).rotation) < 1e-7);
    }

    #[test]
    fn the_mean_of_two_rotations_is_halfway(a in rotation(), b in rotation(), flip in any::<bool>()) {
        prop_assume!(rotation_angle(&a, &b) < 3.0);
        let signed = if flip { UnitQuaternion::new_unchecked(-b.into_inner()) } else { b };
        let mean = space::mean_of_rotations(&[(0.5, a), (0.5, signed)]).unwrap();
        let (to_a, to_b) = (rotation_angle(&mean, &a), rotation_angle(&mean, &b));
        prop_assert!((to_a - to_b).abs() < 1e-7, "{to_a} {to_b}");
        prop_assert!((to_a + to_b - rotation_angle(&a, &b)).abs() < 1e-7);
    }

    #[test]
    fn the_distance_in_se3_is_that_of_its_formula(a in (pose3(), pose3()), b in (pose3(), pose3())) {
        let weights = SpaceWeights { eef_rotation: 0.5, object_rotation: 2.0, eef_position: 3.0, ..SpaceWeights::default() };
        let scales = space::unit_scales(weights);
        let arm = |eef, gap: f64| ArmState { eef, fingers: [gap / 2.0, -gap / 2.0] };
        let state = |(eef, object): (Isometry3<f64>, Isometry3<f64>), gap| Space::state(&scales, &arm(eef, gap), &object);
        let angle = |p: &Isometry3<f64>, q: &Isometry3<f64>| 2.0 * p.rotation.coords.dot(&q.rotation.coords).abs().min(1.0).acos();
        let distance = |p: &Isometry3<f64>, q: &Isometry3<f64>| (p.translation.vector - q.translation.vector).norm_squared();
        let oracle = 3.0 * distance(&a.0, &b.0) + distance(&a.1, &b.1) + 0.25
            + 0.5 * angle(&a.0, &b.0).powi(2) + 2.0 * angle(&a.1, &b.1).powi(2);
        prop_assert!((Space::squared(&scales, &state(a, 0.5), &state(b, 0.0)) - oracle).abs() < 1e-6);
    }
}

fn space_entry(eef: &Isometry3<f64>, object: &Isometry3<f64>, goal: &Isometry3<f64>) -> Entry<Space> {
    let proprio = ArmState {
        eef: *eef,
        fingers: [0.04, -0.04],
    };
    Entry {
        demo: 0,
        frame: 0,
        retrievable: true,
        proprio,
        object: *object,
        action: ArmAction {
            goal: *goal,
            gripper: -1.0,
        },
        state: Space::state(&space::unit_scales(SpaceWeights::default()), &proprio, object),
    }
}

#[test]
fn used_frames_are_remembered_up_to_the_limit() {
    let mut used = UsedFrames::new(5, Some(2));
    for at in [0, 1, 1, 2] {
        used.insert(at);
    }
    assert_eq!([0, 1, 2, 3].map(|at| used.contains(at)), [false, true, true, false]);
    let mut all = UsedFrames::new(5, None);
    (0..5).for_each(|at| all.insert(at));
    assert_eq!(all.len(), 5);
    all.clear();
    assert!(!(0..5).any(|at| all.contains(at)));
    let mut none = UsedFrames::new(5, Some(0));
    none.insert(3);
    assert!(!none.contains(3));
}

#[test]
fn noise_decays_to_its_floor_and_depends_on_the_seed() {
    let config = QueryNoiseConfig {
        sigma: 0.01,
        decay: 0.5,
        floor: 0.002,
    };
    let mut noise = QueryNoise::new(7, config);
    let sigmas: Vec<f64> = (0..4).filter_map(|_| noise.next_sigma()).collect();
    assert_eq!(sigmas, [0.01, 0.005, 0.0025, 0.002]);
    let draw = |seed| {
        let mut noise = QueryNoise::new(seed, config);
        (0..10_000).map(|_| noise.normal()).collect::<Vec<f64>>()
    };
    let numbers = draw(7);
    assert_eq!(numbers, draw(7));
    assert_ne!(numbers, draw(8));
    let mean = numbers.iter().sum::<f64>() / 1e4;
    let variance = numbers.iter().map(|v| (v - mean) * (v - mean)).sum::<f64>() / 1e4;
    assert!(mean.abs() < 0.05 && (variance - 1.0).abs() < 0.05, "{mean} {variance}");
    let silent = QueryNoiseConfig { sigma: 0.0, ..config };
    assert_eq!(QueryNoise::new(7, silent).next_sigma(), None);
    // Coordinates of a query stay within the range of the demonstrations.
    let mut state = [0.99, -0.99, 0.0, 0.5, 1.0];
    Plane::perturb(&mut state, &mut || 0.1);
    assert_eq!(state, [1.0, -0.89, 0.1, 0.6, 1.0]);
}

#[test]
fn weights_are_those_of_their_formulas() {
    let inverse = inverse_weights([1.0, 3.0].into_iter());
    assert!((inverse[0] - 0.75).abs() < 1e-6 && (inverse[1] - 0.25).abs() < 1e-6);
    let soft = softmax_weights(&[1.0, 2.0], 0.5);
    let oracle = 1.0 / (1.0 + (-2.0f64).exp());
    assert!((soft[0] - oracle).abs() < 1e-12 && (soft[0] + soft[1] - 1.0).abs() < 1e-12);
    // Also far from all demonstrations, where the exponentials alone would be 0.
    assert!((softmax_weights(&[1e6, 1e6], 1e-3)[0] - 0.5).abs() < 1e-12);
}

#[test]
fn a_latent_space_keeps_distances_and_orders_variances() {
    let rows: Vec<Vec<f64>> = (0..50)
        .map(|i| {
            let (s, c) = f64::from(i).sin_cos();
            vec![s + 2.0 * c, 3.0 * s - c, 0.1 * (f64::from(i) * 1.7).sin()]
        })
        .collect();
    let all = Latent::fit(&rows, 9, 0.0);
    let codes: Vec<Vec<f64>> = rows.iter().map(|row| all.of(row)).collect();
    for (a, b) in [(0, 1), (3, 40), (12, 13)] {
        assert!((squared(&codes[a], &codes[b]) - squared(&rows[a], &rows[b])).abs() < 1e-9);
    }
    let variance = |i: usize| codes.iter().map(|code| code[i] * code[i]).sum::<f64>() / 49.0;
    assert!(variance(0) >= variance(1) && variance(1) >= variance(2));
    assert_eq!(Latent::fit(&rows, 2, 0.0).of(&rows[4]), codes[4][..2]);
    // Divided by the fourth root of the variance, a component has the root of its variance.
    let whitened = Latent::fit(&rows, 1, 0.25);
    let rescaled = rows.iter().map(|row| whitened.of(row)[0].powi(2)).sum::<f64>() / 49.0;
    assert!((rescaled - variance(0).sqrt()).abs() < 1e-6);
}

#[test]
fn runs_and_histories_stay_within_a_demonstration() {
    let frame = (Point2::zeros(), Pose2::IDENTITY, Point2::zeros());
    let memory = memory(&[vec![frame; 3], vec![frame; 4]]);
    assert_eq!([memory.run(1, 8), memory.run(3, 2), memory.run(6, 8)], [2, 2, 1]);
    assert_eq!(
        [memory.before(4, 1), memory.before(4, 5), memory.before(2, 2)],
        [3, 3, 0]
    );
}
