//! Lines of which nothing but the width is not as the filters have it: the filters of a width near theirs do as well as a likelihood, at a
//! hundredth of its time. Sheets have a waist and lenses a depth of field, so that most lines of a scan are such.

use std::ops::Range;

use fearless_simd::{Simd, dispatch};

use super::fir::{Bank, Estimates};
use super::front::NOWHERE;
use super::measure::{NARROWEST, WIDENING, group_from};
use super::window::{GROUP, Group};
use super::{Buffers, Engine, Job, Model};
use crate::Pixel;
use crate::profile::{Flags, Stripe};

/// Ratio of a bank's width to the next one's, and how many there are on either side of the model's own.
const RATIO: f32 = 1.15;
const BESIDE: i32 = 2;
/// Times that a line's width may point to another bank.
const ROUNDS: usize = 2;
/// Slope of the background, in its sigmas, up to which it is left to the filters.
const LEVEL: f32 = 3.0;

/// Filters for widths near the model's, made when they are first asked for.
#[derive(Debug, Default)]
pub(super) struct Widths {
    banks: Vec<Bank>,
    estimates: Estimates,
}

impl Widths {
    fn banks(&mut self, model: &Model) {
        if self.banks.is_empty() {
            let width = |step: i32| model.width_px * RATIO.powi(step);
            let bank = |step| Bank::new(width(step), model.noise, model.min_snr);
            self.banks.extend((-BESIDE..=BESIDE).filter(|step| *step != 0).map(bank));
        }
    }

    /// The bank whose width is nearest.
    fn nearest(&self, width_px: f32) -> Option<usize> {
        let off = |bank: &Bank| (width_px / bank.width).ln().abs();
        (0..self.banks.len()).min_by(|a, b| off(&self.banks[*a]).total_cmp(&off(&self.banks[*b])))
    }
}

/// Whether a line's shape is all that is wanting of it.
fn is_open(stripe: &Stripe, line: usize) -> bool {
    let flags = stripe.flags[line];
    let others = Flags::SATURATED | Flags::BORDER;
    flags.contains(Flags::EDGE) && flags.without(others) == flags && stripe.reject[line].is_none()
}

impl Engine {
    /// Estimates lines anew whose shape is not the filters', by those of a width near their own, and takes those of which these lack nothing.
    pub(super) fn by_width<P: Pixel>(
        &mut self,
        job: &Job<'_, P>,
        buffers: &mut Buffers<P>,
        stripe: &mut Stripe,
    ) {
        let (first_line, _, _) = job.origin();
        if !(first_line..first_line + job.lines()).any(|line| is_open(stripe, line)) {
            return;
        }
        self.widths.banks(&self.model);
        let level = self.level;
        for from in (0..job.lines()).step_by(GROUP) {
            let lines = group_from(job, from);
            dispatch!(level, simd => self.by_width_here(simd, job, buffers, &lines, stripe));
        }
    }

    #[inline(always)]
    fn by_width_here<S: Simd, P: Pixel>(
        &mut self,
        simd: S,
        job: &Job<'_, P>,
        buffers: &mut Buffers<P>,
        lines: &Range<usize>,
        stripe: &mut Stripe,
    ) {
        let (first_line, first_pixel, length) = job.origin();
        let Self { widths, model, .. } = self;
        for _ in 0..ROUNDS {
            let mut wanted = [None; GROUP];
            let mut places = [NOWHERE; GROUP];
            let mut any = false;
            for ((l, wanted), place) in lines.clone().zip(&mut wanted).zip(&mut places) {
                let line = first_line + l;
                if is_open(stripe, line) {
                    *wanted = widths.nearest(stripe.width_px[line]);
                    any = true;
                }
                // Those beside have their say in how much light there is.
                let local = stripe.position_px[line].round() - first_pixel as f32;
                if (0.0..length as f32).contains(&local) {
                    *place = local as u32;
                }
            }
            if !any {
                return;
            }
            for (k, bank) in widths.banks.iter().enumerate().filter(|(k, _)| wanted.contains(&Some(*k))) {
                let places = &places[..lines.len()];
                let group = Group { first: lines.start, at: places, half: bank.half };
                buffers.windows.load(simd, &job.image, (job.roi, job.axis), group);
                let e = &mut widths.estimates;
                bank.estimate::<S, P, true>(simd, &buffers.windows, lines.len(), e);
                for (l, place) in places.iter().enumerate().filter(|(l, _)| wanted[*l] == Some(k)) {
                    let line = first_line + lines.start + l;
                    let width = bank.width * (1.0 + e.ln_width[l]).max(NARROWEST);
                    // NaN is no success.
                    let sound = *place != NOWHERE
                        && e.excess[l] >= 0.0
                        && e.sigma[l] <= model.max_sigma_px
                        && e.shift[l].abs() <= bank.recentre
                        && e.slope[l].abs() <= LEVEL
                        && width <= model.max_width_px;
                    if !sound {
                        continue;
                    }
                    stripe.width_px[line] = width;
                    if e.ln_width[l].abs() > WIDENING {
                        continue;
                    }
                    let widening = e.ln_width[l] / e.sigma_ln_width[l];
                    stripe.position_px[line] = *place as f32 + e.shift[l] + first_pixel as f32;
                    stripe.sigma_px[line] = e.sigma[l];
                    stripe.amplitude[line] = e.amplitude[l];
                    stripe.background[line] = e.background[l];
                    stripe.chi2[line] = 0.5 * (e.slope[l] * e.slope[l] + widening * widening);
                    stripe.flags[line] = stripe.flags[line].without(Flags::EDGE);
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use rand::{SeedableRng, rngs::StdRng};
    use rand_distr::{Distribution, StandardNormal};

    use super::super::fir::profile;
    use super::*;
    use crate::{Extractor, Method, NoiseModel, Options, View};

    const NOISE: NoiseModel =
        NoiseModel { gain_e_per_dn: 40.0, read_noise_dn: 1.0, speckle_contrast: 0.0, full_scale_dn: 255.0 };
    const SIZE: (usize, usize) = (96, 640);
    /// The filters' width, px.
    const WIDTH: f64 = 2.0;
    /// An RMS of so many lines is known to 2.8 %; and a width to a hundredth of the filters'.
    const RMS_WITHIN: f64 = 0.09;
    const WIDTH_WITHIN: f64 = 0.02;

    fn centre(line: usize) -> f64 {
        40.0 + 0.013 * line as f64
    }

    fn image(width: f64) -> Vec<u8> {
        let mut random = StdRng::seed_from_u64(5);
        let mut pixel = |i: usize| {
            let (line, x) = (i / SIZE.0, i % SIZE.0);
            let light = 12.0 + 120.0 * profile(x as f64, centre(line), width).0;
            let noise: f64 = StandardNormal.sample(&mut random);
            (light + NOISE.variance(light, 0.0).sqrt() * noise).round().clamp(0.0, 255.0) as u8
        };
        (0..SIZE.0 * SIZE.1).map(&mut pixel).collect()
    }

    #[test]
    fn a_stripe_of_another_width_is_measured_as_well_as_one_of_the_filters_own() {
        for ratio in [0.72, 0.85, 1.0, 1.2, 1.35] {
            let pixels = image(ratio * WIDTH);
            let options = Options {
                method: Method::Robust,
                noise: Some(NOISE),
                width_px: Some(WIDTH as f32),
                ..Options::default()
            };
            let mut extractor = Extractor::new(options).unwrap();
            let view = View::packed(&pixels, SIZE.0, SIZE.1).unwrap();
            let stripe = extractor.extract(view, None).unwrap();
            assert_eq!(stripe.found(), SIZE.1, "{ratio}");
            let (mut squares, mut width) = (0.0, 0.0);
            for line in 0..SIZE.1 {
                let off = f64::from(stripe.position_px[line]) - centre(line);
                squares += (off / f64::from(stripe.sigma_px[line])).powi(2) / SIZE.1 as f64;
                width += f64::from(stripe.width_px[line]) / SIZE.1 as f64;
                assert!(!stripe.flags[line].contains(Flags::EDGE), "{ratio}: {line}");
            }
            assert!((squares.sqrt() - 1.0).abs() < RMS_WITHIN, "{ratio}: {} sigmas", squares.sqrt());
            assert!((width / (ratio * WIDTH) - 1.0).abs() < WIDTH_WITHIN, "{ratio}: {width}");
        }
    }
}
