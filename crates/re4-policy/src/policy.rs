//! The planar RE4 loop (paper, Algorithm 1), executed one control step at a time.

use std::collections::{BTreeSet, VecDeque};
use std::num::NonZeroUsize;
use std::sync::Arc;

use rand_pcg::Pcg64;
use re4_episode::{Mode, PlanarFrame};
use re4_geometry::{Point2, Pose2};
use re4_index::{Query, RetrievalIndex};
use re4_rollout::{Act, Phase, Plane, Policy, PolicyError, PolicyFactory, Senses};
use re4_sim::{GOAL, coverage};

use crate::LookupError;
use crate::config::{PolicyConfig, Selector, Tracking};
use crate::demos::DemoSet;
use crate::outcome::{Body, Chunk, ChunkLibrary};
use crate::path::{Leg, legs};
use crate::pusher::{PusherModel, PusherState};
use crate::reframe::{Reframed, reframe, without_reframe};
use crate::replan::{Plan, PlanKind, plan, waypoints};
use crate::workspace::Workspace;
use re4_episode::DemoNames;

/// Number of chunks, in ascending order of cost, for which a path is planned before the search is widened.
const MAX_PLANS: usize = 8;

/// The same limit for the chunks that a widened search adds.
const MAX_PLANS_WIDENED: usize = 128;

/// Factor by which the number of candidates grows if none of them can be executed: 8.
const WIDENING_FACTOR: NonZeroUsize = NonZeroUsize::MIN.saturating_add(7);

/// Maximum depth in pixels to which the recorded motion may move the block into a wall, in addition to the depth at which it
/// already is. Tuned on randomly sampled blocks in corners (`tests/walls.rs`).
const WALL_TOLERANCE: f64 = 30.0;

/// Maximum deviation in pixels of the legs of a replayed path from the recorded path.
const CORNER_TOLERANCE: f64 = 0.5;

/// The read-only data of the policy, which all rollouts share: the demonstrations, their index, and the chunks by outcome.
pub struct Knowledge {
    /// The demonstrations.
    pub demos: DemoSet<PlanarFrame>,
    /// The index for the two-stage lookup.
    pub index: RetrievalIndex,
    /// The chunks by outcome. `None` if the selector does not need them.
    pub chunks: Option<ChunkLibrary>,
}

/// The decision record of one retrieval. Positions and poses are in the frame of the observations, in pixels and radians.
#[derive(Debug, Clone, PartialEq)]
pub struct Decision {
    /// Number of control steps taken before the decision.
    pub step: u32,
    /// Mode of the query.
    pub mode: Mode,
    /// End-effector position of the query.
    pub eef: Point2,
    /// Object pose of the query.
    pub object: Pose2,
    /// Number of the retrieved demonstration in the index.
    pub demo: u32,
    /// Retrieved frame, which is the first frame of the chunk.
    pub demo_frame: u32,
    /// Last frame of the chunk, included.
    pub demo_end: u32,
    /// Distance over the full state in normalised coordinates; `None` for the outcome selector.
    pub d_q: Option<f64>,
    /// Distance over the object pose only in normalised coordinates; `None` for the outcome selector.
    pub d_o: Option<f64>,
    /// δ, the motion from the demonstration's object pose to the query's. The identity if Reframe is disabled.
    pub delta: Pose2,
    /// Set-point at which the chunk starts.
    pub set_point: Point2,
    /// How the path to the set-point was found.
    pub plan_kind: PlanKind,
    /// Number of commands of the path.
    pub plan_steps: u32,
    /// Number of nodes searched for the path.
    pub plan_nodes: u32,
    /// The path as a polyline.
    pub plan_path: Vec<Point2>,
    /// Number of commands of the chunk.
    pub replay_steps: u32,
    /// Object pose after the chunk as the demonstration predicts it.
    pub predicted_object: Pose2,
    /// Coverage of the goal at the predicted pose.
    pub predicted_coverage: f64,
    /// Number of chunks or demonstrations compared.
    pub compared: u32,
}

impl Decision {
    /// Returns the same record with its positions and poses in the world frame.
    #[must_use]
    pub fn in_world(&self, world_from_observed: &Pose2) -> Self {
        let point = |p: &Point2| world_from_observed.transform_point(*p);
        let pose = |pose: Pose2| world_from_observed.compose(pose).normalized();
        Self {
            eef: point(&self.eef),
            object: pose(self.object),
            // The demonstration stays where it was recorded.
            delta: world_from_observed.compose(self.delta),
            set_point: point(&self.set_point),
            plan_path: self.plan_path.iter().map(point).collect(),
            predicted_object: pose(self.predicted_object),
            ..self.clone()
        }
    }

    /// Returns the reason for the decision in words. `names` are the names of the demonstrations.
    pub fn reason(&self, names: &DemoNames) -> String {
        let chosen = format!("{} from frame {}", names.of(self.demo), self.demo_frame);
        let why = match (self.d_q, self.d_o) {
            (Some(d_q), Some(d_o)) => format!(
                "nearest object pose (d_o {d_o:.4}) among the nearest states of {} demonstrations (d_q {d_q:.4})",
                self.compared
            ),
            _ => format!(
                "its push to frame {} is predicted to reach a coverage of {:.3}, at the lowest cost of {} chunks compared",
                self.demo_end, self.predicted_coverage, self.compared
            ),
        };
        let path = match self.plan_kind {
            PlanKind::Direct => "the straight path to its start is free",
            PlanKind::Planned => "the path to its start goes around the block",
            PlanKind::Failed => "no free path to its start was found, so the straight path is used",
            PlanKind::Off => "it is replayed from the current position of the pusher",
        };
        format!("{chosen}: {why}; {path}")
    }
}

/// A command in the queue.
#[derive(Debug, Clone, Copy)]
enum Command {
    /// Send this target.
    Target(Point2),
    /// Send the first of the `left` targets that bring the pusher to the end of the leg. The target is computed when the command
    /// is executed, from the state of the pusher at that time.
    Follow { leg: Leg, left: usize },
}

/// The planar RE4 policy during one episode.
pub struct Re4 {
    config: PolicyConfig,
    knowledge: Arc<Knowledge>,
    random: Pcg64,
    model: PusherModel,
    body: Body,
    workspace: Workspace,
    pusher: Option<PusherState>,
    queue: VecDeque<(Phase, Command)>,
    /// Object poses along the chunk that is being replayed, as the demonstration predicts them.
    expected: Vec<Pose2>,
    trial: Option<Trial>,
    /// Starts of chunks, as (demonstration, frame), whose replay did not move the object as recorded. They are not selected
    /// again.
    ineffective: BTreeSet<(u32, u32)>,
    step: u32,
}

/// A chunk whose effect on the object has yet to be verified.
struct Trial {
    chunk: Chunk,
    /// Object pose at the decision.
    before: Pose2,
}

/// A chunk with the path to its start.
struct Choice {
    chunk: Chunk,
    reframed: Reframed,
    connection: Plan,
}

/// The result of a selector.
struct Selected {
    demo: u32,
    /// First frame of the chunk.
    start: u32,
    /// Last frame of the chunk, included.
    end: u32,
    /// `d_q` and `d_o`, if the selector computes them.
    distances: Option<(f64, f64)>,
    compared: usize,
    reframed: Reframed,
    connection: Plan,
}

/// Returns the frames of a demonstration from `frame` on, which are at least one.
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
    /// Creates the policy for an episode. `seed` seeds the sampling of the planner.
    pub fn new(config: PolicyConfig, knowledge: Arc<Knowledge>, seed: u64) -> Self {
        Self {
            config,
            knowledge,
            // The stream number is the ASCII code of "RE4ROLLOUT".
            random: Pcg64::new(u128::from(seed), 0x5245_3452_4f4c_4c4f_5554),
            model: PusherModel::default(),
            workspace: Workspace::default(),
            pusher: None,
            queue: VecDeque::new(),
            body: Body::tee(),
            expected: Vec::new(),
            trial: None,
            ineffective: BTreeSet::new(),
            step: 0,
        }
    }
}

/// Starts a [`Re4`] policy for every episode.
pub struct Re4Factory {
    /// The settings.
    pub config: PolicyConfig,
    /// The data of the policy.
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
        self.workspace = Workspace::new(senses.observed_from_world());
        let (eef, object) = (senses.proprio(), senses.object()?.pose);
        // The velocity of the pusher is not observed. The model of the controller predicts it from the last command.
        let velocity = self.pusher.map_or(Point2::zeros(), |p| p.velocity);
        let pusher = PusherState {
            position: eef,
            velocity,
        };
        if self.has_diverged(object) {
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
                let target = self.model.first_target(pusher, leg.goal, leg.velocity, left);
                self.workspace.clamp(target)
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
    /// Returns whether the object has left the path along which the chunk should move it.
    fn has_diverged(&self, block: Pose2) -> bool {
        let (Some(limit), Some((Phase::Replay, _))) = (self.config.replay.divergence, self.queue.front()) else {
            return false;
        };
        self.expected
            .iter()
            .all(|&pose| self.body.distance(pose, block) > limit)
    }

    fn decide(&mut self, pusher: PusherState, block: Pose2) -> Result<Decision, LookupError> {
        // A planar pusher does not grasp, so every query is in transit (paper, appendix "Push-T").
        let mode = Mode::Transit;
        self.verify_last_chunk(block);
        match self.config.retrieve.selector {
            Selector::TwoStage => self.decide_two_stage(mode, pusher, block),
            Selector::Outcome => self.decide_outcome(mode, pusher, block),
        }
    }

    /// Excludes the last chunk from further selection if the distance of the object from its predicted pose exceeds half of the
    /// predicted displacement.
    fn verify_last_chunk(&mut self, block: Pose2) {
        let Some(Trial { chunk, before }) = self.trial.take() else {
            return;
        };
        let expected = before.compose(chunk.motion);
        if self.body.distance(expected, block) > 0.5 * self.body.distance(expected, before) {
            self.ineffective.insert((chunk.demo, chunk.start));
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
        // The motion, in the object frame, that would bring the object to its goal.
        let wanted = block.inverse().compose(GOAL);
        let mut count = NonZeroUsize::new(self.config.retrieve.candidates).unwrap_or(NonZeroUsize::MIN);
        let mut candidates = chunks.nearest(wanted, count);
        let mut compared = candidates.len();
        let mut found = self.cheapest(&candidates, MAX_PLANS, mode, pusher, block)?;
        // If none of the best candidates can be executed, for example because the block is in a corner, widen the search. A chunk
        // with a worse outcome can move the block to where better ones can be executed.
        let mut fallback = None;
        while let Some((_, false)) = &found {
            fallback = fallback.or(found);
            if compared >= chunks.len() {
                found = None;
                break;
            }
            count = count.saturating_mul(WIDENING_FACTOR);
            candidates = chunks.nearest(wanted, count);
            found = self.cheapest(&candidates[compared..], MAX_PLANS_WIDENED, mode, pusher, block)?;
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

    /// Returns the cheapest reachable candidate with `true`. If none is reachable, returns the cheapest candidate with `false`,
    /// and `None` if there are no candidates. At most `plans` paths are planned.
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
            let failed_before = self.ineffective.contains(&(chunk.demo, chunk.start));
            let cost = if failed_before {
                f64::INFINITY
            } else {
                self.cost(*misalignment, chunk, pusher, block)?
            };
            ranked.push((cost, *chunk));
        }
        // The sort is stable, so candidates of equal cost stay in the order of their misalignment.
        ranked.sort_by(|a, b| a.0.total_cmp(&b.0));
        let mut first = None;
        let mut planned = 0;
        for (cost, chunk) in ranked {
            let frames = demo_frames(&knowledge.demos, chunk.demo, chunk.start)?;
            let possible = cost.is_finite() && stays_inside(self.workspace, frames, &chunk, block);
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

    /// Performs Reframe and Replan for a chunk that starts at `frame`.
    fn connect(&mut self, mode: Mode, frame: &PlanarFrame, pusher: PusherState, block: Pose2) -> (Reframed, Plan) {
        let reframed = if self.config.reframe.enabled {
            reframe(mode, frame.object, frame.eef, block, pusher.position)
        } else {
            without_reframe(frame.eef)
        };
        let connection = plan(
            &self.config.replan,
            self.workspace,
            block,
            pusher.position,
            reframed.near,
            &mut self.random,
        );
        (reframed, connection)
    }

    /// Returns how many of `frames` the commands of the horizon cover, at least one.
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

    /// Queues the commands of the path and of the chunk, and returns the decision record.
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
            // Keeping the last action of every group moves the pusher as far as in the recording.
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
                // A chunk of one frame has no path, so its start is held for one step.
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
