//! How far the centres along a stripe scatter beyond what each predicts of itself: what speckle does, whose grains the lens spreads over
//! several pixels, so that residuals hardly show it.

use fearless_simd::{Level, Simd, dispatch};

use crate::verdict::run_reach;

/// Lines from a member of a difference to the next: the grains' extent along the stripe drops out.
pub(crate) const SPACING: usize = 2;
/// Squares of the third difference's coefficients ±1 and ±3, in which slope and curvature of the surface drop out.
const WEIGHTS: [f32; 2] = [1.0, 9.0];
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
    pub position: f32,
    pub sigma: f32,
    pub width: f32,
}

/// Reused memory.
#[derive(Debug, Default)]
pub(crate) struct Scatter {
    /// Of each line; NaN where it has no centre fit to tell.
    position: Vec<f32>,
    sigma: Vec<f32>,
    width: Vec<f32>,
    /// Each difference's square, its predicted variance, and the sum of the widths' squares that goes with it. A square is negative, and so never
    /// beyond, where there is no difference.
    squares: Vec<f32>,
    variances: Vec<f32>,
    widths: Vec<f32>,
    /// How many differences there are.
    count: usize,
}

impl Scatter {
    /// The scatter, in widths, of the centres of successive lines beyond their sigmas, `None` where a line has no centre fit to tell: 0
    /// where chance explains it.
    pub fn of(&mut self, level: Level, centres: impl Iterator<Item = Option<Centre>>) -> f64 {
        let Self { position, sigma, width, .. } = self;
        [&mut *position, sigma, width].into_iter().for_each(Vec::clear);
        for centre in centres {
            let Centre { position: p, sigma: s, width: w } =
                centre.unwrap_or(Centre { position: f32::NAN, sigma: 0.0, width: 0.0 });
            position.push(p);
            sigma.push(s);
            width.push(w);
        }
        f64::from(dispatch!(level, simd => self.of_lines(simd)))
    }

    #[inline(always)]
    fn of_lines<S: Simd>(&mut self, _: S) -> f32 {
        self.take();
        if self.count < LEAST || !self.is_more(0.0, significant(self.count) as f32) {
            return 0.0;
        }
        let (mut low, mut high) = (0.0, 1.0);
        for _ in 0..HALVINGS {
            let middle = 0.5 * (low + high);
            if self.is_more(middle, 1.0) { low = middle } else { high = middle }
        }
        0.5 * (low + high)
    }

    /// The differences over all lines that are one surface's: those between the members have a say, too.
    #[inline(always)]
    fn take(&mut self) {
        // Every other one is a member.
        let [a, before, b, between, c, after, d] = parts(&self.position, 1);
        let [sa, sb, sc, sd] = parts(&self.sigma, SPACING);
        let [wa, wb, wc, wd] = parts(&self.width, SPACING);
        let n = a.len();
        for of in [&mut self.squares, &mut self.variances, &mut self.widths] {
            of.clear();
            of.resize(n, 0.0);
        }
        let (squares, variances, widths) =
            (&mut self.squares[..n], &mut self.variances[..n], &mut self.widths[..n]);
        let reach = SPACING as f32 * run_reach(0.0);
        let mut count = 0u32;
        for i in 0..n {
            let near =
                ((a[i] - b[i]).abs() < reach) & ((b[i] - c[i]).abs() < reach) & ((c[i] - d[i]).abs() < reach);
            let known = (before[i] + between[i] + after[i]).is_finite();
            let difference = third_difference([a[i], b[i], c[i], d[i]]);
            count += u32::from(near & known);
            squares[i] = if near & known { difference * difference } else { -1.0 };
            variances[i] = weighted_squares([sa[i], sb[i], sc[i], sd[i]]);
            widths[i] = weighted_squares([wa[i], wb[i], wc[i], wd[i]]);
        }
        self.count = count as usize;
    }

    /// Whether the quantile of the differences, by their sigmas with a scatter of `k` widths, is more than so many times that of a normal
    /// distribution: counted, not sorted.
    #[inline(always)]
    fn is_more(&self, k: f32, times: f32) -> bool {
        let n = self.squares.len();
        let (squares, variances, widths) = (&self.squares[..n], &self.variances[..n], &self.widths[..n]);
        let (limit, by_width) = ((times * SHARE_NORMAL as f32).powi(2), k * k);
        let mut beyond = 0u32;
        for i in 0..n {
            beyond += u32::from(squares[i] > limit * (variances[i] + by_width * widths[i]));
        }
        let at = ((SHARE * self.count as f64) as usize).min(self.count - 1);
        beyond as usize >= self.count - at
    }
}

/// What remains of four members of a smooth curve.
#[inline(always)]
pub(crate) fn third_difference([a, b, c, d]: [f32; 4]) -> f32 {
    (a - d) + 3.0 * (c - b)
}

/// Variance of that from standard deviations of the four.
#[inline(always)]
pub(crate) fn weighted_squares([a, b, c, d]: [f32; 4]) -> f32 {
    WEIGHTS[0] * (a * a + d * d) + WEIGHTS[1] * (b * b + c * c)
}

/// The `K` parts of equal length that begin `spacing` apart.
#[inline(always)]
pub(crate) fn parts<const K: usize>(values: &[f32], spacing: usize) -> [&[f32]; K] {
    let length = values.len().saturating_sub((K - 1) * spacing);
    std::array::from_fn(|k| values.get(k * spacing..k * spacing + length).unwrap_or(&[]))
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
                (i % 97 != 0).then_some(position as f32)
            });
            let found = of(centres);
            assert!((found - added).abs() <= WITHIN * added, "{added}: {found}");
        }
    }

    #[test]
    fn other_surfaces_and_few_lines_tell_nothing() {
        let far = |i: usize| Some(90.0 + 40.0 * (i / 3 % 2) as f32);
        for centres in [vec![], vec![None; 3], vec![Some(90.0); 6], (0..600).map(far).collect()] {
            assert!(of(centres.into_iter()).abs() < f64::EPSILON);
        }
    }

    /// Of centres with a sigma of 0.05 px and a width of 2 px.
    fn of(centres: impl Iterator<Item = Option<f32>>) -> f64 {
        let centre = |position: f32| Centre { position, sigma: 0.05, width: 2.0 };
        Scatter::default().of(Level::new(), centres.map(|position| position.map(centre)))
    }
}
