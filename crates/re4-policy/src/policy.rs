//! The planar RE4 loop (paper, Algorithm 1), executed one control step at a time.

mod choose;

use std::collections::{BTreeSet, VecDeque};
use std::sync::Arc;

use rand_pcg::Pcg64;
use re4_episode::{Mode, PlanarFrame};
use re4_geometry::{Point2, Pose2};
use re4_index::{Query, RetrievalIndex};
use re4_rollout::{Act, Phase, Plane, Policy, PolicyError, PolicyFactory, Senses, Trace};
use re4_sim::{GOAL, coverage};

use self::choose::{Choice, Found, Situation};
use crate::LookupError;
use crate::config::{PolicyConfig, Selector, Tracking};
use crate::decision::Decision;
use crate::demos::DemoSet;
use crate::outcome::{Body, Chunk, ChunkLibrary};
use crate::path::{Leg, legs};
use crate::pusher::{PusherModel, PusherState};
use crate::reframe::{Reframed, reframe, without_reframe};
use crate::replan::{Plan, PlanKind, plan, waypoints};
use crate::workspace::Workspace;

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
    /// Predicted state of the pusher at the next control step.
    pusher: Option<PusherState>,
    /// The predicted velocity and the command of each of the last control steps that the observation does not show yet.
    unseen: VecDeque<(Point2, Point2)>,
    /// Number of control steps until an observation shows the effect of the last replayed command.
    unsettled: usize,
    queue: VecDeque<(Phase, Command)>,
    /// Object poses along the chunk that is being replayed, as the demonstration predicts them.
    expected: Vec<Pose2>,
    trial: Option<Trial>,
    /// Starts of chunks, as (demonstration, frame), whose replay did not move the object as recorded. They are not selected
    /// again.
    ineffective: BTreeSet<(u32, u32)>,
    trace: Trace,
    step: u32,
}

/// A chunk whose effect on the object has yet to be verified.
struct Trial {
    chunk: Chunk,
    /// Object pose at the decision.
    before: Pose2,
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
            unseen: VecDeque::new(),
            unsettled: 0,
            queue: VecDeque::new(),
            body: Body::tee(),
            expected: Vec::new(),
            trial: None,
            ineffective: BTreeSet::new(),
            trace: Trace::default(),
            step: 0,
        }
    }

    /// The same policy without some of its demonstrations, which reports what its decisions depend on.
    #[must_use]
    pub fn without(self, without: &Arc<BTreeSet<u32>>) -> Self {
        Self {
            trace: Trace::without(without),
            ..self
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

    fn start_without(&self, seed: u32, first: &Point2, without: &Arc<BTreeSet<u32>>) -> Option<Re4> {
        Some(self.start(seed, first).without(without))
    }
}

impl Policy<Plane> for Re4 {
    type Decision = Decision;

    fn act(&mut self, senses: &mut dyn Senses<Plane>) -> Result<Act<Plane, Decision>, PolicyError> {
        self.workspace = Workspace::new(senses.observed_from_world());
        let (eef, object) = (senses.proprio(), senses.object()?.pose);
        let latency = senses.latency() as usize;
        let pusher = self.current_pusher(eef);
        if self.has_diverged(object) {
            self.queue.clear();
        }
        // A decision needs the pose of the object at rest. The pusher holds its position until the observation shows it.
        if self.queue.is_empty() && self.unsettled > 0 {
            self.unsettled -= 1;
            return Ok(self.send(Phase::Replay, pusher, pusher.position, None, object, latency));
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
        if phase == Phase::Replay {
            self.unsettled = latency;
        }
        Ok(self.send(phase, pusher, target, decision, object, latency))
    }

    fn considered(&self) -> Option<&BTreeSet<u32>> {
        self.trace.considered()
    }
}

impl Re4 {
    /// Returns the current state of the pusher: the observed one, moved on by the commands that the observation does not show yet.
    ///
    /// The velocity is not observed. The model of the controller predicts it from the earlier commands.
    fn current_pusher(&self, observed: Point2) -> PusherState {
        let predicted = self.pusher.map_or(Point2::zeros(), |pusher| pusher.velocity);
        let seen = PusherState {
            position: observed,
            velocity: self.unseen.front().map_or(predicted, |(velocity, _)| *velocity),
        };
        let commands = self.unseen.iter().map(|(_, target)| *target);
        commands.fold(seen, |pusher, target| self.model.predict(pusher, target))
    }

    /// Sends a target and predicts the pusher's state after it.
    fn send(
        &mut self,
        phase: Phase,
        pusher: PusherState,
        target: Point2,
        decision: Option<Decision>,
        object: Pose2,
        latency: usize,
    ) -> Act<Plane, Decision> {
        self.pusher = Some(self.model.predict(pusher, target));
        self.unseen.push_back((pusher.velocity, target));
        if self.unseen.len() > latency {
            self.unseen.pop_front();
        }
        self.step += 1;
        Act {
            action: target,
            phase,
            decision,
            object: Some(object),
        }
    }

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
            .retrieve_without(&query, self.config.retrieve.epsilon, self.trace.left_out())?
            .ok_or(LookupError::NoFrameOfMode { mode })?;
        // Stage 2 takes a minimum over demonstrations, each with its own frame of stage 1: without another demonstration than
        // the one with the minimum, the minimum is the same.
        self.trace.consider([found.episode]);
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
        let at = Situation { mode, pusher, block };
        let before = self.trace.is_on().then(|| self.random.clone());
        let without = self.trace.left_out().clone();
        let found = self.choose(&at, &without)?;
        if let Some(before) = before {
            self.trace_choice(&at, &found, &before)?;
        }
        let Found {
            choice:
                Choice {
                    chunk,
                    reframed,
                    connection,
                    ..
                },
            compared,
            ..
        } = found;
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
