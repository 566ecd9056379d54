//! Candidates of columns: for a vector of columns at a time, the block that stands highest out of those above and below, and the row in it.

use fearless_simd::{Level, Select, Simd, SimdBase, SimdInt, SimdMask, dispatch};

use super::front::{Blocks, Front, NOWHERE, Wanted, least_second, least_second_in_the_dark};
use super::lanes::{MOST_LANES, splat, vector};
use super::maxima::maxima;
use crate::{NoiseModel, Pixel, Roi, View};

impl<P: Pixel> Front<P> {
    /// Finds the candidates of all columns.
    pub fn columns(&mut self, level: Level, image: &View<'_, P>, roi: Roi, wanted: Wanted) {
        let blocks = Blocks::new(roi);
        // One more, unused: blocks as they are cut from any column on reach into the next one.
        self.map.resize((blocks.count + 1) * blocks.apart());
        for (block, map) in (0..blocks.count).zip(self.map.chunks_exact_mut(blocks.apart())) {
            maxima(level, image, &roi, blocks.range(block), &mut map[..roi.width]);
        }
        if roi.width < P::N {
            self.few_columns(image, blocks, wanted);
            return;
        }
        let mut least = None;
        for x in (0..roi.width).step_by(P::N) {
            let x = x.min(roi.width - P::N);
            dispatch!(level, simd => self.strip(simd, image, blocks, (wanted, &mut least), x));
        }
    }

    /// Candidates of a vector of columns from `x` on. `least`: height of a second candidate, once it had to be known.
    #[inline(always)]
    fn strip<S: Simd>(
        &mut self,
        simd: S,
        image: &View<'_, P>,
        blocks: Blocks,
        (wanted, least): (Wanted, &mut Option<P>),
        x: usize,
    ) {
        let reach = reach(wanted, blocks);
        let map = Maxima { from: &self.map[x..], apart: blocks.apart(), count: blocks.count };
        let Some(noise) = wanted.second else {
            let mut best = Best::<S, P>::new(simd, P::ZERO);
            contrasts(simd, map, reach, &mut best);
            self.locate(simd, image, blocks, x, 0, best.place);
            return;
        };
        // What is bright enough for a second candidate nearly always lies next to the first: then there is none.
        let mut look = BestAndBright::<S, P>::new(simd, P::from_dn(least_second_in_the_dark(&noise)));
        contrasts(simd, map, reach, &mut look);
        let strongest = look.best.place;
        let one = splat(simd, P::from_index(1));
        let above = strongest.saturating_sub(look.first).simd_gt(one);
        if above.any_true() || look.last.saturating_sub(strongest).simd_gt(one).any_true() {
            let least = *least.get_or_insert_with(|| self.least_second(&noise, blocks));
            let mut look = BestApart { simd, best: Best::<S, P>::new(simd, least), strongest };
            contrasts(simd, map, reach, &mut look);
            self.locate(simd, image, blocks, x, 1, look.best.place);
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
        let none = splat(simd, P::MAX);
        // Wraps for those that have no place, which then are the least.
        let one = splat(simd, P::from_index(1));
        let (low, high) = (place.reduce_min(), (place + one).reduce_max());
        let out = &mut self.places[rank].at[x..x + P::N];
        if low == P::MAX {
            return;
        }
        for block in low.index()..high.index() {
            let mine = place.simd_eq(splat(simd, P::from_index(block as u8)));
            if !mine.any_true() {
                continue;
            }
            let block = block as usize;
            let best = vector(simd, &self.map[blocks.place(block, x)..][..P::N]);
            let range = blocks.range(block);
            let (pixels, stride) = image.starting_at(blocks.roi.x + x, blocks.roi.y + range.start);
            // Blocks of very tall images have more rows than a byte can number: parts of them.
            let most = P::MAX.index().min(255) as usize;
            for part in (0..range.len()).step_by(most).rev() {
                let mut row = none;
                for r in (part..(part + most).min(range.len())).rev() {
                    let here = vector(simd, &pixels[r * stride..][..P::N]);
                    let number = splat(simd, P::from_index((r - part) as u8));
                    row = here.simd_eq(best).select(number, row);
                }
                let row = mine.select(row, none);
                let mut rows = [P::MAX; MOST_LANES];
                row.store_slice(&mut rows[..P::N]);
                for (at, r) in out.iter_mut().zip(rows) {
                    *at = if r == P::MAX { *at } else { (range.start + part) as u32 + r.index() };
                }
            }
        }
    }

    /// Least height of a second candidate.
    fn least_second(&self, noise: &NoiseModel, blocks: Blocks) -> P {
        let width = blocks.roi.width;
        let maximum = |i: usize| self.map[blocks.place(i / width, i % width)];
        P::from_dn(least_second(noise, blocks.count * width, maximum))
    }

    /// [`Self::strip`] for regions narrower than a vector.
    fn few_columns(&mut self, image: &View<'_, P>, blocks: Blocks, wanted: Wanted) {
        let Blocks { roi, count, .. } = blocks;
        let reach = reach(wanted, blocks);
        let least = wanted.second.map(|noise| self.least_second(&noise, blocks));
        for x in 0..roi.width {
            let map = |block: usize| (block < count).then(|| self.map[blocks.place(block, x)]);
            let contrast = |block: usize| {
                let here = self.map[blocks.place(block, x)];
                here - here.min(around(block.checked_sub(reach).and_then(map), map(block + reach)))
            };
            let mut strongest = None::<usize>;
            for rank in 0..2 {
                let mut best = (P::ZERO, None);
                if rank == 1 {
                    let Some(least) = least else { break };
                    best.0 = least;
                }
                for block in (0..count).filter(|b| strongest.is_none_or(|s| b.abs_diff(s) > 1)) {
                    let contrast = contrast(block);
                    if contrast > best.0 {
                        best = (contrast, Some(block));
                    }
                }
                let Some(block) = best.1 else { break };
                strongest = Some(block);
                let top = self.map[blocks.place(block, x)];
                let row = blocks.range(block).find(|y| image.row(roi.y + y)[roi.x + x] == top);
                self.places[rank].at[x] = row.map_or(NOWHERE, |y| y as u32);
            }
        }
    }
}

/// Blocks to either side in which a stripe of the block between does not show.
fn reach(wanted: Wanted, blocks: Blocks) -> usize {
    1 + (6.0 * wanted.width_px / blocks.rows as f32).ceil() as usize
}

/// The smaller of two neighbours' maxima, or that of the one there is.
fn around<P: Pixel>(before: Option<P>, after: Option<P>) -> P {
    match (before, after) {
        (Some(a), Some(b)) => a.min(b),
        (one, other) => one.or(other).unwrap_or(P::ZERO),
    }
}

/// What is told the blocks of a vector of columns one after the other, their number and how far they stand out. A trait instead of a closure,
/// which the compiler may leave outside the processor's features.
trait Look<S: Simd, P: Pixel> {
    fn see(&mut self, number: P::V<S>, contrast: P::V<S>);
}

/// What stands highest so far, and the number of its block; the first of equals.
struct Best<S: Simd, P: Pixel> {
    height: P::V<S>,
    place: P::V<S>,
}

impl<S: Simd, P: Pixel> Best<S, P> {
    #[inline(always)]
    fn new(simd: S, least: P) -> Self {
        Self { height: splat(simd, least), place: splat(simd, P::MAX) }
    }
}

impl<S: Simd, P: Pixel> Look<S, P> for Best<S, P> {
    #[inline(always)]
    fn see(&mut self, number: P::V<S>, contrast: P::V<S>) {
        self.place = contrast.simd_gt(self.height).select(number, self.place);
        self.height = self.height.max(contrast);
    }
}

/// The same, and the first and last block that is bright enough for a second candidate.
struct BestAndBright<S: Simd, P: Pixel> {
    best: Best<S, P>,
    dark: P::V<S>,
    none: P::V<S>,
    first: P::V<S>,
    last: P::V<S>,
}

impl<S: Simd, P: Pixel> BestAndBright<S, P> {
    #[inline(always)]
    fn new(simd: S, dark: P) -> Self {
        let (none, least) = (splat(simd, P::MAX), splat(simd, P::ZERO));
        Self { best: Best::new(simd, P::ZERO), dark: splat(simd, dark), none, first: none, last: least }
    }
}

impl<S: Simd, P: Pixel> Look<S, P> for BestAndBright<S, P> {
    #[inline(always)]
    fn see(&mut self, number: P::V<S>, contrast: P::V<S>) {
        self.best.see(number, contrast);
        let bright = contrast.simd_gt(self.dark);
        self.first = self.first.min(bright.select(number, self.none));
        self.last = bright.select(number, self.last);
    }
}

/// What stands highest apart from the strongest.
struct BestApart<S: Simd, P: Pixel> {
    simd: S,
    best: Best<S, P>,
    strongest: P::V<S>,
}

impl<S: Simd, P: Pixel> Look<S, P> for BestApart<S, P> {
    #[inline(always)]
    fn see(&mut self, number: P::V<S>, contrast: P::V<S>) {
        // A neighbour of the strongest is its other part.
        let distance = number.max(self.strongest) - number.min(self.strongest);
        let apart = distance.simd_gt(splat(self.simd, P::from_index(1)));
        self.best.see(number, apart.select(contrast, splat(self.simd, P::ZERO)));
    }
}

/// The blocks' maxima of a vector of columns: each so many grey values after the one before.
#[derive(Clone, Copy)]
struct Maxima<'a, P> {
    from: &'a [P],
    apart: usize,
    count: usize,
}

impl<'a, P: Pixel> Maxima<'a, P> {
    /// Those of some blocks, as far as there are any, each from its first column on.
    #[inline(always)]
    fn of(self, blocks: std::ops::Range<usize>) -> std::iter::Take<std::slice::ChunksExact<'a, P>> {
        let first = blocks.start.min(self.count - 1);
        let count = blocks.end.min(self.count).saturating_sub(blocks.start);
        self.from[first * self.apart..].chunks_exact(self.apart).take(count)
    }
}

/// How far each block of a vector of columns stands out of those a reach away, with its number, in their order; of two such blocks the lower
/// counts, or the one there is.
#[inline(always)]
fn contrasts<S: Simd, P: Pixel>(simd: S, map: Maxima<'_, P>, reach: usize, look: &mut impl Look<S, P>) {
    let count = map.count;
    let one = splat(simd, P::from_index(1));
    let mut number = splat(simd, P::ZERO);
    // The first ones have none before, the last none after; where there are few some have neither.
    let mut later = map.of(reach..count);
    for here in map.of(0..reach) {
        let low = if let Some(after) = later.next() { own(simd, after) } else { splat(simd, P::ZERO) };
        look.see(number, own(simd, here).saturating_sub(low));
        number += one;
    }
    let middle = count.saturating_sub(reach).max(reach);
    let both = map.of(reach..middle).zip(map.of(0..count)).zip(later);
    for ((here, before), after) in both {
        let low = own(simd, before).min(own(simd, after));
        look.see(number, own(simd, here).saturating_sub(low));
        number += one;
    }
    for (here, before) in map.of(middle..count).zip(map.of(middle - reach..count)) {
        look.see(number, own(simd, here).saturating_sub(own(simd, before)));
        number += one;
    }
}

/// Those of the vector of columns in a block.
#[inline(always)]
fn own<S: Simd, P: Pixel>(simd: S, maxima: &[P]) -> P::V<S> {
    vector(simd, &maxima[..P::N])
}
