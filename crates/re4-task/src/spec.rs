//! The record of a task: [`TaskSpec`] and the types of its fields.

use nalgebra::Vector3;
use re4_geometry::spatial::Symmetry;

use crate::{Camera, ObjectLayout};

/// The record of a robosuite task with one Panda arm.
#[derive(Debug)]
pub struct TaskSpec {
    /// Name in pipeline files and artifacts.
    pub name: &'static str,
    /// Name on HTML pages.
    pub title: &'static str,
    /// One sentence about the task, for the schema of pipeline files.
    pub about: &'static str,
    /// robosuite's name of the environment.
    pub environment: &'static str,
    /// `MimicGen`'s name of the same scene if it differs from robosuite's: `Square` for `Square_D0`.
    pub mimicgen: Option<&'static str>,
    /// Name of the manipulated object in models and observations.
    pub object: &'static str,
    /// Rotations after which the manipulated object looks the same, in its own frame.
    pub symmetry: Symmetry,
    /// Layouts of the observation `object`: first that of robosuite up to 1.4, then that from 1.5 on.
    pub layouts: [ObjectLayout; 2],
    /// Rules for the initial poses of all objects of the scene, in the order in which they are placed, which is that of the
    /// model.
    pub placement: &'static [ObjectRule],
    /// Names of the bodies whose positions the success rule needs in addition to that of the object.
    pub landmarks: &'static [&'static str],
    /// The environment's own success rule (`_check_success`).
    pub success: fn(&Positions<'_>) -> bool,
    /// Cameras whose images can be rendered.
    pub cameras: &'static [Camera],
    /// Number of control steps per second (Hz).
    pub control_rate: usize,
    /// Shapes of the static scene for HTML pages, world frame. They do not affect the simulation.
    pub fixtures: &'static [Solid],
    /// Shapes of the manipulated object for HTML pages, in the object's frame. They do not affect the simulation.
    pub shape: &'static [Solid],
}

/// Arguments of a success rule: positions in the world frame, in metres.
#[derive(Debug, Clone, Copy)]
pub struct Positions<'a> {
    /// Origin of the manipulated object.
    pub object: Vector3<f64>,
    /// The grip site.
    pub grip_site: Vector3<f64>,
    /// The landmarks, in the order of the record.
    pub landmarks: &'a [Vector3<f64>],
}

/// Initial pose of an object, sampled as by robosuite's `UniformRandomSampler`: x and y are uniform in the given ranges and are
/// sampled again while the object overlaps an earlier one; the yaw is uniform in `[0, 2π)`. Lengths are in metres, world frame.
#[derive(Debug)]
pub struct ObjectRule {
    /// Name of the object in models.
    pub object: &'static str,
    /// Whether the task uses the object. Unused objects are placed, too, because their random numbers are part of robosuite's
    /// sequence, and are then moved out of the scene.
    pub used: bool,
    /// Range of x relative to the reference.
    pub x: [f64; 2],
    /// Range of y relative to the reference.
    pub y: [f64; 2],
    /// Reference point in the world frame.
    pub reference: [f64; 3],
    /// Height of the object's bottom above the reference.
    pub height: f64,
    /// Size of the object.
    pub extent: Extent,
}

/// Size of an object as the placement uses it, in metres.
#[derive(Debug, Clone, Copy)]
pub enum Extent {
    /// The same size for all seeds.
    Fixed {
        /// Height of its bottom relative to its origin, usually negative.
        bottom: f64,
        /// Height of its top relative to its origin.
        top: f64,
        /// Its radius in the xy plane.
        radius: f64,
    },
    /// A box whose three half sizes are sampled by the seed, each uniform in this range. They are part of the model. The box's
    /// geoms are named after the object: `cube_g0` for collisions and `cube_g0_vis` for rendering.
    Box([f64; 2]),
}

impl ObjectRule {
    /// Returns the name of the object's body in models.
    #[must_use]
    pub fn body(&self) -> String {
        body_of(self.object)
    }

    /// Returns the name of the object's free joint in models.
    #[must_use]
    pub fn joint(&self) -> String {
        joint_of(self.object)
    }
}

impl TaskSpec {
    /// Returns the name of the manipulated object's body in models.
    #[must_use]
    pub fn body(&self) -> String {
        body_of(self.object)
    }

    /// Returns the name of the manipulated object's free joint in models.
    #[must_use]
    pub fn joint(&self) -> String {
        joint_of(self.object)
    }

    /// Returns the names of the bodies of the unused objects, which are moved out of the scene.
    #[must_use]
    pub fn unused_bodies(&self) -> Vec<String> {
        let away = self.placement.iter().filter(|rule| !rule.used);
        away.map(ObjectRule::body).collect()
    }

    /// Returns whether every seed has its own model, because the sizes of boxes are sampled.
    #[must_use]
    pub fn samples_models(&self) -> bool {
        self.placement.iter().any(|rule| matches!(rule.extent, Extent::Box(_)))
    }

    /// Returns the number of columns of the observation `object`.
    #[must_use]
    pub fn object_columns(&self) -> usize {
        self.layouts[0].columns()
    }

    /// Returns the layout of the observation `object` in a version (major, minor) of robosuite.
    #[must_use]
    pub fn layout(&self, version: (u32, u32)) -> ObjectLayout {
        self.layouts[usize::from(version >= (1, 5))]
    }
}

// robosuite names the body and the joint of a `MujocoObject` by these suffixes.
fn body_of(object: &str) -> String {
    format!("{object}_main")
}

fn joint_of(object: &str) -> String {
    format!("{object}_joint0")
}

/// A box or an upright cylinder for HTML pages, aligned with the axes of its frame. Lengths are in metres.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Solid {
    /// Its style on the page: `table`, `wall`, `goal` or `object`.
    pub kind: &'static str,
    /// Its centre.
    pub centre: [f64; 3],
    /// Half sizes along x, y and z; for a cylinder the first two are the radius.
    pub half: [f64; 3],
    /// Whether it is a cylinder.
    pub round: bool,
}

impl Solid {
    /// Creates a box.
    #[must_use]
    pub const fn cuboid(kind: &'static str, centre: [f64; 3], half: [f64; 3]) -> Self {
        Self {
            kind,
            centre,
            half,
            round: false,
        }
    }

    /// Creates an upright cylinder of height `2 * half`.
    #[must_use]
    pub const fn cylinder(kind: &'static str, centre: [f64; 3], radius: f64, half: f64) -> Self {
        Self {
            kind,
            centre,
            half: [radius, radius, half],
            round: true,
        }
    }
}
