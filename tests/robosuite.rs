//! Observations and success of robosuite tasks equal robosuite's on its own states. Skipped if datasets or simulators are
//! missing.

#[path = "../crates/re4-sim/tests/reference/mod.rs"]
mod reference;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use crate::support::repository;
use re4_ingest::IngestError;
use re4_ingest::robomimic::{Access, Demo, DemoChoice, RobomimicReader, Sources};
use re4_mujoco::Library;
use re4_robosuite::models::with_assets;
use re4_robosuite::physics::without_visuals;
use re4_sim::Simulator as _;
use re4_sim::robosuite::{FirstTorques, Profile, Robosuite, RobosuiteModel, RobosuiteScene, RobosuiteTask};
use reference::Reference;

/// Tasks for which there are demonstrations with states.
const TASKS: [&str; 3] = ["lift", "can", "square"];

/// The folder that a variable names, or a folder of the repository; if it does not exist, prints that the test is skipped.
fn folder(variable: &str, otherwise: &str, below: &str, how: &str) -> Option<PathBuf> {
    let path = std::env::var_os(variable)
        .map_or_else(|| repository().join(otherwise), PathBuf::from)
        .join(below);
    if !path.is_dir() {
        println!("skipped: no {}; {how}", path.display());
    }
    path.is_dir().then_some(path)
}

/// Demonstrations by number.
fn demonstrations(path: &Path) -> BTreeMap<u32, Demo> {
    let sources = Sources::open(path).unwrap();
    let reader = RobomimicReader::open(&sources, &DemoChoice::default(), Access::Library, None).unwrap();
    let mut demos = BTreeMap::new();
    reader
        .for_each::<Demo, IngestError>(
            0..reader.demos().len(),
            |_, demo| Ok(demo.unwrap()),
            |at, demo| {
                demos.insert(reader.demos()[at].number.unwrap(), demo);
                Ok(())
            },
        )
        .unwrap();
    demos
}

/// Maximum absolute difference.
fn max_difference(ours: &[f64], theirs: &[f64]) -> f64 {
    assert_eq!(ours.len(), theirs.len());
    assert!(ours.iter().all(|number| number.is_finite()));
    ours.iter().zip(theirs).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max)
}

/// Maximum absolute difference of two quaternions up to sign, since q and -q are the same rotation.
fn max_quaternion_difference(ours: &[f64], theirs: &[f64]) -> f64 {
    let negated: Vec<f64> = theirs.iter().map(|part| -part).collect();
    max_difference(ours, theirs).min(max_difference(ours, &negated))
}

#[test]
fn observations_and_success_match_robosuite() {
    let setup = "run scripts/setup-simulators.sh";
    let Some(simulators) = folder("RE4_SIMULATORS", "data/simulators", "", setup) else {
        return;
    };
    let data = "set RE4_DATA to the folder of the datasets";
    let Some(data) = folder("RE4_DATA", "../shared/data", "robomimic-scripted", data) else {
        return;
    };
    let profile = Profile::V1_4;
    let version = profile.mujoco();
    let library = Library::open(&simulators.join(format!("mujoco-{version}")), version).unwrap();
    for name in TASKS {
        let task = RobosuiteTask::named(name).unwrap();
        let references = repository().join("crates/re4-sim/tests/data/robosuite");
        let file = Reference::open(&references.join(format!("states_{name}_1.4.1.bin.gz")));
        assert_eq!((file.text("task"), file.text("robosuite")), (task.environment, "1.4.1"));
        let demos = demonstrations(&data.join(name).join("low_dim.hdf5"));
        let (numbers, frames) = (file.u32s("demo").numbers, file.u32s("frame").numbers);
        let (moved, success) = (file.u8s("moved").numbers, file.u8s("success").numbers);
        let (positions, objects) = (file.f64s("position"), file.f64s("object"));
        let (eef, hand) = (file.f64s("robot0_eef_pos"), file.f64s("robot0_eef_quat"));
        let fingers = file.f64s("robot0_gripper_qpos");
        let mut last: Option<(Arc<str>, Robosuite)> = None;
        let [mut poses, mut relative] = [0.0_f64; 2];
        let mut verdicts = [[0; 2]; 2];
        for row in 0..numbers.len() {
            let demo = &demos[&numbers[row]];
            let mjcf = demo.model.as_ref().unwrap();
            if last.as_ref().is_none_or(|(of, _)| of != mjcf) {
                let whole = with_assets(mjcf, &simulators.join("robosuite-1.4.1")).unwrap();
                let text = without_visuals(&whole).unwrap();
                let model = RobosuiteModel::compile(&library, task, profile, &text).unwrap();
                last = Some((Arc::clone(mjcf), Robosuite::new(&model).unwrap()));
            }
            let (_, simulation) = last.as_mut().unwrap();
            let states = demo.states.as_ref().unwrap();
            let mut state = states.values[frames[row] as usize * states.columns..][..states.columns].to_vec();
            if moved[row] == 1 {
                let at = 1 + simulation.model().mujoco().joint(file.text("joint")).unwrap().0;
                state[at..at + 3].copy_from_slice(positions.row(row));
            }
            let scene = RobosuiteScene::Recorded(state);
            let seen = simulation.reset(&scene, FirstTorques::AsRobosuite).unwrap();
            let object = seen.object_state(task, profile);
            let theirs = objects.row(row);
            poses = poses
                .max(max_difference(
                    seen.grip_site.translation.vector.as_slice(),
                    eef.row(row),
                ))
                .max(max_quaternion_difference(seen.hand.coords.as_slice(), hand.row(row)))
                .max(max_difference(&seen.fingers, fingers.row(row)))
                .max(max_difference(&object[..3], &theirs[..3]))
                .max(max_quaternion_difference(&object[3..7], &theirs[3..7]));
            relative = relative.max(max_difference(&object[7..10], &theirs[7..10]));
            if object.len() > 10 {
                relative = relative.max(max_quaternion_difference(&object[10..], &theirs[10..]));
            }
            let ours = u8::from(simulation.success());
            assert_eq!(
                ours, success[row],
                "{name}: row {row}, {} frame {}",
                demo.name, frames[row]
            );
            verdicts[usize::from(moved[row])][usize::from(ours)] += 1;
        }
        let [recorded, constructed] = verdicts.map(|verdicts| (verdicts[0] + verdicts[1], verdicts[1]));
        println!(
            "{name}: {} recorded states, {} successes; {} constructed, {} successes; verdicts equal; poses within {poses:.1e}, \
             relative pose within {relative:.1e}",
            recorded.0, recorded.1, constructed.0, constructed.1
        );
        assert!(recorded.0 + constructed.0 >= 1000 && verdicts.iter().flatten().all(|&count| count > 0));
        assert!(poses <= 1e-12, "{name}: {poses:e}");
        // The relative pose is less precise because robosuite converts matrices to quaternions and back in single precision.
        assert!(relative <= 1e-6, "{name}: {relative:e}");
    }
}
