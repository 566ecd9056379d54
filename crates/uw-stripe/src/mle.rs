//! Refinement: maximum likelihood of a pixel-integrated Gaussian on a smooth background.
//!
//! Model: μᵢ = F · [Φ((xᵢ + ½ − c)/w) − Φ((xᵢ − ½ − c)/w)] + Σ bₖ Tₖ((xᵢ − x₀)/h), Chebyshev polynomials of a degree that the
//! window can carry. Fisher scoring with the variance taken from the model at μᵢ, not at the grey value, which would bias towards
//! dark pixels. Pixels at full scale, and zeros of a converter that clips there, enter as bounds (Tobin 1958). Sigmas are the
//! inverse of the Fisher matrix.

use crate::NoiseModel;

mod dense;
mod judge;
mod likelihood;
mod pixels;
mod problem;
mod settle;
mod solve;
pub(crate) mod surroundings;
#[cfg(test)]
mod tests;
mod wide;

use dense::Symmetric;
pub(crate) use problem::Seed;
pub(crate) use settle::{Common, Fitter, Source, WINDOW, within};

/// Highest degree of the background's polynomial.
const DEGREE: usize = 7;
const CENTRE: usize = 0;
const FLUX: usize = 1;
const LN_WIDTH: usize = 2;
/// First coefficient of the background; those of degrees 1, 2, … follow.
const LEVEL: usize = 3;
/// Parameters of a stripe on a straight background, and on one of the highest degree.
const STRAIGHT: usize = LEVEL + 2;
const MOST: usize = LEVEL + 1 + DEGREE;

/// Half-length of the polynomials' unit, in widths.
const UNIT_WIDTHS: f64 = 8.0;
/// Of the scaled diagonal: keeps a nearly singular step finite without moving the solution.
const DAMPING: f64 = 1e-6;

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
    information: Symmetric<f64, MOST>,
    /// Parameters in use.
    size: usize,
    /// Origin and half-length of the background's polynomials, px.
    pivot: f64,
    unit: f64,
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

/// The background at a stripe's centre, DN, of polynomials with that origin and half-length.
fn background(at: &[f64], pivot: f64, unit: f64) -> f64 {
    let t = (at[CENTRE] - pivot) / unit;
    let (mut last, mut this, mut sum) = (t, 1.0, 0.0);
    for coefficient in &at[LEVEL..] {
        sum += coefficient * this;
        (last, this) = (this, 2.0 * t * this - last);
    }
    sum
}
