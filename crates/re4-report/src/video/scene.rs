//! Videos of rollouts whose images are rendered by the caller, for example with MuJoCo. Below each image is a strip with the
//! timeline of retrieved demonstrations, the phases of the steps and, if the tile is large enough, text.

use std::collections::BTreeMap;
use std::io::Write;

use super::paint::{Palette, median_cut};
use super::reel::{Reel, check_settings};
use super::{
    BAR, INK, PLAN, REPLAY, SUCCEEDED, VideoError, VideoSettings, VideoSummary, is_announced, text, text_scale,
};
use re4_rollout::Phase;

/// Duration of a control step, in hundredths of a second.
const STEP_CS: f64 = 5.0;
const PAPER: [u8; 3] = [255; 3];
const HOME: [u8; 3] = [154, 79, 125];
const FAILED: [u8; 3] = [192, 42, 86];
/// Number of colours of demonstrations. If there are more demonstrations, several have the same colour.
const HUES: usize = 16;
/// Number of rollouts, and number of images of each, from which the palette is computed.
const SAMPLES: usize = 4;

/// A state of a rollout.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SceneState {
    /// Demonstration that the next action follows (in the last state, the action before it); `None` during the return to the
    /// initial pose.
    pub demo: Option<u32>,
    /// Phase of that action.
    pub phase: Phase,
}

/// A rollout to be recorded.
#[derive(Debug, Clone, PartialEq)]
pub struct SceneRollout {
    /// Seed of the scene.
    pub seed: u32,
    /// Whether the rollout succeeds.
    pub success: bool,
    /// Number of control steps taken before the disturbance; `None` if there is none.
    pub disturbance: Option<u32>,
    /// States before each control step and after the last one; at least one state.
    pub states: Vec<SceneState>,
    /// Names of demonstrations by number.
    pub names: BTreeMap<u32, String>,
}

/// Renders a rollout, given its index, in a state. Returns a square RGB image of the video's size, three bytes per pixel, rows
/// from top to bottom.
pub type RenderScene<'a> = dyn FnMut(usize, usize) -> Result<Vec<u8>, Box<dyn std::error::Error + Send + Sync>> + 'a;

/// Writes a video of rollouts, with one tile per rollout, row by row. Rollouts that end earlier stay in their last state. A control
/// step lasts 0.05 s at speed 1. Otherwise, the video is like that of [`super::write_video`].
///
/// # Errors
/// [`VideoError`]. The bytes that were written before the error are not a valid video.
pub fn write_scene_video(
    out: impl Write,
    rollouts: &[SceneRollout],
    settings: VideoSettings,
    render: &mut RenderScene<'_>,
    going: &mut dyn FnMut() -> bool,
) -> Result<VideoSummary, VideoError> {
    check_settings(
        rollouts.iter().map(|rollout| (rollout.seed, rollout.states.len())),
        settings,
    )?;
    let side = settings.size as usize;
    let mut palette = palette(rollouts, render)?;
    let lasts: Vec<usize> = rollouts.iter().map(|rollout| rollout.states.len() - 1).collect();
    let reel = Reel::new(&lasts, settings, strip_height(settings.size), STEP_CS);
    let (colours, transparent) = (palette.bytes(), palette.transparent());
    let mut pixels = Vec::new();
    let mut paint = |number: usize, state: usize| {
        let image = render(number, state).map_err(VideoError::Image)?;
        pixels.clear();
        palette.index(&image, &mut pixels);
        pixels.resize(side * side, palette.of(PAPER));
        strip(&mut pixels, settings.size, &rollouts[number], state, &mut palette);
        Ok(pixels.clone())
    };
    reel.write(out, &colours, transparent, &mut paint, going)
}

/// Returns a palette of the strip's colours, and of the colours that best represent a sample of images.
fn palette(rollouts: &[SceneRollout], render: &mut RenderScene<'_>) -> Result<Palette, VideoError> {
    let mut colours = vec![INK, BAR, PAPER, PLAN, REPLAY, HOME, SUCCEEDED, FAILED];
    colours.extend((0..HUES).map(hue_colour));
    let mut sample = Vec::new();
    for (number, rollout) in rollouts.iter().enumerate().take(SAMPLES) {
        for part in 0..SAMPLES {
            let state = (rollout.states.len() - 1) * part / (SAMPLES - 1);
            sample.extend(render(number, state).map_err(VideoError::Image)?);
        }
    }
    // A GIF palette has 256 colours, and one of them is the transparent one.
    colours.extend(median_cut(&sample, 255 - colours.len()));
    Ok(Palette::new(&colours, &[]))
}

/// Returns the colour of a hue from 0 to [`HUES`] - 1. All hues have the same saturation and lightness.
fn hue_colour(hue: usize) -> [u8; 3] {
    let at = 6.0 * hue as f64 / HUES as f64;
    // HSL with saturation 0.55 and lightness 0.47.
    [5.0, 3.0, 1.0].map(|offset| {
        let k: f64 = (offset + at) % 6.0;
        let part = k.min(4.0 - k).clamp(0.0, 1.0);
        (255.0 * (0.728_5 - 0.517 * part)).round() as u8
    })
}

/// Returns the colour of a demonstration: that of the HTML page, rounded to [`HUES`] hues. Multiples of the golden angle, 137.508
/// degrees, give neighbouring numbers hues that differ most.
fn demo_colour(demo: u32) -> [u8; 3] {
    let fraction = (f64::from(demo) * 137.508 / 360.0).fract();
    hue_colour((fraction * HUES as f64) as usize % HUES)
}

/// Height of the strip below the image: the timeline, the phases, and two lines of text.
fn strip_height(size: u32) -> u32 {
    match text_scale(size) {
        0 => 9,
        scale => scale * 35,
    }
}

/// Adds the strip below an image.
fn strip(pixels: &mut Vec<u8>, size: u32, rollout: &SceneRollout, at: usize, palette: &mut Palette) {
    let (side, scale) = (size as usize, text_scale(size) as usize);
    let start = pixels.len();
    pixels.resize(start + side * strip_height(size) as usize, palette.of(PAPER));
    let strip = &mut pixels[start..];
    let last = rollout.states.len() - 1;
    let (band, thin) = ((7 * scale).max(6), (3 * scale).max(3));
    let reached = (side * at).checked_div(last).unwrap_or(side);
    for x in 0..side {
        let state = rollout.states[(x * last.max(1) / side).min(last)];
        let (demo, phase) = if x < reached {
            (state.demo.map_or(INK, demo_colour), phase_of(state.phase).1)
        } else {
            (BAR, PAPER)
        };
        let (demo, phase) = (palette.of(demo), palette.of(phase));
        for row in 0..band {
            strip[row * side + x] = demo;
        }
        for row in band..band + thin {
            strip[row * side + x] = phase;
        }
    }
    if scale == 0 {
        return;
    }
    let state = rollout.states[at];
    let margin = 3 * scale;
    let ink = palette.of(INK);
    let first = format!("SEED {} STEP {at} OF {last}", rollout.seed);
    text::write(strip, side, (margin, 15 * scale), scale, &first, ink);
    let (word, colour) = match (at == last, rollout.success) {
        (true, true) => ("SUCCESS", SUCCEEDED),
        (true, false) => ("FAILED", FAILED),
        _ if rollout.disturbance.is_some_and(|step| is_announced(step, at)) => ("DISTURBED", FAILED),
        _ => phase_of(state.phase),
    };
    let right = side.saturating_sub(margin + text::width(word, scale));
    text::write(strip, side, (right, 25 * scale), scale, word, palette.of(colour));
    if let Some(demo) = state.demo {
        let name = rollout.names.get(&demo).map_or("", String::as_str);
        let words = text::fitting(&name.to_uppercase(), right.saturating_sub(2 * margin), scale);
        text::write(
            strip,
            side,
            (margin, 25 * scale),
            scale,
            &words,
            palette.of(demo_colour(demo)),
        );
    }
}

fn phase_of(phase: Phase) -> (&'static str, [u8; 3]) {
    match phase {
        Phase::Plan | Phase::Bridge => ("BRIDGE", PLAN),
        Phase::Replay => ("REPLAY", REPLAY),
        Phase::Home => ("HOME", HOME),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn rollout(states: usize) -> SceneRollout {
        let state = |i| SceneState {
            demo: (i % 3 != 2).then_some(i as u32 / 3),
            phase: if i % 3 == 2 { Phase::Home } else { Phase::Replay },
        };
        SceneRollout {
            seed: 200_000,
            success: true,
            disturbance: None,
            states: (0..states).map(state).collect(),
            names: BTreeMap::from([(0, "demo_4".to_owned())]),
        }
    }

    fn video(rollouts: &[SceneRollout], size: u32) -> (VideoSummary, Vec<u8>) {
        let mut bytes = Vec::new();
        let settings = VideoSettings { size, speed: 1.0 };
        let mut render = |number: usize, state: usize| {
            let colour = [200 - number as u8 * 50, 10, state as u8];
            Ok(colour.repeat((size * size) as usize))
        };
        let summary = write_scene_video(&mut bytes, rollouts, settings, &mut render, &mut || true).unwrap();
        (summary, bytes)
    }

    #[test]
    fn every_state_is_a_frame_with_its_image_and_its_timeline() {
        let size = 64;
        let (summary, bytes) = video(&[rollout(9), rollout(4)], size);
        assert_eq!((summary.width, summary.height, summary.frames), (128, 64 + 9, 9));
        assert_eq!(summary.duration_cs, 8 * 5 + 100);
        let mut options = gif::DecodeOptions::new();
        options.set_color_output(gif::ColorOutput::RGBA);
        let mut decoder = options.read_info(&bytes[..]).unwrap();
        let mut screen = vec![0_u8; 4 * 128 * 73];
        let mut frames = 0;
        while let Some(frame) = decoder.read_next_frame().unwrap() {
            for (i, pixel) in frame.buffer.chunks_exact(4).enumerate() {
                let (x, y) = (i % frame.width as usize, i / frame.width as usize);
                let at = 4 * ((y + frame.top as usize) * 128 + x + frame.left as usize);
                if pixel[3] > 0 {
                    screen[at..at + 4].copy_from_slice(pixel);
                }
            }
            let colour = |x: usize, y: usize| <[u8; 3]>::try_from(&screen[4 * (y * 128 + x)..][..3]).unwrap();
            // Red is exact; blue is as close as in the nearest image of the sample.
            assert_eq!(colour(5, 5)[..2], [200, 10]);
            assert!(
                colour(5, 5)[2].abs_diff(frames) <= 4,
                "state {frames}: {:?}",
                colour(5, 5)
            );
            assert_eq!(colour(64 + 5, 5)[0], 150);
            // After the first step, the first eighth of the timeline has the colour of the first demonstration.
            assert_eq!(colour(2, 66), if frames > 0 { demo_colour(0) } else { BAR });
            frames += 1;
        }
        assert_eq!(frames, 9);
        assert!(video(&[rollout(9), rollout(4)], size).1 == bytes);
    }

    #[test]
    fn consecutive_demonstrations_have_different_colours() {
        let colours: std::collections::BTreeSet<[u8; 3]> = (0..5).map(demo_colour).collect();
        assert_eq!(colours.len(), 5);
        for hue in 0..HUES {
            let [minimum, maximum] = [hue_colour(hue).into_iter().min(), hue_colour(hue).into_iter().max()];
            assert_eq!((minimum, maximum), (Some(54), Some(186)));
        }
    }

    #[test]
    fn an_image_that_cannot_be_rendered_ends_the_video() {
        let mut render = |_: usize, _: usize| Err("no OpenGL".into());
        let settings = VideoSettings { size: 64, speed: 1.0 };
        let error = write_scene_video(Vec::new(), &[rollout(2)], settings, &mut render, &mut || true).unwrap_err();
        assert_eq!(error.to_string(), "no OpenGL");
    }
}
