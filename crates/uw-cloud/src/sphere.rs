//! The sphere, of free or of known radius.

use crate::cloud::PointCloud;
use crate::consensus::{Search, consensus};
use crate::deviations::{Deviations, Influence};
use crate::error::FitError;
use crate::fit::{Fitted, Foot, Surface, fit, refine, rival};
use crate::plane::square_to;
use crate::round::{Apex, nearest_on_round};
use crate::sample::{Observation, Observations, Sample};
use nalgebra::{DMatrix, Matrix3, Matrix4, SMatrix, SVector, Vector3};

/// By how much chi² has to be worse for the other side of a cap of known radius to be ruled out: three sigma.
const SIDE_CHI2: f64 = 9.0;

/// How a sphere is fitted.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SphereOptions {
    /// The radius where it is known, mm; `None` estimates it.
    pub radius_mm: Option<f64>,
    /// Seed of the random samples that the start is taken from.
    pub seed: u64,
}

impl Default for SphereOptions {
    fn default() -> Self {
        Self { radius_mm: None, seed: 1 }
    }
}

/// A fitted sphere.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct SphereFit {
    /// Radius, mm.
    pub radius_mm: f64,
    /// Centre in the cloud's frame, mm.
    pub center_mm: [f64; 3],
    /// Standard deviation of the radius, mm; 0 where it was given.
    pub sigma_radius_mm: f64,
    /// Standard deviations of the centre's coordinates, mm.
    pub sigma_center_mm: [f64; 3],
    /// Covariance of (centre x, y, z, radius), mm²; the radius's row is 0 where it was given.
    pub covariance_mm2: Matrix4<f64>,
    /// Number of points and their distances.
    pub deviations: Deviations,
    /// How (centre x, y, z, radius) follow the points.
    pub influence: Influence,
}

/// Returns the sphere that most of a cloud's points lie on, in the cloud's frame, mm.
///
/// The start stands up to seven tenths of outliers; the rest is the maximum-likelihood fit with errors in variables that
/// `fit` describes, which has none of the bias of an orthogonal-distance fit (−0.03 mm on a ball of 20 mm at 1067 mm
/// with 0.2 px of stripe noise). Without covariances it is the orthogonal-distance fit.
///
/// # Errors
/// Fewer than four distinct points (five without covariances; with a known radius three and four), values that are not
/// finite, no sphere in the points, or points that do not determine one: see [`FitError`].
///
/// # Examples
/// ```
/// use uw_cloud::{Frame, PointCloud, SphereOptions, fit_sphere};
///
/// let points = (0..300).map(|i| {
///     let (t, z) = (2.4 * f64::from(i), -1.0 + f64::from(i) / 300.0);
///     let r = (1.0 - z * z).sqrt();
///     [20.0 * r * t.cos(), 20.0 * r * t.sin(), 700.0 + 20.0 * z]
/// });
/// let fit = fit_sphere(&PointCloud::new(Frame::Camera, points.collect()), &SphereOptions::default())?;
/// assert!((fit.radius_mm - 20.0).abs() < 1e-9);
/// assert!((fit.center_mm[2] - 700.0).abs() < 1e-9);
/// # Ok::<(), uw_cloud::FitError>(())
/// ```
pub fn fit_sphere(cloud: &PointCloud, options: &SphereOptions) -> Result<SphereFit, FitError> {
    match options.radius_mm {
        None => {
            let sample = Sample::new(cloud, FreeSphere::NAME, 4)?;
            let search = Search { size: 4, starts: 1, seed: options.seed };
            let start = consensus(&sample, search, |p| through_four(&sample.points(p)).into_iter().collect())
                .ok_or(FitError::Undetermined { shape: FreeSphere::NAME, noise_share: 1.0, allowed: 0.0 })?;
            let fitted = fit::<FreeSphere, 4>(&start.surface, start.scatter_mm, &sample)?;
            let ball = fitted.surface.0;
            Ok(result(&ball, &sample, fitted.covariance, fitted.deviations, fitted.influence))
        }
        Some(radius) if radius > 0.0 && radius < 1e100 => {
            let sample = Sample::new(cloud, KnownSphere::NAME, 3)?;
            let search = Search { size: 3, starts: 1, seed: options.seed };
            let start = consensus(&sample, search, |p| through_three(&sample.points(p), radius))
                .ok_or(FitError::Undetermined { shape: KnownSphere::NAME, noise_share: 1.0, allowed: 0.0 })?;
            let fitted = fit::<KnownSphere, 3>(&start.surface, start.scatter_mm, &sample)?;
            let fitted = on_the_right_side(fitted, &sample)?;
            let mut covariance = Matrix4::zeros();
            covariance.fixed_view_mut::<3, 3>(0, 0).copy_from(&fitted.covariance);
            let mut given = DMatrix::zeros(4, 3);
            given.fill_diagonal(1.0);
            let influence = fitted.influence.mapped(&given);
            Ok(result(&fitted.surface.0, &sample, covariance, fitted.deviations, influence))
        }
        Some(radius_mm) => Err(FitError::InvalidRadius { radius_mm }),
    }
}

/// Returns the result in the cloud's frame.
fn result(
    ball: &Ball,
    sample: &Sample<'_>,
    covariance: Matrix4<f64>,
    deviations: Deviations,
    influence: Influence,
) -> SphereFit {
    let sigma = |i: usize| covariance[(i, i)].max(0.0).sqrt();
    SphereFit {
        radius_mm: ball.radius,
        center_mm: (ball.center + sample.centre).into(),
        sigma_radius_mm: sigma(3),
        sigma_center_mm: [sigma(0), sigma(1), sigma(2)],
        covariance_mm2: covariance,
        deviations,
        influence,
    }
}

/// Returns the sphere near a start that the given points of a checked cloud agree with, and those that do.
pub(crate) fn refit(
    cloud: &PointCloud,
    indices: Vec<usize>,
    center: Vector3<f64>,
    radius: f64,
    scatter_mm: f64,
) -> Result<(SphereFit, Vec<usize>), FitError> {
    let sample = Sample::of(cloud, indices, FreeSphere::NAME, 4)?;
    let start = FreeSphere(Ball { center: center - sample.centre, radius });
    let fitted = fit::<FreeSphere, 4>(&start, scatter_mm, &sample)?;
    let inliers = sample.indices(&fitted.inliers);
    Ok((result(&fitted.surface.0, &sample, fitted.covariance, fitted.deviations, fitted.influence), inliers))
}

/// Returns the sphere of least squares of distances to points about the origin, from a start; a
/// scatter below the resolution is none.
pub(crate) fn least_squares(
    points: &[Vector3<f64>],
    center: Vector3<f64>,
    radius: f64,
    resolution_mm: f64,
) -> Option<(Vector3<f64>, f64)> {
    let (points, all) = (Observations::bare(points.to_vec()), (0..points.len()).collect::<Vec<_>>());
    let ball = refine(FreeSphere(Ball { center, radius }), &points, &all, 1.0, resolution_mm)?.0;
    Some((ball.center, ball.radius))
}

/// Returns the better of a ball of known radius and its mirror image beyond the cap.
fn on_the_right_side(
    fitted: Fitted<KnownSphere, 3>,
    sample: &Sample<'_>,
) -> Result<Fitted<KnownSphere, 3>, FitError> {
    let ball = fitted.surface.0;
    let middle = fitted.inliers.iter().map(|&i| sample.observations.points[i]).sum::<Vector3<f64>>()
        / fitted.inliers.len().max(1) as f64;
    let mirrored = KnownSphere(Ball { center: middle * 2.0 - ball.center, ..ball });
    let Some((other, chi2_difference)) = rival(mirrored, &fitted, sample, SIDE_CHI2) else {
        return Ok(fitted);
    };
    let separation_mm = (other.surface.0.center - ball.center).norm();
    if separation_mm < 1e-3 * ball.radius || chi2_difference > SIDE_CHI2 {
        Ok(fitted)
    } else if chi2_difference < -SIDE_CHI2 {
        Ok(other)
    } else {
        Err(FitError::Ambiguous {
            shape: KnownSphere::NAME,
            separation_mm,
            chi2_difference: chi2_difference.abs(),
            needed: SIDE_CHI2,
        })
    }
}

/// Centre and radius, mm.
#[derive(Debug, Clone, Copy)]
struct Ball {
    center: Vector3<f64>,
    radius: f64,
}

/// A sphere whose four parameters (centre, radius) are free.
#[derive(Debug, Clone, Copy)]
struct FreeSphere(Ball);

/// A sphere of given radius: three parameters.
#[derive(Debug, Clone, Copy)]
struct KnownSphere(Ball);

impl Ball {
    fn distance(&self, point: &Vector3<f64>) -> f64 {
        (point - self.center).norm() - self.radius
    }

    fn foot(&self, observation: Observation<'_>, floor_mm: f64) -> (f64, f64, Vector3<f64>) {
        let arm = observation.in_axes(&(observation.point - self.center));
        let (residual, variance, normal) =
            nearest_on_round(arm, &observation.variances(floor_mm), self.radius);
        (residual, variance, observation.out_of_axes(&normal))
    }

    /// Returns ∂n/∂q = (I − nnᵀ)/R.
    fn shape_operator(&self, normal: &Vector3<f64>) -> Matrix3<f64> {
        (Matrix3::identity() - normal * normal.transpose()) / self.radius
    }
}

impl Surface<4> for FreeSphere {
    type Feet = [Foot<4>; 1];
    const NAME: &'static str = "sphere";

    fn radius_mm(&self) -> Option<f64> {
        Some(self.0.radius)
    }

    fn distance(&self, point: &Vector3<f64>) -> f64 {
        self.0.distance(point)
    }

    fn feet(&self, observation: Observation<'_>, floor_mm: f64) -> [Foot<4>; 1] {
        let (residual_mm, variance_mm2, normal) = self.0.foot(observation, floor_mm);
        [Foot { residual_mm, variance_mm2, normal, gradient: (-normal).push(-1.0) }]
    }

    fn gradient_change(&self, foot: &Foot<4>) -> SMatrix<f64, 4, 3> {
        let mut change = SMatrix::<f64, 4, 3>::zeros();
        change.fixed_view_mut::<3, 3>(0, 0).copy_from(&-self.0.shape_operator(&foot.normal));
        change
    }

    fn normal_change(&self, foot: &Foot<4>) -> Matrix3<f64> {
        self.0.shape_operator(&foot.normal)
    }

    fn lever(&self) -> impl Fn(&Foot<4>) -> SVector<f64, 4> {
        let apex = Apex::of(self.0.center, self.0.radius);
        let [first, second] = square_to(&apex.outward());
        move |foot| {
            let arm = apex.arm(&foot.normal);
            let [rise, bend] = apex.rise_and_bend(&foot.normal);
            SVector::<f64, 4>::new(first.dot(&arm), second.dot(&arm), rise, bend)
        }
    }

    fn moved(&self, step: &SVector<f64, 4>) -> Self {
        let apex = Apex::of(self.0.center, self.0.radius);
        let [first, second] = square_to(&apex.outward());
        let (center, radius) = apex.moved(&(first * step[0] + second * step[1]), step[2], step[3]);
        Self(Ball { center, radius })
    }
}

impl Surface<3> for KnownSphere {
    type Feet = [Foot<3>; 1];
    const NAME: &'static str = "sphere";

    fn radius_mm(&self) -> Option<f64> {
        Some(self.0.radius)
    }

    fn distance(&self, point: &Vector3<f64>) -> f64 {
        self.0.distance(point)
    }

    fn feet(&self, observation: Observation<'_>, floor_mm: f64) -> [Foot<3>; 1] {
        let (residual_mm, variance_mm2, normal) = self.0.foot(observation, floor_mm);
        [Foot { residual_mm, variance_mm2, normal, gradient: -normal }]
    }

    fn gradient_change(&self, foot: &Foot<3>) -> SMatrix<f64, 3, 3> {
        -self.0.shape_operator(&foot.normal)
    }

    fn normal_change(&self, foot: &Foot<3>) -> Matrix3<f64> {
        self.0.shape_operator(&foot.normal)
    }

    fn moved(&self, step: &SVector<f64, 3>) -> Self {
        Self(Ball { center: self.0.center + step, ..self.0 })
    }
}

/// Returns the sphere through four points, `None` where they lie on one plane to within rounding.
fn through_four(points: &[Vector3<f64>]) -> Option<FreeSphere> {
    let [a, b, c, d] = points else { return None };
    let edges = Matrix3::from_columns(&[b - a, c - a, d - a]).transpose();
    let squares = Vector3::new((b - a).norm_squared(), (c - a).norm_squared(), (d - a).norm_squared());
    let flatness = edges.determinant().abs() / (squares[0] * squares[1] * squares[2]).sqrt();
    if flatness.is_nan() || flatness < 1e-12 {
        return None;
    }
    let arm = edges.lu().solve(&(squares * 0.5))?;
    let radius = arm.norm();
    (radius.is_finite() && radius > 0.0).then(|| FreeSphere(Ball { center: a + arm, radius }))
}

/// Returns the two spheres of a radius through three points, none where the points lie on one line or too far apart.
fn through_three(points: &[Vector3<f64>], radius: f64) -> Vec<KnownSphere> {
    let [a, b, c] = points else { return Vec::new() };
    let (u, v) = (b - a, c - a);
    let across = u.cross(&v);
    let area2 = across.norm_squared();
    if area2.is_nan() || area2 <= 1e-20 * u.norm_squared() * v.norm_squared() {
        return Vec::new();
    }
    let arm = (v.cross(&across) * u.norm_squared() + across.cross(&u) * v.norm_squared()) / (2.0 * area2);
    // Noise may push the circle through the points beyond the sphere's equator by a little.
    let height2 = radius * radius - arm.norm_squared();
    if height2 < -0.25 * radius * radius {
        return Vec::new();
    }
    let rise = across * (height2.max(0.0) / area2).sqrt();
    [a + arm + rise, a + arm - rise].map(|center| KnownSphere(Ball { center, radius })).to_vec()
}
