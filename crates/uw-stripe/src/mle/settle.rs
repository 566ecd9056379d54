//! The fit whose window suits the width that it finds.

use super::{Fit, Start, WidthPrior, fit};
use crate::NoiseModel;
use crate::lines::Line;
use crate::noise::Residual;

/// Half a fit's window, in widths plus pixels: the further it reaches, the less does a background cost the centre.
pub(crate) const WINDOW: (f64, f64) = (8.0, 1.0);
/// Fits, each with the window of the one before.
const ROUNDS: usize = 3;
/// Ratio of window wanted to window used within which a fit stands.
const WINDOW_FITS: std::ops::Range<f64> = 0.75..1.34;

/// What is thought of a stripe before it is fitted.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Seed {
    pub centre: f64,
    pub width: f64,
    /// DN · px.
    pub flux: f64,
    pub background: f64,
}

/// Fits, and fits again in the window of the width that was found; `window` gives the pixels within so many of a centre, the first and the
/// one after the last. A fit that ran out of its window is the last, and for the caller to judge.
pub(crate) fn settle(
    line: Line<'_>,
    noise: &NoiseModel,
    mut seed: Seed,
    prior: Option<WidthPrior>,
    mut residuals: Option<&mut Vec<Residual>>,
    window: impl Fn(f64, f64) -> (usize, usize),
) -> Option<Fit> {
    let mut best = None;
    for _ in 0..ROUNDS {
        let half = WINDOW.0 * seed.width + WINDOW.1;
        let (from, to) = window(seed.centre, half);
        if let Some(r) = residuals.as_deref_mut() {
            r.clear();
        }
        let Seed { centre, width, flux, background } = seed;
        let start = Start { centre, width, flux, background, from, to };
        let Some(fit) = fit(line, noise, start, prior, residuals.as_deref_mut()) else { break };
        best = Some(fit);
        let wanted = WINDOW.0 * fit.width + WINDOW.1;
        if WINDOW_FITS.contains(&(wanted / half)) || !(from as f64..to as f64).contains(&fit.centre) {
            break;
        }
        seed = Seed { centre: fit.centre, width: fit.width, flux: fit.flux, background: fit.background };
    }
    best
}
