//! Images of a stripe with known centres.
//!
//! Light: a Gaussian cross section of standard deviation `width` px perpendicular to nothing but the rows (so that
//! `width` is what a row shows), its centre a function of the row, plus background. It is integrated over each pixel's
//! area by midpoints on a grid of 8 × 8, which shares nothing with the extractor's formula and includes the smear that a
//! slope brings. Camera: Poisson electrons, Gaussian read noise, rounding, clipping at zero and full scale.

use rand::{SeedableRng, rngs::StdRng};
use rand_distr::{Distribution, Normal, Poisson};

/// Midpoints a pixel side.
const FINE: usize = 8;

/// Scene and camera. Functions take image coordinates in px.
pub struct Scene<'a> {
    pub width: usize,
    pub height: usize,
    /// Centre of the stripe on (fractional) row v.
    pub centre: &'a dyn Fn(f64) -> f64,
    /// Height of the cross section at (u, v), DN; varies where albedo does.
    pub amplitude: &'a dyn Fn(f64, f64) -> f64,
    /// Standard deviation of the cross section along the row, px.
    pub sigma: f64,
    /// Everything else at (u, v), DN.
    pub background: &'a dyn Fn(f64, f64) -> f64,
    pub electrons_per_dn: f64,
    pub read_noise_dn: f64,
    pub full_scale_dn: f64,
}

pub fn none(_: f64, _: f64) -> f64 {
    0.0
}

impl Scene<'_> {
    /// Grey values, row by row.
    pub fn render(&self, seed: u64) -> Vec<u16> {
        let mut rng = StdRng::seed_from_u64(seed);
        let read = Normal::new(0.0, self.read_noise_dn).unwrap();
        let mut image = Vec::with_capacity(self.width * self.height);
        for y in 0..self.height {
            for x in 0..self.width {
                let electrons = self.light(x, y) * self.electrons_per_dn;
                let caught =
                    if electrons > 0.0 { Poisson::new(electrons).unwrap().sample(&mut rng) } else { 0.0 };
                let dn = caught / self.electrons_per_dn + read.sample(&mut rng);
                image.push(dn.round().clamp(0.0, self.full_scale_dn) as u16);
            }
        }
        image
    }

    /// Expected grey value of a pixel, DN.
    fn light(&self, x: usize, y: usize) -> f64 {
        let at = |i: usize, k: usize| i as f64 + (k as f64 + 0.5) / FINE as f64 - 0.5;
        let mut sum = 0.0;
        for j in 0..FINE {
            let v = at(y, j);
            let centre = (self.centre)(v);
            for i in 0..FINE {
                let u = at(x, i);
                let t = (u - centre) / self.sigma;
                let stripe = if t.abs() < 7.0 { (self.amplitude)(u, v) * (-0.5 * t * t).exp() } else { 0.0 };
                sum += stripe + (self.background)(u, v);
            }
        }
        sum / (FINE * FINE) as f64
    }
}

pub fn to_u8(image: &[u16]) -> Vec<u8> {
    image.iter().map(|&v| v.min(255) as u8).collect()
}
