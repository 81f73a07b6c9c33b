//! The page of sets of rollouts: scores, plots of all rollouts, and a viewer that shows for every step which demonstration was
//! retrieved, how it was reframed, and why. The differences between Push-T and robosuite's tasks are in the trait [`Scene`].

pub mod plane;
mod sections;
pub mod space;
mod summary;
mod world;

use std::collections::BTreeMap;

use maud::{Markup, html};
use serde_json::{Map, Value, json};

use self::summary::Summary;
pub use self::world::World;
use self::world::conditions;
use re4_artifact::Row;
use re4_policy::kinds::Kinds;
use re4_rollout::{DecisionCore, ResultCore, StepCore};

use super::pack::{Pack, f32s};
use super::shell::{Column, Document};

/// The content of the page.
#[derive(Debug, Clone)]
pub struct Report<S: Scene> {
    /// Version of the program that makes the page.
    pub tool_version: String,
    /// Sets of rollouts, in the order in which they are shown.
    pub artifacts: Vec<Rollouts<S>>,
    /// Demonstrations that decisions refer to, by the key of their index and by their number. An index that was not found has no
    /// entry.
    pub demonstrations: BTreeMap<String, BTreeMap<u32, Demonstration>>,
}

/// Frames of a demonstration. [`Scene::frame`] defines the numbers of a frame.
pub type Demonstration = Vec<Vec<f64>>;

/// One `rollouts` artifact.
#[derive(Debug, Clone)]
pub struct Rollouts<S: Scene> {
    /// Key of the artifact, 64 hexadecimal digits.
    pub key: String,
    /// Key of the index from which demonstrations were retrieved.
    pub index_key: String,
    /// Preset of the policy.
    pub preset: String,
    /// Whether any setting differs from the preset.
    pub altered: bool,
    /// What the policy observed: state or image.
    pub variant: String,
    /// Maximum number of control steps of a rollout.
    pub max_steps: u32,
    /// The protocol, as the artifact's manifest states it.
    pub protocol: Value,
    /// Settings of the policy.
    pub settings: Value,
    /// Data that depends on the kind of scene.
    pub scene: S,
    /// The rollouts.
    pub rollouts: Vec<Rollout<S>>,
}

/// One rollout.
#[derive(Debug, Clone)]
pub struct Rollout<S: Scene> {
    /// Its row in table `results`.
    pub result: S::Result,
    /// Whether the viewer contains it. If not, the page has only its results.
    pub shown: bool,
    /// Control steps.
    pub steps: Vec<S::Step>,
    /// Decisions.
    pub decisions: Vec<Decided<S>>,
    /// Goal and disturbance; `None` if the rollouts have those of the task.
    pub world: Option<S::World>,
}

/// A decision.
#[derive(Debug, Clone)]
pub struct Decided<S: Scene> {
    /// The data that every policy records.
    pub core: S::Decision,
    /// The data that only RE4 records; `None` for other policies.
    pub detail: Option<S::Detail>,
}

impl<S: Scene> Rollout<S> {
    /// Returns the part of the result that all scenes have.
    pub fn core(&self) -> &ResultCore {
        S::result(&self.result)
    }

    /// Returns the number of control steps taken before the disturbance, and the disturbance in words.
    pub fn disturbance(&self) -> Option<(u32, String)> {
        self.world.as_ref()?.disturbance()
    }
}

impl<S: Scene> Decided<S> {
    /// Returns the part of the decision that all scenes have.
    pub fn core(&self) -> &DecisionCore {
        S::decision(&self.core)
    }
}

impl<S: Scene> Rollouts<S> {
    /// Iterates over the rollouts in the viewer.
    pub(crate) fn shown(&self) -> impl Iterator<Item = &Rollout<S>> + Clone {
        self.rollouts.iter().filter(|rollout| rollout.shown)
    }

    /// Returns the suffix that marks a changed preset in the score table; empty if the preset is unchanged.
    pub(crate) fn changed(&self) -> &'static str {
        if self.altered { " · settings changed" } else { "" }
    }

    /// Returns the conditions that are not those of the task, in words.
    pub(crate) fn conditions(&self) -> Vec<String> {
        conditions(&self.protocol)
    }

    fn data(&self, label: &str, extra: &S::Extra) -> Value {
        let shown: Vec<usize> = (0..self.rollouts.len()).filter(|&i| self.rollouts[i].shown).collect();
        let results = Pack::of(&self.rollouts)
            .list("seed", |r| r.core().seed)
            .list("success", |r| u8::from(r.core().success))
            .list("steps", |r| r.steps.len())
            .list("decisions", |r| r.decisions.len())
            .where_any(
                |r| r.disturbance().is_some(),
                |pack| pack.list("disturbance", Rollout::disturbance),
            );
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

/// Returns the name of the demonstration that a decision follows; empty if it follows none. Artifacts of older versions have only
/// the number of the demonstration in the index.
pub(crate) fn demo_name(core: &DecisionCore) -> String {
    match (core.demo, &core.demo_name) {
        (_, Some(name)) => name.clone(),
        (Some(number), None) => format!("demonstration {number}"),
        (None, None) => String::new(),
    }
}

/// Marks a missing number in a packed column of integers.
const NONE: u32 = u32::MAX;

/// The texts of a kind of page.
#[derive(Debug)]
pub struct Words {
    /// Text after the names of the policies in the first sentence.
    pub of: &'static str,
    /// Title of the section of scores, name of its table, and the table's CSS classes.
    pub scores: [&'static str; 3],
    /// Explains how scores are computed.
    pub note: &'static str,
    /// Columns of the score table, starting with the policy.
    pub score_columns: &'static [Column<'static>],
    /// States which results are not comparable.
    pub comparison: &'static str,
    /// CSS class of the viewer's stage.
    pub stage: &'static str,
    /// Columns of the table of rollouts: name in the data, heading, and whether four decimals are shown.
    pub columns: &'static [(&'static str, &'static str, bool)],
}

/// The parts of the page that differ between Push-T and robosuite's tasks.
pub trait Scene: Clone + std::fmt::Debug {
    /// Row of a rollout.
    type Result: Row + Clone + std::fmt::Debug;
    /// Row of a control step.
    type Step: Row + Clone + std::fmt::Debug;
    /// Row of a decision.
    type Decision: Row + Clone + std::fmt::Debug;
    /// Row of the data of a decision that only RE4 records.
    type Detail: Row + Clone + std::fmt::Debug;
    /// Row of a rollout's goal and disturbance.
    type World: World + Row + Clone + std::fmt::Debug;
    /// Row of a demonstration's frame in the index.
    type Frame: Row;
    /// Kinds of policies.
    type Policies: Kinds;
    /// Data that is computed once per artifact.
    type Extra;

    /// Texts of the page.
    const WORDS: Words;
    /// CSS rules, which follow those of all pages of rollouts.
    const STYLE: &'static str;
    /// Script parts. They define what `script/traces.js`, `viewer.js`, `timeline.js` and `table.js` require.
    const SCRIPT: &'static [&'static str];

    /// Returns the name of a rollout's number: seed or scene.
    fn noun(&self) -> &'static str;
    /// Returns the title of the page.
    fn title(artifacts: &[Rollouts<Self>]) -> String;
    /// Returns labels that distinguish the artifacts.
    fn labels(artifacts: &[Rollouts<Self>]) -> Vec<String>;
    /// Computes the data that is needed once per artifact.
    fn extra(artifact: &Rollouts<Self>) -> Self::Extra;
    /// Returns the lines under an artifact's name in the score table.
    fn details(artifact: &Rollouts<Self>) -> Vec<String>;
    /// Renders an artifact's cells in the score table.
    fn score_cells(artifact: &Rollouts<Self>) -> Markup;
    /// Renders the section with the plots of all rollouts; the script renders the plots.
    fn overview(labels: &[String]) -> Markup;
    /// Renders the part of the viewer below a decision's reason.
    fn evidence(report: &Report<Self>) -> Markup;
    /// Renders further tables: one below the scores, one below the table of rollouts.
    fn more_tables(labels: &[String], extras: &[Self::Extra]) -> [Markup; 2] {
        let _ = (labels, extras);
        [html! {}, html! {}]
    }

    /// Returns the part of a result that all scenes have.
    fn result(row: &Self::Result) -> &ResultCore;
    /// Returns the part of a step that all scenes have.
    fn step(row: &Self::Step) -> &StepCore;
    /// Returns the part of a decision that all scenes have.
    fn decision(row: &Self::Decision) -> &DecisionCore;
    /// Returns the number of the demonstration of a frame, the number of the frame, and the frame's numbers.
    fn frame(frame: &Self::Frame) -> (u32, u32, Vec<f64>);
    /// Returns the numbers of a rollout's first state.
    fn start(rollout: &Rollout<Self>) -> Vec<f64>;
    /// Adds the columns of rollouts that only this scene has.
    fn pack_results(pack: Pack<'_, Rollout<Self>>) -> Pack<'_, Rollout<Self>>;
    /// Adds the columns of control steps that only this scene has.
    fn pack_steps<'a>(pack: Pack<'a, Self::Step>, artifact: &'a Rollouts<Self>) -> Pack<'a, Self::Step>;
    /// Adds the columns of decisions that only this scene has.
    fn pack_decisions(pack: Pack<'_, Decided<Self>>) -> Pack<'_, Decided<Self>>;
    /// Adds the data of an artifact that only this scene has.
    fn pack_more<'a>(pack: Pack<'a, Self>, artifact: &Rollouts<Self>, extra: &Self::Extra) -> Pack<'a, Self>;
}

/// The script parts of all pages of rollouts, which go before and after the scene's own parts.
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

/// Renders the page.
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
