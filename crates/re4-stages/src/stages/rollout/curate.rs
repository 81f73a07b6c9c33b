//! Makes `curation`, a subset of the demonstrations that is chosen on some scenes and judged on others.

mod scores;

use std::collections::BTreeSet;
use std::time::Instant;

use anyhow::{Context as _, Result};
use rand_pcg::Pcg64;
use rand_pcg::rand_core::Rng as _;
use re4_artifact::{Artifact, ArtifactSummary, Row as _, Stage, columns};
use re4_fault::{bail, ensure};
use re4_influence::{Aim, By, Choice, Curate, CuratedRow, Demo, JudgedRow, RoundRow, Score, curate, learning_curve};
use re4_ingest::Selection;
use re4_rollout::{PlaneResultRow, SpaceResultRow};
use re4_stats::{mean_interval, median, paired_interval, sign_test, wilson_interval};
use serde_json::json;

use crate::pipeline::Seeds;
use crate::runner::{Built, Runner};

use super::Judge;

/// Increase it whenever the same input gives different bytes.
const CODE_VERSION: u32 = 1;

/// Seed of all bootstraps, as in comparisons.
const BOOTSTRAP_SEED: u64 = 0;

/// How a subset is chosen and judged.
#[derive(Debug, Clone)]
pub struct Curation {
    /// What demonstrations are ranked by.
    pub by: By,
    /// What the choice aims at.
    pub aim: Aim,
    /// Number of scenes per demonstration that start from its own first state, perturbed, besides the pipeline's scenes.
    pub starts: u32,
    /// Seeds on which the subset is judged; none of them may be a seed of the pipeline.
    pub judge: Option<Seeds>,
    /// Number of random subsets of the same size that are judged, too.
    pub random: u32,
    /// Whether to compute the learning curve.
    pub curve: bool,
}

/// A curation.
pub struct Curated {
    /// The `curation` artifact.
    pub built: Built,
    /// The rows of its table `curated`.
    pub rows: Vec<CuratedRow>,
    /// The rows of its table `curation_rounds`.
    pub rounds: Vec<RoundRow>,
    /// The rows of its table `curation_judged`.
    pub judged: Vec<JudgedRow>,
}

impl Curated {
    /// Names of the kept demonstrations.
    pub fn kept(&self) -> Vec<String> {
        let kept = self.rows.iter().filter(|row| row.kept);
        kept.map(|row| row.demo_name.clone()).collect()
    }
}

impl Runner {
    /// Makes the `curation` artifact, or returns the existing one.
    ///
    /// # Errors
    /// If the policy cannot do without single demonstrations, the seeds overlap, an input cannot be read, or the run is interrupted.
    pub fn curate(&self, curation: &Curation) -> Result<Curated> {
        let start = Instant::now();
        self.refuse_learned()?;
        self.refuse_overlap(curation)?;
        let episodes = self.ingest()?;
        let modes = self.segment(&episodes)?;
        let audit = self.audit(&episodes, &modes)?;
        let more = json!({
            "by": re4_artifact::Word::word(curation.by),
            "aim": re4_artifact::Word::word(curation.aim),
            "starts": curation.starts,
            "judge": curation.judge,
            "random": curation.random,
            "curve": curation.curve,
        });
        let judge = Judge {
            starts: curation.starts,
        };
        let (built, _) = self.with_artifacts(&|policy, artifacts| {
            let recipe = self.judged_recipe(Stage::Curate, CODE_VERSION, policy, artifacts, &more)?;
            let recipe = recipe.input("audit", audit.artifact.key());
            if let Some(built) = self.unchanged(&recipe, start)? {
                return Ok(built);
            }
            let (choice, demos, findings) = self.with_episodes(policy, artifacts, judge, &|on, roll| {
                let findings = scores::findings(&audit.artifact, on.demos.len())?;
                let names: Vec<String> = on.demos.iter().map(|demo| demo.name.clone()).collect();
                let scores = scores::scores(&episodes.artifact, &audit.artifact, &names)?;
                let request = Curate {
                    demos: on.demos.len(),
                    scenes: on.scenes.len(),
                    max_steps: self.pipeline.rollout()?.max_steps,
                    scores: &scores,
                    findings: &Score {
                        name: "findings".to_owned(),
                        values: findings.iter().map(|count| Some(f64::from(*count))).collect(),
                    },
                    by: curation.by,
                    aim: curation.aim,
                };
                let mut choice = curate(&request, roll)?;
                if curation.curve {
                    let random = shuffled(on.demos.len() as u32, 0);
                    choice.rounds.extend(learning_curve(&request, &choice.ranking(), &random, roll)?);
                }
                Ok((choice, on.demos.to_vec(), findings))
            })?;
            let judged = self.judge(curation, &choice, &demos)?;
            self.build(&recipe, |writer| {
                let taken = choice.rounds.iter().rev().find(|round| round.taken);
                writer.write_rows(CuratedRow::rows(&choice, &demos, &findings))?;
                writer.write_rows(RoundRow::rows(&choice))?;
                writer.write_rows(judged.iter().cloned())?;
                Ok(ArtifactSummary {
                    summary: json!({
                        "demonstrations": demos.len(),
                        "kept": choice.kept.len(),
                        "sets_tried": choice.rounds.len(),
                        "tuned": {
                            "success": [choice.rounds.first().map(|round| round.success), taken.map(|round| round.success)],
                            "steps": [choice.rounds.first().map(|round| round.steps), taken.map(|round| round.steps)],
                        },
                    }),
                    warnings: Vec::new(),
                })
            })
        })?;
        Ok(Curated {
            rows: built.artifact.read()?,
            rounds: built.artifact.read()?,
            judged: built.artifact.read()?,
            built,
        })
    }

    /// Refuses to judge a subset on the seeds that it is chosen on.
    fn refuse_overlap(&self, curation: &Curation) -> Result<()> {
        let tuned = self.pipeline.rollout()?.seeds.as_ref();
        let (Some(tuned), Some(judge)) = (tuned, &curation.judge) else {
            return Ok(());
        };
        let tuned: BTreeSet<u32> = tuned.as_slice().iter().copied().collect();
        if let Some(both) = judge.as_slice().iter().find(|seed| tuned.contains(seed)) {
            bail!(
                "the subset would be judged on seed {both}, on which it is chosen";
                "give seeds with --judge that are not in rollout.seeds"
            );
        }
        Ok(())
    }

    /// Rolls out the curated set, all demonstrations, and random sets on the seeds of the judgement.
    fn judge(&self, curation: &Curation, choice: &Choice, demos: &[Demo]) -> Result<Vec<JudgedRow>> {
        let Some(seeds) = &curation.judge else {
            return Ok(Vec::new());
        };
        let count = choice.kept.len();
        let all: BTreeSet<u32> = (0..demos.len() as u32).collect();
        let mut sets = vec![("curated".to_owned(), choice.kept.clone()), ("all".to_owned(), all)];
        sets.extend((1..=curation.random).map(|number| {
            let order = shuffled(demos.len() as u32, number);
            (format!("random {number}"), order.into_iter().take(count).collect())
        }));
        let mut results = Vec::new();
        for (name, set) in &sets {
            self.notes
                .note(&format!("{:>10}  {name}, {} demonstrations", "judge", set.len()));
            results.push(self.results(set, demos, seeds)?);
        }
        let curated = results.first().cloned().context("no curated set")?;
        let rows = sets.iter().zip(&results);
        Ok(rows
            .flat_map(|((name, set), found)| judged_rows(name, set.len(), found, &curated))
            .collect())
    }

    /// The results of the pipeline with only some demonstrations.
    fn results(&self, set: &BTreeSet<u32>, demos: &[Demo], seeds: &Seeds) -> Result<Vec<ResultOf>> {
        let mut pipeline = self.pipeline.clone();
        let picks = set
            .iter()
            .filter_map(|&demo| demos.get(demo as usize))
            .map(|demo| demo.name.as_str().into());
        if set.len() < demos.len() {
            pipeline.ingest.select = Selection::List(picks.collect());
        }
        pipeline.rollout.as_mut().context("no table [rollout]")?.seeds = Some(seeds.clone());
        let (built, _) = self.runner(&self.file, pipeline).roll_out()?;
        read_results(&built.artifact)
    }
}

columns! {
    /// The columns of a result of Push-T that are judged.
    pub struct PlaneResultOf {
        /// Whether the task succeeded.
        pub success: bool,
        /// Number of control steps.
        pub steps: u32,
        /// Maximum score.
        pub score_max: f64,
    }
}

columns! {
    /// The columns of a result of a robosuite task that are judged.
    pub struct SpaceResultOf {
        /// Whether the task succeeded.
        pub success: bool,
        /// Number of control steps.
        pub steps: u32,
    }
}

/// The result of a rollout.
#[derive(Debug, Clone, Copy, PartialEq)]
struct ResultOf {
    success: bool,
    steps: u32,
    score: f64,
}

fn read_results(rollouts: &Artifact) -> Result<Vec<ResultOf>> {
    let space = rollouts.table_named(SpaceResultRow::NAME)?.domain().as_deref() == Some("space");
    Ok(if space {
        let rows: Vec<SpaceResultOf> = rollouts.table(SpaceResultRow::table())?.read()?;
        let result = |row: SpaceResultOf| ResultOf {
            success: row.success,
            steps: row.steps,
            score: f64::from(u8::from(row.success)),
        };
        rows.into_iter().map(result).collect()
    } else {
        let rows: Vec<PlaneResultOf> = rollouts.table(PlaneResultRow::table())?.read()?;
        let result = |row: PlaneResultOf| ResultOf {
            success: row.success,
            steps: row.steps,
            score: row.score_max,
        };
        rows.into_iter().map(result).collect()
    })
}

/// A measure: its name, and its value in a result.
type Measured = (&'static str, fn(&ResultOf) -> f64);

/// The rows of a set: success, score and steps.
fn judged_rows(name: &str, demos: usize, found: &[ResultOf], curated: &[ResultOf]) -> Vec<JudgedRow> {
    let measures: [Measured; 3] = [
        ("success", |one| f64::from(u8::from(one.success))),
        ("score", |one| one.score),
        ("steps", |one| f64::from(one.steps)),
    ];
    let solved: Vec<f64> = found
        .iter()
        .filter(|one| one.success)
        .map(|one| f64::from(one.steps))
        .collect();
    let row = |(measure, value): Measured| {
        let values: Vec<f64> = found.iter().map(value).collect();
        let own: Vec<f64> = curated.iter().map(value).collect();
        let interval = if measure == "success" {
            wilson_interval(solved.len() as u64, values.len() as u64)
        } else {
            mean_interval(&values, BOOTSTRAP_SEED)
        };
        let difference = paired_interval(&own, &values, BOOTSTRAP_SEED)?;
        let test = sign_test(&own, &values)?;
        Some(JudgedRow {
            set: name.to_owned().into(),
            demos: demos as u32,
            measure: measure.into(),
            rollouts: values.len() as u32,
            value: interval.value,
            low: interval.low,
            high: interval.high,
            median_steps: median(&solved),
            difference: difference.value,
            difference_low: difference.low,
            difference_high: difference.high,
            p: test.p,
        })
    };
    measures.into_iter().filter_map(row).collect()
}

/// The numbers below `count` in a random order, which depends only on `count` and `seed`.
fn shuffled(count: u32, seed: u32) -> Vec<u32> {
    // The stream number is the ASCII code of "CURATE".
    let mut random = Pcg64::new(u128::from(seed), 0x4355_5241_5445);
    let mut order: Vec<u32> = (0..count).collect();
    for last in (1..order.len()).rev() {
        // The upper half of a 64 x 64 bit product is an index up to `last`, uniform to within last / 2^64.
        let at = ((u128::from(random.next_u64()) * (last as u128 + 1)) >> 64) as usize;
        order.swap(last, at);
    }
    order
}

/// Refuses an `audit` artifact that does not list every demonstration.
fn check_count(found: usize, expected: usize) -> Result<()> {
    ensure!(
        found == expected,
        "the audit lists {found} demonstrations instead of {expected}";
        "delete the audit artifact and run again"
    );
    Ok(())
}
