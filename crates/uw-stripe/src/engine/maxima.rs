//! Pass one: the largest grey values of blocks of rows, at the speed of a read.
//!
//! Rows are read in the order of memory, a kilobyte of each at least where they have as much: the processor's prefetching follows one row at a time.

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

/// Some rows of a region, and where their maxima go.
struct Strip<'a, P> {
    /// From the first row's first pixel on, and pixels from a row to the next.
    pixels: &'a [P],
    stride: usize,
    width: usize,
    rows: usize,
    layout: Layout,
}

/// Largest grey value of each column in some rows of a region at least a vector wide.
///
/// What steps are told that are dispatched block by block goes by reference: to copy what was just written in parts, all at once, waits until
/// it has reached the cache.
#[inline(never)]
pub(super) fn maxima<P: Pixel>(
    level: Level,
    image: &View<'_, P>,
    roi: &Roi,
    rows: Range<usize>,
    layout: Layout,
    map: &mut [P],
) {
    let (pixels, stride) = image.starting_at(roi.x, roi.y + rows.start);
    let strip = &Strip { pixels, stride, width: roi.width, rows: rows.len(), layout };
    dispatch!(level, simd => maxima_here(simd, strip, map));
}

/// The rows in parts of a few vectors, whose maxima fit into registers: to keep them in memory would hold up every pixel that is read and lies
/// as far into its page as a maximum that was just written into its own. Widths of sensors are a whole number of parts of one size.
#[inline(always)]
fn maxima_here<S: Simd, P: Pixel>(simd: S, strip: &Strip<'_, P>, map: &mut [P]) {
    let whole = strip.width / P::N;
    let mut done = 0;
    match whole {
        n if n.is_multiple_of(16) => done = parts::<S, P, 16>(simd, strip, map, done),
        n if n.is_multiple_of(15) => done = parts::<S, P, 15>(simd, strip, map, done),
        n if n.is_multiple_of(10) => done = parts::<S, P, 10>(simd, strip, map, done),
        _ => {
            done = parts::<S, P, 12>(simd, strip, map, done);
            done = parts::<S, P, 4>(simd, strip, map, done);
            done = parts::<S, P, 2>(simd, strip, map, done);
        }
    }
    parts::<S, P, 1>(simd, strip, map, done);
    if !strip.width.is_multiple_of(P::N) {
        let last = strip.layout.last;
        part::<S, P, 1>(simd, strip, strip.width - P::N, &mut map[last..]);
    }
}

/// As many parts of so many vectors as there are from `done` vectors on; how many are done then.
#[inline(always)]
fn parts<S: Simd, P: Pixel, const COUNT: usize>(
    simd: S,
    strip: &Strip<'_, P>,
    map: &mut [P],
    mut done: usize,
) -> usize {
    while done + COUNT <= strip.width / P::N {
        part::<S, P, COUNT>(simd, strip, done * P::N, &mut map[done * strip.layout.apart..]);
        done += COUNT;
    }
    done
}

/// Maxima of some vectors from pixel `from` of the rows on.
#[inline(always)]
fn part<S: Simd, P: Pixel, const COUNT: usize>(simd: S, strip: &Strip<'_, P>, from: usize, map: &mut [P]) {
    let mut best = [splat(simd, P::ZERO); COUNT];
    for r in 0..strip.rows {
        let row = &strip.pixels[r * strip.stride + from..][..COUNT * P::N];
        for (best, part) in best.iter_mut().zip(row.chunks_exact(P::N)) {
            *best = best.max(vector(simd, part));
        }
    }
    for (i, best) in best.iter().enumerate() {
        best.store_slice(&mut map[i * strip.layout.apart..][..P::N]);
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
