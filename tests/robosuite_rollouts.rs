//! Rollouts and replays of robosuite tasks in MuJoCo, from demonstrations to tables. The tests need the datasets in the folder
//! that `RE4_DATA` names (or in ../shared/data), and the simulators in the folder that `RE4_SIMULATORS` names (or in
//! data/simulators, where scripts/setup-simulators.sh installs them).

use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::path::Path;
use std::process::Command;

use crate::support::{
    Answer, Place, artifact_bytes, assert_same_bytes, compare_with_schemas, filters, scripted_and_simulators,
};
use insta::{assert_snapshot, with_settings};
use re4_artifact::Row as _;
use re4_artifact::{Artifact, Stage, col_bool, col_f64, col_f64_list, col_text, col_u32};
use re4_sim::robosuite::RobosuiteTask;

fn pipeline(task: &str, source: &Path) -> String {
    format!(
        r#"task = "{task}"
variant = "state"
[ingest]
source = "{}"
select = {{ first = 20 }}
[segment]
[pose]
source = "recorded"
[index]
leave_out = ["missed_grasp", "lost_grasp"]
[rollout]
policy = "re4"
seeds = "200000..200004"
"#,
        source.display()
    )
}

fn run(place: &Place, simulators: &Path, arguments: &str) -> Answer {
    let mut command: Command = place.command();
    command
        .env("RE4_SIMULATORS", simulators)
        .args(arguments.split_whitespace());
    Answer::new(&command.output().unwrap(), place.path())
}

fn only(place: &Place, artifacts: &str, stage: Stage) -> Artifact {
    let mut folders = crate::support::folders_in(&place.path().join(artifacts).join(stage.artifact()));
    assert_eq!(folders.len(), 1);
    Artifact::open(&folders.remove(0)).unwrap()
}

#[test]
fn lift_succeeds_and_its_tables_are_consistent() {
    let Some((data, simulators)) = scripted_and_simulators() else {
        return;
    };
    let place = Place::empty();
    place.write("lift.toml", pipeline("lift", &data.join("lift/low_dim.hdf5")));
    run(&place, &simulators, "rollout lift.toml --jobs 1 --artifacts one").done();
    run(&place, &simulators, "rollout lift.toml --jobs 2 --artifacts two").done();
    assert_same_bytes(
        &artifact_bytes(&place.path().join("one")),
        &artifact_bytes(&place.path().join("two")),
    );

    let rollouts = only(&place, "one", Stage::Rollout);
    let results = crate::support::results(&rollouts);
    let steps = crate::support::steps(&rollouts);
    let decisions = crate::support::decisions(&rollouts);
    let seeds = col_u32(&results, "seed").unwrap();
    assert_eq!(seeds, [200_000, 200_001, 200_002, 200_003]);
    assert!((0..4).all(|row| col_bool(&results, "success").unwrap().value(row)));
    // Every step and every decision is counted once, and the success of a rollout is that of its last step.
    let (of_steps, of_decisions) = (col_u32(&steps, "seed").unwrap(), col_u32(&decisions, "seed").unwrap());
    let heights = col_f64(&steps, "object_z").unwrap();
    for (row, seed) in seeds.iter().enumerate() {
        let own: Vec<usize> = (0..of_steps.len()).filter(|at| of_steps[*at] == *seed).collect();
        assert_eq!(own.len() as u32, col_u32(&results, "steps").unwrap()[row]);
        let decided = of_decisions.iter().filter(|of| *of == seed).count();
        assert_eq!(decided as u32, col_u32(&results, "decisions").unwrap()[row]);
        // Lift's success rule: the cube is 4 cm above the table.
        let last = *own.last().unwrap();
        assert!(heights[last] > 0.84 && heights[last - 1] <= 0.84);
    }
    // The retrieved frame is retrievable and has the mode of the query.
    let index = only(&place, "one", Stage::Index);
    let indexed = index
        .table(re4_index::IndexRow::<re4_index::SpatialState>::table())
        .unwrap()
        .read_all()
        .unwrap();
    let (episodes, frames) = (
        col_u32(&indexed, "episode").unwrap(),
        col_u32(&indexed, "frame").unwrap(),
    );
    let modes = col_text(&indexed, "mode").unwrap();
    let place_of: BTreeMap<(u32, u32), usize> = (0..episodes.len()).map(|i| ((episodes[i], frames[i]), i)).collect();
    let kinds = col_text(&decisions, "kind").unwrap();
    let query = col_text(&decisions, "mode").unwrap();
    let demo = re4_artifact::col_u32_or_null(&decisions, "demo").unwrap();
    let frame = re4_artifact::col_u32_or_null(&decisions, "demo_frame").unwrap();
    let mut retrieved = 0;
    for row in (0..kinds.len()).filter(|row| kinds[*row] == Some("retrieve")) {
        let at = place_of[&(demo[row].unwrap(), frame[row].unwrap())];
        assert_eq!(modes[at], query[row]);
        assert!(col_bool(&indexed, "retrievable").unwrap().value(at));
        retrieved += 1;
    }
    assert!(retrieved >= 4);
    // The state after the reset is what robosuite samples for the seed: arm noise about the initial pose, fingers, cube at rest.
    let states = col_f64_list(&results, "state").unwrap();
    assert!(
        states
            .iter()
            .all(|state| state.len() == 1 + 16 + 15 && state[0] == 0.0 && state[17..].iter().all(|v| *v == 0.0))
    );
}

#[test]
fn replays_follow_the_recording_and_gate() {
    let Some((data, simulators)) = scripted_and_simulators() else {
        return;
    };
    let place = Place::empty();
    let text = pipeline("lift", &data.join("lift/low_dim.hdf5")).replace("first = 20", "first = 3");
    place.write("lift.toml", text);
    run(&place, &simulators, "replay lift.toml --fail-under 1").done();
    let replays = only(&place, "artifacts", Stage::Replay);
    let table = replays
        .table(re4_stages::ReplayRow::<re4_stages::SpatialReplay>::table())
        .unwrap()
        .read_all()
        .unwrap();
    assert_eq!(
        col_text(&table, "actions").unwrap()[..2],
        [Some("delta"), Some("absolute")]
    );
    assert_eq!(
        col_text(&table, "origin").unwrap()[..2],
        [Some("recorded"), Some("converted")]
    );
    for (kind, arm) in col_text(&table, "actions")
        .unwrap()
        .iter()
        .zip(col_f64(&table, "arm_max").unwrap())
    {
        // Recorded deltas go through the controller's own arithmetic. Converted goals are rounded once more, to single precision,
        // so they deviate more.
        let bound = if *kind == Some("delta") { 1e-7 } else { 1e-6 };
        assert!(*arm < bound, "{kind:?}: {arm}");
    }
    run(&place, &simulators, "rollout lift.toml --seeds 200000..200001").done();
    let compared = compare_with_schemas(&place);
    for name in [
        "results",
        "steps",
        "decisions",
        "decisions_re4",
        "replays",
        "divergence",
        "index",
    ] {
        assert!(compared.contains(&format!("{name}-space")), "{name}");
    }
    // A demonstration truncated before the lift fails, so the gate fails.
    let Some(python) = std::env::var_os("RE4_PYTHON") else {
        println!("skipped the gate: RE4_PYTHON is not set");
        return;
    };
    let script = format!(
        r"
import h5py
with h5py.File({:?}) as whole, h5py.File('cut.hdf5', 'w') as cut:
    data = cut.create_group('data')
    data.attrs.update({{k: v for k, v in whole['data'].attrs.items() if k != 'total'}})
    demo = data.create_group('demo_0')
    demo.attrs.update(whole['data/demo_0'].attrs)
    demo.attrs['num_samples'] = 30
    def copy(name, entry):
        if isinstance(entry, h5py.Dataset):
            demo[name] = entry[:30]
    whole['data/demo_0'].visititems(copy)
",
        data.join("lift/low_dim.hdf5")
    );
    let written = Command::new(python)
        .args(["-c", &script])
        .current_dir(place.path())
        .output()
        .unwrap();
    assert!(written.status.success(), "{}", String::from_utf8_lossy(&written.stderr));
    place.write(
        "cut.toml",
        "task = \"lift\"\n[ingest]\nsource = \"cut.hdf5\"\n[segment]\n",
    );
    let answer = run(&place, &simulators, "replay cut.toml --fail-under 0.5");
    assert_eq!(answer.code, Some(1), "{}{}", answer.stdout, answer.stderr);
    assert!(answer.stdout.contains("0 of 1 succeed"), "{}", answer.stdout);
    run(&place, &simulators, "replay cut.toml").done();
}

/// Everything that prevents a simulation from starting gives one sentence and exit code 2.
#[test]
fn missing_simulators_and_unusable_settings() {
    let Some((data, simulators)) = scripted_and_simulators() else {
        return;
    };
    let place = Place::empty();
    let lift = data.join("lift/low_dim.hdf5");
    let text = pipeline("lift", &lift).replace("first = 20", "first = 1");
    place.write("lift.toml", &text);
    let empty = place.path().join("none");
    let mut errors = String::new();
    let mut refuse = |what: &str, simulators: &Path, arguments: &str| {
        let sentence = run(&place, simulators, &format!("{arguments} --quiet")).refused();
        writeln!(errors, "{what}\n  {}", sentence.trim_end()).unwrap();
    };
    refuse("no simulators", &empty, "rollout lift.toml");
    refuse("no simulators, replay", &empty, "replay lift.toml");
    refuse("--record", &simulators, "rollout lift.toml --record out.zarr");
    refuse("--plot", &simulators, "replay lift.toml --plot out.svg");
    let settings = [
        ("unknown policy", "rollout.policy=re5"),
        ("unknown key", "rollout.retrieve.epsilon=1"),
        ("no horizon", "rollout.replay.horizon=0"),
        ("no steps", "rollout.max_steps=0"),
        ("negative noise", "rollout.noise={translation=-1,rotation=0}"),
        ("no axis", "rollout.symmetry={kind=\"full\",axis=[0,0,0]}"),
        ("unknown check", "index.leave_out=[\"nonsense\"]"),
        ("images", "variant=\"image\""),
        ("log-polar", "pose.source=\"log_polar\""),
        ("scenes", "scenes={kind=\"sparse_observations\"}"),
        ("inner name", "spatial_rollout={policy=\"re4\"}"),
        ("Push-T's key", "rollout.reset=\"legacy\""),
        ("another task", "task=\"can\""),
        ("any environment", "task=\"robosuite\""),
    ];
    for (what, setting) in settings {
        refuse(what, &simulators, &format!("rollout lift.toml --set {setting}"));
    }
    let mut filters = filters();
    filters.push((data.to_str().unwrap(), "[data]"));
    filters.push((simulators.to_str().unwrap(), "[simulators]"));
    let folder = place.path().canonicalize().unwrap();
    filters.push((folder.to_str().unwrap(), "[folder]"));
    // The list of tasks is filtered, so that a new task does not change the snapshot.
    let errors = errors.replace(&RobosuiteTask::known(), "[tasks]");
    with_settings!({ filters => filters }, { assert_snapshot!(errors) });
}

/// Every step of the policy and every optional table can be switched off.
#[test]
fn steps_of_the_policy_can_be_switched_off() {
    let Some((data, simulators)) = scripted_and_simulators() else {
        return;
    };
    let place = Place::empty();
    place.write("lift.toml", pipeline("lift", &data.join("lift/low_dim.hdf5")));
    let phases = |settings: &str, artifacts: &str| {
        run(
            &place,
            &simulators,
            &format!("rollout lift.toml --seeds 200000..200001 --artifacts {artifacts} {settings}"),
        )
        .done();
        let rollouts = only(&place, artifacts, Stage::Rollout);
        let steps = crate::support::steps(&rollouts);
        let decisions = crate::support::decisions(&rollouts);
        let bridged = col_text(&steps, "phase").unwrap().contains(&Some("bridge"));
        let moved = re4_artifact::col_f64_or_null(&decisions, "delta_x").unwrap();
        (bridged, moved.iter().flatten().any(|x| *x != 0.0))
    };
    assert_eq!(phases("", "all"), (true, true));
    assert_eq!(phases("--set rollout.replan.enabled=false", "no-bridge"), (false, true));
    assert!(!phases("--set rollout.reframe.enabled=false", "no-reframe").1);
    assert_eq!(phases("--policy re2", "re2"), (false, false));
    phases(
        "--set rollout.filter=false --set rollout.recovery.ban=false --set rollout.retrieve.commit_margin=false",
        "plain",
    );
    let config = only(&place, "plain", Stage::Rollout).manifest().config.clone();
    assert!(config["policy"]["filter"].is_null() && config["policy"]["recovery"]["ban"].is_null());
    assert!(config["policy"]["retrieve"]["commit_margin"].is_null());
}
