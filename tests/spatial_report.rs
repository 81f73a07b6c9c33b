//! The HTML page and the video of rollouts of robosuite tasks: their figures are those of the artifact, the page works in a
//! browser, and the video shows the rollout. The tests need the datasets in the folder that `RE4_DATA` names (or in
//! ../shared/data), and the simulators in the folder that `RE4_SIMULATORS` names (or in data/simulators, where
//! scripts/setup-simulators.sh installs them).

use std::fs;
use std::path::Path;
use std::process::Command;

use crate::support::{Answer, Place, filters, repository, scripted_and_simulators};
use insta::{assert_snapshot, with_settings};
use re4_artifact::{Artifact, col_f64, col_f64_or_null, col_text, col_u32};
use serde_json::Value;

fn run(place: &Place, simulators: &Path, arguments: &str) -> Answer {
    let mut command: Command = place.command();
    command
        .env("RE4_SIMULATORS", simulators)
        .args(arguments.split_whitespace());
    Answer::new(&command.output().unwrap(), place.path())
}

/// Runs four rollouts of Lift with few demonstrations, and writes their page. Returns the artifact's folder relative to the test
/// folder.
fn lift(place: &Place, data: &Path, simulators: &Path, policy: &str) -> String {
    let text = format!(
        "task = \"lift\"\nvariant = \"state\"\n[ingest]\nsource = \"{}\"\nselect = {{ first = 10 }}\n[segment]\n[pose]\nsource = \"recorded\"\n[index]\n[rollout]\npolicy = \"re4\"\nseeds = \"200000..200004\"\n",
        data.join("lift/low_dim.hdf5").display()
    );
    place.write("lift.toml", text);
    let answer = run(
        place,
        simulators,
        &format!("run lift.toml --policy {policy} --report run.html --json"),
    )
    .done();
    assert!(
        answer.stderr.contains("  run.html  4 rollouts in the viewer, "),
        "{}",
        answer.stderr
    );
    answer.json()["artifact"].as_str().unwrap().to_owned()
}

fn data_of(page: &str) -> Value {
    let (_, rest) = page.split_once("type=\"application/json\">").unwrap();
    serde_json::from_str(rest.split_once("</script>").unwrap().0).unwrap()
}

fn numbers<T>(packed: &Value, from: impl Fn(&[u8]) -> T, size: usize) -> Vec<T> {
    use base64::Engine as _;
    let bytes = base64::prelude::BASE64_STANDARD
        .decode(packed["data"].as_str().unwrap())
        .unwrap();
    bytes.chunks_exact(size).map(from).collect()
}

#[test]
fn the_page_matches_the_artifact() {
    let Some((data, simulators)) = scripted_and_simulators() else {
        return;
    };
    let place = Place::empty();
    let folder = lift(&place, &data, &simulators, "re4");
    run(&place, &simulators, &format!("report {folder} --output page.html")).done();
    let page = fs::read_to_string(place.path().join("page.html")).unwrap();
    assert!(page == fs::read_to_string(place.path().join("run.html")).unwrap());
    let artifact = Artifact::open(&place.path().join(&folder)).unwrap();
    let rate = &artifact.manifest().summary["metrics"]["success_rate"];
    let stated = format!(
        "data-metric=\"success_rate\" data-value=\"{}\" data-low=\"{}\" data-high=\"{}\"",
        rate["value"].as_f64().unwrap(),
        rate["low"].as_f64().unwrap(),
        rate["high"].as_f64().unwrap()
    );
    assert!(page.contains(&stated), "{stated}");
    assert!(page.contains("10 selected demonstrations") && page.contains("MuJoCo 2.3.7"));
    let shown = &data_of(&page)["artifacts"][0];
    let results = crate::support::results(&artifact);
    for name in ["seed", "steps", "decisions"] {
        assert_eq!(
            shown["rollouts"][name],
            serde_json::json!(col_u32(&results, name).unwrap()),
            "{name}"
        );
    }
    let f64s = |packed: &Value| numbers(packed, |b| f64::from_le_bytes(b.try_into().unwrap()), 8);
    let f32s = |packed: &Value| numbers(packed, |b| f32::from_le_bytes(b.try_into().unwrap()), 4);
    let decisions = crate::support::decisions(&artifact);
    let (seed_of, kinds) = (
        col_u32(&decisions, "seed").unwrap(),
        col_text(&decisions, "kind").unwrap(),
    );
    let lost = |seed: &u32| {
        let own = seed_of.iter().zip(&kinds).filter(|(other, _)| *other == seed);
        own.filter(|(_, kind)| **kind == Some("grasp_lost")).count()
    };
    let losses: Vec<usize> = col_u32(&results, "seed").unwrap().iter().map(lost).collect();
    assert_eq!(shown["rollouts"]["losses"], serde_json::json!(losses));
    for name in ["d_q", "d_o", "d_e"] {
        let expected = col_f64_or_null(&decisions, name).unwrap();
        let found = f64s(&shown["decisions"][name])
            .into_iter()
            .map(|v| (!v.is_nan()).then_some(v));
        assert_eq!(found.collect::<Vec<_>>(), expected, "{name}");
    }
    let reasons: Vec<&str> = col_text(&decisions, "reason").unwrap().into_iter().flatten().collect();
    assert_eq!(shown["decisions"]["reason"], serde_json::json!(reasons));
    let steps = crate::support::steps(&artifact);
    let z: Vec<f32> = f32s(&shown["steps"]["object"]).into_iter().skip(2).step_by(7).collect();
    let expected: Vec<f32> = col_f64(&steps, "object_z").unwrap().iter().map(|v| *v as f32).collect();
    assert_eq!(z, expected);
}

#[test]
fn reports_and_videos_that_cannot_be_made() {
    let Some((data, simulators)) = scripted_and_simulators() else {
        return;
    };
    let place = Place::new();
    let lift = lift(&place, &data, &simulators, "re4");
    let planar = place.run("run small.toml --no-images --json").done().json()["artifact"]
        .as_str()
        .unwrap()
        .to_owned();
    let mut sentences = Vec::new();
    for arguments in [
        format!("report {lift} {planar} --output page.html"),
        format!("report {lift} --seeds 7 --output page.html"),
        format!("video {lift} video.gif --seed 7"),
        format!("video {lift} video.gif --seed 200000 --size 20"),
    ] {
        sentences.push(run(&place, &simulators, &arguments).refused_at_once());
    }
    fs::rename(place.artifacts().join("episodes"), place.path().join("away")).unwrap();
    let video = format!("video {lift} video.gif --seed 200000");
    sentences.push(run(&place, &simulators, &video).refused_at_once());
    assert!(!place.path().join("video.gif").exists() && !place.path().join("page.html").exists());
    assert!(place.temporaries().is_empty());
    with_settings!({ filters => filters() }, { assert_snapshot!(sentences.join("\n")) });
}

/// Images are rendered when the page is made. The object's origin, as marked on the page, is in the middle of the red cube.
#[test]
fn the_page_shows_the_camera_images() {
    let Some((data, simulators)) = scripted_and_simulators() else {
        return;
    };
    let place = Place::empty();
    let folder = lift(&place, &data, &simulators, "re4");
    let report = format!("report {folder} --output page.html --images 1");
    let answer = run(&place, &simulators, &report);
    if answer.stderr.contains("OpenGL") {
        println!("skipped: {}", answer.stderr.trim());
        return;
    }
    answer.done();
    let page = fs::read_to_string(place.path().join("page.html")).unwrap();
    let shown = &data_of(&page)["artifacts"][0];
    let images = &shown["images"];
    let png = images["png"].as_array().unwrap();
    // All decisions of one rollout: the first failed one, or the first one if none failed.
    let success = shown["rollouts"]["success"].as_array().unwrap();
    let chosen = success.iter().position(|success| success == 0).unwrap_or(0);
    let counts: Vec<usize> = serde_json::from_value(shown["rollouts"]["decisions"].clone()).unwrap();
    let first: usize = counts[..chosen].iter().sum();
    let numbered = numbers(&images["decision"], |b| u32::from_le_bytes(b.try_into().unwrap()), 4);
    assert_eq!(
        numbered,
        (first as u32..(first + counts[chosen]) as u32).collect::<Vec<_>>()
    );
    assert_eq!(png.len(), counts[chosen]);
    let places = numbers(&images["places"], |b| f32::from_le_bytes(b.try_into().unwrap()), 4);
    assert_eq!(places.len(), 16 * png.len());
    // The policy observes the simulator's pose.
    assert!(places.chunks_exact(16).all(|both| both[..8] == both[8..]));
    // At the start nothing occludes the cube.
    let bytes = {
        use base64::Engine as _;
        base64::prelude::BASE64_STANDARD
            .decode(png[0].as_str().unwrap())
            .unwrap()
    };
    let image = image::load_from_memory(&bytes).unwrap().into_rgb8();
    assert_eq!(image.dimensions(), (84, 84));
    let red: Vec<[f64; 2]> = image
        .enumerate_pixels()
        .filter(|(_, _, pixel)| f64::from(pixel[0]) > 1.8 * f64::from(pixel[1].max(pixel[2])) && pixel[0] > 60)
        .map(|(x, y, _)| [f64::from(x) + 0.5, f64::from(y) + 0.5])
        .collect();
    let middle = [0, 1].map(|k| red.iter().map(|pixel| pixel[k]).sum::<f64>() / red.len() as f64);
    let away = (middle[0] - f64::from(places[0])).hypot(middle[1] - f64::from(places[1]));
    assert!(
        red.len() > 8 && away < 1.5,
        "{} red pixels with centre {middle:?}, the page has {:?}",
        red.len(),
        &places[..2]
    );
    // A second report gives the same page; without the episodes artifact there is an error.
    run(&place, &simulators, &report).done();
    assert!(page == fs::read_to_string(place.path().join("page.html")).unwrap());
    fs::rename(place.artifacts().join("episodes"), place.path().join("away")).unwrap();
    let refused = run(&place, &simulators, &report).refused_at_once();
    assert!(
        refused.contains("cannot show images of") && refused.contains("episodes artifact"),
        "{refused}"
    );
}

#[test]
fn the_video_shows_the_rollout() {
    let Some((data, simulators)) = scripted_and_simulators() else {
        return;
    };
    let place = Place::empty();
    let folder = lift(&place, &data, &simulators, "re4");
    let video = format!("video {folder} video.gif --seeds 200000..200002 --size 96 --speed 10 --json");
    let answer = run(&place, &simulators, &video);
    if answer.stderr.contains("OpenGL") {
        println!("skipped: {}", answer.stderr.trim());
        return;
    }
    let output = answer.done().json();
    let artifact = Artifact::open(&place.path().join(&folder)).unwrap();
    let results = crate::support::results(&artifact);
    // At this speed, every fourth state and the last one are shown.
    let longest = col_u32(&results, "steps").unwrap()[..2].iter().max().copied().unwrap();
    assert_eq!(
        (&output["width"], &output["frames"]),
        (&192.into(), &(longest.div_ceil(4) + 1).into())
    );
    let bytes = fs::read(place.path().join("video.gif")).unwrap();
    run(&place, &simulators, &video).done();
    assert!(
        bytes == fs::read(place.path().join("video.gif")).unwrap(),
        "the second video differs from the first"
    );
    // The table of robosuite's Lift is bright and its walls are grey, so an image has more than one colour.
    let mut decoder = gif::DecodeOptions::new().read_info(&bytes[..]).unwrap();
    let frame = decoder.read_next_frame().unwrap().unwrap();
    let mut colours = frame.buffer[..96 * 192].to_vec();
    colours.sort_unstable();
    colours.dedup();
    assert!(colours.len() > 40, "{} colours", colours.len());
}

/// Opens pages of two policies in headless Chromium. `tests/spatial_report_page.py` has the checks.
#[test]
fn the_page_works_in_a_browser() {
    let Some((data, simulators)) = scripted_and_simulators() else {
        return;
    };
    let Some(python) = std::env::var_os("RE4_PYTHON") else {
        println!("skipped: RE4_PYTHON is not set; run scripts/setup-python.sh and set it to target/python/bin/python");
        return;
    };
    let place = Place::empty();
    let folders = ["re4", "re2"].map(|policy| place.path().join(lift(&place, &data, &simulators, policy)));
    let paths: Vec<String> = folders.iter().map(|folder| folder.display().to_string()).collect();
    run(
        &place,
        &simulators,
        &format!("report {} --output page.html --images 1", paths.join(" ")),
    )
    .done();
    let mut command = Command::new(&python);
    command
        .arg(repository().join("tests/spatial_report_page.py"))
        .arg(place.path().join("page.html"))
        .args(&folders);
    let answer = command.output().unwrap();
    assert!(
        answer.status.success(),
        "{}\n{}",
        String::from_utf8_lossy(&answer.stdout),
        String::from_utf8_lossy(&answer.stderr)
    );
}
