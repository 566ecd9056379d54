//! Triangle meshes.

use crate::calibration::overwrite;
use crate::cloud::cloud_of;
use crate::convert::{Out, lend, lend_rows, row_arrays, table, triple};
use crate::errors::{Class, OrRaise, error, input, type_name, warn};
use numpy::ndarray::ArrayView1;
use pyo3::prelude::*;
use std::path::PathBuf;
use uwscan::cloud::{Frame, SurfaceOptions, TriangleMesh, triangulate};
use uwscan::io::meshes;

/// Triangles on shared vertices, mm; counter-clockwise as seen from the sensor or from outside. Its arrays are read-only views of its own
/// memory.
///
/// Parameters
/// ----------
/// vertices_mm : array_like
///     (n, 3), mm.
/// triangles : array_like
///     (m, 3) whole numbers: corners as places in `vertices_mm`.
/// frame : str, default "camera"
///     "camera" or "galvo".
///
/// Raises
/// ------
/// InputError
///     Where a position is not finite or a corner names no vertex.
///
/// Examples
/// --------
/// >>> import uwscan
/// >>> uwscan.Mesh([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]]).area_mm2
/// 0.5
#[pyclass(module = "uwscan", frozen)]
pub struct Mesh {
    pub inner: TriangleMesh,
    /// Which point of the cloud each vertex is.
    points: Option<Vec<u32>>,
}

#[pymethods]
impl Mesh {
    #[new]
    #[pyo3(signature = (
        vertices_mm: "numpy.typing.ArrayLike",
        triangles: "numpy.typing.ArrayLike",
        *,
        frame = "camera",
    ))]
    fn new(vertices_mm: &Bound<'_, PyAny>, triangles: &Bound<'_, PyAny>, frame: &str) -> PyResult<Self> {
        let py = vertices_mm.py();
        let frame = Frame::from_name(frame)
            .ok_or_else(|| input(py, format!("frame must be \"camera\" or \"galvo\", got \"{frame}\"")))?;
        let vertices = row_arrays(&table("vertices_mm", vertices_mm, 3)?);
        let corners: Vec<[f64; 3]> = row_arrays(&table("triangles", triangles, 3)?);
        let whole = |v: &f64| *v >= 0.0 && *v < f64::from(u32::MAX) && (v - v.trunc()).abs() < f64::EPSILON;
        if !corners.iter().flatten().all(whole) {
            return Err(input(py, "triangles must hold whole numbers from 0"));
        }
        let corners = corners.into_iter().map(|t| t.map(|v| v as u32)).collect();
        let inner = TriangleMesh::new(frame, vertices, corners).or_raise(py)?;
        Ok(Self { inner, points: None })
    }

    /// The mesh of a file: .ply, .stl or .obj.
    ///
    /// Raises
    /// ------
    /// FileError, FormatError
    ///     Where the file can't be read, or holds what no mesh holds.
    #[staticmethod]
    fn load(py: Python<'_>, path: PathBuf) -> PyResult<Self> {
        let (inner, problems) = py.detach(|| meshes::read(&path)).or_raise(py)?;
        warn(py, &problems, &[])?;
        Ok(Self { inner, points: None })
    }

    /// Writes the mesh, whole or not at all: .ply or .stl (binary), .obj, or .glb (in metres).
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
            let format = meshes::Format::of(&path)?;
            meshes::write(&path, self::overwrite(overwrite), &self.inner, format)
        })
        .or_raise(py)
    }

    /// Positions, (n, 3) float64, mm.
    #[getter]
    fn vertices_mm<'py>(slf: &Bound<'py, Self>) -> PyResult<Out<'py, f64>> {
        lend_rows(slf.as_any(), slf.get().inner.vertices_mm())
    }

    /// Corners as places in `vertices_mm`, (m, 3) uint32.
    #[getter]
    fn triangles<'py>(slf: &Bound<'py, Self>) -> PyResult<Out<'py, u32>> {
        lend_rows(slf.as_any(), slf.get().inner.triangles())
    }

    /// Unit normals of the vertices, (n, 3) float32; None where there are none.
    #[getter]
    fn normals<'py>(slf: &Bound<'py, Self>) -> PyResult<Option<Out<'py, f32>>> {
        slf.get().inner.normals().map(|n| lend_rows(slf.as_any(), n)).transpose()
    }

    /// Standard deviation of the vertices along their least certain direction, (n,) float32, mm; None where it is not known.
    #[getter]
    fn sigma_mm<'py>(slf: &Bound<'py, Self>) -> PyResult<Option<Out<'py, f32>>> {
        slf.get().inner.sigmas_mm().map(|s| lend(slf.as_any(), &ArrayView1::from(s))).transpose()
    }

    /// Brightness of the stripe at the vertices, (n,) float32, DN; None where it is not known.
    #[getter]
    fn intensity<'py>(slf: &Bound<'py, Self>) -> PyResult<Option<Out<'py, f32>>> {
        slf.get().inner.intensities().map(|i| lend(slf.as_any(), &ArrayView1::from(i))).transpose()
    }

    /// Which point of the cloud each vertex is, (n,) uint32; None for a mesh that was not triangulated from a cloud.
    #[getter]
    fn point_index<'py>(slf: &Bound<'py, Self>) -> PyResult<Option<Out<'py, u32>>> {
        slf.get().points.as_ref().map(|p| lend(slf.as_any(), &ArrayView1::from(p.as_slice()))).transpose()
    }

    /// Sum of the triangles' areas, mm².
    #[getter]
    fn area_mm2(&self) -> f64 {
        self.inner.area_mm2()
    }

    /// Frame of the coordinates: ``"camera"`` or ``"galvo"``.
    #[getter]
    fn frame(&self) -> &'static str {
        self.inner.frame().name()
    }

    fn __repr__(&self) -> String {
        let m = &self.inner;
        format!(
            "Mesh({} vertices, {} triangles, frame=\"{}\")",
            m.vertices_mm().len(),
            m.triangles().len(),
            self.frame()
        )
    }
}

/// The surface through a cloud's points, none of them moved unless `smooth` is true: triangulated in the image (or in directions from the sensor, for points
/// without pixels), and cut at voids, along occlusions and across steps.
///
/// Parameters
/// ----------
/// cloud : Cloud or array_like
///     One sweep's points; (n, 3), mm.
/// sensor_mm : array_like, optional
///     Where the points were seen from, (3,), mm; the frame's origin by default.
/// steepest_deg : float, default 85
///     Triangles that the line of sight or the light meets at this angle to their normal, or a larger one, are left out.
/// smooth : bool, default False
///     Move vertices to what they and their neighbours say together, each by its sigma: the cloud must have sigmas.
///
/// Returns
/// -------
/// Mesh
///     With normals, and the points' sigmas and intensities as far as they have any.
///
/// Raises
/// ------
/// SurfaceError
///     For fewer than three points, values that are not finite, points on a line, and where no triangle is left.
///
/// Examples
/// --------
/// >>> import numpy as np, uwscan
/// >>> x, y = np.meshgrid(np.arange(5.0), np.arange(5.0))
/// >>> points = np.stack([x, y, np.full_like(x, 700.0)], axis=-1).reshape(-1, 3)
/// >>> mesh = uwscan.triangulate_surface(points)
/// >>> round(mesh.area_mm2, 6)
/// 16.0
#[pyfunction]
#[pyo3(signature = (
    cloud: "Cloud | numpy.typing.ArrayLike",
    *,
    sensor_mm: "numpy.typing.ArrayLike | None" = None,
    steepest_deg = 85.0,
    smooth = false,
) -> "Mesh")]
pub fn triangulate_surface(
    py: Python<'_>,
    cloud: &Bound<'_, PyAny>,
    sensor_mm: Option<&Bound<'_, PyAny>>,
    steepest_deg: f64,
    smooth: bool,
) -> PyResult<Mesh> {
    if !(45.0..=90.0).contains(&steepest_deg) {
        return Err(input(py, format!("steepest_deg must be from 45 to 90, got {steepest_deg}")));
    }
    let sensor_mm = sensor_mm.map(|any| triple("sensor_mm", any)).transpose()?;
    let options = SurfaceOptions { sensor_mm, steepest_rad: steepest_deg.to_radians(), smooth };
    let cloud = cloud_of(cloud, None, None)?;
    let made = py.detach(|| triangulate(&cloud, &options)).or_raise(py)?;
    Ok(Mesh { inner: made.mesh, points: Some(made.points) })
}

/// A mesh, or the path of its file, as an argument.
pub fn mesh_of<'py>(name: &str, any: &Bound<'py, PyAny>) -> PyResult<Bound<'py, Mesh>> {
    let py = any.py();
    if let Ok(mesh) = any.cast::<Mesh>() {
        return Ok(mesh.clone());
    }
    let path: PathBuf = any.extract().map_err(|_| {
        let got = type_name(any);
        error(py, Class::Dtype, format!("{name} must be a Mesh or a path, got {got}"))
    })?;
    Bound::new(py, Mesh::load(py, path)?)
}
