//! Plots of points and curves.

use maud::{Markup, html};

const WIDTH: f64 = 560.0;
const HEIGHT: f64 = 400.0;
/// Left, right, top and bottom.
const MARGINS: [f64; 4] = [48.0, 14.0, 14.0, 34.0];

/// A point of a scatter plot.
pub(super) struct Mark {
    pub(super) at: [f64; 2],
    pub(super) class: &'static str,
    pub(super) title: String,
}

/// A curve of a plot.
pub(super) struct Curve {
    pub(super) class: &'static str,
    pub(super) points: Vec<[f64; 2]>,
    /// Whether the points are joined.
    pub(super) joined: bool,
}

fn text(value: f64) -> String {
    format!("{value:.1}")
}

/// Smallest and largest value, a little apart.
fn range(values: impl Iterator<Item = f64>) -> [f64; 2] {
    let values = values.filter(|value| value.is_finite());
    let [low, high] = values.fold([f64::INFINITY, f64::NEG_INFINITY], |[low, high], value| {
        [low.min(value), high.max(value)]
    });
    if low > high {
        return [0.0, 1.0];
    }
    let margin = 0.05 * (high - low).max(1e-9);
    [low - margin, high + margin]
}

/// Circles for demonstrations and crosses for scenes, with equal scales of both axes.
pub(super) fn scatter(demos: &[Mark], scenes: &[Mark]) -> Markup {
    let all = || demos.iter().chain(scenes);
    let [x_low, x_high] = range(all().map(|mark| mark.at[0]));
    let [y_low, y_high] = range(all().map(|mark| mark.at[1]));
    let [left, right, top, bottom] = MARGINS;
    let scale = ((WIDTH - left - right) / (x_high - x_low)).min((HEIGHT - top - bottom) / (y_high - y_low));
    let x = |value: f64| left + (value - x_low) * scale;
    let y = |value: f64| HEIGHT - bottom - (value - y_low) * scale;
    let shown = |mark: &&Mark| mark.at.iter().all(|value| value.is_finite());
    html! {
        svg.chart viewBox=(format!("0 0 {WIDTH} {HEIGHT}")) role="img" aria-label="Start positions of demonstrations and scenes" {
            @for mark in scenes.iter().filter(shown) {
                @let [a, b] = [x(mark.at[0]), y(mark.at[1])];
                path class={ "cross " (mark.class) } d=(format!("M{} {}l6 6m0 -6l-6 6", text(a - 3.0), text(b - 3.0))) { title { (mark.title) } }
            }
            @for mark in demos.iter().filter(shown) {
                circle class=(mark.class) cx=(text(x(mark.at[0]))) cy=(text(y(mark.at[1]))) r="4" { title { (mark.title) } }
            }
            text.axis x=(text(left)) y=(text(HEIGHT - 8.0)) { (format!("x {x_low:.3} to {x_high:.3}, y {y_low:.3} to {y_high:.3}")) }
        }
    }
}

/// Values from 0 to 1 over a number of demonstrations on a logarithmic axis.
pub(super) fn curves(curves: &[Curve], words: &str) -> Markup {
    let most = curves
        .iter()
        .flat_map(|curve| &curve.points)
        .map(|point| point[0])
        .fold(1.0, f64::max);
    let [left, right, top, bottom] = MARGINS;
    let x = |count: f64| left + (WIDTH - left - right) * count.max(1.0).ln() / most.max(1.1).ln();
    let y = |value: f64| top + (HEIGHT - top - bottom) * (1.0 - value.clamp(0.0, 1.0));
    let ticks = [1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0, 200.0, 500.0, 1000.0];
    html! {
        svg.chart viewBox=(format!("0 0 {WIDTH} {HEIGHT}")) role="img" aria-label=(words) {
            @for tick in [0.0, 0.2, 0.4, 0.6, 0.8, 1.0] {
                line.grid x1=(left) x2=(WIDTH - right) y1=(text(y(tick))) y2=(text(y(tick))) {}
                text.tick x=(left - 8.0) y=(text(y(tick) + 4.0)) text-anchor="end" { (format!("{tick:.1}")) }
            }
            @for tick in ticks.into_iter().filter(|tick| *tick <= most) {
                text.tick x=(text(x(tick))) y=(HEIGHT - bottom + 16.0) text-anchor="middle" { (tick) }
            }
            @for curve in curves {
                g class=(curve.class) {
                    @if curve.joined {
                        polyline.curve points=(curve.points.iter().map(|p| format!("{},{}", text(x(p[0])), text(y(p[1])))).collect::<Vec<_>>().join(" ")) {}
                    }
                    @for p in &curve.points {
                        circle cx=(text(x(p[0]))) cy=(text(y(p[1]))) r="3.5" { title { (p[0]) " demonstrations: " (format!("{:.3}", p[1])) } }
                    }
                }
            }
        }
    }
}
