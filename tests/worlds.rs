//! Rollouts with goals elsewhere, disturbances, old observations and noisy poses.

use re4_artifact::Stage;
use re4_geometry::Pose2;
use re4_policy::kinds::PlaneRe4Row;
use re4_rollout::{Displaced, PlaneDecisionRow, PlaneResultRow, PlaneStepRow, PlaneWorldRow};
use re4_sim::{GOAL, coverage, depth_in_walls, random_goal};
use serde_json::Value;

use crate::support::{Place, assert_same_bytes};

/// Settings of a disturbance that every episode of the small dataset has.
const DISTURBED: &str = "--set rollout.disturbance.steps=[2,6] --set rollout.disturbance.translation=25 \
     --set rollout.disturbance.rotation=0.3 --set rollout.disturbance.kind=either";

fn rolled(place: &Place, arguments: &str) -> Value {
    place
        .run(&format!("rollout small.toml {arguments} --no-images --json"))
        .done()
        .json()
}

#[test]
fn bad_settings_are_refused_in_one_sentence() {
    let place = Place::empty();
    let refused = |arguments: &str| place.run(&format!("rollout small.toml {arguments}")).refused_at_once();
    for (arguments, expected) in [
        (
            "--set rollout.goal=[20,256,0]",
            "rollout.goal is [20, 256, 0], where the block would reach 47.0 px into a wall; give a pose with the whole block between 7 and 504 px",
        ),
        (
            "--set rollout.goal=center",
            "\"center\" is not a goal; write \"random\", or [x, y, theta] in pixels and radians",
        ),
        ("--set rollout.goal=[1,2]", "[1,2] is not a goal; write \"random\""),
        ("--set rollout.goal=[\"a\",1,2,3]", "is not a goal; write \"random\""),
        ("--set rollout.goal=[256,nan,0]", "rollout.goal is nan"),
        ("--set rollout.latency=-1", "rollout.latency"),
        ("--set rollout.latency=11", "rollout.latency is 11; give 0 to 10"),
        (
            "--set rollout.latncy=1",
            "unknown key rollout.latncy (did you mean latency?)",
        ),
        ("--set rollout.disturbance.steps=[9,3]", "missing field"),
        (
            "--set rollout.disturbance={steps=[9,3],translation=1,rotation=0}",
            "rollout.disturbance.steps is [9, 3], and an episode has the steps 0 to",
        ),
        (
            "--set rollout.disturbance={steps=[1,100000],translation=1,rotation=0}",
            "rollout.disturbance.steps is [1, 100000], and an episode has the steps 0 to",
        ),
        (
            "--set rollout.disturbance={steps=[1,2],translation=-1,rotation=0}",
            "rollout.disturbance.translation is -1 px; give 0 to 100.00",
        ),
        (
            "--set rollout.disturbance={steps=[1,2],translation=1,rotation=4}",
            "rollout.disturbance.rotation is 4 rad; give 0 to 3.14",
        ),
        (
            "--set rollout.disturbance={steps=[1,2],translation=1,rotation=0,kind=\"wall\"}",
            "unknown variant `wall`, expected one of `object`, `pusher`, `either`",
        ),
        (
            "--set rollout.disturbance={steps=[1,2],translation=1,rotation=0,step=3}",
            "unknown key rollout.disturbance.step",
        ),
        (
            "--set rollout.noise.translation=200",
            "rollout.noise.translation is 200 px; give 0 to 100.00",
        ),
        (
            "--set rollout.noise.translation=1 --set variant=image --set pose.source=log_polar",
            "variant is \"image\", but rollout.noise adds errors to recorded poses only; remove rollout.noise",
        ),
    ] {
        let message = refused(arguments);
        assert!(message.contains(expected), "{arguments}: {message}");
        assert_eq!(message.trim_end().lines().count(), 1, "{message}");
    }
}

#[test]
fn settings_of_the_task_keep_the_key_and_the_goal_of_the_task_keeps_the_tables() {
    let place = Place::new();
    let plain = rolled(&place, "")["artifact"].clone();
    assert_eq!(rolled(&place, "--set rollout.latency=0")["artifact"], plain);
    let tables = |artifact: &Value| {
        let folder = place.path().join(artifact.as_str().unwrap());
        ["results", "steps", "decisions", "decisions_re4"]
            .map(|name| std::fs::read(folder.join(name).with_extension("parquet")).unwrap())
    };
    let goal = format!("--set rollout.goal=[{},{},{}]", GOAL.x, GOAL.y, GOAL.theta);
    let same = rolled(&place, &goal)["artifact"].clone();
    assert_ne!(same, plain);
    assert!(tables(&same) == tables(&plain), "the goal of the task changes no byte");
    for other in ["--set rollout.latency=1", "--set rollout.goal=random", DISTURBED] {
        let artifact = rolled(&place, other)["artifact"].clone();
        assert!(tables(&artifact) != tables(&plain), "{other}");
    }
}

#[test]
fn threads_do_not_change_the_artifacts() {
    let arguments = format!(
        "rollout small.toml {DISTURBED} --set rollout.goal=random --set rollout.latency=1 --set rollout.noise.translation=1"
    );
    let bytes = |jobs: u32| {
        let place = Place::new();
        place.run(&format!("{arguments} --jobs {jobs}")).done();
        place.bytes()
    };
    assert_same_bytes(&bytes(1), &bytes(3));
}

fn close(a: Pose2, b: Pose2) -> bool {
    let turn = (a.theta - b.theta).sin().abs();
    (a.translation() - b.translation()).norm() < 1e-6 && turn < 1e-6
}

#[test]
fn tables_have_the_goal_and_are_in_the_world_frame() {
    let place = Place::new();
    place.run("rollout small.toml --set rollout.goal=random").done();
    let rollouts = place.artifact(Stage::Rollout);
    let worlds: Vec<PlaneWorldRow> = rollouts.read().unwrap();
    let results: Vec<PlaneResultRow> = rollouts.read().unwrap();
    let steps: Vec<PlaneStepRow> = rollouts.read().unwrap();
    let decisions: Vec<PlaneDecisionRow> = rollouts.read().unwrap();
    let details: Vec<PlaneRe4Row> = rollouts.read().unwrap();
    assert_eq!(worlds.len(), results.len());
    assert!(
        worlds
            .iter()
            .all(|world| world.disturbance_step.is_none() && depth_in_walls(world.goal) == 0.0)
    );
    let goal_of = |seed: u32| worlds.iter().find(|world| world.seed == seed).unwrap().goal;
    for (world, result) in worlds.iter().zip(&results) {
        assert_eq!(world.seed, result.core.seed);
        assert_eq!(world.goal, random_goal(world.seed, result.object));
        assert!(coverage(result.object, world.goal) <= 0.55);
    }
    for step in &steps {
        assert!((step.coverage - coverage(step.object, goal_of(step.core.seed))).abs() < 1e-9);
        assert!((0.0..=512.0).contains(&step.action.x) && (0.0..=512.0).contains(&step.action.y));
    }
    let before = |seed: u32, step: u32| {
        let own = steps
            .iter()
            .filter(|row| row.core.seed == seed && row.core.step + 1 == step);
        let result = results.iter().find(|row| row.core.seed == seed).unwrap();
        own.map(|row| (row.eef, row.object))
            .next()
            .unwrap_or((result.eef, result.object))
    };
    for (decision, detail) in decisions.iter().zip(&details) {
        let (eef, object) = before(decision.core.seed, decision.core.step);
        assert!((decision.query_eef - eef).norm() < 1e-6);
        assert!(close(decision.query_object.unwrap(), object));
        let start = &detail.plan_path[..2];
        assert!(
            (start[0] - eef.x).hypot(start[1] - eef.y) < 1e-6,
            "the plan starts at the pusher"
        );
        let predicted = coverage(detail.predicted_object, goal_of(detail.seed));
        assert!((predicted - detail.predicted_coverage).abs() < 1e-6);
    }
    assert!(!details.is_empty());
}

#[test]
fn pages_and_videos_show_goals_and_disturbances() {
    let place = Place::new();
    place
        .run(&format!("rollout small.toml {DISTURBED} --set rollout.goal=random"))
        .done();
    let rollouts = place.artifact(Stage::Rollout);
    let worlds: Vec<PlaneWorldRow> = rollouts.read().unwrap();
    let disturbed: Vec<&PlaneWorldRow> = worlds.iter().filter(|world| world.disturbance_step.is_some()).collect();
    assert!(!disturbed.is_empty());
    for world in &disturbed {
        assert!((2..7).contains(&world.disturbance_step.unwrap()));
        let motion = world.displacement.unwrap();
        assert!((motion.translation().norm() - 25.0).abs() < 1e-9);
        let turned = world.disturbed == Some(Displaced::Object);
        assert_eq!(motion.theta.abs(), if turned { 0.3 } else { 0.0 });
    }
    let folder = rollouts.path().display().to_string();
    place.run(&format!("report {folder} -o page.html")).done();
    let page = std::fs::read_to_string(place.path().join("page.html")).unwrap();
    assert!(page.contains("random goals · object or pusher disturbed before step 2 to 6"));
    assert!(page.contains("moved by 25 px"));
    assert!(page.contains("\"goal\":[["), "every rollout has its goal");
    let seed = disturbed[0].seed;
    place
        .run(&format!("video {folder} one.gif --seeds {seed} --size 128"))
        .done();
    place
        .run(&format!("inspect {folder} --seed {seed} --image one.svg"))
        .done();
}
