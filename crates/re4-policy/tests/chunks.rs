//! Chunks of demonstrations: which parts are chunks, how they are found by outcome, and how they are transformed.

mod common;

use std::collections::BTreeSet;
use std::num::NonZeroUsize;

use common::{LONGEST, OUTLINE, Random, distance_to_tee, scripted};
use re4_episode::{Mode, PlanarFrame};
use re4_geometry::{Point2, Pose2};
use re4_policy::{Body, Chunk, ChunkLibrary, DemoSet, LookupError, collect_chunks, reframe};
use re4_sim::{PushT, ResetOrder, Scene, Simulator as _};

fn chunks() -> (DemoSet<PlanarFrame>, Vec<Chunk>) {
    let demos = DemoSet::new(common::without_modes(scripted(8)));
    let chunks = collect_chunks(&demos, LONGEST);
    assert!(chunks.len() > 500, "{}", chunks.len());
    (demos, chunks)
}

#[expect(clippy::unwrap_used, reason = "a panic is how a test fails")]
fn frames_of<'a>(demos: &'a DemoSet<PlanarFrame>, chunk: &Chunk) -> &'a [PlanarFrame] {
    &demos.demo(chunk.demo).unwrap()[chunk.start as usize..=chunk.end as usize]
}

#[test]
fn a_chunk_starts_free_of_the_block_and_moves_it() {
    let (demos, chunks) = chunks();
    for chunk in &chunks {
        let frames = frames_of(&demos, chunk);
        let (first, last) = (frames[0], frames[frames.len() - 1]);
        assert!(frames.len() >= 2 && frames.len() <= LONGEST + 1);
        assert!(distance_to_tee(first.object, first.eef) >= 16.0 - 1e-9, "{chunk:?}");
        assert_ne!(first.object, last.object, "{chunk:?}");
        let predicted = first.object.compose(chunk.motion);
        assert!(
            (predicted.translation() - last.object.translation()).norm() < 1e-9,
            "{chunk:?}"
        );
        assert!((predicted.theta - last.object.theta).sin().abs() < 1e-9, "{chunk:?}");
        let travel: f64 = frames.windows(2).map(|w| (w[1].eef - w[0].eef).norm()).sum();
        assert!((chunk.travel - travel).abs() < 1e-9, "{chunk:?}");
        let displaced = Body::tee().distance(first.object, last.object);
        assert!(chunk.pushed >= displaced - 1e-9, "{chunk:?} moved {displaced}");
    }
    let key = |c: &Chunk| (c.demo, c.start, c.end);
    assert!(chunks.windows(2).all(|w| key(&w[0]) < key(&w[1])));
}

#[test]
fn a_shorter_limit_gives_the_chunks_within_it() {
    let (demos, all) = chunks();
    let short = collect_chunks(&demos, 12);
    let expected: Vec<Chunk> = all.into_iter().filter(|c| c.end - c.start <= 12).collect();
    assert_eq!(short, expected);
}

#[test]
fn leaving_out_demonstrations_at_the_query_is_a_library_without_them() {
    let (_, chunks) = chunks();
    let all = ChunkLibrary::build(chunks.clone()).unwrap();
    for without in [vec![], vec![0], vec![2, 5], vec![0, 1, 2, 3, 4, 5, 6]] {
        let without: BTreeSet<u32> = without.into_iter().collect();
        let rest: Vec<Chunk> = chunks.iter().copied().filter(|c| !without.contains(&c.demo)).collect();
        assert_eq!(all.len_without(&without), rest.len());
        let library = ChunkLibrary::build(rest).unwrap();
        for number in 0..20 {
            let wanted = Pose2::new(f64::from(number) * 7.3 - 60.0, 31.1, f64::from(number) * 0.31);
            for count in [1, 10, 300, 100_000] {
                let count = NonZeroUsize::new(count).unwrap();
                let distances = |found: Vec<(f64, Chunk)>| found.into_iter().map(|(d, _)| d).collect::<Vec<_>>();
                let found = all.nearest_without(wanted, count, &without);
                assert!(found.iter().all(|(_, chunk)| !without.contains(&chunk.demo)));
                assert_eq!(distances(found), distances(library.nearest(wanted, count)));
            }
        }
    }
}

#[test]
fn the_distance_of_poses_is_the_rms_displacement_of_the_points() {
    // The points of a fine lattice inside the outline; each represents its cell.
    let points: Vec<Point2> = (-240..240)
        .flat_map(|i| (0..480).map(move |j| Point2::new((f64::from(i) + 0.5) * 0.25, (f64::from(j) + 0.5) * 0.25)))
        .filter(|&p| distance_to_tee(Pose2::IDENTITY, p) == 0.0)
        .collect();
    let area = OUTLINE
        .iter()
        .zip(OUTLINE.iter().cycle().skip(1))
        .map(|(a, b)| 0.5 * (a[0] * b[1] - a[1] * b[0]))
        .sum::<f64>();
    assert!((points.len() as f64 / 16.0 - area).abs() < 1e-6 * area);
    let mut random = Random::new(1);
    for _ in 0..20 {
        let (a, b) = (random.block(), random.block());
        let mean = points
            .iter()
            .map(|&p| (a.transform_point(p) - b.transform_point(p)).norm_squared())
            .sum::<f64>()
            / points.len() as f64;
        let distance = Body::tee().distance(a, b);
        assert!(
            (distance - mean.sqrt()).abs() < 0.01,
            "{a:?}, {b:?}: {distance}, {}",
            mean.sqrt()
        );
    }
}

#[test]
fn nearest_agrees_with_a_scan_over_all_chunks() {
    let (_, chunks) = chunks();
    let library = ChunkLibrary::build(chunks.clone()).unwrap();
    let body = library.body();
    let mut random = Random::new(2);
    for round in 0..400 {
        let wanted = match round % 3 {
            0 => chunks[(random.range(0.0, 1.0) * chunks.len() as f64) as usize].motion,
            1 => Pose2::new(
                random.range(-80.0, 80.0),
                random.range(-80.0, 80.0),
                random.range(-2.0, 2.0),
            ),
            _ => Pose2::new(
                random.range(-400.0, 400.0),
                random.range(-400.0, 400.0),
                random.range(-9.0, 9.0),
            ),
        };
        let count = [1, 2, 17, 256, chunks.len(), chunks.len() + 10][round % 6];
        let found = library.nearest(wanted, NonZeroUsize::new(count).unwrap());
        let mut all: Vec<f64> = chunks.iter().map(|c| body.distance(c.motion, wanted)).collect();
        all.sort_by(f64::total_cmp);
        assert_eq!(found.len(), count.min(chunks.len()));
        for (i, (distance, chunk)) in found.iter().enumerate() {
            // The i-th distance is the i-th smallest of all, and belongs to the chunk that is returned with it.
            assert!((distance - all[i]).abs() < 1e-6, "{i}: {distance}, {}", all[i]);
            assert!(
                (distance - body.distance(chunk.motion, wanted)).abs() < 1e-6,
                "{chunk:?}"
            );
        }
        let mut keys: Vec<_> = found.iter().map(|(_, c)| (c.demo, c.start, c.end)).collect();
        keys.sort_unstable();
        keys.dedup();
        assert_eq!(keys.len(), found.len(), "no chunk is returned twice");
    }
}

#[test]
fn a_reframed_chunk_is_unchanged_in_the_block_frame() {
    let (demos, chunks) = chunks();
    let mut random = Random::new(3);
    for chunk in chunks.iter().step_by(7) {
        let frames = frames_of(&demos, chunk);
        let (object, eef) = (random.block(), random.point(0.0, 512.0));
        let carried = reframe(Mode::Transit, frames[0].object, frames[0].eef, object, eef);
        assert!((carried.near - carried.carry.transform_point(frames[0].eef)).norm() < 1e-9);
        let first = carried.carry.compose(frames[0].object);
        assert!(
            Body::tee().distance(first, object) < 1e-8,
            "the first frame has the block at the query's pose"
        );
        for frame in frames {
            let now = carried.carry.compose(frame.object);
            for (before, after) in [
                (frame.eef, carried.carry.transform_point(frame.eef)),
                (frame.action, carried.carry.transform_point(frame.action)),
            ] {
                let in_block_frame = frame.object.inverse_transform_point(before);
                assert!((now.inverse_transform_point(after) - in_block_frame).norm() < 1e-8);
            }
        }
        // The motion in the block frame is the recorded one at any pose.
        let last = carried.carry.compose(frames[frames.len() - 1].object);
        assert!(Body::tee().distance(object.compose(chunk.motion), last) < 1e-8);
    }
}

#[test]
fn a_reframed_chunk_pushes_the_block_as_recorded() {
    // This is the assumption behind Reframe and the outcome selector: pushing does not depend on where in the plane it happens.
    let (demos, chunks) = chunks();
    let mut simulator = PushT::new().unwrap();
    let mut random = Random::new(4);
    let mut errors: Vec<f64> = Vec::new();
    for chunk in chunks.iter().filter(|c| c.end - c.start <= 25 && c.pushed > 10.0) {
        let frames = frames_of(&demos, chunk);
        let object = Pose2::new(
            random.range(220.0, 290.0),
            random.range(220.0, 290.0),
            random.range(0.0, 6.0),
        );
        let carried = reframe(Mode::Transit, frames[0].object, frames[0].eef, object, frames[0].eef).carry;
        let inside = |p: Point2| (20.0..492.0).contains(&p.x) && (20.0..492.0).contains(&p.y);
        let clear = frames.iter().all(|f| {
            [f.object, carried.compose(f.object)].iter().all(|pose| {
                OUTLINE
                    .iter()
                    .all(|v| inside(pose.transform_point(Point2::new(v[0], v[1]))))
            }) && inside(carried.transform_point(f.eef))
        });
        if !clear {
            continue;
        }
        let start = Scene::from_observed(carried.transform_point(frames[0].eef), object);
        simulator.reset(&start, ResetOrder::Legacy).unwrap();
        for frame in &frames[..frames.len() - 1] {
            simulator.step(&carried.transform_point(frame.action)).unwrap();
        }
        let expected = object.compose(chunk.motion);
        errors.push(Body::tee().distance(simulator.observation().block, expected) / chunk.pushed);
    }
    assert!(errors.len() > 100, "{}", errors.len());
    errors.sort_by(f64::total_cmp);
    // The recorded pusher is already moving at the start of a chunk and the simulated one is at rest, so some chunks differ.
    let median = errors[errors.len() / 2];
    let p90 = errors[errors.len() * 9 / 10];
    assert!(
        median < 0.02 && p90 < 0.2,
        "median {median}, p90 {p90} of the recorded motion: {errors:?}"
    );
}

#[test]
fn demonstrations_without_a_push_have_no_chunks() {
    let resting: Vec<_> = (0..30)
        .map(|i| PlanarFrame {
            eef: Point2::new(30.0 + f64::from(i), 40.0),
            object: Pose2::new(300.0, 300.0, 1.0),
            action: Point2::new(31.0 + f64::from(i), 40.0),
            contacts: 0.0,
        })
        .collect();
    let chunks = collect_chunks(&DemoSet::new([(0, resting)]), LONGEST);
    assert!(chunks.is_empty());
    assert!(matches!(ChunkLibrary::build(chunks), Err(LookupError::NoChunks)));
    assert!(collect_chunks(&DemoSet::default(), LONGEST).is_empty());
}
