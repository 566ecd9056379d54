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
use nalgebra::{SMatrix, SVector};

use super::lanes::CHUNK;
use super::window::{GROUP, Pair, Windows, split};
use crate::special::normal;
use crate::{NoiseModel, Pixel};

/// Levels, two an octave of 1 + ρ + κ.
const LEVELS: usize = 24;
/// Offset the filters are made for, px.
const PHASE: f64 = 0.25;
/// Half a window, in widths: where shot noise dominates, what lies beyond holds 0.5 % of the information.
const REACH_WIDTHS: f64 = 3.2;
/// Distance from the offset up to which a filter is still matched well enough, in widths: five hundredths are lost at its end.
const BELIEVED_WIDTHS: f64 = 0.5;
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
/// Degree of the polynomial that inverts t.
const DEGREE: usize = 5;

/// Coefficients by rising powers.
type Polynomial = [f32; DEGREE + 1];

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

/// Filters at one level, split in what is odd and what is even in k, in whole numbers: sums are exact whatever their order.
#[derive(Debug)]
struct Kernel {
    /// For each pair of pixels, the taps of the first and, above 16 bits, of the second: of shift and height, odd and even.
    taps: Vec<[[i32; 2]; 2]>,
    /// The same for what the model lacks: slope of the background and width.
    extra: Vec<[[i32; 2]; 2]>,
    /// What one is in the taps of shift, height, slope, width.
    unit: [f32; 4],
    /// Variances of the two for unit variance that is even, follows the stripe, follows its square.
    extra_noise: [[f32; 3]; 2],
    /// Shift of the centre by a background that slopes by its height a pixel.
    lean: f32,
    /// Shift from t, and its derivative.
    shift: Polynomial,
    rate: Polynomial,
    /// What the two read by the height on a stripe that lacks nothing, from t.
    expected: [Polynomial; 2],
    /// Range of t that the polynomial holds for.
    range: [f32; 2],
    /// Variance of D for unit variance that is even over the pixels, follows the stripe, follows its square.
    noise: [f32; 3],
    /// Share of a shift beside the offset that is lacking, by the logarithm of width that is read.
    lacking: f32,
    /// The height's tap in the middle.
    peak: f32,
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

/// A stripe of height 1 and width `w` centred on `c` at pixel k, and its derivative by c: integrated over the pixel.
pub(crate) fn profile(k: f64, c: f64, w: f64) -> (f64, f64) {
    let ((low_density, low), (high_density, high)) = (normal((k - 0.5 - c) / w), normal((k + 0.5 - c) / w));
    let unit = (2.0 * std::f64::consts::PI).sqrt();
    (unit * w * (high - low), -unit * (high_density - low_density))
}

/// Pixels on either side of the place: fewer than five tell less than five shapes.
fn half(width: f64) -> usize {
    ((REACH_WIDTHS * width + 0.5).ceil() as usize).max(2)
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

/// Shapes that a window is made of: height, shift, background; slope of the background and width, which the plain filters leave out.
const SHAPES: usize = 5;
const PLAIN: usize = 3;

impl Kernel {
    fn new(width: f64, half: usize, rho: f64, kappa: f64) -> Self {
        let taps = 2 * half + 1;
        let shapes: Vec<SVector<f64, SHAPES>> = (0..taps)
            .map(|i| {
                let k = i as f64 - half as f64;
                let (g, shift) = profile(k, PHASE, width);
                let step = 1e-3;
                // The height goes with 1/width at a given flux; here it is the shape of a given height that widens.
                let wider =
                    profile(k, PHASE, width * (1.0 + step)).0 - profile(k, PHASE, width * (1.0 - step)).0;
                SVector::from([g, shift, 1.0, k, wider / (2.0 * step)])
            })
            .collect();
        let weight = |r: &SVector<f64, SHAPES>| 1.0 / (1.0 + rho * r[0] + kappa * r[0] * r[0]);
        let mut normal = SMatrix::<f64, SHAPES, SHAPES>::zeros();
        for r in &shapes {
            normal += r * r.transpose() * weight(r);
        }
        // Shapes of which none is a sum of the others over five pixels and more: singular only where rounding makes them so.
        let plain =
            normal.fixed_view::<PLAIN, PLAIN>(0, 0).into_owned().try_inverse().unwrap_or_else(SMatrix::zeros);
        let full = normal.try_inverse().unwrap_or_else(SMatrix::zeros);
        let mut filters: Vec<[f64; 4]> = shapes
            .iter()
            .map(|r| {
                let few = plain * r.fixed_rows::<PLAIN>(0) * weight(r);
                let all = full * r * weight(r);
                [few[1], few[0], all[3], all[4]]
            })
            .collect();
        // All that follows is of the filters as they are in whole numbers.
        let whole: [Whole; 4] = std::array::from_fn(|which| Whole::of(&mut filters, which));
        let noise = |which: usize| {
            let mut sums = [0.0f32; 3];
            for (f, r) in filters.iter().zip(&shapes) {
                for (sum, power) in sums.iter_mut().zip([1.0, r[0], r[0] * r[0]]) {
                    *sum += (f[which] * f[which] * power) as f32;
                }
            }
            sums
        };
        let (shift, expected, range) = inversion(width, half, &filters);
        let lacking = lacking(width, half, &filters, (&shift, &expected[1]));
        let rate = std::array::from_fn(|k| if k < DEGREE { shift[k + 1] * (k + 1) as f32 } else { 0.0 });
        Self {
            taps: (0..=half).map(|j| [whole[0].taps[j], whole[1].taps[j]]).collect(),
            extra: (0..=half).map(|j| [whole[2].taps[j], whole[3].taps[j]]).collect(),
            unit: whole.each_ref().map(|w| w.unit),
            peak: filters[half][1] as f32,
            extra_noise: [noise(2), noise(3)],
            lean: filters.iter().zip(&shapes).map(|(f, r)| f[0] * r[3]).sum::<f64>() as f32,
            shift,
            rate,
            expected,
            range,
            noise: noise(0),
            lacking,
        }
    }
}

/// A filter in whole numbers.
struct Whole {
    /// For each pair of pixels, odd and even.
    taps: Vec<[i32; 2]>,
    unit: f32,
}

impl Whole {
    /// Rounds a filter of a window, and puts it back as it is then. What a constant background would add stays nothing.
    fn of(filters: &mut [[f64; 4]], which: usize) -> Self {
        /// Sum of taps by which pixels of 16 bits with a sign make no more than 32 bits.
        const LARGEST_SUM: f64 = u16::MAX as f64;
        const LARGEST: f64 = i16::MAX as f64;
        // What rounding adds to a tap's odd and even part at most.
        let added = 2.0 * filters.len() as f64;
        let last = filters.len() - 1;
        let part = |k: usize, sign: f64| 0.5 * (filters[k][which] + sign * filters[last - k][which]);
        let size = |k: usize| part(k, -1.0).abs() + part(k, 1.0).abs();
        let (sum, most) =
            (0..=last).map(size).fold((0.0f64, 0.0f64), |(sum, most), size| (sum + size, most.max(size)));
        let unit = (sum / (LARGEST_SUM - added).max(1.0)).max(most / (LARGEST - added).max(1.0));
        let whole = |value: f64| if unit > 0.0 { (value / unit).round() as i32 } else { 0 };
        let mut both: Vec<[i32; 2]> = (0..=last).map(|k| [whole(part(k, -1.0)), 0]).collect();
        // What rounding leaves of an even part goes to the next one: the flat ends of a wide filter would all be rounded the same way.
        let (mut sum, mut done) = (0.0, 0);
        for k in 0..last / 2 {
            sum += part(k, 1.0);
            let next = whole(sum);
            (both[k][1], both[last - k][1]) = (next - done, next - done);
            done = next;
        }
        both[last / 2][1] = -2 * done;
        for (filter, [odd, even]) in filters.iter_mut().zip(&both) {
            filter[which] = f64::from(odd + even) * unit;
        }
        let taps = both
            .chunks(2)
            .map(|pair| {
                let second = pair.get(1).copied().unwrap_or_default();
                // The lower half as it is without a sign.
                std::array::from_fn(|part| (pair[0][part] & 0xffff) | (second[part] << 16))
            })
            .collect();
        Self { taps, unit: unit as f32 }
    }
}

/// What the filters read of a noise-free stripe of height 1, of that shift and width.
fn read(filters: &[[f64; 4]], half: usize, (shift, width): (f64, f64)) -> [f64; 4] {
    let mut read = [0.0; 4];
    for (i, f) in filters.iter().enumerate() {
        let g = profile(i as f64 - half as f64, shift, width).0;
        read.iter_mut().zip(f).for_each(|(sum, f)| *sum += f * g);
    }
    read
}

/// By how much of itself a shift beside the offset is read too small, by the logarithm of width that is read with it: of noise-free stripes a little wider
/// and narrower than the filters.
fn lacking(width: f64, half: usize, filters: &[[f64; 4]], (shift, wider): (&Polynomial, &Polynomial)) -> f32 {
    const AWAY: f64 = 0.25;
    const WIDER: f64 = 0.08;
    let value = |c: &Polynomial, t: f64| c.iter().rev().fold(0.0, |sum, c| sum * t + f64::from(*c));
    let one = |(away, by): (f64, f64)| {
        let [moment, height, _, widening] = read(filters, half, (PHASE + away, width * (1.0 + by)));
        let t = moment / height;
        let found = value(shift, t) - PHASE;
        (away / found - 1.0) / (widening / height - value(wider, t))
    };
    let all = [(AWAY, WIDER), (AWAY, -WIDER), (-AWAY, WIDER), (-AWAY, -WIDER)].map(one);
    let mean = all.iter().sum::<f64>() / all.len() as f64;
    // Too narrow a filter tells no width.
    if mean.is_finite() { mean.clamp(0.0, 1.0) as f32 } else { 0.0 }
}

/// Polynomials in t = D/A for a stripe's shift and for what the extra filters read by its height, fitted to noise-free stripes, and the range
/// of t they were fitted to.
fn inversion(width: f64, half: usize, filters: &[[f64; 4]]) -> (Polynomial, [Polynomial; 2], [f32; 2]) {
    const STEPS: usize = 64;
    const TERMS: usize = DEGREE + 1;
    let reach = BELIEVED_WIDTHS * width;
    let (from, to) = (PHASE - 0.5 - reach, PHASE + 0.1 + reach);
    let mut normal = SMatrix::<f64, TERMS, TERMS>::zeros();
    let mut right = SMatrix::<f64, TERMS, 3>::zeros();
    let (mut low, mut high) = (f64::INFINITY, f64::NEG_INFINITY);
    for step in 0..=STEPS {
        let shift = from + (to - from) * step as f64 / STEPS as f64;
        let [moment, height, slope, wider] = read(filters, half, (shift, width));
        let t = moment / height;
        (low, high) = (low.min(t), high.max(t));
        let powers = SVector::<f64, TERMS>::from_fn(|k, _| t.powi(k as i32));
        normal += powers * powers.transpose();
        right += powers * SMatrix::<f64, 1, 3>::new(shift, slope / height, wider / height);
    }
    let solution = normal.cholesky().map_or_else(SMatrix::zeros, |c| c.solve(&right));
    let column = |c: usize| std::array::from_fn(|k| solution[(k, c)] as f32);
    (column(0), [column(1), column(2)], [low as f32, high as f32])
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn no_tap_is_off_by_more_than_its_neighbours_leave_it() {
        for width in [0.4, 2.0, 8.0, 50.0, 150.0] {
            let half = half(width);
            let profile: Vec<f64> =
                (0..=2 * half).map(|i| profile(i as f64 - half as f64, PHASE, width).0).collect();
            let even = profile.iter().sum::<f64>() / profile.len() as f64;
            let exact: Vec<[f64; 4]> = profile.iter().map(|value| [value - even; 4]).collect();
            let mut filters = exact.clone();
            let unit = f64::from(Whole::of(&mut filters, 0).unit);
            for (whole, exact) in filters.iter().zip(&exact) {
                assert!((whole[0] - exact[0]).abs() < 1.6 * unit, "{width}: {whole:?} for {exact:?}");
            }
        }
    }

    proptest! {
        /// Neither a tap nor a sum of pixels by taps is more than its bits hold, and an even background is nothing.
        #[test]
        fn whole_numbers_fit_whatever_the_filter(
            width in 0.05f64..120.0,
            rho in prop_oneof![Just(0.0), 1e-3f64..1e5],
            kappa in prop_oneof![Just(0.0), 1e-3f64..1e5],
        ) {
            let half = half(width);
            let kernel = Kernel::new(width, half, rho, kappa);
            for taps in [&kernel.taps, &kernel.extra] {
                prop_assert_eq!(taps.len(), half + 1);
                for which in 0..2 {
                    let parts = [0, 1].map(|part| {
                        let both = |pair: &[[i32; 2]; 2]| [pair[which][part] as i16, (pair[which][part] >> 16) as i16];
                        taps.iter().flat_map(both).map(i64::from).collect::<Vec<_>>()
                    });
                    let largest: i64 = parts.iter().flatten().map(|tap| tap.abs()).sum();
                    prop_assert!(largest * i64::from(i16::MIN).abs() <= i64::from(i32::MAX), "{largest}");
                    prop_assert!(parts.iter().all(|part| part.iter().sum::<i64>() == 0));
                    prop_assert!(parts.iter().all(|part| part[2 * half + 1] == 0));
                    let mirrored = |k: usize, sign: i64, part: &[i64]| part[k] == sign * part[2 * half - k];
                    prop_assert!((0..=half).all(|k| mirrored(k, -1, &parts[0]) && mirrored(k, 1, &parts[1])));
                }
            }
        }
    }
}
