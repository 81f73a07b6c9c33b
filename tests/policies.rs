//! Policies by their kinds: what a table `[policy]` says, and how the older form of it is read.

use re4_artifact::{Facts, Label, Recipe, Stage, Store, table};
use re4_episode::Mode;
use re4_geometry::{Point2, Pose2};
use re4_policy::kinds::PlaneRe4Row;
use re4_rollout::PlaneDecisionRow;
use serde_json::Value;

use crate::support::Place;

/// The program's answer to a rollout with these settings.
fn rolled(place: &Place, arguments: &str) -> Value {
    place
        .run(&format!("rollout {arguments} --no-images --json"))
        .done()
        .json()
}

/// The pipeline `small.toml` with its policy in a table of its own.
fn today(place: &Place) {
    let small = std::fs::read_to_string(place.path().join("small.toml")).unwrap();
    let text = small.replace("policy = \"re4\"\n", "") + "\n[policy]\nkind = \"re4\"\n[policy.replan]\nkeepout = 19\n";
    place.write("today.toml", text);
    place.write("older.toml", small + "\n[rollout.replan]\nkeepout = 19\n");
}

#[test]
fn an_older_file_names_the_same_artifact() {
    let place = Place::new();
    today(&place);
    let key = |arguments: &str| rolled(&place, arguments)["artifact"].clone();
    let one = key("today.toml");
    assert_eq!(key("older.toml"), one);
    assert_ne!(key("small.toml"), one);
    assert_eq!(key("small.toml --set rollout.replan.keepout=19"), one);
    assert_eq!(key("small.toml --set policy.replan.keepout=19"), one);
    let other = key("today.toml --set policy.kind=re2");
    for form in [
        "today.toml --set rollout.policy=re2",
        "older.toml --set rollout.policy=re2",
        "older.toml --policy re2",
    ] {
        assert_eq!(key(form), other, "{form}");
    }
}

#[test]
fn settings_of_another_kind_are_refused_by_name() {
    let place = Place::empty();
    today(&place);
    let say = |arguments: &str| place.run(&format!("rollout {arguments}")).refused_at_once();
    for (arguments, told) in [
        (
            "today.toml --set policy.kind=re44",
            "unknown policy \"re44\" in policy.kind (did you mean re4?)",
        ),
        (
            "today.toml --set policy.recovery.check=step",
            "unknown key policy.recovery (did you mean replay?)",
        ),
        ("today.toml --set rollout.fidelity=fast", "unknown key rollout.fidelity"),
        (
            "today.toml --set policy.replan.keepot=1",
            "unknown key policy.replan.keepot (did you mean keepout?)",
        ),
        ("today.toml --set policy=re4", "policy is \"re4\"; give a table"),
        (
            "today.toml --set rollout={policy=\"re4\"}",
            "both rollout.policy and a table [policy] say what the policy is; write policy.kind",
        ),
    ] {
        let sentence = say(arguments);
        assert!(sentence.contains(told), "{arguments}: {sentence}");
    }
}

table! {
    /// Decisions of Push-T before what is particular to RE4 had a table of its own.
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
        /// Planner's answer.
        pub plan: Label,
        /// Steps.
        pub plan_steps: u32,
        /// Nodes.
        pub plan_nodes: u32,
        /// Way.
        pub plan_path: Vec<f64>,
        /// Steps.
        pub replay_steps: u32,
        /// Block after the chunk.
        pub predicted_object: Pose2,
        /// Coverage there.
        pub predicted_coverage: f64,
        /// Words.
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
    let artifact = writer.publish(Facts::default()).unwrap();
    let core = artifact.read::<PlaneDecisionRow>().unwrap().remove(0);
    assert_eq!((core.core.step, core.core.demo, core.core.kind), (7, Some(3), None));
    assert_eq!((core.query_object, core.core.demo_name), (Some(pose), old.demo_name));
    let details = artifact.read::<PlaneRe4Row>().unwrap().remove(0);
    assert_eq!(
        (details.delta, details.plan_path, details.compared),
        (pose, old.plan_path, 256)
    );
}
