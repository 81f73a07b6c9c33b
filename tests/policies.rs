//! Kinds of policies: the table `[policy]`, and how its older form is read.

use std::sync::Arc;

use re4_artifact::{Artifact, ArtifactSummary, Label, Recipe, Stage, Store, col_f64, col_u32, col_u32_or_null, table};
use re4_episode::Mode;
use re4_geometry::{Point2, Pose2};
use re4_policy::kinds::{AltRow, GpiRow, GpiTunedRow, NearestRow, PlaneRe4Row, VinnRow};
use re4_rollout::{PlaneDecisionRow, PlaneStepRow, SpaceStepRow};
use re4_stages::testing::{Estimate, MockRun};
use serde_json::Value;

use crate::image_rollouts::{recorded, write_poses};
use crate::support::{Answer, Place, folders_in, repository, scripted_and_simulators};

/// The program's JSON output for a rollout with these arguments.
fn rolled(place: &Place, arguments: &str) -> Value {
    place
        .run(&format!("rollout {arguments} --no-images --json"))
        .done()
        .json()
}

/// Writes `current.toml`, which is `small.toml` with a table `[policy]`, and `older.toml`, which has the older form.
fn write_pipelines(place: &Place) {
    let small = std::fs::read_to_string(place.path().join("small.toml")).unwrap();
    let text = small.replace("policy = \"re4\"\n", "") + "\n[policy]\nkind = \"re4\"\n[policy.replan]\nkeepout = 19\n";
    place.write("current.toml", text);
    place.write("older.toml", small + "\n[rollout.replan]\nkeepout = 19\n");
}

#[test]
fn an_older_file_gives_the_same_artifact() {
    let place = Place::new();
    write_pipelines(&place);
    let key = |arguments: &str| rolled(&place, arguments)["artifact"].clone();
    let one = key("current.toml");
    assert_eq!(key("older.toml"), one);
    assert_ne!(key("small.toml"), one);
    assert_eq!(key("small.toml --set rollout.replan.keepout=19"), one);
    assert_eq!(key("small.toml --set policy.replan.keepout=19"), one);
    let other = key("current.toml --set policy.kind=re2");
    for form in [
        "current.toml --set rollout.policy=re2",
        "older.toml --set rollout.policy=re2",
        "older.toml --policy re2",
    ] {
        assert_eq!(key(form), other, "{form}");
    }
}

#[test]
fn settings_of_another_kind_are_refused_by_name() {
    let place = Place::empty();
    write_pipelines(&place);
    let error_of = |arguments: &str| place.run(&format!("rollout {arguments}")).refused_at_once();
    for (arguments, expected) in [
        (
            "current.toml --set policy.kind=re44",
            "unknown policy \"re44\" in policy.kind (did you mean re4?)",
        ),
        (
            "current.toml --set policy.recovery.check=step",
            "unknown key policy.recovery; the known keys are retrieve, reframe, replan, replay, kind",
        ),
        (
            "current.toml --set rollout.fidelity=fast",
            "unknown key rollout.fidelity",
        ),
        (
            "current.toml --set policy.replan.keepot=1",
            "unknown key policy.replan.keepot (did you mean keepout?)",
        ),
        ("current.toml --set policy=re4", "policy is \"re4\"; give a table"),
        (
            "current.toml --set rollout={policy=\"re4\"}",
            "rollout.policy and a table [policy] both define the policy; replace rollout.policy by policy.kind",
        ),
    ] {
        let sentence = error_of(arguments);
        assert!(sentence.contains(expected), "{arguments}: {sentence}");
    }
}

/// Asserts that the nearest neighbour policy executes, at every step, the recorded action of the frame that it retrieved.
fn replays_the_nearest(rollouts: &Artifact, actions: &[(&str, &str)], index: &Artifact) {
    let (steps, decisions) = (crate::support::steps(rollouts), crate::support::decisions_of(rollouts));
    let details = rollouts.read::<NearestRow>().unwrap();
    assert_eq!(steps.num_rows(), decisions.num_rows(), "one decision per step");
    assert_eq!(details.len(), decisions.num_rows());
    let frames = index.table_named("index").unwrap().read_all().unwrap();
    let place: std::collections::BTreeMap<_, _> = col_u32(&frames, "episode")
        .unwrap()
        .iter()
        .zip(col_u32(&frames, "frame").unwrap())
        .enumerate()
        .map(|(row, (episode, frame))| ((*episode, *frame), row))
        .collect();
    let demos = col_u32_or_null(&decisions, "demo").unwrap();
    let numbers = col_u32_or_null(&decisions, "demo_frame").unwrap();
    for (sent, recorded) in actions {
        let (sent, recorded) = (col_f64(&steps, sent).unwrap(), col_f64(&frames, recorded).unwrap());
        for row in 0..steps.num_rows() {
            let at = place[&(demos[row].unwrap(), numbers[row].unwrap())];
            assert!((sent[row] - recorded[at]).abs() < 1e-9, "{row}");
        }
    }
    assert!(details.iter().all(|row| row.distance.is_finite() && row.compared > 0));
}

#[test]
fn the_nearest_neighbour_runs_on_push_t_from_state_and_image() {
    let place = Place::new();
    place.write_image();
    for file in ["small.toml", "image.toml"] {
        let _ = std::fs::remove_dir_all(place.artifacts());
        place.run(&format!("rollout {file} --policy nearest")).done();
        let (rollouts, index) = (place.artifact(Stage::Rollout), place.artifact(Stage::Index));
        replays_the_nearest(&rollouts, &[("action_x", "action_x"), ("action_y", "action_y")], &index);
        let asked = rollouts.read::<PlaneStepRow>().unwrap();
        let images = u32::from(file == "image.toml");
        assert!(asked.iter().all(|row| row.core.asked_object == Some(true)));
        assert!(asked.iter().all(|row| row.core.asked_images == Some(images)), "{file}");
    }
    // With a longer horizon, it retrieves and observes less often.
    place
        .run("rollout image.toml --policy nearest --set policy.horizon=5 --artifacts longer")
        .done();
    let folder = folders_in(&place.path().join("longer/rollouts")).remove(0);
    let rows = Artifact::open(&folder).unwrap().read::<PlaneStepRow>().unwrap();
    let asked = rows.iter().filter(|row| row.core.asked_object == Some(true)).count();
    assert!(5 * asked < rows.len() + 60, "{asked} of {}", rows.len());
    let refused = place
        .run("rollout small.toml --policy nearest --set policy.horizn=2")
        .refused_at_once();
    assert!(
        refused.contains("unknown key policy.horizn (did you mean horizon?)"),
        "{refused}"
    );
    let refused = place
        .run("rollout small.toml --policy nearest --set policy.horizon=0")
        .refused_at_once();
    assert!(refused.contains("policy.horizon is 0; give 1 or more"), "{refused}");
}

#[test]
fn the_nearest_neighbour_runs_on_lift_from_state_and_image() {
    let Some((data, simulators)) = scripted_and_simulators() else {
        return;
    };
    std::env::set_current_dir(repository()).unwrap();
    let place = Place::empty();
    let write = |variant: &str, pose: &str| {
        let text = format!(
            "task = \"lift\"\nvariant = \"{variant}\"\n[ingest]\nsource = \"{}\"\nselect = {{ first = 20 }}\n[segment]\n[pose]\nsource = \"{pose}\"\n[index]\n[policy]\nkind = \"nearest\"\n[rollout]\nseeds = \"200000..200002\"\nmax_steps = 60\n",
            data.join("lift/low_dim.hdf5").display()
        );
        place.write(&format!("{variant}.toml"), text);
    };
    write("state", "recorded");
    write("image", "encoder");
    let mut command = place.command();
    let answer = command
        .env("RE4_SIMULATORS", &simulators)
        .args(["rollout", "state.toml"])
        .output();
    Answer::new(&answer.unwrap(), place.path()).done();
    let goal = [
        ("action_x", "goal_x"),
        ("action_y", "goal_y"),
        ("action_z", "goal_z"),
        ("gripper", "gripper"),
    ];
    let index = place.artifact(Stage::Index);
    let state = place.artifact(Stage::Rollout);
    replays_the_nearest(&state, &goal, &index);
    // From images, with an encoder without errors, the actions are the same.
    let episodes = place.artifact(Stage::Ingest);
    let poses = write_poses(&place.artifacts(), &episodes, "recorded", &recorded(&episodes));
    let mock = MockRun {
        pipeline: &place.path().join("image.toml"),
        overrides: &[],
        artifacts: &place.artifacts(),
        poses: &poses,
    };
    let truth: Estimate = Arc::new(|_, object| *object);
    let image = Artifact::open(&mock.roll_out(&truth).unwrap()).unwrap();
    let (of_state, of_image) = (
        state.read::<SpaceStepRow>().unwrap(),
        image.read::<SpaceStepRow>().unwrap(),
    );
    let actions = |rows: &[SpaceStepRow]| rows.iter().map(|row| (row.action, row.gripper)).collect::<Vec<_>>();
    assert_eq!(actions(&of_state), actions(&of_image));
    assert!(of_image.iter().all(|row| row.core.asked_images == Some(1)));
}

/// The rollouts in another artifact folder.
fn rollouts_below(place: &Place, folder: &str) -> Artifact {
    let folder = folders_in(&place.path().join(folder).join("rollouts")).remove(0);
    Artifact::open(&folder).unwrap()
}

#[test]
fn retrieval_baselines_run_on_push_t_from_state_and_image() {
    let place = Place::new();
    place.write_image();
    for file in ["small.toml", "image.toml"] {
        for policy in ["gpi", "vinn", "alt"] {
            let folder = format!("{policy}-{file}");
            place
                .run(&format!("rollout {file} --policy {policy} --artifacts {folder}"))
                .done();
            let rollouts = rollouts_below(&place, &folder);
            let decisions = crate::support::decisions_of(&rollouts).num_rows();
            let neighbors = |lists: Vec<Vec<f64>>| {
                assert_eq!(lists.len(), decisions);
                for list in lists {
                    let weights: f64 = list.iter().skip(2).step_by(3).sum();
                    assert!((weights - 1.0).abs() < 1e-9, "{list:?}");
                }
            };
            match policy {
                "gpi" => neighbors(
                    rollouts
                        .read::<GpiRow>()
                        .unwrap()
                        .into_iter()
                        .map(|r| r.neighbors)
                        .collect(),
                ),
                "vinn" => neighbors(
                    rollouts
                        .read::<VinnRow>()
                        .unwrap()
                        .into_iter()
                        .map(|r| r.neighbors)
                        .collect(),
                ),
                _ => {
                    let rows = rollouts.read::<AltRow>().unwrap();
                    assert_eq!(rows.len(), decisions);
                    for row in rows {
                        let quantile = row.quantile.unwrap();
                        assert_eq!(row.out_of_distribution, quantile > 0.99, "{row:?}");
                    }
                }
            }
            let asked = rollouts.read::<PlaneStepRow>().unwrap();
            assert!(asked.iter().all(|row| row.core.asked_object == Some(true)));
        }
    }
    // The noise of queries depends on the scene only, so that one thread gives the same rollouts as several.
    place
        .run("rollout small.toml --policy gpi --jobs 1 --artifacts one")
        .done();
    let rows = |folder: &str| rollouts_below(&place, folder).read::<GpiRow>().unwrap();
    assert_eq!(rows("one"), rows("gpi-small.toml"));
    // With world actions, ALT needs the block only at lookups.
    place
        .run("rollout image.toml --policy alt --set policy.actions=\"world\" --artifacts world")
        .done();
    let rows = rollouts_below(&place, "world").read::<PlaneStepRow>().unwrap();
    let asked = rows.iter().filter(|row| row.core.asked_object == Some(true)).count();
    assert!(asked * 4 < rows.len(), "{asked} of {}", rows.len());
}

#[test]
fn settings_of_retrieval_baselines_that_make_no_sense_are_refused() {
    let place = Place::empty();
    for (arguments, expected) in [
        ("gpi --set policy.horizon=0", "policy.horizon is 0; give 1 or more"),
        ("gpi --set policy.neighbors=0", "policy.neighbors is 0; give 1 or more"),
        (
            "gpi --set policy.noise.sigma=-1",
            "policy.noise.sigma is -1; give a number from 0 to 1",
        ),
        (
            "gpi --set policy.smoothing=-0.5",
            "policy.smoothing is -0.5; give a number from 0 to 100",
        ),
        (
            "gpi --set policy.neighbours=2",
            "unknown key policy.neighbours (did you mean neighbors?)",
        ),
        (
            "vinn --set policy.temperature=0",
            "policy.temperature is 0; give a finite number above 0",
        ),
        (
            "vinn --set policy.history=0",
            "policy.history is 0; give a number from 1 to 100",
        ),
        (
            "alt --set policy.cell=-1",
            "policy.cell is -1; give 0, or a number from",
        ),
        (
            "alt --set policy.alarm=2",
            "policy.alarm is 2; give a number from 0 to 1",
        ),
        ("gpi-tuned", "unknown policy \"gpi-tuned\""),
    ] {
        let sentence = place
            .run(&format!("rollout small.toml --policy {arguments}"))
            .refused_at_once();
        assert!(sentence.contains(expected), "{arguments}: {sentence}");
    }
}

#[test]
fn retrieval_baselines_run_on_lift() {
    let Some((data, simulators)) = scripted_and_simulators() else {
        return;
    };
    let place = Place::empty();
    place.write(
        "lift.toml",
        format!(
            "task = \"lift\"\nvariant = \"state\"\n[ingest]\nsource = \"{}\"\nselect = {{ first = 20 }}\n[segment]\n[pose]\nsource = \"recorded\"\n[index]\n[policy]\nkind = \"gpi\"\n[rollout]\nseeds = \"201000..201002\"\nmax_steps = 60\n",
            data.join("lift/low_dim.hdf5").display()
        ),
    );
    let run = |arguments: &str, folder: &str| {
        let mut command = place.command();
        command.env("RE4_SIMULATORS", &simulators);
        command
            .args(["rollout", "lift.toml", "--artifacts", folder])
            .args(arguments.split(' '));
        Answer::new(&command.output().unwrap(), place.path())
    };
    for policy in ["gpi", "gpi-tuned", "vinn", "alt"] {
        run(&format!("--policy {policy}"), policy).done();
        let rollouts = rollouts_below(&place, policy);
        let decisions = crate::support::decisions_of(&rollouts).num_rows();
        let details = match policy {
            "gpi" => rollouts.read::<GpiRow>().unwrap().len(),
            "vinn" => rollouts.read::<VinnRow>().unwrap().len(),
            "alt" => rollouts.read::<AltRow>().unwrap().len(),
            _ => {
                let rows = rollouts.read::<GpiTunedRow>().unwrap();
                assert!(rows.iter().any(|row| &*row.phase == "pick"));
                rows.len()
            }
        };
        assert_eq!(details, decisions, "{policy}");
        let steps = rollouts.read::<SpaceStepRow>().unwrap();
        assert!(
            steps
                .iter()
                .all(|row| row.core.asked_object == Some(true) || policy == "alt")
        );
    }
    for (arguments, expected) in [
        (
            "--policy gpi-tuned --set policy.horizon=0",
            "policy.horizon is 0; give 1 or more",
        ),
        (
            "--policy gpi --set policy.weights.fingers=-1",
            "policy.weights.fingers is -1; give a number from 0 to 1000000",
        ),
    ] {
        let sentence = run(arguments, "refused").refused();
        assert!(sentence.contains(expected), "{arguments}: {sentence}");
    }
}

table! {
    /// Table `decisions` of Push-T in older artifacts, which also has the columns that now are in `decisions_re4`.
    #[table("decisions", version = 2)]
    pub struct OldDecision {
        /// Seed.
        pub seed: u32,
        /// Decision.
        pub decision: u32,
        /// Step.
        pub step: u32,
        /// Mode.
        pub mode: Mode,
        /// Selector.
        pub selector: Label,
        /// Pusher.
        pub query_eef: Point2,
        /// Block.
        pub query_object: Pose2,
        /// Demonstration.
        pub demo: u32,
        /// First frame.
        pub demo_frame: u32,
        /// Last frame.
        pub demo_end: u32,
        /// Chunks.
        pub compared: u32,
        /// Distance.
        pub d_q: Option<f64>,
        /// Distance.
        pub d_o: Option<f64>,
        /// Motion.
        pub delta: Pose2,
        /// Start of the chunk.
        pub set_point: Point2,
        /// Result of the planner.
        pub plan: Label,
        /// Steps.
        pub plan_steps: u32,
        /// Nodes.
        pub plan_nodes: u32,
        /// Path.
        pub plan_path: Vec<f64>,
        /// Steps.
        pub replay_steps: u32,
        /// Block after the chunk.
        pub predicted_object: Pose2,
        /// Coverage after the chunk.
        pub predicted_coverage: f64,
        /// Reason.
        pub reason: String,
        /// Name.
        pub demo_name: Option<String>,
    }
}

#[test]
fn decisions_of_older_artifacts_are_read_as_both_tables() {
    let place = Place::empty();
    let recipe = Recipe::new(Stage::Rollout, 1).config(&serde_json::json!({})).unwrap();
    let writer = Store::open(&place.artifacts()).unwrap().begin(&recipe).unwrap();
    let pose = Pose2::new(1.0, 2.0, 3.0);
    let old = OldDecision {
        seed: 500,
        decision: 0,
        step: 7,
        mode: Mode::Transit,
        selector: "outcome".into(),
        query_eef: Point2::new(4.0, 5.0),
        query_object: pose,
        demo: 3,
        demo_frame: 11,
        demo_end: 19,
        compared: 256,
        d_q: None,
        d_o: None,
        delta: pose,
        set_point: Point2::new(6.0, 7.0),
        plan: "direct".into(),
        plan_steps: 2,
        plan_nodes: 0,
        plan_path: vec![4.0, 5.0, 6.0, 7.0],
        replay_steps: 9,
        predicted_object: pose,
        predicted_coverage: 0.5,
        reason: "since".to_owned(),
        demo_name: Some("episode 3".to_owned()),
    };
    writer.write_rows([old.clone()]).unwrap();
    let artifact = writer.publish(ArtifactSummary::default()).unwrap();
    let core = artifact.read::<PlaneDecisionRow>().unwrap().remove(0);
    assert_eq!((core.core.step, core.core.demo, core.core.kind), (7, Some(3), None));
    assert_eq!((core.query_object, core.core.demo_name), (Some(pose), old.demo_name));
    let details = artifact.read::<PlaneRe4Row>().unwrap().remove(0);
    assert_eq!(
        (details.delta, details.plan_path, details.compared),
        (pose, old.plan_path, 256)
    );
}
