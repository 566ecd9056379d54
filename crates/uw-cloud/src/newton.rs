//! Damped Gauss–Newton for the few parameters of a shape.

use nalgebra::{SMatrix, SVector};

/// Half the gradient of a sum of squares, its Gauss–Newton matrix and the sum itself.
pub(crate) struct Normal<const P: usize> {
    /// Σ d².
    pub(crate) cost: f64,
    /// Σ (∂d/∂θ) d.
    pub(crate) gradient: SVector<f64, P>,
    /// Σ (∂d/∂θ)(∂d/∂θ)ᵀ.
    pub(crate) matrix: SMatrix<f64, P, P>,
}

impl<const P: usize> Normal<P> {
    /// Returns the sum over nothing.
    pub(crate) fn zero() -> Self {
        Self { cost: 0.0, gradient: SVector::zeros(), matrix: SMatrix::zeros() }
    }
}

/// Iterations after which a fit is given up.
pub(crate) const MAX_ITERATIONS: usize = 200;

/// A step that lowers the cost by less than this share of it is the last: it is a thousandth of a sigma with
/// 10 000 points, and well above the rounding of the sum.
const COST_TOLERANCE: f64 = 1e-10;

/// Share of a parameter's own information that the others must leave of it for a last step to be believed unseen: a parameter that nothing tells
/// may go far at no gain.
const DETERMINED: f64 = 1e-6;

/// Damping above which no step that lowers the cost is left: rounding has been reached.
const MAX_DAMPING: f64 = 1e12;

/// Returns the parameters that minimise a sum of squares, by Levenberg's damping of the Gauss–Newton step with
/// Marquardt's scaling; `None` where it does not come to rest or leaves the numbers. A cost of at most `negligible` is
/// rounding, and the end.
pub(crate) fn minimise<S, const P: usize>(
    start: S,
    negligible: f64,
    evaluate: impl Fn(&S) -> Normal<P>,
    moved: impl Fn(&S, &SVector<f64, P>) -> S,
) -> Option<S> {
    let mut at = start;
    let mut normal = evaluate(&at);
    let mut damping = 1e-4;
    for _ in 0..MAX_ITERATIONS {
        if !normal.cost.is_finite() {
            return None;
        }
        let mut damped = normal.matrix;
        for i in 0..P {
            damped[(i, i)] *= 1.0 + damping;
        }
        let factor = damped.cholesky();
        let told = factor.as_ref().is_some_and(|factor| {
            (0..P).all(|i| factor.l_dirty()[(i, i)].powi(2) > DETERMINED * damped[(i, i)])
        });
        let trial = factor.map(|factor| -factor.solve(&normal.gradient)).map(|step| {
            let predicted = -step.dot(&normal.gradient);
            (predicted, damping <= 10.0 && predicted <= COST_TOLERANCE * normal.cost, moved(&at, &step))
        });
        let trial = match trial {
            // So little is not worth a look, which may find nothing but rounding.
            Some((_, true, next)) if told => return Some(next),
            trial => trial.map(|(predicted, done, next)| (predicted, done, evaluate(&next), next)),
        };
        match trial {
            Some((_, true, next_normal, next)) => {
                return Some(if next_normal.cost <= normal.cost { next } else { at });
            }
            Some((predicted, _, next_normal, next)) if next_normal.cost <= normal.cost => {
                let gain = (normal.cost - next_normal.cost) / predicted;
                (at, normal) = (next, next_normal);
                // Curvature that Gauss and Newton leave out makes steps too long: then the gain is small.
                if gain > 0.75 {
                    damping = (damping / 10.0).max(1e-12);
                } else if gain < 0.25 {
                    damping *= 10.0;
                }
                if normal.cost <= negligible {
                    return Some(at);
                }
            }
            _ if damping > MAX_DAMPING => return Some(at),
            _ => damping *= 10.0,
        }
    }
    None
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rosenbrock_valley_is_walked_to_its_end() {
        // d = (10 (y − x²), 1 − x): the minimum is (1, 1), from the classic start (−1.2, 1).
        let evaluate = |at: &SVector<f64, 2>| {
            let d = [10.0 * (at[1] - at[0] * at[0]), 1.0 - at[0]];
            let rows = [SVector::<f64, 2>::new(-20.0 * at[0], 10.0), SVector::<f64, 2>::new(-1.0, 0.0)];
            let mut normal = Normal::zero();
            for (d, row) in d.iter().zip(rows) {
                normal.cost += d * d;
                normal.gradient += row * *d;
                normal.matrix += row * row.transpose();
            }
            normal
        };
        let found = minimise(SVector::<f64, 2>::new(-1.2, 1.0), 0.0, evaluate, |at, step| at + step);
        let found = found.expect("a minimum");
        assert!((found - SVector::<f64, 2>::new(1.0, 1.0)).norm() < 1e-9, "got {found}");
    }

    #[test]
    fn a_cost_that_is_no_number_gives_nothing() {
        let evaluate = |_: &f64| Normal::<1> { cost: f64::NAN, ..Normal::zero() };
        assert!(minimise(0.0, 0.0, evaluate, |at, step| at + step[0]).is_none());
    }
}
