//! Comparison of several artifacts: labels that distinguish them, and the differences between their protocols.

use std::collections::{BTreeMap, BTreeSet};

use maud::Markup;
use serde_json::Value;

use super::{Report, Rollouts, Scene};

/// Entries of the protocol that are listed first, because sets of rollouts most often differ in them.
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

/// An entry of the protocol that has no effect on rollouts: whether the demonstrations have images in addition to states.
const WITHOUT_EFFECT: &str = "demonstrations.images";

/// The comparison of the artifacts of a report.
pub(super) struct Summary<'a, S: Scene> {
    /// The artifacts.
    pub(super) report: &'a Report<S>,
    /// Label of each artifact on the page.
    pub(super) labels: Vec<String>,
    /// Rows of the protocol table.
    pub(super) protocol: Vec<Row>,
    /// Rows of the table of settings.
    pub(super) settings: Vec<Row>,
    /// Data that is computed once per artifact.
    pub(super) extras: Vec<S::Extra>,
    /// Tables that only this scene has.
    pub(super) tables: [Markup; 2],
}

/// One entry of the protocol or the settings, with its value for each artifact.
pub(super) struct Row {
    /// Dotted name of the entry.
    pub(super) name: String,
    /// Its value for each artifact; empty if the artifact does not state it.
    pub(super) values: Vec<String>,
}

impl Row {
    /// Whether the artifacts have different values.
    pub(super) fn differs(&self) -> bool {
        self.values.iter().any(|value| Some(value) != self.values.first())
    }
}

impl<'a, S: Scene> Summary<'a, S> {
    pub(super) fn of(report: &'a Report<S>) -> Self {
        let artifacts = &report.artifacts;
        let flattened = |value: fn(&Rollouts<S>) -> &Value| -> Vec<BTreeMap<String, String>> {
            artifacts.iter().map(|artifact| flatten(value(artifact))).collect()
        };
        let mut protocols = flattened(|artifact| &artifact.protocol);
        for (protocol, artifact) in protocols.iter_mut().zip(artifacts) {
            protocol.insert("variant".to_owned(), artifact.variant.clone());
        }
        let labels = S::labels(artifacts);
        let extras: Vec<S::Extra> = artifacts.iter().map(S::extra).collect();
        Self {
            report,
            tables: S::more_tables(&labels, &extras),
            labels,
            protocol: rows(&protocols),
            settings: rows(&flattened(|artifact| &artifact.settings)),
            extras,
        }
    }

    /// Returns the names of the protocol entries that differ between the artifacts. Entries of the same group are named once, by
    /// the group.
    pub(super) fn differences(&self) -> Vec<&str> {
        let mut names: Vec<&str> = Vec::new();
        for row in self
            .protocol
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
}

/// A part of an artifact's label.
pub(super) type Part<'a, S> = &'a dyn Fn(&Rollouts<S>) -> String;

/// Returns labels that distinguish artifacts. Each starts with `name`. To equal labels, the parts that differ are appended, in
/// order: first `parts`, then the maximum number of steps, then the beginning of the key.
pub(super) fn distinct_labels<S: Scene>(
    artifacts: &[Rollouts<S>],
    name: impl Fn(&Rollouts<S>) -> String,
    parts: &[Part<'_, S>],
) -> Vec<String> {
    let mut labels: Vec<String> = artifacts.iter().map(name).collect();
    let steps = |artifact: &Rollouts<S>| format!("{} steps", artifact.max_steps);
    let key = |artifact: &Rollouts<S>| artifact.key.chars().take(8).collect();
    for part in parts
        .iter()
        .copied()
        .chain([&steps as &dyn Fn(&Rollouts<S>) -> String, &key])
    {
        let words: Vec<String> = artifacts.iter().map(part).collect();
        let doubles: Vec<bool> = labels
            .iter()
            .enumerate()
            .map(|(i, label)| (0..labels.len()).any(|j| j != i && labels[j] == *label && words[j] != words[i]))
            .collect();
        for ((label, word), double) in labels.iter_mut().zip(&words).zip(doubles) {
            if double {
                label.push_str(" · ");
                label.push_str(word);
            }
        }
    }
    labels
}

/// Returns the leaves of a JSON value by their dotted names.
fn flatten(value: &Value) -> BTreeMap<String, String> {
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

/// Returns one row per entry: first those that differ, then those of [`FIRST`], then the others by name.
fn rows(artifacts: &[BTreeMap<String, String>]) -> Vec<Row> {
    let names: BTreeSet<&String> = artifacts.iter().flat_map(BTreeMap::keys).collect();
    let mut rows: Vec<Row> = names
        .into_iter()
        .map(|name| Row {
            name: name.clone(),
            values: artifacts
                .iter()
                .map(|entries| entries.get(name).cloned().unwrap_or_default())
                .collect(),
        })
        .collect();
    let place = |row: &Row| FIRST.iter().position(|name| *name == row.name).unwrap_or(FIRST.len());
    rows.sort_by_key(|row| (!row.differs(), place(row)));
    rows
}
