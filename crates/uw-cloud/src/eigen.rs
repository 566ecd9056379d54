//! Eigenvalues of the symmetric 3 × 3 matrix that every neighbourhood's plane comes from, without iteration.

use nalgebra::{Matrix3, Vector3};

/// Eigenvalues of a symmetric matrix, ascending, and the unit eigenvector of the first.
pub(crate) struct Least {
    pub(crate) values: [f64; 3],
    pub(crate) axis: Vector3<f64>,
}

/// Returns the eigenvalues and the axis of the least one; `None` for a matrix that is not finite.
///
/// The roots of the characteristic polynomial by the cosine of a third of an angle (O. Smith, Comm. ACM 4 (1961) 168), vectors as cross
/// products from the root that stands apart (D. Eberly, A Robust Eigensolver for 3 × 3 Symmetric Matrices, 2014). The least value is
/// the Rayleigh quotient of its vector, and so as exact as the matrix's entries are: to some epsilon of the largest.
pub(crate) fn least(m: &Matrix3<f64>) -> Option<Least> {
    let scale = m.amax();
    if !scale.is_finite() {
        return None;
    }
    if scale <= 0.0 {
        return Some(Least { values: [0.0; 3], axis: Vector3::x() });
    }
    let a = m / scale;
    let q = a.trace() / 3.0;
    let off2 = a[(0, 1)] * a[(0, 1)] + a[(0, 2)] * a[(0, 2)] + a[(1, 2)] * a[(1, 2)];
    let b = Vector3::new(a[(0, 0)] - q, a[(1, 1)] - q, a[(2, 2)] - q);
    let p = ((b.norm_squared() + 2.0 * off2) / 6.0).sqrt();
    if p <= f64::EPSILON {
        return Some(Least { values: [scale * q; 3], axis: Vector3::x() });
    }
    let mut shifted = a;
    (0..3).for_each(|k| shifted[(k, k)] = b[k]);
    let half = (0.5 * shifted.determinant() / (p * p * p)).clamp(-1.0, 1.0);
    let third = half.acos() / 3.0;
    let most = q + 2.0 * p * third.cos();
    let least = q + 2.0 * p * (third + 2.0 * std::f64::consts::FRAC_PI_3).cos();
    // The root that stands apart has the better vector; the least one's is square to it.
    let axis = if half < 0.0 {
        vector(&a, least)
    } else {
        let largest = vector(&a, most);
        square(&a, &largest, least)
    };
    let value = axis.dot(&(a * axis));
    let middle = 3.0 * q - most - value;
    Some(Least { values: [value, middle, most].map(|v| v * scale), axis })
}

/// The vector of a simple eigenvalue: the longest of the cross products of the rows of A − λ.
fn vector(a: &Matrix3<f64>, value: f64) -> Vector3<f64> {
    let mut shifted = *a;
    (0..3).for_each(|k| shifted[(k, k)] -= value);
    let rows = [shifted.column(0), shifted.column(1), shifted.column(2)];
    let products = [rows[0].cross(&rows[1]), rows[0].cross(&rows[2]), rows[1].cross(&rows[2])];
    let longest = products.into_iter().max_by(|p, q| p.norm_squared().total_cmp(&q.norm_squared()));
    longest.and_then(|p| p.try_normalize(0.0)).unwrap_or_else(Vector3::x)
}

/// The vector of an eigenvalue in the plane square to another one's vector.
fn square(a: &Matrix3<f64>, other: &Vector3<f64>, value: f64) -> Vector3<f64> {
    let [u, v] = crate::plane::square_to(other);
    let (au, av) = (a * u, a * v);
    let (uu, uv, vv) = (u.dot(&au) - value, u.dot(&av), v.dot(&av) - value);
    // (A − λ) x = 0 for x = c u + s v: the longer of the two rows is what x is square to.
    let (c, s) = if uu.abs() >= vv.abs() { (-uv, uu) } else { (vv, -uv) };
    (u * c + v * s).try_normalize(0.0).unwrap_or(u)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::robust::Random;

    /// Rounding of a few sums in units of the largest eigenvalue.
    const ROUNDING: f64 = 1e-13;

    #[test]
    fn values_are_those_of_an_iteration_and_the_axis_is_one() {
        let mut random = Random::new(3);
        for trial in 0..4000 {
            let mut number = || random.share() - 0.5;
            // Flat, long, exact and round ones.
            let thin = [1.0, 1e-3, 1e-7, 0.0][trial % 4];
            let narrow = [1.0, 0.1, 1e-6][trial % 3];
            let turn = nalgebra::Rotation3::new(Vector3::new(number(), number(), number()) * 6.0);
            let spread = Vector3::new(1.0, narrow, narrow * thin) * [1.0, 1e-9, 1e12][trial % 3];
            let m = turn * Matrix3::from_diagonal(&spread) * turn.inverse();
            let m = (m + m.transpose()) * 0.5;
            let found = least(&m).unwrap();
            let mut truth: Vec<f64> = m.symmetric_eigenvalues().iter().copied().collect();
            truth.sort_by(f64::total_cmp);
            for (value, true_value) in found.values.iter().zip(&truth) {
                // Two equal ones are known to the root of that.
                assert!((value - true_value).abs() < 1e-7 * truth[2], "{:?} {truth:?}", found.values);
            }
            assert!(
                (found.values[0] - truth[0]).abs() < 10.0 * ROUNDING * truth[2],
                "{:?} {truth:?}",
                found.values
            );
            let left = m * found.axis - found.axis * found.values[0];
            assert!(left.norm() < 1e-7 * truth[2], "{left} {truth:?}");
            assert!((found.axis.norm() - 1.0).abs() < ROUNDING);
        }
        assert!(least(&Matrix3::from_element(f64::NAN)).is_none());
    }
}
