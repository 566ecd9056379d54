//! The exact model of the instrument, on arrays.

use crate::convert::{Out, column, floats, row_arrays, table, triple};
use crate::errors::{OrRaise, input};
use nalgebra::{Matrix3, Vector2, Vector3};
use numpy::PyUntypedArrayMethods;
use pyo3::prelude::*;
use uwscan::geom::{self, Distortion, GeomError, Medium};

/// A row for each of an array's, NaN where there is none; without the GIL.
fn each<const I: usize, const O: usize>(
    name: &str,
    any: &Bound<'_, PyAny>,
    one: impl Fn([f64; I]) -> Result<[f64; O], GeomError> + Sync,
) -> PyResult<Vec<[f64; O]>> {
    let rows: Vec<[f64; I]> = row_arrays(&table(name, any, I)?);
    Ok(any.py().detach(|| rows.into_iter().map(|row| one(row).unwrap_or([f64::NAN; O])).collect()))
}

fn medium(py: Python<'_>, index: f64) -> PyResult<Medium> {
    if (1.0..3.0).contains(&index) {
        return Ok(Medium::of_index(index));
    }
    Err(input(py, format!("an index of refraction must be from 1 to 3, got {index}")))
}

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
    inner: geom::Camera,
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
    inner: geom::Port,
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

type Rays<'py> = (Out<'py, f64>, Out<'py, f64>);

fn six(ray: &geom::Ray) -> [f64; 6] {
    let (o, d) = (&ray.origin, &ray.direction);
    [o.x, o.y, o.z, d.x, d.y, d.z]
}

fn rays(py: Python<'_>, rows: Vec<[f64; 6]>) -> PyResult<Rays<'_>> {
    let part = |first: usize| rows.iter().map(|r| [r[first], r[first + 1], r[first + 2]]).collect();
    Ok((Out::rows::<3>(py, part(0))?, Out::rows::<3>(py, part(3))?))
}

/// The laser's fan as the mirror shows it at the reference voltage: a plane of rays from a virtual apex, in the galvanometer frame.
///
/// Parameters
/// ----------
/// apex_mm : array_like
///     Virtual apex, (3,), mm: x along the axis, y how far the plane misses the axis, −z the length from apex to axis.
/// tilt_rad : float, default 0
///     Angle between the fan's plane and the axis.
/// mirror_offset_mm : float, default 0
///     Mirror surface to axis, mm.
/// mirror_normal_rad : float, default 0
///     Direction of the mirror's normal at the reference voltage: angle from z towards y.
#[pyclass(module = "uwscan", frozen)]
#[derive(Clone)]
pub struct Fan {
    inner: geom::Fan,
}

#[pymethods]
impl Fan {
    #[new]
    #[pyo3(signature = (
        apex_mm: "numpy.typing.ArrayLike", *, tilt_rad = 0.0, mirror_offset_mm = 0.0, mirror_normal_rad = 0.0,
    ))]
    fn new(
        apex_mm: &Bound<'_, PyAny>,
        tilt_rad: f64,
        mirror_offset_mm: f64,
        mirror_normal_rad: f64,
    ) -> PyResult<Self> {
        let apex_mm: Vector3<f64> = triple("apex_mm", apex_mm)?.into();
        Ok(Self { inner: geom::Fan { apex_mm, tilt_rad, mirror_offset_mm, mirror_normal_rad } })
    }

    /// Virtual apex, (3,) float64, mm, galvanometer frame.
    #[getter]
    fn apex_mm<'py>(&self, py: Python<'py>) -> Out<'py, f64> {
        Out::of(py, self.inner.apex_mm.as_slice().to_vec())
    }

    /// Angle between the fan's plane and the axis, rad.
    #[getter]
    fn tilt_rad(&self) -> f64 {
        self.inner.tilt_rad
    }

    /// Mirror surface to axis, mm.
    #[getter]
    fn mirror_offset_mm(&self) -> f64 {
        self.inner.mirror_offset_mm
    }

    /// Direction of the mirror's normal at the reference voltage, rad: angle from z towards y.
    #[getter]
    fn mirror_normal_rad(&self) -> f64 {
        self.inner.mirror_normal_rad
    }
}

/// The galvanometer: its frame in the camera's, and how far the mirror turns per volt.
///
/// Parameters
/// ----------
/// camera_from_galvo : array_like
///     The frame, (4, 4), mm: x along the mirror's axis, z out to the scene in the laser's plane at the reference voltage.
/// degrees_per_volt : float
///     Mechanical; the beam turns by twice as much.
/// reference_v : float, default 0
///     The voltage that fixes the frame.
/// quadratic_deg_per_v2, cubic_deg_per_v3 : float, default 0
///     Terms about 0 V.
///
/// Raises
/// ------
/// InputError
///     For a matrix that does not turn and move.
#[pyclass(module = "uwscan", frozen)]
#[derive(Clone)]
pub struct Galvo {
    inner: geom::Galvo,
}

/// How far from a rotation a matrix may be.
const ROTATION_ROUNDING: f64 = 1e-6;

#[pymethods]
impl Galvo {
    #[new]
    #[pyo3(signature = (
        camera_from_galvo: "numpy.typing.ArrayLike",
        degrees_per_volt,
        *,
        reference_v = 0.0,
        quadratic_deg_per_v2 = 0.0,
        cubic_deg_per_v3 = 0.0,
    ))]
    fn new(
        camera_from_galvo: &Bound<'_, PyAny>,
        degrees_per_volt: f64,
        reference_v: f64,
        quadratic_deg_per_v2: f64,
        cubic_deg_per_v3: f64,
    ) -> PyResult<Self> {
        let py = camera_from_galvo.py();
        let rows: Vec<[f64; 4]> = row_arrays(&table("camera_from_galvo", camera_from_galvo, 4)?);
        let [a, b, c, _] = rows[..] else {
            return Err(input(
                py,
                format!("camera_from_galvo must have the shape (4, 4), got ({}, 4)", rows.len()),
            ));
        };
        let axes = Matrix3::new(a[0], a[1], a[2], b[0], b[1], b[2], c[0], c[1], c[2]);
        let square = (axes * axes.transpose() - Matrix3::identity()).norm() < ROTATION_ROUNDING;
        if !(square && axes.determinant() > 0.0) {
            return Err(input(py, "camera_from_galvo must be a rotation and a translation"));
        }
        let inner = geom::Galvo {
            origin_mm: Vector3::new(a[3], b[3], c[3]),
            axes,
            radians_per_volt: degrees_per_volt.to_radians(),
            quadratic: quadratic_deg_per_v2.to_radians(),
            cubic: cubic_deg_per_v3.to_radians(),
            reference_v,
        };
        Ok(Self { inner })
    }

    /// The frame, (4, 4) float64, mm.
    #[getter]
    fn camera_from_galvo<'py>(&self, py: Python<'py>) -> PyResult<Out<'py, f64>> {
        let (r, t) = (&self.inner.axes, &self.inner.origin_mm);
        let row = |i: usize| [r[(i, 0)], r[(i, 1)], r[(i, 2)], t[i]];
        Out::matrix(py, &[row(0), row(1), row(2), [0.0, 0.0, 0.0, 1.0]])
    }

    /// Mechanical turn of the mirror per volt about 0 V, degrees.
    #[getter]
    fn degrees_per_volt(&self) -> f64 {
        self.inner.radians_per_volt.to_degrees()
    }

    /// The voltage that fixes the frame.
    #[getter]
    fn reference_v(&self) -> f64 {
        self.inner.reference_v
    }

    /// Mechanical angle of the mirror at `voltage_v`, rad, from where it stands at the reference voltage.
    fn mirror_angle_rad(&self, voltage_v: f64) -> f64 {
        self.inner.mirror_angle(voltage_v)
    }
}

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

/// Index of refraction of water relative to air: Quan and Fry (Appl. Opt. 34 (1995) 3477), with a term linear in depth.
///
/// Parameters
/// ----------
/// temperature_c : array_like
///     Temperature, °C (0 to 30).
/// salinity_psu : array_like
///     Practical salinity (0 to 35).
/// wavelength_nm : array_like
///     Wavelength in air, nm (400 to 700).
/// depth_m : array_like, optional
///     Depth below the surface, m; 0 by default.
///
/// Returns
/// -------
/// float or numpy.ndarray
///     The arguments broadcast against each other; a float where all are numbers.
///
/// Examples
/// --------
/// >>> import uwscan
/// >>> round(uwscan.water_index(20.0, 35.0, 532.0), 6)
/// 1.34151
/// >>> uwscan.water_index([10.0, 20.0], 0.0, 532.0).round(5).tolist()
/// [1.33569, 1.33504]
#[pyfunction]
#[pyo3(signature = (
    temperature_c: "numpy.typing.ArrayLike",
    salinity_psu: "numpy.typing.ArrayLike",
    wavelength_nm: "numpy.typing.ArrayLike",
    depth_m: "numpy.typing.ArrayLike | None" = None,
) -> "typing.Any")]
pub fn water_index<'py>(
    py: Python<'py>,
    temperature_c: &Bound<'py, PyAny>,
    salinity_psu: &Bound<'py, PyAny>,
    wavelength_nm: &Bound<'py, PyAny>,
    depth_m: Option<&Bound<'py, PyAny>>,
) -> PyResult<Bound<'py, PyAny>> {
    let zero = 0.0_f64.into_pyobject(py)?.into_any();
    let depth_m = depth_m.unwrap_or(&zero);
    let given = [temperature_c, salinity_psu, wavelength_nm, depth_m];
    let numbers: Result<Vec<f64>, _> = given.iter().map(|any| any.extract::<f64>()).collect();
    if let Ok([t, s, l, d]) = numbers.as_deref() {
        return Ok(geom::water::index(*t, *s, *l, *d).into_pyobject(py)?.into_any());
    }
    let names = ["temperature_c", "salinity_psu", "wavelength_nm", "depth_m"];
    let arrays: Vec<_> =
        names.into_iter().zip(given).map(|(name, any)| floats(name, any)).collect::<PyResult<_>>()?;
    let arrays: Vec<&Bound<'_, PyAny>> = arrays.iter().map(|a| a.as_any()).collect();
    let numpy = py.import("numpy")?;
    let tuple = pyo3::types::PyTuple::new(py, arrays)?;
    let refused = |e: PyErr| input(py, e.value(py).to_string());
    let broadcast = numpy.call_method1("broadcast_arrays", tuple).map_err(refused)?;
    let mut columns = Vec::new();
    for array in broadcast.try_iter()? {
        let array = floats("an argument", &array?.call_method0("copy")?)?;
        columns.push((array.as_array().iter().copied().collect::<Vec<f64>>(), array.shape().to_vec()));
    }
    let [(t, shape), (s, _), (l, _), (d, _)] = &columns[..] else {
        return Err(input(py, "four arguments are needed"));
    };
    let index = (0..t.len()).map(|i| geom::water::index(t[i], s[i], l[i], d[i])).collect();
    Out::<f64>::of(py, index).into_inner().call_method1("reshape", (shape.clone(),))
}
