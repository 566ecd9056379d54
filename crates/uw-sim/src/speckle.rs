//! Laser speckle: the grain of coherent light on a rough surface.

use crate::stripe::SAMPLES;
use nalgebra::Vector2;

/// Grain of one frame: the mean intensity of several independent random fields, each a Gaussian average of complex normal numbers on a
/// lattice of samples (J. W. Goodman, Speckle Phenomena in Optics, 2007, chapters 3 and 5): contrast 1/√(fields), correlated over the
/// average's width. Every number follows from the seed and its place alone.
pub(crate) struct Speckle {
    seed: u64,
    fields: u64,
    /// The mean of 1 that is left between the fields' contrast and the wanted one.
    share: f32,
    weights: Vec<f32>,
}

impl Speckle {
    /// Grain of this contrast (0 to 1) and width; `None` for none.
    pub(crate) fn new(seed: u64, contrast: f64, grain_px: f64) -> Option<Self> {
        if contrast <= 0.0 {
            return None;
        }
        let fields = (1.0 / (contrast * contrast)).floor().clamp(1.0, MOST_FIELDS);
        let sigma = (grain_px * SAMPLES as f64).max(1e-3);
        let reach = (2.5 * sigma).ceil() as i32;
        let weight = |k: i32| (-0.5 * (f64::from(k) / sigma).powi(2)).exp();
        let power: f64 = (-reach..=reach).map(|k| weight(k).powi(2)).sum();
        let weights = (-reach..=reach).map(|k| (weight(k) / power.sqrt()) as f32).collect();
        let share = (contrast * fields.sqrt()).min(1.0) as f32;
        Some(Self { seed, fields: fields as u64, share, weights })
    }

    /// Multiplies a pixel's samples by their grain.
    pub(crate) fn grain(&self, middle: &Vector2<f64>, light: &mut [[f32; SAMPLES]; SAMPLES]) {
        let n = self.weights.len();
        let reach = (n / 2) as i64;
        let (u, v) = (middle.x as i64 * SAMPLES as i64 - reach, middle.y as i64 * SAMPLES as i64 - reach);
        let side = SAMPLES + n - 1;
        let mut total = [[0.0_f32; SAMPLES]; SAMPLES];
        for field in 0..self.fields {
            // Two real fields make a complex one.
            for part in 0..2 {
                let key = mix(self.seed ^ mix(2 * field + part));
                let mut across = vec![0.0_f32; side * SAMPLES];
                for j in 0..side {
                    let line: Vec<f32> = (0..side).map(|i| normal(key, u + i as i64, v + j as i64)).collect();
                    for i in 0..SAMPLES {
                        let sum: f32 = self.weights.iter().zip(&line[i..]).map(|(w, x)| w * x).sum();
                        across[j * SAMPLES + i] = sum;
                    }
                }
                for (j, line) in total.iter_mut().enumerate() {
                    for (i, out) in line.iter_mut().enumerate() {
                        let rows = (0..n).map(|k| self.weights[k] * across[(j + k) * SAMPLES + i]);
                        *out += rows.sum::<f32>().powi(2);
                    }
                }
            }
        }
        let scale = 0.5 / self.fields as f32;
        for (light, total) in light.as_flattened_mut().iter_mut().zip(total.as_flattened()) {
            *light *= 1.0 + self.share * (scale * total - 1.0);
        }
    }
}

/// More fields than this would take long and show little: a contrast below 1/8 mixes grain with even light instead.
const MOST_FIELDS: f64 = 64.0;

/// A normal number that belongs to a place: the sum of four 16-bit uniform ones, whose kurtosis of 2.7 the averages over the lattice
/// take to 3.
fn normal(key: u64, u: i64, v: i64) -> f32 {
    let bits = mix(key ^ mix((u as u64) << 32 ^ (v as u64 & 0xffff_ffff)));
    let sum = (0..4).map(|k| bits >> (16 * k) & 0xffff).sum::<u64>() as f32;
    // Four uniform numbers have a variance of 4/12.
    (sum / 65536.0 - 2.0) * 3.0_f32.sqrt()
}

/// SplitMix64's finaliser (G. Steele, D. Lea, C. Flood, OOPSLA 2014).
pub(crate) fn mix(x: u64) -> u64 {
    let x = x.wrapping_add(0x9E37_79B9_7F4A_7C15);
    let x = (x ^ (x >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
    let x = (x ^ (x >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
    x ^ (x >> 31)
}
