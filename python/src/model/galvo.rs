//! What turns the light: the laser's fan, and the galvanometer.

use crate::convert::{Out, row_arrays, table, triple};
use crate::errors::input;
use nalgebra::{Matrix3, Vector3};
use pyo3::prelude::*;
use uwscan::geom;

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
    pub inner: geom::Fan,
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
    pub inner: geom::Galvo,
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
