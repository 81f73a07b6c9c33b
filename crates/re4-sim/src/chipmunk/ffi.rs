//! The part of Chipmunk 7's C interface that Push-T uses. Names and layouts follow `chipmunk.h`.

use std::ffi::{c_char, c_int, c_uchar, c_void};

/// `cpVect`, with `cpFloat` a double as on every desktop build.
#[repr(C)]
#[derive(Clone, Copy)]
pub(super) struct CpVect {
    pub(super) x: f64,
    pub(super) y: f64,
}

/// `cpTransform`: the columns of an affine map.
#[repr(C)]
#[derive(Clone, Copy)]
pub(super) struct CpTransform {
    pub(super) a: f64,
    pub(super) b: f64,
    pub(super) c: f64,
    pub(super) d: f64,
    pub(super) tx: f64,
    pub(super) ty: f64,
}

macro_rules! opaque {
    ($($name:ident),*) => {$(
        #[repr(C)]
        pub(super) struct $name {
            _private: [u8; 0],
        }
    )*};
}

opaque!(CpSpace, CpBody, CpShape, CpArbiter);

/// `cpCollisionHandler`. `begin`, `pre_solve` and `separate` keep Chipmunk's defaults.
#[repr(C)]
pub(super) struct CpCollisionHandler {
    type_a: usize,
    type_b: usize,
    begin: Option<unsafe extern "C" fn(*mut CpArbiter, *mut CpSpace, *mut c_void) -> c_uchar>,
    pre_solve: Option<unsafe extern "C" fn(*mut CpArbiter, *mut CpSpace, *mut c_void) -> c_uchar>,
    pub(super) post_solve: Option<unsafe extern "C" fn(*mut CpArbiter, *mut CpSpace, *mut c_void)>,
    separate: Option<unsafe extern "C" fn(*mut CpArbiter, *mut CpSpace, *mut c_void)>,
    pub(super) user_data: *mut c_void,
}

/// `cpSpaceDebugColor`.
#[repr(C)]
#[derive(Clone, Copy)]
pub(super) struct CpColor {
    pub(super) r: f32,
    pub(super) g: f32,
    pub(super) b: f32,
    pub(super) a: f32,
}

/// `CP_SPACE_DEBUG_DRAW_SHAPES`.
pub(super) const DRAW_SHAPES: c_int = 1;
/// `CP_SPACE_DEBUG_DRAW_COLLISION_POINTS`.
pub(super) const DRAW_COLLISION_POINTS: c_int = 1 << 2;

/// `cpSpaceDebugDrawOptions`. Its `flags` are a C enumeration, which has the size of an `int`.
#[repr(C)]
pub(super) struct CpDrawOptions {
    pub(super) draw_circle: unsafe extern "C" fn(CpVect, f64, f64, CpColor, CpColor, *mut c_void),
    pub(super) draw_segment: unsafe extern "C" fn(CpVect, CpVect, CpColor, *mut c_void),
    pub(super) draw_fat_segment: unsafe extern "C" fn(CpVect, CpVect, f64, CpColor, CpColor, *mut c_void),
    pub(super) draw_polygon: unsafe extern "C" fn(c_int, *const CpVect, f64, CpColor, CpColor, *mut c_void),
    pub(super) draw_dot: unsafe extern "C" fn(f64, CpVect, CpColor, *mut c_void),
    pub(super) flags: c_int,
    pub(super) outline: CpColor,
    pub(super) colour_for_shape: unsafe extern "C" fn(*mut CpShape, *mut c_void) -> CpColor,
    pub(super) constraint: CpColor,
    pub(super) collision_point: CpColor,
    pub(super) data: *mut c_void,
}

unsafe extern "C" {
    pub(super) safe static cpVersionString: *const c_char;

    pub(super) fn cpSpaceNew() -> *mut CpSpace;
    pub(super) fn cpSpaceFree(space: *mut CpSpace);
    pub(super) fn cpSpaceSetDamping(space: *mut CpSpace, damping: f64);
    pub(super) fn cpSpaceGetStaticBody(space: *const CpSpace) -> *mut CpBody;
    pub(super) fn cpSpaceAddCollisionHandler(space: *mut CpSpace, a: usize, b: usize) -> *mut CpCollisionHandler;
    pub(super) fn cpSpaceAddShape(space: *mut CpSpace, shape: *mut CpShape) -> *mut CpShape;
    pub(super) fn cpSpaceAddBody(space: *mut CpSpace, body: *mut CpBody) -> *mut CpBody;
    pub(super) fn cpSpaceStep(space: *mut CpSpace, seconds: f64);

    pub(super) fn cpSpaceDebugDraw(space: *mut CpSpace, options: *mut CpDrawOptions);

    pub(super) fn cpBodyNew(mass: f64, moment: f64) -> *mut CpBody;
    pub(super) fn cpBodyNewKinematic() -> *mut CpBody;
    pub(super) fn cpBodyFree(body: *mut CpBody);
    pub(super) fn cpBodyGetPosition(body: *const CpBody) -> CpVect;
    pub(super) fn cpBodySetPosition(body: *mut CpBody, position: CpVect);
    pub(super) fn cpBodySetCenterOfGravity(body: *mut CpBody, centre: CpVect);
    pub(super) fn cpBodyGetVelocity(body: *const CpBody) -> CpVect;
    pub(super) fn cpBodySetVelocity(body: *mut CpBody, velocity: CpVect);
    pub(super) fn cpBodyGetAngle(body: *const CpBody) -> f64;
    pub(super) fn cpBodySetAngle(body: *mut CpBody, angle: f64);

    pub(super) fn cpMomentForPoly(mass: f64, count: c_int, vertices: *const CpVect, offset: CpVect, radius: f64)
    -> f64;
    pub(super) fn cpCircleShapeNew(body: *mut CpBody, radius: f64, offset: CpVect) -> *mut CpShape;
    pub(super) fn cpSegmentShapeNew(body: *mut CpBody, a: CpVect, b: CpVect, radius: f64) -> *mut CpShape;
    pub(super) fn cpPolyShapeNew(
        body: *mut CpBody,
        count: c_int,
        vertices: *const CpVect,
        transform: CpTransform,
        radius: f64,
    ) -> *mut CpShape;
    pub(super) fn cpShapeFree(shape: *mut CpShape);
    pub(super) fn cpShapeGetCenterOfGravity(shape: *mut CpShape) -> CpVect;

    pub(super) fn cpArbiterGetCount(arbiter: *const CpArbiter) -> c_int;
}
