//! Candidates of rows: what stands out of a block's maxima, then each row's maximum around it.

use std::ops::Range;

use fearless_simd::{Level, Simd, SimdBase, SimdInt, SimdMask, dispatch};

use super::front::{Front, Wanted, brightest, is_second, least_second_in_the_dark, position};
use super::lanes::{MOST_LANES, NUMBERED, splat, vector};
use super::maxima::{ROWS, apart, maxima};
use super::window::GROUP;
use crate::{Pixel, Roi, View};

/// Pixels added on either side of what stands out.
const MARGIN: usize = 4;
/// Pixels on which steep stripes count as one: 16 rows at slope 3.
const STEEP: usize = 24;
/// Pixels that one comparison covers on either side of a peak.
const ARM: usize = 32;

/// Most blocks that are searched together.
const BLOCKS: usize = GROUP / ROWS;

/// Blocks of rows that are searched together, and where their maxima are: block after block, each with a margin on either side.
#[derive(Debug, Clone)]
struct Search<'a> {
    roi: &'a Roi,
    wanted: &'a Wanted,
    /// Rows of all of them.
    rows: Range<usize>,
    /// Pixels after which the surroundings of a stripe begin.
    reach: usize,
    /// A margin's length, and from a block's maxima to the next ones.
    pad: usize,
    apart: usize,
}

impl<'a> Search<'a> {
    /// Some rows of a region, on which the stripe moves by so many pixels.
    fn new(roi: &'a Roi, wanted: &'a Wanted, rows: Range<usize>, moves: usize) -> Self {
        let around = (3.5 * wanted.width_px).ceil() as usize;
        // Whole vectors, so that maxima lie as the image does.
        let pad = (around + STEEP).max(ARM).next_multiple_of(MOST_LANES);
        let apart = apart(roi.width + 2 * pad);
        Self { roi, wanted, rows, reach: around + moves, pad, apart }
    }

    fn blocks(&self) -> Range<usize> {
        0..self.rows.len().div_ceil(ROWS)
    }

    /// A block's rows.
    fn rows(&self, block: usize) -> Range<usize> {
        let first = self.rows.start + block * ROWS;
        first..(first + ROWS).min(self.rows.end)
    }

    /// Where a block's maxima are, without the margins.
    fn within(&self, block: usize) -> Range<usize> {
        let first = block * self.apart + self.pad;
        first..first + self.roi.width
    }
}

/// Pixels of a block in which the stripe is, and, counted from the start of the margin, what belongs to it.
#[derive(Debug, Clone)]
struct Span {
    from: usize,
    to: usize,
    near: Range<usize>,
}

impl<P: Pixel> Front<P> {
    /// Finds the candidates of a group of rows, counted from the region's first.
    pub fn rows(
        &mut self,
        level: Level,
        image: &View<'_, P>,
        roi: &Roi,
        wanted: &Wanted,
        rows: Range<usize>,
    ) {
        let search = Search::new(roi, wanted, rows, STEEP);
        let size = BLOCKS * search.apart;
        if self.contrast.len() != size || self.map.len() != size {
            self.map.resize(size);
            self.contrast.resize(size);
        }
        if search.rows.start == 0 {
            // Beyond the border lies what never is the smaller of two.
            self.map.fill(P::MAX);
            self.contrast.fill(P::ZERO);
        }
        for block in search.blocks() {
            maxima(level, image, roi, search.rows(block), &mut self.map[search.within(block)]);
        }
        dispatch!(level, simd => self.search(simd, image, &search));
    }

    /// What stands highest out of a single row: brighter things on other rows may have kept its stripe from being a candidate. After
    /// [`Self::rows`], of the same region.
    pub fn row(
        &mut self,
        level: Level,
        image: &View<'_, P>,
        roi: &Roi,
        wanted: &Wanted,
        row: usize,
    ) -> Option<u32> {
        let search = Search::new(roi, wanted, row..row + 1, 0);
        let within = search.within(0);
        self.map[within.clone()].copy_from_slice(&image.row(roi.y + row)[roi.x..][..roi.width]);
        dispatch!(level, simd => {
            let top = self.stand_out(simd, &search, 0);
            position(simd, &self.contrast[within], top).filter(|_| top > P::ZERO).map(|at| at as u32)
        })
    }

    /// True for as many pixels a row as [`Self::rows_nearby`] can number.
    pub fn numbers(width: usize) -> bool {
        width == P::N / 2 || (P::N..=NUMBERED).contains(&width)
    }

    /// The candidates of some rows of a region that holds nothing but the stripe's surroundings: each row's maximum.
    pub fn rows_nearby(&mut self, level: Level, image: &View<'_, P>, roi: Roi, rows: Range<usize>) {
        let places = &mut self.places[0].at[rows.clone()];
        let part = image.starting_at(roi.x, roi.y + rows.start);
        dispatch!(level, simd => tops_of_group(simd, part, roi.width, places));
    }

    /// Candidates of some blocks of rows from their maxima. Each step is done for all of them before the next: what was just written is read
    /// at other offsets, for which it must have reached the cache.
    #[inline(always)]
    fn search<S: Simd>(&mut self, simd: S, image: &View<'_, P>, search: &Search<'_>) {
        let mut spans: [Option<Span>; BLOCKS] = Default::default();
        let mut tops = [P::ZERO; BLOCKS];
        for block in search.blocks() {
            tops[block] = self.stand_out(simd, search, block);
        }
        for block in search.blocks() {
            spans[block] = self.span(simd, search, block, tops[block]);
        }
        self.find_tops(simd, image, search, &spans, 0);
        let Some(noise) = search.wanted.second else { return };
        // A second one lies apart from the first.
        for span in spans.iter().flatten() {
            self.contrast[span.near.clone()].fill(P::ZERO);
        }
        let mut any = false;
        for block in search.blocks() {
            let within = search.within(block);
            let top = brightest(simd, &self.contrast[within.clone()]);
            // The usual level is looked for only where it matters.
            let seen = spans[block].is_some()
                && top > P::from_dn(least_second_in_the_dark(&noise))
                && is_second(simd, &noise, &self.map[within], top);
            spans[block] = if seen { self.span(simd, search, block, top) } else { None };
            any |= seen;
        }
        if any {
            self.find_tops(simd, image, search, &spans, 1);
        }
    }

    /// What of a block's maxima stands out of their surroundings, and the largest of it.
    #[inline(always)]
    fn stand_out<S: Simd>(&mut self, simd: S, search: &Search<'_>, block: usize) -> P {
        let (within, reach) = (search.within(block), search.reach);
        // A line too short for both sides is compared with its darkest pixel.
        if within.len() <= 2 * reach {
            let beyond = self.map[within.clone()].iter().copied().min().unwrap_or(P::ZERO);
            self.map[within.start - reach..within.start].fill(beyond);
            self.map[within.end..within.end + reach].fill(beyond);
        }
        stand_out(simd, &self.map, &mut self.contrast[within.clone()], (within.start, reach))
    }

    /// Where in a block the value that stands out most belongs to; `None` where nothing does.
    #[inline(always)]
    fn span<S: Simd>(&self, simd: S, search: &Search<'_>, block: usize, top: P) -> Option<Span> {
        if top == P::ZERO {
            return None;
        }
        let (width, start) = (search.roi.width, search.within(block).start);
        let peak = position(simd, &self.contrast[start..start + width], top)?;
        let (before, after) = run(simd, &self.contrast, start + peak, P::from_dn(0.25 * top.dn()));
        // The steeper the stripe, the further a line that is too dim to count may lie beyond.
        let margin = MARGIN + (before + after) / 4;
        let from = (peak - before.min(peak)).saturating_sub(margin);
        let to = (peak + after + margin).min(width);
        let near = start + from.saturating_sub(search.reach)..start + (to + search.reach).min(width);
        // At least half a vector or a whole one, as much on one side as on the other: lines much dimmer than the others may lie beyond. Short
        // lines are looked at whole.
        let size = match to - from {
            _ if width < P::N => width,
            few if few <= P::N / 2 => P::N / 2,
            many => many.max(P::N).min(width),
        };
        let from = from.saturating_sub((size - (to - from).min(size)) / 2).min(width - size);
        Some(Span { from, to: from + size, near })
    }

    /// Places of the rows' maxima in some blocks' spans.
    #[inline(always)]
    fn find_tops<S: Simd>(
        &mut self,
        simd: S,
        image: &View<'_, P>,
        search: &Search<'_>,
        spans: &[Option<Span>; BLOCKS],
        rank: usize,
    ) {
        for block in search.blocks() {
            let Some(Span { from, to, .. }) = &spans[block] else { continue };
            let (from, length) = (*from, to - from);
            let rows = search.rows(block);
            let part = image.starting_at(search.roi.x + from, search.roi.y + rows.start);
            let places = &mut self.places[rank].at[rows.clone()];
            if !Self::numbers(length) {
                for (r, at) in places.iter_mut().enumerate() {
                    let row = &part.0[r * part.1..][..length];
                    let top = brightest(simd, row);
                    *at = (from + position(simd, row, top).unwrap_or(0)) as u32;
                }
            } else {
                let found = tops(simd, part, length, rows.len());
                for (at, found) in places.iter_mut().zip(found) {
                    *at = from as u32 + found;
                }
            }
        }
    }
}

/// What of some block maxima stands out of those a reach away on either side, and the largest of it.
#[inline(always)]
fn stand_out<S: Simd, P: Pixel>(simd: S, map: &[P], contrast: &mut [P], (start, reach): (usize, usize)) -> P {
    let width = contrast.len();
    let (before, here, after) =
        (&map[start - reach..][..width], &map[start..][..width], &map[start + reach..][..width]);
    if width < P::N {
        let mut top = P::ZERO;
        for (x, out) in contrast.iter_mut().enumerate() {
            *out = here[x] - here[x].min(before[x].min(after[x]));
            top = top.max(*out);
        }
        return top;
    }
    let mut top = splat(simd, P::ZERO);
    let vectors = here.chunks_exact(P::N).zip(before.chunks_exact(P::N)).zip(after.chunks_exact(P::N));
    for (((here, before), after), out) in vectors.zip(contrast.chunks_exact_mut(P::N)) {
        let one = above(simd, here, before, after);
        one.store_slice(out);
        top = top.max(one);
    }
    if !width.is_multiple_of(P::N) {
        let last = width - P::N;
        let one = above(simd, &here[last..], &before[last..], &after[last..]);
        one.store_slice(&mut contrast[last..]);
        top = top.max(one);
    }
    top.reduce_max()
}

/// How far a vector of block maxima stands out of the lower of those on either side.
#[inline(always)]
fn above<S: Simd, P: Pixel>(simd: S, here: &[P], before: &[P], after: &[P]) -> P::V<S> {
    vector(simd, here).saturating_sub(vector(simd, before).min(vector(simd, after)))
}

/// How far values above `low` go on from `peak` on, downwards without it and upwards with it; nothing is above `low` at the ends.
#[inline(always)]
fn run<S: Simd, P: Pixel>(simd: S, values: &[P], peak: usize, low: P) -> (usize, usize) {
    let low_v = splat(simd, low);
    let mut above = 0;
    for (i, part) in values[peak - ARM..peak + ARM].chunks_exact(P::N).enumerate() {
        above |= vector(simd, part).simd_gt(low_v).to_bitmask() << (i * P::N % 64);
    }
    let (before, after) = ((above << ARM).leading_ones() as usize, (above >> ARM).trailing_ones() as usize);
    if before < ARM && after < ARM {
        return (before, after);
    }
    let is_above = |v: &&P| **v > low;
    (
        values[..peak].iter().rev().take_while(is_above).count(),
        values[peak..].iter().take_while(is_above).count(),
    )
}

/// Places of the largest grey values in a group's rows, as [`tops`] finds them. All rows are read before any is searched: few of these lines of the
/// cache follow each other, and from memory the processor waits for many as long as for one.
#[inline(always)]
fn tops_of_group<S: Simd, P: Pixel>(
    simd: S,
    (pixels, stride): (&[P], usize),
    span: usize,
    places: &mut [u32],
) {
    let mut keys = [[P::Keys::<S>::splat(simd, P::Wide::default()); ROWS]; BLOCKS];
    for (keys, first) in keys.iter_mut().zip((0..places.len()).step_by(ROWS)) {
        let rows = (places.len() - first).min(ROWS);
        fill_keys(simd, (&pixels[first * stride..], stride), span, rows, keys);
    }
    for (keys, places) in keys.iter_mut().zip(places.chunks_mut(ROWS)) {
        places.copy_from_slice(&largest::<S, P>(simd, keys, span)[..places.len()]);
    }
}

/// Place of the largest grey value in each of up to 16 rows, `span` pixels of each, at least half a vector and at most what a byte numbers.
///
/// Each value is put above a number that tells its place, every other is compared with its neighbour, and what remains of all rows is halved in the
/// same way until each lane holds a row. Two rows share a vector where half of one holds a row.
#[inline(always)]
fn tops<S: Simd, P: Pixel>(simd: S, pixels: (&[P], usize), span: usize, rows: usize) -> [u32; ROWS] {
    let mut keys = [P::Keys::<S>::splat(simd, P::Wide::default()); ROWS];
    fill_keys(simd, pixels, span, rows, &mut keys);
    largest::<S, P>(simd, &mut keys, span)
}

/// The larger of each two neighbours in up to 16 rows above the number of its place: a vector for each row or for two.
#[inline(always)]
fn fill_keys<S: Simd, P: Pixel>(
    simd: S,
    (pixels, stride): (&[P], usize),
    span: usize,
    rows: usize,
    keys: &mut [P::Keys<S>; ROWS],
) {
    // Below the last row comes the last row again.
    let row = |r: usize| &pixels[r.min(rows - 1) * stride..][..span];
    if span <= P::N / 2 {
        let numbers = P::numbers(simd, 0, P::N / 2);
        for (r, key) in keys[..ROWS / 2].iter_mut().enumerate() {
            *key = P::keys(simd, P::join(simd, row(2 * r), row(2 * r + 1)), numbers);
        }
        return;
    }
    let numbers = P::numbers(simd, 0, P::N);
    for (r, key) in keys.iter_mut().enumerate() {
        let row = row(r);
        *key = P::keys(simd, vector(simd, &row[..P::N]), numbers);
        // Nearly always one vector or two.
        let mut from = P::N;
        while from < span {
            let at = from.min(span - P::N);
            let numbers = P::numbers(simd, at as u8, P::N);
            *key = key.max(P::keys(simd, vector(simd, &row[at..at + P::N]), numbers));
            from += P::N;
        }
    }
}

/// The places that the largest keys tell, as [`fill_keys`] leaves them. In place: copies would have to reach the cache first.
#[inline(always)]
fn largest<S: Simd, P: Pixel>(simd: S, keys: &mut [P::Keys<S>; ROWS], span: usize) -> [u32; ROWS] {
    if span > P::N / 2 {
        halve::<S, P, 8>(simd, keys);
    }
    halve::<S, P, 4>(simd, keys);
    halve::<S, P, 2>(simd, keys);
    halve::<S, P, 1>(simd, keys);
    let mut places = [0; ROWS];
    P::places(simd, keys[0]).store_slice(&mut places);
    places
}

/// Of neighbours in twice as many vectors, the larger ones, in order.
#[inline(always)]
fn halve<S: Simd, P: Pixel, const COUNT: usize>(simd: S, best: &mut [P::Keys<S>; ROWS]) {
    for r in 0..COUNT {
        best[r] = P::larger(simd, best[2 * r], best[2 * r + 1]);
    }
}

#[cfg(test)]
mod tests {
    use super::super::tests::levels;
    use super::*;

    /// Of spans of all lengths, in rows apart by all that a span leaves.
    fn are_the_first_largest<P: Pixel>(number: impl Fn(usize) -> P) {
        let pixels: Vec<P> =
            (0..NUMBERED * GROUP + 7).map(|i| number(i.wrapping_mul(2_654_435_761) >> 9)).collect();
        for span in (P::N / 2..=P::N / 2).chain(P::N..=NUMBERED) {
            for (rows, stride) in
                [(ROWS, span), (ROWS, NUMBERED), (1, span), (11, span + 3), (GROUP, span), (37, NUMBERED)]
            {
                let want: Vec<u32> = pixels
                    .chunks(stride)
                    .take(rows)
                    .map(|row| (0..span).rev().max_by_key(|i| row[*i]).expect("pixels") as u32)
                    .collect();
                for level in levels() {
                    let mut found = vec![0; rows];
                    dispatch!(level, simd => tops_of_group(simd, (&pixels, stride), span, &mut found));
                    assert_eq!(found, want, "{level:?} {span} {rows} {stride}");
                    if rows <= ROWS {
                        let found = dispatch!(level, simd => tops(simd, (&pixels, stride), span, rows));
                        assert_eq!(found[..rows], want, "{level:?} {span} {rows} {stride}");
                    }
                }
            }
        }
    }

    #[test]
    fn places_are_those_of_the_first_largest_pixels() {
        are_the_first_largest(|i| (i % 251) as u8);
        are_the_first_largest(|i| (i % 9) as u8);
        are_the_first_largest(|i| i as u16);
        are_the_first_largest(|i| (i % 9) as u16);
    }
}
