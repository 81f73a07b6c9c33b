//! Wall times of the calls of a policy.

use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use re4_stats::Durations;

/// Wall times of the calls of [`Policy::act`](crate::Policy::act), which include the observations that the policy requested and
/// the estimates made from them. The memory does not grow with the number of calls.
#[derive(Debug, Default)]
pub struct ActTimes(Mutex<Times>);

#[derive(Debug, Default)]
struct Times {
    all: Durations,
    decisions: Durations,
}

impl ActTimes {
    /// Adds the calls of an episode: the wall time of each, and whether the policy made a decision in it.
    pub fn add(&self, calls: &[(Duration, bool)]) {
        let mut times = self.times();
        for &(duration, decided) in calls {
            times.all.add(duration);
            if decided {
                times.decisions.add(duration);
            }
        }
    }

    /// Times of all calls.
    pub fn actions(&self) -> Durations {
        self.times().all.clone()
    }

    /// Times of the calls in which the policy made a decision.
    pub fn decisions(&self) -> Durations {
        self.times().decisions.clone()
    }

    fn times(&self) -> MutexGuard<'_, Times> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}
