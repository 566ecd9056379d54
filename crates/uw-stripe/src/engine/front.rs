//! Where a stripe may be on each line: the two places that stand highest out of their surroundings.
//!
//! Pass one is a pure read: the largest grey value of every block of 16 rows in each column. The map that results is a sixteenth of the
//! image; both directions are searched on it, for what stands out of the map a stripe's width away, so that a haze that varies slowly, however
//! bright, raises no candidates, and nothing depends on a threshold. Only blocks that hold a candidate are looked at again.

use std::ops::Range;

use fearless_simd::{Select, Simd, SimdBase, SimdMask};

use super::lanes::MOST_LANES;
use crate::{Axis, NoiseModel, Pixel, Roi, View};

/// Rows of which the maximum is formed at a time.
const ROWS: usize = 16;
/// Vectors of a row read at a time.
const STRIP: usize = 4;
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

impl Places {
    fn reset(&mut self, lines: usize) {
        self.at.clear();
        self.at.resize(lines, NOWHERE);
    }
}

/// Search for candidates; keeps its buffers.
#[derive(Debug, Default)]
pub(crate) struct Front<P> {
    /// Block maxima, a row a block.
    map: Vec<P>,
    contrast: Vec<P>,
    padded: Vec<P>,
    /// Strongest and second candidates.
    pub places: [Places; 2],
}

/// What is looked for.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Wanted {
    pub axis: Axis,
    /// Standard deviation of the stripe's cross section, px.
    pub width_px: f32,
    /// Noise that a second candidate must stand out of; `None`: no second one.
    pub second: Option<NoiseModel>,
}

/// Region and size of its blocks.
#[derive(Debug, Clone, Copy)]
struct Blocks {
    roi: Roi,
    rows: usize,
    count: usize,
}

impl Blocks {
    fn new(roi: Roi) -> Self {
        let rows = ROWS * roi.height.div_ceil(ROWS * MOST_BLOCKS).max(1);
        Self { roi, rows, count: roi.height.div_ceil(rows) }
    }

    /// Rows of a block, counted from the region's first.
    fn range(&self, block: usize) -> Range<usize> {
        block * self.rows..((block + 1) * self.rows).min(self.roi.height)
    }
}

impl<P: Pixel> Front<P> {
    /// Finds the candidates.
    #[inline(always)]
    pub fn search<S: Simd>(&mut self, simd: S, image: &View<'_, P>, roi: Roi, wanted: Wanted) {
        let blocks = Blocks::new(roi);
        self.map.resize(blocks.count * roi.width, P::ZERO);
        for block in 0..blocks.count {
            let map = &mut self.map[block * roi.width..(block + 1) * roi.width];
            if roi.width < P::N {
                map.fill(P::ZERO);
                for y in blocks.range(block) {
                    let row = &image.row(roi.y + y)[roi.x..roi.x + roi.width];
                    map.iter_mut().zip(row).for_each(|(m, p)| *m = (*m).max(*p));
                }
            } else {
                maxima(simd, image, roi, blocks.range(block), map);
            }
        }
        let second_dn = wanted.second.map(|noise| self.least_second(&noise));
        let lines = wanted.axis.lines(roi.width, roi.height);
        self.places.iter_mut().for_each(|p| p.reset(lines));
        match wanted.axis {
            Axis::PerColumn if roi.width < P::N => self.few_columns(image, blocks, (wanted, second_dn)),
            Axis::PerColumn => {
                for x in (0..roi.width).step_by(P::N) {
                    self.columns(simd, image, blocks, (wanted, second_dn), x.min(roi.width - P::N));
                }
            }
            Axis::PerRow => {
                for block in 0..blocks.count {
                    self.rows(simd, image, blocks, (wanted, second_dn), block);
                }
            }
        }
    }

    /// Least height of a second candidate, DN, by the noise at the image's usual level.
    fn least_second(&self, noise: &NoiseModel) -> f32 {
        const SAMPLES: usize = 63;
        let mut sample = [P::ZERO; SAMPLES];
        for (k, out) in sample.iter_mut().enumerate() {
            *out = self.map[(2 * k + 1) * self.map.len() / (2 * SAMPLES)];
        }
        let (_, usual, _) = sample.select_nth_unstable(SAMPLES / 2);
        (SECOND_SIGMAS * noise.variance(f64::from(usual.dn()), 0.0).sqrt()) as f32
    }

    /// Blocks to either side in which a stripe of the block between does not show.
    fn reach(wanted: Wanted, blocks: Blocks) -> usize {
        1 + (6.0 * wanted.width_px / blocks.rows as f32).ceil() as usize
    }

    /// The smaller of two neighbours' maxima, or that of the one there is.
    fn around(before: Option<P>, after: Option<P>) -> P {
        match (before, after) {
            (Some(a), Some(b)) => a.min(b),
            (one, other) => one.or(other).unwrap_or(P::ZERO),
        }
    }

    #[inline(always)]
    fn columns<S: Simd>(
        &mut self,
        simd: S,
        image: &View<'_, P>,
        blocks: Blocks,
        (wanted, second_dn): (Wanted, Option<f32>),
        x: usize,
    ) {
        let (width, count) = (blocks.roi.width, blocks.count);
        let reach = Self::reach(wanted, blocks);
        let splat = |v: P| P::V::<S>::splat(simd, v);
        let map = |block: usize| P::V::<S>::from_slice(simd, &self.map[block * width + x..][..P::N]);
        let none = splat(P::MAX);
        let zero = splat(P::ZERO);
        let number = |block: usize| splat(P::from_index(block as u8));
        self.contrast.resize((count * P::N).max(width), P::ZERO);
        let (mut height, mut place) = (zero, none);
        for (block, out) in self.contrast.chunks_exact_mut(P::N).take(count).enumerate() {
            let here = map(block);
            let around = match (block.checked_sub(reach), (block + reach < count).then_some(block + reach)) {
                (Some(a), Some(b)) => map(a).min(map(b)),
                (Some(a), None) | (None, Some(a)) => map(a),
                (None, None) => zero,
            };
            let contrast = here - here.min(around);
            if second_dn.is_some() {
                contrast.store_slice(out);
            }
            place = contrast.simd_gt(height).select(number(block), place);
            height = height.max(contrast);
        }
        let strongest = place;
        if let Some(least) = second_dn {
            (height, place) = (splat(P::from_dn(least)), none);
            for (block, contrast) in self.contrast.chunks_exact(P::N).take(count).enumerate() {
                let number = number(block);
                // A neighbour of the strongest is its other part.
                let apart = (number.max(strongest) - number.min(strongest)).simd_gt(splat(P::from_index(1)));
                let contrast = apart.select(P::V::<S>::from_slice(simd, contrast), zero);
                place = contrast.simd_gt(height).select(number, place);
                height = height.max(contrast);
            }
            if height.simd_gt(splat(P::from_dn(least))).any_true() {
                self.locate(simd, image, blocks, x, 1, place);
            }
        }
        self.locate(simd, image, blocks, x, 0, strongest);
    }

    /// Rows of the maxima within the blocks chosen, for a vector of columns; the first of equals.
    #[inline(always)]
    fn locate<S: Simd>(
        &mut self,
        simd: S,
        image: &View<'_, P>,
        blocks: Blocks,
        x: usize,
        rank: usize,
        place: P::V<S>,
    ) {
        let width = blocks.roi.width;
        let mut chosen = [P::MAX; MOST_LANES];
        place.store_slice(&mut chosen[..P::N]);
        let (mut low, mut high) = (P::MAX, P::ZERO);
        for &b in &chosen[..P::N] {
            low = low.min(b);
            high = high.max(if b == P::MAX { P::ZERO } else { b });
        }
        let out = &mut self.places[rank];
        if low == P::MAX {
            return;
        }
        for block in low.index()..=high.index() {
            let mine = place.simd_eq(P::V::<S>::splat(simd, P::from_index(block as u8)));
            if !mine.any_true() {
                continue;
            }
            let block = block as usize;
            let best = P::V::<S>::from_slice(simd, &self.map[block * width + x..][..P::N]);
            let range = blocks.range(block);
            let (strip, stride) = image.starting_at(blocks.roi.x + x, blocks.roi.y + range.start);
            // Blocks of very tall images have more rows than a byte can number: parts of them.
            let most = P::MAX.index().min(255) as usize;
            for part in (0..range.len()).step_by(most).rev() {
                let mut row = P::V::<S>::splat(simd, P::MAX);
                for r in (part..(part + most).min(range.len())).rev() {
                    let here = P::V::<S>::from_slice(simd, &strip[r * stride..][..P::N]);
                    row = here
                        .simd_eq(best)
                        .select(P::V::<S>::splat(simd, P::from_index((r - part) as u8)), row);
                }
                let row = mine.select(row, P::V::<S>::splat(simd, P::MAX));
                let mut rows = [P::MAX; MOST_LANES];
                row.store_slice(&mut rows[..P::N]);
                for (at, r) in out.at[x..x + P::N].iter_mut().zip(rows) {
                    if r != P::MAX {
                        *at = (range.start + part) as u32 + r.index();
                    }
                }
            }
        }
    }

    /// The same for regions narrower than a vector.
    fn few_columns(
        &mut self,
        image: &View<'_, P>,
        blocks: Blocks,
        (wanted, second_dn): (Wanted, Option<f32>),
    ) {
        let Blocks { roi, count, .. } = blocks;
        let reach = Self::reach(wanted, blocks);
        for x in 0..roi.width {
            let map = |block: usize| (block < count).then(|| self.map[block * roi.width + x]);
            let contrast = |block: usize| {
                let here = self.map[block * roi.width + x];
                here - here.min(Self::around(block.checked_sub(reach).and_then(map), map(block + reach)))
            };
            let mut strongest = None::<usize>;
            for rank in 0..2 {
                let mut best = (P::ZERO, None);
                if rank == 1 {
                    let Some(least) = second_dn else { break };
                    best.0 = P::from_dn(least);
                }
                for block in (0..count).filter(|b| strongest.is_none_or(|s| b.abs_diff(s) > 1)) {
                    let contrast = contrast(block);
                    if contrast > best.0 {
                        best = (contrast, Some(block));
                    }
                }
                let Some(block) = best.1 else { break };
                strongest = Some(block);
                let top = self.map[block * roi.width + x];
                let row = blocks.range(block).find(|y| image.row(roi.y + y)[roi.x + x] == top);
                self.places[rank].at[x] = row.map_or(NOWHERE, |y| y as u32);
            }
        }
    }

    /// The candidates of a block's rows: the places that stand out of the block's maxima, then each row's maximum around them.
    #[inline(always)]
    fn rows<S: Simd>(
        &mut self,
        simd: S,
        image: &View<'_, P>,
        blocks: Blocks,
        (wanted, second_dn): (Wanted, Option<f32>),
        block: usize,
    ) {
        /// Pixels added on either side, and on which steep stripes count as one: 16 rows at slope 3.
        const MARGIN: usize = 4;
        const STEEP: usize = 24;
        let Blocks { roi, .. } = blocks;
        let reach = (3.5 * wanted.width_px).ceil() as usize + STEEP;
        let map = &self.map[block * roi.width..(block + 1) * roi.width];
        // Beyond the border lies what never is the smaller of two; a line too short for both sides is compared with its darkest pixel.
        let short = map.len() <= 2 * reach;
        let beyond = if short { map.iter().copied().min().unwrap_or(P::ZERO) } else { P::MAX };
        self.padded.clear();
        self.padded.resize(reach, beyond);
        self.padded.extend_from_slice(map);
        self.padded.resize(map.len() + 2 * reach, beyond);
        self.contrast.resize(roi.width, P::ZERO);
        let padded = &self.padded;
        let (here, around) = (&padded[reach..], |x: usize| padded[x].min(padded[x + 2 * reach]));
        if roi.width < P::N {
            for (x, contrast) in self.contrast.iter_mut().enumerate() {
                *contrast = here[x] - here[x].min(around(x));
            }
        } else {
            for x in (0..roi.width).step_by(P::N) {
                let x = x.min(roi.width - P::N);
                let load = |from: usize| P::V::<S>::from_slice(simd, &padded[from..from + P::N]);
                let here = load(x + reach);
                (here - here.min(load(x).min(load(x + 2 * reach))))
                    .store_slice(&mut self.contrast[x..x + P::N]);
            }
        }
        for rank in 0..2 {
            let top = brightest(simd, &self.contrast[..roi.width]);
            let enough = rank == 0 || second_dn.is_some_and(|d| top > P::from_dn(d));
            if top == P::ZERO || !enough {
                return;
            }
            let Some(peak) = position(simd, &self.contrast, top) else { return };
            let low = P::from_dn(0.25 * top.dn());
            let (before, after) = self.contrast.split_at(peak);
            let from = (peak - run(simd, before, low, true)).saturating_sub(MARGIN);
            let to = (peak + run(simd, after, low, false) + MARGIN).min(roi.width);
            // At least a vector, where there is one.
            let to = to.max((from + P::N).min(roi.width));
            let from = from.min(to.saturating_sub(P::N));
            let rows = blocks.range(block);
            for first in rows.clone().step_by(ROWS) {
                // Below the last row comes the last row again.
                let row =
                    |r: usize| &image.row(roi.y + (first + r).min(rows.end - 1))[roi.x + from..roi.x + to];
                let best = tops::<S, P>(simd, row);
                let places = &mut self.places[rank].at[first..(first + ROWS).min(rows.end)];
                for (r, (at, best)) in places.iter_mut().zip(best).enumerate() {
                    *at = (from + position(simd, row(r), best).unwrap_or(0)) as u32;
                }
            }
            // A second one lies apart from the first.
            self.contrast[from.saturating_sub(reach)..(to + reach).min(roi.width)].fill(P::ZERO);
        }
    }
}

/// Largest grey value of each column in some rows: of some columns at a time, so that their maxima stay in registers.
#[inline(always)]
fn maxima<S: Simd, P: Pixel>(simd: S, image: &View<'_, P>, roi: Roi, rows: Range<usize>, map: &mut [P]) {
    let width = map.len();
    let (first, stride) = image.starting_at(roi.x, roi.y + rows.start);
    let wide = STRIP * P::N;
    let mut x = 0;
    while x + wide <= width {
        let mut best = [P::V::<S>::splat(simd, P::ZERO); STRIP];
        for r in 0..rows.len() {
            let part = &first[r * stride + x..][..wide];
            for (best, part) in best.iter_mut().zip(part.chunks_exact(P::N)) {
                *best = best.max(P::V::<S>::from_slice(simd, part));
            }
        }
        for (best, out) in best.iter().zip(map[x..x + wide].chunks_exact_mut(P::N)) {
            best.store_slice(out);
        }
        x += wide;
    }
    for x in (x..width).step_by(P::N) {
        let x = x.min(width - P::N);
        let mut best = P::V::<S>::splat(simd, P::ZERO);
        for r in 0..rows.len() {
            best = best.max(P::V::<S>::from_slice(simd, &first[r * stride + x..][..P::N]));
        }
        best.store_slice(&mut map[x..x + P::N]);
    }
}

/// Largest of some grey values; 0 of none.
#[inline(always)]
fn brightest<S: Simd, P: Pixel>(simd: S, row: &[P]) -> P {
    if row.len() < P::N {
        return row.iter().copied().max().unwrap_or(P::ZERO);
    }
    let load = |x: usize| P::V::<S>::from_slice(simd, &row[x..x + P::N]);
    let mut best = load(row.len() - P::N);
    for chunk in row.chunks_exact(P::N) {
        best = best.max(P::V::<S>::from_slice(simd, chunk));
    }
    best.reduce_max()
}

/// Largest grey values of as many rows as a block has: vectors are interleaved in pairs, so that one of half of each remains, until one holds
/// something of all rows.
#[inline(always)]
fn tops<'a, S: Simd, P: Pixel>(simd: S, row: impl Fn(usize) -> &'a [P]) -> [P; ROWS] {
    let length = row(0).len();
    if length < P::N {
        return std::array::from_fn(|r| brightest(simd, row(r)));
    }
    let mut best = [P::V::<S>::splat(simd, P::ZERO); ROWS];
    for (r, best) in best.iter_mut().enumerate() {
        let row = row(r);
        *best = P::V::<S>::from_slice(simd, &row[length - P::N..]);
        // Nearly always one vector or two.
        for chunk in row[..length - 1].chunks_exact(P::N) {
            *best = best.max(P::V::<S>::from_slice(simd, chunk));
        }
    }
    halve::<S, P, 8>(&mut best);
    halve::<S, P, 4>(&mut best);
    halve::<S, P, 2>(&mut best);
    halve::<S, P, 1>(&mut best);
    let mut lanes = [P::ZERO; MOST_LANES];
    best[0].store_slice(&mut lanes[..P::N]);
    let mut tops = [P::ZERO; ROWS];
    for part in lanes.chunks_exact(ROWS) {
        tops.iter_mut().zip(part).for_each(|(top, v)| *top = (*top).max(*v));
    }
    tops
}

/// Of each of the first vectors and its partner half of them on, what is larger in either half, alternating.
#[inline(always)]
fn halve<S: Simd, P: Pixel, const HALF: usize>(best: &mut [P::V<S>; ROWS]) {
    for r in 0..HALF {
        let (low, high) = best[r].interleave(best[r + HALF]);
        best[r] = low.max(high);
    }
}

/// Length of the run of grey values above `low` at the start, or at the end, of some.
#[inline(always)]
fn run<S: Simd, P: Pixel>(simd: S, row: &[P], low: P, backward: bool) -> usize {
    let above = |v: &&P| **v > low;
    let mut length = 0;
    while length + P::N <= row.len() {
        let from = if backward { row.len() - length - P::N } else { length };
        let part = P::V::<S>::from_slice(simd, &row[from..from + P::N]);
        let below = !part.simd_gt(P::V::<S>::splat(simd, low)).to_bitmask() << (64 - P::N);
        let here =
            if backward { below.leading_zeros() } else { (below >> (64 - P::N)).trailing_zeros() } as usize;
        if here < P::N {
            return length + here;
        }
        length += P::N;
    }
    let rest = if backward { &row[..row.len() - length] } else { &row[length..] };
    length
        + if backward {
            rest.iter().rev().take_while(above).count()
        } else {
            rest.iter().take_while(above).count()
        }
}

/// Where a value occurs first.
#[inline(always)]
fn position<S: Simd, P: Pixel>(simd: S, row: &[P], value: P) -> Option<usize> {
    if row.len() < P::N {
        return row.iter().position(|p| *p == value);
    }
    let last = row.len() - P::N;
    for x in (0..row.len()).step_by(P::N) {
        let x = x.min(last);
        let part = P::V::<S>::from_slice(simd, &row[x..x + P::N]);
        let equal = part.simd_eq(P::V::<S>::splat(simd, value)).to_bitmask();
        if equal != 0 {
            return Some(x + equal.trailing_zeros() as usize);
        }
    }
    None
}

/// Largest grey value of the region: nothing but a read, to compare with.
#[inline(always)]
pub(crate) fn read<S: Simd, P: Pixel>(simd: S, image: &View<'_, P>, roi: Roi) -> P {
    let row = |y: usize| &image.row(roi.y + y)[roi.x..roi.x + roi.width];
    if roi.width < P::N {
        return (0..roi.height).flat_map(row).copied().max().unwrap_or(P::ZERO);
    }
    let mut best = [P::V::<S>::splat(simd, P::ZERO); 4];
    for y in 0..roi.height {
        let row = row(y);
        let mut chunks = row.chunks_exact(4 * P::N);
        for chunk in &mut chunks {
            for (best, part) in best.iter_mut().zip(chunk.chunks_exact(P::N)) {
                *best = best.max(P::V::<S>::from_slice(simd, part));
            }
        }
        for x in (row.len() - chunks.remainder().len()..row.len()).step_by(P::N) {
            let x = x.min(row.len() - P::N);
            best[0] = best[0].max(P::V::<S>::from_slice(simd, &row[x..x + P::N]));
        }
    }
    best[0].max(best[1]).max(best[2].max(best[3])).reduce_max()
}
