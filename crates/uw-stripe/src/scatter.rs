//! How far the centres along a stripe scatter beyond what each predicts of itself: what speckle does, whose grains the lens spreads over
//! several pixels, so that residuals hardly show it.

use crate::verdict::run_reach;

/// Lines between the members of a difference: the grains' extent along the stripe drops out.
pub(crate) const SPACING: usize = 2;
/// Squares of the third difference's coefficients 1, −3, 3, −1, in which slope and curvature of the surface drop out.
pub(crate) const WEIGHTS: [f64; 4] = [1.0, 9.0, 9.0, 1.0];
/// Share of the differences that the scatter is read at, and that quantile of |N(0, 1)|: high enough to see heavy tails, below the few that
/// are another surface.
pub(crate) const SHARE: f64 = 0.8;
pub(crate) const SHARE_NORMAL: f64 = 1.2816;
/// Differences below which the scatter is not known.
pub(crate) const LEAST: usize = 20;
/// Halvings of the interval [0, 1] widths.
const HALVINGS: usize = 20;

/// Ratio of the quantile to what is predicted from which the excess is more than chance, for `count` differences: two sigmas of it, which is
/// 0.89 / √n for n independent ones; four share a centre.
pub(crate) fn significant(count: usize) -> f64 {
    1.0 + 2.0 * 0.89 * (2.0 / count as f64).sqrt()
}

/// A centre, its predicted sigma and the stripe's width there, px.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Centre {
    pub position: f64,
    pub sigma: f64,
    pub width: f64,
}

/// Reused memory: differences' squares, their predicted variances, and the sums of widths' squares that go with them.
#[derive(Debug, Default)]
pub(crate) struct Scatter {
    centres: Vec<Centre>,
    squares: Vec<f64>,
    variances: Vec<f64>,
    widths: Vec<f64>,
}

impl Scatter {
    /// The scatter, in widths, of the centres of successive lines beyond their sigmas, `None` where a line has no centre fit to tell: 0
    /// where chance explains it.
    pub fn of(&mut self, centres: impl Iterator<Item = Option<Centre>>) -> f64 {
        const ALL: usize = 3 * SPACING + 1;
        let Self { centres: run, squares, variances, widths } = self;
        run.clear();
        [&mut *squares, variances, widths].into_iter().for_each(Vec::clear);
        let reach = SPACING as f64 * f64::from(run_reach(0.0));
        for centre in centres {
            let Some(centre) = centre else {
                run.clear();
                continue;
            };
            run.push(centre);
            // Those between have a say, too: whether it is one surface.
            let Some(near) = run.last_chunk::<ALL>() else { continue };
            let [a, b, c, d] = std::array::from_fn(|k| near[k * SPACING]);
            let four = [a, b, c, d];
            if four.windows(2).all(|p| (p[0].position - p[1].position).abs() < reach) {
                let difference = a.position - 3.0 * b.position + 3.0 * c.position - d.position;
                let sum = |value: fn(&Centre) -> f64| {
                    four.iter().zip(WEIGHTS).map(|(c, w)| w * value(c)).sum::<f64>()
                };
                squares.push(difference * difference);
                variances.push(sum(|c| c.sigma * c.sigma));
                widths.push(sum(|c| c.width * c.width));
            }
        }
        let count = squares.len();
        if count < LEAST || !self.is_more(0.0, significant(count)) {
            return 0.0;
        }
        let (mut low, mut high) = (0.0, 1.0);
        for _ in 0..HALVINGS {
            let middle = 0.5 * (low + high);
            if self.is_more(middle, 1.0) { low = middle } else { high = middle }
        }
        0.5 * (low + high)
    }

    /// Whether the quantile of the differences, by their sigmas with a scatter of `k` widths, is more than so many times that of a normal
    /// distribution: counted, not sorted.
    fn is_more(&self, k: f64, times: f64) -> bool {
        let Self { squares, variances, widths, .. } = self;
        let (limit, by_width) = ((times * SHARE_NORMAL).powi(2), k * k);
        let mut beyond = 0_u64;
        for ((square, variance), width) in squares.iter().zip(variances).zip(widths) {
            beyond += u64::from(*square > limit * (variance + by_width * width));
        }
        let at = ((SHARE * squares.len() as f64) as usize).min(squares.len() - 1);
        beyond as usize >= squares.len() - at
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{SeedableRng, rngs::StdRng};
    use rand_distr::{Distribution, StandardNormal};

    #[test]
    fn what_was_added_is_found_and_nothing_where_nothing_was() {
        /// Relative sigma of a quantile of 500 differences, each centre in four, twice.
        const WITHIN: f64 = 0.12;
        for added in [0.0, 0.1, 0.3] {
            let mut rng = StdRng::seed_from_u64(7);
            let mut normal = || -> f64 { StandardNormal.sample(&mut rng) };
            let centres = (0..600).map(|i| {
                let position = 90.0 + 0.4 * f64::from(i) + 5.0 * (f64::from(i) / 50.0).sin();
                let position = position + 0.05 * normal() + added * 2.0 * normal();
                (i % 97 != 0).then_some(Centre { position, sigma: 0.05, width: 2.0 })
            });
            let found = Scatter::default().of(centres);
            assert!((found - added).abs() <= WITHIN * added, "{added}: {found}");
        }
        assert!(Scatter::default().of([None; 3].into_iter()).abs() < f64::EPSILON);
    }
}
