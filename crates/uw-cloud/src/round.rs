//! What circles, spheres and cylinders share: the point that is nearest in the metric of a covariance, and steps that flatness does not slow down.

use crate::error::FitError;
use nalgebra::SVector;

/// Returns (residual λ nᵀVn, nᵀVn, n) at the point s of |s| = R that is nearest to `arm` in the metric of V, in V's principal axes.
///
/// s = (I + μV)⁻¹ arm, where μ > −1/v_max solves |s| = R: a single root, and the global minimum (the secular equation of the
/// trust-region problem, J. Moré, D. Sorensen, SIAM J. Sci. Stat. Comput. 4 (1983) 553, whose Newton iteration on 1/|s| this
/// is, kept inside a bracket). Then λ = μ R.
pub(crate) fn nearest_on_round<const N: usize>(
    mut arm: SVector<f64, N>,
    variances: &SVector<f64, N>,
    radius: f64,
) -> (f64, f64, SVector<f64, N>) {
    let largest = variances.max();
    // In the metric of space it is the foot of the arm.
    if variances.min() >= largest {
        let length = arm.norm();
        if length >= 1e-12 * radius {
            return (length - radius, largest, arm / length);
        }
    }
    let shares = variances / largest;
    // A point right in the middle has no nearest one: take any.
    let lever = shares.imax();
    if arm[lever].abs() < 1e-12 * radius {
        arm[lever] = 1e-12 * radius;
    }
    let at = |nu: f64| arm.zip_map(&shares, |a, w| a / (1.0 + nu * w));
    let (mut low, mut high) = (-1.0, f64::INFINITY);
    let outward = arm.norm();
    let slant = arm.component_mul(&shares).dot(&arm) / (outward * outward);
    let mut nu = ((outward - radius) / (radius * slant)).max(-0.5);
    for _ in 0..60 {
        let s = at(nu);
        let length = s.norm();
        let excess = length / radius - 1.0;
        if excess.abs() < 8.0 * f64::EPSILON {
            break;
        }
        if excess > 0.0 {
            low = nu;
        } else {
            high = nu;
        }
        let steepness = s.component_mul(&s).zip_map(&shares, |s2, w| s2 * w / (1.0 + nu * w)).sum();
        let newton = nu + excess * length * length / steepness;
        let previous = nu;
        nu = if newton > low && newton < high {
            newton
        } else if high.is_finite() {
            0.5 * (low + high)
        } else {
            2.0 * low + 1.0
        };
        if (nu - previous).abs() <= 2.0 * f64::EPSILON * nu.abs() {
            break;
        }
    }
    let normal = at(nu).normalize();
    let variance = normal.component_mul(&normal).dot(variances);
    (nu / largest * radius * variance, variance, normal)
}

/// Refuses points, by their distances from it, that are of no such shape. Outliers are told by the points' own scatter: where nothing is near the shape, nothing is an
/// outlier.
pub(crate) fn refuse_filling(
    shape: &'static str,
    radius_mm: f64,
    distances_mm: &[f64],
) -> Result<(), FitError> {
    /// Root mean square by radius. Points that fill a ball evenly come to 0.26 about the sphere that fits them best, those that fill a circle to 0.35.
    const MOST: f64 = 0.2;
    let squares: f64 = distances_mm.iter().map(|d| d * d).sum();
    let rms_mm = (squares / distances_mm.len().max(1) as f64).sqrt();
    if rms_mm > MOST * radius_mm {
        return Err(FitError::NoShape { shape, rms_mm, radius_mm });
    }
    Ok(())
}

/// Returns the principal axes of the symmetric matrix (aa, ab; ab, bb): cosine and sine of the angle that the axis of the larger value is turned by, the larger and the smaller value. Where
/// they are alike the axes stay as they are.
pub(crate) fn principal(aa: f64, ab: f64, bb: f64) -> ([f64; 2], [f64; 2]) {
    /// Of sums of some products, in units of the mean value: what differs by less has no axes, and rounding's are another for each point.
    const ROUNDING: f64 = 32.0 * f64::EPSILON;
    let (mean, half) = (0.5 * (aa + bb), 0.5 * (aa - bb));
    let spread = (half * half + ab * ab).sqrt();
    let values = [mean + spread, mean - spread];
    if spread <= ROUNDING * mean {
        return ([1.0, 0.0], values);
    }
    // Half of an angle of which cosine and sine are known; the larger of its own two comes first, as nothing cancels in it.
    let larger = (0.5 * (1.0 + half.abs() / spread)).sqrt();
    let smaller = 0.5 * ab.abs() / (spread * larger);
    let [c, s] = if half >= 0.0 { [larger, smaller] } else { [smaller, larger] };
    ([c, s.copysign(ab)], values)
}

/// Least square of the slope that a step leaves, one before it: what bends it more is damped.
const LEAST_SLOPE2: f64 = 0.25;

/// A circle or sphere by its apex, the place of it that is nearest to the points' middle, the origin: the surface is κ |x|² / 2 + b·x + d = 0 about there, at first with d = 0 and
/// b the unit normal, and |b|² − 2 κ d = 1 always (V. Pratt, Computer Graphics 21 (1987) 145).
///
/// Distances are all but linear in these, of a whole ball as of a flat cap, and a plane is none of their ends. In centre and radius they are not: of a cap
/// that spans the angle α both are told apart by its fourth power only, which rounding hides, and along the bent valley where they agree steps are short.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Apex<const N: usize> {
    center: SVector<f64, N>,
    radius: f64,
    outward: SVector<f64, N>,
}

impl<const N: usize> Apex<N> {
    pub(crate) fn of(center: SVector<f64, N>, radius: f64) -> Self {
        // Seen from its very middle any place serves.
        let outward = (-center)
            .try_normalize(1e-12 * radius)
            .unwrap_or_else(|| SVector::from_fn(|k, _| if k + 1 == N { 1.0 } else { 0.0 }));
        Self { center, radius, outward }
    }

    pub(crate) fn center(&self) -> SVector<f64, N> {
        self.center
    }

    /// Returns the unit normal at the apex.
    pub(crate) fn outward(&self) -> SVector<f64, N> {
        self.outward
    }

    /// Returns the way from the apex to where the surface has a normal: the derivative of the distance there by a tilt of b.
    pub(crate) fn arm(&self, normal: &SVector<f64, N>) -> SVector<f64, N> {
        (normal - self.outward) * self.radius
    }

    /// Returns the derivatives of the distance by d, with b as long as that asks for, and by κ, where the surface has a normal.
    pub(crate) fn rise_and_bend(&self, normal: &SVector<f64, N>) -> [f64; 2] {
        [self.outward.dot(normal), 0.5 * self.arm(normal).norm_squared()]
    }

    /// Returns centre and radius after steps of b, square to the normal, of d and of κ. The centre may come to lie on the other side.
    pub(crate) fn moved(&self, tilt: &SVector<f64, N>, rise: f64, bend: f64) -> (SVector<f64, N>, f64) {
        let apex = self.center + self.outward * self.radius;
        let slope = self.outward * (1.0 + rise / self.radius) + tilt;
        let curvature = 1.0 / self.radius + bend;
        let slope2 = (slope.norm_squared() - 2.0 * curvature * rise).max(LEAST_SLOPE2);
        // A plane has no centre.
        let curvature = curvature.abs().max(f64::EPSILON / self.radius).copysign(curvature);
        (apex - slope / curvature, slope2.sqrt() / curvature.abs())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{Vector2, Vector3};

    #[test]
    fn derivatives_are_those_of_the_distance() {
        /// Differences over a hundred-thousandth, of distances whose third derivatives are of the size of one.
        const DIFFERENCE: f64 = 1e-8;
        const STEP: f64 = 1e-5;
        let normal = Vector3::new(0.48, -0.6, 0.64);
        for center in [Vector3::zeros(), Vector3::new(0.3, 0.1, -1.1), Vector3::new(4.0, 0.0, 2.0)] {
            let apex = Apex::of(center, 1.3);
            let place = center + normal * 1.3;
            let slope = |tilt: Vector3<f64>, rise: f64, bend: f64| {
                let off = |size: f64| {
                    let (center, radius) = apex.moved(&(tilt * size), rise * size, bend * size);
                    (place - center).norm() - radius
                };
                (off(STEP) - off(-STEP)) / (2.0 * STEP)
            };
            let tilt = apex.outward().cross(&Vector3::new(0.3, -0.5, 0.7));
            let [rise, bend] = apex.rise_and_bend(&normal);
            assert!((slope(tilt, 0.0, 0.0) - tilt.dot(&apex.arm(&normal))).abs() < DIFFERENCE, "{center}");
            assert!((slope(Vector3::zeros(), 1.0, 0.0) - rise).abs() < DIFFERENCE, "{center}");
            assert!((slope(Vector3::zeros(), 0.0, 1.0) - bend).abs() < DIFFERENCE, "{center}");
        }
    }

    #[test]
    fn what_fills_a_ball_or_a_circle_is_neither_sphere_nor_circle() {
        // Middles of shells of equal volume, and of rings of equal area.
        for power in [3.0, 2.0] {
            let away: Vec<f64> =
                (0..1000).map(|k| ((f64::from(k) + 0.5) / 1e3_f64).powf(1.0 / power)).collect();
            let radius = away.iter().sum::<f64>() / 1e3;
            let filling: Vec<f64> = away.iter().map(|r| r - radius).collect();
            assert!(matches!(refuse_filling("ball", radius, &filling), Err(FitError::NoShape { .. })));
            let rough: Vec<f64> = filling.iter().map(|d| 0.5 * d).collect();
            assert_eq!(refuse_filling("ball", radius, &rough), Ok(()));
        }
    }

    #[test]
    fn principal_axes_make_the_matrix_again() {
        for (aa, ab, bb) in
            [(2.0, 0.3, 1.0), (1.0, -0.3, 2.0), (1.0, 1.0, 1.0), (3.0, 0.0, 3.0), (0.0, 1e-9, 4.0)]
        {
            let ([c, s], [most, least]) = principal(aa, ab, bb);
            let made = (most * c * c + least * s * s, (most - least) * c * s, most * s * s + least * c * c);
            let off = (made.0 - aa).abs().max((made.1 - ab).abs()).max((made.2 - bb).abs());
            assert!(off < 4.0 * f64::EPSILON * most && most >= least, "{aa} {ab} {bb}: {made:?}");
        }
    }

    #[test]
    fn a_step_through_the_plane_comes_out_bent_the_other_way() {
        let (center, radius) = Apex::of(Vector2::new(0.0, -50.0), 50.0).moved(&Vector2::zeros(), 0.0, -0.04);
        assert!((center - Vector2::new(0.0, 50.0)).norm() < 1e-12, "{center}");
        assert!((radius - 50.0).abs() < 1e-12, "{radius}");
    }
}
