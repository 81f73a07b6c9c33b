//! Refuses files of other simulators, of another task, and of two arms, which are not supported.

use re4_robosuite::conventions::RobosuiteTask;
use re4_robosuite::env_args::EnvArgs;

use super::super::fault::Hdf5Fault;
use super::super::reader::RobomimicReader;

/// Names of observations and actions that only robots with two arms have, with what they show.
const SECOND_ARM: [(&str, &str); 5] = [
    ("obs/robot1_", "a second robot"),
    ("obs/robot0_left_eef", "a left arm"),
    ("action_dict/left_", "actions of a left arm"),
    ("datagen_info/eef_pose/", "several end effectors"),
    ("datagen_info/left_", "a left arm"),
];

/// Refuses a file of two arms, by the name of its environment and by the datasets of its first demonstration.
pub(in crate::robomimic) fn refuse_two_arms(reader: &RobomimicReader, env: &EnvArgs) -> Result<(), Hdf5Fault> {
    let environment = &env.env_name;
    let refuse = |why: String| {
        Hdf5Fault::Other(format!(
            "its environment {environment} moves two arms ({why}), but only tasks with one arm and a two-finger gripper are supported; give a file of such a task, or audit one arm of it with task = \"arm\" and ingest.arm.arm"
        ))
    };
    if env.robots.len() > 1 {
        return Ok(()); // Refused with the number of its robots.
    }
    if environment.starts_with("TwoArm") {
        return Err(refuse("by its name".to_owned()));
    }
    let names = reader.names_in_first(&["obs", "action_dict", "datagen_info", "datagen_info/eef_pose"])?;
    for (start, shows) in SECOND_ARM {
        if let Some(name) = names.iter().find(|name| name.starts_with(start)) {
            return Err(refuse(format!("dataset {name} is of {shows}")));
        }
    }
    Ok(())
}

/// Checks that the file matches the task of the pipeline.
pub(in crate::robomimic) fn check_task(env: &EnvArgs, task: Option<RobosuiteTask>) -> Result<(), Hdf5Fault> {
    if env.is_foreign() {
        let by = if env.env_name.starts_with("Isaac") {
            "Isaac Lab"
        } else {
            "gym or another library"
        };
        return Err(Hdf5Fault::Other(format!(
            "it is not a robosuite dataset: env_args names environment {} of type {}, which is {by} in robomimic, but only type 1 (robosuite) is supported; give an HDF5 file of robosuite demonstrations",
            env.env_name,
            env.kind.unwrap_or_default()
        )));
    }
    if env.robots.len() > 1 {
        return Err(Hdf5Fault::Other(format!(
            "its environment {} has {} robots, but only tasks with one arm and a two-finger gripper are supported; give a file of such a task, or audit one arm of it with task = \"arm\" and ingest.arm.arm",
            env.env_name,
            env.robots.len()
        )));
    }
    if let Some(task) = task.filter(|task| RobosuiteTask::of_environment(&env.env_name) != Some(*task)) {
        let wanted = task.environment;
        return Err(Hdf5Fault::Other(format!(
            "its environment is {}, but the pipeline's task needs {wanted}; set task to the task of the file, or set task = \"robosuite\" and ingest.object",
            env.env_name
        )));
    }
    Ok(())
}
