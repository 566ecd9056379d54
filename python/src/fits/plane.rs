//! Planes.

use super::{Given, dynamic, sensor, shape};
use nalgebra::Vector3;
use pyo3::prelude::*;
use uwscan::cloud::{PlaneFit as Plane, PlaneOptions};

shape! {
    /// A fitted plane n·p + offset = 0, |n| = 1. Millimetres, in the points' frame.
    PlaneFit(Plane) named "plane", distance off_plane,
    numbers {
        /// d in n·p + d = 0, mm.
        offset_mm,
        /// Standard deviation of the normal in its least certain direction, rad.
        sigma_normal_rad,
        /// Standard deviation of the offset, mm.
        sigma_offset_mm,
    }
    places {
        /// Unit normal towards the sensor, (3,) float64.
        normal,
    }
    pairs {}
    total_numbers {
        /// Standard deviation of the offset with the calibration's part, mm; None where no calibration was given.
        sigma_total_offset_mm = 3,
    }
    total_places {}
    shown(f) { format!(
        "PlaneFit(normal={:.5?}, offset_mm={:.4} ± {:.4}, points={})",
        f.normal, f.offset_mm, f.sigma_offset_mm, f.deviations.points
    ) }
}

fn off_plane(fit: &Plane, point: &Vector3<f64>) -> f64 {
    Vector3::from(fit.normal).dot(point) + fit.offset_mm
}

/// The plane that most points lie on, its normal towards the sensor.
///
/// Parameters
/// ----------
/// points : Cloud or array_like
///     Points, (n, 3), mm. A cloud brings its covariances along.
/// covariance_mm2, sigma_mm, calibration, index_sigma, seed
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
    index_sigma = None,
    seed = 1,
) -> "PlaneFit")]
#[allow(clippy::too_many_arguments, reason = "keywords in Python")]
pub fn fit_plane(
    points: &Bound<'_, PyAny>,
    covariance_mm2: Option<&Bound<'_, PyAny>>,
    sigma_mm: Option<&Bound<'_, PyAny>>,
    sensor_mm: Option<&Bound<'_, PyAny>>,
    calibration: Option<&Bound<'_, PyAny>>,
    index_sigma: Option<f64>,
    seed: u64,
) -> PyResult<PlaneFit> {
    let options = PlaneOptions { sensor_mm: sensor(sensor_mm)?, seed };
    let (fit, common) = Given { points, covariance_mm2, sigma_mm, calibration, index_sigma }.fit(
        |cloud| uwscan::cloud::fit_plane(cloud, &options),
        |fit| (dynamic(&fit.covariance), &fit.influence),
    )?;
    Ok(PlaneFit { fit, common })
}
