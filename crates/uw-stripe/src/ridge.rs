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

use fearless_simd::{Level, dispatch};

use crate::{Axis, NoiseModel, Pixel, View};

mod onto;

/// Half a kernel in its sigmas; what is beyond is 1 % of a second derivative.
const REACH: f64 = 3.0;
/// Narrowest and widest kernel, px: below, samples a pixel apart no longer make derivatives.
const SIGMAS: std::ops::RangeInclusive<f64> = 0.8..=8.0;
/// Pixels of a kernel are padded to multiples of this, so that loops have no remainder.
const LANES: usize = 8;
/// The widest kernel's pixels, padded.
const WIDEST: usize = 56;
/// Moves to another pixel before a candidate is given up.
const MOVES: usize = 4;
/// A ridge further off than that belongs to another pixel: Steger's own program allows 0.6 px.
const BELONGS_PX: f64 = 0.6;
/// Least share of the normal along the line: slopes to 4.
const LEAST_ALONG: f64 = 0.24;
/// Longest step of the centre from a line to the next in one stripe: pixels plus widths.
const STEP: (f64, f64) = (3.0, 2.0);
/// Of a stripe's light the kernel's square takes (2/3)^1.5, of the light's square (1/2)^1.5.
const SHOT: f64 = 0.544_331;
const SPECKLE: f64 = 0.353_553;
/// Half-length, in kernel sigmas, of the fit that tells the bend.
const BEND_REACH: f64 = 2.5;
/// Standard deviation of a bend's correction, as a share of it: what the second order leaves.
const UNSURE: f64 = 0.5;

/// A point of the ridge on a line; positions in pixels of the whole image.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct RidgePoint {
    /// Where the ridge crosses the line.
    pub position: f64,
    /// Its predicted standard deviation, pooled along the ridge: px.
    pub sigma: f64,
    /// Change of the position from a line to the next.
    pub slope: f64,
    /// Peak height, DN, if the stripe has the kernel's width.
    pub amplitude: f64,
    /// Grey value under it, DN.
    pub background: f64,
}

/// Kernels and memory for stripes of one width.
#[derive(Debug)]
pub(crate) struct Ridge {
    sigma: f64,
    half: usize,
    /// Gaussian, first and second derivative, padded with zeros.
    kernels: [Vec<f32>; 3],
    /// Noise after a bend's correction by that before.
    gain: f64,
    /// Instructions of the processor at hand.
    level: Level,
    first: Vec<Option<RidgePoint>>,
    onto: onto::Onto,
}

impl Ridge {
    /// Kernels for a stripe of standard deviation `width_px` across.
    pub fn new(width_px: f64) -> Self {
        /// Either side of the middle, in sigmas.
        const OFF: f64 = 0.05;
        let sigma = if width_px.is_finite() {
            width_px.clamp(*SIGMAS.start(), *SIGMAS.end())
        } else {
            *SIGMAS.start()
        };
        let half = (REACH * sigma).ceil() as usize;
        let lanes = match (2 * half + 1).next_multiple_of(LANES) {
            few if few <= 4 * LANES => few,
            _ => WIDEST,
        };
        let taps = |f: &dyn Fn(f64) -> f64| -> Vec<f64> {
            (0..=2 * half).map(|i| f((i as f64 - half as f64) / sigma)).collect()
        };
        let gauss = |t: f64| (-0.5 * t * t).exp();
        let smooth = taps(&gauss);
        let slope = taps(&|t| t * gauss(t));
        let mut bend = taps(&|t| (t * t - 1.0) * gauss(t));
        // An even background shall have no bend, cut off as the kernel is.
        let level = bend.iter().sum::<f64>() / smooth.iter().sum::<f64>();
        bend.iter_mut().zip(&smooth).for_each(|(b, s)| *b -= level * s);
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
            gain: straightening_gain(sigma),
            level: Level::new(),
            first: Vec::new(),
            onto: onto::Onto::default(),
        }
    }

    /// Whether the kernel at `line` lies on the image's `lines`: beyond them a steep stripe does not go on, whatever is put there.
    pub fn pools_at(&self, line: usize, lines: usize) -> bool {
        line >= self.half && line + self.half < lines
    }

    /// Fills `points` with the ridge on each line of `image`, `None` where a line's candidate (position, px) is `None` or leads to no
    /// ridge, and where the kernel reaches beyond the lines.
    pub fn follow<P: Pixel>(
        &mut self,
        image: &View<'_, P>,
        axis: Axis,
        candidates: &[Option<f32>],
        noise: &NoiseModel,
        points: &mut Vec<Option<RidgePoint>>,
    ) {
        let mut first = std::mem::take(&mut self.first);
        first.clear();
        first.extend(
            candidates
                .iter()
                .enumerate()
                .map(|(line, c)| c.and_then(|c| self.at(image, axis, line, c, noise))),
        );
        points.clear();
        points.extend((0..first.len()).map(|i| self.straightened(&first, i)));
        self.first = first;
    }

    /// The ridge next to one candidate, as smoothed.
    fn at<P: Pixel>(
        &self,
        image: &View<'_, P>,
        axis: Axis,
        line: usize,
        candidate: f32,
        noise: &NoiseModel,
    ) -> Option<RidgePoint> {
        let lines = axis.lines(image.width(), image.height());
        let length = match axis {
            Axis::PerRow => image.width(),
            Axis::PerColumn => image.height(),
        };
        if !self.pools_at(line, lines) || !candidate.is_finite() {
            return None;
        }
        let mut pixel = candidate.round().max(0.0) as usize;
        for _ in 0..MOVES {
            if pixel >= length {
                return None;
            }
            let (x, y) = match axis {
                Axis::PerRow => (pixel, line),
                Axis::PerColumn => (line, pixel),
            };
            let [r, rx, ry, rxx, rxy, ryy] = self.derivatives(image, x, y);
            // Along the line and across the lines.
            let (ra, rc, raa, rcc) = match axis {
                Axis::PerRow => (rx, ry, rxx, ryy),
                Axis::PerColumn => (ry, rx, ryy, rxx),
            };
            let root = (0.25 * (raa - rcc).powi(2) + rxy * rxy).sqrt();
            let curvature = 0.5 * (raa + rcc) - root;
            if curvature.is_nan() || curvature >= 0.0 {
                return None;
            }
            // The eigenvector, of the two forms that with no cancellation.
            let (na, nc) = if raa <= rcc { (curvature - rcc, rxy) } else { (rxy, curvature - raa) };
            let norm = (na * na + nc * nc).sqrt();
            let (na, nc) = if norm > 0.0 { (na / norm, nc / norm) } else { (1.0, 0.0) };
            if na.abs() < LEAST_ALONG {
                return None;
            }
            // The kernel widens the stripe's own variance by its own.
            let variance = 2.0 * self.sigma * self.sigma;
            let parabola = -(ra * na + rc * nc) / curvature;
            let step = gaussian_step(parabola, variance) / na;
            if step.abs() <= BELONGS_PX {
                let slope = -nc / na;
                return Some(self.point(pixel as f64 + step, slope, na.abs(), r, curvature, noise));
            }
            let to = pixel as f64 + step.clamp(-self.sigma.max(1.0), self.sigma.max(1.0)).round();
            if to < 0.0 {
                return None;
            }
            pixel = to as usize;
        }
        None
    }

    /// The point with its sigma: the slope's kernel over the noise of a Gaussian stripe on an even background.
    fn point(
        &self,
        position: f64,
        slope: f64,
        along: f64,
        value: f64,
        curvature: f64,
        noise: &NoiseModel,
    ) -> RidgePoint {
        let sigma = self.sigma;
        let widened = std::f64::consts::SQRT_2 * sigma;
        let amplitude = -curvature * widened.powi(3) / sigma;
        let background = value - amplitude * sigma / widened;
        // ∫ (g′ g)² = 1/(8π σ⁴).
        let dark = noise.variance(background.max(0.0), 0.0);
        let shot = noise.variance(amplitude + background.max(0.0), 0.0) - dark;
        let speckle = (f64::from(noise.speckle_contrast) * amplitude).powi(2);
        let pixel = dark + shot * SHOT + speckle * SPECKLE;
        let slope_sigma = (pixel / (8.0 * std::f64::consts::PI)).sqrt() / (sigma * sigma);
        RidgePoint { position, sigma: slope_sigma / (-curvature * along), slope, amplitude, background }
    }

    /// r, rx, ry, rxx, rxy, ryy of the image smoothed around pixel (x, y).
    fn derivatives<P: Pixel>(&self, image: &View<'_, P>, x: usize, y: usize) -> [f64; 6] {
        // The same sums in the same order on every level: only the registers differ.
        dispatch!(self.level, _simd => self.derivatives_here(image, x, y))
    }

    #[inline(always)]
    fn derivatives_here<P: Pixel>(&self, image: &View<'_, P>, x: usize, y: usize) -> [f64; 6] {
        // Loops of known length over registers.
        match self.kernels[0].len() / LANES {
            1 => self.sums::<P, LANES>(image, x, y),
            2 => self.sums::<P, { 2 * LANES }>(image, x, y),
            3 => self.sums::<P, { 3 * LANES }>(image, x, y),
            4 => self.sums::<P, { 4 * LANES }>(image, x, y),
            _ => self.sums::<P, WIDEST>(image, x, y),
        }
    }

    /// The sums behind [`Ridge::derivatives`], of kernels padded to `N`: down the columns first, all at once, then along the row.
    #[inline(always)]
    fn sums<P: Pixel, const N: usize>(&self, image: &View<'_, P>, x: usize, y: usize) -> [f64; 6] {
        let half = self.half;
        let mut down = [[0.0f32; N]; 3];
        let mut value = [0.0f32; N];
        let inside = x >= half && x - half + N <= image.width();
        for k in 0..=2 * half {
            let row = image.row((y + k).saturating_sub(half).min(image.height() - 1));
            if inside {
                for (to, from) in value.iter_mut().zip(&row[x - half..x - half + N]) {
                    *to = from.dn();
                }
            } else {
                for (i, to) in value.iter_mut().enumerate() {
                    *to = row[(x + i).saturating_sub(half).min(image.width() - 1)].dn();
                }
            }
            for (down, kernel) in down.iter_mut().zip(&self.kernels) {
                let weight = kernel[k];
                down.iter_mut().zip(&value).for_each(|(d, v)| *d += weight * v);
            }
        }
        let [smooth, slope, bend] = &self.kernels;
        [
            across(&down[0], smooth),
            across(&down[0], slope),
            across(&down[1], smooth),
            across(&down[0], bend),
            across(&down[1], slope),
            across(&down[2], smooth),
        ]
    }

    /// Point `i` with the smoothing's pull along a bend taken back, and its sigma widened by what that costs.
    fn straightened(&self, points: &[Option<RidgePoint>], i: usize) -> Option<RidgePoint> {
        let here = points[i]?;
        let reach = (BEND_REACH * self.sigma).ceil() as usize;
        let joined =
            |a: &RidgePoint, b: &RidgePoint| (a.position - b.position).abs() <= STEP.0 + STEP.1 * self.sigma;
        // As far on both sides as the shorter one goes: a bend told from one side only leans on the slope.
        let walk = |next: &dyn Fn(usize) -> Option<usize>| {
            let mut last = here;
            (1..=reach)
                .take_while(|k| {
                    let point = next(*k).and_then(|j| points.get(j).copied().flatten());
                    let on = point.is_some_and(|p| joined(&last, &p));
                    last = point.unwrap_or(last);
                    on
                })
                .count()
        };
        let side = walk(&|k| i.checked_sub(k)).min(walk(&|k| Some(i + k)));
        if side < 2 {
            return Some(here);
        }
        let (mut m2, mut m4, mut p0, mut p2, n) = (0.0, 0.0, 0.0, 0.0, (2 * side + 1) as f64);
        for (j, point) in points[i - side..=i + side].iter().enumerate() {
            let point = (*point)?;
            let x = j as f64 - side as f64;
            (m2, m4) = (m2 + x * x, m4 + x.powi(4));
            (p0, p2) = (p0 + point.position - here.position, p2 + x * x * (point.position - here.position));
        }
        let second = 2.0 * (p2 - p0 * m2 / n) / (m4 - m2 * m2 / n);
        let shift = 0.5 * self.sigma * self.sigma * second / (1.0 + here.slope * here.slope);
        let position = here.position - shift;
        // A shift within its own noise is no bend.
        let real = (shift * shift - 4.0 * here.sigma * here.sigma).max(0.0);
        let sigma = (here.sigma * self.gain).hypot(UNSURE * real.sqrt());
        position.is_finite().then_some(RidgePoint { position, sigma, ..here })
    }
}

/// Distance from the middle of a Gaussian of the given variance, where one Newton step says `parabola` = d / (1 − d²/variance).
fn gaussian_step(parabola: f64, variance: f64) -> f64 {
    let ratio = parabola * parabola / variance;
    // 2/(1 + √(1 + 4 q)) is (−1 + √(1 + 4 q)) / 2q without the cancellation.
    parabola * 2.0 / (1.0 + (1.0 + 4.0 * ratio).sqrt())
}

/// Noise after the bend's correction by that before, for an upright stripe: the correction sharpens what the kernel had smoothed.
fn straightening_gain(sigma: f64) -> f64 {
    let reach = (BEND_REACH * sigma).ceil() as i32;
    let n = f64::from(2 * reach + 1);
    let (m2, m4) =
        (-reach..=reach).fold((0.0, 0.0), |(a, b), x| (a + f64::from(x * x), b + f64::from(x).powi(4)));
    let sharpen = |x: i32| {
        let second = 2.0 * (f64::from(x * x) - m2 / n) / (m4 - m2 * m2 / n);
        f64::from(u8::from(x == 0)) - 0.5 * sigma * sigma * second
    };
    let smooth = |x: i32| (-0.5 * (f64::from(x) / sigma).powi(2)).exp();
    let half = (4.0 * sigma).ceil() as i32;
    let (mut before, mut after) = (0.0, 0.0);
    for at in -half - reach..=half + reach {
        before += smooth(at).powi(2);
        after += (-reach..=reach).map(|x| sharpen(x) * smooth(at - x)).sum::<f64>().powi(2);
    }
    (after / before).sqrt()
}

/// The sum along a row.
#[inline(always)]
fn across<const N: usize>(down: &[f32; N], kernel: &[f32]) -> f64 {
    let mut sums = [0.0f32; LANES];
    for (d, k) in down.chunks_exact(LANES).zip(kernel.chunks_exact(LANES)) {
        sums.iter_mut().zip(d).zip(k).for_each(|((s, d), k)| *s += d * k);
    }
    f64::from(sums.iter().sum::<f32>())
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
        let candidates: Vec<_> = (0..SIZE.1).map(|y| Some((centre(y as f64) + 0.8) as f32)).collect();
        let mut points = Vec::new();
        Ridge::new(width).follow(&view, Axis::PerRow, &candidates, &NOISE, &mut points);
        let inner = 12..SIZE.1 - 12;
        let (mut mean, mut square, mut normal) = (0.0, 0.0, 0.0);
        for y in inner.clone() {
            let point = points[y].unwrap();
            let error = point.position - centre(y as f64);
            mean += error;
            square += error * error;
            normal += (error / point.sigma).powi(2);
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
        let candidates: Vec<_> = (0..50).map(|y| (y != 20).then_some(centre(f64::from(y)) as f32)).collect();
        let (mut rows, mut columns) = (Vec::new(), Vec::new());
        let mut ridge = Ridge::new(1.5);
        ridge.follow(&View::packed(&pixels, 60, 50).unwrap(), Axis::PerRow, &candidates, &NOISE, &mut rows);
        ridge.follow(
            &View::packed(&turned, 50, 60).unwrap(),
            Axis::PerColumn,
            &candidates,
            &NOISE,
            &mut columns,
        );
        assert!(rows[20].is_none() && rows.iter().flatten().count() >= 38);
        for (a, b) in rows.iter().zip(&columns) {
            match (a, b) {
                (Some(a), Some(b)) => assert!((a.position - b.position).abs() < 1e-3, "{a:?} {b:?}"),
                (None, None) => {}
                _ => panic!("{a:?} against {b:?}"),
            }
        }
        let (one, strange) = ([7u16; 1], [Some(f32::NAN), Some(1e9), Some(-5.0)]);
        ridge.follow(&View::packed(&one, 1, 1).unwrap(), Axis::PerRow, &strange, &NOISE, &mut rows);
        assert!(rows.iter().all(Option::is_none));
    }
}
