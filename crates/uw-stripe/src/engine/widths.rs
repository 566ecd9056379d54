//! Lines of which nothing but the width is not as the filters have it: the filters of a width near theirs do as well as a likelihood, at a
//! hundredth of its time. Sheets have a waist and lenses a depth of field, so that most lines of a scan are such.

use std::ops::Range;

use fearless_simd::{Simd, dispatch};

use super::fir::{Bank, Estimates};
use super::front::NOWHERE;
use super::lanes::CHUNK;
use super::measure::{WIDENING, group_from, read_width};
use super::window::{GROUP, Group};
use super::{Buffers, Engine, Job, Model};
use crate::Pixel;
use crate::profile::{Flags, Stripe, union};

/// Ratio of a bank's width to the next one's, and how many there are on either side of the model's own.
const RATIO: f32 = 1.15;
const BESIDE: i32 = 2;
/// Times that a line's width may point to another bank.
const ROUNDS: usize = 2;
/// Slope of the background, in its sigmas, up to which it is left to the filters: a line's, and that of a chunk's lines together. Where neighbours lean all to one side,
/// none is so by chance.
const LEVEL: f32 = 3.0;
const LEVEL_TOGETHER: f32 = 2.0;

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
            let bank = |step| Bank::new(width(step), model.noise, model.min_snr).corrected();
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
        let mut lines = first_line..first_line + job.lines();
        // Few images have any.
        if !union(&stripe.flags[lines.clone()]).contains(Flags::EDGE)
            || !lines.any(|line| is_open(stripe, line))
        {
            return;
        }
        self.widths.banks(&self.model);
        let level = self.level;
        for from in (0..job.lines()).step_by(GROUP) {
            let lines = group_from(job, from);
            dispatch!(level, simd => self.by_width_here(simd, job, buffers, (&lines, from), stripe));
        }
    }

    #[inline(always)]
    fn by_width_here<S: Simd, P: Pixel>(
        &mut self,
        simd: S,
        job: &Job<'_, P>,
        buffers: &mut Buffers<P>,
        (lines, new): (&Range<usize>, usize),
        stripe: &mut Stripe,
    ) {
        let (first_line, first_pixel, length) = job.origin();
        let Self { widths, model, .. } = self;
        let mut width = [0.0; GROUP];
        width[..lines.len()].copy_from_slice(&stripe.width_px[first_line + lines.start..][..lines.len()]);
        for _ in 0..ROUNDS {
            let mut wanted = [None; GROUP];
            let mut places = [NOWHERE; GROUP];
            for (i, l) in lines.clone().enumerate() {
                let line = first_line + l;
                // Columns' last group has lines of the one before.
                if l >= new && is_open(stripe, line) {
                    wanted[i] = widths.nearest(width[i]);
                }
                // Those beside have their say in how much light there is.
                let local = stripe.position_px[line].round() - first_pixel as f32;
                if (0.0..length as f32).contains(&local) {
                    places[i] = local as u32;
                }
            }
            if wanted.iter().all(Option::is_none) {
                return;
            }
            for (k, bank) in widths.banks.iter().enumerate().filter(|(k, _)| wanted.contains(&Some(*k))) {
                let places = &places[..lines.len()];
                let group = Group { first: lines.start, at: places, half: bank.half };
                buffers.windows.load(simd, &job.image, (job.roi, job.axis), group);
                let e = &mut widths.estimates;
                bank.estimate::<S, P, true>(simd, &buffers.windows, lines.len(), e);
                let mut leaning = [false; GROUP / CHUNK];
                for (leaning, first) in leaning.iter_mut().zip((0..).step_by(CHUNK)) {
                    let own = (first..first + CHUNK).filter(|l| wanted[*l] == Some(k));
                    let slopes = || own.clone().map(|l| e.slope[l].clamp(-LEVEL, LEVEL));
                    *leaning =
                        slopes().sum::<f32>().abs() > LEVEL_TOGETHER * (slopes().count() as f32).sqrt();
                }
                for (l, place) in places.iter().enumerate().filter(|(l, _)| wanted[*l] == Some(k)) {
                    let line = first_line + lines.start + l;
                    // As far as these filters reach, which is farther than those that found it.
                    let inside = *place != NOWHERE
                        && *place as usize >= bank.half
                        && (*place as usize) + bank.half < length;
                    // NaN is no success.
                    let sound = inside
                        && !leaning[l / CHUNK]
                        && e.excess[l] >= 0.0
                        && (0.0..=model.max_sigma_px).contains(&e.sigma[l])
                        && e.shift[l].abs() <= bank.recentre
                        && e.slope[l].abs() <= LEVEL
                        && e.top[l] < model.noise.full_scale_dn;
                    if !sound {
                        continue;
                    }
                    width[l] = read_width(bank.width, e.ln_width[l]);
                    if e.ln_width[l].abs() > WIDENING || width[l] > model.max_width_px {
                        continue;
                    }
                    stripe.position_px[line] = *place as f32 + e.shift[l] + first_pixel as f32;
                    stripe.width_px[line] = width[l];
                    stripe.sigma_px[line] = e.sigma[l];
                    stripe.amplitude[line] = e.amplitude[l];
                    stripe.background[line] = e.background[l];
                    stripe.chi2[line] = e.shape_chi2(l);
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
    /// A mean of so many errors is known to a twenty-fifth of their sigma.
    const BIAS_SIGMAS: f64 = 0.2;
    /// An RMS of so many lines is known to 2.8 %; and a width to a hundredth of the filters'.
    const RMS_WITHIN: f64 = 0.09;
    const WIDTH_WITHIN: f64 = 0.02;

    fn image(width: f64, centre: impl Fn(usize) -> f64) -> Vec<u8> {
        let mut random = StdRng::seed_from_u64(5);
        let mut pixel = |i: usize| {
            let (line, x) = (i / SIZE.0, i % SIZE.0);
            let light = 12.0 + 120.0 * profile(x as f64, centre(line), width).0;
            let noise: f64 = StandardNormal.sample(&mut random);
            (light + NOISE.variance(light, 0.0).sqrt() * noise).round().clamp(0.0, 255.0) as u8
        };
        (0..SIZE.0 * SIZE.1).map(&mut pixel).collect()
    }

    fn extracted(pixels: &[u8]) -> Stripe {
        let options = Options {
            method: Method::Robust,
            noise: Some(NOISE),
            width_px: Some(WIDTH as f32),
            ..Options::default()
        };
        let mut extractor = Extractor::new(options).unwrap();
        extractor.extract(View::packed(pixels, SIZE.0, SIZE.1).unwrap(), None).unwrap().clone()
    }

    #[test]
    fn a_stripe_of_another_width_is_measured_as_well_as_one_of_the_filters_own() {
        let centre = |line: usize| 40.0 + 0.013 * line as f64;
        for ratio in [0.72, 0.85, 1.0, 1.2, 1.35] {
            let stripe = extracted(&image(ratio * WIDTH, centre));
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

    #[test]
    fn a_stripe_that_stands_still_is_not_drawn_to_the_pixels() {
        for ratio in [0.81, 1.25, 1.42] {
            for still in [40.0, 40.05, 40.1, 40.45] {
                let stripe = extracted(&image(ratio * WIDTH, |_| still));
                let mean = |values: &[f32]| values.iter().map(|v| f64::from(*v)).sum::<f64>() / SIZE.1 as f64;
                let bias = (mean(&stripe.position_px) - still) / mean(&stripe.sigma_px);
                assert!(bias.abs() < BIAS_SIGMAS, "{ratio} at {still}: {bias} sigmas");
            }
        }
    }
}
