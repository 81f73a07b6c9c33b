//! The RE4 loop (paper, Algorithm 1), one control step at a time.

use std::collections::{BTreeSet, VecDeque};
use std::num::NonZeroUsize;
use std::sync::Arc;

use rand_pcg::Pcg64;
use re4_episode::{Mode, PlanarFrame};
use re4_geometry::{Point2, Pose2};
use re4_index::{Query, RetrievalIndex};
use re4_rollout::{Act, Phase, Plane, Policy, PolicyError, PolicyFactory, Senses};
use re4_sim::{GOAL, coverage, depth_in_walls};

use crate::LookupError;
use crate::config::{PolicyConfig, Selector, Tracking};
use crate::demos::DemoSet;
use crate::outcome::{Body, Chunk, ChunkLibrary};
use crate::path::{Leg, legs};
use crate::pusher::{PusherModel, PusherState};
use crate::reframe::{Reframed, reframe, without_reframe};
use crate::replan::{Plan, PlanKind, WORKSPACE, plan, waypoints};
use re4_episode::DemoNames;

/// Chunks, in the order of their cost, to which a connection is looked for before the cheapest is taken without one.
const PLANS_TRIED: usize = 8;

/// The same, among the chunks that the search is widened to.
const PLANS_TRIED_FARTHER: usize = 128;

/// By how much the search is widened where none of the candidates can be carried out.
const WIDER: NonZeroUsize = NonZeroUsize::MIN.saturating_add(7);

/// How far, in pixels, a recorded motion of the block may lead it into a wall; deeper than it is, if it is in one.
const WALL_TOLERANCE: f64 = 30.0;

/// How far, in pixels, a replayed path may cut the corners of the recorded one.
const CORNER_TOLERANCE: f64 = 0.5;

/// What a policy knows: demonstrations, their index, and the chunks searchable by outcome. Shared between rollouts.
pub struct Knowledge {
    /// Demonstrations.
    pub demos: DemoSet<PlanarFrame>,
    /// Retrieve.
    pub index: RetrievalIndex,
    /// Chunks by outcome, where the selector needs them.
    pub chunks: Option<ChunkLibrary>,
}

/// Why the policy does what it does: one record for every Retrieve.
#[derive(Debug, Clone, PartialEq)]
pub struct Decision {
    /// Control steps taken before the decision.
    pub step: u32,
    /// Mode of the query.
    pub mode: Mode,
    /// End effector and object of the query.
    pub eef: Point2,
    /// Object pose of the query.
    pub object: Pose2,
    /// Retrieved demonstration, by its number in the index.
    pub demo: u32,
    /// Retrieved frame.
    pub demo_frame: u32,
    /// Last frame of the chunk.
    pub demo_end: u32,
    /// Distance over the full state, normalised; absent for the outcome selector.
    pub d_q: Option<f64>,
    /// Distance over the object pose, normalised; absent for the outcome selector.
    pub d_o: Option<f64>,
    /// δ, in the world.
    pub delta: Pose2,
    /// Set-point at which the chunk starts.
    pub set_point: Point2,
    /// How the connection was found.
    pub plan_kind: PlanKind,
    /// Commands of the connection.
    pub plan_steps: u32,
    /// Nodes searched for the connection.
    pub plan_nodes: u32,
    /// The connection, as a polyline.
    pub plan_path: Vec<Point2>,
    /// Commands of the chunk.
    pub replay_steps: u32,
    /// Where the demonstration says the object will be after the chunk.
    pub predicted_object: Pose2,
    /// Coverage of the goal there.
    pub predicted_coverage: f64,
    /// Number of chunks or demonstrations compared.
    pub compared: u32,
}

impl Decision {
    /// The decision in words, in which demonstrations have their names.
    pub fn reason(&self, names: &DemoNames) -> String {
        let chosen = format!("{} from frame {}", names.of(self.demo), self.demo_frame);
        let why = match (self.d_q, self.d_o) {
            (Some(d_q), Some(d_o)) => format!(
                "nearest object pose (d_o {d_o:.4}) among the nearest states of {} demonstrations (d_q {d_q:.4})",
                self.compared
            ),
            _ => format!(
                "its push to frame {} is expected to lead to a coverage of {:.3}, at the minimum cost of {} chunks compared",
                self.demo_end, self.predicted_coverage, self.compared
            ),
        };
        let way = match self.plan_kind {
            PlanKind::Direct => "the straight way to its start is free",
            PlanKind::Planned => "a way round the block leads to its start",
            PlanKind::Failed => "no free way to its start was found, so the straight one is taken",
            PlanKind::Off => "it is replayed from where the pusher is",
        };
        format!("{chosen}: {why}; {way}")
    }
}

/// One command that waits for its control step.
#[derive(Debug, Clone, Copy)]
enum Command {
    /// Send this target.
    Target(Point2),
    /// Send the first of `left` targets that lead to the end of the leg.
    Follow { leg: Leg, left: usize },
}

/// A policy in the middle of an episode.
pub struct Re4 {
    config: PolicyConfig,
    knowledge: Arc<Knowledge>,
    random: Pcg64,
    model: PusherModel,
    body: Body,
    pusher: Option<PusherState>,
    queue: VecDeque<(Phase, Command)>,
    /// Poses that the object should pass, by the demonstration that is being replayed.
    expected: Vec<Pose2>,
    trial: Option<Trial>,
    /// Starts of chunks, as (demonstration, frame), that did not move the object as recorded; not chosen again.
    set_aside: BTreeSet<(u32, u32)>,
    step: u32,
}

/// A chunk whose effect on the object is awaited.
struct Trial {
    chunk: Chunk,
    /// Pose of the object at the decision.
    before: Pose2,
}

/// A chunk with the way to it.
struct Choice {
    chunk: Chunk,
    reframed: Reframed,
    connection: Plan,
}

/// What a selector chose.
struct Selected {
    demo: u32,
    /// First frame of the chunk.
    start: u32,
    /// Last frame of the chunk, included.
    end: u32,
    /// `d_q` and `d_o`, where the selector has them.
    distances: Option<(f64, f64)>,
    compared: usize,
    reframed: Reframed,
    connection: Plan,
}

/// The frames of a demonstration from `frame` on; at least one.
fn demo_frames(demos: &DemoSet<PlanarFrame>, demo: u32, frame: u32) -> Result<&[PlanarFrame], LookupError> {
    demos
        .demo(demo)
        .and_then(|frames| frames.get(frame as usize..))
        .filter(|frames| !frames.is_empty())
        .ok_or_else(|| LookupError::UnknownDemo {
            demo: demos.names().of(demo),
            frame,
        })
}

/// Whether the block, moved from `block` as `chunk` records it, stays clear of the walls: beyond them the demonstration
/// says nothing of what will happen.
fn stays_inside(frames: &[PlanarFrame], chunk: &Chunk, block: Pose2) -> bool {
    let limit = depth_in_walls(block) + WALL_TOLERANCE;
    let carry = block.delta_from(frames[0].object);
    let length = (chunk.end - chunk.start) as usize;
    frames
        .iter()
        .take(length + 1)
        .all(|frame| depth_in_walls(carry.compose(frame.object)) <= limit)
}

impl Re4 {
    /// A policy at the beginning of an episode; `seed` drives the sampling of the planner.
    pub fn new(config: PolicyConfig, knowledge: Arc<Knowledge>, seed: u64) -> Self {
        Self {
            config,
            knowledge,
            random: Pcg64::new(u128::from(seed), 0x5245_3452_4f4c_4c4f_5554),
            model: PusherModel::default(),
            pusher: None,
            queue: VecDeque::new(),
            body: Body::tee(),
            expected: Vec::new(),
            trial: None,
            set_aside: BTreeSet::new(),
            step: 0,
        }
    }
}

/// Starts [`Re4`].
pub struct Re4Factory {
    /// Its settings.
    pub config: PolicyConfig,
    /// What it knows.
    pub knowledge: Arc<Knowledge>,
}

impl PolicyFactory<Plane> for Re4Factory {
    type Policy = Re4;

    fn start(&self, seed: u32, _: &Point2) -> Re4 {
        Re4::new(self.config.clone(), Arc::clone(&self.knowledge), u64::from(seed))
    }
}

impl Policy<Plane> for Re4 {
    type Decision = Decision;

    fn act(&mut self, senses: &mut dyn Senses<Plane>) -> Result<Act<Plane, Decision>, PolicyError> {
        let (eef, object) = (senses.proprio(), senses.object()?);
        // The pusher's velocity is not observed; it follows from the commands sent.
        let velocity = self.pusher.map_or(Point2::zeros(), |p| p.velocity);
        let pusher = PusherState {
            position: eef,
            velocity,
        };
        if self.strayed(object) {
            self.queue.clear();
        }
        let decision = if self.queue.is_empty() {
            Some(self.decide(pusher, object)?)
        } else {
            None
        };
        let (phase, command) = self.queue.pop_front().ok_or(LookupError::NothingToDo)?;
        let target = match command {
            Command::Target(target) => target,
            Command::Follow { leg, left } => {
                let free = self.model.first_target(pusher, leg.goal, leg.velocity, left);
                Point2::new(free.x.clamp(0.0, WORKSPACE), free.y.clamp(0.0, WORKSPACE))
            }
        };
        self.pusher = Some(self.model.predict(pusher, target));
        self.step += 1;
        Ok(Act {
            action: target,
            phase,
            decision,
            object: Some(object),
        })
    }
}

impl Re4 {
    /// Whether the object left the path that the chunk should have moved it along.
    fn strayed(&self, block: Pose2) -> bool {
        let (Some(limit), Some((Phase::Replay, _))) = (self.config.replay.divergence, self.queue.front()) else {
            return false;
        };
        self.expected
            .iter()
            .all(|&pose| self.body.distance(pose, block) > limit)
    }

    fn decide(&mut self, pusher: PusherState, block: Pose2) -> Result<Decision, LookupError> {
        // A planar pusher never grasps: every query is transit (paper, appendix "Push-T").
        let mode = Mode::Transit;
        self.judge(block);
        match self.config.retrieve.selector {
            Selector::TwoStage => self.decide_two_stage(mode, pusher, block),
            Selector::Outcome => self.decide_outcome(mode, pusher, block),
        }
    }

    /// Sets the last chunk aside if the object ended elsewhere than recorded, by more than half of the recorded motion.
    fn judge(&mut self, block: Pose2) {
        let Some(Trial { chunk, before }) = self.trial.take() else {
            return;
        };
        let expected = before.compose(chunk.motion);
        if self.body.distance(expected, block) > 0.5 * self.body.distance(expected, before) {
            self.set_aside.insert((chunk.demo, chunk.start));
        }
    }

    fn decide_two_stage(&mut self, mode: Mode, pusher: PusherState, block: Pose2) -> Result<Decision, LookupError> {
        let knowledge = Arc::clone(&self.knowledge);
        let query = Query {
            mode,
            eef: pusher.position,
            object: block,
        };
        let found = knowledge
            .index
            .retrieve(&query, self.config.retrieve.epsilon)?
            .ok_or(LookupError::NoFrameOfMode { mode })?;
        let frames = demo_frames(&knowledge.demos, found.episode, found.frame)?;
        let end = found.frame + self.frames_within_horizon(frames) as u32 - 1;
        let (reframed, connection) = self.connect(mode, &frames[0], pusher, block);
        let selected = Selected {
            demo: found.episode,
            start: found.frame,
            end,
            distances: Some((found.d_q, found.d_o)),
            compared: knowledge.demos.iter().count(),
            reframed,
            connection,
        };
        self.carry_out(selected, mode, pusher, block)
    }

    fn decide_outcome(&mut self, mode: Mode, pusher: PusherState, block: Pose2) -> Result<Decision, LookupError> {
        let knowledge = Arc::clone(&self.knowledge);
        let chunks = knowledge.chunks.as_ref().ok_or(LookupError::NoChunks)?;
        let wanted = block.inverse().compose(GOAL);
        let mut count = NonZeroUsize::new(self.config.retrieve.candidates).unwrap_or(NonZeroUsize::MIN);
        let mut candidates = chunks.nearest(wanted, count);
        let mut compared = candidates.len();
        let mut found = self.cheapest(&candidates, PLANS_TRIED, mode, pusher, block)?;
        // Where none of the best outcomes can be had, in a corner say, a lesser one will do: it leads to where they can.
        let mut fallback = None;
        while let Some((_, false)) = &found {
            fallback = fallback.or(found);
            if compared >= chunks.len() {
                found = None;
                break;
            }
            count = count.saturating_mul(WIDER);
            candidates = chunks.nearest(wanted, count);
            found = self.cheapest(&candidates[compared..], PLANS_TRIED_FARTHER, mode, pusher, block)?;
            compared = candidates.len();
        }
        let (chosen, _) = found.or(fallback).ok_or(LookupError::NoChunks)?;
        let Choice {
            chunk,
            reframed,
            connection,
        } = chosen;
        self.trial = Some(Trial { chunk, before: block });
        let selected = Selected {
            demo: chunk.demo,
            start: chunk.start,
            end: chunk.end,
            distances: None,
            compared,
            reframed,
            connection,
        };
        self.carry_out(selected, mode, pusher, block)
    }

    /// The cheapest of the candidates to whose start a way leads; where there is none, the cheapest, with `false`.
    fn cheapest(
        &mut self,
        candidates: &[(f64, Chunk)],
        plans: usize,
        mode: Mode,
        pusher: PusherState,
        block: Pose2,
    ) -> Result<Option<(Choice, bool)>, LookupError> {
        let knowledge = Arc::clone(&self.knowledge);
        let mut ranked: Vec<(f64, Chunk)> = Vec::with_capacity(candidates.len());
        for (misalignment, chunk) in candidates {
            let failed_before = self.set_aside.contains(&(chunk.demo, chunk.start));
            let cost = if failed_before {
                f64::INFINITY
            } else {
                self.cost(*misalignment, chunk, pusher, block)?
            };
            ranked.push((cost, *chunk));
        }
        // Stable: equal costs keep the order of their misalignment.
        ranked.sort_by(|a, b| a.0.total_cmp(&b.0));
        let mut first = None;
        let mut planned = 0;
        for (cost, chunk) in ranked {
            let frames = demo_frames(&knowledge.demos, chunk.demo, chunk.start)?;
            let possible = cost.is_finite() && stays_inside(frames, &chunk, block);
            if planned == plans || (!possible && first.is_some()) {
                continue;
            }
            let (reframed, connection) = self.connect(mode, &frames[0], pusher, block);
            planned += 1;
            let reached = possible && connection.kind != PlanKind::Failed;
            let choice = Choice {
                chunk,
                reframed,
                connection,
            };
            if reached {
                return Ok(Some((choice, true)));
            }
            first = first.or(Some((choice, false)));
        }
        Ok(first)
    }

    /// Reframe and Replan for a chunk that starts at `frame`.
    fn connect(&mut self, mode: Mode, frame: &PlanarFrame, pusher: PusherState, block: Pose2) -> (Reframed, Plan) {
        let reframed = if self.config.reframe.enabled {
            reframe(mode, frame.object, frame.eef, block, pusher.position)
        } else {
            without_reframe(frame.eef)
        };
        let connection = plan(
            &self.config.replan,
            block,
            pusher.position,
            reframed.near,
            &mut self.random,
        );
        (reframed, connection)
    }

    /// How many of `frames`, at least one, the horizon's commands carry out.
    fn frames_within_horizon(&self, frames: &[PlanarFrame]) -> usize {
        let replay = &self.config.replay;
        let count = match replay.tracking {
            Tracking::Actions => replay.horizon.saturating_mul(replay.stride.max(1)),
            Tracking::Path => {
                let mut travel = 0.0;
                let reach = replay.horizon as f64 * replay.speed;
                1 + frames
                    .windows(2)
                    .take_while(|pair| {
                        travel += (pair[1].eef - pair[0].eef).norm();
                        travel <= reach
                    })
                    .count()
            }
        };
        count.clamp(1, frames.len())
    }

    /// Queues the connection and the chunk, and says why.
    fn carry_out(
        &mut self,
        selected: Selected,
        mode: Mode,
        pusher: PusherState,
        block: Pose2,
    ) -> Result<Decision, LookupError> {
        let knowledge = Arc::clone(&self.knowledge);
        let Selected {
            demo,
            start,
            end,
            distances,
            compared,
            reframed,
            connection,
        } = selected;
        let rest = demo_frames(&knowledge.demos, demo, start)?;
        let frames = rest
            .get(..=(end - start) as usize)
            .ok_or_else(|| LookupError::UnknownDemo {
                demo: knowledge.demos.names().of(demo),
                frame: end,
            })?;
        let plan_steps = self.queue_plan(&connection);
        let replay_steps = self.queue_chunk(frames, &reframed);
        let poses: Vec<Pose2> = frames.iter().map(|f| reframed.carry.compose(f.object)).collect();
        let predicted = poses.last().map_or(block, |pose| pose.normalized());
        self.expected = poses;
        Ok(Decision {
            step: self.step,
            mode,
            eef: pusher.position,
            object: block,
            demo,
            demo_frame: start,
            demo_end: end,
            d_q: distances.map(|(d_q, _)| d_q),
            d_o: distances.map(|(_, d_o)| d_o),
            delta: reframed.delta,
            set_point: reframed.near,
            plan_kind: connection.kind,
            plan_steps: plan_steps as u32,
            plan_nodes: connection.nodes,
            plan_path: connection.path,
            replay_steps: replay_steps as u32,
            predicted_object: predicted,
            predicted_coverage: coverage(predicted, GOAL),
            compared: compared as u32,
        })
    }

    /// Expected misalignment after the chunk, plus the price of getting there and of carrying it out.
    fn cost(&self, misalignment: f64, chunk: &Chunk, pusher: PusherState, block: Pose2) -> Result<f64, LookupError> {
        let rest = demo_frames(&self.knowledge.demos, chunk.demo, chunk.start)?;
        let carry = block.delta_from(rest[0].object);
        let near = carry.transform_point(rest[0].eef);
        let reachable =
            |p: Point2| (10.0..=WORKSPACE - 10.0).contains(&p.x) && (10.0..=WORKSPACE - 10.0).contains(&p.y);
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

    fn queue_plan(&mut self, connection: &Plan) -> usize {
        if connection.kind == PlanKind::Off {
            return 0;
        }
        let before = self.queue.len();
        match self.config.replay.tracking {
            Tracking::Actions => {
                for point in waypoints(&connection.path, self.config.replan.spacing) {
                    self.queue.push_back((Phase::Plan, Command::Target(point)));
                }
            }
            Tracking::Path => self.queue_legs(Phase::Plan, &legs(&connection.path, self.config.replan.spacing, 0.0)),
        }
        self.queue.len() - before
    }

    fn queue_chunk(&mut self, frames: &[PlanarFrame], reframed: &Reframed) -> usize {
        let replay = self.config.replay.clone();
        let before = self.queue.len();
        match replay.tracking {
            // The last of every `stride` actions, so that the chunk goes as far as its recording.
            Tracking::Actions => {
                for group in frames.chunks(replay.stride.max(1)) {
                    if let Some(last) = group.last() {
                        let target = reframed.carry.transform_point(last.action);
                        self.queue.push_back((Phase::Replay, Command::Target(target)));
                    }
                }
            }
            Tracking::Path => {
                let path: Vec<Point2> = frames.iter().map(|f| reframed.carry.transform_point(f.eef)).collect();
                self.queue_legs(Phase::Replay, &legs(&path, replay.speed, CORNER_TOLERANCE));
                // A chunk of one frame has no path: its start is held for one step.
                if self.queue.len() == before {
                    self.queue.push_back((Phase::Replay, Command::Target(reframed.near)));
                }
            }
        }
        self.queue.truncate(before + replay.horizon.max(1));
        self.queue.len() - before
    }

    fn queue_legs(&mut self, phase: Phase, legs: &[Leg]) {
        for &leg in legs {
            for left in (1..=leg.steps).rev() {
                self.queue.push_back((phase, Command::Follow { leg, left }));
            }
        }
    }
}
