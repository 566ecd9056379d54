//! Pass one: the largest grey values of blocks of rows, at the speed of a read.
//!
//! Rows are read whole, in the order of memory: the processor's prefetching follows one run of lines without gaps.

use std::ops::Range;

use fearless_simd::{Level, Simd, SimdBase, dispatch};

use super::lanes::{MOST_LANES, splat, vector};
use crate::{Pixel, Roi, View};

/// Rows of which the maximum is formed at a time.
pub(super) const ROWS: usize = 16;
/// Vectors that are raised in memory at a time.
const STEP: usize = 4;

/// From a block's maxima to the next ones', where they are so many: whole vectors, and never a page or a part of one, which all would share the same few
/// lines of the first cache.
pub(super) fn apart(width: usize) -> usize {
    width.next_multiple_of(MOST_LANES) | MOST_LANES
}

/// Some rows of a region at least a vector wide.
struct Rows<'a, P> {
    /// From the first row's first pixel on, and pixels from a row to the next.
    pixels: &'a [P],
    stride: usize,
    width: usize,
    count: usize,
}

/// Fills `map` with the largest grey value of each column in some rows of a region.
///
/// What steps are told that are dispatched block by block goes by reference: to copy what was just written in parts, all at once, waits until
/// it has reached the cache.
#[inline(never)]
pub(super) fn maxima<P: Pixel>(
    level: Level,
    image: &View<'_, P>,
    roi: &Roi,
    rows: Range<usize>,
    map: &mut [P],
) {
    if roi.width < P::N {
        maxima_of_few(image, roi, rows, map);
        return;
    }
    let (pixels, stride) = image.starting_at(roi.x, roi.y + rows.start);
    let rows = &Rows { pixels, stride, width: roi.width, count: rows.len() };
    dispatch!(level, simd => maxima_here(simd, rows, map));
}

/// Up to 30 vectors of maxima are held in registers, where there are 32 of 64 bytes; the rest, of wider rows, in memory. Each number has a loop of
/// its own: a single vector in memory costs as much as all the others.
#[inline(always)]
fn maxima_here<S: Simd, P: Pixel>(simd: S, rows: &Rows<'_, P>, map: &mut [P]) {
    macro_rules! held {
        ($($count:literal),*) => {
            match rows.width / P::N {
                $($count.. => raise_all::<S, P, $count>(simd, rows, map),)*
                _ => {}
            }
        };
    }
    held!(
        30, 29, 28, 27, 26, 25, 24, 23, 22, 21, 20, 19, 18, 17, 16, 15, 14, 13, 12, 11, 10, 9, 8, 7, 6, 5, 4,
        3, 2, 1
    );
}

/// Maxima of rows whose first `COUNT` vectors have theirs in registers, as has what is left of them behind the last whole vector.
#[inline(always)]
fn raise_all<S: Simd, P: Pixel, const COUNT: usize>(simd: S, rows: &Rows<'_, P>, map: &mut [P]) {
    let Rows { pixels, stride, width, count } = *rows;
    let (held, whole) = (COUNT * P::N, width - width % P::N);
    let map = &mut map[..width];
    // In vectors, as they are read again at once: what was written in parts would have to reach the cache first.
    for map in map[held..whole].chunks_exact_mut(P::N) {
        splat(simd, P::ZERO).store_slice(map);
    }
    let mut best = [splat(simd, P::ZERO); COUNT];
    let mut last = splat(simd, P::ZERO);
    // From memory this is a tenth and more faster than to take each row by its offset (ADR 0011).
    for row in pixels.chunks(stride).take(count) {
        let row = &row[..width];
        raise(simd, &mut best, &row[..held]);
        if held < whole {
            raise_in_memory(simd, &mut map[held..whole], &row[held..whole]);
        }
        if whole < width {
            last = last.max(vector(simd, &row[width - P::N..]));
        }
    }
    if whole < width {
        last.store_slice(&mut map[width - P::N..]);
    }
    for (best, map) in best.iter().zip(map.chunks_exact_mut(P::N)) {
        best.store_slice(map);
    }
}

/// Raises maxima to what a row has, whole vectors of it.
#[inline(always)]
fn raise<S: Simd, P: Pixel, const COUNT: usize>(simd: S, best: &mut [P::V<S>; COUNT], row: &[P]) {
    for (best, part) in best.iter_mut().zip(row.chunks_exact(P::N)) {
        *best = best.max(vector(simd, part));
    }
}

/// The same of maxima in memory.
#[inline(always)]
fn raise_in_memory<S: Simd, P: Pixel>(simd: S, map: &mut [P], row: &[P]) {
    let mut maps = map.chunks_exact_mut(STEP * P::N);
    let mut rows = row.chunks_exact(STEP * P::N);
    for (map, row) in (&mut maps).zip(&mut rows) {
        raise_vectors(simd, map, row);
    }
    raise_vectors(simd, maps.into_remainder(), rows.remainder());
}

/// The same a vector at a time.
#[inline(always)]
fn raise_vectors<S: Simd, P: Pixel>(simd: S, map: &mut [P], row: &[P]) {
    for (map, row) in map.chunks_exact_mut(P::N).zip(row.chunks_exact(P::N)) {
        vector(simd, map).max(vector(simd, row)).store_slice(map);
    }
}

/// [`maxima`] of a region narrower than a vector.
fn maxima_of_few<P: Pixel>(image: &View<'_, P>, roi: &Roi, rows: Range<usize>, map: &mut [P]) {
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

#[cfg(test)]
mod tests {
    use super::super::tests::levels;
    use super::*;

    /// Every number of vectors that registers hold, what memory holds beside them, and what is left behind the last whole one.
    fn are_the_largest<P: Pixel>(number: impl Fn(usize) -> P) {
        const MOST: usize = 70;
        let stride = (MOST + 1) * P::N;
        let pixels: Vec<P> = (0..stride * 20).map(|i| number(i.wrapping_mul(2_654_435_761) >> 12)).collect();
        for whole in 0..MOST {
            for (more, rows) in [(0, 2..18), (1, 3..4), (P::N - 1, 0..5)] {
                let roi = Roi { x: 1, y: 1, width: (whole * P::N + more).max(1), height: 18 };
                // The last row ends with the image, in the middle of a row of memory.
                let view = View::new(&pixels, roi.x + roi.width, 20, stride).expect("sized");
                let want: Vec<P> = (roi.x..roi.x + roi.width)
                    .map(|x| rows.clone().map(|y| view.row(roi.y + y)[x]).max().expect("some rows"))
                    .collect();
                for level in levels() {
                    let mut map = vec![P::MAX; roi.width];
                    maxima(level, &view, &roi, rows.clone(), &mut map);
                    assert!(map == want, "{level:?} {roi:?}");
                }
            }
        }
    }

    #[test]
    fn maxima_are_the_largest_of_their_columns_whatever_the_width() {
        are_the_largest(|i| i as u8);
        are_the_largest(|i| i as u16);
    }
}
