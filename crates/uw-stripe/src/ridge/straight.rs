//! What the smoothing takes away from a bend is given back.

use super::RidgePoints;

/// Half-length, in kernel sigmas, of the fit that tells the bend.
const REACH: f64 = 2.5;
/// Least lines on either side that tell one.
const LEAST: usize = 2;
/// Longest step of the centre from a line to the next in one stripe: pixels plus widths.
const STEP: (f64, f64) = (3.0, 2.0);
/// Standard deviation of a bend's correction, as a share of it: what the second order leaves.
const UNSURE: f64 = 0.5;

/// Weights and memory for kernels of one width.
#[derive(Debug)]
pub(super) struct Straight {
    sigma: f64,
    /// By the number of lines on either side: what each pair of lines, so many before and after, adds to the second derivative by the
    /// difference of its positions from the line's own.
    weights: Vec<Vec<f64>>,
    /// Noise after a bend's correction by that before.
    gain: f64,
    /// Positions as smoothed, and how many lines before and after a line go on with its stripe.
    smoothed: Vec<f64>,
    before: Vec<usize>,
}

impl Straight {
    /// For kernels of standard deviation `sigma`, px.
    pub fn new(sigma: f64) -> Self {
        let reach = (REACH * sigma).ceil() as usize;
        let weights = (0..=reach).map(second_derivative).collect::<Vec<_>>();
        let gain = gain(sigma, &weights[reach]);
        Self { sigma, weights, gain, smoothed: Vec::new(), before: Vec::new() }
    }

    /// Takes the smoothing's pull along bends back, and widens sigmas by what that costs.
    pub fn straighten(&mut self, points: &mut RidgePoints) {
        let lines = points.position.len();
        let reach = self.weights.len() - 1;
        self.smoothed.clear();
        self.smoothed.extend_from_slice(&points.position);
        let longest = STEP.0 + STEP.1 * self.sigma;
        // NaN goes on with nothing.
        let joined = |i: usize, j: usize, at: &[f64]| (at[i] - at[j]).abs() <= longest;
        self.before.clear();
        self.before.resize(lines, 0);
        for i in 1..lines {
            if joined(i - 1, i, &self.smoothed) {
                self.before[i] = reach.min(self.before[i - 1] + 1);
            }
        }
        let mut after = 0;
        for i in (0..lines).rev() {
            after = if i + 1 < lines && joined(i, i + 1, &self.smoothed) { reach.min(after + 1) } else { 0 };
            // As far on both sides as the shorter one goes: a bend told from one side only leans on the slope.
            let side = after.min(self.before[i]);
            if side < LEAST {
                continue;
            }
            let here = self.smoothed[i];
            let (before, from) = (&self.smoothed[i - side..i], &self.smoothed[i + 1..]);
            let second: f64 = (self.weights[side].iter().zip(before.iter().rev().zip(from)))
                .map(|(weight, (before, after))| weight * (before + after - 2.0 * here))
                .sum();
            let (slope, sigma) = (points.slope[i], points.sigma[i]);
            let shift = 0.5 * self.sigma * self.sigma * second / (1.0 + slope * slope);
            // A shift within its own noise is no bend.
            let real = (shift * shift - 4.0 * sigma * sigma).max(0.0);
            points.position[i] = here - shift;
            points.sigma[i] = (self.gain * self.gain * sigma * sigma + UNSURE * UNSURE * real).sqrt();
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
