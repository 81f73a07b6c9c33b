//! Push-T: a round agent pushes a T-shaped block onto a goal.
//!
//! Constants and order of operations follow gym-pusht 0.1.8 (`envs/pusht.py`).

use re4_geometry::{Point2, Pose2, wrap_to_two_pi};

use crate::chipmunk::{World, chipmunk_version};
use crate::render::Shapes;
use crate::tee::{coverage_of_area, iou_of_area, overlap_area};
use crate::{
    AGENT_RADIUS, CENTRE_OF_GRAVITY, GOAL, ResetOrder, SUCCESS_COVERAGE, SimError, Simulator, Step, WALL_FACES,
    clearance_of_block, depth_in_walls, tee_rectangles, tee_vertices,
};

/// Stiffness of the controller that drives the agent to its target, in 1/s².
pub const PROPORTIONAL_GAIN: f64 = 100.0;

/// Damping of that controller, in 1/s.
pub const DAMPING_GAIN: f64 = 20.0;

/// Length of one physics step, in seconds.
pub const TIME_STEP: f64 = 0.01;

/// Physics steps in one control step: actions come at 10 Hz.
pub const SUBSTEPS: u32 = 10;

/// Side of the square window, in pixels. Actions of the demonstrations are inside it.
pub const WINDOW: f64 = 512.0;

/// Maximum absolute value of a coordinate that a reset or step accepts, in pixels or radians.
///
/// The limit is far outside of the window, so that no policy reaches it by chance, and small enough for double precision.
/// The state itself may reach twice this value.
pub const COORDINATE_LIMIT: f64 = 1e5;

/// The state in which gym-pusht creates agent and block before it sets the requested state.
const FIRST_SCENE: Scene = Scene {
    agent: Point2::new(256.0, 400.0),
    block: Pose2::new(256.0, 300.0, 0.0),
};

/// An initial state to request in a reset, in pixels and radians.
///
/// Under [`ResetOrder::Legacy`] the block does not arrive at `block`; [`Scene::from_observed`] compensates for that.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Scene {
    /// Centre of the agent.
    pub agent: Point2,
    /// Requested pose of the block.
    pub block: Pose2,
}

impl Scene {
    /// The scene to request under [`ResetOrder::Legacy`] so that the block arrives at `block_recorded`.
    ///
    /// The legacy reset sets the block's position and then rotates it about its centre of gravity `c = (0, 45)`, so it
    /// arrives at `requested + c - R(theta) c`. This is the inverse: `requested = recorded - c + R(theta) c`. Use it for
    /// recorded states, such as the rows of the demonstrations. The physics step that ends a reset moves the block further
    /// if it overlaps the agent or a wall.
    pub fn from_observed(agent: Point2, block_recorded: Pose2) -> Self {
        let rotated = Pose2::new(0.0, 0.0, block_recorded.theta).transform_point(CENTRE_OF_GRAVITY);
        let requested = block_recorded.translation() - CENTRE_OF_GRAVITY + rotated;
        Self {
            agent,
            block: Pose2::new(requested.x, requested.y, block_recorded.theta),
        }
    }

    /// The pose at which a reset in this order places the block, before the physics step that ends the reset.
    pub fn arrival(&self, order: ResetOrder) -> Pose2 {
        match order {
            ResetOrder::PoseIsPose => self.block,
            ResetOrder::Legacy => {
                let rotated = Pose2::new(0.0, 0.0, self.block.theta).transform_point(CENTRE_OF_GRAVITY);
                let origin = self.block.translation() + CENTRE_OF_GRAVITY - rotated;
                Pose2::new(origin.x, origin.y, self.block.theta)
            }
        }
    }
}

/// The part of a Push-T state that a policy observes, in pixels, pixels per second and radians.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PushTObservation {
    /// Centre of the agent.
    pub agent: Point2,
    /// Velocity of the agent.
    pub agent_velocity: Point2,
    /// Pose of the block, with the angle in `[0, 2π)`.
    pub block: Pose2,
}

/// The Push-T simulator.
///
/// It may be sent to another thread but not shared between threads. Each reset builds a new Chipmunk space, as gym-pusht
/// does, so that an episode does not depend on earlier ones.
pub struct PushT {
    world: World,
    goal: Pose2,
    goal_vertices: [[Point2; 4]; 2],
    contact_points: u32,
}

impl std::fmt::Debug for PushT {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        formatter
            .debug_struct("PushT")
            .field("observation", &self.observation())
            .field("contact_points", &self.contact_points)
            .finish_non_exhaustive()
    }
}

impl PushT {
    /// A simulator in gym-pusht's state before its first reset: agent at (256, 400), block at (256, 300) and angle 0.
    ///
    /// # Errors
    /// If the major version of the linked Chipmunk library is not 7.
    pub fn new() -> Result<Self, SimError> {
        let found = chipmunk_version();
        if !found.starts_with("7.") {
            return Err(SimError::Library { found });
        }
        Ok(Self {
            world: new_world(),
            goal: GOAL,
            goal_vertices: tee_vertices(GOAL),
            contact_points: 0,
        })
    }

    /// The goal pose of the block.
    pub fn goal(&self) -> Pose2 {
        self.goal
    }

    /// Sets another goal than [`GOAL`]. It stays over resets.
    pub fn set_goal(&mut self, goal: Pose2) {
        self.goal = goal;
        self.goal_vertices = tee_vertices(goal);
    }

    /// Moves the block: rotates it about its centre of gravity by `motion.theta`, then translates it. It is at rest afterwards.
    /// Returns false and leaves the state as it is if the block would reach into a wall or touch the agent.
    pub fn displace_block(&mut self, motion: Pose2) -> bool {
        let now = self.world.block_pose();
        let turned = Pose2::new(now.x, now.y, now.theta + motion.theta);
        let origin = turned.translation() + now.transform_point(CENTRE_OF_GRAVITY)
            - turned.transform_point(CENTRE_OF_GRAVITY)
            + motion.translation();
        let moved = Pose2::new(origin.x, origin.y, turned.theta);
        let valid =
            depth_in_walls(moved) == 0.0 && clearance_of_block(moved, self.world.agent_position()) > AGENT_RADIUS;
        if valid {
            self.world.set_block_angle(moved.theta);
            self.world.set_block_position(moved.translation());
        }
        valid
    }

    /// Moves the agent, which is at rest afterwards. Returns false and leaves the state as it is if the agent would reach into a
    /// wall or touch the block.
    pub fn displace_agent(&mut self, translation: Point2) -> bool {
        let moved = self.world.agent_position() + translation;
        let [low, high] = WALL_FACES;
        let free = |at: f64| (low + AGENT_RADIUS..=high - AGENT_RADIUS).contains(&at);
        let valid = free(moved.x) && free(moved.y) && clearance_of_block(self.world.block_pose(), moved) > AGENT_RADIUS;
        if valid {
            self.world.set_agent_position(moved);
            self.world.set_agent_velocity(Point2::new(0.0, 0.0));
        }
        valid
    }

    /// The current state.
    pub fn observation(&self) -> PushTObservation {
        let block = self.world.block_pose();
        PushTObservation {
            agent: self.world.agent_position(),
            agent_velocity: self.world.agent_velocity(),
            block: Pose2::new(block.x, block.y, wrap_to_two_pi(block.theta)),
        }
    }

    /// The pose of the block with the angle as the physics library counts it, without wrapping.
    pub fn block_pose(&self) -> Pose2 {
        self.world.block_pose()
    }

    /// The current state with its coverage and the contacts of the last reset or step; runs no physics.
    pub fn outcome(&self) -> Step<PushTObservation> {
        let observation = self.observation();
        let overlap = overlap_area(&self.block_vertices(), &self.goal_vertices);
        let coverage = coverage_of_area(overlap);
        Step {
            observation,
            coverage,
            iou: iou_of_area(overlap),
            score: (coverage / SUCCESS_COVERAGE).clamp(0.0, 1.0),
            success: coverage > SUCCESS_COVERAGE,
            contacts: self.contact_points.div_ceil(SUBSTEPS),
        }
    }

    /// Sum of the contact points over all physics steps of the last reset or step.
    pub fn contact_points(&self) -> u32 {
        self.contact_points
    }

    /// Corners of the block's bar and stem in the window, in pixels, in the order of [`tee_rectangles`].
    pub fn block_vertices(&self) -> [[Point2; 4]; 2] {
        tee_vertices(self.world.block_pose())
    }

    /// What an image of the current state shows.
    pub fn shapes(&self) -> Shapes {
        Shapes::new(self.goal, self.world.drawing())
    }

    /// Checks the state after physics, so that no invalid number is returned or enters the next physics step.
    fn check_state(world: &World, operation: &'static str) -> Result<(), SimError> {
        let (agent, block) = (world.agent_position(), world.block_pose());
        let named = [
            ("agent_x", agent.x),
            ("agent_y", agent.y),
            ("block_x", block.x),
            ("block_y", block.y),
            ("block_theta", block.theta),
        ];
        // Twice the limit, because a requested state at the limit may still move.
        let limit = 2.0 * COORDINATE_LIMIT;
        match outside(named, limit) {
            None => Ok(()),
            Some((coordinate, value)) => Err(SimError::Diverged {
                operation,
                coordinate,
                value,
                limit,
            }),
        }
    }
}

impl Simulator for PushT {
    type Scene = Scene;
    type Reset = ResetOrder;
    type Observation = PushTObservation;
    /// The point that the agent is driven to, in pixels of the window.
    type Action = Point2;
    type Step = Step<PushTObservation>;

    fn reset(&mut self, scene: &Scene, order: ResetOrder) -> Result<PushTObservation, SimError> {
        let named = [
            ("agent_x", scene.agent.x),
            ("agent_y", scene.agent.y),
            ("block_x", scene.block.x),
            ("block_y", scene.block.y),
            ("block_theta", scene.block.theta),
        ];
        if let Some((coordinate, value)) = outside(named, COORDINATE_LIMIT) {
            return Err(SimError::Reset {
                coordinate,
                value,
                limit: COORDINATE_LIMIT,
            });
        }
        let mut world = new_world();
        world.set_agent_position(scene.agent);
        match order {
            ResetOrder::Legacy => {
                world.set_block_position(scene.block.translation());
                world.set_block_angle(scene.block.theta);
            }
            ResetOrder::PoseIsPose => {
                world.set_block_angle(scene.block.theta);
                world.set_block_position(scene.block.translation());
            }
        }
        world.step(TIME_STEP);
        Self::check_state(&world, "reset")?;
        self.contact_points = world.take_contact_points();
        self.world = world;
        Ok(self.observation())
    }

    fn step(&mut self, action: &Point2) -> Result<Step<PushTObservation>, SimError> {
        if let Some((coordinate, value)) = outside([("target_x", action.x), ("target_y", action.y)], COORDINATE_LIMIT) {
            return Err(SimError::Step {
                coordinate,
                value,
                limit: COORDINATE_LIMIT,
            });
        }
        // After a divergence the state stays invalid until a reset, and Chipmunk would abort the process on it.
        Self::check_state(&self.world, "step")?;
        for _ in 0..SUBSTEPS {
            let velocity = self.world.agent_velocity();
            // As in gym-pusht: another order of these operations would change the last bits.
            let acceleration = PROPORTIONAL_GAIN * (action - self.world.agent_position())
                + DAMPING_GAIN * (Point2::new(0.0, 0.0) - velocity);
            self.world.set_agent_velocity(velocity + acceleration * TIME_STEP);
            self.world.step(TIME_STEP);
        }
        self.contact_points = self.world.take_contact_points();
        Self::check_state(&self.world, "step")?;
        Ok(self.outcome())
    }
}

fn new_world() -> World {
    World::new(FIRST_SCENE.agent, FIRST_SCENE.block, AGENT_RADIUS, &tee_rectangles())
}

/// The first coordinate that is not finite or is greater than `limit` in absolute value.
fn outside<const N: usize>(named: [(&'static str, f64); N], limit: f64) -> Option<(&'static str, f64)> {
    named
        .into_iter()
        .find(|(_, value)| !value.is_finite() || value.abs() > limit)
}
