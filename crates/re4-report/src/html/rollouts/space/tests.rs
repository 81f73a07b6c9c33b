use re4_artifact::{Label, SixAxis};
use re4_rollout::Phase;

use super::*;
use crate::html::rollouts::page as rollouts_page;

const AT: [f64; 3] = [0.1, -0.2, 0.83];

fn at() -> Isometry3<f64> {
    Isometry3::translation(AT[0], AT[1], AT[2])
}

fn trace(seed: u32, success: bool) -> Rollout<Space> {
    let step = |i: u32| SpaceStepRow {
        core: StepCore {
            seed,
            step: i,
            decision: u32::from(i > 1),
            phase: [Phase::Bridge, Phase::Replay, Phase::Home][i as usize],
            asked_object: None,
            asked_images: None,
        },
        action: SixAxis([0.2, 0.0, 0.9, 0.0, 0.0, 0.0]),
        gripper: if i == 2 { 1.0 } else { -1.0 },
        eef: at(),
        object: at(),
        finger: [0.01 * f64::from(i), 0.0],
        success: false,
        seen: Some(at()),
    };
    let decision = |step, followed: bool| Decided {
        core: SpaceDecisionRow {
            core: DecisionCore {
                seed,
                decision: u32::from(!followed),
                step,
                kind: Some(Label::from(if followed { "retrieve" } else { "grasp_lost" })),
                demo: followed.then_some(17),
                demo_frame: followed.then_some(3),
                demo_end: followed.then_some(4),
                reason: "because </script> of it".to_owned(),
                demo_name: followed.then(|| "demo_40".to_owned()),
            },
            query_eef: at(),
            query_object: Some(at()),
        },
        detail: Some(SpaceRe4Row {
            seed,
            decision: u32::from(!followed),
            mode: Mode::Transit,
            finger_separation: 0.08,
            compared: followed.then_some(20),
            d_q: followed.then_some(0.125),
            d_o: followed.then_some(0.1),
            d_e: followed.then_some(0.3),
            delta: followed.then_some(SixAxis([0.01, 0.0, 0.0, 0.0, 0.0, 0.5])),
            symmetry_rotation: followed.then_some(0.25),
            replay_steps: followed.then_some(2),
            set_point: at(),
            bridge: true,
            banned: 1,
        }),
    };
    Rollout {
        result: SpaceResultRow {
            core: ResultCore {
                episode: 0,
                seed,
                success,
                steps: 3,
                decisions: 2,
                images: None,
            },
            eef: AT.into(),
            object: at(),
            state: Vec::new(),
        },
        shown: true,
        world: None,
        steps: (0..3).map(step).collect(),
        decisions: vec![decision(0, true), decision(2, false)],
    }
}

fn rollouts(task: &str, preset: &str) -> Rollouts<Space> {
    Rollouts {
        key: preset.repeat(64).chars().take(64).collect(),
        index_key: "i".repeat(64),
        preset: preset.to_owned(),
        altered: false,
        variant: "state".to_owned(),
        max_steps: 400,
        protocol: serde_json::json!({ "seeds": "200000..200002" }),
        settings: serde_json::json!({ "replay": { "horizon": 16 } }),
        scene: Space {
            task: RobosuiteTask::all().find(|known| known.title == task).unwrap(),
            seeds: "200000–200001".to_owned(),
            success_rate: Interval {
                value: 0.5,
                low: 0.094,
                high: 0.905,
            },
            successes: 1,
            median_steps: Some(3.0),
            losses: 2,
            demonstrations: "all 20 demonstrations".to_owned(),
            dataset: "low_dim.hdf5".to_owned(),
            simulator: "MuJoCo 2.3.7".to_owned(),
            images: BTreeMap::new(),
        },
        rollouts: vec![trace(200_000, true), trace(200_001, false)],
    }
}

fn report(artifacts: Vec<Rollouts<Space>>) -> Report<Space> {
    let frames = vec![[&[0.1, 0.2, 0.9][..], &pose(at())].concat(); 5];
    Report {
        tool_version: "0.0.0".to_owned(),
        artifacts,
        demonstrations: BTreeMap::from([("i".repeat(64), BTreeMap::from([(17, frames)]))]),
    }
}

fn data(page: &str) -> Value {
    let (_, rest) = page.split_once("type=\"application/json\">").unwrap();
    serde_json::from_str(rest.split_once("</script>").unwrap().0).unwrap()
}

#[test]
fn the_table_shows_the_results_of_the_artifacts() {
    let page = rollouts_page(&report(vec![rollouts("Lift", "re4"), rollouts("Lift", "re2")]));
    for words in [
        "data-metric=\"success_rate\" data-value=\"0.5\" data-low=\"0.094\" data-high=\"0.905\"",
        "data-metric=\"median_steps\" data-value=\"3\"",
        "data-metric=\"losses\" data-value=\"2\"",
        "all 20 demonstrations",
        "seeds 200000–200001",
        "<title>Lift rollouts: re4, re2</title>",
    ] {
        assert!(page.contains(words), "{words}");
    }
    assert!(!page.contains("data-differences"));
}

#[test]
fn labels_contain_the_tasks_and_settings_that_differ() {
    let mut fast = rollouts("Can", "re4");
    fast.scene.simulator = "MuJoCo 2.3.7, fast".to_owned();
    let mut other = rollouts("Can", "re4");
    other.protocol = serde_json::json!({ "seeds": "500..600" });
    let page = rollouts_page(&report(vec![rollouts("Lift", "re4"), other, fast]));
    let data = data(&page);
    let labels: Vec<&str> = (0..3)
        .map(|i| data["artifacts"][i]["label"].as_str().unwrap())
        .collect();
    assert_eq!(
        labels,
        ["Lift re4", "Can re4 · MuJoCo 2.3.7", "Can re4 · MuJoCo 2.3.7, fast"]
    );
    assert!(page.contains("data-differences=\"seeds\""));
}

#[test]
fn traces_are_packed_in_order_and_texts_cannot_end_the_script() {
    let page = rollouts_page(&report(vec![rollouts("Lift", "re4")]));
    assert!(!page.contains("because </script>"));
    let artifact = &data(&page)["artifacts"][0];
    assert_eq!(artifact["rollouts"]["steps"], serde_json::json!([3, 3]));
    assert_eq!(artifact["decisions"]["reason"][0], "because </script> of it");
    assert_eq!(
        artifact["decisions"]["kind"],
        serde_json::json!(["retrieve", "grasp_lost", "retrieve", "grasp_lost"])
    );
    let unpacked = |name: &str, part: &str| {
        use base64::Engine as _;
        let text = artifact[part][name]["data"].as_str().unwrap();
        base64::prelude::BASE64_STANDARD.decode(text).unwrap()
    };
    assert_eq!(unpacked("phase", "steps"), [1, 2, 3, 1, 2, 3]);
    assert_eq!(unpacked("closing", "steps"), [0, 0, 1, 0, 0, 1]);
    let demos: Vec<u32> = unpacked("demo", "decisions")
        .chunks_exact(4)
        .map(|bytes| u32::from_le_bytes(bytes.try_into().unwrap()))
        .collect();
    assert_eq!(demos, [17, u32::MAX, 17, u32::MAX]);
    // If the policy observed the true poses, the page does not contain them twice.
    assert!(artifact["steps"]["seen"].is_null());
    let mut noisy = rollouts("Lift", "re4");
    noisy.rollouts[1].steps[2].seen = Some(Isometry3::translation(0.002, 0.0, 0.0) * at());
    let noisy = rollouts_page(&report(vec![noisy]));
    assert_eq!(data(&noisy)["artifacts"][0]["steps"]["seen"]["type"], "f32");
}

#[test]
fn rollouts_that_are_not_shown_are_only_counted() {
    let mut set = rollouts("Lift", "re4");
    set.rollouts[0].shown = false;
    let page = data(&rollouts_page(&report(vec![set])));
    assert_eq!(page["artifacts"][0]["shown"], serde_json::json!([1]));
    assert_eq!(
        page["artifacts"][0]["rollouts"]["seed"],
        serde_json::json!([200_000, 200_001])
    );
    assert_eq!(page["artifacts"][0]["decisions"]["kind"].as_array().unwrap().len(), 2);
}

#[test]
fn images_of_decisions_are_packed_with_their_numbers() {
    let bare = rollouts_page(&report(vec![rollouts("Lift", "re4")]));
    assert!(!bare.contains("id=\"camera\"") && data(&bare)["artifacts"][0]["images"].is_null());

    let mut artifact = rollouts("Lift", "re4");
    let behind = [None, Some([3.0, 4.0]), None, None];
    let image = DecisionImage {
        camera: "agentview",
        side: 84,
        png: b"image".to_vec(),
        observed: [Some([1.0, 2.0]); 4],
        simulated: behind,
    };
    artifact.scene.images.insert((200_001, 1), image);
    let page = rollouts_page(&report(vec![artifact.clone()]));
    assert!(page.contains("id=\"camera\""));
    let images = &data(&page)["artifacts"][0]["images"];
    assert_eq!((&images["camera"], &images["side"]), (&"agentview".into(), &84.into()));
    assert_eq!(images["png"], serde_json::json!(["aW1hZ2U="]));
    // The second decision of the second rollout, of two decisions each.
    assert_eq!(images["decision"], u32s([3].into_iter()));
    let nan = f64::NAN;
    let places = [
        [1.0, 2.0, 1.0, 2.0, 1.0, 2.0, 1.0, 2.0],
        [nan, nan, 3.0, 4.0, nan, nan, nan, nan],
    ];
    assert_eq!(images["places"], f32s(places.into_iter().flatten()));
    // Rollouts that are not in the viewer have no images, and their decisions are not counted.
    artifact.rollouts[0].shown = false;
    let fewer = rollouts_page(&report(vec![artifact]));
    assert_eq!(
        data(&fewer)["artifacts"][0]["images"]["decision"],
        u32s([1].into_iter())
    );
}
