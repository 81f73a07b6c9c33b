//! Errors of the simulators.

use re4_fault::Remedy;
use re4_mujoco::MujocoError;

/// Why a simulator cannot start, reset or step.
#[derive(Debug, Clone, PartialEq, thiserror::Error, Remedy)]
#[non_exhaustive]
pub enum SimError {
    /// The program was linked with another major version of Chipmunk.
    #[error("cannot start Push-T: the physics library reports Chipmunk version {found}, not 7.x")]
    #[remedy("build with Chipmunk 7 (Debian, Ubuntu: `apt-get install libchipmunk-dev`)")]
    Library {
        /// The version string that the library reports.
        found: String,
    },
    /// A coordinate of the requested scene is not finite or too large.
    #[error("cannot reset Push-T: {coordinate} of the requested scene is {value}")]
    #[remedy("give a finite number of at most {limit} in absolute value")]
    Reset {
        /// Which coordinate: `agent_x`, `agent_y`, `block_x`, `block_y` or `block_theta`.
        coordinate: &'static str,
        /// Its value.
        value: f64,
        /// The maximum absolute value allowed.
        limit: f64,
    },
    /// A coordinate of the action is not finite or too large.
    #[error("cannot step Push-T: {coordinate} of the action is {value}")]
    #[remedy("give a finite number of at most {limit} in absolute value")]
    Step {
        /// Which coordinate: `target_x` or `target_y`.
        coordinate: &'static str,
        /// Its value.
        value: f64,
        /// The maximum absolute value allowed.
        limit: f64,
    },
    /// The physics brought a coordinate out of bounds; the simulator must be reset.
    #[error(
        "cannot {operation} Push-T: the physics brought {coordinate} to {value}, more than {limit} in absolute value"
    )]
    #[remedy("reset the simulator to a scene in which agent and block do not overlap")]
    Diverged {
        /// `reset` or `step`.
        operation: &'static str,
        /// Which coordinate of the state.
        coordinate: &'static str,
        /// Its value.
        value: f64,
        /// The maximum absolute value allowed.
        limit: f64,
    },
    /// MuJoCo reported an error for a robosuite task.
    #[error("cannot simulate {task}: {source}")]
    #[remedy(source.remedy())]
    Mujoco {
        /// The task.
        task: &'static str,
        /// The error that MuJoCo reported.
        source: MujocoError,
    },
    /// The model is not a scene of the task.
    #[error("cannot simulate {task}: {reason}")]
    #[remedy("use the model_file of a demonstration of {task}")]
    Model {
        /// The task.
        task: &'static str,
        /// What is wrong with the model.
        reason: String,
    },
    /// The length of a recorded state does not match the model.
    #[error(
        "cannot reset {task}: the state has {found} numbers, the model needs {expected} ({})",
        if *nv == 0 { "coordinates only".to_owned() } else { format!("time, {nq} coordinates, {nv} velocities") }
    )]
    #[remedy("use the states and the model_file of the same demonstration")]
    StateLength {
        /// The task.
        task: &'static str,
        /// Length of the given state.
        found: usize,
        /// Length that the model needs.
        expected: usize,
        /// Number of the model's coordinates.
        nq: usize,
        /// Number of the model's velocities; 0 if only coordinates are expected.
        nv: usize,
    },
    /// A number of a state or action is NaN or infinite, or too large.
    #[error("cannot {operation} {task}: number {index} of the {what} is {value}")]
    #[remedy("give finite numbers")]
    NotFinite {
        /// `reset`, `step` or `displace`.
        operation: &'static str,
        /// The task.
        task: &'static str,
        /// `state` or `action`.
        what: &'static str,
        /// Index of the number, from 0.
        index: usize,
        /// Its value.
        value: f64,
    },
    /// The simulation reached numbers that are not finite or too large.
    #[error(
        "cannot step {task}: the simulation became unstable{}",
        if reason.is_empty() { String::new() } else { format!(" ({reason})") }
    )]
    #[remedy("reset the simulation")]
    Unstable {
        /// The task.
        task: &'static str,
        /// A description of the instability.
        reason: String,
    },
}
