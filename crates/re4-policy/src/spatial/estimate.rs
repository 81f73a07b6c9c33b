//! The object's pose from the poses observed so far.

use std::collections::VecDeque;

use nalgebra::Isometry3;
use re4_episode::Mode;
use re4_geometry::spatial::{SymmetryGroup, pose_between, pose_distance};
use re4_stats::upper_median;

use crate::spatial::config::PoseFilterConfig;

/// Differences between successive observations that the errors are judged by.
const DIFFERENCES: usize = 60;

/// Fewer of them say nothing.
const FEWEST: usize = 5;

/// Observations that the average counts for where the frame in which the object rests changes: at a grasp or a release it
/// settles by millimetres, which newer observations must be able to tell.
const CARRIED_OVER: u32 = 5;

/// Median of the chi-squared distribution with three degrees of freedom.
const MEDIAN_CHI_SQUARED_3: f64 = 2.365_973_884_375_338;

/// Averages observed object poses in the frame in which the object rests: the world in transit, the gripper in transfer. See
/// [`PoseFilterConfig`] for when the average starts anew.
///
/// The average is sequential: each observation, in that of its like poses that is nearest to the average, moves it by a part
/// `1 / n` of the way, n being the number of observations in it, at most `samples`. The standard deviation of an error along an
/// axis is `√(m / (2 · 2.366))`, m being the median of the squared differences between successive observations: differences of
/// two errors have twice the variance of one, and 2.366 is the median of chi-squared with three degrees of freedom.
pub struct ObjectEstimate {
    config: Option<PoseFilterConfig>,
    group: SymmetryGroup,
    state: Option<State>,
    /// Squared differences, translation and rotation.
    differences: VecDeque<(f64, f64)>,
}

struct State {
    mode: Mode,
    /// In the frame of the mode.
    average: Isometry3<f64>,
    count: u32,
    /// Last observation, in the same frame; none where the frame is new.
    last: Option<Isometry3<f64>>,
}

/// The frame in which the object rests.
fn frame_of(mode: Mode, eef: &Isometry3<f64>) -> Isometry3<f64> {
    match mode {
        Mode::Transit => Isometry3::identity(),
        Mode::Transfer => *eef,
    }
}

impl State {
    /// Goes over to the frame of a mode.
    fn rest_in(&mut self, mode: Mode, eef: &Isometry3<f64>) {
        if self.mode != mode {
            // The gripper has hardly moved since the mode was the other one.
            let world = match self.mode {
                Mode::Transit => self.average,
                Mode::Transfer => eef * self.average,
            };
            *self = Self {
                mode,
                average: frame_of(mode, eef).inv_mul(&world),
                count: self.count.min(CARRIED_OVER),
                last: None,
            };
        }
    }
}

impl ObjectEstimate {
    /// No pose observed yet. Without a configuration every observation is the estimate.
    pub fn new(config: Option<PoseFilterConfig>, group: SymmetryGroup) -> Self {
        Self {
            config,
            group,
            state: None,
            differences: VecDeque::with_capacity(DIFFERENCES),
        }
    }

    /// Takes an observation, with the mode at it, and gives the estimate of the object's pose. World frame.
    pub fn observe(&mut self, mode: Mode, eef: &Isometry3<f64>, object: &Isometry3<f64>) -> Isometry3<f64> {
        let frame = frame_of(mode, eef);
        let seen = frame.inv_mul(object);
        let (Some(config), Some(mut state)) = (self.config.clone(), self.state.take()) else {
            self.state = Some(State {
                mode,
                average: seen,
                count: 1,
                last: Some(seen),
            });
            return *object;
        };
        state.rest_in(mode, eef);
        let (seen, _) = self.group.align(&seen, &state.average);
        if let Some(last) = state.last {
            let (moved, turned) = pose_distance(&self.group.align(&last, &state.average).0, &seen);
            if self.differences.len() == DIFFERENCES {
                self.differences.pop_front();
            }
            self.differences.push_back((moved * moved, turned * turned));
        }
        state.last = Some(seen);
        let rests = self.deviations().is_some_and(|(translation, rotation)| {
            let (off, turned) = pose_distance(&state.average, &seen);
            // The average has an error of its own.
            let spread = config.gate * (1.0 + 1.0 / f64::from(state.count)).sqrt();
            off <= spread * translation && turned <= spread * rotation
        });
        if rests {
            state.count = (state.count + 1).min(config.samples.max(1));
            state.average = pose_between(&state.average, &seen, 1.0 / f64::from(state.count));
        } else {
            (state.average, state.count) = (seen, 1);
        }
        let estimate = frame * state.average;
        self.state = Some(state);
        estimate
    }

    /// The estimate at a step without an observation: the object rests, in the world or in the gripper. None where nothing was
    /// observed yet. World frame. To be asked at every such step, so that the change of the mode is noticed where it happens.
    pub fn carry(&mut self, mode: Mode, eef: &Isometry3<f64>) -> Option<Isometry3<f64>> {
        let state = self.state.as_mut()?;
        state.rest_in(mode, eef);
        Some(frame_of(mode, eef) * state.average)
    }

    /// Standard deviations of an observation's errors along one axis, in metres and rad; none while too little is known.
    pub fn deviations(&self) -> Option<(f64, f64)> {
        if self.differences.len() < FEWEST {
            return None;
        }
        let deviation = |of: fn(&(f64, f64)) -> f64| {
            let square = upper_median(self.differences.iter().map(of))?;
            Some((square / (2.0 * MEDIAN_CHI_SQUARED_3)).sqrt())
        };
        Some((deviation(|d| d.0)?, deviation(|d| d.1)?))
    }
}
