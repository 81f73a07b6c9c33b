//! One simulation of a model.

use std::ffi::{c_int, c_void};
use std::ptr::NonNull;

use crate::layout::Layout;
use crate::library::{Functions, last_warning};
use crate::{Model, MujocoError};

/// The three warnings that tell of numbers that are not finite or too large: positions, velocities,
/// accelerations (`mjWARN_BADQPOS`, ...).
const BAD_NUMBERS: std::ops::Range<usize> = 4..7;

/// One simulation of a model.
pub struct Data {
    model: Model,
    pointer: NonNull<c_void>,
}

// SAFETY: the library keeps nothing of a simulation outside of its data.
unsafe impl Send for Data {}

impl Drop for Data {
    fn drop(&mut self) {
        // SAFETY: the pointer came from `mj_makeData`.
        unsafe { (self.functions().mj_deleteData)(self.pointer.as_ptr()) }
    }
}

/// Reads and writes of whole arrays.
macro_rules! arrays {
    ($($(#[$doc:meta])* $read:ident $(/ $write:ident)?: $field:ident, $length:expr;)*) => {
        impl Data {
            $(
                $(#[$doc])*
                #[must_use]
                pub fn $read(&self) -> &[f64] {
                    let length: fn(&Model) -> usize = $length;
                    // SAFETY: the field points to this many doubles (`mjdata.h`).
                    unsafe { std::slice::from_raw_parts(self.field(self.layout().$field), length(&self.model)) }
                }
                $(
                    /// The same, to be written.
                    pub fn $write(&mut self) -> &mut [f64] {
                        let length: fn(&Model) -> usize = $length;
                        // SAFETY: as above, and the borrow is exclusive.
                        unsafe { std::slice::from_raw_parts_mut(self.field(self.layout().$field), length(&self.model)) }
                    }
                )?
            )*
        }
    };
}

arrays! {
    /// Generalised coordinates.
    qpos / qpos_mut: qpos, Model::nq;
    /// Velocities of the degrees of freedom.
    qvel / qvel_mut: qvel, Model::nv;
    /// Controls of the actuators.
    ctrl / ctrl_mut: ctrl, Model::nu;
    /// Accelerations that the solver of constraints starts from in the next step: those of the step before, or zeros.
    qacc_warmstart / qacc_warmstart_mut: qacc_warmstart, Model::nv;
    /// Gravity, Coriolis and centrifugal forces on the degrees of freedom.
    qfrc_bias: qfrc_bias, Model::nv;
    /// Positions of all sites in the world, three numbers each.
    site_xpos: site_xpos, |model| 3 * model.sites();
    /// Rotations of all sites in the world, nine numbers each, row by row.
    site_xmat: site_xmat, |model| 9 * model.sites();
    /// Positions of all bodies in the world, three numbers each.
    xpos: xpos, |model| 3 * model.bodies();
    /// Rotations of all bodies in the world as quaternions `w, x, y, z`.
    xquat: xquat, |model| 4 * model.bodies();
}

impl Data {
    /// A simulation in the model's initial state.
    ///
    /// # Errors
    /// When there is no memory.
    pub fn new(model: &Model) -> Result<Self, MujocoError> {
        // SAFETY: the model is whole.
        let pointer = unsafe { (model.library().functions().mj_makeData)(model.pointer()) };
        Ok(Self {
            model: model.clone(),
            pointer: NonNull::new(pointer).ok_or(MujocoError::Memory)?,
        })
    }

    /// Its model.
    #[must_use]
    pub fn model(&self) -> &Model {
        &self.model
    }

    pub(crate) fn pointer(&self) -> *mut c_void {
        self.pointer.as_ptr()
    }

    fn functions(&self) -> &Functions {
        self.model.library().functions()
    }

    fn layout(&self) -> &'static Layout {
        self.model.library().version().layout()
    }

    /// The pointer that a field holds.
    fn field(&self, offset: usize) -> *mut f64 {
        // SAFETY: fields of the layout are pointers to doubles, set when the data were made and never changed.
        unsafe { self.pointer().byte_add(offset).cast::<*mut f64>().read() }
    }

    /// Simulated time, in seconds.
    #[must_use]
    pub fn time(&self) -> f64 {
        // SAFETY: the field is a double.
        unsafe { self.pointer().byte_add(self.layout().time).cast::<f64>().read() }
    }

    /// Sets the simulated time.
    pub fn set_time(&mut self, time: f64) {
        // SAFETY: the field is a double.
        unsafe { self.pointer().byte_add(self.layout().time).cast::<f64>().write(time) }
    }

    /// Everything as when it was made (`mj_resetData`).
    pub fn reset(&mut self) {
        // SAFETY: data and model belong together.
        unsafe { (self.functions().mj_resetData)(self.model.pointer(), self.pointer()) }
    }

    /// Everything that follows from positions, velocities and controls (`mj_forward`).
    pub fn forward(&mut self) {
        // SAFETY: data and model belong together.
        unsafe { (self.functions().mj_forward)(self.model.pointer(), self.pointer()) }
    }

    /// One step (`mj_step`).
    pub fn step(&mut self) {
        // SAFETY: data and model belong together.
        unsafe { (self.functions().mj_step)(self.model.pointer(), self.pointer()) }
    }

    /// Everything that follows from positions (`mj_fwdPosition`), then what follows from velocities too (`mj_fwdVelocity`):
    /// the first part of [`Data::forward`] and of [`Data::step`], without sensors.
    pub fn motion_stages(&mut self) {
        // SAFETY: data and model belong together.
        unsafe {
            (self.functions().mj_fwdPosition)(self.model.pointer(), self.pointer());
            (self.functions().mj_fwdVelocity)(self.model.pointer(), self.pointer());
        }
    }

    /// Divides every quaternion of generalised coordinates by its length (`mj_normalizeQuat`), as MuJoCo 2.3.7 does with those
    /// of a state wherever it computes poses. Once need not be enough: a quaternion of length 1 may change in its last bits.
    ///
    /// # Panics
    /// When there are not [`Model::nq`] coordinates.
    pub fn normalize_quaternions(&self, coordinates: &mut [f64]) {
        assert!(coordinates.len() == self.model.nq());
        // SAFETY: the slice holds all coordinates.
        unsafe { (self.functions().mj_normalizeQuat)(self.model.pointer(), coordinates.as_mut_ptr()) }
    }

    /// Actuation, acceleration and constraint forces (`mj_fwdActuation`, `mj_fwdAcceleration`, `mj_fwdConstraint`): the second
    /// part of [`Data::forward`], without sensors. It may be repeated with other controls while the state stays; every time it
    /// warm-starts the solver with its last result.
    pub fn force_stages(&mut self) {
        // SAFETY: data and model belong together.
        unsafe {
            (self.functions().mj_fwdActuation)(self.model.pointer(), self.pointer());
            (self.functions().mj_fwdAcceleration)(self.model.pointer(), self.pointer());
            (self.functions().mj_fwdConstraint)(self.model.pointer(), self.pointer());
        }
    }

    /// Moves on by one step of semi-implicit Euler integration, with the accelerations as they are (`mj_Euler`).
    pub fn euler(&mut self) {
        // SAFETY: data and model belong together.
        unsafe { (self.functions().mj_Euler)(self.model.pointer(), self.pointer()) }
    }

    /// Jacobians of a site: translation and rotation, three rows of [`Model::nv`] numbers each.
    ///
    /// # Panics
    /// When a slice has another length.
    pub fn jacobian(&self, site: usize, translation: &mut [f64], rotation: &mut [f64]) {
        let length = 3 * self.model.nv();
        assert!(translation.len() == length && rotation.len() == length && site < self.model.sites());
        // SAFETY: both slices hold three rows, and the site exists.
        unsafe {
            (self.functions().mj_jacSite)(
                self.model.pointer(),
                self.pointer(),
                translation.as_mut_ptr(),
                rotation.as_mut_ptr(),
                site as c_int,
            );
        }
    }

    /// The inertia matrix, [`Model::nv`] rows of as many numbers.
    ///
    /// # Panics
    /// When the slice has another length.
    pub fn inertia(&self, matrix: &mut [f64]) {
        let nv = self.model.nv();
        assert!(matrix.len() == nv * nv);
        // SAFETY: the slice holds the whole matrix, and `qM` is the packed one of this data.
        unsafe { (self.functions().mj_fullM)(self.model.pointer(), matrix.as_mut_ptr(), self.field(self.layout().q_m)) }
    }

    /// The library's warning when the simulation came to numbers that are not finite or too large, after which the library
    /// has reset it. `None` while all is well.
    #[must_use]
    pub fn diverged(&self) -> Option<String> {
        // SAFETY: the field is an array of `mjWarningStat`, two `int`s each: the last information, and the count.
        let counts = unsafe {
            let start = self.pointer().byte_add(self.layout().warning).cast::<[c_int; 2]>();
            std::slice::from_raw_parts(start, BAD_NUMBERS.end)
        };
        counts[BAD_NUMBERS]
            .iter()
            .any(|[_, count]| *count > 0)
            .then(last_warning)
    }
}
