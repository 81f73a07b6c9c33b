//! Invalid libraries, models, states and actions are reported in one sentence.
#![allow(
    clippy::unwrap_used,
    clippy::panic,
    clippy::print_stdout,
    reason = "a test may panic"
)]

mod reference;
mod simulators;

use std::fs;

use re4_fault::Remedy;
use re4_mujoco::{Library, Version};
use re4_robosuite::models::with_assets;
use re4_sim::Simulator as _;
use re4_sim::robosuite::{
    ArmAction, FirstTorques, Robosuite, RobosuiteAction, RobosuiteModel, RobosuiteScene, RobosuiteTask,
};
use simulators::{Form, Trace, library, simulators};
use tempfile::TempDir;

/// An empty temporary folder.
fn folder() -> TempDir {
    TempDir::new().unwrap()
}

/// The error message as a user reads it, with its remedy.
fn sentence<T>(result: Result<T, impl Remedy>) -> String {
    let text = result.err().unwrap().sentence();
    assert!(!text.contains('\n'), "{text}");
    text
}

#[test]
fn a_missing_library_is_reported() {
    let place = folder();
    let folder = place.path();
    for version in Version::ALL {
        assert_eq!(
            sentence(Library::open(folder, version)),
            format!(
                "MuJoCo's library does not exist at {}/libmujoco.so; run scripts/setup-simulators.sh, or set the environment variable \
                 RE4_SIMULATORS to the folder that it created",
                folder.display()
            )
        );
    }
}

#[test]
fn a_library_of_another_version_is_reported() {
    let Some(simulators) = simulators() else { return };
    let other = simulators.join("mujoco-3.2.7");
    let expected = format!(
        "the library {}/libmujoco.so is MuJoCo 3.2.7, not 2.3.7; remove it and run scripts/setup-simulators.sh",
        other.display()
    );
    assert_eq!(sentence(Library::open(&other, Version::V2_3_7)), expected);
    // Also when the library was loaded before with the right version.
    Library::open(&other, Version::V3_2_7).unwrap();
    assert_eq!(sentence(Library::open(&other, Version::V2_3_7)), expected);
}

#[test]
fn a_truncated_library_is_reported() {
    let Some(simulators) = simulators() else { return };
    for version in Version::ALL {
        let whole = fs::read(simulators.join(format!("mujoco-{version}/libmujoco.so"))).unwrap();
        for length in [0, 40, 5000, whole.len() / 2, whole.len() - 100] {
            let place = folder();
            let folder = place.path();
            fs::write(folder.join("libmujoco.so"), &whole[..length]).unwrap();
            assert_eq!(
                sentence(Library::open(folder, version)),
                format!(
                    "cannot load MuJoCo's library {}/libmujoco.so: the file is truncated; remove it and run \
                     scripts/setup-simulators.sh",
                    folder.display()
                )
            );
        }
        let place = folder();
        let folder = place.path();
        fs::write(
            folder.join("libmujoco.so"),
            "no library, but longer than a header of sixty-four bytes would be",
        )
        .unwrap();
        assert_eq!(
            sentence(Library::open(folder, version)),
            format!(
                "cannot load MuJoCo's library {}/libmujoco.so: the file is not a shared library; remove it and run \
                 scripts/setup-simulators.sh",
                folder.display()
            )
        );
    }
}

#[test]
fn a_model_that_does_not_parse_is_reported() {
    let Some(simulators) = simulators() else { return };
    let trace = Trace::read("lift_1.4.1_absolute");
    let library = library(&simulators, trace.profile);
    let compile = |mjcf: &str| sentence(RobosuiteModel::compile(&library, trace.task, trace.profile, mjcf));
    assert_eq!(
        compile("<mujoco><worldbody><body></worldbody></mujoco>"),
        "cannot simulate Lift: MuJoCo cannot compile the model: XML parse error 14: Error=XML_ERROR_MISMATCHED_ELEMENT ErrorID=14 (0xe) Line number=1: XMLElement name=body"
    );
    assert_eq!(
        compile("<mujoco><worldbody><ball/></worldbody></mujoco>"),
        "cannot simulate Lift: MuJoCo cannot compile the model: XML Error: Schema violation: unrecognized element Element 'ball', line 1"
    );
    assert_eq!(
        sentence(with_assets("<mujoco><worldbody>", &simulators)),
        "the model is not valid XML: the root node was opened but never closed"
    );
    assert_eq!(
        sentence(with_assets("<robot/>", &simulators)),
        "the model's root element is <robot>, not <mujoco>"
    );
}

#[test]
fn a_missing_mesh_is_reported() {
    let Some(simulators) = simulators() else { return };
    let trace = Trace::read("lift_1.4.1_absolute");
    let assets = simulators.join("robosuite-1.4.1");
    let mesh = "/link0.stl";
    let named = trace
        .file
        .text("xml")
        .split('"')
        .find(|text| text.ends_with(mesh))
        .unwrap()
        .to_owned();
    let lost = named.replace(mesh, "/lost.stl");
    let mjcf = trace.file.text("xml").replace(&named, &lost);
    assert_eq!(
        sentence(with_assets(&mjcf, &assets)),
        format!(
            "the model refers to the file {lost}, which does not exist at {}; run scripts/setup-simulators.sh, or set the \
             environment variable RE4_SIMULATORS to the folder that it created",
            lost.replacen("robosuite", &std::path::absolute(&assets).unwrap().to_string_lossy(), 1)
        )
    );
    let library = library(&simulators, trace.profile);
    let whole = trace.mjcf(&simulators);
    let mjcf = whole.replace(mesh, "/lost.stl");
    assert_eq!(
        sentence(RobosuiteModel::compile(&library, trace.task, trace.profile, &mjcf)),
        format!(
            "cannot simulate Lift: MuJoCo cannot compile the model: Error: file not found: '{}/models/assets/robots/panda/meshes/lost.stl'",
            std::path::absolute(&assets).unwrap().display()
        )
    );
}

#[test]
fn a_model_of_another_task_or_version_is_reported() {
    let Some(simulators) = simulators() else { return };
    let of = |name| Trace::read(name);
    let compile = |name, task| {
        let trace = of(name);
        let mjcf = trace.mjcf(&simulators);
        sentence(RobosuiteModel::compile(
            &trace.library(&simulators),
            RobosuiteTask::named(task).unwrap(),
            trace.profile,
            &mjcf,
        ))
    };
    assert_eq!(
        compile("can_1.4.1_absolute", "lift"),
        "cannot simulate Lift: the model has no joint cube_joint0; use the model_file of a demonstration of Lift"
    );
    assert_eq!(
        compile("lift_1.5.1_absolute", "square"),
        "cannot simulate NutAssemblySquare: the model has no joint SquareNut_joint0; use the model_file of a demonstration of NutAssemblySquare"
    );
    let (old, new) = (of("lift_1.4.1_absolute"), of("lift_1.5.1_absolute"));
    assert_eq!(
        sentence(RobosuiteModel::compile(
            &new.library(&simulators),
            new.task,
            new.profile,
            &old.mjcf(&simulators)
        )),
        "cannot simulate Lift: the model has no joint gripper0_right_finger_joint1; use the model_file of a demonstration of Lift"
    );
    let library = old.library(&simulators);
    let empty = "<mujoco><worldbody/></mujoco>";
    assert_eq!(
        sentence(RobosuiteModel::compile(&library, old.task, old.profile, empty)),
        "cannot simulate Lift: the model has 0 actuators, a Panda with its gripper has 9; use the model_file of a demonstration of Lift"
    );
    let slower = old.mjcf(&simulators).replace("<option ", "<option timestep=\"0.004\" ");
    assert_eq!(
        sentence(RobosuiteModel::compile(&library, old.task, old.profile, &slower)),
        "cannot simulate Lift: the model's time step is 0.004 s, not 0.002 s; use the model_file of a demonstration of Lift"
    );
}

#[test]
fn invalid_states_and_actions_are_reported() {
    let Some(simulators) = simulators() else { return };
    let trace = Trace::read("lift_1.4.1_absolute");
    let mut simulation = Robosuite::new(&trace.model(&simulators, Form::Physics)).unwrap();
    let state = trace.file.f64s("initial_state").numbers;
    let mut reset = |scene| sentence(simulation.reset(&scene, FirstTorques::AsRobosuite));
    assert_eq!(
        reset(RobosuiteScene::Recorded(state[1..].to_vec())),
        "cannot reset Lift: the state has 31 numbers, the model needs 32 (time, 16 coordinates, 15 velocities); use the states and the model_file of the same demonstration"
    );
    assert_eq!(
        reset(RobosuiteScene::Recorded(Vec::new())),
        "cannot reset Lift: the state has 0 numbers, the model needs 32 (time, 16 coordinates, 15 velocities); use the states and the model_file of the same demonstration"
    );
    assert_eq!(
        reset(RobosuiteScene::Placed(state.clone())),
        "cannot reset Lift: the state has 32 numbers, the model needs 16 (coordinates only); use the states and the model_file of the same demonstration"
    );
    for (value, at) in [(f64::NAN, 3), (f64::INFINITY, 0), (1e10, 31)] {
        let mut state = state.clone();
        state[at] = value;
        assert_eq!(
            reset(RobosuiteScene::Recorded(state)),
            format!("cannot reset Lift: number {at} of the state is {value}; give finite numbers")
        );
    }
    simulation.reset(&trace.scene(), FirstTorques::AsRobosuite).unwrap();
    let before = simulation.state();
    for at in 0..7 {
        for (value, written) in [(f64::NAN, "NaN"), (f64::NEG_INFINITY, "-inf")] {
            let mut numbers = [0.0; 7];
            numbers[at] = value;
            let arm: [f64; 6] = std::array::from_fn(|i| numbers[i]);
            for arm in [ArmAction::Delta(arm), ArmAction::Absolute(arm)] {
                let action = RobosuiteAction {
                    arm,
                    gripper: numbers[6],
                };
                assert_eq!(
                    sentence(simulation.step(&action)),
                    format!("cannot step Lift: number {at} of the action is {written}; give finite numbers")
                );
            }
        }
    }
    assert_eq!(simulation.state(), before);
    simulation.step(&trace.actions[0]).unwrap();
}
