//! Solution and covariance of [`Normal`] by elimination of the poses.

use crate::lm::LmError;
use crate::normal::{Normal, Step, Unknown};
use nalgebra::{DMatrix, DVector, Matrix6, Matrix6xX, MatrixXx6, Vector6};

/// Below this share of its own diagonal a pivot is rounding noise: the parameter follows from the others. A
/// pivot over its diagonal is 1 − R² of the parameter against those before it, so the test has no unit;
/// rounding leaves about n ε ≈ 1e-14 for the hundred parameters at most that this meets.
const PIVOT_SHARE: f64 = 1e-13;

/// A damped step and the decrease of Σρ that the quadratic model promises for it.
#[derive(Debug, Clone)]
pub struct Proposal {
    /// The step.
    pub step: Step,
    /// By how much Σρ falls if the problem is as quadratic as its normal equations.
    pub decrease: f64,
}

impl Normal {
    /// Returns the step δ of (H + λ diag H) δ = −g, by elimination of the poses.
    ///
    /// # Errors
    /// [`LmError::Singular`] when a parameter is not determined by the residuals and priors.
    pub fn solve(&self, lambda: f64) -> Result<Proposal, LmError> {
        let schur = self.eliminate(lambda)?;
        let mut rhs = -&self.g_g;
        for (block, g) in schur.blocks.iter().zip(&self.g_p) {
            rhs += block.weights.tr_mul(g);
        }
        let globals = schur.solve(&rhs);
        let poses: Vec<Vector6<f64>> = schur
            .blocks
            .iter()
            .zip(&self.g_p)
            .map(|(block, g)| -block.inverse * g - &block.weights * &globals)
            .collect();

        // For chi²: decrease = −2 gᵀδ − δᵀHδ = −gᵀδ + λ δᵀ diag(H) δ, since (H + λ diag H) δ = −g.
        let damped = |diagonal: f64, d: f64, g: f64| d * (lambda * diagonal * d - g);
        let mut decrease: f64 =
            (0..globals.len()).map(|i| damped(self.h_gg[(i, i)], globals[i], self.g_g[i])).sum();
        for ((h, g), d) in self.h_pp.iter().zip(&self.g_p).zip(&poses) {
            decrease += (0..6).map(|i| damped(h[(i, i)], d[i], g[i])).sum::<f64>();
        }
        Ok(Proposal { step: Step { globals, poses }, decrease })
    }

    /// Returns the covariance of all unknowns, (JᵀWJ)⁻¹ without damping; with whitened residuals it needs no
    /// further scale.
    ///
    /// # Errors
    /// [`LmError::Singular`] when a parameter is not determined by the residuals and priors.
    pub fn covariance(&self) -> Result<Covariance, LmError> {
        let schur = self.eliminate(0.0)?;
        let n = self.shape.globals;
        let mut globals = DMatrix::identity(n, n);
        for mut column in globals.column_iter_mut() {
            let solved = schur.solve(&column.clone_owned());
            column.copy_from(&solved);
        }
        globals = (&globals + globals.transpose()) * 0.5;
        let (poses, cross) = schur
            .blocks
            .iter()
            .map(|block| {
                let cross = -(&block.weights * &globals);
                (block.inverse - &cross * block.weights.transpose(), cross.transpose())
            })
            .unzip();
        Ok(Covariance { globals, poses, cross })
    }

    fn eliminate(&self, lambda: f64) -> Result<Schur, LmError> {
        let damping = 1.0 + lambda;
        let mut s = self.h_gg.clone();
        let mut diagonal = self.h_gg.diagonal();
        diagonal *= damping;
        s.set_diagonal(&diagonal);
        s.fill_lower_triangle_with_upper_triangle();
        let mut blocks = Vec::with_capacity(self.shape.poses);
        for (index, (h_pp, h_gp)) in self.h_pp.iter().zip(&self.h_gp).enumerate() {
            let mut h = *h_pp;
            h.set_diagonal(&(h_pp.diagonal() * damping));
            let singular = |share| LmError::Singular { unknown: Unknown::Pose(index), share };
            let cholesky = h.cholesky().ok_or(singular(0.0))?;
            let share =
                (0..6).map(|i| cholesky.l_dirty()[(i, i)].powi(2) / h[(i, i)]).fold(f64::INFINITY, f64::min);
            if share.is_nan() || share < PIVOT_SHARE {
                return Err(singular(share));
            }
            let inverse = cholesky.inverse();
            let weights = inverse * h_gp;
            s -= h_gp.tr_mul(&weights);
            blocks.push(Block { inverse, weights });
        }
        factor(&mut s, &diagonal)?;
        Ok(Schur { lower: s, blocks })
    }
}

/// One eliminated pose: `H_pp`⁻¹ and `H_pp`⁻¹ `H_gp`ᵀ (6 × globals).
struct Block {
    inverse: Matrix6<f64>,
    weights: Matrix6xX<f64>,
}

struct Schur {
    lower: DMatrix<f64>,
    blocks: Vec<Block>,
}

impl Schur {
    /// Solves S x = b; the factor's pivots were checked when it was made.
    fn solve(&self, b: &DVector<f64>) -> DVector<f64> {
        let mut x = b.clone();
        self.lower.solve_lower_triangular_mut(&mut x);
        self.lower.tr_solve_lower_triangular_mut(&mut x);
        x
    }
}

/// Factors s = L Lᵀ in place (lower triangle), naming the parameter whose pivot vanishes against its
/// `diagonal` before elimination.
fn factor(s: &mut DMatrix<f64>, diagonal: &DVector<f64>) -> Result<(), LmError> {
    for j in 0..s.nrows() {
        let pivot = s[(j, j)] - (0..j).map(|k| s[(j, k)] * s[(j, k)]).sum::<f64>();
        let share = pivot / diagonal[j];
        if share.is_nan() || share < PIVOT_SHARE {
            return Err(LmError::Singular { unknown: Unknown::Global(j), share });
        }
        let root = pivot.sqrt();
        s[(j, j)] = root;
        for i in j + 1..s.nrows() {
            let inner: f64 = (0..j).map(|k| s[(i, k)] * s[(j, k)]).sum();
            s[(i, j)] = (s[(i, j)] - inner) / root;
        }
    }
    Ok(())
}

/// Covariance of globals and poses, in the caller's local parameters.
#[derive(Debug, Clone)]
pub struct Covariance {
    /// Of the globals, poses marginalised: globals × globals.
    pub globals: DMatrix<f64>,
    /// Of each pose, everything else marginalised: 6 × 6.
    pub poses: Vec<Matrix6<f64>>,
    /// Between the globals (rows) and each pose (columns): globals × 6.
    pub cross: Vec<MatrixXx6<f64>>,
}

impl Covariance {
    /// Returns the standard deviation of a global parameter, in its own unit.
    ///
    /// # Panics
    /// When `index` is not a global's.
    #[must_use]
    pub fn sigma(&self, index: usize) -> f64 {
        self.globals[(index, index)].max(0.0).sqrt()
    }

    /// Returns the correlation of two global parameters, −1 to 1.
    ///
    /// # Panics
    /// When an index is not a global's.
    #[must_use]
    pub fn correlation(&self, a: usize, b: usize) -> f64 {
        self.globals[(a, b)] / (self.sigma(a) * self.sigma(b))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::normal::{Loss, Row, Shape};

    /// Elimination against a dense solve, relative: both lose about the condition number times ε.
    const DENSE_RELATIVE: f64 = 1e-10;

    /// A repeatable sequence without a generator: fractional parts of multiples of the golden ratio, in ±1.
    fn value(k: usize) -> f64 {
        (k as f64 * 0.618_033_988_749_895 + 0.1).fract() * 2.0 - 1.0
    }

    struct Item {
        pose: usize,
        seed: usize,
    }

    const SHAPE: Shape = Shape { globals: 5, poses: 7 };

    fn items() -> Vec<Item> {
        (0..SHAPE.poses * 40).map(|k| Item { pose: k % SHAPE.poses, seed: 1000 + 31 * k }).collect()
    }

    fn example(loss: Loss) -> Normal {
        let mut normal = Normal::accumulate(SHAPE, &items(), |item, normal| {
            let d = |k: usize| value(item.seed * 13 + k * k + 7 * k);
            let rows: Vec<([f64; 5], [f64; 6])> = (0..2)
                .map(|r| {
                    (
                        std::array::from_fn(|i| d(20 * r + i)),
                        std::array::from_fn(|i| d(20 * r + 5 + i) * 30.0),
                    )
                })
                .collect();
            let rows: Vec<Row<'_>> = rows
                .iter()
                .enumerate()
                .map(|(r, (g, p))| Row { residual: 3.0 * d(50 + r), d_globals: g, d_pose: *p })
                .collect();
            normal.add(&rows, Some(item.pose), loss);
            Some(())
        })
        .unwrap();
        // A prior is a row without a pose.
        let d_globals = [0.0, 0.0, 0.0, 100.0, 0.0];
        normal.add(&[Row { residual: 20.0, d_globals: &d_globals, d_pose: [0.0; 6] }], None, Loss::Squared);
        normal
    }

    #[test]
    fn elimination_equals_the_dense_solve() {
        for lambda in [0.0, 1e-3, 10.0] {
            let normal = example(Loss::Huber(1.5));
            let (h, g) = normal.dense();
            let mut damped = h.clone();
            for i in 0..h.nrows() {
                damped[(i, i)] *= 1.0 + lambda;
            }
            let expected = -(damped.lu().solve(&g).unwrap());
            let got = normal.solve(lambda).unwrap();
            let mut step = got.step.globals.as_slice().to_vec();
            step.extend(got.step.poses.iter().flat_map(|p| p.iter().copied()));
            let step = DVector::from_vec(step);
            assert!((&step - &expected).norm() <= DENSE_RELATIVE * expected.norm());
            let decrease = -2.0 * g.dot(&step) - step.dot(&(&h * &step));
            assert!((got.decrease - decrease).abs() <= DENSE_RELATIVE * decrease);
        }
    }

    #[test]
    fn covariance_equals_the_dense_inverse() {
        let normal = example(Loss::Squared);
        let inverse = normal.dense().0.try_inverse().unwrap();
        let covariance = normal.covariance().unwrap();
        let close = |a: &DMatrix<f64>, b: &DMatrix<f64>| (a - b).norm() <= DENSE_RELATIVE * b.norm();
        assert!(close(&covariance.globals, &inverse.view((0, 0), (5, 5)).into_owned()));
        for pose in 0..SHAPE.poses {
            let at = 5 + 6 * pose;
            let block = DMatrix::from_column_slice(6, 6, covariance.poses[pose].as_slice());
            assert!(close(&block, &inverse.view((at, at), (6, 6)).into_owned()));
            let cross = DMatrix::from_column_slice(5, 6, covariance.cross[pose].as_slice());
            assert!(close(&cross, &inverse.view((0, at), (5, 6)).into_owned()));
        }
        assert!((covariance.sigma(3) - inverse[(3, 3)].sqrt()).abs() < 1e-12);
        assert!(covariance.correlation(2, 2) > 1.0 - 1e-12);
    }

    #[test]
    fn sums_do_not_depend_on_the_number_of_threads() {
        let on = |threads| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            let (h, g) = pool.install(|| example(Loss::Cauchy(2.0))).dense();
            h.iter().chain(g.iter()).map(|x| x.to_bits()).collect::<Vec<_>>()
        };
        assert_eq!(on(1), on(3));
    }

    #[test]
    fn undetermined_unknowns_are_named() {
        let mut normal = Normal::new(Shape { globals: 3, poses: 1 });
        for k in 0..60 {
            // The third global always acts as twice the first.
            let g = [value(3 * k), value(3 * k + 1), 2.0 * value(3 * k)];
            let d_pose = std::array::from_fn(|i| value(7 * k * k + i));
            normal.add(&[Row { residual: 1.0, d_globals: &g, d_pose }], Some(0), Loss::Squared);
        }
        let Err(LmError::Singular { unknown, share }) = normal.covariance() else { panic!("determined") };
        assert_eq!(unknown, Unknown::Global(2));
        assert!(share.abs() < PIVOT_SHARE);

        let mut normal = Normal::new(Shape { globals: 1, poses: 2 });
        for k in 0..20 {
            let d_pose = std::array::from_fn(|i| value(7 * k * k + i));
            normal.add(&[Row { residual: 1.0, d_globals: &[1.0], d_pose }], Some(0), Loss::Squared);
        }
        assert!(
            matches!(normal.covariance(), Err(LmError::Singular { unknown: Unknown::Pose(1), .. })),
            "a pose without residuals"
        );
    }
}
