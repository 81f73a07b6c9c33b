//! Output of Chipmunk's debug drawing of a space: the corners that it computes and the marks of contacts.

use std::ffi::{c_int, c_void};

use re4_geometry::Point2;

use super::ffi::{self, CpColor, CpDrawOptions, CpShape, CpVect};
use super::{World, point};

/// The moving shapes and the contact marks, in pixels, in the order in which Chipmunk reports them.
#[derive(Debug, Clone, Default)]
pub(crate) struct Drawing {
    /// Centres of round shapes: the agent's.
    pub(crate) circles: Vec<Point2>,
    /// Corners of the block's rectangles: bar, stem.
    pub(crate) rectangles: Vec<[Point2; 4]>,
    /// For every contact point of the last physics step, a short line through it along the contact's normal.
    pub(crate) marks: Vec<[Point2; 2]>,
}

/// Chipmunk's colours are not used: the renderer chooses its own.
const NO_COLOUR: CpColor = CpColor {
    r: 0.0,
    g: 0.0,
    b: 0.0,
    a: 0.0,
};

impl World {
    /// The shapes and contact marks after the last physics step, without the walls, which do not move.
    pub(crate) fn drawing(&self) -> Drawing {
        let mut drawing = Drawing::default();
        let mut options = CpDrawOptions {
            draw_circle: circle,
            draw_segment: segment,
            draw_fat_segment: fat_segment,
            draw_polygon: polygon,
            draw_dot: dot,
            flags: ffi::DRAW_SHAPES | ffi::DRAW_COLLISION_POINTS,
            outline: NO_COLOUR,
            colour_for_shape: colour,
            constraint: NO_COLOUR,
            collision_point: NO_COLOUR,
            data: (&raw mut drawing).cast::<c_void>(),
        };
        // SAFETY: the space lives as long as `self`, is not being stepped, and no other thread can reach it. The call
        // only reads the space, except for a lock count that it raises and lowers again. Every callback is set, and each gets
        // `data`, the only pointer to `drawing` that is used until the call returns.
        unsafe { ffi::cpSpaceDebugDraw(self.space.as_ptr(), &raw mut options) }
        drawing
    }
}

/// The drawing that a callback appends to.
///
/// # Safety
/// `data` must be the pointer that [`World::drawing`] set, and that call must not have returned.
unsafe fn drawing_of<'a>(data: *mut c_void) -> &'a mut Drawing {
    // SAFETY: the caller guarantees that it points to a `Drawing` that nothing else uses at this time.
    unsafe { &mut *data.cast::<Drawing>() }
}

unsafe extern "C" fn circle(centre: CpVect, _: f64, _: f64, _: CpColor, _: CpColor, data: *mut c_void) {
    // SAFETY: Chipmunk passes the options' data.
    unsafe { drawing_of(data) }.circles.push(point(centre));
}

/// Chipmunk draws segments without a radius for constraints, which a Push-T space does not have, and for contact points.
unsafe extern "C" fn segment(a: CpVect, b: CpVect, _: CpColor, data: *mut c_void) {
    // SAFETY: Chipmunk passes the options' data.
    unsafe { drawing_of(data) }.marks.push([point(a), point(b)]);
}

unsafe extern "C" fn fat_segment(_: CpVect, _: CpVect, _: f64, _: CpColor, _: CpColor, _: *mut c_void) {}

unsafe extern "C" fn polygon(count: c_int, corners: *const CpVect, _: f64, _: CpColor, _: CpColor, data: *mut c_void) {
    // Both polygons of the block have four corners.
    if count == 4 {
        // SAFETY: Chipmunk passes `count` corners, and the options' data.
        let (corners, drawing) = unsafe { (*corners.cast::<[CpVect; 4]>(), drawing_of(data)) };
        drawing.rectangles.push(corners.map(point));
    }
}

unsafe extern "C" fn dot(_: f64, _: CpVect, _: CpColor, _: *mut c_void) {}

unsafe extern "C" fn colour(_: *mut CpShape, _: *mut c_void) -> CpColor {
    NO_COLOUR
}
