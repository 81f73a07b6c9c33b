//! Videos of rollouts as GIF files: the simulator's image of every state, overlaid with the plan and the reframed chunk.
//!
//! A tile is the image, scaled down to a square, and below it a strip with a bar of the coverage and, if the tile is large
//! enough, text. A video of several rollouts is a grid of tiles that start at the same time. A frame stores only the pixels that
//! changed since the previous frame, which keeps videos small. Frames are encoded one by one, so that memory does not grow with
//! their number.

mod paint;
mod reel;
mod scene;
mod text;

use std::io::Write;

use gif::EncodingError;
use re4_geometry::{Point2, Pose2};
use re4_sim::{Canvas, SUCCESS_COVERAGE};
use thiserror::Error;

pub use scene::{RenderScene, SceneRollout, SceneState, write_scene_video};

use paint::{Palette, Shrink, line_pixels};
use reel::{Reel, check_settings};

/// RGB colour of plans.
pub(crate) const PLAN: [u8; 3] = [214, 126, 20];
/// RGB colour of replayed chunks.
pub(crate) const REPLAY: [u8; 3] = [40, 80, 200];
const INK: [u8; 3] = [51, 51, 51];
const BAR: [u8; 3] = [226, 226, 226];
const SUCCEEDED: [u8; 3] = [60, 150, 60];

/// Number of states for which the text of a disturbance is shown.
const ANNOUNCED: usize = 10;

/// Half the width of overlaid lines, in pixels of the canvas.
const LINE_RADIUS: f64 = 1.6;
/// Minimum side of a tile with text, in pixels. The size of the letters is proportional to the side in multiples of it.
const TEXT_FROM: u32 = 256;
/// Duration of a control step, in hundredths of a second.
const STEP_CS: f64 = 10.0;
/// Minimum duration of a frame, in hundredths of a second. Browsers slow down shorter frames.
const SHORTEST_CS: f64 = 2.0;
/// Duration for which the last state is shown, in hundredths of a second.
const LAST_CS: u16 = 100;

/// Minimum and maximum side of a tile, in pixels.
pub const VIDEO_SIZES: std::ops::RangeInclusive<u32> = 64..=Canvas::SIDE as u32;
/// Minimum and maximum speed, in multiples of the speed of the rollout.
pub const VIDEO_SPEEDS: std::ops::RangeInclusive<f64> = 0.1..=50.0;
/// Maximum number of rollouts in a video.
pub const VIDEO_TILES: usize = 100;

/// Why a video could not be made.
#[derive(Debug, Error)]
pub enum VideoError {
    /// The caller asked to stop.
    #[error("the video was interrupted; nothing was written, run it again")]
    Interrupted,
    /// The settings are outside of [`VIDEO_SIZES`], [`VIDEO_SPEEDS`] or [`VIDEO_TILES`], or a rollout has no states.
    #[error("{0}")]
    Settings(String),
    /// An image could not be rendered.
    #[error("{0}")]
    Image(Box<dyn std::error::Error + Send + Sync>),
    /// The video could not be encoded or written.
    #[error(transparent)]
    Encoding(#[from] EncodingError),
}

/// A state of a rollout, in the world frame, in pixels and radians.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct VideoState {
    /// Position of the pusher.
    pub pusher: Point2,
    /// Pose of the block.
    pub block: Pose2,
    /// Fraction of the goal that the block covers.
    pub coverage: f64,
    /// Index in [`VideoRollout::decisions`] of the decision that the next action belongs to; in the last state, of the decision of
    /// the action before it.
    pub decision: usize,
    /// Whether that action replays a chunk; otherwise, it follows a plan.
    pub replaying: bool,
}

/// A decision of a rollout, in the world frame, in pixels.
#[derive(Debug, Clone, PartialEq)]
pub struct VideoDecision {
    /// Name of the demonstration that was retrieved.
    pub demo: String,
    /// First and last frame of the chunk, both inclusive.
    pub frames: (u32, u32),
    /// Planned path to the start of the chunk.
    pub plan: Vec<Point2>,
    /// Positions of the pusher in the chunk, reframed to the observed block; may be empty.
    pub chunk: Vec<Point2>,
}

/// A rollout to be recorded.
#[derive(Debug, Clone, PartialEq)]
pub struct VideoRollout {
    /// Seed of the scene.
    pub seed: u32,
    /// Goal pose of the block.
    pub goal: Pose2,
    /// Number of control steps taken before the disturbance, and the disturbance in words; `None` if there is none.
    pub disturbance: Option<(u32, String)>,
    /// States before each control step and after the last one; at least one state.
    pub states: Vec<VideoState>,
    /// Decisions, in order of time.
    pub decisions: Vec<VideoDecision>,
}

/// Settings of a video.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct VideoSettings {
    /// Side of a tile's image, in pixels.
    pub size: u32,
    /// Speed, in multiples of the speed of the rollout (a control step of Push-T is 0.1 s, one of robosuite 0.05 s).
    pub speed: f64,
}

/// Properties of a written video.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct VideoSummary {
    /// Width in pixels.
    pub width: u32,
    /// Height in pixels.
    pub height: u32,
    /// Number of frames.
    pub frames: u32,
    /// Duration until the video repeats, in hundredths of a second.
    pub duration_cs: u32,
}

/// Writes a video of rollouts of Push-T, with one tile per rollout, row by row. Rollouts that end earlier stay in their last state.
///
/// Every control step is a frame, unless frames would be shorter than 0.02 s; then only every n-th state is shown.
/// The same rollouts and settings give the same bytes. `going` is called before every frame; if it returns false, writing stops.
///
/// # Errors
/// [`VideoError`]. The bytes that were written before the error are not a valid video.
pub fn write_video(
    out: impl Write,
    rollouts: &[VideoRollout],
    settings: VideoSettings,
    going: &mut dyn FnMut() -> bool,
) -> Result<VideoSummary, VideoError> {
    check_settings(
        rollouts.iter().map(|rollout| (rollout.seed, rollout.states.len())),
        settings,
    )?;
    let palette = Palette::new(
        &[INK, BAR, SUCCEEDED],
        &[&Canvas::COLOURS[..], &[PLAN, REPLAY]].concat(),
    );
    let (colours, transparent) = (palette.bytes(), palette.transparent());
    let lasts: Vec<usize> = rollouts.iter().map(|rollout| rollout.states.len() - 1).collect();
    let reel = Reel::new(&lasts, settings, strip_height(settings.size), STEP_CS);
    let mut tiles: Vec<Tile> = rollouts
        .iter()
        .map(|rollout| Tile::new(rollout, settings.size))
        .collect();
    let mut painter = Painter::new(settings.size, palette);
    let mut paint = |number: usize, state: usize| Ok(painter.paint(&mut tiles[number], state).to_vec());
    reel.write(out, &colours, transparent, &mut paint, going)
}

/// Whether the text of a disturbance is shown in a state: in the first states after it.
fn is_announced(step: u32, state: usize) -> bool {
    state
        .checked_sub(step as usize + 1)
        .is_some_and(|after| after < ANNOUNCED)
}

fn text_scale(size: u32) -> u32 {
    size / TEXT_FROM
}

/// Height of the strip below the image: the bar, and two lines of text.
fn strip_height(size: u32) -> u32 {
    match text_scale(size) {
        0 => 4,
        scale => scale * 28,
    }
}

/// Indices of the canvas pixels that lines cover, with the colours of the lines.
type Lines = Vec<(usize, [u8; 3])>;

/// A rollout and the lines over its images.
struct Tile<'a> {
    rollout: &'a VideoRollout,
    size: u32,
    /// The current decision and its lines.
    overlay: Option<(usize, Lines)>,
}

impl<'a> Tile<'a> {
    fn new(rollout: &'a VideoRollout, size: u32) -> Self {
        Self {
            rollout,
            size,
            overlay: None,
        }
    }

    /// Returns the lines of the plan and the chunk of a decision. They are cached, because a decision lasts for many states.
    fn overlay(&mut self, decision: usize) -> &[(usize, [u8; 3])] {
        if self.overlay.as_ref().is_none_or(|(of, _)| *of != decision) {
            let mut lines = Lines::new();
            if let Some(d) = self.rollout.decisions.get(decision) {
                for (path, colour) in [(&d.plan, PLAN), (&d.chunk, REPLAY)] {
                    let pixels = line_pixels(path, LINE_RADIUS, Canvas::SIDE);
                    lines.extend(pixels.into_iter().map(|pixel| (pixel, colour)));
                }
            }
            self.overlay = Some((decision, lines));
        }
        self.overlay.as_ref().map_or(&[], |(_, lines)| lines)
    }

    /// Returns the texts of the strip for a state (seed and step, coverage, demonstration), and the colour of the last one.
    fn words(&self, at: usize) -> ([String; 3], [u8; 3]) {
        let state = &self.rollout.states[at];
        let first = format!(
            "SEED {} STEP {at} OF {}",
            self.rollout.seed,
            self.rollout.states.len() - 1
        );
        let second = self.rollout.decisions.get(state.decision).map_or(String::new(), |d| {
            let phase = if state.replaying { "REPLAY" } else { "PLAN" };
            format!(
                "{phase}  {} FRAMES {}-{}",
                d.demo.to_uppercase(),
                d.frames.0,
                d.frames.1
            )
        });
        let colour = if state.replaying { REPLAY } else { PLAN };
        let (second, colour) = match &self.rollout.disturbance {
            Some((step, words)) if is_announced(*step, at) => (words.replace('°', " DEG").to_uppercase(), INK),
            _ => (second, colour),
        };
        let coverage = format!("COVERAGE {:.3}", state.coverage);
        ([first, coverage, second], colour)
    }
}

/// Paints tiles. It reuses its buffers.
struct Painter {
    canvas: Canvas,
    shrink: Shrink,
    palette: Palette,
    image: Vec<u8>,
    small: Vec<u8>,
    indices: Vec<u8>,
}

impl Painter {
    fn new(size: u32, palette: Palette) -> Self {
        Self {
            canvas: Canvas::new(),
            shrink: Shrink::new(Canvas::SIDE, size as usize),
            palette,
            image: Vec::new(),
            small: Vec::new(),
            indices: Vec::new(),
        }
    }

    /// Paints a tile in a state, and returns its pixels as palette indices.
    fn paint(&mut self, tile: &mut Tile, at: usize) -> &[u8] {
        let shown = tile.rollout.states[at];
        self.canvas.set_goal(tile.rollout.goal);
        self.canvas.render_state(shown.pusher, shown.block);
        self.image.clear();
        self.image.extend_from_slice(self.canvas.bytes());
        for (pixel, colour) in tile.overlay(shown.decision) {
            self.image[3 * pixel..3 * pixel + 3].copy_from_slice(colour);
        }
        self.shrink.apply(&self.image, &mut self.small);
        self.indices.clear();
        self.palette.index(&self.small, &mut self.indices);
        self.strip(tile, at);
        &self.indices
    }

    /// Adds the strip below the image.
    fn strip(&mut self, tile: &Tile, at: usize) {
        let (side, scale) = (tile.size as usize, text_scale(tile.size) as usize);
        let start = self.indices.len();
        let paper = self.palette.of(Canvas::PAPER);
        self.indices
            .resize(start + side * strip_height(tile.size) as usize, paper);
        let strip = &mut self.indices[start..];
        let coverage = tile.rollout.states[at].coverage;
        let colour = if coverage > SUCCESS_COVERAGE {
            SUCCEEDED
        } else {
            Canvas::OUTLINE
        };
        let (full, empty, ink) = (self.palette.of(colour), self.palette.of(BAR), self.palette.of(INK));
        let bar = (4 * scale).max(4);
        let reached = (coverage.clamp(0.0, 1.0) * side as f64).round() as usize;
        let goal = (SUCCESS_COVERAGE * side as f64).round() as usize;
        for row in strip.chunks_exact_mut(side).take(bar) {
            row.fill(empty);
            row[..reached].fill(full);
            row[goal] = ink;
        }
        if scale > 0 {
            let ([seed, coverage, demo], colour) = tile.words(at);
            let margin = 3 * scale;
            let right = side.saturating_sub(margin + text::width(&coverage, scale));
            text::write(strip, side, (margin, 8 * scale), scale, &seed, ink);
            text::write(strip, side, (right, 8 * scale), scale, &coverage, ink);
            text::write(strip, side, (margin, 18 * scale), scale, &demo, self.palette.of(colour));
        }
    }
}

#[cfg(test)]
mod tests;
