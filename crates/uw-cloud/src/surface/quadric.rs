//! A quadratic surface through a vertex's neighbours, each by its own variance.

use crate::robust::rejection_limit;
use nalgebra::{SMatrix, SVector};

/// A quadratic height over a plane: x², xy, y², x, y, 1. The constant comes last: what it is known by is then the last pivot.
const TERMS: usize = 6;
const CONSTANT: usize = TERMS - 1;

/// Neighbours beyond the terms from which on a fit says how well it holds.
const LEAST_SPARE: usize = 4;

/// Rounds of leaving out what does not belong to the vertex's face.
const ROUNDS: usize = 3;

/// A point over the tangent plane of the vertex, mm.
#[derive(Debug, Clone, Copy)]
pub(super) struct Neighbour {
    pub(super) along: [f64; 2],
    pub(super) height: f64,
    /// One over its height's variance, mm⁻².
    pub(super) weight: f64,
}

impl Neighbour {
    /// Its residual squared, in units of its variance.
    fn chi2(&self, solution: &[f64; TERMS]) -> f64 {
        let [x, y] = self.along;
        let [xx, xy, yy, of_x, of_y, constant] = solution;
        let residual = self.height - (x * (xx * x + xy * y + of_x) + y * (yy * y + of_y) + constant);
        residual * residual * self.weight
    }
}

/// Two sums side by side: in one of the processor's registers.
type Pair = [f64; 2];

fn times(pair: Pair, factor: f64) -> Pair {
    [pair[0] * factor, pair[1] * factor]
}

/// The normal equations of some neighbours: sums that a wider ring is only added to. Of the products of two terms many are the same.
///
/// In millimetres as they are: what Cholesky's decomposition rounds does not depend on the terms' units (N. Higham, Accuracy and Stability of Numerical Algorithms, 2002, theorem 10.6).
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Sums {
    x_y: Pair,
    xx_xy: Pair,
    yy_1: Pair,
    xxx_xxy: Pair,
    xyy_yyy: Pair,
    xxxx_xxxy: Pair,
    xxyy_xyyy: Pair,
    yyyy: f64,
    /// Times the height.
    right: [Pair; TERMS / 2],
}

impl Sums {
    pub(super) fn add(&mut self, neighbours: &[Neighbour]) {
        let mut all = *self;
        for Neighbour { along, height, weight } in neighbours {
            let [x, y] = *along;
            let x_y = times(*along, *weight);
            let xx_xy = times(x_y, x);
            let yy_1 = [x_y[1] * y, *weight];
            let xxx_xxy = times(xx_xy, x);
            let xyy_yyy = times(*along, yy_1[0]);
            let plus = |sum: &mut Pair, pair: Pair| {
                sum[0] += pair[0];
                sum[1] += pair[1];
            };
            plus(&mut all.x_y, x_y);
            plus(&mut all.xx_xy, xx_xy);
            plus(&mut all.yy_1, yy_1);
            plus(&mut all.xxx_xxy, xxx_xxy);
            plus(&mut all.xyy_yyy, xyy_yyy);
            plus(&mut all.xxxx_xxxy, times(xxx_xxy, x));
            plus(&mut all.xxyy_xyyy, times(xyy_yyy, x));
            all.yyyy += xyy_yyy[1] * y;
            plus(&mut all.right[0], times(xx_xy, *height));
            plus(&mut all.right[1], times(yy_1, *height));
            plus(&mut all.right[2], times(x_y, *height));
        }
        *self = all;
    }

    /// Returns the terms' factors and the constant's variance; `None` where they are not determined.
    fn solution(&self) -> Option<([f64; TERMS], f64)> {
        let ([x, y], [xx, xy], [yy, one]) = (self.x_y, self.xx_xy, self.yy_1);
        let ([xxx, xxy], [xyy, yyy]) = (self.xxx_xxy, self.xyy_yyy);
        let ([xxxx, xxxy], [xxyy, xyyy], yyyy) = (self.xxxx_xxxy, self.xxyy_xyyy, self.yyyy);
        #[rustfmt::skip]
        let matrix = SMatrix::<f64, TERMS, TERMS>::from([
            [xxxx, xxxy, xxyy, xxx, xxy, xx],
            [xxxy, xxyy, xyyy, xxy, xyy, xy],
            [xxyy, xyyy, yyyy, xyy, yyy, yy],
            [xxx, xxy, xyy, xx, xy, x],
            [xxy, xyy, yyy, xy, yy, y],
            [xx, xy, yy, x, y, one],
        ]);
        let decomposed = matrix.cholesky()?;
        let pivot = decomposed.l_dirty()[(CONSTANT, CONSTANT)];
        let [[of_xx, of_xy], [of_yy, of_one], [of_x, of_y]] = self.right;
        let solution = decomposed.solve(&SVector::from([of_xx, of_xy, of_yy, of_x, of_y, of_one]));
        Some((solution.into(), 1.0 / (pivot * pivot)))
    }
}

/// The surface at the vertex.
#[derive(Debug, Clone, Copy)]
pub(super) struct Quadric {
    /// Its height over the vertex along the normal, mm, and that height's variance, mm².
    pub(super) height: f64,
    pub(super) variance: f64,
    pub(super) chi2_by_dof: f64,
    pub(super) dof: f64,
}

impl Quadric {
    /// Returns the surface through neighbours, of which the vertex itself is the first and is never left out, with their sums; `None` where they do not determine it, or are
    /// too few to tell how well it holds.
    pub(super) fn through(neighbours: &[Neighbour], sums: &Sums) -> Option<Self> {
        Self::in_rounds(ROUNDS, neighbours, sums)
    }

    fn in_rounds(rounds: usize, neighbours: &[Neighbour], sums: &Sums) -> Option<Self> {
        if neighbours.len() < TERMS + LEAST_SPARE {
            return None;
        }
        let (solution, variance) = sums.solution()?;
        let chi2s = neighbours.iter().map(|neighbour| neighbour.chi2(&solution));
        let (chi2, worst) = chi2s.fold((0.0, 0.0_f64), |(sum, worst), chi2| {
            // A comparison rather than `max`: it is one of the processor's instructions.
            (sum + chi2, if chi2 > worst { chi2 } else { worst })
        });
        let dof = (neighbours.len() - TERMS) as f64;
        let limit = rejection_limit(neighbours.len()).powi(2) * (chi2 / dof).max(1.0);
        if rounds > 1 && worst > limit {
            let (own, others) = neighbours.split_at(1);
            let mut left = Vec::with_capacity(neighbours.len());
            left.extend_from_slice(own);
            left.extend(others.iter().filter(|neighbour| neighbour.chi2(&solution) <= limit));
            if left.len() < neighbours.len() {
                let mut sums = Sums::default();
                sums.add(&left);
                return Self::in_rounds(rounds - 1, &left, &sums);
            }
        }
        Some(Self { height: solution[CONSTANT], variance, chi2_by_dof: chi2 / dof, dof })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::robust::Random;
    use nalgebra::{DMatrix, DVector};

    /// Of sums over a hundred points.
    const ROUNDING: f64 = 1e-12;
    const HEIGHT_MM: f64 = 0.3;

    /// Points at random on a quadratic surface, the first at the vertex, of different weights.
    fn neighbours() -> Vec<Neighbour> {
        let mut random = Random::new(3);
        let mut drawn = |k: usize| {
            let along = if k == 0 { [0.0; 2] } else { [0; 2].map(|_| 6.0 * (random.share() - 0.5)) };
            let [x, y] = along;
            let height = HEIGHT_MM + 0.1 * x - 0.2 * y + 0.03 * x * x - 0.01 * x * y + 0.02 * y * y;
            Neighbour { along, height, weight: 100.0 * (0.5 + random.share()) }
        };
        (0..100).map(&mut drawn).collect()
    }

    /// By sums that are added in parts, as rings come.
    fn through(neighbours: &[Neighbour]) -> Quadric {
        let mut sums = Sums::default();
        neighbours.chunks(19).for_each(|ring| sums.add(ring));
        Quadric::through(neighbours, &sums).unwrap()
    }

    /// Height and its variance by least squares of rows.
    fn by_rows(neighbours: &[Neighbour]) -> (f64, f64) {
        let terms = |n: &Neighbour| {
            let [x, y] = n.along;
            [1.0, x, y, x * x, x * y, y * y].map(|term| term * n.weight.sqrt())
        };
        let rows: Vec<f64> = neighbours.iter().flat_map(terms).collect();
        let rows = DMatrix::from_row_slice(neighbours.len(), TERMS, &rows);
        let heights =
            DVector::from_iterator(neighbours.len(), neighbours.iter().map(|n| n.height * n.weight.sqrt()));
        let inverse = rows.clone().pseudo_inverse(1e-9).unwrap();
        ((&inverse * heights)[0], inverse.row(0).norm_squared())
    }

    #[test]
    fn a_quadratic_surface_is_found_as_well_as_its_variance() {
        let mut all = neighbours();
        let fit = through(&all);
        assert!((fit.height - HEIGHT_MM).abs() < ROUNDING, "{fit:?}");
        assert!(fit.chi2_by_dof < ROUNDING && (fit.dof - 94.0).abs() < ROUNDING);
        // Waves that no quadratic surface has, well within the sigmas.
        all.iter_mut().for_each(|n| n.height += 0.05 * (2.0 * n.along[0]).sin());
        let (fit, (height, variance)) = (through(&all), by_rows(&all));
        assert!((height - HEIGHT_MM).abs() > 1e-6, "the waves tell: {height}");
        assert!((fit.height - height).abs() < ROUNDING, "{fit:?} {height}");
        assert!((fit.variance / variance - 1.0).abs() < ROUNDING, "{fit:?} {variance}");
    }

    #[test]
    fn strays_are_left_out_and_the_vertex_never() {
        let mut all = neighbours();
        // One sigma is a tenth of a millimetre.
        [5, 40, 77].into_iter().for_each(|k| all[k].height += 8.0);
        let fit = through(&all);
        assert!((fit.height - HEIGHT_MM).abs() < ROUNDING && (fit.dof - 91.0).abs() < ROUNDING, "{fit:?}");
        let mut all = neighbours();
        all[0].height += 8.0;
        let (fit, (height, _)) = (through(&all), by_rows(&all));
        assert!((fit.height - height).abs() < ROUNDING && fit.height > HEIGHT_MM + 0.1, "{fit:?} {height}");
    }

    #[test]
    fn what_determines_no_surface_has_none() {
        let none = |neighbours: &[Neighbour]| {
            let mut sums = Sums::default();
            sums.add(neighbours);
            Quadric::through(neighbours, &sums).is_none()
        };
        let mut all = neighbours();
        assert!(none(&all[..TERMS + LEAST_SPARE - 1]) && !none(&all[..TERMS + LEAST_SPARE]));
        all.iter_mut().for_each(|n| n.along[1] = 0.0);
        assert!(none(&all), "on one line");
        all[3].weight = f64::NAN;
        assert!(none(&all));
    }
}
