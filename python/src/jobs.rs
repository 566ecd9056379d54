//! The long jobs: calibrate, reconstruct, simulate.

use crate::calibration::{Calibration, calibration_of, overwrite as allowed};
use crate::capture::path_of;
use crate::cloud::Cloud;
use crate::errors::{OrRaise, input, warn};
use crate::long;
use crate::residuals::residuals;
use crate::stripe::method as stripe_method;
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyString};
use std::path::PathBuf;
use std::sync::Arc;
use uwscan::cloud::Frame;
use uwscan::io::{Medium, Severity};
use uwscan::pipeline::reconstruct::{Refraction, Settings, WaterIndex};
use uwscan::pipeline::report as reporting;
use uwscan::pipeline::{self, calibrate as calibration, reconstruct as reconstruction};

/// The calibration from captures of a chessboard, in air, in water or both: one joint adjustment of the whole instrument.
///
/// Parameters
/// ----------
/// captures : Capture, path, or sequence of them
///     Captures of kind "calibration".
/// rig : str or os.PathLike, optional
///     A rig file that replaces the captures' own.
/// method : str, default "joint"
///     "joint", or "paper" for the paper's method (on land, windows neglected until reconstruction).
/// report : str or os.PathLike, optional
///     Write a page (.html), too: residual maps, coverage of the view, placements, correlations, rejected images, advice.
/// made : str, optional
///     When the page was made, as it is to say it.
/// overwrite : bool, default False
///     Replace the page where it exists.
/// threads : int, optional
///     Threads to work on; one a processor by default. The result does not depend on it.
/// progress : callable, optional
///     Told of progress as ``progress(stage, done, total)``; False tells nobody. In a notebook with tqdm a bar is shown by itself.
///
/// Returns
/// -------
/// Calibration
///     With ``residuals``, by the joint method.
///
/// Raises
/// ------
/// CalibrationError
///     Where the captures determine no calibration; it says what to capture.
/// CaptureError, FileError, FormatError
///     Where a capture is of the wrong kind, shows no board, or a file is wrong.
/// ExistingFileError, InputError
///     Where the page exists, or its name is no page's: before anything is calibrated.
/// KeyboardInterrupt
///     On Ctrl-C; nothing was changed.
#[pyfunction]
#[pyo3(signature = (
    captures: "Capture | str | os.PathLike[str] | collections.abc.Sequence[Capture | str | os.PathLike[str]]",
    *,
    rig: "str | os.PathLike[str] | None" = None,
    method: "typing.Literal['joint', 'paper']" = "joint",
    report: "str | os.PathLike[str] | None" = None,
    made = None,
    overwrite = false,
    threads = None,
    progress: "collections.abc.Callable[[str, int, int], object] | typing.Literal[False] | None" = None,
) -> "Calibration")]
#[allow(clippy::too_many_arguments, reason = "keywords in Python")]
pub fn calibrate(
    py: Python<'_>,
    captures: &Bound<'_, PyAny>,
    rig: Option<PathBuf>,
    method: &str,
    report: Option<PathBuf>,
    made: Option<&str>,
    overwrite: bool,
    threads: Option<usize>,
    progress: Option<&Bound<'_, PyAny>>,
) -> PyResult<Calibration> {
    let method = match method {
        "joint" => uwscan::calib::Method::Joint,
        "paper" => uwscan::calib::Method::Paper,
        _ => return Err(input(py, format!("method must be \"joint\" or \"paper\", got \"{method}\""))),
    };
    // A path is a sequence too, of letters.
    let one = captures.is_instance_of::<crate::capture::Capture>()
        || captures.is_instance_of::<PyString>()
        || captures.hasattr("__fspath__")?;
    let paths: Vec<PathBuf> = match one {
        true => vec![path_of("captures", captures)?],
        false => captures
            .try_iter()
            .map_err(|_| input(py, "captures must be captures or paths"))?
            .map(|any| path_of("a capture", &any?))
            .collect::<PyResult<_>>()?,
    };
    if let Some(page) = &report {
        reporting::check(page, &[], allowed(overwrite)).or_raise(py)?;
    }
    let settings = calibration::Settings { rig, method };
    let calibrated =
        long::run(py, threads, progress, |progress| calibration::calibrate(&paths, &settings, progress))?;
    let calibrated = calibrated.or_raise(py)?;
    warn(py, &calibrated.problems, &calibrated.file.calibration.warnings)?;
    if let Some(page) = &report {
        let write = || {
            reporting::write_calibration_report(
                &calibrated,
                made.map(str::to_owned),
                page,
                allowed(overwrite),
            )
        };
        py.detach(write).or_raise(py)?;
    }
    let across = calibrated.file.calibration.across;
    let remains = (!calibrated.remains.is_empty())
        .then(|| residuals(py, &calibrated.remains, across).and_then(|remains| Py::new(py, remains)))
        .transpose()?;
    Ok(Calibration { file: Arc::new(calibrated.file), remains })
}

/// How to reconstruct, from keywords.
pub struct Keywords<'a> {
    pub refraction: &'a str,
    pub frame: &'a str,
    pub stripe: &'a str,
    pub medium: Option<&'a str>,
    pub water_index: Option<f64>,
    pub water: Option<(f64, f64, f64)>,
}

impl Keywords<'_> {
    pub fn settings(&self, py: Python<'_>) -> PyResult<Settings> {
        let water = match (self.water_index, self.water) {
            (None, None) => WaterIndex::Calibrated,
            (Some(index), None) if (1.0..=2.0).contains(&index) => WaterIndex::Given(index),
            (Some(index), None) => {
                return Err(input(py, format!("water_index must be from 1 to 2, got {index}")));
            }
            (None, Some((temperature_c, salinity_psu, depth_m))) => {
                if !(temperature_c.is_finite() && salinity_psu.is_finite() && depth_m.is_finite()) {
                    return Err(input(py, "water must be finite: (temperature_c, salinity_psu, depth_m)"));
                }
                WaterIndex::Properties { temperature_c, salinity_psu, depth_m }
            }
            (Some(_), Some(_)) => return Err(input(py, "give water_index or water, not both")),
        };
        let unknown =
            |name: &str, known: &str, got: &str| input(py, format!("{name} must be {known}, got \"{got}\""));
        Ok(Settings {
            stripe: stripe_method(py, self.stripe)?,
            refraction: match self.refraction {
                "exact" => Refraction::Exact,
                "paper" => Refraction::Paper,
                "none" => Refraction::None,
                got => return Err(unknown("refraction", "\"exact\", \"paper\" or \"none\"", got)),
            },
            frame: Frame::from_name(self.frame)
                .ok_or_else(|| unknown("frame", "\"camera\" or \"galvo\"", self.frame))?,
            medium: match self.medium {
                None => None,
                Some(name) => Some(
                    Medium::from_name(name).ok_or_else(|| unknown("medium", "\"air\" or \"water\"", name))?,
                ),
            },
            water,
        })
    }
}

/// The points of a scan, each with its covariance: what ``uwscan reconstruct`` writes, bit for bit.
///
/// Parameters
/// ----------
/// capture : Capture, str or os.PathLike
///     A capture of kind "scan": a folder or a recording.
/// calibration : Calibration, str or os.PathLike
///     Of the instrument that took it.
/// refraction : str, default "exact"
///     "exact" through both windows; "paper": its approximations; "none": straight.
/// frame : str, default "camera"
///     Frame of the points: "camera" or "galvo".
/// stripe : str, default "robust"
///     How a stripe's centre is estimated: a method of ``uwscan.extract_stripe``. "precise" reads noise and width off each image by itself
///     and takes six times as long; its points are as near the truth.
/// medium : str, optional
///     What is outside the windows, "air" or "water"; by default what the capture says.
/// water_index : float, optional
///     The water's index at the laser's wavelength, relative to air; by default the calibration's.
/// water : tuple of float, optional
///     (temperature_c, salinity_psu, depth_m), which the water's index follows from.
/// threads : int, optional
///     Threads to work on; one a processor by default. The result does not depend on it.
/// progress : callable, optional
///     Told of progress as ``progress(stage, done, total)``; False tells nobody. In a notebook with tqdm a bar is shown by itself.
///
/// Returns
/// -------
/// Cloud
///     With all attributes; ``report`` says what was left out, and why.
///
/// Raises
/// ------
/// CaptureError
///     Where the capture is no scan, nothing says the water's index, or no image gave a point.
/// FileError, FormatError
///     Where a file is wrong. A lost image is no error: a ``LossWarning`` tells of it.
/// KeyboardInterrupt
///     On Ctrl-C.
#[pyfunction]
#[pyo3(signature = (
    capture: "Capture | str | os.PathLike[str]",
    calibration: "Calibration | str | os.PathLike[str]",
    *,
    refraction: "typing.Literal['exact', 'paper', 'none']" = "exact",
    frame: "typing.Literal['camera', 'galvo']" = "camera",
    stripe: "typing.Literal['fast', 'robust', 'precise', 'ridge', 'cog', 'blais-rioux']" = "robust",
    medium: "typing.Literal['air', 'water'] | None" = None,
    water_index = None,
    water = None,
    threads = None,
    progress: "collections.abc.Callable[[str, int, int], object] | typing.Literal[False] | None" = None,
) -> "Cloud")]
#[allow(clippy::too_many_arguments, reason = "keywords in Python")]
pub fn reconstruct(
    py: Python<'_>,
    capture: &Bound<'_, PyAny>,
    calibration: &Bound<'_, PyAny>,
    refraction: &str,
    frame: &str,
    stripe: &str,
    medium: Option<&str>,
    water_index: Option<f64>,
    water: Option<(f64, f64, f64)>,
    threads: Option<usize>,
    progress: Option<&Bound<'_, PyAny>>,
) -> PyResult<Cloud> {
    let settings = Keywords { refraction, frame, stripe, medium, water_index, water }.settings(py)?;
    let path = path_of("capture", capture)?;
    let calibration = calibration_of(calibration)?;
    let made = long::run(py, threads, progress, |progress| {
        reconstruction::reconstruct(&path, &calibration, &settings, progress)
    })?;
    let made = made.or_raise(py)?;
    warn(py, &made.problems, &made.warnings)?;
    let report = PyDict::new(py);
    report.set_item("frames", made.frames)?;
    report.set_item("rejected", &made.rejected)?;
    report.set_item("index", made.index)?;
    report.set_item("warnings", &made.warnings)?;
    let lost = made.problems.iter().filter(|p| p.severity == Severity::Loss).map(ToString::to_string);
    report.set_item("lost", lost.collect::<Vec<_>>())?;
    let cloud = Cloud::of(made.cloud);
    cloud.report.get_or_init(py, || report.unbind());
    Ok(cloud)
}

/// Images of a scene as the instrument would see it, with the truth beside them: what ``uwscan simulate`` makes, bit for bit.
///
/// Parameters
/// ----------
/// scene : str or os.PathLike
///     Scene file (TOML).
/// rig : str or os.PathLike, optional
///     A rig file that replaces the one that the scene names.
/// output : str or os.PathLike
///     Capture folder to make, or recording where the name ends in .mcap.
/// overwrite : bool, default False
///     Replace the output where it exists.
/// threads : int, optional
///     Threads to work on; one a processor by default. The images do not depend on it.
/// progress : callable, optional
///     As ``uwscan.reconstruct`` has it.
///
/// Returns
/// -------
/// pathlib.Path
///     The folder with the truth: ``truth.json`` and ``stripes.csv``.
///
/// Raises
/// ------
/// SimulationError, FormatError
///     Where the scene says what can't be.
/// ExistingFileError, FileError
///     Where the output exists or can't be written.
#[pyfunction]
#[pyo3(signature = (
    scene: "str | os.PathLike[str]",
    rig: "str | os.PathLike[str] | None" = None,
    *,
    output: "str | os.PathLike[str]",
    overwrite = false,
    threads = None,
    progress: "collections.abc.Callable[[str, int, int], object] | typing.Literal[False] | None" = None,
) -> "pathlib.Path")]
pub fn simulate(
    py: Python<'_>,
    scene: PathBuf,
    rig: Option<PathBuf>,
    output: PathBuf,
    overwrite: bool,
    threads: Option<usize>,
    progress: Option<&Bound<'_, PyAny>>,
) -> PyResult<PathBuf> {
    let made = long::run(py, threads, progress, |progress| {
        pipeline::simulate::simulate(&scene, rig.as_deref(), &output, allowed(overwrite), progress)
    })?;
    let made = made.or_raise(py)?;
    warn(py, &made.problems, &[])?;
    Ok(made.truth)
}
