//! Scores under smaller budgets of control steps: a plot and a table for each column.

use maud::{Markup, html};
use re4_compare::CurveRow;

use super::Comparison;
use crate::html::shell::{exact, short, table};

const WIDTH: f64 = 560.0;
const HEIGHT: f64 = 300.0;
/// Left, right, top and bottom.
const MARGINS: [f64; 4] = [38.0, 12.0, 12.0, 40.0];

/// The names of the colors of curves: `series-0` to `series-7`.
const COLORS: usize = 8;

pub(super) fn section(page: &Comparison) -> Markup {
    let with_curves: Vec<&str> = page
        .columns
        .iter()
        .map(|column| column.name.as_str())
        .filter(|column| page.curves.iter().any(|row| row.column == **column))
        .collect();
    html! {
        @if !with_curves.is_empty() {
            section aria-labelledby="curves-title" {
                h2 #curves-title { "Scores under smaller budgets of steps" }
                p.note { "Mean over the rollouts of the maximum that each reached within the budget, with 95 % intervals." }
                div.curves { @for column in &with_curves { (figure(page, column)) } }
                @for column in &with_curves {
                    details.card { summary { "Table: " (column) } (budgets(page, column)) }
                }
            }
        }
    }
}

/// The points of a row in a column, for the printed measure.
fn curve<'a>(page: &'a Comparison, row: &str, column: &str) -> Vec<&'a CurveRow> {
    let measure = page.printed_measure(column);
    let own = |point: &&CurveRow| point.row == *row && point.column == *column && Some(point.measure) == measure;
    page.curves.iter().filter(own).collect()
}

fn figure(page: &Comparison, column: &str) -> Markup {
    let [left, right, top, bottom] = MARGINS;
    let last = page
        .curves
        .iter()
        .filter(|row| row.column == *column)
        .map(|row| row.budget)
        .max()
        .unwrap_or(1);
    let x = |budget: u32| left + (WIDTH - left - right) * f64::from(budget) / f64::from(last);
    let y = |value: f64| top + (HEIGHT - top - bottom) * (1.0 - value.clamp(0.0, 1.0));
    let rows: Vec<(usize, &String, Vec<&CurveRow>)> = page
        .rows
        .iter()
        .enumerate()
        .map(|(number, row)| (number % COLORS, row, curve(page, row, column)))
        .filter(|(.., points)| !points.is_empty())
        .collect();
    let spacing = if last <= 200 { 50 } else { last.div_ceil(500) * 100 };
    let title = page.printed_measure(column).map_or("", re4_compare::Measure::title);
    html! {
        figure.card {
            figcaption {
                h3 { (column) ": " (title) }
                ul.legend { @for (color, row, _) in &rows { li class=(format!("series-{color}")) { span.swatch {} span.label { (row) } } } }
            }
            svg.chart viewBox=(format!("0 0 {WIDTH} {HEIGHT}")) role="img" aria-label=(format!("{column}: {title} by budget of steps; the table below has the values")) {
                @for tick in [0.0, 0.2, 0.4, 0.6, 0.8, 1.0] {
                    line.grid x1=(left) x2=(WIDTH - right) y1=(point(y(tick))) y2=(point(y(tick))) {}
                    text.tick x=(left - 8.0) y=(point(y(tick) + 4.0)) text-anchor="end" { (format!("{tick:.1}")) }
                }
                @for tick in (0..=last / spacing).map(|i| i * spacing) {
                    text.tick x=(point(x(tick))) y=(HEIGHT - bottom + 18.0) text-anchor="middle" { (tick) }
                }
                text.axis x=(point((left + WIDTH - right) / 2.0)) y=(HEIGHT - 4.0) text-anchor="middle" { "budget of control steps" }
                @for (color, row, points) in &rows {
                    g class=(format!("series series-{color}")) data-curve=(row) {
                        polyline.curve points=(points.iter().map(|p| format!("{},{}", point(x(p.budget)), point(y(p.value)))).collect::<Vec<_>>().join(" ")) {}
                        @for p in points {
                            line.whisker x1=(point(x(p.budget))) x2=(point(x(p.budget))) y1=(point(y(p.low))) y2=(point(y(p.high))) {}
                            circle.point cx=(point(x(p.budget))) cy=(point(y(p.value))) r="3.5" {
                                title { (row) ", " (p.budget) " steps: " (short(p.value)) " [" (short(p.low)) ", " (short(p.high)) "]" }
                            }
                        }
                    }
                }
            }
        }
    }
}

fn point(value: f64) -> String {
    format!("{value:.1}")
}

fn budgets(page: &Comparison, column: &str) -> Markup {
    let rows: Vec<(&String, Vec<&CurveRow>)> = page
        .rows
        .iter()
        .map(|row| (row, curve(page, row, column)))
        .filter(|(_, points)| !points.is_empty())
        .collect();
    let longest = rows.iter().map(|(_, points)| points).max_by_key(|points| points.len());
    let names: Vec<String> = longest
        .into_iter()
        .flatten()
        .map(|point| point.budget.to_string())
        .collect();
    let columns: Vec<(&str, bool)> = [("policy", false)]
        .into_iter()
        .chain(names.iter().map(|name| (name.as_str(), true)))
        .collect();
    let body = html! {
        @for (row, points) in &rows {
            tr {
                th scope="row" { (row) }
                @for p in points {
                    td.figure data-budget=(p.budget) data-value=(exact(p.value)) { (short(p.value)) span.interval.below { "[" (short(p.low)) ", " (short(p.high)) "]" } }
                }
            }
        }
    };
    table("Scores by budget of steps", "scroll", "plain", &columns, &body)
}
