//! The camera in air.

use super::each;
use crate::convert::{Out, floats, row_arrays, table};
use crate::errors::input;
use nalgebra::{Vector2, Vector3};
use pyo3::prelude::*;
use uwscan::geom::{self, Distortion};

/// A pinhole camera in air with Brown–Conrady distortion (OpenCV's). Pixel (0, 0) is the centre of the top-left pixel.
///
/// Parameters
/// ----------
/// camera_matrix : array_like
///     K, (3, 3), px; without skew.
/// distortion : array_like, optional
///     (k1, k2, p1, p2[, k3]); none by default.
///
/// Raises
/// ------
/// InputError
///     For a matrix that is none of a camera's.
///
/// Examples
/// --------
/// >>> import uwscan
/// >>> camera = uwscan.Camera([[1400, 0, 384], [0, 1400, 288], [0, 0, 1]])
/// >>> camera.project([[0.1, 0.0, 1.0]]).tolist()
/// [[524.0, 288.0]]
#[pyclass(module = "uwscan", frozen)]
#[derive(Clone)]
pub struct Camera {
    pub inner: geom::Camera,
}

#[pymethods]
impl Camera {
    #[new]
    #[pyo3(signature = (camera_matrix: "numpy.typing.ArrayLike", distortion: "numpy.typing.ArrayLike | None" = None))]
    fn new(camera_matrix: &Bound<'_, PyAny>, distortion: Option<&Bound<'_, PyAny>>) -> PyResult<Self> {
        let py = camera_matrix.py();
        let rows: Vec<[f64; 3]> = row_arrays(&table("camera_matrix", camera_matrix, 3)?);
        let [[fx, skew, cx], [zero, fy, cy], last] = rows[..] else {
            return Err(input(
                py,
                format!("camera_matrix must have the shape (3, 3), got ({}, 3)", rows.len()),
            ));
        };
        let none = |v: f64| v.abs() < f64::EPSILON;
        let scale = none(last[0]) && none(last[1]) && none(last[2] - 1.0);
        let whole = [fx, fy, cx, cy].iter().all(|v| v.is_finite()) && fx > 0.0 && fy > 0.0;
        if !(none(skew) && none(zero) && scale && whole) {
            let what = "camera_matrix must be [[fx, 0, cx], [0, fy, cy], [0, 0, 1]] with positive fx and fy";
            return Err(input(py, what));
        }
        let mut d = Distortion::none();
        if let Some(any) = distortion {
            let given: Vec<f64> = floats("distortion", any)?.as_array().iter().copied().collect();
            match given[..] {
                [k1, k2, p1, p2] => d = Distortion { k1, k2, p1, p2, k3: 0.0 },
                [k1, k2, p1, p2, k3] => d = Distortion { k1, k2, p1, p2, k3 },
                [] => {}
                _ => {
                    return Err(input(
                        py,
                        format!("distortion must have 4 or 5 numbers, got {}", given.len()),
                    ));
                }
            }
            if !given.iter().all(|v| v.is_finite()) {
                return Err(input(py, "distortion must be finite"));
            }
        }
        Ok(Self { inner: geom::Camera { fx, fy, cx, cy, distortion: d } })
    }

    /// K, (3, 3) float64, px.
    #[getter]
    fn camera_matrix<'py>(&self, py: Python<'py>) -> PyResult<Out<'py, f64>> {
        let c = &self.inner;
        Out::matrix(py, &[[c.fx, 0.0, c.cx], [0.0, c.fy, c.cy], [0.0, 0.0, 1.0]])
    }

    /// (k1, k2, p1, p2, k3), (5,) float64.
    #[getter]
    fn distortion<'py>(&self, py: Python<'py>) -> Out<'py, f64> {
        let d = &self.inner.distortion;
        Out::of(py, vec![d.k1, d.k2, d.p1, d.p2, d.k3])
    }

    /// Pixels at which light from directions in air (or from points in air, with the camera at the origin) is seen.
    ///
    /// Parameters
    /// ----------
    /// directions : array_like
    ///     (n, 3), camera frame, any length.
    ///
    /// Returns
    /// -------
    /// numpy.ndarray
    ///     (u, v), (n, 2) float64, px; NaN for what is not in front of the camera.
    #[pyo3(signature = (directions: "numpy.typing.ArrayLike") -> "numpy.typing.NDArray[numpy.float64]")]
    fn project<'py>(&self, py: Python<'py>, directions: &Bound<'py, PyAny>) -> PyResult<Out<'py, f64>> {
        let made = each("directions", directions, |d| Ok(self.inner.project(&Vector3::from(d))?.into()))?;
        Out::rows::<2>(py, made)
    }

    /// Directions in air from which light at pixels arrives.
    ///
    /// Parameters
    /// ----------
    /// pixels : array_like
    ///     (u, v), (n, 2), px.
    ///
    /// Returns
    /// -------
    /// numpy.ndarray
    ///     (n, 3) float64, camera frame, z = 1; NaN where the distortion can't be undone.
    #[pyo3(signature = (pixels: "numpy.typing.ArrayLike") -> "numpy.typing.NDArray[numpy.float64]")]
    fn back_project<'py>(&self, py: Python<'py>, pixels: &Bound<'py, PyAny>) -> PyResult<Out<'py, f64>> {
        let made = each("pixels", pixels, |p| Ok(self.inner.unproject(&Vector2::from(p))?.into()))?;
        Out::rows::<3>(py, made)
    }

    fn __repr__(&self) -> String {
        let c = &self.inner;
        format!("Camera(fx={:.3}, fy={:.3}, cx={:.3}, cy={:.3})", c.fx, c.fy, c.cx, c.cy)
    }
}
