//! Sign and range of the gripper's command, held against what the fingers do.

use super::demo::Sound;
use super::evidence::{Basis, Declared, Fit, Proof, Test, Verdict};
use super::reading::GripperRange;
use super::residuals::{self, Share};
use super::{GripperSign, Settings, Unproven};
use crate::actions::Action;

/// Fraction of finger travel against the command that play and contacts may cause.
const FINGERS_AGAINST: f64 = 0.1;
/// Finger travel (metres) that tells the command's sign.
pub(super) const FINGER_TRAVEL: f64 = 0.01;

const FINGERS: Test = Test {
    name: "the gripper command against the fingers' motion in the next frame",
    unit: "of the travel",
    threshold: FINGERS_AGAINST,
    rival: 1.0 - FINGERS_AGAINST,
    frames: 5,
};

pub(super) fn gripper_sign(demos: &[Sound<'_>]) -> Verdict<GripperSign> {
    let mut share = Share::default();
    for demo in demos {
        share.add(residuals::finger_travel(demo));
    }
    let frames = if share.total() >= FINGER_TRAVEL {
        share.frames
    } else {
        0
    };
    let fit = |share: Share| Fit::whole(share.value(), frames);
    Verdict::new(
        FINGERS,
        [
            (GripperSign::PositiveCloses, fit(share)),
            (GripperSign::PositiveOpens, fit(share.complement())),
        ],
    )
}

/// Frames after a command other than 0 in which the fingers may still move.
const SETTLES: usize = 4;

/// Whether commands have held the fingers for so long that they should rest.
fn held_at(actions: &[Action], t: usize) -> bool {
    (t.saturating_sub(SETTLES)..=t).all(|t| actions[t][6] == 0.0)
}

/// How far the fingers travel (metres) under commands that hold them, and in how many frames.
pub(super) fn held_travel(demo: &Sound<'_>) -> (f64, usize) {
    let (mut travel, mut frames) = (0.0, 0);
    for (t, pair) in demo.arrays.gripper_qpos.windows(2).enumerate() {
        if demo.actions[t][6] != 0.0 {
            continue;
        }
        let opening = ((pair[1][0] - pair[1][1]) - (pair[0][0] - pair[0][1])).abs();
        if opening >= residuals::FINGER_MOVES && held_at(&demo.actions, t) {
            travel += opening;
            frames += 1;
        }
    }
    (travel, frames)
}

/// Range of the gripper's command, from what is recorded.
pub(super) fn gripper_range(demos: &[Sound<'_>], settings: &Settings) -> Result<(GripperRange, Proof), Unproven> {
    let test = Test {
        name: "the fingers' travel against the gripper command, where 0 holds them (-1 to 1) or moves them the other way than 1 does (0 to 1)",
        unit: "of the travel",
        threshold: 0.1,
        rival: 0.2,
        frames: 5,
    };
    let [mut all, mut held, mut with, mut below, mut commands] = [0.0_f64; 5];
    let mut frames = 0;
    for demo in demos {
        let command = |t: usize| demo.arrays.actions[t][6];
        for t in 0..demo.arrays.actions.len() {
            commands += 1.0;
            if !(-1e-6..=1.0 + 1e-6).contains(&command(t)) {
                below += 1.0;
            }
        }
        for (t, pair) in demo.arrays.gripper_qpos.windows(2).enumerate() {
            let opening = (pair[1][0] - pair[1][1]) - (pair[0][0] - pair[0][1]);
            if opening.abs() < residuals::FINGER_MOVES {
                continue;
            }
            frames += 1;
            all += opening.abs();
            if held_at(demo.arrays.actions, t) {
                held += opening.abs();
            }
            if (opening > 0.0) == (command(t) > 0.5) {
                with += opening.abs();
            }
        }
    }
    if all < 0.01 {
        frames = 0;
    }
    let share = |part: f64| if all > 0.0 { part / all } else { f64::INFINITY };
    // Which way it moves the fingers is another question.
    let zero_one = if below > 0.01 * commands {
        1.0
    } else {
        share(with.min(all - with))
    };
    let verdict = Verdict::new(
        test,
        [
            (GripperRange::MinusOneOne, Fit::whole(share(held), frames)),
            (GripperRange::ZeroOne, Fit::whole(zero_one, frames)),
        ],
    );
    let set = settings.gripper_range;
    if verdict.proven() == Some(GripperRange::ZeroOne) && set.is_none() {
        let opens = with > all - with;
        let (does, also) = if opens {
            (
                "open under command 1 and close under 0",
                " and gripper_sign = \"positive_opens\"",
            )
        } else {
            ("open under command 0 and close under 1", "")
        };
        return Err(Unproven::Actions {
            convention: "gripper_range",
            what: format!(
                "the fingers {does}, and robosuite's hold where they are under 0: gripper commands go from 0 to 1"
            ),
            evidence: format!(
                "{:.2} of the fingers' travel is under a command of 0 that lasts, over {frames} frames",
                share(held)
            ),
            fix: format!("set gripper_range = \"zero_one\"{also}"),
        });
    }
    if share(held) > test.threshold && frames >= test.frames && set.is_none() {
        return Err(Unproven::Actions {
            convention: "gripper_range",
            what: "the fingers move under a gripper command of 0, which holds robosuite's where they are".to_owned(),
            evidence: format!("{:.2} of their travel, over {frames} frames", share(held)),
            fix: "repair the last column of actions: -1 opens, 1 closes".to_owned(),
        });
    }
    let declared = Declared {
        value: GripperRange::MinusOneOne,
        by: "robosuite".to_owned(),
        strict: true,
    };
    let (range, mut proof) = verdict.settle_or_declared("gripper_range", set, &declared)?;
    let within = commands > 0.0 && below == 0.0;
    if proof.basis == Basis::Declared
        && within
        && demos.iter().any(|demo| demo.arrays.actions.iter().any(|a| a[6] == 0.0))
    {
        proof.warning = Some(
            "gripper commands are from 0 to 1 and the fingers hardly move, so that 0 is taken to hold them, as in robosuite; if it opens them, set gripper_range = \"zero_one\"".to_owned(),
        );
    }
    Ok((range, proof))
}
