//! A calibration: the instrument as estimated, and how well it is known.

use crate::convert::{Out, pose_rows};
use crate::errors::{Class, OrRaise, error, type_name, warn};
use crate::model::Scanner;
use crate::residuals::Residuals;
use pyo3::prelude::*;
use pyo3::types::PyDict;
use std::path::PathBuf;
use std::sync::Arc;
use uwscan::calib::{Across, Method, NAMES};
use uwscan::io::Overwrite;
use uwscan::io::calibration_toml::{self, CalibrationFile};

/// What ``overwrite=`` allows.
pub fn overwrite(replace: bool) -> Overwrite {
    if replace { Overwrite::Replace } else { Overwrite::Refuse }
}

/// The instrument as a calibration estimated it: camera, both windows, galvanometer, laser fan, and the water's index. Camera frame (x right,
/// y down, z forward), millimetres, pixels; pixel (0, 0) is the centre of the top-left one.
///
/// Made by ``uwscan.calibrate`` or ``Calibration.load``.
#[pyclass(module = "uwscan", frozen)]
pub struct Calibration {
    pub file: Arc<CalibrationFile>,
    /// What remained of each measurement, of one that was just made by the joint method.
    pub remains: Option<Py<Residuals>>,
}

#[pymethods]
impl Calibration {
    /// The calibration of a file.
    ///
    /// Raises
    /// ------
    /// FileError, FormatError
    ///     Where the file can't be read, or holds what no calibration holds.
    #[staticmethod]
    pub fn load(py: Python<'_>, path: PathBuf) -> PyResult<Self> {
        let (file, problems) = py.detach(|| calibration_toml::read(&path)).or_raise(py)?;
        warn(py, &problems, &[])?;
        Ok(Self { file: Arc::new(file), remains: None })
    }

    /// Writes a calibration file (TOML), whole or not at all.
    ///
    /// Raises
    /// ------
    /// ExistingFileError
    ///     Where the file exists, unless `overwrite` is true.
    /// FileError
    ///     Where it can't be written.
    #[pyo3(signature = (path, *, overwrite = false))]
    fn save(&self, py: Python<'_>, path: PathBuf, overwrite: bool) -> PyResult<()> {
        py.detach(|| calibration_toml::write(&path, self::overwrite(overwrite), &self.file)).or_raise(py)
    }

    /// K, (3, 3) float64, px: as OpenCV has it.
    #[getter]
    fn camera_matrix<'py>(&self, py: Python<'py>) -> PyResult<Out<'py, f64>> {
        let c = &self.file.calibration.scanner().camera;
        Out::matrix(py, &[[c.fx, 0.0, c.cx], [0.0, c.fy, c.cy], [0.0, 0.0, 1.0]])
    }

    /// Distortion (k1, k2, p1, p2, k3), (5,) float64: OpenCV's order and sense.
    #[getter]
    fn distortion<'py>(&self, py: Python<'py>) -> Out<'py, f64> {
        let d = &self.file.calibration.scanner().camera.distortion;
        Out::of(py, vec![d.k1, d.k2, d.p1, d.p2, d.k3])
    }

    /// Width and height of an image, px.
    #[getter]
    fn image_size(&self) -> (u32, u32) {
        let [width, height] = self.file.calibration.image_size;
        (width, height)
    }

    /// The mirror axis's point nearest the optical centre, (3,) float64, camera frame, mm.
    #[getter]
    fn axis_point_mm<'py>(&self, py: Python<'py>) -> Out<'py, f64> {
        Out::of(py, self.file.calibration.scanner().galvo.origin_mm.as_slice().to_vec())
    }

    /// Unit vector along the mirror's axis, (3,) float64, camera frame.
    #[getter]
    fn axis_direction<'py>(&self, py: Python<'py>) -> Out<'py, f64> {
        Out::of(py, self.file.calibration.scanner().galvo.axes.column(0).iter().copied().collect())
    }

    /// Galvanometer frame in the camera frame, (4, 4) float64, mm: ``p_camera = camera_from_galvo @ [*p_galvo, 1]``.
    #[getter]
    fn camera_from_galvo<'py>(&self, py: Python<'py>) -> PyResult<Out<'py, f64>> {
        Out::matrix(py, &pose_rows(&self.file.calibration.scanner().camera_from_galvo().isometry()))
    }

    /// Every figure of the instrument by its name, which ends in its unit.
    #[getter]
    fn values<'py>(&self, py: Python<'py>) -> PyResult<Table<'py>> {
        let all = PyDict::new(py);
        for q in self.file.calibration.quantities() {
            all.set_item(q.name, q.value)?;
        }
        Ok(Table(all))
    }

    /// Standard deviation of every figure by its name; empty without a covariance.
    #[getter]
    fn sigmas<'py>(&self, py: Python<'py>) -> PyResult<Table<'py>> {
        let all = PyDict::new(py);
        if self.file.calibration.covariance.is_some() {
            for q in self.file.calibration.quantities() {
                all.set_item(q.name, q.sigma)?;
            }
        }
        Ok(Table(all))
    }

    /// Covariance of small changes of the instrument, (34, 34) float64, in the order and units of `covariance_names`; None for the
    /// paper's method, which gives none.
    #[getter]
    fn covariance<'py>(&self, py: Python<'py>) -> PyResult<Option<Out<'py, f64>>> {
        self.file.calibration.covariance.as_ref().map(|c| Out::dense(py, c)).transpose()
    }

    /// Names of the covariance's rows.
    #[getter]
    fn covariance_names(&self) -> Vec<&'static str> {
        NAMES.to_vec()
    }

    /// ``"joint"`` or ``"paper"``.
    #[getter]
    fn method(&self) -> &'static str {
        match self.file.calibration.method {
            Method::Joint => "joint",
            Method::Paper => "paper",
        }
    }

    /// Lines that stripes are measured along: ``"rows"`` or ``"columns"``.
    #[getter]
    fn axis(&self) -> &'static str {
        match self.file.calibration.across {
            Across::U => "rows",
            Across::V => "columns",
        }
    }

    /// The exact model of the instrument.
    #[getter]
    fn scanner(&self) -> Scanner {
        Scanner { inner: *self.file.calibration.scanner() }
    }

    /// The water's index at the laser's wavelength, relative to air, during a scan whose nominal index is `nominal` (the calibration's own by
    /// default); None for a calibration on land where none is given.
    #[pyo3(signature = (nominal = None))]
    fn water_index(&self, nominal: Option<f64>) -> Option<f64> {
        let c = &self.file.calibration;
        let nominal = nominal.or(c.nominal_water_index).or_else(|| self.file.rig.water_index());
        nominal.map(|n| c.water(n).index)
    }

    /// What to know before trusting the calibration.
    #[getter]
    fn warnings(&self) -> Vec<String> {
        self.file.calibration.warnings.clone()
    }

    /// Images that were left out, with the reason.
    #[getter]
    fn rejected(&self) -> Vec<(String, String)> {
        let rejected = &self.file.calibration.statistics.rejected;
        rejected.iter().map(|r| (r.file.clone(), r.reason.clone())).collect()
    }

    /// What remained: root mean squares, and how many took part.
    #[getter]
    fn statistics<'py>(&self, py: Python<'py>) -> PyResult<Table<'py>> {
        let s = &self.file.calibration.statistics;
        let all = PyDict::new(py);
        for (name, value) in [
            ("reprojection_rms_px", s.reprojection_rms_px),
            ("stripe_rms_px", s.stripe_rms_px),
            ("stripe_rms_mm", s.stripe_rms_mm),
            ("corner_scale", s.corner_scale),
            ("stripe_scale", s.stripe_scale),
        ] {
            all.set_item(name, value)?;
        }
        for (name, value) in [
            ("corners", s.corners),
            ("stripe_points", s.stripe_points),
            ("corners_rejected", s.corners_rejected),
            ("stripe_points_rejected", s.stripe_points_rejected),
            ("poses_used", s.poses_used),
            ("frames_used", s.frames_used),
            ("iterations", s.iterations),
        ] {
            all.set_item(name, value as f64)?;
        }
        Ok(Table(all))
    }

    /// What remained of every corner and stripe point; None for a calibration that was read from a file, which does not hold them, and for one by the
    /// paper's method.
    #[getter]
    fn residuals(&self, py: Python<'_>) -> Option<Py<Residuals>> {
        self.remains.as_ref().map(|remains| remains.clone_ref(py))
    }

    fn __repr__(&self) -> String {
        let s = &self.file.calibration.statistics;
        format!(
            "Calibration(method=\"{}\", poses={}, reprojection_rms_px={:.4}, stripe_rms_mm={:.4})",
            self.method(),
            s.poses_used,
            s.reprojection_rms_px,
            s.stripe_rms_mm
        )
    }
}

/// Numbers by name.
pub struct Table<'py>(pub Bound<'py, PyDict>);

impl<'py> IntoPyObject<'py> for Table<'py> {
    type Target = PyDict;
    type Output = Bound<'py, PyDict>;
    type Error = std::convert::Infallible;
    #[cfg(feature = "stubs")]
    const OUTPUT_TYPE: pyo3::inspect::PyStaticExpr = pyo3::type_hint_subscript!(
        pyo3::type_hint_identifier!("builtins", "dict"),
        pyo3::type_hint_identifier!("builtins", "str"),
        pyo3::type_hint_identifier!("builtins", "float")
    );

    fn into_pyobject(self, _: Python<'py>) -> Result<Self::Output, Self::Error> {
        Ok(self.0)
    }
}

/// A calibration, or the path of its file, as an argument.
pub fn calibration_of(any: &Bound<'_, PyAny>) -> PyResult<Arc<CalibrationFile>> {
    let py = any.py();
    if let Ok(calibration) = any.cast::<Calibration>() {
        return Ok(calibration.get().file.clone());
    }
    let path: PathBuf = any.extract().map_err(|_| {
        let got = type_name(any);
        error(py, Class::Dtype, format!("calibration must be a Calibration or a path, got {got}"))
    })?;
    Ok(Calibration::load(py, path)?.file)
}
