//! What the camera saw at decisions, with the object's pose as the policy was told it and as it was.
//!
//! Rollouts hold no pictures. They are simulated again, as for films, and drawn when a page is made.

use std::cmp::Reverse;
use std::path::Path;

use anyhow::{Context as _, Result};
use re4_artifact::Artifact;
use re4_mujoco::View;
use re4_report::html::spatial::{DecisionPicture, FrameInPicture, Pose, SpatialRollouts, SpatialTrace};

use super::super::film::spatial::{CAMERA, Films};
use re4_stages::encode_png;
use re4_stages::from_numbers;

/// Rollouts that have pictures, where nobody asks for a number and poses come from pictures.
const ROLLOUTS: usize = 8;

/// Decisions of a rollout that have pictures, at most.
const DECISIONS: usize = 48;

/// Side of a picture, in pixels: what an encoder is shown.
const SIDE: u32 = 84;

/// Length of the axes that are drawn, in metres.
const AXIS: f64 = 0.05;

/// Adds pictures to some of the rollouts that the viewer holds, those that failed first; the same rollouts for the same page.
///
/// # Errors
/// When pictures were asked for and cannot be drawn. Those that nobody asked for are left out instead, which is returned as a
/// warning.
pub(super) fn add(
    artifact: &Artifact,
    set: &mut SpatialRollouts,
    wanted: Option<usize>,
    store: &Path,
) -> Result<Option<String>> {
    let usual = if set.variant == "image" { ROLLOUTS } else { 0 };
    let count = wanted.unwrap_or(usual);
    if count == 0 {
        return Ok(None);
    }
    let drawn = draw(artifact, set, count, store).with_context(|| {
        format!(
            "cannot show pictures of {}; leave --pictures out, or make it 0",
            artifact.path().display()
        )
    });
    match drawn {
        Ok(()) => Ok(None),
        Err(error) if wanted.is_none() => Ok(Some(format!("the page shows no pictures: {error:#}"))),
        Err(error) => Err(error),
    }
}

fn draw(artifact: &Artifact, set: &mut SpatialRollouts, count: usize, store: &Path) -> Result<()> {
    let mut chosen: Vec<&mut SpatialTrace> = set.rollouts.iter_mut().filter(|rollout| rollout.shown).collect();
    chosen.sort_by_key(|rollout| Reverse(!rollout.success));
    chosen.truncate(count);
    let seeds: Vec<u32> = chosen.iter().map(|rollout| rollout.seed).collect();
    let mut films = Films::read(artifact, &seeds, SIDE, store)?;
    for (number, rollout) in chosen.into_iter().enumerate() {
        let steps: Vec<u32> = rollout.decisions.iter().map(|decision| decision.step).collect();
        for (place, &step) in steps.iter().enumerate().take(DECISIONS) {
            let pixels = films.draw(number, step as usize)?;
            let png = encode_png(&pixels, SIDE, SIDE)?;
            let recorded = object_before(rollout, step as usize);
            let view = films.view();
            let decision = &mut rollout.decisions[place];
            decision.picture = Some(DecisionPicture {
                camera: CAMERA,
                side: SIDE,
                png,
                told: seen(view.as_ref(), &decision.object),
                simulated: seen(view.as_ref(), &recorded),
            });
        }
    }
    Ok(())
}

/// The object before a step.
fn object_before(rollout: &SpatialTrace, step: usize) -> Pose {
    let before = step.checked_sub(1).and_then(|last| rollout.steps.get(last));
    before.map_or(rollout.object, |step| step.object)
}

/// A frame's origin and the ends of its axes in a picture.
fn seen(view: Option<&View>, pose: &Pose) -> FrameInPicture {
    let pose = from_numbers(*pose);
    let ends = [[0.0; 3], [AXIS, 0.0, 0.0], [0.0, AXIS, 0.0], [0.0, 0.0, AXIS]];
    ends.map(|end| {
        let point = pose.transform_point(&end.into());
        view?.pixel([point.x, point.y, point.z], SIDE as usize, SIDE as usize)
    })
}
