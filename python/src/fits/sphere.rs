//! Spheres.

use super::{Given, dynamic, shape};
use nalgebra::Vector3;
use pyo3::prelude::*;
use uwscan::cloud::{SphereFit as Sphere, SphereOptions};

shape! {
    /// A fitted sphere. Millimetres, in the points' frame.
    SphereFit(Sphere) named "sphere", distance off_sphere,
    numbers {
        /// Radius, mm.
        radius_mm,
        /// Standard deviation of the radius from the points alone, mm; 0 where it was given.
        sigma_radius_mm,
    }
    places {
        /// Centre, (3,) float64, mm.
        center_mm,
        /// Standard deviations of the centre from the points alone, (3,) float64, mm.
        sigma_center_mm,
    }
    pairs {}
    total_numbers {
        /// Standard deviation of the radius with the calibration's part, mm; None where no calibration was given.
        sigma_total_radius_mm = 3,
    }
    total_places {
        /// Standard deviations of the centre with the calibration's part, (3,) float64, mm; None where no calibration was given.
        sigma_total_center_mm = 0,
    }
    shown(f) { format!(
        "SphereFit(radius_mm={:.4} ± {:.4}, center_mm={:.4?}, points={})",
        f.radius_mm, f.sigma_radius_mm, f.center_mm, f.deviations.points
    ) }
}

fn off_sphere(fit: &Sphere, point: &Vector3<f64>) -> f64 {
    (point - Vector3::from(fit.center_mm)).norm() - fit.radius_mm
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
/// index_sigma : float, optional
///     Standard deviation of the water's index where ``uwscan.reconstruct`` was given it, in place of the calibration's; 0 takes it as exact.
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
    index_sigma = None,
    seed = 1,
) -> "SphereFit")]
#[allow(clippy::too_many_arguments, reason = "keywords in Python")]
pub fn fit_sphere(
    points: &Bound<'_, PyAny>,
    covariance_mm2: Option<&Bound<'_, PyAny>>,
    sigma_mm: Option<&Bound<'_, PyAny>>,
    radius_mm: Option<f64>,
    calibration: Option<&Bound<'_, PyAny>>,
    index_sigma: Option<f64>,
    seed: u64,
) -> PyResult<SphereFit> {
    let options = SphereOptions { radius_mm, seed };
    let (fit, common) = Given { points, covariance_mm2, sigma_mm, calibration, index_sigma }.fit(
        |cloud| uwscan::cloud::fit_sphere(cloud, &options),
        |fit| (dynamic(&fit.covariance_mm2), &fit.influence),
    )?;
    Ok(SphereFit { fit, common })
}
