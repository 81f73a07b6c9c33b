//! The RE4 loop in SE(3) (paper, Algorithm 1), executed one control step at a time.

use std::collections::BTreeSet;
use std::sync::Arc;

use nalgebra::Isometry3;
use re4_episode::Mode;
use re4_geometry::spatial::{is_valid_pose, pose_distance, step_toward};
use re4_index::{IndexError, SpatialDistances, SpatialQuery};
use re4_rollout::{Act, ArmAction, Phase, Policy, PolicyError, Senses, Space, Trace};

use crate::LookupError;
use crate::spatial::bans::Bans;
use crate::spatial::chunk::Chunk;
use crate::spatial::config::{EndOfDemo, GraspCheck, Measuring, SpatialPolicyConfig, WhileHeld};
use crate::spatial::decision::{SpatialChoice, SpatialDecision, SpatialDecisionKind};
use crate::spatial::demos::{SpatialDemoFrame, SpatialKnowledge, last_release};
use crate::spatial::estimate::ObjectEstimate;
use crate::spatial::reframe::{reframe_spatial, without_reframe_spatial};
use crate::spatial::retime::Pace;

/// Command that opens the gripper.
const OPEN: f64 = -1.0;

/// Command that closes the gripper.
const CLOSE: f64 = 1.0;

/// Maximum number of actions after a change of the gripper command for which a chunk is extended while the fingers move.
const MAX_SETTLE_STEPS: u32 = 40;

/// The RE4 policy in SE(3) during one episode.
///
/// The policy makes a decision whenever no activity is in progress. If the gripper was commanded to close and there is nothing
/// between the fingers, the arm returns home. Otherwise the policy retrieves a frame, bridges to the start of the chunk and
/// replays the chunk. The policy uses no random numbers.
pub struct SpatialRe4 {
    config: SpatialPolicyConfig,
    knowledge: Arc<SpatialKnowledge>,
    home: Isometry3<f64>,
    bans: Bans,
    estimate: ObjectEstimate,
    /// Whether the estimate is from an observation that was not doubtful, and the object was not touched since.
    is_clear: bool,
    /// Number of control steps until the policy looks at the object again. `None` if it does not before the next decision.
    look_in: Option<u32>,
    /// Last gripper command.
    gripper: f64,
    /// Number of control steps since the gripper command last changed between closing and not closing.
    since_change: u32,
    /// Distance between the fingers at the last step, in metres.
    separation: Option<f64>,
    activity: Activity,
    /// The last chunk that was replayed to its end. `None` after a return home or once the next chunk has started.
    followed: Option<Followed>,
    /// The demonstration whose action last closed the gripper.
    grasped_by: Option<u32>,
    newly_banned: Vec<u32>,
    trace: Trace,
    step: u32,
}

/// The activity in progress.
enum Activity {
    None,
    Home { taken: u32 },
    Chunk(Box<Chunk>),
}

/// A chunk that was replayed to its end.
#[derive(Clone, Copy)]
struct Followed {
    demo: u32,
    /// The frame after its last frame, or `None` if the demonstration ended.
    next: Option<u32>,
}

/// The observations from which the object pose can still be requested at this step. `None` once the pose is known.
type PoseObserver<'a> = Option<&'a mut dyn Senses<Space>>;

/// The observation at one step, with the estimate of the object pose. World frame.
#[derive(Clone, Copy)]
struct Observation {
    mode: Mode,
    eef: Isometry3<f64>,
    object: Isometry3<f64>,
    fingers: [f64; 2],
}

impl Observation {
    fn separation(&self) -> f64 {
        (self.fingers[0] - self.fingers[1]).abs()
    }

    fn query(&self) -> SpatialQuery {
        SpatialQuery {
            mode: self.mode,
            eef: self.eef,
            object: self.object,
        }
    }
}

impl SpatialRe4 {
    /// Creates the policy for an episode. `home` is the pose to which the grip site returns after a lost grasp; it is the pose
    /// after the reset.
    pub fn new(config: SpatialPolicyConfig, knowledge: Arc<SpatialKnowledge>, home: Isometry3<f64>) -> Self {
        Self {
            bans: Bans::new(
                config.recovery.ban.clone(),
                knowledge.demos().len(),
                config.replay.horizon,
            ),
            estimate: ObjectEstimate::new(config.filter.clone(), knowledge.group().clone()),
            config,
            knowledge,
            home,
            gripper: OPEN,
            is_clear: false,
            look_in: None,
            // The fingers do not count as settling before the first command.
            since_change: MAX_SETTLE_STEPS,
            separation: None,
            activity: Activity::None,
            followed: None,
            grasped_by: None,
            newly_banned: Vec::new(),
            trace: Trace::default(),
            step: 0,
        }
    }

    /// The same policy without some of its demonstrations, which reports what its decisions depend on.
    #[must_use]
    pub fn without(self, without: &Arc<BTreeSet<u32>>) -> Self {
        let left_out = without
            .iter()
            .filter(|demo| self.knowledge.demos().demo(**demo).is_some());
        Self {
            bans: Bans::new(
                self.config.recovery.ban.clone(),
                self.knowledge.demos().len() - left_out.count(),
                self.config.replay.horizon,
            ),
            trace: Trace::without(without),
            ..self
        }
    }

    /// Returns the demonstrations that are currently banned.
    pub fn banned(&self) -> impl Iterator<Item = u32> {
        self.bans.set().iter().copied()
    }
}

/// Returns the error for a pose that is not finite.
fn not_finite() -> PolicyError {
    LookupError::Retrieve(IndexError::QueryNotFinite).into()
}

impl Policy<Space> for SpatialRe4 {
    type Decision = SpatialDecision;

    /// Returns the action for the next control step.
    ///
    /// If the object pose is available without rendering, the policy observes it at every step. Otherwise it requests the pose
    /// when it selects what to do next, and when `reframe.look_again` is due, at most once per step.
    fn act(&mut self, senses: &mut dyn Senses<Space>) -> Result<Act<Space, SpatialDecision>, PolicyError> {
        let arm = senses.proprio();
        if !is_valid_pose(&arm.eef) || arm.fingers.iter().any(|f| !f.is_finite()) {
            return Err(not_finite());
        }
        let mode = self.mode();
        let mut observed = Observation {
            mode,
            eef: arm.eef,
            object: Isometry3::identity(),
            fingers: arm.fingers,
        };
        self.look_in = self.look_in.map(|steps| steps.saturating_sub(1));
        let look_now = mode == Mode::Transit && self.look_in == Some(0);
        let mut observe_now = senses.observes_object() || look_now;
        let mut observer: PoseObserver<'_> = Some(senses);
        if !observe_now || look_now {
            match self.estimate.carry(mode, &arm.eef) {
                Some(carried) => {
                    observed.object = carried;
                    if mode == Mode::Transfer && self.config.reframe.held == WhileHeld::Carried {
                        observer = None;
                    }
                }
                // The first step of an episode needs an observation in any case.
                None => observe_now = true,
            }
        }
        if observe_now {
            self.observe_object(&mut observed, &mut observer)?;
        }
        self.step(observed, observer)
    }

    fn considered(&self) -> Option<&BTreeSet<u32>> {
        self.trace.considered()
    }
}

impl SpatialRe4 {
    fn mode(&self) -> Mode {
        if self.gripper > 0.0 {
            Mode::Transfer
        } else {
            Mode::Transit
        }
    }

    /// Requests the object pose, unless it is already known at this step, and updates the estimate. A doubtful pose is not used if
    /// there is a clear one of the untouched object; the policy then looks again after some steps, when the arm hides less or
    /// something else of the scene.
    fn observe_object(
        &mut self,
        observed: &mut Observation,
        observer: &mut PoseObserver<'_>,
    ) -> Result<(), PolicyError> {
        let Some(senses) = observer.take() else {
            return Ok(());
        };
        let seen = senses.object()?;
        if !is_valid_pose(&seen.pose) {
            return Err(not_finite());
        }
        let doubtful = seen.is_doubtful();
        if !(doubtful && self.is_clear) {
            observed.object = self.estimate.observe(observed.mode, &observed.eef, &seen.pose);
        }
        self.is_clear |= !doubtful;
        self.look_in = self.config.reframe.look_again.filter(|_| doubtful);
        Ok(())
    }

    /// Executes one control step.
    fn step(
        &mut self,
        mut observed: Observation,
        mut observer: PoseObserver<'_>,
    ) -> Result<Act<Space, SpatialDecision>, PolicyError> {
        let mut decision = None;
        if self.config.recovery.check == GraspCheck::Step && self.grasp_is_lost(&observed) {
            decision = Some(self.abort_grasp(&observed));
        }
        // Every iteration returns an action or starts another activity. The loop ends because a decision is always followed by an
        // action: a return home and a chunk both have at least one.
        let (action, phase) = loop {
            match std::mem::replace(&mut self.activity, Activity::None) {
                Activity::None => decision = Some(self.decide(&mut observed, &mut observer)?),
                Activity::Home { taken } => {
                    let arrived = taken > 0 && self.is_at(&observed.eef, &self.home);
                    if !arrived && taken < self.config.recovery.home_steps.max(1) {
                        self.activity = Activity::Home { taken: taken + 1 };
                        break (self.servo_toward(&observed.eef, &self.home, OPEN), Phase::Home);
                    }
                }
                Activity::Chunk(chunk) => {
                    let (done, lost) = self.continue_chunk(chunk, &observed)?;
                    if let Some(done) = done {
                        break done;
                    }
                    decision = lost.or(decision);
                }
            }
        };
        let changed = (action.gripper > 0.0) != (self.gripper > 0.0);
        // The fingers may move the object when they close, and it falls when they open.
        self.is_clear &= !changed;
        self.since_change = if changed {
            1
        } else {
            self.since_change.saturating_add(1)
        };
        self.gripper = action.gripper;
        self.separation = Some(observed.separation());
        self.step += 1;
        Ok(Act {
            action,
            phase,
            decision,
            object: Some(observed.object),
        })
    }

    /// Returns the next action of a chunk, if one is left. If a bridge ends and the grasp is lost, returns the decision to return
    /// home instead.
    #[expect(clippy::type_complexity, reason = "an action with its phase, or a decision")]
    fn continue_chunk(
        &mut self,
        mut chunk: Box<Chunk>,
        observed: &Observation,
    ) -> Result<(Option<(ArmAction, Phase)>, Option<SpatialDecision>), LookupError> {
        let knowledge = Arc::clone(&self.knowledge);
        let frames = frames_of(&knowledge, chunk.demo, chunk.start)?;
        chunk.is_final |= chunk.mode != observed.mode;
        if !chunk.is_final {
            let start = frames[chunk.start];
            self.measure(&mut chunk, &start, observed);
        }
        if let Some(taken) = chunk.bridge {
            if taken < self.config.replan.max_steps && !self.is_at(&observed.eef, &chunk.carry.near) {
                chunk.bridge = Some(taken + 1);
                let gripper = if chunk.mode == Mode::Transfer { CLOSE } else { OPEN };
                let action = self.servo_toward(&observed.eef, &chunk.carry.near, gripper);
                self.activity = Activity::Chunk(chunk);
                return Ok((Some((action, Phase::Bridge)), None));
            }
            chunk.bridge = None;
            if self.grasp_is_lost(observed) {
                self.activity = Activity::Chunk(chunk);
                return Ok((None, Some(self.abort_grasp(observed))));
            }
        }
        chunk.end_if_spent();
        if chunk.next > chunk.end && chunk.next < frames.len() && self.fingers_are_settling(observed) {
            chunk.end = chunk.next;
        }
        if chunk.next > chunk.end {
            self.followed = Some(Followed {
                demo: chunk.demo,
                next: (chunk.next < frames.len()).then_some(chunk.next as u32),
            });
            return Ok((None, None));
        }
        let pace = Pace {
            frames,
            free: knowledge.free(chunk.demo),
            replan: &self.config.replan,
        };
        let paced = pace.next(chunk.next, &chunk.carry, &observed.eef);
        let action = ArmAction {
            goal: paced.goal,
            gripper: frames[paced.frame].gripper,
        };
        if action.gripper > 0.0 && self.gripper <= 0.0 {
            self.grasped_by = Some(chunk.demo);
        }
        chunk.advance(&paced, self.config.replan.max_steps);
        self.activity = Activity::Chunk(chunk);
        Ok((Some((action, Phase::Replay)), None))
    }

    /// Measures the transformation of the chunk again. Of the symmetry-equivalent object poses, the one nearest to the previous
    /// measurement is used, so that the transformation does not jump between them.
    fn measure(&self, chunk: &mut Chunk, start: &SpatialDemoFrame, observed: &Observation) {
        let frame = rest_frame(observed);
        chunk.aligned = self
            .knowledge
            .group()
            .align(&frame.inv_mul(&observed.object), &chunk.aligned)
            .0;
        chunk.carry = reframe_spatial(
            chunk.mode,
            self.config.reframe.transfer,
            (&start.object, &start.eef),
            (&(frame * chunk.aligned), &observed.eef),
        );
    }

    /// Returns whether the fingers are still moving after the last change of the gripper command.
    fn fingers_are_settling(&self, observed: &Observation) -> bool {
        let Some(settle) = &self.config.replay.settle else {
            return false;
        };
        let is_moving = self
            .separation
            .is_some_and(|before| (observed.separation() - before).abs() > settle.finger_speed);
        self.since_change < settle.steps || (is_moving && self.since_change < MAX_SETTLE_STEPS)
    }

    fn is_at(&self, eef: &Isometry3<f64>, goal: &Isometry3<f64>) -> bool {
        let (distance, angle) = pose_distance(eef, goal);
        distance <= self.config.replan.tolerance_translation && angle <= self.config.replan.tolerance_rotation
    }

    /// Returns one step of the closed-loop motion that the bridge and the return home use.
    fn servo_toward(&self, eef: &Isometry3<f64>, goal: &Isometry3<f64>, gripper: f64) -> ArmAction {
        let replan = &self.config.replan;
        ArmAction {
            goal: step_toward(eef, goal, replan.lead_translation, replan.lead_rotation),
            gripper,
        }
    }

    /// Returns whether the gripper was commanded to close and there is nothing between the fingers.
    fn grasp_is_lost(&self, observed: &Observation) -> bool {
        let threshold = self.config.recovery.lost_grasp;
        observed.mode == Mode::Transfer && threshold.is_some_and(|threshold| observed.separation() < threshold)
    }

    fn ban(&mut self, demo: u32) {
        if self.bans.ban(demo) {
            self.newly_banned.push(demo);
        }
        // Without the only demonstration that is not banned, all bans would have been lifted.
        if self.trace.is_on() && self.bans.is_nearly_full() {
            let banned = self.bans.set();
            let others = self.knowledge.demos().iter().map(|(demo, _)| demo);
            let others: Vec<u32> = others.filter(|demo| !banned.contains(demo)).collect();
            self.trace.consider(others);
        }
    }

    /// Starts the return home, and bans the demonstration that made the grasp and the one that was being followed when the grasp
    /// was lost.
    fn abort_grasp(&mut self, observed: &Observation) -> SpatialDecision {
        let followed = match &self.activity {
            Activity::Chunk(chunk) => Some(chunk.demo),
            _ => self.followed.map(|followed| followed.demo),
        };
        let grasped_by = self.grasped_by.take();
        for demo in [grasped_by, followed.filter(|_| followed != grasped_by)]
            .into_iter()
            .flatten()
        {
            self.ban(demo);
        }
        self.return_home(SpatialDecisionKind::GraspLost, observed)
    }

    fn return_home(&mut self, kind: SpatialDecisionKind, observed: &Observation) -> SpatialDecision {
        self.followed = None;
        self.activity = Activity::Home { taken: 0 };
        let home = self.home;
        self.record(kind, observed, None, home, true)
    }

    fn record(
        &mut self,
        kind: SpatialDecisionKind,
        observed: &Observation,
        choice: Option<SpatialChoice>,
        set_point: Isometry3<f64>,
        bridge: bool,
    ) -> SpatialDecision {
        SpatialDecision {
            step: self.step,
            kind,
            mode: observed.mode,
            eef: observed.eef,
            object: observed.object,
            fingers: observed.fingers,
            choice,
            set_point,
            bridge,
            banned: self.bans.set().len() as u32,
            newly_banned: std::mem::take(&mut self.newly_banned),
        }
    }

    fn decide(
        &mut self,
        observed: &mut Observation,
        observer: &mut PoseObserver<'_>,
    ) -> Result<SpatialDecision, PolicyError> {
        if self.grasp_is_lost(observed) {
            return Ok(self.abort_grasp(observed));
        }
        if let Some(Followed { demo, next: None }) = self.followed
            && self.config.recovery.end_of_demo == EndOfDemo::GoHome
        {
            self.ban(demo);
            if observed.mode == Mode::Transit {
                return Ok(self.return_home(SpatialDecisionKind::DemoEnded, observed));
            }
        }
        // Everything that follows depends on the object pose. Returning home does not, so it needs no observation.
        self.observe_object(observed, observer)?;
        let observed = &*observed;
        let (kind, demo, frame, distances) = loop {
            let (kind, demo, frame, distances) = self.retrieve(observed)?;
            self.trace.consider([demo]);
            if !self.bans.is_repeated(observed.mode, demo, frame) {
                break (kind, demo, frame, distances);
            }
            self.ban(demo);
        };
        self.followed = None;
        Ok(self.start(observed, kind, (demo, frame as usize), distances)?)
    }

    /// Returns the frame to continue from: the retrieved frame or, if it is nearly as close, the next frame of the current
    /// demonstration.
    fn retrieve(
        &mut self,
        observed: &Observation,
    ) -> Result<(SpatialDecisionKind, u32, u32, SpatialDistances), LookupError> {
        let knowledge = Arc::clone(&self.knowledge);
        let (query, stage2) = (observed.query(), self.config.retrieve.stage2);
        let found = knowledge
            .index()
            .retrieve_without(&query, stage2, self.bans.set(), self.trace.left_out())?
            .ok_or(LookupError::NoFrameOfMode { mode: observed.mode })?;
        // Also if the policy continues with its demonstration, because the margin is relative to this frame.
        self.trace.consider([found.episode]);
        if let (Some(margin), Some(Followed { demo, next: Some(next) })) =
            (self.config.retrieve.commit_margin, self.followed)
            && !self.bans.set().contains(&demo)
        {
            let frames = frames_of(&knowledge, demo, next as usize)?;
            let frame = &frames[next as usize];
            let distances = knowledge.index().distances(&query, &frame.eef, &frame.object)?;
            if frame.mode == observed.mode && distances.d_q <= found.distances.d_q + margin {
                return Ok((SpatialDecisionKind::Continue, demo, next, distances));
            }
        }
        Ok((
            SpatialDecisionKind::Retrieve,
            found.episode,
            found.frame,
            found.distances,
        ))
    }

    /// Performs Reframe and starts the chunk with the bridge to it.
    fn start(
        &mut self,
        observed: &Observation,
        kind: SpatialDecisionKind,
        (demo, start): (u32, usize),
        distances: SpatialDistances,
    ) -> Result<SpatialDecision, LookupError> {
        let knowledge = Arc::clone(&self.knowledge);
        let frames = frames_of(&knowledge, demo, start)?;
        let first = &frames[start];
        let object = knowledge.group().rotated(&observed.object, distances.symmetry_rotation);
        let carry = if self.config.reframe.enabled {
            reframe_spatial(
                observed.mode,
                self.config.reframe.transfer,
                (&first.object, &first.eef),
                (&object, &observed.eef),
            )
        } else {
            without_reframe_spatial(&first.eef)
        };
        let horizon = self.config.replay.horizon.max(1) as usize;
        let pace = Pace {
            frames,
            free: knowledge.free(demo),
            replan: &self.config.replan,
        };
        let mut end = pace.end(start, horizon);
        let finishes = self.config.replay.finish && last_release(frames).is_some_and(|release| end >= release);
        if finishes {
            end = frames.len() - 1;
        }
        let bridge = self.config.replan.enabled && !self.is_at(&observed.eef, &carry.near);
        self.activity = Activity::Chunk(Box::new(Chunk {
            demo,
            start,
            next: start,
            budget: (self.config.replay.retime.is_some() && !finishes).then_some(self.config.replay.horizon.max(1)),
            waited: 0,
            end,
            mode: observed.mode,
            carry,
            aligned: rest_frame(observed).inv_mul(&object),
            is_final: !self.config.reframe.enabled || self.config.reframe.measure == Measuring::Decision,
            bridge: self.config.replan.enabled.then_some(0),
        }));
        let choice = SpatialChoice {
            demo,
            demo_frame: knowledge.recorded_frame(demo, start),
            demo_end: knowledge.recorded_frame(demo, end),
            d_q: distances.d_q,
            d_o: distances.d_o,
            d_e: distances.d_e,
            compared: knowledge.index().demos(observed.mode) as u32,
            delta: carry.delta,
            symmetry_rotation: distances.symmetry_rotation,
            replay_steps: (end - start + 1) as u32,
        };
        Ok(self.record(kind, observed, Some(choice), carry.near, bridge))
    }
}

/// Returns the pose of the frame in which the object is fixed: the world in transit, the gripper in transfer.
fn rest_frame(observed: &Observation) -> Isometry3<f64> {
    match observed.mode {
        Mode::Transit => Isometry3::identity(),
        Mode::Transfer => observed.eef,
    }
}

/// Returns the frames of a demonstration. It is an error if the demonstration has no frame `frame`.
fn frames_of(knowledge: &SpatialKnowledge, demo: u32, frame: usize) -> Result<&[SpatialDemoFrame], LookupError> {
    knowledge
        .demos()
        .demo(demo)
        .filter(|frames| frame < frames.len())
        .ok_or_else(|| LookupError::UnknownDemo {
            demo: knowledge.demos().names().of(demo),
            frame: frame as u32,
        })
}
