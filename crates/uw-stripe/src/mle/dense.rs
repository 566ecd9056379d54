//! Normal equations of a handful of parameters, without allocation.

#![allow(clippy::needless_range_loop, reason = "indices read as in the formulas")]

/// Most parameters.
pub(crate) const MOST: usize = 11;

/// A symmetric matrix of [`MOST`] rows, of which the lower triangle is kept.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Symmetric(pub [[f64; MOST]; MOST]);

/// Cholesky factor of a matrix scaled to a unit diagonal, since flux and background differ by decades.
#[derive(Debug)]
pub(crate) struct Factor {
    /// Below the diagonal, and the reciprocal of the diagonal.
    lower: [[f64; MOST]; MOST],
    pivot: [f64; MOST],
    scale: [f64; MOST],
    size: usize,
}

/// Evaluates the expression with `$n` a constant: `$size`, one of 5, 7, 9 and [`MOST`]. Loops of known length are several
/// times as fast.
macro_rules! by_size {
    ($size:expr, $n:ident => $body:expr) => {
        match $size {
            5 => {
                const $n: usize = 5;
                $body
            }
            7 => {
                const $n: usize = 7;
                $body
            }
            9 => {
                const $n: usize = 9;
                $body
            }
            _ => {
                const $n: usize = MOST;
                $body
            }
        }
    };
}
pub(super) use by_size;

impl Symmetric {
    pub fn diagonal(values: &[f64; MOST]) -> Self {
        let mut m = Self([[0.0; MOST]; MOST]);
        values.iter().enumerate().for_each(|(k, v)| m.0[k][k] = *v);
        m
    }

    /// The factor of the first `size` rows and columns with `damping` added to the scaled diagonal; `None` where the matrix is
    /// not positive definite to rounding.
    pub fn factor(&self, size: usize, damping: f64) -> Option<Factor> {
        by_size!(size, N => self.factored::<N>(damping))
    }

    fn factored<const N: usize>(&self, damping: f64) -> Option<Factor> {
        /// Pivot of the scaled matrix below which a parameter is not told from the others.
        const SINGULAR: f64 = 1e-12;
        let mut scale = [0.0; MOST];
        for k in 0..N {
            scale[k] = self.0[k][k].sqrt().recip();
            if !(scale[k].is_finite() && scale[k] > 0.0) {
                return None;
            }
        }
        let mut lower = [[0.0; MOST]; MOST];
        let mut pivot = [0.0; MOST];
        for i in 0..N {
            for j in 0..i {
                let mut sum = self.0[i][j] * scale[i] * scale[j];
                for k in 0..j {
                    sum -= lower[i][k] * lower[j][k];
                }
                lower[i][j] = sum * pivot[j];
            }
            let rest = 1.0 + damping - lower[i][..i].iter().map(|v: &f64| v * v).sum::<f64>();
            if rest.is_nan() || rest < SINGULAR {
                return None;
            }
            pivot[i] = rest.sqrt().recip();
        }
        Some(Factor { lower, pivot, scale, size: N })
    }
}

impl Factor {
    /// The solution of the scaled system for the right side `b`, in place.
    pub fn solve(&self, b: &mut [f64; MOST]) {
        by_size!(self.size, N => {
            self.whitened::<N>(b);
            for i in (0..N).rev() {
                b[i] *= self.pivot[i];
                for k in 0..i {
                    b[k] -= self.lower[i][k] * b[i];
                }
                b[i] *= self.scale[i];
            }
        });
    }

    /// L⁻¹ b: the squares of its entries sum to bᵀ M⁻¹ b.
    pub fn whiten(&self, b: &mut [f64; MOST]) {
        by_size!(self.size, N => self.whitened::<N>(b));
    }

    fn whitened<const N: usize>(&self, b: &mut [f64; MOST]) {
        for i in 0..N {
            b[i] *= self.scale[i];
            for k in 0..i {
                b[i] -= self.lower[i][k] * b[k];
            }
            b[i] *= self.pivot[i];
        }
    }

    /// Column `k` of the inverse.
    pub fn column(&self, k: usize) -> [f64; MOST] {
        let mut b = [0.0; MOST];
        b[k] = 1.0;
        self.solve(&mut b);
        b
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn solves_scaled_systems_and_refuses_singular_ones() {
        let mut m = Symmetric::diagonal(&[4e6, 2.0, 3e-6, 1.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]);
        (m.0[1][0], m.0[2][0], m.0[2][1]) = (1e3, 0.5, 1e-3);
        let x = [1.0, -2.0, 3.0];
        let full = |i: usize, j: usize| m.0[i.max(j)][i.min(j)];
        let mut b = [0.0; MOST];
        (0..3).for_each(|i| b[i] = (0..3).map(|j| full(i, j) * x[j]).sum());
        let factor = m.factor(5, 0.0).unwrap();
        let (right, mut white) = (b, b);
        factor.solve(&mut b);
        for i in 0..3 {
            assert!((b[i] - x[i]).abs() < 1e-9, "{b:?}");
        }
        factor.whiten(&mut white);
        let (square, direct): (f64, f64) =
            (white.iter().map(|v| v * v).sum(), (0..3).map(|i| right[i] * x[i]).sum());
        assert!((square / direct - 1.0).abs() < 1e-9);
        (m.0[2][0], m.0[2][1]) = (2e3, 4.0);
        m.0[2][2] = 8.0;
        assert!(m.factor(5, 0.0).is_none());
    }
}
