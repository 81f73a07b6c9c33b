//! Initial states from seeds, bit-identical to robosuite's.
//!
//! Seed `s` gives the state after `np.random.seed(s); env.reset()` with a hard reset (robosuite's default). Both robosuite 1.4.1
//! and 1.5.1 sample from numpy's global generator, in the same order and with the same arithmetic, so one function serves both:
//!
//! 1. while the model is built, the three half sizes of each box without a fixed size (the cube of `Lift`);
//! 2. the joint positions of the arm: the initial pose plus normal noise with a standard deviation of 0.02 rad per joint;
//! 3. for each object in order: x and y (again until it keeps clear of the earlier objects), then its yaw, uniform in
//!    `[0, 2π)`;
//! 4. in `PickPlaceCan`, two numbers for each mark in the target bins. They affect nothing and are the last numbers, so they are
//!    not sampled here.
//!
//! The ranges are those of the task's record.
//!
//! Two objects keep clear of each other when their horizontal distance is greater than the sum of their radii, or when the
//! later one is above the earlier one. Afterwards, objects that the task does not use are put at (10, 10, 10). Nothing moves after
//! that: robosuite computes the derived quantities (`mj_forward`) and takes no simulation step, so objects start in the air and
//! fall in the first steps.
//!
//! The two versions differ only in what is not sampled here: the names of the finger joints, and the state of controller and
//! observations after a reset. Also, MuJoCo 2.3.7 normalises quaternions when it computes the poses, and 3.2.7 does not.
//! robomimic's rollouts begin with `reset()` and `reset_to(get_state())`: the same state, on the model as it is read back from
//! its own MJCF with six digits per number. [`Placement::in_model`] makes that MJCF from the MJCF of any demonstration.

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
/// Pose of objects that a task does not use: position and quaternion (w, x, y, z).
const AWAY: ([f64; 3], [f64; 4]) = ([10.0; 3], [1.0, 0.0, 0.0, 0.0]);

/// A sampled initial state, at rest.
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

/// The initial pose of an object.
#[derive(Debug, Clone, PartialEq)]
pub struct ObjectPlacement {
    /// Its name in the model.
    pub object: &'static str,
    /// Position of its origin, world frame, m.
    pub position: [f64; 3],
    /// Rotation, in MuJoCo's order w, x, y, z.
    pub quaternion: [f64; 4],
    /// Half sizes of a box whose size is sampled, m: a part of the model, not of the state.
    pub half_sizes: Option<[f64; 3]>,
}

/// The extent of an object relative to its origin: down (mostly negative) and up, and its horizontal radius.
struct Reach {
    bottom: f64,
    top: f64,
    radius: f64,
}

impl Placement {
    /// The initial state of a seed.
    #[must_use]
    pub fn sample(task: RobosuiteTask, seed: u32) -> Self {
        let mut generator = RandomState::new(seed);
        let rules = task.placement;
        let sizes: Vec<Option<[f64; 3]>> = rules
            .iter()
            .map(|rule| match rule.extent {
                Extent::Box([minimum, maximum]) => Some(std::array::from_fn(|_| generator.uniform(minimum, maximum))),
                Extent::Fixed { .. } => None,
            })
            .collect();
        let arm = INITIAL_JOINTS.map(|angle| angle + generator.standard_normal() * ARM_NOISE);
        let mut objects: Vec<ObjectPlacement> = Vec::with_capacity(rules.len());
        let mut reaches: Vec<Reach> = Vec::with_capacity(rules.len());
        for (rule, half_sizes) in rules.iter().zip(sizes) {
            let reach = Reach::of(rule, half_sizes);
            // robosuite gives up after 5,000 tries. That does not happen here: more than half of the bin is always free for the
            // next object.
            let position = loop {
                let position = [
                    generator.uniform(rule.x[0], rule.x[1]) + rule.reference[0],
                    generator.uniform(rule.y[0], rule.y[1]) + rule.reference[1],
                    rule.height + rule.reference[2] - reach.bottom,
                ];
                let mut others = reaches.iter().zip(&objects);
                if others.all(|(other, object)| reach.clear_of(other, &position, &object.position)) {
                    break position;
                }
            };
            let half = generator.uniform(0.0, 2.0 * PI) / 2.0;
            reaches.push(reach);
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

    /// MJCF of the task with the box sizes of this placement; everything else stays. Returns the same text if no box is sampled.
    ///
    /// Sizes get six significant digits, as MuJoCo writes them, so the sampled sizes of a seed give the text that robosuite writes
    /// for that seed. All that depends on the size (mass, inertia) is computed when the model is compiled. `statistic/meansize`,
    /// which files of MuJoCo 2.3 have, stays: it only affects the size of decorations.
    ///
    /// # Errors
    /// If the text is not XML, or lacks the geom of such a box.
    pub fn in_model<'m>(&self, mjcf: &'m str) -> Result<Cow<'m, str>, SimError> {
        if !self.task.samples_models() {
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
            // A model without images has no rendered geom.
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

impl Reach {
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

/// Formats a number as C's `%g` does, for numbers that need no exponent.
fn six_digits(number: f64) -> String {
    let rounded = format!("{number:.5e}");
    rounded.parse::<f64>().map_or(rounded, |number| number.to_string())
}
