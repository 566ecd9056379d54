//! The cylinder, of free or of known radius.

use crate::cloud::PointCloud;
use crate::consensus::{Search, consensus};
use crate::deviations::{Deviations, Influence};
use crate::error::FitError;
use crate::fit::{Fitted, Foot, Surface, fit, refine};
use crate::neighbours::Neighbours;
use crate::normals::{NORMAL_NEIGHBOURS, local_plane};
use crate::plane::square_to;
use crate::round::{Apex, nearest_on_round, principal};
use crate::sample::{Observation, Observations, Sample};
use nalgebra::{DMatrix, Matrix2, Matrix3, SMatrix, SVector, Unit, Vector2, Vector3};

/// How a cylinder is fitted.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CylinderOptions {
    /// The radius where it is known, mm; `None` estimates it.
    pub radius_mm: Option<f64>,
    /// Seed of the random samples that the start is taken from.
    pub seed: u64,
}

impl Default for CylinderOptions {
    fn default() -> Self {
        Self { radius_mm: None, seed: 1 }
    }
}

/// A fitted cylinder.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct CylinderFit {
    /// Radius, mm.
    pub radius_mm: f64,
    /// The axis's point at the middle of the fitted points, in the cloud's frame, mm.
    pub axis_point_mm: [f64; 3],
    /// Unit vector along the axis, its largest component positive.
    pub axis_direction: [f64; 3],
    /// Standard deviation of the radius, mm; 0 where it was given.
    pub sigma_radius_mm: f64,
    /// Standard deviations of the axis's point, mm (along the axis it has none).
    pub sigma_axis_point_mm: [f64; 3],
    /// Standard deviation of the axis's direction in its least certain direction, rad.
    pub sigma_direction_rad: f64,
    /// From where to where along the axis the fitted points lie, mm from its point.
    pub extent_mm: [f64; 2],
    /// Covariance of (axis point, direction, radius), mm and no unit, of rank five.
    pub covariance: SMatrix<f64, 7, 7>,
    /// Number of points and their distances.
    pub deviations: Deviations,
    /// How (axis point, direction, radius) follow the points.
    pub influence: Influence,
}

/// Best samples that are concentrated: normals are rough, so that the best sample need not be near the best cylinder.
const STARTS: usize = 6;

/// Sine of the angle between two normals below which their cross product tells no axis.
const LEAST_TURN: f64 = 0.05;

/// Returns the cylinder that most of a cloud's points lie on, in the cloud's frame, mm.
///
/// Two points with the normals that their neighbours tell start it (R. Schnabel, R. Wahl, R. Klein, Computer Graphics Forum 26
/// (2007) 214); the rest is as for the sphere ([`crate::fit_sphere`]). Where its points span little of its circumference, radius and axis are
/// hardly told apart and the sigmas say so.
///
/// # Errors
/// Fewer than five distinct points (six without covariances; with a known radius four and five), values that are not finite, no
/// cylinder in the points, or points that do not determine one: see [`FitError`].
///
/// # Examples
/// ```
/// use uw_cloud::{CylinderOptions, Frame, PointCloud, fit_cylinder};
///
/// let points = (0..600).map(|i| {
///     let (t, x) = (-2.5 + f64::from(i % 30) / 15.0, f64::from(i / 30) * 2.0);
///     [x, 30.0 * t.cos(), 700.0 + 30.0 * t.sin()]
/// });
/// let fit = fit_cylinder(&PointCloud::new(Frame::Camera, points.collect()), &CylinderOptions::default())?;
/// assert!((fit.radius_mm - 30.0).abs() < 1e-9);
/// assert!((fit.axis_direction[0] - 1.0).abs() < 1e-12);
/// # Ok::<(), uw_cloud::FitError>(())
/// ```
pub fn fit_cylinder(cloud: &PointCloud, options: &CylinderOptions) -> Result<CylinderFit, FitError> {
    match options.radius_mm {
        None => {
            let sample = Sample::new(cloud, FreeTube::NAME, 5)?;
            let oriented = Oriented::new(&sample)?;
            let search = Search { size: 2, starts: STARTS, seed: options.seed };
            let start =
                consensus(&sample, search, |p| oriented.through_two(p).into_iter().map(FreeTube).collect())
                    .ok_or_else(|| undetermined(FreeTube::NAME))?;
            Ok(free_result(
                fit::<FreeTube, 5>(&FreeTube(start.surface.0.centred()), start.scatter_mm, &sample)?,
                &sample,
            ))
        }
        Some(radius) if radius > 0.0 && radius < 1e100 => {
            let sample = Sample::new(cloud, KnownTube::NAME, 4)?;
            let oriented = Oriented::new(&sample)?;
            let search = Search { size: 2, starts: STARTS, seed: options.seed };
            let start = consensus(&sample, search, |p| oriented.through_two_of(p, radius))
                .ok_or_else(|| undetermined(KnownTube::NAME))?;
            let start_surface = KnownTube(start.surface.0.centred());
            let fitted = fit::<KnownTube, 4>(&start_surface, start.scatter_mm, &sample)?;
            let mut widened = DMatrix::zeros(5, 4);
            widened.fill_diagonal(1.0);
            let mut covariance = SMatrix::<f64, 5, 5>::zeros();
            covariance.fixed_view_mut::<4, 4>(0, 0).copy_from(&fitted.covariance);
            let influence = fitted.influence.mapped(&widened);
            Ok(result(fitted.surface.0, &covariance, fitted.deviations, influence, &sample, &fitted.inliers))
        }
        Some(radius_mm) => Err(FitError::InvalidRadius { radius_mm }),
    }
}

fn undetermined(shape: &'static str) -> FitError {
    FitError::Undetermined { shape, noise_share: 1.0, allowed: 0.0 }
}

/// Returns the cylinder near a start that the given points of a checked cloud agree with, and those that do.
pub(crate) fn refit(
    cloud: &PointCloud,
    indices: Vec<usize>,
    anchor: Vector3<f64>,
    axis: Unit<Vector3<f64>>,
    radius: f64,
    scatter_mm: f64,
) -> Result<(CylinderFit, Vec<usize>), FitError> {
    let sample = Sample::of(cloud, indices, FreeTube::NAME, 5)?;
    let start = FreeTube(Tube { anchor: anchor - sample.centre, axis, radius }.centred());
    let fitted = fit::<FreeTube, 5>(&start, scatter_mm, &sample)?;
    let inliers = sample.indices(&fitted.inliers);
    Ok((free_result(fitted, &sample), inliers))
}

/// Returns the cylinder of least squares of distances to points about the origin, from a start; a
/// scatter below the resolution is none.
pub(crate) fn least_squares(points: &[Vector3<f64>], tube: Tube, resolution_mm: f64) -> Option<Tube> {
    let (points, all) = (Observations::bare(points.to_vec()), (0..points.len()).collect::<Vec<_>>());
    Some(refine(FreeTube(tube.centred()), &points, &all, 1.0, resolution_mm)?.0)
}

fn free_result(fitted: Fitted<FreeTube, 5>, sample: &Sample<'_>) -> CylinderFit {
    result(fitted.surface.0, &fitted.covariance, fitted.deviations, fitted.influence, sample, &fitted.inliers)
}

/// Returns the result in the cloud's frame, its point in the middle of the inliers.
fn result(
    tube: Tube,
    covariance: &SMatrix<f64, 5, 5>,
    deviations: Deviations,
    influence: Influence,
    sample: &Sample<'_>,
    inliers: &[usize],
) -> CylinderFit {
    let along = |i: &usize| tube.axis.dot(&(sample.observations.points[*i] - tube.anchor));
    let middle = inliers.iter().map(along).sum::<f64>() / inliers.len().max(1) as f64;
    let (low, high) = inliers
        .iter()
        .map(along)
        .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), z| (low.min(z), high.max(z)));
    let sign = tube.axis[tube.axis.iamax()].signum();
    let [first, second] = square_to(&tube.axis);
    let mut jacobian = SMatrix::<f64, 7, 5>::zeros();
    for (k, tangent) in [first, second].iter().enumerate() {
        jacobian.fixed_view_mut::<3, 1>(0, k).copy_from(tangent);
        jacobian.fixed_view_mut::<3, 1>(0, 2 + k).copy_from(&(tangent * middle));
        jacobian.fixed_view_mut::<3, 1>(3, 2 + k).copy_from(&(tangent * sign));
    }
    jacobian[(6, 4)] = 1.0;
    let public = jacobian * covariance * jacobian.transpose();
    let sigma = |i: usize| public[(i, i)].max(0.0).sqrt();
    let tilt = covariance.fixed_view::<2, 2>(2, 2).into_owned();
    let ends = [low - middle, high - middle].map(|z| z * sign);
    CylinderFit {
        radius_mm: tube.radius,
        axis_point_mm: (tube.anchor + tube.axis.into_inner() * middle + sample.centre).into(),
        axis_direction: (tube.axis.into_inner() * sign).into(),
        sigma_radius_mm: sigma(6),
        sigma_axis_point_mm: [sigma(0), sigma(1), sigma(2)],
        sigma_direction_rad: tilt.symmetric_eigenvalues().max().max(0.0).sqrt(),
        extent_mm: if sign < 0.0 { [ends[1], ends[0]] } else { ends },
        covariance: public,
        deviations,
        influence: influence.mapped(&DMatrix::from_fn(7, 5, |i, j| jacobian[(i, j)])),
    }
}

/// Axis and radius, mm.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Tube {
    pub(crate) anchor: Vector3<f64>,
    pub(crate) axis: Unit<Vector3<f64>>,
    pub(crate) radius: f64,
}

/// A cylinder whose five parameters are free: shifts and tilts along the two directions square to its axis, radius.
#[derive(Debug, Clone, Copy)]
struct FreeTube(Tube);

/// A cylinder of given radius: four parameters.
#[derive(Debug, Clone, Copy)]
struct KnownTube(Tube);

impl Tube {
    /// Returns the cylinder through two points with their normals, which meet on its axis; `None` for parallel normals.
    pub(crate) fn through(points: [&Vector3<f64>; 2], normals: [&Vector3<f64>; 2]) -> Option<Self> {
        let [p, q] = points;
        let [m, n] = normals;
        let axis = Unit::try_new(m.cross(n), LEAST_TURN)?;
        // In the plane square to the axis: p + s m = q + t n.
        let flat = |v: &Vector3<f64>| v - axis.into_inner() * axis.dot(v);
        let (m, n, apart) = (flat(m), flat(n), flat(&(q - p)));
        let across = axis.dot(&m.cross(&n));
        let s = axis.dot(&apart.cross(&n)) / across;
        let t = axis.dot(&apart.cross(&m)) / across;
        let anchor = p + m * s;
        let radius = 0.5 * (s.abs() * m.norm() + t.abs() * n.norm());
        (radius > 0.0 && radius.is_finite()).then_some(Self { anchor, axis, radius })
    }

    /// Returns the same cylinder with its anchor abreast of the sample's centre, about which it is tilted.
    fn centred(mut self) -> Self {
        self.anchor -= self.axis.into_inner() * self.axis.dot(&self.anchor);
        self
    }

    pub(crate) fn distance(&self, point: &Vector3<f64>) -> f64 {
        let arm = point - self.anchor;
        (arm - self.axis.into_inner() * self.axis.dot(&arm)).norm() - self.radius
    }

    /// Returns the foot, its gradient by all five parameters: along the axis a point's error does not matter, so that it is
    /// the foot on a circle in the metric of the covariance's part square to the axis.
    fn foot(&self, observation: Observation<'_>, floor_mm: f64) -> Foot<5> {
        let [first, second] = square_to(&self.axis);
        let arm = observation.point - self.anchor;
        let flat = Vector2::new(first.dot(&arm), second.dot(&arm));
        if observation.spread.is_none() {
            // In the metric of space nothing has to be turned.
            let alike = Vector2::repeat(floor_mm * floor_mm);
            let (residual_mm, variance_mm2, n) = nearest_on_round(flat, &alike, self.radius);
            let height = self.axis.dot(&arm);
            let gradient = SVector::<f64, 5>::new(-n.x, -n.y, -n.x * height, -n.y * height, -1.0);
            return Foot { residual_mm, variance_mm2, normal: first * n.x + second * n.y, gradient };
        }
        let variances = observation.variances(floor_mm);
        let (a, b) = (observation.in_axes(&first), observation.in_axes(&second));
        let weighted = |v: &Vector3<f64>| v.component_mul(&variances);
        let (aa, ab, bb) = (a.dot(&weighted(&a)), a.dot(&weighted(&b)), b.dot(&weighted(&b)));
        let ([c, s], [most, least]) = principal(aa, ab, bb);
        let axes = Matrix2::new(c, -s, s, c);
        let least = least.max(floor_mm * floor_mm);
        let (residual_mm, variance_mm2, n) =
            nearest_on_round(axes.tr_mul(&flat), &Vector2::new(most, least), self.radius);
        let n = axes * n;
        let normal = first * n.x + second * n.y;
        let along = observation.out_of_axes(&weighted(&observation.in_axes(&normal)));
        let height = self.axis.dot(&(arm - along * (residual_mm / variance_mm2)));
        let gradient = SVector::<f64, 5>::new(-n.x, -n.y, -n.x * height, -n.y * height, -1.0);
        Foot { residual_mm, variance_mm2, normal, gradient }
    }

    fn gradient_change(&self, foot: &Foot<5>) -> SMatrix<f64, 5, 3> {
        let tangents = square_to(&self.axis);
        let around = self.axis.cross(&foot.normal);
        let mut change = SMatrix::<f64, 5, 3>::zeros();
        let [x, y] = tangents.map(|tangent| foot.normal.dot(&tangent));
        let height = -(foot.gradient[2] * x + foot.gradient[3] * y);
        for (k, (tangent, n)) in tangents.iter().zip([x, y]).enumerate() {
            let turning = around.transpose() * (tangent.dot(&around) / self.radius);
            change.fixed_view_mut::<1, 3>(k, 0).copy_from(&-turning);
            change
                .fixed_view_mut::<1, 3>(2 + k, 0)
                .copy_from(&-(turning * height + self.axis.transpose() * n));
        }
        change
    }

    fn normal_change(&self, foot: &Foot<5>) -> Matrix3<f64> {
        let around = self.axis.cross(&foot.normal);
        around * around.transpose() / self.radius
    }

    /// Returns the circle that it is across its axis, in the two directions square to that.
    fn apex(&self) -> Apex<2> {
        Apex::of(Vector2::from(square_to(&self.axis).map(|tangent| tangent.dot(&self.anchor))), self.radius)
    }

    /// Returns the cylinder with its axis shifted, and tilted about the point of it that is abreast of the sample's centre.
    fn moved(&self, shift: &Vector2<f64>, tilt: &Vector2<f64>, radius: f64) -> Self {
        let [first, second] = square_to(&self.axis);
        Self {
            anchor: self.anchor + first * shift.x + second * shift.y,
            // Never shorter than the unit vector that it was made of.
            axis: Unit::new_normalize(self.axis.into_inner() + first * tilt.x + second * tilt.y),
            radius,
        }
        .centred()
    }
}

impl Surface<5> for FreeTube {
    type Feet = [Foot<5>; 1];
    const NAME: &'static str = "cylinder";

    fn radius_mm(&self) -> Option<f64> {
        Some(self.0.radius)
    }

    fn distance(&self, point: &Vector3<f64>) -> f64 {
        self.0.distance(point)
    }

    fn feet(&self, observation: Observation<'_>, floor_mm: f64) -> [Foot<5>; 1] {
        [self.0.foot(observation, floor_mm)]
    }

    fn gradient_change(&self, foot: &Foot<5>) -> SMatrix<f64, 5, 3> {
        self.0.gradient_change(foot)
    }

    fn normal_change(&self, foot: &Foot<5>) -> Matrix3<f64> {
        self.0.normal_change(foot)
    }

    fn lever(&self) -> impl Fn(&Foot<5>) -> SVector<f64, 5> {
        let apex = self.0.apex();
        let (outward, aside) = (apex.outward(), aside(&apex));
        move |foot| {
            let normal = -foot.gradient.xy();
            let tilted = Vector2::new(foot.gradient[2], foot.gradient[3]);
            let [rise, bend] = apex.rise_and_bend(&normal);
            SVector::<f64, 5>::new(
                aside.dot(&apex.arm(&normal)),
                rise,
                outward.dot(&tilted),
                aside.dot(&tilted),
                bend,
            )
        }
    }

    fn moved(&self, step: &SVector<f64, 5>) -> Self {
        let apex = self.0.apex();
        let aside = aside(&apex);
        let (center, radius) = apex.moved(&(aside * step[0]), step[1], step[4]);
        let tilt = apex.outward() * step[2] + aside * step[3];
        Self(self.0.moved(&(center - apex.center()), &tilt, radius))
    }
}

impl Surface<4> for KnownTube {
    type Feet = [Foot<4>; 1];
    const NAME: &'static str = "cylinder";

    fn radius_mm(&self) -> Option<f64> {
        Some(self.0.radius)
    }

    fn distance(&self, point: &Vector3<f64>) -> f64 {
        self.0.distance(point)
    }

    fn feet(&self, observation: Observation<'_>, floor_mm: f64) -> [Foot<4>; 1] {
        let Foot { residual_mm, variance_mm2, normal, gradient } = self.0.foot(observation, floor_mm);
        [Foot { residual_mm, variance_mm2, normal, gradient: gradient.fixed_rows::<4>(0).into_owned() }]
    }

    fn gradient_change(&self, foot: &Foot<4>) -> SMatrix<f64, 4, 3> {
        self.0.gradient_change(&whole(foot)).fixed_rows::<4>(0).into_owned()
    }

    fn normal_change(&self, foot: &Foot<4>) -> Matrix3<f64> {
        self.0.normal_change(&whole(foot))
    }

    fn moved(&self, step: &SVector<f64, 4>) -> Self {
        Self(self.0.moved(&step.xy(), &Vector2::new(step[2], step[3]), self.0.radius))
    }
}

/// Returns the direction of a circle at its apex.
fn aside(apex: &Apex<2>) -> Vector2<f64> {
    Vector2::new(-apex.outward().y, apex.outward().x)
}

/// A foot on a cylinder of known radius as one on a cylinder of any.
fn whole(foot: &Foot<4>) -> Foot<5> {
    let Foot { residual_mm, variance_mm2, normal, gradient } = *foot;
    Foot { residual_mm, variance_mm2, normal, gradient: gradient.push(-1.0) }
}

/// The sample with the normals that neighbours tell, worked out as they are asked for.
struct Oriented<'a> {
    sample: &'a Sample<'a>,
    positions: Vec<[f64; 3]>,
    neighbours: Neighbours,
}

impl<'a> Oriented<'a> {
    fn new(sample: &'a Sample<'a>) -> Result<Self, FitError> {
        let positions: Vec<[f64; 3]> = sample.observations.points.iter().map(|p| (*p).into()).collect();
        let neighbours = Neighbours::new(&positions)?;
        Ok(Self { sample, positions, neighbours })
    }

    fn normal(&self, i: usize) -> Option<Vector3<f64>> {
        // Of few points, fewer are near.
        let count = NORMAL_NEIGHBOURS.min(self.positions.len() / 4).max(6);
        let place = &self.positions[i];
        local_plane(&self.positions, &self.neighbours, place, count, &[0.0; 3]).map(|local| local.normal)
    }

    fn through_two(&self, pair: &[usize]) -> Option<Tube> {
        let &[i, j] = pair else { return None };
        let (m, n) = (self.normal(i)?, self.normal(j)?);
        let at = |i: usize| &self.sample.observations.points[i];
        Tube::through([at(i), at(j)], [&m, &n])
    }

    /// Returns the cylinders of a known radius through a pair, inside and outside of its surface.
    fn through_two_of(&self, pair: &[usize], radius: f64) -> Vec<KnownTube> {
        let Some(tube) = self.through_two(pair) else { return Vec::new() };
        let arms = pair.iter().map(|&i| {
            let arm = self.sample.observations.points[i] - tube.anchor;
            arm - tube.axis.into_inner() * tube.axis.dot(&arm)
        });
        let Some(outward) = Unit::try_new(arms.sum::<Vector3<f64>>(), 0.0) else { return Vec::new() };
        // The surface stays where the pair is; the axis moves to the given radius.
        let shifted = |side: f64| tube.anchor + outward.into_inner() * (tube.radius - radius) * side;
        let far = tube.anchor + outward.into_inner() * (tube.radius + radius);
        [shifted(1.0), far].map(|anchor| KnownTube(Tube { anchor, radius, ..tube })).to_vec()
    }
}
