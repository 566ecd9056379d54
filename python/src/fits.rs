//! Shapes fitted to points.

use crate::calibration::calibration_of;
use crate::cloud::cloud_of;
use crate::convert::{Out, row_arrays, table, triple};
use crate::errors::OrRaise;
use nalgebra::{DMatrix, Vector3};
use pyo3::prelude::*;
use pyo3::types::PyDict;
use uwscan::cloud::{
    CircleFit as Circle, CircleOptions, CylinderFit as Cylinder, CylinderOptions, Deviations, FitError,
    Influence, PlaneFit as Plane, PlaneOptions, PointCloud, SphereFit as Sphere, SphereOptions,
};
use uwscan::pipeline::uncertainty::SharedErrors;

/// What the fits of all shapes tell.
pub struct Common {
    pub covariance: DMatrix<f64>,
    /// With the calibration's part, where a calibration was given.
    pub total: Option<DMatrix<f64>>,
    /// Which points of the cloud the shape is made of, where it was found among others.
    pub points: Option<Vec<usize>>,
}

fn sigma(covariance: &DMatrix<f64>, at: usize) -> f64 {
    covariance[(at, at)].max(0.0).sqrt()
}

fn sigmas<'py>(py: Python<'py>, covariance: &DMatrix<f64>, first: usize) -> Out<'py, f64> {
    Out::of(py, (first..first + 3).map(|i| sigma(covariance, i)).collect())
}

fn dynamic<const N: usize>(covariance: &nalgebra::SMatrix<f64, N, N>) -> DMatrix<f64> {
    DMatrix::from_fn(N, N, |i, j| covariance[(i, j)])
}

fn statistics<'py>(py: Python<'py>, d: &Deviations) -> PyResult<Bound<'py, PyDict>> {
    let all = PyDict::new(py);
    all.set_item("points", d.points)?;
    all.set_item("outliers", d.outliers)?;
    all.set_item("duplicates", d.duplicates)?;
    all.set_item("rms_mm", d.rms_mm)?;
    all.set_item("max_outside_mm", d.max_outside_mm)?;
    all.set_item("max_inside_mm", d.max_inside_mm)?;
    all.set_item("scale", d.scale)?;
    all.set_item("floor_mm", d.floor_mm)?;
    Ok(all)
}

/// Defines the class of a fitted shape: what it shares with the others, and its own.
macro_rules! shape {
    (
        $(#[doc = $doc:literal])*
        $class:ident($inner:ident) named $name:literal, distance $distance:path, { $($own:tt)* }
    ) => {
        $(#[doc = $doc])*
        #[pyclass(module = "uwscan", frozen)]
        pub struct $class {
            pub fit: $inner,
            pub common: Common,
        }

        #[pymethods]
        impl $class {
            $($own)*

            #[doc = concat!("``\"", $name, "\"``")]
            #[getter]
            fn kind(&self) -> &'static str {
                $name
            }

            /// Covariance of the parameters from the points alone, float64.
            #[getter]
            fn covariance<'py>(&self, py: Python<'py>) -> PyResult<Out<'py, f64>> {
                Out::dense(py, &self.common.covariance)
            }

            /// Covariance of the parameters with the calibration's part, float64; None where no calibration was given.
            #[getter]
            fn covariance_total<'py>(&self, py: Python<'py>) -> PyResult<Option<Out<'py, f64>>> {
                self.common.total.as_ref().map(|total| Out::dense(py, total)).transpose()
            }

            /// Points that the shape was fitted to.
            #[getter]
            fn points(&self) -> usize {
                self.fit.deviations.points
            }

            /// Points rejected: farther off than their sigma and the number of points explain.
            #[getter]
            fn outliers(&self) -> usize {
                self.fit.deviations.outliers
            }

            /// Root mean square of the fitted points' orthogonal distances, mm.
            #[getter]
            fn rms_mm(&self) -> f64 {
                self.fit.deviations.rms_mm
            }

            /// Largest distance of a fitted point on the outside (of a plane: the sensor's side), mm.
            #[getter]
            fn max_outside_mm(&self) -> f64 {
                self.fit.deviations.max_outside_mm
            }

            /// Largest distance of a fitted point on the inside, mm.
            #[getter]
            fn max_inside_mm(&self) -> f64 {
                self.fit.deviations.max_inside_mm
            }

            /// All that is known of the points' distances: points, outliers, duplicates, rms_mm, max_outside_mm, max_inside_mm, scale, floor_mm.
            #[getter]
            fn statistics<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
                statistics(py, &self.fit.deviations)
            }

            /// Which points of the cloud the shape is made of, (n,) int64; None unless ``uwscan.find_shapes`` found it.
            #[getter]
            fn point_index<'py>(&self, py: Python<'py>) -> Option<Out<'py, i64>> {
                let points = self.common.points.as_ref()?;
                Some(Out::of(py, points.iter().map(|&i| i as i64).collect()))
            }

            /// Signed orthogonal distances of points from the shape, mm: positive outside (of a plane: on the sensor's side).
            ///
            /// Parameters
            /// ----------
            /// points_mm : array_like
            ///     (n, 3), mm, in the frame of the fitted points.
            ///
            /// Returns
            /// -------
            /// numpy.ndarray
            ///     (n,) float64, mm.
            #[pyo3(signature = (points_mm: "numpy.typing.ArrayLike") -> "numpy.typing.NDArray[numpy.float64]")]
            fn deviations_mm<'py>(&self, py: Python<'py>, points_mm: &Bound<'py, PyAny>) -> PyResult<Out<'py, f64>> {
                let points: Vec<[f64; 3]> = row_arrays(&table("points_mm", points_mm, 3)?);
                Ok(Out::of(py, points.into_iter().map(|p| $distance(&self.fit, &Vector3::from(p))).collect()))
            }
        }
    };
}

fn off_sphere(fit: &Sphere, point: &Vector3<f64>) -> f64 {
    (point - Vector3::from(fit.center_mm)).norm() - fit.radius_mm
}

fn off_plane(fit: &Plane, point: &Vector3<f64>) -> f64 {
    Vector3::from(fit.normal).dot(point) + fit.offset_mm
}

fn off_cylinder(fit: &Cylinder, point: &Vector3<f64>) -> f64 {
    let from = point - Vector3::from(fit.axis_point_mm);
    Vector3::from(fit.axis_direction).cross(&from).norm() - fit.radius_mm
}

fn off_circle(fit: &Circle, point: &Vector3<f64>) -> f64 {
    let (normal, from) = (Vector3::from(fit.normal), point - Vector3::from(fit.center_mm));
    let height = normal.dot(&from);
    let off = (from - normal * height).norm() - fit.radius_mm;
    off.hypot(height).copysign(off)
}

shape! {
    /// A fitted sphere. Millimetres, in the points' frame.
    SphereFit(Sphere) named "sphere", distance off_sphere, {
        /// Radius, mm.
        #[getter]
        fn radius_mm(&self) -> f64 {
            self.fit.radius_mm
        }

        /// Centre, (3,) float64, mm.
        #[getter]
        fn center_mm<'py>(&self, py: Python<'py>) -> Out<'py, f64> {
            Out::of(py, self.fit.center_mm.to_vec())
        }

        /// Standard deviation of the radius from the points alone, mm; 0 where it was given.
        #[getter]
        fn sigma_radius_mm(&self) -> f64 {
            self.fit.sigma_radius_mm
        }

        /// Standard deviations of the centre from the points alone, (3,) float64, mm.
        #[getter]
        fn sigma_center_mm<'py>(&self, py: Python<'py>) -> Out<'py, f64> {
            Out::of(py, self.fit.sigma_center_mm.to_vec())
        }

        /// Standard deviation of the radius with the calibration's part, mm; None where no calibration was given.
        #[getter]
        fn sigma_total_radius_mm(&self) -> Option<f64> {
            self.common.total.as_ref().map(|c| sigma(c, 3))
        }

        /// Standard deviations of the centre with the calibration's part, (3,) float64, mm; None where no calibration was given.
        #[getter]
        fn sigma_total_center_mm<'py>(&self, py: Python<'py>) -> Option<Out<'py, f64>> {
            self.common.total.as_ref().map(|c| sigmas(py, c, 0))
        }

        fn __repr__(&self) -> String {
            let f = &self.fit;
            format!("SphereFit(radius_mm={:.4} ± {:.4}, center_mm={:.4?}, points={})", f.radius_mm, f.sigma_radius_mm, f.center_mm, f.deviations.points)
        }
    }
}

shape! {
    /// A fitted plane n·p + offset = 0, |n| = 1. Millimetres, in the points' frame.
    PlaneFit(Plane) named "plane", distance off_plane, {
        /// Unit normal towards the sensor, (3,) float64.
        #[getter]
        fn normal<'py>(&self, py: Python<'py>) -> Out<'py, f64> {
            Out::of(py, self.fit.normal.to_vec())
        }

        /// d in n·p + d = 0, mm.
        #[getter]
        fn offset_mm(&self) -> f64 {
            self.fit.offset_mm
        }

        /// Standard deviation of the normal in its least certain direction, rad.
        #[getter]
        fn sigma_normal_rad(&self) -> f64 {
            self.fit.sigma_normal_rad
        }

        /// Standard deviation of the offset, mm.
        #[getter]
        fn sigma_offset_mm(&self) -> f64 {
            self.fit.sigma_offset_mm
        }

        /// Standard deviation of the offset with the calibration's part, mm; None where no calibration was given.
        #[getter]
        fn sigma_total_offset_mm(&self) -> Option<f64> {
            self.common.total.as_ref().map(|c| sigma(c, 3))
        }

        fn __repr__(&self) -> String {
            let f = &self.fit;
            format!("PlaneFit(normal={:.5?}, offset_mm={:.4} ± {:.4}, points={})", f.normal, f.offset_mm, f.sigma_offset_mm, f.deviations.points)
        }
    }
}

shape! {
    /// A fitted cylinder. Millimetres, in the points' frame.
    CylinderFit(Cylinder) named "cylinder", distance off_cylinder, {
        /// Radius, mm.
        #[getter]
        fn radius_mm(&self) -> f64 {
            self.fit.radius_mm
        }

        /// The axis's point at the middle of the points, (3,) float64, mm.
        #[getter]
        fn axis_point_mm<'py>(&self, py: Python<'py>) -> Out<'py, f64> {
            Out::of(py, self.fit.axis_point_mm.to_vec())
        }

        /// Unit vector along the axis, (3,) float64, its largest component positive.
        #[getter]
        fn axis_direction<'py>(&self, py: Python<'py>) -> Out<'py, f64> {
            Out::of(py, self.fit.axis_direction.to_vec())
        }

        /// From where to where along the axis the points lie, mm from its point.
        #[getter]
        fn extent_mm(&self) -> (f64, f64) {
            (self.fit.extent_mm[0], self.fit.extent_mm[1])
        }

        /// Standard deviation of the radius, mm; 0 where it was given.
        #[getter]
        fn sigma_radius_mm(&self) -> f64 {
            self.fit.sigma_radius_mm
        }

        /// Standard deviations of the axis's point, (3,) float64, mm.
        #[getter]
        fn sigma_axis_point_mm<'py>(&self, py: Python<'py>) -> Out<'py, f64> {
            Out::of(py, self.fit.sigma_axis_point_mm.to_vec())
        }

        /// Standard deviation of the axis's direction in its least certain direction, rad.
        #[getter]
        fn sigma_direction_rad(&self) -> f64 {
            self.fit.sigma_direction_rad
        }

        /// Standard deviation of the radius with the calibration's part, mm; None where no calibration was given.
        #[getter]
        fn sigma_total_radius_mm(&self) -> Option<f64> {
            self.common.total.as_ref().map(|c| sigma(c, 6))
        }

        fn __repr__(&self) -> String {
            let f = &self.fit;
            format!("CylinderFit(radius_mm={:.4} ± {:.4}, axis_point_mm={:.4?}, axis_direction={:.5?}, points={})", f.radius_mm, f.sigma_radius_mm, f.axis_point_mm, f.axis_direction, f.deviations.points)
        }
    }
}

shape! {
    /// A fitted circle: a curve in space, such as an edge. Millimetres, in the points' frame.
    CircleFit(Circle) named "circle", distance off_circle, {
        /// Radius, mm.
        #[getter]
        fn radius_mm(&self) -> f64 {
            self.fit.radius_mm
        }

        /// Centre, (3,) float64, mm.
        #[getter]
        fn center_mm<'py>(&self, py: Python<'py>) -> Out<'py, f64> {
            Out::of(py, self.fit.center_mm.to_vec())
        }

        /// Unit normal of its plane towards the sensor, (3,) float64.
        #[getter]
        fn normal<'py>(&self, py: Python<'py>) -> Out<'py, f64> {
            Out::of(py, self.fit.normal.to_vec())
        }

        /// Standard deviation of the radius, mm; 0 where it was given.
        #[getter]
        fn sigma_radius_mm(&self) -> f64 {
            self.fit.sigma_radius_mm
        }

        /// Standard deviations of the centre, (3,) float64, mm.
        #[getter]
        fn sigma_center_mm<'py>(&self, py: Python<'py>) -> Out<'py, f64> {
            Out::of(py, self.fit.sigma_center_mm.to_vec())
        }

        /// Standard deviation of the normal in its least certain direction, rad.
        #[getter]
        fn sigma_normal_rad(&self) -> f64 {
            self.fit.sigma_normal_rad
        }

        /// Standard deviation of the radius with the calibration's part, mm; None where no calibration was given.
        #[getter]
        fn sigma_total_radius_mm(&self) -> Option<f64> {
            self.common.total.as_ref().map(|c| sigma(c, 6))
        }

        fn __repr__(&self) -> String {
            let f = &self.fit;
            format!("CircleFit(radius_mm={:.4} ± {:.4}, center_mm={:.4?}, normal={:.5?}, points={})", f.radius_mm, f.sigma_radius_mm, f.center_mm, f.normal, f.deviations.points)
        }
    }
}

/// What every fit is given.
struct Given<'a, 'py> {
    points: &'a Bound<'py, PyAny>,
    covariance_mm2: Option<&'a Bound<'py, PyAny>>,
    sigma_mm: Option<&'a Bound<'py, PyAny>>,
    calibration: Option<&'a Bound<'py, PyAny>>,
}

impl Given<'_, '_> {
    /// Fits without the GIL, and adds the calibration's part.
    fn fit<F: Send>(
        self,
        fit: impl FnOnce(&PointCloud) -> Result<F, FitError> + Send,
        parts: impl Fn(&F) -> (DMatrix<f64>, &Influence) + Sync,
    ) -> PyResult<(F, Common)> {
        let py = self.points.py();
        let cloud = cloud_of(self.points, self.covariance_mm2, self.sigma_mm)?;
        let calibration = self.calibration.map(calibration_of).transpose()?;
        py.detach(|| {
            let fit = fit(&cloud).map_err(uwscan::Error::Fit)?;
            let (covariance, influence) = parts(&fit);
            let total = match &calibration {
                Some(file) => {
                    Some(SharedErrors::new(&cloud, &file.calibration)?.total(&covariance, influence)?)
                }
                None => None,
            };
            Ok::<_, uwscan::Error>((fit, Common { covariance, total, points: None }))
        })
        .or_raise(py)
    }
}

/// The sphere that most points lie on.
///
/// Maximum likelihood with errors in variables after a start that stands up to seven tenths of outliers.
///
/// Parameters
/// ----------
/// points : Cloud or array_like
///     Points, (n, 3), mm. A cloud brings its covariances along.
/// covariance_mm2 : array_like, optional
///     Covariances of the points, (n, 3, 3) or (n, 6), mm², instead of the cloud's.
/// sigma_mm : array_like, optional
///     Standard deviation of the points in every direction, (n,) or one for all, mm, instead of covariances.
/// radius_mm : float, optional
///     The radius where it is known: only the centre is fitted.
/// calibration : Calibration or path, optional
///     What the cloud was reconstructed with: adds its part of the uncertainty, which all points share (``sigma_total_…``).
/// seed : int, default 1
///     Seed of the random samples that the start is taken from.
///
/// Returns
/// -------
/// SphereFit
///
/// Raises
/// ------
/// FitError
///     Where the points hold no sphere or do not determine one, or are not finite.
/// CalibrationError
///     Where the cloud was not made with the calibration.
///
/// Examples
/// --------
/// >>> import numpy as np, uwscan
/// >>> i = np.arange(300)
/// >>> z = -1 + i / 300
/// >>> r, t = np.sqrt(1 - z**2), 2.4 * i
/// >>> ball = np.stack([20 * r * np.cos(t), 20 * r * np.sin(t), 700 + 20 * z], axis=1)
/// >>> fit = uwscan.fit_sphere(ball)
/// >>> round(fit.radius_mm, 9), np.round(fit.center_mm, 6).tolist()
/// (20.0, [0.0, 0.0, 700.0])
#[pyfunction]
#[pyo3(signature = (
    points: "Cloud | numpy.typing.ArrayLike",
    *,
    covariance_mm2: "numpy.typing.ArrayLike | None" = None,
    sigma_mm: "numpy.typing.ArrayLike | None" = None,
    radius_mm = None,
    calibration: "Calibration | str | os.PathLike[str] | None" = None,
    seed = 1,
) -> "SphereFit")]
pub fn fit_sphere(
    points: &Bound<'_, PyAny>,
    covariance_mm2: Option<&Bound<'_, PyAny>>,
    sigma_mm: Option<&Bound<'_, PyAny>>,
    radius_mm: Option<f64>,
    calibration: Option<&Bound<'_, PyAny>>,
    seed: u64,
) -> PyResult<SphereFit> {
    let options = SphereOptions { radius_mm, seed };
    let (fit, common) = Given { points, covariance_mm2, sigma_mm, calibration }.fit(
        |cloud| uwscan::cloud::fit_sphere(cloud, &options),
        |fit| (dynamic(&fit.covariance_mm2), &fit.influence),
    )?;
    Ok(SphereFit { fit, common })
}

/// The plane that most points lie on, its normal towards the sensor.
///
/// Parameters
/// ----------
/// points : Cloud or array_like
///     Points, (n, 3), mm. A cloud brings its covariances along.
/// covariance_mm2, sigma_mm, calibration, seed
///     As ``uwscan.fit_sphere`` has them.
/// sensor_mm : array_like, optional
///     The sensor's place in the points' frame, (3,), mm; the origin by default.
///
/// Returns
/// -------
/// PlaneFit
///
/// Raises
/// ------
/// FitError
///     Where the points hold no plane, lie on a line, or are not finite.
///
/// Examples
/// --------
/// >>> import numpy as np, uwscan
/// >>> x, y = np.meshgrid(np.arange(10.0), np.arange(10.0))
/// >>> fit = uwscan.fit_plane(np.stack([x, y, 700 + 0.1 * x], axis=-1).reshape(-1, 3))
/// >>> bool(fit.normal[2] < 0), fit.points
/// (True, 100)
#[pyfunction]
#[pyo3(signature = (
    points: "Cloud | numpy.typing.ArrayLike",
    *,
    covariance_mm2: "numpy.typing.ArrayLike | None" = None,
    sigma_mm: "numpy.typing.ArrayLike | None" = None,
    sensor_mm: "numpy.typing.ArrayLike | None" = None,
    calibration: "Calibration | str | os.PathLike[str] | None" = None,
    seed = 1,
) -> "PlaneFit")]
pub fn fit_plane(
    points: &Bound<'_, PyAny>,
    covariance_mm2: Option<&Bound<'_, PyAny>>,
    sigma_mm: Option<&Bound<'_, PyAny>>,
    sensor_mm: Option<&Bound<'_, PyAny>>,
    calibration: Option<&Bound<'_, PyAny>>,
    seed: u64,
) -> PyResult<PlaneFit> {
    let options = PlaneOptions { sensor_mm: sensor(sensor_mm)?, seed };
    let (fit, common) = Given { points, covariance_mm2, sigma_mm, calibration }.fit(
        |cloud| uwscan::cloud::fit_plane(cloud, &options),
        |fit| (dynamic(&fit.covariance), &fit.influence),
    )?;
    Ok(PlaneFit { fit, common })
}

/// The cylinder that most points lie on.
///
/// Parameters
/// ----------
/// points : Cloud or array_like
///     Points, (n, 3), mm. A cloud brings its covariances along.
/// radius_mm : float, optional
///     The radius where it is known.
/// covariance_mm2, sigma_mm, calibration, seed
///     As ``uwscan.fit_sphere`` has them.
///
/// Returns
/// -------
/// CylinderFit
///
/// Raises
/// ------
/// FitError
///     Where the points hold no cylinder or do not determine one, or are not finite.
#[pyfunction]
#[pyo3(signature = (
    points: "Cloud | numpy.typing.ArrayLike",
    *,
    covariance_mm2: "numpy.typing.ArrayLike | None" = None,
    sigma_mm: "numpy.typing.ArrayLike | None" = None,
    radius_mm = None,
    calibration: "Calibration | str | os.PathLike[str] | None" = None,
    seed = 1,
) -> "CylinderFit")]
pub fn fit_cylinder(
    points: &Bound<'_, PyAny>,
    covariance_mm2: Option<&Bound<'_, PyAny>>,
    sigma_mm: Option<&Bound<'_, PyAny>>,
    radius_mm: Option<f64>,
    calibration: Option<&Bound<'_, PyAny>>,
    seed: u64,
) -> PyResult<CylinderFit> {
    let options = CylinderOptions { radius_mm, seed };
    let (fit, common) = Given { points, covariance_mm2, sigma_mm, calibration }.fit(
        |cloud| uwscan::cloud::fit_cylinder(cloud, &options),
        |fit| (dynamic(&fit.covariance), &fit.influence),
    )?;
    Ok(CylinderFit { fit, common })
}

/// The circle that most points lie along: a curve in space, such as an edge.
///
/// Parameters
/// ----------
/// points : Cloud or array_like
///     Points, (n, 3), mm. A cloud brings its covariances along.
/// radius_mm : float, optional
///     The radius where it is known.
/// sensor_mm : array_like, optional
///     The sensor's place in the points' frame, (3,), mm, which the normal faces; the origin by default.
/// covariance_mm2, sigma_mm, calibration, seed
///     As ``uwscan.fit_sphere`` has them.
///
/// Returns
/// -------
/// CircleFit
///
/// Raises
/// ------
/// FitError
///     Where the points hold no circle or do not determine one, or are not finite.
///
/// Examples
/// --------
/// >>> import numpy as np, uwscan
/// >>> t = 0.05 * np.arange(90)
/// >>> fit = uwscan.fit_circle(np.stack([25 * np.cos(t), 25 * np.sin(t), np.full(90, 700.0)], axis=1))
/// >>> round(fit.radius_mm, 9)
/// 25.0
#[pyfunction]
#[pyo3(signature = (
    points: "Cloud | numpy.typing.ArrayLike",
    *,
    covariance_mm2: "numpy.typing.ArrayLike | None" = None,
    sigma_mm: "numpy.typing.ArrayLike | None" = None,
    radius_mm = None,
    sensor_mm: "numpy.typing.ArrayLike | None" = None,
    calibration: "Calibration | str | os.PathLike[str] | None" = None,
    seed = 1,
) -> "CircleFit")]
pub fn fit_circle(
    points: &Bound<'_, PyAny>,
    covariance_mm2: Option<&Bound<'_, PyAny>>,
    sigma_mm: Option<&Bound<'_, PyAny>>,
    radius_mm: Option<f64>,
    sensor_mm: Option<&Bound<'_, PyAny>>,
    calibration: Option<&Bound<'_, PyAny>>,
    seed: u64,
) -> PyResult<CircleFit> {
    let options = CircleOptions { radius_mm, sensor_mm: sensor(sensor_mm)?, seed };
    let (fit, common) = Given { points, covariance_mm2, sigma_mm, calibration }.fit(
        |cloud| uwscan::cloud::fit_circle(cloud, &options),
        |fit| (dynamic(&fit.covariance), &fit.influence),
    )?;
    Ok(CircleFit { fit, common })
}

/// The sensor's place; the origin where none is given.
pub fn sensor(given: Option<&Bound<'_, PyAny>>) -> PyResult<[f64; 3]> {
    given.map_or(Ok([0.0; 3]), |any| triple("sensor_mm", any))
}
