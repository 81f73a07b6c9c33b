//! One simulation of a model.

use std::ffi::{c_int, c_void};
use std::ptr::NonNull;

use crate::layout::Layout;
use crate::library::{Functions, last_warning};
use crate::{Model, MujocoError};

/// The indices of the three warnings about numbers that are not finite or too large: in positions, velocities and accelerations
/// (`mjWARN_BADQPOS`, `mjWARN_BADQVEL`, `mjWARN_BADQACC`).
const BAD_NUMBERS: std::ops::Range<usize> = 4..7;

/// One simulation of a model.
pub struct Data {
    model: Model,
    pointer: NonNull<c_void>,
}

// SAFETY: the library keeps the whole state of a simulation in its `mjData`.
unsafe impl Send for Data {}

impl Drop for Data {
    fn drop(&mut self) {
        // SAFETY: the pointer came from `mj_makeData`.
        unsafe { (self.functions().mj_deleteData)(self.pointer.as_ptr()) }
    }
}

/// Defines accessors for whole arrays of `mjData`.
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
                    /// Mutable access to the same array.
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
    /// Generalised coordinates (`qpos`).
    qpos / qpos_mut: qpos, Model::nq;
    /// Velocities of the degrees of freedom (`qvel`).
    qvel / qvel_mut: qvel, Model::nv;
    /// Controls of the actuators (`ctrl`).
    ctrl / ctrl_mut: ctrl, Model::nu;
    /// Accelerations from which the constraint solver starts in the next step: those of the previous step, or zeros.
    qacc_warmstart / qacc_warmstart_mut: qacc_warmstart, Model::nv;
    /// Gravity, Coriolis and centrifugal forces on the degrees of freedom.
    qfrc_bias: qfrc_bias, Model::nv;
    /// Positions (metres) of all sites in the world frame, three numbers each.
    site_xpos: site_xpos, |model| 3 * model.sites();
    /// Rotation matrices of all sites in the world frame, nine numbers each, in row-major order.
    site_xmat: site_xmat, |model| 9 * model.sites();
    /// Positions (metres) of all bodies in the world frame, three numbers each.
    xpos: xpos, |model| 3 * model.bodies();
    /// Orientations of all bodies in the world frame as quaternions `w, x, y, z`.
    xquat: xquat, |model| 4 * model.bodies();
}

impl Data {
    /// Makes a simulation in the model's initial state.
    ///
    /// # Errors
    /// If there is not enough memory.
    pub fn new(model: &Model) -> Result<Self, MujocoError> {
        // SAFETY: the pointer is that of a valid model.
        let pointer = unsafe { (model.library().functions().mj_makeData)(model.pointer()) };
        Ok(Self {
            model: model.clone(),
            pointer: NonNull::new(pointer).ok_or(MujocoError::Memory)?,
        })
    }

    /// The model of the simulation.
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

    /// The pointer in the field at this offset.
    fn field(&self, offset: usize) -> *mut f64 {
        // SAFETY: the fields that this is called for are pointers to doubles, which `mj_makeData` sets and nothing changes.
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

    /// Resets the simulation to the model's initial state (`mj_resetData`).
    pub fn reset(&mut self) {
        // SAFETY: data and model belong together.
        unsafe { (self.functions().mj_resetData)(self.model.pointer(), self.pointer()) }
    }

    /// Computes all quantities that depend on positions, velocities and controls (`mj_forward`).
    pub fn forward(&mut self) {
        // SAFETY: data and model belong together.
        unsafe { (self.functions().mj_forward)(self.model.pointer(), self.pointer()) }
    }

    /// Simulates one time step (`mj_step`).
    pub fn step(&mut self) {
        // SAFETY: data and model belong together.
        unsafe { (self.functions().mj_step)(self.model.pointer(), self.pointer()) }
    }

    /// Computes the quantities that depend on positions (`mj_fwdPosition`), then those that also depend on velocities
    /// (`mj_fwdVelocity`). This is the first part of [`Data::forward`] and [`Data::step`], without sensors.
    pub fn motion_stages(&mut self) {
        // SAFETY: data and model belong together.
        unsafe {
            (self.functions().mj_fwdPosition)(self.model.pointer(), self.pointer());
            (self.functions().mj_fwdVelocity)(self.model.pointer(), self.pointer());
        }
    }

    /// Normalises every quaternion in generalised coordinates (`mj_normalizeQuat`), as MuJoCo 2.3.7 does before it computes poses.
    /// The operation is not idempotent: normalising a quaternion of length 1 again may change its last bits.
    ///
    /// # Panics
    /// If the number of coordinates differs from [`Model::nq`].
    pub fn normalize_quaternions(&self, coordinates: &mut [f64]) {
        assert!(coordinates.len() == self.model.nq());
        // SAFETY: the slice contains all coordinates.
        unsafe { (self.functions().mj_normalizeQuat)(self.model.pointer(), coordinates.as_mut_ptr()) }
    }

    /// Computes actuation, acceleration and constraint forces (`mj_fwdActuation`, `mj_fwdAcceleration`, `mj_fwdConstraint`).
    /// This is the second part of [`Data::forward`], without sensors. It can be repeated with other controls in the same state.
    /// Each call warm-starts the solver with the result of the previous one.
    pub fn force_stages(&mut self) {
        // SAFETY: data and model belong together.
        unsafe {
            (self.functions().mj_fwdActuation)(self.model.pointer(), self.pointer());
            (self.functions().mj_fwdAcceleration)(self.model.pointer(), self.pointer());
            (self.functions().mj_fwdConstraint)(self.model.pointer(), self.pointer());
        }
    }

    /// Integrates one time step with the semi-implicit Euler method and the current accelerations (`mj_Euler`).
    pub fn euler(&mut self) {
        // SAFETY: data and model belong together.
        unsafe { (self.functions().mj_Euler)(self.model.pointer(), self.pointer()) }
    }

    /// Computes the Jacobians of a site for translation and rotation: three rows of [`Model::nv`] numbers each.
    ///
    /// # Panics
    /// If a slice has another length, or the site does not exist.
    pub fn jacobian(&self, site: usize, translation: &mut [f64], rotation: &mut [f64]) {
        let length = 3 * self.model.nv();
        assert!(translation.len() == length && rotation.len() == length && site < self.model.sites());
        // SAFETY: both slices have three rows, and the site exists.
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

    /// Computes the inertia matrix: [`Model::nv`] rows and columns.
    ///
    /// # Panics
    /// If the slice has another length.
    pub fn inertia(&self, matrix: &mut [f64]) {
        let nv = self.model.nv();
        assert!(matrix.len() == nv * nv);
        // SAFETY: the slice has the size of the whole matrix, and `qM` is the packed matrix of this simulation.
        unsafe { (self.functions().mj_fullM)(self.model.pointer(), matrix.as_mut_ptr(), self.field(self.layout().q_m)) }
    }

    /// The library's warning if the simulation reached numbers that are not finite or too large, after which the library resets
    /// it. `None` if that did not happen.
    #[must_use]
    pub fn diverged(&self) -> Option<String> {
        // SAFETY: the field is an array of `mjWarningStat`, which consist of two `int`s: the last information and the count.
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
