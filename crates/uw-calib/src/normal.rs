//! Normal equations of a least-squares problem whose residuals touch shared parameters and at most one pose each.
//!
//! With globals g (the instrument) and pose blocks pᵢ of six, the matrix is an arrow: `H_gg` dense, `H_pp`
//! block-diagonal, `H_gp` between them. Eliminating the poses leaves the Schur complement
//! S = `H_gg` − Σᵢ `H_gpᵢ` `H_ppᵢ`⁻¹ `H_gpᵢ`ᵀ, of the size of the globals (Triggs et al., "Bundle adjustment: a modern
//! synthesis", 2000, §6.1), so that a solve is linear in the number of poses.

use nalgebra::{DMatrix, DVector, Matrix6, Matrix6xX, MatrixXx6, Vector6};
use rayon::prelude::*;

use crate::lm::LmError;

/// Below this share of its own diagonal a pivot is rounding noise: the parameter follows from the others. A pivot over
/// its diagonal is 1 − R² of the parameter against those before it, so the test has no unit; rounding leaves
/// about n ε ≈ 1e-14 for the hundred parameters at most that this meets.
const PIVOT_SHARE: f64 = 1e-13;

/// Into how many parts a parallel sum is cut. Fixed, so that the order of summation (hence every bit of the result) does not
/// depend on the number of threads.
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
    /// Returns ρ(s) and the weight ρ′(s) with which the residual enters the normal equations (iteratively reweighted
    /// least squares).
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
    shape: Shape,
    /// Upper triangle only.
    h_gg: DMatrix<f64>,
    /// `H_gp`ᵀ of each pose, 6 × globals.
    h_gp: Vec<Matrix6xX<f64>>,
    h_pp: Vec<Matrix6<f64>>,
    g_g: DVector<f64>,
    g_p: Vec<Vector6<f64>>,
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

/// A damped step and the decrease of Σρ that the quadratic model promises for it.
#[derive(Debug, Clone)]
pub(crate) struct Proposal {
    pub step: Step,
    pub decrease: f64,
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

    /// Returns the sums over all items, computed in parallel, the same to the last bit for any number of threads; `None` as soon as
    /// one item returns `None` (it lies outside the model's domain).
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

    /// Adds one residual block: its rows share one robust weight, from the norm of all of them, and at most one pose.
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

    /// Adds the prior (value − expected) / sigma on one global parameter.
    ///
    /// # Panics
    /// When `index` is not below `shape.globals`.
    pub fn add_prior(&mut self, index: usize, deviation: f64, sigma: f64) {
        let residual = deviation / sigma;
        self.h_gg[(index, index)] += sigma.powi(-2);
        self.g_g[index] += residual / sigma;
        self.cost += residual * residual;
        self.rows += 1;
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

    pub(crate) fn is_finite(&self) -> bool {
        self.cost.is_finite()
            && self.h_gg.iter().chain(self.g_g.iter()).all(|x| x.is_finite())
            && self.h_pp.iter().all(|h| h.iter().all(|x| x.is_finite()))
            && self.g_p.iter().all(|g| g.iter().all(|x| x.is_finite()))
    }

    /// Solves (H + λ diag H) δ = −g by elimination of the poses.
    pub(crate) fn solve(&self, lambda: f64) -> Result<Proposal, LmError> {
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

    /// Returns the covariance of all unknowns, (JᵀWJ)⁻¹ without damping; with whitened residuals it needs no further scale.
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

/// Factors s = L Lᵀ in place (lower triangle), naming the parameter whose pivot vanishes against its `diagonal` before elimination.
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
        normal.add_prior(3, 0.2, 0.01);
        normal
    }

    fn dense(normal: &Normal) -> (DMatrix<f64>, DVector<f64>) {
        let Shape { globals, poses } = normal.shape;
        let size = globals + 6 * poses;
        let mut h = DMatrix::zeros(size, size);
        let mut g = DVector::zeros(size);
        h.view_mut((0, 0), (globals, globals)).copy_from(&normal.h_gg);
        g.rows_mut(0, globals).copy_from(&normal.g_g);
        for pose in 0..poses {
            let at = globals + 6 * pose;
            h.view_mut((0, at), (globals, 6)).copy_from(&normal.h_gp[pose].transpose());
            h.fixed_view_mut::<6, 6>(at, at).copy_from(&normal.h_pp[pose]);
            g.rows_mut(at, 6).copy_from(&normal.g_p[pose]);
        }
        h.fill_lower_triangle_with_upper_triangle();
        (h, g)
    }

    #[test]
    fn elimination_equals_the_dense_solve() {
        for lambda in [0.0, 1e-3, 10.0] {
            let normal = example(Loss::Huber(1.5));
            let (h, g) = dense(&normal);
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
        let inverse = dense(&normal).0.try_inverse().unwrap();
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
            let (h, g) = dense(&pool.install(|| example(Loss::Cauchy(2.0))));
            h.iter().chain(g.iter()).map(|x| x.to_bits()).collect::<Vec<_>>()
        };
        assert_eq!(on(1), on(3));
    }

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
