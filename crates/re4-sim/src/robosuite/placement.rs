//! Initial states from seeds, with the bits of robosuite's.
//!
//! Seed `s` means what `np.random.seed(s); env.reset()` gives with a hard reset (robosuite's default). Both robosuite 1.4.1 and
//! 1.5.1 draw from numpy's global generator, in the same order and with the same arithmetic, so that one function serves both:
//!
//! 1. while the model is built, the cube of `Lift` its three half sizes, each uniform in 20 to 22 mm;
//! 2. the arm its joint positions: the initial pose plus a normal number of 0.02 rad standard deviation a joint;
//! 3. every object, one after the other, x, y (again until it keeps clear of those before it), then its yaw, uniform in a full
//!    turn;
//! 4. in `PickPlaceCan` the marks in the target bins: two numbers each that decide nothing, and that nothing follows.
//!
//! | task | objects in order | x, y about the reference, m | height of the origin, m |
//! |---|---|---|---|
//! | `Lift` | cube | ±0.03 about (0, 0) | 0.8 + 0.01 + half height |
//! | `PickPlaceCan` | milk, bread, cereal, can | (±0.145, ±0.195) less the object's radius, about (0.1, -0.25) | 0.8 + depth of the object's bottom |
//! | `NutAssemblySquare` | square nut, round nut | [-0.115, -0.11] and ±[0.11, 0.225] about (0, 0) | 0.82 + 0.02 + 0.05 |
//!
//! Two objects keep clear of each other when their distance in the plane is greater than the sum of their radii. Then objects
//! that the task does not use are put at (10, 10, 10). Nothing moves after that: robosuite computes what follows from the state
//! (`mj_forward`) and takes no simulation step, so that objects start in the air and fall in the first steps.
//!
//! The two versions differ in what is not drawn here: names of the finger joints, and the state of controller and observations
//! after a reset; and MuJoCo 2.3.7 divides quaternions by their length when it computes the poses, which 3.2.7 does not. robomimic's rollouts begin with `reset()` and `reset_to(get_state())`: the same state, on the model as it is
//! read back from its own MJCF with six digits a number. [`with_cube_size`] gives that MJCF from that of any demonstration.

use std::f64::consts::PI;
use std::ops::Range;

use super::RobosuiteTask;
use crate::SimError;
use crate::random_state::RandomState;

/// Joint positions of the arm that the drawn noise is added to.
const ARM: [f64; 7] = [0.0, PI / 16.0, 0.0, -PI / 2.0 - PI / 3.0, 0.0, PI - 0.2, PI / 4.0];
/// Standard deviation of that noise.
const ARM_NOISE: f64 = 0.02;
/// Joint positions of the fingers.
const FINGERS: [f64; 2] = [0.020_833, -0.020_833];
/// Range of the half sizes of the cube.
const CUBE: Range<f64> = 0.020..0.022;
/// Where objects go that a task does not use.
const AWAY: ([f64; 3], [f64; 4]) = ([10.0; 3], [1.0, 0.0, 0.0, 0.0]);

/// A drawn initial state, at rest.
#[derive(Debug, Clone, PartialEq)]
pub struct Placement {
    /// Joint positions of the arm, rad.
    pub arm: [f64; 7],
    /// Joint positions of the two fingers, m.
    pub fingers: [f64; 2],
    /// The objects, in the order of the model.
    pub objects: Vec<ObjectPlacement>,
    /// Half sizes of the cube of `Lift`, m: part of the model, not of the state.
    pub cube: Option<[f64; 3]>,
}

/// Where an object starts.
#[derive(Debug, Clone, PartialEq)]
pub struct ObjectPlacement {
    /// Its free joint.
    pub joint: &'static str,
    /// Position of its origin, world frame, m.
    pub position: [f64; 3],
    /// Rotation, in MuJoCo's order w, x, y, z.
    pub quaternion: [f64; 4],
}

/// What the placing of an object depends on.
struct Rule {
    joint: &'static str,
    /// Whether the task leaves it where it was placed.
    used: bool,
    x: Range<f64>,
    y: Range<f64>,
    reference: [f64; 3],
    /// Height above the reference's, and from the object's origin to its bottom and its top.
    height: f64,
    bottom: f64,
    top: f64,
    radius: f64,
}

impl Placement {
    /// The initial state of a seed.
    #[must_use]
    pub fn draw(task: RobosuiteTask, seed: u32) -> Self {
        let mut generator = RandomState::new(seed);
        let cube =
            (task == RobosuiteTask::Lift).then(|| std::array::from_fn(|_| generator.uniform(CUBE.start, CUBE.end)));
        let arm = ARM.map(|angle| angle + generator.standard_normal() * ARM_NOISE);
        let rules = rules(task, cube);
        let mut placed: Vec<ObjectPlacement> = Vec::with_capacity(rules.len());
        for (index, rule) in rules.iter().enumerate() {
            // robosuite gives up after 5,000 tries. That does not come about: whatever lies in the bin, more than half of it is
            // free for the next object.
            let position = loop {
                let position = [
                    generator.uniform(rule.x.start, rule.x.end) + rule.reference[0],
                    generator.uniform(rule.y.start, rule.y.end) + rule.reference[1],
                    rule.height + rule.reference[2] - rule.bottom,
                ];
                if rules[..index]
                    .iter()
                    .zip(&placed)
                    .all(|(other, object)| rule.clear_of(other, &position, &object.position))
                {
                    break position;
                }
            };
            let half = generator.uniform(0.0, 2.0 * PI) / 2.0;
            placed.push(ObjectPlacement {
                joint: rule.joint,
                position,
                quaternion: [half.cos(), 0.0, 0.0, half.sin()],
            });
        }
        for (object, _) in placed.iter_mut().zip(&rules).filter(|(_, rule)| !rule.used) {
            (object.position, object.quaternion) = AWAY;
        }
        Self {
            arm,
            fingers: FINGERS,
            objects: placed,
            cube,
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
}

impl Rule {
    fn clear_of(&self, other: &Self, position: &[f64; 3], of_other: &[f64; 3]) -> bool {
        let [dx, dy, dz] = std::array::from_fn(|axis| position[axis] - of_other[axis]);
        let apart = (dx * dx + dy * dy).sqrt() > other.radius + self.radius;
        let above = dz > other.top - self.bottom;
        apart || above
    }
}

fn rules(task: RobosuiteTask, cube: Option<[f64; 3]>) -> Vec<Rule> {
    match task {
        RobosuiteTask::Lift => {
            let [x, y, z] = cube.unwrap_or([CUBE.start; 3]);
            vec![Rule {
                joint: "cube_joint0",
                used: true,
                x: -0.03..0.03,
                y: -0.03..0.03,
                reference: [0.0, 0.0, 0.8],
                height: 0.01,
                bottom: -z,
                top: z,
                radius: x.hypot(y),
            }]
        }
        RobosuiteTask::Can => {
            // The bin is 0.39 m by 0.49 m; its walls are kept off by 5 cm.
            let half = [0.39 / 2.0 - 0.05, 0.49 / 2.0 - 0.05];
            let object = |joint, radius: f64, bottom, top| Rule {
                joint,
                used: joint == "Can_joint0",
                x: -half[0] + radius..half[0] - radius,
                y: -half[1] + radius..half[1] - radius,
                reference: [0.1, -0.25, 0.8],
                height: 0.0,
                bottom,
                top,
                radius,
            };
            vec![
                object("Milk_joint0", 0.025, -0.085, 0.075),
                object("Bread_joint0", 0.03, -0.045, 0.03),
                object("Cereal_joint0", 0.04, -0.1, 0.03),
                object("Can_joint0", 0.025, -0.06, 0.04),
            ]
        }
        RobosuiteTask::Square => {
            let nut = |joint, y, top| Rule {
                joint,
                used: joint == "SquareNut_joint0",
                x: -0.115..-0.11,
                y,
                reference: [0.0, 0.0, 0.82],
                height: 0.02,
                bottom: -0.05,
                top,
                radius: 0.11,
            };
            vec![
                nut("SquareNut_joint0", 0.11..0.225, 0.01),
                nut("RoundNut_joint0", -0.225..-0.11, 0.025),
            ]
        }
    }
}

/// MJCF of `Lift` with a cube of other half sizes, in metres, and everything else as it is.
///
/// Sizes get six significant digits, as MuJoCo writes them: from the drawn sizes of a seed comes what robosuite writes for that
/// seed. All that hangs on the size (mass, inertia) is computed when the model is compiled. `statistic/meansize`, which files of
/// MuJoCo 2.3 carry, stays: it is of no effect but on the size of decorations.
///
/// # Errors
/// When the text is not XML, or has no geom `cube_g0`.
pub fn with_cube_size(mjcf: &str, half_sizes: [f64; 3]) -> Result<String, SimError> {
    let refuse = |reason: String| SimError::Model {
        task: RobosuiteTask::Lift.environment(),
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
    let cube = size_of("cube_g0").ok_or_else(|| refuse("the model has no geom cube_g0 with a size".to_owned()))?;
    // The one that is drawn is not there in a model without pictures.
    let mut ranges: Vec<_> = std::iter::once(cube).chain(size_of("cube_g0_vis")).collect();
    let size = half_sizes.map(six_digits).join(" ");
    let mut text = mjcf.to_owned();
    ranges.sort_by_key(|range| std::cmp::Reverse(range.start));
    for range in ranges {
        text.replace_range(range, &size);
    }
    Ok(text)
}

/// A number as C's `%g` writes it, for those that need no exponent.
fn six_digits(number: f64) -> String {
    let rounded = format!("{number:.5e}");
    rounded.parse::<f64>().map_or(rounded, |number| number.to_string())
}
