//! What can go wrong in a simulator.

/// Why a simulator refused to start, reset or step.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum SimError {
    /// The program was linked with a library of another major version.
    #[error(
        "cannot start Push-T: the physics library reports Chipmunk version {found}, not 7.x; \
         build with Chipmunk 7 (Debian, Ubuntu: `apt-get install libchipmunk-dev`)"
    )]
    Library {
        /// The version string the library carries.
        found: String,
    },
    /// The requested scene has a coordinate that no reset can take.
    #[error(
        "cannot reset Push-T: {coordinate} of the requested scene is {value}; \
         give a finite number of at most {limit} in absolute value"
    )]
    Reset {
        /// Which coordinate: `agent_x`, `agent_y`, `block_x`, `block_y` or `block_theta`.
        coordinate: &'static str,
        /// Its value.
        value: f64,
        /// The greatest absolute value allowed.
        limit: f64,
    },
    /// The action has a coordinate that no step can take.
    #[error(
        "cannot step Push-T: {coordinate} of the action is {value}; \
         give a finite number of at most {limit} in absolute value"
    )]
    Step {
        /// Which coordinate: `target_x` or `target_y`.
        coordinate: &'static str,
        /// Its value.
        value: f64,
        /// The greatest absolute value allowed.
        limit: f64,
    },
    /// The physics came to a state it cannot go on from; the simulator must be reset.
    #[error(
        "cannot {operation} Push-T: the physics brought {coordinate} to {value}, outside of {limit} in absolute value; \
         reset the simulator to a scene in which agent and block do not overlap"
    )]
    Diverged {
        /// `reset` or `step`.
        operation: &'static str,
        /// Which coordinate of the state.
        coordinate: &'static str,
        /// Its value.
        value: f64,
        /// The greatest absolute value allowed.
        limit: f64,
    },
    /// The model is not one of the task.
    #[error("cannot simulate {task}: {reason}; take the model_file of a demonstration of {task}")]
    Model {
        /// The task.
        task: &'static str,
        /// What is wrong with the model.
        reason: String,
    },
}
