//! The extractor: one entry for every method.

use fearless_simd::{Level, dispatch};

use crate::engine::{AllBuffers, Engine, Job, Kind, Model};
use crate::median::median_of_known;
use crate::options::{Method, Options};
use crate::pool::Pool;
use crate::precise::Precise;
use crate::profile::{Flags, Reject, Stripe};
use crate::ridge::Ridge;
use crate::{NoiseModel, Pixel, StripeError, View};

/// Finds the stripe in one image after another, and keeps its buffers from image to image.
///
/// With [`Method::Precise`] a result depends on its image alone; it, and [`Extractor::extract_all`], take memory anew while they learn an
/// image's noise and tell stripes apart. The other methods learn noise and width from the first image that shows
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
    /// Made for the width across the stripe, px, which the stripe's slope tells.
    ridge: Option<(f64, Ridge)>,
    slopes: Slopes,
    pool: Pool,
    buffers: AllBuffers,
    stripe: Stripe,
    stripes: Vec<Stripe>,
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
            precise: Precise::new(options.clone(), level),
            options,
            engine: None,
            ridge: None,
            slopes: Slopes::default(),
            pool: Pool::default(),
            buffers: AllBuffers::default(),
            stripe: Stripe::empty(),
            stripes: Vec::new(),
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

    /// The [`Options::stripes`] stripes of most light in `image`, each with one entry a line. Where stripes cross, a rank goes on with one of them:
    /// the first need not be the brightest on every line, and stripes that are about as bright may be lost behind their crossing.
    ///
    /// A rank follows one physical stripe as far as its neighbours say so: stripes that cross go on as they pointed, one that breaks off and
    /// goes on nearby keeps its rank, and one that ends leaves its rank free. Stripes of equal strength that cross may lose the lines after the
    /// crossing. Lines on which two are too near to be told apart are
    /// rejected in both ([`Reject::Merged`]). Whatever the method, each line is measured by maximum likelihood, all stripes of it together;
    /// every stripe has its own speckle scatter, and `rival_ratio` is that of the strongest of the others.
    ///
    /// # Errors
    /// As [`Extractor::extract`].
    ///
    /// # Examples
    /// ```
    /// use uw_stripe::{Extractor, Options, View};
    /// // Two stripes on 16 rows: at column 20.25, and half as bright at 60.5.
    /// let bell = |x: f64, at: f64| (-0.125 * (x - at).powi(2)).exp();
    /// let pixels: Vec<u8> = (0..16 * 80)
    ///     .map(|i| f64::from(i % 80))
    ///     .map(|x| (200.0 * bell(x, 20.25) + 100.0 * bell(x, 60.5)) as u8)
    ///     .collect();
    /// let mut extractor = Extractor::new(Options { stripes: 2, ..Options::default() })?;
    /// let stripes = extractor.extract_all(View::packed(&pixels, 80, 16)?, None)?;
    /// assert!(stripes[0].measurements().all(|m| (m.position_px - 20.25).abs() < 0.02));
    /// assert!(stripes[1].measurements().all(|m| (m.position_px - 60.5).abs() < 0.02));
    /// # Ok::<(), uw_stripe::StripeError>(())
    /// ```
    pub fn extract_all<P: Pixel>(
        &mut self,
        image: View<'_, P>,
        background: Option<View<'_, P>>,
    ) -> Result<&[Stripe], StripeError> {
        P::extract_all(self, image, background)?;
        Ok(&self.stripes)
    }

    /// Fills `self.stripes`.
    pub(crate) fn extract_all_pixels<P: Pixel>(
        &mut self,
        image: View<'_, P>,
        background: Option<View<'_, P>>,
    ) -> Result<(), StripeError> {
        self.precise.extract_all(image, background, self.options.stripes, &mut self.stripes)?;
        for stripe in &mut self.stripes {
            finish(&self.options, &mut self.pool, stripe);
        }
        Ok(())
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
                let buffers = P::buffers(&mut self.buffers);
                engine.extract(job, self.options.track, buffers, &mut self.stripe);
                if self.options.method == Method::Ridge {
                    let width = f64::from(engine.model().width_px);
                    // By steps, so that kernels are kept and a result depends on its own image alone.
                    let step =
                        (self.slopes.obliquity(self.level, &self.stripe).ln() / OBLIQUITY_STEP).round();
                    let across = width / (step * OBLIQUITY_STEP).exp();
                    let kept = self.ridge.take().filter(|(of, _)| of.total_cmp(&across).is_eq());
                    let (_, ridge) =
                        self.ridge.insert(kept.unwrap_or_else(|| (across, Ridge::new(across, self.level))));
                    ridge.replace(&buffers.cleaned().unwrap_or(image), &mut self.stripe);
                }
            }
        }
        finish(&self.options, &mut self.pool, &mut self.stripe);
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

/// What is asked for whatever the method.
fn finish(options: &Options, pool: &mut Pool, stripe: &mut Stripe) {
    if options.reject_edges {
        for line in 0..stripe.len() {
            if stripe.reject[line].is_none() && stripe.flags[line].contains(Flags::EDGE) {
                stripe.drop_line(line, Reject::Edge);
            }
        }
    }
    if let Some(sigma_lines) = options.pool_lines {
        let lines = 0..stripe.len();
        pool.apply(stripe, lines, f64::from(sigma_lines), |_| POOLED_STEP_PX);
    }
}

/// Memory for slopes, and for their median.
#[derive(Debug, Default)]
struct Slopes {
    of: Vec<f32>,
    upper: Vec<u16>,
}

impl Slopes {
    /// Width along a line by that across the stripe: the median of √(1 + slope²) over the image.
    fn obliquity(&mut self, level: Level, stripe: &Stripe) -> f64 {
        /// Lines over which a slope is told.
        const OVER: usize = 4;
        let Self { of, upper } = self;
        let onward = stripe.position_px.get(OVER..).unwrap_or(&[]);
        of.clear();
        of.extend(
            stripe.position_px.iter().zip(onward).map(|(here, there)| (there - here).abs() / OVER as f32),
        );
        let median = dispatch!(level, _simd => median_of_known(of, of.iter().copied(), upper));
        median.map_or(1.0, |slope| f64::from(slope).hypot(1.0))
    }
}

/// Longest step from a line to the next that is pooled across, px.
const POOLED_STEP_PX: f32 = 5.0;
/// Step of ln √(1 + slope²) by which ridge kernels differ: what it costs them is a thousandth.
const OBLIQUITY_STEP: f64 = 0.05;
/// Narrowest width that filters are made for, px.
const NARROWEST_PX: f32 = 0.4;
