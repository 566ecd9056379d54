//! Where a stripe may be on each line: the two places that stand highest out of their surroundings.
//!
//! The largest grey value of every block of 16 rows in each column makes a map, a sixteenth of the image; both directions are searched on it,
//! for what stands out of the map a stripe's width away, so that a haze that varies slowly, however bright, raises no candidates, and
//! nothing depends on a threshold. Only blocks that hold a candidate are looked at again.

use std::ops::Range;

use fearless_simd::{Simd, SimdBase, SimdMask};

use super::aligned::Aligned;
use super::lanes::{splat, vector};
use super::maxima::{ROWS, apart};
use crate::{NoiseModel, Pixel, Roi};

/// Most blocks, so that a byte can number them.
const MOST_BLOCKS: usize = 254;
/// Height of a second candidate that is worth measuring, in sigmas: what the largest of many pixels seldom reaches by noise.
const SECOND_SIGMAS: f64 = 5.5;
/// Place of a line without a candidate.
pub(crate) const NOWHERE: u32 = u32::MAX;

/// Candidates of every line of a region: place along the line, counted from the region's border.
#[derive(Debug, Default)]
pub(crate) struct Places {
    pub at: Vec<u32>,
}

/// Search for candidates; keeps its buffers.
#[derive(Debug, Default)]
pub(crate) struct Front<P> {
    /// Block maxima: of the whole region, or of one block of rows with a margin on either side.
    pub(super) map: Aligned<P>,
    /// What of them stands out, where that is kept.
    pub(super) contrast: Aligned<P>,
    /// Strongest and second candidates.
    pub places: [Places; 2],
}

/// What is looked for.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Wanted {
    /// Standard deviation of the stripe's cross section, px.
    pub width_px: f32,
    /// Noise that a second candidate must stand out of; `None`: no second one.
    pub second: Option<NoiseModel>,
}

/// Region and size of its blocks.
#[derive(Debug, Clone, Copy)]
pub(super) struct Blocks {
    pub roi: Roi,
    pub rows: usize,
    pub count: usize,
}

impl Blocks {
    pub fn new(roi: Roi) -> Self {
        let rows = ROWS * roi.height.div_ceil(ROWS * MOST_BLOCKS).max(1);
        Self { roi, rows, count: roi.height.div_ceil(rows) }
    }

    /// From a block's maxima to the next ones'.
    pub fn apart(&self) -> usize {
        apart(self.roi.width)
    }

    /// Where a column's maximum in a block is.
    pub fn place(&self, block: usize, x: usize) -> usize {
        block * self.apart() + x
    }

    /// Rows of a block, counted from the region's first.
    pub fn range(&self, block: usize) -> Range<usize> {
        block * self.rows..((block + 1) * self.rows).min(self.roi.height)
    }
}

impl<P: Pixel> Front<P> {
    /// Forgets the candidates of the last region.
    pub fn reset(&mut self, lines: usize) {
        for places in &mut self.places {
            places.at.clear();
            places.at.resize(lines, NOWHERE);
        }
    }
}

/// Least height of a second candidate where it is darkest, DN: nowhere is it less.
pub(super) fn least_second_in_the_dark(noise: &NoiseModel) -> f32 {
    (SECOND_SIGMAS * noise.variance(0.0, 0.0).sqrt()) as f32
}

/// Least height of a second candidate, DN, by the noise at the usual level of so many block maxima.
pub(super) fn least_second<P: Pixel>(noise: &NoiseModel, count: usize, maximum: impl Fn(usize) -> P) -> f32 {
    const SAMPLES: usize = 63;
    let mut sample = [P::ZERO; SAMPLES];
    for (k, out) in sample.iter_mut().enumerate() {
        *out = maximum((2 * k + 1) * count / (2 * SAMPLES));
    }
    let (_, usual, _) = sample.select_nth_unstable(SAMPLES / 2);
    (SECOND_SIGMAS * noise.variance(f64::from(usual.dn()), 0.0).sqrt()) as f32
}

/// Whether a height is more than that: most maxima are below the level where it would be as much. To count them takes a fraction of the time of sorting.
#[inline(always)]
pub(super) fn is_second<S: Simd, P: Pixel>(simd: S, noise: &NoiseModel, map: &[P], height: P) -> bool {
    let variance = (f64::from(height.dn()) / SECOND_SIGMAS).powi(2);
    let level = (variance - noise.variance(0.0, 0.0)) * f64::from(noise.gain_e_per_dn);
    if level > f64::from(P::MAX.dn()) {
        return true;
    }
    let level = P::from_dn(level.ceil() as f32);
    let vectors = map.chunks_exact(P::N);
    let mut below = vectors.remainder().iter().filter(|v| **v < level).count();
    for part in vectors {
        below += vector(simd, part).simd_lt(splat(simd, level)).to_bitmask().count_ones() as usize;
    }
    2 * below > map.len()
}

/// Largest of some grey values; 0 of none.
#[inline(always)]
pub(super) fn brightest<S: Simd, P: Pixel>(simd: S, row: &[P]) -> P {
    if row.len() < P::N {
        return row.iter().copied().max().unwrap_or(P::ZERO);
    }
    let mut best = vector(simd, &row[row.len() - P::N..]);
    for chunk in row.chunks_exact(P::N) {
        best = best.max(vector(simd, chunk));
    }
    best.reduce_max()
}

/// Where a value occurs first.
#[inline(always)]
pub(super) fn position<S: Simd, P: Pixel>(simd: S, row: &[P], value: P) -> Option<usize> {
    if row.len() < P::N {
        return row.iter().position(|p| *p == value);
    }
    let last = row.len() - P::N;
    for x in (0..row.len()).step_by(P::N) {
        let x = x.min(last);
        let equal = vector(simd, &row[x..x + P::N]).simd_eq(splat(simd, value)).to_bitmask();
        if equal != 0 {
            return Some(x + equal.trailing_zeros() as usize);
        }
    }
    None
}

#[cfg(test)]
mod tests {
    use fearless_simd::{Level, dispatch};

    use super::super::lanes::Lanes;
    use super::*;

    #[test]
    fn a_second_one_is_worth_measuring_from_its_least_height_on() {
        for (gain_e_per_dn, read_noise_dn) in [(0.3, 0.0), (1.0, 2.0), (40.0, 1.0)] {
            let noise =
                NoiseModel { gain_e_per_dn, read_noise_dn, speckle_contrast: 0.0, full_scale_dn: 255.0 };
            for usual in 0..=u8::MAX {
                let least = u8::from_dn(least_second(&noise, 101, |_| usual));
                for height in u8::from_dn(least_second_in_the_dark(&noise))..=u8::MAX {
                    let seen =
                        dispatch!(Level::new(), simd => is_second(simd, &noise, &[usual; 101], height));
                    assert_eq!(seen, height > least, "{noise:?} {usual} {height}");
                }
            }
        }
    }
}
