//! Simulators behind one trait: Push-T on Chipmunk and robosuite's tasks on MuJoCo, with numpy-compatible scene seeds.
//!
//! [`PushT`] reproduces the Python package gym-pusht 0.1.8 bit for bit in positions, velocities and contact counts. [`robosuite`]
//! reproduces robosuite 1.4.1 and 1.5.1. The README of this crate describes the parity tests. In Push-T, lengths are pixels of the
//! 512 x 512 window (y points down), angles are radians and times are seconds.

mod chipmunk;
mod error;
mod goal;
mod pusht;
mod random_state;
mod render;
pub mod robosuite;
mod seed;
mod simulator;
mod tee;

pub use chipmunk::{WALL_FACES, chipmunk_version};
pub use error::SimError;
pub use goal::{GOAL_MARGIN, START_COVERAGE, random_goal};
pub use pusht::{
    COORDINATE_LIMIT, DAMPING_GAIN, PROPORTIONAL_GAIN, PushT, PushTObservation, SUBSTEPS, Scene, TIME_STEP, WINDOW,
};
pub use render::{Canvas, OBSERVATION_SIDE, OUTLINE_RADIUS, Shapes, render_state};
pub use seed::{SeedScheme, scene_from_seed};
pub use simulator::{ResetOrder, Simulator, Step};
pub use tee::{
    AGENT_RADIUS, CENTRE_OF_GRAVITY, GOAL, SUCCESS_COVERAGE, TEE_AREA, clearance_of_block, coverage, depth_in_walls,
    iou, tee_rectangles, tee_vertices,
};
