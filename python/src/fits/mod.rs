//! Shapes fitted to points.
//!
//! | module | has |
//! |---|---|
//! | `shape` | what the classes of all shapes have, once |
//! | `sphere`, `plane`, `cylinder`, `circle` | each class's own, and its fit |
//!
//! Here is what every fit is given, and the calibration's part of what it tells.

mod circle;
mod cylinder;
mod plane;
mod shape;
mod sphere;

pub use circle::{CircleFit, fit_circle};
pub use cylinder::{CylinderFit, fit_cylinder};
pub use plane::{PlaneFit, fit_plane};
pub(crate) use shape::shape;
pub use sphere::{SphereFit, fit_sphere};

use crate::cloud::cloud_of;
use crate::convert::{Out, triple};
use crate::errors::OrRaise;
use crate::shared::Shared;
use nalgebra::DMatrix;
use pyo3::prelude::*;
use pyo3::types::PyDict;
use uwscan::cloud::{Deviations, FitError, Influence, PointCloud};

/// What the fits of all shapes tell.
pub struct Common {
    pub covariance: DMatrix<f64>,
    /// With the calibration's part, where a calibration was given.
    pub total: Option<DMatrix<f64>>,
    /// Which points of the cloud the shape is made of, where it was found among others.
    pub points: Option<Vec<usize>>,
}

/// The standard deviation in a row of a covariance.
pub fn sigma(covariance: &DMatrix<f64>, at: usize) -> f64 {
    covariance[(at, at)].max(0.0).sqrt()
}

/// The standard deviations in three rows of a covariance.
pub fn sigmas<'py>(py: Python<'py>, covariance: &DMatrix<f64>, first: usize) -> Out<'py, f64> {
    Out::of(py, (first..first + 3).map(|i| sigma(covariance, i)).collect())
}

/// A covariance of any size.
pub fn dynamic<const N: usize>(covariance: &nalgebra::SMatrix<f64, N, N>) -> DMatrix<f64> {
    DMatrix::from_fn(N, N, |i, j| covariance[(i, j)])
}

/// All that is known of the points' distances.
pub fn statistics<'py>(py: Python<'py>, d: &Deviations) -> PyResult<Bound<'py, PyDict>> {
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

/// What every fit is given.
pub struct Given<'a, 'py> {
    pub points: &'a Bound<'py, PyAny>,
    pub covariance_mm2: Option<&'a Bound<'py, PyAny>>,
    pub sigma_mm: Option<&'a Bound<'py, PyAny>>,
    pub calibration: Option<&'a Bound<'py, PyAny>>,
    pub index_sigma: Option<f64>,
}

impl Given<'_, '_> {
    /// Fits without the GIL, and adds the calibration's part.
    pub fn fit<F: Send>(
        self,
        fit: impl FnOnce(&PointCloud) -> Result<F, FitError> + Send,
        parts: impl Fn(&F) -> (DMatrix<f64>, &Influence) + Sync,
    ) -> PyResult<(F, Common)> {
        let py = self.points.py();
        let cloud = cloud_of(self.points, self.covariance_mm2, self.sigma_mm)?;
        let shared = Shared::of(py, self.calibration, self.index_sigma)?;
        let made = py.detach(|| {
            let fit = fit(&cloud).map_err(uwscan::Error::Fit)?;
            let (covariance, influence) = parts(&fit);
            let mut told = None;
            let total = match &shared {
                Some(shared) => {
                    let (mut errors, warning) = shared.errors(&cloud)?;
                    told = warning;
                    Some(errors.total(&covariance, influence)?)
                }
                None => None,
            };
            Ok::<_, uwscan::Error>((fit, Common { covariance, total, points: None }, told))
        });
        let (fit, common, told) = made.or_raise(py)?;
        crate::errors::warn(py, &[], told.as_slice())?;
        Ok((fit, common))
    }
}

/// The sensor's place; the origin where none is given.
pub fn sensor(given: Option<&Bound<'_, PyAny>>) -> PyResult<[f64; 3]> {
    given.map_or(Ok([0.0; 3]), |any| triple("sensor_mm", any))
}
