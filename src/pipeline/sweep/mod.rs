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
mod thickness;

use derivatives::{Along, Derivatives, derivatives, smooth};
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
    let derivatives: Vec<Vec<Option<Derivatives>>> =
        (0..images.len()).map(|n| derivatives(images, n, reach)).collect();
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
        if let Some(d) = smooth(&images[n], &derivatives[n], i, reach) {
            let along = Along::at(&images[n], i, reach, sigmas_px[n]).filter(|_| !seen.is_ridge);
            if along.is_some() {
                seen.bend_again();
            }
            let shift = seen.shift(thickness.v2, &d, along.as_ref());
            let otherwise = seen.shift(thickness.v2 + thickness.sigma_v2, &d, along.as_ref());
            if shift.abs() > LIMIT_WIDTHS * f64::from(seen.width_px) {
                return Err("smeared");
            }
            seen.position_px -= shift;
            if let Some(along) = &along {
                let noise_px = seen.lens_px2(thickness.v2, &d, along) * along.bend_px2.sqrt();
                seen.sigma_px = seen.sigma_px.hypot(noise_px);
            }
            let unsure_px = shift * if d.outwards { UNSURE_OUTWARDS } else { UNSURE };
            let thicker_px = otherwise - shift;
            let side = if thicker_px.abs() > unsure_px.abs() { thicker_px } else { unsure_px };
            let shared_px = unsure_px.hypot(thicker_px);
            seen.sigma_px = seen.sigma_px.hypot(shared_px);
            seen.shared_px = Some(shared_px.hypot(seen.unsure_of_bend_px()).copysign(side));
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

#[cfg(test)]
mod tests {
    use super::*;
    use uw_stripe::{Extractor, NoiseModel, Options, View};

    fn seen(line: usize, position_px: f64, width_px: f32, flux: f64) -> Seen {
        Seen {
            line,
            position_px,
            sigma_px: 0.03,
            shared_px: None,
            amplitude: flux / f64::from(width_px),
            width_px,
            lopsided: 0.0,
            unbent_px: 0.0,
            is_width_measured: true,
            is_ridge: false,
        }
    }

    /// Stripes on 20 lines, one a tenth of a volt, five pixels apart.
    fn even() -> Vec<Image> {
        let stripe = |n: i32| (0..20).map(|line| seen(line, 5.0 * f64::from(n), 1.5, 100.0)).collect();
        (0..8).map(|n| Image { voltage_v: 0.1 * f64::from(n), seen: stripe(n) }).collect()
    }

    fn reasons(image: &Verdicts) -> Vec<Option<&'static str>> {
        image.iter().map(|v| v.as_ref().err().copied()).collect()
    }

    #[test]
    fn an_even_surface_is_left_alone() {
        for (verdicts, image) in judge(&even()).iter().zip(even()) {
            for (verdict, seen) in verdicts.iter().zip(&image.seen) {
                assert_eq!(verdict.expect("believed").position_px.to_bits(), seen.position_px.to_bits());
            }
        }
    }

    #[test]
    fn half_a_beam_at_the_sweeps_end_is_taken_out_and_a_dark_patch_is_not() {
        let mut images = even();
        images[0].seen.iter_mut().for_each(|s| s.amplitude *= 0.4);
        images[4].seen[7].amplitude *= 0.4;
        let verdicts = judge(&images);
        assert_eq!(reasons(&verdicts[0]), [Some("partial_beam"); 20]);
        assert!(verdicts[1..].iter().flatten().all(Result::is_ok));
    }

    #[test]
    fn a_smeared_stripe_is_taken_out_and_an_oblique_one_is_not() {
        let mut images = even();
        images[0].seen.iter_mut().for_each(|s| s.width_px = 4.0);
        let verdicts = judge(&images);
        assert_eq!(reasons(&verdicts[0]), [Some("smeared"); 20]);
        assert!(verdicts[1..].iter().flatten().all(Result::is_ok));

        // Half of each image runs steeply, where a line cuts the stripe at three times its width.
        for seen in images.iter_mut().flat_map(|image| &mut image.seen) {
            let steep = seen.line.saturating_sub(10) as f64;
            seen.position_px += 3.0 * steep;
            seen.width_px = if steep > 0.0 { 1.5 * 3.0_f32.hypot(1.0) } else { 1.5 };
        }
        assert!(judge(&images).iter().flatten().all(Result::is_ok));
    }

    /// The middle of the light of a thick sheet on a curved and shaded surface, integrated in closed form: with u(s) quadratic and
    /// ln F linear in the sheet's offset s, a Gaussian sheet shifted by its brightness stays Gaussian, and its mean is u₀ + u′ τ² g +
    /// ½ u″ (τ² + τ⁴ g²).
    #[test]
    fn the_sheets_thickness_is_found_and_its_shift_taken_back() {
        const TAU_V: f64 = 0.03;
        const LENS_PX: f64 = 0.75;
        const GROWTH: f64 = -1.0;
        let (first, second) = (|v: f64| 30.0 - 20.0 * v, -20.0);
        let centre = |v: f64| 30.0 * v - 10.0 * v * v;
        let stripe = |v: f64| {
            let variance = LENS_PX.powi(2) + (TAU_V * first(v)).powi(2);
            let shift = TAU_V.powi(2) * (first(v) * GROWTH + 0.5 * second);
            let one =
                |line| seen(line, centre(v) + shift, variance.sqrt() as f32, 100.0 * (GROWTH * v).exp());
            Image { voltage_v: v, seen: (0..20).map(one).collect() }
        };
        let mut images: Vec<Image> = (0..25).map(|n| stripe(0.04 * f64::from(n))).collect();
        // The first and the last image too, beside which there is no other.
        for (image, verdicts) in images.iter().zip(&judge(&images)) {
            for verdict in verdicts {
                let truth = centre(image.voltage_v);
                // The shift is 0.02 to 0.04 px; what is left is of third order.
                assert!((verdict.expect("believed").position_px - truth).abs() < 1e-3);
            }
        }

        // Bent along itself, too, whatever each image by itself took back.
        const BEND: f64 = 0.01;
        let curve = |line: usize| BEND * (line as f64 - 4.0).powi(2);
        let mut bent = images.clone();
        for image in &mut bent {
            let (sheet_px2, lens_px2) =
                ((TAU_V * first(image.voltage_v)).powi(2), LENS_PX.powi(2) + PIXEL_PX2);
            for seen in &mut image.seen {
                let slope = 2.0 * BEND * (seen.line as f64 - 4.0);
                seen.width_px = (sheet_px2 + lens_px2 * (1.0 + slope * slope) - PIXEL_PX2).sqrt() as f32;
                seen.amplitude = 100.0 * (GROWTH * image.voltage_v).exp() / f64::from(seen.width_px);
                seen.unbent_px = 0.05;
                seen.position_px += curve(seen.line) + BEND * lens_px2 - seen.unbent_px;
            }
        }
        for (image, verdicts) in bent.iter().zip(&judge(&bent)) {
            for verdict in verdicts {
                let seen = verdict.expect("believed");
                let off = seen.position_px - centre(image.voltage_v) - curve(seen.line);
                assert!(off.abs() < 1.5e-3, "{off}");
            }
        }

        // A ridge takes that back by itself: no more of it.
        let ridge: Vec<Image> = bent
            .iter()
            .map(|image| {
                let lens_px = |s: &Seen| BEND * (LENS_PX.powi(2) + PIXEL_PX2) - s.unbent_px;
                let one = |s: &Seen| Seen {
                    position_px: s.position_px - lens_px(s),
                    unbent_px: 0.0,
                    is_ridge: true,
                    ..*s
                };
                Image { voltage_v: image.voltage_v, seen: image.seen.iter().map(one).collect() }
            })
            .collect();
        for (image, verdicts) in ridge.iter().zip(&judge(&ridge)) {
            for verdict in verdicts {
                let seen = verdict.expect("believed");
                let off = seen.position_px - centre(image.voltage_v) - curve(seen.line);
                assert!(off.abs() < 1.5e-3, "{off}");
            }
        }

        // Before a wall, many more lines of another distance, whose focus changes along it and whose slant hardly does.
        let wall = |v: f64| {
            let width = (1.2 + 0.4 * v + (TAU_V * 25.0).powi(2)).sqrt() as f32;
            (40..200).map(move |line| seen(line, 100.0 + 25.0 * v - 0.1 * v * v, width, 100.0))
        };
        let mut before_a_wall = images.clone();
        before_a_wall.iter_mut().for_each(|image| image.seen.extend(wall(image.voltage_v)));
        for (image, verdicts) in images.iter().zip(&judge(&before_a_wall)) {
            for verdict in &verdicts[..image.seen.len()] {
                let off = verdict.expect("believed").position_px - centre(image.voltage_v);
                assert!(off.abs() < 1e-3, "{off}");
            }
        }

        // Where the light breaks off nothing tells the shift, and the sigma says so: with a tenth of the light in the image before, up to the
        // sheet's thickness, 0.2 px and more.
        let before = judge(&images)[20][7].expect("believed").sigma_px;
        for seen in images[..20].iter_mut().flat_map(|image| &mut image.seen) {
            seen.amplitude *= 0.1;
        }
        images.truncate(21);
        let after = judge(&images)[20][7].expect("believed");
        assert!(before < 0.04 && after.sigma_px > 0.2 && after.sigma_px < TAU_V * 30.0, "{after:?}");
    }

    /// Of a pipe along the sweep every image shows the same arc: no two images differ, but an arc's lines do.
    #[test]
    fn widths_along_a_bent_stripe_tell_the_sheets_thickness() {
        const LENS_PX: f64 = 0.8;
        for tau_v in [0.0, 0.01, 0.03] {
            let stripe = |n: usize| {
                let one = |line: usize| {
                    let y = line as f64 - 30.0;
                    let slope: f64 = 0.05 * y;
                    let square =
                        (tau_v * 30.0_f64).powi(2) + (LENS_PX.powi(2) + PIXEL_PX2) * (1.0 + slope * slope);
                    let width = (square - PIXEL_PX2).sqrt() as f32;
                    seen(line, 1.2 * n as f64 + 0.025 * y * y, width, 100.0)
                };
                Image { voltage_v: 0.04 * n as f64, seen: (0..60).map(one).collect() }
            };
            let mut images: Vec<Image> = (0..12).map(stripe).collect();
            let all: Vec<_> = (0..images.len()).map(|n| derivatives(&images, n, 5.0)).collect();
            let found = Thickness::of(&images, &all, 5.0);
            let off = (found.v2 - tau_v * tau_v).abs();
            assert!(off < 0.02 * tau_v * tau_v + 1e-6, "{found:?} for {tau_v}");
            assert!(found.sigma_v2 < 0.1 * 0.01 * 0.01, "{found:?}");
            // A width that was taken, the same everywhere, tells nothing but a bound.
            for seen in images.iter_mut().flat_map(|image| &mut image.seen) {
                (seen.width_px, seen.is_width_measured) = (1.0, false);
            }
            let taken = Thickness::of(&images, &all, 5.0);
            assert!(taken.sigma_v2 > 0.5 * taken.v2 && taken.v2 > 0.3 / 900.0, "{taken:?}");
        }
    }

    /// On a flat wall whose brightness falls off, 30 px and a factor of e a volt, no width tells the sheet from the lens: half of it is taken for the
    /// sheet's, and the sigma covers the rest.
    #[test]
    fn where_nothing_bends_half_of_the_width_is_taken_for_the_sheets() {
        for (tau_v, lens_px) in [(0.03_f64, 0.75_f64), (0.01, 1.2), (0.04, 0.4)] {
            let stripe = |n: usize| {
                let v = 0.04 * n as f64;
                let width = (tau_v * 30.0).hypot(lens_px) as f32;
                let position = 30.0 * v - 30.0 * tau_v * tau_v;
                let one = |line| Seen { sigma_px: 1e-3, ..seen(line, position, width, 100.0 * (-v).exp()) };
                Image { voltage_v: v, seen: (0..20).map(one).collect() }
            };
            let images: Vec<Image> = (0..12).map(stripe).collect();
            let found = judge(&images)[6][10].expect("believed");
            let (raw, off) = (30.0 * tau_v * tau_v, found.position_px - 30.0 * images[6].voltage_v);
            assert!(off.abs() < 2.0 * found.sigma_px, "{raw}: {off} beside {}", found.sigma_px);
            let half = 0.5 * (raw + lens_px * lens_px / 30.0);
            assert!((off + raw - half).abs() < 1e-3, "{off} of {raw}, {half} taken back");
        }
    }

    /// A lopsided stripe's centre, as the extractor tells it, is no middle of its light: images of a thick sheet on a surface that bends, rendered from
    /// its offsets and the lens, with noise that is even and with the light's own.
    #[test]
    fn a_lopsided_stripe_is_taken_back_by_what_moved_its_centre() {
        const TAU_V: f64 = 0.06;
        const LENS_PX: f64 = 0.8;
        const SIZE: (usize, usize) = (96, 20);
        // Aslant, so that lines cut pixels at all places.
        let centre = |v: f64, line: usize| 30.0 * v - 12.0 * v * v + 15.0 + 0.23 * line as f64;
        let seen = |v: f64, noise: NoiseModel| {
            let mut pixels = vec![10.0; SIZE.0 * SIZE.1];
            for (line, row) in pixels.chunks_exact_mut(SIZE.0).enumerate() {
                // The light of the sheet's parts, a hundredth of its thickness each, smeared by the lens.
                for part in (-400..=400).map(|step| 0.01 * f64::from(step)) {
                    let (at, light) = (centre(v + part * TAU_V, line), 15.0 * (-0.5 * part * part).exp());
                    for (k, value) in row.iter_mut().enumerate() {
                        *value += light * (-0.5 * ((k as f64 - at) / LENS_PX).powi(2)).exp();
                    }
                }
            }
            let pixels: Vec<u16> = pixels.iter().map(|value| value.round() as u16).collect();
            let options = Options { noise: Some(noise), full_scale_dn: Some(4095.0), ..Options::default() };
            let view = View::new(&pixels, SIZE.0, SIZE.1, SIZE.0).unwrap();
            Seen::of(Extractor::new(options).unwrap().extract(view, None).unwrap(), Method::Robust)
        };
        for (gain_e_per_dn, read_noise_dn) in [(1e5, 30.0), (0.2, 0.1)] {
            let noise =
                NoiseModel { gain_e_per_dn, read_noise_dn, speckle_contrast: 0.0, full_scale_dn: 4095.0 };
            let images: Vec<Image> = (0..15)
                .map(|n| 0.07 * f64::from(n))
                .map(|voltage_v| Image { voltage_v, seen: seen(voltage_v, noise) })
                .collect();
            let mut off_px: Vec<f64> = Vec::new();
            for (image, verdicts) in images.iter().zip(&judge(&images)).skip(1).take(13) {
                let off = verdicts.iter().map(|seen| {
                    let seen = seen.as_ref().expect("believed");
                    seen.position_px - centre(image.voltage_v, seen.line)
                });
                off_px.push((off.sum::<f64>() / SIZE.1 as f64).abs());
            }
            // As the middle of light, taken back by 0.043 px throughout, centres in even noise would come out 0.02 to 0.05 px off.
            off_px.sort_by(f64::total_cmp);
            assert!(off_px[6] < 0.003 && off_px[11] < 0.006, "{off_px:?}");
        }
    }

    #[test]
    fn nothing_gives_nothing() {
        assert!(judge(&[]).is_empty());
        let empty = Image { voltage_v: 0.0, seen: vec![] };
        assert!(judge(&[empty.clone(), empty]).iter().all(Vec::is_empty));
    }
}
