//! States and actions of Push-T.

use re4_artifact::Stage;
use re4_geometry::{Point2, Pose2};
use re4_index::{AngleMetric, IndexRow, Normalization, PlanarState, Query};
use re4_rollout::Plane;

use super::{ActionFrame, Entry, Field, Lookup};
use crate::artifact::read_scales;
use crate::kinds::{Inputs, OpenError};

/// Returns a position in the frame of actions.
fn local(frame: ActionFrame, object: &Pose2, position: Point2) -> Point2 {
    match frame {
        ActionFrame::Object => object.inverse_transform_point(position),
        ActionFrame::World => position,
    }
}

/// Returns a position in the world from one in the frame of actions.
fn world(frame: ActionFrame, object: &Pose2, position: Point2) -> Point2 {
    match frame {
        ActionFrame::Object => object.transform_point(position),
        ActionFrame::World => position,
    }
}

impl Lookup for Plane {
    /// Pusher x, y, block x, y and angle. The angle is periodic.
    type State = [f64; 5];
    type Scales = Normalization;
    type Weights = ();

    fn read(inputs: &Inputs<'_>, (): &()) -> Result<(Vec<Entry<Self>>, Normalization), OpenError> {
        let index = inputs.of(Stage::Index)?;
        let scales = Normalization {
            ranges: read_scales(index)?,
            angle: AngleMetric::Periodic,
        };
        let rows: Vec<IndexRow<PlanarState>> = index.read()?;
        let entries = rows.into_iter().map(|row| Entry {
            demo: row.episode,
            frame: row.frame,
            retrievable: row.retrievable.unwrap_or(true),
            proprio: row.state.eef,
            object: row.state.object,
            action: row.state.action,
            state: Self::state(&scales, &row.state.eef, &row.state.object),
        });
        Ok((entries.collect(), scales))
    }

    fn state(scales: &Normalization, proprio: &Point2, object: &Pose2) -> [f64; 5] {
        let query = Query {
            mode: re4_episode::Mode::Transit,
            eef: *proprio,
            object: *object,
        };
        scales.query(&query).map(|unit| 2.0 * unit - 1.0)
    }

    fn is_finite(state: &[f64; 5]) -> bool {
        state.iter().all(|number| number.is_finite())
    }

    fn squared(scales: &Normalization, a: &[f64; 5], b: &[f64; 5]) -> f64 {
        let period = 2.0 * scales.period();
        let direct = (a[4] - b[4]).abs();
        let angle = direct.min((period - direct).abs());
        (0..4).map(|i| (a[i] - b[i]) * (a[i] - b[i])).sum::<f64>() + angle * angle
    }

    fn perturb(state: &mut [f64; 5], normal: &mut dyn FnMut() -> f64) {
        for number in state {
            *number = (*number + normal()).clamp(-1.0, 1.0);
        }
    }

    fn features(scales: &Normalization, state: &[f64; 5]) -> Vec<f64> {
        // A circle whose circumference is the period, so that short arcs have the length of the distance.
        let radius = scales.period() / std::f64::consts::PI;
        let (sine, cosine) = (state[4] / radius).sin_cos();
        let mut features = state[..4].to_vec();
        features.extend([radius * cosine, radius * sine]);
        features
    }

    fn flow(neighbors: &[(f64, &Entry<Self>)], proprio: &Point2, object: &Pose2, field: &Field) -> Point2 {
        let here = local(field.frame, object, *proprio);
        let velocity = |entry: &Entry<Self>| {
            let there = local(field.frame, &entry.object, entry.proprio);
            let action = local(field.frame, &entry.object, entry.action);
            (action - there) * field.progression + (there - here) * field.attraction
        };
        let sum = neighbors
            .iter()
            .fold(Point2::zeros(), |sum, (weight, entry)| sum + velocity(entry) * *weight);
        world(field.frame, object, here + sum)
    }

    fn mean(neighbors: &[(f64, &Entry<Self>)], object: &Pose2, frame: ActionFrame) -> Point2 {
        let sum = neighbors.iter().fold(Point2::zeros(), |sum, (weight, entry)| {
            sum + local(frame, &entry.object, entry.action) * *weight
        });
        world(frame, object, sum)
    }

    fn smooth(action: &mut Point2, previous: &Point2, smoothing: f64) {
        *action = (*action + previous * smoothing) / (1.0 + smoothing);
    }
}
