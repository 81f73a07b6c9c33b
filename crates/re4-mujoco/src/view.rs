//! Projection of points in the world to pixels of a camera image.

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

/// The pose and the field of view of a camera. The frustum is symmetric about the optical axis, as for all cameras of robosuite.
/// World frame, metres.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct View {
    pub(crate) position: Vector,
    /// Unit vector along the optical axis.
    pub(crate) forward: Vector,
    /// Unit vector towards the upper edge of the image.
    pub(crate) up: Vector,
    /// Half of the image height at depth one: the tangent of half the vertical field of view.
    pub(crate) half: f64,
    /// Depth of the near plane. Nearer points are not rendered.
    pub(crate) near: f64,
}

impl View {
    /// The view of a scene's camera. Returns `None` if the frustum is not symmetric, or nothing was rendered yet.
    ///
    /// # Safety
    /// The scene must be a valid `mjvScene` that was made for this model.
    pub(crate) unsafe fn of_scene(scene: *const c_void, model: &Model) -> Option<Self> {
        let version = model.library().version();
        let layout = version.layout();
        // SAFETY: the caller guarantees the scene. It has two cameras (`mjvGLCamera`) with these vectors and numbers.
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
                // In version 2.3.7 `mjvGLCamera` has no flag for orthographic projection.
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
        // The mean of both eyes cancels the shift of stereo images.
        let off_centre = (numbers[0] + others[0]).abs() / 2.0 + (bottom + top).abs();
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

    /// Projects a point in the world frame (metres) to an image of this size. Returns `[column, row]` in pixels from the top left
    /// corner, so that the centre of the first pixel is at (0.5, 0.5). The result is outside the image for points that the image
    /// does not show. Returns `None` for points behind the camera or nearer than the near plane.
    #[must_use]
    pub fn pixel(&self, point: [f64; 3], width: usize, height: usize) -> Option<[f64; 2]> {
        let away = std::array::from_fn(|k| point[k] - self.position[k]);
        let depth = dot(away, self.forward);
        if depth.is_nan() || depth <= self.near {
            return None;
        }
        let (width, height) = (width as f64, height as f64);
        // Pixels are square, so both directions have the same scale.
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

    /// A camera two metres in front of the origin, at a height of one metre, with a field of view of 90 degrees.
    const VIEW: View = View {
        position: [2.0, 0.0, 1.0],
        forward: [-1.0, 0.0, 0.0],
        up: [0.0, 0.0, 1.0],
        half: 1.0,
        near: 0.01,
    };

    #[test]
    fn points_are_projected_to_the_right_pixels() {
        let near = |point: [f64; 3], expected: [f64; 2]| {
            let found = VIEW.pixel(point, 80, 60).unwrap();
            assert!(
                (found[0] - expected[0]).hypot(found[1] - expected[1]) < 1e-12,
                "{point:?}: {found:?}"
            );
        };
        near([0.0, 0.0, 1.0], [40.0, 30.0]);
        // At a depth of 2 m the image is 4 m high, so a metre has 15 pixels. The camera looks along -x, so +y is to its right.
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
