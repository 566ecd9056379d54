//! Pages to hand over.

use crate::calibration::overwrite as allowed;
use crate::errors::{OrRaise, input, warn};
use crate::long;
use pyo3::prelude::*;
use std::path::{Path, PathBuf};
use uwscan::cloud::Frame;
use uwscan::pipeline::reconstruct;
use uwscan::pipeline::report::{self as reporting, Settings};

/// Writes a page on scans and clouds: what was measured with what, shapes with both sigmas, deviations, balls beside their nominal values. What
/// ``uwscan report`` writes, but for the date, which is on the page only where it is given.
///
/// Parameters
/// ----------
/// scans : sequence of paths
///     Captures of scans, which need a calibration, and files of clouds.
/// output : str or os.PathLike
///     The page (.html), one file that asks for no other; the figures go beside it as .json and .csv.
/// calibration : str or os.PathLike, optional
///     Calibration file of the instrument; of a cloud it adds its part of the uncertainty.
/// reference : str or os.PathLike, optional
///     A mesh that the scans are held against, after best fit.
/// nominal : str or os.PathLike, optional
///     Nominal radii and distances of the balls of an artefact (.toml or .csv).
/// frame : str, default "camera"
///     Frame of the points of captures: "camera" or "galvo".
/// title : str, optional
///     Title of the page.
/// made : str, optional
///     When it was made, as the page is to say it.
/// overwrite : bool, default False
///     Replace the files where they exist.
/// threads : int, optional
///     Threads to work on; one a processor by default. The page does not depend on it.
/// progress : callable, optional
///     As ``uwscan.reconstruct`` has it.
///
/// Returns
/// -------
/// pathlib.Path
///     The page.
///
/// Raises
/// ------
/// InputError
///     For a name that is no page's, a capture without a calibration.
/// AlignmentError, CaptureError, FitError
///     Where a scan can't be measured or does not come to lie on the reference.
/// ExistingFileError, FileError, FormatError
///     Where a file is wrong, or an output exists.
#[pyfunction]
#[pyo3(signature = (
    scans: "collections.abc.Sequence[str | os.PathLike[str]]",
    output: "str | os.PathLike[str]",
    *,
    calibration: "str | os.PathLike[str] | None" = None,
    reference: "str | os.PathLike[str] | None" = None,
    nominal: "str | os.PathLike[str] | None" = None,
    frame: "typing.Literal['camera', 'galvo']" = "camera",
    title = None,
    made = None,
    overwrite = false,
    threads = None,
    progress: "collections.abc.Callable[[str, int, int], object] | typing.Literal[False] | None" = None,
) -> "pathlib.Path")]
#[allow(clippy::too_many_arguments, reason = "keywords in Python")]
pub fn report(
    py: Python<'_>,
    scans: Vec<PathBuf>,
    output: PathBuf,
    calibration: Option<PathBuf>,
    reference: Option<PathBuf>,
    nominal: Option<PathBuf>,
    frame: &str,
    title: Option<String>,
    made: Option<String>,
    overwrite: bool,
    threads: Option<usize>,
    progress: Option<&Bound<'_, PyAny>>,
) -> PyResult<PathBuf> {
    let frame = Frame::from_name(frame)
        .ok_or_else(|| input(py, format!("frame must be \"camera\" or \"galvo\", got \"{frame}\"")))?;
    if scans.is_empty() {
        return Err(input(py, "scans must name a capture or cloud"));
    }
    let overwrite = allowed(overwrite);
    let given = scans.iter().chain(&calibration).chain(&reference).chain(&nominal);
    let inputs: Vec<&Path> = given.map(PathBuf::as_path).collect();
    reporting::check(&output, &inputs, overwrite).or_raise(py)?;
    let reconstruct = reconstruct::Settings { frame, ..reconstruct::Settings::default() };
    let settings = Settings { calibration, reconstruct, reference, nominal, title, made, named_from: None };
    let found = long::run(py, threads, progress, |progress| reporting::report(&scans, &settings, progress))?;
    let found = found.or_raise(py)?;
    warn(py, &found.problems, &found.record.warnings)?;
    let [page, ..] = py.detach(|| found.write(&output, overwrite)).or_raise(py)?;
    Ok(page)
}
