//! What a record of a task holds.

use nalgebra::Vector3;
use re4_geometry::spatial::Symmetry;

use crate::{Camera, ObjectLayout};

/// A task of robosuite with one Panda arm.
#[derive(Debug)]
pub struct TaskSpec {
    /// Name in pipeline files and artifacts.
    pub name: &'static str,
    /// Name on pages.
    pub title: &'static str,
    /// What is done in it, for the schema of pipeline files.
    pub about: &'static str,
    /// robosuite's name of the environment.
    pub environment: &'static str,
    /// `MimicGen`'s name of the same scene, where it is another: that of `Square_D0` is `Square`.
    pub mimicgen: Option<&'static str>,
    /// Name of the manipulated object in models and observations.
    pub object: &'static str,
    /// Rotations after which the manipulated object looks the same, in its own frame.
    pub symmetry: Symmetry,
    /// Order of the parts of the observation `object`: up to robosuite 1.4, and from 1.5 on.
    pub layouts: [ObjectLayout; 2],
    /// Where a seed puts the objects, in the order in which they are placed, which is that of the model.
    pub placement: &'static [ObjectRule],
    /// Bodies that the success rule looks at besides the object.
    pub landmarks: &'static [&'static str],
    /// The environment's own success rule (`_check_success`).
    pub success: fn(&Positions<'_>) -> bool,
    /// Cameras whose images can be rendered.
    pub cameras: &'static [Camera],
    /// Control steps a second.
    pub control_rate: usize,
    /// What is drawn of the scene that does not move, world frame.
    pub fixtures: &'static [Solid],
    /// What is drawn of the manipulated object, in its own frame.
    pub shape: &'static [Solid],
}

/// World positions that a success rule decides on, in metres.
#[derive(Debug, Clone, Copy)]
pub struct Positions<'a> {
    /// The manipulated object's origin.
    pub object: Vector3<f64>,
    /// The grip site.
    pub grip_site: Vector3<f64>,
    /// The landmarks, in the order of the record.
    pub landmarks: &'a [Vector3<f64>],
}

/// How robosuite's `UniformRandomSampler` places an object. Its yaw is uniform in a full turn.
#[derive(Debug)]
pub struct ObjectRule {
    /// Name of the object in models.
    pub object: &'static str,
    /// Whether the task leaves it where it was placed. Others are put away.
    pub used: bool,
    /// Range of x about the reference.
    pub x: [f64; 2],
    /// Range of y about the reference.
    pub y: [f64; 2],
    /// The reference.
    pub reference: [f64; 3],
    /// Height of the object's bottom above the reference.
    pub height: f64,
    /// How much room it takes.
    pub extent: Extent,
}

/// How much room an object takes.
#[derive(Debug, Clone, Copy)]
pub enum Extent {
    /// The same for all seeds.
    Fixed {
        /// Height of its bottom above its origin, mostly negative.
        bottom: f64,
        /// Height of its top above its origin.
        top: f64,
        /// Its radius in the plane.
        radius: f64,
    },
    /// A box whose half sizes a seed draws, each uniform in this range. They are part of the model, where the box's geoms are
    /// called after the object: `cube_g0`, and `cube_g0_vis`, which is only drawn.
    Box([f64; 2]),
}

impl ObjectRule {
    /// Name of the object's body in models.
    #[must_use]
    pub fn body(&self) -> String {
        body_of(self.object)
    }

    /// Name of the object's free joint in models.
    #[must_use]
    pub fn joint(&self) -> String {
        joint_of(self.object)
    }
}

impl TaskSpec {
    /// Name of the manipulated object's body in models.
    #[must_use]
    pub fn body(&self) -> String {
        body_of(self.object)
    }

    /// Name of the manipulated object's free joint in models.
    #[must_use]
    pub fn joint(&self) -> String {
        joint_of(self.object)
    }

    /// Bodies of the objects in the scene that the task has put away.
    #[must_use]
    pub fn put_away(&self) -> Vec<String> {
        let away = self.placement.iter().filter(|rule| !rule.used);
        away.map(ObjectRule::body).collect()
    }

    /// Whether seeds have models of their own, which differ in the sizes of boxes.
    #[must_use]
    pub fn draws_models(&self) -> bool {
        self.placement.iter().any(|rule| matches!(rule.extent, Extent::Box(_)))
    }

    /// Columns of the observation `object`.
    #[must_use]
    pub fn object_columns(&self) -> usize {
        self.layouts[0].columns()
    }

    /// Order of the parts of the observation `object` in a version (major, minor) of robosuite.
    #[must_use]
    pub fn layout(&self, version: (u32, u32)) -> ObjectLayout {
        self.layouts[usize::from(version >= (1, 5))]
    }
}

fn body_of(object: &str) -> String {
    format!("{object}_main")
}

fn joint_of(object: &str) -> String {
    format!("{object}_joint0")
}

/// A box, or an upright cylinder, along the axes of its frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Solid {
    /// What it is: `table`, `wall`, `goal`, `object`.
    pub kind: &'static str,
    /// Its centre.
    pub centre: [f64; 3],
    /// Half its sides; of a cylinder the first two are the radius.
    pub half: [f64; 3],
    /// Whether it is a cylinder.
    pub round: bool,
}

impl Solid {
    /// A box.
    #[must_use]
    pub const fn cuboid(kind: &'static str, centre: [f64; 3], half: [f64; 3]) -> Self {
        Self {
            kind,
            centre,
            half,
            round: false,
        }
    }

    /// An upright cylinder.
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
