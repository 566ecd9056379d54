//! What every likelihood fit is judged by, whichever method asked for it.

use crate::mle::Fit;
use crate::profile::{Flags, Reject, Stripe};
use crate::track::keep_runs;
use std::ops::Range;

/// Reduced chi-square beyond which a fit is flagged as poor.
const POOR_CHI2: f64 = 4.0;
/// Skewness, in sigmas and absolute, beyond which a profile counts as lopsided.
const SKEW: (f64, f64) = (4.0, 0.25);
/// Degrees of freedom with which chi-square = 1 is believed before any pixel is seen.
const CHI2_PRIOR_FREEDOM: f64 = 6.0;
/// Lines that must agree with each other.
pub(crate) const LEAST_RUN: usize = 3;
/// Longest step between neighbours in a run: pixels plus widths.
const RUN_STEP: (f32, f32) = (3.0, 2.0);

/// Chi-square per degree of freedom, drawn towards 1 since a handful of pixels says little.
pub(crate) fn chi2_scale(fit: &Fit) -> f64 {
    (CHI2_PRIOR_FREEDOM + fit.chi2) / (CHI2_PRIOR_FREEDOM + fit.freedom)
}

/// What the fit itself tells.
pub(crate) fn flags(fit: &Fit) -> Flags {
    let mut flags = Flags::NONE;
    let mut set = |flag, on| flags |= if on { flag } else { Flags::NONE };
    set(Flags::SATURATED, fit.saturated > 0);
    set(Flags::NOT_CONVERGED, !fit.converged);
    set(Flags::POOR_FIT, fit.chi2 > POOR_CHI2 * fit.freedom.max(1.0));
    let lopsided = fit.skew_snr.abs() > SKEW.0 * chi2_scale(fit).sqrt() && fit.skew.abs() > SKEW.1;
    set(Flags::EDGE, lopsided);
    flags
}

/// Flux by the noise that would be there without a stripe, of `pixel` DN² a pixel, through the filter matched to its width: what
/// decides whether there is one is the chance of the background to look like it.
pub(crate) fn snr(fit: &Fit, pixel: f64) -> f64 {
    fit.flux / (pixel * 2.0 * std::f64::consts::PI.sqrt() * fit.width).sqrt()
}

/// Writes height, width, background and chi-square of a fit.
pub(crate) fn write(stripe: &mut Stripe, line: usize, fit: &Fit) {
    stripe.amplitude[line] = (fit.flux / (fit.width * (2.0 * std::f64::consts::PI).sqrt())) as f32;
    stripe.width_px[line] = fit.width as f32;
    stripe.background[line] = fit.background as f32;
    stripe.chi2[line] = (fit.chi2 / fit.freedom.max(1.0)) as f32;
}

/// Longest step from a line to the next within a stripe of that width, px.
pub(crate) fn run_reach(width_px: f32) -> f32 {
    RUN_STEP.0 + RUN_STEP.1 * width_px.max(0.0)
}

/// Takes out what no neighbours agree with: runs without enough members that are `strong`, which counts from the first of `lines`.
pub(crate) fn drop_lonely(
    stripe: &mut Stripe,
    lines: Range<usize>,
    strong: impl Fn(usize) -> bool,
    keep: &mut Vec<bool>,
) {
    let width = &stripe.width_px[lines.clone()];
    let least = LEAST_RUN.min(lines.len());
    keep_runs(&stripe.position_px[lines.clone()], |i| run_reach(width[i]), strong, least, keep);
    for (line, keep) in lines.zip(keep) {
        if !*keep && stripe.reject[line].is_none() {
            stripe.drop_line(line, Reject::Inconsistent);
        }
    }
}
