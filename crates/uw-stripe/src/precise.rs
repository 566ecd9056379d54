//! Maximum likelihood of every line: image → lines → candidates → track → fits → verdicts.

use fearless_simd::Level;

use crate::bend::Bends;
use crate::edges::Edges;
use crate::lines::{Clip, Line, Lines};
use crate::lone::Lone;
use crate::mle::{self, Common, Fit, Fitter, Seed, Source, WidthPrior, within};
use crate::noise::{self, Residual};
use crate::peak::{Candidate, Candidates, Search};
use crate::profile::{Flags, Reject, Stripe};
use crate::scatter::{Centre, Scatter};
use crate::track::Tracker;
use crate::verdict;
use crate::{NoiseModel, Options, Pixel, StripeError, View};
use std::ops::Range;

pub(crate) mod several;
mod stack;
mod train;

/// Signal-to-noise ratio of a candidate worth a fit; the verdict falls on the fitted flux.
const CANDIDATE_SNR: f32 = 4.0;
/// The same where the noise is still a guess.
const FIRST_LOOK_SNR: f32 = 8.0;
/// Narrowest believable width, px: a point through a perfect lens still covers the pixel it falls on.
const NARROWEST_PX: f64 = 0.25;
/// Narrowest width that a fit starts from, px: a window that holds but the stripe's own pixels tells no background.
const NARROWEST_START_PX: f64 = 0.5;
/// Largest sigma in widths: beyond it there is no telling a stripe from the background's texture.
const LARGEST_SIGMA_IN_WIDTHS: f64 = 0.25;
/// A run needs as many members as [`verdict::LEAST_RUN`] with this many times the least signal-to-noise ratio.
const STRONG: f64 = 2.0;

/// The candidate that a line's fit started from, and the strongest other one's light by its own; 0: none.
#[derive(Debug, Clone, Copy)]
struct Taken {
    candidate: Candidate,
    rival: f32,
}

/// The likelihood path with its buffers; keeps nothing else from image to image, so that a result depends on its image alone.
#[derive(Debug)]
pub(crate) struct Precise {
    options: Options,
    level: Level,
    lines: Lines,
    search: Search,
    candidates: Vec<Candidates>,
    tracker: Tracker,
    choice: Vec<Option<usize>>,
    taken: Vec<Option<Taken>>,
    fitter: Fitter,
    fits: Vec<Option<Fit>>,
    shapes: Vec<Option<mle::surroundings::Shape>>,
    residuals: Vec<Residual>,
    widths: Vec<f64>,
    scratch: Vec<f32>,
    keep: Vec<bool>,
    snr: Vec<f64>,
    partial: Vec<usize>,
    edges: Edges,
    bends: Bends,
    scatter: Scatter,
    /// Distance, px, within which candidates are grains of one stripe; 0: none are.
    grain_reach: f64,
    /// Scatter by speckle, in widths, of the image at hand.
    speckle: f64,
    stripe: Stripe,
}

impl Precise {
    /// The path with the given settings, which have been checked.
    pub fn new(options: Options, level: Level) -> Self {
        Self {
            level,
            options,
            lines: Lines::default(),
            search: Search::new(level),
            candidates: Vec::new(),
            tracker: Tracker::default(),
            choice: Vec::new(),
            taken: Vec::new(),
            fitter: Fitter::new(level),
            fits: Vec::new(),
            shapes: Vec::new(),
            residuals: Vec::new(),
            widths: Vec::new(),
            scratch: Vec::new(),
            keep: Vec::new(),
            snr: Vec::new(),
            partial: Vec::new(),
            edges: Edges::default(),
            bends: Bends::default(),
            scatter: Scatter::default(),
            grain_reach: 0.0,
            speckle: 0.0,
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
        let (noise, width) = self.prepare(&image, background.as_ref())?;
        self.stripe.reset(self.options.axis, self.options.axis.lines(image.width(), image.height()));
        self.stripe.noise = noise;
        self.measure(&noise, width);
        std::mem::swap(&mut self.stripe, out);
        Ok(())
    }

    /// Loads the image, learns its noise and the stripe's width, and finds the candidates.
    fn prepare<P: Pixel>(
        &mut self,
        image: &View<'_, P>,
        background: Option<&View<'_, P>>,
    ) -> Result<(NoiseModel, Option<WidthPrior>), StripeError> {
        let full_scale = self.load(image, background)?;
        let (noise, width, found) = match self.options.noise {
            Some(noise) => {
                self.find(&noise, CANDIDATE_SNR);
                let (seen, width) = self.train(noise, full_scale, train::CLEAR);
                // Grains passed for candidates if it is another.
                (seen, width, seen == noise)
            }
            None => {
                let first = self.first_noise(full_scale);
                self.find(&first, FIRST_LOOK_SNR);
                let (noise, width) = self.train(first, full_scale, train::CLEAR);
                (noise, width, false)
            }
        };
        let known = self.known_width(width);
        let cleaned = known.map(|width| self.lines.clean(&Lone::new(&noise, width))).unwrap_or_default();
        if !found {
            self.find(&noise, CANDIDATE_SNR);
        } else if !cleaned.is_empty() {
            for line in cleaned {
                self.candidates[line] = self.candidates_of(line, &noise, CANDIDATE_SNR);
            }
            self.tracker.choose(&self.candidates, &mut self.choice);
        }
        Ok((noise, width))
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
        self.grain_reach = 0.0;
        Ok(full_scale)
    }

    /// Candidates of every line, and the choice among them.
    fn find(&mut self, noise: &NoiseModel, least_snr: f32) {
        self.candidates.clear();
        for i in 0..self.lines.count() {
            let found = self.candidates_of(i, noise, least_snr);
            self.candidates.push(found);
        }
        self.tracker.choose(&self.candidates, &mut self.choice);
    }

    /// Candidates of a line.
    fn candidates_of(&mut self, line: usize, noise: &NoiseModel, least_snr: f32) -> Candidates {
        // A box of three widths holds most of a stripe.
        let widest = (3.0 * self.options.max_width_px).ceil() as usize;
        let found = self.search.candidates(self.lines.line(line), noise, widest, least_snr);
        found.gathered(self.grain_reach)
    }

    /// Fits, judges and writes the result.
    fn measure(&mut self, noise: &NoiseModel, prior: Option<WidthPrior>) {
        let common = Common { noise, width: prior };
        let chosen = Chosen { lines: &self.lines, candidates: &self.candidates, choice: &self.choice };
        let known = self.known_width(prior);
        let seeds =
            (0..self.choice.len()).map(|i| Some(shape(self.lines.line(i), chosen.candidate(i)?, known)));
        self.fitter.fit(seeds, &chosen, common, &mut self.fits);
        self.taken.clear();
        for (candidates, k) in self.candidates.iter().zip(&self.choice) {
            let candidates = candidates.as_slice();
            self.taken.push(k.map(|k| {
                let other = candidates.iter().enumerate().find(|(j, _)| *j != k);
                let rival = other.map_or(0.0, |(_, c)| c.flux / candidates[k].flux);
                Taken { candidate: candidates[k], rival }
            }));
        }
        self.verdicts();
    }

    /// The width that fits start from. On a skirt of haze a line's own second moment is the skirt's, and so would be the window; where speckle
    /// breaks the stripe into grains it is the grain's, as it should be.
    fn known_width(&self, prior: Option<WidthPrior>) -> Option<f64> {
        prior.filter(|_| self.grain_reach == 0.0).map(|p| p.ln_width.exp())
    }

    /// Judges the fits, each for itself and with its neighbours, and writes the result.
    fn verdicts(&mut self) {
        mle::surroundings::share(&mut self.fits, &mut self.shapes);
        self.edges.load(self.fits.iter().map(|f| f.as_ref().map_or(f64::NAN, |f| f.flux)));
        let Self { fits, edges, scatter, .. } = self;
        self.speckle = scatter.of(
            self.level,
            fits.iter().enumerate().map(|(i, fit)| {
                let told = fit.as_ref().filter(|f| f.converged && f.saturated == 0 && edges.smooth(i));
                told.map(|f| Centre {
                    position: f.centre as f32,
                    sigma: f.sigma as f32,
                    width: f.width as f32,
                })
            }),
        );
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
        self.edges.drop_partial(&mut self.stripe, lines.clone(), &mut self.partial);
        self.bends.unbend(self.level, &mut self.stripe, lines);
    }

    /// Verdict on line `i` of the region, all but its company.
    fn judge(&mut self, i: usize) {
        let o = &self.options;
        let out = i + self.lines.first_line;
        let Some(Taken { candidate: taken, rival }) = self.taken[i] else {
            self.stripe.reject[out] = Some(Reject::NoSignal);
            return;
        };
        let Some(fit) = self.fits[i] else {
            self.stripe.reject[out] = Some(Reject::NotConverged);
            return;
        };
        let scale = verdict::chi2_scale(&fit);
        let edge = self.edges.lean(i, fit.width);
        let lean = edge.unwrap_or(0.0);
        let sigma = (fit.sigma.powi(2) * scale + (self.speckle * fit.width).powi(2) + lean * lean).sqrt();
        let mut flags = verdict::flags(&fit);
        let mut set = |flag, on| flags |= if on { flag } else { Flags::NONE };
        let length = self.lines.length as f64;
        set(Flags::SEVERAL_PEAKS, rival > 0.0);
        set(
            Flags::BORDER,
            fit.centre - 3.0 * fit.width < -0.5 || fit.centre + 3.0 * fit.width > length - 0.5,
        );
        set(Flags::EDGE, edge.is_some());
        let reach = taken.scale as f64 + 2.0 * fit.width;
        let line = self.lines.line(i);
        let level = fit.background.max(0.0) + line.pedestal(taken.centre) + line.light(taken.centre);
        let texture = texture(line, &fit, &mut self.scratch);
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
}

/// The lines with the candidates that were chosen.
#[derive(Debug, Clone, Copy)]
struct Chosen<'a> {
    lines: &'a Lines,
    candidates: &'a [Candidates],
    choice: &'a [Option<usize>],
}

impl Chosen<'_> {
    fn candidate(&self, line: usize) -> Option<&Candidate> {
        self.candidates[line].as_slice().get(self.choice[line]?)
    }
}

impl Source for Chosen<'_> {
    fn line(&self, k: usize) -> Line<'_> {
        self.lines.line(k)
    }

    fn window(&self, k: usize, centre: f64, half: f64) -> Range<usize> {
        let window = within(centre, half, self.lines.length);
        let own = self.candidate(k).map_or(0, |c| c.centre);
        apart(window, own, self.candidates[k].as_slice().iter().map(|c| c.centre))
    }
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

/// The window, stopped midway to the next of `others` on either side of its `own` candidate.
fn apart(window: Range<usize>, own: usize, others: impl Iterator<Item = usize>) -> Range<usize> {
    let Range { mut start, mut end } = window;
    for other in others {
        let sum = other + own;
        if other < own {
            start = start.max(sum.div_ceil(2));
        } else if other > own {
            end = end.min(sum / 2 + 1);
        }
    }
    start.min(end)..end
}

/// Where a fit starts: first and second moment of what rises above the surroundings in the best box, or the width that is known.
fn shape(line: Line<'_>, c: &Candidate, known: Option<f64>) -> Seed {
    let seed = |centre: f64, width: f64| Seed {
        centre,
        width: known.map_or(width, |known| known.max(NARROWEST_START_PX)),
        flux: f64::from(c.flux.max(f32::MIN_POSITIVE)),
        background: f64::from(c.background),
    };
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
        return seed(c.centre as f64, 1.0);
    }
    let mean = first / sum;
    let width = (second / sum - mean * mean - 1.0 / 12.0).max(0.0).sqrt().max(NARROWEST_START_PX);
    // A clipped plateau is flatter than the stripe below it.
    let width = if clipped > 0 { width.min(0.5 * clipped as f64 + 0.5) } else { width };
    seed(c.centre as f64 + mean, width)
}
