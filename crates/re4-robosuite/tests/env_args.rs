//! Parsing of the declarations in files of different versions.
#![allow(clippy::unwrap_used, reason = "tests may panic")]

use re4_robosuite::actions::Osc;
use re4_robosuite::conventions::{ActionKind, RobosuiteTask};
use re4_robosuite::env_args::EnvArgs;

#[test]
fn the_flat_controller_of_1_4_is_parsed() {
    let env = EnvArgs::parse(
        r#"{"env_name": "PickPlaceCan", "env_version": "1.4.1", "type": 1, "env_kwargs": {"control_freq": 20,
            "robots": ["Panda"], "controller_configs": {"type": "OSC_POSE", "input_max": 1, "input_min": -1,
            "output_max": [0.05, 0.05, 0.05, 0.5, 0.5, 0.5], "output_min": [-0.05, -0.05, -0.05, -0.5, -0.5, -0.5],
            "control_delta": true}}}"#,
    )
    .unwrap();
    assert_eq!(env.version(), Some((1, 4)));
    assert_eq!(
        (env.env_name.as_str(), env.robots.as_slice(), env.control_freq),
        ("PickPlaceCan", &["Panda".to_owned()][..], Some(20.0))
    );
    let controller = env.controller.clone().unwrap();
    assert_eq!(controller.declared, Some(ActionKind::Delta));
    assert_eq!(controller.output_max, Some([0.05, 0.05, 0.05, 0.5, 0.5, 0.5]));
    assert_eq!(Osc::from_env(&env).unwrap(), Osc::symmetric(0.05, 0.5).unwrap());
}

#[test]
fn the_nested_controller_of_1_5_is_parsed() {
    let text = |input: &str| {
        format!(
            r#"{{"env_name": "Lift", "env_version": "1.5.1", "env_kwargs": {{"robots": "Panda", "controller_configs":
            {{"type": "BASIC", "body_parts": {{"left": {{"type": "OSC_POSE", "output_max": 9}}, "right": {{"type": "OSC_POSE",
            "input_max": 1, "input_min": -1, "output_max": [0.05, 0.05, 0.05, 0.5, 0.5, 0.5],
            "output_min": [-0.05, -0.05, -0.05, -0.5, -0.5, -0.5], "input_type": "{input}", "input_ref_frame": "base",
            "gripper": {{"type": "GRIP"}}}}}}}}}}}}"#
        )
    };
    for (input, kind) in [("delta", ActionKind::Delta), ("absolute", ActionKind::Absolute)] {
        let env = EnvArgs::parse(&text(input)).unwrap();
        assert_eq!(env.robots, ["Panda"]);
        assert_eq!(env.version(), Some((1, 5)));
        let controller = env.controller.clone().unwrap();
        assert_eq!(
            (controller.declared, controller.input_ref_frame.as_deref()),
            (Some(kind), Some("base"))
        );
        assert_eq!(Osc::from_env(&env).unwrap(), Osc::symmetric(0.05, 0.5).unwrap());
    }
}

#[test]
fn the_attributes_of_raw_files_are_parsed() {
    let info = r#"{"env_name": "Lift", "robots": "Panda", "controller_configs": {"type": "OSC_POSE", "output_max": 0.05,
        "control_delta": false}}"#;
    let env = EnvArgs::parse_raw(Some("Lift"), Some(info), Some("1.0.0")).unwrap();
    assert_eq!(
        (env.env_name.as_str(), env.version(), env.control_freq),
        ("Lift", Some((1, 0)), None)
    );
    assert_eq!(env.controller.unwrap().declared, Some(ActionKind::Absolute));
    let bare = EnvArgs::parse_raw(Some("Door"), None, None).unwrap();
    assert_eq!(
        (bare.env_name.as_str(), bare.version(), bare.controller),
        ("Door", None, None)
    );
    assert_eq!(EnvArgs::parse_raw(None, Some(info), None).unwrap().env_name, "Lift");
    assert!(EnvArgs::parse_raw(None, None, None).is_err());
}

#[test]
fn missing_entries_are_none_and_invalid_entries_are_errors() {
    let env = EnvArgs::parse(r#"{"env_name": "ToolHang"}"#).unwrap();
    assert_eq!((env.env_version, env.controller, env.robots.len()), (None, None, 0));
    // A controller with another number of axes has no scales for a pose.
    let joints =
        EnvArgs::parse(r#"{"env_name": "A", "env_kwargs": {"controller_configs": {"output_max": [1, 2]}}}"#).unwrap();
    assert_eq!(joints.controller.unwrap().output_max, None);
    for (text, part) in [
        ("", "not valid JSON"),
        ("[]", "no env_name"),
        (r#"{"env_name": 3}"#, "no env_name"),
        (
            r#"{"env_name": "A", "env_kwargs": {"control_freq": 0}}"#,
            "control_freq = 0, which must be a number above zero",
        ),
        (
            r#"{"env_name": "A", "env_kwargs": {"controller_configs": {"output_max": "big"}}}"#,
            "output_max = \"big\"",
        ),
        (
            r#"{"env_name": "A", "env_kwargs": {"controller_configs": {"input_min": [1, null]}}}"#,
            "input_min = [1,null]",
        ),
    ] {
        let error = EnvArgs::parse(text).unwrap_err().to_string();
        assert!(error.contains(part), "{error:?} does not contain {part:?}");
    }
    for version in ["", "1", "one.two", "v"] {
        let env = EnvArgs::parse_raw(Some("A"), None, Some(version)).unwrap();
        assert_eq!(env.version(), None);
    }
}

/// Python's `json` writes `NaN` and `Infinity` for numbers that are not finite. The same words in strings stay unchanged.
#[test]
fn non_finite_numbers_of_python_are_parsed() {
    let text = r#"{"env_name": "Lift", "type": 1, "env_kwargs": {"note": "to Infinity \" and NaN", "horizon": -Infinity,
        "controller_configs": {"type": "OSC_POSE", "output_max": 0.05, "kp": 150, "damping": 1,
        "position_limits": [[NaN, -Infinity, -Infinity], [Infinity, Infinity, Infinity]]}}}"#;
    let env = EnvArgs::parse(text).unwrap();
    assert_eq!((env.kind, env.is_foreign()), (Some(1), false));
    let controller = env.controller.unwrap();
    assert_eq!((controller.kp, controller.damping_ratio), (Some(150.0), Some(1.0)));
    assert_eq!(controller.output_max, Some([0.05; 6]));
    // A number that is not finite cannot be a scale, and similar words are not numbers.
    let scale = text.replace("\"output_max\": 0.05", "\"output_max\": [Infinity, 1, 1, 1, 1, 1]");
    assert!(EnvArgs::parse(&scale).unwrap_err().to_string().contains("output_max"));
    assert!(EnvArgs::parse(r#"{"env_name": Infinite}"#).is_err());
    let quoted = EnvArgs::parse(r#"{"env_name": "NaN_\"Infinity\"", "env_kwargs": {"a": NaN}}"#).unwrap();
    assert_eq!(quoted.env_name, "NaN_\"Infinity\"");
}

#[test]
fn environments_of_other_simulators_are_foreign() {
    let isaac = EnvArgs::parse(r#"{"env_name": "Isaac-Stack-Cube-Franka-IK-Rel-v0", "type": 2}"#).unwrap();
    assert!(isaac.is_foreign());
    assert!(!EnvArgs::parse(r#"{"env_name": "Lift"}"#).unwrap().is_foreign());
}

#[test]
fn mimicgen_names_give_task_and_distribution() {
    let tasks = [
        ("Lift", Some("lift"), None),
        ("PickPlaceCan", Some("can"), None),
        ("NutAssemblySquare", Some("square"), None),
        ("Square_D0", Some("square"), Some(0)),
        ("Square_D2", Some("square"), Some(2)),
        ("Can_D1", Some("can"), Some(1)),
        ("Lift_D0", Some("lift"), Some(0)),
        ("NutAssembly_D0", None, Some(0)),
        ("Stack_D1", None, Some(1)),
        ("Square", None, None),
        ("Square_D", None, None),
        ("Square_Dx", None, None),
        ("Square_D+1", None, None),
        ("SquareNut_D0", None, Some(0)),
        ("_D0", None, Some(0)),
    ];
    for (name, task, distribution) in tasks {
        assert_eq!(
            (
                RobosuiteTask::of_environment(name).map(|task| task.name),
                RobosuiteTask::distribution(name)
            ),
            (task, distribution),
            "{name}"
        );
    }
}

#[test]
fn composite_controllers_are_found_under_all_known_names() {
    for text in [
        r#"{"env_name": "Lift", "env_kwargs": {"controller_configs": {"type": "HYBRID", "body_parts_controller_configs":
            {"right": {"type": "OSC_POSE", "output_max": 0.05}}}}}"#,
        r#"{"env_name": "Lift", "env_kwargs": {"controller_configs": {"type": "BASIC", "body_parts":
            {"arms": {"right": {"type": "OSC_POSE", "output_max": 0.05}}}}}}"#,
        r#"{"env_name": "Lift", "env_kwargs": {"controller_configs": {"type": "BASIC", "body_parts":
            {"base": {"type": "JOINT_VELOCITY"}, "robot0_arm": {"type": "OSC_POSE", "output_max": 0.05}}}}}"#,
    ] {
        let env = EnvArgs::parse(text).unwrap();
        assert_eq!(env.controller.unwrap().output_max, Some([0.05; 6]), "{text}");
    }
}
