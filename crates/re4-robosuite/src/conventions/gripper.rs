//! Detection of the sign and the range of the gripper command from the motion of the fingers.

use super::demo::ValidDemo;
use super::evidence::{Basis, Declared, Fit, Proof, Test, Verdict};
use super::reading::GripperRange;
use super::residuals::{self, Fraction};
use super::{GripperSign, Settings, Unproven};
use crate::actions::Action;

/// Maximum fraction of the finger travel that may go against the command because of play and contacts.
const FINGERS_AGAINST: f64 = 0.1;
/// Minimum finger travel (metres) for detecting the sign of the command.
pub(super) const FINGER_TRAVEL: f64 = 0.01;

const FINGERS: Test = Test {
    name: "finger travel against the gripper command of the frame before",
    unit: "of the travel",
    threshold: FINGERS_AGAINST,
    rival: 1.0 - FINGERS_AGAINST,
    frames: 5,
};

/// Tests both signs of the gripper command.
pub(super) fn gripper_sign(demos: &[ValidDemo<'_>]) -> Verdict<GripperSign> {
    let mut against = Fraction::default();
    for demo in demos {
        against.add(residuals::finger_travel(demo));
    }
    let frames = if against.total() >= FINGER_TRAVEL {
        against.frames
    } else {
        0
    };
    let fit = |fraction: Fraction| Fit::whole(fraction.value(), frames);
    Verdict::new(
        FINGERS,
        [
            (GripperSign::PositiveCloses, fit(against)),
            (GripperSign::PositiveOpens, fit(against.complement())),
        ],
    )
}

/// Number of frames for which the fingers may still move after the last command other than 0.
const SETTLES: usize = 4;

/// Whether commands have been 0 for so long that the fingers should be at rest.
fn held_at(actions: &[Action], t: usize) -> bool {
    (t.saturating_sub(SETTLES)..=t).all(|t| actions[t][6] == 0.0)
}

/// Finger travel (metres) under commands that should stop the fingers, and the number of frames with such travel.
pub(super) fn held_travel(demo: &ValidDemo<'_>) -> (f64, usize) {
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

/// Determines the range of the gripper command from the recorded actions.
pub(super) fn gripper_range(demos: &[ValidDemo<'_>], settings: &Settings) -> Result<(GripperRange, Proof), Unproven> {
    let test = Test {
        name: "finger travel that contradicts the gripper command, where 0 stops the fingers (range -1 to 1) or moves them opposite to 1 (range 0 to 1)",
        unit: "of the travel",
        threshold: 0.1,
        rival: 0.2,
        frames: 5,
    };
    // Finger travel in metres: in total, under sustained commands of 0, and consistent with "a command above 0.5 opens". Then the
    // number of commands outside 0 to 1, and of all commands.
    let [mut all, mut held, mut with, mut outside, mut commands] = [0.0_f64; 5];
    let mut frames = 0;
    for demo in demos {
        let command = |t: usize| demo.arrays.actions[t][6];
        for t in 0..demo.arrays.actions.len() {
            commands += 1.0;
            if !(-1e-6..=1.0 + 1e-6).contains(&command(t)) {
                outside += 1.0;
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
    let fraction = |part: f64| if all > 0.0 { part / all } else { f64::INFINITY };
    // The smaller of both directions: whether 1 opens or closes the fingers is the convention `gripper_sign`, not this one.
    let zero_one = if outside > 0.01 * commands {
        1.0
    } else {
        fraction(with.min(all - with))
    };
    let verdict = Verdict::new(
        test,
        [
            (GripperRange::MinusOneOne, Fit::whole(fraction(held), frames)),
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
                "the fingers {does}, but a command of 0 stops robosuite's fingers: the range of the gripper commands is 0 to 1"
            ),
            evidence: format!(
                "a fraction of {:.2} of the finger travel occurs under sustained commands of 0, over {frames} frames",
                fraction(held)
            ),
            fix: format!("set gripper_range = \"zero_one\"{also}"),
        });
    }
    if fraction(held) > test.threshold && frames >= test.frames && set.is_none() {
        return Err(Unproven::Actions {
            convention: "gripper_range",
            what: "the fingers move under gripper commands of 0, which stop robosuite's fingers".to_owned(),
            evidence: format!(
                "a fraction of {:.2} of the finger travel, over {frames} frames",
                fraction(held)
            ),
            fix: "correct the last column of actions: -1 opens, 1 closes".to_owned(),
        });
    }
    let declared = Declared {
        value: GripperRange::MinusOneOne,
        by: "robosuite".to_owned(),
        strict: true,
    };
    let (range, mut proof) = verdict.settle_or_declared("gripper_range", set, &declared)?;
    let within = commands > 0.0 && outside == 0.0;
    if proof.basis == Basis::Declared
        && within
        && demos.iter().any(|demo| demo.arrays.actions.iter().any(|a| a[6] == 0.0))
    {
        proof.warning = Some(
            "all gripper commands are in 0 to 1 and the fingers hardly move, so a command of 0 is assumed to stop the fingers, as in robosuite; if it opens them, set gripper_range = \"zero_one\"".to_owned(),
        );
    }
    Ok((range, proof))
}
