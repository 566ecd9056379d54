//! Cylinders.

use super::{Given, dynamic, shape};
use nalgebra::Vector3;
use pyo3::prelude::*;
use uwscan::cloud::{CylinderFit as Cylinder, CylinderOptions};

shape! {
    /// A fitted cylinder. Millimetres, in the points' frame.
    CylinderFit(Cylinder) named "cylinder", distance off_cylinder,
    numbers {
        /// Radius, mm.
        radius_mm,
        /// Standard deviation of the radius, mm; 0 where it was given.
        sigma_radius_mm,
        /// Standard deviation of the axis's direction in its least certain direction, rad.
        sigma_direction_rad,
    }
    places {
        /// The axis's point at the middle of the points, (3,) float64, mm.
        axis_point_mm,
        /// Unit vector along the axis, (3,) float64, its largest component positive.
        axis_direction,
        /// Standard deviations of the axis's point, (3,) float64, mm.
        sigma_axis_point_mm,
    }
    pairs {
        /// From where to where along the axis the points lie, mm from its point.
        extent_mm,
    }
    total_numbers {
        /// Standard deviation of the radius with the calibration's part, mm; None where no calibration was given.
        sigma_total_radius_mm = 6,
    }
    total_places {}
    shown(f) { format!(
        "CylinderFit(radius_mm={:.4} ± {:.4}, axis_point_mm={:.4?}, axis_direction={:.5?}, points={})",
        f.radius_mm, f.sigma_radius_mm, f.axis_point_mm, f.axis_direction, f.deviations.points
    ) }
}

fn off_cylinder(fit: &Cylinder, point: &Vector3<f64>) -> f64 {
    let from = point - Vector3::from(fit.axis_point_mm);
    Vector3::from(fit.axis_direction).cross(&from).norm() - fit.radius_mm
}

/// The cylinder that most points lie on.
///
/// Parameters
/// ----------
/// points : Cloud or array_like
///     Points, (n, 3), mm. A cloud brings its covariances along.
/// radius_mm : float, optional
///     The radius where it is known.
/// covariance_mm2, sigma_mm, calibration, index_sigma, seed
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
    index_sigma = None,
    seed = 1,
) -> "CylinderFit")]
#[allow(clippy::too_many_arguments, reason = "keywords in Python")]
pub fn fit_cylinder(
    points: &Bound<'_, PyAny>,
    covariance_mm2: Option<&Bound<'_, PyAny>>,
    sigma_mm: Option<&Bound<'_, PyAny>>,
    radius_mm: Option<f64>,
    calibration: Option<&Bound<'_, PyAny>>,
    index_sigma: Option<f64>,
    seed: u64,
) -> PyResult<CylinderFit> {
    let options = CylinderOptions { radius_mm, seed };
    let (fit, common) = Given { points, covariance_mm2, sigma_mm, calibration, index_sigma }.fit(
        |cloud| uwscan::cloud::fit_cylinder(cloud, &options),
        |fit| (dynamic(&fit.covariance), &fit.influence),
    )?;
    Ok(CylinderFit { fit, common })
}
