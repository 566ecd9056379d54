//! Normal equations of a handful of parameters, without allocation: of one fit, or of as many side by side as a vector has lanes.

#![allow(clippy::needless_range_loop, reason = "indices read as in the formulas")]

use super::wide::V;
use fearless_simd::{ExtractToken, Select, Simd, SimdBase, SimdFloat};
use std::ops::{Add, AddAssign, Mul, Range, Sub, SubAssign};

/// A number, or a vector with one for each of the fits that are solved together.
pub(crate) trait Number:
    Copy + Add<Output = Self> + AddAssign + Sub<Output = Self> + SubAssign + Mul<Output = Self>
{
    /// `value`, in as many lanes as this one has.
    fn like(self, value: f64) -> Self;
    /// 1 / √self; NaN where this is below `least`, or NaN.
    fn inverse_root(self, least: f64) -> Self;
}

impl Number for f64 {
    #[inline(always)]
    fn like(self, value: f64) -> Self {
        value
    }
    #[inline(always)]
    fn inverse_root(self, least: f64) -> Self {
        if self >= least { 1.0 / self.sqrt() } else { Self::NAN }
    }
}

impl<S: Simd> Number for V<S> {
    #[inline(always)]
    fn like(self, value: f64) -> Self {
        Self::splat(self.token(), value)
    }
    #[inline(always)]
    fn inverse_root(self, least: f64) -> Self {
        let root = self.like(1.0) / self.sqrt();
        self.simd_ge(self.like(least)).select(root, self.like(f64::NAN))
    }
}

/// A symmetric matrix of `N` rows, of which the lower triangle is kept.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Symmetric<T, const N: usize>(pub [[T; N]; N]);

/// Cholesky factor of a matrix scaled to a unit diagonal, since flux and background differ by decades. NaN where that matrix was not
/// positive definite to rounding.
#[derive(Debug)]
pub(crate) struct Factor<T, const N: usize> {
    /// Below the diagonal, and the reciprocal of the diagonal.
    lower: [[T; N]; N],
    pivot: [T; N],
    scale: [T; N],
}

impl<T: Number, const N: usize> Symmetric<T, N> {
    /// The factor of the matrix with `damping` added to the scaled diagonal.
    #[inline(always)]
    pub fn factor(&self, damping: f64) -> Factor<T, N> {
        /// Pivot of the scaled matrix below which a parameter is not told from the others.
        const SINGULAR: f64 = 1e-12;
        let zero = self.0[0][0].like(0.0);
        let one = zero.like(1.0 + damping);
        let (mut lower, mut pivot, mut scale) = ([[zero; N]; N], [zero; N], [zero; N]);
        for i in 0..N {
            scale[i] = self.0[i][i].inverse_root(f64::MIN_POSITIVE);
            let mut rest = one;
            for j in 0..i {
                let mut sum = self.0[i][j] * scale[i] * scale[j];
                for k in 0..j {
                    sum -= lower[i][k] * lower[j][k];
                }
                let entry = sum * pivot[j];
                lower[i][j] = entry;
                rest -= entry * entry;
            }
            // An infinite entry makes the scale 0, and a missing one NaN: neither may pass for a unit diagonal.
            let unit = self.0[i][i] * scale[i] * scale[i];
            pivot[i] = (rest + unit * zero).inverse_root(SINGULAR);
        }
        Factor { lower, pivot, scale }
    }
}

impl<T: Number, const N: usize> Factor<T, N> {
    /// NaN where the matrix was singular.
    #[inline(always)]
    pub fn soundness(&self) -> T {
        self.pivot[N - 1]
    }

    /// The solution for the right side `b`, in place.
    #[inline(always)]
    pub fn solve(&self, b: &mut [T; N]) {
        self.solve_first::<N>(b);
    }

    /// The solution for the first `M` entries of the right side with as many rows and columns, in place.
    #[inline(always)]
    pub fn solve_first<const M: usize>(&self, b: &mut [T; N]) {
        self.whiten_part(0..M, b);
        for i in (0..M).rev() {
            b[i] = b[i] * self.pivot[i];
            for k in 0..i {
                b[k] -= self.lower[i][k] * b[i];
            }
            b[i] = b[i] * self.scale[i];
        }
    }

    /// L⁻¹ b: the squares of its entries sum to bᵀ M⁻¹ b.
    #[inline(always)]
    pub fn whiten(&self, b: &mut [T; N]) {
        self.whiten_part(0..N, b);
    }

    /// A part of the same where the entries before it are 0.
    #[inline(always)]
    fn whiten_part(&self, part: Range<usize>, b: &mut [T; N]) {
        for i in part.clone() {
            let mut sum = b[i] * self.scale[i];
            for k in part.start..i {
                sum -= self.lower[i][k] * b[k];
            }
            b[i] = sum * self.pivot[i];
        }
    }

    /// Column `k` of the inverse.
    #[inline(always)]
    pub fn column(&self, k: usize) -> [T; N] {
        let mut b = self.unit(k);
        self.solve(&mut b);
        b
    }

    /// Entry `k` of the inverse's diagonal.
    #[inline(always)]
    pub fn variance(&self, k: usize) -> T {
        let mut white = self.unit(k);
        self.whiten_part(k..N, &mut white);
        let mut sum = white[k] * white[k];
        for i in k + 1..N {
            sum += white[i] * white[i];
        }
        sum
    }

    #[inline(always)]
    fn unit(&self, k: usize) -> [T; N] {
        let mut b = [self.pivot[0].like(0.0); N];
        b[k] = b[k].like(1.0);
        b
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn solves_scaled_systems_and_refuses_singular_ones() {
        const N: usize = 5;
        let mut m = Symmetric([[0.0; N]; N]);
        for (k, v) in [4e6, 2.0, 3e-6, 1.0, 1.0].into_iter().enumerate() {
            m.0[k][k] = v;
        }
        (m.0[1][0], m.0[2][0], m.0[2][1]) = (1e3, 0.5, 1e-3);
        let x = [1.0, -2.0, 3.0];
        let full = |i: usize, j: usize| m.0[i.max(j)][i.min(j)];
        let mut b = [0.0; N];
        (0..3).for_each(|i| b[i] = (0..3).map(|j| full(i, j) * x[j]).sum());
        let factor = m.factor(0.0);
        let (right, mut white, mut first) = (b, b, b);
        factor.solve(&mut b);
        factor.solve_first::<3>(&mut first);
        for i in 0..3 {
            assert!((b[i] - x[i]).abs() < 1e-9, "{b:?}");
            assert!((first[i] - x[i]).abs() < 1e-9, "{first:?}");
        }
        factor.whiten(&mut white);
        let (square, direct): (f64, f64) =
            (white.iter().map(|v| v * v).sum(), (0..3).map(|i| right[i] * x[i]).sum());
        assert!((square / direct - 1.0).abs() < 1e-9);
        for k in 0..N {
            assert!((factor.variance(k) / factor.column(k)[k] - 1.0).abs() < 1e-9, "{k}");
        }
        (m.0[2][0], m.0[2][1]) = (2e3, 4.0);
        m.0[2][2] = 8.0;
        assert!(m.factor(0.0).soundness().is_nan());
        for bad in [0.0, -1.0, f64::NAN, f64::INFINITY] {
            let mut m = Symmetric([[1.0; 1]; 1]);
            m.0[0][0] = bad;
            assert!(m.factor(0.0).soundness().is_nan(), "{bad}");
        }
    }
}
