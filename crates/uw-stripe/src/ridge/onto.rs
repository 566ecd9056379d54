//! The ridge put in place of what the filters found, with what they know of it: a skirt of haze, edges of brightness, speckle.

use fearless_simd::{Simd, dispatch};

use super::{Ridge, RidgePoints};
use crate::profile::{Flags, Reject, Stripe, union};
use crate::{Pixel, View};

/// Lines to either side over which the ridge is compared with the filters' centres: haze is smooth along the stripe.
const REACH: usize = 16;
/// Lines that a comparison needs.
const LEAST: f32 = 8.0;
/// Sigmas below which a difference is left alone; above, it is shrunk towards them (James and Stein).
const SIGNIFICANT: f32 = 2.5;
/// Lines, in widths, that share an edge of brightness through the kernel.
const SHARED_WIDTHS: f32 = 1.5;

/// Reused memory. What is summed over neighbours has as many entries more on either side as a comparison reaches.
#[derive(Debug, Default)]
pub(super) struct Onto {
    points: RidgePoints,
    /// The filters' sigmas; infinite where there are none.
    sigma: Vec<f32>,
    /// The ridge's difference from the filters' centre on each line, px, by its weight; the weight, 1/px²; 1 where there are both, else 0.
    differences: [Vec<f32>; 3],
    /// The same over the neighbours of each line, and the least of their sigmas.
    sums: [Vec<f32>; 3],
    least: Vec<f32>,
    spare: Vec<f32>,
    /// Variance that neighbours' edges of brightness bring, px².
    edge: Vec<f32>,
}

impl Ridge {
    /// Replaces what the filters found by where the ridge next to it crosses each line; where there is nothing to pool, at the image's first
    /// and last lines, it stands.
    ///
    /// A background that slopes, as haze puts under a stripe, shifts the ridge, whose kernel knows none; the filters take it out. The mean
    /// difference of the two over neighbouring lines is taken back where it is more than chance.
    pub fn replace<P: Pixel>(&mut self, image: &View<'_, P>, stripe: &mut Stripe) {
        let mut onto = std::mem::take(&mut self.onto);
        self.follow(image, stripe.axis, &stripe.position_px, &stripe.noise, &mut onto.points);
        dispatch!(self.level, simd => onto.compare(simd, stripe));
        onto.edges(stripe);
        let lost = dispatch!(self.level, simd => onto.write(simd, stripe));
        if lost {
            let lines = stripe.len();
            for line in (0..lines).filter(|line| self.pools_at(*line, lines)) {
                if !stripe.position_px[line].is_nan() && onto.points.position[line].is_nan() {
                    stripe.drop_line(line, Reject::NotConverged);
                }
            }
        }
        self.onto = onto;
    }
}

impl Onto {
    /// Compares the ridge with the filters' centres, and adds up what neighbouring lines say.
    #[inline(always)]
    fn compare<S: Simd>(&mut self, _: S, stripe: &Stripe) {
        let lines = stripe.len();
        for of in &mut self.differences {
            of.clear();
            of.resize(lines + 2 * REACH, 0.0);
        }
        self.sigma.clear();
        self.sigma.resize(lines + 2 * REACH, f32::INFINITY);
        let [weighted, weights, counts] = self.differences.each_mut().map(|of| &mut of[REACH..][..lines]);
        let (centres, sigmas) = (&stripe.position_px[..lines], &stripe.sigma_px[..lines]);
        let (positions, sigma) = (&self.points.position[..lines], &mut self.sigma[REACH..][..lines]);
        for i in 0..lines {
            let difference = positions[i] - centres[i];
            // NaN counts as nothing.
            let told = (difference.abs() >= 0.0) & (sigmas[i] > 0.0);
            let by = if told { 1.0 / (sigmas[i] * sigmas[i]) } else { 0.0 };
            weighted[i] = if told { by * difference } else { 0.0 };
            weights[i] = by;
            counts[i] = if told { 1.0 } else { 0.0 };
            sigma[i] = if sigmas[i].is_nan() { f32::INFINITY } else { sigmas[i] };
        }
        for (of, sum) in self.differences.iter().zip(&mut self.sums) {
            near(of, sum, &mut self.spare, |a, b| a + b);
        }
        near(&self.sigma, &mut self.least, &mut self.spare, |a, b| if b < a { b } else { a });
    }

    /// What the neighbours' edges of brightness, which they share through the kernel, add to each line's variance.
    fn edges(&mut self, stripe: &Stripe) {
        let lines = stripe.len();
        self.edge.clear();
        self.edge.resize(lines, 0.0);
        let edged = |flags: &Flags| flags.contains(Flags::EDGE);
        if !edged(&union(&stripe.flags)) {
            return;
        }
        for (line, (edge, least)) in self.edge.iter_mut().zip(&self.least).enumerate() {
            let shared = (SHARED_WIDTHS * stripe.width_px[line].max(0.0)).ceil() as usize;
            *edge = (line.saturating_sub(shared)..(line + shared + 1).min(lines))
                .filter(|i| edged(&stripe.flags[*i]) && !stripe.sigma_px[*i].is_nan())
                .map(|i| stripe.sigma_px[i].powi(2) - least * least)
                .fold(0.0, f32::max);
        }
    }

    /// Writes the ridge where there is one, drawn to the filters' centres as far as the difference is more than chance; true if some lines with
    /// a filter's centre have none.
    ///
    /// Few arrays at a time: that they are apart is tested before they go through vectors, and of many it is not.
    #[inline(always)]
    fn write<S: Simd>(&mut self, _: S, stripe: &mut Stripe) -> bool {
        let n = stripe.len();
        stripe.unbent_px.fill(0.0);
        let [shift, unsure, count] = self.sums.each_mut().map(|of| &mut of[..n]);
        for i in 0..n {
            let (mean, chance) = (shift[i] / unsure[i], 1.0 / unsure[i].sqrt());
            let doubt = SIGNIFICANT * chance / mean;
            let share = 1.0 - doubt * doubt;
            let told = (count[i] >= LEAST) & (share > 0.0);
            let (sure, rest) = (share * chance, (1.0 - share) * mean);
            shift[i] = if told { share * mean } else { 0.0 };
            unsure[i] = if told { sure * sure + rest * rest } else { 0.0 };
        }
        let (sigma, width, scatter) =
            (&mut self.points.sigma[..n], &stripe.width_px[..n], stripe.scatter_widths);
        let edge = &self.edge[..n];
        for i in 0..n {
            let speckle = scatter * width[i].max(0.0);
            sigma[i] = (sigma[i] * sigma[i] + unsure[i] + edge[i] + speckle * speckle).sqrt();
        }
        let (ridge, centre) = (&mut self.points.position[..n], &stripe.position_px[..n]);
        let mut lost = 0u32;
        for i in 0..n {
            lost += u32::from(ridge[i].is_nan() & !centre[i].is_nan());
            ridge[i] = if centre[i].is_nan() { f32::NAN } else { ridge[i] - shift[i] };
        }
        for (to, from) in [
            (&mut stripe.sigma_px, &self.points.sigma),
            (&mut stripe.amplitude, &self.points.amplitude),
            (&mut stripe.background, &self.points.background),
            (&mut stripe.position_px, &self.points.position),
        ] {
            for ((to, from), met) in to.iter_mut().zip(from).zip(&self.points.position) {
                *to = if met.is_nan() { *to } else { *from };
            }
        }
        lost > 0
    }
}

/// What each line's neighbours come to together, its own entry being [`REACH`] further on: of two entries, then of four and so on, and of one more.
#[inline(always)]
fn near(values: &[f32], out: &mut Vec<f32>, spare: &mut Vec<f32>, both: impl Fn(f32, f32) -> f32) {
    out.clear();
    out.extend_from_slice(values);
    let mut reach = 1;
    while reach <= REACH {
        spare.clear();
        spare.extend(out.iter().zip(&out[reach..]).map(|(a, b)| both(*a, *b)));
        std::mem::swap(out, spare);
        reach *= 2;
    }
    out.iter_mut().zip(&values[2 * REACH..]).for_each(|(all, last)| *all = both(*all, *last));
}
