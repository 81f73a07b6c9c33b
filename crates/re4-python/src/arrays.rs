//! Conversion between numpy arrays and the types of the libraries.

use nalgebra::{Isometry3, Quaternion, Translation3, UnitQuaternion};
use numpy::{PyArray1, PyArray2, PyArrayMethods as _, PyReadonlyArray2};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

/// The rows of an array with `N` columns.
///
/// # Errors
/// If the array has another number of columns or is not contiguous.
pub(crate) fn rows<'a, const N: usize>(array: &'a PyReadonlyArray2<'_, f64>, name: &str) -> PyResult<&'a [[f64; N]]> {
    let wrong = || PyValueError::new_err(format!("{name} is not a contiguous array with {N} columns"));
    let numbers = array.as_slice().map_err(|_| wrong())?;
    let (rows, rest) = numbers.as_chunks();
    if rest.is_empty() && array.as_array().ncols() == N {
        Ok(rows)
    } else {
        Err(wrong())
    }
}

/// An array with one row for each item.
///
/// # Errors
/// If Python cannot allocate it.
pub(crate) fn table<const N: usize>(
    py: Python<'_>,
    rows: impl Iterator<Item = [f64; N]>,
) -> PyResult<Bound<'_, PyArray2<f64>>> {
    let numbers: Vec<f64> = rows.flatten().collect();
    let count = numbers.len() / N;
    PyArray1::from_vec(py, numbers).reshape([count, N])
}

/// Deviation of the squared length of a quaternion from 1 that rounding can cause.
const ROUNDING: f64 = 1e-12;

/// A pose from position (x, y, z) and quaternion (x, y, z, w). A quaternion of another length than 1 is normalized; one of unit length
/// keeps its bits. A quaternion without a direction gives a pose that is not finite, which the libraries refuse.
pub(crate) fn pose(numbers: &[f64; 7]) -> Isometry3<f64> {
    let [x, y, z, i, j, k, w] = *numbers;
    let quaternion = Quaternion::new(w, i, j, k);
    let rotation = if (quaternion.norm_squared() - 1.0).abs() < ROUNDING {
        UnitQuaternion::new_unchecked(quaternion)
    } else {
        UnitQuaternion::new_normalize(quaternion)
    };
    Isometry3::from_parts(Translation3::new(x, y, z), rotation)
}
