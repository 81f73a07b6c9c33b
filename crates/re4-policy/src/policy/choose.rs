//! The selector by outcome: the cheapest chunk that can be executed, and the demonstrations on which this choice depends.

use std::collections::{BTreeMap, BTreeSet};
use std::num::NonZeroUsize;
use std::sync::Arc;

use rand_pcg::Pcg64;
use re4_episode::{Mode, PlanarFrame};
use re4_geometry::{Point2, Pose2};
use re4_sim::GOAL;

use super::{Re4, demo_frames};
use crate::LookupError;
use crate::config::Planner;
use crate::outcome::Chunk;
use crate::pusher::PusherState;
use crate::reframe::Reframed;
use crate::replan::{Plan, PlanKind};
use crate::workspace::Workspace;

/// Number of chunks, in ascending order of cost, for which a path is planned before the search is widened.
const MAX_PLANS: usize = 8;

/// The same limit for the chunks that a widened search adds.
const MAX_PLANS_WIDENED: usize = 128;

/// Factor by which the number of candidates grows if none of them can be executed: 8.
const WIDENING_FACTOR: NonZeroUsize = NonZeroUsize::MIN.saturating_add(7);

/// The number of nearest chunks that are looked at, relative to the candidates, for the replacements of those of one demonstration.
const TWICE: NonZeroUsize = NonZeroUsize::MIN.saturating_add(1);

/// Maximum depth in pixels to which the recorded motion may move the block into a wall, in addition to the depth at which it
/// already is. Tuned on randomly sampled blocks in corners (`tests/walls.rs`).
const WALL_TOLERANCE: f64 = 30.0;

/// What a chunk is selected for.
pub(super) struct Situation {
    pub(super) mode: Mode,
    pub(super) pusher: PusherState,
    pub(super) block: Pose2,
}

/// A chunk with the path to its start.
#[derive(PartialEq)]
pub(super) struct Choice {
    pub(super) chunk: Chunk,
    pub(super) reframed: Reframed,
    pub(super) connection: Plan,
    cost: f64,
}

/// The result of a search.
pub(super) struct Found {
    pub(super) choice: Choice,
    /// Number of candidates that were compared.
    pub(super) compared: usize,
    /// Whether one of the first candidates can be executed, so that the search was not widened.
    direct: bool,
}

/// Returns whether the block stays clear of the walls if it moves from `block` as recorded in `chunk`. The demonstration does not
/// predict what happens at a wall.
fn stays_inside(workspace: Workspace, frames: &[PlanarFrame], chunk: &Chunk, block: Pose2) -> bool {
    let limit = workspace.depth_in_walls(block) + WALL_TOLERANCE;
    let carry = block.delta_from(frames[0].object);
    let length = (chunk.end - chunk.start) as usize;
    frames
        .iter()
        .take(length + 1)
        .all(|frame| workspace.depth_in_walls(carry.compose(frame.object)) <= limit)
}

impl Re4 {
    /// Selects the cheapest chunk that can be executed among the chunks of the demonstrations that are not in `without`.
    pub(super) fn choose(&mut self, at: &Situation, without: &BTreeSet<u32>) -> Result<Found, LookupError> {
        let knowledge = Arc::clone(&self.knowledge);
        let chunks = knowledge.chunks.as_ref().ok_or(LookupError::NoChunks)?;
        let all = chunks.len_without(without);
        let wanted = wanted(at);
        let mut count = self.candidates();
        let mut candidates = chunks.nearest_without(wanted, count, without);
        let mut compared = candidates.len();
        let mut found = self.cheapest(&candidates, MAX_PLANS, at)?;
        let direct = matches!(&found, Some((_, true)));
        // If none of the best candidates can be executed, for example because the block is in a corner, widen the search. A chunk
        // with a worse outcome can move the block to where better ones can be executed.
        let mut fallback = None;
        while let Some((_, false)) = &found {
            fallback = fallback.or(found);
            if compared >= all {
                found = None;
                break;
            }
            count = count.saturating_mul(WIDENING_FACTOR);
            candidates = chunks.nearest_without(wanted, count, without);
            found = self.cheapest(&candidates[compared..], MAX_PLANS_WIDENED, at)?;
            compared = candidates.len();
        }
        let (choice, _) = found.or(fallback).ok_or(LookupError::NoChunks)?;
        Ok(Found {
            choice,
            compared,
            direct,
        })
    }

    /// Reports the demonstrations without which [`Self::choose`] would have chosen something else. `before` is the generator of
    /// random numbers before the choice.
    ///
    /// Without demonstration d, its chunks among the candidates are replaced by the next nearest chunks of other demonstrations. The
    /// choice is the same if d does not own it and every replacement costs at least as much: the chunks that cost less than the
    /// choice are then a subset of those that were rejected before, and equal costs are in the order of the misalignment, in which
    /// replacements come last. In all other cases, the choice is made again without d and compared.
    pub(super) fn trace_choice(&mut self, at: &Situation, found: &Found, before: &Pcg64) -> Result<(), LookupError> {
        let knowledge = Arc::clone(&self.knowledge);
        let chunks = knowledge.chunks.as_ref().ok_or(LookupError::NoChunks)?;
        let without = self.trace.left_out().clone();
        let mut count_of: BTreeMap<u32, usize> = BTreeMap::new();
        let first = NonZeroUsize::new(found.compared).unwrap_or(NonZeroUsize::MIN);
        let pool = chunks.nearest_without(wanted(at), first.saturating_mul(TWICE), &without);
        let (candidates, next) = pool.split_at(found.compared.min(pool.len()));
        for (_, chunk) in candidates {
            *count_of.entry(chunk.demo).or_default() += 1;
        }
        let exhausted = pool.len() >= chunks.len_without(&without);
        // A planner with random numbers consumes them for candidates that are rejected.
        let certain = found.direct && self.config.replan.planner != Planner::Rrt;
        let mut costs: Vec<Option<f64>> = vec![None; next.len()];
        for (&demo, &count) in &count_of {
            if demo == found.choice.chunk.demo {
                self.trace.consider([demo]);
                continue;
            }
            let mut safe = certain;
            let mut replaced = 0;
            for ((misalignment, chunk), cost) in next.iter().zip(&mut costs) {
                if !safe || replaced == count {
                    break;
                }
                if chunk.demo != demo {
                    replaced += 1;
                    let known = match *cost {
                        Some(known) => known,
                        None => *cost.insert(self.cost_now(*misalignment, chunk, at)?),
                    };
                    safe = known >= found.choice.cost;
                }
            }
            if !(safe && (replaced == count || exhausted)) && self.choice_changes(at, found, before, demo, &without)? {
                self.trace.consider([demo]);
            }
        }
        Ok(())
    }

    /// Whether the choice, or the generator of random numbers after it, would be another one without a demonstration.
    fn choice_changes(
        &mut self,
        at: &Situation,
        found: &Found,
        before: &Pcg64,
        demo: u32,
        without: &BTreeSet<u32>,
    ) -> Result<bool, LookupError> {
        let mut without = without.clone();
        without.insert(demo);
        let after = std::mem::replace(&mut self.random, before.clone());
        let other = self.choose(at, &without);
        let other_after = std::mem::replace(&mut self.random, after);
        Ok(match other {
            Ok(other) => other.choice != found.choice || other_after != self.random,
            Err(LookupError::NoChunks) => true,
            Err(error) => return Err(error),
        })
    }

    fn candidates(&self) -> NonZeroUsize {
        NonZeroUsize::new(self.config.retrieve.candidates).unwrap_or(NonZeroUsize::MIN)
    }

    /// Returns the cheapest reachable candidate with `true`. If none is reachable, returns the cheapest candidate with `false`,
    /// and `None` if there are no candidates. At most `plans` paths are planned.
    fn cheapest(
        &mut self,
        candidates: &[(f64, Chunk)],
        plans: usize,
        at: &Situation,
    ) -> Result<Option<(Choice, bool)>, LookupError> {
        let knowledge = Arc::clone(&self.knowledge);
        let mut ranked: Vec<(f64, Chunk)> = Vec::with_capacity(candidates.len());
        for (misalignment, chunk) in candidates {
            ranked.push((self.cost_now(*misalignment, chunk, at)?, *chunk));
        }
        // The sort is stable, so candidates of equal cost stay in the order of their misalignment.
        ranked.sort_by(|a, b| a.0.total_cmp(&b.0));
        let mut first = None;
        let mut planned = 0;
        for (cost, chunk) in ranked {
            let frames = demo_frames(&knowledge.demos, chunk.demo, chunk.start)?;
            let possible = cost.is_finite() && stays_inside(self.workspace, frames, &chunk, at.block);
            if planned == plans || (!possible && first.is_some()) {
                continue;
            }
            let (reframed, connection) = self.connect(at.mode, &frames[0], at.pusher, at.block);
            planned += 1;
            let reached = possible && connection.kind != PlanKind::Failed;
            let choice = Choice {
                chunk,
                reframed,
                connection,
                cost,
            };
            if reached {
                return Ok(Some((choice, true)));
            }
            first = first.or(Some((choice, false)));
        }
        Ok(first)
    }

    /// The cost of a chunk, which is infinite if its replay failed before.
    fn cost_now(&self, misalignment: f64, chunk: &Chunk, at: &Situation) -> Result<f64, LookupError> {
        if self.ineffective.contains(&(chunk.demo, chunk.start)) {
            return Ok(f64::INFINITY);
        }
        self.cost(misalignment, chunk, at.pusher, at.block)
    }

    /// Returns the cost of a chunk: its expected misalignment plus the cost of moving to its start and of executing it. Infinite
    /// if the chunk leaves the workspace.
    fn cost(&self, misalignment: f64, chunk: &Chunk, pusher: PusherState, block: Pose2) -> Result<f64, LookupError> {
        let rest = demo_frames(&self.knowledge.demos, chunk.demo, chunk.start)?;
        let carry = block.delta_from(rest[0].object);
        let near = carry.transform_point(rest[0].eef);
        // Keep the path of the pusher at least 10 px inside the workspace.
        let reachable = |p: Point2| self.workspace.contains(p, 10.0);
        let length = (chunk.end - chunk.start) as usize;
        let inside = rest
            .iter()
            .take(length + 1)
            .all(|f| reachable(carry.transform_point(f.eef)));
        if !inside {
            return Ok(f64::INFINITY);
        }
        let steps =
            (near - pusher.position).norm() / self.config.replan.spacing + chunk.travel / self.config.replay.speed;
        Ok(misalignment + self.config.retrieve.step_cost * steps + self.config.retrieve.motion_cost * chunk.pushed)
    }
}

/// The motion, in the object frame, that would bring the object to its goal.
fn wanted(at: &Situation) -> Pose2 {
    at.block.inverse().compose(GOAL)
}
