//! Shapes that are found by themselves, and surfaces.

use crate::cloud::cloud_of;
use crate::errors::OrRaise;
use crate::fits::{Common, CylinderFit, PlaneFit, SphereFit, sensor};
use crate::shared::Shared;
use pyo3::prelude::*;
#[cfg(feature = "stubs")]
use pyo3::type_hint_union;
use pyo3::types::PyList;
use uwscan::cloud::{Relation, ShapeFit, ShapeOptions};

/// The shapes of a cloud, the one with the most points first: a sequence of SphereFit, PlaneFit and CylinderFit.
#[pyclass(module = "uwscan", frozen, sequence)]
pub struct Shapes {
    fits: Py<PyList>,
    unassigned: usize,
    distances: Vec<Relation>,
    angles: Vec<Relation>,
}

/// A distance or angle between two shapes: their places in the list, value, sigma, and sigma with the calibration's part.
type Between = (usize, usize, f64, f64, Option<f64>);

fn between(relations: &[Relation]) -> Vec<Between> {
    relations.iter().map(|r| (r.a, r.b, r.value, r.sigma, r.sigma_total)).collect()
}

#[pymethods]
impl Shapes {
    /// Points that no shape holds.
    #[getter]
    fn unassigned_points(&self) -> usize {
        self.unassigned
    }

    /// Distances between shapes as (a, b, distance_mm, sigma_mm, sigma_total_mm): places in the sequence, mm; the last is None where no
    /// calibration was given.
    #[getter]
    fn distances_mm(&self) -> Vec<Between> {
        between(&self.distances)
    }

    /// Angles between planes and axes as (a, b, angle_rad, sigma_rad, sigma_total_rad).
    #[getter]
    fn angles_rad(&self) -> Vec<Between> {
        between(&self.angles)
    }

    fn __len__(&self, py: Python<'_>) -> usize {
        self.fits.bind(py).len()
    }

    fn __getitem__<'py>(&self, py: Python<'py>, index: isize) -> PyResult<AnyFit<'py>> {
        Ok(AnyFit(self.fits.bind(py).as_any().get_item(index)?))
    }

    fn __iter__<'py>(&self, py: Python<'py>) -> PyResult<FitIterator<'py>> {
        Ok(FitIterator(self.fits.bind(py).as_any().try_iter()?.into_any()))
    }

    fn __repr__(&self, py: Python<'_>) -> PyResult<String> {
        Ok(format!("Shapes({}, unassigned_points={})", self.fits.bind(py).repr()?, self.unassigned))
    }
}

/// A fit of any kind.
struct AnyFit<'py>(Bound<'py, PyAny>);

impl<'py> IntoPyObject<'py> for AnyFit<'py> {
    type Target = PyAny;
    type Output = Bound<'py, PyAny>;
    type Error = std::convert::Infallible;
    // The macro is imported, since it calls itself by its bare name.
    #[cfg(feature = "stubs")]
    const OUTPUT_TYPE: pyo3::inspect::PyStaticExpr = type_hint_union!(
        <SphereFit as pyo3::PyTypeInfo>::TYPE_HINT,
        <PlaneFit as pyo3::PyTypeInfo>::TYPE_HINT,
        <CylinderFit as pyo3::PyTypeInfo>::TYPE_HINT
    );

    fn into_pyobject(self, _: Python<'py>) -> Result<Self::Output, Self::Error> {
        Ok(self.0)
    }
}

/// Fits of any kind, one after the other.
struct FitIterator<'py>(Bound<'py, PyAny>);

impl<'py> IntoPyObject<'py> for FitIterator<'py> {
    type Target = PyAny;
    type Output = Bound<'py, PyAny>;
    type Error = std::convert::Infallible;
    #[cfg(feature = "stubs")]
    const OUTPUT_TYPE: pyo3::inspect::PyStaticExpr = pyo3::type_hint_subscript!(
        pyo3::type_hint_identifier!("collections.abc", "Iterator"),
        <AnyFit<'py> as IntoPyObject<'py>>::OUTPUT_TYPE
    );

    fn into_pyobject(self, _: Python<'py>) -> Result<Self::Output, Self::Error> {
        Ok(self.0)
    }
}

/// The spheres, planes and cylinders of a cloud, and the distances and angles between them.
///
/// Parameters
/// ----------
/// points : Cloud or array_like
///     Points, (n, 3), mm. A cloud brings its covariances along.
/// covariance_mm2, sigma_mm, calibration, index_sigma, seed
///     As ``uwscan.fit_sphere`` has them.
/// max : int, optional
///     At most so many shapes, those with the most points.
/// sensor_mm : array_like, optional
///     The sensor's place in the points' frame, (3,), mm; the origin by default.
///
/// Returns
/// -------
/// Shapes
///     A sequence; empty where there are none.
///
/// Raises
/// ------
/// FitError
///     For fewer than four points, or values that are not finite.
#[pyfunction]
#[pyo3(signature = (
    points: "Cloud | numpy.typing.ArrayLike",
    *,
    covariance_mm2: "numpy.typing.ArrayLike | None" = None,
    sigma_mm: "numpy.typing.ArrayLike | None" = None,
    max = None,
    sensor_mm: "numpy.typing.ArrayLike | None" = None,
    calibration: "Calibration | str | os.PathLike[str] | None" = None,
    index_sigma = None,
    seed = 1,
) -> "Shapes")]
#[allow(clippy::too_many_arguments, reason = "keywords in Python")]
pub fn find_shapes(
    py: Python<'_>,
    points: &Bound<'_, PyAny>,
    covariance_mm2: Option<&Bound<'_, PyAny>>,
    sigma_mm: Option<&Bound<'_, PyAny>>,
    max: Option<usize>,
    sensor_mm: Option<&Bound<'_, PyAny>>,
    calibration: Option<&Bound<'_, PyAny>>,
    index_sigma: Option<f64>,
    seed: u64,
) -> PyResult<Shapes> {
    let options = ShapeOptions { max, sensor_mm: sensor(sensor_mm)?, seed };
    let cloud = cloud_of(points, covariance_mm2, sigma_mm)?;
    let shared = Shared::of(py, calibration, index_sigma)?;
    let made = py.detach(|| {
        let found = uwscan::cloud::find_shapes(&cloud, &options).map_err(uwscan::Error::Fit)?;
        let mut told = None;
        let parts = match &shared {
            Some(shared) => {
                let (mut errors, warning) = shared.errors(&cloud)?;
                told = warning;
                let parts = found.shapes.iter().map(|shape| errors.of(shape.fit.influence()));
                Some(parts.collect::<Result<Vec<_>, _>>()?)
            }
            None => None,
        };
        let relations = uwscan::cloud::relations(&cloud, &found.shapes, parts.as_deref());
        Ok::<_, uwscan::Error>((found, parts, relations, told))
    });
    let (found, parts, relations, told) = made.or_raise(py)?;
    crate::errors::warn(py, &[], told.as_slice())?;
    let fits = PyList::empty(py);
    for (at, shape) in found.shapes.into_iter().enumerate() {
        let covariance = shape.fit.covariance();
        let total = parts.as_ref().map(|parts| &covariance + &parts[at] * parts[at].transpose());
        let common = Common { covariance, total, points: Some(shape.points) };
        match shape.fit {
            ShapeFit::Sphere(fit) => fits.append(Bound::new(py, SphereFit { fit, common })?)?,
            ShapeFit::Plane(fit) => fits.append(Bound::new(py, PlaneFit { fit, common })?)?,
            ShapeFit::Cylinder(fit) => fits.append(Bound::new(py, CylinderFit { fit, common })?)?,
            other => {
                let what = format!("a {} is not known to Python", other.kind());
                return Err(crate::errors::input(py, what));
            }
        }
    }
    Ok(Shapes {
        fits: fits.unbind(),
        unassigned: found.unassigned_points,
        distances: relations.distances_mm,
        angles: relations.angles_rad,
    })
}
