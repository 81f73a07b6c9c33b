//! `re4-pipe curate`: chooses demonstrations, judges the choice and writes it in three forms.

use std::fmt::Write as _;
use std::path::Path;
use std::time::Instant;

use anyhow::Result;
use re4_fault::ensure;
use re4_influence::{JudgedRow, RoundRow};
use re4_ingest::robomimic::copy_with_filter;
use re4_stages::{Curated, Curation, Runner};
use serde_json::json;

use super::Outcome;
use crate::arguments::CurateArguments;
use crate::console::Console;
use crate::output::Output;

/// `re4-pipe curate`.
pub(crate) fn curate(arguments: &CurateArguments) -> Result<Outcome> {
    let start = Instant::now();
    let console = Console::new(&arguments.stage.common);
    let runner = arguments.rolled.runner(&arguments.stage)?.of_many_pipelines();
    runner.pipeline.needs_object()?;
    let planar = runner.pipeline.task.is_planar();
    ensure!(
        !(planar && arguments.mask.is_some()),
        "a filter key can only be written to an HDF5 file, and Push-T's store is none";
        "use --keep-list or --setting"
    );
    let outputs = [
        (arguments.keep_list.as_deref(), "keep-list"),
        (arguments.setting.as_deref(), "setting"),
        (arguments.html.as_deref(), "page"),
    ];
    let outputs = outputs.map(|(path, what)| path.map(|path| Output::at(path, what)).transpose());
    let [list, setting, page] = outputs;
    let (list, setting, page) = (list?, setting?, page?);
    let inputs = runner.inputs()?;
    for output in [&list, &setting, &page].into_iter().flatten() {
        output.refuse_inputs(&inputs)?;
    }
    if let Some(mask) = &arguments.mask {
        ensure!(
            !mask.exists(),
            "cannot write the filter key to {}: that path exists", mask.display();
            "give a path that does not exist yet"
        );
    }
    let curated = runner.curate(&Curation {
        by: arguments.by.by(),
        aim: arguments.aim.aim(),
        starts: arguments.starts,
        judge: arguments.judge.clone(),
        random: arguments.random,
        curve: arguments.curve,
    })?;
    let kept = curated.kept();
    if let Some(output) = &list {
        output.write(&(kept.join("\n") + "\n"))?;
    }
    if let Some(output) = &setting {
        output.write(&toml(&curated, &kept))?;
    }
    if let Some(mask) = &arguments.mask {
        write_mask(&runner, mask, &arguments.filter_key, &kept)?;
    }
    if let Some(output) = &page {
        output.write(&re4_report::curation_page(&curated.built.artifact)?)?;
    }
    let mut answer = curated.built.to_json();
    answer["warnings"] = json!(runner.warnings());
    answer["kept"] = json!(kept);
    answer["judged"] = curated.judged.iter().map(judged_json).collect();
    answer["wall_s"] = json!(start.elapsed().as_secs_f64());
    console.answer(&answer)?;
    console.say(&text(&curated)?)?;
    Ok(Outcome::Done)
}

/// The tables of a pipeline file that select the kept demonstrations.
fn toml(curated: &Curated, kept: &[String]) -> String {
    let names: Vec<String> = kept.iter().map(|name| format!("{name:?}")).collect();
    format!(
        "# {} of {} demonstrations, chosen by re4-pipe curate. Replaces ingest.select in the pipeline file.\n\
         [ingest]\nselect = {{ episodes = [{}] }}\n",
        kept.len(),
        curated.rows.len(),
        names.join(", ")
    )
}

fn write_mask(runner: &Runner, copy: &Path, key: &str, kept: &[String]) -> Result<()> {
    let source = runner.one_file("--mask")?;
    Ok(copy_with_filter(&source, copy, key, kept)?)
}

fn judged_json(row: &JudgedRow) -> serde_json::Value {
    json!({
        "set": &*row.set,
        "demonstrations": row.demos,
        "measure": &*row.measure,
        "rollouts": row.rollouts,
        "value": row.value,
        "low": row.low,
        "high": row.high,
        "median_steps": row.median_steps,
        "difference": row.difference,
        "difference_low": row.difference_low,
        "difference_high": row.difference_high,
        "p": row.p,
    })
}

fn text(curated: &Curated) -> Result<String> {
    let kept = curated.rows.iter().filter(|row| row.kept).count();
    let mut text = format!("kept {kept} of {} demonstrations", curated.rows.len());
    write!(text, "\n  round  kept  success    score    steps     cost")?;
    for row in &curated.rounds {
        let RoundRow { round, kept, .. } = row;
        let mark = match (&*row.series, row.taken) {
            ("tried", true) => "taken",
            ("tried", false) => "",
            (series, _) => series,
        };
        write!(
            text,
            "\n  {round:>5} {kept:>5} {:>8.3} {:>8.3} {:>8.1} {:>8.4}  {mark}",
            row.success, row.score, row.steps, row.cost
        )?;
        if let Some(name) = &row.predicted_by {
            write!(text, "  predicted by {name}")?;
        }
    }
    for row in &curated.judged {
        write!(
            text,
            "\n  {:<10} {:>4} demonstrations  {:<8} {:.3} [{:.3}, {:.3}]",
            &*row.set, row.demos, &*row.measure, row.value, row.low, row.high
        )?;
        if &*row.set != "curated" {
            write!(
                text,
                "  curated {:+.3} [{:+.3}, {:+.3}], p {:.4}",
                row.difference, row.difference_low, row.difference_high, row.p
            )?;
        }
        if let Some(steps) = row.median_steps.filter(|_| &*row.measure == "steps") {
            write!(text, "  median of successes {steps}")?;
        }
    }
    Ok(text)
}

/// The names of `--by` and `--aim` are those in the artifact.
#[cfg(test)]
mod tests {
    use clap::ValueEnum as _;
    use re4_artifact::Word as _;

    use crate::arguments::{AimArgument, ByArgument};

    #[test]
    fn names_are_those_in_the_artifact() {
        for by in ByArgument::value_variants() {
            assert_eq!(by.to_possible_value().unwrap().get_name(), by.by().word());
        }
        for aim in AimArgument::value_variants() {
            assert_eq!(aim.to_possible_value().unwrap().get_name(), aim.aim().word());
        }
    }
}
