//! `re4-pipe influence`: the exact effect of leaving out each demonstration.

use std::fmt::Write as _;
use std::time::Instant;

use anyhow::Result;
use re4_artifact::Stage;
use re4_fault::ensure;
use re4_influence::InfluenceRow;
use re4_stages::Judge;
use serde_json::json;

use super::Outcome;
use crate::arguments::InfluenceArguments;
use crate::console::Console;
use crate::output::Output;

/// Number of demonstrations of each kind that are printed; the artifact and the page have all.
const PRINTED: usize = 10;

/// `re4-pipe influence`.
pub(crate) fn influence(arguments: &InfluenceArguments) -> Result<Outcome> {
    let start = Instant::now();
    let console = Console::new(&arguments.stage.common);
    ensure!(
        arguments.stage.shard.is_none() || (arguments.check == 0 && arguments.html.is_none()),
        "--check and --html do not apply to a shard"; "give them to re4-pipe influence after re4-pipe merge influence"
    );
    let runner = arguments.rolled.runner_of(Stage::Influence, &arguments.stage)?;
    runner.pipeline.needs_object()?;
    let output = arguments
        .html
        .as_deref()
        .map(|path| Output::at(path, "page"))
        .transpose()?;
    if let Some(output) = &output {
        output.refuse_inputs(&runner.inputs()?)?;
    }
    let judge = Judge {
        starts: arguments.starts,
    };
    let influenced = runner.influence(judge)?;
    if let (Some(output), Some(path)) = (&output, &arguments.html) {
        let page = re4_report::influence_page(&influenced.built.artifact)?;
        output.write(&page)?;
        console.note(&format!("{:>10}  {}", "page", path.display()));
    }
    let checked = match arguments.check {
        0 => None,
        count => Some(runner.check_influence(judge, &influenced, count)?),
    };
    let mut answer = influenced.built.to_json();
    answer["warnings"] = json!(runner.warnings());
    answer["wall_s"] = json!(start.elapsed().as_secs_f64());
    if let Some(checked) = &checked {
        answer["check"] = json!({
            "demonstrations": checked.demos,
            "episodes": checked.episodes,
            "differing": checked.differing,
        });
    }
    console.answer(&answer)?;
    let mut text = text(&influenced.rows)?;
    if let Some(checked) = &checked {
        write!(
            text,
            "\ncheck: {} episodes without each of {} demonstrations, {} differ from the artifact",
            checked.episodes,
            checked.demos.len(),
            checked.differing.len()
        )?;
        for sentence in &checked.differing {
            write!(text, "\n  {sentence}")?;
        }
    }
    console.say(&text)?;
    Ok(match checked {
        Some(checked) if !checked.differing.is_empty() => Outcome::GateFailed,
        _ => Outcome::Done,
    })
}

/// The demonstrations whose absence changes the success or the score most, in both directions, and the number of those that were
/// never judged.
fn text(rows: &[InfluenceRow]) -> Result<String> {
    let mut text = String::new();
    for of_kind in rows.chunk_by(|a, b| a.scenes == b.scenes) {
        let Some(first) = of_kind.first() else { continue };
        let never = of_kind.iter().filter(|row| row.depending == 0).count();
        write!(
            text,
            "{}{} {} scenes; {} of {} demonstrations never judged",
            if text.is_empty() { "" } else { "\n" },
            first.episodes,
            re4_artifact::Word::word(first.scenes),
            never,
            of_kind.len()
        )?;
        let change = |row: &InfluenceRow| (row.success_change, row.score_change);
        let mut sorted: Vec<&InfluenceRow> = of_kind.iter().filter(|row| change(row) != (0.0, 0.0)).collect();
        sorted.sort_by(|a, b| {
            let (one, other) = (change(a), change(b));
            other
                .0
                .total_cmp(&one.0)
                .then(other.1.total_cmp(&one.1))
                .then(a.demo.cmp(&b.demo))
        });
        let harmful = sorted.iter().filter(|row| change(row) > (0.0, 0.0)).take(PRINTED);
        list(&mut text, "better without", harmful.copied())?;
        let helpful = sorted.iter().rev().filter(|row| change(row) < (0.0, 0.0)).take(PRINTED);
        list(&mut text, "worse without", helpful.copied())?;
    }
    Ok(text)
}

fn list<'a>(text: &mut String, title: &str, rows: impl Iterator<Item = &'a InfluenceRow>) -> Result<()> {
    for (number, row) in rows.enumerate() {
        if number == 0 {
            write!(
                text,
                "\n  {title:<16} success                   score    followed  failed  repaired  broken"
            )?;
        }
        write!(
            text,
            "\n  {:<16} {:+.4} [{:+.4}, {:+.4}] {:+.4} {:>9} {:>7} {:>9} {:>7}",
            row.demo_name.as_deref().unwrap_or("?"),
            row.success_change,
            row.success_low,
            row.success_high,
            row.score_change,
            row.followed,
            row.failures,
            row.repaired,
            row.broken
        )?;
    }
    Ok(())
}
