//! Where a camera's image shows points of the world.

use std::ffi::{c_int, c_void};

use crate::{Model, Version};

type Vector = [f64; 3];

fn dot(a: Vector, b: Vector) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

fn cross(a: Vector, b: Vector) -> Vector {
    [
        a[1] * b[2] - a[2] * b[1],
        a[2] * b[0] - a[0] * b[2],
        a[0] * b[1] - a[1] * b[0],
    ]
}

/// What a camera sees: an upright pyramid, as all of robosuite's cameras have it. World frame, metres.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct View {
    pub(crate) position: Vector,
    /// Unit vector along the camera's axis.
    pub(crate) forward: Vector,
    /// Unit vector towards the upper edge of the image.
    pub(crate) up: Vector,
    /// Half the image's height at depth one: the tangent of half the vertical field of view.
    pub(crate) half: f64,
    /// What is nearer is not drawn.
    pub(crate) near: f64,
}

impl View {
    /// What the camera of a scene sees; none where it is not such a pyramid, or nothing was drawn yet.
    ///
    /// # Safety
    /// The scene is one of this model, whole.
    pub(crate) unsafe fn of_scene(scene: *const c_void, model: &Model) -> Option<Self> {
        let version = model.library().version();
        let layout = version.layout();
        // SAFETY: by the caller: the scene has two eyes, which have three vectors and then numbers.
        let (eyes, parallel) = unsafe {
            let start = scene.byte_add(layout.scene_camera);
            let eyes = [0, layout.sizes.eye].map(|offset| {
                let eye = start.byte_add(offset);
                let number = |offset: usize| f64::from(eye.byte_add(offset).cast::<f32>().read());
                let vector = |offset: usize| eye.byte_add(offset).cast::<[f32; 3]>().read().map(f64::from);
                (
                    [
                        vector(layout.eye_pos),
                        vector(layout.eye_forward),
                        vector(layout.eye_up),
                    ],
                    [
                        number(layout.eye_center),
                        number(layout.eye_bottom),
                        number(layout.eye_top),
                        number(layout.eye_near),
                    ],
                )
            });
            let parallel = match version {
                Version::V2_3_7 => 0,
                Version::V3_2_7 => start
                    .byte_add(layout.sizes.eye - size_of::<c_int>())
                    .cast::<c_int>()
                    .read(),
            };
            (eyes, parallel)
        };
        let [([left, forward, up], numbers), ([right, ..], others)] = eyes;
        let [_, bottom, top, near] = numbers;
        let off_centre = (numbers[0] + others[0]).abs() / 2.0 + (bottom + top).abs();
        // Not so near as to be off by rounding, and without the shift of a stereo image.
        if parallel != 0 || near <= 0.0 || top <= 0.0 || off_centre > 1e-6 * top {
            return None;
        }
        Some(Self {
            position: std::array::from_fn(|k| f64::midpoint(left[k], right[k])),
            forward,
            up,
            half: top / near,
            near,
        })
    }

    /// Unit vector towards the right edge of the image.
    pub(crate) fn right(&self) -> Vector {
        cross(self.forward, self.up)
    }

    /// Where an image of this size shows a point: pixels to the right and down from the corner at the top left, so that the
    /// first pixel's centre is at (0.5, 0.5). Points beside the image have places outside of it; what is behind the camera,
    /// or nearer than anything is drawn, has none.
    #[must_use]
    pub fn pixel(&self, point: [f64; 3], width: usize, height: usize) -> Option<[f64; 2]> {
        let away = std::array::from_fn(|k| point[k] - self.position[k]);
        let depth = dot(away, self.forward);
        if depth.is_nan() || depth <= self.near {
            return None;
        }
        let (width, height) = (width as f64, height as f64);
        // Pixels are square: one length for both directions.
        let scale = height / (2.0 * self.half * depth);
        Some([
            0.5 * width + scale * dot(away, self.right()),
            0.5 * height - scale * dot(away, self.up),
        ])
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Two metres before the origin, at a height of one, a field of view of 90 degrees.
    const VIEW: View = View {
        position: [2.0, 0.0, 1.0],
        forward: [-1.0, 0.0, 0.0],
        up: [0.0, 0.0, 1.0],
        half: 1.0,
        near: 0.01,
    };

    #[test]
    fn points_are_where_a_image_shows_them() {
        let near = |point: [f64; 3], expected: [f64; 2]| {
            let found = VIEW.pixel(point, 80, 60).unwrap();
            assert!(
                (found[0] - expected[0]).hypot(found[1] - expected[1]) < 1e-12,
                "{point:?}: {found:?}"
            );
        };
        near([0.0, 0.0, 1.0], [40.0, 30.0]);
        // At a depth of two the image is four metres high: 15 px a metre. The camera looks along -x: +y is to its right.
        near([0.0, 1.0, 1.0], [55.0, 30.0]);
        near([0.0, 0.0, 3.0], [40.0, 0.0]);
        near([1.0, -1.0, 0.0], [10.0, 60.0]);
        near([0.0, 9.0, 1.0], [175.0, 30.0]);
        for behind in [
            [3.0, 0.0, 1.0],
            [2.0, 0.0, 1.0],
            [1.995, 0.0, 1.0],
            [f64::NAN, 0.0, 0.0],
        ] {
            assert_eq!(VIEW.pixel(behind, 80, 60), None);
        }
    }
}
