//! The choice of demonstrations: those with which episodes are expected to cost most are dropped, as long as the episodes get cheaper.
//!
//! When demonstrations are dropped, rollouts follow others. So the choice is made in rounds: roll out, rank the demonstrations by the
//! cost that is expected of episodes that follow them, try to drop the worst of them, keep the drop that lowers the mean cost most, and
//! repeat until none does.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

use re4_artifact::Word;
use re4_stats::mean;

use crate::prior::{Evidence, Score, expect, observed};
use crate::{Evaluation, Roll, cost, evaluate, evaluate_without};

/// Parts of the demonstrations that a round tries to drop. If none of them helps, smaller parts are tried, down to one demonstration.
const PARTS: [usize; 3] = [3, 6, 12];

/// What a choice aims at.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Aim {
    /// Drops demonstrations as long as that makes episodes cheaper.
    Harmful,
    /// Drops only the demonstrations on which no episode depends.
    Redundant,
    /// As `Harmful`, and then drops further demonstrations as long as the mean cost is within one standard error of the minimum.
    Smallest,
}

/// What demonstrations are ranked by.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum By {
    /// The observed cost of the episodes that follow a demonstration.
    Influence,
    /// The findings of the audit.
    Audit,
    /// Scores of the demonstrations.
    Scores,
    /// All of these.
    Combined,
}

impl Word for Aim {
    const ALL: &'static [Self] = &[Self::Harmful, Self::Redundant, Self::Smallest];

    fn word(self) -> &'static str {
        match self {
            Self::Harmful => "harmful",
            Self::Redundant => "redundant",
            Self::Smallest => "smallest",
        }
    }
}

impl Word for By {
    const ALL: &'static [Self] = &[Self::Influence, Self::Audit, Self::Scores, Self::Combined];

    fn word(self) -> &'static str {
        match self {
            Self::Influence => "influence",
            Self::Audit => "audit",
            Self::Scores => "scores",
            Self::Combined => "combined",
        }
    }
}

/// What is chosen from, and how.
#[derive(Debug, Clone, Copy)]
pub struct Curate<'a> {
    /// Number of demonstrations.
    pub demos: usize,
    /// Number of scenes.
    pub scenes: usize,
    /// Maximum length of an episode in control steps.
    pub max_steps: u32,
    /// Scores of the demonstrations.
    pub scores: &'a [Score],
    /// Number of errors and warnings of the audit, as a score.
    pub findings: &'a Score,
    /// What demonstrations are ranked by.
    pub by: By,
    /// What the choice aims at.
    pub aim: Aim,
}

/// A set of demonstrations that was tried.
#[derive(Debug, Clone, PartialEq)]
pub struct Round {
    /// Why the set was rolled out: `tried`, `ranked` or `random`.
    pub series: &'static str,
    /// Number of the round, from 0 for all demonstrations.
    pub round: u32,
    /// Number of demonstrations in the set.
    pub kept: u32,
    /// Fraction of episodes that succeed.
    pub success: f64,
    /// Mean score.
    pub score: f64,
    /// Mean number of control steps; failures take the maximum.
    pub steps: f64,
    /// Mean cost.
    pub cost: f64,
    /// Name of the score that predicted costs; `None` if none did.
    pub predicted_by: Option<String>,
    /// Whether the choice continued from this set.
    pub taken: bool,
}

/// The chosen demonstrations.
#[derive(Debug, Clone, PartialEq)]
pub struct Choice {
    /// The numbers of the demonstrations.
    pub kept: BTreeSet<u32>,
    /// Every set that was tried, in order.
    pub rounds: Vec<Round>,
    /// What was known about each demonstration when it was dropped, or at the end.
    pub evidence: Vec<Evidence>,
    /// The round in which each dropped demonstration was dropped.
    pub dropped: BTreeMap<u32, u32>,
}

/// Chooses demonstrations.
///
/// # Errors
/// Those of `roll`.
pub fn curate<E>(curate: &Curate<'_>, roll: &mut Roll<'_, E>) -> Result<Choice, E> {
    let all = evaluate(roll, curate.scenes, &Arc::default())?;
    let mut search = Search {
        curate,
        choice: Choice {
            kept: (0..curate.demos as u32).collect(),
            rounds: Vec::new(),
            evidence: vec![Evidence::default(); curate.demos],
            dropped: BTreeMap::new(),
        },
        now: all,
        round: 0,
    };
    search.note(&search.now.clone(), None, true);
    if curate.aim == Aim::Redundant {
        search.drop_unused();
        return Ok(search.choice);
    }
    while search.improve(roll, None)? {}
    if curate.aim == Aim::Smallest {
        let best = search.now.clone();
        while search.improve(roll, Some(&best))? {}
        search.drop_unused();
    }
    Ok(search.choice)
}

struct Search<'a, 'b> {
    curate: &'a Curate<'b>,
    choice: Choice,
    now: Evaluation,
    round: u32,
}

impl Search<'_, '_> {
    /// Drops a part of the demonstrations with the highest expected cost, and returns whether a part was found. Without `best`, the
    /// part has to lower the mean cost; with it, the mean cost has to stay within one standard error of that of `best`.
    fn improve<E>(&mut self, roll: &mut Roll<'_, E>, best: Option<&Evaluation>) -> Result<bool, E> {
        self.round += 1;
        let (ranked, name) = self.ranked();
        let count = ranked.len();
        let parts = PARTS.map(|part| count / part);
        let smaller = std::iter::successors(Some(count / (2 * PARTS[PARTS.len() - 1])), |part| Some(part / 2));
        let smaller: Vec<usize> = smaller.take_while(|part| *part > 0).chain([1]).collect();
        for parts in [parts.to_vec(), smaller] {
            let mut taken: Option<(f64, Evaluation)> = None;
            for part in distinct(&parts, count) {
                let more: BTreeSet<u32> = ranked.iter().take(part).copied().collect();
                let tried = evaluate_without(roll, &self.now, &more)?;
                let (least, admitted) = match (best, &taken) {
                    (Some(best), taken) => (taken.as_ref(), self.is_within(best, &tried)),
                    (None, None) => (None, self.mean_cost(&tried) < self.mean_cost(&self.now)),
                    (None, Some(taken)) => (Some(taken), true),
                };
                self.note(&tried, name.clone(), false);
                let cost = self.mean_cost(&tried);
                // With `best`, the first part that is admitted is the largest.
                let better = least.is_none_or(|(least, _)| best.is_none() && cost < *least);
                if admitted && better {
                    taken = Some((cost, tried));
                }
            }
            if let Some((_, evaluation)) = taken {
                self.take(evaluation);
                return Ok(true);
            }
        }
        Ok(false)
    }

    /// The kept demonstrations, the one with the highest expected cost first, and the score that predicted costs.
    fn ranked(&mut self) -> (Vec<u32>, Option<String>) {
        let Curate {
            demos,
            max_steps,
            scores,
            findings,
            by,
            ..
        } = *self.curate;
        let mut evidence = observed(demos, &self.now.episodes, max_steps);
        let audit = std::slice::from_ref(findings);
        let scores = match by {
            By::Influence => Vec::new(),
            By::Audit => audit.to_vec(),
            By::Scores => scores.to_vec(),
            By::Combined => [scores, audit].concat(),
        };
        let own = matches!(by, By::Influence | By::Combined);
        let name = expect(&mut evidence, &self.choice.kept, &scores, own).map(str::to_owned);
        let mut ranked: Vec<u32> = self.choice.kept.iter().copied().collect();
        for &demo in &ranked {
            self.choice.evidence[demo as usize] = evidence[demo as usize];
        }
        let expected = |demo: &u32| evidence[*demo as usize].expected;
        ranked.sort_by(|a, b| expected(b).total_cmp(&expected(a)).then(a.cmp(b)));
        (ranked, name)
    }

    fn mean_cost(&self, evaluation: &Evaluation) -> f64 {
        evaluation.mean(|episode| cost(episode, self.curate.max_steps))
    }

    /// Whether the mean cost exceeds that of `best` by at most one standard error of the difference over scenes.
    fn is_within(&self, best: &Evaluation, tried: &Evaluation) -> bool {
        let pairs = tried.episodes.iter().zip(&best.episodes);
        let differences: Vec<f64> = pairs
            .map(|(one, other)| cost(one, self.curate.max_steps) - cost(other, self.curate.max_steps))
            .collect();
        let middle = mean(&differences);
        let squares: Vec<f64> = differences.iter().map(|value| (value - middle).powi(2)).collect();
        let count = differences.len().max(2) as f64;
        middle <= (mean(&squares) / (count - 1.0)).sqrt()
    }

    fn take(&mut self, evaluation: Evaluation) {
        for demo in evaluation.without.difference(&self.now.without) {
            self.choice.kept.remove(demo);
            self.choice.dropped.insert(*demo, self.round);
        }
        let kept = self.choice.kept.len() as u32;
        let tried = self.choice.rounds.iter_mut().rev();
        if let Some(round) = tried
            .take_while(|round| round.round == self.round)
            .find(|round| round.kept == kept)
        {
            round.taken = true;
        }
        self.now = evaluation;
    }

    /// Drops the demonstrations on which no episode depends. All episodes stay the same.
    fn drop_unused(&mut self) {
        self.ranked();
        self.round += 1;
        let used = self.now.episodes.iter().flat_map(|episode| &episode.considered);
        let used: BTreeSet<u32> = used.copied().collect();
        if used.is_empty() || used.len() == self.choice.kept.len() {
            return;
        }
        let unused = self.choice.kept.difference(&used).copied();
        let without = self.now.without.iter().copied().chain(unused).collect();
        let evaluation = Evaluation {
            without: Arc::new(without),
            episodes: self.now.episodes.clone(),
        };
        self.note(&evaluation, None, true);
        self.take(evaluation);
    }

    fn note(&mut self, evaluation: &Evaluation, predicted_by: Option<String>, taken: bool) {
        let round = Round {
            round: self.round,
            predicted_by,
            taken,
            ..Round::of(evaluation, "tried", self.curate)
        };
        self.choice.rounds.push(round);
    }
}

impl Round {
    fn of(evaluation: &Evaluation, series: &'static str, curate: &Curate<'_>) -> Self {
        Self {
            series,
            round: 0,
            kept: (curate.demos - evaluation.without.len()) as u32,
            success: evaluation.success(),
            score: evaluation.mean(|episode| episode.score),
            steps: evaluation.mean(|episode| f64::from(episode.steps)),
            cost: evaluation.mean(|episode| cost(episode, curate.max_steps)),
            predicted_by: None,
            taken: false,
        }
    }
}

impl Choice {
    /// The demonstrations from the best to the worst: the kept ones by the cost that is expected of them, then the dropped ones, those
    /// of the first round last.
    pub fn ranking(&self) -> Vec<u32> {
        let mut ranking: Vec<u32> = (0..self.evidence.len() as u32).collect();
        let round = |demo: u32| std::cmp::Reverse(self.dropped.get(&demo).copied().unwrap_or(u32::MAX));
        let expected = |demo: u32| self.evidence[demo as usize].expected;
        ranking.sort_by(|&a, &b| {
            let by_round = round(a).cmp(&round(b));
            by_round.then(expected(a).total_cmp(&expected(b))).then(a.cmp(&b))
        });
        ranking
    }
}

/// The learning curve: for sizes 1, 2, 5, 10, ..., the best demonstrations of a ranking and as many of a random order.
///
/// # Errors
/// Those of `roll`.
pub fn learning_curve<E>(
    curate: &Curate<'_>,
    ranking: &[u32],
    random: &[u32],
    roll: &mut Roll<'_, E>,
) -> Result<Vec<Round>, E> {
    let sizes = std::iter::successors(Some(1), |decade: &usize| decade.checked_mul(10))
        .take_while(|decade| *decade < curate.demos)
        .flat_map(|decade| [1, 2, 5].map(|digit| digit * decade))
        .filter(|size| *size < curate.demos);
    let mut rounds = Vec::new();
    for size in sizes {
        for (series, order) in [("ranked", ranking), ("random", random)] {
            let without = Arc::new(order.iter().skip(size).copied().collect());
            let evaluation = evaluate(roll, curate.scenes, &without)?;
            rounds.push(Round::of(&evaluation, series, curate));
        }
    }
    Ok(rounds)
}

/// The sizes in descending order without repetitions, which leave at least one demonstration.
fn distinct(sizes: &[usize], count: usize) -> Vec<usize> {
    let sizes: BTreeSet<usize> = sizes.iter().copied().filter(|size| (1..count).contains(size)).collect();
    sizes.into_iter().rev().collect()
}
