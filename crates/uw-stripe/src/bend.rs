//! What blur does to the centre where a stripe bends: found from the neighbouring lines, and taken back.
//!
//! A line cuts the stripe's curve u = f(v), of strength A(v), as blurred along the stripe as across it. Blur of variance w²
//! moves the centre of that cut, to second order, by
//!
//! δ = w² (½ f″ + f′ A′/A):
//!
//! curvature pulls it inwards, and a slope lets the brighter neighbour's light in. Both are large where a stripe runs out along
//! an object's outline, which is why the ends of stripes on balls and pipes are off by a tenth of a pixel and more, always to the
//! same side. A straight stripe, however steep, and one of even strength are left as they are.

use crate::precise::median;
use crate::profile::{Flags, Reject, Stripe};
use crate::special::ln;
use crate::verdict::run_reach;
use fearless_simd::{Level, Simd, dispatch};
use std::ops::Range;

/// Lines to either side that the local curve is fitted to.
const REACH_LINES: usize = 3;
/// Positions that a parabola needs to be more than drawn through its points.
const LEAST_LINES: usize = 4;
/// Standard deviation of the correction, as a share of it: what the second order leaves.
const UNSURE: f64 = 0.5;
/// A correction beyond this share of the stripe's width is no longer believed: the measurement is taken out.
const LIMIT_WIDTHS: f64 = 0.15;

/// Below so many sigmas of its own noise a bend is left alone, above it is shrunk towards that (James and Stein): where there is none,
/// a correction would only add noise.
const SIGNIFICANT: f64 = 3.0;
/// Change of ln strength from one line to the next beyond which the surface's brightness has an edge there, whose light does not mix as
/// that of an even change does.
const EDGE_STEP: f32 = 1.0;

/// The curve around each line; NaN where it is not known.
#[derive(Debug, Default)]
struct Curves {
    /// Natural logarithm of the strength.
    ln_strength: Vec<f32>,
    /// Whether the line goes on in the next one, and in the one before.
    onward: Vec<u8>,
    backward: Vec<u8>,
    slope: Vec<f64>,
    /// ½ f″ + f′ A′/A, 1/px.
    bend: Vec<f64>,
    /// Standard deviation of the bend from positions of unit noise, 1/px².
    noise_gain: Vec<f64>,
}

/// Takes back what blur does where a stripe bends; keeps its buffers.
#[derive(Debug, Default)]
pub(crate) struct Bends {
    curves: Curves,
    squares: Vec<f64>,
    sigmas: Vec<f64>,
    /// Which lines tell how wide the stripe is.
    plain: Vec<bool>,
}

impl Bends {
    /// Corrects the positions of `lines` for blur along a bent stripe, widens their sigmas by what that leaves unsure, and takes out those
    /// beyond belief.
    pub fn unbend(&mut self, level: Level, stripe: &mut Stripe, lines: Range<usize>) {
        let Self { curves, squares, sigmas, plain } = self;
        let position = &stripe.position_px[lines.clone()];
        let width = &stripe.width_px[lines.clone()];
        dispatch!(level, simd => curves.along(simd, position, width, &stripe.amplitude[lines.clone()]));
        curves.near_breaks(position);
        let share = {
            plain.clear();
            // An edge of brightness widens and narrows what crosses it, and bends the curve as far as that reaches.
            let edge = |flags: &Flags| flags.contains(Flags::EDGE);
            let any = stripe.flags.iter().any(edge);
            plain.extend(lines.clone().map(|line| {
                let near = line.saturating_sub(REACH_LINES)..(line + REACH_LINES + 1).min(stripe.flags.len());
                !any || !stripe.flags[near].iter().any(edge)
            }));
            dispatch!(level, simd => blur_along(simd, curves, width, plain))
        };
        // Width square to the stripe: a line cuts a steep one obliquely.
        squares.clear();
        sigmas.clear();
        for (i, line) in lines.clone().enumerate() {
            if !curves.bend[i].is_nan() {
                let slope = curves.slope[i];
                squares.push(f64::from(stripe.width_px[line]).powi(2) / (1.0 + share * slope * slope));
                // The stripe's usual noise: single sigmas are wide where a fit is poor, which a bend itself makes it.
                sigmas.push(f64::from(stripe.sigma_px[line]));
            }
        }
        if squares.is_empty() {
            return;
        }
        let square = median(squares);
        let (variance, limit) = (share * square, LIMIT_WIDTHS * square.sqrt());
        let sigma_px = median(sigmas);
        for (i, line) in lines.enumerate() {
            let bend = curves.bend[i];
            let noise = sigma_px * curves.noise_gain[i];
            if bend.is_nan() {
                continue;
            }
            let doubt = (SIGNIFICANT * noise / bend).powi(2);
            let sigma = f64::from(stripe.sigma_px[line]);
            if doubt.is_nan() || doubt >= 1.0 {
                // At an edge of brightness it may be real all the same.
                if stripe.flags[line].contains(Flags::EDGE) {
                    stripe.sigma_px[line] = sigma.hypot(variance * bend) as f32;
                }
                continue;
            }
            let shift = variance * bend * (1.0 - doubt);
            if shift.abs() > limit {
                stripe.drop_line(line, Reject::Bent);
            } else {
                let (unsure, noise) = (UNSURE * shift, variance * noise);
                stripe.sigma_px[line] = (sigma * sigma + unsure * unsure + noise * noise).sqrt() as f32;
                stripe.position_px[line] = (f64::from(stripe.position_px[line]) - shift) as f32;
            }
        }
    }
}

/// Whether the stripe is blurred along as across (1), or only along its lines (0), as its widths tell: one cut obliquely by a line
/// looks √(1 + f′²) as wide, a blur along the lines as wide everywhere. Without steep lines to tell by, the lens is believed.
#[inline(always)]
fn blur_along<S: Simd>(_: S, curves: &Curves, width: &[f32], plain: &[bool]) -> f64 {
    /// Standard deviation of 1 beforehand, and of ln width² beyond its noise.
    const DOUBT: f64 = 0.5;
    const UNEVEN: f64 = 0.2;
    /// Sums that go beside each other.
    const LANES: usize = 8;
    let mut sums = [[0.0f64; LANES]; 5];
    let mut add = |l: usize, bend: f64, slope: f64, width: f32, plain: bool| {
        let used = plain & !bend.is_nan();
        // Logarithms of width² and of 1 + slope²; those of what is not used are anything.
        let w = f64::from(2.0 * ln(width));
        let s = f64::from(ln((1.0 + slope * slope) as f32));
        for (sum, term) in sums.iter_mut().zip([1.0, w, s, w * s, s * s]) {
            sum[l] += if used { term } else { 0.0 };
        }
    };
    let n = width.len();
    let (bend, slope, plain) = (&curves.bend[..n], &curves.slope[..n], &plain[..n]);
    for from in (0..n).step_by(LANES) {
        for l in 0..LANES.min(n - from) {
            let i = from + l;
            add(l, bend[i], slope[i], width[i], plain[i]);
        }
    }
    let [n, w, s, ws, ss] = sums.map(|lanes| lanes.iter().sum::<f64>());
    if n == 0.0 {
        return 1.0;
    }
    let (cross, square) = (ws - w * s / n, (ss - s * s / n).max(0.0));
    // Neighbours' widths go together: about one in ten lines says something of its own.
    let known = 0.1 * square / (UNEVEN * UNEVEN);
    let prior = DOUBT.powi(-2);
    let told = if square > 0.0 { cross / square } else { 1.0 };
    ((prior + known * told) / (prior + known)).clamp(0.0, 1.0)
}

impl Curves {
    /// The curves where all lines within reach belong to the run, as nearly everywhere: the offsets' odd moments are 0.
    #[inline(always)]
    fn along<S: Simd>(&mut self, _: S, position: &[f32], width: &[f32], amplitude: &[f32]) {
        const COUNT: usize = 2 * REACH_LINES + 1;
        /// Σ 1, Σ x², Σ x⁴ over the offsets, and the determinant of the first and the last.
        const MOMENTS: [f64; 3] = [7.0, 28.0, 196.0];
        const DETERMINANT: f64 = MOMENTS[0] * MOMENTS[2] - MOMENTS[1] * MOMENTS[1];
        let n = position.len();
        self.ln_strength.clear();
        self.ln_strength.extend(amplitude.iter().map(|a| ln(a.max(1e-6))));
        for links in [&mut self.onward, &mut self.backward] {
            links.clear();
            links.resize(n, 0);
        }
        for values in [&mut self.slope, &mut self.bend, &mut self.noise_gain] {
            values.clear();
            values.resize(n, f64::NAN);
        }
        let Some(steps) = n.checked_sub(1) else { return };
        let (here, next) = (&position[..steps], &position[1..][..steps]);
        let (widths, next_widths) = (&width[..steps], &width[1..][..steps]);
        let (strength, next_strength) = (&self.ln_strength[..steps], &self.ln_strength[1..][..steps]);
        let (onward, backward) = (&mut self.onward[..steps], &mut self.backward[1..][..steps]);
        for i in 0..steps {
            let step = (next[i] - here[i]).abs();
            let even = (next_strength[i] - strength[i]).abs() <= EDGE_STEP;
            onward[i] = u8::from(even & (step <= run_reach(widths[i])));
            backward[i] = u8::from(even & (step <= run_reach(next_widths[i])));
        }
        let Some(whole) = (n + 1).checked_sub(COUNT) else { return };
        let p: [&[f32]; COUNT] = std::array::from_fn(|k| &position[k..][..whole]);
        let a: [&[f32]; COUNT] = std::array::from_fn(|k| &self.ln_strength[k..][..whole]);
        let onward: [&[u8]; REACH_LINES] = std::array::from_fn(|k| &self.onward[REACH_LINES + k..][..whole]);
        let backward: [&[u8]; REACH_LINES] = std::array::from_fn(|k| &self.backward[1 + k..][..whole]);
        let slopes = &mut self.slope[REACH_LINES..][..whole];
        let bends = &mut self.bend[REACH_LINES..][..whole];
        let gains = &mut self.noise_gain[REACH_LINES..][..whole];
        for i in 0..whole {
            let (mut moments, mut growth) = ([0.0f64; 3], 0.0f64);
            for k in 0..COUNT {
                let x = k as f64 - REACH_LINES as f64;
                let u = f64::from(p[k][i] - p[REACH_LINES][i]);
                moments = [moments[0] + u, moments[1] + x * u, moments[2] + x * x * u];
                growth += x * f64::from(a[k][i]);
            }
            let curvature = (MOMENTS[0] * moments[2] - MOMENTS[1] * moments[0]) / DETERMINANT;
            let (slope, growth) = (moments[1] / MOMENTS[1], growth / MOMENTS[1]);
            let joined =
                onward[0][i] & onward[1][i] & onward[2][i] & backward[0][i] & backward[1][i] & backward[2][i];
            let known = joined == 1;
            slopes[i] = if known { slope } else { f64::NAN };
            bends[i] = if known { curvature + slope * growth } else { f64::NAN };
            gains[i] = (growth * growth / MOMENTS[1] + MOMENTS[0] / DETERMINANT).sqrt();
        }
    }

    /// The curves near the ends of runs, from fewer lines.
    fn near_breaks(&mut self, position: &[f32]) {
        for line in 0..position.len() {
            if self.bend[line].is_nan()
                && !position[line].is_nan()
                && let Some([slope, bend, noise_gain]) = self.local(position, line)
            {
                (self.slope[line], self.bend[line], self.noise_gain[line]) = (slope, bend, noise_gain);
            }
        }
    }

    /// A parabola through the positions and a straight line through the logarithm of the strengths around `line`, over the unbroken
    /// run that it belongs to: slope, bend and its gain of noise; `None` where that is too short.
    fn local(&self, position: &[f32], line: usize) -> Option<[f64; 3]> {
        let (mut first, mut last) = (line, line);
        while line - first < REACH_LINES && self.backward[first] == 1 {
            first -= 1;
        }
        while last - line < REACH_LINES && self.onward[last] == 1 {
            last += 1;
        }
        if last + 1 - first < LEAST_LINES {
            return None;
        }
        // Moments of the offsets from `line`, and of positions and strengths with them.
        let (mut m, mut p, mut s) = ([0.0; 5], [0.0; 3], [0.0; 2]);
        for i in first..=last {
            let x = i as f64 - line as f64;
            let powers = [1.0, x, x * x, x * x * x, x * x * x * x];
            let (u, strength) = (f64::from(position[i] - position[line]), f64::from(self.ln_strength[i]));
            (0..5).for_each(|k| m[k] += powers[k]);
            (0..3).for_each(|k| p[k] += powers[k] * u);
            (0..2).for_each(|k| s[k] += powers[k] * strength);
        }
        let normal = nalgebra::Matrix3::new(m[0], m[1], m[2], m[1], m[2], m[3], m[2], m[3], m[4]);
        let factor = normal.cholesky()?;
        let curve = factor.solve(&nalgebra::Vector3::from(p));
        let growth = (m[0] * s[1] - m[1] * s[0]) / (m[0] * m[2] - m[1] * m[1]);
        let bend = curve.z + curve.y * growth;
        // The bend is linear in the positions: its variance is gᵀ N⁻¹ g of theirs, g picking curvature and slope.
        let picked = nalgebra::Vector3::new(0.0, growth, 1.0);
        let noise_gain = picked.dot(&factor.solve(&picked)).max(0.0).sqrt();
        (bend.is_finite() && noise_gain.is_finite()).then_some([curve.y, bend, noise_gain])
    }
}
