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
/// No pixel.
const NOWHERE: usize = usize::MAX;

/// The ridge on each line; NaN where there is none. Positions in pixels of the whole image.
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
            of.resize(lines, f32::NAN);
        }
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
        let level = self.level;
        for (first, candidates) in (0..).step_by(CHUNK).zip(candidates.chunks(CHUNK)) {
            // The same sums in the same order on every level: only the registers differ.
            dispatch!(level, simd => self.chunk(simd, (image, axis), (first, candidates), noise, points));
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
        points: &mut RidgePoints,
    ) {
        let lines = axis.lines(image.width(), image.height());
        let length = match axis {
            Axis::PerRow => image.width(),
            Axis::PerColumn => image.height(),
        };
        let mut pixels = [NOWHERE; CHUNK];
        for (line, (pixel, candidate)) in (first..).zip(pixels.iter_mut().zip(candidates)) {
            let at = candidate.round().max(0.0);
            if candidate.is_finite() && at < length as f32 && self.pools_at(line, lines) {
                *pixel = at as usize;
            }
        }
        for _ in 0..MOVES {
            // Sums of known length over registers.
            let smoothed = match self.kernels[0].len() / CHUNK {
                1 => self.smoothed::<S, P, 1>(simd, (image, axis), first, &pixels),
                2 => self.smoothed::<S, P, 2>(simd, (image, axis), first, &pixels),
                _ => self.smoothed::<S, P, MOST>(simd, (image, axis), first, &pixels),
            };
            let found = self.ridges(&smoothed, noise);
            let mut moved = false;
            for (l, pixel) in pixels.iter_mut().enumerate().filter(|(_, pixel)| **pixel != NOWHERE) {
                let (from, step) = (std::mem::replace(pixel, NOWHERE), found.step[l]);
                // NaN is no ridge.
                if found.along[l].is_nan() || found.along[l] < LEAST_ALONG {
                    continue;
                }
                if step.abs() <= BELONGS_PX {
                    points.position[first + l] = from as f32 + step;
                    points.sigma[first + l] = found.sigma[l];
                    points.slope[first + l] = found.slope[l];
                    points.amplitude[first + l] = found.amplitude[l];
                    points.background[first + l] = found.background[l];
                    continue;
                }
                let most = self.sigma.max(1.0) as f32;
                let to = from as f32 + step.clamp(-most, most).round();
                if (0.0..length as f32).contains(&to) {
                    *pixel = to as usize;
                    moved = true;
                }
            }
            if !moved {
                break;
            }
        }
    }

    /// r and its derivatives along the lines (a) and across them (c) at a pixel of each line: r, ra, rc, raa, rac, rcc.
    #[inline(always)]
    fn smoothed<S: Simd, P: Pixel, const V: usize>(
        &self,
        simd: S,
        (image, axis): (&View<'_, P>, Axis),
        first: usize,
        pixels: &[usize; CHUNK],
    ) -> [[f32; CHUNK]; 6] {
        let mut products = [[f32x16::splat(simd, 0.0); CHUNK]; 6];
        for (l, &pixel) in pixels.iter().enumerate().filter(|(_, pixel)| **pixel != NOWHERE) {
            let (x, y) = match axis {
                Axis::PerRow => (pixel, first + l),
                Axis::PerColumn => (first + l, pixel),
            };
            let own = self.products::<S, P, V>(simd, image, x, y);
            for (products, own) in products.iter_mut().zip(own) {
                products[l] = own;
            }
        }
        let mut sums = [[0.0; CHUNK]; 6];
        for (sums, products) in sums.iter_mut().zip(&products) {
            totals(products).store_slice(sums);
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
fn totals<S: Simd>(vectors: &[f32x16<S>; CHUNK]) -> f32x16<S> {
    let mut left = CHUNK / 2;
    let mut sums = [vectors[0]; CHUNK / 2];
    for i in 0..left {
        sums[i] = pair(vectors[i], vectors[i + left]);
    }
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

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{SeedableRng, rngs::StdRng};
    use rand_distr::{Distribution, StandardNormal};

    const NOISE: NoiseModel =
        NoiseModel { gain_e_per_dn: 1e6, read_noise_dn: 2.0, speckle_contrast: 0.0, full_scale_dn: 255.0 };

    /// A stripe of standard deviation `width` across, its distance from the curve taken square to it; noise of 2 DN.
    fn image(size: (usize, usize), centre: &dyn Fn(f64) -> f64, width: f64, seed: Option<u64>) -> Vec<u16> {
        let mut rng = StdRng::seed_from_u64(seed.unwrap_or(0));
        let pixels = (0..size.0 * size.1).map(|i| {
            let (x, y) = ((i % size.0) as f64, (i / size.0) as f64);
            let near = (-120..=120).map(|k| y + 0.1 * f64::from(k));
            let square = near.map(|v| (x - centre(v)).powi(2) + (y - v).powi(2)).fold(f64::MAX, f64::min);
            let error: f64 = if seed.is_some() {
                2.0 * Distribution::<f64>::sample(&StandardNormal, &mut rng)
            } else {
                0.0
            };
            (1000.0 + 150.0 * (-0.5 * square / (width * width)).exp() + error).round() as u16
        });
        pixels.collect()
    }

    /// Mean error, its RMS, and RMS of error over sigma, at lines away from the border.
    fn errors(centre: &dyn Fn(f64) -> f64, width: f64, seed: Option<u64>) -> (f64, f64, f64) {
        const SIZE: (usize, usize) = (140, 90);
        let pixels = image(SIZE, centre, width, seed);
        let view = View::packed(&pixels, SIZE.0, SIZE.1).unwrap();
        let candidates: Vec<_> = (0..SIZE.1).map(|y| (centre(y as f64) + 0.8) as f32).collect();
        let mut points = RidgePoints::default();
        Ridge::new(width, Level::new()).follow(&view, Axis::PerRow, &candidates, &NOISE, &mut points);
        let inner = 12..SIZE.1 - 12;
        let (mut mean, mut square, mut normal) = (0.0, 0.0, 0.0);
        for y in inner.clone() {
            let error = f64::from(points.position[y]) - centre(y as f64);
            mean += error;
            square += error * error;
            normal += (error / f64::from(points.sigma[y])).powi(2);
        }
        let n = inner.len() as f64;
        (mean / n, (square / n).sqrt(), (normal / n).sqrt())
    }

    #[test]
    fn straight_steep_and_bent_stripes_are_met_without_bias() {
        /// Rounding to whole DN of 150 alone, and what the third order leaves of a bend, px.
        const BIAS_PX: f64 = 0.002;
        const RMS_PX: f64 = 0.004;
        for width in [1.2, 2.0] {
            for (name, centre) in [
                ("upright", &(|v: f64| 70.3 + 0.01 * v) as &dyn Fn(f64) -> f64),
                ("steep", &|v| 15.2 + 1.2 * v),
                ("bent", &|v| 70.0 + 30.0 * (v / 25.0).sin()),
                ("arc", &|v| 60.0 + 0.012 * (v - 45.0).powi(2)),
            ] {
                let (mean, rms, _) = errors(centre, width, None);
                assert!(mean.abs() < BIAS_PX && rms < RMS_PX, "{name} {width}: bias {mean}, rms {rms}");
            }
        }
    }

    #[test]
    fn sigmas_are_those_of_the_scatter_and_below_a_single_lines() {
        /// Errors go together along the ridge, so that 8 × 66 lines are some 80 values.
        const WITHIN: std::ops::Range<f64> = 0.8..1.25;
        for slope in [0.02, 1.2] {
            let centre = move |v: f64| 16.3 + slope * v;
            let (mut squares, mut normals) = (0.0, 0.0);
            for seed in 0..8 {
                let (_, rms, normal) = errors(&centre, 2.0, Some(seed));
                (squares, normals) = (squares + rms * rms / 8.0, normals + normal * normal / 8.0);
            }
            assert!(WITHIN.contains(&normals.sqrt()), "slope {slope}: {}", normals.sqrt());
            // A line by itself: σ/A √(2w/√π).
            let single = 2.0 / 150.0 * (2.0 * 2.0 / std::f64::consts::PI.sqrt()).sqrt();
            assert!(squares.sqrt() < 0.8 * single * slope.hypot(1.0), "slope {slope}: {}", squares.sqrt());
        }
    }

    #[test]
    fn columns_are_rows_of_the_transposed_image_and_borders_no_trap() {
        let centre = |v: f64| 3.0 + 0.9 * v;
        let pixels = image((60, 50), &centre, 1.5, Some(3));
        let turned: Vec<u16> = (0..3000).map(|i| pixels[i % 50 * 60 + i / 50]).collect();
        let at = |y| if y == 20 { f32::NAN } else { centre(f64::from(y)) as f32 };
        let candidates: Vec<_> = (0..50).map(at).collect();
        let (mut rows, mut columns) = (RidgePoints::default(), RidgePoints::default());
        let mut ridge = Ridge::new(1.5, Level::new());
        ridge.follow(&View::packed(&pixels, 60, 50).unwrap(), Axis::PerRow, &candidates, &NOISE, &mut rows);
        ridge.follow(
            &View::packed(&turned, 50, 60).unwrap(),
            Axis::PerColumn,
            &candidates,
            &NOISE,
            &mut columns,
        );
        let found = rows.position.iter().filter(|p| !p.is_nan()).count();
        assert!(rows.position[20].is_nan() && found >= 38);
        for (a, b) in rows.position.iter().zip(&columns.position) {
            assert!((a.is_nan() && b.is_nan()) || (a - b).abs() < 1e-3, "{a} {b}");
        }
        let (one, strange) = ([7u16; 1], [f32::NAN, 1e9, -5.0]);
        ridge.follow(&View::packed(&one, 1, 1).unwrap(), Axis::PerRow, &strange, &NOISE, &mut rows);
        assert!(rows.position.iter().all(|p| p.is_nan()));
    }
}
