//! Removes geoms from a scene that do not affect any pixel of the image.
//!
//! Most of the rendering time is spent on the robot's meshes, which have a hundred thousand triangles. Most of them are outside
//! the image if a camera looks at a table, and they are rendered twice if something reflects. Meshes with a bounding box
//! outside the camera's view, both directly and in the mirror, are removed from the scene. The mirror pass is skipped if boxes
//! hide the mirror in the whole image. The image stays bit-exact. Unsupported scenes are left unchanged.
//!
//! MuJoCo renders reflections in only one geom: the first plane or box in the scene with a reflecting material.

use std::ffi::{c_int, c_void};

use crate::Model;
use crate::layout::Layout;

/// `mjGEOM_PLANE`, `mjGEOM_BOX`, `mjGEOM_MESH`.
const PLANE: c_int = 0;
const BOX: c_int = 6;
const MESH: c_int = 7;

/// `mjOBJ_GEOM`.
const GEOM: c_int = 5;

/// `mjRND_REFLECTION`.
pub(crate) const REFLECTION: usize = 2;

/// The frustum and bounding boxes are enlarged by this factor, so that rounding never removes a visible mesh.
const MARGIN: f64 = 1.02;

/// Boxes that hide something are reduced by this factor, for the same reason.
const COVER: f64 = 1.005;

/// Number of cells along each side of the image for finding visible parts of the mirror.
const CELLS: usize = 16;
/// Maximum number of times that a cell is split into halves along each side if no box fills it.
const HALVINGS: usize = 3;

type Vector = [f64; 3];

fn dot(a: Vector, b: Vector) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

fn minus(a: Vector, b: Vector) -> Vector {
    [a[0] - b[0], a[1] - b[1], a[2] - b[2]]
}

/// `a + factor * b`.
fn plus(a: Vector, b: Vector, factor: f64) -> Vector {
    [a[0] + factor * b[0], a[1] + factor * b[1], a[2] + factor * b[2]]
}

/// The frustum of a camera, or a part of it.
#[derive(Clone, Copy)]
struct View {
    position: Vector,
    forward: Vector,
    up: Vector,
    right: Vector,
    /// Lower and upper edge of the image at depth one.
    vertical: [f64; 2],
    /// Left and right edge of the image at depth one.
    horizontal: [f64; 2],
    near: f64,
}

impl View {
    /// The frustum mirrored at the plane through a point with this unit normal.
    fn mirrored(&self, point: Vector, normal: Vector) -> Self {
        let mirror = |v: Vector| plus(v, normal, -2.0 * dot(v, normal));
        Self {
            position: plus(self.position, normal, -2.0 * dot(minus(self.position, point), normal)),
            forward: mirror(self.forward),
            up: mirror(self.up),
            right: mirror(self.right),
            ..*self
        }
    }

    /// One cell of a grid with `parts` rows and columns of equal size.
    fn cell(&self, parts: usize, row: usize, column: usize) -> Self {
        let part = |[from, to]: [f64; 2], number: usize| {
            let edge = |number: usize| from + (to - from) * number as f64 / parts as f64;
            [edge(number), edge(number + 1)]
        };
        Self {
            vertical: part(self.vertical, row),
            horizontal: part(self.horizontal, column),
            ..*self
        }
    }

    /// All cells of a grid with `parts` rows and columns.
    fn cells(&self, parts: usize) -> impl Iterator<Item = Self> + '_ {
        (0..parts * parts).map(move |number| self.cell(parts, number / parts, number % parts))
    }

    /// Whether a box (centre, half axes) is completely outside the frustum. May return false for boxes that are outside.
    fn misses(&self, centre: Vector, axes: &[Vector; 3]) -> bool {
        let away = minus(centre, self.position);
        let [bottom, top] = self.vertical;
        let [left, right] = self.horizontal;
        let against = |v: Vector| v.map(|x| -x);
        let insides = [
            plus(self.up, self.forward, -bottom),
            plus(against(self.up), self.forward, top),
            plus(self.right, self.forward, -left),
            plus(against(self.right), self.forward, right),
            self.forward,
        ];
        insides.into_iter().any(|inside| {
            let reach: f64 = axes.iter().map(|&axis| dot(axis, inside).abs()).sum();
            dot(away, inside) + reach < 0.0
        })
    }

    /// Whether a box covers the whole frustum. Since a box is convex, it suffices that the rays along the four edges hit it.
    fn filled_by(&self, (centre, axes): &(Vector, [Vector; 3])) -> bool {
        let away = minus(*centre, self.position);
        self.vertical.into_iter().all(|y| {
            self.horizontal.into_iter().all(|x| {
                // The ray's parameter is the depth.
                let ray = plus(plus(self.forward, self.up, y), self.right, x);
                let (mut enter, mut leave) = (f64::NEG_INFINITY, f64::INFINITY);
                for &axis in axes {
                    let half = dot(axis, axis) / COVER;
                    let (start, step) = (dot(away, axis), dot(ray, axis));
                    let sides = [(start - half) / step, (start + half) / step];
                    // If the ray is parallel to a side, these are infinities or NaN. `min` and `max` ignore NaN, and without
                    // any number the result below is false.
                    enter = enter.max(sides[0].min(sides[1]));
                    leave = leave.min(sides[0].max(sides[1]));
                }
                enter <= leave && enter > MARGIN * self.near
            })
        })
    }

    /// Whether boxes together cover the whole frustum, which is split up to `halvings` times.
    fn filled(&self, boxes: &[(Vector, [Vector; 3])], halvings: usize) -> bool {
        boxes.iter().any(|filling| self.filled_by(filling))
            || halvings > 0 && self.cells(2).all(|cell| cell.filled(boxes, halvings - 1))
    }
}

/// A geom of a scene (`mjvGeom`).
struct Geom {
    pointer: *const c_void,
    layout: &'static Layout,
}

impl Geom {
    /// Reads a field.
    ///
    /// # Safety
    /// The structure must have a field of type `T` at this offset.
    unsafe fn get<T>(&self, offset: usize) -> T {
        // SAFETY: the caller guarantees the field.
        unsafe { self.pointer.byte_add(offset).cast::<T>().read() }
    }

    fn kind(&self) -> c_int {
        // SAFETY: the field is an `int`.
        unsafe { self.get(self.layout.geom_type) }
    }

    /// Index of the model's geom that it shows, or `None` if it shows something else.
    fn geom(&self) -> Option<usize> {
        // SAFETY: both fields are `int`s.
        let (kind, id) = unsafe {
            (
                self.get::<c_int>(self.layout.geom_objtype),
                self.get::<c_int>(self.layout.geom_objid),
            )
        };
        (kind == GEOM).then(|| usize::try_from(id).ok()).flatten()
    }

    /// Whether MuJoCo would render reflections in the geom.
    fn reflects(&self) -> bool {
        // SAFETY: the field is a `float`.
        matches!(self.kind(), PLANE | BOX) && unsafe { self.get::<f32>(self.layout.geom_reflectance) } > 0.0
    }

    fn opaque(&self) -> bool {
        // SAFETY: the field consists of four `float`s.
        let colour: [f32; 4] = unsafe { self.get(self.layout.geom_rgba) };
        colour[3] >= 1.0
    }

    fn vector(&self, offset: usize) -> Vector {
        // SAFETY: callers only ask for fields of three `float`s.
        unsafe { self.get::<[f32; 3]>(offset) }.map(f64::from)
    }

    fn position(&self) -> Vector {
        self.vector(self.layout.geom_pos)
    }

    /// Its axes in the world frame: the columns of its rotation matrix.
    fn axes(&self) -> [Vector; 3] {
        // SAFETY: the field consists of nine `float`s in row-major order.
        let rows = unsafe { self.get::<[f32; 9]>(self.layout.geom_mat) }.map(f64::from);
        [0, 1, 2].map(|axis| [rows[axis], rows[3 + axis], rows[6 + axis]])
    }
}

/// Removes the meshes from a scene that are not visible in an image with this aspect ratio (width / height). Also clears the flag
/// [`REFLECTION`] if no part of the mirror is visible.
///
/// # Safety
/// The scene must be a valid `mjvScene` that was made and updated for this model.
pub(crate) unsafe fn trim(scene: *mut c_void, model: &Model, aspect: f64) {
    let layout = model.library().version().layout();
    let size = layout.sizes.geom;
    // SAFETY: the caller guarantees the scene, and the layout gives the offsets of its fields.
    unsafe {
        let Some(seen) = crate::View::of_scene(scene, model) else {
            return;
        };
        let view = view_of(&seen, aspect);
        let geoms = scene.byte_add(layout.scene_geoms).cast::<*mut c_void>().read();
        let count_at = scene.byte_add(layout.scene_ngeom).cast::<c_int>();
        let count = usize::try_from(count_at.read()).unwrap_or(0);
        let geom = |number: usize| Geom {
            pointer: geoms.byte_add(number * size),
            layout,
        };
        let mirror = (0..count).map(geom).find(Geom::reflects);
        // The parts of the frustum in which the mirror may be visible, mirrored.
        let mut mirrored = Vec::new();
        if let Some(mirror) = mirror {
            if mirror.kind() != PLANE || !mirror.opaque() {
                return;
            }
            let (point, normal) = (mirror.position(), mirror.axes()[2]);
            let covers: Vec<_> = (0..count)
                .map(geom)
                .filter_map(|cover| cover_of(&cover, &view, point, normal))
                .collect();
            let open = view.cells(CELLS).filter(|cell| !cell.filled(&covers, HALVINGS));
            mirrored.extend(open.map(|cell| cell.mirrored(point, normal)));
            if mirrored.is_empty() {
                scene.byte_add(layout.scene_flags + REFLECTION).cast::<u8>().write(0);
            }
        }
        let mut kept = 0;
        for number in 0..count {
            let seen = match geom(number).geom().filter(|_| geom(number).kind() == MESH) {
                None => true,
                Some(id) => {
                    let (centre, axes) = bounds(&geom(number), model.bounding_box(id));
                    !view.misses(centre, &axes) || mirrored.iter().any(|cell| !cell.misses(centre, &axes))
                }
            };
            if seen {
                if kept != number {
                    let from = geoms.byte_add(number * size).cast::<u8>();
                    std::ptr::copy_nonoverlapping(from, geoms.byte_add(kept * size).cast::<u8>(), size);
                }
                kept += 1;
            }
        }
        count_at.write(kept as c_int);
    }
}

/// The frustum of an image with this aspect ratio, enlarged by a margin.
fn view_of(seen: &crate::View, aspect: f64) -> View {
    let half = MARGIN * seen.half;
    View {
        position: seen.position,
        forward: seen.forward,
        up: seen.up,
        right: seen.right(),
        vertical: [-half, half],
        horizontal: [-half * aspect, half * aspect],
        near: seen.near,
    }
}

/// World centre and half axes of a geom's bounding box, which is given by centre and half sizes in the geom's frame. Enlarged by a
/// margin.
fn bounds(geom: &Geom, [x, y, z, a, b, c]: [f64; 6]) -> (Vector, [Vector; 3]) {
    let axes = geom.axes();
    let mut centre = geom.position();
    for (axis, along) in axes.iter().zip([x, y, z]) {
        centre = plus(centre, *axis, along);
    }
    let mut half = axes;
    for (axis, length) in half.iter_mut().zip([a, b, c]) {
        *axis = axis.map(|x| MARGIN * length * x);
    }
    (centre, half)
}

/// Centre and half axes of a geom, if it is an opaque box on the camera's side of the mirror.
fn cover_of(cover: &Geom, view: &View, point: Vector, normal: Vector) -> Option<(Vector, [Vector; 3])> {
    if cover.kind() != BOX || !cover.opaque() {
        return None;
    }
    let sizes = cover.vector(cover.layout.geom_size);
    let mut axes = cover.axes();
    for (axis, size) in axes.iter_mut().zip(sizes) {
        *axis = axis.map(|x| size * x);
    }
    let height = |v: Vector| dot(minus(v, point), normal);
    let centre = cover.position();
    let reach: f64 = axes.iter().map(|&axis| dot(axis, normal).abs()).sum();
    (height(view.position) > 0.0 && height(centre) > COVER * reach).then_some((centre, axes))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A camera that looks down from two metres above the origin, with x to the right and a field of view of 90 degrees.
    const VIEW: View = View {
        position: [0.0, 0.0, 2.0],
        forward: [0.0, 0.0, -1.0],
        up: [0.0, 1.0, 0.0],
        right: [1.0, 0.0, 0.0],
        vertical: [-1.0, 1.0],
        horizontal: [-1.0, 1.0],
        near: 0.01,
    };

    fn cube(side: f64) -> [Vector; 3] {
        [[side, 0.0, 0.0], [0.0, side, 0.0], [0.0, 0.0, side]]
    }

    #[test]
    fn only_boxes_outside_the_frustum_are_missed() {
        for (centre, missed) in [
            ([0.0, 0.0, 0.0], false),
            ([2.1, 0.0, 0.0], false),
            ([2.3, 0.0, 0.0], true),
            ([0.0, -2.3, 0.0], true),
            ([0.0, 2.1, 0.0], false),
            ([0.0, 0.0, 2.2], true),
            ([0.0, 0.0, 2.05], false),
            ([-2.3, 0.0, -2.0], false),
        ] {
            assert_eq!(VIEW.misses(centre, &cube(0.1)), missed, "{centre:?}");
        }
    }

    #[test]
    fn a_mirrored_view_looks_up() {
        let mirrored = VIEW.mirrored([5.0, 5.0, 0.5], [0.0, 0.0, 1.0]);
        assert_eq!(mirrored.position, [0.0, 0.0, -1.0]);
        assert_eq!(mirrored.forward, [0.0, 0.0, 1.0]);
        assert_eq!((mirrored.up, mirrored.right), (VIEW.up, VIEW.right));
        assert!(!mirrored.misses([0.0, 0.0, 3.0], &cube(0.1)) && VIEW.misses([0.0, 0.0, 3.0], &cube(0.1)));
    }

    #[test]
    fn cells_are_parts_of_the_image() {
        let cell = VIEW.cell(2, 1, 0);
        assert_eq!((cell.vertical, cell.horizontal), ([0.0, 1.0], [-1.0, 0.0]));
        assert!(cell.misses([0.5, 0.5, 0.0], &cube(0.1)) && !cell.misses([-0.5, 0.5, 0.0], &cube(0.1)));
        assert_eq!(VIEW.cells(3).count(), 9);
    }

    #[test]
    fn boxes_that_fill_the_image_are_recognised() {
        let table = |x: f64, half: f64| ([x, 0.0, 0.0], [[half, 0.0, 0.0], [0.0, 3.0, 0.0], [0.0, 0.0, 0.1]]);
        // Its top is 1.9 m below the camera, so the image shows 1.9 m to each side.
        assert!(VIEW.filled_by(&table(0.0, 2.0)));
        assert!(!VIEW.filled_by(&table(0.0, 1.9)));
        assert!(!VIEW.filled_by(&table(0.5, 2.0)));
        // A box around the camera, and one behind it.
        let around = |z: f64| ([0.0, 0.0, z], cube(9.0));
        assert!(!VIEW.filled_by(&around(2.0)) && !VIEW.filled_by(&around(12.0)));
        // Two boxes that overlap fill the image, two boxes with a gap do not.
        assert!(VIEW.filled(&[table(-1.0, 1.3), table(1.0, 1.3)], 4));
        assert!(!VIEW.filled(&[table(-1.0, 1.3), table(1.0, 1.3)], 0));
        assert!(!VIEW.filled(&[table(-1.0, 1.0), table(1.0, 0.99)], 6));
    }
}
