//! The plane.

use crate::cloud::PointCloud;
use crate::consensus::{Search, consensus};
use crate::deviations::{Deviations, Influence};
use crate::eigen::least;
use crate::error::FitError;
use crate::fit::{Fitted, Foot, Surface, fit};
use crate::sample::{Observation, Sample};
use nalgebra::{DMatrix, Matrix3, Matrix4, SMatrix, SVector, Unit, Vector3};

/// How a plane is fitted.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PlaneOptions {
    /// A point on the side that the normal is to face, in the cloud's frame, mm: the sensor, the frame's origin unless
    /// told otherwise.
    pub sensor_mm: [f64; 3],
    /// Seed of the random samples that the start is taken from.
    pub seed: u64,
}

impl Default for PlaneOptions {
    fn default() -> Self {
        Self { sensor_mm: [0.0; 3], seed: 1 }
    }
}

/// A fitted plane n·p + d = 0, |n| = 1.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct PlaneFit {
    /// Unit normal towards the sensor, in the cloud's frame.
    pub normal: [f64; 3],
    /// d in n·p + d = 0, mm.
    pub offset_mm: f64,
    /// Standard deviation of the normal's direction in its least certain direction, rad.
    pub sigma_normal_rad: f64,
    /// Standard deviation of the offset, mm. It includes what the normal's uncertainty makes of the distance between the
    /// points and the frame's origin.
    pub sigma_offset_mm: f64,
    /// Covariance of (n, d), no unit and mm, of rank three: the normal keeps its length.
    pub covariance: Matrix4<f64>,
    /// Number of points and their distances.
    pub deviations: Deviations,
    /// How (n, d) follow the points.
    pub influence: Influence,
}

/// Returns the plane that most of a cloud's points lie on, in the cloud's frame, mm.
///
/// Total least squares in the metric of each point's covariance (where PAPER Eq 4 fits z = Ax + By + C, which is singular
/// for planes parallel to z), after a start that stands up to seven tenths of outliers.
///
/// # Errors
/// Fewer than three distinct points (four without covariances), values that are not finite, no plane in the points, or
/// points on one line to within their noise: see [`FitError`].
///
/// # Examples
/// ```
/// use uw_cloud::{Frame, PlaneOptions, PointCloud, fit_plane};
///
/// let points = (0..100).map(|i| [f64::from(i % 10), f64::from(i / 10), 500.0]);
/// let fit = fit_plane(&PointCloud::new(Frame::Camera, points.collect()), &PlaneOptions::default())?;
/// assert!((fit.normal[2] + 1.0).abs() < 1e-12, "towards the sensor at the origin");
/// assert!((fit.offset_mm - 500.0).abs() < 1e-9);
/// # Ok::<(), uw_cloud::FitError>(())
/// ```
pub fn fit_plane(cloud: &PointCloud, options: &PlaneOptions) -> Result<PlaneFit, FitError> {
    let sample = Sample::new(cloud, Flat::NAME, 3)?;
    let search = Search { size: 3, starts: 1, seed: options.seed };
    let start = consensus(&sample, search, |p| through_three(&sample.points(p)).into_iter().collect())
        .ok_or(FitError::Undetermined { shape: Flat::NAME, noise_share: 1.0, allowed: 0.0 })?;
    let sensor = Vector3::from(options.sensor_mm);
    let surface = start.surface.facing(&(sensor - sample.centre));
    Ok(result(fit::<Flat, 3>(&surface, start.scatter_mm, &sample)?, &sample, &sensor))
}

/// Returns the plane near a start that the given points of a checked cloud agree with, facing the sensor, and those points.
pub(crate) fn refit(
    cloud: &PointCloud,
    indices: Vec<usize>,
    normal: Unit<Vector3<f64>>,
    anchor: Vector3<f64>,
    scatter_mm: f64,
    sensor: &Vector3<f64>,
) -> Result<(PlaneFit, Vec<usize>), FitError> {
    let sample = Sample::of(cloud, indices, Flat::NAME, 3)?;
    let start = Flat::new(normal, anchor - sample.centre).facing(&(sensor - sample.centre));
    let fitted = fit::<Flat, 3>(&start, scatter_mm, &sample)?;
    let inliers = sample.indices(&fitted.inliers);
    Ok((result(fitted, &sample, sensor), inliers))
}

/// Returns the plane of least squares of distances to points, facing as a normal does; `None` where they determine none.
pub(crate) fn least_squares(
    points: &[Vector3<f64>],
    normal: Unit<Vector3<f64>>,
) -> Option<(Unit<Vector3<f64>>, Vector3<f64>)> {
    let middle = points.iter().sum::<Vector3<f64>>() / points.len().max(1) as f64;
    let spread: Matrix3<f64> = points.iter().map(|p| p - middle).map(|arm| arm * arm.transpose()).sum();
    let found = least(&spread)?;
    let axis = if found.axis.dot(&normal) < 0.0 { -found.axis } else { found.axis };
    (found.values[1] > found.values[0].max(0.0)).then(|| (Unit::new_normalize(axis), middle))
}

/// Returns the result in the cloud's frame, its normal towards the sensor.
fn result(mut fitted: Fitted<Flat, 3>, sample: &Sample<'_>, sensor: &Vector3<f64>) -> PlaneFit {
    let towards = fitted.surface.distance(&(sensor - sample.centre));
    let mut jacobian = fitted.surface.jacobian(&sample.centre);
    if towards < 0.0 {
        fitted.surface = fitted.surface.flipped();
        jacobian = -jacobian;
        let sides = &mut fitted.deviations;
        std::mem::swap(&mut sides.max_outside_mm, &mut sides.max_inside_mm);
        sides.histogram = sides.histogram.flipped();
    }
    let covariance = jacobian * fitted.covariance * jacobian.transpose();
    let tilt = fitted.covariance.fixed_view::<2, 2>(0, 0).into_owned();
    let normal = fitted.surface.normal;
    PlaneFit {
        normal: normal.into_inner().into(),
        offset_mm: -normal.dot(&(fitted.surface.anchor + sample.centre)),
        sigma_normal_rad: tilt.symmetric_eigenvalues().max().max(0.0).sqrt(),
        sigma_offset_mm: covariance[(3, 3)].max(0.0).sqrt(),
        covariance,
        deviations: fitted.deviations,
        influence: fitted.influence.mapped(&DMatrix::from_fn(4, 3, |i, j| jacobian[(i, j)])),
    }
}

/// A plane through an anchor point; its parameters are the normal's tilts along two tangents and the shift of the
/// anchor against the normal.
#[derive(Debug, Clone, Copy)]
struct Flat {
    normal: Unit<Vector3<f64>>,
    anchor: Vector3<f64>,
    tangents: [Vector3<f64>; 2],
}

impl Flat {
    fn new(normal: Unit<Vector3<f64>>, anchor: Vector3<f64>) -> Self {
        Self { normal, anchor, tangents: square_to(&normal) }
    }

    /// Returns the plane with its normal on the side of a point.
    fn facing(&self, point: &Vector3<f64>) -> Self {
        if self.distance(point) < 0.0 { self.flipped() } else { *self }
    }

    fn flipped(&self) -> Self {
        Self::new(-self.normal, self.anchor)
    }

    /// Returns the derivatives of (n, d) in the cloud's frame by the parameters.
    fn jacobian(&self, centre: &Vector3<f64>) -> SMatrix<f64, 4, 3> {
        let mut jacobian = SMatrix::<f64, 4, 3>::zeros();
        for (column, tangent) in self.tangents.iter().enumerate() {
            jacobian.fixed_view_mut::<3, 1>(0, column).copy_from(tangent);
            jacobian[(3, column)] = -tangent.dot(&(self.anchor + centre));
        }
        jacobian[(3, 2)] = 1.0;
        jacobian
    }
}

impl Surface<3> for Flat {
    type Feet = [Foot<3>; 1];
    const NAME: &'static str = "plane";

    fn distance(&self, point: &Vector3<f64>) -> f64 {
        self.normal.dot(&(point - self.anchor))
    }

    fn feet(&self, observation: Observation<'_>, floor_mm: f64) -> [Foot<3>; 1] {
        let residual_mm = self.distance(&observation.point);
        let (variance_mm2, shift) = if observation.spread.is_none() {
            (floor_mm * floor_mm, self.normal.into_inner() * residual_mm)
        } else {
            let along = observation.in_axes(&self.normal);
            let variances = observation.variances(floor_mm);
            let variance_mm2 = along.component_mul(&along).dot(&variances);
            let shift = observation.out_of_axes(&along.component_mul(&variances));
            (variance_mm2, shift * (residual_mm / variance_mm2))
        };
        let arm = observation.point - shift - self.anchor;
        let [first, second] = self.tangents;
        let gradient = SVector::<f64, 3>::new(first.dot(&arm), second.dot(&arm), 1.0);
        [Foot { residual_mm, variance_mm2, normal: self.normal.into_inner(), gradient }]
    }

    fn gradient_change(&self, _: &Foot<3>) -> SMatrix<f64, 3, 3> {
        let [first, second] = self.tangents;
        SMatrix::<f64, 3, 3>::from_rows(&[
            first.transpose(),
            second.transpose(),
            Vector3::zeros().transpose(),
        ])
    }

    fn moved(&self, step: &SVector<f64, 3>) -> Self {
        let [first, second] = self.tangents;
        let tilted = self.normal.into_inner() + first * step[0] + second * step[1];
        // Never shorter than the unit normal that it was made of.
        Self::new(Unit::new_normalize(tilted), self.anchor - self.normal.into_inner() * step[2])
    }
}

/// Returns two unit vectors square to a unit vector and to each other.
pub(crate) fn square_to(direction: &Vector3<f64>) -> [Vector3<f64>; 2] {
    let mut aside = Vector3::zeros();
    aside[direction.iamin()] = 1.0;
    let first = direction.cross(&aside);
    let first = first / first.norm();
    [first, direction.cross(&first)]
}

/// Returns the plane through three points, `None` where they lie on one line to within rounding.
fn through_three(points: &[Vector3<f64>]) -> Option<Flat> {
    let [a, b, c] = points else { return None };
    let (u, v) = (b - a, c - a);
    let across = u.cross(&v);
    let normal = Unit::try_new(across, 1e-12 * u.norm() * v.norm())?;
    Some(Flat::new(normal, (a + b + c) / 3.0))
}
