//! The point of a circle, sphere or cylinder that is nearest in the metric of a covariance.

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
