//! The commands that run stages. Each also runs the stages that its stage depends on.

mod spatial;

use std::fmt::Write as _;
use std::path::Path;
use std::time::Instant;

use anyhow::{Context as _, Result};
use re4_artifact::{Row as _, Stage, col_f64, col_u32};
use re4_fault::ensure;
use re4_ingest::Convention;
use re4_ingest::pusht::{PushtWriter, RecordedEpisode};
use re4_report::{Findings, divergence_plot};
use re4_rollout::PlaneResultRow;
use serde_json::{Value, json};

use super::audit::LEAVE_OUT;
use super::{Outcome, report};
use crate::arguments::{ReplayArguments, RolloutArguments, StageArguments, TrainArguments, kind_override};
use crate::console::Console;
use crate::output::Output;
use re4_stages::PoseSource;
use re4_stages::{BudgetRow, Built, Runner, metrics, read_rollouts};

/// `re4-pipe ingest`.
pub(crate) fn ingest(arguments: &StageArguments) -> Result<Outcome> {
    let console = Console::new(&arguments.common);
    let runner = arguments.runner_of(Stage::Ingest, &[])?;
    let built = runner.ingest()?;
    answer(console, &runner, &built)
}

/// `re4-pipe segment`.
pub(crate) fn segment(arguments: &StageArguments) -> Result<Outcome> {
    let console = Console::new(&arguments.common);
    let runner = arguments.runner_of(Stage::Segment, &[])?;
    let episodes = runner.ingest()?;
    let modes = runner.segment(&episodes)?;
    let audit = runner.audit(&episodes, &modes)?;
    let findings = Findings::read(&audit.artifact)?;
    let mut both = modes.to_json();
    both["audit"] = audit.to_json();
    both["warnings"] = json!(runner.warnings());
    console.answer(&both)?;
    let text = format!(
        "{}\naudit: {}; see re4-pipe audit",
        described(&modes)?,
        findings.headline()
    );
    console.say(&text)?;
    Ok(Outcome::Done)
}

/// `re4-pipe observe`. As `audit`, it leaves out unusable demonstrations.
pub(crate) fn observe(arguments: &StageArguments) -> Result<Outcome> {
    let console = Console::new(&arguments.common);
    let runner = arguments.runner_of(Stage::Observe, &[LEAVE_OUT.to_owned()])?;
    let built = runner.artifact_of(Stage::Observe)?;
    answer(console, &runner, &built)
}

/// `re4-pipe train-encoder`. Refuses pipelines without an encoder.
pub(crate) fn train_encoder(arguments: &StageArguments) -> Result<Outcome> {
    let console = Console::new(&arguments.common);
    let runner = arguments.runner_of(Stage::TrainEncoder, &[])?;
    runner.pipeline.needs_object()?;
    ensure!(
        runner.pipeline.pose()?.source == PoseSource::Encoder,
        "nothing to train: the poses of {} do not come from an encoder", arguments.pipeline.display();
        "give a pipeline of a robosuite task with variant = \"image\" and pose.source = \"encoder\""
    );
    let built = runner.artifact_of(Stage::TrainEncoder)?;
    answer(console, &runner, &built)
}

/// `re4-pipe train-pose`. Refuses pipelines that use the recorded poses.
pub(crate) fn train_pose(arguments: &StageArguments) -> Result<Outcome> {
    let console = Console::new(&arguments.common);
    let runner = arguments.runner_of(Stage::TrainPose, &[])?;
    runner.pipeline.needs_object()?;
    let planar = runner.pipeline.task.is_planar();
    ensure!(
        runner.pipeline.pose()?.source != PoseSource::Recorded,
        "nothing to train: {} uses the recorded poses, because pose.source is \"recorded\"",
        arguments.pipeline.display();
        "to estimate poses from images, set variant = \"image\" and pose.source = \"{}\"",
        if planar { "log_polar" } else { "encoder" }
    );
    if planar {
        let built = runner.artifact_of(Stage::TrainPose)?;
        return answer(console, &runner, &built);
    }
    let episodes = runner.ingest()?;
    let modes = runner.segment(&episodes)?;
    let encoder = runner.train_encoder(&episodes, &modes)?.context("no encoder")?;
    let poses = runner.estimate_poses(&episodes, &modes, Some(&encoder))?;
    let poses = poses.context("no pose estimator")?;
    let mut both = poses.to_json();
    both["encoder"] = encoder.to_json();
    both["warnings"] = json!(runner.warnings());
    console.answer(&both)?;
    console.say(&format!("{}\n{}", described(&encoder)?, described(&poses)?))?;
    Ok(Outcome::Done)
}

/// `re4-pipe index`.
pub(crate) fn index(arguments: &StageArguments) -> Result<Outcome> {
    let console = Console::new(&arguments.common);
    let runner = arguments.runner_of(Stage::Index, &[])?;
    runner.pipeline.needs_object()?;
    let built = runner.artifact_of(Stage::Index)?;
    answer(console, &runner, &built)
}

/// `re4-pipe train`. Refuses pipelines whose policy needs no training.
pub(crate) fn train(arguments: &TrainArguments) -> Result<Outcome> {
    let console = Console::new(&arguments.stage.common);
    let kind = arguments.policy.as_deref().map(kind_override);
    let runner = arguments.stage.runner_of(Stage::Train, kind.as_slice())?;
    runner.pipeline.needs_object()?;
    let built = runner.train()?;
    answer(console, &runner, &built)
}

/// `re4-pipe scenes`.
pub(crate) fn scenes(arguments: &StageArguments) -> Result<Outcome> {
    let console = Console::new(&arguments.common);
    let runner = arguments.runner_of(Stage::Scenes, &[])?;
    runner.pipeline.needs_object()?;
    ensure!(
        runner.pipeline.task.is_planar(),
        "no scenes to choose: the stage scenes applies only to Push-T";
        "rollouts of robosuite tasks start from rollout.seeds"
    );
    ensure!(
        runner.pipeline.scenes.is_some(),
        "no scenes to choose: {} has no table [scenes], so its rollouts start from the scenes of seeds",
        arguments.pipeline.display();
        "add one with kind = \"sparse_observations\", and leave rollout.seeds out"
    );
    let built = runner.scenes(&runner.ingest()?)?.context("no table [scenes]")?;
    answer(console, &runner, &built)
}

/// `re4-pipe rollout`.
pub(crate) fn rollout(arguments: &RolloutArguments) -> Result<Outcome> {
    let runner = arguments.rolled.runner_of(Stage::Rollout, &arguments.stage)?;
    runner.pipeline.rollout()?;
    roll_out(&runner, arguments)
}

/// `re4-pipe run`: runs the stages up to `rollout`, or up to `audit` if the pipeline has no table `[rollout]`.
pub(crate) fn run(arguments: &RolloutArguments) -> Result<Outcome> {
    let console = Console::new(&arguments.stage.common);
    let runner = runner(arguments)?;
    if runner.pipeline.rollout.is_some() {
        return roll_out(&runner, arguments);
    }
    ensure!(
        arguments.report.is_none() && arguments.record.is_none(),
        "no rollouts to report or record: {} has no table [rollout]", arguments.stage.pipeline.display();
        "remove --report and --record"
    );
    let episodes = runner.ingest()?;
    let modes = runner.segment(&episodes)?;
    let built = runner.audit(&episodes, &modes)?;
    answer(console, &runner, &built)
}

fn runner(arguments: &RolloutArguments) -> Result<Runner> {
    arguments.rolled.runner(&arguments.stage)
}

/// The page that `--report` asks for.
struct Page<'a> {
    path: &'a Path,
    output: Output,
}

impl<'a> Page<'a> {
    /// Checks the path of the page before any stage runs.
    fn at(runner: &Runner, arguments: &'a RolloutArguments) -> Result<Option<Self>> {
        let Some(path) = arguments.report.as_deref() else {
            return Ok(None);
        };
        let output = Output::at(path, "report")?;
        output.refuse_inputs(&runner.inputs()?)?;
        Ok(Some(Self { path, output }))
    }

    fn write(&self, console: Console, arguments: &RolloutArguments, built: &Built) -> Result<()> {
        let store = &arguments.stage.common.artifacts;
        let written = report::write(
            &[built.artifact.path().to_path_buf()],
            report::Shown::default(),
            &self.output,
            store,
        )?;
        written.say_warnings(console);
        let path = self.path.display();
        let headline = written.headline();
        console.note(&format!("{:>10}  {path}  {headline}", "report"));
        Ok(())
    }
}

fn roll_out(runner: &Runner, arguments: &RolloutArguments) -> Result<Outcome> {
    if !runner.pipeline.task.is_planar() {
        return spatial::roll_out(runner, arguments);
    }
    let console = Console::new(&arguments.stage.common);
    let start = Instant::now();
    if let Some(path) = &arguments.record {
        ensure!(
            !path.exists(),
            "cannot record to {}: that path exists", path.display();
            "give a path that does not exist yet"
        );
        let parent = path.parent().filter(|parent| !parent.as_os_str().is_empty());
        ensure!(
            parent.is_none_or(Path::is_dir),
            "cannot record to {}: its parent folder does not exist", path.display();
            "create it, or give another path"
        );
    }
    let page = Page::at(runner, arguments)?;
    let (built, scenes) = runner.roll_out()?;
    if let Some(path) = &arguments.record {
        record(console, &built, path)?;
    }
    if let Some(page) = &page {
        page.write(console, arguments, &built)?;
    }
    let metrics = metrics(&built.artifact);
    let section = runner.pipeline.rollout()?;
    let kind = runner.pipeline.policy()?.kind();
    let rollouts = built.artifact.table(PlaneResultRow::table())?.rows();
    // The scores over step budgets are the result of the experiments with `[scenes]`. For others, the artifact's table is enough.
    let budgets = scenes.is_some().then(|| budgets(&built)).transpose()?;
    let mut answer = json!({
        "task": runner.pipeline.task,
        "variant": runner.pipeline.variant,
        "policy": kind,
        "episodes": rollouts,
        "max_steps": section.max_steps,
        "metrics": in_order(&metrics),
        "artifact": built.artifact.path(),
        "warnings": runner.warnings(),
        "wall_s": start.elapsed().as_secs_f64(),
    });
    if let Some(budgets) = &budgets {
        answer["budgets"] = json!(budgets);
    }
    console.answer(&answer)?;
    let mut text = score_table(kind, rollouts, section.max_steps, &metrics)?;
    if let Some(budgets) = &budgets {
        text += &budget_table(budgets)?;
    }
    console.say(&text)?;
    Ok(Outcome::Done)
}

/// `re4-pipe replay`.
pub(crate) fn replay(arguments: &ReplayArguments) -> Result<Outcome> {
    let console = Console::new(&arguments.stage.common);
    let runner = arguments.stage.runner(&[])?;
    runner.pipeline.needs_object()?;
    if !runner.pipeline.task.is_planar() {
        return spatial::replay(&runner, arguments);
    }
    ensure!(
        arguments.minimum.is_none(),
        "--fail-under applies only to robosuite tasks";
        "remove it, because the demonstrations of Push-T end before success"
    );
    let built = runner.replay(&runner.ingest()?)?;
    if let Some(path) = &arguments.plot {
        let table = built
            .artifact
            .table(re4_stages::PlanarDivergenceRow::table())?
            .read_columns(&["frame", "block"])?;
        let frames = col_u32(&table, "frame")?;
        let svg = divergence_plot(frames, col_f64(&table, "block")?)
            .with_context(|| format!("cannot plot {}", path.display()))?;
        console.image(path, &svg)?;
    }
    answer(console, &runner, &built)
}

fn record(console: Console, built: &Built, path: &Path) -> Result<()> {
    let episodes: Vec<RecordedEpisode> = read_rollouts(&built.artifact)?
        .into_iter()
        .map(|frames| RecordedEpisode { frames })
        .collect();
    PushtWriter::write(path, &episodes)?;
    console.note(&format!(
        "{:>10}  {}  {} episodes",
        "record",
        path.display(),
        episodes.len()
    ));
    Ok(())
}

pub(super) fn answer(console: Console, runner: &Runner, built: &Built) -> Result<Outcome> {
    let mut answer = built.to_json();
    answer["warnings"] = json!(runner.warnings());
    console.answer(&answer)?;
    console.say(&described(built)?)?;
    Ok(Outcome::Done)
}

/// The path of an artifact, the sizes of its tables, the conventions of the dataset and the error of converted actions.
fn described(built: &Built) -> Result<String> {
    let manifest = built.artifact.manifest();
    let mut text = format!("{} artifact in {}", manifest.artifact, built.artifact.path().display());
    for (name, table) in &manifest.tables {
        write!(text, "\n  {name:<12} {:>9} rows  {:>11} bytes", table.rows, table.bytes)?;
    }
    text += &conventions(built)?;
    if let Some(errors) = manifest.summary.get("goal_error") {
        text += &goal_error(errors)?;
    }
    Ok(text)
}

/// The conventions of a dataset, each with its evidence.
fn conventions(built: &Built) -> Result<String> {
    let mut text = String::new();
    if !built.artifact.has::<Convention>() {
        return Ok(text);
    }
    for row in built.artifact.read::<Convention>()? {
        write!(
            text,
            "\n  {:<18} {:<18} {}: {}",
            &*row.convention, &*row.value, row.basis, row.evidence
        )?;
        if let Some(residual) = row.residual {
            write!(text, ", {residual:.2e} {}", row.unit)?;
        }
        if let Some(rival) = row.runner_up {
            write!(text, " (next best {rival:.2e})")?;
        }
    }
    Ok(text)
}

/// The error of converted actions, compared with recorded ones.
fn goal_error(errors: &Value) -> Result<String> {
    let part = |name: &str, factor: f64| -> Vec<String> {
        let values = errors[name].as_array().into_iter().flatten().filter_map(Value::as_f64);
        values.map(|value| format!("{:.1e}", value * factor)).collect()
    };
    let mut text = String::new();
    write!(
        text,
        "\n  error of goals converted from deltas, against recorded goals, over {} steps (first steps excluded); median, 90 %, 99 %, maximum: {} mm, {} deg",
        errors["steps"],
        part("position_m", 1e3).join(" "),
        part("rotation_rad", 1.0_f64.to_degrees()).join(" "),
    )?;
    Ok(text)
}

/// The metrics in the order of [`METRICS`], each with its value before its bounds. The manifest sorts keys alphabetically.
fn in_order(metrics: &Value) -> Value {
    let ordered = |metric: &Value| json!({ "value": metric["value"], "low": metric["low"], "high": metric["high"] });
    Value::Object(
        METRICS
            .iter()
            .map(|(_, name)| ((*name).to_owned(), ordered(&metrics[*name])))
            .collect(),
    )
}

const METRICS: [(&str, &str); 4] = [
    ("scaled score", "score_scaled_mean"),
    ("raw coverage", "coverage_raw_mean"),
    ("IoU", "iou_mean"),
    ("success rate", "success_rate"),
];

/// The metrics for each step budget, in the form of the JSON result.
fn budgets(built: &Built) -> Result<Vec<Value>> {
    let rows: Vec<BudgetRow> = built.artifact.read()?;
    let object = |row: BudgetRow| {
        let mut object = json!({ "budget": row.budget });
        let means = [row.score, row.coverage, row.iou].map(|m| [m.mean, m.low, m.high]);
        let success = [row.success.rate, row.success.low, row.success.high];
        for ((_, name), parts) in METRICS.iter().zip(means.into_iter().chain([success])) {
            for (part, value) in ["value", "low", "high"].into_iter().zip(parts) {
                object[*name][part] = json!(value);
            }
        }
        object
    };
    Ok(rows.into_iter().map(object).collect())
}

fn budget_table(budgets: &[Value]) -> Result<String> {
    let labels = METRICS.map(|(label, _)| format!("{label:<20}"));
    let mut text = format!("\n  steps   {}", labels.join("   ").trim_end());
    for row in budgets {
        write!(text, "\n  {:>5}", row["budget"].as_u64().unwrap_or_default())?;
        for (_, name) in METRICS {
            let [value, low, high] = ["value", "low", "high"].map(|key| row[name][key].as_f64().unwrap_or(f64::NAN));
            write!(text, "   {value:.3} [{low:.3}, {high:.3}]")?;
        }
    }
    Ok(text)
}

fn score_table(policy: &str, rollouts: u64, max_steps: u32, metrics: &Value) -> Result<String> {
    let mut text = format!("policy {policy}, {rollouts} rollouts of at most {max_steps} steps; mean, 95 % interval");
    for (label, name) in METRICS {
        let number = |key| {
            metrics
                .get(name)
                .and_then(|m| m.get(key))
                .and_then(Value::as_f64)
                .unwrap_or(f64::NAN)
        };
        let [value, low, high] = ["value", "low", "high"].map(number);
        write!(text, "\n  {label:<13} {value:.3}   [{low:.3}, {high:.3}]")?;
    }
    Ok(text)
}
