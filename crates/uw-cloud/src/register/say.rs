//! What say each match has: by its own variance, and by how likely it is to be of the surface at all.
//!
//! Residuals are a mixture: normal with the points' variance about the surface, or anything within the reach, with the share of the latter that makes them all the most
//! likely (M. Aitkin, G. Wilson, Technometrics 22 (1980) 325; P. Torr, A. Zisserman, CVIU 78 (2000) 138). A match weighs what its chance of being of the surface is. Where no
//! residual is longer than noise makes it, that is one for all of them, and nothing of least squares' efficiency is given away; where some are, it falls off the
//! nearer to the surface the more there are.
//!
//! While points are looked for farther off than their noise brings them, the pose's own error is in all residuals, which tell of no strays then; a sharp cut would hold a
//! pose where it is. Until then weights are Tukey's, wide ones.

use super::refine::FARTHEST;
use super::sample::Match;
use crate::robust::{median, scale_about_zero};

/// Tukey's constant of the wide weights: 99 % of a mean's efficiency.
pub(super) const WIDE: f64 = 7.041;
/// Strays that more than half of all may not be: the scale is a median's.
const MOST_STRAYS: f64 = 0.5;
/// Rounds of expectation and maximisation, and the change of the strays' share that they end with, as a share of itself. A weight goes by its logarithm.
const ROUNDS: usize = 30;
const SAME: f64 = 0.1;

/// Gives each of some matches its variance and its chance of being of the surface, and returns the variance that their residuals have beyond what is told, at least `least` mm², and what is told of the most.
/// `reach` is as far as they were looked for, mm.
pub(super) fn judge(matches: &mut [Match], reach: f64, least: f64) -> (f64, f64) {
    let told = median(&mut matches.iter().map(|m| m.told).collect::<Vec<_>>());
    let scatter = scale_about_zero(matches.iter().map(|m| m.residual));
    let floor2 = (scatter * scatter - told).max(least);
    matches.iter_mut().for_each(|m| m.variance = m.told + floor2);
    // Searches narrow down to a tenth.
    if reach > 1.1 * FARTHEST * (told + floor2).sqrt() {
        for m in matches {
            let left = (1.0 - m.residual * m.residual / (m.variance * WIDE * WIDE)).max(0.0);
            (m.chance, m.bent) = (left * left, left * (5.0 * left - 4.0));
        }
        return (floor2, told);
    }
    // How much more likely a residual is of the surface than of what lies anywhere.
    let across = 2.0 * reach / (2.0 * std::f64::consts::PI).sqrt();
    for m in &mut *matches {
        m.chance = across / m.variance.sqrt() * (-0.5 * m.residual * m.residual / m.variance).exp();
    }
    let strays = strays(matches);
    for m in matches {
        let own = (1.0 - strays) * m.chance;
        m.chance = own / (own + strays).max(f64::MIN_POSITIVE);
        // Of points without noise a stray is so many sigmas off that nought times infinity would be asked.
        let slope = 1.0 - (1.0 - m.chance) * m.residual * m.residual / m.variance;
        m.bent = if m.chance > 0.0 { m.chance * slope } else { 0.0 };
    }
    (floor2, told)
}

/// Returns the most likely share of strays among matches whose chance is, so far, by how much more likely they are to be none.
fn strays(matches: &[Match]) -> f64 {
    let count = matches.len().max(1) as f64;
    let mut share = MOST_STRAYS;
    for _ in 0..ROUNDS {
        let chances = matches.iter().map(|m| share / (share + (1.0 - share) * m.chance));
        let next = (chances.sum::<f64>() / count).min(MOST_STRAYS);
        let same = (share - next).abs() <= SAME * share;
        share = next;
        // Of less than one point nobody is one.
        if same || share * count < 1.0 {
            break;
        }
    }
    share
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::robust::Random;
    use nalgebra::Vector3;

    const NOISE_MM: f64 = 0.05;
    const REACH_MM: f64 = 0.6;
    const POINTS: usize = 20_000;

    /// Matches of noise, each `every`th anywhere within the reach.
    fn matches(every: usize) -> Vec<Match> {
        let mut random = Random::new(5);
        let mut residual = |k: usize| {
            // The sum of 48 uniform numbers has no tails that matter here.
            let gauss = ((0..48).map(|_| random.share()).sum::<f64>() - 24.0) / 2.0;
            if k.is_multiple_of(every) { REACH_MM * (2.0 * random.share() - 1.0) } else { NOISE_MM * gauss }
        };
        let of = |residual| Match {
            arm: Vector3::zeros(),
            normal: Vector3::z(),
            own: Vector3::z(),
            residual,
            told: 0.0,
            variance: 0.0,
            chance: 0.0,
            bent: 0.0,
            facing: 1.0,
        };
        (1..=POINTS).map(|k| of(residual(k))).collect()
    }

    #[test]
    fn noise_alone_has_its_whole_say_and_strays_have_theirs_taken() {
        let mut noise = matches(POINTS + 1);
        let (floor2, _) = judge(&mut noise, REACH_MM, 0.0);
        assert!((floor2.sqrt() / NOISE_MM - 1.0).abs() < 0.03, "{}", floor2.sqrt());
        // Variance of a weighted mean over that of the plain one.
        let weighed = |of: fn(&Match) -> f64, all: &[Match]| all.iter().map(of).sum::<f64>();
        let slope = weighed(|m| m.bent, &noise).powi(2);
        let lost = POINTS as f64 * weighed(|m| (m.chance * m.residual).powi(2), &noise)
            / slope
            / (weighed(|m| m.residual.powi(2), &noise) / POINTS as f64);
        assert!((0.999..1.001).contains(&lost), "{lost}");
        for every in [5, 20, 100] {
            let mut mixed = matches(every);
            judge(&mut mixed, REACH_MM, 0.0);
            let share = 1.0 - weighed(|m| m.chance, &mixed) / POINTS as f64;
            // Some of noise's scale is strays'.
            assert!((share * every as f64 - 1.0).abs() < 0.15, "one in {every}: {share}");
            let far = mixed.iter().filter(|m| m.residual.abs() > 5.0 * NOISE_MM).map(|m| m.chance);
            assert!(far.fold(0.0, f64::max) < 0.05, "one in {every}");
        }
    }

    #[test]
    fn strays_among_points_without_noise_have_no_say() {
        let mut exact = matches(POINTS + 1);
        exact.iter_mut().for_each(|m| m.residual = 0.0);
        exact[3].residual = 3.0;
        judge(&mut exact, 5.0, f64::MIN_POSITIVE);
        assert!(exact.iter().all(|m| m.chance.is_finite() && m.bent.is_finite()));
        assert!(exact[3].chance.abs() + exact[3].bent.abs() < f64::EPSILON);
    }

    #[test]
    fn pulls_change_by_what_is_told_of_them() {
        for reach in [REACH_MM, 40.0 * REACH_MM] {
            let at = |shift: f64| {
                let mut all = matches(10);
                all[6].residual = 2.2 * NOISE_MM + shift;
                judge(&mut all, reach, 0.0);
                (all[6].chance * all[6].residual, all[6].bent)
            };
            // One of so many hardly changes the share of strays.
            let step = 1e-5;
            let slope = (at(step).0 - at(-step).0) / (2.0 * step);
            assert!((slope - at(0.0).1).abs() < 0.02, "{slope} {}", at(0.0).1);
        }
    }
}
