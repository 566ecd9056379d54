//! A window.

use super::{Rays, each, medium, rays, six};
use crate::convert::{Out, triple};
use crate::errors::OrRaise;
use nalgebra::Vector3;
use pyo3::prelude::*;
use uwscan::geom::{self, Medium};

/// A flat glass window between air inside and a medium outside. Lengths are along its normal, from the centre of projection behind it.
///
/// Parameters
/// ----------
/// normal : array_like
///     Unit normal outwards, (3,), camera frame.
/// distance_mm : float
///     Centre of projection to the inner face, mm.
/// thickness_mm : float
///     Thickness of the glass, mm.
/// index : float
///     Index of refraction of the glass, relative to air.
///
/// Raises
/// ------
/// GeometryError
///     For a normal that is not of length 1, a negative length, an index below 1.
///
/// Examples
/// --------
/// >>> import uwscan
/// >>> port = uwscan.Port([0, 0, 1], 10.0, 8.0, 1.5195)
/// >>> origins, directions = port.back_project([[0.0, 0.0, 1.0]], index=1.335)
/// >>> origins.tolist(), directions.tolist()
/// ([[0.0, 0.0, 18.0]], [[0.0, 0.0, 1.0]])
#[pyclass(module = "uwscan", frozen)]
#[derive(Clone)]
pub struct Port {
    pub inner: geom::Port,
}

#[pymethods]
impl Port {
    #[new]
    #[pyo3(signature = (normal: "numpy.typing.ArrayLike", distance_mm, thickness_mm, index))]
    fn new(normal: &Bound<'_, PyAny>, distance_mm: f64, thickness_mm: f64, index: f64) -> PyResult<Self> {
        let inner = geom::Port::new(
            triple("normal", normal)?.into(),
            distance_mm,
            thickness_mm,
            Medium::of_index(index),
        );
        Ok(Self { inner: inner.or_raise(normal.py())? })
    }

    /// Unit normal outwards, (3,) float64, camera frame.
    #[getter]
    fn normal<'py>(&self, py: Python<'py>) -> Out<'py, f64> {
        Out::of(py, self.inner.normal.as_slice().to_vec())
    }

    /// Centre of projection to the inner face, mm.
    #[getter]
    fn distance_mm(&self) -> f64 {
        self.inner.distance_mm
    }

    /// Thickness of the glass, mm.
    #[getter]
    fn thickness_mm(&self) -> f64 {
        self.inner.thickness_mm
    }

    /// Index of refraction of the glass, relative to air.
    #[getter]
    fn index(&self) -> f64 {
        self.inner.glass.index
    }

    /// Directions in air in which light leaves the centre of projection to reach points outside: exact through both faces.
    ///
    /// Parameters
    /// ----------
    /// points_mm : array_like
    ///     (n, 3), mm, from the centre of projection.
    /// index : float
    ///     Index of refraction outside, relative to air.
    ///
    /// Returns
    /// -------
    /// numpy.ndarray
    ///     (n, 3) float64, not of length 1; NaN for points that are not outside the window.
    #[pyo3(signature = (points_mm: "numpy.typing.ArrayLike", *, index) -> "numpy.typing.NDArray[numpy.float64]")]
    fn project<'py>(&self, points_mm: &Bound<'py, PyAny>, index: f64) -> PyResult<Out<'py, f64>> {
        let py = points_mm.py();
        let outside = medium(py, index)?;
        let centre = Vector3::zeros();
        let one = |p| Ok(self.inner.air_direction(&centre, &Vector3::from(p), outside)?.into());
        Out::rows::<3>(py, each::<3, 3>("points_mm", points_mm, one)?)
    }

    /// Rays outside that leave the centre of projection with directions in air.
    ///
    /// Parameters
    /// ----------
    /// directions : array_like
    ///     (n, 3), any length.
    /// index : float
    ///     Index of refraction outside, relative to air.
    ///
    /// Returns
    /// -------
    /// origins_mm, directions : numpy.ndarray
    ///     (n, 3) float64 each: points on the outer face, mm, and unit directions; NaN where no ray gets out.
    #[pyo3(signature = (directions: "numpy.typing.ArrayLike", *, index) -> "tuple[numpy.typing.NDArray[numpy.float64], numpy.typing.NDArray[numpy.float64]]")]
    fn back_project<'py>(&self, directions: &Bound<'py, PyAny>, index: f64) -> PyResult<Rays<'py>> {
        let py = directions.py();
        let outside = medium(py, index)?;
        let centre = Vector3::zeros();
        rays(
            py,
            each::<3, 6>("directions", directions, |d| {
                Ok(six(&self.inner.ray_out(&centre, &Vector3::from(d), outside)?))
            })?,
        )
    }

    fn __repr__(&self) -> String {
        let p = &self.inner;
        let [x, y, z]: [f64; 3] = p.normal.into();
        format!(
            "Port(normal=[{x:.6}, {y:.6}, {z:.6}], distance_mm={:.4}, thickness_mm={:.4}, index={:.5})",
            p.distance_mm, p.thickness_mm, p.glass.index
        )
    }
}
