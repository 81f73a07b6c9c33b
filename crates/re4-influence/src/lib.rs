//! The influence of every demonstration on the success of a policy by retrieval, and the choice of demonstrations by it.
//!
//! A policy by retrieval names the demonstrations on which its decisions depend ([`Traced::considered`](re4_rollout::Traced)). An
//! episode in which it did not consider a demonstration is the same without this demonstration. The effect of leaving out each
//! demonstration is therefore exact if only the episodes that considered it are rolled out again ([`leave_one_out`]).
//!
//! This crate asks for episodes by the number of a scene and the demonstrations that are left out ([`Roll`]); it does not know
//! simulators or policies.

mod choose;
mod effects;
mod prior;
mod tables;

pub use choose::{Aim, By, Choice, Curate, Round, curate, learning_curve};
pub use effects::{Change, Episode, Evaluation, Roll, Without, cost, evaluate, evaluate_without, leave_one_out};
pub use prior::{Evidence, Score};
pub use tables::{
    CuratedRow, Demo, InfluenceRow, JudgedEpisodeRow, JudgedRow, PairRow, RoundRow, Scenes, episode_rows,
    influence_rows, pair_rows,
};
