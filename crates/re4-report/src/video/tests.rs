use super::*;
use gif::{ColorOutput, DecodeOptions};

fn rollout(seed: u32, steps: usize) -> VideoRollout {
    let states = (0..=steps).map(|i| VideoState {
        pusher: Point2::new(100.0 + 12.0 * i as f64, 380.0),
        block: Pose2::new(300.0 - 2.0 * i as f64, 200.0, 0.02 * i as f64),
        coverage: i as f64 / steps.max(1) as f64,
        decision: usize::from(i > 3),
        replaying: i > 3,
    });
    let decision = |demo| VideoDecision {
        demo: format!("episode {demo}"),
        frames: (3, 17),
        plan: vec![Point2::new(100.0, 380.0), Point2::new(100.0, 450.0)],
        chunk: vec![Point2::new(400.0, 430.0), Point2::new(440.0, 430.0)],
    };
    VideoRollout {
        seed,
        goal: re4_sim::GOAL,
        disturbance: None,
        states: states.collect(),
        decisions: vec![decision(4), decision(9)],
    }
}

const PLAIN: VideoSettings = VideoSettings { size: 256, speed: 1.0 };

fn video(rollouts: &[VideoRollout], settings: VideoSettings) -> (Vec<u8>, VideoSummary) {
    let mut bytes = Vec::new();
    let summary = write_video(&mut bytes, rollouts, settings, &mut || true).unwrap();
    (bytes, summary)
}

/// The frames as a viewer shows them, in RGB, with their delays.
fn decoded(bytes: &[u8]) -> (usize, usize, Vec<(Vec<u8>, u16)>) {
    let mut options = DecodeOptions::new();
    options.set_color_output(ColorOutput::RGBA);
    let mut decoder = options.read_info(bytes).unwrap();
    let (width, height) = (usize::from(decoder.width()), usize::from(decoder.height()));
    let (mut screen, mut frames) = (vec![0; width * height * 3], Vec::new());
    while let Some(frame) = decoder.read_next_frame().unwrap() {
        let (left, top) = (usize::from(frame.left), usize::from(frame.top));
        for (row, pixels) in frame.buffer.chunks(4 * usize::from(frame.width)).enumerate() {
            for (column, pixel) in pixels.chunks(4).enumerate().filter(|(_, pixel)| pixel[3] > 0) {
                let at = 3 * ((top + row) * width + left + column);
                screen[at..at + 3].copy_from_slice(&pixel[..3]);
            }
        }
        frames.push((screen.clone(), frame.delay));
    }
    (width, height, frames)
}

/// The simulator's image of a state, scaled down.
fn image(state: &VideoState, size: usize) -> Vec<u8> {
    let mut small = Vec::new();
    let canvas = re4_sim::render_state(state.pusher, state.block);
    Shrink::new(Canvas::SIDE, size).apply(canvas.bytes(), &mut small);
    small
}

fn colour(pixels: &[u8], width: usize, (x, y): (usize, usize)) -> [u8; 3] {
    let at = 3 * (y * width + x);
    [pixels[at], pixels[at + 1], pixels[at + 2]]
}

#[test]
fn a_video_has_a_frame_for_every_state_and_lasts_as_long_as_the_rollout() {
    let (bytes, summary) = video(&[rollout(500, 20)], PLAIN);
    let (width, height, frames) = decoded(&bytes);
    assert_eq!((width, height), (256, 256 + 28));
    assert_eq!(
        summary,
        VideoSummary {
            width: 256,
            height: 284,
            frames: 21,
            duration_cs: 20 * 10 + 100
        }
    );
    let delays: Vec<u16> = frames.iter().map(|(_, delay)| *delay).collect();
    assert_eq!(delays, [[10; 20].as_slice(), &[100]].concat());
    assert_eq!(bytes, video(&[rollout(500, 20)], PLAIN).0, "the same bytes");
    assert!(bytes.len() < 40_000, "{} bytes", bytes.len());
}

#[test]
fn every_frame_is_the_simulators_image_with_overlaid_lines() {
    let rollout = rollout(500, 12);
    for size in [512, 256, 200] {
        let (bytes, _) = video(std::slice::from_ref(&rollout), VideoSettings { size, speed: 1.0 });
        let size = size as usize;
        let scale = size as f64 / 512.0;
        let (width, _, frames) = decoded(&bytes);
        for (state, (frame, _)) in rollout.states.iter().zip(&frames) {
            let expected = image(state, size);
            let mut lines = 0;
            for y in 0..size {
                for x in 0..size {
                    let (shown, plain) = (colour(frame, width, (x, y)), colour(&expected, size, (x, y)));
                    // The plan is vertical at x = 100, and the chunk is horizontal at y = 430; both are tested with some margin.
                    let (u, v) = ((x as f64 + 0.5) / scale, (y as f64 + 0.5) / scale);
                    let near = |value: f64, low: f64, high: f64| (low - 6.0..high + 6.0).contains(&value);
                    let on_line = near(u, 100.0, 100.0) && near(v, 380.0, 450.0)
                        || near(u, 400.0, 440.0) && near(v, 430.0, 430.0);
                    lines += usize::from(on_line && shown != plain);
                    // The palette has blends in steps of a quarter, so that the error is at most an eighth of the range of colours.
                    let error = (0..3).map(|c| shown[c].abs_diff(plain[c])).max().unwrap();
                    let tolerance = if size == 512 { 0 } else { 32 };
                    assert!(
                        on_line || error <= tolerance,
                        "size {size}: {shown:?} for {plain:?} at {x}, {y}"
                    );
                }
            }
            assert!(lines > 50, "size {size}: the lines are missing");
        }
        // If lines are wide enough, their middle has exactly the colours of plan and chunk.
        if size >= 256 {
            let at = |x: f64, y: f64| ((x * scale) as usize, (y * scale) as usize);
            assert_eq!(colour(&frames[0].0, width, at(100.0, 430.0)), PLAN);
            assert_eq!(colour(&frames[0].0, width, at(420.0, 430.0)), REPLAY);
        }
    }
}

#[test]
fn the_bar_shows_the_coverage() {
    let (bytes, _) = video(&[rollout(500, 20)], PLAIN);
    let (width, _, frames) = decoded(&bytes);
    for (state, (frame, _)) in frames.iter().enumerate() {
        let filled = (0..256).filter(|x| {
            let shown = colour(frame, width, (*x, 257));
            shown == Canvas::OUTLINE || shown == SUCCEEDED
        });
        // A bar that is longer than the mark at 0.95 has one pixel less, because the mark covers it.
        let expected = (state as f64 / 20.0 * 256.0).round() as usize - usize::from(state > 19);
        assert_eq!(filled.count(), expected, "state {state}");
    }
    assert_eq!(colour(&frames[20].0, width, (0, 257)), SUCCEEDED);
    assert_eq!(colour(&frames[19].0, width, (0, 257)), Canvas::OUTLINE);
}

#[test]
fn speed_changes_the_duration_and_skips_states_if_necessary() {
    for (speed, frames, duration) in [
        (1.0, 21, 200),
        (0.5, 21, 400),
        (3.0, 21, 67),
        (5.0, 21, 40),
        (8.0, 11, 25),
        (20.0, 6, 10),
        (50.0, 3, 4),
    ] {
        let (bytes, summary) = video(&[rollout(1, 20)], VideoSettings { size: 64, speed });
        let (_, _, shown) = decoded(&bytes);
        assert_eq!((shown.len(), summary.frames), (frames, frames as u32), "speed {speed}");
        assert_eq!(summary.duration_cs, duration + 100, "speed {speed}");
        assert!(
            shown.iter().all(|(_, delay)| *delay >= 2),
            "speed {speed}: {:?}",
            shown.iter().map(|f| f.1).collect::<Vec<_>>()
        );
        // The last state is never skipped.
        let (whole, _) = video(&[rollout(1, 20)], VideoSettings { size: 64, speed: 1.0 });
        assert!(
            shown.last().unwrap().0 == decoded(&whole).2.last().unwrap().0,
            "speed {speed}"
        );
    }
}

#[test]
fn several_rollouts_are_tiles_and_short_ones_stay_in_their_last_state() {
    let rollouts = [rollout(1, 4), rollout(2, 9), rollout(3, 0)];
    let settings = VideoSettings { size: 80, speed: 1.0 };
    let (bytes, summary) = video(&rollouts, settings);
    let (width, height, frames) = decoded(&bytes);
    assert_eq!((width, height, frames.len(), summary.frames), (160, 2 * 84, 10, 10));
    for (number, rollout) in rollouts.iter().enumerate() {
        let single = decoded(&video(std::slice::from_ref(rollout), settings).0).2;
        for (state, (frame, _)) in frames.iter().enumerate() {
            let expected = &single[state.min(single.len() - 1)].0;
            for y in 0..84 {
                let start = 3 * ((number / 2 * 84 + y) * width + number % 2 * 80);
                assert!(
                    frame[start..start + 240] == expected[240 * y..240 * (y + 1)],
                    "tile {number}, state {state}, row {y}"
                );
            }
        }
    }
}

#[test]
fn invalid_settings_and_rollouts_are_refused() {
    let one = [rollout(7, 2)];
    let error = |rollouts: &[VideoRollout], size, speed| {
        write_video(Vec::new(), rollouts, VideoSettings { size, speed }, &mut || true)
            .unwrap_err()
            .to_string()
    };
    assert_eq!(error(&[], 256, 1.0), "a video can show 1 to 100 rollouts, not 0");
    assert_eq!(
        error(&vec![one[0].clone(); 101], 256, 1.0),
        "a video can show 1 to 100 rollouts, not 101"
    );
    assert_eq!(
        error(&one, 63, 1.0),
        "the size of a video has to be 64 to 512 px, not 63"
    );
    assert_eq!(
        error(&one, 513, 1.0),
        "the size of a video has to be 64 to 512 px, not 513"
    );
    assert_eq!(
        error(&one, 256, f64::NAN),
        "the speed of a video has to be 0.1 to 50, not NaN"
    );
    assert_eq!(error(&one, 256, 0.0), "the speed of a video has to be 0.1 to 50, not 0");
    let empty = VideoRollout {
        states: Vec::new(),
        ..one[0].clone()
    };
    assert_eq!(error(&[empty], 256, 1.0), "the rollout of seed 7 has no states to show");
    let mut remaining = 2;
    let stopped = write_video(Vec::new(), &one, PLAIN, &mut || {
        remaining -= 1;
        remaining > 0
    });
    assert!(matches!(stopped, Err(VideoError::Interrupted)));
}

#[test]
fn states_that_are_outside_or_not_finite_are_still_frames() {
    let mut odd = rollout(7, 2);
    odd.states[0].pusher = Point2::new(f64::NAN, 1e300);
    odd.states[1].block = Pose2::new(f64::INFINITY, 0.0, f64::NAN);
    odd.states[1].coverage = f64::NAN;
    odd.states[2].decision = 99;
    odd.decisions[0].plan = vec![
        Point2::new(-1e300, 0.0),
        Point2::new(1e300, 5.0),
        Point2::new(f64::NAN, 0.0),
    ];
    let (bytes, _) = video(&[odd], PLAIN);
    assert_eq!(decoded(&bytes).2.len(), 3);
}
