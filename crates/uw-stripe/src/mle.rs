//! Refinement: maximum likelihood of a pixel-integrated Gaussian on a linear background.

use nalgebra::{Cholesky, SMatrix, SVector};

use crate::NoiseModel;
use crate::lines::{Clip, Line};
use crate::noise::Residual;
use crate::special::{mills, normal};

/// Centre, flux, ln width, background, background slope.
const PARAMETERS: usize = 5;
type Vector = SVector<f64, PARAMETERS>;
type Matrix = SMatrix<f64, PARAMETERS, PARAMETERS>;

const CENTRE: usize = 0;
const FLUX: usize = 1;
const LN_WIDTH: usize = 2;
const LEVEL: usize = 3;
const SLOPE: usize = 4;

/// Most iterations; five to eight are usual.
const ITERATIONS: usize = 30;
/// Step of the centre, in widths, and of ln width, below which the iteration has settled.
const SETTLED: f64 = 1e-4;
/// Steps are cut to these: centre in widths, ln width, so that a bad start cannot throw the fit off its candidate.
const LONGEST_STEP: [f64; 2] = [0.7, 0.35];

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
}

/// The model's value and derivatives at one pixel, and what the pixel says.
struct Term {
    gradient: Vector,
    /// Derivative by the third Hermite coefficient.
    skew: f64,
    level: f64,
    signal: f64,
    residual: f64,
    variance: f64,
    /// Derivative of the log likelihood by the expected value, and its information.
    score: f64,
    information: f64,
    clip: Clip,
}

struct Problem<'a> {
    line: Line<'a>,
    noise: &'a NoiseModel,
    start: Start,
    /// Abscissa of the background's level; fixed, so that level and centre don't mix.
    pivot: f64,
    prior_mean: Vector,
    prior_weight: Vector,
}

/// The maximum-likelihood stripe in a window; `None` where the window or the start cannot carry one.
///
/// Model: μᵢ = F · [Φ((xᵢ + ½ − c)/w) − Φ((xᵢ − ½ − c)/w)] + b + s (xᵢ − x₀). Fisher scoring with the variance taken
/// from the model at μᵢ, not at the grey value, which would bias towards dark pixels. Pixels at full scale, and zeros of
/// a converter that clips there, enter as bounds (Tobin 1958). Sigmas are the inverse of the Fisher matrix.
pub(crate) fn fit(
    line: Line<'_>,
    noise: &NoiseModel,
    start: Start,
    width_prior: Option<WidthPrior>,
    mut residuals: Option<&mut Vec<Residual>>,
) -> Option<Fit> {
    let problem = Problem::new(line, noise, start, width_prior)?;
    let mut at = Vector::new(start.centre, start.flux, start.width.ln(), start.background, 0.0);
    let mut converged = false;
    for _ in 0..ITERATIONS {
        let (information, score) = problem.normal_equations(&at);
        let step = solve(&information, &score)?;
        let width = at[LN_WIDTH].exp();
        let longest = (step[CENTRE].abs() / (LONGEST_STEP[0] * width))
            .max(step[LN_WIDTH].abs() / LONGEST_STEP[1])
            .max(1.0);
        let flux = at[FLUX];
        at += step / longest;
        // Flux stays positive: halfway down at most.
        at[FLUX] = at[FLUX].max(0.5 * flux);
        if !at.iter().all(|v| v.is_finite()) {
            return None;
        }
        if longest <= 1.0 && step[CENTRE].abs() < SETTLED * width && step[LN_WIDTH].abs() < SETTLED * 10.0 {
            converged = true;
            break;
        }
    }
    let (information, _) = problem.normal_equations(&at);
    let covariance = inverse(&information)?;
    let mut fit = Fit {
        centre: at[CENTRE],
        sigma: covariance[(CENTRE, CENTRE)].max(0.0).sqrt(),
        flux: at[FLUX],
        sigma_flux: covariance[(FLUX, FLUX)].max(0.0).sqrt(),
        width: at[LN_WIDTH].exp(),
        background: at[LEVEL] + at[SLOPE] * (at[CENTRE] - problem.pivot),
        chi2: 0.0,
        freedom: 0.0,
        skew: 0.0,
        skew_snr: 0.0,
        saturated: 0,
        converged,
    };
    let (mut skew_score, mut skew_information, mut skew_cross) = (0.0, 0.0, Vector::zeros());
    for i in start.from..start.to {
        let t = problem.term(&at, i);
        match t.clip {
            Clip::Full => fit.saturated += 1,
            Clip::Floor => {}
            Clip::No => {
                let leverage = (t.gradient.transpose() * covariance * t.gradient)[0] / t.variance;
                let freedom = (1.0 - leverage).clamp(0.0, 1.0);
                fit.chi2 += t.residual * t.residual / t.variance;
                fit.freedom += freedom;
                if let Some(residuals) = residuals.as_deref_mut() {
                    residuals.push(Residual {
                        level: t.level,
                        signal: t.signal,
                        square: t.residual * t.residual,
                        variance: t.variance,
                        freedom,
                    });
                }
            }
        }
        skew_score += t.skew * t.score;
        skew_information += t.skew * t.skew * t.information;
        skew_cross += t.gradient * (t.skew * t.information);
    }
    // Rao's score test for a sixth parameter, without fitting it.
    let left = skew_information - (skew_cross.transpose() * covariance * skew_cross)[0];
    if left > 1e-9 * skew_information {
        fit.skew = skew_score / left;
        fit.skew_snr = skew_score / left.sqrt();
    }
    Some(fit)
}

impl<'a> Problem<'a> {
    fn new(line: Line<'a>, noise: &'a NoiseModel, start: Start, width: Option<WidthPrior>) -> Option<Self> {
        let pixels = start.to.checked_sub(start.from).filter(|n| *n >= 3 && start.to <= line.value.len())?;
        let usable =
            start.flux > 0.0 && start.width > 0.0 && start.centre.is_finite() && start.background.is_finite();
        if !usable {
            return None;
        }
        // Weak priors that decide only where the floor hides the background: it lies within a few sigmas, or a tenth of
        // the peak, of the surroundings.
        let peak = start.flux / (start.width * (2.0 * std::f64::consts::PI).sqrt());
        let level = start.background.max(0.0) + line.pedestal(start.from);
        let slack = 3.0 * noise.variance(level, 0.0).sqrt() + 0.1 * peak;
        let slope_slack = slack / pixels as f64;
        let mut prior_weight = Vector::zeros();
        prior_weight[LEVEL] = slack.powi(-2);
        prior_weight[SLOPE] = slope_slack.powi(-2);
        let mut prior_mean = Vector::zeros();
        prior_mean[LEVEL] = start.background;
        if let Some(w) = width {
            prior_mean[LN_WIDTH] = w.ln_width;
            prior_weight[LN_WIDTH] = w.sigma.powi(-2);
        }
        Some(Self { line, noise, start, pivot: start.centre.round(), prior_mean, prior_weight })
    }

    fn term(&self, at: &Vector, i: usize) -> Term {
        let width = at[LN_WIDTH].exp();
        let low = (i as f64 - 0.5 - at[CENTRE]) / width;
        let high = (i as f64 + 0.5 - at[CENTRE]) / width;
        let ((density_low, below_low), (density_high, below_high)) = (normal(low), normal(high));
        let share = below_high - below_low;
        let flux = at[FLUX];
        let offset = i as f64 - self.pivot;
        let signal = flux * share;
        let value = signal + at[LEVEL] + at[SLOPE] * offset;
        let gradient = Vector::new(
            -flux * (density_high - density_low) / width,
            share,
            -flux * (high * density_high - low * density_low),
            1.0,
            offset,
        );
        let skew = -flux / 6.0 * ((high * high - 1.0) * density_high - (low * low - 1.0) * density_low);
        let pedestal = self.line.pedestal(i);
        let level = value + pedestal;
        let mut variance = self.noise.variance(level, signal);
        if pedestal > 0.0 {
            variance += self.noise.variance(pedestal, 0.0);
        }
        let sigma = variance.sqrt();
        let clip = self.line.clip[i];
        let measured = f64::from(self.line.value[i]);
        let residual = measured - value;
        // A clipped pixel says only that the light was beyond half a DN from the clip.
        let bound = |z: f64, sign: f64| {
            let m = mills(z);
            (sign * m / sigma, (m * (m + z)).clamp(0.0, 1.0) / variance)
        };
        let (score, information) = match clip {
            Clip::No => (residual / variance, 1.0 / variance),
            Clip::Floor => bound((measured + 0.5 - value) / sigma, -1.0),
            Clip::Full => bound((value - measured + 0.5) / sigma, 1.0),
        };
        Term { gradient, skew, level, signal, residual, variance, score, information, clip }
    }

    fn normal_equations(&self, at: &Vector) -> (Matrix, Vector) {
        let mut information = Matrix::from_diagonal(&self.prior_weight);
        let mut score = self.prior_weight.component_mul(&(self.prior_mean - at));
        for i in self.start.from..self.start.to {
            let t = self.term(at, i);
            information.ger(t.information, &t.gradient, &t.gradient, 1.0);
            score.axpy(t.score, &t.gradient, 1.0);
        }
        (information, score)
    }
}

/// Scaled to a unit diagonal, since flux and slope differ by decades; a little damping there keeps a nearly singular
/// step finite without moving the solution.
fn factor(
    information: &Matrix,
    damping: f64,
) -> Option<(Cholesky<f64, nalgebra::Const<PARAMETERS>>, Vector)> {
    let scale = information.diagonal().map(|d| if d > 0.0 { d.sqrt().recip() } else { 0.0 });
    if scale.iter().any(|s| *s <= 0.0 || !s.is_finite()) {
        return None;
    }
    let mut scaled = Matrix::from_diagonal(&scale) * information * Matrix::from_diagonal(&scale);
    for k in 0..PARAMETERS {
        scaled[(k, k)] += damping;
    }
    Cholesky::new(scaled).map(|f| (f, scale))
}

fn solve(information: &Matrix, score: &Vector) -> Option<Vector> {
    const DAMPING: f64 = 1e-6;
    let (factor, scale) = factor(information, DAMPING)?;
    Some(factor.solve(&score.component_mul(&scale)).component_mul(&scale))
}

fn inverse(information: &Matrix) -> Option<Matrix> {
    let (factor, scale) = factor(information, 0.0)?;
    Some(Matrix::from_diagonal(&scale) * factor.inverse() * Matrix::from_diagonal(&scale))
}
