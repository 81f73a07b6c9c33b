//! Conditions of rollouts that differ from those of the task: goals, disturbances, old observations and noise.

use re4_rollout::{Displaced, PlaneWorldRow, SpaceWorldRow};
use re4_sim::GOAL;
use serde_json::{Value, json};

/// A row of table `worlds`.
pub trait World {
    /// Returns the number of control steps taken before the disturbance, and the disturbance in words.
    fn disturbance(&self) -> Option<(u32, String)>;
}

impl World for PlaneWorldRow {
    fn disturbance(&self) -> Option<(u32, String)> {
        let (step, what, motion) = (self.disturbance_step?, self.disturbed?, self.displacement?);
        let length = motion.translation().norm();
        let words = match what {
            Displaced::Object => format!("block moved by {length:.0} px and {:.0}°", motion.theta.to_degrees()),
            Displaced::Pusher => format!("pusher moved by {length:.0} px"),
        };
        Some((step, words))
    }
}

impl World for SpaceWorldRow {
    fn disturbance(&self) -> Option<(u32, String)> {
        let (step, moved, rotation) = (self.disturbance_step?, self.displacement?, self.rotation?);
        let (length, degrees) = (1000.0 * moved.norm(), rotation.to_degrees());
        Some((step, format!("object moved by {length:.0} mm and {degrees:.0}°")))
    }
}

/// Returns the conditions that a protocol states, in words. Empty for the conditions of the task.
pub(crate) fn conditions(protocol: &Value) -> Vec<String> {
    let mut words = Vec::new();
    let goal = &protocol["goal"];
    if goal == "random" {
        words.push("random goals".to_owned());
    } else if goal.is_array() && *goal != json!([GOAL.x, GOAL.y, GOAL.theta]) {
        words.push(format!("goal {goal}"));
    }
    let disturbance = &protocol["disturbance"];
    if let (Some(kind), Some([first, last])) = (
        disturbance["kind"].as_str(),
        disturbance["steps"].as_array().map(Vec::as_slice),
    ) {
        let what = if kind == "either" { "object or pusher" } else { kind };
        words.push(format!("{what} disturbed before step {first} to {last}"));
    }
    match protocol["latency"].as_u64() {
        None | Some(0) => {}
        Some(1) => words.push("observations 1 step old".to_owned()),
        Some(steps) => words.push(format!("observations {steps} steps old")),
    }
    if protocol["noise"].is_object() {
        words.push("noisy poses".to_owned());
    }
    words
}
