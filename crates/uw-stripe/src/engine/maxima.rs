//! Pass one: the largest grey values of blocks of rows, at the speed of a read.
//!
//! Rows are read in the order of memory, each from end to end: to read several at once, or parts of several in turn, takes three times as
//! long where they come from memory, since the processor's prefetching follows one row at a time.

use std::ops::Range;

use fearless_simd::{Level, Simd, SimdBase, dispatch};

use super::lanes::{splat, vector};
use crate::{Pixel, Roi, View};

/// Rows of which the maximum is formed at a time.
pub(super) const ROWS: usize = 16;

/// Where the maxima of the columns' vectors go: every vector so many elements after the one before, and the last, which is moved back to
/// end with the region where that is no whole number of vectors wide.
#[derive(Debug, Clone, Copy)]
pub(super) struct Layout {
    pub apart: usize,
    pub last: usize,
}

/// Largest grey value of each column in some rows of a region at least a vector wide.
#[inline(never)]
pub(super) fn maxima<P: Pixel>(
    level: Level,
    image: &View<'_, P>,
    roi: Roi,
    rows: Range<usize>,
    to: (&mut [P], Layout),
) {
    dispatch!(level, simd => maxima_here(simd, image, roi, rows, to));
}

#[inline(always)]
fn maxima_here<S: Simd, P: Pixel>(
    simd: S,
    image: &View<'_, P>,
    roi: Roi,
    rows: Range<usize>,
    (map, layout): (&mut [P], Layout),
) {
    let strip = image.starting_at(roi.x, roi.y + rows.start);
    let count = rows.len();
    // Widths of which a row's maxima fit into registers: those of groups of columns, and of sensors.
    match (roi.width / P::N, roi.width % P::N) {
        (1, 0) => held::<S, P, 1>(simd, strip, count, (map, layout)),
        (2, 0) => held::<S, P, 2>(simd, strip, count, (map, layout)),
        (8, 0) => held::<S, P, 8>(simd, strip, count, (map, layout)),
        (10, 0) => held::<S, P, 10>(simd, strip, count, (map, layout)),
        (12, 0) => held::<S, P, 12>(simd, strip, count, (map, layout)),
        (16, 0) => held::<S, P, 16>(simd, strip, count, (map, layout)),
        (20, 0) => held::<S, P, 20>(simd, strip, count, (map, layout)),
        (24, 0) => held::<S, P, 24>(simd, strip, count, (map, layout)),
        _ => any_width(simd, strip, roi.width, count, (map, layout)),
    }
}

#[inline(always)]
fn held<S: Simd, P: Pixel, const COUNT: usize>(
    simd: S,
    (pixels, stride): (&[P], usize),
    rows: usize,
    (map, layout): (&mut [P], Layout),
) {
    let mut best = [splat(simd, P::ZERO); COUNT];
    for r in 0..rows {
        let row = &pixels[r * stride..][..COUNT * P::N];
        for (best, part) in best.iter_mut().zip(row.chunks_exact(P::N)) {
            *best = best.max(vector(simd, part));
        }
    }
    for (i, best) in best.iter().enumerate() {
        best.store_slice(&mut map[i * layout.apart..][..P::N]);
    }
}

#[inline(always)]
fn any_width<S: Simd, P: Pixel>(
    simd: S,
    (pixels, stride): (&[P], usize),
    width: usize,
    rows: usize,
    (map, layout): (&mut [P], Layout),
) {
    for r in 0..rows {
        add(simd, &pixels[r * stride..][..width], (map, layout), r == 0);
    }
}

/// Takes a row into the maxima; the first one is them.
#[inline(always)]
fn add<S: Simd, P: Pixel>(simd: S, row: &[P], (map, layout): (&mut [P], Layout), first: bool) {
    let parts = row.chunks_exact(P::N).zip(map.chunks_mut(layout.apart));
    if first {
        for (part, best) in parts {
            vector(simd, part).store_slice(&mut best[..P::N]);
        }
    } else {
        for (part, best) in parts {
            let best = &mut best[..P::N];
            vector(simd, part).max(vector(simd, best)).store_slice(best);
        }
    }
    if !row.len().is_multiple_of(P::N) {
        let best = &mut map[layout.last..layout.last + P::N];
        let here = vector(simd, &row[row.len() - P::N..]);
        let here = if first { here } else { here.max(vector(simd, best)) };
        here.store_slice(best);
    }
}

/// The same for a region narrower than a vector.
pub(super) fn maxima_of_few<P: Pixel>(image: &View<'_, P>, roi: Roi, rows: Range<usize>, map: &mut [P]) {
    map.fill(P::ZERO);
    for y in rows {
        let row = &image.row(roi.y + y)[roi.x..roi.x + roi.width];
        map.iter_mut().zip(row).for_each(|(m, p)| *m = (*m).max(*p));
    }
}

/// Largest grey value of the region: nothing but a read, to compare with.
#[inline(always)]
pub(crate) fn read<S: Simd, P: Pixel>(simd: S, image: &View<'_, P>, roi: Roi) -> P {
    let row = |y: usize| &image.row(roi.y + y)[roi.x..roi.x + roi.width];
    if roi.width < P::N {
        return (0..roi.height).flat_map(row).copied().max().unwrap_or(P::ZERO);
    }
    let mut best = [splat(simd, P::ZERO); 4];
    for y in 0..roi.height {
        let row = row(y);
        let mut chunks = row.chunks_exact(4 * P::N);
        for chunk in &mut chunks {
            for (best, part) in best.iter_mut().zip(chunk.chunks_exact(P::N)) {
                *best = best.max(vector(simd, part));
            }
        }
        for x in (row.len() - chunks.remainder().len()..row.len()).step_by(P::N) {
            let x = x.min(row.len() - P::N);
            best[0] = best[0].max(vector(simd, &row[x..x + P::N]));
        }
    }
    best[0].max(best[1]).max(best[2].max(best[3])).reduce_max()
}
