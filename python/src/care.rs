//! Care of clouds: outliers, normals, thinning, averaging.

use crate::cloud::{Cloud, cloud_of};
use crate::convert::Out;
use crate::errors::{OrRaise, input};
use crate::fits::sensor;
use pyo3::prelude::*;
use uwscan::cloud::{
    NORMAL_NEIGHBOURS, averaged, normals, sheet_outliers, sparse_outliers, thinned, thinned_by_curvature,
};

/// Lengths that cubes may have, mm.
const LENGTHS_MM: std::ops::RangeInclusive<f64> = 1e-6..=1e6;

fn length(py: Python<'_>, name: &str, mm: f64) -> PyResult<f64> {
    if LENGTHS_MM.contains(&mm) {
        return Ok(mm);
    }
    Err(input(py, format!("{name} must be from 1e-6 to 1e6, got {mm}")))
}

/// Which points are no part of a surface: those that lie apart from all others, and those of a sweep that their neighbours in line and voltage
/// disagree with.
///
/// A point lies apart where the mean distance of its twelve nearest neighbours is larger than the median of all points' by more than
/// `limit_sigmas` robust standard deviations, both as logarithms. A sweep's point disagrees where it lies off the plane through those that
/// hang together with it by more than `limit_sigmas` standard deviations, or hangs together with fewer than two; that needs a cloud with
/// pixels, frames and sigmas, and of another only the first is asked.
///
/// Parameters
/// ----------
/// cloud : Cloud or array_like
///     Points, (n, 3), mm.
/// limit_sigmas : float, default 5
///     From 1 to 100.
///
/// Returns
/// -------
/// numpy.ndarray
///     (n,) bool: ``cloud.select(~found)`` is what is left.
///
/// Raises
/// ------
/// InputError
///     For positions that are not finite, or a limit out of range.
///
/// Examples
/// --------
/// >>> import numpy as np, uwscan
/// >>> x, y = np.meshgrid(np.arange(20.0), np.arange(20.0))
/// >>> points = np.stack([x, y, np.full_like(x, 700.0)], axis=-1).reshape(-1, 3)
/// >>> points[7, 2] -= 40
/// >>> np.flatnonzero(uwscan.find_outliers(points)).tolist()
/// [7]
#[pyfunction]
#[pyo3(signature = (
    cloud: "Cloud | numpy.typing.ArrayLike", *, limit_sigmas = 5.0,
) -> "numpy.typing.NDArray[numpy.bool_]")]
pub fn find_outliers<'py>(
    py: Python<'py>,
    cloud: &Bound<'py, PyAny>,
    limit_sigmas: f64,
) -> PyResult<Out<'py, bool>> {
    if !(1.0..=100.0).contains(&limit_sigmas) {
        return Err(input(py, format!("limit_sigmas must be from 1 to 100, got {limit_sigmas}")));
    }
    let cloud = cloud_of(cloud, None, None)?;
    let found = py.detach(|| {
        let mut found = sparse_outliers(&cloud, limit_sigmas)?;
        if let Some(off) = sheet_outliers(&cloud, limit_sigmas) {
            found.iter_mut().zip(off).for_each(|(found, off)| *found |= off);
        }
        Ok::<_, uwscan::cloud::CloudError>(found)
    });
    Ok(Out::of(py, found.or_raise(py)?))
}

/// The cloud with the surface's unit normal at each point, towards the sensor, from the plane through its neighbours.
///
/// Parameters
/// ----------
/// cloud : Cloud or array_like
///     Points, (n, 3), mm.
/// neighbours : int, default 24
///     Points that a plane is laid through, 4 to 1000; four times as many are asked where these lie on one line.
/// sensor_mm : array_like, optional
///     The sensor's place in the points' frame, (3,), mm; the origin by default.
///
/// Returns
/// -------
/// Cloud
///     With ``normals``; (0, 0, 0) where the neighbours tell no plane.
///
/// Raises
/// ------
/// InputError
///     For positions that are not finite, or a number of neighbours out of range.
///
/// Examples
/// --------
/// >>> import numpy as np, uwscan
/// >>> x, y = np.meshgrid(np.arange(9.0), np.arange(9.0))
/// >>> cloud = uwscan.estimate_normals(np.stack([x, y, np.full_like(x, 700.0)], axis=-1).reshape(-1, 3))
/// >>> bool(np.all(np.abs(cloud.normals - [0, 0, -1]) < 1e-6))
/// True
#[pyfunction]
#[pyo3(signature = (
    cloud: "Cloud | numpy.typing.ArrayLike",
    *,
    neighbours = NORMAL_NEIGHBOURS,
    sensor_mm: "numpy.typing.ArrayLike | None" = None,
) -> "Cloud")]
pub fn estimate_normals(
    py: Python<'_>,
    cloud: &Bound<'_, PyAny>,
    neighbours: usize,
    sensor_mm: Option<&Bound<'_, PyAny>>,
) -> PyResult<Cloud> {
    if !(4..=1000).contains(&neighbours) {
        return Err(input(py, format!("neighbours must be from 4 to 1000, got {neighbours}")));
    }
    let sensor_mm = sensor(sensor_mm)?;
    let cloud = cloud_of(cloud, None, None)?;
    let made = py.detach(|| {
        let found = normals(&cloud, neighbours, &sensor_mm)?;
        let stored = found.into_iter().map(|n| n.map_or([0.0; 3], |n| n.map(|c| c as f32))).collect();
        cloud.with_normals(stored)
    });
    Ok(Cloud::of(made.or_raise(py)?))
}

/// Fewer points of a cloud, as they are: about one in each cube, or few where the surface is flat and many where it bends.
///
/// Parameters
/// ----------
/// cloud : Cloud or array_like
///     Points, (n, 3), mm.
/// spacing_mm : float, optional
///     Edge of the cubes, mm: of each, the point nearest to the middle of its points is kept.
/// flat_mm : float, optional
///     Instead of that: points are left out that lie within this distance of the surface through those that are kept, mm.
///
/// Returns
/// -------
/// Cloud
///     With all attributes, in the order of the points.
///
/// Raises
/// ------
/// InputError
///     Unless one of the two lengths is given, from 1e-6 to 1e6; for positions that are not finite.
///
/// Examples
/// --------
/// >>> import numpy as np, uwscan
/// >>> x, y = np.meshgrid(np.arange(20.0), np.arange(20.0))
/// >>> points = np.stack([x, y, np.full_like(x, 700.0)], axis=-1).reshape(-1, 3)
/// >>> len(uwscan.thin(points, spacing_mm=5.0)), len(uwscan.thin(points, flat_mm=0.1)) < 20
/// (16, True)
#[pyfunction]
#[pyo3(signature = (
    cloud: "Cloud | numpy.typing.ArrayLike", *, spacing_mm = None, flat_mm = None,
) -> "Cloud")]
pub fn thin(
    py: Python<'_>,
    cloud: &Bound<'_, PyAny>,
    spacing_mm: Option<f64>,
    flat_mm: Option<f64>,
) -> PyResult<Cloud> {
    let cloud = cloud_of(cloud, None, None)?;
    cloud.check_finite().or_raise(py)?;
    let kept = match (spacing_mm, flat_mm) {
        (Some(mm), None) => {
            let mm = length(py, "spacing_mm", mm)?;
            py.detach(|| thinned(&cloud, mm))
        }
        (None, Some(mm)) => {
            let mm = length(py, "flat_mm", mm)?;
            py.detach(|| thinned_by_curvature(&cloud, mm))
        }
        _ => return Err(input(py, "give spacing_mm or flat_mm")),
    };
    Ok(Cloud::of(cloud.selected(&kept)))
}

/// The cloud with the points of each cube made one, at their mean.
///
/// Covariances are those of the means: points of one image are neighbours on a stripe, and no number of them is better than their mean
/// covariance; those of different images err each on its own, but for what all points share. What points scatter by beyond that is added along their normal.
///
/// Parameters
/// ----------
/// cloud : Cloud or array_like
///     Points, (n, 3), mm.
/// spacing_mm : float
///     Edge of the cubes, mm.
///
/// Returns
/// -------
/// Cloud
///     Intensities are means, frames and pixels those of the point nearest to the middle; normals and deviations are left out.
///
/// Raises
/// ------
/// InputError
///     For a length that is not from 1e-6 to 1e6; for positions that are not finite.
///
/// Examples
/// --------
/// >>> import uwscan
/// >>> uwscan.average([[0, 0, 700], [0.2, 0, 700.1], [30, 0, 700]], spacing_mm=1.0).points_mm.tolist()
/// [[0.1, 0.0, 700.05], [30.0, 0.0, 700.0]]
#[pyfunction]
#[pyo3(signature = (cloud: "Cloud | numpy.typing.ArrayLike", *, spacing_mm) -> "Cloud")]
pub fn average(py: Python<'_>, cloud: &Bound<'_, PyAny>, spacing_mm: f64) -> PyResult<Cloud> {
    let mm = length(py, "spacing_mm", spacing_mm)?;
    let cloud = cloud_of(cloud, None, None)?;
    cloud.check_finite().or_raise(py)?;
    Ok(Cloud::of(py.detach(|| averaged(&cloud, mm))))
}
