//! Pass one: the largest grey values of blocks of rows, at the speed of a read.
//!
//! Rows are read in the order of memory, whole up to four kilobytes where their width is a sensor's: the processor's prefetching follows one run of
//! lines without gaps.

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

/// Rows as wide as one of these numbers of vectors, as sensors' mostly are, are read whole, others and wider ones in parts, the larger first, so
/// that little is left beside them. Up to 32 are held in registers where there are as many: to keep maxima in memory holds up every pixel
/// that is read and lies as far into its page as a maximum that was just written into its own.
#[inline(always)]
fn maxima_here<S: Simd, P: Pixel>(simd: S, strip: &Strip<'_, P>, map: &mut [P]) {
    let mut done = 0;
    macro_rules! parts {
        ($($times:literal * $count:literal),*) => {
            $(done = parts::<S, P, $count, $times>(simd, strip, map, done);)*
        };
    }
    if (strip.width / P::N).is_multiple_of(64) {
        parts!(4 * 16);
    }
    parts!(
        4 * 15,
        3 * 15,
        4 * 10,
        2 * 16,
        2 * 15,
        2 * 12,
        2 * 10,
        1 * 16,
        1 * 15,
        1 * 12,
        1 * 10,
        1 * 4,
        1 * 2,
        1 * 1
    );
    if !strip.width.is_multiple_of(P::N) {
        let last = strip.layout.last;
        part::<S, P, 1, 1>(simd, strip, strip.width - P::N, &mut map[last..]);
    }
}

/// As many parts of `TIMES` by `COUNT` vectors as there are from `done` vectors on; how many are done then.
#[inline(always)]
fn parts<S: Simd, P: Pixel, const COUNT: usize, const TIMES: usize>(
    simd: S,
    strip: &Strip<'_, P>,
    map: &mut [P],
    mut done: usize,
) -> usize {
    while done + TIMES * COUNT <= strip.width / P::N {
        part::<S, P, COUNT, TIMES>(simd, strip, done * P::N, &mut map[done * strip.layout.apart..]);
        done += TIMES * COUNT;
    }
    done
}

/// Maxima of some vectors from pixel `from` of the rows on. In up to four arrays: the compiler keeps a larger one in memory.
#[inline(always)]
fn part<S: Simd, P: Pixel, const COUNT: usize, const TIMES: usize>(
    simd: S,
    strip: &Strip<'_, P>,
    from: usize,
    map: &mut [P],
) {
    let [mut a, mut b, mut c, mut d] = [[splat(simd, P::ZERO); COUNT]; 4];
    let size = COUNT * P::N;
    for r in 0..strip.rows {
        let row = &strip.pixels[r * strip.stride + from..][..TIMES * size];
        raise(simd, &mut a, row);
        if TIMES > 1 {
            raise(simd, &mut b, &row[size..]);
        }
        if TIMES > 2 {
            raise(simd, &mut c, &row[2 * size..]);
        }
        if TIMES > 3 {
            raise(simd, &mut d, &row[3 * size..]);
        }
    }
    let mut places = map.chunks_mut(strip.layout.apart);
    for best in &[a, b, c, d][..TIMES] {
        for (best, map) in best.iter().zip(&mut places) {
            best.store_slice(&mut map[..P::N]);
        }
    }
}

/// Raises maxima to what a row has from its first pixel on.
#[inline(always)]
fn raise<S: Simd, P: Pixel, const COUNT: usize>(simd: S, best: &mut [P::V<S>; COUNT], row: &[P]) {
    for (best, part) in best.iter_mut().zip(row.chunks_exact(P::N)) {
        *best = best.max(vector(simd, part));
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

#[cfg(test)]
mod tests {
    use super::super::tests::levels;
    use super::*;

    /// Every number of vectors that is read at once, and what is left beside them, at both layouts.
    fn are_the_largest<P: Pixel>(number: impl Fn(usize) -> P) {
        const MOST: usize = 130;
        let stride = MOST * P::N + 7;
        let pixels: Vec<P> = (0..stride * 20).map(|i| number(i.wrapping_mul(2_654_435_761) >> 12)).collect();
        for whole in 1..MOST {
            for (more, rows) in [(0, 2..18), (1, 3..4), (P::N - 1, 0..5)] {
                let roi = Roi { x: 3, y: 1, width: whole * P::N + more, height: 18 };
                let view = View::new(&pixels, stride, 20, stride).expect("sized");
                let strips = roi.width.div_ceil(P::N);
                let dense = Layout { apart: P::N, last: roi.width - P::N };
                let apart = Layout { apart: 3 * P::N, last: 3 * (strips - 1) * P::N };
                let want: Vec<P> = (roi.x..roi.x + roi.width)
                    .map(|x| rows.clone().map(|y| view.row(roi.y + y)[x]).max().expect("some rows"))
                    .collect();
                for level in levels() {
                    let mut map = vec![P::ZERO; 3 * strips * P::N];
                    maxima(level, &view, &roi, rows.clone(), dense, &mut map);
                    assert!(map[..roi.width] == want, "{level:?} {roi:?}");
                    assert!(map[roi.width..].iter().all(|m| *m == P::ZERO), "{level:?} {roi:?}");
                    maxima(level, &view, &roi, rows.clone(), apart, &mut map);
                    for strip in 0..strips {
                        let from = (strip * P::N).min(roi.width - P::N);
                        let got = &map[strip * apart.apart..][..P::N];
                        assert!(got == &want[from..][..P::N], "{level:?} {roi:?} {strip}");
                    }
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
