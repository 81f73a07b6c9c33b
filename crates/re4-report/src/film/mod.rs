//! Films of rollouts as GIF files: the simulator's picture of every state, with the plan and the reframed chunk over it.
//!
//! A tile is the picture, shrunk to a square, over a strip with a bar of the coverage and, where there is room, text. Films
//! of several rollouts are grids of tiles that start together. A frame holds only what changed since the one before, so
//! films are small; frames are encoded one by one, so memory does not grow with their number.

mod paint;
mod scene;
mod text;

use std::borrow::Cow;
use std::io::Write;

use gif::{DisposalMethod, Encoder, EncodingError, Frame, Repeat};
use re4_geometry::{Point2, Pose2};
use re4_sim::{Canvas, SUCCESS_COVERAGE};
use thiserror::Error;

pub use scene::{DrawScene, SceneRollout, SceneState, write_scene_film};

use paint::{Palette, Shrink, line_pixels};

/// Colour of plans, red, green and blue.
pub(crate) const PLAN: [u8; 3] = [214, 126, 20];
/// Colour of replayed chunks.
pub(crate) const REPLAY: [u8; 3] = [40, 80, 200];
const INK: [u8; 3] = [51, 51, 51];
const BAR: [u8; 3] = [226, 226, 226];
const SUCCEEDED: [u8; 3] = [60, 150, 60];

/// Half the width of overlaid lines, in pixels of the canvas.
const LINE_RADIUS: f64 = 1.6;
/// Least side of a tile with text, in pixels; the letters grow with multiples of it.
const TEXT_FROM: u32 = 256;
/// Hundredths of a second that a control step lasts.
const STEP_CS: f64 = 10.0;
/// Browsers slow frames down that are shorter than this, in hundredths of a second.
const SHORTEST_CS: f64 = 2.0;
/// How long the last state is shown, in hundredths of a second.
const LAST_CS: u16 = 100;

/// Least and greatest side of a tile, in pixels.
pub const FILM_SIZES: std::ops::RangeInclusive<u32> = 64..=Canvas::SIDE as u32;
/// Least and greatest speed, in multiples of the speed of the rollout.
pub const FILM_SPEEDS: std::ops::RangeInclusive<f64> = 0.1..=50.0;
/// Most rollouts in a film.
pub const FILM_TILES: usize = 100;

/// Why a film could not be made.
#[derive(Debug, Error)]
pub enum FilmError {
    /// The caller asked to stop.
    #[error("the film was interrupted; nothing was written, run it again")]
    Interrupted,
    /// The settings are outside of [`FILM_SIZES`], [`FILM_SPEEDS`] and [`FILM_TILES`], or there is nothing to show.
    #[error("{0}")]
    Settings(String),
    /// A picture could not be drawn.
    #[error("{0}")]
    Picture(Box<dyn std::error::Error + Send + Sync>),
    /// The encoder or the file refused.
    #[error(transparent)]
    Encoding(#[from] EncodingError),
}

/// A state of a rollout, world frame, pixels and radians.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FilmState {
    /// Position of the pusher.
    pub pusher: Point2,
    /// Pose of the block.
    pub block: Pose2,
    /// Share of the goal that the block covers.
    pub coverage: f64,
    /// Position, in [`FilmRollout::decisions`], of the decision that the next action belongs to; in the last state, that
    /// of the action before it.
    pub decision: usize,
    /// Whether that action replays a chunk (else it follows a plan).
    pub replaying: bool,
}

/// A decision of a rollout, world frame, pixels.
#[derive(Debug, Clone, PartialEq)]
pub struct FilmDecision {
    /// Name of the demonstration that was retrieved.
    pub demo: String,
    /// First frame of the chunk, and its last one, included.
    pub frames: (u32, u32),
    /// Plan to the start of the chunk.
    pub plan: Vec<Point2>,
    /// Positions of the pusher in the chunk, carried to the observed block; may be empty.
    pub chunk: Vec<Point2>,
}

/// A rollout to be filmed.
#[derive(Debug, Clone, PartialEq)]
pub struct FilmRollout {
    /// Seed of the scene.
    pub seed: u32,
    /// States before each control step and after the last; at least one.
    pub states: Vec<FilmState>,
    /// Decisions.
    pub decisions: Vec<FilmDecision>,
}

/// How to film.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FilmSettings {
    /// Side of a tile's picture, in pixels.
    pub size: u32,
    /// Speed, in multiples of the speed of the rollout (a control step is 0.1 s).
    pub speed: f64,
}

/// What a film has become.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct FilmFacts {
    /// Width in pixels.
    pub width: u32,
    /// Height in pixels.
    pub height: u32,
    /// Frames.
    pub frames: u32,
    /// How long it lasts until it starts over, in hundredths of a second.
    pub duration_cs: u32,
}

/// Writes a film of rollouts: one tile each, row by row. Rollouts that end earlier stay in their last state.
///
/// Every control step is a frame, unless frames would be shorter than 0.02 s; then as many states are left out as needed.
/// The same rollouts and settings give the same bytes. `going` is called before every frame and says whether to go on.
///
/// # Errors
/// [`FilmError`]; what was written until then is no film.
pub fn write_film(
    out: impl Write,
    rollouts: &[FilmRollout],
    settings: FilmSettings,
    going: &mut dyn FnMut() -> bool,
) -> Result<FilmFacts, FilmError> {
    check_settings(
        rollouts.iter().map(|rollout| (rollout.seed, rollout.states.len())),
        settings,
    )?;
    let columns = (1..=FILM_TILES).find(|c| c * c >= rollouts.len()).unwrap_or(1);
    let rows = rollouts.len().div_ceil(columns);
    let tile_height = settings.size + strip_height(settings.size);
    let (width, height) = (columns as u32 * settings.size, rows as u32 * tile_height);
    let palette = Palette::new(
        &[INK, BAR, SUCCEEDED],
        &[&Canvas::COLOURS[..], &[PLAN, REPLAY]].concat(),
    );
    let mut encoder = Encoder::new(out, width as u16, height as u16, &palette.bytes())?;
    encoder.set_repeat(Repeat::Infinite)?;

    let mut tiles: Vec<Tile> = rollouts
        .iter()
        .map(|rollout| Tile::new(rollout, settings.size))
        .collect();
    let mut painter = Painter::new(settings.size, palette);
    let mut page = Page::new(width as usize, height as usize);
    let last = rollouts.iter().map(|r| r.states.len() - 1).max().unwrap_or(0);
    let times = shown(last, settings.speed, STEP_CS);
    for (i, &(state, delay)) in times.iter().enumerate() {
        if !going() {
            return Err(FilmError::Interrupted);
        }
        for (number, tile) in tiles.iter_mut().enumerate() {
            let corner = (
                number % columns * settings.size as usize,
                number / columns * tile_height as usize,
            );
            if let Some(pixels) = painter.paint(tile, state) {
                page.put(pixels, settings.size as usize, corner);
            }
        }
        encoder.write_frame(&page.changes(painter.palette.transparent(), delay, i == 0))?;
    }
    encoder.into_inner()?.flush().map_err(EncodingError::from)?;
    Ok(FilmFacts {
        width,
        height,
        frames: times.len() as u32,
        duration_cs: times.iter().map(|(_, delay)| u32::from(*delay)).sum(),
    })
}

/// Checks the settings, and the rollouts by their seeds and counts of states.
fn check_settings(
    rollouts: impl ExactSizeIterator<Item = (u32, usize)>,
    settings: FilmSettings,
) -> Result<(), FilmError> {
    let refuse = |text: String| Err(FilmError::Settings(text));
    let count = rollouts.len();
    if count == 0 || count > FILM_TILES {
        return refuse(format!("a film shows 1 to {FILM_TILES} rollouts, not {count}"));
    }
    for (seed, states) in rollouts {
        if states == 0 {
            return refuse(format!("the rollout of seed {seed} has no states to show"));
        }
    }
    if !FILM_SIZES.contains(&settings.size) {
        let (least, most) = (FILM_SIZES.start(), FILM_SIZES.end());
        return refuse(format!("a film's size is {least} to {most} px, not {}", settings.size));
    }
    if !FILM_SPEEDS.contains(&settings.speed) {
        let (least, most) = (FILM_SPEEDS.start(), FILM_SPEEDS.end());
        return refuse(format!("a film's speed is {least} to {most}, not {}", settings.speed));
    }
    Ok(())
}

/// Which states are shown, and each for how many hundredths of a second, so that times add up to those of the rollout, whose
/// steps last `step` hundredths.
fn shown(last: usize, speed: f64, step: f64) -> Vec<(usize, u16)> {
    let stride = (SHORTEST_CS * speed / step).ceil().max(1.0) as usize;
    let time = |state: usize| (step * state as f64 / speed).round() as u64;
    let mut times: Vec<(usize, u16)> = (0..last)
        .step_by(stride)
        .map(|state| (state, (time((state + stride).min(last)) - time(state)) as u16))
        .collect();
    times.push((last, LAST_CS));
    times
}

fn text_scale(size: u32) -> u32 {
    size / TEXT_FROM
}

/// Height of the strip below the picture: the bar, and two lines of text.
fn strip_height(size: u32) -> u32 {
    match text_scale(size) {
        0 => 4,
        scale => scale * 28,
    }
}

/// Pixels of the canvas that lines cover, with the lines' colours.
type Lines = Vec<(usize, [u8; 3])>;

/// A rollout and what of it was painted last.
struct Tile<'a> {
    rollout: &'a FilmRollout,
    size: u32,
    /// A decision and its lines.
    overlay: Option<(usize, Lines)>,
    painted: Option<usize>,
}

impl<'a> Tile<'a> {
    fn new(rollout: &'a FilmRollout, size: u32) -> Self {
        Self {
            rollout,
            size,
            overlay: None,
            painted: None,
        }
    }

    /// The plan and the chunk of a decision; worked out once, as it lasts for many states.
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

    /// What the strip says of a state: two lines, and the colour of the second.
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
        let coverage = format!("COVERAGE {:.3}", state.coverage);
        ([first, coverage, second], colour)
    }
}

/// Paints tiles, with buffers that are used again.
struct Painter {
    canvas: Canvas,
    shrink: Shrink,
    palette: Palette,
    picture: Vec<u8>,
    small: Vec<u8>,
    indices: Vec<u8>,
}

impl Painter {
    fn new(size: u32, palette: Palette) -> Self {
        Self {
            canvas: Canvas::new(),
            shrink: Shrink::new(Canvas::SIDE, size as usize),
            palette,
            picture: Vec::new(),
            small: Vec::new(),
            indices: Vec::new(),
        }
    }

    /// The pixels of a tile in a state, as positions in the palette; nothing if it looks as it did.
    fn paint(&mut self, tile: &mut Tile, state: usize) -> Option<&[u8]> {
        let at = state.min(tile.rollout.states.len() - 1);
        if tile.painted == Some(at) {
            return None;
        }
        tile.painted = Some(at);
        let shown = tile.rollout.states[at];
        self.canvas.draw_state(shown.pusher, shown.block);
        self.picture.clear();
        self.picture.extend_from_slice(self.canvas.bytes());
        for (pixel, colour) in tile.overlay(shown.decision) {
            self.picture[3 * pixel..3 * pixel + 3].copy_from_slice(colour);
        }
        self.shrink.apply(&self.picture, &mut self.small);
        self.indices.clear();
        self.palette.index(&self.small, &mut self.indices);
        self.strip(tile, at);
        Some(&self.indices)
    }

    /// Adds the strip below the picture.
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

/// The film's current frame and the one before.
struct Page {
    width: usize,
    now: Vec<u8>,
    before: Vec<u8>,
}

impl Page {
    fn new(width: usize, height: usize) -> Self {
        Self {
            width,
            now: vec![0; width * height],
            before: vec![0; width * height],
        }
    }

    fn put(&mut self, tile: &[u8], side: usize, (left, top): (usize, usize)) {
        for (row, pixels) in tile.chunks_exact(side).enumerate() {
            let start = (top + row) * self.width + left;
            self.now[start..start + side].copy_from_slice(pixels);
        }
    }

    /// The least rectangle that holds what changed, see-through where nothing did; the whole page if it is the first.
    fn changes(&mut self, transparent: u8, delay: u16, first: bool) -> Frame<'static> {
        let rows = || {
            self.now
                .chunks_exact(self.width)
                .zip(self.before.chunks_exact(self.width))
        };
        let (mut left, mut right, mut top, mut bottom) = (self.width, 0, usize::MAX, 0);
        for (y, (now, before)) in rows().enumerate() {
            let differs = |(a, b): (&u8, &u8)| first || a != b;
            if let Some(x) = now.iter().zip(before).position(differs) {
                left = left.min(x);
                right = right.max(now.iter().zip(before).rposition(differs).unwrap_or(x));
                (top, bottom) = (top.min(y), y);
            }
        }
        if top == usize::MAX {
            // A frame has at least one pixel.
            (left, right, top, bottom) = (0, 0, 0, 0);
        }
        let buffer: Vec<u8> = rows()
            .skip(top)
            .take(bottom + 1 - top)
            .flat_map(|(now, before)| now[left..=right].iter().zip(&before[left..=right]))
            .map(|(now, before)| if first || now != before { *now } else { transparent })
            .collect();
        self.before.copy_from_slice(&self.now);
        Frame {
            delay,
            dispose: DisposalMethod::Keep,
            transparent: Some(transparent),
            left: left as u16,
            top: top as u16,
            width: (right + 1 - left) as u16,
            height: (bottom + 1 - top) as u16,
            buffer: Cow::Owned(buffer),
            ..Frame::default()
        }
    }
}

#[cfg(test)]
mod tests;
