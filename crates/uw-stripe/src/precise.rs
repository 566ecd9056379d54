//! Maximum likelihood of every line: image → lines → candidates → track → fits → verdicts.

use crate::bend::unbend;
use crate::lines::{Clip, Line, Lines};
use crate::mle::{self, Fit, Start, WidthPrior};
use crate::noise::{self, Residual};
use crate::peak::{Candidate, Candidates, Search};
use crate::profile::{Flags, Reject, Stripe};
use crate::track::Tracker;
use crate::verdict::{self, run_reach};
use crate::{NoiseModel, Options, Pixel, StripeError, View};

/// Signal-to-noise ratio of a candidate worth a fit; the verdict falls on the fitted flux.
const CANDIDATE_SNR: f32 = 4.0;
/// The same where the noise is still a guess.
const FIRST_LOOK_SNR: f32 = 8.0;
/// Narrowest believable width, px: a point through a perfect lens still covers the pixel it falls on.
const NARROWEST_PX: f64 = 0.25;
/// Half a fit's window, in widths plus pixels: the further it reaches, the less does a background cost the centre.
pub(crate) const WINDOW: (f64, f64) = (8.0, 1.0);
/// Change of ln flux a line that counts as an albedo edge: at least this, and this many times the image's usual change.
const FLUX_STEP: (f64, f64) = (0.15, 4.0);
/// Lines within which two levels of flux count as an albedo edge's sides, their least ratio, and the ratio within which
/// a flux belongs to one of them (speckle alone scatters it by a quarter).
const LEVELS_REACH: usize = 12;
const LEVELS_APART: f64 = 3.0;
const LEVEL_MARGIN: f64 = 1.5;
/// Sigma, in widths, of the shift by an edge that the stripe runs along: a Gaussian cut at its middle has its mean at
/// 0.8 widths, and half of the width is the lens's.
const LEAN_BETWEEN_LEVELS: f64 = 0.4;
/// Within two lines of a stripe's end, the share of the flux further in below which only part of the beam met the surface.
const PARTIAL: f64 = 0.5;
/// Largest sigma in widths: beyond it there is no telling a stripe from the background's texture.
const LARGEST_SIGMA_IN_WIDTHS: f64 = 0.25;
/// A run needs as many members as [`verdict::LEAST_RUN`] with this many times the least signal-to-noise ratio.
const STRONG: f64 = 2.0;
/// Lines fitted for the estimate of noise and width; spread over the image.
const TRAINING_LINES: usize = 400;
/// Flux over its sigma from which a width is worth averaging, and where no line shows as much.
const CLEAR: f64 = 15.0;
const FAINT: f64 = 5.0;
/// Measurements below which the noise stays as guessed.
const LEAST_TRAINING: usize = 12;

/// The likelihood path with its buffers; keeps nothing else from image to image, so that a result depends on its image alone.
#[derive(Debug)]
pub(crate) struct Precise {
    options: Options,
    lines: Lines,
    search: Search,
    candidates: Vec<Candidates>,
    tracker: Tracker,
    choice: Vec<Option<usize>>,
    fits: Vec<Option<Fit>>,
    shapes: Vec<Option<mle::surroundings::Shape>>,
    residuals: Vec<Residual>,
    widths: Vec<f64>,
    scratch: Vec<f32>,
    keep: Vec<bool>,
    snr: Vec<f64>,
    partial: Vec<usize>,
    /// Scatter by speckle, in widths, and the usual change of ln flux a line, of the image at hand.
    speckle: f64,
    usual_step: f64,
    stripe: Stripe,
}

impl Precise {
    /// The path with the given settings, which have been checked.
    pub fn new(options: Options) -> Self {
        Self {
            options,
            lines: Lines::default(),
            search: Search::default(),
            candidates: Vec::new(),
            tracker: Tracker::default(),
            choice: Vec::new(),
            fits: Vec::new(),
            shapes: Vec::new(),
            residuals: Vec::new(),
            widths: Vec::new(),
            scratch: Vec::new(),
            keep: Vec::new(),
            snr: Vec::new(),
            partial: Vec::new(),
            speckle: 0.0,
            usual_step: 0.0,
            stripe: Stripe::empty(),
        }
    }

    /// Fills `out` with the stripe in `image`, one entry a line; `background` is an image of the same scene with the laser off.
    ///
    /// # Errors
    /// [`StripeError`] when background or region do not fit the image. An image without a stripe is no error: its lines
    /// are rejected with reasons.
    pub fn extract<P: Pixel>(
        &mut self,
        image: View<'_, P>,
        background: Option<View<'_, P>>,
        out: &mut Stripe,
    ) -> Result<(), StripeError> {
        let full_scale = self.load(&image, background.as_ref())?;
        let (noise, width) = match self.options.noise {
            Some(noise) => {
                self.find(&noise, CANDIDATE_SNR);
                let (seen, width) = self.train(noise, full_scale, CLEAR);
                if seen != noise {
                    // Grains passed for candidates.
                    self.find(&seen, CANDIDATE_SNR);
                }
                (seen, width)
            }
            None => {
                let first = self.first_noise(full_scale);
                self.find(&first, FIRST_LOOK_SNR);
                let (noise, width) = self.train(first, full_scale, CLEAR);
                self.find(&noise, CANDIDATE_SNR);
                (noise, width)
            }
        };
        self.stripe.reset(self.options.axis, self.options.axis.lines(image.width(), image.height()));
        self.stripe.noise = noise;
        self.measure(&noise, width);
        std::mem::swap(&mut self.stripe, out);
        Ok(())
    }

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
    /// As [`Extractor::extract`], and [`StripeError::TooFewForNoise`] when the images hold too little of a stripe.
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

    /// Checks and loads the image; gives the clipping value.
    fn load<P: Pixel>(
        &mut self,
        image: &View<'_, P>,
        background: Option<&View<'_, P>>,
    ) -> Result<f32, StripeError> {
        if let Some(b) = background.filter(|b| (b.width(), b.height()) != (image.width(), image.height())) {
            return Err(StripeError::BackgroundSize {
                needed_width: image.width(),
                needed_height: image.height(),
                got_width: b.width(),
                got_height: b.height(),
            });
        }
        let roi = self.options.roi.unwrap_or(image.bounds()).check(image.width(), image.height())?;
        let full_scale =
            self.options.noise.map(|n| n.full_scale_dn).or(self.options.full_scale_dn).unwrap_or_else(|| {
                let rows = roi.y..roi.y + roi.height;
                let row =
                    |y| image.row(y)[roi.x..roi.x + roi.width].iter().map(|p| p.dn()).fold(0.0, f32::max);
                noise::full_scale(P::MAX_DN, rows.map(row).fold(0.0, f32::max))
            });
        self.lines.load(image, background, roi, self.options.axis, full_scale);
        Ok(full_scale)
    }

    fn first_noise(&mut self, full_scale: f32) -> NoiseModel {
        let start = NoiseModel::start(full_scale);
        let seen = noise::background_noise(&self.lines, &mut self.scratch);
        // A floor that clips the dark shows no noise there; the guess stands in until the fits tell.
        NoiseModel { read_noise_dn: if seen > 0.0 { seen } else { start.read_noise_dn }, ..start }
    }

    /// Candidates of every line, and the choice among them.
    fn find(&mut self, noise: &NoiseModel, least_snr: f32) {
        // A box of three widths holds most of a stripe.
        let widest = (3.0 * self.options.max_width_px).ceil() as usize;
        self.candidates.clear();
        for i in 0..self.lines.count() {
            self.candidates.push(self.search.candidates(self.lines.line(i), noise, widest, least_snr));
        }
        self.tracker.choose(&self.candidates, &mut self.choice);
    }

    /// Noise and typical width from the fits of lines spread over the image.
    fn train(&mut self, first: NoiseModel, full_scale: f32, clear: f64) -> (NoiseModel, Option<WidthPrior>) {
        /// Rounds: the weights of the fits follow the noise that the last round found.
        const ROUNDS: usize = 3;
        /// A fit this many times worse than the median is not noise but another shape.
        const OUTLIER: f64 = 4.0;
        let (mut noise, mut explained) = (NoiseModel { full_scale_dn: full_scale, ..first }, true);
        let used = self.choice.iter().flatten().count();
        let step = used.div_ceil(TRAINING_LINES).max(1);
        for _ in 0..ROUNDS {
            self.residuals.clear();
            self.widths.clear();
            let mut fits: Vec<(f64, Vec<Residual>, f64)> = Vec::new();
            for (i, k) in self.choice.iter().enumerate().filter_map(|(i, k)| k.map(|k| (i, k))).step_by(step)
            {
                let line = self.lines.line(i);
                let mut residuals = Vec::new();
                let fit = refine(line, &noise, &self.candidates[i], k, None, Some(&mut residuals));
                let Some(fit) =
                    fit.filter(|f| f.converged && f.saturated == 0 && f.flux > clear * f.sigma_flux)
                else {
                    continue;
                };
                if fit.freedom > 1.0 && fit.width < f64::from(self.options.max_width_px) {
                    fits.push((fit.chi2 / fit.freedom, residuals, fit.width.ln()));
                }
            }
            if fits.len() < LEAST_TRAINING {
                return (noise, None);
            }
            let mut order: Vec<f64> = fits.iter().map(|f| f.0).collect();
            let limit = OUTLIER * median(&mut order);
            for (_, residuals, ln_width) in fits.into_iter().filter(|f| f.0 <= limit) {
                self.residuals.extend(residuals);
                self.widths.push(ln_width);
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

    /// Fits, judges and writes the result.
    fn measure(&mut self, noise: &NoiseModel, prior: Option<WidthPrior>) {
        self.fits.clear();
        for (i, k) in self.choice.iter().enumerate() {
            let line = self.lines.line(i);
            self.fits.push(k.and_then(|k| refine(line, noise, &self.candidates[i], k, prior, None)));
        }
        mle::surroundings::share(&mut self.fits, &mut self.shapes);
        self.usual_step = self.usual_step();
        self.speckle = self.speckle();
        self.stripe.scatter_widths = self.speckle as f32;
        self.snr.clear();
        self.snr.resize(self.fits.len(), 0.0);
        for i in 0..self.fits.len() {
            self.judge(i);
        }
        let lines = self.lines.first_line..self.lines.first_line + self.fits.len();
        let strong = |i: usize| self.snr[i] >= STRONG * f64::from(self.options.min_snr);
        verdict::drop_lonely(&mut self.stripe, lines.clone(), strong, &mut self.keep);
        // All ends first, then out with them, lest an end be eaten up line by line.
        let reach = |i: usize| run_reach(self.stripe.width_px[i]);
        let mut partial = std::mem::take(&mut self.partial);
        partial.clear();
        partial
            .extend(lines.clone().filter(|&i| self.stripe.reject[i].is_none() && self.partial(i, reach(i))));
        for &i in &partial {
            self.stripe.drop_line(i, Reject::Edge);
        }
        self.partial = partial;
        unbend(&mut self.stripe, lines);
    }

    /// Verdict on line `i` of the region, all but its company.
    fn judge(&mut self, i: usize) {
        let o = &self.options;
        let out = i + self.lines.first_line;
        let Some(k) = self.choice[i] else {
            self.stripe.reject[out] = Some(Reject::NoSignal);
            return;
        };
        let candidates = self.candidates[i].as_slice();
        let taken = candidates[k];
        let rival =
            candidates.iter().enumerate().find(|(j, _)| *j != k).map_or(0.0, |(_, c)| c.flux / taken.flux);
        let Some(fit) = self.fits[i] else {
            self.stripe.reject[out] = Some(Reject::NotConverged);
            return;
        };
        let scale = verdict::chi2_scale(&fit);
        let step = self.flux_step(i);
        let edge = step > self.edge_step();
        // Light of which the surface sends back more on one side moves the centre by width² · d ln(albedo)/dx. The change
        // across is not seen; along the stripe it is, and an edge may run either way. About half the width is the lens's,
        // which moves nothing.
        let along = if edge { 0.5 * fit.width * fit.width * step.min(1.0 / fit.width) } else { 0.0 };
        let between = self.between_levels(i);
        let lean = if between { along.max(LEAN_BETWEEN_LEVELS * fit.width) } else { along };
        let sigma = (fit.sigma.powi(2) * scale + (self.speckle * fit.width).powi(2) + lean * lean).sqrt();
        let mut flags = verdict::flags(&fit);
        let mut set = |flag, on| flags |= if on { flag } else { Flags::NONE };
        let length = self.lines.length as f64;
        set(Flags::SEVERAL_PEAKS, rival > 0.0);
        set(
            Flags::BORDER,
            fit.centre - 3.0 * fit.width < -0.5 || fit.centre + 3.0 * fit.width > length - 0.5,
        );
        set(Flags::EDGE, edge || between);
        let reach = taken.scale as f64 + 2.0 * fit.width;
        let level = fit.background.max(0.0) + self.lines.line(i).pedestal(taken.centre);
        let texture = texture(self.lines.line(i), &fit, &mut self.scratch);
        let pixel = self.stripe.noise.variance(level, 0.0).max(texture * texture);
        let snr = verdict::snr(&fit, pixel);
        self.snr[i] = snr;
        let reject = if (fit.centre - taken.centre as f64).abs() > reach {
            Some(Reject::NotConverged)
        } else if snr < f64::from(o.min_snr) {
            Some(if fit.saturated > 0 { Reject::Saturated } else { Reject::BelowThreshold })
        } else if fit.width > f64::from(o.max_width_px) {
            Some(Reject::TooWide)
        } else if fit.width < NARROWEST_PX {
            Some(Reject::TooNarrow)
        } else if fit.centre - fit.width < -0.5 || fit.centre + fit.width > length - 0.5 {
            Some(Reject::AtBorder)
        } else if sigma > f64::from(o.max_sigma_px)
            || fit.sigma * scale.sqrt() > LARGEST_SIGMA_IN_WIDTHS * fit.width
        {
            Some(if fit.saturated > 0 { Reject::Saturated } else { Reject::Imprecise })
        } else if o.reject_edges && flags.contains(Flags::EDGE) {
            Some(Reject::Edge)
        } else {
            None
        };
        let s = &mut self.stripe;
        if reject.is_none() {
            s.position_px[out] = (fit.centre + self.lines.first_pixel as f64) as f32;
        }
        s.reject[out] = reject;
        s.flags[out] = flags;
        s.rival_ratio[out] = rival;
        s.sigma_px[out] = sigma as f32;
        verdict::write(s, out, &fit);
    }

    /// Flux of the fit on a line of the region, if there is one.
    fn flux(&self, line: Option<usize>) -> Option<f64> {
        self.fits.get(line?)?.as_ref().map(|f| f.flux)
    }

    /// Largest change of ln flux a line, over two lines to either side; 0 without neighbours.
    fn flux_step(&self, i: usize) -> f64 {
        const REACH: usize = 2;
        let Some(here) = self.flux(Some(i)) else { return 0.0 };
        let change = |j| self.flux(j).map_or(0.0, |f| (f / here).ln().abs() / REACH as f64);
        change(i.checked_sub(REACH)).max(change(Some(i + REACH)))
    }

    /// Change of ln flux a line that counts as an edge in the image at hand.
    fn edge_step(&self) -> f64 {
        FLUX_STEP.0.max(FLUX_STEP.1 * self.usual_step)
    }

    /// True where the flux lies well between two levels that the stripe has nearby: it runs along an albedo edge, which
    /// shifts its centre without any sudden change.
    fn between_levels(&self, i: usize) -> bool {
        let Some(here) = self.flux(Some(i)) else { return false };
        let nearby = i.saturating_sub(LEVELS_REACH)..(i + LEVELS_REACH + 1).min(self.fits.len());
        let (low, high) = nearby
            .filter_map(|j| self.flux(Some(j)))
            .fold((f64::INFINITY, 0.0f64), |(low, high), f| (low.min(f), high.max(f)));
        high > LEVELS_APART * low && here > LEVEL_MARGIN * low && here * LEVEL_MARGIN < high
    }

    /// True at the end of a run where its light falls off: the beam's other part went past the surface. `line` is the
    /// image's, `reach` the longest step a line within a run, px.
    fn partial(&self, line: usize, reach: f32) -> bool {
        let here = self.stripe.position_px[line];
        let flux = |j: usize| self.flux(j.checked_sub(self.lines.first_line)).unwrap_or(0.0);
        // NaN, a line without a position, is never near.
        let inside = |j: Option<usize>, gap: f32| {
            let near =
                |j: &usize| self.stripe.position_px.get(*j).is_some_and(|p| (p - here).abs() <= gap * reach);
            j.filter(near).map(flux)
        };
        let pair = |a, b| Some(inside(a, 1.0)?.max(inside(b, 2.0)?));
        let before = pair(line.checked_sub(1), line.checked_sub(2));
        match (before, pair(Some(line + 1), Some(line + 2))) {
            (Some(inside), None) | (None, Some(inside)) => flux(line) < PARTIAL * inside,
            _ => false,
        }
    }

    /// Scatter of the centres along the stripe beyond the fits' own sigmas, in widths: what speckle (whose grains the
    /// lens spreads over several pixels, so that residuals hardly show it) does to a centre.
    ///
    /// Third differences at a spacing of two lines, in which slope and curvature of the surface and the grains' extent
    /// along the stripe drop out; the factor is the one that brings their median to that of a normal distribution.
    fn speckle(&self) -> f64 {
        /// Squares of the third difference's coefficients 1, −3, 3, −1.
        const WEIGHTS: [f64; 4] = [1.0, 9.0, 9.0, 1.0];
        const SPACING: usize = 2;
        /// Median of |N(0, 1)|.
        const MEDIAN_ABS: f64 = 0.6745;
        /// Differences below which the scatter is not known, and the excess in its own sigmas that counts.
        const LEAST: usize = 20;
        const SIGNIFICANT: f64 = 2.0;
        /// Halvings of the interval [0, 1] widths.
        const HALVINGS: usize = 20;
        let smooth: Vec<bool> = (0..self.fits.len())
            .map(|i| self.fits[i].is_some() && self.flux_step(i) <= self.edge_step())
            .collect();
        let mut differences = Vec::new();
        for i in 0..self.fits.len().saturating_sub(3 * SPACING) {
            let at =
                [0, 1, 2, 3].map(|k| self.fits[i + k * SPACING].filter(|f| f.converged && f.saturated == 0));
            let [Some(a), Some(b), Some(c), Some(d)] = at else { continue };
            let four = [a, b, c, d];
            let close = four
                .windows(2)
                .all(|p| (p[0].centre - p[1].centre).abs() < SPACING as f64 * f64::from(run_reach(0.0)));
            if close && smooth[i..=i + 3 * SPACING].iter().all(|s| *s) {
                let difference = a.centre - 3.0 * b.centre + 3.0 * c.centre - d.centre;
                let sum =
                    |value: fn(&Fit) -> f64| four.iter().zip(WEIGHTS).map(|(f, w)| w * value(f)).sum::<f64>();
                differences.push((difference, sum(|f| f.sigma * f.sigma), sum(|f| f.width * f.width)));
            }
        }
        let count = differences.len();
        if count < LEAST {
            return 0.0;
        }
        let ratio = |k: f64| {
            let mut r: Vec<f64> =
                differences.iter().map(|(d, s, w)| d.abs() / (s + k * k * w).sqrt()).collect();
            median(&mut r) / MEDIAN_ABS
        };
        // The relative sigma of a median absolute deviation is 1.17 / √(2 n) for n independent ones; four share a centre.
        if ratio(0.0) < 1.0 + SIGNIFICANT * 1.17 * (2.0 / count as f64).sqrt() {
            return 0.0;
        }
        let (mut low, mut high) = (0.0, 1.0);
        for _ in 0..HALVINGS {
            let middle = 0.5 * (low + high);
            if ratio(middle) > 1.0 { low = middle } else { high = middle }
        }
        0.5 * (low + high)
    }

    /// Median change of ln flux a line: texture and speckle of the surface at hand.
    fn usual_step(&self) -> f64 {
        let mut steps: Vec<f64> =
            (0..self.fits.len()).map(|i| self.flux_step(i)).filter(|s| *s > 0.0).collect();
        median(&mut steps)
    }
}

/// Fit of candidate `k` of a line, its window adapted to the width found.
fn refine(
    line: Line<'_>,
    noise: &NoiseModel,
    candidates: &Candidates,
    k: usize,
    prior: Option<WidthPrior>,
    mut residuals: Option<&mut Vec<Residual>>,
) -> Option<Fit> {
    /// Fits with the window of the one before.
    const ROUNDS: usize = 3;
    /// Ratio of window wanted to window used within which the fit stands.
    const WINDOW_FITS: std::ops::Range<f64> = 0.75..1.34;
    let taken = *candidates.as_slice().get(k)?;
    let (centre, mut width) = shape(line, &taken, prior);
    let mut start = Start {
        centre,
        width,
        flux: f64::from(taken.flux.max(f32::MIN_POSITIVE)),
        background: f64::from(taken.background),
        from: 0,
        to: 0,
    };
    let mut best = None;
    for _ in 0..ROUNDS {
        let half = WINDOW.0 * width + WINDOW.1;
        (start.from, start.to) = window(start.centre, half, candidates, k, line.value.len());
        if let Some(r) = residuals.as_deref_mut() {
            r.clear();
        }
        let Some(fit) = mle::fit(line, noise, start, prior, residuals.as_deref_mut()) else { break };
        best = Some(fit);
        let wanted = WINDOW.0 * fit.width + WINDOW.1;
        // A fit that ran out of its window is judged as it is.
        if WINDOW_FITS.contains(&(wanted / half))
            || !(start.from as f64..start.to as f64).contains(&fit.centre)
        {
            break;
        }
        width = fit.width;
        start = Start { centre: fit.centre, width, flux: fit.flux, background: fit.background, ..start };
    }
    best
}

/// Scatter of the line around a stripe, DN: what haze adds to the camera's noise. 0 without enough pixels.
///
/// From the 85th percentile above the median, which a floor that clips the dark half, or another stripe, leaves alone.
fn texture(line: Line<'_>, fit: &Fit, values: &mut Vec<f32>) -> f64 {
    /// Pixels looked at on either side, and how many are enough.
    const REACH: f64 = 40.0;
    const LEAST: usize = 16;
    const UPPER: f64 = 0.85;
    /// The same percentile of the normal distribution.
    const UPPER_NORMAL: f64 = 1.036;
    let length = line.value.len();
    let at = |x: f64| (x.round().max(0.0) as usize).min(length);
    let own = 4.0 * fit.width + 1.0;
    values.clear();
    values.extend_from_slice(&line.value[at(fit.centre - own - REACH)..at(fit.centre - own)]);
    values.extend_from_slice(&line.value[at(fit.centre + own)..at(fit.centre + own + REACH)]);
    if values.len() < LEAST {
        return 0.0;
    }
    values.sort_unstable_by(f32::total_cmp);
    let upper = values[(UPPER * (values.len() - 1) as f64).round() as usize];
    f64::from(upper - values[values.len() / 2]) / UPPER_NORMAL
}

/// Pixels within `half` of the centre, stopped midway to the next candidate on either side.
fn window(centre: f64, half: f64, candidates: &Candidates, k: usize, length: usize) -> (usize, usize) {
    let (mut low, mut high) = (centre - half, centre + half);
    let own = candidates.as_slice()[k];
    for other in candidates.as_slice().iter().filter(|c| c.centre != own.centre) {
        let middle = 0.5 * (other.centre + own.centre) as f64;
        if other.centre < own.centre {
            low = low.max(middle);
        } else {
            high = high.min(middle);
        }
    }
    let from = low.ceil().max(0.0) as usize;
    let to = (high.floor().max(-1.0) + 1.0) as usize;
    (from.min(length), to.min(length))
}

/// Centre and width to start from: first and second moment of what rises above the surroundings in the best box.
fn shape(line: Line<'_>, c: &Candidate, prior: Option<WidthPrior>) -> (f64, f64) {
    let half = c.scale / 2;
    let (from, to) = (c.centre.saturating_sub(half), (c.centre + half + 1).min(line.value.len()));
    let (mut sum, mut first, mut second) = (0.0, 0.0, 0.0);
    let mut clipped = 0;
    for i in from..to {
        let v = f64::from(line.value[i] - c.background).max(0.0);
        let d = i as f64 - c.centre as f64;
        clipped += usize::from(line.clip[i] == Clip::Full);
        sum += v;
        first += v * d;
        second += v * d * d;
    }
    if sum <= 0.0 {
        return (c.centre as f64, prior.map_or(1.0, |p| p.ln_width.exp()));
    }
    let mean = first / sum;
    let width = (second / sum - mean * mean - 1.0 / 12.0).max(0.25).sqrt();
    // A clipped plateau is flatter than the stripe below it.
    let width = if clipped > 0 { width.min(0.5 * clipped as f64 + 0.5) } else { width };
    (c.centre as f64 + mean, width)
}

/// Median and robust spread of ln width, the spread widened so that a weak prior results.
fn width_prior(ln_widths: &mut [f64]) -> Option<WidthPrior> {
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

/// Upper median; 0 for an empty slice.
pub(crate) fn median(values: &mut [f64]) -> f64 {
    if values.is_empty() {
        return 0.0;
    }
    let middle = values.len() / 2;
    *values.select_nth_unstable_by(middle, f64::total_cmp).1
}
