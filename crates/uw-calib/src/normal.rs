//! Normal equations of a least-squares problem whose residuals touch shared parameters and at most one pose
//! each.
//!
//! With globals g (the instrument) and pose blocks pᵢ of six, the matrix is an arrow: `H_gg` dense, `H_pp`
//! block-diagonal, `H_gp` between them. Eliminating the poses leaves the Schur complement S = `H_gg` − Σᵢ
//! `H_gpᵢ` `H_ppᵢ`⁻¹ `H_gpᵢ`ᵀ, of the size of the globals (Triggs et al., "Bundle adjustment: a modern
//! synthesis", 2000, §6.1), so that a solve is linear in the number of poses.

use nalgebra::{DMatrix, DVector, Matrix6, Matrix6xX, Vector6};
use rayon::prelude::*;

/// Into how many parts a parallel sum is cut. Fixed, so that the order of summation (hence every bit of the
/// result) does not depend on the number of threads.
const PARTS: usize = 32;

/// Number of unknowns: shared parameters, and poses of six each.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Shape {
    /// Shared parameters.
    pub globals: usize,
    /// Blocks of six parameters that share no residual with each other.
    pub poses: usize,
}

/// One unknown, as errors name it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Unknown {
    /// Index into the globals.
    Global(usize),
    /// Index of the pose.
    Pose(usize),
}

impl std::fmt::Display for Unknown {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Global(index) => write!(f, "global parameter {index}"),
            Self::Pose(index) => write!(f, "pose {index}"),
        }
    }
}

/// Loss ρ(s) of a squared, whitened residual norm s; thresholds are in sigmas.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Loss {
    /// ρ(s) = s.
    Squared,
    /// Huber: quadratic up to the threshold k, linear beyond: ρ(s) = 2k√s − k².
    Huber(f64),
    /// Cauchy: ρ(s) = c² ln(1 + s/c²).
    Cauchy(f64),
}

impl Loss {
    /// Returns ρ(s) and the weight ρ′(s) with which the residual enters the normal equations (iteratively
    /// reweighted least squares).
    #[must_use]
    pub fn evaluate(self, squared: f64) -> (f64, f64) {
        match self {
            Self::Huber(k) if squared > k * k => {
                let norm = squared.sqrt();
                (2.0 * k * norm - k * k, k / norm)
            }
            Self::Squared | Self::Huber(_) => (squared, 1.0),
            Self::Cauchy(c) => {
                let c2 = c * c;
                (c2 * (squared / c2).ln_1p(), c2 / (c2 + squared))
            }
        }
    }
}

/// One whitened residual (in sigmas) and its derivatives by the globals and by the pose's local parameters.
#[derive(Debug, Clone, Copy)]
pub struct Row<'a> {
    /// Residual over its standard deviation.
    pub residual: f64,
    /// Derivative of the whitened residual by each global parameter.
    pub d_globals: &'a [f64],
    /// Derivative of the whitened residual by the six parameters of its pose; ignored for rows without one.
    pub d_pose: [f64; 6],
}

/// Sums JᵀWJ, JᵀWr and Σρ over residuals.
#[derive(Debug, Clone)]
pub struct Normal {
    pub(crate) shape: Shape,
    /// Upper triangle only.
    pub(crate) h_gg: DMatrix<f64>,
    /// `H_gp`ᵀ of each pose, 6 × globals.
    pub(crate) h_gp: Vec<Matrix6xX<f64>>,
    pub(crate) h_pp: Vec<Matrix6<f64>>,
    pub(crate) g_g: DVector<f64>,
    pub(crate) g_p: Vec<Vector6<f64>>,
    cost: f64,
    rows: usize,
}

/// A change of all unknowns, in the caller's local parameters.
#[derive(Debug, Clone)]
pub struct Step {
    /// Change of each global parameter.
    pub globals: DVector<f64>,
    /// Change of each pose.
    pub poses: Vec<Vector6<f64>>,
}

impl Normal {
    /// Returns empty sums.
    #[must_use]
    pub fn new(shape: Shape) -> Self {
        let Shape { globals, poses } = shape;
        Self {
            shape,
            h_gg: DMatrix::zeros(globals, globals),
            h_gp: vec![Matrix6xX::zeros(globals); poses],
            h_pp: vec![Matrix6::zeros(); poses],
            g_g: DVector::zeros(globals),
            g_p: vec![Vector6::zeros(); poses],
            cost: 0.0,
            rows: 0,
        }
    }

    /// Returns the sums over all items, computed in parallel, the same to the last bit for any number of
    /// threads; `None` as soon as one item returns `None` (it lies outside the model's domain).
    pub fn accumulate<T: Sync>(
        shape: Shape,
        items: &[T],
        add: impl Fn(&T, &mut Self) -> Option<()> + Sync,
    ) -> Option<Self> {
        let length = items.len().div_ceil(PARTS).max(1);
        let parts: Option<Vec<Self>> = items
            .par_chunks(length)
            .map(|chunk| {
                let mut part = Self::new(shape);
                chunk.iter().try_for_each(|item| add(item, &mut part))?;
                Some(part)
            })
            .collect();
        let mut total = Self::new(shape);
        for part in parts? {
            total.merge(&part);
        }
        Some(total)
    }

    /// Adds one residual block: its rows share one robust weight, from the norm of all of them, and at most
    /// one pose.
    ///
    /// # Panics
    /// When a row's `d_globals` has not `shape.globals` entries or the pose is none of `shape.poses`.
    pub fn add(&mut self, rows: &[Row<'_>], pose: Option<usize>, loss: Loss) {
        let squared = rows.iter().map(|row| row.residual * row.residual).sum();
        let (cost, weight) = loss.evaluate(squared);
        self.cost += cost;
        self.rows += rows.len();
        let n = self.shape.globals;
        for row in rows {
            assert_eq!(row.d_globals.len(), n, "one derivative a global");
            for (j, (column, &d)) in
                self.h_gg.as_mut_slice().chunks_exact_mut(n.max(1)).zip(row.d_globals).enumerate()
            {
                let d = weight * d;
                if d != 0.0 {
                    column[..=j].iter_mut().zip(row.d_globals).for_each(|(h, &e)| *h += d * e);
                    self.g_g[j] += d * row.residual;
                }
            }
            let Some(pose) = pose else { continue };
            let d_pose = Vector6::from(row.d_pose);
            let weighted = weight * d_pose;
            for (mut column, &d) in self.h_gp[pose].column_iter_mut().zip(row.d_globals) {
                column += weighted * d;
            }
            self.h_pp[pose] += weighted * d_pose.transpose();
            self.g_p[pose] += weighted * row.residual;
        }
    }

    fn merge(&mut self, other: &Self) {
        self.h_gg += &other.h_gg;
        self.g_g += &other.g_g;
        for pose in 0..self.shape.poses {
            self.h_gp[pose] += &other.h_gp[pose];
            self.h_pp[pose] += other.h_pp[pose];
            self.g_p[pose] += other.g_p[pose];
        }
        self.cost += other.cost;
        self.rows += other.rows;
    }

    /// Returns Σρ, which for the squared loss is chi².
    #[must_use]
    pub fn cost(&self) -> f64 {
        self.cost
    }

    /// Returns the number of scalar residuals, priors included.
    #[must_use]
    pub fn rows(&self) -> usize {
        self.rows
    }

    /// Returns the number of unknowns.
    #[must_use]
    pub fn shape(&self) -> Shape {
        self.shape
    }

    /// Returns the whole matrix JᵀWJ and the vector JᵀWr with nothing eliminated: globals first, then six rows a pose. For
    /// checks and comparisons: a solve of it costs the cube of the number of poses.
    #[must_use]
    pub fn dense(&self) -> (DMatrix<f64>, DVector<f64>) {
        let Shape { globals, poses } = self.shape;
        let size = globals + 6 * poses;
        let mut h = DMatrix::zeros(size, size);
        let mut g = DVector::zeros(size);
        h.view_mut((0, 0), (globals, globals)).copy_from(&self.h_gg);
        g.rows_mut(0, globals).copy_from(&self.g_g);
        for pose in 0..poses {
            let at = globals + 6 * pose;
            h.view_mut((0, at), (globals, 6)).copy_from(&self.h_gp[pose].transpose());
            h.fixed_view_mut::<6, 6>(at, at).copy_from(&self.h_pp[pose]);
            g.rows_mut(at, 6).copy_from(&self.g_p[pose]);
        }
        h.fill_lower_triangle_with_upper_triangle();
        (h, g)
    }

    pub(crate) fn is_finite(&self) -> bool {
        self.cost.is_finite()
            && self.h_gg.iter().chain(self.g_g.iter()).all(|x| x.is_finite())
            && self.h_pp.iter().all(|h| h.iter().all(|x| x.is_finite()))
            && self.g_p.iter().all(|g| g.iter().all(|x| x.is_finite()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn losses_meet_at_their_threshold_and_weights_are_their_slopes() {
        for loss in [Loss::Squared, Loss::Huber(1.3), Loss::Cauchy(2.0)] {
            for s in [0.01, 1.0, 1.68, 1.70, 9.0, 400.0_f64] {
                let h = 1e-6 * s;
                let slope = (loss.evaluate(s + h).0 - loss.evaluate(s - h).0) / (2.0 * h);
                assert!((slope - loss.evaluate(s).1).abs() < 1e-5, "{loss:?} at {s}");
            }
        }
    }
}
