//! The matched filter at the signal's own level of noise: linear estimates of a stripe's shift, height and background.
//!
//! Around an offset p a stripe of height A and width w on a background b is, to first order in its shift, x = A g(k − p) + D g′(k − p) + b
//! with D = A · shift. Weighted least squares with the variance 1 + ρ g + κ g² (ρ: shot noise of the peak by the background's variance;
//! κ: speckle's) makes each of A, D and b one sum over the window: the filter h_ρ(d) = d g / (1 + ρ g) of the Cramér–Rao bound with what it
//! takes to ignore a constant background. t = D/A is a known function of the shift; a polynomial inverts it.
//!
//! p is a quarter of a pixel to the side on which the stripe's centre lies, so that what is left is a quarter of a pixel and the filter is
//! matched to a thousandth. Levels of ρ + κ are half octaves; a group of 16 lines shares one, at the mean of their heights.
//!
//! Taps are rounded to whole numbers, two pixels of 16 bits are multiplied and added by one instruction, and sums of 32 bits are exact. What a filter of
//! rounded taps reads of a stripe is what t is inverted by, so that rounding costs a share of the noise that cannot be measured, and no bias.

use std::ops::Range;

use fearless_simd::{
    Bytes, Select, Simd, SimdBase, SimdFloat, SimdInt, SimdIntWiden, SimdMask, f32x16, i16x32, i32x16,
    mask32x16,
};

use super::lanes::CHUNK;
use super::window::{GROUP, Pair, Windows, split};
use crate::{NoiseModel, Pixel};
pub(crate) use kernel::profile;
use kernel::{BELIEVED_WIDTHS, DEGREE, Kernel, PHASE, Polynomial, half};

mod kernel;

/// Levels, two an octave of 1 + ρ + κ.
const LEVELS: usize = 24;
/// Height that divides where there is none, DN.
const LEAST_HEIGHT: f32 = 1e-3;
/// Sigmas by which a pixel must stand above what the height explains to be no part of a stripe.
const SPIKE_SIGMAS: f32 = 5.0;
/// Sigmas from which the slope of the background under a chunk of lines is taken out, and most that one line has a say: a hot pixel beside
/// its stripe is no haze.
const SIGNIFICANT: f32 = 4.0;
const MOST_SAY: f32 = 3.0;
/// Factors that leave one pixel of a pair.
const FIRST: i32 = 1;
const SECOND: i32 = 1 << 16;

/// The filters for one width and noise.
#[derive(Debug)]
pub(crate) struct Bank {
    /// Pixels on either side of the place.
    pub half: usize,
    pub width: f32,
    kernels: Vec<Kernel>,
    noise: NoiseModel,
    /// Variance of a pixel without light, DN².
    dark: f32,
    /// Least ratio of height to noise through a matched filter.
    min_snr: f32,
    /// Flux of a stripe of height 1.
    flux: f32,
    /// Largest grey value above the background, by the height, that still is a stripe's: midway, as ratios go, between a stripe's, 1, and that
    /// of a pixel that stands alone.
    peak: f32,
    /// Shift beyond which the window should be moved, px.
    pub recentre: f32,
    /// Whether shifts are made right by the width that is read, for lines whose width is known to be another: what it reads of others is mostly noise.
    corrects: bool,
}

/// What a group of lines yields; lane by lane.
#[derive(Debug)]
pub(crate) struct Estimates {
    /// Centre minus place, px.
    pub shift: [f32; GROUP],
    pub sigma: [f32; GROUP],
    pub amplitude: [f32; GROUP],
    pub background: [f32; GROUP],
    /// Square of the height through a matched filter minus that of the least one, up to a factor: negative where the signal is too weak.
    pub excess: [f32; GROUP],
    /// Largest grey value of the window, DN.
    pub top: [f32; GROUP],
    /// Slope of the background along the line by its standard deviation; only where asked for.
    pub slope: [f32; GROUP],
    /// Shift that the slope of the background makes in the plain filter, px; only where asked for.
    pub lean: [f32; GROUP],
    /// Natural logarithm of width by the filter's, and its standard deviation; only where asked for.
    pub ln_width: [f32; GROUP],
    pub sigma_ln_width: [f32; GROUP],
    /// Whether the largest grey value of some window is more than its height explains: a hot pixel, or a grain in the water.
    pub spike: bool,
}

impl Estimates {
    /// Chi-square over the two shapes that the filters lack, by their number.
    #[inline(always)]
    pub fn shape_chi2(&self, l: usize) -> f32 {
        let widening = self.ln_width[l] / self.sigma_ln_width[l];
        0.5 * (self.slope[l] * self.slope[l] + widening * widening)
    }
}

impl Default for Estimates {
    fn default() -> Self {
        let none = [0.0; GROUP];
        Self {
            shift: none,
            sigma: none,
            amplitude: none,
            background: none,
            excess: none,
            lean: none,
            top: none,
            slope: none,
            ln_width: none,
            sigma_ln_width: none,
            spike: false,
        }
    }
}

impl Bank {
    /// Filters for stripes of `width_px` in the given noise.
    pub fn new(width_px: f32, noise: NoiseModel, min_snr: f32) -> Self {
        let width = f64::from(width_px);
        let half = half(width);
        let dark = noise.variance(0.0, 0.0);
        let (shot, contrast) = (1.0 / f64::from(noise.gain_e_per_dn), f64::from(noise.speckle_contrast));
        let kernels = (0..LEVELS)
            .map(|level| {
                let excess = (2f64.powf(0.5 * (level as f64 + 0.5)) - 1.0) * dark;
                // The height A at which A shot + (A contrast)² is that much, in a form that holds where either is 0.
                let height =
                    2.0 * excess / (shot + (shot * shot + 4.0 * contrast * contrast * excess).sqrt());
                Kernel::new(width, half, height * shot / dark, (height * contrast).powi(2) / dark)
            })
            .collect();
        let flux = ((2.0 * std::f64::consts::PI).sqrt() * width) as f32;
        let plain = Kernel::new(width, half, 0.0, 0.0);
        Self {
            half,
            width: width_px,
            kernels,
            noise,
            dark: dark as f32,
            min_snr,
            flux,
            peak: plain.peak.max(f32::MIN_POSITIVE).sqrt().recip(),
            recentre: (PHASE + BELIEVED_WIDTHS * width) as f32,
            corrects: false,
        }
    }

    /// The same, for lines that are known to be of about that width: their shifts are made right by the width that is read.
    pub fn corrected(self) -> Self {
        Self { corrects: true, ..self }
    }

    /// Variance of a grey value: that of none, DN², and what each DN adds.
    pub fn variance_line(&self) -> (f32, f32) {
        (self.noise.variance(0.0, 0.0) as f32, self.noise.gain_e_per_dn.recip())
    }

    /// Shift, height and background of the lines of a group from their windows; with `EXTRA` also what the model lacks, and a correction
    /// where the background slopes.
    #[inline(always)]
    pub fn estimate<S: Simd, P: Pixel, const EXTRA: bool>(
        &self,
        simd: S,
        windows: &Windows<P>,
        lines: usize,
        out: &mut Estimates,
    ) {
        let chunks = lines.div_ceil(CHUNK);
        out.spike = false;
        // All levels first: what each waits for overlaps.
        let mut levels = [0; GROUP / CHUNK];
        for (chunk, level) in levels[..chunks].iter_mut().enumerate() {
            *level = self.level::<S, P>(simd, windows.chunk(chunk));
        }
        for (chunk, level) in levels[..chunks].iter().enumerate() {
            self.chunk::<S, P, EXTRA>(
                simd,
                windows.chunk(chunk),
                &self.kernels[*level],
                (chunk * CHUNK..lines, out),
            );
        }
    }

    /// The level of the filters for a chunk of lines.
    #[inline(always)]
    fn level<S: Simd, P: Pixel>(&self, simd: S, window: &[Pair]) -> usize {
        let noise = &self.noise;
        let (shot, dark) = (noise.gain_e_per_dn.recip(), self.dark);
        let outer = dot(simd, &window[0], FIRST) + dot(simd, &window[self.half], FIRST);
        let which = if self.half.is_multiple_of(2) { FIRST } else { SECOND };
        let middle = dot(simd, &window[self.half / 2], which);
        let around = outer.reduce_sum() as f32 * (0.5 / CHUNK as f32) + P::BIAS;
        let height = middle.reduce_sum() as f32 * (1.0 / CHUNK as f32) + P::BIAS - around;
        let contrast = noise.speckle_contrast * noise.speckle_contrast;
        let excess = height.max(0.0) * (shot + height * contrast);
        level(excess / (dark + around.max(0.0) * shot))
    }

    #[inline(always)]
    fn chunk<S: Simd, P: Pixel, const EXTRA: bool>(
        &self,
        simd: S,
        window: &[Pair],
        kernel: &Kernel,
        (lines, out): (Range<usize>, &mut Estimates),
    ) {
        let noise = &self.noise;
        let (shot, dark) = (noise.gain_e_per_dn.recip(), self.dark);
        let contrast = noise.speckle_contrast * noise.speckle_contrast;
        let (half, from) = (self.half, lines.start);
        let nothing = i32x16::splat(simd, 0);
        let (mut plain, mut extra, mut total) = ([[nothing; 2]; 2], [[nothing; 2]; 2], nothing);
        let mut top = i16x32::splat(simd, i16::MIN);
        for ((pair, taps), more) in window[..half].iter().zip(&kernel.taps).zip(&kernel.extra) {
            add(simd, &mut plain, pair, taps);
            if EXTRA {
                add(simd, &mut extra, pair, more);
            }
            total += dot(simd, pair, FIRST | SECOND);
            top = top.max(i16x32::load_array_ref(simd, pair));
        }
        // The second pixel of the last pair is none of the window's.
        let last = &window[half];
        add(simd, &mut plain, last, &kernel.taps[half]);
        if EXTRA {
            add(simd, &mut extra, last, &kernel.extra[half]);
        }
        total += dot(simd, last, FIRST);
        let least = both(simd, i32::from(i16::MAX) | i32::from(i16::MIN) << 16);
        top = top.max(i16x32::load_array_ref(simd, last).min(least));
        let bias = splat(simd, P::BIAS);
        let [first, second] = split(top);
        let top: f32x16<S> = first.max(second).to_float::<f32x16<S>>() + bias;
        let total = total.to_float::<f32x16<S>>() + bias * ((2 * half + 1) as f32);
        let zero = splat(simd, 0.0);
        // Inlined always, unlike closures: a call would lose the registers.
        let mirrored = Mirrored(plain[0][0].simd_lt(nothing));
        let moment = mirrored.sum(simd, plain[0], kernel.unit[0]);
        let height = mirrored.sum(simd, plain[1], kernel.unit[1]);
        // Where there is no stripe the height may be anything; the verdict falls on the ratio to its noise.
        let safe = height.max(splat(simd, LEAST_HEIGHT));
        let mut background = (total - height * self.flux) * ((2 * half + 1) as f32).recip();
        let base = background.max(zero) * shot + splat(simd, dark);
        let (own, speckle) = (safe * shot, safe * safe * contrast);
        let mut moment_variance = variance([base, own, speckle], &kernel.noise);
        let inverse = splat(simd, 1.0) / safe;
        let mut t = clamp(simd, moment * inverse, kernel.range);
        let mut stretch = splat(simd, 1.0);
        if EXTRA {
            // A stripe beside the offset looks a little wider, and leaning.
            let slope = mirrored.sum(simd, extra[0], kernel.unit[2]) * inverse
                - polynomial(simd, &kernel.expected[0], t);
            let slope_variance = variance([base, own, speckle], &kernel.extra_noise[0]);
            let z = slope * safe / slope_variance.sqrt();
            let widening = mirrored.sum(simd, extra[1], kernel.unit[3]) * inverse
                - polynomial(simd, &kernel.expected[1], t);
            let lean = slope * kernel.lean;
            mirrored.of(simd, z).store_slice(&mut out.slope[from..from + CHUNK]);
            lean.store_slice(&mut out.lean[from..from + CHUNK]);
            widening.store_slice(&mut out.ln_width[from..from + CHUNK]);
            let sigma = variance([base, own, speckle], &kernel.extra_noise[1]).sqrt() * inverse;
            sigma.store_slice(&mut out.sigma_ln_width[from..from + CHUNK]);
            if self.corrects {
                stretch += widening * kernel.lacking;
            }
            // What haze does to one line is hidden in its noise; sixteen neighbours show it.
            let say = mirrored.of(simd, clamp(simd, z, [-MOST_SAY, MOST_SAY]));
            if say.reduce_sum().abs() > SIGNIFICANT * (CHUNK as f32).sqrt() {
                t = clamp(simd, t - lean, kernel.range);
                moment_variance += slope_variance * (kernel.lean * kernel.lean);
            }
        }
        let offset = splat(simd, PHASE as f32);
        let shift = offset + (polynomial(simd, &kernel.shift, t) - offset) * stretch;
        let rate = polynomial(simd, &kernel.rate, t);
        background = background.max(zero);
        let sigma = moment_variance.sqrt() * rate * inverse;
        let matched = self.width * std::f32::consts::PI.sqrt();
        // Sign and square of the ratio to the noise of the dark: comparisons need no root.
        let excess = height.max(zero) * safe * matched - base * (self.min_snr * self.min_snr);
        let beyond = (top - background - height * self.peak).max(zero);
        let spike = (beyond * beyond).simd_gt((base + own) * (SPIKE_SIGMAS * SPIKE_SIGMAS)).to_bitmask();
        // Beyond the last line lies what was there before.
        out.spike |= spike & ((1 << lines.len().min(CHUNK)) - 1) != 0;
        mirrored.of(simd, shift).store_slice(&mut out.shift[from..from + CHUNK]);
        sigma.store_slice(&mut out.sigma[from..from + CHUNK]);
        height.store_slice(&mut out.amplitude[from..from + CHUNK]);
        background.store_slice(&mut out.background[from..from + CHUNK]);
        excess.store_slice(&mut out.excess[from..from + CHUNK]);
        top.store_slice(&mut out.top[from..from + CHUNK]);
    }
}

/// A pair of numbers, the first of them in the lower half of this one, in all lanes.
#[inline(always)]
fn both<S: Simd>(simd: S, pair: i32) -> i16x32<S> {
    i32x16::splat(simd, pair).bitcast()
}

/// Both pixels of a pair by their factors, added, line by line.
#[inline(always)]
fn dot<S: Simd>(simd: S, pixels: &Pair, factors: i32) -> i32x16<S> {
    i16x32::load_array_ref(simd, pixels).pairwise_dot_product(both(simd, factors))
}

/// Adds what a pair of pixels has of two filters, odd parts and even.
#[inline(always)]
fn add<S: Simd>(simd: S, sums: &mut [[i32x16<S>; 2]; 2], pixels: &Pair, taps: &[[i32; 2]; 2]) {
    for (sums, taps) in sums.iter_mut().zip(taps) {
        for (sum, tap) in sums.iter_mut().zip(taps) {
            *sum += dot(simd, pixels, *tap);
        }
    }
}

/// One number in all lanes.
#[inline(always)]
fn splat<S: Simd>(simd: S, value: f32) -> f32x16<S> {
    f32x16::splat(simd, value)
}

/// The polynomial's values.
#[inline(always)]
fn polynomial<S: Simd>(simd: S, c: &Polynomial, t: f32x16<S>) -> f32x16<S> {
    let mut sum = splat(simd, c[DEGREE]);
    for c in c[..DEGREE].iter().rev() {
        sum = sum * t + splat(simd, *c);
    }
    sum
}

/// Values held within a range.
#[inline(always)]
fn clamp<S: Simd>(simd: S, t: f32x16<S>, range: [f32; 2]) -> f32x16<S> {
    t.max(splat(simd, range[0])).min(splat(simd, range[1]))
}

/// Variance of a filter's output: its gains by the variances that are even, follow the stripe, follow its square.
#[inline(always)]
fn variance<S: Simd>(powers: [f32x16<S>; 3], gains: &[f32; 3]) -> f32x16<S> {
    powers[0] * gains[0] + powers[1] * gains[1] + powers[2] * gains[2]
}

/// The lines whose stripe lies to the left, where the filter is the mirror image.
#[derive(Clone, Copy)]
struct Mirrored<S: Simd>(mask32x16<S>);

impl<S: Simd> Mirrored<S> {
    /// A filter's output from its odd part and its even.
    #[inline(always)]
    fn sum(self, simd: S, [odd, even]: [i32x16<S>; 2], unit: f32) -> f32x16<S> {
        let odd = self.0.select(i32x16::splat(simd, 0) - odd, odd);
        (odd + even).to_float::<f32x16<S>>() * unit
    }

    /// A value with the sign that belongs to it.
    #[inline(always)]
    fn of(self, simd: S, v: f32x16<S>) -> f32x16<S> {
        self.0.select(splat(simd, 0.0) - v, v)
    }
}

/// Level of the filters for the ratio of a stripe's own variance to the background's: half octaves of 1 + ratio, read off the bits.
#[inline(always)]
fn level(ratio: f32) -> usize {
    let bits = (1.0 + ratio.max(0.0)).to_bits() >> 22;
    (bits.saturating_sub(127 << 1) as usize).min(LEVELS - 1)
}
