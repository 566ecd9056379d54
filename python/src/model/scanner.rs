//! The whole instrument.

use super::{Camera, Fan, Galvo, Port, Rays, each, medium, rays, six};
use crate::convert::{Out, column, row_arrays, table};
use nalgebra::{Vector2, Vector3};
use pyo3::prelude::*;
use uwscan::geom::{self, GeomError};

/// The whole instrument: camera, galvanometer and laser, each behind its window. Camera frame, millimetres; exact at both windows.
///
/// Parameters
/// ----------
/// camera : Camera
/// camera_port : Port
///     Seen from the optical centre.
/// galvo : Galvo
/// fan : Fan
/// laser_port : Port
///     Seen from the galvanometer frame's origin; its normal in the camera frame.
///
/// Examples
/// --------
/// >>> import numpy as np, uwscan
/// >>> camera = uwscan.Camera([[1400, 0, 384], [0, 1400, 288], [0, 0, 1]])
/// >>> port = uwscan.Port([0, 0, 1], 10.0, 8.0, 1.5195)
/// >>> frame = np.array([[0, 0.9002, -0.4355, 430], [-1, 0, 0, 0], [0, 0.4355, 0.9002, -13], [0, 0, 0, 1.0]])
/// >>> frame[:3, :3] = np.linalg.qr(frame[:3, :3])[0] * [-1, 1, 1]
/// >>> frame[:3, 0] = np.cross(frame[:3, 1], frame[:3, 2])
/// >>> galvo = uwscan.Galvo(frame, 2.0)
/// >>> scanner = uwscan.Scanner(camera, port, galvo, uwscan.Fan([0, 0, -90]), port)
/// >>> pixels = scanner.project([[10.0, 20.0, 800.0]], index=1.335)
/// >>> origins, directions = scanner.back_project(pixels, index=1.335)
/// >>> bool(np.linalg.norm(np.cross([10.0, 20.0, 800.0] - origins, directions)) < 1e-9)
/// True
#[pyclass(module = "uwscan", frozen)]
#[derive(Clone)]
pub struct Scanner {
    pub inner: geom::Scanner,
}

#[pymethods]
impl Scanner {
    #[new]
    fn new(
        camera: PyRef<'_, Camera>,
        camera_port: PyRef<'_, Port>,
        galvo: PyRef<'_, Galvo>,
        fan: PyRef<'_, Fan>,
        laser_port: PyRef<'_, Port>,
    ) -> Self {
        let inner = geom::Scanner {
            camera: camera.inner,
            camera_port: camera_port.inner,
            galvo: galvo.inner,
            fan: fan.inner,
            laser_port: laser_port.inner,
        };
        Self { inner }
    }

    /// The camera in air.
    #[getter]
    fn camera(&self) -> Camera {
        Camera { inner: self.inner.camera }
    }

    /// The camera's window, seen from the optical centre.
    #[getter]
    fn camera_port(&self) -> Port {
        Port { inner: self.inner.camera_port }
    }

    /// The galvanometer.
    #[getter]
    fn galvo(&self) -> Galvo {
        Galvo { inner: self.inner.galvo }
    }

    /// The laser's fan, galvanometer frame.
    #[getter]
    fn fan(&self) -> Fan {
        Fan { inner: self.inner.fan }
    }

    /// The laser's window, seen from the galvanometer frame's origin; normal in the camera frame.
    #[getter]
    fn laser_port(&self) -> Port {
        Port { inner: self.inner.laser_port }
    }

    /// Pixels at which the camera sees points outside its window.
    ///
    /// Parameters
    /// ----------
    /// points_mm : array_like
    ///     (n, 3), camera frame, mm.
    /// index : float
    ///     Index of refraction outside, relative to air (``uwscan.water_index``; 1 on land).
    ///
    /// Returns
    /// -------
    /// numpy.ndarray
    ///     (u, v), (n, 2) float64, px; NaN for points that it sees nowhere.
    #[pyo3(signature = (points_mm: "numpy.typing.ArrayLike", *, index) -> "numpy.typing.NDArray[numpy.float64]")]
    fn project<'py>(&self, points_mm: &Bound<'py, PyAny>, index: f64) -> PyResult<Out<'py, f64>> {
        let py = points_mm.py();
        let outside = medium(py, index)?;
        let one = |p| Ok(self.inner.project(&Vector3::from(p), outside)?.into());
        Out::rows::<2>(py, each::<3, 2>("points_mm", points_mm, one)?)
    }

    /// Rays outside the window that the camera sees at pixels.
    ///
    /// Parameters
    /// ----------
    /// pixels : array_like
    ///     (u, v), (n, 2), px.
    /// index : float
    ///     Index of refraction outside, relative to air.
    ///
    /// Returns
    /// -------
    /// origins_mm, directions : numpy.ndarray
    ///     (n, 3) float64 each, camera frame: points on the window's outer face, mm, and unit directions; NaN where there is no ray.
    #[pyo3(signature = (pixels: "numpy.typing.ArrayLike", *, index) -> "tuple[numpy.typing.NDArray[numpy.float64], numpy.typing.NDArray[numpy.float64]]")]
    fn back_project<'py>(&self, pixels: &Bound<'py, PyAny>, index: f64) -> PyResult<Rays<'py>> {
        let py = pixels.py();
        let outside = medium(py, index)?;
        let one = |p| Ok(six(&self.inner.pixel_ray(&Vector2::from(p), outside)?));
        rays(py, each::<2, 6>("pixels", pixels, one)?)
    }

    /// Points of the laser's sheet that are seen at pixels.
    ///
    /// Parameters
    /// ----------
    /// pixels : array_like
    ///     (u, v), (n, 2), px.
    /// voltage_v : array_like
    ///     The galvanometer's voltage, (n,) or one for all.
    /// index : float
    ///     Index of refraction outside, relative to air.
    ///
    /// Returns
    /// -------
    /// numpy.ndarray
    ///     (n, 3) float64, camera frame, mm; NaN where a pixel's ray does not meet the sheet.
    #[pyo3(signature = (
        pixels: "numpy.typing.ArrayLike", voltage_v: "numpy.typing.ArrayLike", *, index,
    ) -> "numpy.typing.NDArray[numpy.float64]")]
    fn triangulate<'py>(
        &self,
        pixels: &Bound<'py, PyAny>,
        voltage_v: &Bound<'py, PyAny>,
        index: f64,
    ) -> PyResult<Out<'py, f64>> {
        let py = pixels.py();
        Out::rows::<3>(
            py,
            self.meet::<3>(pixels, voltage_v, index, |exposure, pixel| {
                Ok(exposure.triangulate(pixel)?.into())
            })?,
        )
    }

    /// Points of the laser's sheet that are seen at pixels, with their derivatives: what a pixel's or a voltage's error makes of them.
    ///
    /// Parameters
    /// ----------
    /// pixels, voltage_v, index
    ///     As ``triangulate`` has them.
    ///
    /// Returns
    /// -------
    /// points_mm, per_u, per_v, per_volt : numpy.ndarray
    ///     (n, 3) float64 each, camera frame: mm, mm/px, mm/px, mm/V; NaN where a pixel's ray does not meet the sheet.
    #[pyo3(signature = (
        pixels: "numpy.typing.ArrayLike", voltage_v: "numpy.typing.ArrayLike", *, index,
    ) -> "tuple[numpy.typing.NDArray[numpy.float64], numpy.typing.NDArray[numpy.float64], numpy.typing.NDArray[numpy.float64], numpy.typing.NDArray[numpy.float64]]")]
    fn triangulate_with_derivatives<'py>(
        &self,
        pixels: &Bound<'py, PyAny>,
        voltage_v: &Bound<'py, PyAny>,
        index: f64,
    ) -> PyResult<Derived<'py>> {
        let py = pixels.py();
        let rows = self.meet::<12>(pixels, voltage_v, index, |exposure, pixel| {
            let t = exposure.triangulate_with_derivatives(pixel)?;
            let mut row = [0.0; 12];
            for (part, v) in row.chunks_exact_mut(3).zip([t.point_mm, t.per_u, t.per_v, t.per_volt]) {
                part.copy_from_slice(v.as_slice());
            }
            Ok(row)
        })?;
        let part = |k: usize| {
            Out::rows::<3>(py, rows.iter().map(|r| std::array::from_fn(|i| r[3 * k + i])).collect())
        };
        Ok((part(0)?, part(1)?, part(2)?, part(3)?))
    }

    /// Sine of the angle between the laser's sheet and the light to points: zero on the sheet.
    ///
    /// Parameters
    /// ----------
    /// points_mm : array_like
    ///     (n, 3), camera frame, mm.
    /// voltage_v : array_like
    ///     The galvanometer's voltage, (n,) or one for all.
    /// index : float
    ///     Index of refraction outside, relative to air.
    ///
    /// Returns
    /// -------
    /// numpy.ndarray
    ///     (n,) float64; NaN for points that are not outside the laser's window.
    #[pyo3(signature = (
        points_mm: "numpy.typing.ArrayLike", voltage_v: "numpy.typing.ArrayLike", *, index,
    ) -> "numpy.typing.NDArray[numpy.float64]")]
    fn off_sheet<'py>(
        &self,
        points_mm: &Bound<'py, PyAny>,
        voltage_v: &Bound<'py, PyAny>,
        index: f64,
    ) -> PyResult<Out<'py, f64>> {
        let py = points_mm.py();
        let outside = medium(py, index)?;
        let points: Vec<[f64; 3]> = row_arrays(&table("points_mm", points_mm, 3)?);
        let voltages: Vec<f64> = column("voltage_v", voltage_v, points.len())?.as_array().to_vec();
        let off = py.detach(|| {
            let one = |(p, v): ([f64; 3], f64)| self.inner.sheet(v, outside).off_sheet(&Vector3::from(p));
            points.into_iter().zip(voltages).map(|job| one(job).unwrap_or(f64::NAN)).collect::<Vec<_>>()
        });
        Ok(Out::of(py, off))
    }

    fn __repr__(&self) -> String {
        let c = &self.inner.camera;
        let [x, y, z]: [f64; 3] = self.inner.galvo.origin_mm.into();
        format!("Scanner(fx={:.3}, fy={:.3}, galvo at [{x:.2}, {y:.2}, {z:.2}] mm)", c.fx, c.fy)
    }
}

type Derived<'py> = (Out<'py, f64>, Out<'py, f64>, Out<'py, f64>, Out<'py, f64>);

impl Scanner {
    /// A row for each pixel; what a voltage fixes is worked out once for neighbours that share it.
    fn meet<const O: usize>(
        &self,
        pixels: &Bound<'_, PyAny>,
        voltage_v: &Bound<'_, PyAny>,
        index: f64,
        one: impl Fn(&geom::Exposure, &Vector2<f64>) -> Result<[f64; O], GeomError> + Sync,
    ) -> PyResult<Vec<[f64; O]>> {
        let py = pixels.py();
        let outside = medium(py, index)?;
        let pixels: Vec<[f64; 2]> = row_arrays(&table("pixels", pixels, 2)?);
        let voltages: Vec<f64> = column("voltage_v", voltage_v, pixels.len())?.as_array().to_vec();
        Ok(py.detach(|| {
            let mut last: Option<(u64, Result<geom::Exposure, GeomError>)> = None;
            let mut at = |(pixel, voltage): ([f64; 2], f64)| {
                let bits = voltage.to_bits();
                if last.as_ref().is_none_or(|(known, _)| *known != bits) {
                    last = None;
                }
                let (_, exposure) = last.get_or_insert_with(|| (bits, self.inner.exposure(voltage, outside)));
                let exposure = exposure.as_ref().map_err(|e| *e)?;
                one(exposure, &Vector2::from(pixel))
            };
            pixels.into_iter().zip(voltages).map(|job| at(job).unwrap_or([f64::NAN; O])).collect()
        }))
    }
}
