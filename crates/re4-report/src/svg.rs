//! SVG images of a Push-T rollout, of the divergence of open-loop replays, and of the loss curves of a training.

use plotters::coord::Shift;
use plotters::prelude::*;
use re4_geometry::{Point2, Pose2};
use re4_rollout::Phase;
use re4_sim::{AGENT_RADIUS, tee_rectangles};
use re4_stats::{quantile, sorted};
use thiserror::Error;

use crate::html::rollouts::plane::Plane;
use crate::html::rollouts::{Rollout, demo_name};

/// Error of the plotting library.
#[derive(Debug, Error)]
#[error("the plotting library failed: {reason}")]
pub struct ImageError {
    reason: String,
}

impl<E: std::error::Error + Send + Sync> From<DrawingAreaErrorKind<E>> for ImageError {
    fn from(error: DrawingAreaErrorKind<E>) -> Self {
        Self {
            reason: error.to_string(),
        }
    }
}

/// Side of the workspace in pixels, both in the simulation and in the image.
const WORKSPACE: u32 = 512;
const MARGIN: u32 = 8;
const LEGEND: u32 = 48;

const GOAL: RGBColor = RGBColor(144, 238, 144);
const BLOCK: RGBColor = RGBColor(119, 136, 153);
const PLAN: RGBColor = RGBColor(214, 126, 20);
const REPLAY: RGBColor = RGBColor(40, 80, 200);

/// Renders a rollout as SVG: the goal, the block at each decision (darker with time) and at the end, the plans, and the path of
/// the pusher.
///
/// # Errors
/// [`ImageError`] if the plotting library fails.
pub fn rollout_image(rollout: &Rollout<Plane>) -> Result<String, ImageError> {
    let Rollout {
        result,
        steps,
        decisions,
        ..
    } = rollout;
    let blocks: Vec<Pose2> = [result.object]
        .into_iter()
        .chain(steps.iter().map(|step| step.object))
        .collect();
    let pusher: Vec<Point2> = [result.eef]
        .into_iter()
        .chain(steps.iter().map(|step| step.eef))
        .collect();
    let last = steps.len();
    let mut svg = String::new();
    {
        let size = (WORKSPACE + 2 * MARGIN, WORKSPACE + 2 * MARGIN + LEGEND);
        let root = SVGBackend::with_string(&mut svg, size).into_drawing_area();
        root.fill(&WHITE)?;
        let area = root.margin(MARGIN, MARGIN + LEGEND, MARGIN, MARGIN);
        let side = WORKSPACE as i32;
        area.draw(&Rectangle::new([(0, 0), (side, side)], BLACK.mix(0.2).stroke_width(1)))?;
        tee(&area, rollout.goal(), GOAL.filled())?;
        let shown: Vec<usize> = decisions
            .iter()
            .map(|d| (d.core().step as usize).min(last))
            .chain([last])
            .collect();
        for (i, &at) in shown.iter().enumerate() {
            let strength = 0.15 + 0.55 * (i + 1) as f64 / shown.len() as f64;
            tee(&area, blocks[at], BLOCK.mix(strength).filled())?;
        }
        for decision in decisions {
            let path: Vec<(i32, i32)> = decision.path().map(|[x, y]| pixel(Point2::new(x, y))).collect();
            area.draw(&PathElement::new(path, PLAN.mix(0.5).stroke_width(1)))?;
        }
        for (pair, step) in pusher.windows(2).zip(steps) {
            let colour = if step.core.phase == Phase::Replay { REPLAY } else { PLAN };
            area.draw(&PathElement::new(
                vec![pixel(pair[0]), pixel(pair[1])],
                colour.stroke_width(2),
            ))?;
            area.draw(&Circle::new(pixel(pair[1]), 2, colour.filled()))?;
        }
        for (point, colour) in [(pusher.first(), PLAN), (pusher.last(), REPLAY)] {
            if let Some(&point) = point {
                area.draw(&Circle::new(pixel(point), AGENT_RADIUS as i32, colour.stroke_width(2)))?;
            }
        }
        let demos: Vec<String> = decisions
            .iter()
            .map(|d| format!("step {}: {}", d.core().step, demo_name(d.core())))
            .collect();
        let caption = format!(
            "seed {}, score {:.3} after {last} steps",
            result.core.seed, result.score_max
        );
        let font = ("sans-serif", 14).into_font();
        let y = (WORKSPACE + 2 * MARGIN + 4) as i32;
        root.draw(&Text::new(caption, (MARGIN as i32, y), font.clone()))?;
        root.draw(&Text::new("plan", (360, y), font.clone().color(&PLAN)))?;
        root.draw(&Text::new("replay", (400, y), font.clone().color(&REPLAY)))?;
        root.draw(&Text::new("goal", (455, y), font.color(&RGBColor(60, 150, 60))))?;
        let small = ("sans-serif", 11).into_font().color(&RGBColor(90, 90, 90));
        root.draw(&Text::new(demos.join(", "), (MARGIN as i32, y + 20), small))?;
        root.present()?;
    }
    Ok(svg)
}

fn pixel(point: Point2) -> (i32, i32) {
    (point.x.round() as i32, point.y.round() as i32)
}

fn tee<B: DrawingBackend>(area: &DrawingArea<B, Shift>, pose: Pose2, style: ShapeStyle) -> Result<(), ImageError>
where
    B::ErrorType: 'static,
{
    for part in tee_rectangles() {
        let corners: Vec<(i32, i32)> = part.iter().map(|corner| pixel(pose.transform_point(*corner))).collect();
        area.draw(&Polygon::new(corners, style))?;
    }
    Ok(())
}

/// Plots the divergence of open-loop replays from their recordings: for every frame, the median, the 90th percentile and the
/// maximum of the distances over all demonstrations of at least that length. `distances[i]`, in pixels, belongs to frame
/// `frames[i]`.
///
/// # Errors
/// [`ImageError`] if the plotting library fails.
pub fn divergence_plot(frames: &[u32], distances: &[f64]) -> Result<String, ImageError> {
    let longest = frames.iter().copied().max().unwrap_or(0) as usize;
    let mut columns = vec![Vec::new(); longest + 1];
    for (&frame, &distance) in frames.iter().zip(distances) {
        columns[frame as usize].push(distance);
    }
    let columns: Vec<Vec<f64>> = columns.into_iter().map(sorted).collect();
    let curve = |probability: f64| -> Vec<(f64, f64)> {
        columns
            .iter()
            .enumerate()
            .filter_map(|(frame, column)| Some((frame as f64, quantile(column, probability)?.max(FLOOR))))
            .collect()
    };
    let top = distances.iter().copied().fold(1.0, f64::max) * 1.5;
    let mut svg = String::new();
    {
        let root = SVGBackend::with_string(&mut svg, (760, 400)).into_drawing_area();
        root.fill(&WHITE)?;
        let mut chart = ChartBuilder::on(&root)
            .margin(12)
            .x_label_area_size(40)
            .y_label_area_size(64)
            .build_cartesian_2d(0.0..longest as f64, (FLOOR..top).log_scale())?;
        chart
            .configure_mesh()
            .x_desc("frame of the demonstration")
            .x_label_formatter(&|frame| format!("{frame:.0}"))
            .y_desc("block, distance to recording, px")
            .light_line_style(WHITE.mix(0.0))
            .draw()?;
        for (probability, label, colour) in [
            (1.0, "maximum", PLAN),
            (0.9, "90th percentile", BLOCK),
            (0.5, "median", REPLAY),
        ] {
            chart
                .draw_series(LineSeries::new(curve(probability), colour.stroke_width(2)))?
                .label(label)
                .legend(move |(x, y)| PathElement::new(vec![(x, y), (x + 16, y)], colour.stroke_width(2)));
        }
        chart
            .configure_series_labels()
            .position(SeriesLabelPosition::UpperLeft)
            .background_style(WHITE.mix(0.8))
            .border_style(BLACK.mix(0.2))
            .draw()?;
        root.present()?;
    }
    Ok(svg)
}

/// Plots the loss curves of a training over its epochs, from 1 on. Each curve has a name and may have missing values.
///
/// # Errors
/// [`ImageError`] if the plotting library fails.
pub fn training_plot(curves: &[(&str, Vec<Option<f64>>)]) -> Result<String, ImageError> {
    let points = |values: &[Option<f64>]| -> Vec<(f64, f64)> {
        let numbered = values.iter().enumerate();
        numbered
            .filter_map(|(i, value)| value.map(|value| ((i + 1) as f64, value.max(FLOOR))))
            .collect()
    };
    let all: Vec<f64> = curves
        .iter()
        .flat_map(|(_, values)| points(values))
        .map(|(_, y)| y)
        .collect();
    let top = all.iter().copied().fold(FLOOR, f64::max) * 1.5;
    let bottom = all.iter().copied().fold(top, f64::min) / 1.5;
    let last = curves.iter().map(|(_, values)| values.len()).max().unwrap_or(0).max(2);
    let mut svg = String::new();
    {
        let root = SVGBackend::with_string(&mut svg, (760, 400)).into_drawing_area();
        root.fill(&WHITE)?;
        let mut chart = ChartBuilder::on(&root)
            .margin(12)
            .x_label_area_size(40)
            .y_label_area_size(64)
            .build_cartesian_2d(1.0..last as f64, (bottom..top).log_scale())?;
        chart
            .configure_mesh()
            .x_desc("epoch")
            .x_label_formatter(&|epoch| format!("{epoch:.0}"))
            .y_desc("loss")
            .light_line_style(WHITE.mix(0.0))
            .draw()?;
        for ((label, values), colour) in curves.iter().zip([PLAN, BLOCK, REPLAY, BLACK].into_iter().cycle()) {
            chart
                .draw_series(LineSeries::new(points(values), colour.stroke_width(2)))?
                .label(*label)
                .legend(move |(x, y)| PathElement::new(vec![(x, y), (x + 16, y)], colour.stroke_width(2)));
        }
        chart
            .configure_series_labels()
            .position(SeriesLabelPosition::UpperRight)
            .background_style(WHITE.mix(0.8))
            .border_style(BLACK.mix(0.2))
            .draw()?;
        root.present()?;
    }
    Ok(svg)
}

/// Minimum value on a logarithmic axis; smaller values are plotted here. Distances in pixels below it are rounding errors,
/// because recorded states are float32.
const FLOOR: f64 = 1e-5;

#[cfg(test)]
mod tests {
    use super::*;
    use crate::html::rollouts::plane::tests::rollout;

    #[test]
    fn a_rollout_shows_goal_block_plan_and_caption() {
        let rollout = rollout(7, &[0.475]);
        let svg = rollout_image(&rollout).unwrap();
        assert!(svg.starts_with("<svg"));
        // Two polygons, one per rectangle of the T, for each of the goal, the block at the decision, and the block at the end.
        assert_eq!(svg.matches("<polygon").count(), 6);
        assert!(svg.contains("seed 7, score 0.500 after 1 steps"));
        assert!(svg.contains("step 0: episode 31"));
        assert_eq!(svg, rollout_image(&rollout).unwrap());
    }

    #[test]
    fn an_empty_divergence_is_still_an_image() {
        assert!(divergence_plot(&[], &[]).unwrap().starts_with("<svg"));
        let svg = divergence_plot(&[0, 1, 0, 1], &[0.0, 2.0, 0.0, 4.0]).unwrap();
        assert!(svg.contains("median"));
    }
}
