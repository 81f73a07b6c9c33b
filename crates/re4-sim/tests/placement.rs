//! Initial states from seeds equal those that robosuite samples.
//!
//! `tests/robosuite_reference.py` recorded the files.
#![allow(clippy::unwrap_used, reason = "a test may panic")]

#[path = "reference/mod.rs"]
mod reference;

use re4_sim::robosuite::{Placement, RobosuiteTask};
use std::borrow::Cow;
use std::f64::consts::PI;

use re4_sim::SimError;
use reference::{Reference, names};
use sha2::{Digest, Sha256};

fn task(name: &str) -> RobosuiteTask {
    RobosuiteTask::named(name).unwrap()
}

/// The files with initial states of seeds: placement files, and the traces that contain them too.
fn placements() -> Vec<Reference> {
    let of_traces = names("trace_").into_iter().map(|name| format!("trace_{name}.bin.gz"));
    let own = names("placement_")
        .into_iter()
        .map(|name| format!("placement_{name}.bin.gz"));
    let files = of_traces.chain(own).map(|file| Reference::read(&file));
    files.filter(|file| file.has("seeds")).collect()
}

/// Half sizes of the boxes whose size is sampled.
fn boxes(placement: &Placement) -> Vec<f64> {
    let sizes = placement.objects.iter().filter_map(|object| object.half_sizes);
    sizes.flatten().collect()
}

/// MJCF with a cube of these half sizes.
fn with_cube(mut placement: Placement, mjcf: &str, half_sizes: [f64; 3]) -> Result<String, SimError> {
    placement.objects[0].half_sizes = Some(half_sizes);
    placement.in_model(mjcf).map(Cow::into_owned)
}

fn bits(numbers: &[f64]) -> Vec<u64> {
    numbers.iter().map(|number| number.to_bits()).collect()
}

/// MuJoCo 2.3.7 normalises every quaternion when it computes poses; 3.2.7 leaves quaternions unchanged.
fn as_computed_with(version: &str, mut placement: Placement) -> Vec<f64> {
    if version == "1.4.1" {
        for object in &mut placement.objects {
            let squared: f64 = object.quaternion.iter().map(|part| part * part).sum();
            object.quaternion = object.quaternion.map(|part| part * (1.0 / squared.sqrt()));
        }
    }
    placement.coordinates()
}

#[test]
fn states_after_a_reset_equal_those_of_robosuite() {
    for file in placements() {
        let task = RobosuiteTask::of_environment(file.text("task")).unwrap();
        let version = file.text("robosuite");
        // A trace also has the coordinates of its steps, so the initial states have another name there.
        let qpos = file.f64s(if file.has("placed") { "placed" } else { "qpos" });
        let seeds = file.u32s("seeds").numbers;
        assert!(seeds.len() >= 200);
        for (index, &seed) in seeds.iter().enumerate() {
            let placement = Placement::sample(task, seed);
            let cube = boxes(&placement);
            if !cube.is_empty() {
                assert_eq!(bits(&cube), bits(file.f64s("cube_size").row(index)), "seed {seed}");
            }
            let coordinates = as_computed_with(version, placement);
            assert_eq!(
                bits(&coordinates),
                bits(qpos.row(index)),
                "{task:?} {version}, seed {seed}"
            );
        }
    }
}

/// Every task has its reference files.
#[test]
fn all_tasks_are_tested() {
    let placed: Vec<_> = placements().iter().map(|file| file.text("task").to_owned()).collect();
    let traces = names("trace_");
    let traces = traces
        .iter()
        .map(|name| Reference::read(&format!("trace_{name}.bin.gz")));
    let traced: Vec<_> = traces.map(|file| file.text("task").to_owned()).collect();
    for task in RobosuiteTask::all() {
        let contains = |files: &[String]| files.iter().any(|file| file == task.environment);
        assert!(contains(&placed) && contains(&traced), "{task:?}");
    }
}

#[test]
fn scenes_of_traces_equal_those_of_their_seed() {
    for name in names("trace_") {
        let file = Reference::read(&format!("trace_{name}.bin.gz"));
        let task = RobosuiteTask::of_environment(file.text("task")).unwrap();
        let placement = Placement::sample(task, 11);
        let coordinates = as_computed_with(file.text("robosuite"), placement.clone());
        let state = file.f64s("initial_state").numbers;
        assert_eq!(bits(&state[1..=coordinates.len()]), bits(&coordinates), "{name}");
        let robosuites = file.text("xml");
        if task.samples_models() {
            let other = with_cube(placement.clone(), robosuites, [0.02, 0.0215, 0.022]).unwrap();
            assert!(other.contains(r#"name="cube_g0" size="0.02 0.0215 0.022" "#), "{other}");
            assert_eq!(placement.in_model(&other).unwrap(), robosuites, "{name}");
        } else {
            assert!(matches!(placement.in_model(robosuites), Ok(Cow::Borrowed(same)) if same == robosuites));
        }
    }
}

#[test]
fn a_model_without_a_cube_is_refused() {
    for (mjcf, expected) in [
        (
            "<mujoco><worldbody/></mujoco>",
            "the model has no geom cube_g0 with a size",
        ),
        ("<mujoco><worldbody>", "its MJCF is not XML"),
    ] {
        let error = Placement::sample(task("lift"), 0)
            .in_model(mjcf)
            .unwrap_err()
            .to_string();
        assert!(
            error.starts_with("cannot simulate Lift: ") && error.contains(expected),
            "{error}"
        );
    }
}

/// Ten thousand samples are in the ranges of the rules and uniformly distributed over them.
#[test]
fn ten_thousand_samples_follow_the_rules() {
    for name in ["lift", "can", "square"] {
        let task = task(name);
        let samples: Vec<Placement> = (0..10_000).map(|seed| Placement::sample(task, seed)).collect();
        let object = |index: usize, axis: usize| -> Vec<f64> {
            samples
                .iter()
                .map(|sample| sample.objects[index].position[axis])
                .collect()
        };
        let (used, x, y) = match name {
            "lift" => (0, -0.03..0.03, -0.03..0.03),
            "can" => (3, -0.02..0.22, -0.42..-0.08),
            _ => (0, -0.115..-0.11, 0.11..0.225),
        };
        let yaw: Vec<f64> = samples
            .iter()
            .map(|sample| {
                let [w, i, j, k] = sample.objects[used].quaternion;
                assert_eq!([i, j], [0.0, 0.0]);
                2.0 * k.atan2(w)
            })
            .collect();
        let uniform = |what: &str, numbers: Vec<f64>, range: std::ops::Range<f64>, allowed: f64| {
            let distance = kolmogorov_smirnov(numbers, &range);
            assert!(
                distance < allowed,
                "{name}: the Kolmogorov-Smirnov distance of {what} is {distance}"
            );
        };
        // A uniform sample of 10,000 exceeds the distance 0.0195 once in a thousand times. The can, placed last, keeps clear of
        // the objects that are already in the bin, so the middle of the bin is less frequent.
        let allowed = if name == "can" { 0.03 } else { 0.0195 };
        uniform("x", object(used, 0), x, allowed);
        uniform("y", object(used, 1), y, allowed);
        uniform("yaw", yaw, 0.0..std::f64::consts::TAU, 0.0195);
        for sample in &samples {
            let height = sample.objects[used].position[2];
            let expected = match (name, sample.objects[used].half_sizes) {
                (_, Some(cube)) => 0.81 + cube[2],
                ("can", None) => 0.86,
                (_, None) => 0.89,
            };
            assert!((height - expected).abs() < 1e-12, "{name}: {height}");
            let away = sample.objects.iter().enumerate().filter(|(index, _)| *index != used);
            assert!(
                away.map(|(_, object)| object.position)
                    .all(|position| position == [10.0; 3])
            );
        }
        if name == "lift" {
            for axis in 0..3 {
                let sizes = samples.iter().map(|sample| boxes(sample)[axis]).collect();
                uniform("half size", sizes, 0.020..0.022, 0.0195);
            }
        }
        let means_in_pi = [0.0, 1.0 / 16.0, 0.0, -5.0 / 6.0, 0.0, 1.0, 0.25];
        for (joint, mean_in_pi) in means_in_pi.into_iter().enumerate() {
            let mean = mean_in_pi * PI - if joint == 5 { 0.2 } else { 0.0 };
            let angles = || samples.iter().map(|sample| sample.arm[joint] - mean);
            let average = angles().sum::<f64>() / 10_000.0;
            let variance = angles().map(|angle| (angle - average).powi(2)).sum::<f64>() / 9_999.0;
            // Four standard errors of the mean and of the standard deviation.
            assert!(
                average.abs() < 4.0 * 0.02 / 100.0 + 1e-5,
                "{name}, joint {joint}: mean {average}"
            );
            assert!(
                (variance.sqrt() - 0.02).abs() < 4.0 * 0.02 / 20_000_f64.sqrt(),
                "{name}, joint {joint}: {variance}"
            );
        }
    }
}

#[test]
fn ten_thousand_samples_equal_those_of_robosuite() {
    let files = placements();
    for task in RobosuiteTask::all() {
        let used = task.placement.iter().position(|rule| rule.used).unwrap();
        let mut hash = Sha256::new();
        for seed in 0..10_000 {
            let sample = Placement::sample(task, seed);
            let object = &sample.objects[used];
            let numbers = boxes(&sample).into_iter().chain(sample.arm);
            for number in numbers.chain(object.position).chain(object.quaternion) {
                hash.update(number.to_le_bytes());
            }
        }
        let digits = hash
            .finalize()
            .iter()
            .fold(String::new(), |text, byte| format!("{text}{byte:02x}"));
        for file in files.iter().filter(|file| file.text("task") == task.environment) {
            assert_eq!(file.text("sha256_of_10000"), digits, "{task:?}");
        }
    }
}

/// The Kolmogorov-Smirnov distance between a sample and the uniform distribution of a range, which must contain every number.
fn kolmogorov_smirnov(mut numbers: Vec<f64>, range: &std::ops::Range<f64>) -> f64 {
    numbers.sort_by(f64::total_cmp);
    let count = numbers.len() as f64;
    let mut maximum = 0.0_f64;
    for (index, number) in numbers.iter().enumerate() {
        // Rounding may reach the upper end, and the yaw, which goes through sine and cosine, both ends.
        let fraction = (number - range.start) / (range.end - range.start);
        let fraction = if number < &range.start {
            fraction + 1.0
        } else {
            fraction
        };
        assert!((-1e-9..=1.0 + 1e-9).contains(&fraction), "{number} is not in {range:?}");
        let (below, above) = (index as f64 / count, (index + 1) as f64 / count);
        maximum = maximum.max((fraction - below).abs()).max((above - fraction).abs());
    }
    maximum
}
