//! The curve of a stripe around each of its lines: a parabola through the positions of some neighbours, and a straight line through the logarithms
//! of their strengths.

use crate::engine::lanes::{CHUNK, part};
use crate::special::ln;
use crate::verdict::run_reach;
use fearless_simd::{Simd, SimdBase, f32x16};

/// Lines to either side that the local curve is fitted to.
pub(super) const REACH_LINES: usize = 3;
/// Positions that a parabola needs to be more than drawn through its points.
const LEAST_LINES: usize = 4;
/// Change of ln strength from one line to the next beyond which the surface's brightness has an edge there, whose light does not mix as
/// that of an even change does.
const EDGE_STEP: f32 = 1.0;

/// The curve around each line; NaN where it is not known.
#[derive(Debug, Default)]
pub(super) struct Curves {
    /// Natural logarithm of the strength.
    ln_strength: Vec<f32>,
    /// 0 where the line goes on in the next one, and in the one before; NaN where it does not.
    onward: Vec<f32>,
    backward: Vec<f32>,
    pub slope: Vec<f32>,
    /// ½ f″ + f′ A′/A, 1/px.
    pub bend: Vec<f32>,
    /// Variance of the bend from positions of unit noise, 1/px⁴.
    pub noise_gain: Vec<f32>,
}

impl Curves {
    /// The curves where all lines within reach belong to the run, as nearly everywhere.
    #[inline(always)]
    pub fn along<S: Simd>(&mut self, simd: S, position: &[f32], width: &[f32], amplitude: &[f32]) {
        let n = position.len();
        self.ln_strength.clear();
        self.ln_strength.extend(amplitude.iter().map(|a| ln(a.max(1e-6))));
        for values in
            [&mut self.onward, &mut self.backward, &mut self.slope, &mut self.bend, &mut self.noise_gain]
        {
            values.clear();
            values.resize(n, f32::NAN);
        }
        let Some(steps) = n.checked_sub(1) else { return };
        let (here, next) = (&position[..steps], &position[1..][..steps]);
        let (widths, next_widths) = (&width[..steps], &width[1..][..steps]);
        let (strength, next_strength) = (&self.ln_strength[..steps], &self.ln_strength[1..][..steps]);
        let (onward, backward) = (&mut self.onward[..steps], &mut self.backward[1..][..steps]);
        let gap = |on: bool| if on { 0.0 } else { f32::NAN };
        for i in 0..steps {
            let step = (next[i] - here[i]).abs();
            let even = (next_strength[i] - strength[i]).abs() <= EDGE_STEP;
            onward[i] = gap(even & (step <= run_reach(widths[i])));
            backward[i] = gap(even & (step <= run_reach(next_widths[i])));
        }
        // Some lines are done twice where they are no whole number of vectors; those of short stripes go one by one.
        let Some(last) = n.checked_sub(CHUNK + REACH_LINES).filter(|last| *last >= REACH_LINES) else {
            return;
        };
        for middle in (REACH_LINES..last + CHUNK).step_by(CHUNK) {
            self.chunk(simd, position, middle.min(last));
        }
    }

    /// The curves of so many lines from line `middle` on: the offsets' odd moments are 0.
    #[inline(always)]
    fn chunk<S: Simd>(&mut self, simd: S, position: &[f32], middle: usize) {
        /// Σ 1, Σ x², Σ x⁴ over the offsets, and the determinant of the first and the last.
        const MOMENTS: [f32; 3] = [7.0, 28.0, 196.0];
        const DETERMINANT: f32 = MOMENTS[0] * MOMENTS[2] - MOMENTS[1] * MOMENTS[1];
        let here = part(simd, position, middle);
        let mut moments = [f32x16::splat(simd, 0.0); 3];
        let (mut growth, mut gap) = (moments[0], moments[0]);
        for k in 1..=REACH_LINES {
            let x = k as f32;
            let after = part(simd, position, middle + k) - here;
            let before = part(simd, position, middle - k) - here;
            let (odd, even) = (after - before, after + before);
            moments[0] += even;
            moments[1] += odd * x;
            moments[2] += even * (x * x);
            growth +=
                (part(simd, &self.ln_strength, middle + k) - part(simd, &self.ln_strength, middle - k)) * x;
            gap += part(simd, &self.onward, middle + k - 1) + part(simd, &self.backward, middle + 1 - k);
        }
        let curvature = (moments[2] * MOMENTS[0] - moments[0] * MOMENTS[1]) * DETERMINANT.recip();
        let slope = moments[1] * MOMENTS[1].recip();
        let growth = growth * MOMENTS[1].recip();
        let noise_gain = growth * growth * MOMENTS[1].recip() + MOMENTS[0] / DETERMINANT;
        (slope + gap).store_slice(&mut self.slope[middle..][..CHUNK]);
        (curvature + slope * growth + gap).store_slice(&mut self.bend[middle..][..CHUNK]);
        noise_gain.store_slice(&mut self.noise_gain[middle..][..CHUNK]);
    }

    /// The curves near the ends of runs, from fewer lines.
    pub fn near_breaks(&mut self, position: &[f32]) {
        for from in (0..position.len()).step_by(CHUNK) {
            let lines = from..(from + CHUNK).min(position.len());
            if !self.bend[lines.clone()].iter().fold(false, |any, bend| any | bend.is_nan()) {
                continue;
            }
            for line in lines {
                if self.bend[line].is_nan()
                    && !position[line].is_nan()
                    && let Some([slope, bend, noise_gain]) = self.local(position, line)
                {
                    (self.slope[line], self.bend[line], self.noise_gain[line]) = (slope, bend, noise_gain);
                }
            }
        }
    }

    /// A parabola through the positions and a straight line through the logarithm of the strengths around `line`, over the unbroken
    /// run that it belongs to: slope, bend and its gain of noise; `None` where that is too short.
    fn local(&self, position: &[f32], line: usize) -> Option<[f32; 3]> {
        let (mut first, mut last) = (line, line);
        while line - first < REACH_LINES && !self.backward[first].is_nan() {
            first -= 1;
        }
        while last - line < REACH_LINES && !self.onward[last].is_nan() {
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
        let noise_gain = picked.dot(&factor.solve(&picked)).max(0.0);
        (bend.is_finite() && noise_gain.is_finite()).then_some([
            curve.y as f32,
            bend as f32,
            noise_gain as f32,
        ])
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use fearless_simd::{Level, dispatch};
    use proptest::prelude::*;

    proptest! {
        /// Moments in vectors, and normal equations solved line by line.
        #[test]
        fn curves_many_at_a_time_are_those_of_single_lines(
            (wave, height, phase) in (5.0f32..50.0, 0.0f32..10.0, 0.0f32..6.0),
            n in 22usize..80,
        ) {
            let position: Vec<f32> = (0..n).map(|i| 300.0 + height * (i as f32 / wave + phase).sin()).collect();
            let strength: Vec<f32> = (0..n).map(|i| 500.0 + 200.0 * (i as f32 / wave).cos()).collect();
            let (level, mut curves) = (Level::new(), Curves::default());
            dispatch!(level, simd => curves.along(simd, &position, &vec![2.0; n], &strength));
            for line in REACH_LINES..n - REACH_LINES {
                let want = curves.local(&position, line).unwrap();
                let got = [curves.slope[line], curves.bend[line], curves.noise_gain[line]];
                for (got, want) in got.into_iter().zip(want) {
                    prop_assert!((got - want).abs() < 2e-5 * (1.0 + height), "line {line}: {got} for {want}");
                }
            }
        }
    }
}
