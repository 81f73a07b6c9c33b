//! A chunk in execution.

use nalgebra::Isometry3;
use re4_episode::Mode;

use crate::spatial::reframe::Carry;
use crate::spatial::retime::Paced;

/// A chunk in execution.
pub(super) struct Chunk {
    pub(super) demo: u32,
    /// First frame.
    pub(super) start: usize,
    /// Frame of the next action.
    pub(super) next: usize,
    /// Last frame, included.
    pub(super) end: usize,
    /// Mode of the query.
    pub(super) mode: Mode,
    pub(super) carry: Carry,
    /// Object pose, aligned with the demonstration's by the object's symmetry, in the frame in which the object is fixed: the
    /// world in transit, the gripper in transfer.
    pub(super) aligned: Isometry3<f64>,
    /// Whether the transformation of the chunk is final. If not, it is measured again at every step.
    pub(super) is_final: bool,
    /// Number of actions after which the chunk ends although frames are left, at the robot's pace. `None` if all are replayed.
    pub(super) budget: Option<u32>,
    /// Number of steps in which the replay waited for the end effector to arrive before a contact.
    pub(super) waited: u32,
    /// Number of steps of the bridge so far, or `None` if the bridge has ended.
    pub(super) bridge: Option<u32>,
}

impl Chunk {
    /// Ends the chunk at its next frame if its budget is used up.
    pub(super) fn end_if_spent(&mut self) {
        if self.budget == Some(0) {
            self.end = self.end.min(self.next.saturating_sub(1));
        }
    }

    /// Goes on after an action. If the end effector has not arrived, the frame is repeated, at most `max_wait` times in all.
    pub(super) fn advance(&mut self, paced: &Paced, max_wait: u32) {
        self.budget = self.budget.map(|left| left.saturating_sub(1));
        let waits = !paced.arrived && self.waited < max_wait;
        self.waited += u32::from(waits);
        self.next = paced.frame + usize::from(!waits);
    }
}
