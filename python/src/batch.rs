//! One recording of an archive at a time: what `uwscan.batch` hands to its workers.

use crate::errors::{OrRaise, warn};
use crate::jobs::Keywords;
use crate::long;
use pyo3::prelude::*;
use pyo3::types::PyDict;
use std::path::PathBuf;
use uwscan::io::batch::ResultRecord;
use uwscan::pipeline::batch::{self, Job, Shared};

fn row<'py>(py: Python<'py>, record: &ResultRecord, kept: bool) -> PyResult<Bound<'py, PyDict>> {
    let row = PyDict::new(py);
    row.set_item("recording", &record.recording)?;
    row.set_item("status", record.status.name())?;
    row.set_item("key", &record.key)?;
    row.set_item("points", record.points)?;
    row.set_item("frames", record.frames)?;
    row.set_item("lost", record.lost)?;
    row.set_item("index", record.index)?;
    row.set_item("seconds", record.seconds)?;
    row.set_item("message", &record.message)?;
    row.set_item("kept", kept)?;
    Ok(row)
}

/// The recordings under a folder as (name, path), in the order of their names.
#[pyfunction]
pub fn batch_jobs(py: Python<'_>, folder: PathBuf) -> PyResult<Vec<(String, PathBuf)>> {
    let jobs = py.detach(|| batch::jobs(&folder)).or_raise(py)?;
    Ok(jobs.into_iter().map(|job| (job.name, job.path)).collect())
}

/// Makes one recording's cloud and its result, unless both are there; gives its row of the table.
#[pyfunction]
#[pyo3(signature = (
    name, path: "str | os.PathLike[str]", calibration: "str | os.PathLike[str]", output: "str | os.PathLike[str]",
    *, refraction = "exact", frame = "camera", stripe = "robust", medium = None, water_index = None, water = None, threads = 1,
) -> "dict[str, typing.Any]")]
#[allow(clippy::too_many_arguments, reason = "keywords in Python")]
pub fn batch_one<'py>(
    py: Python<'py>,
    name: String,
    path: PathBuf,
    calibration: PathBuf,
    output: PathBuf,
    refraction: &str,
    frame: &str,
    stripe: &str,
    medium: Option<&str>,
    water_index: Option<f64>,
    water: Option<(f64, f64, f64)>,
    threads: usize,
) -> PyResult<Bound<'py, PyDict>> {
    let settings = Keywords { refraction, frame, stripe, medium, water_index, water }.settings(py)?;
    let made = long::run(py, Some(threads), None, |progress| {
        let (shared, problems) = Shared::read(&calibration, settings)?;
        let (record, kept) = batch::run_one(&Job { name, path }, &shared, &output, progress)?;
        Ok::<_, uwscan::Error>((record, kept, problems))
    })?;
    let (record, kept, problems) = made.or_raise(py)?;
    warn(py, &problems, &[])?;
    row(py, &record, kept)
}

/// Records that a recording failed for a reason from outside; gives its row of the table.
#[pyfunction]
#[pyo3(signature = (
    name, path: "str | os.PathLike[str]", output: "str | os.PathLike[str]", message,
) -> "dict[str, typing.Any]")]
pub fn batch_fail<'py>(
    py: Python<'py>,
    name: String,
    path: PathBuf,
    output: PathBuf,
    message: &str,
) -> PyResult<Bound<'py, PyDict>> {
    let record = batch::record_failure(&Job { name, path }, &output, message).or_raise(py)?;
    row(py, &record, false)
}

/// Writes the table of the recordings' results (CSV), from the files beside their clouds; where it is.
#[pyfunction]
#[pyo3(signature = (
    jobs: "collections.abc.Sequence[tuple[str, str | os.PathLike[str]]]", output: "str | os.PathLike[str]",
) -> "pathlib.Path")]
pub fn batch_table(py: Python<'_>, jobs: Vec<(String, PathBuf)>, output: PathBuf) -> PyResult<PathBuf> {
    let jobs: Vec<Job> = jobs.into_iter().map(|(name, path)| Job { name, path }).collect();
    py.detach(|| batch::write_table(&output, &batch::recorded(&jobs, &output))).or_raise(py)
}
