//! Blocks in a corner, where most recorded pushes would move the block or the pusher into a wall. The scenes are sampled for this
//! test only.

mod common;

use common::{Random, distance_to_tee, knowledge, pusht, rollouts};
use re4_geometry::{Point2, Pose2};
use re4_index::AngleMetric;
use re4_policy::PolicyConfig;
use re4_rollout::{Plane, PlaneScene, Start};
use re4_sim::{GOAL, ResetOrder, Scene, tee_vertices};

/// Samples scenes in which the block is close to two walls.
fn cornered(count: u32) -> Vec<Start<Plane>> {
    let mut random = Random::new(200_000);
    let mut starts = Vec::new();
    while starts.len() < count as usize {
        let at = random.point(0.0, 512.0);
        let block = Pose2::new(at.x, at.y, random.range(0.0, std::f64::consts::TAU));
        let vertices = tee_vertices(block);
        let nearest = vertices
            .iter()
            .flatten()
            .flat_map(|p| [p.x, p.y, 512.0 - p.x, 512.0 - p.y])
            .fold(f64::MAX, f64::min);
        let centre = block.transform_point(Point2::new(0.0, 45.0));
        let near_wall = |v: f64| !(140.0..=372.0).contains(&v);
        if !(7.0..30.0).contains(&nearest) || !near_wall(centre.x) || !near_wall(centre.y) {
            continue;
        }
        let agent = random.point(25.0, 487.0);
        if distance_to_tee(block, agent) >= 22.0 {
            starts.push(Start {
                seed: 200_000 + starts.len() as u32,
                scene: PlaneScene {
                    state: Scene { agent, block },
                    order: ResetOrder::PoseIsPose,
                    goal: GOAL,
                },
            });
        }
    }
    starts
}

#[test]
fn a_block_in_a_corner_is_moved_out_of_it() {
    let Some(demos) = pusht() else { return };
    let knowledge = knowledge(demos, AngleMetric::Periodic);
    // In these of the first 600 scenes, a policy that uses the cheapest chunk even if no path to it exists pushes the block
    // through a wall.
    let hard = [94, 128, 300, 359, 412, 435, 476, 485, 501];
    let starts: Vec<Start<Plane>> = cornered(600)
        .into_iter()
        .filter(|start| hard.contains(&(start.seed - 200_000)))
        .collect();
    let episodes =
        rollouts(&PolicyConfig::re4(), &knowledge, &starts, 500, &|| true).unwrap_or_else(|error| panic!("{error}"));
    let solved = episodes.iter().filter(|episode| episode.success()).count();
    assert_eq!(solved, hard.len());
}

/// The policy solves nearly all of `CORNERS` scenes in corners (an environment variable, default 60).
#[test]
fn nearly_all_blocks_in_corners_reach_the_goal() {
    let Some(demos) = pusht() else { return };
    let knowledge = knowledge(demos, AngleMetric::Periodic);
    let count = std::env::var("CORNERS").map_or(60, |text| text.parse().unwrap());
    let starts = cornered(count);
    let episodes =
        rollouts(&PolicyConfig::re4(), &knowledge, &starts, 500, &|| true).unwrap_or_else(|error| panic!("{error}"));
    let unsolved = episodes.iter().filter(|episode| !episode.success()).count();
    println!("{unsolved} of {count} scenes are not solved");
    assert!(unsolved * 20 <= count as usize, "{unsolved} of {count}");
}
