//! What the retrieval baselines (`gpi`, `vinn`, `alt`) share: frames with normalised states, distances between states, noise for
//! queries, frames that were already used, and averages of actions.
//!
//! Every coordinate of a state is scaled by its minimum and maximum over all indexed frames to `[-1, 1]`, as GPI does. Searches
//! are linear scans: with 26,000 frames of Push-T, one takes about a tenth of a millisecond, and unlike a tree it can exclude any
//! set of frames.

mod history;
mod latent;
mod noise;
mod plane;
mod space;
mod used;

use re4_rollout::Recorded;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::LookupError;
use crate::kinds::{Inputs, OpenError};

pub(crate) use history::History;
pub(crate) use latent::{Latent, squared};
pub(crate) use noise::QueryNoise;
pub use noise::QueryNoiseConfig;
pub use space::SpaceWeights;
pub(crate) use space::read_fingers;
pub(crate) use used::UsedFrames;

/// The frame in which recorded actions are compared, averaged and replayed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum ActionFrame {
    /// The frame of the object: a recorded action moves with the object, so it is applied to the observed pose.
    Object,
    /// The world frame: recorded actions are used as they are.
    World,
}

/// A frame of a demonstration.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Entry<D: Lookup> {
    /// Number of the demonstration.
    pub(crate) demo: u32,
    /// Number of the frame in the demonstration.
    pub(crate) frame: u32,
    /// Whether a search may return the frame. Other frames are only replayed.
    pub(crate) retrievable: bool,
    pub(crate) proprio: D::Proprio,
    pub(crate) object: D::Pose,
    pub(crate) action: D::Action,
    /// The normalised state.
    pub(crate) state: D::State,
}

/// A domain in which states can be looked up.
pub(crate) trait Lookup: Recorded {
    /// A normalised state: coordinates in `[-1, 1]` for the demonstrations, and orientations.
    type State: Copy + std::fmt::Debug + PartialEq + Send + Sync;
    /// The ranges that normalise states, and the weights of distances.
    type Scales: Send + Sync;
    /// Weights of the parts of a state in distances.
    type Weights;

    /// Reads all frames from the index, sorted by demonstration and frame.
    fn read(inputs: &Inputs<'_>, weights: &Self::Weights) -> Result<(Vec<Entry<Self>>, Self::Scales), OpenError>;

    /// Returns the normalised state.
    fn state(scales: &Self::Scales, proprio: &Self::Proprio, object: &Self::Pose) -> Self::State;

    /// Returns whether all numbers of a state are finite.
    fn is_finite(state: &Self::State) -> bool;

    /// Squared distance between two states.
    fn squared(scales: &Self::Scales, a: &Self::State, b: &Self::State) -> f64;

    /// Adds noise to a state: `normal` returns a new Gaussian number with the standard deviation of the noise at every call.
    /// Coordinates are then limited to `[-1, 1]`.
    fn perturb(state: &mut Self::State, normal: &mut dyn FnMut() -> f64);

    /// A vector whose Euclidean distances approximate those of [`Self::squared`]; orientations are embedded without a
    /// discontinuity.
    fn features(scales: &Self::Scales, state: &Self::State) -> Vec<f64>;

    /// The velocity field of GPI, evaluated at the present state: each neighbour contributes its recorded motion, weighted by
    /// `progression`, and an attraction towards its recorded position, weighted by `attraction`. The weights of the neighbours
    /// sum to 1; the first one is the nearest.
    fn flow(
        neighbors: &[(f64, &Entry<Self>)],
        proprio: &Self::Proprio,
        object: &Self::Pose,
        field: &Field,
    ) -> Self::Action;

    /// Weighted mean of the neighbours' actions in a frame, as an action in the world frame for the observed object. The weights
    /// sum to 1; the first neighbour is the nearest.
    fn mean(neighbors: &[(f64, &Entry<Self>)], object: &Self::Pose, frame: ActionFrame) -> Self::Action;

    /// `(action + smoothing * previous) / (1 + smoothing)` for the position of the action.
    fn smooth(action: &mut Self::Action, previous: &Self::Action, smoothing: f64);
}

/// Weights of GPI's velocity field, and the frame in which it is evaluated.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Field {
    pub(crate) frame: ActionFrame,
    pub(crate) progression: f64,
    pub(crate) attraction: f64,
}

/// All frames of the demonstrations with their normalised states.
pub(crate) struct Memory<D: Lookup> {
    pub(crate) entries: Vec<Entry<D>>,
    pub(crate) scales: D::Scales,
}

impl<D: Lookup> Memory<D> {
    /// Reads the frames from the index.
    ///
    /// # Errors
    /// If the index cannot be read or no frame can be retrieved.
    pub(crate) fn open(inputs: &Inputs<'_>, weights: &D::Weights) -> Result<Self, OpenError> {
        let (entries, scales) = D::read(inputs, weights)?;
        if entries
            .iter()
            .any(|entry| entry.retrievable && !D::is_finite(&entry.state))
        {
            return Err(LookupError::Retrieve(re4_index::IndexError::QueryNotFinite).into());
        }
        let memory = Self { entries, scales };
        if memory.entries.iter().any(|entry| entry.retrievable) {
            return Ok(memory);
        }
        let mode = re4_episode::Mode::Transit;
        Err(LookupError::NoFrameOfMode { mode }.into())
    }

    /// Returns the normalised state of an observation.
    ///
    /// # Errors
    /// If a coordinate is not finite.
    pub(crate) fn query(&self, proprio: &D::Proprio, object: &D::Pose) -> Result<D::State, LookupError> {
        let state = D::state(&self.scales, proprio, object);
        if D::is_finite(&state) {
            return Ok(state);
        }
        Err(re4_index::IndexError::QueryNotFinite.into())
    }

    /// Number of entries from `at` to the end of its demonstration, at most `most`.
    pub(crate) fn run(&self, at: usize, most: usize) -> usize {
        let demo = self.entries[at].demo;
        let rest = self.entries[at..].iter().take(most);
        rest.take_while(|entry| entry.demo == demo).count()
    }

    /// The entry `back` frames before `at` in its demonstration, or the first one of the demonstration.
    pub(crate) fn before(&self, at: usize, back: usize) -> usize {
        at - back.min(self.entries[at].frame as usize).min(at)
    }
}

#[cfg(test)]
pub(crate) mod tests;

/// Returns the `count` smallest distances in ascending order with their positions. Ties go to the lowest position, and positions
/// whose distance is `None` are left out.
pub(crate) fn nearest(distances: impl Iterator<Item = Option<f64>>, count: usize) -> Vec<(f64, usize)> {
    let mut best: Vec<(f64, usize)> = Vec::with_capacity(count + 1);
    for (at, distance) in distances.enumerate() {
        let Some(distance) = distance else { continue };
        if best.len() == count && best.last().is_some_and(|(worst, _)| distance >= *worst) {
            continue;
        }
        let place = best.partition_point(|(other, _)| *other <= distance);
        best.insert(place, (distance, at));
        best.truncate(count);
    }
    best
}

/// Minimum and maximum of each coordinate.
pub(crate) fn ranges<const N: usize>(rows: impl Iterator<Item = [f64; N]>) -> [(f64, f64); N] {
    rows.fold([(f64::INFINITY, f64::NEG_INFINITY); N], |mut ranges, row| {
        for ((low, high), value) in ranges.iter_mut().zip(row) {
            (*low, *high) = (low.min(value), high.max(value));
        }
        ranges
    })
}

/// Scales a coordinate from its range to `[-1, 1]`. A coordinate that does not vary is compared in its own unit.
pub(crate) fn scaled(value: f64, (low, high): (f64, f64)) -> f64 {
    if high - low > 1e-8 {
        2.0 * (value - low) / (high - low) - 1.0
    } else {
        value - low
    }
}

/// Weights `1 / (distance + 1e-8)`, divided by their sum (GPI).
pub(crate) fn inverse_weights(distances: impl Iterator<Item = f64>) -> Vec<f64> {
    normalized(distances.map(|distance| 1.0 / (distance + 1e-8)).collect())
}

/// Weights `exp(-distance / temperature)`, divided by their sum (VINN, where the temperature is 1).
pub(crate) fn softmax_weights(distances: &[f64], temperature: f64) -> Vec<f64> {
    let least = distances.iter().copied().fold(f64::INFINITY, f64::min);
    normalized(distances.iter().map(|d| (-(d - least) / temperature).exp()).collect())
}

fn normalized(mut weights: Vec<f64>) -> Vec<f64> {
    let sum: f64 = weights.iter().sum();
    for weight in &mut weights {
        *weight /= sum;
    }
    weights
}
