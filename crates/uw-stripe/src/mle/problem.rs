//! What one line asks of a fit: window, start and what is known beforehand.

use super::{CENTRE, FLUX, LEVEL, LN_WIDTH, STRAIGHT, UNIT_WIDTHS, WidthPrior};
use crate::NoiseModel;
use crate::lines::{Clip, Line};
use std::ops::Range;

/// Half a window, in widths, from which a background of this degree is told from the stripe: it then costs the centre about 5 % in
/// variance by degree 3, and 15 % by degree 5, before the neighbours help (`surroundings`).
const DEGREES: [(f64, usize); 3] = [(7.0, 7), (5.5, 5), (0.0, 1)];
/// Share of floored pixels in the window above which a background's curvature is not seen.
const FLOORED: f64 = 0.3;
/// Half of the window for the first iterations, in widths plus pixels: there any background is nearly straight, and most of what the pixels
/// say is said.
const CLOSE: (f64, f64) = (3.2, 2.5);

/// Where a fit starts.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Seed {
    pub centre: f64,
    pub width: f64,
    /// DN · px.
    pub flux: f64,
    pub background: f64,
}

/// Means of what is known beforehand, and their inverse variances.
#[derive(Debug, Clone, Copy)]
pub(super) struct Prior {
    pub level: f64,
    /// Of the level and of what bends; of the slope.
    pub level_weight: f64,
    pub slope_weight: f64,
    pub ln_width: f64,
    pub ln_width_weight: f64,
}

#[derive(Debug, Clone)]
pub(super) struct Problem {
    pub seed: Seed,
    /// The pixels of the window, and those close to the stripe.
    pub window: Range<usize>,
    pub close: Range<usize>,
    /// Parameters that the window could tell.
    pub full: usize,
    /// Half-length of the background's polynomials, px.
    pub unit: f64,
    pub prior: Prior,
}

impl Problem {
    /// `None` where the window or the seed cannot carry a fit.
    pub fn new(
        line: Line<'_>,
        noise: &NoiseModel,
        seed: Seed,
        window: Range<usize>,
        width: Option<WidthPrior>,
    ) -> Option<Self> {
        let pixels = window.len();
        let usable = pixels >= 3
            && window.end <= line.value.len()
            && seed.flux > 0.0
            && seed.width > 0.0
            && seed.centre.is_finite()
            && seed.background.is_finite();
        if !usable {
            return None;
        }
        let half = (seed.centre - window.start as f64).min(window.end as f64 - 1.0 - seed.centre);
        let floored = line.clip[window.clone()].iter().filter(|c| **c == Clip::Floor).count();
        let degree = if floored as f64 > FLOORED * pixels as f64 {
            1
        } else {
            DEGREES.iter().find(|d| half >= d.0 * seed.width).map_or(1, |d| d.1)
        };
        let reach = CLOSE.0 * seed.width + CLOSE.1;
        let mut close = window.start.max((seed.centre - reach).ceil().max(0.0) as usize)
            ..window.end.min((seed.centre + reach).floor().max(0.0) as usize + 1);
        if close.end < close.start + STRAIGHT {
            close = window.clone();
        }
        // Weak priors that decide only where the floor hides the background: it lies within a few sigmas, or a tenth of
        // the peak, of the surroundings.
        let peak = seed.flux / (seed.width * (2.0 * std::f64::consts::PI).sqrt());
        let level = seed.background.max(0.0) + line.pedestal(window.start);
        let slack = 3.0 * noise.variance(level, 0.0).sqrt() + 0.1 * peak;
        let unit = UNIT_WIDTHS * width.map_or(seed.width, |w| w.ln_width.exp());
        let prior = Prior {
            level: seed.background,
            level_weight: slack.powi(-2),
            // A slope's slack is the same over the window, whatever its length.
            slope_weight: (slack * unit / pixels as f64).powi(-2),
            ln_width: width.map_or(0.0, |w| w.ln_width),
            ln_width_weight: width.map_or(0.0, |w| w.sigma.powi(-2)),
        };
        Some(Self { seed, window, close, full: LEVEL + 1 + degree, unit, prior })
    }

    /// The parameters to start from, of a stripe on a straight background.
    pub fn start(&self) -> [f64; STRAIGHT] {
        let mut start = [0.0; STRAIGHT];
        (start[CENTRE], start[FLUX], start[LN_WIDTH], start[LEVEL]) =
            (self.seed.centre, self.seed.flux, self.seed.width.ln(), self.seed.background);
        start
    }
}
