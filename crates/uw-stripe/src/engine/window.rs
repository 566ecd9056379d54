//! The grey values around the peaks of a group of lines, aligned at the peaks, so that one register holds one offset of many lines.

use fearless_simd::{Select, Simd, SimdBase};

use super::front::NOWHERE;
use super::lanes::MOST_LANES;
use crate::{Axis, Pixel, Roi, View};

/// Lines a group.
pub(crate) const GROUP: usize = MOST_LANES;
/// Spread of the places in a vector up to which rows are read as vectors and shifted into place.
const SPREAD: u32 = 63;
/// Pixels of a row that are turned at a time.
const TURNED: usize = 16;

/// Windows of a group: offset k of line l is `value[k * GROUP + l]`, k = 0 the first.
#[derive(Debug, Default)]
pub(crate) struct Windows<P> {
    raw: Vec<P>,
    pub value: Vec<f32>,
}

/// Which lines, and how far around their places.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Group<'a> {
    /// First line, counted from the region's border.
    pub first: usize,
    /// Place of each line; at most [`GROUP`].
    pub at: &'a [u32],
    /// Pixels on either side of the place.
    pub half: usize,
}

impl<P: Pixel> Windows<P> {
    /// Copies the windows; the image's border is repeated beyond it. Lines without a place get that of another.
    #[inline(always)]
    pub fn load<S: Simd>(&mut self, simd: S, image: &View<'_, P>, roi: Roi, axis: Axis, group: Group<'_>) {
        let taps = 2 * group.half + 1;
        if self.value.len() != taps * GROUP {
            // Room for what is turned at a time, and for what is shifted into place.
            self.raw.clear();
            self.raw.resize((taps + SPREAD as usize) * GROUP, P::ZERO);
            self.value.clear();
            self.value.resize(taps * GROUP, 0.0);
        }
        match axis {
            Axis::PerRow => self.rows(simd, image, roi, group),
            Axis::PerColumn if group.at.len() < GROUP => {
                self.columns_one_by_one(image, roi, group, 0..group.at.len());
            }
            Axis::PerColumn => {
                for lane in (0..GROUP).step_by(P::N) {
                    self.columns(simd, image, roi, group, lane);
                }
            }
        }
        for (value, raw) in self.value.iter_mut().zip(&self.raw) {
            *value = raw.dn();
        }
    }

    /// Turns the rows' windows, some pixels of all rows at a time: to interleave the first half of a matrix with its second moves the highest
    /// bit of every element's index to the lowest place, and once for every bit of the row's number makes columns of rows.
    #[inline(always)]
    fn rows<S: Simd>(&mut self, simd: S, image: &View<'_, P>, roi: Roi, group: Group<'_>) {
        const SIZE: usize = TURNED * GROUP;
        let taps = 2 * group.half + 1;
        let (mut here, mut next) = ([P::ZERO; SIZE], [P::ZERO; SIZE]);
        for (from, out) in (0..taps).step_by(TURNED).zip(self.raw.chunks_exact_mut(SIZE)) {
            for ((lane, &at), window) in group.at.iter().enumerate().zip(here.as_chunks_mut::<TURNED>().0) {
                let at = if at == NOWHERE { 0 } else { at as usize } + from;
                let row = &image.row(roi.y + group.first + lane)[roi.x..roi.x + roi.width];
                let inside = at.checked_sub(group.half).and_then(|from| row.get(from..from + TURNED));
                if let Some(inside) = inside {
                    window.copy_from_slice(inside);
                } else {
                    for (k, out) in window.iter_mut().enumerate() {
                        *out = row[(at + k).saturating_sub(group.half).min(row.len() - 1)];
                    }
                }
            }
            for _ in 0..GROUP.ilog2() / 2 {
                riffle(simd, &here, &mut next);
                riffle(simd, &next, &mut here);
            }
            out.copy_from_slice(&here);
        }
    }

    #[inline(always)]
    fn columns<S: Simd>(&mut self, simd: S, image: &View<'_, P>, roi: Roi, group: Group<'_>, lane: usize) {
        let at = &group.at[lane..lane + P::N];
        let (mut low, mut high) = (NOWHERE, 0);
        for &a in at {
            low = low.min(a);
            high = high.max(if a == NOWHERE { 0 } else { a });
        }
        let half = group.half as u32;
        if high < low || high - low > SPREAD || low < half || high + half >= roi.height as u32 {
            self.columns_one_by_one(image, roi, group, lane..lane + P::N);
            return;
        }
        let mut relative = [P::ZERO; MOST_LANES];
        for (r, &a) in relative.iter_mut().zip(at) {
            *r = P::from_index(if a == NOWHERE { 0 } else { a - low } as u8);
        }
        let mut left = P::V::<S>::from_slice(simd, &relative[..P::N]);
        let (taps, spread) = (2 * group.half + 1, (high - low) as usize);
        let top = roi.y + (low - half) as usize;
        let (strip, stride) = image.starting_at(roi.x + group.first + lane, top);
        let pixels = |row: usize| P::V::<S>::from_slice(simd, &strip[row * stride..][..P::N]);
        let raw = &mut self.raw;
        let mut shift = if spread == 0 { 0 } else { 1 << spread.ilog2() };
        // The highest power of two that occurs in the shifts moves the image's rows, the lower ones what is there already.
        let last = taps + spread - 1;
        if shift == 0 {
            for k in 0..taps {
                pixels(k).store_slice(&mut raw[k * GROUP + lane..][..P::N]);
            }
            return;
        }
        let mut moved = left.simd_gt(P::V::<S>::splat(simd, P::from_index(shift as u8 - 1)));
        for k in 0..taps + (shift - 1).min(spread) {
            let value = moved.select(pixels((k + shift).min(last)), pixels(k));
            value.store_slice(&mut raw[k * GROUP + lane..][..P::N]);
        }
        while shift > 1 {
            left = moved.select(left - P::V::<S>::splat(simd, P::from_index(shift as u8)), left);
            shift /= 2;
            moved = left.simd_gt(P::V::<S>::splat(simd, P::from_index(shift as u8 - 1)));
            for k in 0..taps + shift - 1 {
                let here = P::V::<S>::from_slice(simd, &raw[k * GROUP + lane..][..P::N]);
                let there = P::V::<S>::from_slice(simd, &raw[(k + shift) * GROUP + lane..][..P::N]);
                moved.select(there, here).store_slice(&mut raw[k * GROUP + lane..][..P::N]);
            }
        }
    }

    fn columns_one_by_one(
        &mut self,
        image: &View<'_, P>,
        roi: Roi,
        group: Group<'_>,
        lanes: std::ops::Range<usize>,
    ) {
        for (k, out) in self.raw.chunks_exact_mut(GROUP).take(2 * group.half + 1).enumerate() {
            for lane in lanes.clone() {
                let at = if group.at[lane] == NOWHERE { 0 } else { group.at[lane] as usize };
                let y = (at + k).saturating_sub(group.half).min(roi.height - 1);
                out[lane] = image.row(roi.y + y)[roi.x + group.first + lane];
            }
        }
    }
}

/// Interleaves the first half of some pixels with the second.
#[inline(always)]
fn riffle<S: Simd, P: Pixel>(simd: S, from: &[P], to: &mut [P]) {
    let (first, second) = from.split_at(from.len() / 2);
    for ((a, b), out) in
        first.chunks_exact(P::N).zip(second.chunks_exact(P::N)).zip(to.chunks_exact_mut(2 * P::N))
    {
        let (low, high) = P::V::<S>::from_slice(simd, a).interleave(P::V::<S>::from_slice(simd, b));
        low.store_slice(&mut out[..P::N]);
        high.store_slice(&mut out[P::N..]);
    }
}
