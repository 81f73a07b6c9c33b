//! Policies by their kinds: what a table `[policy]` says, and how the older form of it is read.

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
            "today.toml --set policy.kind=re5",
            "unknown policy \"re5\" in policy.kind (did you mean re4?)",
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
