//! The ridge put in place of what the filters found, with what they know of it: a skirt of haze, edges of brightness, speckle.

use fearless_simd::{Level, dispatch};

use super::{CHUNK, Ridge, RidgePoints};
use crate::profile::{Flags, Reject, Stripe};
use crate::{Pixel, View};

/// Lines to either side over which the ridge is compared with the filters' centres: haze is smooth along the stripe.
const REACH: usize = 16;
/// Lines that a comparison needs.
const LEAST: f64 = 8.0;
/// Sigmas below which a difference is left alone; above, it is shrunk towards them (James and Stein).
const SIGNIFICANT: f64 = 2.5;
/// Lines, in widths, that share an edge of brightness through the kernel.
const SHARED_WIDTHS: f32 = 1.5;

/// Reused memory. Differences and sigmas have as many entries more on either side as a comparison reaches.
#[derive(Debug, Default)]
pub(super) struct Onto {
    points: RidgePoints,
    /// The filters' sigmas.
    sigma: Vec<f32>,
    /// The ridge's difference from the filters' centre on each line, px, by its weight; the weight, 1/px²; 1 where there are both, else 0.
    differences: [Vec<f64>; 3],
    /// Mean difference over the neighbours, as far as it is more than chance, and what that leaves unsure, px.
    shift: Vec<f64>,
    unsure: Vec<f64>,
    /// Least of the neighbours' sigmas.
    least: Vec<f32>,
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
        onto.compare(self.level, stripe);
        let Onto { points, sigma, .. } = &onto;
        let sigma = &sigma[REACH..];
        let lines = stripe.len();
        let edged = stripe.flags.iter().any(|flags| flags.contains(Flags::EDGE));
        for line in 0..lines {
            if stripe.position_px[line].is_nan() {
                continue;
            }
            if points.position[line].is_nan() {
                if self.pools_at(line, lines) {
                    stripe.drop_line(line, Reject::NotConverged);
                }
                continue;
            }
            let (shift, unsure) = (onto.shift[line], onto.unsure[line]);
            let mut edge = 0.0;
            if edged {
                let shared = (SHARED_WIDTHS * stripe.width_px[line].max(0.0)).ceil() as usize;
                let edges = line.saturating_sub(shared)..(line + shared + 1).min(lines);
                edge = edges
                    .filter(|i| stripe.flags[*i].contains(Flags::EDGE) && !sigma[*i].is_nan())
                    .map(|i| f64::from(sigma[i]).powi(2) - f64::from(onto.least[line]).powi(2))
                    .fold(0.0, f64::max);
            }
            let speckle = f64::from(stripe.scatter_widths * stripe.width_px[line].max(0.0));
            let own = points.sigma[line];
            stripe.position_px[line] = (points.position[line] - shift) as f32;
            stripe.sigma_px[line] = (own * own + unsure * unsure + edge + speckle * speckle).sqrt() as f32;
            stripe.amplitude[line] = points.amplitude[line] as f32;
            stripe.background[line] = points.background[line] as f32;
        }
        self.onto = onto;
    }
}

impl Onto {
    /// Compares the ridge with the filters' centres over neighbouring lines.
    fn compare(&mut self, level: Level, stripe: &Stripe) {
        let lines = stripe.len();
        let chunks = lines.next_multiple_of(CHUNK);
        for of in &mut self.differences {
            of.clear();
            of.resize(chunks + 2 * REACH, 0.0);
        }
        self.sigma.clear();
        self.sigma.resize(chunks + 2 * REACH, f32::INFINITY);
        self.sigma[REACH..][..lines].copy_from_slice(&stripe.sigma_px);
        self.shift.resize(chunks, 0.0);
        self.unsure.resize(chunks, 0.0);
        self.least.resize(chunks, 0.0);
        dispatch!(level, _simd => self.compare_here(&stripe.position_px));
    }

    #[inline(always)]
    fn compare_here(&mut self, centres: &[f32]) {
        let [weighted, weights, counts] = &mut self.differences;
        let own = weighted[REACH..].iter_mut().zip(&mut weights[REACH..]).zip(&mut counts[REACH..]);
        let sources = centres.iter().zip(&self.points.position).zip(&self.sigma[REACH..]);
        for (((weighted, weight), count), ((centre, position), sigma)) in own.zip(sources) {
            let difference = position - f64::from(*centre);
            // NaN counts as nothing.
            let told = (difference.abs() >= 0.0) & (*sigma > 0.0);
            let by = if told { 1.0 / (f64::from(*sigma) * f64::from(*sigma)) } else { 0.0 };
            (*weighted, *weight) = (if told { by * difference } else { 0.0 }, by);
            *count = f64::from(u8::from(told));
        }
        let [weighted, weights, counts] = &self.differences;
        for first in (0..self.shift.len()).step_by(CHUNK) {
            let (sum, weight, count) = (near(weighted, first), near(weights, first), near(counts, first));
            let (mut shift, mut unsure, mut least) = ([0.0; CHUNK], [0.0; CHUNK], [f32::INFINITY; CHUNK]);
            for k in 0..=2 * REACH {
                for (least, sigma) in least.iter_mut().zip(&self.sigma[first + k..][..CHUNK]) {
                    // NaN is not less.
                    *least = if *sigma < *least { *sigma } else { *least };
                }
            }
            for l in 0..CHUNK {
                let (mean, chance) = (sum[l] / weight[l], 1.0 / weight[l].sqrt());
                let doubt = SIGNIFICANT * chance / mean;
                let share = 1.0 - doubt * doubt;
                let told = (count[l] >= LEAST) & (share > 0.0);
                let (sure, rest) = (share * chance, (1.0 - share) * mean);
                shift[l] = if told { share * mean } else { 0.0 };
                unsure[l] = if told { (sure * sure + rest * rest).sqrt() } else { 0.0 };
            }
            self.shift[first..][..CHUNK].copy_from_slice(&shift);
            self.unsure[first..][..CHUNK].copy_from_slice(&unsure);
            self.least[first..][..CHUNK].copy_from_slice(&least);
        }
    }
}

/// Sums over the neighbours of a chunk's lines, a line's own entry being [`REACH`] further on.
#[inline(always)]
fn near(values: &[f64], first: usize) -> [f64; CHUNK] {
    let mut sums = [0.0; CHUNK];
    for k in 0..=2 * REACH {
        for (sum, value) in sums.iter_mut().zip(&values[first + k..][..CHUNK]) {
            *sum += value;
        }
    }
    sums
}
