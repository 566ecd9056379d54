//! Errors of the library as Python's: a class by kind (`uwscan.errors`), the message as it is.

use pyo3::prelude::*;
use pyo3::sync::PyOnceLock;
use std::io::ErrorKind;
use uwscan::calib::CalibError;
use uwscan::cloud::{CloudError, FitError, MergeError, MeshError, ReferenceError, SurfaceError};
use uwscan::geom::GeomError;
use uwscan::io;
use uwscan::stripe::StripeError;
use uwscan::{Error, Failure};

/// A class of `uwscan.errors`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Class {
    Uwscan,
    Input,
    Dtype,
    File,
    MissingFile,
    ExistingFile,
    Format,
    Capture,
    Calibration,
    Fit,
    Alignment,
    Geometry,
    Surface,
    Simulation,
    Instrument,
}

impl Class {
    fn name(self) -> &'static str {
        match self {
            Self::Uwscan => "UwscanError",
            Self::Input => "InputError",
            Self::Dtype => "DtypeError",
            Self::File => "FileError",
            Self::MissingFile => "MissingFileError",
            Self::ExistingFile => "ExistingFileError",
            Self::Format => "FormatError",
            Self::Capture => "CaptureError",
            Self::Calibration => "CalibrationError",
            Self::Fit => "FitError",
            Self::Alignment => "AlignmentError",
            Self::Geometry => "GeometryError",
            Self::Surface => "SurfaceError",
            Self::Simulation => "SimulationError",
            Self::Instrument => "InstrumentError",
        }
    }
}

static MODULE: PyOnceLock<Py<PyModule>> = PyOnceLock::new();

fn module(py: Python<'_>) -> PyResult<&Bound<'_, PyModule>> {
    Ok(MODULE.get_or_try_init(py, || PyModule::import(py, "uwscan.errors").map(Bound::unbind))?.bind(py))
}

/// An exception of a class with this message.
pub fn error(py: Python<'_>, class: Class, message: impl Into<String>) -> PyErr {
    let made = module(py).and_then(|m| m.getattr(class.name())).and_then(|c| c.call1((message.into(),)));
    made.map_or_else(|e| e, PyErr::from_value)
}

/// An argument that can't be used.
pub fn input(py: Python<'_>, message: impl Into<String>) -> PyErr {
    error(py, Class::Input, message)
}

/// An object's type, as messages name it.
pub fn type_name(any: &Bound<'_, PyAny>) -> String {
    any.get_type().name().map_or_else(|_| "?".to_owned(), |name| format!("{name}"))
}

/// What the library's errors become in Python.
pub trait IntoPyErr {
    /// The exception.
    fn into_py_err(self, py: Python<'_>) -> PyErr;
}

macro_rules! by_class {
    ($($error:ty => $class:ident),* $(,)?) => {$(
        impl IntoPyErr for $error {
            fn into_py_err(self, py: Python<'_>) -> PyErr {
                error(py, Class::$class, self.to_string())
            }
        }
    )*};
}

by_class! {
    StripeError => Input,
    CloudError => Input,
    FitError => Fit,
    GeomError => Geometry,
    MeshError => Input,
    SurfaceError => Surface,
    ReferenceError => Alignment,
    MergeError => Alignment,
    CalibError => Calibration,
}

impl IntoPyErr for io::Error {
    fn into_py_err(self, py: Python<'_>) -> PyErr {
        let message = self.to_string();
        let Self::File { path, source, .. } = &self else {
            let class = match self {
                Self::Exists { .. } => Class::ExistingFile,
                _ => Class::Format,
            };
            return error(py, class, message);
        };
        let class = match source.kind() {
            ErrorKind::NotFound => Class::MissingFile,
            ErrorKind::AlreadyExists => Class::ExistingFile,
            _ => Class::File,
        };
        let made = error(py, class, message);
        let value = made.value(py);
        // What an OSError tells besides; its message stays as it is.
        let told = value
            .setattr("filename", path.as_os_str())
            .and_then(|()| value.setattr("errno", source.raw_os_error()))
            .and_then(|()| value.setattr("strerror", source.to_string()));
        told.err().unwrap_or(made)
    }
}

impl IntoPyErr for Error {
    fn into_py_err(self, py: Python<'_>) -> PyErr {
        let class = match self {
            Self::File(error) => return error.into_py_err(py),
            Self::Fit(error) => return error.into_py_err(py),
            Self::Cancelled => return pyo3::exceptions::PyKeyboardInterrupt::new_err(()),
            Self::Instrument(_) => Class::Instrument,
            Self::Plan(_)
            | Self::Stripe { .. }
            | Self::PageName { .. }
            | Self::OwnInput { .. }
            | Self::CalibrationNeeded { .. }
            | Self::MeshForCloud { .. } => Class::Input,
            Self::Shapes { .. } => Class::Fit,
            Self::Surface { .. } => Class::Surface,
            Self::Reference { .. } => Class::Alignment,
            Self::Calibration(_)
            | Self::PaperCalibration
            | Self::NoCovariance
            | Self::NoPixels
            | Self::OtherCalibration { .. } => Class::Calibration,
            Self::Kind { .. }
            | Self::Board { .. }
            | Self::BoardNotSeen { .. }
            | Self::NoRig { .. }
            | Self::NoWaterIndex { .. }
            | Self::ImageSize { .. }
            | Self::LaserOff { .. }
            | Self::NoPoint { .. }
            | Self::NothingLeft { .. }
            | Self::NoRecording { .. }
            | Self::Twice { .. } => Class::Capture,
            Self::Simulation(_) | Self::Scene { .. } | Self::SceneFile { .. } | Self::SceneWithoutIndex => {
                Class::Simulation
            }
            _ => Class::Uwscan,
        };
        error(py, class, self.to_string())
    }
}

impl IntoPyErr for Failure {
    /// What had been noticed before goes with the exception, as notes: it may be the cause.
    fn into_py_err(self, py: Python<'_>) -> PyErr {
        let notes = &self.notes;
        let said = notes.problems.iter().map(ToString::to_string).chain(notes.warnings.iter().cloned());
        let rejected = notes.rejected.iter().map(|r| format!("rejected: {}: {}", r.file, r.reason));
        let said: Vec<String> = said.chain(rejected).collect();
        let made = self.error.into_py_err(py);
        match made.value(py).setattr("noticed", said) {
            Ok(()) => made,
            Err(e) => e,
        }
    }
}

/// Results whose errors are the library's.
pub trait OrRaise<T> {
    /// The value, or the exception.
    fn or_raise(self, py: Python<'_>) -> PyResult<T>;
}

impl<T, E: IntoPyErr> OrRaise<T> for Result<T, E> {
    fn or_raise(self, py: Python<'_>) -> PyResult<T> {
        self.map_err(|e| e.into_py_err(py))
    }
}

/// Warns of what was noticed: of losses as `uwscan.LossWarning`, of the rest as `uwscan.UwscanWarning`.
pub fn warn(py: Python<'_>, problems: &[io::Problem], warnings: &[String]) -> PyResult<()> {
    if problems.is_empty() && warnings.is_empty() {
        return Ok(());
    }
    let module = module(py)?;
    let (plain, loss) = (module.getattr("UwscanWarning")?, module.getattr("LossWarning")?);
    let warn = |class: &Bound<'_, PyAny>, message: String| {
        py.import("warnings")?.call_method1("warn", (message, class)).map(drop)
    };
    for problem in problems {
        let class = if problem.severity == io::Severity::Loss { &loss } else { &plain };
        warn(class, problem.to_string())?;
    }
    warnings.iter().try_for_each(|warning| warn(&plain, warning.clone()))
}
