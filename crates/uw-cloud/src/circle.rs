//! The circle in space, of free or of known radius.

use crate::cloud::PointCloud;
use crate::consensus::{Search, consensus};
use crate::deviations::{Deviations, Influence};
use crate::error::FitError;
use crate::fit::{Foot, Surface, fit};
use crate::plane::square_to;
use crate::round::principal;
use crate::sample::{Observation, Sample};
use nalgebra::{DMatrix, SMatrix, SVector, Unit, Vector3};

/// How a circle is fitted.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CircleOptions {
    /// The radius where it is known, mm; `None` estimates it.
    pub radius_mm: Option<f64>,
    /// A point on the side that the normal is to face, in the cloud's frame, mm: the sensor.
    pub sensor_mm: [f64; 3],
    /// Seed of the random samples that the start is taken from.
    pub seed: u64,
}

impl Default for CircleOptions {
    fn default() -> Self {
        Self { radius_mm: None, sensor_mm: [0.0; 3], seed: 1 }
    }
}

/// A fitted circle.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct CircleFit {
    /// Radius, mm.
    pub radius_mm: f64,
    /// Centre in the cloud's frame, mm.
    pub center_mm: [f64; 3],
    /// Unit normal of its plane, towards the sensor.
    pub normal: [f64; 3],
    /// Standard deviation of the radius, mm; 0 where it was given.
    pub sigma_radius_mm: f64,
    /// Standard deviations of the centre's coordinates, mm.
    pub sigma_center_mm: [f64; 3],
    /// Standard deviation of the normal's direction in its least certain direction, rad.
    pub sigma_normal_rad: f64,
    /// Covariance of (centre, normal, radius), mm and no unit, of rank six.
    pub covariance: SMatrix<f64, 7, 7>,
    /// Number of points and their distances from the circle, positive for a point farther from its axis than the radius.
    pub deviations: Deviations,
    /// How (centre, normal, radius) follow the points.
    pub influence: Influence,
}

/// Steps of a foot's angle at most, the longest one and the one that is rounding, rad.
const NEWTON_STEPS: usize = 40;
const LONGEST_TURN: f64 = 0.5;
const SETTLED_TURN: f64 = 1e-14;

/// Returns the circle that most of a cloud's points lie along, in the cloud's frame, mm: a curve in space, such as an edge.
///
/// A point misses a circle in two directions, off its plane and off its radius. Both count, by the covariance that the point
/// has in them; along the circle it may lie anywhere. Start, floor and sigmas as for the sphere ([`crate::fit_sphere`]).
///
/// # Errors
/// Fewer than six distinct points (seven without covariances; with a known radius five and six), values that are not finite, no
/// circle in the points, or points that do not determine one: see [`FitError`].
///
/// # Examples
/// ```
/// use uw_cloud::{CircleOptions, Frame, PointCloud, fit_circle};
///
/// let points = (0..90).map(|i| f64::from(i) * 0.05).map(|t| [25.0 * t.cos(), 25.0 * t.sin(), 700.0]);
/// let fit = fit_circle(&PointCloud::new(Frame::Camera, points.collect()), &CircleOptions::default())?;
/// assert!((fit.radius_mm - 25.0).abs() < 1e-9);
/// assert!((fit.normal[2] + 1.0).abs() < 1e-12, "towards the sensor at the origin");
/// # Ok::<(), uw_cloud::FitError>(())
/// ```
pub fn fit_circle(cloud: &PointCloud, options: &CircleOptions) -> Result<CircleFit, FitError> {
    let search = Search { size: 3, starts: 1, seed: options.seed };
    let undetermined = || FitError::Undetermined { shape: FreeRing::NAME, noise_share: 1.0, allowed: 0.0 };
    match options.radius_mm {
        None => {
            let sample = Sample::new(cloud, FreeRing::NAME, 6)?;
            let start = consensus(&sample, search, |p| {
                through_three(&sample.points(p)).map(FreeRing).into_iter().collect()
            })
            .ok_or_else(undetermined)?;
            let fitted = fit::<FreeRing, 6>(&start.surface, start.scatter_mm, &sample)?;
            let (ring, covariance) = (fitted.surface.0, fitted.covariance);
            Ok(result(&ring, &covariance, fitted.deviations, fitted.influence, &sample, options))
        }
        Some(radius) if radius > 0.0 && radius < 1e100 => {
            let sample = Sample::new(cloud, KnownRing::NAME, 5)?;
            let known = |ring: Ring| KnownRing(Ring { radius, ..ring });
            let start = consensus(&sample, search, |p| {
                through_three(&sample.points(p)).map(known).into_iter().collect()
            })
            .ok_or_else(undetermined)?;
            let fitted = fit::<KnownRing, 5>(&start.surface, start.scatter_mm, &sample)?;
            let mut covariance = SMatrix::<f64, 6, 6>::zeros();
            covariance.fixed_view_mut::<5, 5>(0, 0).copy_from(&fitted.covariance);
            let mut widened = DMatrix::zeros(6, 5);
            widened.fill_diagonal(1.0);
            let influence = fitted.influence.mapped(&widened);
            Ok(result(&fitted.surface.0, &covariance, fitted.deviations, influence, &sample, options))
        }
        Some(radius_mm) => Err(FitError::InvalidRadius { radius_mm }),
    }
}

/// Returns the result in the cloud's frame, its normal towards the sensor.
fn result(
    ring: &Ring,
    covariance: &SMatrix<f64, 6, 6>,
    deviations: Deviations,
    influence: Influence,
    sample: &Sample<'_>,
    options: &CircleOptions,
) -> CircleFit {
    let center = ring.center + sample.centre;
    let sign = if ring.normal.dot(&(Vector3::from(options.sensor_mm) - center)) < 0.0 { -1.0 } else { 1.0 };
    let [first, second] = square_to(&ring.normal);
    let mut jacobian = SMatrix::<f64, 7, 6>::zeros();
    for (k, tangent) in [first, second].iter().enumerate() {
        jacobian.fixed_view_mut::<3, 1>(3, k).copy_from(&(tangent * sign));
        jacobian.fixed_view_mut::<3, 1>(0, 3 + k).copy_from(tangent);
    }
    jacobian.fixed_view_mut::<3, 1>(0, 2).copy_from(&ring.normal);
    jacobian[(6, 5)] = 1.0;
    let public = jacobian * covariance * jacobian.transpose();
    let sigma = |i: usize| public[(i, i)].max(0.0).sqrt();
    let tilt = covariance.fixed_view::<2, 2>(0, 0).into_owned();
    CircleFit {
        radius_mm: ring.radius,
        center_mm: center.into(),
        normal: (ring.normal.into_inner() * sign).into(),
        sigma_radius_mm: sigma(6),
        sigma_center_mm: [sigma(0), sigma(1), sigma(2)],
        sigma_normal_rad: tilt.symmetric_eigenvalues().max().max(0.0).sqrt(),
        covariance: public,
        deviations,
        influence: influence.mapped(&DMatrix::from_fn(7, 6, |i, j| jacobian[(i, j)])),
    }
}

/// Centre, plane and radius, mm.
#[derive(Debug, Clone, Copy)]
struct Ring {
    center: Vector3<f64>,
    normal: Unit<Vector3<f64>>,
    radius: f64,
}

/// A circle whose six parameters are free: tilts of its plane about two tangents, the centre's shift along the normal and in
/// the plane, radius.
#[derive(Debug, Clone, Copy)]
struct FreeRing(Ring);

/// A circle of given radius: five parameters.
#[derive(Debug, Clone, Copy)]
struct KnownRing(Ring);

impl Ring {
    /// Returns how far a point lies off the plane, how much farther from the axis than the circle, and the way outwards.
    fn misses(&self, point: &Vector3<f64>) -> (f64, f64, Vector3<f64>) {
        let arm = point - self.center;
        let off = self.normal.dot(&arm);
        let flat = arm - self.normal.into_inner() * off;
        let length = flat.norm();
        // A point on the axis has no nearest one: take any.
        let outward = if length > 1e-12 * self.radius { flat / length } else { square_to(&self.normal)[0] };
        (off, length - self.radius, outward)
    }

    /// Returns the distance from the curve, with the sign of the radial part.
    fn distance(&self, point: &Vector3<f64>) -> f64 {
        let (off, beyond, _) = self.misses(point);
        off.hypot(beyond).copysign(beyond)
    }

    /// Returns the residuals along the two principal directions that the covariance has across the curve, which are independent.
    ///
    /// The foot is the point q of the circle that is nearest in the metric of V, by Newton's steps of its angle from the nearest one
    /// in space. There V⁻¹(p − q) is square to the circle, hence d² = rᵀ (NᵀVN)⁻¹ r with r = Nᵀ(p − q) in the two directions N
    /// across the circle, and its derivatives are those of r.
    fn feet(&self, observation: Observation<'_>, floor_mm: f64) -> [Foot<6>; 2] {
        let (_, _, mut outward) = self.misses(&observation.point);
        let variances = observation.variances(floor_mm);
        let least = variances.min();
        let weighed = |v: &Vector3<f64>| {
            observation.out_of_axes(&observation.in_axes(v).zip_map(&variances, |x, v| x * (least / v)))
        };
        let arm = observation.point - self.center;
        for _ in 0..NEWTON_STEPS {
            let around = self.normal.cross(&outward);
            let pull = weighed(&(arm - outward * self.radius));
            let flatness = self.radius * around.dot(&weighed(&around));
            let slope = flatness + outward.dot(&pull);
            let step = around.dot(&pull) / if slope > 0.1 * flatness { slope } else { flatness };
            let (s, c) = step.clamp(-LONGEST_TURN, LONGEST_TURN).sin_cos();
            outward = outward * c + around * s;
            if step.abs() < SETTLED_TURN {
                break;
            }
        }
        let miss = arm - outward * self.radius;
        let (off, beyond) = (self.normal.dot(&miss), outward.dot(&miss));
        let (a, b) = (observation.in_axes(&self.normal), observation.in_axes(&outward));
        let (aa, ab, bb) = (
            a.component_mul(&a).dot(&variances),
            a.component_mul(&b).dot(&variances),
            b.component_mul(&b).dot(&variances),
        );
        let ([c, s], [most, least]) = principal(aa, ab, bb);
        let least = least.max(floor_mm * floor_mm);
        let [first, second] = square_to(&self.normal);
        let (x, y) = (outward.dot(&first), outward.dot(&second));
        let along = |c: f64, s: f64, variance_mm2: f64| Foot {
            residual_mm: c * off + s * beyond,
            variance_mm2,
            normal: self.normal.into_inner() * c + outward * s,
            gradient: SVector::<f64, 6>::new(
                c * self.radius * x,
                c * self.radius * y,
                -c,
                -s * x,
                -s * y,
                -s,
            ),
        };
        [along(c, s, most), along(-s, c, least)]
    }

    fn gradient_change(&self, foot: &Foot<6>) -> SMatrix<f64, 6, 3> {
        let (c, s) = (-foot.gradient[2], -foot.gradient[5]);
        let mut change = SMatrix::<f64, 6, 3>::zeros();
        let tangents = square_to(&self.normal);
        // c R x and −s x are known: x is c times the one by R less s times the other.
        let [x, y] = [0, 1].map(|k| c * foot.gradient[k] / self.radius - s * foot.gradient[3 + k]);
        let around = tangents[1] * x - tangents[0] * y;
        for (k, tangent) in tangents.iter().enumerate() {
            let turning = around.transpose() * (tangent.dot(&around) / self.radius);
            change.fixed_view_mut::<1, 3>(k, 0).copy_from(&(turning * (c * self.radius)));
            change.fixed_view_mut::<1, 3>(3 + k, 0).copy_from(&(turning * -s));
        }
        change
    }

    fn moved(&self, step: &SVector<f64, 6>) -> Self {
        let [first, second] = square_to(&self.normal);
        let normal = self.normal.into_inner();
        Self {
            center: self.center + normal * step[2] + first * step[3] + second * step[4],
            normal: Unit::new_normalize(normal + first * step[0] + second * step[1]),
            radius: (self.radius + step[5]).max(0.5 * self.radius),
        }
    }
}

fn shortened(foot: &Foot<6>) -> Foot<5> {
    let Foot { residual_mm, variance_mm2, normal, gradient } = *foot;
    Foot { residual_mm, variance_mm2, normal, gradient: gradient.fixed_rows::<5>(0).into_owned() }
}

impl Surface<6> for FreeRing {
    type Feet = [Foot<6>; 2];
    const NAME: &'static str = "circle";

    fn radius_mm(&self) -> Option<f64> {
        Some(self.0.radius)
    }

    fn distance(&self, point: &Vector3<f64>) -> f64 {
        self.0.distance(point)
    }

    fn feet(&self, observation: Observation<'_>, floor_mm: f64) -> [Foot<6>; 2] {
        self.0.feet(observation, floor_mm)
    }

    fn gradient_change(&self, foot: &Foot<6>) -> SMatrix<f64, 6, 3> {
        self.0.gradient_change(foot)
    }

    fn moved(&self, step: &SVector<f64, 6>) -> Self {
        Self(self.0.moved(step))
    }
}

impl Surface<5> for KnownRing {
    type Feet = [Foot<5>; 2];
    const NAME: &'static str = "circle";

    fn radius_mm(&self) -> Option<f64> {
        Some(self.0.radius)
    }

    fn distance(&self, point: &Vector3<f64>) -> f64 {
        self.0.distance(point)
    }

    fn feet(&self, observation: Observation<'_>, floor_mm: f64) -> [Foot<5>; 2] {
        self.0.feet(observation, floor_mm).map(|foot| shortened(&foot))
    }

    fn gradient_change(&self, foot: &Foot<5>) -> SMatrix<f64, 5, 3> {
        let Foot { residual_mm, variance_mm2, normal, gradient } = *foot;
        let c = -gradient[2];
        // What the direction has in the plane is s times the way outwards, c times which the gradient has.
        let flat = foot.normal - self.0.normal.into_inner() * c;
        let [x, y] = square_to(&self.0.normal).map(|tangent| flat.dot(&tangent));
        let s = flat.norm().copysign((x * gradient[0] + y * gradient[1]) * c);
        let whole = Foot { residual_mm, variance_mm2, normal, gradient: gradient.push(-s) };
        self.0.gradient_change(&whole).fixed_rows::<5>(0).into_owned()
    }

    fn moved(&self, step: &SVector<f64, 5>) -> Self {
        Self(self.0.moved(&step.push(0.0)))
    }
}

/// Returns the circle through three points, `None` where they lie on one line to within rounding.
fn through_three(points: &[Vector3<f64>]) -> Option<Ring> {
    let [a, b, c] = points else { return None };
    let (u, v) = (b - a, c - a);
    let across = u.cross(&v);
    let normal = Unit::try_new(across, 1e-10 * u.norm() * v.norm())?;
    let arm = (v.cross(&across) * u.norm_squared() + across.cross(&u) * v.norm_squared())
        / (2.0 * across.norm_squared());
    let radius = arm.norm();
    (radius.is_finite() && radius > 0.0).then(|| Ring { center: a + arm, normal, radius })
}
