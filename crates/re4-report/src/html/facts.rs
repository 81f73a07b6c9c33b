//! What follows from several artifacts together: names that tell them apart, differences of protocol, budget curves.

use std::collections::{BTreeMap, BTreeSet};

use serde_json::Value;

use super::{Report, Rollouts};
use re4_stats::{Interval, budgets, mean, mean_interval, running_maxima};

/// Seed of the bootstrap; the same as that of the artifacts' own summaries, so that the last budget has their interval.
const BOOTSTRAP_SEED: u64 = 0;

/// Facts of protocol that come first: what most often tells two sets of rollouts apart.
const FIRST: [&str; 9] = [
    "variant",
    "seeds",
    "scenes",
    "seed_scheme",
    "reset",
    "max_steps",
    "demonstrations.select",
    "dataset_blake3",
    "measure",
];

/// A fact that changes no rollout: whether pictures lie beside the states.
const WITHOUT_EFFECT: &str = "demonstrations.images";

/// Most points of a drawn curve.
const CURVE_POINTS: u32 = 256;

/// See the module.
pub(super) struct Facts {
    /// Name of each artifact on the page.
    pub(super) labels: Vec<String>,
    /// Rows of the protocol table.
    pub(super) protocol: Vec<Row>,
    /// Rows of the table of settings.
    pub(super) settings: Vec<Row>,
    /// Budget curve of each artifact.
    pub(super) curves: Vec<Curve>,
}

/// One fact, and what it is for each artifact.
pub(super) struct Row {
    /// Name of the fact.
    pub(super) name: String,
    /// Its value for each artifact; empty where the artifact does not state it.
    pub(super) values: Vec<String>,
}

impl Row {
    /// Whether the artifacts disagree.
    pub(super) fn differs(&self) -> bool {
        self.values.iter().any(|value| Some(value) != self.values.first())
    }
}

/// Means over rollouts of what they reached within step budgets.
pub(super) struct Curve {
    /// Budgets that the table shows.
    pub(super) budgets: Vec<u32>,
    /// Mean scaled score within each of them.
    pub(super) score: Vec<Interval>,
    /// Mean coverage within each of them.
    pub(super) coverage: Vec<Interval>,
    /// Budgets of the drawn line.
    pub(super) steps: Vec<u32>,
    /// Mean scaled score within each of those.
    pub(super) score_line: Vec<f64>,
    /// Mean coverage within each of those.
    pub(super) coverage_line: Vec<f64>,
}

impl Facts {
    pub(super) fn of(report: &Report) -> Self {
        let artifacts = &report.artifacts;
        let flattened = |value: fn(&Rollouts) -> &Value| -> Vec<BTreeMap<String, String>> {
            artifacts.iter().map(|artifact| flatten(value(artifact))).collect()
        };
        let mut protocols = flattened(|artifact| &artifact.protocol);
        for (facts, artifact) in protocols.iter_mut().zip(artifacts) {
            facts.insert("variant".to_owned(), artifact.variant.clone());
        }
        Self {
            labels: labels(artifacts),
            protocol: rows(&protocols),
            settings: rows(&flattened(|artifact| &artifact.settings)),
            curves: artifacts.iter().map(curve).collect(),
        }
    }

    /// Names of what the artifacts disagree on in their protocols, each group of facts once.
    pub(super) fn differences(&self) -> Vec<&str> {
        differences(&self.protocol)
    }
}

/// Names of what artifacts disagree on, each group of facts once.
pub(super) fn differences(protocol: &[Row]) -> Vec<&str> {
    let mut names: Vec<&str> = Vec::new();
    for row in protocol
        .iter()
        .filter(|row| row.differs() && row.name != WITHOUT_EFFECT)
    {
        let name = row.name.split('.').next().unwrap_or(&row.name);
        if !names.contains(&name) {
            names.push(name);
        }
    }
    names
}

/// The preset, and as much more as it takes to tell the artifacts apart.
fn labels(artifacts: &[Rollouts]) -> Vec<String> {
    type Part = fn(&Rollouts) -> String;
    let parts: [Part; 5] = [
        |artifact| artifact.variant.clone(),
        |artifact| {
            artifact
                .demonstrations
                .map_or_else(|| "other demos".to_owned(), |count| format!("{count} demos"))
        },
        |artifact| artifact.scenes.clone(),
        |artifact| format!("{} steps", artifact.max_steps),
        |artifact| artifact.key.chars().take(8).collect(),
    ];
    let presets = artifacts.iter().map(|artifact| artifact.preset.clone()).collect();
    let parts = parts.map(|part| artifacts.iter().map(part).collect());
    told_apart(presets, &parts)
}

/// Names with as many of the parts appended as it takes to tell them apart.
pub(super) fn told_apart(mut labels: Vec<String>, parts: &[Vec<String>]) -> Vec<String> {
    for words in parts {
        let doubles: Vec<bool> = labels
            .iter()
            .enumerate()
            .map(|(i, label)| (0..labels.len()).any(|j| j != i && labels[j] == *label && words[j] != words[i]))
            .collect();
        for ((label, word), double) in labels.iter_mut().zip(words).zip(doubles) {
            if double {
                label.push_str(" · ");
                label.push_str(word);
            }
        }
    }
    labels
}

/// Leaves of a JSON value by their dotted names.
pub(super) fn flatten(value: &Value) -> BTreeMap<String, String> {
    fn walk(name: &str, value: &Value, leaves: &mut BTreeMap<String, String>) {
        match value {
            Value::Object(map) => {
                for (key, inner) in map {
                    let path = if name.is_empty() {
                        key.clone()
                    } else {
                        format!("{name}.{key}")
                    };
                    walk(&path, inner, leaves);
                }
            }
            Value::String(text) => {
                leaves.insert(name.to_owned(), text.clone());
            }
            other => {
                leaves.insert(name.to_owned(), other.to_string());
            }
        }
    }
    let mut leaves = BTreeMap::new();
    walk("", value, &mut leaves);
    leaves
}

/// One row a fact: those that differ first, then those of [`FIRST`], then by name.
pub(super) fn rows(artifacts: &[BTreeMap<String, String>]) -> Vec<Row> {
    let names: BTreeSet<&String> = artifacts.iter().flat_map(BTreeMap::keys).collect();
    let mut rows: Vec<Row> = names
        .into_iter()
        .map(|name| Row {
            name: name.clone(),
            values: artifacts
                .iter()
                .map(|facts| facts.get(name).cloned().unwrap_or_default())
                .collect(),
        })
        .collect();
    let place = |row: &Row| FIRST.iter().position(|name| *name == row.name).unwrap_or(FIRST.len());
    rows.sort_by_key(|row| (!row.differs(), place(row)));
    rows
}

fn curve(artifact: &Rollouts) -> Curve {
    let marks = budgets(artifact.max_steps);
    let spacing = artifact.max_steps.div_ceil(CURVE_POINTS).max(1);
    let steps: Vec<u32> = (1..=artifact.max_steps)
        .filter(|step| step % spacing == 0 || *step == artifact.max_steps)
        .collect();
    // One column a budget, one value a rollout.
    let columns = |value: fn(&super::StepTrace) -> f64, at: &[u32]| -> Vec<Vec<f64>> {
        let mut columns = vec![Vec::with_capacity(artifact.rollouts.len()); at.len()];
        for rollout in &artifact.rollouts {
            let values: Vec<f64> = rollout.steps.iter().map(value).collect();
            for (column, most) in columns.iter_mut().zip(running_maxima(&values, at)) {
                column.push(most);
            }
        }
        columns
    };
    let intervals = |value| -> Vec<Interval> {
        let columns = columns(value, &marks);
        columns
            .iter()
            .map(|column| mean_interval(column, BOOTSTRAP_SEED))
            .collect()
    };
    let line = |value| -> Vec<f64> { columns(value, &steps).iter().map(|column| mean(column)).collect() };
    Curve {
        score: intervals(|step| step.score),
        coverage: intervals(|step| step.coverage),
        score_line: line(|step| step.score),
        coverage_line: line(|step| step.coverage),
        budgets: marks,
        steps,
    }
}
