//! Steger's ridge detector, evaluated at candidates only.
//!
//! The stripe's centre is where the image, smoothed by a Gaussian of the stripe's width, has no slope across the direction of its
//! greatest curvature (C. Steger, PAMI 20 (1998) 113, section 3). Smoothing in two dimensions follows a steep stripe as it does an
//! upright one, and pools along it: a position draws on some 3.5 widths of neighbouring lines, so its sigma may lie below the bound of
//! a single line, and neighbours' errors go together.
//!
//! Where we differ: only the pixels around a candidate are smoothed. The step from the pixel's centre to the ridge is that of a
//! Gaussian, not of a parabola, which is off by up to 0.04 px half a pixel away. And what the smoothing takes away from a bend is given
//! back: of curvature κ it moves the ridge by ½ σ² κ inwards (the Laplacian in polar coordinates), along a line by ½ σ² f″/(1 + f′²).

use fearless_simd::{Level, Simd, SimdBase, dispatch, f32x16};

use crate::engine::lanes::CHUNK;
use crate::{Axis, NoiseModel, Pixel, View};

mod onto;
mod straight;
#[cfg(test)]
mod tests;

/// Half a kernel in its sigmas; what is beyond is 1 % of a second derivative.
const REACH: f64 = 3.0;
/// Narrowest and widest kernel, px: below, samples a pixel apart no longer make derivatives.
const SIGMAS: std::ops::RangeInclusive<f64> = 0.8..=8.0;
/// Moves to another pixel before a candidate is given up.
const MOVES: usize = 4;
/// A ridge further off than that belongs to another pixel: Steger's own program allows 0.6 px.
const BELONGS_PX: f32 = 0.6;
/// Least share of the normal along the line: slopes to 4.
const LEAST_ALONG: f32 = 0.24;
/// Of a stripe's light the kernel's square takes (2/3)^1.5, of the light's square (1/2)^1.5.
const SHOT: f32 = 0.544_331;
const SPECKLE: f32 = 0.353_553;
/// Vectors of the widest kernel, and its rows.
const MOST: usize = 4;
const HIGHEST: usize = 2 * (REACH * *SIGMAS.end()) as usize + 1;

/// What six sums are made of: for each a vector of every line of a chunk.
type Products = [[[f32; CHUNK]; CHUNK]; 6];

/// The ridge on each line, and on as many more as make whole vectors; NaN where there is none. Positions in pixels of the whole image.
#[derive(Debug, Default)]
pub(crate) struct RidgePoints {
    /// Where the ridge crosses the line.
    pub position: Vec<f32>,
    /// Its predicted standard deviation, pooled along the ridge: px.
    pub sigma: Vec<f32>,
    /// Change of the position from a line to the next.
    pub slope: Vec<f32>,
    /// Peak height, DN, if the stripe has the kernel's width.
    pub amplitude: Vec<f32>,
    /// Grey value under it, DN.
    pub background: Vec<f32>,
}

impl RidgePoints {
    /// Without a point on any of so many lines.
    fn reset(&mut self, lines: usize) {
        for of in
            [&mut self.position, &mut self.sigma, &mut self.slope, &mut self.amplitude, &mut self.background]
        {
            of.clear();
            of.resize(lines.next_multiple_of(CHUNK), f32::NAN);
        }
    }

    /// Those of a chunk that begins with line `first`, in the order of the fields.
    #[inline(always)]
    fn chunk(&mut self, first: usize) -> [&mut [f32; CHUNK]; 5] {
        [&mut self.position, &mut self.sigma, &mut self.slope, &mut self.amplitude, &mut self.background]
            .map(|of| &mut of.as_chunks_mut().0[first / CHUNK])
    }
}

/// Kernels and memory for stripes of one width.
#[derive(Debug)]
pub(crate) struct Ridge {
    sigma: f64,
    half: usize,
    /// Gaussian, first and second derivative, padded with zeros.
    kernels: [Vec<f32>; 3],
    straight: straight::Straight,
    /// Instructions of the processor at hand.
    level: Level,
    onto: onto::Onto,
}

impl Ridge {
    /// Kernels for a stripe of standard deviation `width_px` across, in the instructions of `level`.
    pub fn new(width_px: f64, level: Level) -> Self {
        /// Either side of the middle, in sigmas.
        const OFF: f64 = 0.05;
        let sigma = if width_px.is_finite() {
            width_px.clamp(*SIGMAS.start(), *SIGMAS.end())
        } else {
            *SIGMAS.start()
        };
        let half = (REACH * sigma).ceil() as usize;
        // A whole number of vectors.
        let lanes = match (2 * half + 1).div_ceil(CHUNK) {
            few @ 1..=2 => few * CHUNK,
            _ => MOST * CHUNK,
        };
        let taps = |f: &dyn Fn(f64) -> f64| -> Vec<f64> {
            (0..=2 * half).map(|i| f((i as f64 - half as f64) / sigma)).collect()
        };
        let gauss = |t: f64| (-0.5 * t * t).exp();
        let smooth = taps(&gauss);
        let slope = taps(&|t| t * gauss(t));
        let mut bend = taps(&|t| (t * t - 1.0) * gauss(t));
        // An even background shall have no bend, cut off as the kernel is.
        let even = bend.iter().sum::<f64>() / smooth.iter().sum::<f64>();
        bend.iter_mut().zip(&smooth).for_each(|(b, s)| *b -= even * s);
        // What that takes from the bend of a stripe of the kernel's width is found from how its slope grows away from the middle.
        let stripe = |kernel: &[f64], off: f64| -> f64 {
            kernel.iter().zip(taps(&|t| gauss(t - off))).map(|(k, light)| k * light).sum()
        };
        let grows = (stripe(&slope, OFF) - stripe(&slope, -OFF)) / (2.0 * OFF);
        let right = -grows / stripe(&bend, 0.0);
        bend.iter_mut().for_each(|b| *b *= right);
        let unit = ((2.0 * std::f64::consts::PI).sqrt() * sigma).recip();
        let scaled = |k: Vec<f64>, by: f64| {
            let mut k: Vec<f32> = k.iter().map(|v| (v * by) as f32).collect();
            k.resize(lanes, 0.0);
            k
        };
        let kernels =
            [scaled(smooth, unit), scaled(slope, unit / sigma), scaled(bend, unit / (sigma * sigma))];
        Self {
            sigma,
            half,
            kernels,
            straight: straight::Straight::new(sigma),
            level,
            onto: onto::Onto::default(),
        }
    }

    /// Whether the kernel at `line` lies on the image's `lines`: beyond them a steep stripe does not go on, whatever is put there.
    pub fn pools_at(&self, line: usize, lines: usize) -> bool {
        line >= self.half && line + self.half < lines
    }

    /// Fills `points` with the ridge on each line of `image`: none where a line's candidate (position, px) is NaN or leads to no ridge, and
    /// where the kernel reaches beyond the lines.
    pub fn follow<P: Pixel>(
        &mut self,
        image: &View<'_, P>,
        axis: Axis,
        candidates: &[f32],
        noise: &NoiseModel,
        points: &mut RidgePoints,
    ) {
        points.reset(candidates.len());
        let (level, products) = (self.level, &mut [[[0.0; CHUNK]; CHUNK]; 6]);
        for (first, candidates) in (0..).step_by(CHUNK).zip(candidates.chunks(CHUNK)) {
            // The same sums in the same order on every level: only the registers differ.
            let memory = (&mut *products, &mut *points);
            dispatch!(level, simd => self.chunk(simd, (image, axis), (first, candidates), noise, memory));
        }
        self.straight.straighten(level, points);
    }

    /// The ridge next to the candidates of some lines, as smoothed.
    #[inline(always)]
    fn chunk<S: Simd, P: Pixel>(
        &self,
        simd: S,
        (image, axis): (&View<'_, P>, Axis),
        (first, candidates): (usize, &[f32]),
        noise: &NoiseModel,
        (products, points): (&mut Products, &mut RidgePoints),
    ) {
        let lines = axis.lines(image.width(), image.height());
        let length = match axis {
            Axis::PerRow => image.width(),
            Axis::PerColumn => image.height(),
        } as f32;
        // Pixels; NaN for none.
        let mut places = [f32::NAN; CHUNK];
        for (line, (place, candidate)) in (first..).zip(places.iter_mut().zip(candidates)) {
            let at = candidate.round();
            if at < length && self.pools_at(line, lines) {
                *place = at.max(0.0);
            }
        }
        for _ in 0..MOVES {
            // Sums of known length over registers.
            let smoothed = match self.kernels[0].len() / CHUNK {
                1 => self.smoothed::<S, P, 1>(simd, (image, axis), (first, &places), products),
                2 => self.smoothed::<S, P, 2>(simd, (image, axis), (first, &places), products),
                _ => self.smoothed::<S, P, MOST>(simd, (image, axis), (first, &places), products),
            };
            let found = self.ridges(&smoothed, noise);
            if !self.settle(&found, length, &mut places, points.chunk(first)) {
                break;
            }
        }
    }

    /// Takes what was found where the ridge belongs to the pixel; the others' places become those that it points to. False if there are none.
    #[inline(always)]
    fn settle(
        &self,
        found: &Found,
        length: f32,
        places: &mut [f32; CHUNK],
        [position, sigma, slope, amplitude, background]: [&mut [f32; CHUNK]; 5],
    ) -> bool {
        let most = self.sigma.max(1.0) as f32;
        let mut met = [f32::NAN; CHUNK];
        let mut moved = 0u32;
        for l in 0..CHUNK {
            let (from, step) = (places[l], found.step[l]);
            // NaN is no ridge.
            let ridge = !from.is_nan() & (found.along[l] >= LEAST_ALONG);
            let belongs = step.abs() <= BELONGS_PX;
            met[l] = if ridge & belongs { from + step } else { f32::NAN };
            let to = from + step.clamp(-most, most).round();
            let moves = ridge & !belongs & (to >= 0.0) & (to < length);
            places[l] = if moves { to } else { f32::NAN };
            moved += u32::from(moves);
        }
        for (to, from) in [
            (position, &met),
            (sigma, &found.sigma),
            (slope, &found.slope),
            (amplitude, &found.amplitude),
            (background, &found.background),
        ] {
            for l in 0..CHUNK {
                to[l] = if met[l].is_nan() { to[l] } else { from[l] };
            }
        }
        moved > 0
    }

    /// r and its derivatives along the lines (a) and across them (c) at a pixel of each line: r, ra, rc, raa, rac, rcc.
    #[inline(always)]
    fn smoothed<S: Simd, P: Pixel, const V: usize>(
        &self,
        simd: S,
        (image, axis): (&View<'_, P>, Axis),
        (first, places): (usize, &[f32; CHUNK]),
        products: &mut Products,
    ) -> [[f32; CHUNK]; 6] {
        // Those of lines without a place stay what they were, and nobody asks for their sums.
        for (l, place) in places.iter().enumerate().filter(|(_, place)| !place.is_nan()) {
            let (line, pixel) = (first + l, *place as usize);
            let (x, y) = match axis {
                Axis::PerRow => (pixel, line),
                Axis::PerColumn => (line, pixel),
            };
            let own = self.products::<S, P, V>(simd, image, x, y);
            for (products, own) in products.iter_mut().zip(own) {
                own.store_slice(&mut products[l]);
            }
        }
        let mut sums = [[0.0; CHUNK]; 6];
        for (sums, products) in sums.iter_mut().zip(&*products) {
            totals(simd, products).store_slice(sums);
        }
        let [r, rx, ry, rxx, rxy, ryy] = sums;
        match axis {
            Axis::PerRow => [r, rx, ry, rxx, rxy, ryy],
            Axis::PerColumn => [r, ry, rx, ryy, rxy, rxx],
        }
    }

    /// What r, rx, ry, rxx, rxy, ryy at pixel (x, y) are the sums of: down the columns first, all at once and two rows at a time, on which a
    /// kernel differs in its sign at most; then along the row.
    #[inline(always)]
    fn products<S: Simd, P: Pixel, const V: usize>(
        &self,
        simd: S,
        image: &View<'_, P>,
        x: usize,
        y: usize,
    ) -> [f32x16<S>; 6] {
        let [smooth, slope, bend] = &self.kernels;
        let half = self.half;
        let inside =
            x >= half && x - half + V * CHUNK <= image.width() && y >= half && y + half < image.height();
        let copy;
        let patch = if inside {
            image.starting_at(x - half, y - half)
        } else {
            copy = patch(image, (x, y), half, V * CHUNK);
            (copy.as_flattened(), MOST * CHUNK)
        };
        let mut down = [[f32x16::splat(simd, 0.0); 3]; V];
        for (down, value) in down.iter_mut().zip(row::<S, P, V>(simd, patch, half)) {
            (down[0], down[2]) = (value * smooth[half], value * bend[half]);
        }
        for k in 1..=half {
            let before = row::<S, P, V>(simd, patch, half - k);
            let after = row::<S, P, V>(simd, patch, half + k);
            for (down, (before, after)) in down.iter_mut().zip(before.into_iter().zip(after)) {
                let (even, odd) = (after + before, after - before);
                down[0] += even * smooth[half + k];
                down[1] += odd * slope[half + k];
                down[2] += even * bend[half + k];
            }
        }
        let mut along = [f32x16::splat(simd, 0.0); 6];
        for (v, down) in down.into_iter().enumerate() {
            let (smooth, slope, bend) = (taps(simd, smooth, v), taps(simd, slope, v), taps(simd, bend, v));
            along[0] += down[0] * smooth;
            along[1] += down[0] * slope;
            along[2] += down[1] * smooth;
            along[3] += down[0] * bend;
            along[4] += down[1] * slope;
            along[5] += down[2] * smooth;
        }
        along
    }

    /// Where the ridge crosses some lines, from r and its derivatives.
    #[inline(always)]
    fn ridges(&self, [r, ra, rc, raa, rac, rcc]: &[[f32; CHUNK]; 6], noise: &NoiseModel) -> Found {
        let sigma = self.sigma as f32;
        // The kernel widens the stripe's own variance by its own.
        let widened = 2.0 * sigma * sigma;
        let (dark, shot) = (noise.variance(0.0, 0.0) as f32, 1.0 / noise.gain_e_per_dn);
        let contrast = noise.speckle_contrast;
        // Of a curvature, and of a height.
        let (height, share) = (widened * widened.sqrt() / sigma, sigma / widened.sqrt());
        // The slope's kernel over the noise of a Gaussian stripe on an even background: ∫ (g′ g)² = 1/(8π σ⁴).
        let gain = 1.0 / (8.0 * std::f32::consts::PI * sigma.powi(4));
        let mut found = Found::default();
        for l in 0..CHUNK {
            let (raa, rac, rcc) = (raa[l], rac[l], rcc[l]);
            let root = (0.25 * (raa - rcc) * (raa - rcc) + rac * rac).sqrt();
            let curvature = 0.5 * (raa + rcc) - root;
            // The eigenvector, of the two forms that with no cancellation.
            let (na, nc) = if raa <= rcc { (curvature - rcc, rac) } else { (rac, curvature - raa) };
            let norm = (na * na + nc * nc).sqrt();
            let unit = 1.0 / norm;
            let (na, nc) = if norm > 0.0 { (na * unit, nc * unit) } else { (1.0, 0.0) };
            let (by_along, by_curvature) = (1.0 / na, 1.0 / curvature);
            let parabola = -(ra[l] * na + rc[l] * nc) * by_curvature;
            found.step[l] = gaussian_step(parabola, 1.0 / widened) * by_along;
            found.slope[l] = -nc * by_along;
            found.along[l] = if curvature < 0.0 { na.abs() } else { f32::NAN };
            let amplitude = -curvature * height;
            let background = r[l] - amplitude * share;
            let speckle = contrast * amplitude;
            let variance =
                dark + (background.max(0.0) + amplitude * SHOT) * shot + speckle * speckle * SPECKLE;
            found.sigma[l] = (variance * gain).sqrt() * (by_curvature * by_along).abs();
            found.amplitude[l] = amplitude;
            found.background[l] = background;
        }
        found
    }
}

/// Where the ridge crosses some lines, as far as can be told from one pixel of each.
#[derive(Default)]
struct Found {
    /// From the pixel's centre, px.
    step: [f32; CHUNK],
    /// The normal's share along the line; NaN where there is no ridge.
    along: [f32; CHUNK],
    sigma: [f32; CHUNK],
    slope: [f32; CHUNK],
    amplitude: [f32; CHUNK],
    background: [f32; CHUNK],
}

/// So many pixels of each row around (x, y), `half` of them before and as many rows above and below; the border is repeated beyond it.
#[inline(never)]
fn patch<P: Pixel>(
    image: &View<'_, P>,
    (x, y): (usize, usize),
    half: usize,
    width: usize,
) -> [[P; MOST * CHUNK]; HIGHEST] {
    let mut patch = [[P::ZERO; MOST * CHUNK]; HIGHEST];
    for (k, to) in patch[..=2 * half].iter_mut().enumerate() {
        let row = image.row((y + k).saturating_sub(half).min(image.height() - 1));
        for (i, to) in to[..width].iter_mut().enumerate() {
            *to = row[(x + i).saturating_sub(half).min(row.len() - 1)];
        }
    }
    patch
}

/// Grey values at the start of row `k` of pixels so many to a row.
#[inline(always)]
fn row<S: Simd, P: Pixel, const V: usize>(
    simd: S,
    (pixels, stride): (&[P], usize),
    k: usize,
) -> [f32x16<S>; V] {
    let mut values = [f32x16::splat(simd, 0.0); V];
    for (to, from) in values.iter_mut().zip(pixels[k * stride..][..V * CHUNK].as_chunks().0) {
        *to = P::floats(simd, from);
    }
    values
}

/// A kernel's vector of that number.
#[inline(always)]
fn taps<S: Simd>(simd: S, kernel: &[f32], v: usize) -> f32x16<S> {
    f32x16::load_array_ref(simd, &kernel.as_chunks().0[v])
}

/// The total of each vector, in their order: interleaved in pairs, so that one of half of each remains, until each lane is one's.
#[inline(always)]
fn totals<S: Simd>(simd: S, vectors: &[[f32; CHUNK]; CHUNK]) -> f32x16<S> {
    let mut sums = [f32x16::splat(simd, 0.0); CHUNK];
    for (sum, vector) in sums.iter_mut().zip(vectors) {
        *sum = f32x16::load_array_ref(simd, vector);
    }
    let mut left = CHUNK;
    while left > 1 {
        left /= 2;
        for i in 0..left {
            sums[i] = pair(sums[i], sums[i + left]);
        }
    }
    sums[0]
}

/// Interleaved: every other lane is one's and every other the other's, each the sum of two of theirs.
#[inline(always)]
fn pair<S: Simd>(one: f32x16<S>, other: f32x16<S>) -> f32x16<S> {
    let (low, high) = one.interleave(other);
    low + high
}

/// Distance from the middle of a Gaussian, where one Newton step says `parabola` = d / (1 − d²/variance); the variance as its reciprocal.
#[inline(always)]
fn gaussian_step(parabola: f32, by_variance: f32) -> f32 {
    let ratio = parabola * parabola * by_variance;
    // 2/(1 + √(1 + 4 q)) is (−1 + √(1 + 4 q)) / 2q without the cancellation.
    parabola * 2.0 / (1.0 + (1.0 + 4.0 * ratio).sqrt())
}
