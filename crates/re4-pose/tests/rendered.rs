//! The estimator on images of the simulator's renderer, for which the poses are known.

mod common;

use std::sync::LazyLock;

use common::{PUSHER, error, estimator, outline, paint_disc, rendered, unobstructed, view};
use proptest::prelude::*;
use re4_fault::Remedy as _;
use re4_geometry::{Point2, Pose2};
use re4_pose::{AnchorBuilder, AnchorError, Flag, LogPolarEstimator, PushtImage, Storage};
use re4_sim::{GOAL, PushT, ResetOrder, Scene, Simulator as _};

static REFINED: LazyLock<LogPolarEstimator> = LazyLock::new(|| estimator(true));
static CLOSED_FORM: LazyLock<LogPolarEstimator> = LazyLock::new(|| estimator(false));

fn block() -> impl Strategy<Value = Pose2> {
    (135.0..375.0f64, 135.0..375.0f64, 0.0..std::f64::consts::TAU).prop_map(|(x, y, t)| Pose2::new(x, y, t))
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(400))]

    #[test]
    fn a_completely_visible_block_is_found(truth in block()) {
        let image = unobstructed(truth);
        let estimate = REFINED.estimate(&view(&image));
        let (position, angle) = error(&estimate, truth);
        prop_assert!(position < 2.0 && angle < 1.5, "{position} px, {angle} degrees");
        prop_assert_eq!(estimate.flag, Flag::Clear);
        prop_assert!(estimate.confidence > 0.8, "{}", estimate.confidence);
        // The paper's closed form without refinement is less accurate, but never wrong by pi.
        let (position, angle) = error(&CLOSED_FORM.estimate(&view(&image)), truth);
        prop_assert!(position < 6.0 && angle < 4.0, "{position} px, {angle} degrees");
    }

    #[test]
    fn a_pusher_on_the_block_is_tolerated(truth in block(), along in 0.0..120.0f64, across in -45.0..45.0f64) {
        let agent = truth.transform_point(Point2::new(across, along));
        let image = rendered(agent, truth);
        let estimate = REFINED.estimate(&view(&image));
        let (position, angle) = error(&estimate, truth);
        prop_assert!(position < 3.0 && angle < 3.0, "{position} px, {angle} degrees, {estimate:?}");
    }

    /// If a pose has the flag `Clear`, it is accurate, whatever hides the block.
    #[test]
    fn a_clear_pose_is_accurate(truth in block(), x in -70.0..70.0f64, y in -30.0..130.0f64, radius in 10.0..90.0f64) {
        let mut image = unobstructed(truth);
        paint_disc(&mut image, truth.transform_point(Point2::new(x, y)), radius, PUSHER);
        let estimate = REFINED.estimate(&view(&image));
        if estimate.flag == Flag::Clear {
            let (position, angle) = error(&estimate, truth);
            prop_assert!(position < 4.0 && angle < 4.0, "{position} px, {angle} degrees, {estimate:?}");
        }
    }

    #[test]
    fn a_second_block_is_detected(one in block(), other in block()) {
        prop_assume!((one.transform_point(Point2::new(0.0, 45.0)) - other.transform_point(Point2::new(0.0, 45.0))).norm() > 60.0);
        let mut image = unobstructed(one);
        let second = unobstructed(other);
        let empty = unobstructed(Pose2::new(-900.0, -900.0, 0.0));
        for ((pixel, second), empty) in image.iter_mut().zip(&second).zip(&empty) {
            if second != empty {
                *pixel = *second;
            }
        }
        prop_assert_eq!(REFINED.estimate(&view(&image)).flag, Flag::SecondBlock);
    }
}

#[test]
fn contact_marks_are_tolerated() {
    let mut simulator = PushT::new().unwrap();
    let scene = Scene::from_observed(Point2::new(256.0, 150.0), Pose2::new(256.0, 200.0, 0.0));
    simulator.reset(&scene, ResetOrder::Legacy).unwrap();
    let mut touched = 0;
    for _ in 0..30 {
        let after = simulator.step(&Point2::new(256.0, 420.0)).unwrap();
        touched += u32::from(after.contacts > 0);
        let estimate = REFINED.estimate(&view(&simulator.render().observation()));
        let (position, angle) = error(&estimate, after.observation.block);
        assert!(position < 2.5 && angle < 2.0, "{position} px, {angle} degrees");
        assert_eq!(estimate.flag, Flag::Clear);
    }
    assert!(touched >= 10, "{touched} steps with contact");
}

#[test]
fn without_a_block_there_is_no_pose() {
    let mut hidden = unobstructed(Pose2::new(200.0, 200.0, 1.0));
    paint_disc(&mut hidden, Point2::new(190.0, 240.0), 130.0, PUSHER);
    for image in [
        unobstructed(Pose2::new(-900.0, -900.0, 0.0)),
        vec![0; 27_648],
        vec![255; 27_648],
        hidden,
    ] {
        let estimate = REFINED.estimate(&view(&image));
        assert_eq!(
            (estimate.pose, estimate.confidence, estimate.flag),
            (None, 0.0, Flag::NoBlock)
        );
    }
}

#[test]
fn images_of_another_size_are_refused() {
    for (bytes, width, height) in [
        (27_648, 48, 192),
        (3 * 84 * 84, 84, 84),
        (27_648 - 1, 96, 96),
        (4 * 96 * 96, 96, 96),
    ] {
        let refusal = PushtImage::new(&vec![0; bytes], width, height)
            .err()
            .unwrap()
            .sentence();
        assert!(
            refusal.contains(&format!("{width} x {height} pixels and {bytes} bytes")),
            "{refusal}"
        );
    }
}

/// Calibrates an anchor on these images.
fn calibrated(images: &[Vec<u8>], goal: Pose2) -> Result<re4_pose::Anchor, AnchorError> {
    let mut builder = AnchorBuilder::default();
    for image in images {
        builder.add(&view(image));
    }
    builder.finish(goal, &outline(), Storage::Lossless)
}

#[test]
fn the_goal_is_combined_from_images_that_hide_parts_of_it() {
    let left = rendered(Point2::new(190.0, 330.0), Pose2::new(230.0, 200.0, 0.2));
    let right = rendered(Point2::new(300.0, 250.0), Pose2::new(230.0, 330.0, 3.0));
    assert!(matches!(
        calibrated(std::slice::from_ref(&left), GOAL),
        Err(AnchorError::Area { .. })
    ));
    let both = calibrated(
        &[left.clone(), right.clone(), unobstructed(Pose2::new(100.0, 400.0, 0.0))],
        GOAL,
    )
    .unwrap();
    let again = calibrated(&[unobstructed(Pose2::new(100.0, 400.0, 0.0)), right, left], GOAL).unwrap();
    assert_eq!(both, again);
}

#[test]
fn images_that_cannot_calibrate_are_refused() {
    let good = unobstructed(Pose2::new(110.0, 110.0, 0.3));
    let mut bgr = good.clone();
    for pixel in bgr.as_chunks_mut::<3>().0 {
        pixel.swap(0, 2);
    }
    let floats: Vec<u8> = good.iter().map(|byte| byte / 255).collect();
    let refusal = |images: &[Vec<u8>], goal| calibrated(images, goal).unwrap_err().sentence();
    assert!(refusal(&[], GOAL).contains("no image"));
    assert!(refusal(&[bgr], GOAL).contains("BGR order"));
    assert!(refusal(&[floats], GOAL).contains("light green"));
    let outside = refusal(std::slice::from_ref(&good), Pose2::new(480.0, 256.0, 0.0));
    assert!(outside.contains("outside of the image"), "{outside}");
    let elsewhere = refusal(std::slice::from_ref(&good), Pose2::new(240.0, 256.0, GOAL.theta));
    assert!(elsewhere.contains("give the goal pose of this dataset"), "{elsewhere}");
    let not_a_number = refusal(&[good], Pose2::new(f64::NAN, 256.0, 0.0));
    assert!(not_a_number.contains("outside of the image"), "{not_a_number}");
}
