//! A camera alone, from photographs.

use crate::capture::path_of;
use crate::convert::Out;
use crate::errors::{OrRaise, warn};
use crate::long;
use crate::model::Camera;
use pyo3::prelude::*;
use pyo3::types::PyDict;
use uwscan::calib::{PINHOLE_NAMES, PinholeOptions};
use uwscan::pipeline::camera::{self as photographs, Photographed};

/// A camera in air from photographs of a chessboard, and how well they determine it.
///
/// Made by ``uwscan.calibrate_camera``.
#[pyclass(module = "uwscan", frozen)]
pub struct CameraFit {
    inner: Photographed,
}

#[pymethods]
impl CameraFit {
    /// The camera, for the exact model: ``project``, ``back_project``.
    #[getter]
    fn camera(&self) -> Camera {
        Camera { inner: self.inner.pinhole.camera }
    }

    /// K, (3, 3) float64, px.
    #[getter]
    fn camera_matrix<'py>(&self, py: Python<'py>) -> PyResult<Out<'py, f64>> {
        let c = &self.inner.pinhole.camera;
        Out::matrix(py, &[[c.fx, 0.0, c.cx], [0.0, c.fy, c.cy], [0.0, 0.0, 1.0]])
    }

    /// (k1, k2, p1, p2, k3), (5,) float64, as OpenCV has them.
    #[getter]
    fn distortion<'py>(&self, py: Python<'py>) -> Out<'py, f64> {
        let d = &self.inner.pinhole.camera.distortion;
        Out::of(py, vec![d.k1, d.k2, d.p1, d.p2, d.k3])
    }

    /// Standard deviations by name: fx, fy, cx, cy (px), k1, k2, p1, p2, k3.
    #[getter]
    fn sigmas<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let sigmas = PyDict::new(py);
        for (name, sigma) in PINHOLE_NAMES.iter().zip(self.inner.pinhole.sigmas()) {
            sigmas.set_item(name, sigma)?;
        }
        Ok(sigmas)
    }

    /// Covariance of the camera's figures in the order of ``sigmas``, (9, 9) float64.
    #[getter]
    fn covariance<'py>(&self, py: Python<'py>) -> PyResult<Out<'py, f64>> {
        Out::dense(py, &self.inner.pinhole.covariance)
    }

    /// Root mean square distance between corners seen and predicted, px, outliers left out.
    #[getter]
    fn rms_px(&self) -> f64 {
        self.inner.pinhole.rms_px
    }

    /// The same of each image of ``files``.
    #[getter]
    fn image_rms_px<'py>(&self, py: Python<'py>) -> Out<'py, f64> {
        Out::of(py, self.inner.pinhole.view_rms_px.clone())
    }

    /// The images that show the board.
    #[getter]
    fn files(&self) -> Vec<String> {
        self.inner.files.clone()
    }

    /// Images that were left out, and why.
    #[getter]
    fn rejected(&self) -> Vec<(String, String)> {
        let rejected = self.inner.notes.rejected.iter();
        rejected.map(|one| (one.file.clone(), one.reason.clone())).collect()
    }

    /// Width and height of the images, px.
    #[getter]
    fn image_size(&self) -> (u32, u32) {
        self.inner.image_size.into()
    }

    /// Corners of one of ``files``: (n, 4) float64, (u, v) as seen and (u, v) as predicted, px.
    ///
    /// Raises
    /// ------
    /// IndexError
    ///     Where there is no such image.
    fn corners<'py>(&self, py: Python<'py>, image: usize) -> PyResult<Out<'py, f64>> {
        let corners = self.inner.corners.get(image).ok_or_else(|| {
            let count = self.inner.files.len();
            pyo3::exceptions::PyIndexError::new_err(format!("there are {count} images, counted from 0"))
        })?;
        let rows: Vec<[f64; 4]> = corners.iter().map(|[[u, v], [x, y]]| [*u, *v, *x, *y]).collect();
        Out::rows::<4>(py, rows)
    }

    fn __repr__(&self) -> String {
        let c = &self.inner.pinhole.camera;
        let (n, rms_px) = (self.inner.files.len(), self.rms_px());
        format!("CameraFit(fx={:.2}, fy={:.2}, images={n}, rms_px={rms_px:.3})", c.fx, c.fy)
    }
}

/// A camera alone, from photographs of a chessboard on land: a pinhole with Brown-Conrady distortion, as OpenCV's ``calibrateCamera`` has it. For a
/// camera without a window, or to compare with other programs; the whole instrument, under water too, is ``uwscan.calibrate``'s.
///
/// Parameters
/// ----------
/// capture : Capture or path
///     A capture of kind "calibration", in air; its images without the laser are looked at. It needs no rig.toml.
/// equal_focal : bool, default False
///     The pixels are square: fx = fy.
/// k3 : bool, default True
///     Whether k3 is estimated; else it is 0.
/// threads : int, optional
///     Threads to work on; one a processor by default. The result does not depend on it.
/// progress : callable, optional
///     As ``uwscan.calibrate`` has it.
///
/// Returns
/// -------
/// CameraFit
///
/// Raises
/// ------
/// CalibrationError
///     Where the images determine no camera; it says what is missing.
/// CaptureError, FileError, FormatError
///     Where the capture is no calibration's in air, shows no board, or a file is wrong.
///
/// Examples
/// --------
/// >>> import uwscan
/// >>> fit = uwscan.calibrate_camera("fixtures/photographs", equal_focal=True)
/// >>> len(fit.files), bool(abs(fit.camera_matrix[0, 0] - 533.5) < 2.0)
/// (13, True)
#[pyfunction]
#[pyo3(signature = (
    capture: "Capture | str | os.PathLike[str]",
    *,
    equal_focal = false,
    k3 = true,
    threads = None,
    progress: "collections.abc.Callable[[str, int, int], object] | typing.Literal[False] | None" = None,
) -> "CameraFit")]
pub fn calibrate_camera(
    py: Python<'_>,
    capture: &Bound<'_, PyAny>,
    equal_focal: bool,
    k3: bool,
    threads: Option<usize>,
    progress: Option<&Bound<'_, PyAny>>,
) -> PyResult<CameraFit> {
    let path = path_of("capture", capture)?;
    let options = PinholeOptions { equal_focal, without_k3: !k3 };
    let made =
        long::run(py, threads, progress, |progress| photographs::calibrate_camera(&path, options, progress))?;
    let inner = made.or_raise(py)?;
    warn(py, &inner.notes.problems, &[])?;
    Ok(CameraFit { inner })
}
