//! Whether a fitted shape is what it is called: whether its points tell it from its nearest relatives.
//!
//! A narrow band of a cone lies on a sphere as well, a short piece of a bent edge on a cylinder, a gently curved patch on a plane. A figure
//! places each shape between itself, 0, and the relative, 1: on a sphere a difference of its two curvatures, and of the one across a band, on a
//! cylinder a taper and a curvature along its axis, on either how flat it is. The shape is confirmed where every figure is nearer to it than to the relative,
//! below one half, with a chance of one in ten thousand that this is by noise ([`SIGMAS`]).
//!
//! The same holds for what lies off it: less than half of its variance may be form, whether neighbours show it, which lie off alike
//! (`Hunt::is_noise_about`), or a regression on what the relatives would show. More of a shape is thus told by more points, and nothing is claimed of a few.
//!
//! Form is no objection to a round shape that all of it is slight beside, and that ends where its points do: a calibration that rests on land
//! poses bends a ball of 20 mm by 0.02 mm under water, which a quiet camera sees. What lies off is slight below a hundredth of what the points lie off a
//! plane ([`is_slight`]). A piece of another smooth surface may be as slight, but goes on beyond what is claimed of it (`Hunt::goes_on`).

use crate::cylinder::CylinderFit;
use crate::plane::square_to;
use crate::shapes::ShapeFit;
use crate::shapes::primitive::Primitive;
use crate::sphere::SphereFit;
use nalgebra::{DMatrix, DVector, Matrix3, Vector3};

/// Half-way between a shape and its relative, and between noise and form.
const HALFWAY: f64 = 0.5;

/// What a Gaussian exceeds once in ten thousand times: of a dozen tests a shape, one shape in a thousand is wrongly confirmed that lies
/// half-way.
const SIGMAS: f64 = 3.719;

/// Most of what no covariance tells, in units of the roughness that is typical in the cloud: a scanner's noise grows with the square of the depth, and so differs twofold
/// over its range, hardly more.
const ROUGHER: f64 = 2.0;

/// Share of what the points of a round shape lie off a plane below which what lies off the shape is slight. A piece of some other smooth surface, of radius
/// R, that ends where it lies off by the tolerance t is mostly not: its third derivative leaves it 1.7 (R/t)^(1/3) times as far off a plane, 40 times where
/// that is 1 m and 0.06 mm.
const SLIGHT: f64 = 0.01;

/// Points that are looked at.
const LOOKED_AT: usize = 2000;

/// Returns whether points, relative to the primitive's origin, confirm the fit.
///
/// A radius below `resolved_mm`, as far as normals are averaged, is that of an edge. Where its form is `slight`, it is no objection.
pub(super) fn confirmed(
    fit: &ShapeFit,
    primitive: &Primitive,
    points: &[Vector3<f64>],
    typical_mm: f64,
    resolved_mm: f64,
    slight: bool,
) -> bool {
    let deviations = fit.deviations();
    let unexplained = deviations.floor_mm.unwrap_or(deviations.rms_mm).min(deviations.rms_mm);
    let known = match fit {
        ShapeFit::Plane(_) => true,
        // Its flat relative has no curvature.
        ShapeFit::Sphere(SphereFit { radius_mm, sigma_radius_mm, .. })
        | ShapeFit::Cylinder(CylinderFit { radius_mm, sigma_radius_mm, .. }) => {
            SIGMAS * sigma_radius_mm <= HALFWAY * radius_mm && *radius_mm >= resolved_mm
        }
    };
    known
        && unexplained <= ROUGHER * typical_mm
        && relatives_are_told_apart(primitive, points, slight).unwrap_or(false)
}

/// Returns whether a share of the deviations' variance that is form, as `samples` independent ones tell it, is below one half, surely. A squared
/// correlation of one half is known to sqrt(1/2n), and other shares of it at least as well.
pub(super) fn is_mostly_noise(share: f64, samples: f64) -> bool {
    share + SIGMAS * (0.5 / samples.max(1.0)).sqrt() <= HALFWAY
}

/// Returns whether a round shape's deviations, form and all, are small beside what its points lie off their best plane.
pub(super) fn is_slight(primitive: &Primitive, points: &[Vector3<f64>]) -> bool {
    let count = points.len().max(1) as f64;
    let off = points.iter().map(|p| primitive.distance(p).powi(2)).sum::<f64>() / count;
    let spread = spread(points) / count;
    let round = !matches!(primitive, Primitive::Plane { .. });
    round
        && spread.iter().all(|s| s.is_finite())
        && off <= SLIGHT * SLIGHT * spread.symmetric_eigenvalues().min()
}

/// Returns the sum of squares and products of what some vectors lie off their mean.
fn spread(vectors: &[Vector3<f64>]) -> Matrix3<f64> {
    let mean = vectors.iter().sum::<Vector3<f64>>() / vectors.len().max(1) as f64;
    vectors.iter().map(|v| (v - mean) * (v - mean).transpose()).sum()
}

/// Returns whether the relatives' figures are known to be small; `None` where the points determine none.
fn relatives_are_told_apart(primitive: &Primitive, points: &[Vector3<f64>], slight: bool) -> Option<bool> {
    let chosen: Vec<&Vector3<f64>> = points.iter().step_by(points.len().div_ceil(LOOKED_AT).max(1)).collect();
    let middle = chosen.iter().copied().sum::<Vector3<f64>>() / chosen.len().max(1) as f64;
    let own = primitive.parameters();
    let band = band(primitive, &chosen);
    let rows: Vec<Vec<f64>> = chosen.iter().map(|p| regressors(primitive, p, &middle, &band)).collect();
    let columns = rows.first()?.len();
    if chosen.len() <= columns {
        return None;
    }
    let off = DVector::from_iterator(chosen.len(), chosen.iter().map(|p| primitive.distance(p)));
    let whole = DMatrix::from_fn(chosen.len(), columns, |i, j| rows[i][j]);
    let scales: Vec<f64> = whole.column_iter().map(|c| c.norm().max(f64::MIN_POSITIVE)).collect();
    let scaled = DMatrix::from_fn(chosen.len(), columns, |i, j| whole[(i, j)] / scales[j]);
    let (gram, right) = (scaled.tr_mul(&scaled), scaled.tr_mul(&off));
    // Squares that the first so many columns leave.
    let left = |count: usize| {
        let solution =
            gram.view((0, 0), (count, count)).into_owned().cholesky()?.solve(&right.rows(0, count));
        Some(((&off - scaled.columns(0, count) * &solution).norm_squared(), solution))
    };
    let (before, _) = left(own)?;
    let (after, solution) = left(columns)?;
    let inverse = gram.clone().cholesky()?.inverse();
    let degrees = |count: usize| (chosen.len() - count) as f64;
    let variance = after / degrees(columns);
    let figures_small = matches!(primitive, Primitive::Plane { .. })
        || (own..columns).all(|k| {
            let sigma = (variance * inverse[(k, k)].max(0.0)).sqrt();
            solution[k].abs() + SIGMAS * sigma <= HALFWAY * scales[k]
        });
    // Exact points are told from nothing by their scatter: rounding is all there is.
    let exact = before.sqrt() <= 1e-9 * middle.norm().max(scales[own - 1]);
    let share = 1.0 - variance / (before / degrees(own));
    let noise = exact || slight || is_mostly_noise(share, degrees(columns));
    Some(figures_small && noise)
}

/// Returns what a step of each of the shape's own parameters and then of its relatives' figures does to a point's distance.
fn regressors(primitive: &Primitive, point: &Vector3<f64>, middle: &Vector3<f64>, band: &Band) -> Vec<f64> {
    match primitive {
        Primitive::Plane { normal, .. } => {
            let [x, y] = square_to(normal).map(|t| t.dot(&(point - middle)));
            vec![1.0, x, y, x * x, x * y, y * y]
        }
        Primitive::Sphere { center, radius } => {
            let n = (point - center) / (point - center).norm();
            let mean = middle - center;
            let length = mean.norm();
            // A ball seen from all round has no middle: any direction serves.
            let mean = if length > 1e-6 * radius { mean / length } else { Vector3::z() };
            let [a, b] = square_to(&mean).map(|t| t.dot(&n));
            let across = band.axis.dot(&n).clamp(-1.0, 1.0).acos() - band.angle;
            vec![
                n.x,
                n.y,
                n.z,
                1.0,
                radius * (a * a - b * b) * 0.5,
                radius * a * b,
                radius * across * across * 0.5,
            ]
        }
        Primitive::Cylinder(tube) => {
            let arm = point - tube.anchor;
            let z = tube.axis.dot(&(point - middle));
            let n = arm - tube.axis.into_inner() * tube.axis.dot(&arm);
            let n = n / n.norm();
            let [x, y] = square_to(&tube.axis).map(|t| t.dot(&n));
            vec![x, y, x * z, y * z, 1.0, z, z * z / (2.0 * tube.radius)]
        }
    }
}

/// The small circle of a sphere that its points lie nearest to: the axis, and the angle from it.
struct Band {
    axis: Vector3<f64>,
    angle: f64,
}

/// Returns the circle about the direction in which the normals spread least.
fn band(primitive: &Primitive, points: &[&Vector3<f64>]) -> Band {
    let Primitive::Sphere { center, .. } = primitive else { return Band { axis: Vector3::z(), angle: 0.0 } };
    let normals: Vec<Vector3<f64>> = points.iter().map(|p| (*p - center) / (*p - center).norm()).collect();
    let spread = spread(&normals);
    let axis = if spread.iter().all(|s| s.is_finite()) {
        let eigen = spread.symmetric_eigen();
        eigen.eigenvectors.column(eigen.eigenvalues.imin()).into_owned()
    } else {
        Vector3::z()
    };
    let angle = normals.iter().map(|n| axis.dot(n).clamp(-1.0, 1.0).acos()).sum::<f64>()
        / normals.len().max(1) as f64;
    Band { axis, angle }
}
