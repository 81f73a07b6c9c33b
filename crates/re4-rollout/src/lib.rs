//! The rollout harness: one control loop and one driver for every policy, task and variant.
//!
//! * [`Domain`] defines the types of proprioception, object pose, action and outcome. [`Plane`] is the domain of Push-T, and
//!   [`Space`] is the domain of the robosuite tasks.
//! * [`Env`] is the simulation of a task in a domain.
//! * [`Policy`] returns an action at every control step. It reads its observations from [`Senses`].
//! * [`PolicyFactory`] starts a policy for every episode.
//! * [`rollouts`] runs the policies from a list of starts on several threads and records actions, decisions and requested
//!   observations.
//!
//! A new policy implements [`PolicyFactory`], [`Policy`], and [`Explained`] for its decision record. The settings, pipeline
//! schema and tables are added in `re4-policy` (module `kinds`).

mod conditions;
mod domain;
mod env;
mod live;
mod noise;
mod policy;
mod record;
mod rollout;
mod scene_renderer;
mod senses;
mod tables;
mod times;
mod trace;

pub use conditions::{AppliedDisturbance, Conditions, Displaced, Displacement, Disturbance, Disturbed};
pub use domain::{ArmAction, ArmState, Domain, Plane, PlaneScene, Space, SpaceFirst, robosuite_action};
pub use env::{Env, Image, PushTEnv, RobosuiteEnv};
pub use live::{Acted, Acting, Given};
pub use noise::PoseNoise;
pub use policy::{Act, Phase, Policy, PolicyError, PolicyFactory};
pub use record::{Batch, Explained, Explanation, Named, Opened, RecordError, Recording};
pub use rollout::{Harness, MakeEnv, MakeSource, Rollout, RolloutError, Start, StepRecord, rollout, rollouts};
pub use scene_renderer::{SceneCamera, SceneRenderer, drop_renderer, set_state};
pub use senses::{Asked, CLEAR, Errors, Estimator, ObservedPose, Senses, Source};
pub use tables::{
    DecisionCore, PlaneDecisionRow, PlaneResultRow, PlaneStepRow, PlaneWorldRow, Recorded, ResultCore,
    SpaceDecisionRow, SpaceResultRow, SpaceStepRow, SpaceWorldRow, StepCore, tables,
};
pub use times::ActTimes;
pub use trace::{Job, Trace, Traced};
