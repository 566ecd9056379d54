//! A cloud moved onto a mesh: rigid alignment in the metric of each point's covariance, and what of it is determined.
//!
//! Minimised is Σ ρ(r² / v) over the points p, with q the point of the mesh nearest to T p, n the surface's normal there, r = n·(T p − q) and
//! v = nᵀ R C Rᵀ n + s² + f²: C the point's own covariance, s the mesh's sigma there and f what the residuals scatter by beyond both.
//! That is generalised ICP (A. Segal, D. Haehnel, S. Thrun, RSS 2009) in the limit of flat surfaces. Points whose nearest point lies on a
//! border of the mesh are beyond it and have no say.

use crate::cloud::{PointCloud, unpacked};
use crate::error::RegisterError;
use crate::nearest::{Nearest, NearestOnMesh};
use crate::robust::{Random, median, scale_about_zero};
use nalgebra::{Isometry3, Matrix6, Point3, Translation3, UnitQuaternion, Vector3, Vector6};

/// Tukey's constant: 95 % of a mean's efficiency with Gaussian noise, nothing from beyond it.
const TUKEY: f64 = 4.685;
/// Points that a pose is estimated from; more don't make it better than what the instrument shares between them.
const MOST_POINTS: usize = 20_000;
/// Points that starts are compared by.
const COMPARED: usize = 300;
const MAX_ROUNDS: usize = 80;
/// Share of a motion's least certain information that the noise of the normals may feign, as for shapes.
const MAX_NOISE_SHARE: f64 = 0.5;

/// Where the search begins.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Start {
    /// At this pose, which is right to within the reach, mm.
    Near(Isometry3<f64>, f64),
    /// Anywhere: from the principal axes of both, turned about by steps.
    Anywhere,
}

/// A rigid motion and how well it is known.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct Registration {
    /// Moves the cloud onto the mesh.
    pub mesh_from_cloud: Isometry3<f64>,
    /// Covariance of a small further motion (turn about the cloud's middle in rad, shift in mm, both along the mesh's axes). Errors that
    /// points share are not in it.
    pub covariance: Matrix6<f64>,
    /// Root mean square of the residuals that have a say, mm.
    pub rms_mm: f64,
    /// Share of the points that lie on the mesh to within what they scatter by.
    pub overlap: f64,
    /// What the residuals scatter by beyond the points' and the mesh's own sigmas, mm.
    pub floor_mm: f64,
    /// Motions that the points do not determine; along them the pose is as it was begun with.
    pub undetermined: Vec<Motion>,
    /// Rounds of estimation.
    pub rounds: usize,
}

/// A direction in which a pose is not known.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Motion {
    /// Turn, as a share of the whole, about an axis through the cloud's middle.
    pub turn: [f64; 3],
    /// Shift, as a share of the whole.
    pub shift: [f64; 3],
}

impl std::fmt::Display for Motion {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let [turn, shift] = [self.turn, self.shift].map(Vector3::from);
        let (what, way) =
            if turn.norm() > shift.norm() { ("a turn about", turn) } else { ("a shift along", shift) };
        let way = way / way.norm();
        write!(f, "{what} ({:.2}, {:.2}, {:.2})", way.x, way.y, way.z)
    }
}

/// One point on its way.
struct Match {
    arm: Vector3<f64>,
    normal: Vector3<f64>,
    residual: f64,
    /// Variance that the cloud and the mesh tell of, mm².
    told: f64,
    /// Variance of the normal's direction by the mesh's own noise.
    tilt: f64,
}

/// Returns the motion that brings a cloud onto a mesh.
///
/// # Errors
/// [`RegisterError`] for fewer than six points, values that are not finite, and where fewer than `least_overlap` of the points come to lie on the mesh.
pub fn register(
    cloud: &PointCloud,
    target: &NearestOnMesh<'_>,
    start: Start,
    least_overlap: f64,
) -> Result<Registration, RegisterError> {
    cloud.check_finite()?;
    if cloud.len() < 6 {
        return Err(RegisterError::TooFewPoints { got: cloud.len() });
    }
    let step = cloud.len().div_ceil(MOST_POINTS);
    let points: Vec<usize> = (0..cloud.len()).step_by(step).collect();
    let middle = points.iter().map(|&i| cloud.vector(i)).sum::<Vector3<f64>>() / points.len() as f64;
    let radius = (points.iter().map(|&i| (cloud.vector(i) - middle).norm_squared()).sum::<f64>()
        / points.len() as f64)
        .sqrt();
    if radius <= 1e-12 * middle.norm() {
        return Err(RegisterError::OnePlace);
    }
    let (pose, reach) = match start {
        Start::Near(pose, reach) => (pose, reach),
        Start::Anywhere => anywhere(cloud, &points, middle, radius, target),
    };
    let problem = Problem { cloud, points: &points, target, middle, radius };
    let fitted = problem.refine(pose, reach, MAX_ROUNDS);
    let overlap = problem.overlap(&fitted);
    if overlap < least_overlap || fitted.used < 6 {
        return Err(RegisterError::LittleOverlap { overlap, needed: least_overlap });
    }
    Ok(fitted.told(overlap, radius))
}

struct Problem<'a, 'm> {
    cloud: &'a PointCloud,
    points: &'a [usize],
    target: &'a NearestOnMesh<'m>,
    middle: Vector3<f64>,
    radius: f64,
}

struct Fitted {
    pose: Isometry3<f64>,
    information: Matrix6<f64>,
    feigned: Matrix6<f64>,
    weak: Vec<Vector6<f64>>,
    floor: f64,
    scale: f64,
    rms: f64,
    used: usize,
    rounds: usize,
}

impl Problem<'_, '_> {
    fn matches(&self, pose: &Isometry3<f64>, reach: f64) -> Vec<Match> {
        let middle = pose * Point3::from(self.middle);
        let rotation = pose.rotation.to_rotation_matrix();
        let covariances = self.cloud.covariances_mm2();
        let of = |&i: &usize| {
            let moved = pose * Point3::from(self.cloud.positions_mm()[i]);
            let near = self.target.nearest(&moved.coords.into());
            if near.on_border || near.signed_mm.abs() > reach {
                return None;
            }
            let (normal, mesh_variance, tilt) = self.surface(&near);
            let own = match (covariances, self.cloud.sigmas_mm()) {
                (Some(all), _) => {
                    let back = rotation.inverse() * normal;
                    back.dot(&(unpacked(&all[i]) * back)).max(0.0)
                }
                (None, Some(sigmas)) => f64::from(sigmas[i]).powi(2),
                (None, None) => 0.0,
            };
            Some(Match {
                arm: moved.coords - middle.coords,
                normal,
                residual: normal.dot(&(moved.coords - Vector3::from(near.point_mm))),
                told: own + mesh_variance,
                tilt,
            })
        };
        self.points.iter().filter_map(of).collect()
    }

    /// The mesh's normal at a point, smoothed over the vertices of its triangle, with the mesh's variances of place and of direction.
    fn surface(&self, near: &Nearest) -> (Vector3<f64>, f64, f64) {
        let own = Vector3::from(near.normal);
        let mesh = self.target.mesh();
        let Some(sigmas) = mesh.sigmas_mm() else { return (own, 0.0, 0.0) };
        let corners = mesh.triangles()[near.triangle];
        let variance = corners.iter().map(|&v| f64::from(sigmas[v as usize]).powi(2)).sum::<f64>() / 3.0;
        let mut normal = own;
        if let Some(normals) = mesh.normals() {
            let sum: Vector3<f64> =
                corners.iter().map(|&v| Vector3::from(normals[v as usize].map(f64::from))).sum();
            normal = sum.try_normalize(0.0).unwrap_or(own);
        }
        // A triangle tilts by its corners' noise over its heights; the mean over a dozen triangles does so by less.
        let [a, b, c] = mesh.corners(near.triangle);
        let twice = mesh.area_vector(near.triangle).norm();
        let sides = (b - a).norm_squared() + (c - b).norm_squared() + (a - c).norm_squared();
        (normal, variance, variance * sides / (twice * twice) / 8.0)
    }

    fn refine(&self, start: Isometry3<f64>, first_reach: f64, most: usize) -> Fitted {
        let mut fitted = Fitted {
            pose: start,
            information: Matrix6::zeros(),
            feigned: Matrix6::zeros(),
            weak: Vec::new(),
            floor: 0.0,
            scale: 1.0,
            rms: f64::INFINITY,
            used: 0,
            rounds: 0,
        };
        let mut reach = first_reach;
        for round in 1..=most {
            let matches = self.matches(&fitted.pose, reach);
            fitted.rounds = round;
            fitted.used = matches.len();
            if matches.len() < 6 {
                break;
            }
            let told = median(&mut matches.iter().map(|m| m.told).collect::<Vec<_>>());
            let scatter = scale_about_zero(matches.iter().map(|m| m.residual));
            let floor2 = (scatter * scatter - told).max(0.0).max((1e-9 * self.radius).powi(2));
            let (mut gradient, mut sum, mut count) = (Vector6::zeros(), 0.0, 0.0);
            (fitted.information, fitted.feigned) = (Matrix6::zeros(), Matrix6::zeros());
            for m in &matches {
                let variance = m.told + floor2;
                let ratio = m.residual * m.residual / (variance * TUKEY * TUKEY);
                if ratio >= 1.0 {
                    continue;
                }
                let weight = (1.0 - ratio).powi(2) / variance;
                // A turn by ω about the middle and a shift by t move the point by ω × arm + t. Turns are in units of the radius.
                let turn = m.arm.cross(&m.normal) / self.radius;
                let row = Vector6::new(turn.x, turn.y, turn.z, m.normal.x, m.normal.y, m.normal.z);
                gradient += row * (weight * m.residual);
                fitted.information += row * row.transpose() * weight;
                let share = weight * m.tilt;
                let across = m.arm.norm_squared() / (self.radius * self.radius);
                fitted.feigned +=
                    Matrix6::from_diagonal(&Vector6::new(across, across, across, 1.0, 1.0, 1.0)) * share;
                sum += m.residual * m.residual;
                count += 1.0;
            }
            fitted.rms = (sum / f64::max(count, 1.0)).sqrt();
            fitted.floor = floor2.sqrt();
            let (step, weak) = determined_step(&fitted.information, &fitted.feigned, &gradient);
            fitted.weak = weak;
            let turn = Vector3::new(step[0], step[1], step[2]) / self.radius;
            let shift = Vector3::new(step[3], step[4], step[5]);
            let middle = fitted.pose * Point3::from(self.middle);
            let about = Translation3::from(middle.coords + shift)
                * UnitQuaternion::new(turn)
                * Translation3::from(-middle.coords);
            fitted.pose = about * fitted.pose;
            // What is farther off than anything that has a say is looked for no more.
            let next = (3.0 * TUKEY * (told + floor2).sqrt()).min(reach);
            let settled =
                step.norm() < 1e-6 * (told + floor2).sqrt() + 1e-12 * self.radius && next > 0.9 * reach;
            reach = next.max(0.5 * reach);
            if settled {
                break;
            }
        }
        fitted
    }

    /// Share of all points that lie on the mesh and are not beyond it.
    fn overlap(&self, fitted: &Fitted) -> f64 {
        let near = self.matches(&fitted.pose, f64::INFINITY);
        let within = |m: &&Match| m.residual.powi(2) <= TUKEY.powi(2) * (m.told + fitted.floor.powi(2));
        near.iter().filter(within).count() as f64 / self.points.len() as f64
    }
}

/// The step of least squares in the motions that the points determine, and the motions that they don't: those in which half of what the
/// points say, or more, is what noise of the normals alone would say.
fn determined_step(
    information: &Matrix6<f64>,
    feigned: &Matrix6<f64>,
    gradient: &Vector6<f64>,
) -> (Vector6<f64>, Vec<Vector6<f64>>) {
    let eigen = information.symmetric_eigen();
    let most = eigen.eigenvalues.max();
    let (mut step, mut weak) = (Vector6::zeros(), Vec::new());
    for (value, way) in eigen.eigenvalues.iter().zip(eigen.eigenvectors.column_iter()) {
        let noise = way.dot(&(feigned * way));
        if *value <= 1e-9 * most || noise > MAX_NOISE_SHARE * value {
            weak.push(way.into_owned());
        } else {
            step -= way * (way.dot(gradient) / value);
        }
    }
    (step, weak)
}

impl Fitted {
    fn told(self, overlap: f64, radius: f64) -> Registration {
        let eigen = self.information.symmetric_eigen();
        let most = eigen.eigenvalues.max();
        let inverse = eigen.eigenvalues.map(|value| self.scale / value.max(1e-12 * most));
        let whole = eigen.eigenvectors * Matrix6::from_diagonal(&inverse) * eigen.eigenvectors.transpose();
        let units =
            Matrix6::from_diagonal(&Vector6::new(1.0 / radius, 1.0 / radius, 1.0 / radius, 1.0, 1.0, 1.0));
        let motion =
            |way: &Vector6<f64>| Motion { turn: [way[0], way[1], way[2]], shift: [way[3], way[4], way[5]] };
        Registration {
            mesh_from_cloud: self.pose,
            covariance: units * whole * units,
            rms_mm: self.rms,
            overlap,
            floor_mm: self.floor,
            undetermined: self.weak.iter().map(motion).collect(),
            rounds: self.rounds,
        }
    }
}

/// The best of many starts, and how far off it may be: middles and principal axes brought together every way round, and turned about
/// each of the axes by steps.
fn anywhere(
    cloud: &PointCloud,
    points: &[usize],
    middle: Vector3<f64>,
    radius: f64,
    target: &NearestOnMesh<'_>,
) -> (Isometry3<f64>, f64) {
    const TURNS: usize = 12;
    const REFINED: usize = 12;
    let mut random = Random::new(1);
    let few: Vec<usize> =
        (0..COMPARED.min(points.len())).map(|_| points[random.below(points.len())]).collect();
    let own = axes(points.iter().map(|&i| (cloud.vector(i), 1.0)));
    let mesh = target.mesh();
    let triangles = (0..mesh.triangles().len()).map(|t| {
        let [a, b, c] = mesh.corners(t);
        ((a + b + c) / 3.0, mesh.area_vector(t).norm())
    });
    let (center, theirs) = axes(triangles);
    let problem = Problem { cloud, points: &few, target, middle, radius };
    let nearness = |pose: &Isometry3<f64>| {
        let distance = |&i: &usize| {
            target.nearest(&(pose * Point3::from(cloud.vector(i))).coords.into()).signed_mm.abs()
        };
        median(&mut few.iter().map(distance).collect::<Vec<_>>())
    };
    let mut tried = Vec::new();
    // Which axis of the cloud goes along which of the mesh's cannot be told from a part of it: each may.
    for axis in 0..3 {
        for flip in [1.0, -1.0] {
            for turn in 0..TURNS {
                let about = |vectors: &[Vector3<f64>; 3], sign: f64| {
                    let z = vectors[axis] * sign;
                    let x = vectors[(axis + 1) % 3];
                    UnitQuaternion::face_towards(&z, &x)
                };
                let angle = turn as f64 * std::f64::consts::TAU / TURNS as f64;
                let spin = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), angle);
                for own_axis in 0..3 {
                    let from = UnitQuaternion::face_towards(&own.1[own_axis], &own.1[(own_axis + 1) % 3]);
                    let rotation = about(&theirs, flip) * spin * from.inverse();
                    let shift = center - rotation * own.0;
                    let pose = Isometry3::from_parts(shift.into(), rotation);
                    tried.push((nearness(&pose), pose));
                }
            }
        }
    }
    tried.sort_by(|a, b| a.0.total_cmp(&b.0));
    tried.truncate(REFINED);
    let refined = tried.iter().map(|(near, pose)| {
        let pose = problem.refine(*pose, 6.0 * near, 30).pose;
        (nearness(&pose), pose)
    });
    let best = refined.min_by(|a, b| a.0.total_cmp(&b.0));
    let (near, pose) = best.unwrap_or((radius, Isometry3::identity()));
    (pose, 10.0 * near.max(1e-6 * radius))
}

/// The weighted middle of points and their principal axes, the longest first.
fn axes(points: impl Iterator<Item = (Vector3<f64>, f64)> + Clone) -> (Vector3<f64>, [Vector3<f64>; 3]) {
    let (sum, weight) =
        points.clone().fold((Vector3::zeros(), 0.0), |(s, w), (p, own)| (s + p * own, w + own));
    let middle = sum / weight;
    let spread = points
        .fold(nalgebra::Matrix3::zeros(), |s, (p, own)| s + (p - middle) * (p - middle).transpose() * own);
    let eigen = spread.symmetric_eigen();
    let mut order = [0, 1, 2];
    order.sort_by(|&a, &b| eigen.eigenvalues[b].total_cmp(&eigen.eigenvalues[a]));
    (middle, order.map(|k| eigen.eigenvectors.column(k).into_owned()))
}
