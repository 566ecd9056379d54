//! The grey values around the peaks of a group of lines, aligned at the peaks, so that one register holds one offset of many lines.

use fearless_simd::{Select, Simd, SimdBase, SimdMask};

use super::front::NOWHERE;
use super::lanes::MOST_LANES;
use crate::{Axis, Pixel, Roi, View};

/// Lines a group.
pub(crate) const GROUP: usize = MOST_LANES;
/// Spread of the places in a vector up to which rows are read as vectors, once for each place.
const SPREAD: u32 = 48;
/// Offsets read at a time.
const OFFSETS: usize = 8;

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
            self.raw.clear();
            self.raw.resize(taps * GROUP, P::ZERO);
            self.value.clear();
            self.value.resize(taps * GROUP, 0.0);
        }
        match axis {
            Axis::PerRow => self.rows(image, roi, group),
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

    #[inline(always)]
    fn rows(&mut self, image: &View<'_, P>, roi: Roi, group: Group<'_>) {
        let taps = 2 * group.half + 1;
        for (lane, &at) in group.at.iter().enumerate() {
            let at = if at == NOWHERE { 0 } else { at as usize };
            let row = &image.row(roi.y + group.first + lane)[roi.x..roi.x + roi.width];
            let out = self.raw.as_chunks_mut::<GROUP>().0;
            if let Some(window) = at.checked_sub(group.half).and_then(|from| row.get(from..from + taps)) {
                for (out, p) in out.iter_mut().zip(window) {
                    out[lane % GROUP] = *p;
                }
            } else {
                for (k, out) in out.iter_mut().enumerate() {
                    out[lane % GROUP] = row[(at + k).saturating_sub(group.half).min(row.len() - 1)];
                }
            }
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
        let relative = P::V::<S>::from_slice(simd, &relative[..P::N]);
        // One mask for each place that occurs.
        let none = relative.simd_lt(relative);
        let none_value = P::V::<S>::splat(simd, P::ZERO);
        let mut places = [(0, none); SPREAD as usize + 1];
        let mut count = 0;
        for step in 0..=high - low {
            let mine = relative.simd_eq(P::V::<S>::splat(simd, P::from_index(step as u8)));
            if mine.any_true() {
                places[count] = (step as usize, mine);
                count += 1;
            }
        }
        let top = roi.y + (low - half) as usize;
        let (strip, stride) = image.starting_at(roi.x + group.first + lane, top);
        // Some offsets at a time, so that their registers and the mask at hand stay where they are.
        for (block, out) in self.raw.chunks_mut(OFFSETS * GROUP).enumerate() {
            let offsets = out.len() / GROUP;
            let load = |k: usize, step: usize| {
                // Beyond the last offset the last one again; it is not stored.
                let from = (block * OFFSETS + k.min(offsets - 1) + step) * stride;
                P::V::<S>::from_slice(simd, &strip[from..from + P::N])
            };
            let mut window = [none_value; OFFSETS];
            for (k, window) in window.iter_mut().enumerate() {
                *window = load(k, places[0].0);
            }
            for &(step, mine) in &places[1..count] {
                for (k, window) in window.iter_mut().enumerate() {
                    *window = mine.select(load(k, step), *window);
                }
            }
            for (out, window) in out.chunks_exact_mut(GROUP).zip(window) {
                window.store_slice(&mut out[lane..lane + P::N]);
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
        for (k, out) in self.raw.chunks_exact_mut(GROUP).enumerate() {
            for lane in lanes.clone() {
                let at = if group.at[lane] == NOWHERE { 0 } else { group.at[lane] as usize };
                let y = (at + k).saturating_sub(group.half).min(roi.height - 1);
                out[lane] = image.row(roi.y + y)[roi.x + group.first + lane];
            }
        }
    }
}
