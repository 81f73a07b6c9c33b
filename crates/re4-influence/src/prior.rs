//! How costly episodes are that follow a demonstration: what was observed, and what scores of demonstrations predict.

use std::collections::BTreeSet;

use re4_rollout::Traced;

use crate::cost;

/// Number of episodes that a prediction by scores counts for, relative to observed episodes.
const PRIOR_EPISODES: f64 = 4.0;

/// Width of the kernel over ranks, as a fraction of the demonstrations.
const BANDWIDTH: f64 = 0.1;

/// A score of demonstrations, such as their duration. Neither direction needs to be the better one.
#[derive(Debug, Clone, PartialEq)]
pub struct Score {
    /// Its name.
    pub name: String,
    /// One value per demonstration.
    pub values: Vec<Option<f64>>,
}

/// What is known about the episodes that follow a demonstration.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Evidence {
    /// Number of episodes that followed it.
    pub episodes: u32,
    /// Sum of their costs.
    pub cost: f64,
    /// The cost that is expected of an episode that follows it.
    pub expected: f64,
}

/// Sums of costs of the episodes that follow each demonstration.
pub(crate) fn observed(demos: usize, episodes: &[Traced], max_steps: u32) -> Vec<Evidence> {
    let mut evidence = vec![Evidence::default(); demos];
    for episode in episodes {
        let followed: BTreeSet<u32> = episode.followed.iter().copied().collect();
        for demo in followed {
            if let Some(evidence) = evidence.get_mut(demo as usize) {
                evidence.episodes += 1;
                evidence.cost += cost(episode, max_steps);
            }
        }
    }
    evidence
}

/// Fills in the expected costs, and returns the name of the score that they are predicted by. `own` is false if only the prediction
/// counts.
///
/// The prediction for a demonstration is the mean cost of the episodes that followed demonstrations of about the same rank in a
/// score, without its own. Of several scores, the one that predicts the observed costs best is used. Observed episodes and the
/// prediction are combined as if the prediction were [`PRIOR_EPISODES`] episodes.
pub(crate) fn expect<'a>(
    evidence: &mut [Evidence],
    kept: &BTreeSet<u32>,
    scores: &'a [Score],
    own: bool,
) -> Option<&'a str> {
    let predictions = scores
        .iter()
        .map(|score| (Some(score.name.as_str()), predict(evidence, kept, Some(score))))
        .chain([(None, predict(evidence, kept, None))]);
    let error = |predicted: &[f64]| -> f64 {
        kept.iter()
            .map(|&demo| (evidence[demo as usize], predicted[demo as usize]))
            .filter(|(one, _)| one.episodes > 0)
            .map(|(one, predicted)| {
                let episodes = f64::from(one.episodes);
                episodes * (one.cost / episodes - predicted).powi(2)
            })
            .sum()
    };
    let best = predictions.min_by(|(_, a), (_, b)| error(a).total_cmp(&error(b)));
    let (name, predicted) = best?;
    for (one, predicted) in evidence.iter_mut().zip(predicted) {
        let episodes = if own { f64::from(one.episodes) } else { 0.0 };
        let cost = if own { one.cost } else { 0.0 };
        one.expected = (cost + PRIOR_EPISODES * predicted) / (episodes + PRIOR_EPISODES);
    }
    name
}

/// The predicted cost of every demonstration. Without a score, or for a demonstration without a value, the mean over all episodes.
fn predict(evidence: &[Evidence], kept: &BTreeSet<u32>, score: Option<&Score>) -> Vec<f64> {
    let (episodes, total) = kept.iter().fold((0.0, 0.0), |(episodes, total), &demo| {
        let one = evidence[demo as usize];
        (episodes + f64::from(one.episodes), total + one.cost)
    });
    let mean = if episodes > 0.0 { total / episodes } else { 0.5 };
    let Some(score) = score else {
        return vec![mean; evidence.len()];
    };
    let mut ranked: Vec<(f64, u32)> = kept
        .iter()
        .filter_map(|&demo| Some((score.values.get(demo as usize).copied()??, demo)))
        .filter(|(value, _)| value.is_finite())
        .collect();
    ranked.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
    let width = (BANDWIDTH * ranked.len() as f64).max(1.0);
    // Equal values have the same rank: the middle of their places.
    let rank = |value: f64| {
        let below = ranked.partition_point(|(other, _)| *other < value);
        let up_to = ranked.partition_point(|(other, _)| *other <= value);
        (below + up_to) as f64 / 2.0
    };
    let ranks: Vec<f64> = ranked.iter().map(|(value, _)| rank(*value)).collect();
    let mut predicted = vec![mean; evidence.len()];
    for (place, (_, demo)) in ranks.iter().zip(&ranked) {
        // One episode of the mean cost keeps the quotient finite.
        let (mut episodes, mut total) = (1.0, mean);
        for (other_place, (_, other)) in ranks.iter().zip(&ranked) {
            if other == demo {
                continue;
            }
            let apart = (place - other_place) / width;
            let weight = (-0.5 * apart * apart).exp();
            let one = evidence[*other as usize];
            episodes += weight * f64::from(one.episodes);
            total += weight * one.cost;
        }
        predicted[*demo as usize] = total / episodes;
    }
    predicted
}
