//! What can go wrong in a simulator.

use re4_fault::Remedy;
use re4_mujoco::MujocoError;

/// Why a simulator refused to start, reset or step.
#[derive(Debug, Clone, PartialEq, thiserror::Error, Remedy)]
#[non_exhaustive]
pub enum SimError {
    /// The program was linked with a library of another major version.
    #[error("cannot start Push-T: the physics library reports Chipmunk version {found}, not 7.x")]
    #[remedy("build with Chipmunk 7 (Debian, Ubuntu: `apt-get install libchipmunk-dev`)")]
    Library {
        /// The version string the library carries.
        found: String,
    },
    /// The requested scene has a coordinate that no reset can take.
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
    /// The action has a coordinate that no step can take.
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
    /// The physics came to a state it cannot go on from; the simulator must be reset.
    #[error(
        "cannot {operation} Push-T: the physics brought {coordinate} to {value}, outside of {limit} in absolute value"
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
    /// A robosuite task cannot be simulated.
    #[error("cannot simulate {task}: {source}")]
    #[remedy(source.remedy())]
    Mujoco {
        /// The task.
        task: &'static str,
        /// Why.
        source: MujocoError,
    },
    /// The model is not one of the task.
    #[error("cannot simulate {task}: {reason}")]
    #[remedy("take the model_file of a demonstration of {task}")]
    Model {
        /// The task.
        task: &'static str,
        /// What is wrong with the model.
        reason: String,
    },
    /// A recorded state does not fit the model.
    #[error(
        "cannot reset {task}: the state has {found} numbers, the model needs {expected} ({})",
        if *nv == 0 { "coordinates alone".to_owned() } else { format!("time, {nq} coordinates, {nv} velocities") }
    )]
    #[remedy("take states and model_file of the same demonstration")]
    StateLength {
        /// The task.
        task: &'static str,
        /// Numbers of the state.
        found: usize,
        /// Numbers that the model needs.
        expected: usize,
        /// Coordinates of the model.
        nq: usize,
        /// Velocities of the model; 0 where coordinates alone are asked for.
        nv: usize,
    },
    /// A number that is NaN or infinite.
    #[error("cannot {operation} {task}: number {index} of the {what} is {value}")]
    #[remedy("give finite numbers")]
    NotFinite {
        /// `reset` or `step`.
        operation: &'static str,
        /// The task.
        task: &'static str,
        /// State or action.
        what: &'static str,
        /// Which number, from 0.
        index: usize,
        /// Its value.
        value: f64,
    },
    /// The simulation came to numbers that are not finite or absurdly large.
    #[error(
        "cannot step {task}: the simulation became unstable{}",
        if reason.is_empty() { String::new() } else { format!(" ({reason})") }
    )]
    #[remedy("reset it")]
    Unstable {
        /// The task.
        task: &'static str,
        /// MuJoCo's words.
        reason: String,
    },
}
