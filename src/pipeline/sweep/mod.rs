//! What only the sweep as a whole shows: where the sheet of light grazes the surface or partly misses it, and how its thickness moves
//! the middle of the light.
//!
//! The sheet is some tenths of a millimetre thick. Where it grazes a surface, its light is smeared over many times its thickness;
//! where it half passes an outline, only the half that meets the surface is seen. Either way the middle of the light is not where the
//! middle of the sheet is, by up to a pixel, always to the same side. A single image does not tell when the whole stripe is so, as
//! where the sheet first touches a ball: the neighbouring images and the usual width do.
//!
//! Elsewhere the shift is small and known to second order. With u(V, y) the centre on line y, F(V, y) its light, τ the sheet's standard
//! deviation in volts of the sweep and s² the variance of the lens's blur and the pixels, the middle of the light lies by
//!
//! m = τ² (½ u_VV + u_V F_V/F) + s² (½ u_yy + u_y F_y/F)
//!
//! beside the middle of the sheet: towards the side where the light is spread wider, and towards the brighter one. The widths tell τ and s:
//! w² = τ² u_V² + s² (1 + u_y²), from image to image as from line to line. Where little of a sweep bends they tell no more than a bound, the sheet's part being no
//! more than all: any share of it is as likely, and half of it is off by half as much as nothing would be.
//!
//! But a stripe's centre is not the middle of its light. Where the light is spread unevenly the stripe is lopsided, with the third cumulant
//!
//! κ = 3 (τ⁴ u_V² u_VV + 2 τ² s² u_V u_y u_Vy + s⁴ u_y² u_yy)
//!
//! and an efficient estimate of a Gaussian's centre lies by a share c of κ/w² towards the steeper flank: a quarter where the noise is even, less where
//! the light's own noise counts. The centre's shift is m − c κ/w². What the image by itself took back for blur along its stripe is given again first: it
//! cannot tell the sheet from the lens.

mod derivatives;
#[cfg(test)]
mod tests;
mod thickness;

use derivatives::{Along, Derivatives, derivatives};
use thickness::Thickness;
use uw_stripe::{Measurement, Method, Stripe, UNBENT_UNSURE};

/// A stripe this many times wider than usual is smeared.
const SMEARED: f32 = 1.8;
/// Share of the light further in below which part of the sheet passed the surface.
const PARTIAL: f32 = 0.5;
/// Longest way from an image to the next within a surface: usual steps, and pixels.
const STEP: (f32, f32) = (2.0, 3.0);
/// Variance of a pixel's area along either side, px²: a stripe's width is that before it.
const PIXEL_PX2: f64 = 1.0 / 12.0;
/// A shift beyond this share of the stripe's width is no longer second order: the measurement is taken out.
const LIMIT_WIDTHS: f64 = 0.25;
/// Standard deviation of a shift, as a share of it, beside what the thickness's makes: what the second order leaves; and where images on one side alone tell it,
/// which see the surface bend away no further than they reach.
const UNSURE: f64 = 0.3;
const UNSURE_OUTWARDS: f64 = 0.6;

/// A stripe's centre on one line of an image.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Seen {
    /// Row or column of the image.
    pub line: usize,
    /// Centre along it, px.
    pub position_px: f64,
    /// Its standard deviation, px.
    pub sigma_px: f64,
    /// What of that the whole sweep shares, px: a step to this side here is one to that side there, by their signs; `None` before that is known.
    pub shared_px: Option<f64>,
    /// Peak height, DN.
    pub amplitude: f64,
    /// Standard deviation of the cross section, px.
    pub width_px: f32,
    /// Share of the third cumulant by the squared width that the centre lies off the middle of the light.
    pub lopsided: f64,
    /// What the image by itself took back where blur along the stripe bends it, px.
    pub unbent_px: f64,
    /// Whether the width was measured, rather than taken.
    pub is_width_measured: bool,
    /// Whether the centre is that of a ridge, which takes back by itself, in its own way, what bends it.
    pub is_ridge: bool,
}

impl Seen {
    /// The centres of one image's stripe, as a method found them.
    pub(crate) fn of(stripe: &Stripe, method: Method) -> Vec<Self> {
        let seen = |m: Measurement| Self {
            line: m.line,
            position_px: m.position_px,
            sigma_px: m.sigma_px,
            shared_px: None,
            amplitude: m.amplitude,
            width_px: stripe.width_px[m.line],
            // The centre of gravity is the middle of the light.
            lopsided: if method == Method::Cog { 0.0 } else { lopsided(stripe, m.line) },
            unbent_px: stripe.unbent_px[m.line].into(),
            is_width_measured: !stripe.chi2[m.line].is_nan(),
            is_ridge: method == Method::Ridge,
        };
        stripe.measurements().map(seen).collect()
    }

    /// The centre before something was taken back, px.
    fn seen_px(&self) -> f64 {
        self.position_px + self.unbent_px
    }

    /// Light across the stripe, DN · px up to a factor.
    fn flux(&self) -> f32 {
        self.amplitude as f32 * self.width_px
    }

    /// Standard deviation of what the image by itself took back, px, part of the centre's own.
    fn unsure_of_bend_px(&self) -> f64 {
        f64::from(UNBENT_UNSURE) * self.unbent_px
    }

    /// Undoes what the image by itself took back.
    fn bend_again(&mut self) {
        self.sigma_px = (self.sigma_px.powi(2) - self.unsure_of_bend_px().powi(2)).max(0.0).sqrt();
        self.position_px = self.seen_px();
        self.unbent_px = 0.0;
    }

    /// Width on a line by sheet, lens and pixels, squared.
    fn square_px2(&self) -> f64 {
        f64::from(self.width_px).powi(2) + PIXEL_PX2
    }

    /// Variance of blur along the stripe, px²: what the sheet leaves of the width.
    fn lens_px2(&self, sheet_v2: f64, d: &Derivatives, along: &Along) -> f64 {
        (self.square_px2() - sheet_v2 * d.first * d.first).max(0.0) / (1.0 + along.slope * along.slope)
    }

    /// How far the centre lies beside that of the curve in the sheet's middle, px, by the sheet's variance, V², and by blur along the stripe; of a stripe
    /// whose curve is not known, by the sheet alone.
    fn shift(&self, sheet_v2: f64, d: &Derivatives, along: Option<&Along>) -> f64 {
        // No thicker than the stripe is wide.
        let sheet_v2 = sheet_v2.min(self.square_px2() / (d.first * d.first));
        let across = sheet_v2 * d.first;
        let mut middle = sheet_v2 * (0.5 * d.second + d.first * d.growth);
        // A third of the third cumulant.
        let mut skew = across * across * d.second;
        if let Some(along) = along {
            let (slope, lens_px2) = (along.slope, self.lens_px2(sheet_v2, d, along));
            middle += lens_px2 * (along.bend + slope * along.growth);
            skew += 2.0 * lens_px2 * slope * (across * d.twist + lens_px2 * slope * along.bend);
        }
        middle - 3.0 * self.lopsided * skew / self.square_px2()
    }

    /// Moves the centre to the curve in the sheet's middle, and widens its sigma by what is unsure of that; `Err` where that is not to be believed.
    fn take_back(
        &mut self,
        thickness: &Thickness,
        d: &Derivatives,
        along: Option<&Along>,
    ) -> Result<(), &'static str> {
        if along.is_some() {
            self.bend_again();
        }
        let shift = self.shift(thickness.v2, d, along);
        if shift.abs() > LIMIT_WIDTHS * f64::from(self.width_px) {
            return Err("smeared");
        }
        self.position_px -= shift;
        if let Some(along) = along {
            let noise_px = self.lens_px2(thickness.v2, d, along) * along.bend_px2.sqrt();
            self.sigma_px = self.sigma_px.hypot(noise_px);
        }
        let unsure_px = shift * if d.outwards { UNSURE_OUTWARDS } else { UNSURE };
        let thicker_px = self.shift(thickness.v2 + thickness.sigma_v2, d, along) - shift;
        let side = if thicker_px.abs() > unsure_px.abs() { thicker_px } else { unsure_px };
        let shared_px = unsure_px.hypot(thicker_px);
        self.sigma_px = self.sigma_px.hypot(shared_px);
        self.shared_px = Some(shared_px.hypot(self.unsure_of_bend_px()).copysign(side));
        Ok(())
    }
}

/// The share c of a lopsided stripe's third cumulant by its squared width that its centre lies off the middle of its light: least squares with the variance
/// 1 + ρ g of a Gaussian g, whose filter this fits to 0.02.
fn lopsided(stripe: &Stripe, line: usize) -> f64 {
    let (noise, height) = (&stripe.noise, f64::from(stripe.amplitude[line].max(0.0)));
    let around = noise.variance(f64::from(stripe.background[line]), 0.0);
    let shot = height
        * (1.0 / f64::from(noise.gain_e_per_dn) + height * f64::from(noise.speckle_contrast).powi(2))
        / around;
    0.25 / (1.0 + 0.25 * shot).sqrt()
}

/// One image's centres, line by line, and its voltage.
#[derive(Clone, Debug)]
pub(crate) struct Image {
    pub voltage_v: f64,
    pub seen: Vec<Seen>,
}

/// What became of each centre of an image: corrected, or the reason why it is not to be believed.
pub(crate) type Verdicts = Vec<Result<Seen, &'static str>>;

/// The verdict on each centre of each image; images in the order of their voltages.
pub(crate) fn judge(images: &[Image]) -> Vec<Verdicts> {
    let width = median(images.iter().flat_map(|image| (0..image.seen.len()).map(|i| square_width(image, i))));
    let steps = images.windows(2).flat_map(|pair| {
        let step =
            |seen: &Seen| at(&pair[1], seen).map(|next| (next.position_px - seen.position_px).abs() as f32);
        pair[0].seen.iter().filter_map(step)
    });
    let reach = STEP.0 * median(steps) + STEP.1;
    let derivatives = derivatives(images, reach);
    let thickness = Thickness::of(images, &derivatives, reach);
    let sigma = |image: &Image| median(image.seen.iter().map(|s| s.sigma_px as f32)).into();
    let sigmas_px: Vec<f64> = images.iter().map(sigma).collect();
    let verdict = |n: usize, i: usize| {
        let mut seen = images[n].seen[i];
        if square_width(&images[n], i) > SMEARED * width {
            return Err("smeared");
        }
        if partial(images, n, &seen, reach) {
            return Err("partial_beam");
        }
        if let Some(d) = &derivatives[n][i] {
            let curve = || Along::at(&images[n], i, reach, sigmas_px[n]);
            let along = (!seen.is_ridge).then(curve).flatten();
            seen.take_back(&thickness, d, along.as_ref())?;
        } else {
            seen.shared_px = Some(seen.unsure_of_bend_px());
            seen.sigma_px = seen.sigma_px.hypot(untold(images, n, &seen, reach, thickness.v2));
        }
        Ok(seen)
    };
    (0..images.len()).map(|n| (0..images[n].seen.len()).map(|i| verdict(n, i)).collect()).collect()
}

/// Slope of the stripe at a centre, px a line.
fn slope(image: &Image, i: usize) -> f32 {
    let (a, b) = (&image.seen[i.saturating_sub(1)], &image.seen[(i + 1).min(image.seen.len() - 1)]);
    if b.line > a.line && b.line <= a.line + 2 {
        (b.position_px - a.position_px) as f32 / (b.line - a.line) as f32
    } else {
        0.0
    }
}

/// Width across the stripe: a line cuts a steep one obliquely.
fn square_width(image: &Image, i: usize) -> f32 {
    image.seen[i].width_px / slope(image, i).hypot(1.0)
}

/// Whether the surface ends in the next image on one side, where the light is much less than in the images on the other.
fn partial(images: &[Image], n: usize, seen: &Seen, reach: f32) -> bool {
    let flux = |other: Option<usize>, steps: f32| {
        let found = at(images.get(other?)?, seen)?;
        ((found.position_px - seen.position_px).abs() as f32 <= steps * reach).then(|| found.flux())
    };
    let before = [flux(n.checked_sub(1), 1.0), flux(n.checked_sub(2), 2.0)];
    let after = [flux(Some(n + 1), 1.0), flux(Some(n + 2), 2.0)];
    let inside = match (before, after) {
        ([None, None], [Some(a), Some(b)]) | ([Some(a), Some(b)], [None, None]) => a.max(b),
        _ => return false,
    };
    seen.flux() < PARTIAL * inside
}

/// How far the middle of the light may lie off where no derivatives tell, px: what a neighbouring image's light tells to first order, up to the sheet's own
/// thickness, which an edge of brightness across it may move it by.
fn untold(images: &[Image], n: usize, seen: &Seen, reach: f32, thickness: f64) -> f64 {
    let beside = [n.checked_sub(1), n.checked_add(1)].into_iter().filter_map(|other| {
        let image = images.get(other?)?;
        let there = at(image, seen)?;
        let way_px = (there.position_px - seen.position_px).abs();
        let volts = (image.voltage_v - images[n].voltage_v).abs();
        let growth = f64::from(there.flux() / seen.flux()).ln().abs() / volts;
        let sheet_px = thickness.sqrt() * way_px / volts;
        (way_px as f32 <= reach && volts > 0.0).then(|| sheet_px * (thickness.sqrt() * growth).min(1.0))
    });
    beside.fold(0.0, f64::max)
}

/// What another image shows on the same line.
fn at<'a>(image: &'a Image, seen: &Seen) -> Option<&'a Seen> {
    index(image, seen).map(|i| &image.seen[i])
}

/// Where that is among what it shows.
fn index(image: &Image, seen: &Seen) -> Option<usize> {
    image.seen.binary_search_by_key(&seen.line, |s| s.line).ok()
}

/// Upper median; 0 of none.
fn median(values: impl Iterator<Item = f32>) -> f32 {
    let mut values: Vec<f32> = values.collect();
    let middle = values.len() / 2;
    if values.is_empty() { 0.0 } else { *values.select_nth_unstable_by(middle, f32::total_cmp).1 }
}
