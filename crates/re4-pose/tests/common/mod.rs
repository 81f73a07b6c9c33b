//! Images of the simulator's renderer, and errors of estimates.
#![allow(dead_code, reason = "every test file uses only a part of it")]
#![expect(clippy::unwrap_used, reason = "only tests call these functions, and they may panic")]

use std::f64::consts::TAU;

use re4_geometry::{Point2, Pose2, periodic_distance};
use re4_pose::{AnchorBuilder, Estimate, LogPolarEstimator, Outline, PushtImage, SIDE, Storage};
use re4_sim::{GOAL, OUTLINE_RADIUS, render_state, tee_rectangles};

pub(crate) const PUSHER: [u8; 3] = [65, 105, 225];

pub(crate) fn outline() -> Outline {
    Outline::new(&tee_rectangles(), OUTLINE_RADIUS)
}

pub(crate) fn rendered(agent: Point2, block: Pose2) -> Vec<u8> {
    render_state(agent, block).observation()
}

/// An image with the pusher in a corner, where it hides nothing.
pub(crate) fn unobstructed(block: Pose2) -> Vec<u8> {
    rendered(Point2::new(25.0, 25.0), block)
}

pub(crate) fn view(image: &[u8]) -> PushtImage<'_> {
    PushtImage::new(image, SIDE, SIDE).unwrap()
}

pub(crate) fn estimator(refined: bool) -> LogPolarEstimator {
    let mut builder = AnchorBuilder::default();
    builder.add(&view(&unobstructed(Pose2::new(110.0, 110.0, 0.3))));
    LogPolarEstimator::new(
        &builder.finish(GOAL, &outline(), Storage::Lossless).unwrap(),
        outline(),
        refined,
    )
}

/// Distance in px and angle in degrees from the true pose.
pub(crate) fn error(estimate: &Estimate, truth: Pose2) -> (f64, f64) {
    let pose = estimate.pose.unwrap();
    (
        (pose.translation() - truth.translation()).norm(),
        periodic_distance(pose.theta, truth.theta, TAU).to_degrees(),
    )
}

/// Paints a disc of one colour into an image; centre and radius in world pixels.
pub(crate) fn paint_disc(image: &mut [u8], centre: Point2, radius: f64, colour: [u8; 3]) {
    for (i, pixel) in image.as_chunks_mut::<3>().0.iter_mut().enumerate() {
        let world = |d: usize| (d as f64 + 0.5) * 512.0 / SIDE as f64 - 0.5;
        if (Point2::new(world(i % SIDE), world(i / SIDE)) - centre).norm() <= radius {
            *pixel = colour;
        }
    }
}
