//! Images of a stripe as a camera would take them, with what each line could tell at best.
//!
//! Light on the surface: a line of Gaussian cross section (standard deviation `line_px`, square to the stripe or along the row),
//! times the surface's strength there. Lens: Gaussian point-spread `spread_px`; for speckle it acts on the field, not on the
//! intensity (coherent imaging of a rough surface, J. W. Goodman, *Speckle Phenomena in Optics*, 2007, chapter 5), and `looks`
//! independent patterns add up. Pixels: the mean over their area, from [`FINE`] × [`FINE`] samples. Camera: Poisson electrons,
//! Gaussian read noise, rounding, clipping at zero and full scale. Nothing of it is shared with the extractor.

use rand::{SeedableRng, rngs::StdRng};
use rand_distr::{Distribution, Normal, Poisson, StandardNormal};

/// Samples a pixel side.
const FINE: usize = 4;
/// Reach of a Gaussian, in standard deviations.
const REACH: f64 = 6.0;
/// Half of the window that the bound rests on, in widths of the stripe.
const BOUND_REACH: f64 = 8.0;

/// Noise of a camera.
#[derive(Debug, Clone, Copy)]
pub struct Camera {
    pub electrons_per_dn: f64,
    pub read_noise_dn: f64,
    pub full_scale_dn: f64,
}

impl Camera {
    /// Variance of a grey value, DN².
    pub fn variance(&self, mean_dn: f64) -> f64 {
        mean_dn.max(0.0) / self.electrons_per_dn + self.read_noise_dn.powi(2) + 1.0 / 12.0
    }
}

pub type Curve = Box<dyn Fn(f64) -> f64>;
pub type Field = Box<dyn Fn(f64, f64) -> f64>;

/// A stripe that runs down the image, and what else sends light. Functions take image coordinates in px.
pub struct Optics {
    pub width: usize,
    pub height: usize,
    pub camera: Camera,
    /// Centre of the stripe on (fractional) row v.
    pub centre: Curve,
    /// Height of the imaged cross section where the stripe is straight, vertical and even, DN; varies where the albedo does.
    pub strength: Field,
    /// Everything else at (u, v), DN.
    pub background: Field,
    /// Standard deviation of the line on the surface, px.
    pub line_px: f64,
    /// The same of the lens's point-spread, px.
    pub spread_px: f64,
    /// Factor of `line_px` on (fractional) row v: where the line is out of focus.
    pub blur: Curve,
    /// True: the line keeps its cross section along the row however steep it is, as many generators draw it.
    pub sheared: bool,
    /// Independent speckle patterns; 0: light without speckle.
    pub looks: u32,
}

/// Expected grey values of a scene, row by row.
pub struct Exposure<'a> {
    scene: &'a Optics,
    /// The stripe's, without background, DN.
    stripe: Vec<f64>,
    /// Its derivative by a shift of the stripe along the row, DN/px.
    by_centre: Vec<f64>,
    background: Vec<f64>,
}

impl Optics {
    /// Standard deviation of the imaged cross section square to the stripe, before integration over pixels, px.
    pub fn sigma_px(&self) -> f64 {
        self.line_px.hypot(self.spread_px)
    }

    /// Expected image; `seed` chooses the speckle.
    pub fn expose(&self, seed: u64) -> Exposure<'_> {
        // The stripe goes on beyond the first and last row, and its light comes in through the lens.
        let margin = (REACH * self.spread_px).ceil() as usize;
        let (columns, rows) = (self.width * FINE, (self.height + 2 * margin) * FINE);
        let at = |i: usize| (i as f64 + 0.5) / FINE as f64 - 0.5;
        // The lens lowers the peak of a line by the ratio of widths; `strength` is what the image shall show.
        let gain = self.sigma_px() / self.line_px;
        let mut light = vec![0.0f32; columns * rows];
        for (j, row) in light.chunks_exact_mut(columns).enumerate() {
            let v = at(j) - margin as f64;
            let (centre, slope) =
                ((self.centre)(v), ((self.centre)(v + 1e-3) - (self.centre)(v - 1e-3)) / 2e-3);
            let along = self.line_px * (self.blur)(v) * if self.sheared { 1.0 } else { slope.hypot(1.0) };
            let first = ((centre - REACH * along).max(0.0) * FINE as f64) as usize;
            let last = ((centre + REACH * along + 1.0).max(0.0) * FINE as f64) as usize;
            for (i, value) in row.iter_mut().enumerate().take(last.min(columns)).skip(first) {
                let u = at(i);
                let t = (u - centre) / along;
                *value = (gain * (self.strength)(u, v) * (-0.5 * t * t).exp()) as f32;
            }
        }
        let light = if self.looks > 0 {
            self.coherent(&light, seed)
        } else {
            blurred(&light, columns, self.spread_px * FINE as f64)
        };
        let (mut stripe, mut by_centre, mut background) = (Vec::new(), Vec::new(), Vec::new());
        let sample = |i: usize, j: usize| f64::from(light[(margin * FINE + j) * columns + i]);
        for y in 0..self.height {
            for x in 0..self.width {
                let (mut sum, mut edges) = (0.0, 0.0);
                for j in y * FINE..(y + 1) * FINE {
                    sum += (x * FINE..(x + 1) * FINE).map(|i| sample(i, j)).sum::<f64>();
                    let edge =
                        |i: usize| 0.5 * (sample(i.saturating_sub(1), j) + sample(i.min(columns - 1), j));
                    edges += edge(x * FINE) - edge((x + 1) * FINE);
                }
                stripe.push(sum / (FINE * FINE) as f64);
                by_centre.push(edges / FINE as f64);
                let (u, v) = (x as f64, y as f64);
                let quarters = [(-0.25, -0.25), (0.25, -0.25), (-0.25, 0.25), (0.25, 0.25)];
                background
                    .push(quarters.iter().map(|(a, b)| (self.background)(u + a, v + b)).sum::<f64>() / 4.0);
            }
        }
        Exposure { scene: self, stripe, by_centre, background }
    }

    /// Intensity behind the lens of a rough surface under coherent light.
    fn coherent(&self, light: &[f32], seed: u64) -> Vec<f32> {
        let columns = self.width * FINE;
        // A Gaussian field of √2 times the width has the point-spread as its square.
        let spread = self.spread_px * FINE as f64 * std::f64::consts::SQRT_2;
        // Random phasors add in power: energy of the field's kernel against the sum of the intensity's.
        let power = 2.0 * spread * std::f64::consts::PI.sqrt();
        let scale = (power * power / (2.0 * f64::from(self.looks))) as f32;
        let mut sum = vec![0.0; light.len()];
        let mut rng = StdRng::seed_from_u64(seed ^ 0x5eed_0f5b_ec41);
        for _ in 0..2 * self.looks {
            let field: Vec<f32> = light
                .iter()
                .map(|&l| {
                    if l > 0.0 {
                        l.sqrt() * Distribution::<f32>::sample(&StandardNormal, &mut rng)
                    } else {
                        0.0
                    }
                })
                .collect();
            for (s, f) in sum.iter_mut().zip(blurred(&field, columns, spread)) {
                *s += scale * f * f;
            }
        }
        sum
    }
}

impl Exposure<'_> {
    /// Grey values of one shot, row by row.
    pub fn shoot(&self, seed: u64) -> Vec<u16> {
        let camera = &self.scene.camera;
        let mut rng = StdRng::seed_from_u64(seed);
        let read = Normal::new(0.0, camera.read_noise_dn).unwrap();
        self.stripe
            .iter()
            .zip(&self.background)
            .map(|(s, b)| {
                let electrons = (s + b) * camera.electrons_per_dn;
                let caught =
                    if electrons > 0.0 { Poisson::new(electrons).unwrap().sample(&mut rng) } else { 0.0 };
                let dn = caught / camera.electrons_per_dn + read.sample(&mut rng);
                dn.round().clamp(0.0, camera.full_scale_dn) as u16
            })
            .collect()
    }

    /// Cramér–Rao bound of each row's centre, px: from the Fisher matrix of centre, height and constant background with variance
    /// μ/K + r² + 1/12, pixels of μ at full scale left out. The width is taken as known, which a symmetric profile makes nearly
    /// free: an estimator that needs no width could reach the same bound.
    pub fn bounds(&self) -> Vec<f64> {
        let scene = self.scene;
        let rows = (0..scene.height).map(|y| {
            let centre = (scene.centre)(y as f64);
            let slope = (scene.centre)(y as f64 + 0.5) - (scene.centre)(y as f64 - 0.5);
            let half = BOUND_REACH * scene.sigma_px() * slope.hypot(1.0);
            let first = (centre - half).max(0.0) as usize;
            let last = ((centre + half).max(0.0) as usize).min(scene.width - 1);
            let mut information = nalgebra::Matrix3::<f64>::zeros();
            for i in y * scene.width + first..=y * scene.width + last {
                let mean = self.stripe[i] + self.background[i];
                if mean < scene.camera.full_scale_dn {
                    let gradient = nalgebra::Vector3::new(self.by_centre[i], self.stripe[i] / 100.0, 1.0);
                    information += gradient * gradient.transpose() / scene.camera.variance(mean);
                }
            }
            information.try_inverse().map_or(f64::NAN, |m| m[(0, 0)].sqrt())
        });
        rows.collect()
    }
}

/// Convolution with a Gaussian of unit sum along both directions; beyond the border there is nothing.
fn blurred(image: &[f32], columns: usize, sigma: f64) -> Vec<f32> {
    if sigma <= 0.0 {
        return image.to_vec();
    }
    let half = (4.0 * sigma).ceil() as usize;
    let mut kernel: Vec<f32> =
        (0..=2 * half).map(|k| (-0.5 * ((k as f64 - half as f64) / sigma).powi(2)).exp() as f32).collect();
    let sum: f32 = kernel.iter().sum();
    kernel.iter_mut().for_each(|k| *k /= sum);
    // Down the columns by adding whole rows; along the rows only where there is light.
    let rows = image.len() / columns;
    let mut down = vec![0.0f32; image.len()];
    for (j, source) in image.chunks_exact(columns).enumerate() {
        let Some(first) = source.iter().position(|v| *v != 0.0) else { continue };
        let last = source.iter().rposition(|v| *v != 0.0).unwrap_or(first);
        for (k, weight) in kernel.iter().enumerate() {
            if let Some(to) = (j + k).checked_sub(half).filter(|to| *to < rows) {
                let target = &mut down[to * columns + first..=to * columns + last];
                target.iter_mut().zip(&source[first..=last]).for_each(|(t, s)| *t += weight * s);
            }
        }
    }
    let mut out = vec![0.0f32; image.len()];
    for (source, target) in down.chunks_exact(columns).zip(out.chunks_exact_mut(columns)) {
        for (i, s) in source.iter().enumerate().filter(|(_, s)| **s != 0.0) {
            let from = i.saturating_sub(half);
            for (t, weight) in
                target[from..(i + half + 1).min(columns)].iter_mut().zip(&kernel[from + half - i..])
            {
                *t += weight * s;
            }
        }
    }
    out
}
