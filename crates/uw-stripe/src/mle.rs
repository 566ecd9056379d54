//! Refinement: maximum likelihood of a pixel-integrated Gaussian on a smooth background.

use crate::NoiseModel;
use crate::lines::{Clip, Line};
use crate::noise::Residual;
use crate::special::{mills, normal};

mod dense;
mod settle;
pub(crate) mod surroundings;
#[cfg(test)]
mod tests;

use dense::{Factor, MOST, Symmetric, by_size};
pub(crate) use settle::{Seed, WINDOW, settle};

/// Highest degree of the background's polynomial.
const DEGREE: usize = 7;
const CENTRE: usize = 0;
const FLUX: usize = 1;
const LN_WIDTH: usize = 2;
/// First coefficient of the background; those of degrees 1, 2, … follow.
const LEVEL: usize = 3;

/// Half a window, in widths, from which a background of this degree is told from the stripe: it then costs the centre about 5 % in
/// variance by degree 3, and 15 % by degree 5, before the neighbours help (`surroundings`).
const DEGREES: [(f64, usize); 3] = [(7.0, 7), (5.5, 5), (0.0, 1)];
/// Parameters of a stripe on a straight background.
const STRAIGHT: usize = LEVEL + 2;
/// Rao's score statistic beyond which a background counts as bent: six coefficients that are zero exceed it once in 2000.
const BENT: f64 = 24.0;
/// Half-length of the polynomials' unit, in widths.
const UNIT_WIDTHS: f64 = 8.0;
/// Beyond so many widths from the centre there is no stripe: less than 1e-7 of its height.
const STRIPE_WIDTHS: f64 = 5.7;
/// Share of floored pixels in the window above which a background's curvature is not seen.
const FLOORED: f64 = 0.3;

/// Most iterations; three to five are usual.
const ITERATIONS: usize = 30;
/// Half of the window for these, in widths plus pixels.
const CLOSE: (f64, f64) = (3.2, 2.5);
/// Step, in widths and of ln width, that one solution of the normal equations does as well as an iteration would.
const NEAR: f64 = 0.03;
/// Iterations before the background is judged straight or bent.
const FIRST_LOOK: usize = 4;
/// Iterations after which the background's origin follows the centre no more.
const PIVOTING: usize = 2;
/// Step of the centre, in widths, and of ln width, below which the iteration has settled.
const SETTLED: f64 = 3e-4;
/// Steps are cut to these: centre in widths, ln width, so that a bad start cannot throw the fit off its candidate.
const LONGEST_STEP: [f64; 2] = [0.7, 0.35];
/// Of the scaled diagonal: keeps a nearly singular step finite without moving the solution.
const DAMPING: f64 = 1e-6;

/// Where a fit starts and which pixels it uses.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Start {
    pub centre: f64,
    pub width: f64,
    /// DN · px.
    pub flux: f64,
    pub background: f64,
    /// First pixel of the window, and the one after its last.
    pub from: usize,
    pub to: usize,
}

/// What is known of the width beforehand: ln width and its standard deviation.
#[derive(Debug, Clone, Copy)]
pub(crate) struct WidthPrior {
    pub ln_width: f64,
    pub sigma: f64,
}

/// The fitted stripe on one line; positions in pixels from the start of the line.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Fit {
    pub centre: f64,
    pub sigma: f64,
    /// DN · px.
    pub flux: f64,
    pub sigma_flux: f64,
    pub width: f64,
    pub background: f64,
    /// Chi-square and degrees of freedom of the pixels that are not clipped.
    pub chi2: f64,
    pub freedom: f64,
    /// Skewness of the profile beyond the model, and in units of its sigma.
    pub skew: f64,
    pub skew_snr: f64,
    /// Pixels at full scale in the window.
    pub saturated: usize,
    pub converged: bool,
    /// Parameters and their information, for `surroundings`.
    solution: Solution,
}

/// Where the iteration ended.
#[derive(Debug, Clone, Copy)]
struct Solution {
    at: [f64; MOST],
    information: Symmetric,
    /// Parameters in use.
    size: usize,
    /// Origin and half-length of the background's polynomials, px.
    pivot: f64,
    unit: f64,
}

/// What a pixel says: derivative of the log likelihood by the expected value, and its information.
struct Term {
    residual: f64,
    variance: f64,
    score: f64,
    information: f64,
}

/// The stripe's share of a pixel, and its derivatives.
#[derive(Clone, Copy, Default)]
struct Profile {
    signal: f64,
    by_centre: f64,
    by_flux: f64,
    by_ln_width: f64,
    /// By the third Hermite coefficient.
    by_skew: f64,
}

/// A [`NoiseModel`] as what its variance is made of: no division for every pixel.
#[derive(Debug, Clone, Copy)]
struct Weights {
    dark: f64,
    per_level: f64,
    per_square: f64,
}

impl Weights {
    fn of(noise: &NoiseModel) -> Self {
        let dark = noise.variance(0.0, 0.0);
        let per_level = f64::from(noise.gain_e_per_dn).recip();
        Self { dark, per_level, per_square: f64::from(noise.speckle_contrast).powi(2) }
    }

    fn variance(&self, level: f64, signal: f64) -> f64 {
        self.dark + level.max(0.0) * self.per_level + signal * signal * self.per_square
    }
}

struct Problem<'a> {
    line: Line<'a>,
    noise: Weights,
    from: usize,
    to: usize,
    size: usize,
    pivot: f64,
    unit: f64,
    prior_mean: [f64; MOST],
    prior_weight: [f64; MOST],
}

/// The maximum-likelihood stripe in a window; `None` where the window or the start cannot carry one.
///
/// Model: μᵢ = F · [Φ((xᵢ + ½ − c)/w) − Φ((xᵢ − ½ − c)/w)] + Σ bₖ Tₖ((xᵢ − x₀)/h), Chebyshev polynomials of a degree that the
/// window can carry. Fisher scoring with the variance taken from the model at μᵢ, not at the grey value, which would bias towards
/// dark pixels. Pixels at full scale, and zeros of a converter that clips there, enter as bounds (Tobin 1958). Sigmas are the
/// inverse of the Fisher matrix.
pub(crate) fn fit(
    line: Line<'_>,
    noise: &NoiseModel,
    start: Start,
    width_prior: Option<WidthPrior>,
    residuals: Option<&mut Vec<Residual>>,
) -> Option<Fit> {
    let (mut problem, full) = Problem::new(line, noise, start, width_prior)?;
    let mut at = [0.0; MOST];
    (at[CENTRE], at[FLUX], at[LN_WIDTH], at[LEVEL]) =
        (start.centre, start.flux, start.width.ln(), start.background);
    // Close around the stripe any background is nearly straight, and most of what the pixels say is said.
    let close = CLOSE.0 * start.width + CLOSE.1;
    problem.from = start.from.max((start.centre - close).ceil().max(0.0) as usize);
    problem.to = start.to.min((start.centre + close).floor().max(0.0) as usize + 1);
    if problem.to < problem.from + STRAIGHT {
        (problem.from, problem.to) = (start.from, start.to);
    }
    let settled = problem.iterate(&mut at, FIRST_LOOK)?;
    (problem.from, problem.to) = (start.from, start.to);
    let (mut information, mut step) = problem.normal_equations(&at, full);
    let mut white = step;
    information.factor(full, DAMPING)?.whiten(&mut white);
    // The first entries are what a straight background has left to do.
    let bent = white[STRAIGHT..full].iter().map(|v| v * v).sum::<f64>() > BENT;
    let mut rest = step;
    information.factor(STRAIGHT, DAMPING)?.solve(&mut rest);
    let near = rest[CENTRE].abs() < NEAR * at[LN_WIDTH].exp() && rest[LN_WIDTH].abs() < NEAR;
    let mut end = at;
    let mut converged = settled && near && !bent;
    if converged {
        (0..STRAIGHT).for_each(|k| end[k] += rest[k]);
    } else {
        problem.size = if bent { full } else { STRAIGHT };
        converged = problem.iterate(&mut at, ITERATIONS)?;
        (information, step) = problem.normal_equations(&at, full);
        end = at;
    }
    let factor = information.factor(full, 0.0)?;
    factor.solve(&mut step);
    let mut solution = Solution { at, information, size: full, pivot: problem.pivot, unit: problem.unit };
    solution.at.iter_mut().zip(&step).for_each(|(a, s)| *a += s);
    problem.verdict(&end, solution, converged, residuals)
}

impl<'a> Problem<'a> {
    /// The problem with a straight background, and the parameters that its window could tell.
    fn new(
        line: Line<'a>,
        noise: &NoiseModel,
        start: Start,
        width: Option<WidthPrior>,
    ) -> Option<(Self, usize)> {
        let pixels = start.to.checked_sub(start.from).filter(|n| *n >= 3 && start.to <= line.value.len())?;
        let usable =
            start.flux > 0.0 && start.width > 0.0 && start.centre.is_finite() && start.background.is_finite();
        if !usable {
            return None;
        }
        let half = (start.centre - start.from as f64).min(start.to as f64 - 1.0 - start.centre);
        let floored = line.clip[start.from..start.to].iter().filter(|c| **c == Clip::Floor).count();
        let degree = if floored as f64 > FLOORED * pixels as f64 {
            1
        } else {
            DEGREES.iter().find(|d| half >= d.0 * start.width).map_or(1, |d| d.1)
        };
        // Weak priors that decide only where the floor hides the background: it lies within a few sigmas, or a tenth of
        // the peak, of the surroundings.
        let peak = start.flux / (start.width * (2.0 * std::f64::consts::PI).sqrt());
        let level = start.background.max(0.0) + line.pedestal(start.from);
        let slack = 3.0 * noise.variance(level, 0.0).sqrt() + 0.1 * peak;
        let unit = UNIT_WIDTHS * width.map_or(start.width, |w| w.ln_width.exp());
        let (mut prior_weight, mut prior_mean) = ([0.0; MOST], [0.0; MOST]);
        prior_weight[LEVEL..].fill(slack.powi(-2));
        // A slope's slack is the same over the window, whatever its length.
        prior_weight[LEVEL + 1] = (slack * unit / pixels as f64).powi(-2);
        prior_mean[LEVEL] = start.background;
        if let Some(w) = width {
            prior_mean[LN_WIDTH] = w.ln_width;
            prior_weight[LN_WIDTH] = w.sigma.powi(-2);
        }
        let (from, to, pivot, noise) = (start.from, start.to, start.centre, Weights::of(noise));
        let problem = Self { line, noise, from, to, size: STRAIGHT, pivot, unit, prior_mean, prior_weight };
        Some((problem, LEVEL + 1 + degree))
    }

    /// Moves `at` to the maximum of the likelihood; true when it settled there. `None` where it ran away.
    fn iterate(&mut self, at: &mut [f64; MOST], most: usize) -> Option<bool> {
        for round in 0..most {
            let (information, mut step) = self.normal_equations(at, self.size);
            information.factor(self.size, DAMPING)?.solve(&mut step);
            let width = at[LN_WIDTH].exp();
            let longest = (step[CENTRE].abs() / (LONGEST_STEP[0] * width))
                .max(step[LN_WIDTH].abs() / LONGEST_STEP[1])
                .max(1.0);
            let flux = at[FLUX];
            at.iter_mut().zip(&step).for_each(|(a, s)| *a += s / longest);
            // Flux stays positive: halfway down at most.
            at[FLUX] = at[FLUX].max(0.5 * flux);
            if !at.iter().all(|v| v.is_finite()) {
                return None;
            }
            if longest <= 1.0 && step[CENTRE].abs() < SETTLED * width && step[LN_WIDTH].abs() < SETTLED * 10.0
            {
                return Some(true);
            }
            if round < PIVOTING {
                self.pivot = at[CENTRE];
            }
        }
        Some(false)
    }

    /// Calls `each` for every pixel of the window with its profile, its expected value and that one's gradient by the first `N`
    /// parameters.
    #[inline(always)]
    fn scan<const N: usize>(
        &self,
        at: &[f64; MOST],
        mut each: impl FnMut(usize, &Profile, f64, &[f64; N], f64),
    ) {
        let width = at[LN_WIDTH].exp();
        let (flux, centre, inverse) = (at[FLUX], at[CENTRE], width.recip());
        let (reach, per_unit) = (STRIPE_WIDTHS * width + 0.5, self.unit.recip());
        let mut gradient = [0.0; N];
        // A pixel's right edge is the next one's left.
        let mut left = None;
        for i in self.from..self.to {
            let x = i as f64 - centre;
            let t = (i as f64 - self.pivot) * per_unit;
            chebyshev(&mut gradient[LEVEL..], t);
            let mut background = 0.0;
            for k in LEVEL..N {
                background += at[k] * gradient[k];
            }
            let mut profile = Profile::default();
            if x.abs() < reach {
                let low = (x - 0.5) * inverse;
                let high = (x + 0.5) * inverse;
                let (density_low, below_low) = left.unwrap_or_else(|| normal(low));
                let (density_high, below_high) = normal(high);
                left = Some((density_high, below_high));
                let share = below_high - below_low;
                profile = Profile {
                    signal: flux * share,
                    by_centre: -flux * (density_high - density_low) * inverse,
                    by_flux: share,
                    by_ln_width: -flux * (high * density_high - low * density_low),
                    by_skew: -flux / 6.0
                        * ((high * high - 1.0) * density_high - (low * low - 1.0) * density_low),
                };
            }
            (gradient[CENTRE], gradient[FLUX], gradient[LN_WIDTH]) =
                (profile.by_centre, profile.by_flux, profile.by_ln_width);
            each(i, &profile, profile.signal + background, &gradient, t);
        }
    }

    fn term(&self, i: usize, signal: f64, value: f64) -> Term {
        let pedestal = self.line.pedestal(i);
        let mut variance = self.noise.variance(value + pedestal + self.line.light(i), signal);
        if pedestal > 0.0 {
            variance += self.noise.variance(pedestal, 0.0);
        }
        let measured = f64::from(self.line.value[i]);
        let residual = measured - value;
        // A clipped pixel says only that the light was beyond half a DN from the clip.
        let bound = |beyond: f64, sign: f64| {
            let sigma = variance.sqrt();
            let z = beyond / sigma;
            let m = mills(z);
            (sign * m / sigma, (m * (m + z)).clamp(0.0, 1.0) / variance)
        };
        let (score, information) = match self.line.clip[i] {
            Clip::No => {
                let weight = variance.recip();
                (residual * weight, weight)
            }
            Clip::Floor => bound(measured + 0.5 - value, -1.0),
            Clip::Full => bound(value - measured + 0.5, 1.0),
        };
        Term { residual, variance, score, information }
    }

    /// Fisher information and score of the first `size` parameters.
    fn normal_equations(&self, at: &[f64; MOST], size: usize) -> (Symmetric, [f64; MOST]) {
        by_size!(size, N => self.sums::<N>(at))
    }

    fn sums<const N: usize>(&self, at: &[f64; MOST]) -> (Symmetric, [f64; MOST]) {
        // Tᵢ Tⱼ = (Tᵢ₊ⱼ + T|ᵢ₋ⱼ|) / 2: sums over single polynomials give all of the background's block.
        let mut polynomials = [0.0; 2 * DEGREE + 1];
        let degree = N - 1 - LEVEL;
        let (mut stripe, mut score) = ([[0.0; N]; LEVEL], [0.0; N]);
        self.scan::<N>(at, |i, profile, value, gradient, t| {
            let term = self.term(i, profile.signal, value);
            let (mut last, mut this) = (t, 1.0);
            let twice = 2.0 * t;
            for sum in polynomials.iter_mut().take(2 * degree + 1) {
                *sum += term.information * this;
                (last, this) = (this, twice * this - last);
            }
            for k in LEVEL..N {
                score[k] += term.score * gradient[k];
            }
            if profile.by_flux > 0.0 {
                for r in 0..LEVEL {
                    let weighted = term.information * gradient[r];
                    score[r] += term.score * gradient[r];
                    for c in 0..N {
                        stripe[r][c] += weighted * gradient[c];
                    }
                }
            }
        });
        let mut all = (Symmetric::diagonal(&self.prior_weight), [0.0; MOST]);
        for r in 0..N {
            all.1[r] = score[r] + self.prior_weight[r] * (self.prior_mean[r] - at[r]);
            for c in 0..=r {
                all.0.0[r][c] += if c < LEVEL {
                    stripe[c][r]
                } else {
                    0.5 * (polynomials[r + c - 2 * LEVEL] + polynomials[r - c])
                };
            }
        }
        all
    }

    /// The fit at the solution, with chi-square, skewness and residuals.
    fn verdict(
        &self,
        at: &[f64; MOST],
        solution: Solution,
        converged: bool,
        residuals: Option<&mut Vec<Residual>>,
    ) -> Option<Fit> {
        by_size!(self.size, N => self.judged::<N>(at, solution, converged, residuals))
    }

    fn judged<const N: usize>(
        &self,
        at: &[f64; MOST],
        solution: Solution,
        converged: bool,
        mut residuals: Option<&mut Vec<Residual>>,
    ) -> Option<Fit> {
        let factor = solution.information.factor(N, 0.0)?;
        let mut fit = Solution { at: *at, size: N, ..solution }.fit(&factor);
        (fit.converged, fit.solution) = (converged, solution);
        // What the parameters took of each pixel's freedom is asked for, or clipped pixels gave them some; else the sum will do: the
        // trace of C (C⁻¹ − prior).
        let each = residuals.is_some() || self.line.clip[self.from..self.to].iter().any(|c| *c != Clip::No);
        let (mut skew_score, mut skew_information, mut skew_cross) = (0.0, 0.0, [0.0; MOST]);
        self.scan::<N>(at, |i, profile, value, gradient, _| {
            let t = self.term(i, profile.signal, value);
            match self.line.clip[i] {
                Clip::Full => fit.saturated += 1,
                Clip::Floor => {}
                Clip::No => {
                    let square = t.residual * t.residual;
                    fit.chi2 += square / t.variance;
                    let mut freedom = 1.0;
                    if each {
                        let mut white = [0.0; MOST];
                        white[..N].copy_from_slice(gradient);
                        factor.whiten(&mut white);
                        let leverage = white[..N].iter().map(|v| v * v).sum::<f64>() / t.variance;
                        freedom = (1.0 - leverage).clamp(0.0, 1.0);
                    }
                    fit.freedom += freedom;
                    if let Some(residuals) = residuals.as_deref_mut() {
                        let level = value + self.line.pedestal(i) + self.line.light(i);
                        let (signal, variance) = (profile.signal, t.variance);
                        residuals.push(Residual { level, signal, square, variance, freedom });
                    }
                }
            }
            skew_score += profile.by_skew * t.score;
            skew_information += profile.by_skew * profile.by_skew * t.information;
            for k in 0..N {
                skew_cross[k] += gradient[k] * profile.by_skew * t.information;
            }
        });
        if !each {
            let taken = (0..N).map(|k| 1.0 - self.prior_weight[k] * factor.column(k)[k]);
            fit.freedom = (fit.freedom - taken.sum::<f64>()).max(0.0);
        }
        // Rao's score test for one more parameter, without fitting it.
        factor.whiten(&mut skew_cross);
        let left = skew_information - skew_cross[..N].iter().map(|v| v * v).sum::<f64>();
        if left > 1e-9 * skew_information {
            fit.skew = skew_score / left;
            fit.skew_snr = skew_score / left.sqrt();
        }
        Some(fit)
    }
}

impl Solution {
    /// The fit as far as parameters and covariance say it.
    fn fit(&self, factor: &Factor) -> Fit {
        let at = &self.at;
        let mut basis = [0.0; DEGREE + 1];
        chebyshev(&mut basis, (at[CENTRE] - self.pivot) / self.unit);
        let sigma = |k: usize| factor.column(k)[k].max(0.0).sqrt();
        Fit {
            centre: at[CENTRE],
            sigma: sigma(CENTRE),
            flux: at[FLUX],
            sigma_flux: sigma(FLUX),
            width: at[LN_WIDTH].exp(),
            background: basis.iter().zip(&at[LEVEL..self.size]).map(|(p, b)| p * b).sum(),
            chi2: 0.0,
            freedom: 0.0,
            skew: 0.0,
            skew_snr: 0.0,
            saturated: 0,
            converged: false,
            solution: *self,
        }
    }
}

/// Chebyshev polynomials T₀, T₁, … at `t`, as many as `p` holds.
#[inline(always)]
fn chebyshev(p: &mut [f64], t: f64) {
    p[0] = 1.0;
    p[1] = t;
    for k in 2..p.len() {
        p[k] = 2.0 * t * p[k - 1] - p[k - 2];
    }
}
