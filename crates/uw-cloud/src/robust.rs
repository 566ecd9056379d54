//! Robust scale, random sampling and the few statistics that the fits share.

/// Standard deviation of a Gaussian over its median absolute value, 1 / Φ⁻¹(3/4).
const SIGMA_PER_MEDIAN: f64 = 1.482_602_218_505_602;

/// Returns the value of a given rank (0 is the smallest), reordering the slice; `None` where there is none.
pub(crate) fn ranked(values: &mut [f64], rank: usize) -> Option<f64> {
    (rank < values.len()).then(|| *values.select_nth_unstable_by(rank, f64::total_cmp).1)
}

/// Returns the median (the upper one of an even number), reordering the slice; 0 for an empty one.
pub(crate) fn median(values: &mut [f64]) -> f64 {
    ranked(values, values.len() / 2).unwrap_or(0.0)
}

/// Returns the standard deviation that a Gaussian about zero with this median absolute value has; half of the
/// values may be anything.
pub(crate) fn scale_about_zero(values: impl Iterator<Item = f64>) -> f64 {
    SIGMA_PER_MEDIAN * median(&mut values.map(f64::abs).collect::<Vec<_>>())
}

/// Returns how many sigmas a sound measurement among `count` practically never exceeds: sqrt(2 ln n), the bound on
/// the expected maximum of n Gaussians (D. Donoho, I. Johnstone, Biometrika 81 (1994) 425), at least 3.
pub(crate) fn rejection_limit(count: usize) -> f64 {
    (2.0 * (count.max(1) as f64).ln()).sqrt().max(3.0)
}

/// Returns the half-width of the 68.27 % interval of Student's t over that of the Gaussian, by the expansion in
/// 1/dof of Abramowitz and Stegun, 26.7.5 (1.4 % low at one degree of freedom, exact from three on).
pub(crate) fn student_widening(dof: usize) -> f64 {
    let x = 1.0 / dof.max(1) as f64;
    1.0 + x * (0.5 + x * (0.25 + x / 16.0))
}

/// SplitMix64 (G. Steele, D. Lea, C. Flood, OOPSLA 2014): the same seed gives the same fit on every machine and
/// with every release of every dependency.
pub(crate) struct Random(u64);

impl Random {
    /// Returns the generator of this seed.
    pub(crate) fn new(seed: u64) -> Self {
        Self(seed)
    }

    /// Returns a number from 0 to `bound` − 1 (0 where `bound` is 0).
    pub(crate) fn below(&mut self, bound: usize) -> usize {
        ((u128::from(self.bits()) * bound as u128) >> 64) as usize
    }

    /// Returns 64 bits.
    pub(crate) fn bits(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }

    /// Returns a number from 0 to below 1.
    pub(crate) fn share(&mut self) -> f64 {
        const STEPS: usize = 1 << 31;
        self.below(STEPS) as f64 / STEPS as f64
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn scale_stands_a_minority_of_nonsense() {
        // A symmetric triangle of quantiles of the uniform law on ±1: median |x| is 0.5.
        let mut values: Vec<f64> = (0..1001).map(|i| f64::from(i) / 500.0 - 1.0).collect();
        assert!((scale_about_zero(values.iter().copied()) - 0.5 * SIGMA_PER_MEDIAN).abs() < 2e-3);
        values.extend([1e9; 800]);
        let scale = scale_about_zero(values.into_iter());
        assert!(scale < 1.0 * SIGMA_PER_MEDIAN, "still of the size of the sound values, got {scale}");
    }

    #[test]
    fn student_widening_meets_the_exact_quantiles() {
        // tan(π p / 2) for one degree of freedom, p / sqrt((1 − p²)/2) for two, with p = 0.682689.
        for (dof, exact, tolerance) in [(1, 1.8373, 0.03), (2, 1.3213, 0.003), (10, 1.0526, 0.001)] {
            assert!((student_widening(dof) - exact).abs() < tolerance, "dof {dof}");
        }
    }

    #[test]
    fn random_numbers_repeat_and_cover_the_range() {
        let draw = || {
            let mut random = Random::new(7);
            (0..600).map(|_| random.below(6)).collect::<Vec<_>>()
        };
        assert_eq!(draw(), draw());
        for face in 0..6 {
            let count = draw().iter().filter(|&&n| n == face).count();
            assert!((60..=140).contains(&count), "{face}: {count} of 600, 100 expected, sigma 9");
        }
    }
}
