//! Rollouts from scenes far from the demonstrations, on the sample in `data/`: the chosen scenes, the start states of rollouts,
//! the scores under smaller budgets of steps, and all error messages.

use std::fs;

use crate::support::{Place, assert_same_bytes, filters, folders_in, repository};
use insta::{assert_snapshot, with_settings};
use re4_artifact::{Row as _, Stage, col_bool, col_f64, col_u32};
use re4_ingest::{FrameRow, PlanarColumns};
use re4_stats::{mean_interval, wilson_interval};

/// A folder with `sparse.toml` (the sample, 12 scenes, 120 steps), and `small.toml`, which rolls out from seeds.
fn place() -> Place {
    let place = Place::empty();
    let small = fs::read_to_string(place.path().join("small.toml")).unwrap();
    let sample = repository().join("data/pusht-sample.zarr");
    let small = small
        .replace("small.zarr", sample.to_str().unwrap())
        .replace("max_steps = 60", "max_steps = 120");
    place.write("small.toml", &small);
    place.write_sparse();
    place
}

#[test]
fn scenes_are_chosen_rolled_out_and_kept() {
    let place = place();
    let first = place.run("run sparse.toml --jobs 1").done();
    let bytes = place.bytes();
    let second = place.run("run sparse.toml").done();
    assert_same_bytes(&bytes, &place.bytes());
    assert_eq!(first.stdout, second.stdout);
    for jobs in ["2", "4"] {
        let other = self::place();
        other.run(&format!("run sparse.toml --quiet --jobs {jobs}")).done();
        assert_same_bytes(&bytes, &other.bytes());
    }
    let mut masks = filters();
    masks.extend([
        (r"\d\.\d{3}\b", "[figure]"),
        (r"\b\d+ (chunks|frames|segments|transit frames)", "[n] $1"),
    ]);
    with_settings!({filters => masks}, {
        assert_snapshot!("run", format!("{}---\n{}", first.stderr, first.stdout));
        assert_snapshot!("again", second.stderr);
    });

    let scenes = place.artifact(Stage::Scenes);
    let scenes = scenes.table(re4_scenes::SceneRow::table()).unwrap().read_all().unwrap();
    let number = |name| col_u32(&scenes, name).unwrap().to_vec();
    assert_eq!(number("scene"), (0..12).collect::<Vec<_>>());
    assert_eq!(number("pose"), (0..12).map(|i| i / 2).collect::<Vec<_>>());
    assert_eq!(number("pusher"), (0..12).map(|i| i % 2).collect::<Vec<_>>());

    let rollouts = place.artifact(Stage::Rollout);
    assert_eq!(
        rollouts.manifest().inputs.keys().collect::<Vec<_>>(),
        ["episodes", "index", "scenes"]
    );
    let results = crate::support::results(&rollouts);
    assert_eq!(col_u32(&results, "seed").unwrap(), number("scene"));
    for (in_scenes, name) in [
        ("agent_x", "eef_x"),
        ("agent_y", "eef_y"),
        ("block_x", "object_x"),
        ("block_y", "object_y"),
        ("block_theta", "object_theta"),
    ] {
        let (asked, found) = (col_f64(&scenes, in_scenes).unwrap(), col_f64(&results, name).unwrap());
        for (asked, found) in asked.iter().zip(found) {
            assert!((asked - found).abs() < 1e-6, "{name}: {found} instead of {asked}");
        }
    }
}

/// Computes the nearest frame of every scene again from the episodes.
#[test]
fn the_nearest_frame_is_correct() {
    let place = place();
    place.run("scenes sparse.toml").done();
    assert!(
        folders_in(&place.artifacts().join("index")).is_empty(),
        "scenes need no index"
    );
    let frames = place.artifact(Stage::Ingest);
    let frames = frames
        .table(FrameRow::<PlanarColumns>::table())
        .unwrap()
        .read_all()
        .unwrap();
    let scenes = place.artifact(Stage::Scenes);
    let scenes = scenes.table(re4_scenes::SceneRow::table()).unwrap().read_all().unwrap();
    let tau = std::f64::consts::TAU;
    let demonstrated = ["object_x", "object_y", "object_theta"].map(|name| col_f64(&frames, name).unwrap());
    let chosen = ["block_x", "block_y", "block_theta"].map(|name| col_f64(&scenes, name).unwrap());
    let spans = demonstrated.map(|values| {
        let wrapped = values.iter().map(|v| if *v < 0.0 { v + tau } else { *v });
        let (low, high) = wrapped.fold((f64::MAX, f64::MIN), |(low, high), v| (low.min(v), high.max(v)));
        high - low
    });
    let (episode, frame) = (col_u32(&frames, "episode").unwrap(), col_u32(&frames, "frame").unwrap());
    let [x, y, theta] = chosen;
    for scene in 0..scenes.num_rows() {
        let pose = [x[scene], y[scene], theta[scene]];
        let distance = |row: usize| {
            let part = |i: usize| (pose[i] - demonstrated[i][row]).abs();
            let angle = part(2).rem_euclid(tau);
            let angle = angle.min(tau - angle);
            (part(0) / spans[0]).hypot(part(1) / spans[1]).hypot(angle / spans[2])
        };
        let minimum = (0..frames.num_rows()).map(distance).fold(f64::MAX, f64::min);
        let rho = col_f64(&scenes, "rho").unwrap()[scene];
        assert!((rho - minimum).abs() < 1e-9, "scene {scene}: {rho} is not {minimum}");
        let named = [
            col_u32(&scenes, "nearest_demo").unwrap()[scene],
            col_u32(&scenes, "nearest_frame").unwrap()[scene],
        ];
        let row = (0..frames.num_rows())
            .find(|&row| [episode[row], frame[row]] == named)
            .unwrap();
        assert!((distance(row) - minimum).abs() < 1e-9, "scene {scene}: frame {named:?}");
    }
}

/// Computes table `budgets` again from the steps, for scenes and for seeds.
#[test]
fn budgets_match_the_steps() {
    let place = place();
    // Maximum numbers of steps below 50, at a multiple of 50, and above one.
    for (arguments, expected) in [
        ("sparse.toml", vec![50, 100, 120]),
        ("small.toml --set rollout.seeds=500..530 --max-steps 100", vec![50, 100]),
        ("small.toml --max-steps 20", vec![20]),
    ] {
        let object = place.run(&format!("run {arguments} --json")).done().json();
        let path = place.path().join(object["artifact"].as_str().unwrap());
        let artifact = re4_artifact::Artifact::open(&path).unwrap();
        let read = |table| artifact.table(table).unwrap().read_all().unwrap();
        let (results, steps, budgets) = (
            crate::support::results(&artifact),
            crate::support::steps(&artifact),
            read(re4_stages::tables::of(re4_artifact::Stage::Rollout).pop().unwrap()),
        );
        assert_eq!(col_u32(&budgets, "budget").unwrap(), expected);
        let numbers = col_u32(&results, "seed").unwrap();
        assert!(
            col_u32(&budgets, "rollouts")
                .unwrap()
                .iter()
                .all(|n| *n as usize == numbers.len())
        );
        let mut before = 0.0;
        for (row, &budget) in expected.iter().enumerate() {
            for (measure, name) in [
                ("score", "score_mean"),
                ("coverage", "coverage_mean"),
                ("iou", "iou_mean"),
            ] {
                let values = col_f64(&steps, measure).unwrap();
                let reached: Vec<f64> = numbers
                    .iter()
                    .map(|number| {
                        let seeds = col_u32(&steps, "seed")
                            .unwrap()
                            .iter()
                            .zip(col_u32(&steps, "step").unwrap());
                        let within = seeds
                            .zip(values)
                            .filter(|((s, step), _)| *s == number && **step < budget);
                        within.map(|(_, value)| *value).fold(0.0, f64::max)
                    })
                    .collect();
                let interval = mean_interval(&reached, 0);
                let stated = ["mean", "low", "high"].map(|part| {
                    let column = name.replace("mean", part);
                    col_f64(&budgets, &column).unwrap()[row]
                });
                assert_eq!(
                    stated,
                    [interval.value, interval.low, interval.high],
                    "{name} of {budget}"
                );
            }
            let done = col_bool(&results, "success").unwrap();
            let successes = (0..numbers.len())
                .filter(|&i| done.value(i) && col_u32(&results, "steps").unwrap()[i] <= budget)
                .count();
            let interval = wilson_interval(successes as u64, numbers.len() as u64);
            let stated =
                ["rate", "low", "high"].map(|part| col_f64(&budgets, &format!("success_{part}")).unwrap()[row]);
            assert_eq!(
                stated,
                [interval.value, interval.low, interval.high],
                "successes of {budget}"
            );
            let score = col_f64(&budgets, "score_mean").unwrap()[row];
            assert!(score >= before, "the score decreases with more steps");
            before = score;
        }
        let last = expected.len() - 1;
        for (metric, column) in [
            ("score_scaled_mean", "score"),
            ("coverage_raw_mean", "coverage"),
            ("iou_mean", "iou"),
        ] {
            for (key, part) in [("value", "mean"), ("low", "low"), ("high", "high")] {
                let stated = col_f64(&budgets, &format!("{column}_{part}")).unwrap()[last];
                assert_eq!(
                    object["metrics"][metric][key].as_f64().unwrap(),
                    stated,
                    "{metric}.{key}"
                );
            }
        }
        let rows = object.get("budgets").map(|rows| rows.as_array().unwrap());
        assert_eq!(
            rows.is_some(),
            arguments.starts_with("sparse"),
            "the score is the same for all budgets"
        );
        for (row, stated) in rows.into_iter().flatten().enumerate() {
            assert_eq!(stated["budget"], expected[row]);
            for (metric, column) in [("score_scaled_mean", "score_low"), ("success_rate", "success_low")] {
                assert_eq!(stated[metric]["low"], col_f64(&budgets, column).unwrap()[row]);
            }
        }
    }
}

#[test]
fn settings_rebuild_the_dependent_stages() {
    let place = place();
    place.run("run sparse.toml").done();
    let count = |kind: &str| folders_in(&place.artifacts().join(kind)).len();
    let counts = || ["episodes", "index", "scenes", "rollouts"].map(count);
    assert_eq!(counts(), [1, 1, 1, 1]);
    place.run("run sparse.toml --policy paper").done();
    assert_eq!(counts(), [1, 1, 1, 2], "scenes do not depend on the policy");
    place.run("run sparse.toml --set scenes.seed=1").done();
    assert_eq!(counts(), [1, 1, 2, 3]);
    place
        .run("run sparse.toml --set rollout.seed_scheme=gym_pusht --set rollout.reset=pose")
        .done();
    assert_eq!(counts(), [1, 1, 2, 3], "scenes do not depend on settings of seeds");
    place.run("run sparse.toml --set ingest.select.first=20").done();
    assert_eq!(counts(), [2, 2, 3, 4], "scenes depend on the selected demonstrations");
}

#[test]
fn refusals() {
    let place = place();
    let mut sentences = Vec::new();
    for arguments in [
        "scenes small.toml",
        "run sparse.toml --seeds 500..506",
        "run small.toml --set scenes.kind=sparse_observations",
        "run sparse.toml --set scenes.kind=dense",
        "run sparse.toml --set scenes.pose=3",
        "run sparse.toml --set scenes.grid=1",
        "run sparse.toml --set scenes.grid=201",
        "run sparse.toml --set scenes.poses=0",
        "run sparse.toml --set scenes.pushers=0",
        "run sparse.toml --set scenes.pushers=-1",
        "run sparse.toml --set scenes.padding_position=-1",
        "run sparse.toml --set scenes.padding_position=nan",
        "run sparse.toml --set scenes.padding_angle=7",
        "run sparse.toml --set scenes.separation=-0.1",
        "run sparse.toml --set scenes.clearance=-1",
        "run sparse.toml --set scenes.angle=degrees",
        "run sparse.toml --max-steps 100001",
        "scenes sparse.toml --quiet --set scenes.separation=2",
        "scenes sparse.toml --quiet --set scenes.clearance=500",
    ] {
        sentences.push(format!(
            "re4-pipe {arguments}\n  {}",
            place.run(arguments).refused_at_once()
        ));
    }
    let small = fs::read_to_string(place.path().join("small.toml")).unwrap();
    place.write("nothing.toml", small.replace("seeds = \"500..506\"\n", ""));
    let sentence = place.run("run nothing.toml").refused_at_once();
    sentences.push(format!("neither seeds nor scenes\n  {sentence}"));
    assert_snapshot!(sentences.join("\n"));
    assert!(folders_in(&place.artifacts().join("scenes")).is_empty());
    assert!(place.temporaries().is_empty());
}
