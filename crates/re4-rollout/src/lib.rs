//! The harness of rollouts: one loop and one driver for every policy, task and variant.
//!
//! A [`Domain`] says what is felt, seen, commanded and led to: [`Plane`] for Push-T, [`Space`] for robosuite's tasks. An
//! [`Env`] is a simulation in it. A [`Policy`] answers an action at every control step and asks its [`Senses`] for what it
//! needs; a [`PolicyFactory`] starts one for every episode. [`rollouts`] drives them, and records what was asked.

mod domain;
mod env;
mod noise;
mod policy;
mod record;
mod rollout;
mod scene_renderer;
mod senses;
mod tables;

pub use domain::{ArmAction, ArmState, Domain, Plane, PlaneScene, Space, SpaceFirst, robosuite_action};
pub use env::{Env, Image, PushTEnv, RobosuiteEnv};
pub use noise::PoseNoise;
pub use policy::{Act, Phase, Policy, PolicyError, PolicyFactory};
pub use record::{Batch, Explained, Explanation, Named, Opened, RecordError, Recording};
pub use rollout::{Harness, MakeEnv, MakeSource, Rollout, RolloutError, Start, StepRecord, rollout, rollouts};
pub use scene_renderer::{SceneCamera, SceneRenderer, drop_renderer, set_state};
pub use senses::{Asked, Errors, Estimator, ObservedPose, Senses, Source};
pub use tables::{
    DecisionCore, PlaneDecisionRow, PlaneResultRow, PlaneStepRow, Recorded, ResultCore, SpaceDecisionRow,
    SpaceResultRow, SpaceStepRow, StepCore, tables,
};
