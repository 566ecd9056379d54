//! The grey values around the peaks of a group of lines, aligned at the peaks, so that one register holds two neighbouring offsets of many lines.

use fearless_simd::{Bytes, Select, Simd, SimdBase, SimdInt, f32x16, i16x32, i32x16, u32x16};

use super::aligned::Aligned;
use super::front::NOWHERE;
use super::lanes::{CHUNK, MOST_LANES, SQUARE, splat, vector};
use crate::{Axis, Pixel, Roi, View};

/// Lines a group.
pub(crate) const GROUP: usize = MOST_LANES;
/// Spread of the places in a vector up to which rows are read as vectors and shifted into place.
const SPREAD: u32 = 63;
/// Pixels of a row that are turned at a time.
const TURNED: usize = 16;

/// Two neighbouring pixels of a chunk of lines, line after line.
pub(super) type Pair = [i16; 2 * CHUNK];

/// Windows of a group.
#[derive(Debug, Default)]
pub(crate) struct Windows<P> {
    /// Pixels of columns, offset by offset.
    raw: Aligned<P>,
    /// Pairs of pixels, from which [`Lanes::BIAS`](super::lanes::Lanes::BIAS) is taken, chunk of lines after chunk.
    pairs: Aligned<i16>,
    /// Pairs a chunk.
    chunk: usize,
    /// See [`Self::values`].
    value: Vec<f32>,
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
    pub fn load<S: Simd>(
        &mut self,
        simd: S,
        image: &View<'_, P>,
        (roi, axis): (Roi, Axis),
        group: Group<'_>,
    ) {
        let taps = 2 * group.half + 1;
        self.chunk = taps.next_multiple_of(TURNED) / 2;
        self.pairs.resize(self.chunk * 2 * GROUP);
        if axis == Axis::PerRow {
            for (first, at) in (group.first..).step_by(CHUNK).zip(group.at.chunks(CHUNK)) {
                let chunk = (first - group.first) / CHUNK;
                self.rows(simd, image, roi, (Group { first, at, ..group }, chunk));
            }
            return;
        }
        // Room for what is shifted into place, and for what makes a pair of the last pixel.
        self.raw.resize((taps + 1 + SPREAD as usize) * GROUP);
        if group.at.len() < GROUP {
            // Beyond the last line there would lie what was there before.
            self.raw.fill(P::ZERO);
            self.columns_one_by_one(image, roi, group, 0..group.at.len());
        } else {
            for lane in (0..GROUP).step_by(P::N) {
                self.columns(simd, image, roi, group, lane);
            }
        }
        let rows = self.raw.as_chunks::<CHUNK>().0.as_chunks::<{ GROUP / CHUNK }>().0;
        let pairs = self.pairs.as_chunks_mut().0;
        for (j, [first, second]) in rows.as_chunks().0[..=group.half].iter().enumerate() {
            for (chunk, (first, second)) in first.iter().zip(second).enumerate() {
                let out: &mut Pair = &mut pairs[chunk * self.chunk + j];
                P::pair(simd, first, second).store_array(out);
            }
        }
    }

    /// The windows of a chunk of lines.
    #[inline(always)]
    pub fn chunk(&self, chunk: usize) -> &[Pair] {
        &self.pairs.as_chunks().0[chunk * self.chunk..][..self.chunk]
    }

    /// Grey values in DN of all lines, [`GROUP`] at each offset.
    #[inline(always)]
    pub fn values<S: Simd>(&mut self, simd: S, half: usize) -> &[f32] {
        self.value.resize((2 * half + 2) * GROUP, 0.0);
        let pairs: &[Pair] = self.pairs.as_chunks().0;
        let out = self.value.as_chunks_mut::<CHUNK>().0.as_chunks_mut::<{ GROUP / CHUNK }>().0;
        for (j, [first, second]) in out.as_chunks_mut().0.iter_mut().enumerate() {
            for (chunk, (first, second)) in first.iter_mut().zip(second).enumerate() {
                let values = split(i16x32::load_array_ref(simd, &pairs[chunk * self.chunk + j]));
                for (values, out) in values.into_iter().zip([first, second]) {
                    (values.to_float::<f32x16<S>>() + f32x16::splat(simd, P::BIAS)).store_array(out);
                }
            }
        }
        &self.value[..(2 * half + 1) * GROUP]
    }

    /// Turns the windows of a chunk of rows, some pixels of all of them at a time.
    #[inline(always)]
    fn rows<S: Simd>(&mut self, simd: S, image: &View<'_, P>, roi: Roi, (group, chunk): (Group<'_>, usize)) {
        let pairs = &mut self.pairs.as_chunks_mut().0[chunk * self.chunk..][..self.chunk];
        let (pixels, stride) = image.starting_at(roi.x, roi.y + group.first);
        for (out, from) in pairs.as_chunks_mut().0.iter_mut().zip((0..).step_by(TURNED)) {
            if let Some(rows) = whole_rows((pixels, stride), roi.width, group, from) {
                turn::<S, P>(simd, P::square(simd, &rows), out);
                continue;
            }
            let mut here = [[P::ZERO; TURNED]; CHUNK];
            for ((lane, &at), window) in group.at.iter().enumerate().zip(&mut here) {
                let at = if at == NOWHERE { 0 } else { at as usize } + from;
                let row = &pixels[lane * stride..][..roi.width];
                for (k, out) in window.iter_mut().enumerate() {
                    *out = row[(at + k).saturating_sub(group.half).min(row.len() - 1)];
                }
            }
            turn::<S, P>(simd, P::square(simd, &here.each_ref()), out);
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
        let mut left = vector(simd, &relative[..P::N]);
        let (taps, spread) = (2 * group.half + 1, (high - low) as usize);
        let top = roi.y + (low - half) as usize;
        let (strip, stride) = image.starting_at(roi.x + group.first + lane, top);
        // A row for each offset.
        let raw = &mut self.raw.as_chunks_mut::<GROUP>().0[..taps + spread];
        let mut shift = if spread == 0 { 0 } else { 1 << spread.ilog2() };
        // The highest power of two that occurs in the shifts moves the image's rows, the lower ones what is there already.
        let last = taps + spread - 1;
        if shift == 0 {
            for (k, out) in raw[..taps].iter_mut().enumerate() {
                row(simd, strip, k * stride).store_slice(&mut out[lane..][..P::N]);
            }
            return;
        }
        let mut moved = left.simd_gt(splat(simd, P::from_index(shift as u8 - 1)));
        for (k, out) in raw[..taps + (shift - 1).min(spread)].iter_mut().enumerate() {
            let value =
                moved.select(row(simd, strip, (k + shift).min(last) * stride), row(simd, strip, k * stride));
            value.store_slice(&mut out[lane..][..P::N]);
        }
        while shift > 1 {
            left = moved.select(left - splat(simd, P::from_index(shift as u8)), left);
            shift /= 2;
            moved = left.simd_gt(splat(simd, P::from_index(shift as u8 - 1)));
            for k in 0..taps + shift - 1 {
                let (here, there) = (row(simd, &raw[k], lane), row(simd, &raw[k + shift], lane));
                moved.select(there, here).store_slice(&mut raw[k][lane..][..P::N]);
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

/// A vector of grey values from `from` on.
#[inline(always)]
fn row<S: Simd, P: Pixel>(simd: S, pixels: &[P], from: usize) -> P::V<S> {
    vector(simd, &pixels[from..][..P::N])
}

/// Some pixels of each of a chunk's rows, `from` on in their windows; `None` where one of them reaches beyond the border.
#[inline(always)]
fn whole_rows<'a, P: Pixel>(
    (pixels, stride): (&'a [P], usize),
    width: usize,
    group: Group<'_>,
    from: usize,
) -> Option<[&'a [P; TURNED]; CHUNK]> {
    let at: &[u32; CHUNK] = group.at.try_into().ok()?;
    let (mut low, mut high) = (NOWHERE, 0);
    for &a in at {
        low = low.min(a);
        high = high.max(a);
    }
    // NOWHERE is beyond.
    if low as usize + from < group.half || high as usize + from + TURNED > width + group.half {
        return None;
    }
    let mut rows = [pixels.first_chunk()?; CHUNK];
    for ((row, &at), first) in rows.iter_mut().zip(at).zip((0..).step_by(stride)) {
        *row = pixels.get(first + at as usize + from - group.half..)?.first_chunk()?;
    }
    Some(rows)
}

/// A square matrix turned, in pairs of pixels: what is sorted by even and odd places moves the lowest bit of every element's index to the highest
/// place, and once for every bit of a place in a row makes columns of rows.
#[inline(always)]
fn turn<S: Simd, P: Pixel>(simd: S, mut units: [u32x16<S>; SQUARE], to: &mut [Pair; TURNED / 2]) {
    let count = TURNED * size_of::<P>() / 4;
    for _ in 0..count.ilog2() {
        let mut next = [u32x16::splat(simd, 0); SQUARE];
        for i in 0..count / 2 {
            (next[i], next[i + count / 2]) = units[2 * i].deinterleave(units[2 * i + 1]);
        }
        units = next;
    }
    for (unit, to) in units.into_iter().zip(to.chunks_exact_mut(TURNED / 2 / count)) {
        for (pair, to) in P::pairs(simd, unit).into_iter().zip(to) {
            pair.store_array(to);
        }
    }
}

/// The first pixels of pairs, and the second.
#[inline(always)]
pub(super) fn split<S: Simd>(pairs: i16x32<S>) -> [i32x16<S>; 2] {
    let pairs: i32x16<S> = pairs.bitcast();
    [(pairs << 16) >> 16, pairs >> 16]
}
