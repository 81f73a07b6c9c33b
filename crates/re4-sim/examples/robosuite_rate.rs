//! Repeats the actions of a reference trace on one thread and prints the number of policy steps per second.
//!
//! `cargo run --release -p re4-sim --example robosuite_rate TRACE [EPISODES]`, with the simulators in the folder that
//! `RE4_SIMULATORS` names or in data/simulators. Resets are not timed. `steps_per_s_fast` is the rate of `Fidelity::Fast`. The
//! differences are the maximum deviations of the coordinates from those of the trace within the given numbers of policy steps.
#![expect(clippy::print_stdout, reason = "this example prints its results")]

#[path = "../tests/reference/mod.rs"]
mod reference;

use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use re4_mujoco::Library;
use re4_robosuite::models::with_assets;
use re4_robosuite::physics::{without_contacts, without_visuals};
use re4_sim::Simulator;
use re4_sim::robosuite::{
    ArmAction, Fidelity, FirstTorques, Profile, Robosuite, RobosuiteAction, RobosuiteModel, RobosuiteScene,
    RobosuiteTask,
};
use reference::Reference;
use serde_json::json;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut arguments = std::env::args().skip(1);
    let name = arguments.next().ok_or("usage: robosuite_rate TRACE [EPISODES]")?;
    let episodes: u32 = arguments.next().map_or(Ok(5), |text| text.parse())?;
    let trace = Reference::open(Path::new(&name));
    let task = RobosuiteTask::of_environment(trace.text("task")).ok_or("the trace is of another task")?;
    let profile = Profile::of(trace.text("robosuite")).ok_or("the trace is of another version of robosuite")?;

    let simulators = std::env::var_os("RE4_SIMULATORS").map_or_else(|| PathBuf::from("data/simulators"), PathBuf::from);
    let library = Library::open(
        &simulators.join(format!("mujoco-{}", profile.mujoco())),
        profile.mujoco(),
    )?;
    // Rollouts simulate the same reduced model, without the parts that only rendering needs.
    let mjcf = without_visuals(&with_assets(trace.text("xml"), &simulators.join("robosuite-1.4.1"))?)?;
    let apart = without_contacts(&mjcf, &task.unused_bodies())?;

    let numbers = trace.f64s("actions");
    let actions: Vec<RobosuiteAction> = (0..numbers.shape[0])
        .map(|step| {
            let row = numbers.row(step);
            let arm = std::array::from_fn(|i| row[i]);
            RobosuiteAction {
                arm: match trace.text("control") {
                    "delta" => ArmAction::Delta(arm),
                    _ => ArmAction::Absolute(arm),
                },
                gripper: row[6],
            }
        })
        .collect();
    let scene = RobosuiteScene::Recorded(trace.f64s("initial_state").numbers);
    let coordinates = trace.f64s("qpos");

    let measure = |mjcf: &str, fidelity| -> Result<(f64, Vec<f64>), Box<dyn std::error::Error>> {
        let model = RobosuiteModel::compile(&library, task, profile, mjcf)?;
        let mut simulator = Robosuite::new(&model.with_fidelity(fidelity))?;
        let mut spent = Duration::ZERO;
        let mut differences = Vec::new();
        for _ in 0..episodes {
            differences.clear();
            simulator.reset(&scene, FirstTorques::Fresh)?;
            simulator.set_solver_start(&trace.f64s("qacc_warmstart").numbers);
            for (step, action) in actions.iter().enumerate() {
                let start = Instant::now();
                simulator.step(action)?;
                spent += start.elapsed();
                let pairs = simulator.data().qpos().iter().zip(coordinates.row(step + 1));
                differences.push(pairs.map(|(ours, theirs)| (ours - theirs).abs()).fold(0.0, f64::max));
            }
        }
        Ok((
            f64::from(episodes) * actions.len() as f64 / spent.as_secs_f64(),
            differences,
        ))
    };
    let (steps_per_s, differences) = measure(&mjcf, Fidelity::Robosuite)?;
    let (fast, _) = measure(&apart, Fidelity::Fast)?;
    let differences = [10, 20, 30, 60].map(|steps| differences.iter().take(steps).copied().fold(0.0, f64::max));
    println!(
        "{}",
        json!({
            "task": trace.text("task"),
            "robosuite": trace.text("robosuite"),
            "steps_per_s": steps_per_s,
            "steps_per_s_fast": fast,
            "maximum_difference_in_10_20_30_60_steps": differences,
        })
    );
    Ok(())
}
