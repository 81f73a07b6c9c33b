use base64::Engine as _;
use base64::prelude::BASE64_STANDARD;
use serde_json::Value;

use super::*;

fn demo(episode: u32, frames: usize) -> AuditedEpisodeRow {
    AuditedEpisodeRow {
        episode,
        demo: format!("demo_{episode}"),
        frames,
        transit_frames: frames - 1,
        transfer_frames: 1,
        segments: 2,
        transfers: 1,
        grasp_frame: Some(frames - 1),
        object_displacement: 0.25,
        errors: 1,
        warnings: 0,
        notes: 0,
    }
}

fn audit() -> Audit {
    Audit {
        tool_version: "1.2.3".to_owned(),
        dataset: "can/<b>.hdf5".to_owned(),
        task: "Can".to_owned(),
        command: "re4-pipe audit can.toml".to_owned(),
        artifacts: vec![("audit".to_owned(), "a".repeat(64))],
        frame_seconds: 0.05,
        length: Measure {
            unit: "mm".to_owned(),
            factor: 1000.0,
        },
        demos: vec![demo(0, 2), demo(7, 3)],
        checks: vec![
            check("grasp_lost", Severity::Error, 2),
            check("idle", Severity::Note, 0),
        ],
        findings: vec![finding(0), finding(7)],
        segments: Vec::new(),
        grasps: Vec::new(),
        object: true,
        outline: None,
        contacts: None,
        conventions: Vec::new(),
        scores: Vec::new(),
        shots: Vec::new(),
        flags: vec![Flag {
            label: "holds".to_owned(),
            values: vec![Some(true), None, Some(false), Some(true), None],
        }],
        panels: vec![Panel {
            title: "Speed".to_owned(),
            measure: Measure {
                unit: "mm/frame".to_owned(),
                factor: 1000.0,
            },
            series: vec![Series {
                label: String::new(),
                values: vec![0.5, f64::NAN, 0.1, 0.2, f64::NAN],
            }],
        }],
    }
}

fn check(code: &str, severity: Severity, findings: u32) -> CheckRow {
    CheckRow {
        code: code.to_owned().into(),
        severity,
        meaning: "what it means".to_owned(),
        measure: "what is measured".to_owned(),
        threshold: Some(0.000_012_345),
        unit: "m".into(),
        origin: "data".into(),
        derivation: "three times the median".to_owned(),
        findings,
        episodes: findings,
    }
}

fn finding(episode: u32) -> FindingRow {
    FindingRow {
        finding: 0,
        severity: Severity::Error,
        code: "grasp_lost".into(),
        episode,
        frames: 0..1,
        value: Some(0.1 + 0.2),
        threshold: None,
        unit: "m".into(),
        message: "it </script> slipped".to_owned(),
        other_episode: None,
        other_demo: None,
        demo_name: None,
    }
}

fn data_of(page: &str) -> Value {
    let (_, rest) = page.split_once("type=\"application/json\">").unwrap();
    serde_json::from_str(rest.split_once("</script>").unwrap().0).unwrap()
}

fn bytes(packed: &Value) -> Vec<u8> {
    BASE64_STANDARD.decode(packed["data"].as_str().unwrap()).unwrap()
}

#[test]
fn columns_by_frame_are_packed_completely() {
    let data = data_of(&page(&audit()));
    let values: Vec<f32> = bytes(&data["panels"][0]["series"][0]["values"])
        .chunks_exact(4)
        .map(|b| f32::from_le_bytes(b.try_into().unwrap()))
        .collect();
    assert_eq!((values[0], values[2], values[3]), (0.5, 0.1, 0.2));
    assert!(values[1].is_nan() && values[4].is_nan() && values.len() == 5);
    assert_eq!(bytes(&data["flags"][0]["values"]), [1, 2, 0, 1, 2]);
}

#[test]
fn findings_keep_all_digits_and_cannot_end_the_script() {
    let text = page(&audit());
    let data = data_of(&text);
    assert_eq!(data["findings"]["value"][0], 0.1 + 0.2);
    assert_eq!(data["findings"]["threshold"][0], Value::Null);
    assert_eq!(data["findings"]["message"][1], "it </script> slipped");
    assert_eq!(data["findings"]["severity"], serde_json::json!([0, 0]));
    assert_eq!(data["findings"]["demo"], serde_json::json!([0, 1]));
    assert!(text.contains("can/&lt;b&gt;.hdf5"));
}

#[test]
fn figures_and_texts_are_readable_without_the_script() {
    let text = page(&audit());
    assert!(text.contains("data-fact=\"frames\" data-value=\"5\""));
    assert!(text.contains("data-code=\"grasp_lost\" data-findings=\"2\" data-episodes=\"2\""));
    // A check without findings has no button, but is named.
    assert!(!text.contains("data-code=\"idle\""));
    assert!(text.contains("data-silent=\"idle\""));
    assert!(
        text.contains("data-value=\"0.000012345\">1.2345e-5 m<"),
        "the threshold with all its digits"
    );
    assert!(text.contains("three times the median"));
    assert!(text.contains("No demonstration of this audit has a transfer segment"));
    assert!(!text.contains("id=\"conventions\""));
}

#[test]
fn an_empty_audit_has_a_page() {
    let empty = Audit {
        demos: Vec::new(),
        checks: Vec::new(),
        findings: Vec::new(),
        flags: Vec::new(),
        panels: Vec::new(),
        ..audit()
    };
    let text = page(&empty);
    assert!(text.contains("0 demonstrations") && !text.contains("NaN"));
}

/// Scores of demonstrations 0 and 7: the first one is shorter and straighter.
fn scored() -> Audit {
    let line = |frames: usize, wobble: f64| {
        let at = |frame: usize| [frame as f64 / frames as f64, wobble * (frame % 2) as f64, 0.0].into();
        let eef: Vec<nalgebra::Vector3<f64>> = (0..frames).map(at).collect();
        re4_scores::Motion {
            steps: eef.windows(2).map(|pair| (pair[1] - pair[0]).norm()).collect(),
            object: vec![nalgebra::Vector3::zeros(); frames],
            fingers: Vec::new(),
            states: vec![[0.0; 7]; frames],
            actions: vec![[0.0; 7]; frames],
            segments: vec![re4_episode::Segment {
                mode: re4_episode::Mode::Transit,
                frames: 0..frames,
            }],
            eef,
            period: 0.05,
        }
    };
    let sketches =
        [(0, line(20, 0.0)), (7, line(60, 0.1))].map(|(episode, motion)| re4_scores::Sketch::of(episode, &motion));
    Audit {
        scores: re4_scores::score(&sketches),
        shots: vec![Shot {
            finding: 1,
            frame: 2,
            png: b"png".to_vec(),
        }],
        ..audit()
    }
}

#[test]
fn scores_refer_to_demonstrations_by_their_place_and_keep_all_digits() {
    let audit = scored();
    let text = page(&audit);
    let data = data_of(&text);
    assert_eq!(data["scores"]["demo"], serde_json::json!([0, 1]));
    assert_eq!(data["scores"]["nearest"], serde_json::json!([1, 0]));
    let column = |name: &str| {
        let columns = data["scores"]["columns"].as_array().unwrap();
        columns.iter().find(|column| column["name"] == name).unwrap().clone()
    };
    let efficiency = audit.scores[1].scores.path_efficiency.unwrap();
    assert_eq!(column("path_efficiency")["values"][1], efficiency);
    assert_eq!(column("duration")["ranks"], serde_json::json!([1.0, 2.0]));
    assert_eq!(column("quality")["ranks"], serde_json::json!([1.0, 2.0]));
    // Scores that no demonstration has are not offered.
    assert!(text.contains("option value=\"score duration\"") && !text.contains("option value=\"score regrasps\""));
    // Duration and path efficiency rank both demonstrations in the same order.
    assert!(text.contains("class=\"figure\" data-value=\"1\""));
}

#[test]
fn camera_images_belong_to_findings() {
    let data = data_of(&page(&scored()));
    assert_eq!(
        (&data["shots"]["finding"][0], &data["shots"]["frame"][0]),
        (&Value::from(1), &Value::from(2))
    );
    assert_eq!(
        BASE64_STANDARD
            .decode(data["shots"]["png"][0].as_str().unwrap())
            .unwrap(),
        b"png"
    );
}

#[test]
fn what_was_left_out_is_listed_with_the_reason() {
    assert!(!page(&audit()).contains("id=\"left-out\""));
    let left_out = Audit {
        findings: vec![FindingRow {
            code: "left_out".into(),
            message: "row 3 is <missing>".to_owned(),
            ..finding(7)
        }],
        ..audit()
    };
    let text = page(&left_out);
    assert!(text.contains("data-left-out=\"demo_7\"") && text.contains("row 3 is &lt;missing&gt;"));
}
