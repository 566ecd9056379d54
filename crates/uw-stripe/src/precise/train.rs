//! Noise and width of the stripe, read off the image at hand.

use super::{Chosen, FIRST_LOOK_SNR, Precise, shape};
use crate::median::median;
use crate::mle::{Common, Fit, WidthPrior};
use crate::noise;
use crate::{NoiseModel, Pixel, StripeError, View};

/// Lines fitted for the estimate of noise and width; spread over the image.
const TRAINING_LINES: usize = 400;
/// Flux over its sigma from which a width is worth averaging, and where no line shows as much.
pub(super) const CLEAR: f64 = 15.0;
const FAINT: f64 = 5.0;
/// Measurements below which the noise stays as guessed.
const LEAST_TRAINING: usize = 12;
/// Sigma of ln width while single lines tell of the noise only: what they show as their width is a grain's.
const HELD: f64 = 0.05;

impl Precise {
    /// Noise and width of the stripe, px, from one image; `None` where it holds too little of one.
    pub fn learn<P: Pixel>(&mut self, image: View<'_, P>) -> Result<Option<(NoiseModel, f64)>, StripeError> {
        let full_scale = self.load(&image, None)?;
        let first = self.options.noise.unwrap_or_else(|| self.first_noise(full_scale));
        self.find(&first, FIRST_LOOK_SNR);
        let mut learned = self.train(first, full_scale, CLEAR);
        if learned.1.is_none() {
            learned = self.train(first, full_scale, FAINT);
        }
        let (noise, width) = learned;
        Ok(width.map(|w| (noise, w.ln_width.exp())))
    }

    /// The noise estimated from several images of one camera together: steadier than from each alone.
    ///
    /// # Errors
    /// As [`Extractor::extract`](crate::Extractor::extract), and [`StripeError::TooFewForNoise`] when the images hold too little of a stripe.
    pub fn estimate_noise<'a, P: Pixel>(
        &mut self,
        images: impl IntoIterator<Item = View<'a, P>>,
    ) -> Result<NoiseModel, StripeError> {
        let (mut pooled, mut full_scale, mut got) = (Vec::new(), 0.0f32, 0);
        let mut last = None;
        for image in images {
            let full = self.load(&image, None)?;
            full_scale = full_scale.max(full);
            let first = self.first_noise(full);
            self.find(&first, FIRST_LOOK_SNR);
            let (model, _) = self.train(first, full, CLEAR);
            got += self.widths.len();
            pooled.append(&mut self.residuals);
            last = Some(model);
        }
        match last {
            Some(model) if got >= LEAST_TRAINING => {
                Ok(noise::photon_transfer(&pooled, &NoiseModel { full_scale_dn: full_scale, ..model }))
            }
            _ => Err(StripeError::TooFewForNoise { needed: LEAST_TRAINING, got }),
        }
    }

    /// What the image's noise looks like before anything is known of it.
    pub(super) fn first_noise(&mut self, full_scale: f32) -> NoiseModel {
        let start = NoiseModel::start(full_scale);
        let seen = noise::background_noise(&self.lines, &mut self.scratch);
        // A floor that clips the dark shows no noise there; the guess stands in until the fits tell.
        NoiseModel { read_noise_dn: if seen > 0.0 { seen } else { start.read_noise_dn }, ..start }
    }

    /// Noise and typical width from the fits of lines spread over the image. Where speckle breaks single lines into grains, the width is that
    /// of many lines together, and `self.grain_reach` is set.
    pub(super) fn train(
        &mut self,
        first: NoiseModel,
        full_scale: f32,
        clear: f64,
    ) -> (NoiseModel, Option<WidthPrior>) {
        let first = NoiseModel { full_scale_dn: full_scale, ..first };
        let (noise, width) = self.rounds(first, clear, None);
        let Some(width) = width else { return (noise, None) };
        let Some(whole) = self.stacked_width(&noise, width) else { return (noise, Some(width)) };
        let held = WidthPrior { sigma: HELD, ..whole };
        let (noise, _) = self.rounds(first, clear, Some(held));
        self.grain_reach = 3.0 * whole.ln_width.exp();
        (noise, Some(whole))
    }

    /// The same from single lines, whose width may be held.
    fn rounds(
        &mut self,
        first: NoiseModel,
        clear: f64,
        held: Option<WidthPrior>,
    ) -> (NoiseModel, Option<WidthPrior>) {
        /// Rounds: the weights of the fits follow the noise that the last round found.
        const ROUNDS: usize = 3;
        /// A fit this many times worse than the median is not noise but another shape.
        const OUTLIER: f64 = 4.0;
        let (mut noise, mut explained) = (first, true);
        let used = self.choice.iter().flatten().count();
        let step = used.div_ceil(TRAINING_LINES).max(1);
        for _ in 0..ROUNDS {
            self.residuals.clear();
            self.widths.clear();
            let chosen = Chosen { lines: &self.lines, candidates: &self.candidates, choice: &self.choice };
            let mut place = 0;
            let seeds = (0..self.choice.len()).map(|i| {
                let candidate = chosen.candidate(i)?;
                let taken = place % step == 0;
                place += 1;
                taken.then(|| shape(self.lines.line(i), candidate, None))
            });
            let common = Common { noise: &noise, width: held };
            let residuals = self.fitter.fit_with_residuals(seeds, &chosen, common, &mut self.fits);
            let widest = f64::from(self.options.max_width_px);
            let clear = |f: &&Fit| {
                f.converged && f.flux > clear * f.sigma_flux && f.freedom > 1.0 && f.width < widest
            };
            let count = |clipped: bool| {
                self.fits.iter().flatten().filter(clear).filter(|f| (f.saturated > 0) == clipped).count()
            };
            // What is left of clipped stripes tells the noise, but the width less well.
            let whole = count(false) >= LEAST_TRAINING;
            if !whole && count(true) < LEAST_TRAINING {
                return (noise, None);
            }
            let used = |f: &&Fit| clear(f) && (f.saturated == 0) == whole;
            let excess = |f: &Fit| f.chi2 / f.freedom;
            let mut order: Vec<f64> = self.fits.iter().flatten().filter(used).map(excess).collect();
            let limit = OUTLIER * median(&mut order);
            for (fit, residuals) in self.fits.iter().zip(residuals) {
                let Some(fit) = fit.as_ref().filter(used).filter(|f| excess(f) <= limit) else { continue };
                self.residuals.extend_from_slice(residuals);
                if whole {
                    self.widths.push(fit.width.ln());
                }
            }
            explained = explained && noise::explains(&self.residuals, &noise);
            noise = match self.options.noise {
                None => noise::photon_transfer(&self.residuals, &noise),
                // Frames that tell a camera's noise do not tell the surface's speckle.
                Some(given) if given.speckle_contrast > 0.0 || explained => break,
                Some(_) => noise::photon_transfer(&self.residuals, &noise),
            };
        }
        (noise, width_prior(&mut self.widths))
    }
}

/// Median and robust spread of ln width, the spread widened so that a weak prior results.
pub(super) fn width_prior(ln_widths: &mut [f64]) -> Option<WidthPrior> {
    /// Widths change along a stripe by focus and slope; the sample may not show by how much.
    const LEAST_SIGMA: f64 = 0.25;
    /// MAD to sigma, doubled.
    const SPREAD: f64 = 2.0 * 1.4826;
    if ln_widths.len() < LEAST_TRAINING {
        return None;
    }
    let ln_width = median(ln_widths);
    let mut off: Vec<f64> = ln_widths.iter().map(|w| (w - ln_width).abs()).collect();
    Some(WidthPrior { ln_width, sigma: (SPREAD * median(&mut off)).max(LEAST_SIGMA) })
}
