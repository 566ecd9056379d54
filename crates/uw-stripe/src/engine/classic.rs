//! The two estimators that most scanners use, for comparison. Neither knows the noise; the predicted sigmas are theirs, from their own weights.

use super::fir::{Bank, Estimates};
use super::window::GROUP;

type Lanes = [f32; GROUP];

/// Centre of gravity of what stands above the mean of the window's ends, over the whole window.
///
/// c = Σ k x / Σ x, σ² = Σ (k − c)² v / (Σ x)².
#[inline(always)]
pub(super) fn centre_of_gravity(bank: &Bank, windows: &[f32], out: &mut Estimates) {
    let rows = windows.as_chunks::<GROUP>().0;
    let offset = |k: usize| k as f32 - bank.half as f32;
    let noise = bank.variance_line();
    let (mut sum, mut moment, mut variance): (Lanes, Lanes, Lanes) =
        ([0.0; GROUP], [0.0; GROUP], [0.0; GROUP]);
    for ((out, first), last) in out.background.iter_mut().zip(&rows[0]).zip(&rows[rows.len() - 1]) {
        *out = 0.5 * (first + last);
    }
    for (k, row) in rows.iter().enumerate() {
        for l in 0..GROUP {
            let value = (row[l] - out.background[l]).max(0.0);
            sum[l] += value;
            moment[l] += value * offset(k);
        }
    }
    for l in 0..GROUP {
        out.shift[l] = if sum[l] > 0.0 { moment[l] / sum[l] } else { 0.0 };
    }
    for (k, row) in rows.iter().enumerate() {
        for l in 0..GROUP {
            let lever = offset(k) - out.shift[l];
            variance[l] += lever * lever * (noise.0 + row[l] * noise.1);
        }
    }
    for l in 0..GROUP {
        out.sigma[l] = variance[l].sqrt() / sum[l];
    }
}

/// Zero crossing of Blais and Rioux's eighth-order derivative filter next to the brightest pixel, linearly interpolated.
///
/// s(k) = Σⱼ (x(k + j) − x(k − j)), j = 1 … 4; F. Blais, M. Rioux, Real-time numerical peak detector, Signal Processing 11 (1986) 145.
#[inline(always)]
pub(super) fn blais_rioux(bank: &Bank, windows: &[f32], out: &mut Estimates) {
    /// Pixels on either side.
    const ORDER: usize = 4;
    /// Farthest crossing that is believed, px.
    const FARTHEST: f32 = 2.0;
    let rows = windows.as_chunks::<GROUP>().0;
    let order = ORDER.min(bank.half.saturating_sub(1)).max(1);
    let noise = bank.variance_line();
    // The filter at the brightest pixel and at its neighbours, and the pixels' variance.
    let (mut slopes, mut variance): ([Lanes; 3], Lanes) = ([[0.0; GROUP]; 3], [0.0; GROUP]);
    for j in 1..=order {
        for (slope, middle) in slopes.iter_mut().zip(bank.half - 1..) {
            let (after, before) = (&rows[middle + j], &rows[middle - j]);
            for l in 0..GROUP {
                slope[l] += after[l] - before[l];
            }
        }
        let (after, before) = (&rows[bank.half + j], &rows[bank.half - j]);
        for l in 0..GROUP {
            variance[l] += 2.0 * noise.0 + (after[l] + before[l]) * noise.1;
        }
    }
    for l in 0..GROUP {
        // Uphill here: the crossing lies between this pixel and the next.
        let right = slopes[1][l] >= 0.0;
        let (a, b) = if right { (slopes[1][l], slopes[2][l]) } else { (slopes[0][l], slopes[1][l]) };
        let fall = (a - b).max(f32::MIN_POSITIVE);
        let crossing = a / fall - if right { 0.0 } else { 1.0 };
        out.shift[l] = crossing.clamp(-FARTHEST, FARTHEST);
        out.sigma[l] = variance[l].sqrt() / fall;
    }
}
