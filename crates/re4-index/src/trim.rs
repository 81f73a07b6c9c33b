//! Frames of a demonstration that need not be replayed: what is idle, and what leads back to a state from before.

use re4_episode::SpatialFrame;
use re4_episode::pace::{IDLE_FRACTION, fast_step, reach};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// What is cut out of demonstrations in the index.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Trim {
    /// Idle stretches: frames since which neither the end effector nor the fingers have moved by more than 5 % of their fast steps.
    Idle,
    /// Detours and corrections: frames after which end effector, object, fingers and gripper command are back in an earlier state,
    /// such as a detour of the arm, or a missed grasp that leaves the object where it was.
    Detours,
}

/// Number of frames before and after a change of the gripper command that are never cut: half a second, in which the arm settles before
/// it, and the fingers move and the grip becomes firm after it. `policy.replay.settle.steps` has the same default.
const GUARD: usize = 10;

/// Change of the object's pose that counts as none, in metres, with rotations converted by the lever:
/// `segment.minimum_motion` of demonstrations with a gripper.
const RESTING: f64 = 5e-4;

/// Returns, for every frame, whether it is kept. The first and the last frame are.
///
/// The state at a kept frame is always within one fast step of the end effector from that at the kept frame before, unless it was
/// farther from it in the recording.
pub fn kept(frames: &[SpatialFrame], what: &[Trim]) -> Vec<bool> {
    let mut kept = vec![true; frames.len()];
    let pairs = || frames.iter().zip(frames.iter().skip(1));
    let fast = Fast {
        arm: fast_step(pairs().map(|(now, next)| reach(&now.eef, &next.eef))),
        fingers: fast_step(pairs().map(|(now, next)| opening(now, next))),
    };
    if what.contains(&Trim::Detours) {
        cut_detours(frames, &fast, &mut kept);
    }
    if what.contains(&Trim::Idle) {
        cut_idle(frames, &fast, &mut kept);
    }
    kept
}

/// Fast steps, in metres.
struct Fast {
    arm: f64,
    fingers: f64,
}

fn opening(now: &SpatialFrame, next: &SpatialFrame) -> f64 {
    (next.finger_separation() - now.finger_separation()).abs()
}

/// Whether the frame is within the guard around a change of the gripper command.
fn guarded(frames: &[SpatialFrame], frame: usize) -> bool {
    let around = &frames[frame.saturating_sub(GUARD)..(frame + GUARD + 1).min(frames.len())];
    let mut pairs = around.iter().zip(around.iter().skip(1));
    pairs.any(|(now, next)| now.closes() != next.closes())
}

fn cut_idle(frames: &[SpatialFrame], fast: &Fast, kept: &mut [bool]) {
    let mut last = 0;
    for now in 1..frames.len().saturating_sub(1) {
        if !kept[now] {
            continue;
        }
        let moved = reach(&frames[last].eef, &frames[now].eef) > IDLE_FRACTION * fast.arm
            || opening(&frames[last], &frames[now]) > IDLE_FRACTION * fast.fingers
            || reach(&frames[last].object, &frames[now].object) > RESTING;
        if moved || guarded(frames, now) {
            last = now;
        } else {
            kept[now] = false;
        }
    }
}

/// Cuts, after every frame, to the last later frame with the same state, if the end effector was elsewhere or the gripper did something
/// in between.
fn cut_detours(frames: &[SpatialFrame], fast: &Fast, kept: &mut [bool]) {
    let mut now = 0;
    while now < frames.len() {
        let same = |then: &SpatialFrame| {
            let here = &frames[now];
            here.closes() == then.closes()
                && reach(&here.eef, &then.eef) <= fast.arm
                && reach(&here.object, &then.object) <= RESTING
                && opening(here, then) <= fast.fingers
        };
        let follows = |then: &usize| {
            frames
                .get(then + 1)
                .is_some_and(|next| next.closes() == frames[*then].closes())
                && !guarded(frames, *then)
        };
        let back = (now + 2..frames.len())
            .rev()
            .find(|then| same(&frames[*then]) && follows(then));
        let back = back.filter(|&then| {
            let mut between = frames[now + 1..then].iter();
            !guarded(frames, now)
                && between.any(|frame| {
                    frame.closes() != frames[now].closes() || reach(&frames[now].eef, &frame.eef) > 2.0 * fast.arm
                })
        });
        now = match back {
            Some(then) => {
                kept[now + 1..=then].fill(false);
                then + 1
            }
            None => now + 1,
        };
    }
}
