//! Circles.

use super::{Given, dynamic, sensor, shape};
use nalgebra::Vector3;
use pyo3::prelude::*;
use uwscan::cloud::{CircleFit as Circle, CircleOptions};

shape! {
    /// A fitted circle: a curve in space, such as an edge. Millimetres, in the points' frame.
    CircleFit(Circle) named "circle", distance off_circle,
    numbers {
        /// Radius, mm.
        radius_mm,
        /// Standard deviation of the radius, mm; 0 where it was given.
        sigma_radius_mm,
        /// Standard deviation of the normal in its least certain direction, rad.
        sigma_normal_rad,
    }
    places {
        /// Centre, (3,) float64, mm.
        center_mm,
        /// Unit normal of its plane towards the sensor, (3,) float64.
        normal,
        /// Standard deviations of the centre, (3,) float64, mm.
        sigma_center_mm,
    }
    pairs {}
    total_numbers {
        /// Standard deviation of the radius with the calibration's part, mm; None where no calibration was given.
        sigma_total_radius_mm = 6,
    }
    total_places {}
    shown(f) { format!(
        "CircleFit(radius_mm={:.4} ± {:.4}, center_mm={:.4?}, normal={:.5?}, points={})",
        f.radius_mm, f.sigma_radius_mm, f.center_mm, f.normal, f.deviations.points
    ) }
}

fn off_circle(fit: &Circle, point: &Vector3<f64>) -> f64 {
    let (normal, from) = (Vector3::from(fit.normal), point - Vector3::from(fit.center_mm));
    let height = normal.dot(&from);
    let off = (from - normal * height).norm() - fit.radius_mm;
    off.hypot(height).copysign(off)
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
/// covariance_mm2, sigma_mm, calibration, index_sigma, seed
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
    index_sigma = None,
    seed = 1,
) -> "CircleFit")]
#[allow(clippy::too_many_arguments, reason = "keywords in Python")]
pub fn fit_circle(
    points: &Bound<'_, PyAny>,
    covariance_mm2: Option<&Bound<'_, PyAny>>,
    sigma_mm: Option<&Bound<'_, PyAny>>,
    radius_mm: Option<f64>,
    sensor_mm: Option<&Bound<'_, PyAny>>,
    calibration: Option<&Bound<'_, PyAny>>,
    index_sigma: Option<f64>,
    seed: u64,
) -> PyResult<CircleFit> {
    let options = CircleOptions { radius_mm, sensor_mm: sensor(sensor_mm)?, seed };
    let (fit, common) = Given { points, covariance_mm2, sigma_mm, calibration, index_sigma }.fit(
        |cloud| uwscan::cloud::fit_circle(cloud, &options),
        |fit| (dynamic(&fit.covariance), &fit.influence),
    )?;
    Ok(CircleFit { fit, common })
}
