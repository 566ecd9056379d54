//! The extractor: one entry for every method.

use fearless_simd::Level;

use crate::engine::{AllBuffers, Engine, Job, Kind, Model};
use crate::options::{Method, Options};
use crate::pool::Pool;
use crate::precise::{Precise, median};
use crate::profile::{Reject, Stripe};
use crate::ridge::{Ridge, RidgePoint};
use crate::{NoiseModel, Pixel, StripeError, View};

/// Finds the stripe in one image after another, and keeps its buffers from image to image.
///
/// With [`Method::Precise`] a result depends on its image alone. The other methods learn noise and width from the first image that shows
/// enough of a stripe, unless [`Options::noise`] and [`Options::width_px`] give them, and keep them until [`Extractor::forget`]; until then,
/// and with a background image, they measure as `Precise` does. Give both, or [`Extractor::learn`] from one image beforehand, where results
/// must not depend on the order of the images.
///
/// # Examples
/// ```
/// use uw_stripe::{Extractor, Options, View};
/// // A stripe centred on column 20.25, two pixels wide, on 16 rows.
/// let pixels: Vec<u8> = (0..16 * 40)
///     .map(|i| (200.0 * (-0.125 * (f64::from(i % 40) - 20.25).powi(2)).exp()) as u8)
///     .collect();
/// let mut extractor = Extractor::new(Options::default())?;
/// let stripe = extractor.extract(View::packed(&pixels, 40, 16)?, None)?;
/// assert_eq!(stripe.found(), 16);
/// assert!(stripe.measurements().all(|m| (m.position_px - 20.25).abs() < 0.02));
/// # Ok::<(), uw_stripe::StripeError>(())
/// ```
#[derive(Debug)]
pub struct Extractor {
    options: Options,
    precise: Precise,
    /// Made for the noise and width at hand; `None`: not known yet.
    engine: Option<Engine>,
    /// Made for the width across the stripe, which the first stripe's slope tells.
    ridge: Option<Ridge>,
    candidates: Vec<Option<f32>>,
    points: Vec<Option<RidgePoint>>,
    pool: Pool,
    buffers: AllBuffers,
    stripe: Stripe,
    level: Level,
}

impl Extractor {
    /// An extractor with the given settings.
    ///
    /// # Errors
    /// [`StripeError::InvalidOption`] for a setting out of range.
    pub fn new(options: Options) -> Result<Self, StripeError> {
        Self::with_level(options, Level::new())
    }

    /// The same in the instructions of `level`.
    pub(crate) fn with_level(options: Options, level: Level) -> Result<Self, StripeError> {
        options.check()?;
        let mut extractor = Self {
            precise: Precise::new(options.clone()),
            options,
            engine: None,
            ridge: None,
            candidates: Vec::new(),
            points: Vec::new(),
            pool: Pool::default(),
            buffers: AllBuffers::default(),
            stripe: Stripe::empty(),
            level,
        };
        extractor.forget();
        Ok(extractor)
    }

    /// The settings.
    pub fn options(&self) -> &Options {
        &self.options
    }

    /// The stripe in `image`, one entry a line; `background` is an image of the same scene with the laser off.
    ///
    /// # Errors
    /// [`StripeError`] when background or region do not fit the image. An image without a stripe is no error: its lines
    /// are rejected with reasons.
    pub fn extract<P: Pixel>(
        &mut self,
        image: View<'_, P>,
        background: Option<View<'_, P>>,
    ) -> Result<&Stripe, StripeError> {
        P::extract(self, image, background)?;
        Ok(&self.stripe)
    }

    /// Fills `self.stripe`.
    pub(crate) fn extract_pixels<P: Pixel>(
        &mut self,
        image: View<'_, P>,
        background: Option<View<'_, P>>,
    ) -> Result<(), StripeError> {
        let kind = match self.options.method {
            Method::Fast => Kind::Fast,
            Method::Robust | Method::Ridge | Method::Precise => Kind::Robust,
            Method::Cog => Kind::Cog,
            Method::BlaisRioux => Kind::BlaisRioux,
        };
        let precise = self.options.method == Method::Precise || background.is_some();
        if precise || (self.engine.is_none() && !self.learn_pixels(image)?) {
            self.precise.extract(image, background, &mut self.stripe)?;
        } else {
            let roi = self.options.roi.unwrap_or(image.bounds()).check(image.width(), image.height())?;
            if let Some(engine) = &mut self.engine {
                let job = Job { image, roi, axis: self.options.axis, kind };
                engine.extract(job, self.options.track, P::buffers(&mut self.buffers), &mut self.stripe);
                if self.options.method == Method::Ridge {
                    let width = f64::from(engine.model().width_px);
                    let ridge = self.ridge.get_or_insert_with(|| Ridge::new(width / obliquity(&self.stripe)));
                    follow(ridge, &image, &mut self.candidates, &mut self.points, &mut self.stripe);
                }
            }
        }
        if let Some(sigma_lines) = self.options.pool_lines {
            let lines = 0..self.stripe.len();
            self.pool.apply(&mut self.stripe, lines, f64::from(sigma_lines), |_| POOLED_STEP_PX);
        }
        Ok(())
    }

    /// Learns noise and width, those that the settings do not give, from `image`; false where it shows too little of a stripe.
    ///
    /// # Errors
    /// [`StripeError`] when the region does not fit the image.
    pub fn learn<P: Pixel>(&mut self, image: View<'_, P>) -> Result<bool, StripeError> {
        P::learn(self, image)
    }

    pub(crate) fn learn_pixels<P: Pixel>(&mut self, image: View<'_, P>) -> Result<bool, StripeError> {
        let Some((noise, width)) = self.precise.learn(image)? else { return Ok(false) };
        self.set(noise, self.options.width_px.unwrap_or(width as f32));
        Ok(true)
    }

    /// Forgets what was learned from images.
    pub fn forget(&mut self) {
        (self.engine, self.ridge) = (None, None);
        if let (Some(noise), Some(width)) = (self.options.noise, self.options.width_px) {
            self.set(noise, width);
        }
    }

    /// Noise and width of the stripe, px, that the methods other than [`Method::Precise`] work with; `None`: not known yet.
    pub fn model(&self) -> Option<(NoiseModel, f32)> {
        self.engine.as_ref().map(|e| (e.model().noise, e.model().width_px))
    }

    fn set(&mut self, noise: NoiseModel, width_px: f32) {
        let o = &self.options;
        // Narrower than a pixel's own share, or wider than is allowed, no filter is matched to.
        let width_px = width_px.clamp(NARROWEST_PX, o.max_width_px.max(NARROWEST_PX));
        let (min_snr, max_sigma_px, max_width_px) = (o.min_snr, o.max_sigma_px, o.max_width_px);
        let model = Model { noise, width_px, min_snr, max_sigma_px, max_width_px };
        (self.engine, self.ridge) = (Some(Engine::new(self.level, model)), None);
    }

    /// The noise estimated from several images of one camera together: steadier than from each alone.
    ///
    /// # Errors
    /// As [`Extractor::extract`], and [`StripeError::TooFewForNoise`] when the images hold too little of a stripe.
    pub fn estimate_noise<'a, P: Pixel>(
        &mut self,
        images: impl IntoIterator<Item = View<'a, P>>,
    ) -> Result<NoiseModel, StripeError> {
        P::estimate_noise(self, &mut images.into_iter())
    }

    pub(crate) fn estimate_noise_pixels<'a, P: Pixel>(
        &mut self,
        images: &mut dyn Iterator<Item = View<'a, P>>,
    ) -> Result<NoiseModel, StripeError> {
        self.precise.estimate_noise(images)
    }
}

/// Replaces what the filters found by where the ridge next to it crosses each line; where there is nothing to pool, at the image's first and
/// last lines, it stands.
fn follow<P: Pixel>(
    ridge: &mut Ridge,
    image: &View<'_, P>,
    candidates: &mut Vec<Option<f32>>,
    points: &mut Vec<Option<RidgePoint>>,
    stripe: &mut Stripe,
) {
    candidates.clear();
    candidates.extend(stripe.position_px.iter().map(|p| (!p.is_nan()).then_some(*p)));
    ridge.follow(image, stripe.axis, candidates, &stripe.noise, points);
    for (line, point) in points.iter().enumerate().filter(|(i, _)| candidates[*i].is_some()) {
        if let Some(point) = point {
            stripe.position_px[line] = point.position as f32;
            stripe.sigma_px[line] = point.sigma as f32;
            stripe.amplitude[line] = point.amplitude as f32;
            stripe.background[line] = point.background as f32;
        } else if ridge.pools_at(line, points.len()) {
            stripe.drop_line(line, Reject::NotConverged);
        }
    }
}

/// Width along a line by that across the stripe: the median of √(1 + slope²) over the image.
fn obliquity(stripe: &Stripe) -> f64 {
    /// Lines over which a slope is told.
    const OVER: usize = 4;
    let slope = |p: &[f32]| f64::from((p[OVER] - p[0]) / OVER as f32);
    let mut all: Vec<f64> = stripe
        .position_px
        .windows(OVER + 1)
        .map(slope)
        .filter(|s| s.is_finite())
        .map(|s| s.hypot(1.0))
        .collect();
    if all.is_empty() { 1.0 } else { median(&mut all) }
}

/// Longest step from a line to the next that is pooled across, px.
const POOLED_STEP_PX: f32 = 5.0;
/// Narrowest width that filters are made for, px.
const NARROWEST_PX: f32 = 0.4;
