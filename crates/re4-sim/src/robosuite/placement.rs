//! Initial states from seeds, with the bits of robosuite's.
//!
//! Seed `s` means what `np.random.seed(s); env.reset()` gives with a hard reset (robosuite's default). Both robosuite 1.4.1 and
//! 1.5.1 draw from numpy's global generator, in the same order and with the same arithmetic, so that one function serves both:
//!
//! 1. while the model is built, boxes of no fixed size (the cube of `Lift`) their three half sizes;
//! 2. the arm its joint positions: the initial pose plus a normal number of 0.02 rad standard deviation a joint;
//! 3. every object, one after the other, x, y (again until it keeps clear of those before it), then its yaw, uniform in a full
//!    turn;
//! 4. in `PickPlaceCan` the marks in the target bins: two numbers each that decide nothing, and that nothing follows.
//!
//! The ranges are those of the task's record.
//!
//! Two objects keep clear of each other when their distance in the plane is greater than the sum of their radii. Then objects
//! that the task does not use are put at (10, 10, 10). Nothing moves after that: robosuite computes what follows from the state
//! (`mj_forward`) and takes no simulation step, so that objects start in the air and fall in the first steps.
//!
//! The two versions differ in what is not drawn here: names of the finger joints, and the state of controller and observations
//! after a reset; and MuJoCo 2.3.7 divides quaternions by their length when it computes the poses, which 3.2.7 does not. robomimic's rollouts begin with `reset()` and `reset_to(get_state())`: the same state, on the model as it is
//! read back from its own MJCF with six digits a number. [`Placement::in_model`] gives that MJCF from that of any demonstration.

use std::borrow::Cow;
use std::f64::consts::PI;

use re4_task::{Extent, ObjectRule, RobosuiteTask};

use super::INITIAL_JOINTS;
use crate::SimError;
use crate::random_state::RandomState;

/// Standard deviation of the noise of the arm's joint positions.
const ARM_NOISE: f64 = 0.02;
/// Joint positions of the fingers.
const FINGERS: [f64; 2] = [0.020_833, -0.020_833];
/// Where objects go that a task does not use.
const AWAY: ([f64; 3], [f64; 4]) = ([10.0; 3], [1.0, 0.0, 0.0, 0.0]);

/// A drawn initial state, at rest.
#[derive(Debug, Clone, PartialEq)]
pub struct Placement {
    /// The task.
    pub task: RobosuiteTask,
    /// Joint positions of the arm, rad.
    pub arm: [f64; 7],
    /// Joint positions of the two fingers, m.
    pub fingers: [f64; 2],
    /// The objects, in the order of the model.
    pub objects: Vec<ObjectPlacement>,
}

/// Where an object starts.
#[derive(Debug, Clone, PartialEq)]
pub struct ObjectPlacement {
    /// Its name in the model.
    pub object: &'static str,
    /// Position of its origin, world frame, m.
    pub position: [f64; 3],
    /// Rotation, in MuJoCo's order w, x, y, z.
    pub quaternion: [f64; 4],
    /// Half sizes of a box whose size the seed draws, m: part of the model, not of the state.
    pub half_sizes: Option<[f64; 3]>,
}

/// How far an object reaches from its origin: down (mostly negative) and up, and its radius in the plane.
struct Room {
    bottom: f64,
    top: f64,
    radius: f64,
}

impl Placement {
    /// The initial state of a seed.
    #[must_use]
    pub fn draw(task: RobosuiteTask, seed: u32) -> Self {
        let mut generator = RandomState::new(seed);
        let rules = task.placement;
        let sizes: Vec<Option<[f64; 3]>> = rules
            .iter()
            .map(|rule| match rule.extent {
                Extent::Box([minimum, most]) => Some(std::array::from_fn(|_| generator.uniform(minimum, most))),
                Extent::Fixed { .. } => None,
            })
            .collect();
        let arm = INITIAL_JOINTS.map(|angle| angle + generator.standard_normal() * ARM_NOISE);
        let mut objects: Vec<ObjectPlacement> = Vec::with_capacity(rules.len());
        let mut rooms: Vec<Room> = Vec::with_capacity(rules.len());
        for (rule, half_sizes) in rules.iter().zip(sizes) {
            let room = Room::of(rule, half_sizes);
            // robosuite gives up after 5,000 tries. That does not come about: whatever lies in the bin, more than half of it is
            // free for the next object.
            let position = loop {
                let position = [
                    generator.uniform(rule.x[0], rule.x[1]) + rule.reference[0],
                    generator.uniform(rule.y[0], rule.y[1]) + rule.reference[1],
                    rule.height + rule.reference[2] - room.bottom,
                ];
                let mut others = rooms.iter().zip(&objects);
                if others.all(|(other, object)| room.clear_of(other, &position, &object.position)) {
                    break position;
                }
            };
            let half = generator.uniform(0.0, 2.0 * PI) / 2.0;
            rooms.push(room);
            objects.push(ObjectPlacement {
                object: rule.object,
                position,
                quaternion: [half.cos(), 0.0, 0.0, half.sin()],
                half_sizes,
            });
        }
        for (object, _) in objects.iter_mut().zip(rules).filter(|(_, rule)| !rule.used) {
            (object.position, object.quaternion) = AWAY;
        }
        Self {
            task,
            arm,
            fingers: FINGERS,
            objects,
        }
    }

    /// MuJoCo's coordinates (`qpos`) of the task's model: arm, fingers, then position and quaternion of every object.
    #[must_use]
    pub fn coordinates(&self) -> Vec<f64> {
        let objects = self
            .objects
            .iter()
            .flat_map(|object| object.position.into_iter().chain(object.quaternion));
        self.arm.into_iter().chain(self.fingers).chain(objects).collect()
    }

    /// MJCF of the task with the boxes of this placement, and everything else as it is: the same text where no box is drawn.
    ///
    /// Sizes get six significant digits, as MuJoCo writes them: from the drawn sizes of a seed comes what robosuite writes for
    /// that seed. All that hangs on the size (mass, inertia) is computed when the model is compiled. `statistic/meansize`, which
    /// files of MuJoCo 2.3 carry, stays: it is of no effect but on the size of decorations.
    ///
    /// # Errors
    /// When the text is not XML, or lacks the geom of such a box.
    pub fn in_model<'m>(&self, mjcf: &'m str) -> Result<Cow<'m, str>, SimError> {
        if !self.task.draws_models() {
            return Ok(Cow::Borrowed(mjcf));
        }
        let refuse = |reason: String| SimError::Model {
            task: self.task.environment,
            reason,
        };
        let document =
            roxmltree::Document::parse(mjcf).map_err(|error| refuse(format!("its MJCF is not XML ({error})")))?;
        let size_of = |name: &str| {
            document
                .descendants()
                .find(|node| node.has_tag_name("geom") && node.attribute("name") == Some(name))
                .and_then(|geom| geom.attribute_node("size"))
                .map(|size| size.range_value())
        };
        let mut changes = Vec::new();
        for object in &self.objects {
            let Some(half_sizes) = object.half_sizes else { continue };
            let geom = format!("{}_g0", object.object);
            let solid = size_of(&geom).ok_or_else(|| refuse(format!("the model has no geom {geom} with a size")))?;
            let size = half_sizes.map(six_digits).join(" ");
            // The one that is rendered is not there in a model without images.
            let rendered = size_of(&format!("{geom}_vis")).map(|range| (range, size.clone()));
            changes.extend(rendered);
            changes.push((solid, size));
        }
        changes.sort_by_key(|(range, _)| std::cmp::Reverse(range.start));
        let mut text = mjcf.to_owned();
        for (range, size) in changes {
            text.replace_range(range, &size);
        }
        Ok(Cow::Owned(text))
    }
}

impl Room {
    fn of(rule: &ObjectRule, half_sizes: Option<[f64; 3]>) -> Self {
        match (rule.extent, half_sizes) {
            (Extent::Fixed { bottom, top, radius }, _) => Self { bottom, top, radius },
            (Extent::Box([minimum, _]), half_sizes) => {
                let [x, y, z] = half_sizes.unwrap_or([minimum; 3]);
                Self {
                    bottom: -z,
                    top: z,
                    radius: x.hypot(y),
                }
            }
        }
    }

    fn clear_of(&self, other: &Self, position: &[f64; 3], of_other: &[f64; 3]) -> bool {
        let [dx, dy, dz] = std::array::from_fn(|axis| position[axis] - of_other[axis]);
        let apart = (dx * dx + dy * dy).sqrt() > other.radius + self.radius;
        let above = dz > other.top - self.bottom;
        apart || above
    }
}

/// A number as C's `%g` writes it, for those that need no exponent.
fn six_digits(number: f64) -> String {
    let rounded = format!("{number:.5e}");
    rounded.parse::<f64>().map_or(rounded, |number| number.to_string())
}
