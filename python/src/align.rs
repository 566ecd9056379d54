//! Clouds brought onto a reference, and onto each other.

use crate::cloud::{Cloud, cloud_of};
use crate::convert::{Out, lend, pose_rows, six_rows};
use crate::errors::{OrRaise, input, warn};
use crate::mesh::{Mesh, mesh_of};
use nalgebra::Isometry3;
use numpy::ndarray::ArrayView1;
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyList};
use uwscan::cloud::{
    AgainstReference, MergeOptions, Merged as Together, PointCloud, ReferenceOptions, Registration, Start,
    compare_with_reference,
};

/// How far apart coordinates that agree nearly may be, mm.
const NEAR_MM: std::ops::RangeInclusive<f64> = 1e-6..=1e6;

fn near(py: Python<'_>, mm: Option<f64>) -> PyResult<Option<f64>> {
    match mm {
        Some(mm) if !NEAR_MM.contains(&mm) => {
            Err(input(py, format!("near_mm must be from 1e-6 to 1e6, got {mm}")))
        }
        mm => Ok(mm),
    }
}

fn share(py: Python<'_>, least_overlap: f64) -> PyResult<f64> {
    if (0.0..=1.0).contains(&least_overlap) {
        return Ok(least_overlap);
    }
    Err(input(py, format!("least_overlap must be from 0 to 1, got {least_overlap}")))
}

/// A cloud's distances from a reference, and the alignment that they were measured after. Made by ``uwscan.compare``.
#[pyclass(module = "uwscan", frozen)]
pub struct Comparison {
    inner: AgainstReference,
    cloud: Py<Cloud>,
}

impl Comparison {
    fn alignment(&self) -> Option<&Registration> {
        self.inner.registration.as_ref()
    }
}

#[pymethods]
impl Comparison {
    /// Signed distance of each point, (n,) float32, mm, positive on the side that the reference faces; NaN beyond a border of it.
    #[getter]
    fn deviations_mm<'py>(slf: &Bound<'py, Self>) -> PyResult<Out<'py, f32>> {
        lend(slf.as_any(), &ArrayView1::from(slf.get().inner.comparison.deviations_mm.as_slice()))
    }

    /// The cloud where it was, with each point's ``deviation_mm``: files keep it.
    #[getter]
    fn cloud(&self, py: Python<'_>) -> Py<Cloud> {
        self.cloud.clone_ref(py)
    }

    /// Points that were compared.
    #[getter]
    fn compared(&self) -> usize {
        self.inner.comparison.compared
    }

    /// Points beyond a border of the reference.
    #[getter]
    fn beyond(&self) -> usize {
        self.inner.comparison.beyond
    }

    /// Mean of the distances, mm.
    #[getter]
    fn mean_mm(&self) -> f64 {
        self.inner.comparison.mean_mm
    }

    /// Their root mean square, mm.
    #[getter]
    fn rms_mm(&self) -> f64 {
        self.inner.comparison.rms_mm
    }

    /// Their standard deviation as the median absolute deviation has it, mm.
    #[getter]
    fn robust_sigma_mm(&self) -> f64 {
        self.inner.comparison.robust_sigma_mm
    }

    /// The values that 2.5, 25, 50, 75 and 97.5 % of them lie below, (5,) float64, mm.
    #[getter]
    fn quantiles_mm<'py>(&self, py: Python<'py>) -> Out<'py, f64> {
        Out::of(py, self.inner.comparison.quantiles_mm.to_vec())
    }

    /// The farthest inside and outside, mm.
    #[getter]
    fn extremes_mm(&self) -> (f64, f64) {
        let [low, high] = self.inner.comparison.extremes_mm;
        (low, high)
    }

    /// The distance, on either side, that 95 % of them keep, mm.
    #[getter]
    fn within_95_mm(&self) -> f64 {
        self.inner.comparison.within_95_mm
    }

    /// Share of the points that lie off by no more than once, twice and three times their own sigma: about 0.68, 0.95 and 0.997 where form and
    /// sigmas are right. None for a cloud without sigmas.
    #[getter]
    fn within_sigmas(&self) -> Option<(f64, f64, f64)> {
        self.inner.comparison.within_sigmas.map(|[one, two, three]| (one, two, three))
    }

    /// Moves the cloud onto the reference: (4, 4) float64, mm; None where it was compared where it is.
    #[getter]
    fn reference_from_cloud<'py>(&self, py: Python<'py>) -> PyResult<Option<Out<'py, f64>>> {
        self.alignment().map(|a| Out::matrix(py, &pose_rows(&a.mesh_from_cloud))).transpose()
    }

    /// Covariance of the alignment, (6, 6) float64: turn about the cloud's moved middle, rad, and shift, mm, both along the reference's axes.
    /// Errors that points share are not in it. None without alignment.
    #[getter]
    fn covariance<'py>(&self, py: Python<'py>) -> PyResult<Option<Out<'py, f64>>> {
        self.alignment().map(|a| Out::matrix(py, &six_rows(&a.covariance))).transpose()
    }

    /// Share of the points that lie on the reference after alignment; None without.
    #[getter]
    fn overlap(&self) -> Option<f64> {
        self.alignment().map(|a| a.overlap)
    }

    /// Motions that the points do not determine, in words.
    #[getter]
    fn undetermined(&self) -> Vec<String> {
        self.alignment().map_or_else(Vec::new, |a| a.undetermined.iter().map(ToString::to_string).collect())
    }

    /// Other poses that fit as well, (k, 4, 4) float64: of a form that looks the same in several ways round.
    #[getter]
    fn rivals<'py>(&self, py: Python<'py>) -> PyResult<Out<'py, f64>> {
        let poses = self.alignment().map_or_else(Vec::new, |a| a.rivals.iter().map(pose_rows).collect());
        Out::matrices(py, poses)
    }

    /// What to know before trusting the figures; each was warned of.
    #[getter]
    fn warnings(&self) -> Vec<String> {
        self.inner.warnings.clone()
    }

    /// How many points lie how far off, over ± four robust standard deviations about the median.
    ///
    /// Returns
    /// -------
    /// counts, edges_mm : numpy.ndarray
    ///     (k,) int64 and (k + 1,) float64, as ``numpy.histogram`` has them; points beyond either end are in the last class there.
    #[pyo3(signature = () -> "tuple[numpy.typing.NDArray[numpy.int64], numpy.typing.NDArray[numpy.float64]]")]
    fn histogram<'py>(&self, py: Python<'py>) -> (Out<'py, i64>, Out<'py, f64>) {
        let bins = self.inner.comparison.histogram();
        let edge = |k: usize| bins.from_mm + k as f64 * bins.width_mm;
        let edges = (0..=bins.counts.len()).map(edge).collect();
        (Out::of(py, bins.counts.iter().map(|n| *n as i64).collect()), Out::of(py, edges))
    }

    fn __repr__(&self) -> String {
        let c = &self.inner.comparison;
        format!(
            "Comparison(rms_mm={:.4}, within_95_mm={:.4}, compared={})",
            c.rms_mm, c.within_95_mm, c.compared
        )
    }
}

/// How far a cloud or mesh lies off a reference mesh, after best-fit alignment from anywhere.
///
/// Distances are those to the nearest point of the reference's triangles, with the sign of the side that they face. Points whose nearest
/// point lies on a border of an open reference are beyond it, and have no distance. Alignment takes every error of form along that a rigid
/// motion can: what is left is the best fit's, not a datum's.
///
/// Parameters
/// ----------
/// points : Cloud, Mesh or array_like
///     What was measured: points, (n, 3), mm, or a mesh's vertices. A cloud brings its covariances along.
/// reference : Mesh, str or os.PathLike
///     What it should be, mm.
/// align : bool, default True
///     False: compare it where it is.
/// near_mm : float, optional
///     Where it is already right to within this distance, mm: look no farther.
/// least_overlap : float, default 0.2
///     Share of the points that must come to lie on the reference.
///
/// Returns
/// -------
/// Comparison
///
/// Raises
/// ------
/// AlignmentError
///     For a reference without area, points that do not come to lie on it, and where none lies beside it.
/// InputError
///     For a setting out of range.
///
/// Examples
/// --------
/// >>> import numpy as np, uwscan
/// >>> plate = uwscan.Mesh([[0, 0, 0], [40, 0, 0], [0, 40, 0], [40, 40, 0]], [[0, 1, 2], [1, 3, 2]])
/// >>> x, y = np.meshgrid(np.arange(5.0, 35), np.arange(5.0, 35))
/// >>> measured = np.stack([x, y, np.full_like(x, 0.25)], axis=-1).reshape(-1, 3)
/// >>> import warnings; warnings.simplefilter("ignore", uwscan.UwscanWarning)
/// >>> round(uwscan.compare(measured, plate, align=False).mean_mm, 6)
/// 0.25
#[pyfunction]
#[pyo3(signature = (
    points: "Cloud | Mesh | numpy.typing.ArrayLike",
    reference: "Mesh | str | os.PathLike[str]",
    *,
    align = true,
    near_mm = None,
    least_overlap = 0.2,
) -> "Comparison")]
pub fn compare(
    py: Python<'_>,
    points: &Bound<'_, PyAny>,
    reference: &Bound<'_, PyAny>,
    align: bool,
    near_mm: Option<f64>,
    least_overlap: f64,
) -> PyResult<Comparison> {
    let least_overlap = share(py, least_overlap)?;
    let align = match (align, near(py, near_mm)?) {
        (false, None) => None,
        (false, Some(_)) => return Err(input(py, "near_mm goes with align=True")),
        (true, Some(reach)) => Some(Start::Near(Isometry3::identity(), reach)),
        (true, None) => Some(Start::Anywhere),
    };
    let cloud = match points.cast::<Mesh>() {
        Ok(mesh) => vertices(py, &mesh.get().inner)?,
        Err(_) => cloud_of(points, None, None)?,
    };
    let reference = mesh_of("reference", reference)?;
    let mesh = &reference.get().inner;
    let options = ReferenceOptions { align, least_overlap };
    let found = py.detach(|| compare_with_reference(&cloud, mesh, &options)).or_raise(py)?;
    warn(py, &[], &found.warnings)?;
    let told = cloud.with_deviations_mm(found.comparison.deviations_mm.clone()).or_raise(py)?;
    Ok(Comparison { inner: found, cloud: Py::new(py, Cloud::of(told))? })
}

/// A mesh's vertices as points, with what is known of them.
fn vertices(py: Python<'_>, mesh: &uwscan::cloud::TriangleMesh) -> PyResult<PointCloud> {
    let cloud = PointCloud::new(mesh.frame(), mesh.vertices_mm().to_vec());
    match mesh.sigmas_mm() {
        Some(sigmas) => cloud.with_sigmas_mm(sigmas.to_vec()).or_raise(py),
        None => Ok(cloud),
    }
}

/// Sweeps brought together. Made by ``uwscan.merge``.
#[pyclass(module = "uwscan", frozen)]
pub struct Merged {
    inner: Together,
    cloud: Py<Cloud>,
}

#[pymethods]
impl Merged {
    /// All points, in the frame of the first cloud: attributes that all clouds have, covariances turned along; no frames and no pixels, which
    /// belong to one capture.
    #[getter]
    fn cloud(&self, py: Python<'_>) -> Py<Cloud> {
        self.cloud.clone_ref(py)
    }

    /// Moves each cloud into the first one's frame: (k, 4, 4) float64, mm.
    #[getter]
    fn poses<'py>(&self, py: Python<'py>) -> PyResult<Out<'py, f64>> {
        Out::matrices(py, self.inner.poses.iter().map(pose_rows).collect())
    }

    /// Covariance of each pose beside the first one's, (k, 6, 6) float64: turn about the middle of all points, rad, and shift, mm, the first
    /// cloud's axes. Errors that a sweep's points share are not in it.
    #[getter]
    fn covariances<'py>(&self, py: Python<'py>) -> PyResult<Out<'py, f64>> {
        Out::matrices(py, self.inner.covariances.iter().map(six_rows).collect())
    }

    /// What lies on what, for every two clouds that overlap: dictionaries of points_of and surface_of (places in the list, from 0), overlap,
    /// rms_mm, and floor_mm: what of that the clouds' own sigmas do not tell.
    #[getter]
    fn pairs<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyList>> {
        let all = PyList::empty(py);
        for pair in &self.inner.pairs {
            let one = PyDict::new(py);
            one.set_item("points_of", pair.points_of)?;
            one.set_item("surface_of", pair.surface_of)?;
            one.set_item("overlap", pair.overlap)?;
            one.set_item("rms_mm", pair.rms_mm)?;
            one.set_item("floor_mm", pair.floor_mm)?;
            all.append(one)?;
        }
        Ok(all)
    }

    /// What to know before trusting it; each was warned of.
    #[getter]
    fn warnings(&self) -> Vec<String> {
        self.inner.warnings.clone()
    }

    fn __repr__(&self) -> String {
        format!("Merged({} points of {} clouds)", self.inner.cloud.len(), self.inner.poses.len())
    }
}

/// Overlapping sweeps of one scene as one cloud: each brought onto the others' surfaces, all at once, by each point's covariance.
///
/// Parameters
/// ----------
/// clouds : sequence of Cloud or array_like
///     Two or more, each of one sweep; the result is in the frame of the first.
/// near_mm : float, optional
///     Where all clouds' coordinates agree already to within this distance, mm: look no farther.
/// least_overlap : float, default 0.2
///     Share of a cloud's points that must lie on the surface of another one.
///
/// Returns
/// -------
/// Merged
///     No points are averaged; ``uwscan.average`` does that.
///
/// Raises
/// ------
/// AlignmentError
///     For fewer than two clouds, one that has no surface or does not overlap with the others, and one whose overlap tells several poses or a
///     whole path of them.
/// InputError
///     For a setting out of range.
#[pyfunction]
#[pyo3(signature = (
    clouds: "collections.abc.Sequence[Cloud | numpy.typing.ArrayLike]", *, near_mm = None, least_overlap = 0.2,
) -> "Merged")]
pub fn merge(
    py: Python<'_>,
    clouds: &Bound<'_, PyAny>,
    near_mm: Option<f64>,
    least_overlap: f64,
) -> PyResult<Merged> {
    let options = MergeOptions { least_overlap: share(py, least_overlap)?, near_mm: near(py, near_mm)? };
    let clouds: Vec<PointCloud> = clouds
        .try_iter()
        .map_err(|_| input(py, "clouds must be a sequence of clouds"))?
        .map(|any| cloud_of(&any?, None, None))
        .collect::<PyResult<_>>()?;
    let made = py.detach(|| uwscan::cloud::merge(&clouds, &options)).or_raise(py)?;
    warn(py, &[], &made.warnings)?;
    let cloud = Py::new(py, Cloud::of(made.cloud.clone()))?;
    Ok(Merged { inner: made, cloud })
}
