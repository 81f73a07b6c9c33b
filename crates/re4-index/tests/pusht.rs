//! Compares the index with the linear scan on the real Push-T demonstrations.

mod common;

use common::{Random, agreed, coordinates, pusht, query};
use rayon::prelude::*;
use re4_episode::Mode;
use re4_index::{AngleMetric, Query, RetrievalIndex};

const EPSILONS: [f64; 4] = [0.0, 0.03, 0.1, f64::INFINITY];

#[test]
fn index_and_linear_scan_agree_on_and_off_the_demonstrations() {
    let Some(frames) = pusht() else { return };
    for metric in [AngleMetric::Periodic, AngleMetric::Raw] {
        let index = RetrievalIndex::build(frames.clone(), metric).unwrap();
        let ranges = index.normalization().ranges;
        let mut random = Random::new(5);
        let mut queries: Vec<(bool, Query)> = Vec::new();
        for kind in 0..4 {
            for _ in 0..300 {
                let on = coordinates(&random.pick(&frames));
                let mut off = |reach: f64| on.map(|v| v + reach * random.range(-1.0, 1.0));
                let c = match kind {
                    0 => on,
                    1 => off(0.05),
                    2 => off(10.0),
                    _ => ranges.map(|r| random.range(r.minimum - 0.2 * r.span(), r.maximum + 0.2 * r.span())),
                };
                queries.push((kind == 0, query(Mode::Transit, c)));
            }
        }
        queries.par_iter().for_each(|(on_data, query)| {
            for epsilon in EPSILONS {
                let answer = agreed(&index, query, epsilon).unwrap();
                if *on_data {
                    assert_eq!((answer.d_q, answer.d_o), (0.0, 0.0), "{query:?}");
                }
            }
        });
    }
}

#[test]
fn a_query_evaluates_few_frames() {
    let Some(frames) = pusht() else { return };
    let index = RetrievalIndex::build(frames, AngleMetric::Periodic).unwrap();
    let evaluated: u64 = index
        .frames()
        .iter()
        .step_by(13)
        .map(|f| {
            let c = coordinates(f).map(|v| v + 3.0);
            let cost = index.retrieve_counted(&query(Mode::Transit, c), 0.1).unwrap().1;
            assert!(cost.demos_evaluated >= 1);
            u64::from(cost.frames_evaluated)
        })
        .sum();
    let queries = index.frames().len().div_ceil(13) as u64;
    let mean = evaluated / queries;
    assert!(mean < index.frames().len() as u64 / 10, "{mean} frames per query");
}
