//! The physics of Push-T in a Chipmunk space: the only module of this crate that calls C.
#![allow(
    unsafe_code,
    reason = "Chipmunk is a C library; only this module calls it, behind the safe type `World`"
)]

mod drawing;
mod ffi;
mod quiet;

use std::cell::Cell;
use std::ffi::{CStr, c_int, c_void};
use std::ptr::NonNull;

use re4_geometry::{Point2, Pose2};

pub(crate) use drawing::Drawing;
use ffi::{CpArbiter, CpBody, CpShape, CpSpace, CpTransform, CpVect};

/// Friction, elasticity, collision types and filters keep Chipmunk's defaults, as they do in gym-pusht: its
/// `body.friction = 1` sets an attribute that a body does not have.
pub(crate) const WALL_RADIUS: f64 = 2.0;
pub(crate) const WALLS: [[Point2; 2]; 4] = [
    [Point2::new(5.0, 506.0), Point2::new(5.0, 5.0)],
    [Point2::new(5.0, 5.0), Point2::new(506.0, 5.0)],
    [Point2::new(506.0, 5.0), Point2::new(506.0, 506.0)],
    [Point2::new(5.0, 506.0), Point2::new(506.0, 506.0)],
];
/// Lower and upper bound of the free space in x and in y: the inner faces of the walls, in pixels.
pub const WALL_FACES: [f64; 2] = [5.0 + WALL_RADIUS, 506.0 - WALL_RADIUS];
const BLOCK_MASS: f64 = 1.0;

const fn vect(x: f64, y: f64) -> CpVect {
    CpVect { x, y }
}

fn point(v: CpVect) -> Point2 {
    Point2::new(v.x, v.y)
}

fn from_point(p: Point2) -> CpVect {
    vect(p.x, p.y)
}

/// The version that the linked library reports, such as `7.0.3`.
pub fn chipmunk_version() -> String {
    if ffi::cpVersionString.is_null() {
        return "unknown".to_owned();
    }
    // SAFETY: the library defines the variable as a pointer to a string literal, which lives as long as the program and
    // is never written to; null was ruled out above.
    let text = unsafe { CStr::from_ptr(ffi::cpVersionString) };
    text.to_string_lossy().into_owned()
}

/// One Chipmunk space with four walls, the agent and the block.
///
/// Every pointer is created in [`World::new`], is owned by this value only and is freed when it is dropped. The methods do not
/// check their arguments: Chipmunk aborts the process on a value that is not finite, so callers check them first.
pub(crate) struct World {
    space: NonNull<CpSpace>,
    agent: NonNull<CpBody>,
    block: NonNull<CpBody>,
    shapes: Vec<NonNull<CpShape>>,
    /// Contact points since the last call of [`World::take_contact_points`]. The space's collision handler has the same
    /// address, so this is a raw pointer and not a `Box`, which would assert unique access.
    contact_points: NonNull<Cell<u32>>,
}

// SAFETY: the pointers of a `World` are reachable only through it, and Chipmunk has no thread-local state.
// Its only writable global is the flag that the greeting was printed, which `quiet::greet_once` sets under a lock before any
// space is made (the other globals in the library's data sections are constant tables). So a `World` may move to another
// thread. It is not `Sync`, because of `Cell` and the raw pointers.
unsafe impl Send for World {}

impl World {
    /// Sets up the world in gym-pusht's order: the order of the shapes determines the order of their collisions.
    pub(crate) fn new(agent: Point2, block: Pose2, agent_radius: f64, rectangles: &[[Point2; 4]; 2]) -> Self {
        quiet::greet_once();
        let contact_points = NonNull::from(Box::leak(Box::new(Cell::new(0))));
        let mut shapes = Vec::with_capacity(WALLS.len() + 3);
        // SAFETY: every constructor returns a new object (Chipmunk does not check its allocations; a failed one
        // would end the process before it returned). Bodies and shapes are added once, to this space only. All numbers
        // are finite: constants, and poses that the caller has checked. `rectangles` are convex, so the polygons
        // are valid. The handler's data is the counter, which keeps its address and is freed after the space.
        unsafe {
            let space = non_null(ffi::cpSpaceNew());
            // The block keeps no velocity after a physics step: Chipmunk multiplies it by 0^dt = 0. The agent is
            // kinematic and not damped.
            ffi::cpSpaceSetDamping(space.as_ptr(), 0.0);

            let ground = ffi::cpSpaceGetStaticBody(space.as_ptr());
            for [a, b] in WALLS {
                let wall = non_null(ffi::cpSegmentShapeNew(
                    ground,
                    from_point(a),
                    from_point(b),
                    WALL_RADIUS,
                ));
                ffi::cpSpaceAddShape(space.as_ptr(), wall.as_ptr());
                shapes.push(wall);
            }

            let agent_body = non_null(ffi::cpBodyNewKinematic());
            ffi::cpBodySetPosition(agent_body.as_ptr(), from_point(agent));
            let disc = non_null(ffi::cpCircleShapeNew(agent_body.as_ptr(), agent_radius, vect(0.0, 0.0)));
            ffi::cpSpaceAddBody(space.as_ptr(), agent_body.as_ptr());
            ffi::cpSpaceAddShape(space.as_ptr(), disc.as_ptr());
            shapes.push(disc);

            let corners = rectangles.map(|rectangle| rectangle.map(from_point));
            // Twice the bar's moment of inertia: gym-pusht and diffusion_policy both pass the bar's corners for the stem too.
            let moment = bar_moment(&corners[0]) + bar_moment(&corners[0]);
            let block_body = non_null(ffi::cpBodyNew(BLOCK_MASS, moment));
            let parts = corners.map(|corners| polygon(block_body, &corners));
            let [bar_centre, stem_centre] = parts.map(|part| point(ffi::cpShapeGetCenterOfGravity(part.as_ptr())));
            let centre = (bar_centre + stem_centre) / 2.0;
            ffi::cpBodySetCenterOfGravity(block_body.as_ptr(), from_point(centre));
            ffi::cpBodySetAngle(block_body.as_ptr(), block.theta);
            ffi::cpBodySetPosition(block_body.as_ptr(), from_point(block.translation()));
            ffi::cpSpaceAddBody(space.as_ptr(), block_body.as_ptr());
            for part in parts {
                ffi::cpSpaceAddShape(space.as_ptr(), part.as_ptr());
                shapes.push(part);
            }

            let handler = non_null(ffi::cpSpaceAddCollisionHandler(space.as_ptr(), 0, 0)).as_ptr();
            (*handler).post_solve = Some(count_contact_points);
            (*handler).user_data = contact_points.as_ptr().cast::<c_void>();

            Self {
                space,
                agent: agent_body,
                block: block_body,
                shapes,
                contact_points,
            }
        }
    }

    pub(crate) fn agent_position(&self) -> Point2 {
        // SAFETY: the body lives as long as `self`; the call only reads it.
        point(unsafe { ffi::cpBodyGetPosition(self.agent.as_ptr()) })
    }

    pub(crate) fn set_agent_position(&mut self, position: Point2) {
        // SAFETY: the body lives as long as `self`, is not shared, and the space is not being stepped.
        unsafe { ffi::cpBodySetPosition(self.agent.as_ptr(), from_point(position)) }
    }

    pub(crate) fn agent_velocity(&self) -> Point2 {
        // SAFETY: the body lives as long as `self`; the call only reads it.
        point(unsafe { ffi::cpBodyGetVelocity(self.agent.as_ptr()) })
    }

    pub(crate) fn set_agent_velocity(&mut self, velocity: Point2) {
        // SAFETY: the body lives as long as `self`, is not shared, and the space is not being stepped.
        unsafe { ffi::cpBodySetVelocity(self.agent.as_ptr(), from_point(velocity)) }
    }

    /// The block's pose; its angle is cumulative, not wrapped.
    pub(crate) fn block_pose(&self) -> Pose2 {
        // SAFETY: the body lives as long as `self`; the calls only read it.
        let (position, theta) = unsafe {
            (
                ffi::cpBodyGetPosition(self.block.as_ptr()),
                ffi::cpBodyGetAngle(self.block.as_ptr()),
            )
        };
        Pose2::new(position.x, position.y, theta)
    }

    /// Moves the block's origin.
    pub(crate) fn set_block_position(&mut self, position: Point2) {
        // SAFETY: the body lives as long as `self`, is not shared, and the space is not being stepped.
        unsafe { ffi::cpBodySetPosition(self.block.as_ptr(), from_point(position)) }
    }

    /// Rotates the block about its centre of gravity.
    pub(crate) fn set_block_angle(&mut self, theta: f64) {
        // SAFETY: the body lives as long as `self`, is not shared, and the space is not being stepped.
        unsafe { ffi::cpBodySetAngle(self.block.as_ptr(), theta) }
    }

    /// Runs the physics for `seconds`.
    pub(crate) fn step(&mut self, seconds: f64) {
        // SAFETY: the space lives as long as `self` and is not shared. The callback only accesses the counter.
        unsafe { ffi::cpSpaceStep(self.space.as_ptr(), seconds) }
    }

    /// Number of contact points solved since the last call.
    pub(crate) fn take_contact_points(&mut self) -> u32 {
        // SAFETY: the cell lives as long as `self`, and the space is not being stepped.
        unsafe { self.contact_points.as_ref() }.take()
    }
}

impl Drop for World {
    fn drop(&mut self) {
        // SAFETY: each object was created in `new`, is freed once, and is not used afterwards. The space is freed first,
        // because it accesses its bodies while it is freed; this also frees its collision handler and its own
        // static body. A shape does not access its body when it is freed.
        unsafe {
            ffi::cpSpaceFree(self.space.as_ptr());
            for shape in &self.shapes {
                ffi::cpShapeFree(shape.as_ptr());
            }
            ffi::cpBodyFree(self.block.as_ptr());
            ffi::cpBodyFree(self.agent.as_ptr());
            drop(Box::from_raw(self.contact_points.as_ptr()));
        }
    }
}

/// Wraps a pointer that a Chipmunk constructor returned; these do not return null.
fn non_null<T>(pointer: *mut T) -> NonNull<T> {
    match NonNull::new(pointer) {
        Some(pointer) => pointer,
        // The same reaction as that of Rust's allocator when memory runs out.
        None => std::alloc::handle_alloc_error(std::alloc::Layout::new::<[u8; 64]>()),
    }
}

fn bar_moment(corners: &[CpVect; 4]) -> f64 {
    // SAFETY: the pointer and the count describe `corners`, which the call only reads.
    unsafe {
        ffi::cpMomentForPoly(
            BLOCK_MASS,
            corners.len() as c_int,
            corners.as_ptr(),
            vect(0.0, 0.0),
            0.0,
        )
    }
}

/// A polygon on `body`, with the corners in the order of Chipmunk's convex hull.
///
/// # Safety
/// `body` must be alive until the polygon is freed or no longer used.
unsafe fn polygon(body: NonNull<CpBody>, corners: &[CpVect; 4]) -> NonNull<CpShape> {
    let identity = CpTransform {
        a: 1.0,
        b: 0.0,
        c: 0.0,
        d: 1.0,
        tx: 0.0,
        ty: 0.0,
    };
    // SAFETY: the pointer and the count describe `corners`, which the call copies; the body is alive.
    non_null(unsafe { ffi::cpPolyShapeNew(body.as_ptr(), corners.len() as c_int, corners.as_ptr(), identity, 0.0) })
}

/// Called by Chipmunk for each touching pair of shapes after a physics step has solved it. It cannot unwind.
unsafe extern "C" fn count_contact_points(arbiter: *mut CpArbiter, _space: *mut CpSpace, counter: *mut c_void) {
    // SAFETY: Chipmunk passes a valid arbiter, and the data set on the handler: a `Cell<u32>` that outlives the space.
    // No other reference to the cell exists while the space is stepped.
    let (points, counter) = unsafe { (ffi::cpArbiterGetCount(arbiter), &*counter.cast::<Cell<u32>>()) };
    counter.set(counter.get().wrapping_add(u32::try_from(points).unwrap_or(0)));
}
