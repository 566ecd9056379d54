//! Point clouds, their arrays lent to NumPy.

use crate::calibration::overwrite;
use crate::convert::{Out, column, floats, lend, lend_rows, row_arrays, table};
use crate::errors::{OrRaise, input, warn};
use numpy::ndarray::ArrayView1;
use numpy::{PyArray, PyArrayMethods, PyUntypedArrayMethods};
use pyo3::prelude::*;
use pyo3::sync::PyOnceLock;
use pyo3::types::PyDict;
use std::path::PathBuf;
use uwscan::cloud::{Frame, PointCloud};
use uwscan::io::clouds;

/// A point cloud in millimetres. Its arrays are read-only views of its own memory; copy what is to be changed.
///
/// Parameters
/// ----------
/// points_mm : array_like
///     Positions, (n, 3), mm.
/// frame : str, default "camera"
///     "camera" (x right, y down, z forward) or "galvo" (x along the mirror's axis).
/// intensity : array_like, optional
///     Brightness of the stripe, (n,), DN.
/// frame_index : array_like, optional
///     Image that a point was seen in, (n,).
/// pixel : array_like, optional
///     Stripe centre (u, v) in the raw image, (n, 2), px.
/// sigma_mm : array_like, optional
///     Standard deviation along the least certain direction, (n,), mm.
/// covariance_mm2 : array_like, optional
///     Covariance of each measurement, (n, 3, 3), or (n, 6) as xx, xy, xz, yy, yz, zz, mm².
/// shared_mm : array_like, optional
///     What of their error all points share: each one's step where that is off by one standard deviation, (n, 3), mm. Part of
///     the covariance, too.
///
/// Raises
/// ------
/// InputError
///     For arrays of another shape, or of other lengths.
///
/// Examples
/// --------
/// >>> import numpy as np, uwscan
/// >>> cloud = uwscan.Cloud(np.zeros((5, 3)), sigma_mm=0.1)
/// >>> len(cloud), cloud.sigma_mm.shape, cloud.pixel is None
/// (5, (5,), True)
#[pyclass(module = "uwscan", frozen)]
pub struct Cloud {
    pub inner: PointCloud,
    pub report: PyOnceLock<Py<PyDict>>,
    covariances: PyOnceLock<Py<PyAny>>,
}

impl Cloud {
    /// A cloud of the library's.
    pub fn of(inner: PointCloud) -> Self {
        Self { inner, report: PyOnceLock::new(), covariances: PyOnceLock::new() }
    }
}

type MaybeFloats<'py> = PyResult<Option<Out<'py, f32>>>;

#[pymethods]
impl Cloud {
    #[new]
    #[pyo3(signature = (
        points_mm: "numpy.typing.ArrayLike",
        *,
        frame = "camera",
        intensity: "numpy.typing.ArrayLike | None" = None,
        frame_index: "numpy.typing.ArrayLike | None" = None,
        pixel: "numpy.typing.ArrayLike | None" = None,
        sigma_mm: "numpy.typing.ArrayLike | None" = None,
        covariance_mm2: "numpy.typing.ArrayLike | None" = None,
        shared_mm: "numpy.typing.ArrayLike | None" = None,
    ))]
    #[allow(clippy::too_many_arguments, reason = "keywords in Python")]
    fn new(
        points_mm: &Bound<'_, PyAny>,
        frame: &str,
        intensity: Option<&Bound<'_, PyAny>>,
        frame_index: Option<&Bound<'_, PyAny>>,
        pixel: Option<&Bound<'_, PyAny>>,
        sigma_mm: Option<&Bound<'_, PyAny>>,
        covariance_mm2: Option<&Bound<'_, PyAny>>,
        shared_mm: Option<&Bound<'_, PyAny>>,
    ) -> PyResult<Self> {
        let py = points_mm.py();
        let frame = Frame::from_name(frame)
            .ok_or_else(|| input(py, format!("frame must be \"camera\" or \"galvo\", got \"{frame}\"")))?;
        let points: Vec<[f64; 3]> = row_arrays(&table("points_mm", points_mm, 3)?);
        let n = points.len();
        let singles = |name: &str, any: &Bound<'_, PyAny>| -> PyResult<Vec<f64>> {
            Ok(column(name, any, n)?.as_array().iter().copied().collect())
        };
        let narrow = |values: Vec<f64>| values.into_iter().map(|v| v as f32).collect();
        let mut cloud = PointCloud::new(frame, points);
        if let Some(any) = intensity {
            cloud = cloud.with_intensities(narrow(singles("intensity", any)?)).or_raise(py)?;
        }
        if let Some(any) = frame_index {
            let rows = singles("frame_index", any)?;
            let whole =
                |v: &f64| *v >= 0.0 && *v <= f64::from(u32::MAX) && (v - v.trunc()).abs() < f64::EPSILON;
            if !rows.iter().all(whole) {
                return Err(input(py, "frame_index must hold whole numbers from 0"));
            }
            cloud = cloud.with_frame_rows(rows.into_iter().map(|v| v as u32).collect()).or_raise(py)?;
        }
        if let Some(any) = pixel {
            let pixels: Vec<[f64; 2]> = row_arrays(&table("pixel", any, 2)?);
            cloud =
                cloud.with_pixels(pixels.into_iter().map(|p| p.map(|c| c as f32)).collect()).or_raise(py)?;
        }
        if let Some(any) = sigma_mm {
            cloud = cloud.with_sigmas_mm(narrow(singles("sigma_mm", any)?)).or_raise(py)?;
        }
        if let Some(any) = covariance_mm2 {
            cloud = cloud.with_covariances_mm2(packed_covariances(any, n)?).or_raise(py)?;
        }
        if let Some(any) = shared_mm {
            let steps: Vec<[f64; 3]> = row_arrays(&table("shared_mm", any, 3)?);
            cloud = cloud
                .with_shared_mm(steps.into_iter().map(|s| s.map(|c| c as f32)).collect())
                .or_raise(py)?;
        }
        Ok(Self::of(cloud))
    }

    /// The cloud of a file: .ply, .pcd, .xyz, .csv or .e57; .las and .laz where the module was built with its feature ``las``.
    ///
    /// Raises
    /// ------
    /// FileError, FormatError
    ///     Where the file can't be read, or holds what no cloud holds.
    #[staticmethod]
    fn load(py: Python<'_>, path: PathBuf) -> PyResult<Self> {
        let (cloud, problems) = py.detach(|| clouds::read(&path)).or_raise(py)?;
        warn(py, &problems, &[])?;
        Ok(Self::of(cloud))
    }

    /// Writes the cloud, whole or not at all: .ply or .pcd (binary), .xyz, .csv or .e57 (.las and .laz with the
    /// feature ``las``); what a format can't hold is left out.
    ///
    /// Raises
    /// ------
    /// ExistingFileError
    ///     Where the file exists, unless `overwrite` is true.
    /// FormatError
    ///     For a name with another ending.
    #[pyo3(signature = (path, *, overwrite = false))]
    fn save(&self, py: Python<'_>, path: PathBuf, overwrite: bool) -> PyResult<()> {
        py.detach(|| {
            let format = clouds::Format::of(&path)?;
            clouds::write(&path, self::overwrite(overwrite), &self.inner, format)
        })
        .or_raise(py)
    }

    /// Positions, (n, 3) float64, mm.
    #[getter]
    fn points_mm<'py>(slf: &Bound<'py, Self>) -> PyResult<Out<'py, f64>> {
        lend_rows(slf.as_any(), slf.get().inner.positions_mm())
    }

    /// Brightness of the stripe, (n,) float32, DN; None where the cloud has none.
    #[getter]
    fn intensity<'py>(slf: &Bound<'py, Self>) -> MaybeFloats<'py> {
        lent(slf, slf.get().inner.intensities())
    }

    /// Standard deviation along the least certain direction, (n,) float32, mm; None where the cloud has none.
    #[getter]
    fn sigma_mm<'py>(slf: &Bound<'py, Self>) -> MaybeFloats<'py> {
        lent(slf, slf.get().inner.sigmas_mm())
    }

    /// Image that each point was seen in, (n,) uint32; None where the cloud has none.
    #[getter]
    fn frame_index<'py>(slf: &Bound<'py, Self>) -> PyResult<Option<Out<'py, u32>>> {
        slf.get().inner.frame_rows().map(|rows| lend(slf.as_any(), &ArrayView1::from(rows))).transpose()
    }

    /// Stripe centre (u, v) in the raw image, (n, 2) float32, px; (0, 0) is the centre of the top-left pixel. None where the cloud has none.
    #[getter]
    fn pixel<'py>(slf: &Bound<'py, Self>) -> MaybeFloats<'py> {
        slf.get().inner.pixels().map(|pixels| lend_rows(slf.as_any(), pixels)).transpose()
    }

    /// Covariance of each measurement, (n, 3, 3) float32, mm²; None where the cloud has none. Made at the first look.
    #[getter]
    fn covariance_mm2<'py>(&self, py: Python<'py>) -> MaybeFloats<'py> {
        let Some(packed) = self.inner.covariances_mm2() else { return Ok(None) };
        let unpack = || -> PyResult<Py<PyAny>> {
            let full = |&[xx, xy, xz, yy, yz, zz]: &[f32; 6]| [xx, xy, xz, xy, yy, yz, xz, yz, zz];
            let values: Vec<f32> = packed.iter().flat_map(full).collect();
            let array = PyArray::from_vec(py, values).reshape([packed.len(), 3, 3])?;
            array.call_method1("setflags", (false,))?;
            Ok(array.into_any().unbind())
        };
        Ok(Some(Out::known(self.covariances.get_or_try_init(py, unpack)?.bind(py).clone())))
    }

    /// What of their error all points share, as that of the sheet's thickness: each one's step where that is off by one standard deviation, (n, 3)
    /// float32, mm. It is part of the covariance, does not average out, and is in the sigmas of what is fitted. None where the cloud tells none.
    #[getter]
    fn shared_mm<'py>(slf: &Bound<'py, Self>) -> MaybeFloats<'py> {
        slf.get().inner.shared_mm().map(|steps| lend_rows(slf.as_any(), steps)).transpose()
    }

    /// Unit normals of the surface, (n, 3) float32, towards the sensor; (0, 0, 0) where the neighbours tell none. None where the cloud has none:
    /// ``uwscan.estimate_normals`` makes them.
    #[getter]
    fn normals<'py>(slf: &Bound<'py, Self>) -> MaybeFloats<'py> {
        slf.get().inner.normals().map(|normals| lend_rows(slf.as_any(), normals)).transpose()
    }

    /// Signed distance of each point from a reference, (n,) float32, mm, as ``uwscan.compare`` measured or a file tells it; None where the cloud has
    /// none.
    #[getter]
    fn deviation_mm<'py>(slf: &Bound<'py, Self>) -> MaybeFloats<'py> {
        lent(slf, slf.get().inner.deviations_mm())
    }

    /// Frame of the coordinates: ``"camera"`` or ``"galvo"``.
    #[getter]
    fn frame(&self) -> &'static str {
        self.inner.frame().name()
    }

    /// What ``uwscan.reconstruct`` tells besides the points: images used, rows without a point by reason, the index of refraction outside the
    /// windows, warnings, losses. None for another cloud.
    #[getter]
    fn report<'py>(&self, py: Python<'py>) -> Option<Bound<'py, PyDict>> {
        self.report.get(py).map(|d| d.bind(py).clone())
    }

    /// Lowest and highest corner of the box around all points, mm; None for a cloud without points.
    #[getter]
    fn bounding_box_mm(&self) -> Option<([f64; 3], [f64; 3])> {
        self.inner.bounding_box_mm()
    }

    /// The points of an index array or mask, with all that they have.
    ///
    /// Raises
    /// ------
    /// IndexError
    ///     As NumPy's indexing.
    #[pyo3(signature = (index: "numpy.typing.ArrayLike") -> "Cloud")]
    fn select(&self, py: Python<'_>, index: &Bound<'_, PyAny>) -> PyResult<Self> {
        let numpy = py.import("numpy")?;
        let all = numpy.call_method1("arange", (self.inner.len(),))?;
        let chosen = numpy.call_method1("asarray", (index,))?;
        let chosen = all.get_item(chosen)?.call_method0("ravel")?;
        let order: Vec<usize> = chosen.extract()?;
        Ok(Self::of(self.inner.selected(&order)))
    }

    fn __len__(&self) -> usize {
        self.inner.len()
    }

    fn __repr__(&self) -> String {
        format!("Cloud({} points, frame=\"{}\")", self.inner.len(), self.frame())
    }
}

fn lent<'py>(owner: &Bound<'py, Cloud>, values: Option<&[f32]>) -> MaybeFloats<'py> {
    values.map(|values| lend(owner.as_any(), &ArrayView1::from(values))).transpose()
}

/// Covariances (n, 3, 3) or (n, 6) as xx, xy, xz, yy, yz, zz.
pub fn packed_covariances(any: &Bound<'_, PyAny>, n: usize) -> PyResult<Vec<[f32; 6]>> {
    let py = any.py();
    let array = floats("covariance_mm2", any)?;
    let wrong = |got: &[usize]| {
        input(py, format!("covariance_mm2 must have the shape ({n}, 3, 3) or ({n}, 6), got {got:?}"))
    };
    let order: [usize; 6] = match *array.shape() {
        [got, 6] if got == n => [0, 1, 2, 3, 4, 5],
        [got, 3, 3] if got == n => [0, 1, 2, 4, 5, 8],
        ref got => return Err(wrong(got)),
    };
    let values: Vec<f64> = array.as_array().iter().copied().collect();
    let entries = values.len().checked_div(n).unwrap_or(1).max(1);
    let matrices = values.chunks_exact(entries);
    if entries == 9 {
        let lopsided = |m: &[f64]| {
            [(1, 3), (2, 6), (5, 7)]
                .iter()
                .any(|&(a, b)| (m[a] - m[b]).abs() > 1e-6 * m[a].abs().max(m[b].abs()))
        };
        if let Some(at) = matrices.clone().position(lopsided) {
            return Err(input(py, format!("covariance_mm2[{at}] is not symmetric")));
        }
    }
    Ok(matrices.map(|m| order.map(|i| m[i] as f32)).collect())
}

/// Points as an argument: a cloud, or positions with what else is known of them.
pub fn cloud_of(
    any: &Bound<'_, PyAny>,
    covariance_mm2: Option<&Bound<'_, PyAny>>,
    sigma_mm: Option<&Bound<'_, PyAny>>,
) -> PyResult<PointCloud> {
    let py = any.py();
    let mut cloud = match any.cast::<Cloud>() {
        Ok(cloud) => cloud.get().inner.clone(),
        Err(_) => PointCloud::new(Frame::Camera, row_arrays(&table("points", any, 3)?)),
    };
    let n = cloud.len();
    match (covariance_mm2, sigma_mm) {
        (Some(_), Some(_)) => return Err(input(py, "give covariance_mm2 or sigma_mm, not both")),
        (Some(given), None) => {
            cloud = cloud.with_covariances_mm2(packed_covariances(given, n)?).or_raise(py)?;
        }
        (None, Some(given)) => {
            // The same in all directions, as nothing else is said.
            let sigmas = column("sigma_mm", given, n)?;
            let round = |s: &f64| {
                let v = (s * s) as f32;
                [v, 0.0, 0.0, v, 0.0, v]
            };
            cloud = cloud.with_covariances_mm2(sigmas.as_array().iter().map(round).collect()).or_raise(py)?;
        }
        (None, None) => {}
    }
    Ok(cloud)
}
