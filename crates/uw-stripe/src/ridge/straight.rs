//! What the smoothing takes away from a bend is given back.

use fearless_simd::{Level, Simd, SimdBase, dispatch, f32x16};

use super::RidgePoints;
use crate::engine::lanes::{CHUNK, part};

/// Half-length, in kernel sigmas, of the fit that tells the bend.
const REACH: f64 = 2.5;
/// Least lines on either side that tell one.
const LEAST: usize = 2;
/// Longest step of the centre from a line to the next in one stripe: pixels plus widths.
const STEP: (f64, f64) = (3.0, 2.0);
/// Standard deviation of a bend's correction, as a share of it: what the second order leaves.
const UNSURE: f32 = 0.5;

/// Weights and memory for kernels of one width.
#[derive(Debug)]
pub(super) struct Straight {
    sigma: f64,
    /// By the number of lines on either side: what each pair of lines, so many before and after, adds to the second derivative by the
    /// difference of its positions from the line's own.
    weights: Vec<Vec<f32>>,
    /// Noise after a bend's correction by that before.
    gain: f32,
    /// 0 where a line's stripe goes on in the next, else NaN.
    gap: Vec<f32>,
    /// Second derivatives; NaN where they cannot be told.
    second: Vec<f32>,
}

impl Straight {
    /// For kernels of standard deviation `sigma`, px.
    pub fn new(sigma: f64) -> Self {
        let reach = (REACH * sigma).ceil() as usize;
        let weights = (0..=reach).map(second_derivative).collect::<Vec<_>>();
        let gain = gain(sigma, &weights[reach]) as f32;
        let weights = weights.into_iter().map(|of| of.into_iter().map(|w| w as f32).collect()).collect();
        Self { sigma, weights, gain, gap: Vec::new(), second: Vec::new() }
    }

    /// Takes the smoothing's pull along bends back, and widens sigmas by what that costs.
    pub fn straighten(&mut self, level: Level, points: &mut RidgePoints) {
        dispatch!(level, simd => self.tell(simd, &points.position));
        for (line, position) in points.position.iter().enumerate() {
            if self.second[line].is_nan() && !position.is_nan() {
                self.second[line] = self.near_break(&points.position, line);
            }
        }
        dispatch!(level, simd => self.correct(simd, points));
    }

    /// The second derivatives where all lines within reach belong to one stripe, as nearly everywhere.
    #[inline(always)]
    fn tell<S: Simd>(&mut self, simd: S, position: &[f32]) {
        let (lines, reach) = (position.len(), self.weights.len() - 1);
        let longest = (STEP.0 + STEP.1 * self.sigma) as f32;
        self.gap.clear();
        // NaN goes on with nothing.
        let steps = position.iter().zip(position.get(1..).unwrap_or(&[]));
        self.gap.extend(steps.map(|(a, b)| if (b - a).abs() <= longest { 0.0 } else { f32::NAN }));
        self.second.clear();
        self.second.resize(lines, f32::NAN);
        // Some lines are done twice where they are no whole number of vectors; those of short stripes go one by one.
        let Some(last) = lines.checked_sub(CHUNK + reach).filter(|last| *last >= reach) else { return };
        for line in (reach..last + CHUNK).step_by(CHUNK).map(|line| line.min(last)) {
            let here = part(simd, position, line);
            let mut second = f32x16::splat(simd, 0.0);
            for (weight, off) in self.weights[reach].iter().zip(1..) {
                let (before, after) = (part(simd, position, line - off), part(simd, position, line + off));
                second += ((before - here) + (after - here)) * *weight;
                second += part(simd, &self.gap, line - off) + part(simd, &self.gap, line + off - 1);
            }
            second.store_slice(&mut self.second[line..][..CHUNK]);
        }
    }

    /// The second derivative near the end of a stripe, as far on both sides as the shorter one goes: a bend told from one side only leans on the
    /// slope. NaN where that is too short.
    fn near_break(&self, position: &[f32], line: usize) -> f32 {
        let reach = self.weights.len() - 1;
        let on = |gap: &&f32| !gap.is_nan();
        let before = self.gap[..line].iter().rev().take(reach).take_while(on).count();
        let after = self.gap[line..].iter().take(reach).take_while(on).count();
        let side = before.min(after);
        if side < LEAST {
            return f32::NAN;
        }
        let here = position[line];
        (self.weights[side].iter().zip(1..))
            .map(|(weight, off)| weight * ((position[line - off] - here) + (position[line + off] - here)))
            .sum()
    }

    #[inline(always)]
    fn correct<S: Simd>(&self, _: S, points: &mut RidgePoints) {
        let n = points.position.len();
        let (position, sigma) = (&mut points.position[..n], &mut points.sigma[..n]);
        let (slope, second) = (&points.slope[..n], &self.second[..n]);
        let (half_square, gain) = ((0.5 * self.sigma * self.sigma) as f32, self.gain * self.gain);
        for i in 0..n {
            let told = !second[i].is_nan();
            let shift = half_square * second[i] / (1.0 + slope[i] * slope[i]);
            let variance = sigma[i] * sigma[i];
            // A shift within its own noise is no bend.
            let real = (shift * shift - 4.0 * variance).max(0.0);
            let wider = (gain * variance + UNSURE * UNSURE * real).sqrt();
            position[i] -= if told { shift } else { 0.0 };
            sigma[i] = if told { wider } else { sigma[i] };
        }
    }
}

/// The second derivative by a parabola through a line and `side` lines on either side.
fn second_derivative(side: usize) -> Vec<f64> {
    let squares = || (1..=side).map(|x| (x * x) as f64);
    let (m2, m4, n) =
        (2.0 * squares().sum::<f64>(), 2.0 * squares().map(|s| s * s).sum::<f64>(), (2 * side + 1) as f64);
    squares().map(|square| 2.0 * (square - m2 / n) / (m4 - m2 * m2 / n)).collect()
}

/// Noise after the bend's correction by that before, for an upright stripe: the correction sharpens what the kernel had smoothed.
fn gain(sigma: f64, weights: &[f64]) -> f64 {
    let reach = weights.len() as i32;
    let sharpen = |x: i32| {
        let second = match x.unsigned_abs() as usize {
            0 => -2.0 * weights.iter().sum::<f64>(),
            off => weights[off - 1],
        };
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
