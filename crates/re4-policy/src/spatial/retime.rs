//! Replay at the robot's pace.

use nalgebra::Isometry3;
use re4_episode::Mode;
use re4_episode::pace::reach;
use re4_geometry::spatial::pose_distance;

use crate::spatial::config::{RetimeConfig, SpatialReplanConfig};
use crate::spatial::demos::SpatialDemoFrame;
use crate::spatial::reframe::Carry;

/// Fraction of a constant lead that the end effector moves in one control step. robosuite's controller is a critically damped spring
/// with a stiffness of 150 per s², so the speed at a constant lead is lead * sqrt(150) / 2 per second, in 20 steps per second.
const MOTION_PER_LEAD: f64 = 0.306;

/// Number of frames after a change of the gripper command that are replayed as recorded: the half second in which the fingers move.
const SETTLING: usize = 10;

/// Motion of an object that is not held, in metres per frame, above which it is pushed; the same as `segment.minimum_motion` of
/// demonstrations with a gripper.
const PUSHED: f64 = 5e-4;

/// Returns whether each frame may be replayed at the robot's pace: nothing is touched there, or the object is carried freely.
pub(crate) fn free_frames(frames: &[SpatialDemoFrame], retime: &RetimeConfig) -> Vec<bool> {
    let mut free = vec![true; frames.len()];
    let closes = |frame: &SpatialDemoFrame| frame.gripper > 0.0;
    for (now, pair) in frames.windows(2).enumerate() {
        if pair[0].mode == Mode::Transit
            && pair[1].mode == Mode::Transit
            && reach(&pair[0].object, &pair[1].object) > PUSHED
        {
            free[now..=now + 1].fill(false);
        }
        if closes(&pair[0]) == closes(&pair[1]) {
            continue;
        }
        // The command changes at frame `event`.
        let event = now + 1;
        let near = |at: &usize| reach(&frames[*at].eef, &frames[event].eef) <= retime.margin;
        let first = (0..event).rev().take_while(near).last().unwrap_or(event);
        let last = (event..frames.len()).take_while(near).last().unwrap_or(event);
        let last = last.max(event + SETTLING).min(frames.len() - 1);
        free[first..=last].fill(false);
    }
    free
}

/// What to command next.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Paced {
    /// The frame whose gripper command is given.
    pub(crate) frame: usize,
    /// The goal, in the world frame.
    pub(crate) goal: Isometry3<f64>,
    /// Whether the frame after it may follow. If not, the end effector has not arrived at the last frame before a contact.
    pub(crate) arrived: bool,
}

/// The pace at which a demonstration is replayed.
pub(crate) struct Pace<'a> {
    /// All frames of the demonstration.
    pub(crate) frames: &'a [SpatialDemoFrame],
    /// Whether each frame may be replayed at the robot's pace; empty if none may.
    pub(crate) free: &'a [bool],
    /// The lead.
    pub(crate) replan: &'a SpatialReplanConfig,
}

impl Pace<'_> {
    fn is_free(&self, frame: usize) -> bool {
        self.free.get(frame).copied().unwrap_or(false)
    }

    /// Returns the part of the lead that lies between two poses: 1 if they are the lead apart in translation or in rotation.
    fn part(&self, a: &Isometry3<f64>, b: &Isometry3<f64>) -> f64 {
        let (distance, angle) = pose_distance(a, b);
        (distance / self.replan.lead_translation).max(angle / self.replan.lead_rotation)
    }

    /// Returns the last frame of a chunk of about `horizon` control steps that starts at `start`. A frame takes one step, or less
    /// where the robot is faster than the recording.
    pub(crate) fn end(&self, start: usize, horizon: usize) -> usize {
        let last = self.frames.len() - 1;
        if self.free.is_empty() {
            return start.saturating_add(horizon - 1).min(last);
        }
        let (mut end, mut steps) = (start, 0.0);
        while end < last {
            steps += if self.is_free(end) && self.is_free(end + 1) {
                (self.part(&self.frames[end].eef, &self.frames[end + 1].eef) / MOTION_PER_LEAD).min(1.0)
            } else {
                1.0
            };
            if steps > (horizon - 1) as f64 {
                break;
            }
            end += 1;
        }
        end
    }

    /// Returns what to command next, from frame `next` on.
    ///
    /// At the robot's pace, the frame is the nearest one to the end effector on the path ahead, and the goal is the recorded pose of the
    /// end effector at most the lead ahead of that frame, along the path. Both stay within the free frames. Before a contact, the end
    /// effector has to arrive at the last free frame, as at the end of a bridge.
    pub(crate) fn next(&self, next: usize, carry: &Carry, eef: &Isometry3<f64>) -> Paced {
        if !self.is_free(next) {
            return self.recorded(next, carry);
        }
        let frame = self.nearest(next, carry, eef);
        let ahead = self.ahead(frame);
        let goal = carry.goal(&self.frames[ahead].eef);
        if ahead > frame {
            return Paced {
                frame,
                goal,
                arrived: true,
            };
        }
        let (distance, angle) = pose_distance(&goal, eef);
        if distance <= self.replan.tolerance_translation && angle <= self.replan.tolerance_rotation {
            // The recorded action leads into the contact.
            return self.recorded(frame, carry);
        }
        Paced {
            frame,
            goal,
            arrived: false,
        }
    }

    fn recorded(&self, frame: usize, carry: &Carry) -> Paced {
        Paced {
            frame,
            goal: carry.goal(&self.frames[frame].goal),
            arrived: true,
        }
    }

    /// Returns the last frame that is at most the lead ahead of a frame, along the path, with only free frames in between.
    fn ahead(&self, at: usize) -> usize {
        let (mut ahead, mut lead) = (at, 0.0);
        while ahead + 1 < self.frames.len() && self.is_free(ahead + 1) {
            lead += self.part(&self.frames[ahead].eef, &self.frames[ahead + 1].eef);
            if lead > 1.0 && ahead > at {
                break;
            }
            ahead += 1;
        }
        ahead
    }

    /// Returns the frame nearest to the end effector among those at most the lead ahead; the last one if several are.
    fn nearest(&self, next: usize, carry: &Carry, eef: &Isometry3<f64>) -> usize {
        let distance = |at: usize| self.part(&carry.goal(&self.frames[at].eef), eef);
        let candidates = (next..=self.ahead(next)).map(|at| (at, distance(at)));
        candidates
            .fold(
                (next, f64::INFINITY),
                |best, found| if found.1 <= best.1 { found } else { best },
            )
            .0
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::Translation3;

    use super::*;
    use crate::spatial::config::SpatialPolicyConfig;
    use crate::spatial::reframe::without_reframe_spatial;

    /// Moves along x by `step` per frame; the gripper closes at frame `close`.
    fn line(frames: usize, step: f64, close: usize) -> Vec<SpatialDemoFrame> {
        let at = |x: f64| Isometry3::from(Translation3::new(x, 0.0, 0.0));
        let frame = |number: usize| SpatialDemoFrame {
            eef: at(step * number as f64),
            object: at(step * close as f64),
            goal: at(step * (number + 1) as f64),
            gripper: if number < close { -1.0 } else { 1.0 },
            mode: if number <= close { Mode::Transit } else { Mode::Transfer },
        };
        (0..frames).map(frame).collect()
    }

    #[test]
    fn frames_near_a_change_of_the_gripper_are_replayed_as_recorded() {
        let frames = line(200, 0.002, 100);
        let free = free_frames(&frames, &RetimeConfig { margin: 0.0201 });
        let contact: Vec<usize> = (0..200).filter(|&at| !free[at]).collect();
        assert_eq!(contact, (90..=110).collect::<Vec<_>>());
        let replan = SpatialPolicyConfig::re4().replan;
        let (pace, carry) = (
            Pace {
                frames: &frames,
                free: &free,
                replan: &replan,
            },
            without_reframe_spatial(&frames[0].eef),
        );
        for (at, frame) in frames.iter().enumerate().take(111).skip(90) {
            let recorded = Paced {
                frame: at,
                goal: frame.goal,
                arrived: true,
            };
            assert_eq!(pace.next(at, &carry, &frame.eef), recorded);
        }
    }

    #[test]
    fn the_set_point_is_one_lead_ahead_on_the_path_and_never_in_a_contact() {
        // 25 frames are just within the lead of 5 cm.
        let frames = line(200, 0.00199, 100);
        let free = free_frames(&frames, &RetimeConfig { margin: 0.0201 });
        let replan = SpatialPolicyConfig::re4().replan;
        let pace = Pace {
            frames: &frames,
            free: &free,
            replan: &replan,
        };
        let carry = without_reframe_spatial(&frames[0].eef);
        let goal_at = |next: usize, eef: usize| {
            let next = pace.next(next, &carry, &frames[eef].eef);
            (
                next.frame,
                (next.goal.translation.x / 0.00199).round() as usize,
                next.arrived,
            )
        };
        assert_eq!(goal_at(0, 0), (0, 25, true));
        // The end effector is ahead of the next frame.
        assert_eq!(goal_at(10, 14), (14, 39, true));
        // The end effector lags behind: the replay waits.
        assert_eq!(goal_at(10, 5), (10, 35, true));
        // Before a contact, the set-point stays outside it.
        assert_eq!(goal_at(80, 80), (80, 89, true));
        // The last free frame leads into it with its own action.
        assert_eq!(goal_at(89, 89), (89, 90, true));
        // If the end effector is more than the tolerance of 1 cm away, it arrives there first.
        assert_eq!(goal_at(89, 83), (89, 89, false));
    }

    #[test]
    fn a_chunk_covers_what_the_robot_moves_in_its_horizon() {
        let frames = line(400, 0.002, 399);
        let free = free_frames(&frames, &RetimeConfig { margin: 0.0 });
        let replan = SpatialPolicyConfig::re4().replan;
        let pace = Pace {
            frames: &frames,
            free: &free,
            replan: &replan,
        };
        // 15 steps of 0.306 * 0.05 m, 2 mm per frame.
        assert_eq!(pace.end(0, 16), (15.0 * 0.306 * 0.05 / 0.002) as usize);
        let recorded = Pace {
            frames: &frames,
            free: &[],
            replan: &replan,
        };
        assert_eq!(recorded.end(0, 16), 15);
        assert_eq!(recorded.end(390, 16), 399);
        assert_eq!(
            recorded
                .next(7, &without_reframe_spatial(&frames[0].eef), &frames[3].eef)
                .frame,
            7
        );
    }
}
