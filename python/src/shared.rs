//! The calibration's part of a measurement's uncertainty, as keywords: ``calibration=`` and ``index_sigma=``.

use crate::calibration::calibration_of;
use crate::errors::input;
use pyo3::prelude::*;
use std::sync::Arc;
use uwscan::cloud::PointCloud;
use uwscan::io::CalibrationFile;
use uwscan::pipeline::uncertainty::SharedErrors;

/// All of the difference between air and water.
const MOST_INDEX_SIGMA: f64 = 0.3;

/// The calibration that a cloud was made with, and how well its water's index was known.
pub struct Shared {
    file: Arc<CalibrationFile>,
    index_sigma: Option<f64>,
}

impl Shared {
    /// What the keywords say; `None` without a calibration.
    pub fn of(
        py: Python<'_>,
        calibration: Option<&Bound<'_, PyAny>>,
        index_sigma: Option<f64>,
    ) -> PyResult<Option<Self>> {
        if let Some(sigma) = index_sigma {
            if calibration.is_none() {
                return Err(input(py, "index_sigma goes with calibration, whose place it takes"));
            }
            if !(0.0..=MOST_INDEX_SIGMA).contains(&sigma) {
                return Err(input(
                    py,
                    format!("index_sigma must be from 0 to {MOST_INDEX_SIGMA}, got {sigma}"),
                ));
            }
        }
        calibration.map(|any| Ok(Self { file: calibration_of(any)?, index_sigma })).transpose()
    }

    /// The errors that the calibration brought into a cloud, and what to know of the water's index.
    pub fn errors<'a>(
        &'a self,
        cloud: &'a PointCloud,
    ) -> Result<(SharedErrors<'a>, Option<String>), uwscan::Error> {
        let shared = SharedErrors::new(cloud, &self.file.calibration)?;
        if let Some(sigma) = self.index_sigma {
            return Ok((shared.with_index_known_to(sigma), None));
        }
        let warning = shared.other_index().map(|own| {
            format!(
                "light was traced with an index of {:.5}, the calibration's water has {own:.5}; the index counts as uncertain as the \
                 calibration's. If reconstruct was given it, say how well it is known: index_sigma=",
                shared.index(),
            )
        });
        Ok((shared, warning))
    }
}
