//! Initial states from seeds are those that robosuite draws.
//!
//! `tests/robosuite_reference.py` made the files.

#[path = "reference/mod.rs"]
mod reference;

use re4_sim::robosuite::{Placement, RobosuiteTask, with_cube_size};
use std::f64::consts::PI;

use reference::Reference;
use sha2::{Digest, Sha256};

const TASKS: [(RobosuiteTask, &str); 3] = [
    (RobosuiteTask::Lift, "lift"),
    (RobosuiteTask::Can, "can"),
    (RobosuiteTask::Square, "square"),
];

fn bits(numbers: &[f64]) -> Vec<u64> {
    numbers.iter().map(|number| number.to_bits()).collect()
}

/// MuJoCo 2.3.7 multiplies every quaternion with one over its length wherever it computes poses, 3.2.7 leaves them as they are.
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
fn states_after_a_reset_are_those_of_robosuite() {
    for (task, name) in TASKS {
        for version in ["1.4.1", "1.5.1"] {
            let file = Reference::read(&format!("placement_{name}_{version}.bin.gz"));
            assert_eq!(
                (file.text("task"), file.text("robosuite")),
                (task.environment(), version)
            );
            let (seeds, qpos) = (file.u32s("seeds"), file.f64s("qpos"));
            assert!(seeds.numbers.len() >= 200);
            for (index, &seed) in seeds.numbers.iter().enumerate() {
                let placement = Placement::draw(task, seed);
                if let Some(cube) = placement.cube {
                    assert_eq!(bits(&cube), bits(file.f64s("cube_size").row(index)), "seed {seed}");
                }
                let coordinates = as_computed_with(version, placement);
                assert_eq!(
                    bits(&coordinates),
                    bits(qpos.row(index)),
                    "{name} {version}, seed {seed}"
                );
            }
        }
    }
}

#[test]
fn scenes_of_traces_are_those_of_their_seed() {
    for name in [
        "lift_1.4.1",
        "lift_1.5.1",
        "can_1.4.1",
        "can_1.5.1",
        "square_1.4.1",
        "square_1.5.1",
    ] {
        let file = Reference::read(&format!("trace_{name}_absolute.bin.gz"));
        let (task, _) = TASKS.into_iter().find(|(_, task)| name.starts_with(task)).unwrap();
        let placement = Placement::draw(task, 11);
        let coordinates = as_computed_with(file.text("robosuite"), placement.clone());
        let state = file.f64s("initial_state").numbers;
        assert_eq!(bits(&state[1..=coordinates.len()]), bits(&coordinates), "{name}");
        if let Some(cube) = placement.cube {
            let robosuites = file.text("xml");
            let other = with_cube_size(robosuites, [0.02, 0.0215, 0.022]).unwrap();
            assert!(other.contains(r#"name="cube_g0" size="0.02 0.0215 0.022" "#), "{other}");
            assert_eq!(with_cube_size(&other, cube).unwrap(), robosuites, "{name}");
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
        let error = with_cube_size(mjcf, [0.02; 3]).unwrap_err().to_string();
        assert!(
            error.starts_with("cannot simulate Lift: ") && error.contains(expected),
            "{error}"
        );
    }
}

/// Ten thousand draws: in the ranges of the rules, spread evenly over them, and bit for bit those of robosuite's samplers.
#[test]
fn ten_thousand_draws_follow_the_rules() {
    for (task, name) in TASKS {
        let draws: Vec<Placement> = (0..10_000).map(|seed| Placement::draw(task, seed)).collect();
        let object = |index: usize, axis: usize| -> Vec<f64> {
            draws.iter().map(|draw| draw.objects[index].position[axis]).collect()
        };
        let (used, x, y) = match task {
            RobosuiteTask::Lift => (0, -0.03..0.03, -0.03..0.03),
            RobosuiteTask::Can => (3, -0.02..0.22, -0.42..-0.08),
            RobosuiteTask::Square => (0, -0.115..-0.11, 0.11..0.225),
        };
        let yaw: Vec<f64> = draws
            .iter()
            .map(|draw| {
                let [w, i, j, k] = draw.objects[used].quaternion;
                assert_eq!([i, j], [0.0, 0.0]);
                2.0 * k.atan2(w)
            })
            .collect();
        let even = |what: &str, numbers: Vec<f64>, range: std::ops::Range<f64>, allowed: f64| {
            let distance = kolmogorov_smirnov(numbers, &range);
            assert!(distance < allowed, "{name}: {what} is off by {distance}");
        };
        // 0.0195 is the distance that one uniform sample of 10,000 in a thousand exceeds. The can, placed last, keeps clear of
        // what lies in the bin already, which makes the middle of the bin rarer.
        let allowed = if task == RobosuiteTask::Can { 0.03 } else { 0.0195 };
        even("x", object(used, 0), x, allowed);
        even("y", object(used, 1), y, allowed);
        even("yaw", yaw, 0.0..std::f64::consts::TAU, 0.0195);
        for draw in &draws {
            let height = draw.objects[used].position[2];
            let expected = match draw.cube {
                Some(cube) => 0.81 + cube[2],
                None if task == RobosuiteTask::Can => 0.86,
                None => 0.89,
            };
            assert!((height - expected).abs() < 1e-12, "{name}: {height}");
            let away = draw.objects.iter().enumerate().filter(|(index, _)| *index != used);
            assert!(
                away.map(|(_, object)| object.position)
                    .all(|position| position == [10.0; 3])
            );
        }
        if task == RobosuiteTask::Lift {
            for axis in 0..3 {
                let sizes = draws.iter().map(|draw| draw.cube.unwrap()[axis]).collect();
                even("half size", sizes, 0.020..0.022, 0.0195);
            }
        }
        let turns = [0.0, 1.0 / 16.0, 0.0, -5.0 / 6.0, 0.0, 1.0, 0.25];
        for (joint, turn) in turns.into_iter().enumerate() {
            let mean = turn * PI - if joint == 5 { 0.2 } else { 0.0 };
            let angles = || draws.iter().map(|draw| draw.arm[joint] - mean);
            let average = angles().sum::<f64>() / 10_000.0;
            let variance = angles().map(|angle| (angle - average).powi(2)).sum::<f64>() / 9_999.0;
            // Four standard errors of mean and standard deviation.
            assert!(
                average.abs() < 4.0 * 0.02 / 100.0 + 1e-5,
                "{name}, joint {joint}: mean {average}"
            );
            assert!(
                (variance.sqrt() - 0.02).abs() < 4.0 * 0.02 / 20_000_f64.sqrt(),
                "{name}, joint {joint}: {variance}"
            );
        }
        let mut hash = Sha256::new();
        for draw in &draws {
            let object = &draw.objects[used];
            let numbers = draw.cube.into_iter().flatten().chain(draw.arm);
            for number in numbers.chain(object.position).chain(object.quaternion) {
                hash.update(number.to_le_bytes());
            }
        }
        let drawn = hash.finalize();
        for version in ["1.4.1", "1.5.1"] {
            let file = Reference::read(&format!("placement_{name}_{version}.bin.gz"));
            let expected = file.text("sha256_of_10000");
            for (index, byte) in drawn.iter().enumerate() {
                assert_eq!(
                    expected[2 * index..2 * index + 2],
                    format!("{byte:02x}"),
                    "{name}: {expected}"
                );
            }
        }
    }
}

/// Greatest distance between the distribution of a sample and the uniform one of a range, which every number must be in.
fn kolmogorov_smirnov(mut numbers: Vec<f64>, range: &std::ops::Range<f64>) -> f64 {
    numbers.sort_by(f64::total_cmp);
    let count = numbers.len() as f64;
    let mut greatest = 0.0_f64;
    for (index, number) in numbers.iter().enumerate() {
        // Rounding may reach the upper end, and yaw's way through sine and cosine both.
        let share = (number - range.start) / (range.end - range.start);
        let share = if number < &range.start { share + 1.0 } else { share };
        assert!((-1e-9..=1.0 + 1e-9).contains(&share), "{number} is not in {range:?}");
        let (below, above) = (index as f64 / count, (index + 1) as f64 / count);
        greatest = greatest.max((share - below).abs()).max((above - share).abs());
    }
    greatest
}
