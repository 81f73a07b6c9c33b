//! The page over sets of rollouts: scores, every rollout, and a viewer that shows for every step what was retrieved, how it was
//! moved, and why. What differs between the plane and space is a [`Scene`].

pub mod plane;
mod sections;
pub mod space;
mod summary;

use std::collections::BTreeMap;

use maud::{Markup, html};
use serde_json::{Map, Value, json};

use self::summary::Summary;
use re4_artifact::Row;
use re4_policy::kinds::Kinds;
use re4_rollout::{DecisionCore, ResultCore, StepCore};

use super::pack::{Pack, f32s};
use super::shell::{Column, Document};

/// What the page shows.
#[derive(Debug, Clone)]
pub struct Report<S: Scene> {
    /// Version of the program that makes the page.
    pub tool_version: String,
    /// Sets of rollouts, in the order in which they are shown.
    pub artifacts: Vec<Rollouts<S>>,
    /// Demonstrations that decisions refer to, by the key of their index. An index that could not be read is not in it.
    pub demonstrations: BTreeMap<String, BTreeMap<u32, Demonstration>>,
}

/// Frames of a demonstration: the numbers of each.
pub type Demonstration = Vec<Vec<f64>>;

/// One `rollouts` artifact.
#[derive(Debug, Clone)]
pub struct Rollouts<S: Scene> {
    /// Its key, 64 hexadecimal digits.
    pub key: String,
    /// Key of the index that demonstrations were retrieved from.
    pub index_key: String,
    /// Preset of the policy.
    pub preset: String,
    /// Whether single settings of the preset were changed.
    pub altered: bool,
    /// What the policy observed: state or image.
    pub variant: String,
    /// Control steps a rollout lasts at most.
    pub max_steps: u32,
    /// The protocol that the artifact states, one entry a fact.
    pub protocol: Value,
    /// Settings of the policy.
    pub settings: Value,
    /// What else it states.
    pub scene: S,
    /// The rollouts.
    pub rollouts: Vec<Rollout<S>>,
}

/// One rollout.
#[derive(Debug, Clone)]
pub struct Rollout<S: Scene> {
    /// Its row in table results.
    pub result: S::Result,
    /// Whether the viewer holds it; if not, its figures alone are on the page.
    pub shown: bool,
    /// Control steps.
    pub steps: Vec<S::Step>,
    /// Decisions.
    pub decisions: Vec<Decided<S>>,
}

/// A decision.
#[derive(Debug, Clone)]
pub struct Decided<S: Scene> {
    /// What every policy says.
    pub core: S::Decision,
    /// What RE4 says besides; nothing of other policies.
    pub detail: Option<S::Detail>,
}

impl<S: Scene> Rollout<S> {
    /// What all scenes say of it.
    pub fn core(&self) -> &ResultCore {
        S::result(&self.result)
    }
}

impl<S: Scene> Decided<S> {
    /// What all scenes say of it.
    pub fn core(&self) -> &DecisionCore {
        S::decision(&self.core)
    }
}

impl<S: Scene> Rollouts<S> {
    /// The rollouts that the viewer holds.
    pub(crate) fn shown(&self) -> impl Iterator<Item = &Rollout<S>> + Clone {
        self.rollouts.iter().filter(|rollout| rollout.shown)
    }

    /// What its name in the score table ends in.
    pub(crate) fn changed(&self) -> &'static str {
        if self.altered { " · settings changed" } else { "" }
    }

    fn data(&self, label: &str, extra: &S::Extra) -> Value {
        let shown: Vec<usize> = (0..self.rollouts.len()).filter(|&i| self.rollouts[i].shown).collect();
        let results = Pack::of(&self.rollouts)
            .list("seed", |r| r.core().seed)
            .list("success", |r| u8::from(r.core().success))
            .list("steps", |r| r.steps.len())
            .list("decisions", |r| r.decisions.len());
        let steps = Pack::of(self.shown().flat_map(|r| &r.steps))
            .u32("decision", |s| S::step(s).decision)
            .u8("phase", |s| S::step(s).phase as u8);
        let decisions = Pack::of(self.shown().flat_map(|r| &r.decisions))
            .u32("step", |d| d.core().step)
            .u32("demo", |d| d.core().demo.unwrap_or(NONE))
            .u32("demo_frame", |d| d.core().demo_frame.unwrap_or(NONE))
            .u32("demo_end", |d| d.core().demo_end.unwrap_or(NONE))
            .u8("detailed", |d| u8::from(d.detail.is_some()))
            .list("kind", |d| d.core().kind.as_deref().unwrap_or("retrieve").to_owned())
            .list("reason", |d| d.core().reason.as_str())
            .list("demo_name", |d| demo_name(d.core()));
        let pack = Pack::of([])
            .with("label", json!(label))
            .with("key", json!(self.key))
            .with("index", json!(self.index_key))
            .with("noun", json!(self.scene.noun()))
            .with("max_steps", json!(self.max_steps))
            .with("rollouts", S::pack_results(results).json())
            .with("shown", json!(shown))
            .with("starts", f32s(self.shown().flat_map(S::start)))
            .with("steps", S::pack_steps(steps, self).json())
            .with("decisions", S::pack_decisions(decisions).json());
        S::pack_more(pack, self, extra).json()
    }
}

/// What the demonstration of a decision is called; nothing where none is followed. Artifacts of older versions have numbers in the
/// index alone.
pub(crate) fn demo_name(core: &DecisionCore) -> String {
    match (core.demo, &core.demo_name) {
        (_, Some(name)) => name.clone(),
        (Some(number), None) => format!("demonstration {number}"),
        (None, None) => String::new(),
    }
}

/// A number that is not there.
const NONE: u32 = u32::MAX;

/// The words of a kind of page.
#[derive(Debug)]
pub struct Words {
    /// What follows on the names of the policies in the first sentence.
    pub of: &'static str,
    /// Title of the scores, name of their table, and its classes.
    pub scores: [&'static str; 3],
    /// How scores are to be read.
    pub note: &'static str,
    /// Columns of the score table, the policy's first.
    pub score_columns: &'static [Column<'static>],
    /// What must not be compared.
    pub comparison: &'static str,
    /// Class of the viewer's stage.
    pub stage: &'static str,
    /// Columns of the table of rollouts: name in the data, words, and whether four digits of it are shown.
    pub columns: &'static [(&'static str, &'static str, bool)],
}

/// What the page shows of rollouts and how, in the plane or in space.
pub trait Scene: Clone + std::fmt::Debug {
    /// A rollout's row.
    type Result: Row + Clone + std::fmt::Debug;
    /// A control step's row.
    type Step: Row + Clone + std::fmt::Debug;
    /// A decision's row.
    type Decision: Row + Clone + std::fmt::Debug;
    /// The row of what RE4 says of a decision.
    type Detail: Row + Clone + std::fmt::Debug;
    /// The row of a demonstration's frame in the index.
    type Frame: Row;
    /// Kinds of policies.
    type Policies: Kinds;
    /// What is worked out of an artifact once.
    type Extra;

    /// Its words.
    const WORDS: Words;
    /// Its rules of style, after those of all pages of rollouts.
    const STYLE: &'static str;
    /// Its parts of the script, which give what `script/traces.js`, `viewer.js`, `timeline.js` and `table.js` ask for.
    const SCRIPT: &'static [&'static str];

    /// What a rollout's number is called: seed or scene.
    fn noun(&self) -> &'static str;
    /// What the rollouts are of.
    fn title(artifacts: &[Rollouts<Self>]) -> String;
    /// Names that tell the artifacts apart.
    fn labels(artifacts: &[Rollouts<Self>]) -> Vec<String>;
    /// What is worked out of an artifact once.
    fn extra(artifact: &Rollouts<Self>) -> Self::Extra;
    /// What stands under an artifact's name in the score table.
    fn details(artifact: &Rollouts<Self>) -> Vec<String>;
    /// An artifact's cells in the score table.
    fn score_cells(artifact: &Rollouts<Self>) -> Markup;
    /// The section of plots over all rollouts; the script draws them.
    fn overview(labels: &[String]) -> Markup;
    /// What stands beside the scene in the viewer, under a decision's reason.
    fn evidence(report: &Report<Self>) -> Markup;
    /// Further tables: under the scores, and under the rollouts.
    fn more_tables(labels: &[String], extras: &[Self::Extra]) -> [Markup; 2] {
        let _ = (labels, extras);
        [html! {}, html! {}]
    }

    /// What all scenes say of a rollout.
    fn result(row: &Self::Result) -> &ResultCore;
    /// What all scenes say of a step.
    fn step(row: &Self::Step) -> &StepCore;
    /// What all scenes say of a decision.
    fn decision(row: &Self::Decision) -> &DecisionCore;
    /// The demonstration that a frame is of, and its numbers.
    fn frame(frame: &Self::Frame) -> (u32, Vec<f64>);
    /// Numbers of a rollout's first state.
    fn start(rollout: &Rollout<Self>) -> Vec<f64>;
    /// What the script reads of rollouts, beside what all scenes say.
    fn pack_results(pack: Pack<'_, Rollout<Self>>) -> Pack<'_, Rollout<Self>>;
    /// What it reads of control steps.
    fn pack_steps<'a>(pack: Pack<'a, Self::Step>, artifact: &'a Rollouts<Self>) -> Pack<'a, Self::Step>;
    /// What it reads of decisions.
    fn pack_decisions(pack: Pack<'_, Decided<Self>>) -> Pack<'_, Decided<Self>>;
    /// What else it reads of an artifact.
    fn pack_more<'a>(pack: Pack<'a, Self>, artifact: &Rollouts<Self>, extra: &Self::Extra) -> Pack<'a, Self>;
}

/// The script, before and after the scene's own parts.
const SCRIPT: [[&str; 3]; 2] = [
    [
        concat!(include_str!("script/selection.js"), include_str!("script/traces.js")),
        include_str!("script/timeline.js"),
        include_str!("script/viewer.js"),
    ],
    [
        include_str!("script/table.js"),
        include_str!("script/player.js"),
        include_str!("script/main.js"),
    ],
];

/// The page.
pub fn page<S: Scene>(report: &Report<S>) -> String {
    let summary = Summary::of(report);
    Document {
        tool_version: &report.tool_version,
        title: format!(
            "{} rollouts: {}",
            S::title(&report.artifacts),
            summary.labels.join(", ")
        ),
        style: &[include_str!("page.css"), S::STYLE].concat(),
        script: &[&SCRIPT[0][..], S::SCRIPT, &SCRIPT[1]].concat(),
        data: &data(report, &summary),
        body: body(&summary),
    }
    .render()
}

fn data<S: Scene>(report: &Report<S>, summary: &Summary<S>) -> Value {
    let artifacts = report.artifacts.iter().zip(&summary.labels).zip(&summary.extras);
    let demonstrations = |demos: &BTreeMap<u32, Demonstration>| {
        json!({
            "number": demos.keys().collect::<Vec<_>>(),
            "length": demos.values().map(Vec::len).collect::<Vec<_>>(),
            "frames": f32s(demos.values().flatten().flatten().copied()),
        })
    };
    let demonstrations = report
        .demonstrations
        .iter()
        .map(|(key, demos)| (key.clone(), demonstrations(demos)));
    json!({
        "artifacts": artifacts.map(|((artifact, label), extra)| artifact.data(label, extra)).collect::<Vec<_>>(),
        "demonstrations": demonstrations.collect::<Map<_, _>>(),
    })
}

fn body<S: Scene>(summary: &Summary<S>) -> Markup {
    html! {
        a.skip href="#viewer" { "Skip to the rollout viewer" }
        (sections::header(summary))
        main {
            (sections::scores(summary))
            (S::overview(&summary.labels))
            (sections::viewer(summary))
            (sections::tables(summary))
            (sections::protocol(summary))
        }
        (sections::footer(summary))
    }
}
