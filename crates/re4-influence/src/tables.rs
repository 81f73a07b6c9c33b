//! The tables of `influence` and `curation` artifacts.

use std::collections::BTreeMap;

use rayon::prelude::*;
use re4_artifact::{Label, Word, table};
use re4_rollout::Traced;
use re4_stats::{Interval, mean_interval};

use crate::{Change, Choice, Evaluation};

/// Seed of all bootstraps, as in comparisons.
const BOOTSTRAP_SEED: u64 = 0;

/// Where scenes are from.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Scenes {
    /// The scenes of the pipeline: its seeds, or its table of scenes.
    Given,
    /// The start states of the demonstrations, each perturbed several times.
    Starts,
}

impl Word for Scenes {
    const ALL: &'static [Self] = &[Self::Given, Self::Starts];

    fn word(self) -> &'static str {
        match self {
            Self::Given => "given",
            Self::Starts => "starts",
        }
    }
}

table! {
    /// One row per demonstration and kind of scenes: how often rollouts followed it, and the exact change of their results if it were
    /// left out, over all scenes of that kind. Changes are the value without the demonstration minus the value with it, so a change
    /// above 0 means that the demonstration harms. 95 % intervals: percentile bootstrap over scenes (10,000 resamples, seed 0); they
    /// have no width if no scene changes. Sorted by kind of scenes and demonstration.
    #[table("influence", version = 1)]
    pub struct InfluenceRow {
        /// Where the scenes are from: given (the pipeline's) or starts (perturbed start states of the demonstrations).
        pub scenes: Scenes,
        /// Number of the demonstration in the index, from 0.
        pub demo: u32,
        /// Name of the demonstration in its source. Null if it is not known.
        pub demo_name: Option<String>,
        /// Position of its object in the first frame along x, world frame: px for Push-T, m for robosuite tasks.
        pub start_x: f64,
        /// The same along y.
        pub start_y: f64,
        /// Number of scenes.
        pub episodes: u32,
        /// Number of decisions to follow the demonstration.
        pub decisions: u32,
        /// Number of episodes that followed it.
        pub followed: u32,
        /// Number of episodes that followed it and succeeded.
        pub successes: u32,
        /// Number of episodes that followed it and failed.
        pub failures: u32,
        /// Number of episodes that depend on it: they considered it, and were rolled out again without it. 0: the demonstration was
        /// never judged, and its changes are 0 because no episode would be another one without it.
        pub depending: u32,
        /// Number of scenes that fail with it and succeed without it.
        pub repaired: u32,
        /// Number of scenes that succeed with it and fail without it.
        pub broken: u32,
        /// Change of the success rate.
        pub success_change: f64,
        /// Lower end of its interval.
        pub success_low: f64,
        /// Upper end of its interval.
        pub success_high: f64,
        /// Change of the mean score.
        pub score_change: f64,
        /// Lower end of its interval.
        pub score_low: f64,
        /// Upper end of its interval.
        pub score_high: f64,
        /// Change of the mean number of control steps; a failure takes as many as are allowed.
        pub steps_change: f64,
    }
}

table! {
    /// One row per scene: the episode with all demonstrations. Sorted by kind of scenes, in their order.
    #[table("judged_episodes", version = 1)]
    pub struct JudgedEpisodeRow {
        /// Where the scene is from.
        pub scenes: Scenes,
        /// Seed or number of the scene. A scene of kind starts has the number of its demonstration times the scenes per demonstration,
        /// plus the number of the perturbation.
        pub seed: u32,
        /// Whether the task succeeded.
        pub success: bool,
        /// Score from 0 to 1.
        pub score: f64,
        /// Number of control steps.
        pub steps: u32,
        /// Number of decisions to follow a demonstration.
        pub decisions: u32,
        /// Number of demonstrations that were followed.
        pub followed: u32,
        /// Number of demonstrations on which the episode depends.
        pub depending: u32,
        /// Number of them without which the success is another one.
        pub flips: u32,
        /// Position of the object after the reset along x, world frame: px for Push-T, m for robosuite tasks.
        pub start_x: f64,
        /// The same along y.
        pub start_y: f64,
    }
}

table! {
    /// One row per scene and demonstration on which its episode depends: the episode with and without the demonstration. In all other
    /// combinations, the episode is the same without the demonstration. The rows of a scene that fails name the demonstrations to
    /// blame: without those with success_without, it succeeds. Sorted by kind of scenes, demonstration and scene, in each part of the
    /// artifact.
    #[table("influence_pairs", version = 1)]
    pub struct PairRow {
        /// Where the scene is from.
        pub scenes: Scenes,
        /// Number of the demonstration in the index, from 0.
        pub demo: u32,
        /// Name of the demonstration in its source. Null if it is not known.
        pub demo_name: Option<String>,
        /// Seed or number of the scene.
        pub seed: u32,
        /// Number of decisions to follow the demonstration. 0 if it was only considered.
        pub decisions: u32,
        /// Whether the task succeeded with all demonstrations.
        pub success: bool,
        /// Whether it succeeded without this one.
        pub success_without: bool,
        /// Score with all demonstrations.
        pub score: f64,
        /// Score without this one.
        pub score_without: f64,
        /// Number of control steps with all demonstrations.
        pub steps: u32,
        /// Number of control steps without this one.
        pub steps_without: u32,
    }
}

table! {
    /// One row per demonstration: whether the curation keeps it, and what was known about it when it was dropped, or at the end.
    #[table("curated", version = 1)]
    pub struct CuratedRow {
        /// Number of the demonstration in the index, from 0.
        pub demo: u32,
        /// Name of the demonstration in its source.
        pub demo_name: String,
        /// Whether it is kept.
        pub kept: bool,
        /// Round in which it was dropped. Null if it is kept.
        pub round: Option<u32>,
        /// Number of episodes that followed it.
        pub episodes: u32,
        /// Mean cost of these episodes: 1 - score (1 - steps / (2 max_steps)). Null if there are none.
        pub cost: Option<f64>,
        /// Cost that was expected of an episode that follows it, from these episodes and from the scores.
        pub expected: f64,
        /// Number of errors and warnings of the audit.
        pub findings: u32,
    }
}

table! {
    /// One row per set of demonstrations that was rolled out on the scenes that the curation was tuned on, in order. Row 0 is the set
    /// of all demonstrations.
    #[table("curation_rounds", version = 1)]
    pub struct RoundRow {
        /// Why the set was rolled out: tried (by the curation), ranked (the best demonstrations by its ranking, for the learning
        /// curve) or random (the same number of random ones).
        pub series: Label,
        /// Number of the round, from 0. A round tries several sets. 0 for the learning curve.
        pub round: u32,
        /// Number of demonstrations in the set.
        pub kept: u32,
        /// Fraction of episodes that succeed.
        pub success: f64,
        /// Mean score.
        pub score: f64,
        /// Mean number of control steps; a failure takes as many as are allowed.
        pub steps: f64,
        /// Mean cost.
        pub cost: f64,
        /// Name of the score that predicted costs. Null if none did.
        pub predicted_by: Option<String>,
        /// Whether the next round continued from this set.
        pub taken: bool,
    }
}

table! {
    /// One row per set of demonstrations and measure, on seeds that the curation was not tuned on: the mean, and the difference
    /// between the curated set and this set over equal seeds. 95 % intervals: Wilson for the success, percentile bootstrap (10,000
    /// resamples, seed 0) otherwise. p: exact sign test.
    #[table("curation_judged", version = 1)]
    pub struct JudgedRow {
        /// Name of the set: curated, all, or random and its number.
        pub set: Label,
        /// Number of demonstrations in the set.
        pub demos: u32,
        /// The measure: success, score, or steps (failures take as many as are allowed).
        pub measure: Label,
        /// Number of rollouts.
        pub rollouts: u32,
        /// Mean of the measure.
        pub value: f64,
        /// Lower end of its interval.
        pub low: f64,
        /// Upper end of its interval.
        pub high: f64,
        /// Median number of steps of the rollouts that succeed. Null if there are none.
        pub median_steps: Option<f64>,
        /// Mean difference: the curated set minus this set.
        pub difference: f64,
        /// Lower end of its interval.
        pub difference_low: f64,
        /// Upper end of its interval.
        pub difference_high: f64,
        /// Probability of differences at least as uneven if neither set is better.
        pub p: f64,
    }
}

/// A demonstration: its name, and the position of its object in the first frame.
#[derive(Debug, Clone, PartialEq)]
pub struct Demo {
    /// Its name in the source.
    pub name: String,
    /// Horizontal position in the world frame, px or m.
    pub start: [f64; 2],
}

/// The rows of table `influence`: one for each of `demos` and each kind of scenes that has any, from the rows of the other two tables,
/// in any order of the pairs.
pub fn influence_rows(demos: &[Demo], episodes: &[JudgedEpisodeRow], pairs: &[PairRow]) -> Vec<InfluenceRow> {
    let mut rows = Vec::new();
    for scenes in [Scenes::Given, Scenes::Starts] {
        let of_kind: Vec<u32> = episodes
            .iter()
            .filter(|row| row.scenes == scenes)
            .map(|row| row.seed)
            .collect();
        if of_kind.is_empty() {
            continue;
        }
        let places: BTreeMap<u32, usize> = of_kind.iter().copied().zip(0..).collect();
        let mut own: Vec<(u32, usize, &PairRow)> = pairs
            .iter()
            .filter(|pair| pair.scenes == scenes)
            .filter_map(|pair| Some((pair.demo, *places.get(&pair.seed)?, pair)))
            .collect();
        own.sort_unstable_by_key(|&(demo, place, _)| (demo, place));
        let row = |(number, demo): (usize, &Demo)| {
            let number = number as u32;
            let first = own.partition_point(|&(other, ..)| other < number);
            let end = own.partition_point(|&(other, ..)| other <= number);
            influence_row(scenes, number, demo, of_kind.len(), &own[first..end])
        };
        rows.par_extend(demos.par_iter().enumerate().map(row));
    }
    rows
}

/// `pairs` are those of the demonstration with the places of their scenes, in that order.
fn influence_row(
    scenes: Scenes,
    demo: u32,
    about: &Demo,
    episodes: usize,
    pairs: &[(u32, usize, &PairRow)],
) -> InfluenceRow {
    let change = |value: &dyn Fn(&PairRow) -> f64| {
        let mut differences = vec![0.0; episodes];
        for (_, place, pair) in pairs {
            differences[*place] = value(pair);
        }
        if differences.iter().all(|difference| *difference == 0.0) {
            return Interval {
                value: 0.0,
                low: 0.0,
                high: 0.0,
            };
        }
        mean_interval(&differences, BOOTSTRAP_SEED)
    };
    let number = |success: bool| f64::from(u8::from(success));
    let success = change(&|pair| number(pair.success_without) - number(pair.success));
    let score = change(&|pair| pair.score_without - pair.score);
    let rows = || pairs.iter().map(|(_, _, pair)| *pair);
    let steps = rows().map(|pair| f64::from(pair.steps_without) - f64::from(pair.steps));
    let followed = || rows().filter(|pair| pair.decisions > 0);
    InfluenceRow {
        scenes,
        demo,
        demo_name: Some(about.name.clone()),
        start_x: about.start[0],
        start_y: about.start[1],
        episodes: episodes as u32,
        decisions: followed().map(|pair| pair.decisions).sum(),
        followed: followed().count() as u32,
        successes: followed().filter(|pair| pair.success).count() as u32,
        failures: followed().filter(|pair| !pair.success).count() as u32,
        depending: pairs.len() as u32,
        repaired: rows().filter(|pair| !pair.success && pair.success_without).count() as u32,
        broken: rows().filter(|pair| pair.success && !pair.success_without).count() as u32,
        success_change: success.value,
        success_low: success.low,
        success_high: success.high,
        score_change: score.value,
        score_low: score.low,
        score_high: score.high,
        steps_change: steps.sum::<f64>() / episodes.max(1) as f64,
    }
}

fn decisions(episode: &Traced, demo: u32) -> u32 {
    episode.followed.iter().filter(|followed| **followed == demo).count() as u32
}

/// The rows of table `judged_episodes` for one kind of scenes.
pub fn episode_rows(scenes: Scenes, base: &Evaluation, changes: &[Change]) -> Vec<JudgedEpisodeRow> {
    let mut flips: BTreeMap<usize, u32> = BTreeMap::new();
    for change in changes {
        if change.after.success != base.episodes[change.scene].success {
            *flips.entry(change.scene).or_default() += 1;
        }
    }
    let row = |(scene, episode): (usize, &Traced)| {
        let mut followed = episode.followed.clone();
        followed.sort_unstable();
        followed.dedup();
        JudgedEpisodeRow {
            scenes,
            seed: episode.seed,
            success: episode.success,
            score: episode.score,
            steps: episode.steps,
            decisions: episode.followed.len() as u32,
            followed: followed.len() as u32,
            depending: episode.considered.len() as u32,
            flips: flips.get(&scene).copied().unwrap_or(0),
            start_x: episode.start[0],
            start_y: episode.start[1],
        }
    };
    base.episodes.iter().enumerate().map(row).collect()
}

/// The rows of table `influence_pairs` for one kind of scenes.
pub fn pair_rows(scenes: Scenes, demos: &[Demo], base: &Evaluation, changes: &[Change]) -> Vec<PairRow> {
    let row = |change: &Change| {
        let with = &base.episodes[change.scene];
        PairRow {
            scenes,
            demo: change.demo,
            demo_name: demos.get(change.demo as usize).map(|demo| demo.name.clone()),
            seed: with.seed,
            decisions: decisions(with, change.demo),
            success: with.success,
            success_without: change.after.success,
            score: with.score,
            score_without: change.after.score,
            steps: with.steps,
            steps_without: change.after.steps,
        }
    };
    changes.iter().map(row).collect()
}

impl CuratedRow {
    /// The rows of table `curated`. `findings` are the errors and warnings of each demonstration.
    pub fn rows(choice: &Choice, demos: &[Demo], findings: &[u32]) -> Vec<Self> {
        let rows = (0..).zip(demos).zip(&choice.evidence);
        rows.map(|((demo, about), evidence)| Self {
            demo,
            demo_name: about.name.clone(),
            kept: choice.kept.contains(&demo),
            round: choice.dropped.get(&demo).copied(),
            episodes: evidence.episodes,
            cost: (evidence.episodes > 0).then(|| evidence.cost / f64::from(evidence.episodes)),
            expected: evidence.expected,
            findings: findings.get(demo as usize).copied().unwrap_or(0),
        })
        .collect()
    }
}

impl RoundRow {
    /// The rows of table `curation_rounds`.
    pub fn rows(choice: &Choice) -> Vec<Self> {
        let rows = choice.rounds.iter();
        rows.map(|round| Self {
            series: round.series.into(),
            round: round.round,
            kept: round.kept,
            success: round.success,
            score: round.score,
            steps: round.steps,
            cost: round.cost,
            predicted_by: round.predicted_by.clone(),
            taken: round.taken,
        })
        .collect()
    }
}
