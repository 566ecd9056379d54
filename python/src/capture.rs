//! Captures: folders and recordings, their images decoded one at a time.

#[cfg(feature = "stubs")]
use crate::convert::Out;
use crate::errors::{Class, OrRaise, error, input, type_name, warn};
use numpy::{PyArray, PyArrayMethods};
use pyo3::exceptions::PyIndexError;
use pyo3::prelude::*;
use pyo3::sync::PyOnceLock;
#[cfg(feature = "stubs")]
use pyo3::type_hint_union;
use std::path::PathBuf;
use std::sync::{Arc, Mutex, PoisonError};
use uwscan::io::{self, FrameRecord, Pixels, Reduce};

/// Wavelength that an image's channel is chosen by where no rig file says the laser's, nm.
const GREEN_NM: f64 = 532.0;

/// A capture: images of a target or of a scene, each with its voltage, in a folder or in a recording (.mcap).
///
/// A sequence of `Frame`; images are decoded when they are asked for. ``uwscan.open_capture`` opens one; it closes at the end of a
/// ``with``, or by itself.
///
/// Examples
/// --------
/// >>> import uwscan
/// >>> with uwscan.open_capture("fixtures/ball") as capture:
/// ...     len(capture), capture.kind, capture[1].image.shape
/// (43, 'scan', (576, 768))
#[pyclass(module = "uwscan", frozen, sequence)]
pub struct Capture {
    path: PathBuf,
    open: Mutex<Option<Arc<io::Capture>>>,
}

impl Capture {
    fn get(&self, py: Python<'_>) -> PyResult<Arc<io::Capture>> {
        let open = self.open.lock().unwrap_or_else(PoisonError::into_inner).clone();
        open.ok_or_else(|| input(py, format!("{}: the capture is closed", self.path.display())))
    }
}

#[pymethods]
impl Capture {
    /// The folder, or the recording's file.
    #[getter]
    fn path(&self) -> PathBuf {
        self.path.clone()
    }

    /// ``"scan"`` or ``"calibration"``.
    #[getter]
    fn kind(&self, py: Python<'_>) -> PyResult<&'static str> {
        Ok(self.get(py)?.kind.name())
    }

    /// What is outside the windows: ``"air"`` or ``"water"``.
    #[getter]
    fn medium(&self, py: Python<'_>) -> PyResult<&'static str> {
        Ok(self.get(py)?.medium.name())
    }

    /// What is wrong with the capture and can be gone on without: warnings, and images that are lost.
    #[getter]
    fn problems(&self, py: Python<'_>) -> PyResult<Vec<String>> {
        Ok(self.get(py)?.problems().iter().map(ToString::to_string).collect())
    }

    /// SHA-256, in hexadecimal, of all that the capture says; its name doesn't count.
    ///
    /// Raises
    /// ------
    /// FileError
    ///     Where a file cannot be read.
    fn content_hash(&self, py: Python<'_>) -> PyResult<String> {
        let capture = self.get(py)?;
        py.detach(|| capture.content_hash()).or_raise(py)
    }

    /// Frees the recording's file; frames that were taken out of it keep it open.
    fn close(&self) {
        *self.open.lock().unwrap_or_else(PoisonError::into_inner) = None;
    }

    fn __enter__(slf: PyRef<'_, Self>) -> PyRef<'_, Self> {
        slf
    }

    #[pyo3(signature = (*_details: "object") -> "None")]
    fn __exit__(&self, _details: &Bound<'_, PyAny>) {
        self.close();
    }

    fn __len__(&self, py: Python<'_>) -> PyResult<usize> {
        Ok(self.get(py)?.frames.len())
    }

    fn __getitem__(&self, py: Python<'_>, index: isize) -> PyResult<Frame> {
        let capture = self.get(py)?;
        let number = capture.frames.len();
        let at = if index < 0 { index + number as isize } else { index };
        let at = usize::try_from(at).ok().filter(|at| *at < number);
        let at = at.ok_or_else(|| PyIndexError::new_err(format!("frame {index} of {number}")))?;
        Ok(Frame { capture, at, image: PyOnceLock::new() })
    }

    fn __iter__(&self, py: Python<'_>) -> PyResult<Frames> {
        Ok(Frames { capture: self.get(py)?, next: Mutex::new(0) })
    }

    fn __repr__(&self) -> String {
        let open = self.open.lock().unwrap_or_else(PoisonError::into_inner).clone();
        let path = self.path.display();
        match open {
            Some(c) => format!(
                "Capture(\"{path}\", kind=\"{}\", medium=\"{}\", frames={})",
                c.kind.name(),
                c.medium.name(),
                c.frames.len()
            ),
            None => format!("Capture(\"{path}\", closed)"),
        }
    }
}

/// The frames of a capture, one after the other.
#[pyclass(module = "uwscan", frozen)]
pub struct Frames {
    capture: Arc<io::Capture>,
    next: Mutex<usize>,
}

#[pymethods]
impl Frames {
    fn __iter__(slf: PyRef<'_, Self>) -> PyRef<'_, Self> {
        slf
    }

    fn __next__(&self) -> Option<Frame> {
        let mut next = self.next.lock().unwrap_or_else(PoisonError::into_inner);
        let at = *next;
        *next += 1;
        (at < self.capture.frames.len()).then(|| Frame {
            capture: self.capture.clone(),
            at,
            image: PyOnceLock::new(),
        })
    }
}

/// One image of a capture, with what was recorded beside it.
#[pyclass(module = "uwscan", frozen)]
pub struct Frame {
    capture: Arc<io::Capture>,
    at: usize,
    image: PyOnceLock<Py<PyAny>>,
}

impl Frame {
    fn record(&self) -> &FrameRecord {
        &self.capture.frames[self.at]
    }
}

#[pymethods]
impl Frame {
    /// Number of the image, from 0: the `frame_index` of a point.
    #[getter]
    fn index(&self) -> usize {
        self.record().row
    }

    /// Path of the image as frames.csv gives it.
    #[getter]
    fn file(&self) -> String {
        self.record().file.clone()
    }

    /// Which placement of the target the image shows; None in a scan.
    #[getter]
    fn pose(&self) -> Option<u32> {
        self.record().pose
    }

    /// Whether the laser was on.
    #[getter]
    fn laser_on(&self) -> bool {
        self.record().laser_on
    }

    /// The galvanometer's voltage; None where the laser is off.
    #[getter]
    fn voltage_v(&self) -> Option<f64> {
        self.record().voltage_v
    }

    /// Start of the exposure, nanoseconds since the Unix epoch.
    #[getter]
    fn stamp_ns(&self) -> u64 {
        self.record().stamp_ns
    }

    /// The grey image, (h, w), uint8 or uint16: decoded at the first look, on the thread that looks. Of a colour image it is the channel
    /// nearest the laser's wavelength, and the luma where the laser is off.
    #[getter]
    fn image<'py>(&self, py: Python<'py>) -> PyResult<Image<'py>> {
        let decode = || -> PyResult<Py<PyAny>> {
            let nm = self.capture.rig.as_ref().map_or(GREEN_NM, |rig| rig.laser.wavelength_nm);
            let record = self.record();
            let reduce = if record.laser_on { Reduce::Wavelength(nm) } else { Reduce::Luma };
            let image = py.detach(|| self.capture.image(record, reduce, None)).or_raise(py)?;
            let shape = [image.height as usize, image.width as usize];
            Ok(match image.data {
                Pixels::U8(values) => PyArray::from_vec(py, values).reshape(shape)?.into_any(),
                Pixels::U16(values) => PyArray::from_vec(py, values).reshape(shape)?.into_any(),
            }
            .unbind())
        };
        Ok(Image(self.image.get_or_try_init(py, decode)?.bind(py).clone()))
    }

    fn __repr__(&self) -> String {
        let r = self.record();
        let voltage = r.voltage_v.map_or_else(|| "None".to_owned(), |v| v.to_string());
        format!("Frame(index={}, file=\"{}\", voltage_v={voltage})", r.row, r.file)
    }
}

/// An array of either type of pixel.
pub struct Image<'py>(Bound<'py, PyAny>);

impl<'py> IntoPyObject<'py> for Image<'py> {
    type Target = PyAny;
    type Output = Bound<'py, PyAny>;
    type Error = std::convert::Infallible;
    // The macro is imported, since it calls itself by its bare name.
    #[cfg(feature = "stubs")]
    const OUTPUT_TYPE: pyo3::inspect::PyStaticExpr = type_hint_union!(
        <Out<'py, u8> as IntoPyObject<'py>>::OUTPUT_TYPE,
        <Out<'py, u16> as IntoPyObject<'py>>::OUTPUT_TYPE
    );

    fn into_pyobject(self, _: Python<'py>) -> Result<Self::Output, Self::Error> {
        Ok(self.0)
    }
}

/// The capture in a folder, or in a recording (.mcap).
///
/// Parameters
/// ----------
/// path : str or os.PathLike
///     A folder with capture.toml and frames.csv, or a recording, finished or cut off.
///
/// Returns
/// -------
/// Capture
///     A sequence of frames.
///
/// Raises
/// ------
/// FileError, FormatError
///     Where there is no capture, or one of its files is wrong. An image that is missing is no error: a ``LossWarning`` tells of it.
#[pyfunction]
pub fn open_capture(py: Python<'_>, path: PathBuf) -> PyResult<Capture> {
    let capture = py.detach(|| io::Capture::open(&path)).or_raise(py)?;
    warn(py, capture.problems(), &[])?;
    Ok(Capture { path, open: Mutex::new(Some(Arc::new(capture))) })
}

/// A capture, or its path, as an argument.
pub fn path_of(name: &str, any: &Bound<'_, PyAny>) -> PyResult<PathBuf> {
    let py = any.py();
    if let Ok(capture) = any.cast::<Capture>() {
        let capture = capture.get();
        capture.get(py)?;
        return Ok(capture.path.clone());
    }
    any.extract().map_err(|_| {
        let got = type_name(any);
        error(py, Class::Dtype, format!("{name} must be a Capture or a path, got {got}"))
    })
}
