//! The RE4 loop in SE(3) (paper, Algorithm 1), one control step at a time.

use std::sync::Arc;

use nalgebra::Isometry3;
use re4_episode::Mode;
use re4_geometry::spatial::{is_sound, pose_distance, step_toward};
use re4_index::{IndexError, SpatialDistances, SpatialQuery};
use re4_rollout::{Act, ArmAction, ArmState, Phase, Policy, PolicyError, PolicyFactory, Senses, Space};

use crate::LookupError;
use crate::spatial::bans::Bans;
use crate::spatial::config::{EndOfDemo, GraspCheck, Measuring, SpatialPolicyConfig, WhileHeld};
use crate::spatial::decision::{SpatialChoice, SpatialDecision, SpatialDecisionKind};
use crate::spatial::demos::{SpatialDemoFrame, SpatialKnowledge, last_release};
use crate::spatial::estimate::ObjectEstimate;
use crate::spatial::reframe::{Carry, reframe_spatial, without_reframe_spatial};

/// Command that opens the gripper.
const OPEN: f64 = -1.0;

/// Command that closes it.
const CLOSE: f64 = 1.0;

/// Actions after a change of the gripper's command for which fingers that move are waited for.
const SETTLE_MOST: u32 = 40;

/// A policy in the middle of an episode.
///
/// When nothing is under way it decides: with the gripper told to close and nothing between the fingers, it goes home;
/// otherwise it retrieves a frame, bridges to where the chunk starts, and replays. It draws no random numbers.
pub struct SpatialRe4 {
    config: SpatialPolicyConfig,
    knowledge: Arc<SpatialKnowledge>,
    home: Isometry3<f64>,
    bans: Bans,
    estimate: ObjectEstimate,
    /// Last gripper command.
    gripper: f64,
    /// Control steps since that command began to close, or ceased to.
    since_change: u32,
    /// Distance between the fingers at the last step.
    separation: Option<f64>,
    doing: Doing,
    /// The chunk that was replayed to its end, unless a grasp was lost since.
    followed: Option<Followed>,
    /// The demonstration that last closed the gripper.
    grasped_by: Option<u32>,
    newly_banned: Vec<u32>,
    step: u32,
}

/// What is under way.
enum Doing {
    Nothing,
    Home { taken: u32 },
    Chunk(Box<Chunk>),
}

/// A chunk that is being carried out.
struct Chunk {
    demo: u32,
    /// First frame.
    start: usize,
    /// Frame of the next action.
    next: usize,
    /// Last frame.
    end: usize,
    /// Mode of the query.
    mode: Mode,
    carry: Carry,
    /// The query's object, aligned with the demonstration's: in the world in transit, in the gripper in transfer.
    aligned: Isometry3<f64>,
    /// Whether the way that the chunk is carried stays as it is from here on.
    measured: bool,
    /// Steps of the bridge so far; none when it is over.
    bridge: Option<u32>,
}

/// A chunk that is over.
#[derive(Clone, Copy)]
struct Followed {
    demo: u32,
    /// The frame after its last; none where the demonstration ended.
    next: Option<u32>,
}

/// Who can still be asked for the object's pose at a step; nobody once it is known.
type PoseObserver<'a> = Option<&'a mut dyn Senses<Space>>;

/// What is seen at a step, with the estimate of the object's pose.
#[derive(Clone, Copy)]
struct Seen {
    mode: Mode,
    eef: Isometry3<f64>,
    object: Isometry3<f64>,
    fingers: [f64; 2],
}

impl Seen {
    fn separation(&self) -> f64 {
        (self.fingers[0] - self.fingers[1]).abs()
    }

    /// Looks, unless the object's pose was told.
    fn look(&mut self, observer: &mut PoseObserver<'_>, estimate: &mut ObjectEstimate) -> Result<(), PolicyError> {
        if let Some(senses) = observer.take() {
            let object = senses.object()?;
            if !is_sound(&object) {
                return Err(nowhere());
            }
            self.object = estimate.observe(self.mode, &self.eef, &object);
        }
        Ok(())
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
    /// A policy at the beginning of an episode. `home` is the pose of the grip site to go back to when a grasp is lost: that
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
            since_change: SETTLE_MOST,
            separation: None,
            doing: Doing::Nothing,
            followed: None,
            grasped_by: None,
            newly_banned: Vec::new(),
            step: 0,
        }
    }

    /// Demonstrations that are not followed again in this episode.
    pub fn banned(&self) -> impl Iterator<Item = u32> {
        self.bans.set().iter().copied()
    }
}

/// Starts [`SpatialRe4`].
pub struct SpatialRe4Factory {
    /// Its settings.
    pub config: SpatialPolicyConfig,
    /// What it knows.
    pub knowledge: Arc<SpatialKnowledge>,
}

impl PolicyFactory<Space> for SpatialRe4Factory {
    type Policy = SpatialRe4;

    fn start(&self, _: u32, first: &ArmState) -> SpatialRe4 {
        SpatialRe4::new(self.config.clone(), Arc::clone(&self.knowledge), first.eef)
    }
}

/// A pose that is nowhere.
fn nowhere() -> PolicyError {
    LookupError::Retrieve(IndexError::QueryNotFinite).into()
}

impl Policy<Space> for SpatialRe4 {
    type Decision = SpatialDecision;

    /// Where the object's pose is told at every step, every one is taken; else it is asked for where the policy chooses what to
    /// do next, once a step at the most, and not at other steps.
    fn act(&mut self, senses: &mut dyn Senses<Space>) -> Result<Act<Space, SpatialDecision>, PolicyError> {
        let body = senses.proprio();
        if !is_sound(&body.eef) || body.fingers.iter().any(|f| !f.is_finite()) {
            return Err(nowhere());
        }
        let mode = self.mode();
        let mut seen = Seen {
            mode,
            eef: body.eef,
            object: Isometry3::identity(),
            fingers: body.fingers,
        };
        let mut at_once = senses.observes_object();
        let mut observer: PoseObserver<'_> = Some(senses);
        if !at_once {
            match self.estimate.carry(mode, &body.eef) {
                Some(carried) => {
                    seen.object = carried;
                    if mode == Mode::Transfer && self.config.reframe.held == WhileHeld::Carried {
                        observer = None;
                    }
                }
                None => at_once = true,
            }
        }
        if at_once {
            seen.look(&mut observer, &mut self.estimate)?;
        }
        self.step(seen, observer)
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

    /// One control step.
    fn step(
        &mut self,
        mut seen: Seen,
        mut observer: PoseObserver<'_>,
    ) -> Result<Act<Space, SpatialDecision>, PolicyError> {
        let mut decision = None;
        if self.config.recovery.check == GraspCheck::Step && self.grasp_is_lost(&seen) {
            decision = Some(self.abort_grasp(&seen));
        }
        // Each pass ends with an action or with another thing to do, and after a decision there is always an action: the way
        // home has at least one, and so has every chunk.
        let (action, phase) = loop {
            match std::mem::replace(&mut self.doing, Doing::Nothing) {
                Doing::Nothing => decision = Some(self.decide(&mut seen, &mut observer)?),
                Doing::Home { taken } => {
                    let arrived = taken > 0 && self.is_at(&seen.eef, &self.home);
                    if !arrived && taken < self.config.recovery.home_steps.max(1) {
                        self.doing = Doing::Home { taken: taken + 1 };
                        break (self.toward(&seen.eef, &self.home, OPEN), Phase::Home);
                    }
                }
                Doing::Chunk(chunk) => {
                    let (done, lost) = self.carry_on(chunk, &seen)?;
                    if let Some(done) = done {
                        break done;
                    }
                    decision = lost.or(decision);
                }
            }
        };
        let changed = (action.gripper > 0.0) != (self.gripper > 0.0);
        self.since_change = if changed {
            1
        } else {
            self.since_change.saturating_add(1)
        };
        self.gripper = action.gripper;
        self.separation = Some(seen.separation());
        self.step += 1;
        Ok(Act {
            action,
            phase,
            decision,
            object: Some(seen.object),
        })
    }

    /// The next action of a chunk, if there is one left; where a bridge ends without a grasp, the decision to go home.
    #[expect(clippy::type_complexity, reason = "an action with its phase, or a decision")]
    fn carry_on(
        &mut self,
        mut chunk: Box<Chunk>,
        seen: &Seen,
    ) -> Result<(Option<(ArmAction, Phase)>, Option<SpatialDecision>), LookupError> {
        let knowledge = Arc::clone(&self.knowledge);
        let frames = frames_of(&knowledge, chunk.demo, chunk.start)?;
        chunk.measured |= chunk.mode != seen.mode;
        if !chunk.measured {
            let start = frames[chunk.start];
            self.measure(&mut chunk, &start, seen);
        }
        if let Some(taken) = chunk.bridge {
            if taken < self.config.replan.max_steps && !self.is_at(&seen.eef, &chunk.carry.near) {
                chunk.bridge = Some(taken + 1);
                let gripper = if chunk.mode == Mode::Transfer { CLOSE } else { OPEN };
                let action = self.toward(&seen.eef, &chunk.carry.near, gripper);
                self.doing = Doing::Chunk(chunk);
                return Ok((Some((action, Phase::Bridge)), None));
            }
            chunk.bridge = None;
            if self.grasp_is_lost(seen) {
                self.doing = Doing::Chunk(chunk);
                return Ok((None, Some(self.abort_grasp(seen))));
            }
        }
        if chunk.next > chunk.end && chunk.next < frames.len() && self.settles(seen) {
            chunk.end = chunk.next;
        }
        if chunk.next > chunk.end {
            self.followed = Some(Followed {
                demo: chunk.demo,
                next: (chunk.next < frames.len()).then_some(chunk.next as u32),
            });
            return Ok((None, None));
        }
        let frame = &frames[chunk.next];
        let action = ArmAction {
            goal: chunk.carry.goal(&frame.goal),
            gripper: frame.gripper,
        };
        if action.gripper > 0.0 && self.gripper <= 0.0 {
            self.grasped_by = Some(chunk.demo);
        }
        chunk.next += 1;
        self.doing = Doing::Chunk(chunk);
        Ok((Some((action, Phase::Replay)), None))
    }

    /// Measures anew how the chunk is carried. The object's pose is taken in that of its like ones that is nearest to the one
    /// taken before, so that the chunk never jumps from one to another.
    fn measure(&self, chunk: &mut Chunk, start: &SpatialDemoFrame, seen: &Seen) {
        let frame = frame_of_rest(seen);
        chunk.aligned = self
            .knowledge
            .group()
            .align(&frame.inv_mul(&seen.object), &chunk.aligned)
            .0;
        chunk.carry = reframe_spatial(
            chunk.mode,
            self.config.reframe.transfer,
            (&start.object, &start.eef),
            (&(frame * chunk.aligned), &seen.eef),
        );
    }

    /// Whether the fingers are still on their way to what the last change of the gripper's command asked for.
    fn settles(&self, seen: &Seen) -> bool {
        let Some(settle) = &self.config.replay.settle else {
            return false;
        };
        let moves = self
            .separation
            .is_some_and(|before| (seen.separation() - before).abs() > settle.finger_speed);
        self.since_change < settle.steps || (moves && self.since_change < SETTLE_MOST)
    }

    fn is_at(&self, eef: &Isometry3<f64>, goal: &Isometry3<f64>) -> bool {
        let (distance, angle) = pose_distance(eef, goal);
        distance <= self.config.replan.tolerance_translation && angle <= self.config.replan.tolerance_rotation
    }

    /// One step of the servo that bridges and goes home.
    fn toward(&self, eef: &Isometry3<f64>, goal: &Isometry3<f64>, gripper: f64) -> ArmAction {
        let replan = &self.config.replan;
        ArmAction {
            goal: step_toward(eef, goal, replan.lead_translation, replan.lead_rotation),
            gripper,
        }
    }

    /// ObservedPose to close, and nothing between the fingers.
    fn grasp_is_lost(&self, seen: &Seen) -> bool {
        let lost_below = self.config.recovery.lost_grasp;
        seen.mode == Mode::Transfer && lost_below.is_some_and(|minimum| seen.separation() < minimum)
    }

    fn ban(&mut self, demo: u32) {
        if self.bans.ban(demo) {
            self.newly_banned.push(demo);
        }
    }

    /// Goes home, and bans the demonstration that made the grasp and the one that was followed when it was lost.
    fn abort_grasp(&mut self, seen: &Seen) -> SpatialDecision {
        let followed = match &self.doing {
            Doing::Chunk(chunk) => Some(chunk.demo),
            _ => self.followed.map(|followed| followed.demo),
        };
        let grasped_by = self.grasped_by.take();
        for demo in [grasped_by, followed.filter(|_| followed != grasped_by)]
            .into_iter()
            .flatten()
        {
            self.ban(demo);
        }
        self.go_home(SpatialDecisionKind::GraspLost, seen)
    }

    fn go_home(&mut self, kind: SpatialDecisionKind, seen: &Seen) -> SpatialDecision {
        self.followed = None;
        self.doing = Doing::Home { taken: 0 };
        let home = self.home;
        self.record(kind, seen, None, home, true)
    }

    fn record(
        &mut self,
        kind: SpatialDecisionKind,
        seen: &Seen,
        choice: Option<SpatialChoice>,
        set_point: Isometry3<f64>,
        bridge: bool,
    ) -> SpatialDecision {
        SpatialDecision {
            step: self.step,
            kind,
            mode: seen.mode,
            eef: seen.eef,
            object: seen.object,
            fingers: seen.fingers,
            choice,
            set_point,
            bridge,
            banned: self.bans.set().len() as u32,
            newly_banned: std::mem::take(&mut self.newly_banned),
        }
    }

    fn decide(&mut self, seen: &mut Seen, observer: &mut PoseObserver<'_>) -> Result<SpatialDecision, PolicyError> {
        if self.grasp_is_lost(seen) {
            return Ok(self.abort_grasp(seen));
        }
        if let Some(Followed { demo, next: None }) = self.followed
            && self.config.recovery.end_of_demo == EndOfDemo::GoHome
        {
            self.ban(demo);
            if seen.mode == Mode::Transit {
                return Ok(self.go_home(SpatialDecisionKind::DemoEnded, seen));
            }
        }
        // Whatever is chosen from here on depends on where the object is; the way home does not.
        seen.look(observer, &mut self.estimate)?;
        let seen = &*seen;
        let (kind, demo, frame, distances) = loop {
            let (kind, demo, frame, distances) = self.retrieve(seen)?;
            if !self.bans.leads_nowhere(seen.mode, demo, frame) {
                break (kind, demo, frame, distances);
            }
            self.ban(demo);
        };
        self.followed = None;
        Ok(self.start(seen, kind, (demo, frame as usize), distances)?)
    }

    /// The frame to go on from: the retrieved one, or the next of the demonstration followed, where that is nearly as near.
    fn retrieve(&self, seen: &Seen) -> Result<(SpatialDecisionKind, u32, u32, SpatialDistances), LookupError> {
        let knowledge = &self.knowledge;
        let (query, stage2) = (seen.query(), self.config.retrieve.stage2);
        let found = knowledge
            .index()
            .retrieve(&query, stage2, self.bans.set())?
            .ok_or(LookupError::NoFrameOfMode { mode: seen.mode })?;
        if let (Some(margin), Some(Followed { demo, next: Some(next) })) =
            (self.config.retrieve.commit_margin, self.followed)
            && !self.bans.set().contains(&demo)
        {
            let frames = frames_of(knowledge, demo, next as usize)?;
            let frame = &frames[next as usize];
            let distances = knowledge.index().distances(&query, &frame.eef, &frame.object)?;
            if frame.mode == seen.mode && distances.d_q <= found.distances.d_q + margin {
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

    /// Reframe, and the chunk with the bridge to it.
    fn start(
        &mut self,
        seen: &Seen,
        kind: SpatialDecisionKind,
        (demo, start): (u32, usize),
        distances: SpatialDistances,
    ) -> Result<SpatialDecision, LookupError> {
        let knowledge = Arc::clone(&self.knowledge);
        let frames = frames_of(&knowledge, demo, start)?;
        let first = &frames[start];
        let object = knowledge.group().turned(&seen.object, distances.turn);
        let carry = if self.config.reframe.enabled {
            reframe_spatial(
                seen.mode,
                self.config.reframe.transfer,
                (&first.object, &first.eef),
                (&object, &seen.eef),
            )
        } else {
            without_reframe_spatial(&first.eef)
        };
        let horizon = self.config.replay.horizon.max(1) as usize;
        let mut end = start.saturating_add(horizon - 1).min(frames.len() - 1);
        if self.config.replay.finish && last_release(frames).is_some_and(|release| end >= release) {
            end = frames.len() - 1;
        }
        let bridge = self.config.replan.enabled && !self.is_at(&seen.eef, &carry.near);
        self.doing = Doing::Chunk(Box::new(Chunk {
            demo,
            start,
            next: start,
            end,
            mode: seen.mode,
            carry,
            aligned: frame_of_rest(seen).inv_mul(&object),
            measured: !self.config.reframe.enabled || self.config.reframe.measure == Measuring::Decision,
            bridge: self.config.replan.enabled.then_some(0),
        }));
        let choice = SpatialChoice {
            demo,
            demo_frame: start as u32,
            demo_end: end as u32,
            d_q: distances.d_q,
            d_o: distances.d_o,
            d_e: distances.d_e,
            compared: knowledge.index().demos(seen.mode) as u32,
            delta: carry.delta,
            turn: distances.turn,
            replay_steps: (end - start + 1) as u32,
        };
        Ok(self.record(kind, seen, Some(choice), carry.near, bridge))
    }
}

/// The frame in which the object rests: the world in transit, the gripper in transfer.
fn frame_of_rest(seen: &Seen) -> Isometry3<f64> {
    match seen.mode {
        Mode::Transit => Isometry3::identity(),
        Mode::Transfer => seen.eef,
    }
}

/// The frames of a demonstration, which hold `frame`.
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
